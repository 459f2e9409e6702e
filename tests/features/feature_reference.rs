//! Compares the visibility of points with `data/reference/*.features.csv`: mesh vertices count as visible if Embree
//! finds nothing on their ray that is nearer by more than 2 mm + 0.1 %.
//!
//! For hits nearer by less than this tolerance, either answer is accepted.

use presight_testkit as common;

use common::data;
use glam::{DMat3, DQuat, DVec3};
use presight_features::{FeatureSettings, PlacedFeature, Visibility, predict_features};
use presight_model::environment::{Existence, Feature, FeatureShape, Properties};
use presight_model::geometry::{Aabb, Pose};
use presight_model::index::{QueryResult, Region};
use presight_model::sensor::{Camera, Geometry, Sensor, SensorSpec};
use presight_model::world::World;
use presight_studies::index::polygon_meets;
use serde_json::Value;

const Z_UP_FROM_Y_UP: DMat3 = DMat3::from_cols(DVec3::X, DVec3::Z, DVec3::NEG_Y);

fn number(v: &Value) -> f64 {
    v.as_f64().expect("a number")
}

fn camera(list: &Value) -> Sensor {
    let get = |key: &str| number(&list[key]);
    let (w, h) = (get("width") as u32, get("height") as u32);
    let camera = Camera::pinhole(w, h, get("fx"), get("fy"), get("cx"), get("cy"));
    Sensor::new(SensorSpec::new("embree", "video", Geometry::Camera(camera))).unwrap()
}

fn pose(view: &Value, sensor: &Sensor) -> Pose {
    let row = |r: usize| [0, 1, 2, 3].map(|c| number(&view["world_from_camera"][r][c]));
    let rows = [row(0), row(1), row(2)];
    let column = |c: usize| DVec3::new(rows[0][c], rows[1][c], rows[2][c]);
    let world_from_optical = Z_UP_FROM_Y_UP * DMat3::from_cols(column(0), column(1), column(2));
    let world_from_body = world_from_optical * sensor.body_from_image().transpose();
    Pose::new(Z_UP_FROM_Y_UP * column(3), DQuat::from_mat3(&world_from_body)).unwrap()
}

/// A vertex on all polygons within a few millimetres of it.
fn placed(world: &World, id: u32, at: DVec3) -> PlacedFeature {
    let around = Region::cuboid(&Aabb { min: at - 1e-3, max: at + 1e-3 });
    let mut found = QueryResult::default();
    world.index().query(world.environment(), &around, &mut found);
    let on = |slot: &u32| world.environment().polygon_in_world(*slot).is_some_and(|c| polygon_meets(&around, &c));
    let shape = FeatureShape::Point { at, covariance: DMat3::ZERO };
    let (existence, properties) = (Existence::default(), Properties::default());
    let feature = Feature { id, name: None, object: None, shape, existence, properties };
    PlacedFeature { feature: feature.into(), object: None, slots: found.all().filter(on).collect() }
}

#[derive(Default)]
struct Count {
    compared: usize,
    left_out: usize,
    wrong: Vec<String>,
    wrong_by_rays: usize,
}

fn check(world: &World, list: &Value, view: &Value, count: &mut Count) {
    let sensor = camera(list);
    let pose = pose(view, &sensor);
    let file = view["file"].as_str().expect("a name");
    let Some(path) = data::file(&format!("reference/{file}.features.csv")) else { return };
    let text = std::fs::read_to_string(path).unwrap();
    let rows: Vec<Vec<f64>> = text
        .lines()
        .filter(|l| !l.starts_with('#') && !l.trim().is_empty())
        .map(|l| l.split(',').map(|w| w.trim().parse().expect("a number")).collect())
        .collect();
    let features: Vec<PlacedFeature> =
        (1..).zip(&rows).map(|(id, r)| placed(world, id, Z_UP_FROM_Y_UP * DVec3::new(r[0], r[1], r[2]))).collect();
    let images = common::reference(&common::plan(world, &sensor, &pose));
    let [by_pixels, by_rays] = [Visibility::Image, Visibility::Rays].map(|visibility| {
        let options = FeatureSettings { visibility, ..FeatureSettings::default() };
        predict_features(world, &sensor, &pose, &images, &features, &options).unwrap()
    });
    for (row, (seen, truth)) in rows.iter().zip(by_pixels.features.iter().zip(&by_rays.features)) {
        let [u, v, visible, first, distance] = [3, 4, 6, 7, 8].map(|i| row[i]);
        let clear = visible == 1.0 && first >= distance * (1.0 - 1e-6);
        if visible == 1.0 && !clear {
            count.left_out += 1;
            continue;
        }
        count.compared += 1;
        let (u2, v2) = sensor
            .project(sensor.body_from_image().transpose() * pose.inverse().transform_point(seen.points_world[0]))
            .expect("in view");
        assert!((u - u2).hypot(v - v2) < 1e-3, "{file}: {u} {v} is at {u2} {v2}");
        if (seen.visible_fraction == 1.0) != clear {
            count.wrong.push(format!("{file} {}: {:?}, {row:?}", seen.feature.id, seen.hidden));
        }
        count.wrong_by_rays += usize::from((truth.visible_fraction == 1.0) != clear);
    }
}

#[test]
fn vertices_have_the_visibility_that_embree_finds() {
    let Some(list) = data::file("reference/reference.json") else { return };
    let list: Value = serde_json::from_str(&std::fs::read_to_string(list).unwrap()).unwrap();
    let mut all = Count::default();
    for (scene, entry) in list["scenes"].as_object().expect("scenes") {
        let Some(world) = data::scene(scene, true) else { return };
        let mut count = Count::default();
        for view in entry["views"].as_array().expect("views") {
            check(&world, &list, view, &mut count);
        }
        let Count { compared, left_out, wrong, wrong_by_rays } = &count;
        eprintln!(
            "{scene}: {compared} vertices, {left_out} within the tolerance left out, {} wrong, {wrong_by_rays} by rays",
            wrong.len()
        );
        all.compared += compared;
        all.wrong_by_rays += wrong_by_rays;
        all.wrong.append(&mut count.wrong);
    }
    let some = &all.wrong[..all.wrong.len().min(12)];
    assert!(all.compared > 3000, "{}", all.compared);
    assert!(all.wrong.is_empty() && all.wrong_by_rays == 0, "{} wrong: {some:#?}", all.wrong.len());
}
