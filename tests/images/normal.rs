//! The image of normals: calculated by hand, equal on every engine, and free unless requested.

use presight_testkit as common;

use common::{engines, reference, scenes};
use glam::{DVec3, Vec3};
use presight_model::environment::{Environment, Mesh, NewObject, Polygon, PolygonOrder};
use presight_model::geometry::Pose;
use presight_model::sensor::{Geometry, Sensor};
use presight_model::world::World;
use presight_predict::request::Request;
use presight_render::plan::{FramePlan, IdScheme, Images, Output, Outputs};
use presight_render::verify::compare;

/// A tilted wall 1.75 m ahead whose plane rises 4 for 3 ahead, so that its normal is (-0.8, 0, 0.6) or its opposite.
fn leaning_wall(reversed: bool, mirrored: bool) -> World {
    let mut environment = Environment::new();
    environment.add_material(presight_model::environment::Material::named("paint")).unwrap();
    let corners = [[1.0, -4.0, -1.0], [1.0, 4.0, -1.0], [2.5, 4.0, 1.0], [2.5, -4.0, 1.0]].map(Vec3::from);
    let order = if reversed { vec![3, 2, 1, 0] } else { vec![0, 1, 2, 3] };
    let mesh = Mesh::new("wall", corners.to_vec(), vec![Polygon::new(order, 0)], PolygonOrder::Given).unwrap();
    let side = if mirrored { -1.0 } else { 1.0 };
    let object_from_mesh = glam::DAffine3::from_scale(DVec3::new(1.0, side, 1.0));
    let wall = NewObject { object_from_mesh, ..NewObject::new("wall", Pose::IDENTITY, mesh.into()) };
    environment.insert(wall).unwrap();
    World::new(environment)
}

fn render(world: &World, sensor: &Sensor, pose: &Pose, outputs: Outputs) -> Vec<Images> {
    let plan = FramePlan::new(world, sensor, pose, &Request::of(outputs)).unwrap();
    engines::all().into_iter().map(|(_, _, mut render)| render(&plan)).collect()
}

fn limited(sensor: &Sensor, range_min: f64, range_max: f64) -> Sensor {
    Sensor::new(sensor.spec().clone().with_limits(range_min, range_max)).unwrap()
}

/// The truth by hand, in body axes for both a camera and a scanner, for either winding of the wall, mirrored or not.
#[test]
fn the_normal_faces_the_sensor_in_body_axes() {
    for sensor in [scenes::camera(31, 21), scenes::scanner(36, 5)] {
        for (reversed, mirrored) in [(false, false), (true, false), (false, true), (true, true)] {
            let world = leaning_wall(reversed, mirrored);
            // Straight ahead, rotated to the left, and from behind the wall.

            let behind = Pose::from_xyz_rpy(DVec3::new(4.0, 0.0, 0.0), 0.0, 0.0, std::f64::consts::PI);
            for (pose, truth) in [
                (Pose::IDENTITY, Vec3::new(-0.8, 0.0, 0.6)),
                (
                    Pose::from_xyz_rpy(DVec3::ZERO, 0.0, 0.0, 0.3),
                    Vec3::new(-0.8 * 0.3f32.cos(), 0.8 * 0.3f32.sin(), 0.6),
                ),
                (behind, Vec3::new(-0.8, 0.0, -0.6)),
            ] {
                for images in render(&world, &sensor, &pose, Outputs::of(&[Output::Normal])) {
                    assert_eq!(images.outputs(), Outputs::of(&[Output::Normal]));
                    let seen = images.normal.iter().copied().map(Vec3::from).filter(|n| !n.is_nan());
                    let most = seen.clone().map(|n| n.distance(truth)).fold(0.0, f32::max);
                    assert!(seen.count() > 10 && most < 2e-7, "{}: off by {most}", sensor.spec().name);
                }
            }
        }
    }
}

/// Present below `range_min`, as the angle is; NaN beyond `range_max`, without a hit, and without a ray.
#[test]
fn the_normal_exists_wherever_the_angle_does() {
    let wall = leaning_wall(false, false);
    let outputs = Outputs::ALL.without(Output::DepthZ);
    for (range_min, range_max) in [(2.2, 50.0), (0.0, 2.1)] {
        for sensor in [scenes::camera(61, 41), scenes::scanner(36, 5), scenes::all_round(40, 21)] {
            let sensor = limited(&sensor, range_min, range_max);
            for images in render(&wall, &sensor, &Pose::IDENTITY, outputs) {
                let open = |n: &[f32; 3]| n.iter().all(|x| x.is_nan());
                let same = images.normal.iter().zip(&images.cos_incidence).all(|(n, cos)| open(n) == cos.is_nan());
                assert!(same, "{} {range_min}..{range_max}", sensor.spec().name);
                if range_min > 0.0 {
                    let near = |at: usize| images.range[at] == f32::NEG_INFINITY;
                    assert!((0..images.pixels()).any(|at| near(at) && images.normal[at] == [-0.8, 0.0, 0.6]));
                }
                assert!(images.normal.iter().any(open) || matches!(sensor.spec().geometry, Geometry::Camera(_)));
            }
        }
    }
}

/// Planted faults: a normal off by more than its bound, one on the wrong side, and one in optical axes instead of body
/// axes.
#[test]
fn engines_agree_and_planted_faults_are_caught() {
    let world = scenes::room_world(3, 12);
    let pose = Pose::from_xyz_rpy(DVec3::new(0.1, 0.2, 1.3), 0.02, 0.05, 0.7);
    for (name, precision, mut render) in engines::all() {
        for sensor in [scenes::camera(97, 61), scenes::scanner(120, 31), scenes::all_round(40, 21)] {
            for outputs in [Outputs::ALL, Outputs::of(&[Output::Normal])] {
                let outputs = if sensor.is_camera() { outputs } else { outputs.without(Output::DepthZ) };
                for ids in [IdScheme::Model, IdScheme::Source] {
                    let request = Request::of(outputs).with_ids(ids);
                    let plan = FramePlan::new(&world, &sensor, &pose, &request).unwrap();
                    let (right, got) = (reference(&plan), render(&plan));
                    common::compare_or_show(&right, &got, &plan, precision)
                        .check(0.01)
                        .unwrap_or_else(|e| panic!("{name:?}, {}: {e}", sensor.spec().name));
                    let at = got.pixels() / 2 + 7;
                    let faults: [fn(Vec3) -> Vec3; 3] =
                        [|n| (n + Vec3::new(1e-3, -2e-3, 1e-3)).normalize(), |n| -n, |n| Vec3::new(-n.y, -n.z, n.x)];
                    // All polygons of an object in this scene have one source, so its id would excuse the normals of
                    // others.
                    let planted = if ids == IdScheme::Model { &faults[..] } else { &faults[..1] };
                    for (i, fault) in planted.iter().enumerate() {
                        let mut wrong = right.clone();
                        wrong.normal[at] = fault(Vec3::from(right.normal[at])).to_array();
                        let report = compare(&right, &wrong, &plan, precision).unwrap();
                        // Without ids another polygon may happen to have the wrong normal, but not at this pixel.
                        assert_eq!(report.fault, 1, "fault {i}, {}, {ids:?}", sensor.spec().name);
                    }
                }
            }
        }
    }
}

#[test]
fn without_a_request_there_is_no_normal_and_no_cost() {
    let (world, sensor) = (scenes::room_world(3, 4), scenes::camera(31, 23));
    let plan = |outputs| FramePlan::new(&world, &sensor, &Pose::IDENTITY, &Request::of(outputs)).unwrap();
    let without = plan(Outputs::of(&[Output::Range]));
    assert_eq!(without.drawn(), Outputs::of(&[Output::Range]));
    assert!(reference(&without).normal.is_empty());
    let asked = plan(Outputs::of(&[Output::Normal]));
    assert_eq!(asked.drawn(), Outputs::of(&[Output::PolygonId, Output::ObjectId]));
}
