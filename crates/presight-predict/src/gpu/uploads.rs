//! Uploads of one frame, computed from the plan without a device: instances, runs, and the f64 list.

use super::geometry::Arena;
use super::grid::Tables;
use super::layout::{
    BOX_WORDS, FEW_INSTANCES, GridKind, Instance, MAX_WAVES, Params, RUN_NEAR, RUN_WORDS, SLOT_WORDS, UNIT, UNIT_SHIFT,
    WorkRun,
};
use super::near::{NearList, cluster_of, is_near};
use super::shown::{MAX_SLOTS, Shown};
use super::testing::Hiding;
use glam::{DMat3, DVec3, Vec3};
use presight_render::plan::{FramePlan, IdScheme, Output, Outputs, Run, StageName};
use std::ops::Range;

/// Maximum number of slots that are read back to resolve images on the CPU.
const MAX_SLOTS_ON_HOST: u32 = 1 << 20;

/// Minimum number of polygons for which testing for hidden ones pays.
const MIN_TO_HIDE: usize = 4096;
/// Polygons of the first wave.
const FIRST_WAVE: usize = 2048;
/// Ratio of polygons from one wave to the next; the last wave takes all that are left.
const WAVE_GROWTH: usize = 4;

/// The choices by which frames are drawn.
#[derive(Clone, Copy)]
pub(super) struct DrawMode {
    /// The adapter is software.
    pub software: bool,
    /// The device has no 64-bit atomics.
    pub in_two_passes: bool,
    /// Maximum image side that the hardware rasterizer draws; 0 if it is not used.
    pub max_rendered: u32,
    pub hiding: Hiding,
}

impl DrawMode {
    /// Number of polygons that ends the first wave if no earlier frame is reused; all polygons for a single wave.
    fn first_wave_end(self, plan: &FramePlan) -> usize {
        let most = match self.hiding {
            Hiding::WhereItPays if plan.polygon_count >= MIN_TO_HIDE => FIRST_WAVE,
            Hiding::WhereItPays | Hiding::Off => plan.polygon_count,
            Hiding::Always | Hiding::TooNear | Hiding::LastFrameOnly => plan.polygon_count / 4,
        };
        most.max(1)
    }

    /// True if there may be several waves.
    fn hides(self, plan: &FramePlan) -> bool {
        self.first_wave_end(plan) < plan.polygon_count
    }
}

/// The uploads of a frame; the buffers are reused.
#[derive(Default)]
pub(super) struct FrameUploads {
    pub params: Params,
    pub instances: Vec<Instance>,
    /// Runs, facings by material, units of the first wave.
    pub work: Vec<u32>,
    /// Indices of the plan's runs in drawing order.
    order: Vec<u32>,
    /// Number of runs at the start of `order` that the sensor's last frame showed.
    pub shown_before: u32,
    /// The reason if the last frame is not reused.
    pub why_anew: &'static str,
    /// True if the visible polygons are recorded for the sensor's next frame.
    pub remembered: bool,
    /// Units of all waves.
    pub units: u32,
    /// The runs of each wave.
    pub waves: Vec<Range<u32>>,
    /// Passes on the device, in order.
    pub passes: Vec<StageName>,
    /// Workgroups of the coarse depth stage.
    pub blocks: [u32; 2],
    /// Polygons of all runs.
    pub polygon_count: u32,
    pub near: NearList,
    /// Every instance is opaque and two-sided, so materials are not checked.
    pub plain: bool,
    /// The requested outputs that can be delivered.
    pub outputs: Outputs,
    /// Words of all images.
    pub output_words: u64,
    /// Words of the sums that are read back instead of images; 0 without weighing.
    pub sum_words: u64,
    /// Slots of the environment.
    pub slots: u32,
    /// The images are resolved on the CPU.
    pub on_host: bool,
    /// The hardware rasterizer draws the polygons that it can draw exactly.
    pub rendered: bool,
    /// Drawn in one submission with other frames, where timestamps are not taken.
    pub in_company: bool,
}

impl FrameUploads {
    /// True if the instances are read from a uniform buffer.
    pub fn few(&self) -> bool {
        self.instances.len() <= FEW_INSTANCES as usize
    }

    /// Bytes of `work` with room for the units of all waves.
    pub fn work_bytes(&self) -> u64 {
        4 * (u64::from(self.params.units_at) + u64::from(self.units))
    }

    /// Size of the slot table, bytes.
    pub fn slot_bytes(&self) -> u64 {
        u64::from(self.slots) * 4 * u64::from(SLOT_WORDS)
    }

    /// Words of the bit mask of shown slots; 0 if the device does not write it.
    pub fn shown_words(&self) -> u32 {
        if self.remembered && !self.on_host { self.slots.div_ceil(32) } else { 0 }
    }

    /// Computes the uploads. The arena must hold every mesh of the plan. On a software adapter the CPU resolves the
    /// images, unless reading back the slots would cost more than it saves. `last`: the polygons that the sensor's last
    /// frame showed, if they may be reused.
    pub fn fill(&mut self, plan: &FramePlan, tables: &Tables, arena: &Arena, mode: DrawMode, last: Option<&Shown>) {
        self.slots = plan.environment().slot_count();
        self.on_host = mode.software && self.slots <= MAX_SLOTS_ON_HOST;
        self.sum_words = 0;
        let fits = tables.params.width.max(tables.params.height) <= mode.max_rendered;
        self.rendered = tables.kind == GridKind::Camera && fits && plan.limit.is_none();
        self.params = tables.params;
        self.blocks = tables.blocks;
        self.plain = plan.instances.iter().all(|i| i.plain);
        self.remembered = last.is_some() && self.slots <= MAX_SLOTS;
        self.fill_instances(plan, arena);
        self.fill_order(plan, mode, last);
        self.fill_waves(plan, mode);
        self.fill_work(plan, tables, arena);
        self.place_outputs(plan);
        self.params.source_ids = u32::from(plan.drawn_ids() == IdScheme::Source);
    }

    fn fill_instances(&mut self, plan: &FramePlan, arena: &Arena) {
        self.instances.clear();
        let objects = plan.environment().objects();
        for instance in &plan.instances {
            let object = &objects[instance.object as usize];
            let Some(place) = arena.place(&object.mesh) else {
                debug_assert!(false, "mesh {:?} was not admitted", object.mesh.name());
                continue;
            };
            let [linear_x, linear_y, linear_z] = columns(instance.image_from_mesh);
            let [normal_x, normal_y, normal_z] = columns(instance.normal_from_mesh);
            let (center_high, center_low) = split(instance.center_in_mesh);
            self.instances.push(Instance {
                linear_x,
                linear_y,
                linear_z,
                normal_x,
                normal_y,
                normal_z,
                handedness: instance.image_from_mesh.determinant().signum() as f32,
                first_slot: object.first_slot,
                first_source: object.first_source,
                object_id: instance.object + 1,
                polygons_at: place.polygons_at,
                corners_at: place.corners_at,
                vertices_at: place.vertices_at,
                center_high,
                center_low,
                padding: 0,
            });
        }
    }

    fn fill_work(&mut self, plan: &FramePlan, tables: &Tables, arena: &Arena) {
        self.work.clear();
        self.near.clear();
        let objects = plan.environment().objects();
        for run in self.order.iter().map(|run| &plan.runs[*run as usize]) {
            let instance = &plan.instances[run.instance as usize];
            let mesh = &objects[instance.object as usize].mesh;
            let near = is_near(mesh, instance, run);
            if near {
                self.near.add(plan, tables, instance, run);
            }
            let boxes_at = arena.place(mesh).map_or(0, |place| place.boxes_at);
            let words = WorkRun {
                instance: run.instance,
                polygon: run.first,
                count: run.count | if near { RUN_NEAR } else { 0 },
                r#box: boxes_at + cluster_of(mesh, run) as u32 * BOX_WORDS,
            };
            self.work.extend_from_slice(bytemuck::cast_slice(&[words]));
        }
        debug_assert_eq!(self.work.len(), plan.runs.len() * RUN_WORDS);
        self.params.stamp = self.near.stamp;
        self.params.facings_at = self.work.len() as u32;
        self.work.extend(plan.facings.iter().map(|f| u32::from(f.opaque) | u32::from(f.one_sided) << 1));
        self.params.units_at = self.work.len() as u32;
        let units_of = |run: &Run| run.count.div_ceil(UNIT);
        // The device appends the units of later waves.
        self.units = plan.runs.iter().map(units_of).sum();
        let first = self.waves.first().map_or(0, |wave| wave.end as usize);
        for (index, run) in (0..).zip(&self.order[..first]) {
            let units = units_of(&plan.runs[*run as usize]);
            self.work.extend((0..units).map(|unit| index << UNIT_SHIFT | unit));
        }
    }

    /// Number of units that the first wave starts with.
    pub fn first_units(&self) -> u32 {
        self.work.len() as u32 - self.params.units_at
    }

    /// Orders the runs nearest first. If most of the last frame's polygons may be seen again, their runs go first.
    fn fill_order(&mut self, plan: &FramePlan, mode: DrawMode, last: Option<&Shown>) {
        let all = 0..plan.runs.len() as u32;
        self.order.clear();
        (self.shown_before, self.why_anew) = (0, "");
        let again = match last {
            _ if !plan.reuse_visible => Err("not requested"),
            None => Err("not in batches, nor with a deadline"),
            Some(_) if !self.remembered => Err("the world has too many polygons"),
            Some(_) if !mode.hides(plan) => Err("too few polygons are in view"),
            Some(last) => last.of(plan).ok_or("the sensor has no last frame in this version of the world"),
        };
        match again {
            Ok(last) => {
                let shown = |run: &u32| last.count_in(plan, &plan.runs[*run as usize]);
                let mut polygons = 0;
                self.order.extend(all.clone().filter(|run| {
                    let of_run = shown(run);
                    polygons += of_run;
                    of_run > 0
                }));
                if last.is_mostly_without(polygons) {
                    self.why_anew = "most of what it showed is out of view";
                    self.order.clear();
                    self.order.extend(all);
                } else {
                    self.shown_before = self.order.len() as u32;
                    self.order.extend(all.filter(|run| shown(run) == 0));
                }
            }
            Err(why) => {
                self.why_anew = why;
                self.order.extend(all);
            }
        }
    }

    /// Divides the runs into waves.
    fn fill_waves(&mut self, plan: &FramePlan, mode: DrawMode) {
        self.polygon_count = plan.polygon_count as u32;
        self.waves.clear();
        let end = plan.runs.len() as u32;
        let (mut begin, mut polygons, mut most) = (0, 0, mode.first_wave_end(plan));
        if self.shown_before > 0 && self.shown_before < end {
            self.waves.push(0..self.shown_before);
            // One wave suffices for the rest: it is tested against the depth of the first.
            (begin, most) = (self.shown_before, usize::MAX);
        }
        let end = if mode.hiding == Hiding::LastFrameOnly && begin > 0 { begin } else { end };
        for (index, run) in (0..).zip(&self.order).skip(begin as usize) {
            polygons += plan.runs[*run as usize].count as usize;
            let split = polygons >= most && index + 1 < end && self.waves.len() + 1 < MAX_WAVES;
            if split {
                self.waves.push(begin..index + 1);
                (begin, most) = (index + 1, WAVE_GROWTH * most);
            }
        }
        self.waves.push(begin..end);
        self.passes.clear();
        for wave in 0..self.waves.len() {
            self.passes.extend((wave > 0).then_some(StageName::Hidden));
            self.passes.extend([StageName::Cull, StageName::Setup]);
            let is_last = wave + 1 == self.waves.len();
            for _ in 0..if self.rendered && mode.in_two_passes && is_last { 2 } else { 1 } {
                self.passes.push(StageName::Raster);
                self.passes.extend(self.rendered.then_some(StageName::HardwareRaster));
            }
            self.passes.extend((!is_last).then_some(StageName::CoarseDepth));
        }
        self.passes.extend((!self.on_host).then_some(StageName::Resolve));
    }

    /// Returns the parameters of a wave.
    pub fn params_of(&self, wave: usize) -> Params {
        let Range { start, end } = self.waves[wave];
        Params { first_run: start, end_run: end, hiding: u32::from(wave > 0), ..self.params }
    }

    fn place_outputs(&mut self, plan: &FramePlan) {
        self.outputs = plan.drawn();
        if !plan.sensor.is_camera() {
            self.outputs = self.outputs.without(Output::DepthZ);
        }
        if plan.limit.is_some() {
            // Ranges decide which pixels are final.
            self.outputs = self.outputs.with(Output::Range);
        }
        let pixels = plan.sensor.width() * plan.sensor.height();
        for (i, output) in self.outputs.iter().enumerate() {
            let at = i as u32 * pixels;
            match output {
                Output::Range => self.params.range_at = at,
                Output::DepthZ => self.params.depth_at = at,
                Output::PolygonId => self.params.polygon_at = at,
                Output::ObjectId => self.params.object_at = at,
                Output::CosIncidence => self.params.cos_at = at,
                // The plan never passes derived outputs to engines.
                _ => debug_assert!(false, "{} is derived from other images", output.name()),
            }
        }
        self.output_words = u64::from(pixels) * self.outputs.iter().count() as u64;
    }
}

fn columns(m: DMat3) -> [[f32; 3]; 3] {
    [m.x_axis, m.y_axis, m.z_axis].map(|c| c.as_vec3().to_array())
}

/// Splits f64 into two f32, which together hold 48 bits.
fn split(p: DVec3) -> ([f32; 3], [f32; 3]) {
    let high: Vec3 = p.as_vec3();
    (high.to_array(), (p - high.as_dvec3()).as_vec3().to_array())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn two_floats_hold_a_site_in_metres() {
        let p = DVec3::new(5_000_000.123_456_789, -3.0e-7, 1_234.567_890_123);
        let (high, low) = split(p);
        let again = Vec3::from(high).as_dvec3() + Vec3::from(low).as_dvec3();
        assert!((again - p).abs().max_element() < 1e-8);
    }
}
