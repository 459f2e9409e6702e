//! A scanner that ends with the direction of its first beam shows the same features as without that beam.

use presight_testkit::{Random, scenes};

use glam::{DMat3, DVec3};
use presight_features::{BoxOptions, FeatureOptions, FeaturePrediction, PlacedFeature};
use presight_model::environment::{Existence, Feature, FeatureShape, Properties};
use presight_model::geometry::{Pose, SensorPose};
use presight_model::sensor::{Angles, Geometry, Sensor};
use presight_model::world::World;
use presight_predict::predict::{Backend, Options, Predictor};
use presight_predict::request::Request;
use presight_render::plan::{Output, Outputs};

/// Points, edges and faces of the polygons of a world.
fn features(world: &World) -> Vec<PlacedFeature> {
    let shapes = (0..world.environment().slot_count()).flat_map(|slot| {
        let corners = world.environment().polygon_in_world(slot).unwrap_or_default();
        let (at, ends, none) = (corners[0], [corners[0], corners[1]], DMat3::ZERO);
        [
            (slot, FeatureShape::Point { at, covariance: none }),
            (slot, FeatureShape::Segment { ends, covariances: [none; 2], cross: none }),
            (slot, FeatureShape::Patch { corners, covariance: none }),
        ]
    });
    let placed = |(id, (slot, shape)): (u32, (u32, FeatureShape))| {
        let (existence, properties) = (Existence::default(), Properties::default());
        let feature = Feature { id, name: None, object: None, shape, existence, properties };
        PlacedFeature { feature: feature.into(), object: None, slots: vec![slot] }
    };
    (1..).zip(shapes).map(placed).collect()
}

fn seen(world: &World, sensor: &Sensor, pose: &Pose, placed: &[PlacedFeature]) -> FeaturePrediction {
    let request = Request::of(Outputs::of(&[Output::FeatureId]))
        .with_features(FeatureOptions::default().with_placed(placed.to_vec()))
        .with_regions(BoxOptions::default().with_sensor_sigmas([0.02, 0.02, 0.02, 0.0, 0.0, 0.02]));
    let mut predictor = Predictor::new(Options::new(Backend::Cpu).with_threads(2)).unwrap();
    let mut prediction = predictor.predict(world, sensor, &SensorPose::new(*pose), &request).unwrap();
    let mut features = prediction.features.take().unwrap();
    features.feature_id = prediction.images.feature_id;
    features
}

/// The same scanner with its azimuths listed.
fn listed(sensor: &Sensor) -> Sensor {
    let Geometry::Scanner(mut scanner) = sensor.spec().geometry.clone() else { panic!("a scanner") };
    let angles = (0..scanner.azimuth.len()).map(|i| scanner.azimuth.degrees(i)).collect();
    scanner.azimuth = Angles::Listed(angles);
    Sensor::new(sensor.spec().clone().with_geometry(Geometry::Scanner(scanner))).unwrap()
}

/// How far two columns are apart, modulo whole turns.
fn apart(a: f64, b: f64, turn: f64) -> f64 {
    let off = (a - b) / turn;
    (off - off.round()).abs() * turn
}

#[test]
fn a_column_that_comes_twice_changes_no_feature() {
    let mut random = Random(17);
    for (columns, rows) in [(180, 31), (90, 11)] {
        let world = scenes::room_world(random.bits(), 20);
        let placed = features(&world);
        let pose = Pose::from_xyz_rpy(DVec3::new(0.2, -0.1, 1.4), 0.1, 0.1, random.uniform(-3.0, 3.0));
        let (open, closed) = (scenes::scanner(columns, rows), scenes::closed(columns + 1, rows));
        let (width, turn) = (columns as usize, f64::from(columns));
        let once = seen(&world, &open, &pose, &placed);
        assert!(once.features.len() > 50);
        let over_the_seam = once.features.iter().filter(|f| f.roi.is_some_and(|[_, _, x1, _]| x1 > turn));
        assert!(over_the_seam.count() > 0);
        // Regions of uneven beams rest on finite differences.
        for (other, near) in [(closed.clone(), 1e-6), (listed(&open), 0.1), (listed(&closed), 0.1)] {
            let again = seen(&world, &other, &pose, &placed);
            assert_eq!(once.features.len(), again.features.len());
            for (a, b) in once.features.iter().zip(&again.features) {
                let name = (&a.feature.id, &a.roi, &b.roi);
                assert!((a.visible_fraction - b.visible_fraction).abs() < 0.02, "{name:?} {a:?} {b:?}");
                let ([x0, y0, x1, y1], [u0, v0, u1, v1]) = (a.roi.unwrap(), b.roi.unwrap());
                let off = [(y0 - v0).abs(), (y1 - v1).abs(), apart(x0, u0, turn), apart(x1, u1, turn)];
                let is_whole = x1 - x0 >= turn && u1 - u0 >= turn;
                assert!(is_whole || off.iter().all(|off| *off < near), "{name:?} {a:?} {b:?}");
            }
            let w = other.width() as usize;
            for (one, two) in once.feature_id.chunks(width).zip(again.feature_id.chunks(w)) {
                assert_eq!(two.get(width).unwrap_or(&two[0]), &two[0]);
                let apart = one.iter().zip(two).filter(|(a, b)| a != b).count();
                assert!(apart * 20 <= width, "{apart} of {width} pixels");
            }
        }
    }
}
