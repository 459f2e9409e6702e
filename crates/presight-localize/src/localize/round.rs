//! What is seen all round from places of a world, coarsely: where sensors of any shape may be that look anywhere.

use glam::{DQuat, DVec3};
use presight_model::error::Result;
use presight_model::geometry::{Pose, SensorPose};
use presight_model::measured::Frame;
use presight_model::sensor::{Angles, Geometry, Scanner, Sensor, SensorSpec};
use presight_model::world::World;
use presight_predict::batch::BatchRequest;
use presight_predict::predict::Predictor;
use presight_render::plan::{Output, Outputs};
use rayon::prelude::*;
use std::f64::consts::{FRAC_PI_2, PI};

/// Directions of a round view: a turn has so many headings.
pub(super) const HEADINGS: usize = 72;
/// From the zenith to the nadir.
const ROWS: usize = HEADINGS / 2;
/// Degrees between neighbouring directions.
const STEP_DEG: f64 = 360.0 / HEADINGS as f64;
/// The same in radians.
pub(super) const STEP: f64 = 2.0 * PI / HEADINGS as f64;
/// Most that one pixel speaks against a place, as half a squared error in variances: three standard deviations.
const MOST: f32 = 4.5;

/// The ranges in all directions from free places.
#[derive(Clone, Debug)]
pub(super) struct RoundViews {
    /// Of the sensor.
    pub places: Vec<DVec3>,
    /// Place by place, row by row.
    range: Vec<f32>,
    /// How the sensor leans at heading 0.
    level_from_sensor: DQuat,
}

/// A measured pixel, as it is looked up in a round view.
struct SeenDirection {
    row: usize,
    column: usize,
    range: f32,
    /// Half of one over the variance, 1 / square metre.
    sharpness: f32,
}

impl RoundViews {
    /// Looks round at all places, and keeps those that are free.
    ///
    /// # Errors
    /// Those of [`Predictor::batch`].
    pub fn new(
        predictor: &mut Predictor,
        world: &World,
        sensor: &Sensor,
        places: Vec<DVec3>,
        level_from_sensor: DQuat,
        is_free: impl Fn(&[f32]) -> bool,
        watch: &mut dyn FnMut(usize, usize),
    ) -> Result<Self> {
        let azimuth = Angles::Uniform { start_deg: -180.0, step_deg: STEP_DEG, count: HEADINGS as u32 };
        let top = 90.0 - 0.5 * STEP_DEG;
        let elevation = Angles::Uniform { start_deg: top, step_deg: -STEP_DEG, count: ROWS as u32 };
        let geometry = Geometry::Scanner(Scanner { azimuth, elevation, beam_height_deg: None });
        let mut spec = SensorSpec::new(&sensor.spec().name, &sensor.spec().class, geometry);
        (spec.range_min, spec.range_max) = (sensor.spec().range_min, sensor.spec().range_max);
        let request = BatchRequest { images: Some(Outputs::of(&[Output::Range]).into()), ..BatchRequest::default() };
        let all = places.len();
        let poses = places.into_iter().map(|translation| SensorPose::new(Pose { translation, ..Pose::IDENTITY }));
        let mut views = Self { places: Vec::new(), range: Vec::new(), level_from_sensor };
        for (k, item) in predictor.batch(world, &Sensor::new(spec)?, poses, &request)?.enumerate() {
            watch(k, all);
            let item = item?;
            if is_free(&item.images.range) {
                views.places.push(item.pose.world_from_sensor().translation);
                views.range.extend_from_slice(&item.images.range);
            }
        }
        Ok(views)
    }

    /// How well a frame fits at all headings of all places, place by place: minus half the squared errors, in variances. What is
    /// seen from elsewhere in the `cell` of a place, or between two directions, counts as noise.
    ///
    /// # Errors
    /// Those of [`Predictor::on_threads`].
    pub fn weigh(&self, predictor: &mut Predictor, frame: &Frame, sigma: f64, cell: f64) -> Result<Vec<f32>> {
        let seen = self.directions(frame, sigma, cell);
        let one = |view: &[f32]| {
            let mut costs = [0.0f32; HEADINGS];
            for s in &seen {
                let row = &view[s.row * HEADINGS..(s.row + 1) * HEADINGS];
                for (heading, cost) in costs.iter_mut().enumerate() {
                    let off = row[(s.column + heading) % HEADINGS] - s.range;
                    // Nothing predicted is as far off as anything: `min` passes over NaN.
                    *cost -= (s.sharpness * off * off).min(MOST);
                }
            }
            costs
        };
        let views = self.range.par_chunks(ROWS * HEADINGS);
        let all: Vec<[f32; HEADINGS]> = predictor.on_threads(|| views.map(one).collect())?;
        Ok(all.concat())
    }

    fn directions(&self, frame: &Frame, sigma: f64, cell: f64) -> Vec<SeenDirection> {
        let sensor = frame.sensor();
        let (width, distinct) = (sensor.width() as usize, sensor.distinct_columns() as usize);
        let body = sensor.body_from_image();
        let direction = |(i, range): (usize, &f32)| {
            let is_seen = range.is_finite() && i % width < distinct;
            let ray = sensor.ray((i % width) as u32, (i / width) as u32).filter(|_| is_seen)?;
            let ray = self.level_from_sensor * (body * ray);
            let row = (FRAC_PI_2 - ray.z.clamp(-1.0, 1.0).asin()) / STEP;
            let column = ((ray.y.atan2(ray.x) + PI) / STEP).round() as usize % HEADINGS;
            let z = f64::from(*range);
            let variance = sigma * sigma + cell * cell / 12.0 + (0.5 * STEP * z).powi(2);
            let sharpness = (0.5 / variance) as f32;
            Some(SeenDirection { row: (row as usize).min(ROWS - 1), column, range: *range, sharpness })
        };
        frame.ranges().iter().enumerate().filter_map(direction).collect()
    }

    /// The pose of the sensor at a place, turned to a heading.
    pub fn pose(&self, place: usize, heading: u32) -> Pose {
        let turned = DQuat::from_rotation_z(STEP * f64::from(heading));
        Pose { translation: self.places[place], rotation: turned * self.level_from_sensor }
    }
}
