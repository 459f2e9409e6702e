//! A sensor's query region: the space that it can see.

use glam::DVec3;
use presight_model::error::Result;
use presight_model::geometry::Pose;
use presight_model::index::Region;
use presight_model::sensor::{Geometry, LineAxis, PixelGrid, Sensor, Sides};

/// A conservative region around all rays of a sensor, up to its maximum range: the frustum of a pinhole camera, the
/// spherical segment of a scanner, a pyramid around the rays of a table, or the complement of a pyramid.
///
/// # Errors
/// Same as [`Pose::check`].
pub fn region_of(sensor: &Sensor, world_from_sensor: &Pose) -> Result<Region> {
    world_from_sensor.check()?;
    let (apex, radius) = (world_from_sensor.translation, sensor.spec().range_max);
    let world_from_image = world_from_sensor.rotation_matrix() * sensor.body_from_image();
    let frustum = |normals: Vec<DVec3>| {
        let normals: Vec<DVec3> = normals.into_iter().map(|n| world_from_image * n).collect();
        Region::frustum(apex, &normals, radius)
    };
    Ok(match (sensor.grid(), &sensor.spec().geometry) {
        (PixelGrid::Lines(grid), Geometry::Scanner(scanner)) => {
            // Positions in the line frame are -tan(elevation), ascending.
            let t = grid.positions();
            let elevations = ((-t[t.len() - 1]).atan(), (-t[0]).atan());
            let columns = || (0..sensor.width()).map(|column| sensor.whole_column(column) as usize);
            let angles = || columns().map(|i| scanner.azimuth.degrees(i).to_radians());
            let least = angles().fold(f64::INFINITY, f64::min);
            let greatest = angles().fold(f64::NEG_INFINITY, f64::max);
            Region::segment(world_from_sensor, 0.5 * (least + greatest), greatest - least, elevations, radius)?
        }
        (PixelGrid::Lines(grid), _) if grid.axis() == LineAxis::Rows => frustum(sides(sensor)),
        (PixelGrid::Lines(_), _) => frustum(Vec::new()),
        (PixelGrid::Rays(rays), _) => match rays.sides() {
            Sides::Within(normals) => frustum(normals.clone()),
            Sides::Outside(normals) => {
                let normals: Vec<DVec3> = normals.iter().map(|n| world_from_image * *n).collect();
                Region::outside(apex, &normals, radius)
            }
        },
    })
}

/// The four sides of a pinhole image (through its outermost rays) and the half space in front.
fn sides(sensor: &Sensor) -> Vec<DVec3> {
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

#[cfg(test)]
mod tests {
    use super::*;
    use glam::{DAffine3, Vec3};
    use presight_model::geometry::Aabb;
    use presight_model::index::{IndexKind, Params, QueryResult, Skd, WorldIndex};
    use presight_model::sensor::{Angles, Camera, Distortion, PRESETS, RayTable, Scanner, SensorSpec};
    use presight_model::{Environment, Material, Mesh, NewObject, Polygon, PolygonOrder};
    use proptest::prelude::*;
    use std::sync::Arc;

    fn uniform(start_deg: f64, step_deg: f64, count: u32) -> Angles {
        Angles::Uniform { start_deg, step_deg, count }
    }

    fn sensors() -> impl Strategy<Value = Sensor> {
        let preset = (0..PRESETS.len()).prop_map(|i| presight_read::preset(PRESETS[i].name).unwrap());
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
        // Fisheyes that see beyond 90 degrees from the axis, and rays in all directions.
        let wide = (1.0..170.0f64, direction(), direction()).prop_map(move |(half_deg, a, b)| {
            let aside = (b - a * a.dot(b)).try_normalize().unwrap_or_else(|| a.any_orthonormal_vector());
            let ray = |k: u32| {
                let around = aside * f64::from(k).cos() + a.cross(aside) * f64::from(k).sin();
                let (sin, cos) = (half_deg.to_radians() * f64::from(k % 9) / 8.0).sin_cos();
                a * cos + around * sin
            };
            made(Geometry::Rays(RayTable::new(6, 9, (0..54).map(ray).collect()).unwrap()))
        });
        prop_oneof![preset, scanner, camera, rays, wide]
    }

    fn direction() -> impl Strategy<Value = DVec3> {
        let some = [-1.0..1.0f64, -1.0..1.0f64, -1.0..1.0f64].prop_map(DVec3::from);
        some.prop_filter("no direction", |v| v.length() > 0.1).prop_map(DVec3::normalize)
    }

    /// An object with any rotation and scale, mirrored or not, at various distances from the sensor.
    fn placements() -> impl Strategy<Value = (Pose, DVec3)> {
        let scale = prop_oneof![0.01..10.0f64, -10.0..-0.01f64, Just(1.0)];
        let far = prop_oneof![Just(0.0), -10.0..10.0f64, -600.0..600.0f64];
        (
            [-3.1..3.1f64, -1.5..1.5f64, -3.1..3.1f64],
            [scale.clone(), scale.clone(), scale],
            [far.clone(), far.clone(), far],
        )
            .prop_map(|(rpy, scale, at)| {
                (Pose::from_xyz_rpy(at.into(), rpy[0], rpy[1], rpy[2]), DVec3::from_array(scale))
            })
    }

    fn poses() -> impl Strategy<Value = Pose> {
        let at = prop_oneof![Just(0.0), -20.0..20.0f64, 5e6..5.001e6f64];
        let lean = prop_oneof![Just(0.0), -3.1..3.1f64, Just(1e-9)];
        ([at.clone(), at.clone(), at], [lean.clone(), lean.clone(), lean])
            .prop_map(|(at, rpy)| Pose::from_xyz_rpy(at.into(), rpy[0], rpy[1], rpy[2]))
    }

    /// A world with one triangle that has a corner near this point; also returns the stored corner.
    fn triangle_at(p_in_world: DVec3, world_from_object: Pose, scale: DVec3, size: f32) -> (Environment, DVec3) {
        let p_in_object = world_from_object.inverse().transform_point(p_in_world);
        let p = (p_in_object / scale).as_vec3();
        let size = size.max(p.abs().max_element() * 1e-5);
        let vertices = vec![p, p + Vec3::new(size, 0.0, size), p + Vec3::new(0.0, -size, size)];
        let face = vec![Polygon::new(vec![0, 1, 2], 0)];
        let mesh = Mesh::new("t", vertices, face, PolygonOrder::Spatial).unwrap();
        let mut new = NewObject::new("t", world_from_object, Arc::new(mesh));
        new.object_from_mesh = DAffine3::from_scale(scale);
        let mut environment = Environment::new();
        environment.add_material(Material::named("m")).unwrap();
        environment.insert(new).unwrap();
        let corner = environment.polygon_in_world(0).unwrap()[0];
        (environment, corner)
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(2000))]

        /// Selection may keep too much, but never too little, with any index: a polygon that touches a ray is kept, and
        /// `nearest` does not exceed the distance.
        #[test]
        fn a_polygon_on_a_ray_is_kept(
            sensor in sensors(), pose in poses(), placement in placements(),
            (i, j, t) in (any::<u32>(), any::<u32>(), 0.0..=1.0f64),
            size in prop_oneof![Just(1e-3f32), Just(1.0), Just(1e3)],
        ) {
            let border = |n: u32, k: u32| match k % 4 { 0 => 0, 1 => n - 1, _ => (k / 4) % n };
            let ray = sensor.ray(border(sensor.width(), i), border(sensor.height(), j));
            prop_assume!(ray.is_some());
            let distance = t * t * sensor.spec().range_max.min(200.0) * (1.0 - 1e-9);
            let p_in_world = pose.transform_point(sensor.body_from_image() * ray.unwrap() * distance);
            let (mut placement, scale) = placement;
            placement.translation += pose.translation;
            let (environment, corner) = triangle_at(p_in_world, placement, scale, size);
            // Move the sensor so that its ray meets the stored corner.
            let pose = Pose { translation: pose.translation + (corner - p_in_world), ..pose };
            let flat = IndexKind::Polygons(Box::new(Skd::<3>::build(Params::default(), &[])));
            for kind in [IndexKind::None, IndexKind::default(), flat] {
                let index = WorldIndex::new(&environment, &kind);
                let (mut found, mut runs) = (QueryResult::default(), Vec::new());
                index.select(&environment, &region_of(&sensor, &pose).unwrap(), &mut found, &mut runs);
                prop_assert_eq!(runs.len(), 1, "{:?} at {}", kind, distance);
                let rounding = 1e-8 + distance * 1e-12;
                prop_assert!(runs[0].nearest <= distance + rounding, "{:?}: {:?} at {}", kind, runs, distance);
            }
        }
    }

    fn keeps(sensor: &Sensor, p_in_image: DVec3) -> bool {
        let at = sensor.body_from_image() * p_in_image;
        let half = DVec3::splat(0.01);
        region_of(sensor, &Pose::IDENTITY).unwrap().meets(&Aabb { min: at - half, max: at + half })
    }

    /// Keeping everything would pass the test above, so polygons clearly out of sight must be dropped.
    #[test]
    fn what_is_out_of_sight_is_dropped() {
        let scanner = presight_read::preset("laser-range-camera").unwrap();
        assert!(keeps(&scanner, DVec3::X * 9.0));
        for p in [DVec3::NEG_X * 9.0, DVec3::X * 11.0, DVec3::new(1.0, 1.0, 0.0), DVec3::new(1.0, 0.0, 0.2)] {
            assert!(!keeps(&scanner, p), "{p}");
        }
        assert!(!keeps(&scanner, DVec3::new(1.0, 0.0, -2.0)));
        let camera = presight_read::preset("video-camera").unwrap();
        assert!(keeps(&camera, DVec3::Z * 9.0));
        for p in [DVec3::NEG_Z, DVec3::X, DVec3::NEG_X, DVec3::Y, DVec3::NEG_Y] {
            assert!(!keeps(&camera, p * 9.0), "{p}");
        }
        let table = RayTable::new(2, 1, vec![DVec3::X, DVec3::new(1.0, 0.1, 0.0)]).unwrap();
        let rays = Sensor::new(SensorSpec::new("r", "laser", Geometry::Rays(table))).unwrap();
        assert!(keeps(&rays, DVec3::X * 9.0) && !keeps(&rays, DVec3::Y * 9.0) && !keeps(&rays, DVec3::NEG_X * 9.0));
        // A fisheye with a half angle of 100 degrees, and a lens with an image of three rows.
        let camera = |f: f64, distortion| {
            let camera = Camera { distortion, ..Camera::pinhole(81, 3, f, f, 40.0, 1.0) };
            Sensor::new(SensorSpec::new("c", "video", Geometry::Camera(camera))).unwrap()
        };
        let wide = camera(40.0 / 100f64.to_radians(), Distortion::Equidistant([0.0; 4]));
        assert!(keeps(&wide, DVec3::Z * 9.0) && keeps(&wide, DVec3::new(9.0, 0.0, -1.0)));
        assert!(!keeps(&wide, DVec3::NEG_Z * 9.0) && !keeps(&wide, DVec3::new(3.0, 0.0, -9.0)));
        let barrel = camera(100.0, Distortion::PlumbBob([-0.1, 0.0, 0.0, 0.0, 0.0]));
        let right = barrel.ray(80, 1).unwrap();
        assert!(keeps(&barrel, right * 9.0) && !keeps(&barrel, (right + DVec3::X * 0.02) * 9.0));
        assert!(!keeps(&barrel, (DVec3::Z + DVec3::Y * 0.03) * 9.0), "above its three rows");
    }
}
