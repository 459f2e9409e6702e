//! Deadlines on the GPU engine, which can stop between pieces of a frame.

use crate::common::scenes::{camera, room_world};
use crate::common::{Random, data, env_number, plan};
use crate::partial::{judge, sensors};
use crate::ticks::Ticks;
use presight_model::error::ErrorKind;
use presight_model::geometry::{Pose, SensorPose};
use presight_model::sensor::Sensor;
use presight_model::world::World;
use presight_predict::engine::{Engine, EngineKind};
use presight_predict::predict::{Backend, Options, Predictor};
use presight_predict::request::Request;
use presight_render::deadline::Watch;
use presight_render::plan::CountName;
use presight_render::plan::{Images, Output, Outputs, Stats};
use presight_testkit::skip::no_adapter;
use std::sync::Arc;
use std::time::Duration;

/// An engine on any available adapter.
fn engine() -> Option<Box<dyn Engine>> {
    EngineKind::Gpu.open(&2.into()).map_err(no_adapter).ok()
}

struct Subject<'a> {
    world: &'a World,
    sensor: &'a Sensor,
    pose: Pose,
}

impl Subject<'_> {
    fn full(&self, engine: &mut dyn Engine) -> Images {
        let mut images = Images::default();
        engine.render(&plan(self.world, self.sensor, &self.pose), &mut images, &mut Stats::default()).unwrap();
        images
    }

    /// Renders, stopped after `ms` milliseconds, which are `looks` readings of the clock.
    fn render(&self, engine: &mut dyn Engine, ms: u64, looks: u64) -> (Images, Stats) {
        let mut plan = plan(self.world, self.sensor, &self.pose);
        plan.set_watch(Watch::start(Arc::new(Ticks::of(1000 * ms / looks)), Duration::from_millis(ms)));
        let (mut images, mut stats) = (Images::default(), Stats::default());
        engine.render(&plan, &mut images, &mut stats).unwrap();
        (images, stats)
    }
}

/// A deadline in milliseconds that is never reached.
const ENDLESS: u64 = 1 << 40;

/// How often frames were complete, partial, and partial with some pixels shown.
#[derive(Debug, Default)]
struct Tally {
    whole: usize,
    partial: usize,
    with_something: usize,
    pieces: u64,
}

/// Checks that frames stopped at random equal the full image bit for bit where they show something, and are open
/// elsewhere.
fn hold(subject: &Subject<'_>, engine: &mut dyn Engine, random: &mut Random, frames: usize, tally: &mut Tally) {
    let full = subject.full(engine);
    let name = &subject.sensor.spec().name;
    for frame in 0..frames {
        let ms = [0, ENDLESS].get(frame).copied().unwrap_or_else(|| 4 << random.below(7) as u64);
        let (images, stats) = subject.render(engine, ms, 4 + random.below(3) as u64);
        let given_up = stats.degradation();
        let verdict = judge(&full, &images, given_up.map_or(f64::INFINITY, |g| g.complete_to), subject.sensor);
        assert_eq!((verdict.wrong, verdict.missing), (0, 0), "{name}, {ms} ms");
        assert_eq!(given_up.map_or(0, |g| g.samples as usize), verdict.open, "{name}, {ms} ms");
        tally.whole += usize::from(verdict.open == 0);
        tally.partial += usize::from(verdict.open > 0);
        tally.with_something += usize::from(verdict.open > 0 && verdict.shown > 0);
        tally.pieces = tally.pieces.max(stats.count_of(CountName::Waves).unwrap());
    }
}

#[test]
fn pixels_that_a_device_finishes_in_time_equal_its_full_image() {
    let Some(mut engine) = engine() else { return };
    let (mut random, mut tally) = (Random(31), Tally::default());
    let frames = env_number("FRAMES", 8) as usize;
    for seed in 0..2 {
        let world = room_world(seed, 900);
        for sensor in sensors() {
            let subject = Subject { world: &world, sensor: &sensor, pose: Pose::IDENTITY };
            hold(&subject, &mut *engine, &mut random, frames, &mut tally);
        }
    }
    println!("{tally:?}");
    assert!(tally.whole > 0 && tally.with_something > 5 && tally.pieces > 1, "{tally:?}");
}

#[test]
fn pixels_that_a_device_finishes_in_time_in_a_building_equal_its_full_image() {
    let Some(world) = data::scene("hospital", true) else { return };
    let Some(mut engine) = engine() else { return };
    let (mut random, mut tally) = (Random(32), Tally::default());
    let frames = env_number("SCENE_FRAMES", 5) as usize;
    for (pose, turn) in data::poses(&world, 2, 5).into_iter().zip(0..) {
        for sensor in &data::presets_at(turn, 0, 2) {
            hold(&Subject { world: &world, sensor, pose }, &mut *engine, &mut random, frames, &mut tally);
        }
    }
    println!("{tally:?}");
    assert!(tally.with_something > 0, "{tally:?}");
}

/// The check finds an engine that reports unfinished pixels as final, and one that reports nothing as predicted.
#[test]
fn a_device_that_shows_unfinished_pixels_is_caught() {
    let Some(mut engine) = engine() else { return };
    let (world, sensors) = (room_world(1, 900), sensors());
    let stops =
        sensors.iter().flat_map(|sensor| (1..24).flat_map(move |k| (4..7).map(move |looks| (sensor, 4 * k, looks))));
    let stopped = stops.map(|(sensor, ms, looks)| {
        let (images, stats) = Subject { world: &world, sensor, pose: Pose::IDENTITY }.render(&mut *engine, ms, looks);
        (sensor, images, stats)
    });
    let shows = |images: &Images| images.range.iter().filter(|range| range.is_finite()).count();
    let mut partial =
        stopped.filter(|(_, images, stats)| stats.degradation().is_some_and(|g| g.samples > 100) && shows(images) > 0);
    let (sensor, images, stats) = partial.next().expect("some frame is partial");
    drop(partial);
    let full = Subject { world: &world, sensor, pose: Pose::IDENTITY }.full(&mut *engine);
    let complete_to = stats.degradation().unwrap().complete_to;
    assert_eq!(judge(&full, &images, complete_to, sensor).wrong, 0);
    // The image of the nearest runs alone, with no pixel left open.
    let mut near = plan(&world, sensor, &Pose::IDENTITY);
    let drawn = near.runs.iter().take_while(|run| f64::from(run.nearest) <= complete_to * 1.003).count();
    near.runs.truncate(drawn);
    near.polygon_count = near.runs.iter().map(|run| run.count as usize).sum();
    let mut shown = Images::default();
    engine.render(&near, &mut shown, &mut Stats::default()).unwrap();
    let seen = shows(&full);
    let wrong = judge(&full, &shown, complete_to, sensor).wrong;
    assert!(wrong > seen / 100, "{wrong} of {seen}, complete to {complete_to}");
    let mut invented = images;
    invented.range.iter_mut().filter(|range| range.is_nan()).for_each(|range| *range = f32::INFINITY);
    assert!(judge(&full, &invented, complete_to, sensor).wrong > seen / 100);
}

/// The predictor keeps deadlines on a device, for outputs without range too, and refuses in time if no prediction is
/// possible.
#[test]
fn a_predictor_keeps_deadlines_on_a_device() {
    let Ok(mut predictor) = Predictor::new(Options::new(Backend::Gpu).with_threads(2)).map_err(no_adapter) else {
        return;
    };
    let (world, sensor) = (room_world(2, 900), camera(160, 120));
    let mut predict = |request: &Request| predictor.predict(&world, &sensor, &SensorPose::IDENTITY, request);
    let ids = Request::of(Outputs::of(&[Output::PolygonId, Output::Normal]));
    let full = predict(&ids).unwrap();
    let generous = predict(&ids.clone().with_deadline(Duration::from_secs(3600))).unwrap();
    assert_eq!((generous.stats.engine, generous.degradation()), ("gpu", None));
    assert_eq!(generous.images.polygon_id, full.images.polygon_id);
    assert!(generous.images.range.is_empty() && generous.stats.deadline.is_some());
    let too_little = predict(&ids.clone().with_deadline(Duration::from_nanos(1))).unwrap_err();
    assert_eq!(too_little.kind(), ErrorKind::Deadline);
    for ms in [1, 2, 4, 8, 16] {
        let Ok(seen) = predict(&ids.clone().with_deadline(Duration::from_millis(ms))) else { continue };
        let pairs = seen.images.polygon_id.iter().zip(&full.images.polygon_id);
        assert!(pairs.clone().all(|(seen, full)| *seen == 0 || seen == full), "{ms} ms");
        let open = pairs.filter(|(seen, full)| seen != full).count() as u64;
        assert!(seen.degradation().map_or(0, |given_up| given_up.samples) >= open, "{ms} ms");
    }
    let costs: Vec<_> = predictor.costs().keys().collect();
    assert!(!costs.is_empty() && costs.iter().all(|key| key.engine == "gpu" && key.adapter.is_some()));
}
