//! What one frame uploads, worked out from the plan without a device: instances, runs, and the f64 list.

use super::geometry::Arena;
use super::grid::Tables;
use super::layout::{FEW_INSTANCES, GROUP, Instance, Params, RUN_WORDS, SLOT_WORDS, WorkRun};
use super::near::{NearList, is_near};
use super::stages::{NAMES, RESOLVE};
use crate::plan::{FramePlan, IdScheme, Output, Outputs, Run, StageName};
use glam::{DMat3, DVec3, Vec3};
use std::ops::Range;

/// Most slots that are read back to resolve images on the CPU.
const MOST_SLOTS_ON_HOST: u32 = 1 << 20;

/// The uploads of a frame, in buffers that stay.
#[derive(Default)]
pub(super) struct FrameUploads {
    pub params: Params,
    pub instances: Vec<Instance>,
    /// Runs and a sentinel, the first run of every workgroup, facings by material.
    pub work: Vec<u32>,
    pub near: NearList,
    /// Every instance is opaque and two-sided: no material is looked at.
    pub plain: bool,
    /// What can be delivered of what is asked.
    pub outputs: Outputs,
    /// Words of all images.
    pub output_words: u64,
    /// Slots of the environment.
    pub slots: u32,
    /// The images are resolved on the CPU.
    pub on_host: bool,
    /// Drawn in one submission with others, which tells no times.
    pub in_company: bool,
}

impl FrameUploads {
    /// True if the instances are read from a uniform buffer.
    pub fn few(&self) -> bool {
        self.instances.len() <= FEW_INSTANCES as usize
    }

    /// Names of the stages that run on the device.
    pub fn stages(&self) -> &'static [StageName] {
        if self.on_host { &NAMES[..RESOLVE] } else { &NAMES }
    }

    /// Size of what is known about slots.
    pub fn slot_bytes(&self) -> u64 {
        u64::from(self.slots) * 4 * u64::from(SLOT_WORDS)
    }

    /// Works it out; the arena holds every mesh of the plan. On a software adapter the images are resolved on the
    /// CPU, unless so many slots would have to be read back that nothing is gained.
    pub fn fill(&mut self, plan: &FramePlan, tables: &Tables, arena: &Arena, software: bool) {
        self.fill_some(plan, 0..plan.runs.len(), tables, arena, software);
    }

    /// [`FrameUploads::fill`] with some of the runs.
    pub fn fill_some(&mut self, plan: &FramePlan, runs: Range<usize>, tables: &Tables, arena: &Arena, software: bool) {
        self.slots = plan.environment().slot_count();
        self.on_host = software && self.slots <= MOST_SLOTS_ON_HOST;
        self.params = tables.params;
        self.plain = plan.instances.iter().all(|i| i.plain);
        self.fill_instances(plan, arena);
        self.fill_work(plan, &plan.runs[runs], tables);
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

    fn fill_work(&mut self, plan: &FramePlan, runs: &[Run], tables: &Tables) {
        self.work.clear();
        self.near.clear();
        let objects = plan.environment().objects();
        let mut start = 0;
        for run in runs {
            let instance = &plan.instances[run.instance as usize];
            let near = is_near(&objects[instance.object as usize].mesh, instance, run);
            if near {
                self.near.add(plan, tables, instance, run);
            }
            let words = WorkRun { start, instance: run.instance, polygon: run.first, near: u32::from(near) };
            self.work.extend_from_slice(bytemuck::cast_slice(&[words]));
            start += run.count;
        }
        self.work.extend_from_slice(bytemuck::cast_slice(&[WorkRun { start, ..WorkRun::default() }]));
        debug_assert_eq!(self.work.len(), (runs.len() + 1) * RUN_WORDS);
        self.params.polygon_count = start;
        self.params.stamp = self.near.stamp;
        self.params.groups_at = self.work.len() as u32;
        let mut end = 0;
        for (index, run) in runs.iter().enumerate() {
            // Workgroups whose first polygon lies in this run.
            let first = (end as u32).next_multiple_of(GROUP);
            end += run.count as usize;
            self.work.extend((first..end as u32).step_by(GROUP as usize).map(|_| index as u32));
        }
        self.params.facings_at = self.work.len() as u32;
        self.work.extend(plan.facings.iter().map(|f| u32::from(f.opaque) | u32::from(f.one_sided) << 1));
    }

    fn place_outputs(&mut self, plan: &FramePlan) {
        self.outputs = plan.drawn();
        if !plan.sensor.is_camera() {
            self.outputs = self.outputs.without(Output::DepthZ);
        }
        if plan.watch.is_some() {
            // It tells what is final.
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
                // The plan draws none of those that engines do not make.
                _ => debug_assert!(false, "{} is made of other images", output.name()),
            }
        }
        self.output_words = u64::from(pixels) * self.outputs.iter().count() as u64;
    }
}

fn columns(m: DMat3) -> [[f32; 3]; 3] {
    [m.x_axis, m.y_axis, m.z_axis].map(|c| c.as_vec3().to_array())
}

/// Two f32 that together hold 48 bits.
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
