//! How likely a scan is at poses of the robot.

use glam::{DQuat, DVec3};
use presight_model::error::Result;
use presight_model::geometry::{Pose, SensorPose};
use presight_model::measured::{Frame, Measurement, RangeNoise};
use presight_model::sensor::{Angles, Geometry, Scanner, Sensor, SensorSpec};
use presight_model::world::World;
use presight_predict::batch::{BatchRequest, PoseCell, RangeLikelihood};
use presight_predict::predict::Predictor;
use presight_render::row::is_level;

/// A sensor with the noise of its ranges and of the model together.
#[derive(Clone, Debug)]
pub(super) struct PoseLikelihood {
    scanner: Sensor,
    /// Columns and rows of a frame that are left out between two that count.
    stride: u32,
    /// A level scanner, whose poses are turned upright.
    level: bool,
}

/// A row counts as level if it leaves its height by no more within its reach, metres.
const LEVEL: f64 = 0.05;

/// Pixels along the longer side of an image that is weighed, of a single row as many as in such an image: more only
/// cost time, as neighbours err together.
const SIDE: u32 = 24;

impl PoseLikelihood {
    /// `level_from_sensor` is how the sensor stands. A row that hangs upside down becomes the upright one that sees the
    /// same. `beam_dependence` is for a sensor that states none. The reach of a sensor without `range_max` is the map's
    /// extent.
    pub fn new(
        sensor: &Sensor,
        level_from_sensor: DQuat,
        world: &World,
        model_sigma: f64,
        beam_dependence: f64,
    ) -> Result<Self> {
        let mut spec = with_noise(sensor, world, model_sigma, beam_dependence);
        let up = level_from_sensor * DVec3::Z;
        let reach = spec.range_max.min(reach_of(world));
        let mut level = is_level(&Pose { rotation: level_from_sensor, ..Pose::IDENTITY });
        if let Geometry::Scanner(scanner) = &mut spec.geometry
            && sensor.height() == 1
            && reach * up.truncate().length() <= LEVEL
        {
            level = true;
            if up.z < 0.0 {
                scanner.azimuth = mirrored(&scanner.azimuth);
                scanner.elevation = mirrored(&scanner.elevation);
            }
        }
        Ok(Self { level, scanner: Sensor::new(spec)?, stride: 1 })
    }

    /// Weighs a few pixels of a sensor of any shape.
    pub fn of_image(sensor: &Sensor, world: &World, model_sigma: f64, beam_dependence: f64) -> Result<Self> {
        let (width, height) = (f64::from(sensor.width()), f64::from(sensor.height()));
        let side = f64::from(SIDE);
        // As many pixels of a flat image as of one of 4 to 3.
        let stride = if height == 1.0 { width / (side * side) } else { (width * height / (0.75 * side * side)).sqrt() };
        let stride = stride.max(1.0) as u32;
        let nothing = vec![f32::NAN; sensor.width() as usize * sensor.height() as usize];
        let thin = Frame::new(0.0, sensor.clone(), Measurement::Range(nothing))?.thinned(stride)?;
        let mut spec = with_noise(thin.sensor(), world, model_sigma, beam_dependence);
        spec.range_max = spec.range_max.min(reach_of(world));
        Ok(Self { scanner: Sensor::new(spec)?, stride, level: false })
    }

    /// True if the row is level, so that its view turns with it.
    pub fn is_level(&self) -> bool {
        self.level
    }

    /// The pixels of a frame that count.
    pub fn thinned(&self, frame: &Frame) -> Result<Frame> {
        if self.stride > 1 { frame.thinned(self.stride) } else { Ok(frame.clone()) }
    }

    /// The scanner that frames are weighed with.
    pub fn scanner(&self) -> &Sensor {
        &self.scanner
    }

    /// The readings of a frame that count, as the scanner delivers them.
    pub fn readings(&self, frame: &Frame) -> Result<Vec<f32>> {
        let spec = self.scanner.spec();
        let reading = |r: &f32| match f64::from(*r) {
            z if z > spec.range_max => f32::INFINITY,
            // A sensor that measures from 0 on has nothing that is too near.
            f64::NEG_INFINITY if spec.range_min == 0.0 => f32::NAN,
            z if z < spec.range_min => f32::NEG_INFINITY,
            _ => *r,
        };
        Ok(self.thinned(frame)?.ranges().iter().map(reading).collect())
    }

    /// A level scanner all round with the limits of this one.
    pub fn all_round(&self, count: usize) -> Result<Sensor> {
        let step_deg = 360.0 / count as f64;
        let azimuth = Angles::Uniform { start_deg: -180.0, step_deg, count: count as u32 };
        let elevation = Angles::Listed(vec![0.0]);
        let geometry = Geometry::Scanner(Scanner { azimuth, elevation, beam_height_deg: None });
        let own = self.scanner.spec();
        let mut spec = SensorSpec::new(&own.name, &own.class, geometry);
        (spec.range_min, spec.range_max) = (own.range_min, own.range_max);
        Sensor::new(spec)
    }

    /// A frame, ready to be weighed; `None` if it has no reading.
    pub fn of(&self, frame: &Frame, cell: PoseCell) -> Result<Option<RangeLikelihood>> {
        let ranges = self.readings(frame)?;
        if ranges.iter().all(|r| !r.is_finite()) {
            return Ok(None);
        }
        let frame = Frame::new(frame.stamp, self.scanner.clone(), Measurement::Range(ranges))?;
        RangeLikelihood::new(&frame, cell).map(Some)
    }

    /// The scanner's poses for poses of the robot.
    pub fn of_sensor(&self, robot: impl Iterator<Item = Pose>) -> Vec<SensorPose> {
        let mount = self.scanner.spec().mount;
        let of_sensor = |pose: Pose| if self.level { upright(&(pose * mount)) } else { pose * mount };
        let mut poses: Vec<Pose> = robot.map(of_sensor).collect();
        // One cut of the world serves them all, if rounding leaves them at one height.
        let height = poses.first().map_or(0.0, |pose| pose.translation.z);
        let same = |pose: &&mut Pose| (pose.translation.z - height).abs() < 1e-9;
        poses.iter_mut().filter(same).for_each(|pose| pose.translation.z = height);
        poses.into_iter().map(SensorPose::new).collect()
    }

    /// Log-likelihoods of a frame at poses of the robot.
    pub fn at(
        &self,
        predictor: &mut Predictor,
        world: &World,
        frame: &Frame,
        poses: impl Iterator<Item = Pose>,
    ) -> Result<Vec<f64>> {
        let poses = self.of_sensor(poses);
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

/// The pose with its z axis upright and its x axis where it was: what rounding turned away is turned back.
fn upright(pose: &Pose) -> Pose {
    Pose { rotation: DQuat::from_rotation_z(heading_of(pose.rotation)), ..*pose }
}

/// The azimuth of the x axis, radians.
pub(super) fn heading_of(rotation: DQuat) -> f64 {
    let x = rotation * DVec3::X;
    x.y.atan2(x.x)
}

/// The same angles to the other side.
fn mirrored(angles: &Angles) -> Angles {
    match angles {
        Angles::Uniform { start_deg, step_deg, count } => {
            Angles::Uniform { start_deg: -start_deg, step_deg: -step_deg, count: *count }
        }
        Angles::Listed(angles) => Angles::Listed(angles.iter().map(|a| -a).collect()),
    }
}

/// The specification of a sensor, with the noise of its ranges and of the model together.
fn with_noise(sensor: &Sensor, world: &World, model_sigma: f64, beam_dependence: f64) -> SensorSpec {
    let mut spec = sensor.spec().clone();
    if spec.range_max.is_infinite() {
        spec.range_max = reach_of(world);
    }
    spec.noise.range_sigma = RangeNoise::of(sensor).sigma.hypot(model_sigma);
    if spec.noise.mixture.beam_dependence == 1.0 {
        spec.noise.mixture.beam_dependence = beam_dependence;
    }
    spec
}
