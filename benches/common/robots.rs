//! Sensors of few rays and of free ray tables, as robots carry them.

use glam::DVec3;
use presight_model::sensor::{Angles, Geometry, RayTable, Scanner, Sensor, SensorSpec};
use presight_read::preset;
use std::f64::consts::TAU;

/// Each with the degrees by which the robot leans.
pub fn sensors() -> Vec<(Sensor, f64)> {
    let of = |name: &str| preset(name).expect("a preset");
    let named =
        |sensor: &Sensor, name: &str| Sensor::new(sensor.spec().clone().with_name(name)).expect("a valid sensor");
    let (scanner, radar) = (of("laser-scanner"), of("microwave-radar-scan"));
    vec![
        (scanner.clone(), 0.0),
        (named(&scanner, "laser-scanner leaning"), 3.0),
        (row("scanner 270", -135.0, 0.25, 1081), 0.0),
        (named(&radar, "3600 level"), 0.0),
        (named(&radar, "3600 leaning"), 3.0),
        (of("vlp-16"), 0.0),
        (of("os1-128"), 0.0),
        (rosette(), 0.0),
        (offset_rows(), 0.0),
    ]
}

fn row(name: &str, start_deg: f64, step_deg: f64, count: u32) -> Sensor {
    let azimuth = Angles::Uniform { start_deg, step_deg, count };
    let elevation = Angles::Uniform { start_deg: 0.0, step_deg: 0.0, count: 1 };
    let geometry = Geometry::Scanner(Scanner { azimuth, elevation, beam_height_deg: None });
    Sensor::new(SensorSpec::new(name, "laser", geometry).with_limits(0.0, 30.0)).expect("a valid scanner")
}

/// 0.24 s of a rosette of two prisms that turn at 7,294 and -4,664 rpm, as a Livox Mid-40 has them: a circle of 38.4 degrees,
/// 24,000 rays in the order of time.
fn rosette() -> Sensor {
    let half = 9.6f64.to_radians();
    let ray = |i: u32| {
        let t = TAU * f64::from(i) / 100_000.0 / 60.0;
        let (one, two) = (7294.0 * t, -4664.0 * t);
        let (y, z) = (half * (one.cos() + two.cos()), half * (one.sin() + two.sin()));
        let off = y.hypot(z);
        DVec3::new(off.cos(), y * sinc(off), z * sinc(off))
    };
    table("rosette", 240, 100, 260.0, ray)
}

fn sinc(x: f64) -> f64 {
    if x == 0.0 { 1.0 } else { x.sin() / x }
}

/// A spinning lidar whose rows are turned against each other, in groups of four.
fn offset_rows() -> Sensor {
    let ray = |i: u32| {
        let (column, row) = (i % 1024, i / 1024);
        let offset = [3.0, 1.0, -1.0, -3.0][row as usize % 4];
        let azimuth = (360.0 * f64::from(column) / 1024.0 - 180.0 + offset).to_radians();
        let elevation = (22.5 - 45.0 * f64::from(row) / 127.0).to_radians();
        DVec3::new(elevation.cos() * azimuth.cos(), elevation.cos() * azimuth.sin(), elevation.sin())
    };
    table("offset rows", 1024, 128, 120.0, ray)
}

fn table(name: &str, width: u32, height: u32, range_max: f64, ray: impl Fn(u32) -> DVec3) -> Sensor {
    let table = RayTable::new(width, height, (0..width * height).map(ray).collect()).expect("sound rays");
    let spec = SensorSpec::new(name, "laser", Geometry::Rays(table)).with_limits(0.0, range_max);
    Sensor::new(spec).expect("a valid table")
}
