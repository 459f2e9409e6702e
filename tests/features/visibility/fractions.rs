//! Compares the visible fractions of segments over 25 pixels with dense rays in f64, on every model and for every
//! preset and lens: `cargo test --release --test features fractions_on_every_model -- --ignored --nocapture` prints a
//! row for each model and sensor.
//!
//! `PRESIGHT_FRACTION_SCENES` names models, `PRESIGHT_FRACTION_POSES` sets the number of poses.

use super::common::oracle::Oracle;
use super::common::{Random, data, env_number};
use super::{near_edges, seen_length, sensors};
use presight_features::{FeatureOptions, Hidden, PlacedFeatures};
use presight_model::geometry::{Pose, SensorPose};
use presight_model::sensor::{Geometry, Sensor};
use presight_model::world::World;
use presight_predict::predict::{Backend, Options, Predictor};
use presight_predict::request::Request;
use presight_render::plan::{Output, Outputs};
use rayon::prelude::*;

/// Segments up to this length, in pixels, do not count.
const LONG: f64 = 25.0;
/// The largest accepted error of a visible fraction.
const OFF: f64 = 0.02;
const SCENES: &str = "room_cube,room_cylinder,room_sphere,room_tray,room_trays,room_corridor,warehouse_small,factory_hall,\
    agriculture_clearpath,office_clearpath,office_construction_clearpath,office_willowgarage,hospital,city";

#[derive(Default)]
struct Row {
    segments: usize,
    /// Off by more than that, and off by more even with the oracle's doubt.
    off: usize,
    surely: usize,
    worst: f64,
}

impl Row {
    fn take(&mut self, world: &World, sensor: &Sensor, pose: &Pose, random: &mut Random) {
        let placed = PlacedFeatures::from(near_edges(world, pose, 300, random));
        let options = FeatureOptions::default().with_placed(placed.clone()).with_hidden(Hidden::Full);
        let request = Request::of(Outputs::of(&[Output::PolygonId])).with_features(options);
        let mut predictor = Predictor::new(Options::new(Backend::Cpu)).unwrap();
        let mut features =
            predictor.predict(world, sensor, &SensorPose::new(*pose), &request).unwrap().features.unwrap();
        features.spell_out(world.environment(), &placed.features);
        let oracle = Oracle::new(world.environment(), pose.translation).unwrap();
        let both: Vec<_> = placed.features.iter().zip(&features.features).collect();
        assert_eq!(both.len(), features.features.len());
        let off = |(placed, seen)| {
            let (length, clear, _) = seen_length(&oracle, sensor, pose, (placed, seen), false);
            if length <= LONG {
                return None;
            }
            let off = (clear / length - seen.visible_fraction).abs();
            if off <= OFF {
                return Some([off; 2]);
            }
            let (_, clear, unsure) = seen_length(&oracle, sensor, pose, (placed, seen), true);
            let (low, high) = (clear / length, (clear + unsure) / length);
            Some([off, (low - seen.visible_fraction).max(seen.visible_fraction - high).max(0.0)])
        };
        let all: Vec<[f64; 2]> = both.into_par_iter().filter_map(off).collect();
        self.segments += all.len();
        for [off, surely] in all {
            self.off += usize::from(off > OFF);
            self.surely += usize::from(surely > OFF);
            self.worst = self.worst.max(surely);
        }
    }
}

#[test]
#[ignore = "a study of minutes"]
fn fractions_on_every_model() {
    let names = std::env::var("PRESIGHT_FRACTION_SCENES").unwrap_or_else(|_| SCENES.to_owned());
    let poses = env_number("PRESIGHT_FRACTION_POSES", 2) as usize;
    let lenses = sensors().into_iter().filter(|s| s.spec().name == "lens");
    // The oracle does not model limits of incidence.
    let plain = data::presets().into_iter().filter(|s| s.spec().max_incidence.is_none());
    let all: Vec<Sensor> = plain.chain(lenses).filter(|s| !matches!(s.spec().geometry, Geometry::Rays(_))).collect();
    eprintln!("| model | sensor | segments | off by more than {OFF} | along another's edge | worst |");
    eprintln!("|---|---|---|---|---|---|");
    let mut sum = Row::default();
    for name in names.split(',') {
        let Some(world) = data::scene(name, true) else { return };
        let poses = data::poses(&world, poses, 5);
        for sensor in &all {
            let (mut row, mut random) = (Row::default(), Random(7));
            poses.iter().for_each(|pose| row.take(&world, sensor, pose, &mut random));
            let Row { segments, off, surely, worst } = row;
            eprintln!("| {name} | {} | {segments} | {surely} | {} | {worst:.3} |", sensor.spec().name, off - surely);
            sum.segments += segments;
            sum.off += off;
            sum.surely += surely;
            sum.worst = sum.worst.max(worst);
        }
    }
    let Row { segments, off, surely, worst } = sum;
    eprintln!("| all | | {segments} | {surely} | {} | {worst:.3} |", off - surely);
    assert!(segments > 100 && 100 * surely <= segments, "{surely} of {segments}");
}
