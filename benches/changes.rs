//! Measures the time of a change of the world: `cargo bench --bench changes -- [SCENE]..` (default: `scenes/room.glb`).
//!
//! A move and a group of two moves, each before any prediction, after a prediction, and after one while a reader holds
//! a clone of the world. Only the reader may cause a copy of objects and index: predictors keep no part of a world.

#![allow(missing_docs, clippy::print_stdout, reason = "a program that prints figures")]

use presight::Scene;
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

fn measure(world: &mut World, group: bool, before: Before) -> Result<f64, Box<dyn Error>> {
    let sensor = presight_files::preset("laser-scanner")?;
    let mut predictor = Predictor::new(Options::new(Backend::Cpu).with_threads(1))?;
    let mut times = Vec::with_capacity(RUNS);
    for run in 0..RUNS {
        let mut changes = moves(world, if run % 2 == 0 { 0.01 } else { -0.01 });
        let change = if group { Change::Group(changes) } else { changes.swap_remove(0) };
        if before != Before::Nobody {
            predictor.predict(world, &sensor, &Pose::IDENTITY, &Request::default())?;
        }
        let reader = (before == Before::Reader).then(|| world.clone());
        let start = Instant::now();
        world.apply(change)?;
        times.push(start.elapsed().as_secs_f64());
        drop(reader);
    }
    Ok(median_us(times))
}

fn main() -> Result<(), Box<dyn Error>> {
    let given: Vec<String> = std::env::args().skip(1).filter(|arg| arg != "--bench").collect();
    let scenes = if given.is_empty() { vec!["scenes/room.glb".to_owned()] } else { given };
    println!(
        "| scene | objects | polygons | change | alone, us | after a prediction, us | with a reader's clone, us |"
    );
    println!("|---|---|---|---|---|---|---|");
    for scene in scenes {
        let mut world = Scene::open(&scene)?.world;
        let objects = world.environment().objects().len();
        let polygons: usize = world.environment().objects().iter().map(|o| o.mesh.polygon_count()).sum();
        for (name, group) in [("move", false), ("group of two moves", true)] {
            let [alone, after, reader] =
                [Before::Nobody, Before::Predictor, Before::Reader].map(|before| measure(&mut world, group, before));
            let (alone, after, reader) = (alone?, after?, reader?);
            println!("| {scene} | {objects} | {polygons} | {name} | {alone:.2} | {after:.2} | {reader:.2} |");
        }
    }
    Ok(())
}
