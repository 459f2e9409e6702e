//! Measures how well deadlines are kept. Prints the figures of benches/runs/2026-11-23-epyc/deadlines.md:
//!
//! ```sh
//! cargo bench --bench deadline -- figures SCENE.glb [SENSOR] [FRAMES] [gpu] [busy|cpu-time]
//! cargo bench --bench deadline -- clairvoyant SCENE.glb [SENSOR] [cpu-time]
//! cargo bench --bench deadline -- drive SCENE.glb OUT.svg [SENSOR] [gpu] [busy|cpu-time]
//! ```
//!
//! `busy` keeps one core busy with another process. `cpu-time` uses one thread and the process's CPU time in place of
//! the clock, which other work on the machine hardly changes. `gpu` selects the GPU engine on any adapter.

#![allow(missing_docs, clippy::print_stdout, reason = "a program that prints figures")]

#[path = "deadline/clairvoyant.rs"]
mod clairvoyant;
#[path = "deadline/drive.rs"]
mod drive;
#[path = "deadline/figures.rs"]
mod figures;
#[path = "deadline/steadiness.rs"]
mod steadiness;

use presight_model::geometry::{Pose, SensorPose};
use presight_model::sensor::Sensor;
use presight_model::world::World;
use presight_predict::predict::{Backend, Options, Predictor};
use presight_predict::request::Request;
use presight_read::gltf::{ImportOptions, import};
use presight_render::deadline::{Clock, SystemClock};
use presight_render::plan::Stats;
use std::error::Error;
use std::process::{Child, Command, Stdio};
use std::sync::Arc;
use std::time::Duration;

type Outcome<T = ()> = Result<T, Box<dyn Error>>;

/// The quantile of this share by nearest rank; NaN for an empty list.
fn quantile(values: &[f64], share: f64) -> f64 {
    let mut sorted = values.to_vec();
    sorted.sort_by(f64::total_cmp);
    let rank = ((share * sorted.len() as f64).ceil() as usize).max(1);
    sorted.get(rank - 1).copied().unwrap_or(f64::NAN)
}

struct Bench {
    world: World,
    sensor: Sensor,
    predictor: Predictor,
    clock: Arc<dyn Clock>,
    threads: usize,
}

/// CPU time of this process.
#[derive(Debug)]
struct CpuTime;

impl Clock for CpuTime {
    fn now(&self) -> Duration {
        cpu_time::ProcessTime::now().as_duration()
    }
}

/// The options of a measurement.
struct Setting {
    backend: Backend,
    by_cpu_time: bool,
    /// Keeps a core busy until it is dropped.
    _busy: Option<Busy>,
}

impl Setting {
    /// Takes the option words off the end of the arguments.
    fn take(args: &mut Vec<String>) -> Outcome<Self> {
        let mut take = |word: &str| args.pop_if(|last| last == word).is_some();
        let (busy, by_cpu_time) = (take("busy"), take("cpu-time"));
        let backend = if take("gpu") { Backend::Gpu } else { Backend::Cpu };
        let _busy = busy.then(Busy::start).transpose()?;
        Ok(Self { backend, by_cpu_time, _busy })
    }
}

impl Bench {
    fn new(scene: &str, sensor: Option<&String>, setting: &Setting) -> Outcome<Self> {
        let sensor = presight_read::preset(sensor.map_or("microwave-radar-image", String::as_str))?;
        let world = World::new(import(scene, &ImportOptions::default())?.environment);
        let threads = usize::from(setting.by_cpu_time);
        let mut predictor = Predictor::new(Options::new(setting.backend).with_threads(threads))?;
        let clock: Arc<dyn Clock> =
            if setting.by_cpu_time { Arc::new(CpuTime) } else { Arc::new(SystemClock::default()) };
        predictor.set_clock(clock.clone());
        let by = if setting.by_cpu_time { ", one thread, times are CPU times" } else { "" };
        let (name, polygons) = (&sensor.spec().name, world.environment().slot_count());
        println!("{scene}, {name}, {polygons} polygons, {}{by}", predictor.engine_name());
        Ok(Self { world, sensor, predictor, clock, threads })
    }

    /// Runs one prediction; returns its time in milliseconds and its statistics.
    fn frame(&mut self, pose: &Pose, deadline_ms: Option<f64>) -> (f64, presight_model::error::Result<Stats>) {
        let mut request = Request::default();
        request.deadline = deadline_ms.map(|ms| Duration::from_secs_f64(ms / 1e3));
        let start = self.clock.now();
        let prediction = self.predictor.predict(&self.world, &self.sensor, &SensorPose::new(*pose), &request);
        (self.since(start), prediction.map(|p| p.stats))
    }

    /// The number of samples missing under a deadline: all of them if it is refused.
    fn lost(&mut self, pose: &Pose, deadline_ms: f64) -> f64 {
        match self.frame(pose, Some(deadline_ms)).1 {
            Ok(stats) => stats.degradation().map_or(0.0, |given_up| given_up.samples as f64),
            Err(_) => self.pixels(),
        }
    }

    /// The milliseconds since `start`.
    fn since(&self, start: Duration) -> f64 {
        (self.clock.now() - start).as_secs_f64() * 1e3
    }

    fn pixels(&self) -> f64 {
        f64::from(self.sensor.width()) * f64::from(self.sensor.height())
    }
}

/// Another process that keeps a core busy until this is dropped.
struct Busy(Child);

impl Busy {
    fn start() -> Outcome<Self> {
        println!("one core is kept busy by another process");
        let mut command = Command::new("sh");
        command.args(["-c", "while :; do :; done"]).stdout(Stdio::null());
        Ok(Self(command.spawn()?))
    }
}

impl Drop for Busy {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

fn main() -> Outcome {
    let mut args: Vec<String> = std::env::args().skip(1).filter(|arg| arg != "--bench").collect();
    let setting = Setting::take(&mut args)?;
    match args.first().map(String::as_str) {
        Some("figures") if args.len() > 1 => figures::print(&args[1..], &setting),
        Some("clairvoyant") if args.len() > 1 => clairvoyant::print(&args[1..], &setting),
        Some("drive") if args.len() > 2 => drive::draw(&args[1..], &setting),
        _ => {
            println!("give: figures SCENE.glb [SENSOR] [FRAMES] [gpu] [busy|cpu-time]");
            println!("or:   clairvoyant SCENE.glb [SENSOR] [cpu-time]");
            println!("or:   drive SCENE.glb OUT.svg [SENSOR] [gpu] [busy|cpu-time]");
            Ok(())
        }
    }
}
