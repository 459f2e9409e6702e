//! The formula of docs/batches.md, beam by beam with a logarithm for each, in f64: slow and simple.

use presight_model::sensor::{Mixture, SensorSpec};
use presight_predict::batch::PoseCell;
use std::f64::consts::PI;

/// The terms of the mixture.
#[derive(Debug, Default)]
pub struct Terms {
    pub hit: f64,
    pub short: f64,
    pub none: f64,
    pub any: f64,
}

pub fn terms(spec: &SensorSpec, cell: PoseCell, sensed: f32, range: f32, cos: f32) -> Terms {
    let Mixture { hit, short, none, any, .. } = spec.noise.mixture;
    let (z, r) = (f64::from(sensed), f64::from(range));
    let mut terms = Terms::default();
    // Unmapped objects are equally likely anywhere up to the surface, or up to the end of the range.
    let surface = r.min(spec.range_max).max(1e-6);
    if sensed == f32::INFINITY {
        terms.none = none;
        terms.hit = if range == f32::INFINITY { hit } else { 0.0 };
        return terms;
    }
    if sensed == f32::NEG_INFINITY {
        terms.any = any * spec.range_min / spec.range_max;
        terms.short = if range == f32::NEG_INFINITY { short } else { short * spec.range_min / surface };
        terms.hit = if range == f32::NEG_INFINITY { hit } else { 0.0 };
        return terms;
    }
    terms.any = any / spec.range_max;
    if range == f32::NEG_INFINITY {
        return terms;
    }
    if range == f32::INFINITY {
        terms.short = short / spec.range_max;
        return terms;
    }
    let cos = f64::from(cos).max(0.05);
    let tan = (1.0 - cos * cos).sqrt() / cos;
    let own = spec.noise.range_sigma + spec.noise.range_sigma_quadratic * r * r;
    let heading = cell.turn / 12f64.sqrt();
    let place = cell.side / 12f64.sqrt();
    let angle = spec.noise.angle_sigma;
    let variance = own.powi(2) + (r * tan * angle).powi(2) + (r * tan * heading).powi(2) + (place / cos).powi(2);
    terms.hit = hit * (-(z - r).powi(2) / (2.0 * variance)).exp() / (2.0 * PI * variance).sqrt();
    terms.short = if z < r { short / surface } else { 0.0 };
    terms
}

pub fn log_likelihood(spec: &SensorSpec, cell: PoseCell, sensed: &[f32], range: &[f32], cos: &[f32]) -> f64 {
    assert!(sensed.len() == range.len() && range.len() == cos.len());
    let mut sum = 0.0;
    for i in 0..sensed.len() {
        if !sensed[i].is_nan() && !range[i].is_nan() {
            let Terms { hit, short, none, any } = terms(spec, cell, sensed[i], range[i], cos[i]);
            sum += (hit + short + none + any).ln();
        }
    }
    sum / spec.noise.mixture.beam_dependence
}
