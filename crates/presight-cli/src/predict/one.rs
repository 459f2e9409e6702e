//! One prediction, repeated for timing.

use super::files::{Shown, attributes, write_files};
use super::{Args, Job};
use crate::summary::{Summary, objects_in};
use crate::templates::Names;
use crate::{CommandOutcome, flags, print};
use presight::files;
use presight::tools;
use presight::{Output, Predictor, Result, Stats};
use presight_studies::statistics::{Statistics, Subject};
use std::time::Instant;

/// Predicts at one pose, and writes the files.
///
/// # Errors
/// Errors from reading the scene, from the engine, and from writing files.
pub fn run(args: &Args, mut job: Job) -> Result<CommandOutcome> {
    let (sensor, given) = (job.sensors.remove(0), job.poses.given()[0].1);
    let request = args.request(&sensor)?;
    let mut predictor = Predictor::new(job.options)?;
    args.deadline.read_costs(&mut predictor)?;
    let frame = args.memory(&sensor, &request, &predictor);
    tools::require_memory(frame.bytes())?;
    let scene = args.open(&job.import)?;
    let pose = given.of_sensor(sensor.spec(), &scene.world_from_gltf)?;
    let mut layers = args.layers.load(&scene, &sensor, args.asked())?;
    if let Some(layers) = &mut layers {
        layers.move_to(&given, &sensor, &pose, &scene);
        sensor.check_projection().map_err(|e| e.in_file(args.sensor.as_deref().unwrap_or_default()))?;
    }
    let mut request = layers.as_ref().map_or(request.clone(), |layers| layers.add_to(request));
    let motions = args.motions(&scene, &sensor, Some(&given))?;
    request.motion = motions.at(&sensor, args.motion.stamp()?)?;
    let settings = args.virtual_sensor.settings(&scene, &sensor, &pose, &mut predictor)?;
    // Check again: the scene has taken some of the memory.
    tools::require_memory(frame.bytes())?;
    let start = Instant::now();
    let mut prediction = predictor.predict(&scene.world, &sensor, &pose, &request)?;
    let first_ms = start.elapsed().as_secs_f64() * 1e3;
    let (mut times_ms, mut runs): (Vec<f64>, Vec<Stats>) = Default::default();
    let repeat = args.repeat.unwrap_or(u32::from(args.stats.is_some()));
    for _ in 0..repeat {
        let start = Instant::now();
        predictor.predict_again(&scene.world, &pose, &mut prediction)?;
        times_ms.push(start.elapsed().as_secs_f64() * 1e3);
        runs.push(prediction.stats.clone());
    }
    if repeat == 0 {
        times_ms.push(first_ms);
        runs.push(prediction.stats.clone());
    }
    layers.iter().for_each(|layers| layers.spell_out(&scene, &mut prediction));
    print::notices(&prediction.stats.notices);
    let subject = Subject {
        scene: args.scene.display().to_string(),
        sensor: sensor.spec().name.clone(),
        size: (sensor.width(), sensor.height()),
        outputs: request.outputs.iter().map(Output::name).collect(),
    };
    runs.iter_mut().flat_map(|run| &mut run.notices).for_each(|notice| *notice = flags::named(notice));
    let statistics = Statistics::of(subject, &times_ms, &runs);
    let shown = Shown::of(args, &scene, &mut predictor, &prediction, (layers.as_ref(), &settings))?;
    job.files.check_scene(&scene.files)?;
    args.deadline.write_costs(&predictor)?;
    let paths = job.names.paths(&Names { sensor: &sensor.spec().name, ..Names::default() })?;
    let attributes = args.out.as_ref().map(|_| attributes(args, &scene, &sensor)).transpose()?;
    write_files(args, &paths, &scene, &prediction, attributes, &shown)?;
    paths.npy.iter().try_for_each(|(output, path)| files::write_npy(path, &prediction.images, *output))?;
    job.names.rays(&sensor)?.iter().try_for_each(|path| files::write_rays_npy(path, &sensor))?;
    args.stats.iter().try_for_each(|path| statistics.write(path))?;
    let summary = Summary::of(&prediction, objects_in(scene.world.environment()));
    let (ms, engine) = (statistics.median_ms(), statistics.engine_in_words());
    if args.explain {
        print::lines(statistics.explanation())?;
    } else if args.json {
        print::data(&format!("{}\n", summary.json(&args.scene, &prediction, ms, &engine)))?;
    } else if !args.writes_something() {
        print::lines([format!("{}, {ms:.2} ms on {engine}", summary.in_words(&prediction))])?;
    } else if let Some(given_up) = prediction.degradation() {
        print::notices(&[format!("{}; a longer --deadline-ms gives up less", given_up.summary())]);
    }
    Ok(CommandOutcome::Done)
}
