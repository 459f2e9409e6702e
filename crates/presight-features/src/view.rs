//! Quick test for boxes that may be in a sensor's image, including its border and the height of its beams.

use glam::DVec3;
use presight_model::sensor::{Camera, Geometry, PixelGrid, Scanner, Sensor, Sides};

/// Margin for rounding, radians.
const SLACK: f64 = 1e-9;

/// The directions and ranges in which a sensor sees features, slightly enlarged.
#[derive(Debug)]
pub(super) struct View {
    form: Form,
    range_max: f64,
}

#[derive(Debug)]
enum Form {
    /// Inward unit normals of planes through the sensor, and the angle outside them at which features may be visible.
    Planes(Vec<DVec3>, f64),
    Beams {
        /// Centre and half the width, radians; `None` for a full circle.
        azimuth: Option<[f64; 2]>,
        /// Minimum and maximum elevation, radians.
        elevation: [f64; 2],
        /// Tangents of the elevations, away from the poles.
        slopes: Option<[f64; 2]>,
    },
    Anywhere,
}

impl View {
    /// The view of a sensor, in its image frame.
    pub fn new(sensor: &Sensor) -> Self {
        let form = match (&sensor.spec().geometry, sensor.grid()) {
            (Geometry::Camera(camera), _) if camera.distortion.is_none() => Form::Planes(sides(camera), 0.0),
            (Geometry::Camera(_), PixelGrid::Rays(rays)) => match (rays.sides(), widest_step(sensor)) {
                (Sides::Within(normals), Some(step)) if !normals.is_empty() => Form::Planes(normals.clone(), step),
                _ => Form::Anywhere,
            },
            (Geometry::Scanner(scanner), _) => beams(sensor, scanner),
            _ => Form::Anywhere,
        };
        Self { form, range_max: sensor.spec().range_max }
    }

    /// Returns true if a box, given by its centre and half edges, may have a point in view.
    pub fn meets(&self, middle: DVec3, axes: &[DVec3; 3]) -> bool {
        let radius = axes.iter().map(|a| a.length_squared()).sum::<f64>().sqrt();
        middle.length() - radius <= self.range_max * (1.0 + SLACK) && self.meets_directions(middle, axes)
    }

    /// Returns true if a box may have a point in a visible direction, at any range.
    pub fn meets_directions(&self, middle: DVec3, axes: &[DVec3; 3]) -> bool {
        let radius = axes.iter().map(|a| a.length_squared()).sum::<f64>().sqrt();
        let range = middle.length();
        match &self.form {
            Form::Planes(normals, lean) => {
                let beyond = (lean + SLACK) * (range + radius);
                let reach = |n: &DVec3| axes.iter().map(|a| n.dot(*a).abs()).sum::<f64>();
                normals.iter().all(|n| n.dot(middle) + reach(n) >= -beyond)
            }
            Form::Beams { azimuth, elevation: [low, high], slopes } => {
                if range <= radius {
                    return true;
                }
                let flat = (middle.x * middle.x + middle.y * middle.y).sqrt();
                // A test without angles: the whole box is above or below the beams, at both its nearest and farthest
                // distance from the axis.
                if let Some(slopes) = slopes {
                    let up = axes.iter().map(|a| a.z.abs()).sum::<f64>() + SLACK * (range + radius);
                    let wide = axes.iter().map(|a| a.x.abs() + a.y.abs()).sum::<f64>().min(radius);
                    let rise = |slope: f64| [(flat - wide).max(0.0), flat + wide].map(|flat| slope * flat);
                    let ([low, high], z) = (slopes.map(rise), middle.z);
                    if z - up > high[0].max(high[1]) || z + up < low[0].min(low[1]) {
                        return false;
                    }
                }
                if azimuth.is_none() && slopes.is_some() {
                    return true;
                }
                let (up, off) = (middle.z.atan2(flat), (radius / range).asin() + SLACK);
                if up + off < *low || up - off > *high {
                    return false;
                }
                azimuth.is_none_or(|[heading, half]| {
                    let by = (middle.y.atan2(middle.x) - heading).rem_euclid(std::f64::consts::TAU);
                    let by = by.min(std::f64::consts::TAU - by);
                    flat <= radius || by <= half + (radius / flat).asin() + SLACK
                })
            }
            Form::Anywhere => true,
        }
    }
}

/// Planes for the sides of a pinhole image, and for the half space in front.
fn sides(camera: &Camera) -> Vec<DVec3> {
    let (low, high) = (
        camera.normalized(-0.5, -0.5),
        camera.normalized(f64::from(camera.width) - 0.5, f64::from(camera.height) - 0.5),
    );
    vec![
        DVec3::Z,
        DVec3::new(1.0, 0.0, -low.0).normalize(),
        DVec3::new(-1.0, 0.0, high.0).normalize(),
        DVec3::new(0.0, 1.0, -low.1).normalize(),
        DVec3::new(0.0, -1.0, high.1).normalize(),
    ]
}

/// Maximum angle between a ray at the border and the next one inward. The border itself is half that angle farther out.
fn widest_step(sensor: &Sensor) -> Option<f64> {
    const PLACES: u32 = 16;
    let (w, h) = (sensor.width(), sensor.height());
    let mut widest: f64 = 0.0;
    for i in 0..=PLACES {
        let (column, row) = ((w - 1) * i / PLACES, (h - 1) * i / PLACES);
        let inward = [
            ((column, 0), (column, 1.min(h - 1))),
            ((column, h - 1), (column, h.saturating_sub(2))),
            ((0, row), (1.min(w - 1), row)),
            ((w - 1, row), (w.saturating_sub(2), row)),
        ];
        for (at, next) in inward {
            let (a, b) = (sensor.ray(at.0, at.1)?, sensor.ray(next.0, next.1)?);
            widest = widest.max(a.angle_between(b));
        }
    }
    // A single row or column gives no step.
    (w > 1 && h > 1).then_some(widest)
}

fn beams(sensor: &Sensor, scanner: &Scanner) -> Form {
    let widest = |angles: &[f64]| angles.windows(2).map(|a| (a[1] - a[0]).abs()).fold(0.0, f64::max);
    let bounds = |angles: &[f64], by: f64| {
        let low = angles.iter().copied().fold(f64::INFINITY, f64::min) - by;
        [low, angles.iter().copied().fold(f64::NEG_INFINITY, f64::max) + by].map(f64::to_radians)
    };
    let rows = scanner.rows_deg();
    let elevation = bounds(&rows, widest(&rows).max(0.5 * scanner.beam_height_deg.unwrap_or(0.0)));
    // Near the poles the tangent is unusable.
    let slopes = elevation.iter().all(|e| e.abs() < 1.5).then(|| elevation.map(f64::tan));
    let columns: Vec<f64> = (0..scanner.azimuth.len()).map(|i| scanner.azimuth.degrees(i)).collect();
    let [low, high] = bounds(&columns, widest(&columns));
    // The width of a single column is only known to the projection.
    let all_around = sensor.columns_of_a_turn().is_some() || columns.len() < 2 || high - low >= std::f64::consts::TAU;
    Form::Beams { azimuth: (!all_around).then_some([0.5 * (low + high), 0.5 * (high - low)]), elevation, slopes }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Piece, Sampler};
    use presight_model::random::SplitMix64;
    use presight_model::sensor::{Angles, Distortion, PRESETS, SensorSpec};
    use presight_read::preset;

    fn sensors() -> Vec<Sensor> {
        let made = |geometry| Sensor::new(SensorSpec::new("s", "video", geometry)).unwrap();
        let lens =
            |distortion| Geometry::Camera(Camera { distortion, ..Camera::pinhole(64, 48, 50.0, 50.0, 31.5, 23.5) });
        let uniform = |start_deg, step_deg, count| Angles::Uniform { start_deg, step_deg, count };
        let scanner =
            |azimuth, elevation, beam_height_deg| Geometry::Scanner(Scanner { azimuth, elevation, beam_height_deg });
        let own = [
            lens(Distortion::PlumbBob([-0.2, 0.05, 0.001, 0.0, 0.0])),
            lens(Distortion::Equidistant([0.02, 0.0, 0.0, 0.0])),
            scanner(uniform(160.0, 1.0, 40), uniform(-10.0, 2.0, 8), None),
            scanner(uniform(30.0, -0.5, 40), Angles::Listed(vec![5.0]), Some(3.0)),
            scanner(uniform(0.0, 2.0, 180), Angles::Listed(vec![20.0, 3.0, 0.0, -30.0]), Some(1.0)),
        ];
        let presets = PRESETS.iter().map(|p| preset(p.name).unwrap());
        presets.chain(own.map(made)).collect()
    }

    /// A point that the sampler finds in the image is in view, and so is any box around it. Most other points are not.
    #[test]
    fn what_is_in_the_image_is_in_view() {
        let mut random = SplitMix64(5);
        for sensor in sensors() {
            let (view, sampler) = (View::new(&sensor), Sampler::new(&sensor));
            let (mut inside, mut kept) = (0, 0);
            for k in 0..20_000 {
                let mut unit = || 2.0 * random.unit() - 1.0;
                let direction = DVec3::new(unit(), unit(), unit());
                // Half of the points are at the border of the image.
                let (u, v) = (unit() * 0.51 + 0.5, if k % 4 == 0 { -0.499 } else { unit() * 0.51 + 0.5 });
                let pixel = [u * f64::from(sensor.width()), v * f64::from(sensor.height())];
                let ray = if k % 2 == 0 { sensor.ray_at(pixel[0], pixel[1]) } else { None };
                let at = ray.unwrap_or(direction) * (0.1 + 9.0 * unit().abs());
                let axes = [DVec3::X, DVec3::Y, DVec3::Z].map(|a| a * 1e-6);
                let seen = matches!(sampler.point(at), Piece::Inside(_)) && at.length() <= sensor.spec().range_max;
                inside += usize::from(seen);
                kept += usize::from(view.meets(at, &axes) && k % 2 == 1);
                if seen {
                    assert!(view.meets(at, &axes), "{}: {at}", sensor.spec().name);
                    let by = DVec3::new(unit(), unit(), unit());
                    assert!(view.meets(at + by, &[DVec3::X, DVec3::Y, DVec3::Z]), "{}: {at}", sensor.spec().name);
                }
            }
            // No random point hits a single row of beams without height.
            let is_plane = sensor.height() == 1
                && matches!(&sensor.spec().geometry, Geometry::Scanner(s) if s.beam_height_deg.is_none());
            assert!(inside > 200 || is_plane, "{}: {inside}", sensor.spec().name);
            let Form::Planes(..) = view.form else { continue };
            assert!(kept < 5000, "{}: {kept} of 10,000 random points are kept", sensor.spec().name);
        }
    }
}
