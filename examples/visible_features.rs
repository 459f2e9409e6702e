//! The features of a model that a camera should see, each with the image box in which it will be found.
//!
//! `cargo run --example visible_features`
#![allow(clippy::print_stdout, reason = "an example prints its result")]

use glam::DVec3;
use presight::features::BoxOptions;
use presight::features::{FeatureOptions, GenerateOptions, generate};
use presight::{Options, Prediction, Predictor, Request, Result, Scene, SensorPose};

/// Predicts edges and corners for a camera whose pose is known to 2 cm in x and y and 0.01 rad of heading.
pub fn visible_features(pose: &SensorPose) -> Result<Prediction> {
    let (scene, camera) = (Scene::open("scenes/room.glb")?, presight::preset("realsense-d435")?);
    let layer = generate(scene.world.environment(), "video", &GenerateOptions::default())?.layer;
    let features = FeatureOptions::default().with_placed(scene.place(&layer)?);
    let regions = BoxOptions::default().with_sensor_sigmas([0.02, 0.02, 0.0, 0.0, 0.0, 0.01]);
    let request = Request::default().with_features(features).with_regions(regions);
    Predictor::new(Options::default())?.predict(&scene.world, &camera, pose, &request)
}

/// Prints the box of each visible feature.
pub fn main() -> Result<()> {
    let seen = visible_features(&SensorPose::from_xyz_rpy(DVec3::new(0.3, 0.35, 1.65), 0.0, 0.2, 0.66))?;
    for feature in seen.features.iter().flat_map(|f| &f.features) {
        if let (Some(roi), Some(range)) = (feature.roi, feature.range) {
            println!("{} {} at {range:.2} m, in {roi:.1?}", feature.feature.shape.kind(), feature.feature.id);
        }
    }
    Ok(())
}
