//! Likelihood of a measured range image at a pose, given the image predicted there (formula in `docs/batches.md`).

use super::beam_model::BeamModel;
use super::weigh::LogDensitySum;
use super::{Headings, PoseCell};
use presight_model::error::{Error, Result};
use presight_model::measured::Frame;
use presight_model::sensor::{Sensor, SensorSpec};
use presight_render::plan::Weighing;

/// A measured range image of a sensor, prepared for comparison with predictions.
#[derive(Clone, Debug)]
pub struct RangeLikelihood {
    sensor: Sensor,
    range: Vec<f32>,
    pub(super) model: BeamModel,
}

impl RangeLikelihood {
    /// Prepares the ranges of a frame. Poses are compared with the frame's own sensor; `cell` is the spacing of
    /// candidate poses.
    ///
    /// ```
    /// use presight::predict::{PoseCell, RangeLikelihood};
    /// use presight::measured::{Frame, Measurement};
    /// use presight::sensor::{Noise, SensorSpec};
    /// use presight::Sensor;
    /// let mut spec: SensorSpec = presight::preset("laser-scanner")?.spec().clone();
    /// spec.noise = Noise { range_sigma: 0.02, ..Noise::default() };
    /// let frame = Frame::new(0.0, Sensor::new(spec)?, Measurement::Range(vec![2.0; 361]))?;
    /// let sensed = RangeLikelihood::new(&frame, PoseCell::default())?;
    /// let at = |range: f32| sensed.log_likelihood(&[range; 361], &[1.0; 361]);
    /// assert!(at(2.0) > at(2.05) && at(2.05) > at(1.0));
    /// # Ok::<(), presight::Error>(())
    /// ```
    ///
    /// # Errors
    /// [`presight_model::ErrorKind::Invalid`] for a frame without a reading, for readings that this sensor cannot
    /// deliver, for a sensor without `range_sigma` or finite `range_max`, for a cell that is not finite, or for a frame
    /// whose rays do not have one pose.
    pub fn new(frame: &Frame, cell: PoseCell) -> Result<Self> {
        if !frame.has_one_pose() {
            let remedy = "give Frame::at_one_moment, and poses of its sensor at that moment";
            return Err(Error::invalid("the robot moves while the frame is measured", remedy));
        }
        let (sensor, range) = (frame.sensor(), frame.ranges());
        let spec = sensor.spec();
        if range.iter().all(|r| r.is_nan()) {
            return Err(Error::invalid("the frame has no range readings", "give a frame of ranges"));
        }
        let model = BeamModel::new(sensor, cell)?;
        let too_near = range.iter().position(|r| *r == f32::NEG_INFINITY && spec.range_min == 0.0);
        if let Some(i) = too_near {
            let what = format!("nothing is too near for sensor {:?}, whose range_min is 0", spec.name);
            return Err(Error::invalid(what, "give a range_min, or NaN for no reading").at(format!("range {i}")));
        }
        // A beam that comes twice counts once.
        let (width, distinct) = (sensor.width() as usize, sensor.distinct_columns() as usize);
        let mut range = range.to_vec();
        range.chunks_mut(width).for_each(|row| row[distinct..].fill(f32::NAN));
        Ok(Self { sensor: sensor.clone(), range, model })
    }

    pub(super) fn sensor(&self) -> &SensorSpec {
        self.sensor.spec()
    }

    /// The ranges of the frame, NaN for a beam that comes a second time.
    pub fn range(&self) -> &[f32] {
        &self.range
    }

    /// Natural logarithm of the likelihood of the measured image, given the predicted images `range` and
    /// `cos_incidence`. Readings have densities in 1 / metre, so only differences are meaningful. Rays without a
    /// reading or a prediction are ignored.
    ///
    /// # Panics
    /// If the images do not have the sensor's size.
    pub fn log_likelihood(&self, range: &[f32], cos_incidence: &[f32]) -> f64 {
        assert!(range.len() == self.range.len() && cos_incidence.len() == range.len(), "the sensor's images");
        let sum = LogDensitySum { model: &self.model, sensed: &self.range, range, cos_incidence };
        self.tempered(pulp::Arch::new().dispatch(sum))
    }

    /// The log-likelihood of an image, from the sum of the beams' logarithms.
    pub(super) fn tempered(&self, sum: f64) -> f64 {
        sum / self.model.mixture.beam_dependence
    }

    /// The data for an engine that weighs images itself, at a pose or at all headings.
    pub(super) fn weighing(&self, headings: Option<&Headings>) -> Weighing {
        let model = self.model.numbers();
        let Some(h) = headings else {
            let width = self.sensor.width();
            return Weighing { sensed: self.range.clone(), beams: [width; 2], headings: 1, stride: 0, model };
        };
        let (sensed, width) = h.resampled(&self.range);
        let beams = [width as u32, h.beams as u32];
        Weighing { sensed, beams, headings: h.count, stride: h.stride as u32, model }
    }
}
