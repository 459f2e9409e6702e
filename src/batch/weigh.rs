//! The log-likelihood of a whole image: eight beams at a time, in f64.

use super::likelihood::BeamModel;

/// Beams that are worked on together.
const LANES: usize = 8;

/// Adds up the logarithms of the densities of all beams. A type, so that it is compiled for each vector width; none of them
/// changes a bit, for sums and products have the same order and are not fused.
pub(super) struct Weigh<'a> {
    pub model: &'a BeamModel,
    /// Three images of one size.
    pub sensed: &'a [f32],
    pub range: &'a [f32],
    pub cos_incidence: &'a [f32],
}

impl pulp::WithSimd for Weigh<'_> {
    type Output = f64;

    #[inline(always)]
    fn with_simd<S: pulp::Simd>(self, _: S) -> f64 {
        let mut product = Product::new();
        let (sensed, sensed_rest) = self.sensed.as_chunks::<LANES>();
        let (range, range_rest) = self.range.as_chunks::<LANES>();
        let (cos, cos_rest) = self.cos_incidence.as_chunks::<LANES>();
        for ((sensed, range), cos) in sensed.iter().zip(range).zip(cos) {
            product.take(self.model, sensed, range, cos);
        }
        // Beams that are not there have no reading.
        let filled = |rest: &[f32]| std::array::from_fn(|l| rest.get(l).copied().unwrap_or(f32::NAN));
        product.take(self.model, &filled(sensed_rest), &filled(range_rest), &filled(cos_rest));
        product.ln()
    }
}

/// Products of factors above 0, with exponents apart, so that none is too large or too small.
struct Product {
    /// In 1..2.
    mantissas: [f64; LANES],
    /// Powers of two, each [`BIAS`] too large.
    exponents: [u64; LANES],
    factors: u64,
}

const BIAS: u64 = 1023;
const MANTISSA: u64 = (1 << 52) - 1;
const ONE: u64 = BIAS << 52;

impl Product {
    fn new() -> Self {
        Self { mantissas: [1.0; LANES], exponents: [0; LANES], factors: 0 }
    }

    #[inline(always)]
    fn take(&mut self, model: &BeamModel, sensed: &[f32; LANES], range: &[f32; LANES], cos: &[f32; LANES]) {
        for l in 0..LANES {
            self.multiply(l, density(model, f64::from(sensed[l]), f64::from(range[l]), f64::from(cos[l])));
        }
        self.factors += 1;
    }

    #[inline(always)]
    fn multiply(&mut self, lane: usize, factor: f64) {
        let bits = (self.mantissas[lane] * factor).to_bits();
        self.exponents[lane] += bits >> 52;
        self.mantissas[lane] = f64::from_bits(bits & MANTISSA | ONE);
    }

    fn ln(&self) -> f64 {
        let exponents: u64 = self.exponents.iter().sum();
        let whole = exponents as i64 - (self.factors * BIAS * LANES as u64) as i64;
        whole as f64 * std::f64::consts::LN_2 + self.mantissas.iter().product::<f64>().ln()
    }
}

/// The density of a reading, or the probability of what has none; 1 without a reading or a prediction. Without branches.
#[inline(always)]
fn density(model: &BeamModel, sensed: f64, range: f64, cos_incidence: f64) -> f64 {
    let mixture = &model.mixture;
    let surface = model.surface(range, cos_incidence);
    let away = sensed - range;
    let gauss = surface.peak * exp_minus(away * away * surface.sharpness);
    let hit = if range.abs() < f64::INFINITY { gauss } else { 0.0 };
    let short = if away < 0.0 { surface.short } else { 0.0 };
    let ranged = hit + short + model.any;
    let none = if range == f64::INFINITY { mixture.none + mixture.hit } else { mixture.none };
    let outcome = if sensed == f64::INFINITY { none } else { ranged };
    let outcome = if sensed == f64::NEG_INFINITY { model.near(range, surface.short) } else { outcome };
    // NaN is what is not equal to itself.
    #[expect(clippy::eq_op, reason = "a comparison of two vectors; is_nan is one of bits")]
    let known = sensed == sensed && range == range;
    if known { outcome } else { 1.0 }
}

/// The exponential of -x, for x of 0 or more, to 1e-13 of it; about 0 beyond 700. Without branches, for vectors.
#[inline(always)]
fn exp_minus(x: f64) -> f64 {
    /// Added, the last bit of a sum is worth 1.
    const ROUND: f64 = 6_755_399_441_055_744.0;
    // NaN counts as far away.
    let power = x * -std::f64::consts::LOG2_E;
    let power = if power > -1020.0 { power } else { -1020.0 };
    let rounded = power + ROUND;
    let t = (power - (rounded - ROUND)) * std::f64::consts::LN_2;
    // Its Taylor series, |t| <= ln 2 / 2: the first term left out is 6e-15.
    let p = t * (1.0 / 39_916_800.0) + 1.0 / 3_628_800.0;
    let p = p * t + 1.0 / 362_880.0;
    let p = p * t + 1.0 / 40_320.0;
    let p = p * t + 1.0 / 5_040.0;
    let p = p * t + 1.0 / 720.0;
    let p = p * t + 1.0 / 120.0;
    let p = p * t + 1.0 / 24.0;
    let p = p * t + 1.0 / 6.0;
    let p = p * t + 0.5;
    let p = p * t + 1.0;
    let p = p * t + 1.0;
    f64::from_bits(p.to_bits().wrapping_add(rounded.to_bits() << 52))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn exponentials_are_right() {
        for i in 0..=700_000u32 {
            let x = f64::from(i) * 1e-3 + 1e-7;
            assert!((exp_minus(x) / (-x).exp() - 1.0).abs() < 2e-13, "{x}");
        }
        assert!(exp_minus(f64::INFINITY) < 1e-306 && exp_minus(f64::NAN) < 1e-306 && exp_minus(1e300) < 1e-306);
        assert_eq!(exp_minus(0.0), 1.0);
    }

    #[test]
    fn products_have_no_ends() {
        let mut product = Product::new();
        for factor in [1e-300, 1e-300, 3.0, 1e-200] {
            (0..LANES).for_each(|l| product.multiply(l, factor));
            product.factors += 1;
        }
        let truth = LANES as f64 * (3f64.ln() - 800.0 * 10f64.ln());
        assert!((product.ln() / truth - 1.0).abs() < 1e-14);
    }
}
