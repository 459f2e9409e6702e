//! Scans of a lidar that turns while the robot drives, cast by another library, each with the scan of a robot that
//! stands at its stamp.

use glam::{DQuat, DVec3};
use presight_model::environment::Environment;
use presight_model::geometry::{Pose, RobotPose, SensorPose};
use presight_model::measured::{Frame, Measurement, ScanMotion};
use presight_model::sensor::{Angles, Geometry, Noise, RayTimes, Scanner, Sensor, SensorSpec, StampAt};
use presight_testkit::caster::Caster;
use presight_testkit::oracle::Oracle;
use presight_testkit::route::{Driving, Route};

/// Seconds of a turn.
const TURN_S: f64 = 0.1;
/// Seconds between scans: 0.6 m and 0.4 rad.
const EVERY_S: f64 = 0.4;
/// The robot drives evenly from here on, seconds.
const START_S: f64 = 2.0;

/// A scan of a driving robot.
pub struct Scan {
    /// The robot's pose at the stamp.
    pub pose: Pose,
    /// The scan, without its motion.
    driving: Frame,
    /// A scan at the pose of the stamp.
    pub standing: Frame,
    /// A scan of a robot that stands where the driving one is in the middle of its scan.
    pub in_the_middle: (Frame, Pose),
    /// The same place with other noise.
    pub in_the_middle_again: (Frame, Pose),
    /// Poses during the scan by seconds after the stamp, world.
    path: Vec<(f64, Pose)>,
}

/// The motion that a frame reports.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Told {
    /// The truth.
    Truth,
    /// Odometry that measures 2 % too long a distance and 2 % too wide a turn.
    Slipping,
    Nothing,
    /// Velocity along the axes of the world instead of the robot's.
    WorldAxes,
    /// The last column first.
    TurnExchanged,
    /// Times before the stamp instead of after it.
    FromLastRay,
}

impl Told {
    /// Faults that must be found.
    pub const PLANTED: [Self; 4] = [Self::Nothing, Self::WorldAxes, Self::TurnExchanged, Self::FromLastRay];
}

impl Scan {
    /// The scan of the driving robot.
    pub fn told(&self, told: Told) -> Frame {
        let frame = |times: RayTimes| {
            let spec = self.driving.sensor().spec().clone().with_times(times);
            let ranges = Measurement::Range(self.driving.ranges().to_vec());
            Frame::new(self.driving.stamp, Sensor::new(spec).expect("a sensor"), ranges).expect("a frame")
        };
        let from = |relative: &dyn Fn(&Pose) -> Pose| {
            ScanMotion::path(self.path.iter().map(|(t, pose)| (*t, relative(pose))).collect()).expect("a path")
        };
        let own = from(&|pose| self.pose.inverse() * *pose);
        match told {
            Told::Truth => self.driving.clone().with_scan_motion(own),
            Told::Slipping => self.driving.clone().with_scan_motion(from(&|pose| {
                let moved = self.pose.inverse() * *pose;
                let rotation = DQuat::from_scaled_axis(1.02 * moved.rotation.to_scaled_axis());
                Pose { translation: 1.02 * moved.translation, rotation }
            })),
            Told::Nothing => self.driving.clone(),
            Told::WorldAxes => self.driving.clone().with_scan_motion(from(&|pose| Pose {
                translation: pose.translation - self.pose.translation,
                ..self.pose.inverse() * *pose
            })),
            Told::TurnExchanged => frame(RayTimes::turning(-TURN_S, StampAt::First)).with_scan_motion(own),
            Told::FromLastRay => frame(RayTimes::turning(TURN_S, StampAt::Last)).with_scan_motion(own),
        }
    }
}

/// A lidar on the robot with a full turn of columns and 40 degrees of rows.
pub fn lidar(columns: u32, rows: u32) -> Sensor {
    let azimuth = Angles::Uniform { start_deg: -180.0, step_deg: 360.0 / f64::from(columns), count: columns };
    let elevation = |r: u32| 20.0 - 40.0 * f64::from(r) / f64::from(rows.max(2) - 1);
    let elevation = Angles::Listed((0..rows).map(elevation).collect());
    let scanner = Geometry::Scanner(Scanner { azimuth, elevation, beam_height_deg: None });
    let spec = SensorSpec::new("lidar", "laser", scanner)
        .with_limits(0.3, 30.0)
        .with_mount(Pose::from_xyz_rpy(DVec3::new(0.1, 0.0, 0.8), 0.0, 0.0, 0.0))
        .with_noise(Noise { range_sigma: 0.005, ..Noise::default() })
        .with_times(RayTimes::turning(TURN_S, StampAt::First));
    Sensor::new(spec).expect("a sensor")
}

/// Scans of a drive, and poses of the sensor between them, at which the explored model is judged. All have the noise of the
/// sensor; `disturbed` ones also have drop-outs and mixed pixels at jumps, which differ from scan to scan.
pub fn drive(
    environment: &Environment,
    sensor: &Sensor,
    count: usize,
    (seed, disturbed): (u64, bool),
) -> (Vec<Scan>, Vec<Pose>) {
    let bounds = environment.bounds();
    let oracle = Oracle::new(environment, 0.5 * (bounds.min + bounds.max)).expect("surfaces");
    let driving = Driving { seconds: START_S + EVERY_S * (count + 1) as f64, speed: 1.5, turn: 1.0 };
    let route = Route::wander(&oracle, &bounds, &driving, seed);
    let mut caster = Caster::new(environment, sensor.clone(), seed);
    caster.slip = None;
    if !disturbed {
        (caster.drop_outs, caster.mixed) = (0.0, 0.0);
    }
    let scan = |k: usize| {
        let stamp = START_S + EVERY_S * k as f64;
        let pose = route.at(stamp);
        caster.times = RayTimes::turning(TURN_S, StampAt::First);
        let driving = caster.frame(&|t| route.at(t), stamp, None);
        caster.times = RayTimes::AtOnce;
        let standing = caster.frame(&|_| pose, stamp, None);
        let middle = route.at(stamp + 0.5 * TURN_S);
        let [in_the_middle, in_the_middle_again] = [(); 2].map(|()| (caster.frame(&|_| middle, stamp, None), middle));
        let path = (-12..=12).map(|i| 0.01 * f64::from(i)).map(|t| (t, route.at(stamp + t))).collect();
        Scan { pose, driving, standing, in_the_middle, in_the_middle_again, path }
    };
    let between = |k: usize| route.at(START_S + EVERY_S * (k as f64 + 0.5)) * sensor.spec().mount;
    ((0..count).map(scan).collect(), (0..count).map(between).collect())
}

/// The sensor's pose for a pose of the robot.
pub fn sensor_pose(sensor: &Sensor, robot: &Pose) -> SensorPose {
    RobotPose::new(*robot).sensor(sensor)
}
