//! Occluders that no pixel shows, or that pixels show only elsewhere.

use super::common::scenes;
use super::{in_both_ways, predict};
use glam::{DMat3, DVec3};
use presight_features::{PlacedFeature, Reason};
use presight_model::environment::NewObject;
use presight_model::environment::{Existence, Feature, FeatureShape, Properties};
use presight_model::geometry::Pose;
use presight_model::world::World;
use presight_render::plan::Images;

/// A wall 5 m ahead, an occluder 2 m ahead, and an edge on the wall, 80 pixels long, with a sample every half pixel.
fn behind(occluder: &[Vec<glam::Vec3>]) -> (World, Vec<PlacedFeature>) {
    let mut environment = scenes::empty();
    let at = |x: f32, y: f32, z: f32| glam::Vec3::new(x, y, z);
    let wall = vec![at(5.0, -4.0, -4.0), at(5.0, 4.0, -4.0), at(5.0, 4.0, 4.0), at(5.0, -4.0, 4.0)];
    for (name, polygons) in [("wall", vec![wall].as_slice()), ("occluder", occluder)] {
        let new = NewObject::new(name, Pose::IDENTITY, std::sync::Arc::new(scenes::mesh(polygons)));
        environment.insert(new).unwrap();
    }
    let ends = [DVec3::new(5.0, 1.0, 0.1), DVec3::new(5.0, -1.0, 0.1)];
    let shape = FeatureShape::Segment { ends, covariances: [DMat3::ZERO; 2], cross: DMat3::ZERO };
    let (existence, properties) = (Existence::default(), Properties::default());
    let feature = Feature { id: 1, name: None, object: None, shape, existence, properties };
    (World::new(environment), vec![PlacedFeature { feature: feature.into(), object: None, slots: vec![0] }])
}

fn hidden_pixels_behind(occluder: &[Vec<glam::Vec3>]) -> (f64, Images) {
    let (world, placed) = behind(occluder);
    let (seen, images) = predict(&world, &scenes::camera(200, 150), &Pose::IDENTITY, &placed);
    let [f] = &seen.features[..] else { panic!("one feature") };
    assert!(f.hidden.iter().all(|h| h.reason == Reason::Occluded && h.by.is_some_and(|by| by.object == 1)));
    (80.0 * (1.0 - f.visible_fraction), images)
}

/// 0.6 pixels wide, between two columns of pixel centres: no image shows it.
#[test]
fn a_wire_between_the_pixels_hides() {
    let at = |y: f32, z: f32| glam::Vec3::new(2.0, y, z);
    let (hidden, images) =
        hidden_pixels_behind(&[vec![at(-0.003, -1.0), at(0.003, -1.0), at(0.003, 1.0), at(-0.003, 1.0)]]);
    assert!(!images.polygon_id.contains(&2), "the image shows it");
    assert!((hidden - 1.0).abs() < 1e-9, "{hidden}");
}

/// The tip of a triangle that pixels show only far from the place that it hides.
#[test]
fn a_tip_between_the_pixels_hides() {
    let at = |y: f32, z: f32| glam::Vec3::new(2.0, y, z);
    // The edge is in row 70. The tip is half a pixel above it, over a sample between two columns of pixel centres.
    let tip = vec![at(-0.0475, -0.6), at(0.0525, -0.6), at(0.0025, 0.045)];
    let (hidden, images) = hidden_pixels_behind(&[tip]);
    let shown = images.polygon_id.chunks(200).position(|row| row.contains(&2)).unwrap();
    assert!(shown > 71, "row {shown} shows it");
    assert!((hidden - 0.5).abs() < 1e-9, "{hidden}");
}

/// A screen of facets smaller than pixels: only some of them have a pixel.
#[test]
fn facets_under_a_pixel_hide() {
    let facet = |i: i32, j: i32| {
        let at = |a: i32, b: i32| glam::Vec3::new(2.0, (i + a) as f32 * 0.002, 0.03 + (j + b) as f32 * 0.002);
        [vec![at(0, 0), at(1, 0), at(1, 1)], vec![at(0, 0), at(1, 1), at(0, 1)]]
    };
    let screen: Vec<_> = (-50..50).flat_map(|i| (0..10).flat_map(move |j| facet(i, j))).collect();
    let (hidden, _) = hidden_pixels_behind(&screen);
    assert!((hidden - 20.0).abs() < 1e-9, "{hidden}");
}

/// Features slightly behind their wall: facets between the wall and the features hide them, although the wall covers
/// the whole image and hides the facets.
#[test]
fn facets_behind_the_wall_hide_features() {
    let facet = |i: i32, j: i32| {
        let at = |a: i32, b: i32| glam::Vec3::new(5.002, (i + a) as f32 * 0.05, (j + b) as f32 * 0.05);
        vec![at(0, 0), at(1, 0), at(1, 1), at(0, 1)]
    };
    let facets: Vec<_> = (-10..10).flat_map(|i| (-10..10).map(move |j| facet(i, j))).collect();
    let (world, mut placed) = behind(&facets);
    let at = |y: f64, z: f64| DVec3::new(5.005, y, z);
    let segment = FeatureShape::Segment {
        ends: [at(1.0, 0.11), at(-1.0, 0.11)],
        covariances: [DMat3::ZERO; 2],
        cross: DMat3::ZERO,
    };
    let corners = vec![at(1.0, 1.0), at(-1.0, 1.0), at(-1.0, -1.0), at(1.0, -1.0)];
    let patch = FeatureShape::Patch { corners, covariance: DMat3::ZERO };
    placed = [segment, patch]
        .into_iter()
        .map(|shape| {
            let mut placed = placed[0].clone();
            std::sync::Arc::make_mut(&mut placed.feature).shape = shape;
            placed
        })
        .collect();
    let [by_tiles, by_rays] = in_both_ways(&world, &scenes::camera(200, 150), &Pose::IDENTITY, &placed);
    assert!(by_tiles.features[0] == by_rays.features[0], "segments have the same samples");
    let seen: Vec<f64> = by_tiles.features.iter().map(|f| f.visible_fraction).collect();
    assert!((seen[0] - 0.5).abs() < 0.02 && (seen[1] - 0.75).abs() < 0.02, "{seen:?}");
}
