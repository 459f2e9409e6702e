//! Measures supervision of a corridor of 4 x 0.8 m: `cargo bench --bench supervise` prints tables in Markdown. Scenes:
//! the factory hall and the hospital in `PRESIGHT_DATA` (default `../shared/data`). `FRAMES` (30) sets the number of
//! intruders of each scene and sensor, `EMPTY` (100) that of frames without one, `SEED` (1) the random numbers. The truth
//! is worked out by rays of the test kit's own caster.
#![expect(clippy::print_stdout, reason = "a bench prints a table")]

use glam::DVec3;
use presight_localize::simulate::{Disturbances, Simulator, displace};
use presight_localize::verdict::{ExpectedImage, Surfaces};
use presight_model::geometry::{Pose, RobotPose};
use presight_model::sensor::Sensor;
use presight_model::statistics::median;
use presight_model::world::World;
use presight_predict::predict::{Backend, Options, Predictor};
use presight_predict::virtual_sensors::Corridor;
use presight_supervise::query::surface_distance;
use presight_supervise::{CellState, Cells, SuperviseOptions, Supervisor};
use presight_testkit::intruders::{
    HALF_WIDTH, HEIGHTS, KINDS, LENGTH, believed, floor_poses, random_place, sensors, truth, with_intruder,
};
use presight_testkit::{Random, data, env_number};
use std::time::Instant;

/// Deviations of the robot's pose: metres and radians along and about each axis.
const DEVIATION: [f64; 2] = [0.003, 0.001];

fn main() {
    let (frames, empty) = (env_number("FRAMES", 30) as usize, env_number("EMPTY", 100) as usize);
    println!(
        "| scene, sensor | intruders with 3 pixels: missed | free cells that hide a part | distance off, median, mm | beyond 3.3 sigma | alarms, empty | alarms, known objects 1 cm off | hidden share, rays | prediction, ms | supervision in addition, ms |"
    );
    println!("|---|---|---|---|---|---|---|---|---|---|");
    for scene in ["factory_hall", "hospital"] {
        let Some(model) = data::scene(scene, true) else { continue };
        let mut random = Random(env_number("SEED", 1));
        let clear = floor_poses(&model, 4, &mut random, &mut |pose| is_clear(&model, pose, 0.15)).expect("clear ways");
        let beside = floor_poses(&model, 4, &mut random, &mut |pose| brushes(&model, pose)).expect("ways along walls");
        for (name, sensor) in sensors() {
            let mut row = Row::default();
            let mut bench = Bench::new(&model, &sensor, &mut random);
            (0..frames).for_each(|k| bench.intruder(&mut row, clear[k % clear.len()], k % KINDS.len()));
            row.empty = bench.empty(&clear, empty);
            row.known = bench.known(&beside, empty / 4);
            row.print(&format!("{scene}, {name}"));
        }
    }
}

fn corridor() -> Corridor {
    let corners = vec![[0.0, -HALF_WIDTH], [LENGTH, -HALF_WIDTH], [LENGTH, HALF_WIDTH], [0.0, HALF_WIDTH]];
    Corridor::polygon(corners, HEIGHTS[0], HEIGHTS[1]).expect("a corridor")
}

fn distance(model: &World, p: DVec3) -> f64 {
    surface_distance(model, p).expect("finite").map_or(f64::INFINITY, |n| n.distance)
}

/// True if no surface is near the middle of any third cell of the corridor.
fn is_clear(model: &World, pose: &Pose, least: f64) -> bool {
    let cells = Cells::new(&corridor(), 0.2).expect("cells");
    let far = |cell: usize| distance(model, pose.transform_point(cells.middle(cell))) > least;
    (0..cells.count()).all(far)
}

/// True if the robot stands free and the corridor has surfaces in its outer third only.
fn brushes(model: &World, pose: &Pose) -> bool {
    let cells = Cells::new(&corridor(), 0.2).expect("cells");
    let near = |cell: usize| distance(model, pose.transform_point(cells.middle(cell))) < 0.1;
    let (inner, outer): (Vec<usize>, Vec<usize>) =
        (0..cells.count()).partition(|cell| cells.middle(*cell).x < 1.0 || cells.middle(*cell).y.abs() < 0.2);
    !inner.into_iter().any(near) && outer.into_iter().filter(|cell| near(*cell)).count() > 8
}

#[derive(Default)]
struct Row {
    seen: usize,
    missed: usize,
    free: usize,
    hiding: usize,
    off: Vec<f64>,
    beyond: usize,
    empty: [usize; 2],
    known: [usize; 2],
    hidden: Vec<f64>,
    prediction: Vec<f64>,
    beside: Vec<f64>,
}

impl Row {
    fn print(&mut self, what: &str) {
        let middle = |values: &mut Vec<f64>| median(values).unwrap_or(f64::NAN);
        println!(
            "| {what} | {} of {} | {} of {} | {:.1} | {} of {} | {} in {} | {} in {} | {:.3} | {:.2} | {:.2} |",
            self.missed,
            self.seen,
            self.hiding,
            self.free,
            1e3 * middle(&mut self.off),
            self.beyond,
            self.off.len(),
            self.empty[0],
            self.empty[1],
            self.known[0],
            self.known[1],
            middle(&mut self.hidden),
            1e3 * middle(&mut self.prediction),
            1e3 * middle(&mut self.beside),
        );
    }
}

struct Bench<'a> {
    model: &'a World,
    sensor: &'a Sensor,
    supervisor: Supervisor,
    predictor: Predictor,
    random: &'a mut Random,
}

fn predictor() -> Predictor {
    Predictor::new(Options::new(Backend::Cpu).with_threads(1)).expect("the CPU engine starts")
}

impl<'a> Bench<'a> {
    fn new(model: &'a World, sensor: &'a Sensor, random: &'a mut Random) -> Self {
        let supervisor = Supervisor::new(corridor(), SuperviseOptions::default()).expect("sound options");
        Self { model, sensor, supervisor, predictor: predictor(), random }
    }

    fn simulator(&mut self) -> Simulator {
        let seed = (1e9 * self.random.unit()) as u64;
        Simulator::new(predictor(), self.sensor.clone(), Disturbances::default(), seed).expect("a simulator")
    }

    fn intruder(&mut self, row: &mut Row, robot: Pose, kind: usize) {
        let place = random_place(self.random);
        let environment = with_intruder(self.model.environment(), robot * place, kind);
        let alone = truth::alone(&environment, &(robot * self.sensor.spec().mount));
        let world = World::new(environment);
        let frame = self.simulator().frame(&world, 0.0, &RobotPose::new(robot)).expect("a frame");
        let belief = believed(&robot, DEVIATION, self.random);
        let start = Instant::now();
        let pose = &belief.world_from_robot;
        ExpectedImage::predict(
            &mut self.predictor,
            self.model,
            &mut Surfaces::default(),
            self.sensor,
            &RobotPose::new(*pose),
        )
        .expect("a prediction");
        let prediction = start.elapsed().as_secs_f64();
        let start = Instant::now();
        let report =
            self.supervisor.supervise(&mut self.predictor, self.model, &[&frame], Some(&belief)).expect("a report");
        row.prediction.push(prediction);
        row.beside.push(start.elapsed().as_secs_f64() - prediction);
        row.hidden.push(report.hidden.iter().sum());
        let pixels = truth::pixels(&world, &alone, &frame, &robot, &corridor());
        if pixels.len() >= 3 {
            row.seen += 1;
            row.missed += usize::from(report.intrusions.is_empty());
            let nearest = pixels.iter().copied().fold(f64::INFINITY, f64::min);
            if let Some(found) = report.intrusions.iter().map(|i| i.range).reduce(f64::min) {
                row.off.push((found - nearest).abs());
                row.beyond += usize::from((found - nearest).abs() > 3.3 * self.sensor.spec().noise.range_sigma);
            }
        }
        let cells = self.supervisor.cells();
        for cell in (0..cells.count()).filter(|cell| report.cells[*cell] == CellState::Free) {
            let (middle, half) = (cells.middle(cell), 0.5 * DVec3::new(cells.side, cells.side, cells.layer_height));
            row.free += 1;
            let is_near = (middle.truncate() - place.translation.truncate()).length() < 1.0;
            row.hiding += usize::from(is_near && alone.holds_part(&robot, middle - half, middle + half, 0.07));
        }
    }

    /// Alarms in frames of an empty corridor, and the number of frames.
    fn empty(&mut self, poses: &[Pose], count: usize) -> [usize; 2] {
        let mut alarms = 0;
        let mut simulator = self.simulator();
        for k in 0..count {
            let robot = poses[k % poses.len()];
            let frame = simulator.frame(self.model, k as f64, &RobotPose::new(robot)).expect("a frame");
            let belief = believed(&robot, DEVIATION, self.random);
            let report = self.supervisor.supervise(&mut self.predictor, self.model, &[&frame], Some(&belief));
            alarms += usize::from(!report.expect("a report").intrusions.is_empty());
        }
        [alarms, count]
    }

    /// Alarms where the corridor has known objects in it, all of the model 1 cm off.
    fn known(&mut self, poses: &[Pose], count: usize) -> [usize; 2] {
        let mut alarms = 0;
        let options = SuperviseOptions::default().with_model_sigma(0.01);
        let mut supervisor = Supervisor::new(corridor(), options).expect("sound options");
        let mut world = self.model.clone();
        displace(&mut world, 0.01, 1).expect("objects are moved");
        let mut simulator = self.simulator();
        for k in 0..count {
            let robot = poses[k % poses.len()];
            let frame = simulator.frame(&world, k as f64, &RobotPose::new(robot)).expect("a frame");
            let belief = believed(&robot, DEVIATION, self.random);
            let report = supervisor.supervise(&mut self.predictor, self.model, &[&frame], Some(&belief));
            alarms += usize::from(!report.expect("a report").intrusions.is_empty());
        }
        [alarms, count]
    }
}
