//! No code uses rayon's global pool, which panics where the system has no more threads.
#![cfg(feature = "script")]

use glam::DVec3;
use presight_features::generate::{GenerateOptions, generate};
use presight_features::{
    BoxOptions, BoxQuery, FeatureOptions, FeatureSettings, Visibility, add_boxes, place, predict_features,
};
use presight_model::geometry::{Pose, SensorPose};
use presight_model::index::IndexKind;
use presight_model::threads::Threads;
use presight_model::world::World;
use presight_predict::predict::{Backend, Options, Predictor};
use presight_predict::request::Request;
use presight_read::gltf;
use presight_read::gltf::ImportOptions;
use presight_read::preset;
use presight_render::plan::{FramePlan, Output, Outputs};
use presight_render::verify::{Precision, candidates};
use presight_studies::index::Scheme;
use presight_testkit::{self as common, forbid_global_pool};
use std::path::{Path, PathBuf};

/// Balls with enough polygons for parallel sorting of meshes and indexes.
const BALLS: &str = r#"
    place("ball", sphere(1, 256), pose(4, 0, 1, 0, 0, 0));
    place("large", sphere(2, 200), pose(0, 6, 1, 0, 0, 0));
    place("floor", box(20, 20, 0.1), pose(0, 0, -0.1, 0, 0, 0));
    "#;

/// The scene as a script, and as glTF made from it.
fn scene(folder: &Path) -> (PathBuf, PathBuf) {
    let (script, glb) = (folder.join("balls.rhai"), folder.join("balls.glb"));
    std::fs::write(&script, BALLS).unwrap();
    let made = presight_read::script::load(&script, &ImportOptions::default(), &mut |_| ()).unwrap();
    gltf::write_glb(&glb, &made.environment).unwrap();
    (script, glb)
}

#[test]
fn nothing_uses_the_global_pool() {
    forbid_global_pool();
    let folder = tempfile::tempdir().unwrap();
    let (_, glb) = scene(folder.path());
    let world = World::new(gltf::import(&glb, &ImportOptions::default()).unwrap().environment);
    for scheme in Scheme::ALL {
        let _ = world.reindexed(&scheme.tuned());
    }
    let (camera, pose) = (preset("video-camera").unwrap(), Pose::from_xyz_rpy(DVec3::Z, 0.0, 0.0, 0.0));
    let plan = common::plan(&world, &camera, &pose);
    let images = common::reference(&plan);
    assert_eq!(candidates(&plan, &[(256, 256)], Precision::F32).len(), 1);

    let options = GenerateOptions { min_length: 0.5, ..GenerateOptions::default() };
    let layer = generate(world.environment(), "video", &options).unwrap().layer;
    let placed = place(&world, &layer).unwrap();
    for visibility in [Visibility::Rays, Visibility::default()] {
        let options = FeatureSettings { visibility, ..FeatureSettings::default() };
        let mut seen = predict_features(&world, &camera, &pose, &images, &placed, &options).unwrap();
        add_boxes(
            &mut seen,
            &BoxQuery {
                placed: &placed,
                world: &world,
                sensor: &camera,
                world_from_sensor: &pose,
                options: &BoxOptions::default(),
            },
        )
        .unwrap();
    }
    #[cfg(feature = "store")]
    {
        use presight_store::{Note, Store, create};
        let path = folder.path().join("balls.presight");
        create(&path, world.environment(), &Note::default()).unwrap();
        let stored = presight_store::read_world(&path, &IndexKind::default()).unwrap();
        assert_eq!(stored.environment().content_hash(), world.environment().content_hash());
        drop(Store::open(&path).unwrap());
    }
    for backend in [Backend::Cpu, Backend::Gpu] {
        // Without an adapter the other engines are still checked.
        let Ok(mut predictor) = Predictor::new(Options::new(backend).with_threads(2)) else { continue };
        predict_all(&mut predictor, &world, &plan, &layer);
    }
}

/// Images, features and regions of interest.
fn predict_all(
    predictor: &mut Predictor,
    world: &World,
    plan: &FramePlan,
    layer: &presight_model::environment::FeatureLayer,
) {
    let options = FeatureOptions::default().with_placed(place(world, layer).unwrap());
    let request = Request::of(Outputs::of(&[Output::Range, Output::PolygonId]))
        .with_features(options)
        .with_regions(BoxOptions::default());
    let prediction =
        predictor.predict(world, &plan.sensor, &SensorPose::new(plan.world_from_sensor), &request).unwrap();
    assert!(prediction.features.is_some());
}

/// A script has its own thread. Its imports are built on the threads of the options; here there is only one, and it
/// waits for the script.
#[test]
fn a_script_that_imports_may_be_loaded_on_a_single_thread() {
    let folder = tempfile::tempdir().unwrap();
    scene(folder.path());
    let script = folder.path().join("outer.rhai");
    std::fs::write(&script, r#"print("hello"); place("balls", import_gltf("balls.glb"));"#).unwrap();
    let threads = Threads::new(1).unwrap();
    let options = ImportOptions { threads: threads.clone(), ..ImportOptions::default() };
    let mut said = Vec::new();
    let load = || presight_read::script::load(&script, &options, &mut |line| said.push(line.to_owned()));
    let made = threads.run(load).unwrap().unwrap();
    assert_eq!((made.environment.objects().len(), said), (3, vec!["hello".to_owned()]));
}
