//! How deadlines are kept, on the CPU engine. Prints the figures of docs/deadline.md:
//!
//! ```sh
//! cargo bench --bench deadline -- figures SCENE.glb [SENSOR] [FRAMES] [busy]
//! cargo bench --bench deadline -- drive SCENE.glb OUT.svg [SENSOR] [busy]
//! ```
//!
//! `busy` keeps one core busy by another process.

#![allow(missing_docs, clippy::print_stdout, reason = "a program that prints figures")]

#[path = "deadline/drive.rs"]
mod drive;
#[path = "deadline/figures.rs"]
mod figures;

use presight::io::gltf::{ImportOptions, import};
use presight::{Backend, Options, Pose, Predictor, Request, Sensor, Stats, World};
use std::error::Error;
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

type Outcome<T = ()> = Result<T, Box<dyn Error>>;

/// A share of values that are no greater (nearest rank); NaN of none.
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
}

impl Bench {
    fn new(scene: &str, sensor: Option<&String>) -> Outcome<Self> {
        let sensor = presight::preset(sensor.map_or("microwave-radar-image", String::as_str))?;
        let world = World::new(import(scene, &ImportOptions::default())?.environment);
        let predictor = Predictor::new(Options::new(Backend::Cpu))?;
        println!("{scene}, {}, {} polygons", sensor.spec().name, world.environment().slot_count());
        Ok(Self { world, sensor, predictor })
    }

    /// Milliseconds of one prediction from outside, and what it says.
    fn frame(&mut self, pose: &Pose, deadline_ms: Option<f64>) -> (f64, presight::Result<Stats>) {
        let mut request = Request::default();
        request.deadline = deadline_ms.map(|ms| Duration::from_secs_f64(ms / 1e3));
        let start = Instant::now();
        let prediction = self.predictor.predict(&self.world, &self.sensor, pose, &request);
        (start.elapsed().as_secs_f64() * 1e3, prediction.map(|p| p.stats))
    }

    fn pixels(&self) -> f64 {
        f64::from(self.sensor.width()) * f64::from(self.sensor.height())
    }
}

/// Another process that keeps a core busy as long as this is there.
struct Busy(Child);

impl Busy {
    fn start(args: &mut Vec<String>) -> Outcome<Option<Self>> {
        if args.last().is_none_or(|arg| arg != "busy") {
            return Ok(None);
        }
        args.pop();
        println!("one core is kept busy by another process");
        let mut command = Command::new("sh");
        command.args(["-c", "while :; do :; done"]).stdout(Stdio::null());
        Ok(Some(Self(command.spawn()?)))
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
    let _busy = Busy::start(&mut args)?;
    match args.first().map(String::as_str) {
        Some("figures") if args.len() > 1 => figures::print(&args[1..]),
        Some("drive") if args.len() > 2 => drive::draw(&args[1..]),
        _ => {
            println!("give: figures SCENE.glb [SENSOR] [FRAMES] [busy], or: drive SCENE.glb OUT.svg [SENSOR] [busy]");
            Ok(())
        }
    }
}
