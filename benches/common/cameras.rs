//! Cameras of 640 x 480 pixels with lenses, and free ray tables of the same size.

use glam::DVec3;
use presight_model::sensor::{Camera, Distortion, Geometry, RayTable, Sensor, SensorSpec};

pub const SIZE: (u32, u32) = (640, 480);

fn camera(name: &str, f: f64, distortion: Distortion) -> Sensor {
    let (width, height) = SIZE;
    let camera = Camera { distortion, ..Camera::pinhole(width, height, f, f, 319.5, 239.5) };
    Sensor::new(SensorSpec::new(name, "video", Geometry::Camera(camera))).expect("a valid camera")
}

/// An equidistant camera with this angle across the image's width. Pixels beyond that angle have rays, too.
fn fisheye(degrees: u32) -> Sensor {
    let f = f64::from(SIZE.0) / f64::from(degrees).to_radians();
    camera(&format!("fisheye {degrees}"), f, Distortion::Equidistant([-0.003, 0.0, 0.0, 0.0]))
}

fn table(name: &str, ray: impl Fn(u32, u32) -> DVec3) -> Sensor {
    let (width, height) = SIZE;
    let rays = (0..height).flat_map(|r| (0..width).map(move |c| (c, r))).map(|(c, r)| ray(c, r)).collect();
    let table = RayTable::new(width, height, rays).expect("sound rays");
    Sensor::new(SensorSpec::new(name, "video", Geometry::Rays(table))).expect("a valid table")
}

/// A pinhole camera first, then the sensors that are compared with it.
pub fn sensors() -> Vec<Sensor> {
    let pinhole = camera("pinhole", 525.0, Distortion::None);
    let listed = pinhole.clone();
    let same = move |c: u32, r: u32| listed.body_from_image() * listed.ray(c, r).expect("a ray a pixel");
    // A rotating head of staggered beams: -25 to 25 degrees all round, with every eleventh beam missing.
    let beams = |c: u32, r: u32| {
        let azimuth = std::f64::consts::TAU * (f64::from(c) + 0.25 * f64::from(r % 4)) / f64::from(SIZE.0);
        let elevation = (25.0 - 50.0 * f64::from(r) / f64::from(SIZE.1 - 1)).to_radians();
        let ray = DVec3::new(azimuth.cos() * elevation.cos(), azimuth.sin() * elevation.cos(), elevation.sin());
        if (c + 7 * r).is_multiple_of(11) { DVec3::NAN } else { ray }
    };
    let rational = [0.47, 0.13, 2e-4, -1e-4, 0.01, 0.55, 0.2, 0.03];
    vec![
        pinhole,
        camera("plumb-bob", 525.0, Distortion::PlumbBob([-0.25, 0.08, 3e-4, -2e-4, -0.01])),
        camera("rational", 525.0, Distortion::from_model("rational_polynomial", &rational).expect("8 coefficients")),
        fisheye(60),
        fisheye(120),
        fisheye(200),
        table("pinhole's rays", same),
        table("beams all round", beams),
    ]
}
