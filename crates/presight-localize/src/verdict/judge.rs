//! Judges each pixel.

use super::expected::{ExpectedImage, TASK, body_from_image};
use super::pixel::ExpectedPixel;
use super::surfaces::ObjectError;
use glam::DVec3;
use presight_model::geometry::{Pose, PoseEstimate};
use presight_model::matrix::{quadratic, sandwich, turn};
use presight_model::measured::{Frame, RangeNoise};
use presight_model::sensor::Sensor;
use presight_model::statistics::NOISE_BOUND;
use presight_model::threads::parallel_or_here;
use rayon::prelude::*;

presight_model::words! {
    /// The result of comparing a measured pixel with its prediction.
    #[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
    pub enum Verdict {
        /// The measurement agrees with the predicted surface.
        Confirmed = "confirmed",
        /// An unknown object is in front of the predicted surface.
        Nearer = "nearer",
        /// The ray passed through the predicted surface.
        Farther = "farther",
        /// A surface was predicted, but the pixel has no measurement.
        NoReturn = "no_return",
        /// Neither the prediction nor the measurement has a surface within the sensor's range.
        Beyond = "beyond",
        /// An edge, or another surface within the uncertainty of the pixel, explains the measurement as well.
        Undecidable = "undecidable",
        /// There is no prediction to compare with the measurement.
        NotPredicted = "not_predicted",
    }
}

impl Verdict {
    /// Its colour in pictures, sRGB: muted for confirmed pixels, and distinguishable with red-green colour blindness.
    pub fn color(self) -> [u8; 3] {
        match self {
            Self::Confirmed => [0x2f, 0x6f, 0x5e],
            Self::Nearer => [0xff, 0x8c, 0x42],
            Self::Farther => [0x56, 0xb4, 0xe9],
            Self::NoReturn => [0x0b, 0x0c, 0x0f],
            Self::Beyond => [0x26, 0x2a, 0x33],
            Self::Undecidable => [0x8a, 0x90, 0x9c],
            Self::NotPredicted => [0xcc, 0x79, 0xa7],
        }
    }
}

/// The verdicts of an image.
#[derive(Clone, Debug, PartialEq)]
pub struct Verdicts {
    /// Columns.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// Row by row.
    pub pixels: Vec<Verdict>,
    /// Measured less predicted range, metres; NaN where one of both is missing.
    pub difference: Vec<f32>,
}

impl Verdicts {
    /// Pixels of each verdict, in the order of [`Verdict::ALL`].
    pub fn counts(&self) -> [usize; 7] {
        let mut counts = [0; 7];
        self.pixels.iter().for_each(|v| counts[*v as usize] += 1);
        counts
    }

    /// Share of the pixels that have this verdict; 0 for an image without pixels.
    pub fn share(&self, verdict: Verdict) -> f64 {
        self.counts()[verdict as usize] as f64 / self.pixels.len().max(1) as f64
    }
}

/// Maximum half width of the window around a pixel, pixels; bounds the time for an uncertain pose.
const WIDEST: i64 = 16;
/// Compares a frame with its prediction; see [`super::of_frame`]. The pose may differ slightly from the predicted one,
/// because ranges are computed on the predicted planes.
///
/// # Panics
/// If the expected image is of another sensor.
pub fn judge(frame: &Frame, expected: &ExpectedImage, robot: &PoseEstimate, polygon_sigma: f64) -> Verdicts {
    let sensor = frame.sensor();
    let (width, height) = (sensor.width() as usize, sensor.height() as usize);
    assert_eq!((width, height), (expected.width, expected.height), "the frame's own sensor is predicted");
    let judge = parallel_or_here(|| PixelJudge::new(expected, sensor, robot, polygon_sigma));
    let limits = (sensor.spec().range_min, sensor.spec().range_max);
    let one = |i: usize| {
        let z = f64::from(frame.ranges()[i]);
        let (verdict, predicted) = judge.pixel(i % width, i / width, as_measured(z, limits), limits);
        let difference = (z - predicted) as f32;
        (verdict, if difference.is_finite() { difference } else { f32::NAN })
    };
    let (mut pixels, mut difference) = (Vec::new(), Vec::new());
    let all = (0..width * height).into_par_iter().with_min_len(TASK);
    parallel_or_here(|| all.map(one).unzip_into_vecs(&mut pixels, &mut difference));
    Verdicts { width: width as u32, height: height as u32, pixels, difference }
}

/// A range outside the limits becomes an infinity, as in REP-117.
fn as_measured(z: f64, (min, max): (f64, f64)) -> f64 {
    if z < min {
        f64::NEG_INFINITY
    } else if z > max {
        f64::INFINITY
    } else {
        z
    }
}

struct PixelJudge<'a> {
    expected: &'a ExpectedImage,
    noise: RangeNoise,
    /// Rotation of rays and position of the sensor, in the expected image's frame.
    expected_from_now: Pose,
    /// Variance of each pixel's polygon along its normal, from the robot's pose and from the object's; square metres.
    off: Vec<f64>,
    /// Standard deviations of the robot's pose over all axes together, metres and radians.
    translation: f64,
    rotation: f64,
}

/// The predicted ranges in the window around a pixel.
struct PixelWindow {
    nearest: f64,
    farthest: f64,
    /// True if a pixel of the window has no prediction.
    open: bool,
}

impl<'a> PixelJudge<'a> {
    fn new(expected: &'a ExpectedImage, sensor: &Sensor, known: &PoseEstimate, polygon_sigma: f64) -> Self {
        let PoseEstimate { world_from_robot, covariance: in_world } = known;
        let mount = sensor.spec().mount;
        let expected_from_world = expected.world_from_image.inverse();
        let expected_from_now = expected_from_world * *world_from_robot * mount * body_from_image(&expected.sensor);
        let covariance = sandwich(&turn(expected_from_world.rotation), in_world.as_rows());
        let robot = expected_from_world.transform_point(world_from_robot.translation);
        let off = |pixel: &ExpectedPixel| {
            let (point, normal) = (pixel.point.as_dvec3(), pixel.normal.as_dvec3());
            let by_pose = quadratic(&covariance, &ObjectError::gradient(robot, point, normal)).max(0.0);
            let by_object = expected.errors.get(&pixel.object).map_or(0.0, |error| {
                let world = &expected.world_from_image;
                let (point, normal) = (world.transform_point(point), world.rotation * normal);
                quadratic(&error.covariance, &ObjectError::gradient(error.origin, point, normal)).max(0.0)
            });
            by_pose + by_object + polygon_sigma.powi(2)
        };
        let largest = |from: usize| (from..from + 3).map(|i| in_world[i][i]).sum::<f64>().max(0.0).sqrt();
        Self {
            expected,
            noise: RangeNoise::of(sensor),
            expected_from_now,
            off: expected.pixels.par_iter().with_min_len(TASK).map(off).collect(),
            translation: largest(0),
            rotation: largest(3),
        }
    }

    /// Predicted range on the plane of a pixel along a ray, and its standard deviation; `None` without a prediction.
    fn on_plane(&self, at: usize, ray: DVec3, measured: f64) -> Option<(f64, f64)> {
        let pixel = &self.expected.pixels[at];
        if !pixel.range.is_finite() {
            return None;
        }
        let normal = pixel.normal.as_dvec3();
        let centre = self.expected_from_now.translation;
        let slope = normal.dot(ray);
        let range = (f64::from(pixel.offset) - normal.dot(centre)) / slope;
        // If the plane is edge-on or behind the ray, only the pixel's own range is left.
        let range = if range > 0.0 && slope.abs() > 1e-3 { range } else { f64::from(pixel.range) };
        let cos = slope.abs().max(1e-3);
        let off = self.off[at];
        let z = if measured.is_finite() { measured } else { range };
        let along = self.noise.range_sigma(z);
        let across = z * self.noise.angle * (1.0 - cos * cos).max(0.0).sqrt() / cos;
        Some((range, (along * along + across * across + off / (cos * cos)).sqrt()))
    }

    fn window(&self, column: usize, row: usize, ray: DVec3, z: f64) -> PixelWindow {
        let e = self.expected;
        let at = row * e.width + column;
        let range = if z.is_finite() { z } else { f64::from(e.pixels[at].range) };
        let range = if range.is_finite() { range.max(0.1) } else { 1.0 };
        let angle = NOISE_BOUND * (self.rotation + self.translation / range + self.noise.angle);
        // Half a pixel is added because a polygon's edge may be anywhere between two rays.
        let half = |spacing: f64| ((angle / spacing + 0.5).ceil() as i64).clamp(i64::from(spacing.is_finite()), WIDEST);
        let (hu, hv) = (half(e.spacing.0), half(e.spacing.1));
        let (hu, hv) = (hu.min(e.width as i64 - 1), hv.min(e.height as i64 - 1));
        let mut window = PixelWindow { nearest: f64::INFINITY, farthest: f64::NEG_INFINITY, open: false };
        for v in row as i64 - hv..=row as i64 + hv {
            for u in column as i64 - hu..=column as i64 + hu {
                if u < 0 || v < 0 || u >= e.width as i64 || v >= e.height as i64 {
                    continue;
                }
                let j = v as usize * e.width + u as usize;
                // A neighbour contributes its own range and the range at which this ray would meet its plane.
                let Some((on_plane, sigma)) = self.on_plane(j, ray, z) else {
                    window.open = true;
                    continue;
                };
                let own = f64::from(e.pixels[j].range);
                let (low, high) = if j == at { (on_plane, on_plane) } else { (own.min(on_plane), own) };
                window.nearest = window.nearest.min(low - NOISE_BOUND * sigma);
                window.farthest = window.farthest.max(high + NOISE_BOUND * sigma);
            }
        }
        window
    }

    fn pixel(&self, column: usize, row: usize, z: f64, (min, max): (f64, f64)) -> (Verdict, f64) {
        let e = self.expected;
        let at = row * e.width + column;
        let Some(ray) = e.sensor.ray(column as u32, row as u32) else { return (Verdict::NotPredicted, f64::NAN) };
        let ray = self.expected_from_now.rotation * ray;
        let here = self.on_plane(at, ray, z);
        let predicted = here.map_or(f64::from(e.pixels[at].range), |(range, _)| range);
        if e.is_uncertain(at) {
            return (Verdict::Undecidable, predicted);
        }
        // The window includes this pixel, so a range that agrees with it is neither nearer nor farther than all of
        // them.
        if let Some((range, sigma)) = here
            && (z - range).abs() <= NOISE_BOUND * sigma
        {
            return (Verdict::Confirmed, predicted);
        }
        let window = self.window(column, row, ray, z);
        let empty = window.nearest == f64::INFINITY;
        let verdict = if z.is_nan() {
            if empty { Verdict::NotPredicted } else { Verdict::NoReturn }
        } else if z == f64::INFINITY {
            match (empty, window.open) {
                (true, _) => Verdict::Beyond,
                (false, false) if window.farthest < max => Verdict::Farther,
                _ => Verdict::Undecidable,
            }
        } else if z == f64::NEG_INFINITY {
            if e.pixels[at].range == f32::NEG_INFINITY {
                Verdict::Confirmed
            } else if window.nearest > min && !empty {
                Verdict::Nearer
            } else {
                Verdict::Undecidable
            }
        } else if empty {
            Verdict::NotPredicted
        } else if z < window.nearest {
            Verdict::Nearer
        } else if z > window.farthest && !window.open {
            Verdict::Farther
        } else {
            Verdict::Undecidable
        };
        (verdict, predicted)
    }
}
