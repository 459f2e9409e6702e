//! Every way in which a mirrored cube enters an environment.

use super::{BOX, CUBOID_FACES, INSIDE, ROOM, check_on_cpu, corners, cube, one_sided};
use crate::build::{Folder, Gltf, U16};
use glam::{DAffine3, DVec3};
use presight_model::change::Change;
use presight_model::environment::{Environment, NewObject};
use presight_model::geometry::Pose;
use presight_model::world::World;
use presight_read::gltf::{ImportOptions, import, write_glb};
use serde_json::{Value, json};

/// A file with the cube as mesh 0, of a one-sided material; its front sides are outside, or inside.
fn gltf(outside: bool, nodes: &[Value]) -> Gltf {
    let mut g = Gltf::new();
    let positions = g.positions(&corners().iter().map(|p| p.to_array()).collect::<Vec<_>>());
    let triangle = |a: u32, b: u32, c: u32| if outside { [a, b, c] } else { [a, c, b] };
    let triangles = CUBOID_FACES.iter().flat_map(|f| [triangle(f[0], f[1], f[2]), triangle(f[0], f[2], f[3])]);
    let indices = g.indices(U16, &triangles.flatten().collect::<Vec<_>>());
    g.mesh(json!([{"attributes": {"POSITION": positions}, "indices": indices, "material": 0}]));
    g.json["materials"] = json!([{"name": "plate", "extras": {"presight": {"one_sided": true}}}]);
    nodes.iter().for_each(|node| {
        g.node(node.clone());
    });
    g
}

/// Node trees that place the cube between x = 2 and x = 3, mirrored by one node or another.
fn trees() -> Vec<(&'static str, Vec<Value>)> {
    let leaf = |at: f64, scale: [f64; 3]| json!({"name": "leaf", "mesh": 0, "translation": [at, 0, 0], "scale": scale});
    let hall = |scale: [f64; 3]| json!({"name": "hall", "children": [1], "scale": scale});
    // Column by column; mirrors x.
    let matrix = json!([-1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 2.5, 0, 0, 1]);
    vec![
        ("one node", vec![leaf(2.5, [-1.0, 1.0, 1.0])]),
        ("one node, in y", vec![leaf(2.5, [1.0, -1.0, 1.0])]),
        ("one node, in z", vec![leaf(2.5, [1.0, 1.0, -1.0])]),
        ("one node, in all", vec![leaf(2.5, [-1.0, -2.0, -0.7])]),
        ("a matrix", vec![json!({"name": "leaf", "mesh": 0, "matrix": matrix})]),
        ("its parent", vec![hall([-1.0, 1.0, 1.0]), leaf(-2.5, [1.0, 1.0, 1.0])]),
        ("both", vec![hall([-1.0, 1.0, 1.0]), leaf(-2.5, [-1.0, 1.0, 1.0])]),
        ("both, in other axes", vec![hall([1.0, -2.0, 1.0]), leaf(2.5, [-1.0, 1.0, 1.0])]),
        ("its parent, not evenly", vec![hall([-0.5, 2.0, 0.8]), leaf(-5.0, [2.0, 0.5, 1.0])]),
    ]
}

fn imported(outside: bool, nodes: &[Value], merge: bool) -> Environment {
    let folder = Folder::new();
    let options = ImportOptions { merge, ..ImportOptions::default() };
    import(folder.write("s.glb", &gltf(outside, nodes).glb()), &options).unwrap().environment
}

#[test]
fn a_scene_file_mirrors_by_any_node() {
    for (what, nodes) in trees() {
        for merge in [true, false] {
            check_on_cpu(what, &imported(true, &nodes, merge), BOX);
            check_on_cpu(what, &imported(false, &nodes, merge), ROOM);
        }
    }
}

#[test]
fn the_frame_of_the_scene_may_mirror_too() {
    let sidecar = "format = 1\n[material.plate]\none_sided = true\n";
    for (what, nodes) in trees() {
        let scene = gltf(true, &nodes).import_with(&ImportOptions::default(), Some(sidecar)).unwrap().environment;
        assert!(scene.materials()[0].one_sided);
        check_on_cpu(what, &scene, BOX);
    }
}

#[test]
fn an_exported_scene_keeps_its_fronts() {
    let folder = Folder::new();
    for (what, nodes) in trees() {
        let path = folder.path("again.glb");
        write_glb(&path, &imported(true, &nodes, true)).unwrap();
        check_on_cpu(what, &import(&path, &ImportOptions::default()).unwrap().environment, BOX);
        // By its triangles and matrices alone, as other programs read it.
        let bytes = std::fs::read(&path).unwrap();
        let (at, name) = (bytes.windows(8).position(|w| w == b"presight"), b"elsewise");
        let mut plain = bytes.clone();
        for start in (0..bytes.len() - 8).filter(|i| at.is_some() && &bytes[*i..i + 8] == b"presight") {
            plain[start..start + 8].copy_from_slice(name);
        }
        let sidecar = "format = 1\n[material.plate]\none_sided = true\n";
        folder.write("plain.materials.toml", sidecar.as_bytes());
        let plain = import(folder.write("plain.glb", &plain), &ImportOptions::default()).unwrap().environment;
        assert!(plain.materials()[0].one_sided);
        check_on_cpu(what, &plain, BOX);
    }
}

/// The library's own interface: the mirror is in `object_from_mesh`.
#[test]
fn an_inserted_object_mirrors_and_keeps_its_fronts_as_it_moves() {
    for scale in [DVec3::new(-1.0, 1.0, 1.0), DVec3::new(1.0, 1.0, -1.0), DVec3::new(-1.0, -2.0, -0.5)] {
        for (outside, expected) in [(true, BOX), (false, ROOM)] {
            let object_from_mesh = DAffine3::from_scale(scale);
            let far = Pose { translation: DVec3::new(40.0, 1.0, 0.0), ..Pose::IDENTITY };
            let object = NewObject { object_from_mesh, ..NewObject::new("hall/cube", far, cube(outside)) };
            let mut world = World::new(one_sided());
            world.apply(Change::InsertObject(object)).unwrap();
            // The object alone, then back, then with its group.
            let here = Pose { translation: INSIDE, ..Pose::IDENTITY };
            let mover = |name: &str, pose| Change::MoveObject { name: name.into(), world_from_object: pose };
            let back = world.apply(mover("hall/cube", here)).unwrap();
            check_on_cpu("moved", world.environment(), expected);
            world.apply(back).unwrap();
            let frame = world.environment().frame("hall").unwrap();
            let shift = INSIDE - far.translation;
            world.apply(mover("hall", Pose { translation: frame.translation + shift, ..frame })).unwrap();
            check_on_cpu("moved with its group", world.environment(), expected);
        }
    }
}

#[cfg(feature = "script")]
#[test]
fn a_script_mirrors_shapes_and_imports_mirrored_nodes() {
    let folder = Folder::new();
    let load = |text: &str| {
        let path = folder.write("s.rhai", text.as_bytes());
        presight_read::script::load(path, &ImportOptions::default(), &mut |_| {}).unwrap().environment
    };
    let plate = "material(\"plate\", #{ one_sided: true });\n";
    // A box stands on its frame's floor.
    for scale in ["1", "-1", "-1, 1, 1", "1, -1, 1", "1, 1, -1", "-1, -1, 1"] {
        let low = if scale.ends_with("-1") { 0.5 } else { -0.5 };
        let text = format!(
            "{plate}place(\"cube\", box(1, 1, 1).made_of(\"plate\").scale({scale}).translate(0, 0, {low}), pose(2.5, 0, 0));"
        );
        check_on_cpu(scale, &load(&text), BOX);
    }
    for (what, nodes) in trees() {
        folder.write("m.glb", &gltf(true, &nodes).glb());
        check_on_cpu(what, &load("place(\"m\", import_gltf(\"m.glb\"));"), BOX);
    }
}

#[cfg(feature = "store")]
mod stored {
    use super::*;
    use presight_store as store;
    use presight_store::{Note, Store};

    fn note() -> Note {
        Note::new("test", 1.0)
    }

    #[test]
    fn a_store_keeps_fronts() {
        for (what, nodes) in trees() {
            let folder = Folder::new();
            let path = folder.path("s.presight");
            store::create(&path, &imported(true, &nodes, true), &note()).unwrap();
            check_on_cpu(what, &store::read(&path).unwrap(), BOX);
        }
    }

    /// The cube's pose in the file does not count, so it is inserted at its place here.
    #[test]
    fn a_library_file_keeps_fronts() {
        for (what, nodes) in trees() {
            for (outside, expected) in [(true, BOX), (false, ROOM)] {
                let folder = Folder::new();
                let path = folder.path("s.presight");
                store::create(&path, &one_sided(), &note()).unwrap();
                folder.write("cube.glb", &gltf(outside, &nodes).glb());
                let mut store = Store::open(&path).unwrap();
                let line = r#"{"op":"insert_object","object":"cube","pose":[2.5,0,0,0,0,0],"from":"cube.glb"}"#;
                let mut batch = store.batch().unwrap();
                batch.apply_line(line, cube_folder(&folder).as_path(), &note()).unwrap();
                batch.commit().unwrap();
                check_on_cpu(what, store.world().environment(), expected);
                check_on_cpu(what, &store::read(&path).unwrap(), expected);
            }
        }
    }

    fn cube_folder(folder: &Folder) -> std::path::PathBuf {
        folder.path(".")
    }
}
