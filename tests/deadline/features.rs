//! Features within a deadline: the most important first, and the omitted ones are named.

use crate::common::scenes::{camera, room_world};
use crate::ticks::Sudden;
use glam::{DMat3, DVec3};
use presight_features::{BoxOptions, FeatureOptions, Hidden, PlacedFeature, SeenFeature};
use presight_model::environment::{Existence, Feature, FeatureShape, Properties};
use presight_model::error::ErrorKind;
use presight_model::geometry::SensorPose;
use presight_model::world::World;
use presight_predict::predict::{Backend, Options, Prediction, Predictor};
use presight_predict::request::Request;
use presight_render::deadline::{DegradationKind, Priority};
use presight_render::plan::{Output, Outputs};
use std::sync::Arc;
use std::time::Duration;

const FEATURES: u32 = 100;

/// Upright edges 1 m ahead; edge i is i times as long in the image as edge 1.
fn edges() -> Vec<PlacedFeature> {
    let edge = |id: u32| {
        let (y, half) = (0.4 - 0.005 * f64::from(id), 0.001 * f64::from(id));
        let ends = [DVec3::new(1.0, y, -half), DVec3::new(1.0, y, half)];
        let shape = FeatureShape::Segment { ends, covariances: [DMat3::ZERO; 2], cross: DMat3::ZERO };
        let (existence, properties) = (Existence::default(), Properties::default());
        let feature = Feature { id, name: None, object: None, shape, existence, properties };
        PlacedFeature { feature: feature.into(), object: None, slots: vec![] }
    };
    (1..=FEATURES).map(edge).collect()
}

fn request() -> Request {
    Request::of(Outputs::of(&[Output::Range, Output::FeatureId]))
        .with_features(FeatureOptions::default().with_hidden(Hidden::Full).with_placed(edges()))
        .with_regions(BoxOptions::default().with_sensor_sigmas([0.02, 0.02, 0.02, 0.0, 0.0, 0.01]))
}

fn predict(world: &World, request: &Request, look: u64) -> presight_model::error::Result<Prediction> {
    let mut predictor = Predictor::new(Options::new(Backend::Cpu).with_threads(1)).unwrap();
    predictor.set_clock(Arc::new(Sudden::at(look)));
    predictor.predict(world, &camera(120, 90), &SensorPose::IDENTITY, request)
}

/// The ids of features.
fn ids(features: &[SeenFeature]) -> Vec<u32> {
    features.iter().map(|seen| seen.feature.id).collect()
}

#[test]
fn the_longest_features_go_first_and_the_rest_are_named() {
    let world = room_world(1, 50);
    let full = predict(&world, &request(), 0).unwrap();
    let full = full.features.unwrap();
    let (in_time, ranked) = (request().with_deadline(Duration::from_secs(1)), [7, 3]);
    let with_ranks = in_time.clone().with_priority(Priority::default().with_features(ranked.to_vec()));
    let (mut partial, mut whole) = (0, 0);
    for look in 1..80 {
        for (request, first) in [(&in_time, &[][..]), (&with_ranks, &ranked)] {
            let seen = match predict(&world, request, look) {
                Ok(seen) => seen,
                Err(e) => {
                    assert_eq!(e.kind(), ErrorKind::Deadline);
                    continue;
                }
            };
            let found = seen.features.as_ref().unwrap();
            let left_out = seen.degradation().map_or(&[][..], |given_up| &given_up.features);
            let mut order: Vec<u32> = first.to_vec();
            order.extend((1..=FEATURES).rev().filter(|id| !first.contains(id)));
            let (mut expected, mut rest) =
                (order[..found.features.len()].to_vec(), order[found.features.len()..].to_vec());
            expected.sort_unstable();
            rest.sort_unstable();
            assert_eq!((ids(&found.features), left_out), (expected, &rest[..]), "look {look}");
            // These features and their regions equal the full prediction's.
            for seen in &found.features {
                let same = full.features.iter().find(|f| f.feature.id == seen.feature.id).unwrap();
                assert_eq!(format!("{seen:?}"), format!("{same:?}"), "look {look}");
            }
            let is_told =
                seen.degradation().is_some_and(|g| g.means.iter().any(|m| m.means == DegradationKind::Features));
            assert_eq!(is_told, !rest.is_empty());
            let marked = |id: &u32| *id == 0 || found.features.iter().any(|f| f.feature.id == *id);
            assert!(seen.images.feature_id.iter().all(marked));
            partial += usize::from(!rest.is_empty() && !found.features.is_empty());
            whole += usize::from(rest.is_empty());
        }
    }
    assert!(partial > 0 && whole > 0, "{partial} in part, {whole} whole");
}

/// Omitted features do not make complete images partial: NaN means that a pixel has no ray, and no pixel counts as not
/// predicted.
#[test]
fn features_left_out_leave_images_whole() {
    let world = room_world(1, 50);
    let full = predict(&world, &request(), 0).unwrap().images;
    let in_time = request().with_deadline(Duration::from_secs(1));
    let seen = (1..80).filter_map(|look| predict(&world, &in_time, look).ok());
    let mut seen = seen.filter(|seen| seen.degradation().is_some_and(|g| g.samples == 0 && !g.features.is_empty()));
    let seen = seen.next().expect("one of the clocks stops between images and features");
    assert_eq!(seen.images.range, full.range);
    assert!(seen.not_predicted().is_empty() && !seen.is_not_predicted(3, 3));
    assert_eq!(seen.degradation().unwrap().complete_to, f64::INFINITY);
}
