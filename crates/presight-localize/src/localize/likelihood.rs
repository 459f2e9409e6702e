//! How likely a scan is at poses of the robot.

use glam::{DQuat, DVec3};
use presight_model::error::Result;
use presight_model::geometry::Pose;
use presight_model::measured::{Frame, Measurement, RangeNoise};
use presight_model::sensor::Sensor;
use presight_model::world::World;
use presight_predict::batch::{BatchRequest, PoseCell, RangeLikelihood};
use presight_predict::predict::Predictor;

/// A sensor with the noise of its ranges and of the model together.
#[derive(Clone, Debug)]
pub(super) struct PoseLikelihood {
    scanner: Sensor,
    /// Columns and rows of a frame that are left out between two that count.
    stride: u32,
    /// A level scanner, whose poses are turned upright.
    level: bool,
}

/// Pixels along the longer side of an image that is weighed: more only cost time, as neighbours err together.
const SIDE: u32 = 24;

impl PoseLikelihood {
    /// `beam_dependence` is for a sensor that states none. The reach of a sensor without `range_max` is the map's extent.
    pub fn new(sensor: &Sensor, world: &World, model_sigma: f64, beam_dependence: f64) -> Result<Self> {
        let mut spec = sensor.spec().clone();
        if spec.range_max.is_infinite() {
            spec.range_max = reach_of(world);
        }
        spec.noise.range_sigma = RangeNoise::of(sensor).sigma.hypot(model_sigma);
        if spec.noise.mixture.beam_dependence == 1.0 {
            spec.noise.mixture.beam_dependence = beam_dependence;
        }
        Ok(Self { scanner: Sensor::new(spec)?, stride: 1, level: true })
    }

    /// Of a sensor of any shape that may lean: a few of its pixels count.
    pub fn of_image(sensor: &Sensor, world: &World, model_sigma: f64, beam_dependence: f64) -> Result<Self> {
        let stride = (sensor.width().max(sensor.height()) / SIDE).max(1);
        let nothing = vec![f32::NAN; sensor.width() as usize * sensor.height() as usize];
        let thin = Frame::new(0.0, sensor.clone(), Measurement::Range(nothing))?.thinned(stride)?;
        let mut spec = thin.sensor().spec().clone();
        spec.range_max = spec.range_max.min(reach_of(world));
        Ok(Self { stride, level: false, ..Self::new(&Sensor::new(spec)?, world, model_sigma, beam_dependence)? })
    }

    /// The pixels of a frame that count.
    pub fn thinned(&self, frame: &Frame) -> Result<Frame> {
        if self.stride > 1 { frame.thinned(self.stride) } else { Ok(frame.clone()) }
    }

    /// The scanner that frames are weighed with.
    pub fn scanner(&self) -> &Sensor {
        &self.scanner
    }

    /// A frame, ready to be weighed; `None` if it has no reading.
    pub fn of(&self, frame: &Frame, cell: PoseCell) -> Result<Option<RangeLikelihood>> {
        let spec = self.scanner.spec();
        let reading = |r: &f32| match f64::from(*r) {
            z if z > spec.range_max => f32::INFINITY,
            // A sensor that measures from 0 on has nothing that is too near.
            f64::NEG_INFINITY if spec.range_min == 0.0 => f32::NAN,
            z if z < spec.range_min => f32::NEG_INFINITY,
            _ => *r,
        };
        let ranges: Vec<f32> = self.thinned(frame)?.ranges().iter().map(reading).collect();
        if ranges.iter().all(|r| !r.is_finite()) {
            return Ok(None);
        }
        let frame = Frame::new(frame.stamp, self.scanner.clone(), Measurement::Range(ranges))?;
        RangeLikelihood::new(&frame, cell).map(Some)
    }

    /// Log-likelihoods of a frame at poses of the robot.
    pub fn at(
        &self,
        predictor: &mut Predictor,
        world: &World,
        frame: &Frame,
        poses: impl Iterator<Item = Pose>,
    ) -> Result<Vec<f64>> {
        let mount = self.scanner.spec().mount;
        let of_sensor = |pose: Pose| if self.level { upright(&(pose * mount)) } else { pose * mount };
        let mut poses: Vec<Pose> = poses.map(of_sensor).collect();
        // One cut of the world serves them all, if rounding leaves them at one height.
        let height = poses.first().map_or(0.0, |pose| pose.translation.z);
        let same = |pose: &&mut Pose| (pose.translation.z - height).abs() < 1e-9;
        poses.iter_mut().filter(same).for_each(|pose| pose.translation.z = height);
        let Some(likelihood) = self.of(frame, PoseCell::default())? else { return Ok(vec![0.0; poses.len()]) };
        let request = BatchRequest { likelihood: Some(likelihood), ..BatchRequest::default() };
        let items = predictor.batch(world, &self.scanner, poses, &request)?;
        items.map(|item| item.map(|item| item.log_likelihood.unwrap_or(0.0))).collect()
    }
}

/// No range in a map is longer than its diagonal, metres.
fn reach_of(world: &World) -> f64 {
    let bounds = world.environment().bounds();
    if bounds.is_empty() { 1.0 } else { (bounds.max - bounds.min).length().max(1.0) }
}

/// The pose with its z axis upright: what rounding turned away is turned back.
fn upright(pose: &Pose) -> Pose {
    let x = pose.rotation * DVec3::X;
    Pose { rotation: DQuat::from_rotation_z(x.y.atan2(x.x)), ..*pose }
}
