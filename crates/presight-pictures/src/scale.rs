//! Maps values to positions on a scale bar.

use presight_model::statistics::ranked;
use presight_render::plan::{Images, Output};

/// A scale of values, linear or logarithmic.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Scale {
    /// The value with the colour of near.
    pub low: f64,
    /// The value with the colour of far.
    pub high: f64,
    /// True if equal steps of colour are equal ratios.
    pub logarithmic: bool,
}

/// Ratio of far to near above which the scale is logarithmic: on a linear one, everything near would have one colour.
const LOGARITHMIC_FROM: f64 = 6.0;
/// Fraction of pixels clipped at either end of the scale, so that one near corner does not take the colours of a whole
/// hall.
const OUTLIERS: f64 = 0.002;

impl Scale {
    /// The scale of an output's finite values; 0..1 for an output that is not in metres.
    pub fn of(images: &Images, output: Output) -> Self {
        let values = images.floats(output).filter(|_| output.is_distance()).unwrap_or(&[]);
        Self::of_values(values.iter().copied())
    }

    /// The scale of the finite values above 0.
    pub fn of_values(values: impl Iterator<Item = f32>) -> Self {
        let mut finite: Vec<f32> = values.filter(|v| v.is_finite() && *v > 0.0).collect();
        if finite.is_empty() {
            return Self { low: 0.0, high: 1.0, logarithmic: false };
        }
        let last = finite.len() - 1;
        let mut at = |rank: f64| ranked(&mut finite, rank as usize, f32::total_cmp).map_or(0.0, f64::from);
        let (low, high) = (at((OUTLIERS * last as f64).floor()), at(((1.0 - OUTLIERS) * last as f64).ceil()));
        let high = if high > low * 1.001 { high } else { low * 1.001 };
        Self { low, high, logarithmic: high > LOGARITHMIC_FROM * low }
    }

    /// 0 at the low end, 1 at the high one.
    pub fn share(&self, value: f64) -> f64 {
        let share = if self.logarithmic {
            (value / self.low).ln() / (self.high / self.low).ln()
        } else {
            (value - self.low) / (self.high - self.low)
        };
        share.clamp(0.0, 1.0)
    }

    /// Round values on the scale with their labels, in rising order.
    pub fn ticks(&self) -> Vec<(f64, String)> {
        let mut ticks = Vec::new();
        if self.logarithmic {
            let digits: &[f64] =
                if self.high > 20.0 * self.low { &[1.0, 2.0, 5.0] } else { &[1.0, 1.5, 2.0, 3.0, 4.0, 5.0, 6.0, 8.0] };
            for power in self.low.log10().floor() as i32..=self.high.log10().ceil() as i32 {
                let decimals = |digit: f64| (i32::from(digit.fract() != 0.0) - power).max(0) as usize;
                ticks.extend(digits.iter().map(|digit| (digit * 10f64.powi(power), decimals(*digit))));
            }
        } else {
            let (step, decimals) = nice_step((self.high - self.low) / 5.0);
            let first = (self.low / step).ceil() as i64;
            ticks.extend((first..first + 20).map(|i| (i as f64 * step, decimals)));
        }
        // The slack keeps the tick at an end that f32 rounding moved inwards.
        let slack = 1e-5 * (self.high - self.low);
        let on_scale = ticks.into_iter().filter(|(v, _)| (self.low - slack..=self.high + slack).contains(v));
        on_scale.map(|(v, decimals)| (v, format!("{v:.decimals$}"))).collect()
    }
}

/// 1, 2 or 5 times a power of ten, at least `rough`, and the decimals to print it with.
pub fn nice_step(rough: f64) -> (f64, usize) {
    let power = rough.log10().floor() as i32;
    let base = 10f64.powi(power);
    let digit = [1.0, 2.0, 5.0, 10.0].into_iter().find(|d| d * base >= rough * (1.0 - 1e-9)).unwrap_or(10.0);
    let power = if digit == 10.0 { power + 1 } else { power };
    (digit * base, (-power).max(0) as usize)
}

#[cfg(test)]
mod tests {
    use super::*;
    use presight_render::plan::Outputs;

    fn scale_of(values: &[f32]) -> Scale {
        let mut images = Images::default();
        images.prepare(values.len() as u32, 1, Outputs::of(&[Output::Range]));
        images.range.copy_from_slice(values);
        Scale::of(&images, Output::Range)
    }

    #[test]
    fn ticks_are_round_and_on_the_scale() {
        let labels = |s: Scale| s.ticks().into_iter().map(|(_, label)| label).collect::<Vec<_>>();
        assert_eq!(labels(scale_of(&[2.0, 4.9, f32::INFINITY])), ["2", "3", "4"]);
        assert_eq!(labels(scale_of(&[0.4, 75.0])), ["0.5", "1", "2", "5", "10", "20", "50"]);
        assert_eq!(labels(scale_of(&[0.7, 6.1])), ["0.8", "1", "1.5", "2", "3", "4", "5", "6"]);
        assert_eq!(labels(scale_of(&[1.00, 1.02])), ["1.000", "1.005", "1.010", "1.015", "1.020"]);
        assert!(labels(scale_of(&[])).len() >= 3);
        assert!(scale_of(&[3.0]).ticks().len() < 20);
    }

    #[test]
    fn shares_rise_from_0_to_1() {
        let s = scale_of(&[1.0, 100.0]);
        assert_eq!([s.share(0.5), s.share(1.0), s.share(10.0), s.share(1e9)], [0.0, 0.0, 0.5, 1.0]);
    }
}
