//! Simulated rooms with hand-computed surfaces.

use glam::{DVec3, Vec3};
use presight_explore::{Exploration, ExploreOptions, Known, Views};
use presight_localize::simulate::{Disturbances, Simulator};
use presight_model::environment::{Environment, Mesh, NewObject, Object, Polygon, PolygonOrder};
use presight_model::geometry::{Pose, RobotPose, SensorPose};
use presight_model::sensor::{Camera, Geometry, Noise, Sensor, SensorSpec};
use presight_model::world::World;
use presight_predict::predict::{Options, Predictor};
use presight_testkit::judge::is_blocked;
use presight_testkit::scenes::{cuboid, empty};

/// A wall 2 m ahead of the origin, 4 m wide and high, with a window of 0.8 m in its middle, and a floor 1 m below.
pub(crate) fn windowed() -> Environment {
    let mut environment = empty();
    let wall = |[a, b, c, d]: [f32; 4]| vec![[2.0, a, c], [2.0, a, d], [2.0, b, d], [2.0, b, c]];
    let parts = [[0.4, 2.0, -2.0, 2.0], [-2.0, -0.4, -2.0, 2.0], [-0.4, 0.4, 0.4, 2.0], [-0.4, 0.4, -2.0, -0.4]];
    let floor = vec![[0.5, -2.0, -1.0], [2.0, -2.0, -1.0], [2.0, 2.0, -1.0], [0.5, 2.0, -1.0]];
    let polygons: Vec<Vec<Vec3>> =
        parts.map(wall).into_iter().chain([floor]).map(|p| p.into_iter().map(Vec3::from).collect()).collect();
    let mesh = presight_testkit::scenes::mesh(&polygons);
    environment.insert(NewObject::new("wall", Pose::IDENTITY, mesh.into())).unwrap();
    environment
}

pub(crate) fn sensor() -> Sensor {
    let camera = Geometry::Camera(Camera::pinhole(96, 72, 48.0, 48.0, 47.5, 35.5));
    let spec = SensorSpec::new("camera", "laser", camera).with_limits(0.2, 8.0);
    Sensor::new(spec.with_noise(Noise { range_sigma: 0.002, ..Noise::default() })).unwrap()
}

fn views(frames: impl IntoIterator<Item = (Environment, Pose)>) -> Views {
    views_of(&sensor(), frames)
}

/// Frames of worlds at poses.
pub(crate) fn views_of(sensor: &Sensor, frames: impl IntoIterator<Item = (Environment, Pose)>) -> Views {
    let predictor = Predictor::new(Options::default()).unwrap();
    let mut simulator = Simulator::new(predictor, sensor.clone(), Disturbances::default(), 7).unwrap();
    let mut views = Views::default();
    for (k, (environment, pose)) in frames.into_iter().enumerate() {
        let frame = simulator.frame(&World::new(environment), k as f64, &RobotPose::new(pose)).unwrap();
        views.push(&frame, SensorPose::new(pose)).unwrap();
    }
    views
}

/// Poses that look ahead, from the left to the right.
pub(crate) fn ahead(count: usize) -> impl Iterator<Item = Pose> {
    (0..count).map(move |k| {
        let off = k as f64 / (count - 1) as f64 - 0.5;
        Pose::from_xyz_rpy(DVec3::new(0.0, off, 0.1 * off), 0.0, 0.2, -0.4 * off)
    })
}

pub(crate) fn explore(known: &Environment, kind: Known, views: &Views) -> Exploration {
    Exploration::of(known, kind, views, &ExploreOptions::default()).unwrap()
}

/// Number of rays through the window, 5 cm from its border or more, that something blocks.
pub(crate) fn blocked(environment: &Environment) -> usize {
    let to = |k: usize| DVec3::new(2.2, -0.35 + 0.07 * (k % 11) as f64, -0.35 + 0.07 * (k / 11) as f64);
    (0..121).filter(|k| is_blocked(environment, DVec3::new(1.8, to(*k).y, to(*k).z), to(*k))).count()
}

#[test]
fn a_window_stays_open() {
    let found = explore(&Environment::new(), Known::Explored, &views(ahead(9).map(|pose| (windowed(), pose))));
    let around = |y: f64, z: f64| is_blocked(found.environment(), DVec3::new(1.0, y, z), DVec3::new(2.1, y, z));
    assert!(around(0.6, 0.0) && around(-0.6, 0.0) && around(0.0, 0.6) && around(0.0, -0.6));
    assert_eq!(blocked(found.environment()), 0);
    // Rays passed at the border of the window; the wall beyond its sides was unobserved.
    assert!(found.areas.open > 0.05 && found.areas.unseen > 0.05, "{:?}", found.areas);
    // A filled hole is found.
    let mut filled = found.environment().clone();
    let corners = [[2.0, -0.4, -0.4], [2.0, 0.4, -0.4], [2.0, 0.4, 0.4], [2.0, -0.4, 0.4]].map(Vec3::from).to_vec();
    let mesh = Mesh::new("pane", corners, vec![Polygon::new(vec![0, 1, 2, 3], 0)], PolygonOrder::Given).unwrap();
    filled.insert(NewObject::new("pane", Pose::IDENTITY, mesh.into())).unwrap();
    assert_eq!(blocked(&filled), 121, "planted");
}

/// A rough model: the wall and the floor of one object are 10 cm and 6 cm off, and the window is not known.
#[test]
fn a_rough_model_is_corrected_and_keeps_its_paths() {
    let mut rough = empty();
    let wall = cuboid(Vec3::new(2.1, -2.0, -1.0), Vec3::new(2.3, 2.0, 2.0));
    let floor = cuboid(Vec3::new(0.5, -2.0, -1.2), Vec3::new(2.0, 2.0, -1.06));
    rough.insert(NewObject::new("building/wall", Pose::IDENTITY, wall.into())).unwrap();
    rough.insert(NewObject::new("building/floor", Pose::IDENTITY, floor.into())).unwrap();
    let found = explore(&rough, Known::Rough, &views(ahead(9).map(|pose| (windowed(), pose))));
    let object = |name: &str| found.environment().object(name).unwrap().world_bounds();
    let (wall, floor) = (object("building/wall"), object("building/floor"));
    assert!((wall.min.x - 2.0).abs() < 0.01, "{}", wall.min);
    // The unobserved side keeps its thickness.
    assert!((wall.max.x - 2.2).abs() < 0.01 && (floor.max.z + 1.0).abs() < 0.01, "{} {}", wall.max, floor.max);
    assert!(found.opened > 0.4, "{}", found.opened);
    let front = |y: f64, z: f64| is_blocked(found.environment(), DVec3::new(1.0, y, z), DVec3::new(2.1, y, z));
    assert!(!front(0.0, 0.0) && !front(0.2, 0.2) && front(1.0, 0.0));
    assert!(found.unexplained < 0.1, "{}", found.unexplained);
}

/// Exploring on finds nothing new in known places, and the rest under the next numbers.
#[test]
fn exploring_on_adds_what_is_new() {
    let first = views(ahead(9).map(|pose| (windowed(), pose)));
    let found = explore(&Environment::new(), Known::Explored, &first);
    let again = explore(found.environment(), Known::Explored, &first);
    assert!(again.polygons() < found.polygons() / 5 + 3, "{} of {}", again.polygons(), found.polygons());
    let mut more = windowed();
    let chest = cuboid(Vec3::new(1.0, -0.9, -1.0), Vec3::new(1.4, -0.4, -0.5));
    more.insert(NewObject::new("chest", Pose::IDENTITY, chest.into())).unwrap();
    let next = explore(found.environment(), Known::Explored, &views(ahead(9).map(|pose| (more.clone(), pose))));
    let is_front = |p: DVec3| p.x < 1.05 && p.y < -0.35;
    let new: Vec<String> = next.objects.iter().map(|o| o.path.clone()).collect();
    assert!(new.iter().any(|name| name.starts_with("explored/")), "{new:?}");
    assert!(
        next.environment()
            .objects()
            .iter()
            .any(|o| (0..o.mesh.polygon_count() as u32).any(|k| o.polygon_in_world(k).into_iter().any(is_front)))
    );
    // Known surfaces keep their bits, except for openings.
    for later in [&again, &next] {
        let known = found.environment().objects().iter().filter(|o| !o.is_deleted());
        let pairs: Vec<_> = known.map(|o| (o, later.environment().object(&o.name).unwrap())).collect();
        assert!(pairs.iter().all(|(a, b)| a.world_from_object == b.world_from_object));
        let is_same = |(a, b): &&(&Object, &Object)| a.mesh.vertices() == b.mesh.vertices();
        let same = pairs.iter().filter(is_same).count();
        println!("{same} of {} objects are the same, {:.4} m2 opened", pairs.len(), later.opened);
        assert!(later.opened < 0.05 && (later.opened > 0.0 || same == pairs.len()), "{same} of {}", pairs.len());
    }
}
