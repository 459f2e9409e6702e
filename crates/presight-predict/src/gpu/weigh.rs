//! Weighs measured range images on the device after resolve, so that sums are read back instead of images.

use super::buffers::{Growable, Uploads};
use super::device::Gpu;
use super::layout::{GROUP, GridKind};
use super::shaders;
use super::stage::{Binding, Stage, Variant};
use super::uploads::FrameUploads;
use bytemuck::{Pod, Zeroable};
use presight_model::error::Result;
use presight_render::plan::{BeamNumbers, StageName, Weighing};

/// Beams that an invocation sums.
const BEAMS: u32 = 16;
/// The only variant: the shader does not depend on the grid.
const VARIANT: Variant = Variant { kind: GridKind::Camera, bits: 0 };
/// Maximum number of parts of an image.
const MAX_PARTS: u32 = 1024;

/// `WeighParams` in weigh.wgsl.
#[derive(Clone, Copy, Debug, Pod, Zeroable)]
#[repr(C)]
pub(super) struct WeighParams {
    pub count: u32,
    pub sensed_beams: u32,
    pub predicted_beams: u32,
    pub stride: u32,
    pub parts: u32,
    pub range_at: u32,
    pub cos_at: u32,
    pub sums_at: u32,
    pub beam: BeamNumbers,
}

/// The stage and its buffers.
pub(super) struct Weigh {
    stage: Stage,
    params: Growable,
    sensed: Growable,
}

impl Weigh {
    pub fn new(gpu: &Gpu) -> Result<Self> {
        let mut stage = Stage::new(gpu, "weigh", &[Binding::Uniform, Binding::Read, Binding::Write]);
        stage.prepare(gpu, VARIANT, shaders::WEIGH, &[])?;
        let params = Growable::uniform(gpu, "beam model", size_of::<WeighParams>() as u64);
        Ok(Self { stage, params, sensed: Growable::storage(gpu, "measured image") })
    }

    /// Makes room for a measured image. Returns true if its buffer was replaced.
    ///
    /// # Errors
    /// [`presight_model::ErrorKind::DeviceMemory`].
    pub fn reserve(&mut self, gpu: &Gpu, weighing: &Weighing) -> Result<bool> {
        self.sensed.reserve(gpu, size_of_val(&weighing.sensed[..]) as u64)
    }

    pub fn bind(&mut self, gpu: &Gpu, outputs: &wgpu::Buffer) {
        self.stage.bind(gpu, &[self.params.buffer(), self.sensed.buffer(), outputs]);
    }

    /// Uploads a measured image for frames of one sensor.
    pub fn put(&self, uploads: &mut Uploads, weighing: &Weighing, frame: &FrameUploads) {
        uploads.put(&self.params, 0, bytemuck::bytes_of(&params(weighing, frame)));
        uploads.put(&self.sensed, 0, bytemuck::cast_slice(&weighing.sensed));
    }

    /// Encodes the weighing of a resolved frame.
    pub fn encode(&self, gpu: &Gpu, encoder: &mut wgpu::CommandEncoder, weighing: &Weighing) {
        let label = Some(StageName::WeighOnDevice.name());
        let mut pass = gpu.pass(encoder, &wgpu::ComputePassDescriptor { label, timestamp_writes: None });
        if self.stage.set(&mut pass, VARIANT, 0) {
            gpu.dispatch(&mut pass, [parts(weighing), weighing.headings]);
        }
    }
}

/// Workgroups that share the beams of a heading.
fn parts(weighing: &Weighing) -> u32 {
    (weighing.sensed.len() as u32).div_ceil(GROUP * BEAMS).clamp(1, MAX_PARTS)
}

/// Words of the sums of a frame.
pub(super) fn sum_words(weighing: &Weighing) -> u64 {
    u64::from(parts(weighing)) * u64::from(weighing.headings)
}

/// Adds the sums of parts by heading.
pub(super) fn sums_of(weighing: &Weighing, answer: &[u8]) -> Vec<f64> {
    let sum = |part: &[u8]| part.chunks_exact(4).map(|word| f64::from(bytemuck::pod_read_unaligned::<f32>(word))).sum();
    answer.chunks_exact(4 * parts(weighing) as usize).map(sum).collect()
}

fn params(weighing: &Weighing, frame: &FrameUploads) -> WeighParams {
    WeighParams {
        count: weighing.sensed.len() as u32,
        sensed_beams: weighing.beams[0],
        predicted_beams: weighing.beams[1],
        stride: weighing.stride,
        parts: parts(weighing),
        range_at: frame.params.range_at,
        cos_at: frame.params.cos_at,
        sums_at: frame.output_words as u32,
        beam: weighing.model,
    }
}
