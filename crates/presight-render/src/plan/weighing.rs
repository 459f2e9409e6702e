//! Data for engines that weigh a measured range image where they keep the predicted images.

use super::Images;
use bytemuck::{Pod, Zeroable};

/// An engine's result for one of many frames.
#[derive(Debug)]
pub enum Drawn<'a> {
    /// The requested images.
    Images(&'a mut Images),
    /// The device weighed the images: sums of the beams' log-densities, by heading.
    Sums(&'a [f64]),
}

/// A measured range image and the beam model (formula in `docs/batches.md`). An engine that weighs returns sums instead
/// of images.
#[derive(Clone, Debug)]
pub struct Weighing {
    /// Row-major, metres, as in `batch::RangeLikelihood`.
    pub sensed: Vec<f32>,
    /// Beams of a measured row and of a predicted row. The predicted row is longer if it covers a full turn.
    pub beams: [u32; 2],
    /// Number of headings: at heading k the measured row begins at the predicted column `k * stride`, modulo the row.
    pub headings: u32,
    /// Columns from one heading to the next.
    pub stride: u32,
    /// Parameters common to all beams.
    pub model: BeamNumbers,
}

/// Parameters of a beam's mixture: metres, radians, densities in 1 / metre; `ln` are natural logarithms.
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct BeamNumbers {
    /// Standard deviation of a range.
    pub range_sigma: f32,
    /// Added to `range_sigma`, times the squared range.
    pub quadratic: f32,
    /// Variance of direction and heading together, radians squared.
    pub turn: f32,
    /// Variance of the position, metres squared.
    pub place: f32,
    /// Minimum range of the sensor, metres.
    pub range_min: f32,
    /// Maximum range of the sensor, metres.
    pub range_max: f32,
    /// Share of readings shorter than predicted.
    pub short: f32,
    /// Logarithm of `short`.
    pub ln_short: f32,
    /// Probability of a random reading below `range_min`.
    pub below: f32,
    /// Probability of a reading below `range_min` if one is predicted there.
    pub near_there: f32,
    /// Log-density of random readings.
    pub ln_any: f32,
    /// Logarithm of the share of hits over the root of two pi.
    pub ln_hit: f32,
    /// Log-probability of no return if a surface is predicted.
    pub ln_none: f32,
    /// Log-probability of no return if none is predicted.
    pub ln_nothing: f32,
}
