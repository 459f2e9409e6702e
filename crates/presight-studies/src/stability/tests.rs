//! Checks the oracle against rational numbers computed by hand, and against parry in easy cases.

use super::big::{Big, Vector};
use super::judge::TruthImage;
use super::lens::Exact;
use super::oracle::Oracle;
use super::truth::Truth;
use glam::{DVec3, Vec3};
use parry3d_f64::query::{Ray, RayCast};
use parry3d_f64::shape::Triangle;
use presight_model::environment::{Environment, Material, Mesh, NewObject, Polygon, PolygonOrder};
use presight_model::geometry::Pose;
use presight_model::sensor::{Angles, Camera, Distortion, Geometry, RayTable, Scanner, Sensor, SensorSpec};
use presight_model::world::World;
use presight_render::plan::{FramePlan, IdScheme, ImageRequest, Images, Outputs};
use presight_render::reference;
use presight_render::verify::Precision;
use std::sync::Arc;

fn world(triangles: &[[[f32; 3]; 3]], pose: Pose) -> World {
    let mut environment = Environment::new();
    environment.add_material(Material::named("grey")).unwrap();
    for t in triangles {
        let face = vec![Polygon::new(vec![0, 1, 2], 0)];
        let mesh = Mesh::new("t", t.map(Vec3::from_array).to_vec(), face, PolygonOrder::Given).unwrap();
        environment.insert(NewObject::new("t", pose, Arc::new(mesh))).unwrap();
    }
    World::new(environment)
}

fn plan(world: &World, geometry: Geometry, pose: &Pose) -> FramePlan {
    let sensor = Sensor::new(SensorSpec::new("s", "study", geometry)).unwrap();
    FramePlan::new(world, &sensor, pose, ImageRequest { outputs: Outputs::default(), ids: IdScheme::Model }).unwrap()
}

fn sight(plan: &FramePlan, column: u32, row: u32, polygon: usize) -> super::truth::PolygonOnRay {
    match Oracle::new(plan).look(column, row) {
        Truth::Ray(sights) => sights[polygon].clone(),
        other => panic!("{other:?}"),
    }
}

/// The plane through (2, 0, 0), (0, 4, 0), (0, 0, 4) is 2x + y + z = 4. The ray (2, 1, 2) / 3 meets it at 12/7, with
/// the cosine 7 / (3 sqrt 6).
#[test]
fn a_ray_meets_a_triangle_where_it_does_by_hand() {
    let world = world(&[[[2.0, 0.0, 0.0], [0.0, 4.0, 0.0], [0.0, 0.0, 4.0]]], Pose::IDENTITY);
    let rays = vec![DVec3::new(2.0, 1.0, 2.0), DVec3::new(2.0, -1.0, 2.0), DVec3::NAN];
    let table = RayTable::new(3, 1, rays).unwrap();
    let plan = plan(&world, Geometry::Rays(table), &Pose::IDENTITY);
    let hit = sight(&plan, 0, 0, 0);
    assert_eq!(hit.inverse_range, 7.0 / 12.0);
    // The expected value is rounded three times.
    assert!((hit.cos_incidence - 7.0 / (3.0 * 6f64.sqrt())).abs() < 3e-16);
    // The planes through the origin and the edges are the coordinate planes.
    let mut margins = hit.margins.clone();
    margins.sort_by(f64::total_cmp);
    assert_eq!(margins, [1.0 / 3.0, 2.0 / 3.0, 2.0 / 3.0]);
    assert!(sight(&plan, 1, 0, 0).margins.iter().any(|m| *m == -1.0 / 3.0));
    assert!(matches!(Oracle::new(&plan).look(2, 0), Truth::NoRay));
}

/// A quarter turn about z by a quaternion of nearly unit length, and an offset of 1e8 m to which f64 cannot add 2^-30:
/// the wall is at 3 - 2^-30.
#[test]
fn poses_and_offsets_are_exact() {
    let half = std::f64::consts::FRAC_1_SQRT_2;
    let turn = glam::DQuat::from_xyzw(0.0, 0.0, half, half);
    let object = Pose { rotation: turn, translation: DVec3::new(1e8, 0.0, 0.0) };
    // In the world the wall is at y = 3.
    let world = world(&[[[3.0, -9.0, -9.0], [3.0, 9.0, -9.0], [3.0, 0.0, 9.0]]], object);
    let pose = Pose { rotation: turn, translation: DVec3::new(1e8, 2f64.powi(-30), 0.0) };
    let camera = Camera::pinhole(3, 3, 1.0, 1.0, 1.0, 1.0);
    let plan = plan(&world, Geometry::Camera(camera), &pose);
    assert_eq!(sight(&plan, 1, 1, 0).inverse_range, (3.0 - 2f64.powi(-30)).recip());
    // One column to the left: 45 degrees.
    assert_eq!(sight(&plan, 0, 1, 0).inverse_range, ((3.0 - 2f64.powi(-30)) * 2f64.sqrt()).recip());
}

/// A beam at 60 degrees meets a wall 1 m ahead at 2 m. Angles are start + i * step, not accumulated sums.
#[test]
fn beams_are_at_start_plus_steps() {
    let world = world(&[[[1.0, -9.0, -9.0], [1.0, 9.0, -9.0], [1.0, 0.0, 9.0]]], Pose::IDENTITY);
    let azimuth = Angles::Uniform { start_deg: -30.0, step_deg: 30.0, count: 4 };
    let elevation = Angles::Listed(vec![-60.0, 0.0]);
    let scanner = Scanner { azimuth, elevation, beam_height_deg: None };
    let plan = plan(&world, Geometry::Scanner(scanner), &Pose::IDENTITY);
    assert_eq!(sight(&plan, 3, 0, 0).inverse_range, 0.5);
    assert_eq!(sight(&plan, 1, 1, 0).inverse_range, 0.5);
    assert_eq!(sight(&plan, 1, 0, 0).inverse_range, 1.0);
}

/// r (1 - 0.3 r^2) turns back at r = sqrt(10 / 9), where the image radius is 2/3 r.
#[test]
fn lenses_fold_where_they_do_by_hand() {
    let lens = Exact::new(&Distortion::PlumbBob([-0.3, 0.0, 0.0, 0.0, 0.0]));
    let fold = lens.fold.as_ref().unwrap();
    assert!((fold.to_f64() - 2.0 / 3.0 * (10f64 / 9.0).sqrt()).abs() < 1e-15);
    let [u, v] = lens.forward(&Vector::new(DVec3::new(1.0, 0.0, 2.0)));
    assert_eq!((u.to_f64(), v.to_f64()), (0.4625, 0.0));
    let fisheye = Exact::new(&Distortion::Equidistant([-0.1, 0.0, 0.0, 0.0]));
    // theta (1 - theta^2 / 10) turns back at sqrt(10 / 3).
    let turn = (10f64 / 3.0).sqrt();
    assert!((fisheye.fold.unwrap().to_f64() - turn * 2.0 / 3.0).abs() < 1e-15);
    assert!(Exact::new(&Distortion::PlumbBob([0.1, 0.0, 0.0, 0.0, 0.0])).fold.is_none());
}

/// Along the x axis, with p = (p2, 0), the image radius is r + k1 r^3 + 3 p2 r^2: it turns back where
/// 1 + 6 p2 r + 3 k1 r^2 = 0.
#[test]
fn tangential_terms_fold_where_they_do_by_hand() {
    let (k1, p2) = (-0.3, -0.02);
    let lens = Exact::new(&Distortion::PlumbBob([k1, 0.0, 0.0, p2, 0.0]));
    assert!(lens.fold.is_none());
    for side in [1.0, -1.0] {
        let p = side * p2;
        let r = (-3.0 * p - (9.0 * p * p - 3.0 * k1).sqrt()) / (3.0 * k1);
        let fold = r + k1 * r.powi(3) + 3.0 * p * r * r;
        for off in [-0.1, -1e-7, 1e-7, 0.1] {
            let (beyond, known) = lens.beyond_fold(&Big::new(side * (fold + off)), &Big::new(0.0)).unwrap();
            assert!((beyond - off).abs() < 1e-12 && known == 1e-9, "{side} {off}: {beyond}");
        }
    }
    // With negligible tangential terms it is the radial fold in every direction.
    let [round, exact] = [1e-300, 0.0].map(|p1| Exact::new(&Distortion::PlumbBob([k1, 0.0, p1, 0.0, 0.0])));
    let at = [0.5, -0.3].map(Big::new);
    let [a, b] = [round, exact].map(|lens| lens.beyond_fold(&at[0], &at[1]).unwrap().0);
    assert!((a - b).abs() < 1e-12, "{a} {b}");
}

/// The inverse is correct even if the product's ray is missing or lies beyond the fold.
#[test]
fn a_lens_is_inverted_whatever_the_product_says() {
    let lens = Exact::new(&Distortion::PlumbBob([-0.3, 0.0, 0.003, -0.002, 0.0]));
    let ray = DVec3::new(0.5, 0.2, 1.0);
    let inside = lens.forward(&Vector::new(ray));
    let again = DVec3::new(1.3, 0.5, 1.0);
    for near in [None, Some(ray), Some(again)] {
        let found = lens.inverse(&inside[0], &inside[1], near).unwrap().to_f64();
        assert!(found.distance(ray) < 1e-15, "{near:?}: {found}");
    }
    let beyond = [0.75, 0.2].map(Big::new);
    assert!(matches!(lens.inverse(&beyond[0], &beyond[1], Some(ray)), Err(Truth::NoRay)));
}

/// Leaving out a plate that rays meet at 1e-7 rad, as if it were edge-on, is counted in f32 and a fault in f64.
#[test]
fn a_polygon_that_is_left_out_as_edge_on_is_told() {
    let at = |dx: f32, y: f32| [10.0 + dx, y, 1e-7 * dx];
    let plate = [[at(-1.0, -1.0), at(1.0, -1.0), at(1.0, 1.0)], [at(-1.0, -1.0), at(1.0, 1.0), at(-1.0, 1.0)]];
    let wall = [[20.0, -90.0, -90.0], [20.0, 90.0, -90.0], [20.0, 0.0, 90.0]];
    let [with, without] = [[wall, plate[0], plate[1]].as_slice(), &[wall]].map(|t| world(t, Pose::IDENTITY));
    let sensor = || Geometry::Camera(Camera::pinhole(17, 9, 80.0, 4e8, 8.3, 4.1));
    let (with, without) = (plan(&with, sensor(), &Pose::IDENTITY), plan(&without, sensor(), &Pose::IDENTITY));
    let picture = TruthImage::new(&with);
    let (mut right, mut behind) = (Images::default(), Images::default());
    reference::render(&with, &mut right).unwrap();
    reference::render(&without, &mut behind).unwrap();
    let plates = right.polygon_id.iter().filter(|id| **id > 1).count();
    assert!(plates > 10, "{plates}");
    let verdict = picture.judge(&right, Precision::F32);
    assert!(verdict.fault.is_none() && verdict.other == 0 && verdict.error < 1e-7, "{verdict:?}");
    let verdict = picture.judge(&behind, Precision::F32);
    assert!(verdict.fault.is_none() && verdict.other == plates && verdict.unbounded == plates, "{verdict:?}");
    // The plate is 9 to 11 m away, the wall 20.
    assert!((0.8..1.3).contains(&verdict.error) && verdict.bound == f64::INFINITY, "{verdict:?}");
    assert!(picture.judge(&behind, Precision::F64).fault.is_some());
}

/// Converts to parry's version of glam.
fn parry(v: DVec3) -> parry3d_f64::math::Vector {
    parry3d_f64::math::Vector::new(v.x, v.y, v.z)
}

#[test]
fn parry_agrees_in_easy_cases() {
    let triangles: Vec<[[f32; 3]; 3]> = (0..7u8)
        .map(|k| {
            let t = f32::from(k);
            [[3.0 + t, -2.0 + 0.5 * t, -1.0], [2.5 + 0.3 * t, 1.5, -0.7 + 0.2 * t], [3.5, 0.3 * t, 1.0 + 0.1 * t]]
        })
        .collect();
    let pose = Pose::from_xyz_rpy(DVec3::new(0.5, 0.2, -0.3), 0.1, 0.2, 0.3);
    let world = world(&triangles, pose);
    let sensor_pose = Pose::from_xyz_rpy(DVec3::new(0.1, -0.4, 0.2), -0.1, 0.1, 0.4);
    let plan = plan(&world, Geometry::Camera(Camera::pinhole(33, 17, 20.0, 15.0, 16.2, 8.1)), &sensor_pose);
    let oracle = Oracle::new(&plan);
    let mut hits = 0;
    for (column, row) in (0..17).flat_map(|row| (0..33).map(move |column| (column, row))) {
        let Truth::Ray(sights) = oracle.look(column, row) else { panic!("a pinhole has all rays") };
        let direction = sensor_pose.rotation * (plan.sensor.body_from_image() * plan.sensor.ray(column, row).unwrap());
        let ray = Ray::new(parry(sensor_pose.translation), parry(direction));
        for (sight, t) in sights.iter().zip(&triangles) {
            let [a, b, c] = t.map(|p| parry(pose.transform_point(Vec3::from_array(p).as_dvec3())));
            let met = Triangle::new(a, b, c).cast_local_ray(&ray, 1e9, false);
            let least = sight.margins.iter().copied().fold(f64::INFINITY, f64::min);
            if least.abs() > 1e-9 {
                assert_eq!(met.is_some(), least > 0.0, "({column}, {row})");
            }
            if let Some(range) = met.filter(|_| least > 1e-9) {
                hits += 1;
                assert!((range * sight.inverse_range - 1.0).abs() < 1e-12, "{range} {}", sight.inverse_range);
            }
        }
    }
    assert!(hits > 100, "{hits}");
}

/// The judge accepts a correct image, and finds each kind of planted fault.
#[test]
fn the_judge_sees_each_planted_fault() {
    let triangles = [
        [[3.0, -2.0, -2.0], [3.0, 2.0, -2.0], [3.0, 0.0, 2.0]],
        [[5.0, -50.0, -50.0], [5.0, 50.0, -50.0], [5.0, 0.0, 90.0f32]],
    ];
    let world = world(&triangles, Pose::IDENTITY);
    let sensor =
        Sensor::new(SensorSpec::new("s", "study", Geometry::Camera(Camera::pinhole(33, 17, 20.0, 15.0, 16.2, 8.1))));
    let request = ImageRequest { outputs: Outputs::ALL, ids: IdScheme::Model };
    let plan = FramePlan::new(&world, &sensor.unwrap(), &Pose::IDENTITY, request).unwrap();
    let picture = TruthImage::new(&plan);
    let mut images = Images::default();
    reference::render(&plan, &mut images).unwrap();
    let verdict = picture.judge(&images, Precision::F64);
    assert!(verdict.fault.is_none() && verdict.hits == 33 * 17 && verdict.unbounded == 0, "{verdict:?}");
    assert!(verdict.error > 0.0 && verdict.error < 1e-7, "{verdict:?}");
    let middle = 8 * 33 + 16;
    let faults: [fn(&mut Images, usize); 9] = [
        |i, at| i.range[at] *= 1.0 + 1e-6,
        |i, at| i.range[at] = f32::NAN,
        |i, at| i.polygon_id[at] = 2,
        |i, at| i.polygon_id[at] = 3,
        |i, at| i.object_id[at] = 2,
        |i, at| i.cos_incidence[at] *= 1.0 + 1e-6,
        |i, at| i.depth_z[at] *= 1.0 + 1e-6,
        |i, at| i.echo[at] = f32::NAN,
        |i, at| {
            (i.polygon_id[at], i.object_id[at], i.range[at], i.depth_z[at]) = (0, 0, f32::INFINITY, f32::INFINITY);
            (i.cos_incidence[at], i.echo[at]) = (f32::NAN, f32::NAN);
        },
    ];
    for (n, fault) in faults.into_iter().enumerate() {
        let mut spoiled = images.clone();
        fault(&mut spoiled, middle);
        let verdict = picture.judge(&spoiled, Precision::F64);
        assert!(verdict.fault.is_some_and(|f| f.contains("(16, 8)")), "fault {n}");
    }
}
