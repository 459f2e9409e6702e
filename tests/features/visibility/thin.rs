//! Faces closer together than a layer's tolerance, and polygons that a feature intersects at a small angle.
//!
//! The truth of each scene is the side of a plane, calculated in each test.

use super::common::{plan, reference, scenes};
use super::{FeatureSettings, PlacedFeature, predict_features};
use glam::{DMat3, DVec3, Vec3};
use presight_features::{Hidden, SeenFeature, Visibility, place};
use presight_model::environment::NewObject;
use presight_model::environment::{Existence, Feature, FeatureLayer, FeatureShape, Properties};
use presight_model::geometry::Pose;
use presight_model::sensor::Sensor;
use presight_model::world::World;
use std::sync::Arc;

type Polygons<'a> = &'a [&'a [[f32; 3]]];

/// A world of polygons, each of them an object.
fn world(polygons: Polygons<'_>) -> World {
    let mut environment = scenes::empty();
    for (i, polygon) in polygons.iter().enumerate() {
        let mesh = scenes::mesh(&[polygon.iter().map(|p| Vec3::from(*p)).collect()]);
        environment.insert(NewObject::new(format!("{i}"), Pose::IDENTITY, Arc::new(mesh))).unwrap();
    }
    World::new(environment)
}

fn try_place(world: &World, shape: FeatureShape) -> presight_model::error::Result<Vec<PlacedFeature>> {
    let (existence, properties) = (Existence::default(), Properties::default());
    let feature = Feature { id: 1, name: None, object: None, shape, existence, properties };
    let layer =
        FeatureLayer { class: "video".into(), tolerance: 1e-3, features: vec![feature.into()], ..Default::default() };
    place(world, &layer)
}

fn segment(ends: [[f64; 3]; 2]) -> FeatureShape {
    FeatureShape::Segment { ends: ends.map(DVec3::from), covariances: [DMat3::ZERO; 2], cross: DMat3::ZERO }
}

/// One feature in a world; images and rays give the same result.
fn see(world: &World, sensor: &Sensor, pose: &Pose, shape: FeatureShape) -> SeenFeature {
    let placed = try_place(world, shape).unwrap();
    let images = reference(&plan(world, sensor, pose));
    let [image, rays] = [Visibility::Image, Visibility::Rays].map(|visibility| {
        let options = FeatureSettings { visibility, hidden: Hidden::Full, ..FeatureSettings::default() };
        predict_features(world, sensor, pose, &images, &placed, &options).unwrap().features.remove(0)
    });
    // For large patches the image samples other places.
    let near = if placed[0].feature.shape.is_area() { 0.02 } else { 1e-9 };
    assert!((image.visible_fraction - rays.visible_fraction).abs() < near, "{image:?} {rays:?}");
    image
}

fn both() -> [Sensor; 2] {
    [scenes::camera(400, 300), scenes::scanner(1440, 361)]
}

/// A book's face at x = 3 with its upper edge at z = 0.2, from y = -0.5 to 0.5. A cover in front of it, at this gap,
/// begins at y = 0, in the sensor's x-z plane, and extends beyond the edge: everything to the left of y = 0 is hidden,
/// whatever the gap.
#[test]
fn a_cover_hides_the_book_behind_it() {
    for gap in [0.2e-3f32, 0.5e-3, 0.9e-3, 2e-3, 5e-3] {
        let x = 3.0 - gap;
        let world = world(&[
            &[[3.0, -0.5, -0.5], [3.0, 0.5, -0.5], [3.0, 0.5, 0.2], [3.0, -0.5, 0.2]],
            &[[x, 0.0, -0.6], [x, 0.7, -0.6], [x, 0.7, 0.6], [x, 0.0, 0.6]],
        ]);
        for sensor in both() {
            let seen = see(&world, &sensor, &Pose::IDENTITY, segment([[3.0, -0.5, 0.2], [3.0, 0.5, 0.2]]));
            let name = &sensor.spec().name;
            assert!((seen.visible_fraction - 0.5).abs() < 0.01, "{name}, {gap}: {}", seen.visible_fraction);
            assert!((seen.visible[0].t[1] - 0.5).abs() < 0.01, "{name}, {gap}: {:?}", seen.visible);
            // The book's face as a patch: the same half is hidden.
            let corners = [[3.0, -0.5, -0.5], [3.0, 0.5, -0.5], [3.0, 0.5, 0.2], [3.0, -0.5, 0.2]].map(DVec3::from);
            let patch = FeatureShape::Patch { corners: corners.to_vec(), covariance: DMat3::ZERO };
            let seen = see(&world, &sensor, &Pose::IDENTITY, patch);
            assert!((seen.visible_fraction - 0.5).abs() < 0.02, "{name}, {gap}: {}", seen.visible_fraction);
        }
    }
}

/// A sheet-metal wall with both faces, and a box that touches it from behind. The box's upper edge is visible from
/// behind, over the box, but not through the sheet.
#[test]
fn a_sheet_hides_what_touches_it_from_behind() {
    for thickness in [0.1e-3f32, 0.5e-3, 1e-3, 2e-3, 5e-3] {
        let back = 3.0 + thickness;
        let face = |x: f32| [[x, -2.0, -2.0], [x, 2.0, -2.0], [x, 2.0, 2.0], [x, -2.0, 2.0]];
        let top = [[back, -0.5, 0.0], [back, 0.5, 0.0], [3.5, 0.5, 0.0], [3.5, -0.5, 0.0]];
        let world = world(&[&face(3.0), &face(back), &top]);
        // In f32 the edge lies on the box and on the wall's back within rounding.
        let x = f64::from(back);
        let edge = || segment([[x, -0.5, 0.0], [x, 0.5, 0.0]]);
        for sensor in both() {
            let name = &sensor.spec().name;
            let front = see(&world, &sensor, &Pose::from_xyz_rpy(DVec3::Z * 0.3, 0.0, 0.0, 0.0), edge());
            assert_eq!(front.visible_fraction, 0.0, "{name}, {thickness}");
            assert_eq!(front.hidden[0].by.map(|by| by.object), Some(0), "{name}, {thickness}");
            let turned = Pose::from_xyz_rpy(DVec3::new(5.0, 0.0, 0.3), 0.0, 0.0, std::f64::consts::PI);
            assert_eq!(see(&world, &sensor, &turned, edge()).visible_fraction, 1.0, "{name}, {thickness}");
        }
    }
}

/// The same wall without thickness: one polygon, or one that is stored twice. A shelf through it is visible from both
/// sides, and so is a line on the wall.
#[test]
fn a_sheet_without_thickness_hides_what_touches_it_from_behind() {
    let face = [[3.0, -2.0, -2.0], [3.0, 2.0, -2.0], [3.0, 2.0, 2.0], [3.0, -2.0, 2.0]];
    let board = |from: f32, to: f32| [[from, -0.5, 0.0], [from, 0.5, 0.0], [to, 0.5, 0.0], [to, -0.5, 0.0]];
    let behind: &[[f32; 3]] = &board(3.0, 3.5);
    let through: &[[f32; 3]] = &board(2.5, 3.5);
    let before: &[[f32; 3]] = &board(3.0, 2.5);
    let scenes: [(Polygons<'_>, [f64; 2]); 5] = [
        (&[&face, behind], [0.0, 1.0]),
        (&[&face, &face, behind], [0.0, 1.0]),
        (&[&face, before], [1.0, 0.0]),
        (&[&face, through], [1.0, 1.0]),
        (&[&face, &face], [1.0, 1.0]),
    ];
    for (k, (polygons, fractions)) in scenes.into_iter().enumerate() {
        let world = world(polygons);
        for sensor in both() {
            for (turn, expected) in [0.0, std::f64::consts::PI].into_iter().zip(fractions) {
                let pose = Pose::from_xyz_rpy(DVec3::new(3.0 - 3.0 * turn.cos(), 0.0, 0.3), 0.0, 0.0, turn);
                let seen = see(&world, &sensor, &pose, segment([[3.0, -0.5, 0.0], [3.0, 0.5, 0.0]]));
                let name = &sensor.spec().name;
                assert_eq!(seen.visible_fraction, expected, "{name}, {k}, {turn}");
                assert!(expected == 1.0 || seen.hidden[0].by.map(|by| by.object) == Some(0), "{name}, {k}: {seen:?}");
            }
        }
    }
}

/// The lower edge of a face that intersects the floor (z = 0) in the middle: the half below the floor is hidden,
/// however small the angle.
#[test]
fn the_floor_hides_what_leans_through_it() {
    for degrees in [0.1f64, 0.5, 1.0, 3.0, 5.0, 10.0] {
        let rise = 0.5 * degrees.to_radians().tan();
        let low = rise as f32;
        let world = world(&[
            &[[0.5, -3.0, 0.0], [6.0, -3.0, 0.0], [6.0, 3.0, 0.0], [0.5, 3.0, 0.0]],
            &[[2.0, -0.5, -low], [2.0, 0.5, low], [2.0, 0.5, 1.0], [2.0, -0.5, 1.0]],
        ]);
        let low = f64::from(low);
        let pose = Pose::from_xyz_rpy(DVec3::Z, 0.0, 0.4, 0.0);
        for sensor in both() {
            let name = &sensor.spec().name;
            let seen = see(&world, &sensor, &pose, segment([[2.0, -0.5, -low], [2.0, 0.5, low]]));
            let [visible] = &seen.visible[..] else { panic!("{name}, {degrees}: {:?}", seen.visible) };
            assert!((visible.t[0] - 0.5).abs() < 0.01 && visible.t[1] > 1.0 - 1e-9, "{name}, {degrees}: {visible:?}");
        }
    }
}

/// Two floors with a gap of 6 mm, and a ramp of 10 degrees that crosses their level in the middle of the gap. No part
/// of the segment is 1 mm off all polygons, but in the gap only the ramp is near, and the segment does not lie along
/// it.
#[test]
fn a_refusal_does_not_say_that_less_is_off_than_is_allowed() {
    let floor = |from: f32, to: f32| [[from, -1.0, 0.0], [to, -1.0, 0.0], [to, 1.0, 0.0], [from, 1.0, 0.0]];
    let rise = 0.2 * 10f32.to_radians().tan();
    let ramp = [[0.303, -1.0, -rise], [0.703, -1.0, rise], [0.703, 1.0, rise], [0.303, 1.0, -rise]];
    let world = world(&[&floor(0.0, 0.5), &floor(0.506, 1.0), &ramp]);
    let said = try_place(&world, segment([[0.1, 0.0, 0.0], [0.9, 0.0, 0.0]])).unwrap_err().to_string();
    assert!(said.contains("lies on no polygon at") && said.contains("within 0.001 m only touch or cross it"), "{said}");
    let said = try_place(&world, segment([[0.1, 0.0, 0.5], [0.9, 0.0, 0.5]])).unwrap_err().to_string();
    assert!(said.contains("m off its polygons") && said.contains("0.001 m is allowed"), "{said}");
}
