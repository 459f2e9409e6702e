//! What an engine needs to weigh a sensed range image itself, where it keeps the predicted ones.

use super::Images;
use bytemuck::{Pod, Zeroable};

/// What an engine hands over of each of many frames.
#[derive(Debug)]
pub enum Drawn<'a> {
    /// The images that were asked for.
    Images(&'a mut Images),
    /// The images were weighed where they were drawn: sums of the logarithms of the beams' densities, by heading.
    Sums(&'a [f64]),
}

/// A sensed range image and the model of its beams (the formula: `docs/batches.md`). An engine that weighs gives back sums and no
/// image.
#[derive(Clone, Debug)]
pub struct Weighing {
    /// Row-major, metres, as [`crate::batch::RangeLikelihood`] takes them.
    pub sensed: Vec<f32>,
    /// Beams of a row, sensed and predicted. More are predicted where they go all the way round.
    pub beams: [u32; 2],
    /// Headings at which it is weighed: the sensed row begins at the predicted column `k * stride`, modulo the row.
    pub headings: u32,
    /// Columns from one heading to the next.
    pub stride: u32,
    /// What all beams have in common.
    pub model: BeamNumbers,
}

/// Numbers of the mixture of a beam: metres, radians, densities in 1 / metre; `ln` are natural logarithms.
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct BeamNumbers {
    /// Standard deviation of a range.
    pub range_sigma: f32,
    /// What is added to it, times the square of the range.
    pub quadratic: f32,
    /// Variance of direction and heading together.
    pub turn: f32,
    /// Variance of the place.
    pub place: f32,
    /// Ranges that the sensor can sense: from.
    pub range_min: f32,
    /// Ranges that the sensor can sense: to.
    pub range_max: f32,
    /// Share of what is nearer than predicted.
    pub short: f32,
    /// Its logarithm.
    pub ln_short: f32,
    /// Probability of anything nearer than `range_min`.
    pub below: f32,
    /// The same where that is predicted.
    pub near_there: f32,
    /// Density of anything.
    pub ln_any: f32,
    /// Share of hits over the root of two pi.
    pub ln_hit: f32,
    /// Probability of no return where a surface is predicted.
    pub ln_none: f32,
    /// Probability of no return where none is predicted.
    pub ln_nothing: f32,
}
