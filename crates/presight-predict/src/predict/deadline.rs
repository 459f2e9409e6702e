//! Predictions with a deadline: the parts that were given up, the costs, and the ways that finish in time.

use super::{Prediction, Predictor};
use crate::request::Request;
use presight_features::{FeaturePrediction, Vantage};
use presight_model::error::Result;
use presight_model::geometry::SensorPose;
use presight_model::sensor::Sensor;
use presight_model::world::World;
use presight_render::cost::{CostModel, DeadlineFrame, Forecast};
use presight_render::deadline::{Clock, DeadlineOutcome, Degradation, DegradationKind, DegradationStep};
use presight_render::plan::{ChosenWay, Images, Output, Stats, Way};
use presight_render::row::{Making, RowCut, is_row};
use std::sync::Arc;
use std::time::Duration;

impl Prediction {
    /// The parts given up for the deadline; `None` if the prediction is complete.
    pub fn degradation(&self) -> Option<&Degradation> {
        self.stats.degradation()
    }

    /// [`Prediction::is_not_predicted`] for all pixels, row-major; empty if no sample was given up.
    pub fn not_predicted(&self) -> Vec<bool> {
        if !self.misses_samples() {
            return Vec::new();
        }
        let rows = (0..self.images.height).flat_map(|row| (0..self.images.width).map(move |column| (column, row)));
        rows.map(|(column, row)| self.is_not_predicted(column, row)).collect()
    }

    /// True if a pixel was given up: it is NaN with id 0 although the sensor has a ray there. In a prediction with ids
    /// only, also true for pixels without a hit.
    pub fn is_not_predicted(&self, column: u32, row: u32) -> bool {
        let at = row as usize * self.images.width as usize + column as usize;
        self.misses_samples() && self.images.is_open(at) && self.sensor.ray(column, row).is_some()
    }

    /// True if samples were given up, not only features.
    fn misses_samples(&self) -> bool {
        self.degradation().is_some_and(|given_up| given_up.samples > 0)
    }
}

impl Predictor {
    /// The prediction of a frame that [`Predictor::predict`] refused with [`presight_model::ErrorKind::Deadline`], for
    /// a series that continues: every sample and every feature is given up, and `complete_to` is 0.
    ///
    /// # Errors
    /// [`presight_model::ErrorKind::System`] if the system refuses the memory; the errors of [`Predictor::predict`]
    /// about features.
    pub fn give_up(
        &mut self,
        world: &World,
        sensor: &Sensor,
        pose: &SensorPose,
        request: &Request,
    ) -> Result<Prediction> {
        let mut images = Images::default();
        images.try_prepare(sensor.width(), sensor.height(), request.outputs.with(Output::Range))?;
        images.show_nothing(sensor.grid());
        let samples = images.leave_open(0.0, sensor.spec().range_min);
        images.keep(request.outputs);
        if request.outputs.has(Output::FeatureId) {
            images.feature_id = vec![0; images.pixels()];
        }
        let placed = request.features.as_ref().map(|options| self.place(world, sensor, options)).transpose()?;
        let ids = placed.iter().flat_map(|placed| placed.features.iter().map(|p| p.feature.id));
        let mut features: Vec<u32> = ids.collect();
        features.sort_unstable();
        let step = |means, metres| DegradationStep { means, at_ms: 0.0, metres };
        let mut means = vec![step(DegradationKind::Clock, Some(0.0))];
        means.extend((!features.is_empty()).then(|| step(DegradationKind::Features, None)));
        let given_up = Some(Degradation { complete_to: 0.0, samples, features, means, ..Degradation::default() });
        let deadline_ms = request.deadline.map_or(0.0, |limit| 1e3 * limit.as_secs_f64());
        let deadline = Some(DeadlineOutcome { deadline_ms, given_up, ..DeadlineOutcome::default() });
        Ok(Prediction {
            request: request.clone(),
            sensor: sensor.clone(),
            pose: *pose,
            world_version: world.version(),
            images,
            features: placed.map(|_| FeaturePrediction::default()),
            stats: Stats { deadline, ..Stats::default() },
        })
    }

    /// The cut of the world for a level scanner of one row, if it is known or due. With a deadline, the row and any new
    /// cut must be certain to finish in time.
    pub(super) fn find_cut(&self, vantage: &Vantage<'_>, timed: Option<&DeadlineFrame>) -> Option<Arc<RowCut>> {
        let Vantage { world, sensor, world_from_sensor } = *vantage;
        if !self.may_cut() || !self.engine.draws_cuts() || !is_row(sensor) {
            return None;
        }
        let has_time =
            |before| timed.is_none_or(|timed| self.controller.is_surely_in_time(timed, Forecast::Row, before));
        let making = if has_time(RowCut::max_time(world)) { Making::IfOften } else { Making::Never };
        let cut = self.row_cuts.get(world, sensor, world_from_sensor, making);
        cut.filter(|_| has_time(Duration::ZERO))
    }

    /// The way that was chosen, or the raster if tiles are not surely in time.
    pub(super) fn way_in_time(&self, timed: &DeadlineFrame, chosen: ChosenWay) -> ChosenWay {
        if chosen.way != Way::Tiles {
            return chosen;
        }
        if !chosen.at_once && self.engine.waits_for_trees() {
            return ChosenWay::WITHOUT_TREES;
        }
        let has_time = self.controller.is_surely_in_time(timed, Forecast::Tiles, Duration::ZERO);
        if has_time { chosen } else { ChosenWay::TILES_TAKE_TOO_LONG }
    }

    /// Learnt costs of predictions with a deadline; save them with `costs::write`.
    pub fn costs(&self) -> &CostModel {
        &self.controller.costs
    }

    /// Sets the costs learnt earlier.
    pub fn set_costs(&mut self, costs: CostModel) {
        self.controller.costs = costs;
    }

    /// Replaces the system clock, for tests.
    #[doc(hidden)]
    pub fn set_clock(&mut self, clock: Arc<dyn Clock>) {
        self.controller.set_clock(clock);
    }
}
