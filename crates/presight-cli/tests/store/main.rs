//! The stored environment: its content, its durability, and its refusals.

mod absent;
mod bad;
mod beliefs;
mod command;
use presight_testkit as common;
mod damage;
mod durable;
mod exports;
mod kill;
mod random;
mod undo;
mod updates;

use glam::{DMat3, DVec3, Vec3};
use presight::environment::{Environment, Material, Mesh, NewObject, Polygon, PolygonOrder};
use presight::features::{Existence, Feature, FeatureShape, Properties};
use presight::store;
use presight::store::Note;
use presight::{Change, Pose, World};
use presight_testkit::{CUBOID_FACES, cuboid_corners};
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::Arc;

/// The environment of a scene's file.
fn environment_of(path: impl AsRef<Path>) -> Environment {
    Arc::unwrap_or_clone(presight::Scene::open(path).unwrap().world.into_environment())
}

fn presight() -> Command {
    Command::new(env!("CARGO_BIN_EXE_presight"))
}

/// A box of six polygons with a material number for each face.
fn block(name: &str, size: f32, materials: [u16; 6]) -> Arc<Mesh> {
    let polygons = CUBOID_FACES.iter().zip(materials).map(|(f, m)| Polygon::new(f.to_vec(), m)).collect();
    let corners = cuboid_corners(Vec3::ZERO, Vec3::splat(size)).to_vec();
    Arc::new(Mesh::new(name, corners, polygons, PolygonOrder::Spatial).unwrap())
}

fn at(x: f64, y: f64, yaw: f64) -> Pose {
    Pose::from_xyz_rpy(DVec3::new(x, y, -0.0), 0.0, 0.0, yaw)
}

fn point(id: u32, x: f64, object: Option<&str>) -> Feature {
    Feature {
        id,
        name: Some(format!("p{id}")),
        object: object.map(str::to_owned),
        shape: FeatureShape::Point { at: DVec3::new(x, 0.1, -0.0), covariance: DMat3::from_diagonal(DVec3::splat(x)) },
        existence: Existence { p0: 0.75, confirmed: 1e9, rate: 0.1 },
        properties: Properties { strength: Some(0.3), contrast: None, normal: Some(DVec3::Z) },
    }
}

/// Objects of two meshes, two of them in groups, features, and a deleted object. One of the groups has a frame.
fn small() -> Environment {
    let mut environment = Environment::new();
    environment.add_material(Material::named("paint")).unwrap();
    let glass = Material { reflection: 0.1, color: [0.1, 0.2, 0.7], ..Material::named("glass") };
    environment.add_material(glass).unwrap();
    let (one, other) = (block("one", 1.0, [0, 0, 1, 0, 1, 0]), block("other", 0.5, [1; 6]));
    environment.insert(NewObject::new("a", at(3.0, 0.0, 0.1), one.clone())).unwrap();
    environment.insert(NewObject::new("gone", at(9.0, 0.0, 0.0), other.clone())).unwrap();
    environment.insert(NewObject::new("b", at(4.0, 2.0, 1.0), one.clone())).unwrap();
    environment.insert(NewObject::new("b/lid", at(4.0, 2.5, 1.0), other.clone())).unwrap();
    // Surfaces for the features in the world frame.
    environment.insert(NewObject::new("floor", at(0.0, 0.0, 0.0), one)).unwrap();
    environment.insert(NewObject::new("g/h/y", at(-3.0, 1.0, 0.3), other)).unwrap();
    environment.set_frame("g/h", Some(at(-3.0, 0.5, 0.7))).unwrap();
    environment.delete("gone").unwrap();
    let mut world = World::new(environment);
    for (id, object) in [(2, Some("a")), (5, None)] {
        let feature = point(id, 0.5, object);
        world.apply(Change::InsertFeature { class: "video".into(), feature }).unwrap();
    }
    Arc::unwrap_or_clone(world.into_environment())
}

fn create(folder: &Path, environment: &Environment) -> PathBuf {
    let path = folder.join("env.presight");
    store::create(&path, environment, &Note::new("test", 1.5)).unwrap();
    path
}

fn note(time: f64) -> Note {
    Note::new("because", time)
}

/// Change number `k` of an endless sequence over [`small`], and its line.
fn numbered(k: u64) -> (Change, String) {
    let x = k as f64 * 0.001 - 2.0;
    let pose = Pose { translation: DVec3::new(x, 1.0, 0.25), rotation: glam::DQuat::IDENTITY };
    let name = if k.is_multiple_of(2) { "a" } else { "b" };
    let mover = Change::MoveObject { name: name.into(), world_from_object: pose };
    let mut line = format!(r#"{{"op":"move","object":"{name}","pose":[{x:?},1,0.25,0,0,0,1]}}"#);
    let feature = point(100 + k as u32, 0.25, None);
    let insert = Change::InsertFeature { class: "radar".into(), feature };
    let id = 100 + k;
    let entry = format!(
        r#"{{"id":{id},"kind":"point","name":"p{id}","points":[[0.25,0.1,-0.0]],"sigma":0.5,"existence":0.75,"confirmed":1e9,"rate":0.1,"properties":{{"strength":0.3,"normal":[0,0,1]}}}}"#
    );
    let add = format!(r#"{{"op":"insert_feature","class":"radar","feature":{entry}}}"#);
    match k % 5 {
        0 => (insert, add),
        1 => {
            line = format!(r#"{{"op":"group","changes":[{line},{add}]}}"#);
            (Change::Group(vec![mover, insert]), line)
        }
        _ => (mover, line),
    }
}

/// The shared data's hospital, if available.
fn hospital() -> Option<PathBuf> {
    common::data::file("env/hospital.glb")
}
