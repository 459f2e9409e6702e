//! Logs that are well formed and make no sense: each fault has a note, and sound logs have none.

use presight::files::{LogFrame, LogFrames, load_sensor, range_log_header, range_log_line, sensor_to_toml};
use presight::sensor::{Angles, Geometry, Scanner, SensorSpec};
use presight::{Pose, RobotPose};
use proptest::prelude::*;

const RANGE_MAX: f32 = 12.0;

/// A fault of a log.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Fault {
    /// This part of the rays without a detection is written as the maximum range.
    AtReach(f64),
    /// Odometry in millimetres.
    Odometry,
    /// Reference poses in millimetres.
    Reference,
    /// Times in milliseconds.
    Times,
}

fn spec() -> SensorSpec {
    let azimuth = Angles::Uniform { start_deg: -90.0, step_deg: 3.0, count: 61 };
    let elevation = Angles::Uniform { start_deg: 0.0, step_deg: 0.0, count: 1 };
    let scanner = Scanner { azimuth, elevation, beam_height_deg: None };
    SensorSpec::new("s", "laser", Geometry::Scanner(scanner)).with_limits(0.1, f64::from(RANGE_MAX))
}

/// The notices on a log of a robot that drives at a speed, metres per second, and sees walls at random ranges.
fn notices(speed: f64, ranges: &[f32], fault: Option<Fault>) -> Vec<String> {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.jsonl");
    let mut text = range_log_header(&spec());
    let at = |metres: f64| Pose::from_xyz_rpy(glam::DVec3::X * metres, 0.0, 0.0, 0.0);
    for (k, scan) in ranges.chunks_exact(61).enumerate() {
        let mut scan = scan.to_vec();
        if let Some(Fault::AtReach(part)) = fault {
            let count = (part * scan.len() as f64).round() as usize;
            scan[..count].fill(RANGE_MAX);
        }
        let unit = |fault_of| if fault == Some(fault_of) { 1000.0 } else { 1.0 };
        let time = k as f64 / 10.0 * unit(Fault::Times);
        let odometry = (k > 0).then(|| at(speed / 10.0 * unit(Fault::Odometry)));
        let reference = Some(RobotPose::new(at(speed * k as f64 / 10.0 * unit(Fault::Reference))));
        let frame = LogFrame { odometry, reference, ..LogFrame::new(time, scan) };
        text += &format!("\n{}", range_log_line(&frame).unwrap());
    }
    std::fs::write(&path, text).unwrap();
    let mut log = LogFrames::open(&path, None, &Default::default()).unwrap();
    log.by_ref().for_each(|frame| drop(frame.unwrap()));
    log.notices()
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(100))]

    /// By the figures of the notes: a robot at 0.2 m/s and more, at 10 frames a second.
    #[test]
    fn faults_are_noted_and_sound_logs_are_not(
        speed in 0.2..3f64,
        ranges in prop::collection::vec(0.2..RANGE_MAX - 0.01, 61 * 6),
        part in 0.2..1f64,
    ) {
        prop_assert_eq!(notices(speed, &ranges, None), Vec::<String>::new());
        for (fault, word) in [
            (Fault::AtReach(part), "exactly range_max, 12 m"),
            (Fault::Odometry, "the odometry moves at up to"),
            (Fault::Reference, "the reference moves at up to"),
            (Fault::Times, "milliseconds"),
        ] {
            let said = notices(speed, &ranges, Some(fault));
            prop_assert!(said.iter().any(|notice| notice.contains(word)), "{:?}: {:?}", fault, said);
        }
    }
}

/// A sensor file with angles in radians, and one whose mount is in millimetres.
#[test]
fn sensor_files_in_other_units_are_noted() {
    let folder = tempfile::tempdir().unwrap();
    let said = |spec: &SensorSpec| {
        let path = folder.path().join("s.toml");
        std::fs::write(&path, sensor_to_toml(spec)).unwrap();
        load_sensor(path.to_str().unwrap()).unwrap().1.join("\n")
    };
    let mount = |x: f64, yaw_deg: f64| Pose::from_xyz_rpy(glam::DVec3::X * x, 0.0, 0.0, yaw_deg.to_radians());
    assert_eq!(said(&spec().with_mount(mount(0.4, 90.0))), "");
    assert!(
        said(&spec().with_mount(mount(400.0, 0.0)))
            .contains("400 m from the origin of the robot: is it in millimetres?")
    );
    assert!(said(&spec().with_mount(mount(0.4, std::f64::consts::FRAC_PI_2))).contains("is 90 degrees in radians"));
}
