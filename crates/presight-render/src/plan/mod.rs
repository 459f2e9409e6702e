//! The frame plan: the work of one prediction. It is made before any engine starts and does not depend on the engine.

mod derived;
pub(crate) mod facing;
mod images;
mod keys;
mod make;
mod names;
mod output;
mod polygons;
mod raster;
mod request;
mod stats;
mod view;
mod way;
mod weighing;

pub use facing::{Facing, facings};
pub use images::{Images, Samples, SamplesMut};
pub use keys::{KeySurface, Keys, resolve_keys};
pub use names::{CountName, Part, StageName};
pub use output::{Maker, Output, OutputInfo, Outputs, SampleKind};
pub use polygons::PolygonsOfIds;
pub use raster::Raster;
pub use request::{IdScheme, ImageRequest};
pub use stats::{Omission, StageRow, StageVariant, Stats, Work};
pub use view::region_of;
pub use way::{ChosenWay, Way};
pub use weighing::{BeamNumbers, Drawn, Weighing};

use crate::deadline::Watch;
use crate::row::RowCut;
use glam::{DMat3, DVec3};
use presight_model::environment::Environment;
use presight_model::error::{Error, Result};
use presight_model::geometry::Pose;
use presight_model::index::{ObjectRun, QueryResult, Region};
use presight_model::measured::ScanPoses;
use presight_model::sensor::{ImagePart, PixelGrid, STRIDES, Sensor};
use presight_model::world::World;
use std::borrow::Cow;
use std::sync::Arc;
use std::time::Duration;

/// One object as the sensor sees it. A mesh point p is at `image_from_mesh * (p - center_in_mesh)` in the image
/// frame. Subtracting first keeps the precision of near points, also in f32.
#[derive(Clone, Copy, Debug)]
pub struct Instance {
    /// Index of the object in the environment.
    pub object: u32,
    /// Linear part, f64.
    pub image_from_mesh: DMat3,
    /// The sensor's centre in the mesh frame, metres.
    pub center_in_mesh: DVec3,
    /// Transforms mesh normals into the image frame (inverse transpose of the linear part); does not preserve length.
    pub normal_from_mesh: DMat3,
    /// Transforms mesh normals into the frame of the object.
    object_from_normal: DMat3,
    /// Frobenius norms of `image_from_mesh` and `normal_from_mesh`.
    pub(crate) norms: [f64; 2],
    /// True if the linear part mirrors.
    pub mirrors: bool,
    /// True if all materials of the mesh are opaque to the sensor's class and two-sided: no material test is needed.
    pub plain: bool,
}

impl Instance {
    /// An object seen from a sensor's pose (body axes); `facings` comes from [`facings`].
    pub fn new(
        environment: &Environment,
        sensor: &Sensor,
        world_from_sensor: &Pose,
        facings: &[Facing],
        object: u32,
    ) -> Self {
        let o = &environment.objects()[object as usize];
        let plain = o.mesh.materials().iter().all(|m| {
            let f = facings[usize::from(*m)];
            f.opaque && !f.one_sided
        });
        let object_from_normal = o.object_from_mesh.matrix3.inverse().transpose();
        Self::seen_from(environment, sensor, world_from_sensor, object, (object_from_normal, plain))
    }

    /// The same object, seen from another pose.
    pub(crate) fn again(&self, environment: &Environment, sensor: &Sensor, world_from_sensor: &Pose) -> Self {
        Self::seen_from(environment, sensor, world_from_sensor, self.object, (self.object_from_normal, self.plain))
    }

    fn seen_from(
        environment: &Environment,
        sensor: &Sensor,
        world_from_sensor: &Pose,
        object: u32,
        (object_from_normal, plain): (DMat3, bool),
    ) -> Self {
        let o = &environment.objects()[object as usize];
        let world_from_image = world_from_sensor.rotation_matrix() * sensor.body_from_image();
        let image_from_object = world_from_image.transpose() * o.world_from_object.rotation_matrix();
        let image_from_mesh = image_from_object * o.object_from_mesh.matrix3;
        let normal_from_mesh = image_from_object * object_from_normal;
        let norm = |m: DMat3| m.to_cols_array().iter().map(|x| x * x).sum::<f64>().sqrt();
        Self {
            object,
            image_from_mesh,
            center_in_mesh: o.point_in_mesh(world_from_sensor.translation),
            normal_from_mesh,
            object_from_normal,
            norms: [image_from_mesh, normal_from_mesh].map(norm),
            mirrors: image_from_mesh.determinant() < 0.0,
            plain,
        }
    }
}

/// A contiguous run of an instance's polygons: the unit in which selection passes polygons to the engines.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Run {
    /// Index into [`FramePlan::instances`].
    pub instance: u32,
    /// First polygon of the mesh.
    pub first: u32,
    /// Number of polygons.
    pub count: u32,
    /// Lower bound of the distance from the sensor, metres: the front-to-back key.
    pub nearest: f32,
}

impl Run {
    /// Lower bound of the distance to the run, metres: `nearest` is rounded to nearest, this value down.
    pub(crate) fn nearest_below(&self) -> f32 {
        self.nearest.next_down().max(0.0)
    }
}

/// Reason why engines have nothing to do.
pub const NOTHING_IN_VIEW: &str = "no polygon is in view";

/// The work of one prediction.
#[derive(Clone, Debug)]
pub struct FramePlan {
    /// The version of the world that is predicted.
    pub world: World,
    /// The sensor.
    pub sensor: Sensor,
    /// The sensor's pose, body axes.
    pub world_from_sensor: Pose,
    /// The request.
    pub request: ImageRequest,
    /// Objects with at least one polygon selected.
    pub instances: Vec<Instance>,
    /// Selected polygons, nearest first.
    pub runs: Vec<Run>,
    /// Indexed by material.
    pub facings: Vec<Facing>,
    /// Polygons in `runs`.
    pub polygon_count: usize,
    /// Objects that were not selected because they are out of view or out of range.
    pub objects_out_of_view: usize,
    /// Polygons of selected objects that were not selected.
    pub polygons_out_of_view: usize,
    /// Objects in view that the sensor's class cannot see.
    pub objects_not_opaque: usize,
    /// Only in frames with a deadline.
    pub limit: Option<TimeLimit>,
    /// True if engines may begin with the polygons that the sensor's last frame showed.
    pub reuse_visible: bool,
    /// [`Way::Tiles`] only for plans without a selection.
    chosen: ChosenWay,
    /// For a level scanner of one row: the cut of the world at its height, in place of runs.
    pub(crate) cut: Option<Arc<RowCut>>,
    /// The poses of bundles of rays, if no single pose holds for all rays; then nothing is selected.
    bundles: Option<Arc<ScanPoses>>,
    /// Scratch memory, kept from frame to frame.
    found: QueryResult,
    selected: Vec<ObjectRun>,
}

/// Data that only frames with a deadline have.
#[derive(Clone, Debug)]
pub struct TimeLimit {
    /// The clock that stops drawing.
    pub watch: Watch,
    /// The radius to which the runs were cut, if they were, metres.
    pub radius: Option<f32>,
    /// The part of the image to draw, unless it is the whole image.
    pub part: Option<ImagePart>,
    /// Drawing costs, if they are learnt: the engine may thin the image accordingly.
    pub pace: Option<Pace>,
    /// The raster may hand over to tiles while at least this much time is left; `None` if it may not.
    pub tiles: Option<Duration>,
}

impl TimeLimit {
    /// A limit by the clock alone.
    pub fn new(watch: Watch) -> Self {
        Self { watch, radius: None, part: None, pace: None, tiles: None }
    }
}

/// Seconds of drawing on all threads together, for the second estimate of a prediction with a deadline.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Pace {
    /// Per wave.
    pub wave: f64,
    /// Per polygon.
    pub polygon: f64,
    /// Per pixel of the bounding boxes of polygons.
    pub sample: f64,
    /// Time that images of each of [`STRIDES`] save, out of the time reserved for the images as drawn.
    pub saved: [f64; STRIDES.len()],
    /// Time to draw all runs, from the end of selection; 0 if unknown.
    pub drawing: f64,
}

impl Pace {
    /// Seconds that a thinned image saves out of the time reserved for images.
    pub fn saved(&self, stride: u32) -> f64 {
        STRIDES.iter().position(|s| *s == stride).map_or(0.0, |i| self.saved[i])
    }
}

/// Memory of a plan, reused for the next one. It refers to no world, so keeping it keeps no version alive.
#[derive(Debug, Default)]
pub struct PlanBuffers {
    instances: Vec<Instance>,
    runs: Vec<Run>,
    facings: Vec<Facing>,
    found: QueryResult,
    selected: Vec<ObjectRun>,
}

impl FramePlan {
    /// Lets a clock stop the engines, for tests. A `Predictor` does so for `Request::deadline`.
    pub fn set_watch(&mut self, watch: Watch) {
        self.limit = Some(TimeLimit::new(watch));
    }

    /// Lets engines begin with the polygons that the sensor's last frame showed, for tests. A `Predictor` does
    /// so for `Options::reuse_visible`.
    pub fn set_reuse_visible(&mut self) {
        self.reuse_visible = true;
    }

    /// The clock that stops drawing, if there is a deadline.
    pub fn watch(&self) -> Option<&Watch> {
        self.limit.as_ref().map(|limit| &limit.watch)
    }

    /// The radius to which the runs were cut, if they were, metres.
    pub fn radius(&self) -> Option<f32> {
        self.limit.as_ref().and_then(|limit| limit.radius)
    }

    /// The part of the image to draw, unless it is the whole image.
    pub fn part(&self) -> Option<ImagePart> {
        self.limit.as_ref().and_then(|limit| limit.part)
    }

    /// Drawing costs, if they are learnt.
    pub fn pace(&self) -> Option<&Pace> {
        self.limit.as_ref().and_then(|limit| limit.pace.as_ref())
    }

    /// Keeps only the nearest `runs`.
    pub fn cut(&mut self, runs: usize) {
        let Some(first_out) = self.runs.get(runs) else { return };
        let radius = first_out.nearest_below();
        self.limit.iter_mut().for_each(|limit| limit.radius = Some(radius));
        self.runs.truncate(runs);
        self.polygon_count = self.runs.iter().map(|r| r.count as usize).sum();
    }

    /// Time since the start of the prediction; zero without a deadline.
    pub fn elapsed(&self) -> Duration {
        self.watch().map_or(Duration::ZERO, Watch::elapsed)
    }

    /// Lower bound of the distance to any polygon after the first `done` runs, metres.
    pub fn nearest_after(&self, done: usize) -> f32 {
        match self.runs.get(done) {
            Some(run) => run.nearest_below(),
            None => self.radius().unwrap_or(f32::INFINITY),
        }
    }

    /// Restricts the plan to some columns and repeats the selection for them; the radius and the clock stay.
    pub fn narrow(&mut self, part: ImagePart) -> Result<()> {
        let region = region_of(&self.sensor.part(part)?, &self.world_from_sensor)?;
        let limit = self.limit.take();
        self.fill(&region);
        if let Some(radius) = limit.as_ref().and_then(|limit| limit.radius) {
            let within = self.runs.partition_point(|run| run.nearest_below() < radius);
            self.cut(within);
        }
        // The old radius still applies, even if no run selected now lies beyond it.
        self.limit = limit.map(|limit| TimeLimit { part: Some(part), ..limit });
        Ok(())
    }

    /// Returns the same plan for a part of the image, with more time to draw it.
    pub fn of_part(&self, part: ImagePart, more: Duration) -> Result<Self> {
        let mut limit = self.limit.clone();
        if let Some(limit) = &mut limit {
            limit.watch.stop_later(more);
            // Another sensor, whose rays are not in tiles yet.
            (limit.part, limit.tiles) = (None, None);
        }
        Ok(Self {
            world: self.world.clone(),
            sensor: self.sensor.part(part)?,
            world_from_sensor: self.world_from_sensor,
            request: self.request,
            instances: self.instances.clone(),
            runs: self.runs.clone(),
            facings: self.facings.clone(),
            polygon_count: self.polygon_count,
            objects_out_of_view: self.objects_out_of_view,
            polygons_out_of_view: self.polygons_out_of_view,
            objects_not_opaque: self.objects_not_opaque,
            limit,
            reuse_visible: false,
            chosen: self.chosen,
            cut: None,
            bundles: None,
            found: QueryResult::default(),
            selected: Vec::new(),
        })
    }

    /// Draws only every k-th column and row (2, 4 or 8), for tests. `around` restricts it to a number of columns around
    /// a heading (radians, counter-clockwise). Needs a watch.
    ///
    /// # Errors
    /// [`presight_model::ErrorKind::Usage`] without a watch; [`presight_model::ErrorKind::System`] if there is no
    /// memory for the ray tables.
    pub fn set_part(&mut self, stride: u32, around: Option<(f64, u32)>) -> Result<()> {
        let narrow = around.and_then(|(heading, columns)| self.sensor.columns_around(heading, columns));
        if let Some(part) = narrow {
            self.narrow(part)?;
        }
        let part = ImagePart { stride, ..self.part().unwrap_or(self.sensor.whole()) };
        let Some(limit) = &mut self.limit else {
            return Err(Error::usage("a part of an image without a deadline", "call set_watch first"));
        };
        limit.part = Some(part);
        Ok(())
    }

    /// Drops the plan and returns its memory.
    pub fn into_buffers(self) -> PlanBuffers {
        let Self { instances, runs, facings, found, selected, .. } = self;
        PlanBuffers { instances, runs, facings, found, selected }
    }

    /// Plans another prediction and reuses the buffers. After an error the plan is unchanged.
    ///
    /// # Errors
    /// Same as [`FramePlan::new`].
    pub fn renew(
        &mut self,
        world: &World,
        sensor: &Sensor,
        world_from_sensor: &Pose,
        request: impl Into<ImageRequest>,
    ) -> Result<()> {
        world_from_sensor.check()?;
        self.world = world.clone();
        self.sensor = sensor.clone();
        self.world_from_sensor = *world_from_sensor;
        self.request = request.into();
        self.reuse_visible = false;
        self.chosen = ChosenWay::RASTER;
        self.bundles = None;
        match ScanPoses::new(sensor, world_from_sensor, None)? {
            Some(poses) => self.take_bundles(poses),
            None => self.fill(&region_of(sensor, world_from_sensor)?),
        }
        Ok(())
    }

    /// The environment that is predicted.
    pub fn environment(&self) -> &Arc<Environment> {
        self.world.environment()
    }

    /// Any object as the sensor sees it, even if it was not selected.
    pub fn instance_of(&self, object: u32) -> Instance {
        self.instance_from(&self.world_from_sensor, object)
    }

    /// Any object as the sensor sees it from a pose.
    pub fn instance_from(&self, world_from_sensor: &Pose, object: u32) -> Instance {
        Instance::new(self.world.environment(), &self.sensor, world_from_sensor, &self.facings, object)
    }

    /// The `polygon_id` of a polygon.
    pub fn polygon_id(&self, object: u32, polygon: u32) -> u32 {
        self.request.ids.id_of(&self.world.environment().objects()[object as usize], polygon)
    }

    /// The `polygon_id` that engines draw for a polygon, see [`FramePlan::drawn_ids`].
    pub fn drawn_polygon_id(&self, object: u32, polygon: u32) -> u32 {
        self.drawn_ids().id_of(&self.world.environment().objects()[object as usize], polygon)
    }

    /// Removes the selection and the facings.
    fn clear(&mut self) {
        // Feature ids are derived from features later.
        self.request.outputs = self.request.outputs.without(Output::FeatureId);
        if !self.sensor.is_camera() {
            // Planar depth needs a planar image.
            self.request.outputs = self.request.outputs.without(Output::DepthZ);
        }
        self.instances.clear();
        self.runs.clear();
        self.facings.clear();
        self.limit = None;
        (self.polygon_count, self.objects_out_of_view) = (0, 0);
        (self.polygons_out_of_view, self.objects_not_opaque) = (0, 0);
        self.cut = None;
    }

    fn find_facings(&mut self) {
        self.facings.extend(facings(self.world.environment(), &self.sensor.spec().class));
    }

    fn fill(&mut self, region: &Region) {
        self.clear();
        self.find_facings();
        let world = self.world.clone();
        let environment = world.environment();
        let mut selected = std::mem::take(&mut self.selected);
        selected.clear();
        world.index().select(environment, region, &mut self.found, &mut selected);
        for runs in selected.chunk_by(|a, b| a.object == b.object) {
            self.take(runs);
        }
        self.selected = selected;
        let live = environment.objects().iter().filter(|o| o.mesh.polygon_count() > 0).count();
        self.objects_out_of_view = live - self.instances.len() - self.objects_not_opaque;
        self.runs.sort_by(|a, b| a.nearest.total_cmp(&b.nearest));
    }

    /// Adds the runs of one object.
    fn take(&mut self, runs: &[ObjectRun]) {
        let object = runs[0].object;
        let world = self.world.clone();
        let environment = world.environment();
        let mesh = &environment.objects()[object as usize].mesh;
        let absent = environment.absent_parts(object, &self.sensor.spec().class);
        if absent.is_none() || !mesh.materials().iter().any(|m| self.facings[usize::from(*m)].opaque) {
            self.objects_not_opaque += 1;
            return;
        }
        let instance = self.instances.len() as u32;
        self.instances.push(self.instance_of(object));
        let run = |r: &ObjectRun| Run { instance, first: r.first, count: r.count, nearest: r.nearest as f32 };
        let from = self.runs.len();
        match absent.filter(|parts| !parts.is_empty()) {
            None => self.runs.extend(runs.iter().map(run)),
            Some(parts) => {
                let stands = |polygon: &u32| !environment.lies_in(object, *polygon, &parts);
                let single = |r: &ObjectRun, first: u32| Run { first, count: 1, ..run(r) };
                let standing = |r: &ObjectRun| (r.first..r.first + r.count).filter(stands).collect::<Vec<u32>>();
                self.runs.extend(runs.iter().flat_map(|r| standing(r).into_iter().map(move |first| single(r, first))));
            }
        }
        let selected = self.runs[from..].iter().map(|r| r.count as usize).sum::<usize>();
        self.polygon_count += selected;
        self.polygons_out_of_view += mesh.polygon_count() - selected;
    }

    /// The stages and images that this prediction does not need, with the reasons.
    pub fn left_out(&self) -> Vec<Omission> {
        let mut all = Vec::new();
        let mut add = |what: Part, why: Cow<'static, str>| all.push(Omission { what, why });
        if self.objects_out_of_view > 0 {
            add(Part::Objects(self.objects_out_of_view), "out of view or reach".into());
        }
        if self.polygons_out_of_view > 0 {
            add(Part::Polygons(self.polygons_out_of_view), "their run is out of view or reach".into());
        }
        if self.objects_not_opaque > 0 {
            let why = format!("not opaque to class {:?}", self.sensor.spec().class);
            add(Part::Objects(self.objects_not_opaque), why.into());
        }
        for (what, taken, why) in self.variants() {
            if !taken {
                add(what.into(), why.into());
            }
        }
        let drawn = self.drawn();
        for output in Output::ALL {
            if !self.request.outputs.has(output) && !drawn.has(output) {
                add(Part::Image(output), "not requested".into());
            }
        }
        all
    }

    /// Variants of stages with extra cost: name, whether this prediction uses it, and why.
    pub fn variants(&self) -> [(StageName, bool, &'static str); 4] {
        let choose = |what, taken, why: [&'static str; 2]| (what, taken, why[usize::from(taken)]);
        let by_rays = matches!(self.sensor.grid(), PixelGrid::Rays(_));
        let mixed = match self.way() {
            Way::Tiles => self.facings.iter().any(|f| f.one_sided || !f.opaque),
            _ => !self.instances.iter().all(|i| i.plain),
        };
        let by_material = self.reflects_by_material();
        [
            choose(
                StageName::RayTable,
                by_rays,
                [
                    "no lens distortion and no listed rays: spans are computed in closed form",
                    "the rays do not lie on lines: polygons are tested against tiles of rays",
                ],
            ),
            choose(
                StageName::MaterialTest,
                mixed,
                [
                    "everything selected is opaque to this class and two-sided",
                    "something selected is one-sided, or not opaque to this class",
                ],
            ),
            choose(
                StageName::ReflectionFactor,
                by_material,
                ["no echo is requested, or all materials have one factor", "an echo is requested, and factors differ"],
            ),
            (StageName::RaysByTiles, self.way() == Way::Tiles, self.chosen.why),
        ]
    }
}
