//! What a sensor should not be believed: glass, noise without a surface. And what a store may hold.

use super::rooms::{ahead, blocked, explore, sensor, views_of, windowed};
use glam::Vec3;
use presight_explore::{Exploration, ExploreOptions, Known, MAX_MARKS, Views};
use presight_model::environment::{Appearance, Environment, Mark, MarkKind, Material, NewObject};
use presight_model::error::ErrorKind;
use presight_model::geometry::{Aabb, Pose, SensorPose};
use presight_model::measured::{Frame, Measurement};
use presight_model::sensor::{Angles, Geometry, Noise, Scanner, Sensor, SensorSpec};
use presight_testkit::Random;

/// A pane in the window reflects in one frame of nine, as glass does at right angles, and lets the rays of the others
/// through.
#[test]
fn glass_that_rays_go_through_leaves_nothing() {
    let with_pane = |appearance: Appearance| {
        let mut real = windowed();
        let mut glass = Material::named("glass");
        glass.appearance.insert("laser".to_owned(), appearance);
        let material = real.add_material(glass).unwrap();
        let corners = [[2.0, -0.4, -0.4], [2.0, 0.4, -0.4], [2.0, 0.4, 0.4], [2.0, -0.4, 0.4]].map(Vec3::from);
        let pane = presight_testkit::scenes::mesh(&[corners.to_vec()]).with_materials(|_| material);
        real.insert(NewObject::new("pane", Pose::IDENTITY, pane.into())).unwrap();
        // The sensor's rays continue to a wall behind.
        let wall = [[4.0, -3.0, -2.0], [4.0, 3.0, -2.0], [4.0, 3.0, 2.0], [4.0, -3.0, 2.0]].map(Vec3::from);
        real.insert(NewObject::new("back", Pose::IDENTITY, presight_testkit::scenes::mesh(&[wall.to_vec()]).into()))
            .unwrap();
        real
    };
    let reflecting = |count: usize| {
        let appearance = move |k: usize| if k < count { Appearance::Opaque } else { Appearance::Transparent };
        let views =
            views_of(&sensor(), ahead(9).enumerate().map(|(k, pose)| (with_pane(appearance((k + 5) % 9)), pose)));
        blocked(explore(&Environment::new(), Known::Explored, &views).environment())
    };
    assert_eq!(reflecting(1), 0);
    // A pane that reflects in each frame is a surface like others.
    assert_eq!(reflecting(9), 121, "planted");
}

/// Leaves, grass, dust: distances without a surface.
#[test]
fn nothing_flat_is_an_error_or_next_to_nothing() {
    let (sensor, mut random) = (sensor(), Random(3));
    let mut views = Views::default();
    for (k, pose) in ahead(5).enumerate() {
        let ranges = (0..96 * 72).map(|_| random.uniform(1.0, 7.0) as f32).collect();
        views
            .push(&Frame::new(k as f64, sensor.clone(), Measurement::Range(ranges)).unwrap(), SensorPose::new(pose))
            .unwrap();
    }
    match Exploration::of(&Environment::new(), Known::Explored, &views, &ExploreOptions::default()) {
        Err(e) => assert!(e.kind() == ErrorKind::Invalid && e.to_string().contains("nothing flat"), "{e}"),
        Ok(found) => assert!(found.areas.surface < 0.5, "{:?}", found.areas),
    }
}

/// Trees: points that lie decimetres apart, no two of them on one surface. Nearly all of what lies between them stays
/// open.
#[test]
fn a_scan_of_leaves_becomes_no_wall() {
    let angles = |first: f64, count: u32| Angles::Uniform { start_deg: first, step_deg: 1.5, count };
    let scanner = Scanner { azimuth: angles(-40.0, 54), elevation: angles(-15.0, 20), beam_height_deg: None };
    let spec = SensorSpec::new("sparse", "laser", Geometry::Scanner(scanner)).with_limits(0.2, 50.0);
    let sensor = Sensor::new(spec.with_noise(Noise { range_sigma: 0.02, ..Noise::default() })).unwrap();
    let share = |ranges: Vec<f32>| {
        let mut views = Views::default();
        let frame = Frame::new(0.0, sensor.clone(), Measurement::Range(ranges)).unwrap();
        views.push(&frame, SensorPose::IDENTITY).unwrap();
        let found = explore(&Environment::new(), Known::Explored, &views);
        found.areas.surface / (found.areas.surface + found.areas.unseen)
    };
    let mut random = Random(5);
    let leaves = share((0..54 * 20).map(|_| random.uniform(5.0, 30.0) as f32).collect());
    let ahead = |pixel: u32| (sensor.body_from_image() * sensor.ray(pixel % 54, pixel / 54).unwrap()).x;
    let wall = share((0..54 * 20).map(|pixel| (10.0 / ahead(pixel)) as f32).collect());
    assert!(leaves < 0.05 && wall > 0.8, "{leaves} {wall}");
}

/// Marks that a store has count.
#[test]
fn a_store_has_at_most_ten_thousand_marks_of_unseen_places() {
    let views = views_of(&sensor(), ahead(9).map(|pose| (windowed(), pose)));
    let first = explore(&Environment::new(), Known::Explored, &views);
    let marks = |e: &Environment| e.marks().filter(|(_, mark)| mark.kind == MarkKind::Unseen).count();
    let own = marks(first.environment());
    assert!(own > 20, "{own}");
    let mut known = presight_testkit::scenes::empty();
    let far = presight_testkit::scenes::cuboid(Vec3::new(50.0, 0.0, 0.0), Vec3::new(51.0, 1.0, 1.0));
    known.insert(NewObject::new("far", Pose::IDENTITY, far.into())).unwrap();
    for k in 0..MAX_MARKS - 7 {
        let bounds = Aabb { min: glam::DVec3::splat(50.0), max: glam::DVec3::splat(51.0) };
        let mark = Mark { object: "far".into(), kind: MarkKind::Unseen, class: None, bounds: Some(bounds) };
        known.set_mark(&format!("unseen/far/{k}"), mark).unwrap();
    }
    let found = explore(&known, Known::Explored, &views);
    assert_eq!(marks(found.environment()), MAX_MARKS);
    // The largest are kept.
    let size = |mark: &Mark| mark.bounds.unwrap().size().to_bits();
    let all: Vec<u64> = first.environment().marks().map(|(_, mark)| size(mark)).collect();
    let is_new = |(name, _): &(&str, &Mark)| !name.starts_with("unseen/far/");
    let most = all.iter().max().unwrap();
    assert!(found.environment().marks().filter(is_new).any(|(_, mark)| size(mark) == *most));
}
