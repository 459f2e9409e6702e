//! Makes plans: by a selection, by a cut of the world, or by tiles, without a selection.

use super::{ChosenWay, FramePlan, ImageRequest, PlanBuffers, TimeLimit, Way, region_of};
use crate::row::RowCut;
use presight_model::error::Result;
use presight_model::geometry::Pose;
use presight_model::measured::ScanPoses;
use presight_model::sensor::Sensor;
use presight_model::world::World;
use std::borrow::Cow;
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
        if let Some(poses) = ScanPoses::new(sensor, world_from_sensor, None)? {
            return Self::in_bundles(buffers, world, sensor, world_from_sensor, request, poses);
        }
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
            bundles: None,
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
        if chosen.way != Way::Tiles || sensor.has_origins() {
            let plan = Self::within(buffers, world, sensor, world_from_sensor, request)?;
            let chosen = if plan.bundles.is_some() { plan.chosen } else { chosen };
            return Ok(Self { chosen, ..plan });
        }
        world_from_sensor.check()?;
        let mut plan = Self { chosen, ..Self::unfilled(buffers, world, sensor, world_from_sensor, request) };
        plan.clear();
        plan.find_facings();
        Ok(plan)
    }

    /// Plans a prediction whose rays have poses of their own, by tiles, without a selection. Only the CPU engine and the
    /// reference draw it. Sensors that stand and whose rays have origins get such a plan from every constructor.
    ///
    /// # Errors
    /// Same as [`Pose::check`].
    pub fn in_bundles(
        buffers: PlanBuffers,
        world: &World,
        sensor: &Sensor,
        world_from_sensor: &Pose,
        request: ImageRequest,
        poses: ScanPoses,
    ) -> Result<Self> {
        world_from_sensor.check()?;
        let mut plan = Self::unfilled(buffers, world, sensor, world_from_sensor, request);
        plan.take_bundles(poses);
        Ok(plan)
    }

    pub(super) fn take_bundles(&mut self, poses: ScanPoses) {
        self.clear();
        self.find_facings();
        (self.chosen, self.bundles) = (ChosenWay::BUNDLES, Some(Arc::new(poses)));
    }

    /// The poses of bundles of rays; `None` if one pose holds for all rays.
    pub fn bundles(&self) -> Option<&ScanPoses> {
        self.bundles.as_deref()
    }

    /// A plan without a selection for the rays of one bundle, for the reference and its comparisons.
    pub(crate) fn of_bundle(&self, bundle: u32) -> Self {
        let buffers = PlanBuffers { facings: self.facings.clone(), ..PlanBuffers::default() };
        let pose = self.bundles.as_ref().map_or(self.world_from_sensor, |poses| poses.poses()[bundle as usize]);
        Self::unfilled(buffers, &self.world, &self.sensor, &pose, self.request)
    }

    /// Groups values by the bundle of their pixel (column, row), with the plan of each bundle. One group with this plan
    /// if one pose holds for all.
    pub(crate) fn by_bundle<T>(
        &self,
        values: impl Iterator<Item = T>,
        pixel: impl Fn(&T) -> (u32, u32),
    ) -> Vec<(Cow<'_, Self>, Vec<T>)> {
        let Some(poses) = self.bundles() else { return vec![(Cow::Borrowed(self), values.collect())] };
        let bundles = poses.bundles();
        let mut grouped: Vec<Vec<T>> = Vec::new();
        grouped.resize_with(bundles.len(), Vec::new);
        for value in values {
            let (column, row) = pixel(&value);
            grouped[bundles.of_pixel(column, row) as usize].push(value);
        }
        let groups = (0..).zip(grouped).filter(|(_, group)| !group.is_empty());
        groups.map(|(bundle, group)| (Cow::Owned(self.of_bundle(bundle)), group)).collect()
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
