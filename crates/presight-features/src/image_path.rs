//! The image of a part of a curve, as a polyline.

use super::STEP;
use super::columns::turn;
use super::prediction::{VisibleInterval, along};
use glam::{DVec2, DVec3};
use presight_model::geometry::Pose;
use presight_model::sensor::Sensor;

/// Maximum distance of the image of a line from its chord, pixels: half of the sampling error of its ends.
const OFF: f64 = 0.25 * STEP;

/// A line is halved at most this often: a ray table projects only as finely as its rays.
const HALVINGS: u32 = 8;

/// The visible part of a curve through `points_world` in the image: pixel coordinates, column and row, from its first
/// end to its last. If a lens or a scanner bends the image of a line, points are added so that the polyline follows it
/// to a quarter of the sampling step. Past the seam of a full turn, column numbers continue beyond the image.
pub fn image_path(
    sensor: &Sensor,
    world_from_sensor: &Pose,
    points_world: &[DVec3],
    visible: &VisibleInterval,
) -> Vec<DVec2> {
    let image_from_world = (world_from_sensor.rotation_matrix() * sensor.body_from_image()).transpose();
    let in_image = |p: DVec3| image_from_world * (p - world_from_sensor.translation);
    let mut path = Path { sensor, turn: turn(sensor), points: vec![visible.pixels[0]] };
    for [a, b] in along(points_world, visible.t) {
        path.line(in_image(a), in_image(b), HALVINGS);
    }
    let end = path.near(visible.pixels[1]);
    match path.points.len() {
        1 => path.points.push(end),
        last => path.points[last - 1] = end,
    }
    path.points
}

struct Path<'a> {
    sensor: &'a Sensor,
    /// Columns of a full turn.
    turn: Option<f64>,
    /// Not empty.
    points: Vec<DVec2>,
}

impl Path<'_> {
    /// The pixel in the turn that is nearest to the end of the path.
    fn near(&self, mut pixel: DVec2) -> DVec2 {
        if let (Some(turn), Some(last)) = (self.turn, self.points.last()) {
            pixel.x += turn * ((last.x - pixel.x) / turn).round();
        }
        pixel
    }

    fn project(&self, p: DVec3) -> Option<DVec2> {
        self.sensor.project(p).map(|p| self.near(p.into()))
    }

    /// Continues the path along a line in space, image frame.
    fn line(&mut self, a: DVec3, b: DVec3, halvings: u32) {
        // The point at a share of the angle by halves: a bisector divides the line in the ratio of the distances.
        let half = |a: DVec3, b: DVec3| a.lerp(b, a.length() / (a.length() + b.length()));
        let middle = half(a, b);
        let is_straight = || {
            let between = [half(a, middle), middle, half(middle, b)].map(|p| self.project(p));
            let (Some(from), Some(to)) = (self.project(a), self.project(b)) else { return true };
            between.iter().flatten().all(|p| off_line(*p, from, to) <= OFF)
        };
        if halvings > 0 && middle.is_finite() && !is_straight() {
            self.line(a, middle, halvings - 1);
            self.line(middle, b, halvings - 1);
        } else if let Some(next) = self.project(b) {
            self.points.push(next);
        }
    }
}

/// Distance of a point from a line between two others, or from the first one if they are the same.
fn off_line(p: DVec2, from: DVec2, to: DVec2) -> f64 {
    let along = (to - from).normalize_or_zero();
    (p - from - along * (p - from).dot(along)).length()
}

#[cfg(test)]
mod tests {
    use super::*;
    use presight_model::sensor::{Angles, Camera, Distortion, Geometry, Scanner, SensorSpec};

    fn camera(distortion: Distortion) -> Sensor {
        let camera = Camera { distortion, ..Camera::pinhole(640, 480, 200.0, 200.0, 319.5, 239.5) };
        Sensor::new(SensorSpec::new("c", "video", Geometry::Camera(camera))).unwrap()
    }

    fn path(sensor: &Sensor, points: &[DVec3], t: [f64; 2]) -> Vec<DVec2> {
        let pixel = |p: DVec3| {
            let image_from_body = sensor.body_from_image().transpose();
            sensor.project(image_from_body * p).map(DVec2::from).unwrap()
        };
        let ends = along(points, t);
        let pixels = [pixel(ends[0][0]), pixel(ends[ends.len() - 1][1])];
        image_path(sensor, &Pose::IDENTITY, points, &VisibleInterval { t, pixels })
    }

    /// In an undistorted image the path has the ends and each vertex between them. x = 2, so a metre is 100 pixels.
    #[test]
    fn a_pinhole_shows_vertices_only() {
        let corner = [DVec3::new(2.0, 1.0, 0.0), DVec3::new(2.0, 0.0, 0.0), DVec3::new(2.0, 0.0, -1.0)];
        let seen = path(&camera(Distortion::None), &corner, [0.25, 1.0]);
        let right = [[269.5, 239.5], [319.5, 239.5], [319.5, 339.5]].map(DVec2::from);
        assert_eq!(seen.len(), 3, "{seen:?}");
        assert!(seen.iter().zip(right).all(|(is, right)| is.distance(right) < 1e-9), "{seen:?}");
    }

    /// An equidistant fisheye images the point at angle a from the axis at 200 a pixels from the centre. The line at
    /// height 1 bends: its middle is 39 pixels from the chord.
    #[test]
    fn a_lens_bends_lines() {
        let fisheye = camera(Distortion::Equidistant([0.0; 4]));
        let ends = [DVec3::new(1.0, 1.5, 1.0), DVec3::new(1.0, -1.5, 1.0)];
        let seen = path(&fisheye, &ends, [0.0, 1.0]);
        let place = |y: f64| {
            let flat = DVec2::new(-y, -1.0);
            DVec2::new(319.5, 239.5) + 200.0 * flat.length().atan() * flat.normalize()
        };
        assert!(off_line(place(0.0), seen[0], seen[seen.len() - 1]) > 20.0);
        for i in 0..=1000 {
            let p = place(1.5 - 3.0 * f64::from(i) / 1000.0);
            let off = seen.windows(2).map(|w| {
                let s = ((p - w[0]).dot(w[1] - w[0]) / (w[1] - w[0]).length_squared()).clamp(0.0, 1.0);
                p.distance(w[0].lerp(w[1], s))
            });
            assert!(off.fold(f64::INFINITY, f64::min) <= OFF, "{i}: {} points", seen.len());
        }
        assert!(seen.len() < 40, "{} points", seen.len());
    }

    /// A line behind a scanner crosses the seam at column 0: its column numbers continue.
    #[test]
    fn columns_go_on_over_the_seam() {
        let azimuth = Angles::Uniform { start_deg: -180.0, step_deg: 1.0, count: 360 };
        let elevation = Angles::Uniform { start_deg: -10.0, step_deg: 1.0, count: 21 };
        let geometry = Geometry::Scanner(Scanner { azimuth, elevation, beam_height_deg: None });
        let scanner = Sensor::new(SensorSpec::new("s", "laser", geometry)).unwrap();
        let seen = path(&scanner, &[DVec3::new(-2.0, 1.0, 0.1), DVec3::new(-2.0, -1.0, 0.1)], [0.0, 1.0]);
        let steps = seen.windows(2).map(|w| w[1].x - w[0].x);
        assert!(steps.clone().all(|step| (0.0..60.0).contains(&step)), "{seen:?}");
        let turned: f64 = steps.sum();
        assert!((turned - 2.0 * 0.5f64.atan().to_degrees()).abs() < 1e-9, "{turned}");
    }
}
