//! What a sensor can see at all: the plain bounds test behind the selection seam.

use super::Instance;
use crate::geometry::Aabb;
use crate::sensor::{Geometry, LineAxis, PixelGrid, Sensor, Tile};
use glam::DVec3;

/// A conservative region around all rays of a sensor, in the image frame.
#[derive(Clone, Debug)]
pub struct View {
    /// Inward normals of planes through the centre; a box wholly outside one is not seen.
    planes: Vec<DVec3>,
    /// Least and greatest tangent of the elevation, for scanners.
    tangents: Option<(f64, f64)>,
    range_max: f64,
}

/// Angles are widened by this much, radians: selection may keep too much, never too little.
const SLACK: f64 = 1e-9;

impl View {
    /// The region of a sensor.
    pub fn of(sensor: &Sensor) -> Self {
        let mut view = Self { planes: Vec::new(), tangents: None, range_max: sensor.spec().range_max };
        match (sensor.grid(), &sensor.spec().geometry) {
            (PixelGrid::Lines(grid), _) if grid.axis() == LineAxis::Rows => view.planes = frustum(sensor),
            (PixelGrid::Lines(grid), Geometry::Scanner(scanner)) => {
                // Line-frame positions are -tan(elevation), rising.
                let t = grid.positions();
                view.tangents = Some((-t[t.len() - 1] - SLACK, -t[0] + SLACK));
                let n = scanner.azimuth.len();
                let angles: Vec<f64> = (0..n).map(|i| scanner.azimuth.degrees(i).to_radians()).collect();
                view.planes = sector(&angles);
            }
            (PixelGrid::Lines(_), _) => {}
            (PixelGrid::Rays(rays), _) => {
                let whole = Tile::around(0, 0, rays.width(), rays.height(), |c, r| sensor.ray(c, r));
                view.planes = cone(&whole);
            }
        }
        view
    }

    /// The least distance at which the sensor may see something in a box of the mesh frame, or `None` if it cannot.
    pub fn distance_if_seen(&self, instance: &Instance, bounds: &Aabb) -> Option<f64> {
        let m = instance.image_from_mesh;
        let center = m * (bounds.center() - instance.center_in_mesh);
        let half = bounds.half_extent();
        let axes = [m.x_axis * half.x, m.y_axis * half.y, m.z_axis * half.z];
        let slack = 1e-12 * (center.abs().max_element() + instance.center_in_mesh.length() * m.x_axis.length());
        let reach: DVec3 = axes.iter().map(|a| a.abs()).sum::<DVec3>() + slack;
        let in_image = Aabb { min: center - reach, max: center + reach };
        let nearest = in_image.distance_squared(DVec3::ZERO).sqrt() * (1.0 - 1e-12);
        if nearest > self.range_max {
            return None;
        }
        for plane in &self.planes {
            let radius: f64 = axes.iter().map(|a| plane.dot(*a).abs()).sum();
            if plane.dot(center) + radius + slack + SLACK * center.length() < 0.0 {
                return None;
            }
        }
        match self.tangents {
            Some(limits) if misses_elevations(&in_image, limits) => None,
            _ => Some(nearest),
        }
    }
}

/// True if every point of the box lies above the highest or below the lowest elevation.
fn misses_elevations(b: &Aabb, (lowest, highest): (f64, f64)) -> bool {
    let gap = b.min.max(-b.max).max(DVec3::ZERO);
    let nearest = gap.x.hypot(gap.y);
    let far = b.min.abs().max(b.max.abs());
    let farthest = far.x.hypot(far.y);
    let least = if b.min.z > 0.0 { b.min.z / farthest } else { b.min.z / nearest };
    let greatest = if b.max.z > 0.0 { b.max.z / nearest } else { b.max.z / farthest };
    // 0/0 (a box on the axis) is NaN and compares false: kept.
    least > highest || greatest < lowest
}

/// The four sides of a pinhole image (as wide as its outermost rays) and the half space in front.
fn frustum(sensor: &Sensor) -> Vec<DVec3> {
    let (w, h) = (sensor.width() - 1, sensor.height() - 1);
    let ray = |c, r| sensor.ray(c, r).unwrap_or(DVec3::Z);
    let (left_top, right_bottom) = (ray(0, 0), ray(w, h));
    let (left, right) = (left_top.x / left_top.z, right_bottom.x / right_bottom.z);
    let (top, bottom) = (left_top.y / left_top.z, right_bottom.y / right_bottom.z);
    vec![
        DVec3::Z,
        DVec3::new(1.0, 0.0, -left).normalize(),
        DVec3::new(-1.0, 0.0, right).normalize(),
        DVec3::new(0.0, 1.0, -top).normalize(),
        DVec3::new(0.0, -1.0, bottom).normalize(),
    ]
}

/// The two sides of an azimuth sector of less than half a turn; a wider one is no convex region.
fn sector(angles: &[f64]) -> Vec<DVec3> {
    let least = angles.iter().copied().fold(f64::INFINITY, f64::min);
    let greatest = angles.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    if greatest - least >= std::f64::consts::PI - 1e-6 {
        return Vec::new();
    }
    vec![DVec3::new(-least.sin(), least.cos(), 0.0), DVec3::new(greatest.sin(), -greatest.cos(), 0.0)]
}

/// Four planes around a cone of less than a right angle.
fn cone(tile: &Tile) -> Vec<DVec3> {
    if !(0.0..1.5).contains(&tile.half_angle) {
        return Vec::new();
    }
    let (side, up) = tile.axis.any_orthonormal_pair();
    let (sin, cos) = (tile.half_angle + SLACK).sin_cos();
    [side, -side, up, -up].map(|d| tile.axis * sin + d * cos).to_vec()
}
