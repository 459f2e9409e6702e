//! The density of a reading of one beam, given the predicted surface.

use super::PoseCell;
use presight_model::error::{Error, Result};
use presight_model::sensor::{Mixture, Sensor};
use presight_render::plan::BeamNumbers;

/// Lower limit of the cosine of incidence; below it, the spread of the range would be unbounded.
const MIN_COS: f64 = 0.05;

/// Unexpected objects are spread over at least this distance, metres, so that their density is bounded.
const MIN_RANGE: f64 = 1e-6;

/// Lower limit of probabilities, so that a tiny `range_min` does not make the likelihood 0.
const MIN_PROBABILITY: f64 = 1e-30;

/// Upper limit of the variance of directions, radians squared: larger ones make no difference.
const ANY_TURN: f64 = 1e12;

/// Parameters common to all beams of a sensor.
#[derive(Clone, Copy, Debug)]
pub(super) struct BeamModel {
    pub mixture: Mixture,
    range_sigma: f64,
    quadratic: f64,
    /// Variance of the beam's direction and the pose's heading together, radians squared.
    turn: f64,
    /// Variance of the pose's position, metres squared.
    place: f64,
    range_min: f64,
    pub range_max: f64,
    /// Density of random readings, 1 / metre.
    pub any: f64,
    /// Probability of a random reading below `range_min`.
    below: f64,
}

/// Densities of readings for the predicted surfaces, 1 / metre.
#[derive(Clone, Copy, Debug)]
pub struct Surface<V> {
    /// Density of a hit at the predicted range, and the exponent's factor of the squared deviation; only for hits.
    pub peak: V,
    pub sharpness: V,
    /// Density of readings from unexpected nearer objects. Meaningless for surfaces below `range_min`.
    pub short: V,
}

impl BeamModel {
    pub fn new(sensor: &Sensor, cell: PoseCell) -> Result<Self> {
        let spec = sensor.spec();
        let at = |e: Error| e.at(format!("sensor {:?}", spec.name));
        if !(spec.noise.range_sigma >= 1e-9) {
            let remedy = "give range_sigma of at least 1e-9 m in its [noise]";
            return Err(at(Error::invalid("a likelihood needs the noise of ranges", remedy)));
        }
        if spec.range_max.is_infinite() {
            return Err(at(Error::invalid("a likelihood needs a finite range_max", "give the sensor one")));
        }
        let widths = [cell.side, cell.turn];
        if !widths.iter().all(|w| *w >= 0.0 && *w <= 1e6) {
            return Err(Error::invalid(
                format!("pose cell {cell:?}"),
                "give widths of 0 or more, in metres and radians",
            ));
        }
        // Variance of a uniform distribution.
        let variance = |width: f64| width * width / 12.0;
        let any = spec.noise.mixture.any / spec.range_max;
        Ok(Self {
            mixture: spec.noise.mixture,
            range_sigma: spec.noise.range_sigma,
            quadratic: spec.noise.range_sigma_quadratic,
            turn: (spec.noise.angle_sigma * spec.noise.angle_sigma + variance(cell.turn)).min(ANY_TURN),
            place: variance(cell.side),
            range_min: spec.range_min,
            range_max: spec.range_max,
            any: any.max(f64::MIN_POSITIVE),
            below: any * spec.range_min,
        })
    }

    /// The parameters in f32, for an engine that weighs images itself.
    pub fn numbers(&self) -> BeamNumbers {
        // For a share of 0, a logarithm whose exponential is 0.
        let ln = |p: f64| p.ln().max(-1e4) as f32;
        let Mixture { hit, short, none, .. } = self.mixture;
        BeamNumbers {
            range_sigma: self.range_sigma as f32,
            quadratic: self.quadratic as f32,
            turn: self.turn as f32,
            place: self.place as f32,
            range_min: self.range_min as f32,
            range_max: self.range_max as f32,
            short: short as f32,
            ln_short: ln(short),
            below: self.below as f32,
            near_there: (self.below + short + hit) as f32,
            ln_any: ln(self.any),
            ln_hit: ln(hit / std::f64::consts::TAU.sqrt()),
            ln_none: ln(none),
            ln_nothing: ln(none + hit),
        }
    }

    /// Densities for surfaces at predicted ranges.
    #[inline(always)]
    pub fn surface<S: pulp::Simd>(&self, simd: S, range: S::f64s, cos_incidence: S::f64s) -> Surface<S::f64s> {
        const PER_TWO_PI: f64 = 0.5 / std::f64::consts::PI;
        let (of, add, mul) = (|v| simd.splat_f64s(v), |a, b| simd.add_f64s(a, b), |a, b| simd.mul_f64s(a, b));
        let cos = simd.max_f64s(cos_incidence, of(MIN_COS));
        let cos_squared = mul(cos, cos);
        let squared = mul(range, range);
        let own = add(of(self.range_sigma), mul(of(self.quadratic), squared));
        let turned = mul(mul(squared, of(self.turn)), simd.sub_f64s(of(1.0), cos_squared));
        // The variance times the squared cosine: a single division then gives its inverse.
        let spread = add(add(mul(mul(own, own), cos_squared), turned), of(self.place));
        let inverse = simd.div_f64s(cos_squared, spread);
        let far = simd.max_f64s(simd.min_f64s(range, of(self.range_max)), of(MIN_RANGE));
        Surface {
            peak: mul(of(self.mixture.hit), simd.sqrt_f64s(mul(inverse, of(PER_TWO_PI)))),
            sharpness: mul(of(0.5), inverse),
            short: simd.div_f64s(of(self.mixture.short), far),
        }
    }

    /// Probabilities of readings below `range_min`.
    #[inline(always)]
    pub fn near<S: pulp::Simd>(&self, simd: S, range: S::f64s, short: S::f64s) -> S::f64s {
        let near = simd.add_f64s(simd.splat_f64s(self.below), simd.mul_f64s(short, simd.splat_f64s(self.range_min)));
        let is_near = simd.equal_f64s(range, simd.splat_f64s(f64::NEG_INFINITY));
        let near_there = simd.splat_f64s(self.below + self.mixture.short + self.mixture.hit);
        simd.max_f64s(simd.select_f64s(is_near, near_there, near), simd.splat_f64s(MIN_PROBABILITY))
    }
}
