//! Draws the plant with its visible features, without contours and with them:
//! `PRESIGHT_PICTURES=FOLDER cargo test --test features pictures_of_the_plant -- --ignored`.

use super::common::data;
use super::plant::plant;
use presight_features::generate::{GenerateOptions, generate};
use presight_features::{FeatureOptions, Hidden, place};
use presight_model::environment::FeatureLayer;
use presight_model::geometry::SensorPose;
use presight_pictures::{Marks, Overlay, write_preview_with};
use presight_predict::predict::{Backend, Options, Predictor};
use presight_predict::request::Request;
use presight_render::plan::{Output, Outputs};

#[test]
#[ignore = "writes pictures for people"]
fn pictures_of_the_plant() {
    let folder = std::path::PathBuf::from(std::env::var_os("PRESIGHT_PICTURES").expect("a folder"));
    let world = plant(3);
    let made = generate(world.environment(), "video", &GenerateOptions::default()).unwrap().layer;
    let camera = super::pinhole();
    let mut predictor = Predictor::new(Options::new(Backend::Cpu)).unwrap();
    for (k, pose) in data::poses(&world, 4, 11).iter().enumerate() {
        for (name, kinds) in [("before", &["segment"][..]), ("after", &["segment", "contour"])] {
            let features = made.features.iter().filter(|f| kinds.contains(&f.shape.kind())).cloned().collect();
            let placed = place(&world, &FeatureLayer { features, ..made.clone() }).unwrap();
            let options = FeatureOptions::default().with_placed(placed).with_hidden(Hidden::Count);
            let request = Request::of(Outputs::of(&[Output::Range, Output::PolygonId])).with_features(options);
            let seen = predictor.predict(&world, &camera, &SensorPose::new(*pose), &request).unwrap();
            let overlay = Overlay {
                features: seen.features.as_ref().unwrap(),
                sides: &predictor.predict_outlines(&world, &seen).unwrap(),
                sensor: &camera,
                pose: SensorPose::new(*pose),
                numbers: false,
            };
            let marks = Marks { overlay: Some(&overlay), ..Marks::default() };
            let path = folder.join(format!("plant_{k}_{name}.png"));
            write_preview_with(&path, &seen.images, &camera, Output::Range, &marks).unwrap();
        }
    }
}
