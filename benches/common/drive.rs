//! Drives with steps of 10 cm and 2 degrees: independent frames, and frames that start from the previous frame's
//! result.

use crate::{cameras, middle, number, scenes};
use cpu_time::ProcessTime;
use glam::DVec3;
use presight_model::geometry::Pose;
use presight_model::sensor::{Angles, Geometry, Scanner, Sensor, SensorSpec};
use presight_model::world::World;
use presight_predict::gpu::{DeviceOptions, GpuEngine};
use presight_predict::request::Request;
use presight_read::preset;
use presight_render::plan::{CountName, StageName};
use presight_render::plan::{FramePlan, Images, Stats};

const STEPS: usize = 30;

/// Runs both kinds of frame, in turns at each pose, along drives that start at `PRESIGHT_POSES` (default 4) free poses
/// and stay free. The fastest of `PRESIGHT_REPEATS` (default 3) runs counts. Leaves out each drive's first pose and
/// poses with nothing in view.
pub fn compare(named: &[String]) {
    let usual = ["hospital", "factory_hall"].map(str::to_owned);
    println!(
        "| scene, sensor | reused frames | runs selected | runs brought | runs hidden | polygons set up | submission to answer, ms | warm over cold: median (10 %, 90 %) | CPU time, ms | warm over cold | samples that differ |"
    );
    println!("|{}", "---|".repeat(11));
    for scene in if named.is_empty() { &usual[..] } else { named } {
        let world = World::new(scenes::environment(scene));
        let drives = drives(scene, &world);
        let lens = cameras::sensors().swap_remove(1);
        for sensor in [preset("video-camera").ok(), preset("microwave-radar-image").ok(), Some(lens)].iter().flatten() {
            measure(scene, &world, sensor, &drives);
        }
    }
}

/// Drives to the left, or to the right where something is in the way.
fn drives(scene: &str, world: &World) -> Vec<Vec<Pose>> {
    let azimuth = Angles::Uniform { start_deg: -180.0, step_deg: 1.0, count: 360 };
    let elevation = Angles::Uniform { start_deg: 0.0, step_deg: 1.0, count: 1 };
    let around = Geometry::Scanner(Scanner { azimuth, elevation, beam_height_deg: None });
    let around = Sensor::new(SensorSpec::new("around", "laser", around)).expect("a valid scanner");
    let is_clear = |pose: &Pose| {
        let (plan, mut images) = (FramePlan::new(world, &around, pose, &Request::default()), Images::default());
        presight_render::reference::render(&plan.expect("a valid pose"), &mut images).expect("it renders");
        images.range.iter().all(|range| *range > 0.15)
    };
    let wanted = number("PRESIGHT_POSES", 4);
    let mut found = Vec::new();
    for start in scenes::poses(scene, world, 10 * wanted) {
        let along = |degrees: f64| {
            let step = Pose::from_xyz_rpy(DVec3::new(0.1, 0.0, 0.0), 0.0, 0.0, degrees.to_radians());
            let poses: Vec<Pose> = std::iter::successors(Some(start), |pose| Some(*pose * step)).take(STEPS).collect();
            poses.iter().all(is_clear).then_some(poses)
        };
        found.extend(along(2.0).or_else(|| along(-2.0)));
        if found.len() == wanted {
            break;
        }
    }
    found
}

/// The figures of one frame, cold and warm.
#[derive(Clone, Default)]
struct Frame {
    device: [f64; 2],
    cpu: [f64; 2],
    hidden: [u64; 2],
    set_up: [u64; 2],
    selected: u64,
    brought: u64,
    differ: usize,
}

fn measure(scene: &str, world: &World, sensor: &Sensor, drives: &[Vec<Pose>]) {
    let open = || GpuEngine::new(DeviceOptions::default()).expect("an adapter");
    let mut engines = [open(), open()];
    eprintln!(
        "{scene}, {} {} x {}, {} drives, on {}",
        sensor.spec().name,
        sensor.width(),
        sensor.height(),
        drives.len(),
        engines[0].adapter()
    );
    let mut frames: Vec<Frame> = Vec::new();
    for poses in drives {
        let mut of_drive: Vec<Frame> = Vec::new();
        for _ in 0..number("PRESIGHT_REPEATS", 3) {
            let again: Vec<Frame> = poses.iter().map(|pose| at_pose(world, sensor, pose, &mut engines)).collect();
            if of_drive.is_empty() {
                of_drive.clone_from(&again);
            }
            for (least, frame) in of_drive.iter_mut().zip(&again) {
                for k in 0..2 {
                    least.device[k] = least.device[k].min(frame.device[k]);
                    least.cpu[k] = least.cpu[k].min(frame.cpu[k]);
                }
                least.differ += frame.differ;
            }
        }
        frames.extend(of_drive.into_iter().skip(1).filter(|frame| frame.selected > 0));
    }
    let mean = |of: &dyn Fn(&Frame) -> f64| frames.iter().map(of).sum::<f64>() / frames.len() as f64;
    let pair = |of: &dyn Fn(&Frame) -> [f64; 2], digits: usize| {
        let [cold, warm] = [0, 1].map(|k| mean(&|frame| of(frame)[k]));
        format!("{cold:.digits$} -> {warm:.digits$}")
    };
    let ratio = |of: &dyn Fn(&Frame) -> [f64; 2]| {
        let mut ratios: Vec<f64> = frames.iter().map(|frame| of(frame)[1] / of(frame)[0]).collect();
        ratios.sort_by(f64::total_cmp);
        let (low, high) = (ratios[ratios.len() / 10], ratios[9 * ratios.len() / 10]);
        format!("{:.2} ({low:.2}, {high:.2})", middle(ratios))
    };
    println!(
        "| {scene}, {} {} x {} | {} of {} | {:.0} | {:.0} | {} | {} | {} | {} | {} | {} | {} |",
        sensor.spec().name,
        sensor.width(),
        sensor.height(),
        frames.iter().filter(|frame| frame.brought > 0).count(),
        frames.len(),
        mean(&|frame| frame.selected as f64),
        mean(&|frame| frame.brought as f64),
        pair(&|frame| frame.hidden.map(|n| n as f64), 0),
        pair(&|frame| frame.set_up.map(|n| n as f64), 0),
        pair(&|frame| frame.device, 1),
        ratio(&|frame| frame.device),
        pair(&|frame| frame.cpu, 1),
        ratio(&|frame| frame.cpu),
        frames.iter().map(|frame| frame.differ).sum::<usize>(),
    );
}

fn at_pose(world: &World, sensor: &Sensor, pose: &Pose, engines: &mut [GpuEngine; 2]) -> Frame {
    let (mut frame, mut images) = (Frame::default(), [Images::default(), Images::default()]);
    for (k, engine) in engines.iter_mut().enumerate() {
        let mut plan = FramePlan::new(world, sensor, pose, &Request::default()).expect("a valid pose");
        if k == 1 {
            plan.set_reuse_visible();
        }
        let (cpu, mut stats) = (ProcessTime::now(), Stats::default());
        engine.render(&plan, &mut images[k], &mut stats).expect("the engine renders");
        frame.cpu[k] = cpu.elapsed().as_secs_f64() * 1e3;
        frame.device[k] = stats.stage_ms(StageName::Device).unwrap_or(0.0);
        let count = |name| stats.count_of(name).unwrap_or(0);
        frame.hidden[k] = count(CountName::RunsHidden);
        frame.set_up[k] = count(CountName::PolygonsSetUp);
        frame.selected = count(CountName::RunsSelected);
        frame.brought = count(CountName::RunsShownBefore);
    }
    let [cold, warm] = &images;
    let pairs = cold.range.iter().zip(&warm.range).zip(cold.polygon_id.iter().zip(&warm.polygon_id));
    frame.differ = pairs.filter(|((a, b), (c, d))| a.to_bits() != b.to_bits() || c != d).count();
    frame
}
