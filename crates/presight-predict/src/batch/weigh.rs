//! The log-likelihood of a whole image: eight beams at a time, in f64.

use super::beam_model::BeamModel;
use std::f64::consts::{LN_2, LOG2_E};

/// Number of beams processed together.
const LANES: usize = 8;

/// Sums the log-densities of all beams. A type, so that it is compiled for each vector width. The result is bit-equal
/// for all widths, because the order of operations is fixed and none are fused.
pub(super) struct LogDensitySum<'a> {
    pub model: &'a BeamModel,
    /// Three images of equal size: measured ranges, predicted ranges, predicted cosines.
    pub sensed: &'a [f32],
    pub range: &'a [f32],
    pub cos_incidence: &'a [f32],
}

impl pulp::WithSimd for LogDensitySum<'_> {
    type Output = f64;

    #[inline(always)]
    fn with_simd<S: pulp::Simd>(self, simd: S) -> f64 {
        let mut product = Product::new();
        let (sensed, sensed_rest) = self.sensed.as_chunks::<LANES>();
        let (range, range_rest) = self.range.as_chunks::<LANES>();
        let (cos, cos_rest) = self.cos_incidence.as_chunks::<LANES>();
        for ((sensed, range), cos) in sensed.iter().zip(range).zip(cos) {
            product.take(&Densities::of(simd, self.model, [sensed, range, cos]));
        }
        // Beams beyond the end have no reading.
        let filled = |rest: &[f32]| std::array::from_fn(|l| rest.get(l).copied().unwrap_or(f32::NAN));
        let [sensed, range, cos] = [filled(sensed_rest), filled(range_rest), filled(cos_rest)];
        product.take(&Densities::of(simd, self.model, [&sensed, &range, &cos]));
        product.ln()
    }
}

type Lanes = [f64; LANES];

/// Densities of readings, or probabilities of missing ones: `rest` plus `peak` times a power of two.
struct Densities {
    peak: Lanes,
    /// The exponent, in the last bits: see [`ROUND`].
    power: Lanes,
    rest: Lanes,
}

/// After adding it, the last bit of the sum is worth 1.
const ROUND: f64 = 6_755_399_441_055_744.0;

impl Densities {
    /// Computes them from readings, predicted ranges and cosines; 1 without a reading or a prediction.
    #[inline(always)]
    fn of<S: pulp::Simd>(simd: S, model: &BeamModel, images: [&[f32; LANES]; 3]) -> Self {
        let [sensed, range, cos] = images.map(|image| image.map(f64::from));
        let mut ours = Self { peak: [0.0; LANES], power: [0.0; LANES], rest: [0.0; LANES] };
        {
            let [sensed, range, cos] = [&sensed, &range, &cos].map(|lanes| S::as_simd_f64s(lanes).0);
            let peak = S::as_mut_simd_f64s(&mut ours.peak).0;
            let power = S::as_mut_simd_f64s(&mut ours.power).0;
            let rest = S::as_mut_simd_f64s(&mut ours.rest).0;
            for i in 0..LANES / S::F64_LANES {
                [peak[i], power[i], rest[i]] = mixed(simd, model, sensed[i], range[i], cos[i]);
            }
        }
        ours
    }
}

/// The terms of [`Densities`] for a vector of beams.
#[inline(always)]
fn mixed<S: pulp::Simd>(simd: S, model: &BeamModel, sensed: S::f64s, range: S::f64s, cos: S::f64s) -> [S::f64s; 3] {
    let (of, add, mul) = (|v| simd.splat_f64s(v), |a, b| simd.add_f64s(a, b), |a, b| simd.mul_f64s(a, b));
    let (zero, infinity, nearest) = (of(0.0), of(f64::INFINITY), of(f64::NEG_INFINITY));
    let surface = model.surface(simd, range, cos);
    let away = simd.sub_f64s(sensed, range);

    let power = simd.max_f64s(mul(mul(away, away), mul(surface.sharpness, of(-LOG2_E))), of(-1020.0));
    let rounded = add(power, of(ROUND));
    let t = mul(simd.sub_f64s(power, simd.sub_f64s(rounded, of(ROUND))), of(LN_2));
    let peak = mul(surface.peak, exp(simd, t));

    let short = simd.select_f64s(simd.less_than_f64s(away, zero), surface.short, zero);
    let rest = add(short, of(model.any));
    let nothing = simd.equal_f64s(range, infinity);
    let none = simd.select_f64s(nothing, of(model.mixture.none + model.mixture.hit), of(model.mixture.none));
    let none_sensed = simd.equal_f64s(sensed, infinity);
    let near_sensed = simd.equal_f64s(sensed, nearest);
    let rest = simd.select_f64s(none_sensed, none, rest);
    let rest = simd.select_f64s(near_sensed, model.near(simd, range, surface.short), rest);
    // NaN differs from itself.
    let known = simd.and_m64s(simd.equal_f64s(sensed, sensed), simd.equal_f64s(range, range));
    let finite = |v| simd.less_than_f64s(simd.abs_f64s(v), infinity);
    let hit = simd.and_m64s(finite(sensed), finite(range));
    [simd.select_f64s(hit, peak, zero), rounded, simd.select_f64s(known, rest, of(1.0))]
}

/// exp(t) for |t| <= ln 2 / 2, by its Taylor series: the first omitted term is 6e-15.
#[inline(always)]
fn exp<S: pulp::Simd>(simd: S, t: S::f64s) -> S::f64s {
    const OVER_FACTORIALS: [f64; 11] = [
        1.0 / 3_628_800.0,
        1.0 / 362_880.0,
        1.0 / 40_320.0,
        1.0 / 5_040.0,
        1.0 / 720.0,
        1.0 / 120.0,
        1.0 / 24.0,
        1.0 / 6.0,
        0.5,
        1.0,
        1.0,
    ];
    let mut p = simd.splat_f64s(1.0 / 39_916_800.0);
    for c in OVER_FACTORIALS {
        p = simd.add_f64s(simd.mul_f64s(p, t), simd.splat_f64s(c));
    }
    p
}

/// Products of positive factors, with separate exponents against overflow and underflow.
struct Product {
    /// Each in 1..2.
    mantissas: Lanes,
    /// Exponents of two, each with a surplus of [`BIAS`] per factor.
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
    fn take(&mut self, densities: &Densities) {
        for l in 0..LANES {
            let power = f64::from_bits(densities.power[l].to_bits().wrapping_add(BIAS) << 52);
            let density = densities.rest[l] + densities.peak[l] * power;
            let bits = (self.mantissas[l] * density).to_bits();
            self.exponents[l] += bits >> 52;
            self.mantissas[l] = f64::from_bits(bits & MANTISSA | ONE);
        }
        self.factors += 1;
    }

    #[inline(always)]
    fn ln(self) -> f64 {
        let exponents: u64 = self.exponents.iter().sum();
        let whole = exponents as i64 - (self.factors * BIAS * LANES as u64) as i64;
        whole as f64 * LN_2 + self.mantissas.iter().product::<f64>().ln()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    struct Exp(Vec<f64>);

    impl pulp::WithSimd for Exp {
        type Output = Vec<f64>;

        fn with_simd<S: pulp::Simd>(mut self, simd: S) -> Vec<f64> {
            S::as_mut_simd_f64s(&mut self.0).0.iter_mut().for_each(|t| *t = exp(simd, *t));
            self.0
        }
    }

    #[test]
    fn exponentials_are_right() {
        let t: Vec<f64> = (-3466..=3469).map(|i| f64::from(i) * 1e-4).collect();
        for (exp, t) in pulp::Arch::new().dispatch(Exp(t.clone())).iter().zip(t) {
            assert!((exp / t.exp() - 1.0).abs() < 2e-14, "{t}");
        }
    }

    #[test]
    fn products_have_no_ends() {
        let mut product = Product::new();
        for factor in [1e-300, 1e-300, 3.0, 1e-200, 1e300] {
            product.take(&Densities { peak: [0.0; LANES], power: [ROUND; LANES], rest: [factor; LANES] });
        }
        let truth = LANES as f64 * (3f64.ln() - 500.0 * 10f64.ln());
        assert!((product.ln() / truth - 1.0).abs() < 1e-14);
    }
}
