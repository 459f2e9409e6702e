//! Replays recorded counts and times: no real clock is used.

use super::*;
use crate::deadline::{
    Clock, DeadlineEngine, DeadlineOutcome, Degradation, DegradationKind, DegradationStep, Priority,
};
use crate::plan::{CountName, FramePlan, Outputs, Run, Stats};
use presight_model::environment::Environment;
use presight_model::error::{ErrorKind, Result};
use presight_model::geometry::Pose;
use presight_model::sensor::Sensor;
use presight_model::world::World;
use std::sync::{Arc, Mutex};
use std::time::Duration;

/// A clock that only moves when it is set.
#[derive(Debug, Default)]
struct Standing(Mutex<Duration>);

impl Standing {
    fn pass(&self, microseconds: f64) {
        *self.0.lock().unwrap() += Duration::from_secs_f64(microseconds * 1e-6);
    }
}

impl Clock for Standing {
    fn now(&self) -> Duration {
        *self.0.lock().unwrap()
    }
}

/// Recorded times of an engine, microseconds.
#[derive(Clone, Copy)]
struct Recorded {
    selection: f64,
    /// Per polygon.
    polygon: f64,
    images: f64,
    /// Factor on all times.
    slow: f64,
    /// Share of drawing and images that thinning does not save.
    fixed: f64,
}

const RECORDED: Recorded = Recorded { selection: 200.0, polygon: 1.0, images: 500.0, slow: 1.0, fixed: 0.4 };

struct Replay {
    clock: Arc<Standing>,
    controller: Controller,
    world: World,
    sensor: Sensor,
    priority: Priority,
    /// Distance between runs, metres.
    spacing: f32,
    /// True if the engine can thin and narrow images.
    draws_parts: bool,
}

/// Outcome of a frame.
#[derive(Debug)]
struct TimedFrame {
    took_us: f64,
    kept: DeadlineOutcome,
    drawn: usize,
    radius: Option<f32>,
    columns: Option<(u32, u32)>,
}

impl Replay {
    fn new() -> Self {
        let clock = Arc::new(Standing::default());
        let mut controller = Controller::default();
        controller.set_clock(clock.clone());
        let sensor = presight_read::preset("laser-scanner").unwrap();
        Self {
            clock,
            controller,
            world: World::new(Environment::new()),
            sensor,
            priority: Priority::default(),
            spacing: 0.1,
            draws_parts: false,
        }
    }

    /// Draws a frame with runs of 10 polygons each, `spacing` apart; the engine can stop between runs.
    fn frame(&mut self, deadline_us: f64, runs: usize, recorded: Recorded) -> Result<TimedFrame> {
        let (deadline, outputs) = (Duration::from_secs_f64(deadline_us * 1e-6), Outputs::default());
        let engine = DeadlineEngine { name: "cpu", adapter: None, threads: 1, draws_parts: self.draws_parts };
        let mut timed = self
            .controller
            .begin(Some((deadline, &self.priority)), Some(engine), &self.sensor, outputs)?
            .expect("it has a deadline");
        self.clock.pass(recorded.selection * recorded.slow);
        let mut plan = FramePlan::new(&self.world, &self.sensor, &Pose::IDENTITY, outputs)?;
        let run = |i| Run { instance: 0, first: 0, count: 10, nearest: self.spacing * i as f32 };
        plan.runs = (0..runs).map(run).collect();
        self.controller.plan(&mut timed, &mut plan)?;
        let watch = plan.watch().cloned().expect("it has a deadline");
        let stride = plan.part().map_or(1, |part| part.stride);
        let slow = recorded.slow * (recorded.fixed + (1.0 - recorded.fixed) * timed.share(stride));
        let mut drawn = 0;
        while drawn < plan.runs.len() && !watch.is_over() {
            self.clock.pass(10.0 * recorded.polygon * slow);
            drawn += 1;
        }
        let drawn_ms = watch.elapsed().as_secs_f64() * 1e3;
        self.clock.pass(recorded.images * slow);
        timed.images_are_made();
        let stopped = drawn < plan.runs.len();
        let clock = DegradationStep { means: DegradationKind::Clock, at_ms: drawn_ms, metres: None };
        let there = (drawn as f64 / runs as f64).powi(2) * timed.share(stride);
        let given_up = (stopped || plan.radius().is_some() || stride > 1).then(|| Degradation {
            complete_to: 0.0,
            samples: ((1.0 - there) * timed.pixels() as f64) as u64,
            stride,
            means: stopped.then_some(clock).into_iter().collect(),
            ..Degradation::default()
        });
        let mut stats = Stats {
            deadline: Some(DeadlineOutcome { drawn_ms, given_up, ..DeadlineOutcome::default() }),
            ..Stats::default()
        };
        stats.count(CountName::RunsSelected, plan.runs.len());
        stats.count(CountName::PolygonsSetUp, 10 * drawn);
        self.controller.end(&timed, &mut stats);
        let took_us = watch.elapsed().as_secs_f64() * 1e6;
        let columns = plan.part().map(|part| (part.first_column, part.end_column));
        Ok(TimedFrame { took_us, kept: stats.deadline.unwrap(), drawn, radius: plan.radius(), columns })
    }

    /// Learns from fifty frames with ample time.
    fn learn(&mut self) {
        for k in 0..50 {
            self.frame(1e9, 100 + 17 * (k % 20), RECORDED).unwrap();
        }
    }
}

#[test]
fn whole_frames_give_nothing_up_and_costs_are_found() {
    let mut replay = Replay::new();
    replay.learn();
    let frame = replay.frame(1e9, 300, RECORDED).unwrap();
    assert_eq!((frame.drawn, frame.radius, frame.kept.given_up), (300, None, None));
    // 200 + 3000 + 500 microseconds.
    assert!((frame.kept.time_ms - 3.7).abs() < 1e-6, "{}", frame.kept.time_ms);
    assert!((frame.kept.estimate_ms / 3.7 - 1.0).abs() < 0.02, "{}", frame.kept.estimate_ms);
}

/// By hand: after 600 of 800 microseconds, half of the rest is kept for images, so ten runs of 10 are drawn. The
/// default costs of these images are far above 200 microseconds; a machine may be faster than they say.
#[test]
fn without_learnt_costs_a_frame_is_tried_unless_its_time_is_up() {
    let mut replay = Replay::new();
    let camera =
        "format = 1\nkind = \"camera\"\nwidth = 1280\nheight = 200\nfx = 600.0\nfy = 600.0\ncx = 640.0\ncy = 100.0\n";
    replay.sensor = Sensor::new(presight_read::sensor_toml::parse(camera, "", None).unwrap()).unwrap();
    replay.draws_parts = true;
    let recorded = Recorded { selection: 600.0, images: 50.0, ..RECORDED };
    let frame = replay.frame(800.0, 300, recorded).unwrap();
    assert_eq!((frame.drawn, frame.took_us.round()), (10, 750.0));
    let mut replay = Replay { controller: Controller::default(), ..replay };
    replay.controller.set_clock(replay.clock.clone());
    let refused = replay.frame(600.0, 300, recorded).unwrap_err();
    assert_eq!(refused.kind(), ErrorKind::Deadline);
    // Twice the selection and the margin.
    assert!(refused.to_string().contains("; give 1.300 ms or more"), "{refused}");
    assert!(replay.frame(1300.0, 300, recorded).is_ok());
}

#[test]
fn deadlines_are_kept_by_stopping_in_time_for_the_images() {
    let mut replay = Replay::new();
    replay.learn();
    for deadline in [1000.0, 1500.0, 2500.0, 3500.0] {
        let frame = replay.frame(deadline, 300, RECORDED).unwrap();
        assert!(frame.took_us <= deadline, "{} of {deadline}", frame.took_us);
        // Only the time for images and the margin is reserved, so little more is given up than necessary.
        let possible = (deadline - 700.0) / 10.0;
        assert!(
            frame.drawn as f64 > possible - 25.0 && (frame.drawn as f64) < possible,
            "{} of {possible}",
            frame.drawn
        );
    }
}

/// By hand: 1000 microseconds minus 200, 500 and 100 suffice for 20 runs of 10; the rest certainly cannot be drawn.
#[test]
fn a_radius_is_a_prefix_of_the_runs() {
    let mut replay = Replay::new();
    replay.learn();
    let frame = replay.frame(1000.0, 300, RECORDED).unwrap();
    let radius = frame.radius.expect("it is cut");
    // Runs within 2 m are never cut; there are 20 of them.
    assert!((2.0..2.4).contains(&radius), "{radius}");
    let means = &frame.kept.given_up.as_ref().unwrap().means;
    assert_eq!(means[0].means, DegradationKind::Radius);
    assert!((means[0].metres.unwrap() - f64::from(radius)).abs() < 1e-9);
    // Rounded down: no run that was cut off is nearer.
    let first_out = (0..300).map(|i| 0.1 * i as f32).find(|nearest| *nearest > radius).unwrap();
    assert!(radius < first_out && radius > first_out - 1e-5);
    // A larger minimum radius is kept.
    replay.priority.min_radius = 5.0;
    assert!((5.0..5.2).contains(&replay.frame(1000.0, 300, RECORDED).unwrap().radius.unwrap()));
    // A frame that fits is not cut.
    assert_eq!(replay.frame(4500.0, 300, RECORDED).unwrap().radius, None);
}

/// By hand: all 300 runs are within 2 m. With every fourth column, a quarter of all, they need (0.4 + 0.6 / 4) of 3000
/// microseconds: 1650. Available are 1000 minus 200, 500 (0.4 + 0.6 / 4), 100, and 200 for another selection. That is a
/// seventh, so about 49 of 361 columns stay, 25 degrees to either side of the heading.
#[test]
fn the_angle_shrinks_when_the_least_radius_is_too_much() {
    let mut replay = Replay::new();
    replay.learn();
    (replay.spacing, replay.draws_parts) = (0.005, true);
    let columns = |replay: &mut Replay| replay.frame(1000.0, 300, RECORDED).unwrap().columns.expect("it is narrowed");
    let (first, end) = columns(&mut replay);
    // The first column is a multiple of the largest stride; the estimate is a low one.
    assert!((46..=60).contains(&(end - first)) && first.is_multiple_of(8), "{first}..{end}");
    // Two columns per degree, 180 is straight ahead; the first column is rounded down to a multiple of 8.
    let off = |(first, end): (u32, u32), middle: u32| first.midpoint(end).abs_diff(middle);
    assert!(off((first, end), 180) <= 8, "{first}..{end}");
    replay.priority.heading = 45f64.to_radians();
    let left = columns(&mut replay);
    replay.priority.heading = -45f64.to_radians();
    let right = columns(&mut replay);
    let opposite = off(left, 270).min(off(left, 90)) <= 8 && off(right, 270).min(off(right, 90)) <= 8;
    assert!(opposite && left.0.abs_diff(right.0) > 120, "{left:?} {right:?}");
    assert_eq!(replay.frame(4500.0, 300, RECORDED).unwrap().columns, None);
    // After a selection of 500, less than 500 are left for another one.
    assert_eq!(replay.frame(1000.0, 300, Recorded { selection: 500.0, ..RECORDED }).unwrap().columns, Some((0, 361)));
}

/// By hand: after selection 2000 microseconds are left. Whole images leave 1400 of the 3000 for drawing: by the initial
/// curve, a fifth of the samples. Every second column takes 0.7 of both: 350 and the margin for images leave 1550 of
/// 2100, which gives half of the thinned samples.
#[test]
fn images_are_thinned_where_that_leaves_more_samples() {
    let stride = |frame: &TimedFrame| frame.kept.given_up.as_ref().map_or(1, |given_up| given_up.stride);
    let mut replay = Replay::new();
    replay.learn();
    replay.draws_parts = true;
    let frame = replay.frame(2200.0, 300, RECORDED).unwrap();
    assert_eq!(stride(&frame), 2);
    assert!(frame.took_us <= 2200.0, "{}", frame.took_us);
    assert_eq!(stride(&replay.frame(4500.0, 300, RECORDED).unwrap()), 1);
    // The controller notices an engine that saves nothing by thinning.
    let in_vain = Recorded { fixed: 1.0, ..RECORDED };
    let strides: Vec<u32> = (0..30).map(|_| stride(&replay.frame(2200.0, 300, in_vain).unwrap())).collect();
    assert!(strides[0] > 1 && strides[20..].iter().all(|stride| *stride == 1), "{strides:?}");
}

/// One frame in twenty takes ten times as long for its images, 5000 microseconds. Reserving that would leave no time of
/// 3500 for drawing, so only half is reserved.
#[test]
fn slow_frames_that_may_come_do_not_stop_all_others() {
    let mut replay = Replay::new();
    for k in 0..100 {
        let images = if k % 20 == 0 { 10.0 * RECORDED.images } else { RECORDED.images };
        replay.frame(1e9, 100 + 17 * (k % 19), Recorded { images, ..RECORDED }).unwrap();
    }
    let frame = replay.frame(3500.0, 300, RECORDED).unwrap();
    assert!(frame.drawn >= 120, "{}", frame.drawn);
    assert!(frame.took_us <= 3500.0, "{}", frame.took_us);
}

#[test]
fn a_machine_that_gets_busy_is_planned_for_in_a_few_frames() {
    let mut replay = Replay::new();
    replay.learn();
    let busy = Recorded { slow: 3.0, ..RECORDED };
    let late: Vec<bool> = (0..40).map(|_| replay.frame(4000.0, 300, busy).is_ok_and(|f| f.took_us > 4000.0)).collect();
    assert!(late[0], "nobody could know");
    assert!(late[4..].iter().all(|late| !late), "{late:?}");
}

#[test]
fn what_cannot_be_done_is_refused_at_once_and_tried_when_that_may_be_wrong() {
    let mut replay = Replay::new();
    replay.learn();
    for _ in 0..500 {
        let before = replay.clock.now();
        let refused = replay.frame(100.0, 300, RECORDED).unwrap_err();
        assert_eq!((refused.kind(), replay.clock.now()), (ErrorKind::Deadline, before));
        assert!(refused.to_string().contains("; give 0."), "{refused}");
    }
    // A machine was three times slower for a long time and is fast again: doubt grows until one frame is tried.
    let busy = Recorded { slow: 3.0, ..RECORDED };
    (0..300).for_each(|_| drop(replay.frame(1e9, 300, busy)));
    let tries = (0..200).position(|_| replay.frame(1100.0, 300, RECORDED).is_ok());
    assert!(tries.is_some_and(|tries| tries < 100), "{tries:?}");
}

/// Equal records give bit-equal decisions. Another test shows, with the file format, that a saved model reads back
/// bit-equal.
#[test]
fn decisions_replay() {
    let run = || {
        let mut replay = Replay::new();
        replay.learn();
        let frames = (1..60).map(|k| replay.frame(60.0 * f64::from(k), 300, RECORDED).map_err(|e| e.to_string()));
        format!("{:?}", frames.collect::<Vec<_>>())
    };
    assert_eq!(run(), run());
}
