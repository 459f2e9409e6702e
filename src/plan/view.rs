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
        let reach: DVec3 = axes.iter().map(|a| a.abs()).sum();
        let scale = m.x_axis.length().max(m.y_axis.length()).max(m.z_axis.length());
        let slack =
            1e-12 * (center.abs().max_element() + reach.max_element() + instance.center_in_mesh.length() * scale);
        let reach = reach + slack;
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Pose;
    use crate::sensor::{Angles, Camera, Distortion, PRESETS, RayTable, Scanner, SensorSpec};
    use glam::DMat3;
    use proptest::prelude::*;

    fn uniform(start_deg: f64, step_deg: f64, count: u32) -> Angles {
        Angles::Uniform { start_deg, step_deg, count }
    }

    fn sensors() -> impl Strategy<Value = Sensor> {
        let preset = (0..PRESETS.len()).prop_map(|i| crate::preset(PRESETS[i].name).unwrap());
        let made = |geometry| {
            let mut spec = SensorSpec::new("s", "laser", geometry);
            spec.range_max = 100.0;
            Sensor::new(spec).unwrap()
        };
        let scanner = (-700.0..700.0f64, 1..40u32, 0.001..9.0f64, any::<bool>(), 0..4usize).prop_map(
            move |(start, count, step, left, rows)| {
                let azimuth = uniform(start, if left { step } else { -step }, count);
                let elevation = match rows {
                    0 => uniform(-90.0, 22.5, 9),
                    1 => Angles::Listed(vec![89.999_999_9, 0.0]),
                    2 => uniform(-60.0, step, 3),
                    _ => Angles::Listed(vec![0.0]),
                };
                made(Geometry::Scanner(Scanner { azimuth, elevation, beam_height_deg: None }))
            },
        );
        let camera =
            ([0.1..900.0f64, 0.1..900.0f64, -50.0..90.0f64, -50.0..90.0f64], 1..40u32, 1..40u32, any::<bool>())
                .prop_map(move |([fx, fy, cx, cy], width, height, fisheye)| {
                    let distortion = if fisheye { Distortion::Equidistant([0.0; 4]) } else { Distortion::None };
                    made(Geometry::Camera(Camera { width, height, fx, fy, cx, cy, distortion }))
                });
        let rays = (prop::collection::vec([-1.0..1.0f64, -1.0..1.0f64, 0.01..1.0f64], 6), 0.01..20.0f64).prop_map(
            move |(d, narrow)| {
                let d = d.iter().map(|d| DVec3::new(d[0], d[1], d[2] * narrow)).collect();
                made(Geometry::Rays(RayTable::new(2, 3, d).unwrap()))
            },
        );
        prop_oneof![preset, scanner, camera, rays]
    }

    fn instances() -> impl Strategy<Value = Instance> {
        let scale = prop_oneof![0.01..10.0f64, -10.0..-0.01f64, Just(1e-6)];
        let far = prop_oneof![Just(0.0), -10.0..10.0f64, -5e6..5e6f64];
        (
            [-3.1..3.1f64, -1.5..1.5f64, -3.1..3.1f64],
            [scale.clone(), scale.clone(), scale],
            [far.clone(), far.clone(), far],
        )
            .prop_map(|(rpy, scale, center)| {
                let turn = Pose::from_xyz_rpy(DVec3::ZERO, rpy[0], rpy[1], rpy[2]).rotation_matrix();
                let image_from_mesh = turn * DMat3::from_diagonal(DVec3::from_array(scale));
                Instance {
                    object: 0,
                    image_from_mesh,
                    center_in_mesh: DVec3::from_array(center),
                    normal_from_mesh: image_from_mesh.inverse().transpose(),
                    plain: true,
                }
            })
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(2000))]

        /// Selection may keep too much, never too little: a box with a point of a ray in it is kept, and no nearer
        /// point is promised away.
        #[test]
        fn a_box_on_a_ray_is_kept(
            sensor in sensors(), instance in instances(), (i, j, t) in (any::<u32>(), any::<u32>(), 0.0..=1.0f64),
            below in [0.0..3.0f64, 0.0..3.0f64, 0.0..3.0f64], above in [0.0..3.0f64, 0.0..3.0f64, 0.0..3.0f64],
            size in prop_oneof![Just(0.0), Just(1e-6), Just(1.0), Just(1e3)],
        ) {
            let border = |n: u32, k: u32| match k % 4 { 0 => 0, 1 => n - 1, _ => (k / 4) % n };
            let ray = sensor.ray(border(sensor.width(), i), border(sensor.height(), j));
            prop_assume!(ray.is_some());
            let distance = t * t * sensor.spec().range_max.min(200.0);
            let p_in_image = ray.unwrap() * distance;
            let p_in_mesh = instance.center_in_mesh + instance.image_from_mesh.inverse() * p_in_image;
            let (below, above) = (DVec3::from_array(below) * size, DVec3::from_array(above) * size);
            let bounds = Aabb { min: p_in_mesh - below, max: p_in_mesh + above };
            let nearest = View::of(&sensor).distance_if_seen(&instance, &bounds);
            prop_assert!(nearest.is_some(), "{:?} at {}", bounds, distance);
            prop_assert!(nearest.unwrap() <= distance, "{} > {}", nearest.unwrap(), distance);
        }
    }

    fn keeps(sensor: &Sensor, p_in_image: DVec3) -> bool {
        let instance = Instance {
            object: 0,
            image_from_mesh: DMat3::IDENTITY,
            center_in_mesh: DVec3::ZERO,
            normal_from_mesh: DMat3::IDENTITY,
            plain: true,
        };
        let half = DVec3::splat(0.01);
        let bounds = Aabb { min: p_in_image - half, max: p_in_image + half };
        View::of(sensor).distance_if_seen(&instance, &bounds).is_some()
    }

    /// Keeping everything would pass the test above: what is clearly out of sight must go.
    #[test]
    fn what_is_out_of_sight_is_dropped() {
        let scanner = crate::preset("laser-range-camera").unwrap();
        assert!(keeps(&scanner, DVec3::X * 9.0));
        for p in [DVec3::NEG_X * 9.0, DVec3::X * 11.0, DVec3::new(1.0, 1.0, 0.0), DVec3::new(1.0, 0.0, 0.2)] {
            assert!(!keeps(&scanner, p), "{p}");
        }
        assert!(!keeps(&scanner, DVec3::new(1.0, 0.0, -2.0)));
        let camera = crate::preset("video-camera").unwrap();
        assert!(keeps(&camera, DVec3::Z * 9.0));
        for p in [DVec3::NEG_Z, DVec3::X, DVec3::NEG_X, DVec3::Y, DVec3::NEG_Y] {
            assert!(!keeps(&camera, p * 9.0), "{p}");
        }
        let table = RayTable::new(2, 1, vec![DVec3::X, DVec3::new(1.0, 0.1, 0.0)]).unwrap();
        let rays = Sensor::new(SensorSpec::new("r", "laser", Geometry::Rays(table))).unwrap();
        assert!(keeps(&rays, DVec3::X * 9.0) && !keeps(&rays, DVec3::Y * 9.0) && !keeps(&rays, DVec3::NEG_X * 9.0));
    }
}
