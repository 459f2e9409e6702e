//! Simulated logs: measurements of a sensor with noise, drop-outs and mixed pixels, odometry that slips, and a scene
//! that differs from its model.
//!
//! A seed determines the log. The noise shares only the sensor's stated deviations with the estimator's model.

mod grey;
mod surroundings;

pub use grey::GreySimulator;
pub use surroundings::{Walkers, displace};

use crate::motion::moved;
use presight_model::error::{Error, Result};
use presight_model::geometry::{Pose, PoseCovariance, RobotPose};
use presight_model::measured::{Frame, GreyImage, Measurement, Motion, RangeNoise, ScanMotion};
use presight_model::random::SplitMix64;
use presight_model::sensor::Sensor;
use presight_model::world::World;
use presight_predict::predict::Predictor;
use presight_predict::request::Request;
use presight_render::plan::{Output, Outputs};

presight_model::options! {
    /// Errors of a simulated sensor and its robot beyond the sensor's stated noise.
    #[derive(Clone, Copy, Debug, PartialEq)]
    pub struct Disturbances {
        /// Fraction of the pixels without a measurement.
        drop_outs: f64 = 0.01, with_drop_outs;
        /// Fraction of the pixels at a range jump that measure a range in between.
        mixed_pixels: f64 = 0.3, with_mixed_pixels;
        /// Odometry error as a fraction of the distance, one standard deviation.
        slip: f64 = 0.02, with_slip;
        /// Odometry error in radians per radian turned and per metre driven, one standard deviation.
        turn_slip: f64 = 0.02, with_turn_slip;
    }
}

/// A range that differs from its neighbour's by more than this fraction is behind an edge.
const JUMP: f64 = 0.05;

/// Simulates the frames of one sensor on one robot.
///
/// # Examples
/// ```
/// use presight::simulate::{Disturbances, Simulator};
/// use presight::environment::Environment;
/// use presight::{Options, Predictor, RobotPose, World};
/// let world = World::new(Environment::new());
/// let scanner = presight::preset("laser-scanner")?;
/// let mut simulator = Simulator::new(Predictor::new(Options::default())?, scanner, Disturbances::default(), 7)?;
/// let frame = simulator.frame(&world, 0.0, &RobotPose::IDENTITY)?;
/// assert!(frame.ranges().iter().all(|r| !r.is_finite()), "the scene is empty");
/// # Ok::<(), presight::Error>(())
/// ```
pub struct Simulator {
    predictor: Predictor,
    sensor: Sensor,
    disturbances: Disturbances,
    random: SplitMix64,
    before: Option<Pose>,
    intensities: Option<Intensities>,
}

/// Simulates intensities.
struct Intensities {
    noise: f64,
    /// Separate, so that ranges are the same with and without intensities.
    random: SplitMix64,
}

/// A simulated pixel: its range, and the fraction that comes from its neighbour.
#[derive(Clone, Copy)]
struct MeasuredPixel {
    range: f32,
    mixed: f64,
}

impl Simulator {
    /// Makes a simulator; the same seed gives the same frames.
    ///
    /// # Errors
    /// [`presight_model::ErrorKind::Usage`] for fractions outside 0..=1, and for slips that are negative or not finite.
    pub fn new(predictor: Predictor, sensor: Sensor, disturbances: Disturbances, seed: u64) -> Result<Self> {
        let d = &disturbances;
        let shares = [("drop_outs", d.drop_outs), ("mixed_pixels", d.mixed_pixels)];
        if let Some((name, share)) = shares.into_iter().find(|(_, s)| !(0.0..=1.0).contains(s)) {
            return Err(Error::usage(format!("{name} of {share}"), "give a fraction of 0 to 1"));
        }
        if ![d.slip, d.turn_slip].iter().all(|s| *s >= 0.0 && s.is_finite()) {
            return Err(Error::usage(
                format!("slips of {} and {}", d.slip, d.turn_slip),
                "give finite fractions of at least 0",
            ));
        }
        let random = SplitMix64(seed);
        Ok(Self { predictor, sensor, disturbances, random, before: None, intensities: None })
    }

    /// Adds intensities to the ranges: the echo ([`Output::Echo`]) with noise of this standard deviation, 0 to 1. They
    /// saturate at 1. A pixel that mixes two surfaces mixes their echoes.
    ///
    /// # Errors
    /// [`presight_model::ErrorKind::Usage`] for a noise outside of 0 to 1.
    pub fn with_intensities(self, noise: f64) -> Result<Self> {
        if !(0.0..=1.0).contains(&noise) {
            return Err(Error::usage(format!("noise of intensities of {noise}"), "give 0 to 1"));
        }
        let random = SplitMix64(self.random.0 ^ 0x6563_686f);
        Ok(Self { intensities: Some(Intensities { noise, random }), ..self })
    }

    /// The measurement with the robot at a pose, and the odometry since the previous frame.
    ///
    /// # Errors
    /// Errors of [`Predictor::predict_images`], and a stamp that is not finite.
    pub fn frame(&mut self, world: &World, stamp: f64, robot: &RobotPose) -> Result<Frame> {
        self.frame_in_motion(world, stamp, robot, None)
    }

    /// As [`Simulator::frame`], of a robot that moves while the sensor measures its rays: `motion` is relative to its pose
    /// at the stamp. `None` if it stands. The frame does not contain the motion, like the logs of robots.
    ///
    /// # Errors
    /// Errors of [`Simulator::frame`]; [`presight_model::ErrorKind::Invalid`] if the motion does not reach over the scan.
    pub fn frame_in_motion(
        &mut self,
        world: &World,
        stamp: f64,
        robot: &RobotPose,
        motion: Option<&ScanMotion>,
    ) -> Result<Frame> {
        let asked = [Output::Range, Output::CosIncidence, Output::Echo];
        let outputs = Outputs::of(&asked[..if self.intensities.is_some() { 3 } else { 2 }]);
        let mut request = Request::of(outputs);
        request.motion = motion.cloned();
        let seen = self.predictor.predict(world, &self.sensor, &robot.sensor(&self.sensor), &request)?.images;
        let pixels = self.measure(&seen.range, &seen.cos_incidence);
        let ranges = pixels.iter().map(|p| p.range).collect();
        let mut frame = Frame::new(stamp, self.sensor.clone(), Measurement::Range(ranges))?;
        if let Some(intensities) = &mut self.intensities {
            let values = intensities.measure(&seen.echo, &pixels);
            frame = frame.with_intensities(GreyImage::new(self.sensor.width(), self.sensor.height(), values)?)?;
        }
        let now = robot.world_from_robot();
        frame.motion = self.before.replace(now).map(|before| self.odometry(&before, &now));
        Ok(frame)
    }

    fn measure(&mut self, range: &[f32], cos_incidence: &[f32]) -> Vec<MeasuredPixel> {
        let spec = self.sensor.spec().clone();
        let noise = RangeNoise::of(&self.sensor);
        let width = self.sensor.width() as usize;
        let mut measured = Vec::with_capacity(range.len());
        for (i, r) in range.iter().enumerate() {
            // Every pixel draws the same random numbers, so a change of the world affects only the pixels that see it.
            let (along, across) = (self.random.normal(1.0), self.random.normal(1.0));
            let (lost, mixed, between) = (self.random.unit(), self.random.unit(), self.random.unit());
            if !r.is_finite() {
                measured.push(MeasuredPixel { range: *r, mixed: 0.0 });
                continue;
            }
            let (mut z, mut of_next) = (f64::from(*r), 0.0);
            let neighbour = if (i + 1) % width != 0 { range.get(i + 1).copied().map(f64::from) } else { None };
            if let Some(next) = neighbour.filter(|n| n.is_finite() && (n - z).abs() > JUMP * z)
                && mixed < self.disturbances.mixed_pixels
            {
                z += between * (next - z);
                of_next = between;
            }
            let cos = f64::from(cos_incidence[i]).clamp(0.05, 1.0);
            let slant = (1.0 - cos * cos).sqrt() / cos;
            z += noise.range_sigma(z) * along + z * noise.angle * slant * across;
            let range = if lost < self.disturbances.drop_outs {
                f32::NAN
            } else if z < spec.range_min {
                f32::NEG_INFINITY
            } else if z > spec.range_max {
                f32::INFINITY
            } else {
                z as f32
            };
            measured.push(MeasuredPixel { range, mixed: of_next });
        }
        measured
    }

    fn odometry(&mut self, before: &Pose, now: &Pose) -> Motion {
        let truth = before.inverse() * *now;
        let way = truth.translation.length();
        let turned = truth.rotation.angle_between(glam::DQuat::IDENTITY);
        // Never zero: a standing robot may have been pushed.
        let t = self.disturbances.slip * way + 1e-4;
        let r = self.disturbances.turn_slip * (turned + way) + 1e-4;
        let error: [f64; 6] = std::array::from_fn(|i| if i < 3 { t } else { r } * self.random.normal(1.0));
        let covariance = PoseCovariance::from_sigmas([t, t, t, r, r, r]);
        Motion { previous_from_current: moved(&truth, &error), covariance }
    }
}

impl Intensities {
    /// NaN where no range was measured.
    fn measure(&mut self, echo: &[f32], pixels: &[MeasuredPixel]) -> Vec<f32> {
        let value = |(i, pixel): (usize, &MeasuredPixel)| {
            let noise = self.noise * self.random.normal(1.0);
            let own = f64::from(echo[i]);
            let next = echo.get(i + 1).map_or(own, |e| f64::from(*e));
            let value = if pixel.mixed > 0.0 { own + pixel.mixed * (next - own) } else { own };
            if pixel.range.is_finite() { (value + noise).clamp(0.0, 1.0) as f32 } else { f32::NAN }
        };
        pixels.iter().enumerate().map(value).collect()
    }
}
