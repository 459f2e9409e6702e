//! Makes plans: by a selection, by a cut of the world, or by tiles, without a selection.

use super::{ChosenWay, FramePlan, ImageRequest, PlanBuffers, TimeLimit, Way, region_of};
use crate::row::RowCut;
use presight_model::error::Result;
use presight_model::geometry::Pose;
use presight_model::sensor::Sensor;
use presight_model::world::World;
use std::sync::Arc;

impl FramePlan {
    /// Plans a prediction: composes transforms in f64 and selects the runs that the sensor may see.
    ///
    /// # Errors
    /// Same as [`Pose::check`].
    pub fn new(
        world: &World,
        sensor: &Sensor,
        world_from_sensor: &Pose,
        request: impl Into<ImageRequest>,
    ) -> Result<Self> {
        Self::within(PlanBuffers::default(), world, sensor, world_from_sensor, request.into())
    }

    /// Same as [`FramePlan::new`], reusing another plan's memory.
    pub fn within(
        buffers: PlanBuffers,
        world: &World,
        sensor: &Sensor,
        world_from_sensor: &Pose,
        request: ImageRequest,
    ) -> Result<Self> {
        let region = region_of(sensor, world_from_sensor)?;
        let mut plan = Self::unfilled(buffers, world, sensor, world_from_sensor, request);
        plan.fill(&region);
        Ok(plan)
    }

    /// Plans a prediction by a cut of the same version of the world at the sensor's height, see
    /// [`crate::row::RowCuts::get`], without a selection. Only the CPU engine draws it.
    pub fn by_cut(
        buffers: PlanBuffers,
        world: &World,
        sensor: &Sensor,
        world_from_sensor: &Pose,
        request: ImageRequest,
        cut: Arc<RowCut>,
    ) -> Self {
        let mut plan = Self::unfilled(buffers, world, sensor, world_from_sensor, request);
        plan.clear();
        plan.facings.extend_from_slice(cut.facings());
        plan.cut = Some(cut);
        plan.chosen = ChosenWay { why: "the world's cut at the sensor's height is searched", ..ChosenWay::RASTER };
        plan
    }

    fn unfilled(
        buffers: PlanBuffers,
        world: &World,
        sensor: &Sensor,
        world_from_sensor: &Pose,
        request: ImageRequest,
    ) -> Self {
        let PlanBuffers { instances, runs, facings, found, selected } = buffers;
        Self {
            world: world.clone(),
            sensor: sensor.clone(),
            world_from_sensor: *world_from_sensor,
            request,
            instances,
            runs,
            facings,
            polygon_count: 0,
            objects_out_of_view: 0,
            polygons_out_of_view: 0,
            objects_not_opaque: 0,
            limit: None,
            reuse_visible: false,
            chosen: ChosenWay::RASTER,
            cut: None,
            found,
            selected,
        }
    }

    /// Plans a prediction with a chosen strategy. Plans for tiles have no selection; only the CPU engine and the
    /// reference draw them.
    ///
    /// # Errors
    /// Same as [`Pose::check`].
    pub fn by(
        chosen: ChosenWay,
        buffers: PlanBuffers,
        world: &World,
        sensor: &Sensor,
        world_from_sensor: &Pose,
        request: ImageRequest,
    ) -> Result<Self> {
        if chosen.way != Way::Tiles {
            let plan = Self::within(buffers, world, sensor, world_from_sensor, request)?;
            return Ok(Self { chosen, ..plan });
        }
        world_from_sensor.check()?;
        let mut plan = Self { chosen, ..Self::unfilled(buffers, world, sensor, world_from_sensor, request) };
        plan.clear();
        plan.find_facings();
        Ok(plan)
    }

    /// Strategy of the CPU engine for this plan: [`Way::Tiles`] for plans without a selection.
    pub fn way(&self) -> Way {
        self.chosen.way
    }

    /// The chosen strategy and the reason.
    pub fn chosen(&self) -> ChosenWay {
        self.chosen
    }

    /// Replaces the strategy, for tests.
    #[cfg(test)]
    pub(crate) fn set_chosen(&mut self, chosen: ChosenWay) {
        self.chosen = chosen;
    }

    /// This plan with a selection of the polygons that the sensor may see.
    ///
    /// # Errors
    /// Same as [`Pose::check`].
    pub fn selected(&self) -> Result<Self> {
        let Self { world, sensor, world_from_sensor, request, .. } = self;
        let plan = Self::new(world, sensor, world_from_sensor, *request)?;
        let mut limit = self.limit.clone();
        if let Some(TimeLimit { watch, .. }) = &mut limit {
            // As for any images whose time is not known.
            watch.stop_after(watch.elapsed() + watch.left() / 2);
        }
        Ok(Self { limit, chosen: ChosenWay::WITHOUT_TREES, ..plan })
    }

    /// Records the strategy that the engine used, if it is not the planned one.
    pub fn record_way(&mut self, way: Option<Way>) {
        match (self.way(), way) {
            (Way::Tiles, Some(Way::Raster)) => self.chosen = ChosenWay::WITHOUT_TREES,
            (Way::Raster, Some(Way::Tiles)) => self.chosen = ChosenWay::AFTER_A_WAVE,
            _ => {}
        }
    }
}
