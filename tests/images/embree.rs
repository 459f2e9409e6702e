//! Compares the reference with images that Embree rendered of the same scenes (`data/reference`).
//!
//! The depth decides. Ids are compared only at stable pixels, and another id is accepted where the depth is the same,
//! because the models have coincident faces. All rays within 0.02 pixels of a stable pixel hit the same triangle.

#![expect(clippy::print_stderr, reason = "the test prints the agreement")]

use presight_testkit as common;

use common::data;
use flate2::read::GzDecoder;
use glam::{DMat3, DQuat, DVec3};
use presight_model::geometry::Pose;
use presight_model::sensor::{Camera, Geometry, RayTable, Sensor, SensorSpec};
use presight_model::world::World;
use presight_predict::request::Request;
use presight_render::plan::{FramePlan, IdScheme, Images, Outputs};
use presight_render::verify::Precision;
use serde_json::Value;
use std::io::Read;

/// Relative; Embree's poses were written with 12 digits and its depths as f32.
const TOLERANCE: f32 = 1e-5;
const Z_UP_FROM_Y_UP: DMat3 = DMat3::from_cols(DVec3::X, DVec3::Z, DVec3::NEG_Y);

fn bytes(name: &str) -> Vec<u8> {
    let path = data::file(&format!("reference/{name}.gz")).expect("the file of the list");
    let mut bytes = Vec::new();
    GzDecoder::new(std::fs::File::open(path).unwrap()).read_to_end(&mut bytes).unwrap();
    bytes
}

fn words(name: &str) -> Vec<[u8; 4]> {
    bytes(name).chunks_exact(4).map(|c| c.try_into().unwrap()).collect()
}

fn floats(name: &str) -> Vec<f32> {
    words(name).into_iter().map(f32::from_le_bytes).collect()
}

/// Ids of the images start at 1; Embree's start at 0 with a special number for no hit.
fn ids(name: &str) -> Vec<u32> {
    words(name).into_iter().map(|w| u32::from_le_bytes(w).wrapping_add(1)).collect()
}

fn number(v: &Value) -> f64 {
    v.as_f64().expect("a number")
}

fn vector(v: &Value) -> DVec3 {
    DVec3::new(number(&v[0]), number(&v[1]), number(&v[2]))
}

fn images(world: &World, sensor: &Sensor, pose: &Pose) -> Images {
    let request = Request::of(Outputs::ALL).with_ids(IdScheme::Source);
    let plan = FramePlan::new(world, sensor, pose, &request).expect("a valid pose");
    let images = common::reference(&plan);
    let tiles = common::engines::cpu_by_tiles(2)(&plan);
    common::compare_or_show(&images, &tiles, &plan, Precision::F64).check(1e-4).unwrap();
    images
}

/// Compares lengths, then depths, then ids; returns the number of stable pixels with equal depth.
fn check(name: &str, depth: &[f32], id: &[u32], images: &[f32], polygon_id: &[u32], stable: &[u8]) -> usize {
    assert_eq!((depth.len(), id.len(), stable.len()), (images.len(), polygon_id.len(), images.len()), "{name}");
    let mut agree = 0;
    let mut other_depth = Vec::new();
    for at in (0..depth.len()).filter(|at| stable[*at] == 1) {
        let (theirs, ours) = (depth[at], images[at]);
        let same = theirs == ours || (theirs - ours).abs() <= TOLERANCE * theirs;
        if same {
            agree += 1;
        } else {
            other_depth.push((at, theirs, ours, id[at], polygon_id[at]));
        }
    }
    let ids_apart = (0..id.len()).filter(|at| stable[*at] == 1 && id[*at] != polygon_id[*at]).count();
    eprintln!("{name}: {agree} depths agree, {} do not, {ids_apart} other ids at the same depth", other_depth.len());
    assert!(other_depth.is_empty(), "{name}: {:?}", &other_depth[..other_depth.len().min(5)]);
    agree
}

fn check_scene(scene: &str, entry: &Value, intrinsics: &Value) {
    let Some(world) = data::scene(scene, false) else {
        return;
    };
    let get = |key: &str| number(&intrinsics[key]);
    let (w, h) = (get("width") as u32, get("height") as u32);
    let camera = Camera::pinhole(w, h, get("fx"), get("fy"), get("cx"), get("cy"));
    let sensor = Sensor::new(SensorSpec::new("embree", "video", Geometry::Camera(camera))).unwrap();
    for view in entry["views"].as_array().expect("views") {
        let file = view["file"].as_str().expect("a name");
        let rows: Vec<Vec<f64>> =
            (0..3).map(|r| (0..4).map(|c| number(&view["world_from_camera"][r][c])).collect()).collect();
        let column = |c: usize| DVec3::new(rows[0][c], rows[1][c], rows[2][c]);
        let world_from_optical = Z_UP_FROM_Y_UP * DMat3::from_cols(column(0), column(1), column(2));
        let world_from_body = world_from_optical * sensor.body_from_image().transpose();
        let pose = Pose::new(Z_UP_FROM_Y_UP * column(3), DQuat::from_mat3(&world_from_body)).unwrap();
        let ours = images(&world, &sensor, &pose);
        let stable = bytes(&format!("{file}.stable.u8"));
        let (depth, id) = (floats(&format!("{file}.depth.f32")), ids(&format!("{file}.gid.u32")));
        assert!(check(file, &depth, &id, &ours.depth_z, &ours.polygon_id, &stable) > 10_000);
    }
    let lidar = &entry["lidar"][0];
    let file = lidar["file"].as_str().expect("a name");
    let at = |row: u32, column: u32| {
        let elevation = (-25.0 + 40.0 * f64::from(row) / 31.0).to_radians();
        let azimuth = (f64::from(column) * 0.5).to_radians();
        Z_UP_FROM_Y_UP * DVec3::new(elevation.cos() * azimuth.sin(), elevation.sin(), elevation.cos() * azimuth.cos())
    };
    let rays = (0..32).flat_map(|r| (0..720).map(move |c| at(r, c))).collect();
    let table = RayTable::new(720, 32, rays).unwrap();
    let sensor = Sensor::new(SensorSpec::new("lidar", "laser", Geometry::Rays(table))).unwrap();
    let pose = Pose::new(Z_UP_FROM_Y_UP * vector(&lidar["position"]), DQuat::IDENTITY).unwrap();
    let ours = images(&world, &sensor, &pose);
    let (range, id) = (floats(&format!("{file}.range.f32")), ids(&format!("{file}.gid.u32")));
    // No mask was stored, so a pixel next to a jump in range or id counts as unstable.
    let stable: Vec<u8> = (0..id.len())
        .map(|i| {
            let (row, column) = (i / 720, i % 720);
            let beside = [row * 720 + (column + 1) % 720, row * 720 + (column + 719) % 720, (i + 720) % id.len()];
            u8::from(beside.iter().all(|j| id[*j] == id[i]))
        })
        .collect();
    assert!(check(file, &range, &id, &ours.range, &ours.polygon_id, &stable) > 1000);
}

#[test]
fn depths_and_ranges_equal_embrees() {
    let Some(list) = data::file("reference/reference.json") else {
        return;
    };
    let list: Value = serde_json::from_str(&std::fs::read_to_string(list).unwrap()).unwrap();
    for (scene, entry) in list["scenes"].as_object().expect("scenes") {
        check_scene(scene, entry, &list);
    }
}
