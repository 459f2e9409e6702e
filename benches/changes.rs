//! Measures the time of a change of the world: `cargo bench --bench changes -- [SCENE]..` (default: `scenes/room.glb`).
//!
//! A move, a group of two moves, and a group of 50 moves and 50 deletes as updates make them, each before any prediction, after a
//! prediction, and after one while a reader holds a clone of the world. Only the reader may cause a copy of objects and index:
//! predictors keep no part of a world. The time includes objects and index. A last column has the time by which the next
//! prediction on the device that `Backend::Auto` takes is longer than the one after it: what the change costs there.

#![allow(missing_docs, clippy::print_stdout, reason = "a program that prints figures")]

use presight::{Scene, SensorPose};
use presight_model::change::Change;
use presight_model::geometry::Pose;
use presight_model::world::World;
use presight_predict::predict::{Backend, Options, Predictor};
use presight_predict::request::Request;
use std::error::Error;
use std::time::Instant;

const RUNS: usize = 201;

/// Who uses the world before it changes.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Before {
    Nobody,
    Predictor,
    Reader,
}

fn median_us(mut times: Vec<f64>) -> f64 {
    times.sort_by(f64::total_cmp);
    times.get(times.len() / 2).copied().unwrap_or(f64::NAN) * 1e6
}

/// The change whose time is measured.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Kind {
    Move,
    TwoMoves,
    /// As many moves and deletes.
    Hundred,
}

/// Objects of the last kind.
const HUNDRED: usize = 100;

/// Moves the first half of objects spread over the list, and deletes the others.
fn hundred(world: &World, step: f64) -> Vec<Change> {
    let objects: Vec<_> = world.environment().objects().iter().filter(|object| !object.is_deleted()).collect();
    let chosen = objects.iter().step_by((objects.len() / HUNDRED).max(1)).take(HUNDRED);
    let change = |(number, object): (usize, &&presight_model::environment::Object)| {
        let (name, pose) = (object.name.clone(), object.world_from_object);
        let there = Pose { translation: pose.translation + glam::DVec3::new(step, 0.0, 0.0), ..pose };
        if number % 2 == 0 { Change::SetPose { name, world_from_object: there } } else { Change::DeleteObject { name } }
    };
    chosen.enumerate().map(change).collect()
}

/// Moves the first and the last object of the list back and forth.
fn moves(world: &World, step: f64) -> Vec<Change> {
    let objects = world.environment().objects();
    let ends = [objects.first(), objects.last()].into_iter().flatten();
    let change = |name: &str, pose: Pose| {
        let there = Pose { translation: pose.translation + glam::DVec3::new(step, 0.0, 0.0), ..pose };
        Change::MoveObject { name: name.to_owned(), world_from_object: there }
    };
    ends.map(|object| change(&object.name, object.world_from_object)).collect()
}

fn change(world: &World, kind: Kind, run: usize) -> Change {
    let step = if run.is_multiple_of(2) { 0.01 } else { -0.01 };
    match kind {
        Kind::Move => moves(world, step).swap_remove(0),
        Kind::TwoMoves => Change::Group(moves(world, step)),
        Kind::Hundred => Change::Group(hundred(world, step)),
    }
}

fn measure(world: &mut World, kind: Kind, before: Before) -> Result<f64, Box<dyn Error>> {
    let sensor = presight_read::preset("laser-scanner")?;
    let mut predictor = Predictor::new(Options::new(Backend::Cpu).with_threads(1))?;
    let mut times = Vec::with_capacity(RUNS);
    for run in 0..RUNS {
        let change = change(world, kind, run);
        if before != Before::Nobody {
            predictor.predict(world, &sensor, &SensorPose::IDENTITY, &Request::default())?;
        }
        let reader = (before == Before::Reader).then(|| world.clone());
        let start = Instant::now();
        let back = world.apply(change)?;
        times.push(start.elapsed().as_secs_f64());
        drop(reader);
        if kind == Kind::Hundred {
            // Deleted objects come back.
            world.apply(back)?;
        }
    }
    Ok(median_us(times))
}

/// By how much the first prediction after a change is longer than the second.
fn on_device(world: &mut World, kind: Kind) -> Result<(f64, String), Box<dyn Error>> {
    let sensor = presight_read::preset("laser-scanner")?;
    let mut predictor = Predictor::new(Options::new(Backend::Auto))?;
    let mut times = Vec::new();
    for run in 0..RUNS / 4 {
        let back = world.apply(change(world, kind, run))?;
        let mut predict = || {
            let start = Instant::now();
            predictor.predict(world, &sensor, &SensorPose::IDENTITY, &Request::default())?;
            Ok::<f64, Box<dyn Error>>(start.elapsed().as_secs_f64())
        };
        let (first, second) = (predict()?, predict()?);
        times.push(first - second);
        if kind == Kind::Hundred {
            world.apply(back)?;
        }
    }
    Ok((median_us(times), predictor.engine_name()))
}

fn main() -> Result<(), Box<dyn Error>> {
    let given: Vec<String> = std::env::args().skip(1).filter(|arg| arg != "--bench").collect();
    let scenes = if given.is_empty() { vec!["scenes/room.glb".to_owned()] } else { given };
    println!(
        "| scene | objects | polygons | change | alone, us | after a prediction, us | with a reader's clone, us | on the device, us |"
    );
    println!("|---|---|---|---|---|---|---|---|");
    for scene in scenes {
        let mut world = Scene::open(&scene)?.world;
        let objects = world.environment().objects().len();
        let polygons: usize = world.environment().objects().iter().map(|o| o.mesh.polygon_count()).sum();
        for (name, kind) in [
            ("move", Kind::Move),
            ("group of two moves", Kind::TwoMoves),
            ("group of 50 moves and 50 deletes", Kind::Hundred),
        ] {
            let [alone, after, reader] =
                [Before::Nobody, Before::Predictor, Before::Reader].map(|before| measure(&mut world, kind, before));
            let (alone, after, reader) = (alone?, after?, reader?);
            let (device, by) = on_device(&mut world, kind)?;
            println!(
                "| {scene} | {objects} | {polygons} | {name} | {alone:.2} | {after:.2} | {reader:.2} | {device:.0}, {by} |"
            );
        }
    }
    Ok(())
}
