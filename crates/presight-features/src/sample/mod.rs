//! Samples features along their image.
//!
//! A segment's image is cut into pieces of at most half a pixel, or finer if requested, with a sample in the middle of
//! each. A pinhole camera images straight lines as straight lines: the segment is clipped in closed form, and its image
//! cut into equal pieces. For all other sensors (lens distortion, scanners, ray tables) the arc of directions between
//! the ends is halved until its image is short enough. This follows curved images, also over the seam and the poles.
//!
//! A scanner of one row sees a cone of directions, or with the height of its beam a layer between two cones. It sees
//! only the parts of segments and patches inside the cone or layer.

mod arc;
mod patch;
mod patch_columns;
mod patch_cone;
mod row;
mod run;
mod straight;

pub(super) use patch_columns::{Column, PatchColumns};
pub(super) use patch_cone::{PatchCone, PatchOutline};
pub(super) use run::{Part, Run};

use super::Reason;
use glam::{DVec2, DVec3};
use presight_model::sensor::{Angles, Camera, Geometry, Scanner, Sensor};
use std::sync::OnceLock;

/// Default length of the longest piece of an image per sample, pixels.
pub const STEP: f64 = 0.5;
/// Maximum number of samples of one segment.
pub const MAX_SEGMENT_SAMPLES: usize = 1 << 17;
/// Maximum number of samples of one patch at the default step: larger patches have wider steps, unless images decide
/// them pixel by pixel. Finer steps allow up to 64 times this number.
pub const MAX_PATCH_SAMPLES: usize = 1 << 12;

/// Tolerance for directions on the cone of a row without height, radians.
const ON_CONE: f64 = 1e-9;

/// A small part of a feature's image.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sample {
    /// Interval of the feature's length in space; its ends are equal where a cut leaves a point.
    pub t: [f64; 2],
    /// Its middle, image frame, metres.
    pub at: DVec3,
    /// Pixel coordinates of the middle.
    pub pixel: DVec2,
    /// Pixel coordinates of both ends.
    pub ends: [DVec2; 2],
    /// Length in the image in pixels, or area for patches; 0 for points.
    pub weight: f64,
}

/// A part of a feature, inside or outside the image.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Piece {
    /// In the image.
    Inside(Sample),
    /// Not in the image, or behind the sensor.
    Outside {
        /// Interval of the feature's length.
        t: [f64; 2],
        /// The reason.
        reason: Reason,
    },
}

/// Samples features for one sensor.
#[derive(Debug)]
pub struct Sampler<'a> {
    sensor: &'a Sensor,
    pinhole: Option<&'a Camera>,
    size: DVec2,
    turn: Option<f64>,
    /// Maximum length of an image piece per sample, pixels.
    step: f64,
    /// Approximate finest angle between neighbouring rays, radians.
    pixel_angle: f64,
    /// Range of elevations of a single row, radians.
    cone: Option<[f64; 2]>,
    /// Elevations of rows and half the height of the beam, degrees, if the beams of neighbouring rows leave gaps.
    beams: Option<(Vec<f64>, f64)>,
    /// Places along the border of the image and their rays, computed when first used.
    border: OnceLock<Vec<(DVec2, DVec3)>>,
}

impl<'a> Sampler<'a> {
    /// Samples every [`STEP`].
    pub fn new(sensor: &'a Sensor) -> Self {
        Self::with_step(sensor, STEP)
    }

    /// Samples every `step` pixels, which must be positive.
    pub(super) fn with_step(sensor: &'a Sensor, step: f64) -> Self {
        let (mut pinhole, mut cone, mut beams) = (None, None, None);
        match &sensor.spec().geometry {
            Geometry::Camera(c) if c.distortion.is_none() => pinhole = Some(c),
            Geometry::Scanner(s) if s.elevation.len() == 1 => {
                let half = 0.5 * s.beam_height_deg.unwrap_or(0.0);
                let row = s.elevation.degrees(0);
                cone = Some([row - half, row + half].map(|e| e.clamp(-90.0, 90.0).to_radians()));
            }
            Geometry::Scanner(s) => beams = s.beam_height_deg.map(|h| (s.rows_deg(), 0.5 * h)),
            _ => {}
        }
        let turn = sensor.columns_of_a_turn();
        Self {
            sensor,
            pinhole,
            size: DVec2::new(f64::from(sensor.width()), f64::from(sensor.height())),
            turn,
            step,
            pixel_angle: pixel_angle(sensor),
            cone,
            beams,
            border: OnceLock::new(),
        }
    }

    /// The columns of a full turn, if the last column is next to the first.
    pub fn turn(&self) -> Option<f64> {
        self.turn
    }

    /// Returns true for a scanner of one row, which sees only cuts.
    pub(super) fn is_one_row(&self) -> bool {
        self.cone.is_some()
    }

    /// Approximate finest angle between neighbouring rays, radians.
    pub(super) fn pixel_angle(&self) -> f64 {
        self.pixel_angle
    }

    /// Column and row of the pixel nearest to a place in the image; columns beyond the seam continue on the other side.
    pub(super) fn nearest_pixel(&self, place: DVec2) -> (i64, i64) {
        let columns = f64::from(self.sensor.distinct_columns());
        let x = match self.turn {
            Some(turn) if !(place.x >= -0.5 && place.x < columns - 0.5) => (place.x + 0.5).rem_euclid(turn) - 0.5,
            _ => place.x,
        };
        let nearest = |x: f64, n: f64| ((x + 0.5) as i64).min(n as i64 - 1);
        (nearest(x, columns), nearest(place.y, self.size.y))
    }

    /// Samples a point of the image frame.
    pub fn point(&self, at: DVec3) -> Piece {
        let t = [0.0, 1.0];
        match self.project(at).filter(|pixel| self.holds(at, *pixel)) {
            Some(pixel) => Piece::Inside(Sample { t, at, pixel, ends: [pixel, pixel], weight: 0.0 }),
            None => self.outside(at, t),
        }
    }

    /// Samples a segment between two points of the image frame; visits pieces that cover 0..=1 in order.
    pub fn segment(&self, a: DVec3, b: DVec3, visit: &mut impl FnMut(Piece)) {
        self.parts(a, b, &mut |part| part.pieces(visit));
    }

    /// Visits the parts of a segment between two points of the image frame; they cover 0..=1 in order.
    pub(super) fn parts(&self, a: DVec3, b: DVec3, visit: &mut impl FnMut(Part)) {
        match (self.pinhole, self.cone) {
            (Some(camera), _) => self.straight(camera, a, b, visit),
            (None, Some(cone)) => self.cut(cone, a, b, visit),
            (None, None) => self.arc(a, b, [0.0, 1.0], visit),
        }
    }

    fn project(&self, p: DVec3) -> Option<DVec2> {
        self.sensor.project(p).map(DVec2::from)
    }

    /// Returns true if a point, imaged at `pixel`, is in the image.
    fn holds(&self, at: DVec3, pixel: DVec2) -> bool {
        let within = |x: f64, n: f64| x >= -0.5 && x <= n - 0.5;
        let inside = (self.turn.is_some() || within(pixel.x, self.size.x)) && within(pixel.y, self.size.y);
        let elevation = || at.z.atan2(at.x.hypot(at.y));
        if let Some([low, high]) = self.cone {
            return (self.turn.is_some() || within(pixel.x, self.size.x))
                && (low - ON_CONE..=high + ON_CONE).contains(&elevation());
        }
        let in_beam = |(rows, half): &(Vec<f64>, f64)| {
            let row = (pixel.y.round().max(0.0) as usize).min(rows.len() - 1);
            (elevation().to_degrees() - rows[row]).abs() <= *half
        };
        inside && self.beams.as_ref().is_none_or(in_beam)
    }

    fn outside(&self, at: DVec3, t: [f64; 2]) -> Piece {
        let behind = self.sensor.is_camera() && at.z <= 0.0 && self.sensor.project(at).is_none();
        Piece::Outside { t, reason: if behind { Reason::BehindSensor } else { Reason::OutsideImage } }
    }
}

fn pixel_angle(sensor: &Sensor) -> f64 {
    let mean = |angles: &Angles| {
        let n = angles.len();
        if n < 2 { f64::INFINITY } else { ((angles.degrees(n - 1) - angles.degrees(0)) / (n - 1) as f64).abs() }
    };
    if let Geometry::Scanner(Scanner { azimuth, elevation, .. }) = &sensor.spec().geometry {
        let finest = mean(azimuth).min(mean(elevation));
        return if finest.is_finite() && finest > 0.0 { finest.to_radians() } else { 1f64.to_radians() };
    }
    let (w, h) = (sensor.width(), sensor.height());
    let mut finest = f64::INFINITY;
    for i in 0..16 {
        for j in 0..16 {
            let (c, r) = (i * w / 16, j * h / 16);
            let Some(ray) = sensor.ray(c, r) else { continue };
            for other in [(c + 1, r), (c, r + 1)].into_iter().filter_map(|(c, r)| sensor.ray(c, r)) {
                let angle = ray.angle_between(other);
                if angle > 1e-9 {
                    finest = finest.min(angle);
                }
            }
        }
    }
    if finest.is_finite() { finest } else { 1f64.to_radians() }
}
