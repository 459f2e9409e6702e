//! Learns for each sensor which strategy of the CPU engine is faster. Both give the same bits, so learning is free of
//! risk.
//!
//! By counts, tiles take over from the raster if too many polygons may be visible after the first wave
//! ([`Way::choose`]). The costs of a polygon and of a ray depend on the machine and on the sensor, so that this
//! threshold is learnt. A frame's time by either strategy is a linear function of the polygons left, and tiles take
//! over where these functions cross. The threshold stays within a factor of [`RANGE`] of the counted one, and only
//! frames in that range try the other strategy, at first one in [`TRIED_EARLY`], later one in [`TRIED`]. A frame by the
//! wrong strategy takes at most a few times as long, so trials cost little.

use super::{UnitCosts, WorkCounts};
use crate::plan::{ChosenWay, CountName, FramePlan, Outputs, Stats, Way};
use presight_model::sensor::{GroupLayout, Sensor};
use std::time::Duration;

/// Maximum factor between the learnt threshold and the counted one.
const RANGE: u64 = 4;

/// Period of trials, frames: one trial takes the raster instead of tiles, another one the reverse.
const TRIED: u64 = 128;

/// Period of trials among a sensor's first frames, and the number of these frames: enough to use times soon.
const TRIED_EARLY: u64 = 8;
const EARLY: u64 = TRIED_EARLY * ENOUGH;

/// Number of frames by each strategy before their times are used.
const ENOUGH: u64 = 8;

/// Number of successive frames that turned to tiles after which frames go by tiles without a selection.
const IN_SUCCESSION: u32 = 4;

/// Period, frames, of a selection and a first wave nevertheless, to check that tiles are still faster.
const CHECKED: u64 = 16;

/// Maximum number of sensors. A further one displaces the oldest.
const MAX_SENSORS: usize = 64;

/// Learnt times of a sensor's frames.
#[derive(Debug)]
struct SensorWays {
    size: [u32; 2],
    layout: GroupLayout,
    is_camera: bool,
    outputs: Outputs,
    /// Frames chosen.
    frames: u64,
    /// Number of successive frames that turned to tiles.
    turned: u32,
    /// Times of the raster and of tiles over the polygons left.
    costs: [UnitCosts; 2],
}

/// The faster strategy for each sensor. It reads no clock: callers pass times.
#[derive(Debug, Default)]
pub struct WayCosts {
    sensors: Vec<SensorWays>,
}

impl SensorWays {
    fn new(sensor: &Sensor, outputs: Outputs) -> Self {
        Self {
            size: [sensor.width(), sensor.height()],
            layout: sensor.ray_layout(),
            is_camera: sensor.is_camera(),
            outputs,
            frames: 0,
            turned: 0,
            costs: <[UnitCosts; 2]>::default(),
        }
    }

    fn is_of(&self, sensor: &Sensor, outputs: Outputs) -> bool {
        self.size == [sensor.width(), sensor.height()]
            && self.layout == sensor.ray_layout()
            && self.is_camera == sensor.is_camera()
            && self.outputs == outputs
    }

    /// Number of polygons left from which on tiles are faster, by times. `counted` is the number by counts.
    fn max_left(&self, counted: u64) -> u64 {
        if self.costs.iter().any(|costs| costs.frames < ENOUGH) {
            return counted;
        }
        let seconds = |costs: &UnitCosts, left| costs.mean(&of(left));
        let [raster, tiles] = &self.costs;
        // Doubles the number at each step, from the top down while tiles are faster.
        let mut most = RANGE * counted;
        while most > counted / RANGE && seconds(tiles, most) < seconds(raster, most) {
            most /= 2;
        }
        most.max(counted / RANGE)
    }

    /// Number of polygons left from which on a trial takes tiles, if the current frame is a trial.
    fn trial(&self, counted: u64) -> Option<u64> {
        let period = if self.frames <= EARLY { TRIED_EARLY } else { TRIED };
        match self.frames % period {
            0 => Some(counted / RANGE),
            n if n == period / 2 => Some(counted.saturating_mul(RANGE)),
            _ => None,
        }
    }
}

fn of(left: u64) -> WorkCounts {
    WorkCounts { polygons: left, ..WorkCounts::default() }
}

impl WayCosts {
    fn entry(&mut self, sensor: &Sensor, outputs: Outputs) -> &mut SensorWays {
        let at = match self.sensors.iter().position(|known| known.is_of(sensor, outputs)) {
            Some(at) => at,
            None => {
                if self.sensors.len() >= MAX_SENSORS {
                    self.sensors.remove(0);
                }
                self.sensors.push(SensorWays::new(sensor, outputs));
                self.sensors.len() - 1
            }
        };
        &mut self.sensors[at]
    }

    /// The strategy of the next frame, by the times of this sensor's frames. `chosen` is the strategy by counts; if it
    /// does not depend on counts, it is returned.
    pub fn adjust(&mut self, sensor: &Sensor, outputs: Outputs, chosen: ChosenWay) -> ChosenWay {
        if chosen.max_left == u64::MAX {
            return chosen;
        }
        let known = self.entry(sensor, outputs);
        known.frames += 1;
        let counted = chosen.max_left;
        let trial = known.trial(counted);
        let max_left = trial.unwrap_or_else(|| known.max_left(counted));
        if known.turned >= IN_SUCCESSION && trial.is_none() && !known.frames.is_multiple_of(CHECKED) {
            let why = "the sensor's last frames had too many polygons after the first wave";
            return ChosenWay { way: Way::Tiles, why, max_left, ..chosen };
        }
        ChosenWay { max_left, ..chosen }
    }

    /// Learns from a frame that took this time, from the choice to the images.
    pub fn learn(&mut self, plan: &FramePlan, stats: &Stats, took: Duration) {
        let chosen = plan.chosen();
        if chosen.max_left == u64::MAX || stats.degradation().is_some() {
            return;
        }
        let known = self.entry(&plan.sensor, plan.request.outputs);
        if chosen.way == Way::Tiles {
            if stats.way == Some(Way::Raster) {
                known.turned = 0;
            }
            return;
        }
        let by_tiles = stats.way == Some(Way::Tiles);
        if known.trial(0).is_none() {
            known.turned = if by_tiles { known.turned + 1 } else { 0 };
        }
        let left = stats.count_of(CountName::PolygonsLeft);
        if let Some(left) = left.filter(|_| took > Duration::ZERO) {
            known.costs[usize::from(by_tiles)].observe(&of(left), took.as_secs_f64());
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::plan::FramePlan;
    use presight_model::environment::Environment;
    use presight_model::geometry::Pose;
    use presight_model::sensor::{Camera, Geometry, SensorSpec};
    use presight_model::world::World;

    /// A simulated sensor with a constant time by each strategy: numbers of frames by each, and for each frame the time
    /// lost against the faster one.
    struct Simulated {
        ways: WayCosts,
        plan: FramePlan,
        seconds: [fn(f64) -> f64; 2],
        frames: [u64; 2],
        best: f64,
        spent: f64,
    }

    const COUNTED: u64 = 1000;

    impl Simulated {
        fn new(seconds: [fn(f64) -> f64; 2]) -> Self {
            let camera = Camera::pinhole(80, 50, 40.0, 40.0, 40.0, 25.0);
            let sensor = Sensor::new(SensorSpec::new("c", "laser", Geometry::Camera(camera))).unwrap();
            let world = World::new(Environment::new());
            let outputs = Outputs::of(&[crate::plan::Output::Range]);
            let plan = FramePlan::new(&world, &sensor, &Pose::IDENTITY, outputs).unwrap();
            Self { ways: WayCosts::default(), plan, seconds, frames: [0; 2], best: 0.0, spent: 0.0 }
        }

        /// A frame with a number of polygons left after its first wave.
        fn frame(&mut self, left: u64) -> Way {
            let counted = ChosenWay { max_left: COUNTED, ..ChosenWay::RASTER };
            let chosen = self.ways.adjust(&self.plan.sensor, self.plan.request.outputs, counted);
            self.plan.set_chosen(chosen);
            let by_tiles = chosen.way == Way::Tiles || left > chosen.max_left;
            let way = if by_tiles { Way::Tiles } else { Way::Raster };
            let mut stats = Stats { way: Some(way), ..Stats::default() };
            if chosen.way == Way::Raster {
                stats.count(CountName::PolygonsLeft, left as usize);
            }
            let took = self.seconds.map(|seconds| seconds(left as f64));
            self.frames[usize::from(by_tiles)] += 1;
            self.best += took[0].min(took[1]);
            self.spent += took[usize::from(by_tiles)];
            self.ways.learn(&self.plan, &stats, Duration::from_secs_f64(took[usize::from(by_tiles)]));
            way
        }
    }

    /// If the counted threshold is right, trials cost at most 2 %, at any number of polygons.
    #[test]
    fn trying_costs_little() {
        let seconds: [fn(f64) -> f64; 2] = [|n| 1e-3 * (0.4 + 0.6e-3 * n), |_| 1e-3];
        for left in [10, 250, 300, 700, 1001, 1500, 3900, 5000, 100_000] {
            let mut sensor = Simulated::new(seconds);
            (0..3000).for_each(|_| _ = sensor.frame(left));
            assert!(sensor.spent < 1.02 * sensor.best, "{left}: {} {}", sensor.spent, sensor.best);
        }
    }

    /// Tiles of this machine are twice as fast, or twice as slow, as counts expect.
    #[test]
    fn times_correct_counts() {
        let fast: [fn(f64) -> f64; 2] = [|n| 1e-3 * (0.2 + 0.6e-3 * n), |_| 0.45e-3];
        let slow: [fn(f64) -> f64; 2] = [|n| 1e-3 * (0.2 + 0.6e-3 * n), |_| 1.8e-3];
        for (seconds, left, better) in [(fast, 700, Way::Tiles), (slow, 1500, Way::Raster)] {
            let mut sensor = Simulated::new(seconds);
            (0..1200).for_each(|_| _ = sensor.frame(left));
            let late = (0..640).filter(|_| sensor.frame(left) == better).count();
            assert!(late >= 620, "{better}: {late} of 640");
        }
    }

    /// A sensor that leaves a crowded place returns to the raster within one check.
    #[test]
    fn another_place_is_noticed() {
        let mut sensor = Simulated::new([|n| 1e-6 * n, |_| 1e-3]);
        (0..100).for_each(|_| _ = sensor.frame(20_000));
        let before = sensor.frames[0];
        assert!(before <= 2, "{before}");
        (0..CHECKED + 1).for_each(|_| _ = sensor.frame(50));
        assert_eq!(sensor.frame(50), Way::Raster);
    }

    /// Within the first hundred frames, a sensor for which counts choose the slower strategy has turned to the faster
    /// one.
    #[test]
    fn times_count_soon() {
        let mut sensor = Simulated::new([|n| 1e-3 * (0.4 + 1.2e-3 * n), |_| 1e-3]);
        (0..70).for_each(|_| _ = sensor.frame(800));
        let late = (0..30).filter(|_| sensor.frame(800) == Way::Tiles).count();
        assert!(late >= 29, "{late} of 30");
    }

    #[test]
    fn choices_that_leave_nothing_open_stay() {
        let mut sensor = Simulated::new([|_| 1.0, |_| 1e-3]);
        for chosen in [ChosenWay::RASTER, ChosenWay::TILES] {
            let outputs = sensor.plan.request.outputs;
            assert_eq!(sensor.ways.adjust(&sensor.plan.sensor, outputs, chosen), chosen);
            sensor.plan.set_chosen(chosen);
            sensor.ways.learn(&sensor.plan, &Stats::default(), Duration::from_secs(1));
        }
        assert!(sensor.ways.sensors.is_empty());
    }
}
