//! A prediction stopped at any moment shows nothing that differs from the full prediction.

use crate::common::scenes::{all_round, camera, fisheye, lens, room_world, scanner};
use crate::common::{Random, data, env_number, plan};
use crate::ticks::Ticks;
use presight_model::geometry::Pose;
use presight_model::sensor::Sensor;
use presight_model::world::World;
use presight_render::cpu::CpuEngine;
use presight_render::deadline::Watch;
use presight_render::plan::{ChosenWay, FramePlan, Images, Output, PlanBuffers, Stats};
use std::sync::Arc;
use std::time::Duration;

/// The faults of a partial prediction, and its content.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Verdict {
    /// Samples that differ from the full prediction, including `+inf` where the full one has a range.
    pub wrong: usize,
    /// Samples not predicted although nearer than `complete_to`.
    pub missing: usize,
    /// Samples not predicted.
    pub open: usize,
    /// Samples that show something.
    pub shown: usize,
}

/// Compares a partial prediction with the full one. A sample without range may be nearer than the sensor's `range_min`,
/// so only samples beyond that are surely nearer than `complete_to`.
pub fn judge(full: &Images, partial: &Images, complete_to: f64, sensor: &Sensor) -> Verdict {
    judge_part(full, partial, (complete_to, sensor), |_, _| true)
}

/// The same for a request of only some columns and rows: no others may show anything.
fn judge_part(
    full: &Images,
    partial: &Images,
    (complete_to, sensor): (f64, &Sensor),
    asked: impl Fn(u32, u32) -> bool,
) -> Verdict {
    let mut verdict = Verdict::default();
    let floats = |images: &Images, at: usize| {
        [Output::Range, Output::DepthZ, Output::CosIncidence, Output::Echo].map(|o| {
            images.floats(o).map(|image| if image[at].is_nan() { f32::NAN.to_bits() } else { image[at].to_bits() })
        })
    };
    let ids = |images: &Images, at: usize| [images.polygon_id[at], images.object_id[at]];
    for at in 0..full.pixels() {
        let same = floats(full, at) == floats(partial, at) && ids(full, at) == ids(partial, at);
        let asked_for = asked(at as u32 % full.width, at as u32 / full.width);
        let is_open = floats(partial, at).iter().flatten().all(|bits| f32::from_bits(*bits).is_nan())
            && ids(partial, at) == [0; 2];
        verdict.shown += usize::from(partial.range[at].is_finite());
        verdict.wrong += usize::from(!asked_for && !is_open);
        if same {
            continue;
        }
        verdict.open += usize::from(is_open);
        verdict.wrong += usize::from(!is_open && asked_for);
        let range = f64::from(full.range[at]);
        let range = if range == f64::NEG_INFINITY { sensor.spec().range_min } else { range };
        verdict.missing += usize::from(is_open && asked_for && range < complete_to);
    }
    verdict
}

pub fn sensors() -> Vec<Sensor> {
    vec![camera(96, 64), scanner(180, 24), scanner(721, 1), all_round(90, 40), lens(80, 60), fisheye(72, 56)]
}

const WAYS: [ChosenWay; 2] = [ChosenWay::RASTER, ChosenWay::TILES];

struct Subject<'a> {
    world: &'a World,
    sensor: &'a Sensor,
    pose: Pose,
    chosen: ChosenWay,
}

impl Subject<'_> {
    /// Renders, stopped after `looks` readings of the clock; returns the images, the statistics and the number of
    /// readings.
    fn render(&self, engine: &mut CpuEngine, looks: u64) -> (Images, Stats, u64) {
        let clock = Arc::new(Ticks::default());
        let request = plan(self.world, self.sensor, &self.pose).request;
        let by = FramePlan::by(self.chosen, PlanBuffers::default(), self.world, self.sensor, &self.pose, request);
        let mut plan = by.unwrap();
        plan.set_watch(Watch::start(clock.clone(), Duration::from_micros(looks)).looking_always());
        let (mut images, mut stats) = (Images::default(), Stats::default());
        engine.render(&plan, &mut images, &mut stats).unwrap();
        (images, stats, clock.looks())
    }

    /// Renders a part of the images, stopped after `looks` readings of the clock.
    fn render_part(&self, engine: &mut CpuEngine, looks: u64, part: (u32, Option<(f64, u32)>)) -> (Images, Stats) {
        let mut plan = plan(self.world, self.sensor, &self.pose);
        plan.set_watch(Watch::start(Arc::new(Ticks::default()), Duration::from_micros(looks)).looking_always());
        plan.set_part(part.0, part.1).unwrap();
        let (mut images, mut stats) = (Images::default(), Stats::default());
        engine.render(&plan, &mut images, &mut stats).unwrap();
        (images, stats)
    }

    fn full(&self, engine: &mut CpuEngine) -> Images {
        let mut images = Images::default();
        engine.render(&plan(self.world, self.sensor, &self.pose), &mut images, &mut Stats::default()).unwrap();
        images
    }
}

#[derive(Default)]
struct Tally {
    frames: usize,
    partial: usize,
    with_something: usize,
}

/// Stops several frames at random moments.
fn hold(subject: &Subject<'_>, random: &mut Random, frames: usize, engine: &mut CpuEngine, tally: &mut Tally) {
    let full = subject.full(engine);
    let (all, stats, looks) = subject.render(engine, u64::MAX / 2000);
    assert_eq!(stats.degradation(), None);
    let name = &subject.sensor.spec().name;
    assert_eq!(
        judge(&full, &all, f64::INFINITY, subject.sensor),
        Verdict { shown: judge(&full, &full, 0.0, subject.sensor).shown, ..Verdict::default() }
    );
    for frame in 0..frames {
        // The first frame has no time at all.
        let stop = if frame == 0 { 0 } else { 1 + random.below(looks as usize) as u64 };
        let (partial, stats, _) = subject.render(engine, stop);
        let given_up = stats.degradation();
        let verdict = judge(&full, &partial, given_up.map_or(f64::INFINITY, |g| g.complete_to), subject.sensor);
        assert_eq!((verdict.wrong, verdict.missing), (0, 0), "{name}, stopped after {stop} of {looks} looks");
        // The count of missing samples is exact, including samples without a hit in the full image.
        assert_eq!(given_up.map_or(0, |g| g.samples as usize), verdict.open, "{name}, stopped after {stop}");
        tally.frames += 1;
        tally.partial += usize::from(verdict.open > 0);
        tally.with_something += usize::from(verdict.open > 0 && verdict.shown > 0);
    }
}

#[test]
fn final_samples_equal_the_full_prediction() {
    let mut random = Random(11);
    let mut tally = Tally::default();
    let frames = env_number("FRAMES", 12) as usize;
    for seed in 0..2 {
        let world = room_world(seed, 700);
        for threads in [1, 2] {
            let mut engine = CpuEngine::new(threads).unwrap();
            for (sensor, chosen) in sensors().into_iter().flat_map(|s| WAYS.map(|way| (s.clone(), way))) {
                let subject = Subject { world: &world, sensor: &sensor, pose: Pose::IDENTITY, chosen };
                hold(&subject, &mut random, frames, &mut engine, &mut tally);
            }
        }
    }
    println!(
        "{} frames, {} gave something up, {} of them show something",
        tally.frames, tally.partial, tally.with_something
    );
    assert!(tally.partial * 2 > tally.frames, "hardly any frame was stopped");
    assert!(tally.with_something * 4 > tally.partial, "hardly any stopped frame shows anything");
}

/// Part of the image: every k-th column and row, of all columns or of some around a heading. Each sample equals the
/// full image's bit for bit, complete or stopped anywhere; no other sample shows anything.
#[test]
fn a_thinned_or_narrowed_image_has_samples_of_the_full_image() {
    let mut random = Random(13);
    let (mut parts, mut kept) = (0, 0);
    for (seed, threads) in [(0, 1), (1, 2)] {
        let world = room_world(seed, 700);
        let mut engine = CpuEngine::new(threads).unwrap();
        for sensor in sensors() {
            let subject = Subject { world: &world, sensor: &sensor, pose: Pose::IDENTITY, chosen: ChosenWay::RASTER };
            let full = subject.full(&mut engine);
            for (stride, around) in
                [(2, None), (4, None), (8, None), (1, Some((0.7, 17))), (4, Some((-0.2, 40))), (2, Some((9.0, 11)))]
            {
                let all = subject.render_part(&mut engine, u64::MAX / 2000, (stride, around));
                let stopped = subject.render_part(&mut engine, random.below(60) as u64, (stride, around));
                for (images, stats) in [all, stopped] {
                    let (given_up, name) = (stats.degradation(), &sensor.spec().name);
                    let asked = |column: u32, row: u32| {
                        let in_part = given_up.is_none_or(|g| g.opening.is_none()) || around.is_some();
                        in_part && column.is_multiple_of(stride) && row.is_multiple_of(stride)
                    };
                    let complete_to = if around.is_some() { 0.0 } else { given_up.map_or(0.0, |g| g.complete_to) };
                    let verdict = judge_part(&full, &images, (complete_to, &sensor), asked);
                    assert_eq!((verdict.wrong, verdict.missing), (0, 0), "{name}, every {stride}, {around:?}");
                    assert_eq!(
                        given_up.map_or(0, |g| g.samples as usize),
                        verdict.open,
                        "{name}, {stride}, {around:?}"
                    );
                    assert_eq!(given_up.map_or(1, |g| g.stride), stride, "{name}");
                    kept += verdict.shown;
                    parts += 1;
                }
            }
            // Every second column and row of a complete frame show all that the full image has there.
            let (images, _) = subject.render_part(&mut engine, u64::MAX / 2000, (2, None));
            let shown = |images: &Images, every: usize| {
                let rows = images.range.chunks(images.width as usize).step_by(every);
                rows.flat_map(|row| row.iter().step_by(every)).filter(|range| range.is_finite()).count()
            };
            assert_eq!(shown(&images, 1), shown(&full, 2), "{}", sensor.spec().name);
        }
    }
    println!("{parts} parts of images show {kept} samples");
    assert!(kept > 10_000);
}

/// By hand: a scanner of 180 columns has one for each degree from -90 on. Nine columns around 45 degrees to the left
/// are 131 to 139; the first is rounded down to a multiple of 8.
#[test]
fn an_image_is_narrowed_to_columns_around_a_heading() {
    let (world, sensor) = (room_world(1, 50), scanner(181, 3));
    let subject = Subject { world: &world, sensor: &sensor, pose: Pose::IDENTITY, chosen: ChosenWay::RASTER };
    let mut engine = CpuEngine::new(1).unwrap();
    let degrees = |column: u32| {
        let ray = sensor.ray(column, 1).unwrap();
        ray.y.atan2(ray.x).to_degrees()
    };
    let middle = (0..181).min_by(|a, b| (degrees(*a) - 45.0).abs().total_cmp(&(degrees(*b) - 45.0).abs())).unwrap();
    let first = (middle - 4) / 8 * 8;
    let (images, stats) = subject.render_part(&mut engine, u64::MAX / 2000, (1, Some((45f64.to_radians(), 9))));
    let there: Vec<u32> = (0..181).filter(|column| !images.range[181 + *column as usize].is_nan()).collect();
    assert_eq!(there, (first..middle + 5).collect::<Vec<_>>());
    let opening = stats.degradation().unwrap().opening.unwrap();
    let ends = [degrees(first), degrees(middle + 4)];
    assert!((opening.opening_deg - (ends[1] - ends[0]).abs()).abs() < 1e-9, "{opening:?}");
    assert!((opening.heading_deg - 0.5 * (ends[0] + ends[1])).abs() < 1e-9, "{opening:?}");
}

/// The same in buildings: `SCENE_FRAMES=60 cargo test --release --test deadline buildings -- --nocapture` runs many.
#[test]
fn final_samples_in_buildings_equal_the_full_prediction() {
    let mut random = Random(12);
    let frames = env_number("SCENE_FRAMES", 3) as usize;
    for name in ["hospital", "factory_hall", "office_willowgarage"] {
        let Some(world) = data::scene(name, true) else { return };
        let mut engine = CpuEngine::new(2).unwrap();
        let mut tally = Tally::default();
        for (pose, turn) in data::poses(&world, 2.max(frames / 8), 5).into_iter().zip(0..) {
            for sensor in data::presets_at(turn, 0, 3).iter().chain(&[lens(160, 120), all_round(180, 60)]) {
                let subject = Subject { world: &world, sensor, pose, chosen: WAYS[turn % 2] };
                hold(&subject, &mut random, frames, &mut engine, &mut tally);
            }
        }
        println!(
            "{name}: {} frames, {} gave something up, {} of them show something",
            tally.frames, tally.partial, tally.with_something
        );
        assert!(tally.partial > 0);
    }
}

/// The check finds a controller that reports empty space where it did not render.
#[test]
fn infinity_for_omitted_samples_is_caught() {
    let (world, sensor) = (room_world(3, 700), camera(96, 64));
    let subject = Subject { world: &world, sensor: &sensor, pose: Pose::IDENTITY, chosen: ChosenWay::RASTER };
    let mut engine = CpuEngine::new(1).unwrap();
    let full = subject.full(&mut engine);
    let (mut partial, stats, _) = subject.render(&mut engine, 6);
    let given_up = stats.degradation().expect("six looks are too few").clone();
    assert_eq!(judge(&full, &partial, given_up.complete_to, &sensor).wrong, 0);
    let seen = full.range.iter().filter(|range| range.is_finite()).count();
    for range in partial.range.iter_mut().filter(|range| range.is_nan()) {
        *range = f32::INFINITY;
    }
    assert!(judge(&full, &partial, given_up.complete_to, &sensor).wrong > seen / 100);
    // It also finds one that shows unfinished samples beyond `complete_to`.
    let (mut partial, _, _) = subject.render(&mut engine, 6);
    let at = partial.range.iter().position(|range| range.is_nan()).unwrap();
    (partial.range[at], partial.polygon_id[at]) = (9.0, 1);
    assert_eq!(judge(&full, &partial, given_up.complete_to, &sensor).wrong, 1);
    // And one that states a `complete_to` that is too far.
    let nearest_open = (0..full.pixels()).filter(|at| partial.range[*at].is_nan()).map(|at| full.range[at]);
    let beyond = f64::from(nearest_open.fold(f32::INFINITY, f32::min)) + 0.01;
    assert!(judge(&full, &partial, beyond, &sensor).missing > 0);
}

/// The check finds a thinned image that fills its gaps from neighbours, and one shifted by a pixel.
#[test]
fn samples_in_wrong_places_are_caught() {
    let (world, sensor) = (room_world(3, 700), camera(96, 64));
    let subject = Subject { world: &world, sensor: &sensor, pose: Pose::IDENTITY, chosen: ChosenWay::RASTER };
    let mut engine = CpuEngine::new(1).unwrap();
    let full = subject.full(&mut engine);
    let every_second = |column: u32, row: u32| column.is_multiple_of(2) && row.is_multiple_of(2);
    let (thinned, _) = subject.render_part(&mut engine, u64::MAX / 2000, (2, None));
    assert_eq!(judge_part(&full, &thinned, (1e9, &sensor), every_second).wrong, 0);
    let mut filled = thinned.clone();
    for at in (1..filled.range.len()).filter(|at| filled.range[*at].is_nan()).collect::<Vec<_>>() {
        filled.range[at] = filled.range[at - 1];
    }
    assert!(judge_part(&full, &filled, (1e9, &sensor), every_second).wrong > 100);
    let mut shifted = thinned;
    shifted.range.rotate_right(2);
    shifted.polygon_id.rotate_right(2);
    assert!(judge_part(&full, &shifted, (1e9, &sensor), every_second).wrong > 100);
}
