//! Tests feature samples against the surfaces that the nine pixels around each show: the fifth stage.
//!
//! It reads the last frame's nearest polygons and their records on the device, so no image is transferred. Answers are
//! f32 proposals; the caller verifies them in f64 ([`presight_features`]).

#[cfg(test)]
mod twin;

use super::buffers::{Answers, Growable, Uploads};
use super::device::Gpu;
use super::frame_buffers::FrameBuffers;
use super::layout::{self, GridKind, words_of};
use super::shaders;
use super::stage::{Binding, Stage, Variant};
use bytemuck::{Pod, Zeroable};
use glam::{DMat3, DVec3};
use presight_features::{FeatureSamples, OcclusionHint};
use presight_model::error::Result;
use presight_model::sensor::{PixelGrid, Sensor};

/// Words before the samples: their number, 1 if columns wrap around, padding.
pub(super) const SAMPLES_AT: usize = 4;
/// Words of a sample.
pub(super) const SAMPLE_WORDS: usize = words_of::<Sample>() as usize;

/// A sample of a feature; `SAMPLE_` in visible.wgsl.
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub(super) struct Sample {
    /// Position in the line frame.
    pub place: [f32; 3],
    /// Row-major index of the middle pixel.
    pub pixel: u32,
    /// Offset of the slots of its feature.
    pub slots: u32,
}

/// Word for an undecided sample.
const DOUBT: u32 = u32::MAX;
/// Word for a visible sample.
const SEEN: u32 = u32::MAX - 1;

/// Decodes a hint from its word.
pub(super) fn hint_of_word(word: u32) -> OcclusionHint {
    match word {
        DOUBT => OcclusionHint::Doubt,
        SEEN => OcclusionHint::Seen,
        slot => OcclusionHint::Hidden(slot),
    }
}

/// Feature samples in the stage's input format.
#[derive(Clone, Debug)]
pub struct OcclusionQuery {
    words: Vec<u32>,
    /// Transforms samples into the line frame of the records' planes.
    line_from_image: DMat3,
    count: u32,
    own_at: u32,
}

impl OcclusionQuery {
    /// Takes the samples of all features.
    pub fn new(of: &FeatureSamples<'_>) -> Self {
        let mut query = Self::with_room(of.samples.iter().map(Vec::len).sum(), of.sensor);
        for (samples, placed) in of.samples.iter().zip(of.placed) {
            query.begin(&placed.slots);
            samples.iter().for_each(|(at, pixel)| query.push(*at, *pixel));
        }
        query
    }

    /// Makes room for `count` samples on a sensor's image.
    pub(super) fn with_room(count: usize, sensor: &Sensor) -> Self {
        let mut words = vec![0; SAMPLES_AT + count * SAMPLE_WORDS];
        words[1] = sensor.columns_of_a_turn().map_or(0, |_| sensor.distinct_columns());
        let line_from_image = match sensor.grid() {
            PixelGrid::Lines(grid) => grid.line_from_image(),
            PixelGrid::Rays(_) => DMat3::IDENTITY,
        };
        Self { words, line_from_image, count: 0, own_at: 0 }
    }

    /// Starts a feature on these slots; the samples that follow belong to it.
    pub(super) fn begin(&mut self, slots: &[u32]) {
        self.own_at = self.words.len() as u32;
        self.words.push(slots.len() as u32);
        self.words.extend_from_slice(slots);
    }

    /// Adds a sample at a position in the image frame; `pixel` is the row-major index of the middle pixel.
    pub(super) fn push(&mut self, at: DVec3, pixel: u32) {
        let place = (self.line_from_image * at).as_vec3().to_array();
        let first = SAMPLES_AT + self.count as usize * SAMPLE_WORDS;
        let sample = Sample { place, pixel, slots: self.own_at };
        self.words[first..first + SAMPLE_WORDS].copy_from_slice(bytemuck::cast_slice(&[sample]));
        self.count += 1;
        self.words[0] = self.count;
    }

    /// Number of samples pushed.
    pub fn count(&self) -> u32 {
        self.count
    }
}

/// The stage with its buffers, created at the first query.
pub(super) struct Visible {
    stage: Stage,
    asked: Growable,
    answers: Growable,
    readback: Answers,
    rebind: bool,
}

impl Visible {
    pub fn new(gpu: &Gpu) -> Self {
        use Binding::{Read, Uniform, Write};
        Self {
            stage: Stage::new(gpu, "visible", &[Uniform, Read, Read, Read, Read, Write]),
            asked: Growable::storage(gpu, "samples of features"),
            answers: Growable::storage(gpu, "proposals"),
            readback: Answers::new(gpu, "the proposals"),
            rebind: true,
        }
    }

    /// Marks a frame buffer as replaced.
    pub fn rebind(&mut self) {
        self.rebind = true;
    }

    /// Runs the stage for at least one sample, on the last frame's buffers. Returns a hint for each sample.
    ///
    /// # Errors
    /// [`presight_model::error::ErrorKind::DeviceMemory`], or errors of the device.
    pub fn run(
        &mut self,
        gpu: &Gpu,
        uploads: &mut Uploads,
        store: &FrameBuffers,
        kind: GridKind,
        asked: &OcclusionQuery,
    ) -> Result<Vec<OcclusionHint>> {
        let bytes = u64::from(asked.count) * 4;
        self.rebind |= self.asked.reserve(gpu, asked.words.len() as u64 * 4)?;
        self.rebind |= self.answers.reserve(gpu, bytes)?;
        self.readback.reserve(gpu, bytes)?;
        let variant = Variant { kind, bits: 0 };
        self.stage.prepare(gpu, variant, shaders::VISIBLE, &[kind.constant()])?;
        if self.rebind {
            let of = [&store.params, &store.keys, &store.seen_slots, &store.records, &self.asked, &self.answers];
            self.stage.bind(gpu, &of.map(Growable::buffer));
            self.rebind = false;
        }
        uploads.clear();
        uploads.put(&self.asked, 0, bytemuck::cast_slice(&asked.words));
        uploads.end_part();
        uploads.submit(gpu, |uploads, encoder| {
            uploads.encode(encoder, 0);
            let mut pass = gpu.pass(encoder, &wgpu::ComputePassDescriptor::default());
            if self.stage.set(&mut pass, variant, 0) {
                gpu.dispatch(&mut pass, layout::groups_for(asked.count));
            }
            drop(pass);
            encoder.copy_buffer_to_buffer(self.answers.buffer(), 0, self.readback.buffer(), 0, bytes);
        })?;
        let answer = self.readback.wait(gpu, bytes)?;
        let words: &[u32] = bytemuck::cast_slice(&answer);
        Ok(words.iter().map(|word| hint_of_word(*word)).collect())
    }
}
