//! Which way a prediction with a deadline takes. The clocks stand still, so counts and learnt costs alone decide.

use crate::common::{bits, hall, scenes};
use presight_model::geometry::{Pose, SensorPose};
use presight_model::sensor::Sensor;
use presight_model::world::World;
use presight_predict::predict::{Backend, Options, Prediction, Predictor};
use presight_predict::request::Request;
use presight_render::cost::{CostModel, Forecast, Key, WorkCounts};
use presight_render::deadline::Clock;
use presight_render::plan::{ChosenWay, Output, Part, StageName, Way};
use std::sync::Arc;
use std::time::Duration;

/// A clock that stands still.
#[derive(Debug)]
struct Still;

impl Clock for Still {
    fn now(&self) -> Duration {
        Duration::ZERO
    }
}

struct Bench {
    world: World,
    sensor: Sensor,
    pose: Pose,
    predictor: Predictor,
}

impl Bench {
    fn new(sensor: &str, polygons: usize, lean: f64, way: Way) -> Self {
        let world = World::new(hall::open_hall(3, polygons));
        let at = hall::hall_poses(world.environment(), 3, 1)[0].translation;
        let pose = Pose::from_xyz_rpy(at, lean, 0.0, 0.7);
        let options = Options::new(Backend::Cpu).with_threads(1).with_way(way);
        let mut predictor = Predictor::new(options).unwrap();
        predictor.set_clock(Arc::new(Still));
        Self { world, sensor: presight_read::preset(sensor).unwrap(), pose, predictor }
    }

    fn predict(&mut self, deadline: Option<Duration>) -> presight_model::error::Result<Prediction> {
        let mut request = Request::default();
        request.deadline = deadline;
        self.predictor.predict(&self.world, &self.sensor, &SensorPose::new(self.pose), &request)
    }

    /// The way under a deadline, and why tiles were not taken. Complete images have the bits of a prediction without a deadline.
    fn way(&mut self, microseconds: u64) -> (&'static str, Option<String>) {
        let free = self.predict(None).unwrap();
        let timed = self.predict(Some(Duration::from_micros(microseconds))).unwrap();
        assert_eq!(timed.degradation(), None);
        for output in Output::ALL {
            assert_eq!(bits(&free.images, output), bits(&timed.images, output));
        }
        let stats = &timed.stats;
        let why = stats
            .left_out
            .iter()
            .find(|row| row.what == Part::Stage(StageName::RaysByTiles))
            .map(|row| row.why.to_string());
        (if stats.engine == "row" { "row" } else { stats.way.expect("the CPU engine names it").name() }, why)
    }

    /// Costs by which fifty frames of this kind took so long each.
    fn learn(&self, costs: &mut CostModel, forecast: Forecast, microseconds: f64) {
        let outputs = Request::default().outputs;
        let key = Key::new("cpu", None, 1, &self.sensor, outputs, forecast);
        (0..50).for_each(|_| costs.observe(&key, &WorkCounts::default(), 1e-6 * microseconds).unwrap());
    }
}

/// The raster, since tiles may be late.
fn late() -> (&'static str, Option<String>) {
    ("raster", Some(ChosenWay::TILES_TAKE_TOO_LONG.why.to_owned()))
}

/// By hand: a millisecond, twice 361 microseconds, and 100 for the return. After 300 learnt frames each of them is a quantile.
#[test]
fn few_rays_go_by_tiles_if_these_are_surely_in_time() {
    let mut bench = Bench::new("laser-scanner", 20_000, 0.05, Way::Auto);
    bench.predictor.make_trees(&bench.world).unwrap();
    assert_eq!(bench.way(5_000_000), ("tiles", None));
    assert_eq!(bench.way(1_823), ("tiles", None));
    assert_eq!(bench.way(1_821), late());
    let mut costs = CostModel::default();
    bench.learn(&mut costs, Forecast::Tiles, 300.0);
    bench.predictor.set_costs(costs);
    assert_eq!(bench.way(410), ("tiles", None));
    assert_eq!(bench.way(390), late());
}

/// Trees that are lacking are made only if their time is surely within the deadline: 2 microseconds for each polygon.
/// A deadline of 2 ms leaves tiles their millisecond and twice 361 microseconds, and 100 microseconds for the return, but no tree.
#[test]
fn trees_are_made_within_the_deadline_only() {
    let mut bench = Bench::new("laser-scanner", 300_000, 0.05, Way::Tiles);
    let lean = bench.pose;
    let mut way = |deadline_ms| {
        let request = Request::default().with_deadline(Duration::from_millis(deadline_ms));
        bench.predictor.predict(&bench.world, &bench.sensor, &SensorPose::new(lean), &request).unwrap().stats.way
    };
    assert_eq!([way(2), way(2)], [Some(Way::Raster); 2]);
    assert_eq!([way(5000), way(2)], [Some(Way::Tiles); 2]);
}

/// By hand: a row takes at most a millisecond, twice 361 microseconds, and 20 for the return; its cut, a microsecond for each polygon.
#[test]
fn rows_in_the_plane_are_taken_if_they_are_surely_in_time() {
    let mut bench = Bench::new("laser-scanner", 20_000, 0.0, Way::Counts);
    let polygons = bench.world.environment().slot_count();
    let mut request = Request::default();
    for (deadline_us, engine) in [(u64::from(polygons) + 1_741, "cpu"), (u64::from(polygons) + 1_743, "row")] {
        request.deadline = Some(Duration::from_micros(deadline_us));
        for _ in 0..40 {
            let seen =
                bench.predictor.predict(&bench.world, &bench.sensor, &SensorPose::new(bench.pose), &request).unwrap();
            if seen.stats.engine == "row" {
                assert_eq!(engine, "row", "{deadline_us}");
                break;
            }
        }
    }
    assert_eq!(bench.way(1_743).0, "row");
    assert_ne!(bench.way(1_741).0, "row");
    // Images by the raster are known to be too slow for this deadline; a row is known to be in time.
    let mut costs = CostModel::default();
    bench.learn(&mut costs, Forecast::Access, 200.0);
    bench.learn(&mut costs, Forecast::Images, 900.0);
    bench.predictor.set_costs(costs.clone());
    assert_eq!(
        bench.predict(Some(Duration::from_micros(500))).unwrap_err().kind(),
        presight_model::ErrorKind::Deadline
    );
    bench.learn(&mut costs, Forecast::Row, 40.0);
    bench.predictor.set_costs(costs);
    assert_eq!(bench.way(500).0, "row");
    assert_eq!(bench.way(62).0, "row");
}

/// By hand: 28,800 rays take at most 2 microseconds each, a millisecond and 100 microseconds. Three times the default costs of four images
/// are kept for the raster's, with 100 microseconds for the return: 0.1 ms and 0.576, three times, and 0.1. That is 60.828 ms.
#[test]
fn the_raster_turns_to_tiles_if_these_are_surely_in_time() {
    let mut bench = Bench::new("vlp-16", 300_000, 0.0, Way::Counts);
    bench.predictor.make_trees(&bench.world).unwrap();
    assert_eq!(bench.way(5_000_000), ("tiles", None));
    assert_eq!(bench.way(60_830), ("tiles", None));
    assert_eq!(bench.way(60_826).0, "raster");
}

/// A world of few polygons, where a tree gains nothing, and a way that was requested.
#[test]
fn a_deadline_does_not_change_what_counts_decide() {
    let mut bench = Bench::new("laser-scanner", 20_000, 0.05, Way::Raster);
    assert_eq!(bench.way(5_000_000), ("raster", Some("this way was requested".to_owned())));
    bench.world = scenes::room_world(4, 20);
    bench.predictor = Predictor::new(Options::new(Backend::Cpu).with_threads(1)).unwrap();
    assert_eq!(bench.way(5_000_000), ("raster", Some("the world has few polygons".to_owned())));
}
