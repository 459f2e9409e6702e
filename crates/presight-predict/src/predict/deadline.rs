//! The parts that a prediction with a deadline gave up, and the costs of predictions.

use super::{Prediction, Predictor};
use presight_render::cost::CostModel;
use presight_render::deadline::{Clock, Degradation};
use std::sync::Arc;

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
    /// Learnt costs of predictions with a deadline; save them with `costs::write`.
    pub fn costs(&self) -> &CostModel {
        &self.controller.costs
    }

    /// Sets the costs learnt earlier.
    pub fn set_costs(&mut self, costs: CostModel) {
        self.controller.costs = costs;
    }

    /// Replaces the system clock, for tests.
    pub fn set_clock(&mut self, clock: Arc<dyn Clock>) {
        self.controller.set_clock(clock);
    }
}
