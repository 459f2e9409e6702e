//! How likely a sensed range image is at a pose, given the image predicted there (the formula: `docs/batches.md`).

use super::PoseCell;
use crate::error::{Error, Result};
use crate::sensor::{Mixture, Sensor, SensorSpec};

/// Below this cosine of incidence a beam counts as one that meets the surface at it: the spread of its range has no end.
pub(super) const LEAST_COS: f64 = 0.05;

/// Something unknown is spread over no less than this, metres, so that its density has a bound.
const LEAST_RANGE: f64 = 1e-6;

/// No probability is less: a `range_min` may be all but 0, a likelihood not.
const LEAST: f64 = 1e-30;

/// A sensed range image of a sensor, ready to be compared with predictions.
#[derive(Clone, Debug)]
pub struct RangeLikelihood {
    sensor: Sensor,
    range: Vec<f32>,
    pub(super) model: BeamModel,
}

impl RangeLikelihood {
    /// A range image of the sensor, row-major: metres, `+inf` where nothing was sensed, `-inf` where something was nearer than
    /// `range_min`, NaN where there is no reading ([`crate::io::log::LogFrame::range`]).
    ///
    /// ```
    /// use presight::batch::{PoseCell, RangeLikelihood};
    /// use presight::{Noise, Sensor, SensorSpec};
    /// let mut spec: SensorSpec = presight::preset("laser-scanner")?.spec().clone();
    /// spec.noise = Noise { range_sigma: 0.02, ..Noise::default() };
    /// let sensor = Sensor::new(spec)?;
    /// let sensed = RangeLikelihood::new(&sensor, vec![2.0; 361], PoseCell::default())?;
    /// let at = |range: f32| sensed.log_likelihood(&[range; 361], &[1.0; 361]);
    /// assert!(at(2.0) > at(2.05) && at(2.05) > at(1.0));
    /// # Ok::<(), presight::Error>(())
    /// ```
    ///
    /// # Errors
    /// [`crate::ErrorKind::Invalid`] for an image of another size, one without any reading, one that holds what this sensor
    /// cannot sense, a sensor without `range_sigma` or without a finite `range_max`, or a cell that is not finite.
    pub fn new(sensor: &Sensor, range: Vec<f32>, cell: PoseCell) -> Result<Self> {
        let spec = sensor.spec();
        let pixels = sensor.width() as usize * sensor.height() as usize;
        let remedy = "give a range image of the sensor";
        if range.len() != pixels {
            let what = format!("the sensed image has {} ranges, sensor {:?} has {pixels} rays", range.len(), spec.name);
            return Err(Error::invalid(what, remedy));
        }
        if range.iter().all(|r| r.is_nan()) {
            return Err(Error::invalid("the sensed image holds no reading", remedy));
        }
        let model = BeamModel::new(sensor, cell)?;
        let possible = |r: f32| match r {
            f32::NEG_INFINITY => spec.range_min > 0.0,
            r => !(r < spec.range_min as f32) && (!(r > spec.range_max as f32) || r == f32::INFINITY),
        };
        if let Some(i) = range.iter().position(|r| !possible(*r)) {
            let what = format!("sensor {:?} cannot sense {} m", spec.name, range[i]);
            return Err(
                Error::invalid(what, "give inf beyond range_max, -inf below range_min").at(format!("range {i}"))
            );
        }
        Ok(Self { sensor: sensor.clone(), range, model })
    }

    pub(super) fn sensor(&self) -> &SensorSpec {
        self.sensor.spec()
    }

    /// The image as it was given.
    pub fn range(&self) -> &[f32] {
        &self.range
    }

    /// Natural logarithm of the likelihood of the sensed image where `range` and `cos_incidence` are predicted, the images of
    /// one prediction. Readings have densities in 1 / metre: only differences tell something. Rays without a reading or without a
    /// prediction are left out.
    ///
    /// # Panics
    /// If the images are not of the sensor's size.
    pub fn log_likelihood(&self, range: &[f32], cos_incidence: &[f32]) -> f64 {
        assert!(range.len() == self.range.len() && cos_incidence.len() == range.len(), "the sensor's images");
        // A logarithm now and then, of a product that is far from the ends of f64.
        const ENDS: std::ops::Range<f64> = 1e-150..1e150;
        let (mut sum, mut product) = (0.0, 1.0);
        for ((&sensed, &range), &cos) in self.range.iter().zip(range).zip(cos_incidence) {
            if sensed.is_nan() || range.is_nan() {
                continue;
            }
            product *= self.model.beam(range, cos).density(sensed);
            if !ENDS.contains(&product) {
                sum += product.ln();
                product = 1.0;
            }
        }
        (sum + product.ln()) / self.model.mixture.beam_dependence
    }
}

/// What all beams of a sensor have in common.
#[derive(Clone, Copy, Debug)]
pub(super) struct BeamModel {
    pub mixture: Mixture,
    range_sigma: f64,
    quadratic: f64,
    /// Variance of the beam's direction and the pose's heading together, radians squared.
    turn: f64,
    /// Variance of the pose's place, metres squared.
    place: f64,
    range_min: f64,
    pub range_max: f64,
}

/// What a beam may sense, given its prediction: a mixture of densities over ranges, 1 / metre, and of two outcomes without one.
#[derive(Clone, Copy, Debug)]
pub(super) struct Beam {
    /// Predicted, metres.
    pub range: f64,
    /// Density of a hit at the predicted range, and what its distance squared is multiplied by in the exponent.
    pub peak: f64,
    pub sharpness: f64,
    /// Density nearer than predicted, of something that the model does not have.
    pub short: f64,
    /// Density of anything.
    pub any: f64,
    /// Probability of nothing, and of something nearer than `range_min`.
    pub none: f64,
    pub near: f64,
}

impl BeamModel {
    fn new(sensor: &Sensor, cell: PoseCell) -> Result<Self> {
        let spec = sensor.spec();
        let at = |e: Error| e.at(format!("sensor {:?}", spec.name));
        if !(spec.noise.range_sigma >= 1e-9) {
            let remedy = "give range_sigma of at least 1e-9 m in its [noise]";
            return Err(at(Error::invalid("a likelihood needs the noise of ranges", remedy)));
        }
        if spec.range_max.is_infinite() {
            return Err(at(Error::invalid("a likelihood needs a finite range_max", "give the sensor one")));
        }
        let widths = [cell.side, cell.turn];
        if !widths.iter().all(|w| *w >= 0.0 && *w <= 1e6) {
            return Err(Error::invalid(
                format!("pose cell {cell:?}"),
                "give widths of 0 or more, in metres and radians",
            ));
        }
        // Variance of what lies anywhere within a width.
        let variance = |width: f64| width * width / 12.0;
        Ok(Self {
            mixture: spec.noise.mixture,
            range_sigma: spec.noise.range_sigma,
            quadratic: spec.noise.range_sigma_quadratic,
            turn: spec.noise.angle_sigma * spec.noise.angle_sigma + variance(cell.turn),
            place: variance(cell.side),
            range_min: spec.range_min,
            range_max: spec.range_max,
        })
    }

    /// The beam whose prediction is this.
    pub fn beam(&self, range: f32, cos_incidence: f32) -> Beam {
        let Mixture { hit, short, none, any, .. } = self.mixture;
        let anywhere = any / self.range_max;
        let below = any * self.range_min / self.range_max;
        if range == f32::INFINITY {
            let (peak, sharpness, short_at) = (0.0, 0.0, short / self.range_max);
            let near = (below + short_at * self.range_min).max(LEAST);
            return Beam {
                range: 2.0 * self.range_max,
                peak,
                sharpness,
                short: short_at,
                any: anywhere,
                none: none + hit,
                near,
            };
        }
        if range == f32::NEG_INFINITY {
            let near = below + short + hit;
            return Beam { range: 0.0, peak: 0.0, sharpness: 0.0, short: 0.0, any: anywhere, none, near };
        }
        let r = f64::from(range);
        let cos_squared = f64::from(cos_incidence).max(LEAST_COS).powi(2);
        let own = self.range_sigma + self.quadratic * r * r;
        let variance = own * own + (r * r * self.turn * (1.0 - cos_squared) + self.place) / cos_squared;
        let sharpness = 0.5 / variance;
        let peak = hit * (sharpness / std::f64::consts::PI).sqrt();
        let short = if r > 0.0 { short / r.max(LEAST_RANGE) } else { 0.0 };
        Beam {
            range: r,
            peak,
            sharpness,
            short,
            any: anywhere,
            none,
            near: (below + short * self.range_min).max(LEAST),
        }
    }
}

impl Beam {
    /// The density of a reading, or the probability of what has none.
    fn density(&self, sensed: f32) -> f64 {
        match sensed {
            f32::INFINITY => self.none,
            f32::NEG_INFINITY => self.near,
            sensed => {
                let away = f64::from(sensed) - self.range;
                let exponent = away * away * self.sharpness;
                // Less than a rounding of what is added.
                let hit = if exponent < 700.0 { self.peak * (-exponent).exp() } else { 0.0 };
                let short = if away < 0.0 { self.short } else { 0.0 };
                hit + short + self.any
            }
        }
    }
}
