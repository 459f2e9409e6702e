//! One axis of a chart: the positions of values and ticks.

use plotters::coord::ranged1d::{KeyPointHint, NoDefaultFormatting, Ranged, ValueFormatter};

/// The maximum number of ticks on an axis.
const MOST_TICKS: i32 = 9;

/// One axis: the positions of values and ticks. Plotters sees only drawn units.
#[derive(Clone)]
pub(super) struct Axis {
    log: bool,
    /// Ends in drawn units: decades if logarithmic.
    low: f64,
    high: f64,
    /// Position of 0 on a logarithmic axis; `None` if no value is 0.
    zero: Option<f64>,
    /// Position of infinite bounds; `None` if all bounds are finite.
    pub top: Option<f64>,
    pub ticks: Vec<f64>,
}

impl Axis {
    /// An axis that covers the values; `None` if no value can be shown.
    pub fn over(values: impl Iterator<Item = f64> + Clone, log: bool) -> Option<Self> {
        let shown =
            values.clone().filter(|v| v.is_finite() && (!log || *v > 0.0)).map(|v| if log { v.log10() } else { v });
        let (low, high) = shown.fold((f64::INFINITY, f64::NEG_INFINITY), |(lo, hi), v| (lo.min(v), hi.max(v)));
        let zero = log && values.clone().any(|v| v == 0.0);
        if low > high && !zero {
            return None;
        }
        let (low, high) = if low > high { (0.0, 0.0) } else { (low, high) };
        if !log {
            let margin = if high > low { 0.06 * (high - low) } else { high.abs().max(1.0) * 0.5 };
            let (low, high) = (low - margin, high + margin);
            return Some(Self { log, low, high, zero: None, top: None, ticks: Vec::new() }.with_round_ticks());
        }
        let margin = (0.07 * (high - low)).max(0.4);
        let (first, last) = ((low - margin).floor() as i32, (high + margin).ceil() as i32);
        // Axes of at most three decades also get ticks at 2 and 5.
        let (low, high) =
            if last - first <= 3 { (low - margin, high + margin) } else { (f64::from(first), f64::from(last)) };
        let step = (last - first).div_euclid(MOST_TICKS) + 1;
        let mut ticks: Vec<f64> = (first..=last).filter(|k| k.rem_euclid(step) == 0).map(f64::from).collect();
        if last - first <= 3 {
            let between = |k: i32| [2f64, 5.0].map(|m| f64::from(k) + m.log10());
            ticks.extend((first..last).flat_map(between));
            ticks.sort_by(f64::total_cmp);
        }
        ticks.retain(|t| (low..=high).contains(t));
        let gap = (0.1 * (high - low)).max(0.3);
        let zero = zero.then_some(low - gap);
        ticks.extend(zero);
        Some(Self { log, low: zero.map_or(low, |z| z - 0.4 * gap), high, zero, top: None, ticks })
    }

    /// Adds a position above all values for infinite bounds.
    pub fn add_top(&mut self) {
        let gap = 0.08 * (self.high - self.low);
        self.top = Some(self.high + gap);
        self.ticks.push(self.high + gap);
        self.high += 1.6 * gap;
    }

    /// Sets ticks in steps of 1, 2 or 5 times a power of ten.
    fn with_round_ticks(mut self) -> Self {
        let raw = (self.high - self.low) / f64::from(MOST_TICKS);
        let power = 10f64.powf(raw.log10().floor());
        let step = [1.0, 2.0, 5.0, 10.0].map(|m| m * power).into_iter().find(|s| *s >= raw).unwrap_or(raw);
        let first = (self.low / step).ceil();
        // Multiply rather than add up steps, which would accumulate rounding.
        self.ticks = (0..=MOST_TICKS).map(|k| (first + f64::from(k)) * step).filter(|t| *t <= self.high).collect();
        self
    }

    /// The position of a value; `None` if it cannot be shown.
    pub fn place(&self, value: f64) -> Option<f64> {
        match (self.log, value) {
            (_, v) if !v.is_finite() => None,
            (false, v) => Some(v),
            (true, 0.0) => self.zero,
            (true, v) => (v > 0.0).then(|| v.log10()),
        }
    }

    fn label(&self, at: f64) -> String {
        match (self.log, self.zero) {
            _ if self.top == Some(at) => "no bound".into(),
            (false, _) => number(at),
            (true, Some(zero)) if at == zero => "0".into(),
            (true, _) => number(10f64.powf(at)),
        }
    }
}

impl Ranged for Axis {
    type FormatOption = NoDefaultFormatting;
    type ValueType = f64;

    fn map(&self, value: &f64, limit: (i32, i32)) -> i32 {
        let share = (value - self.low) / (self.high - self.low);
        limit.0 + (share * f64::from(limit.1 - limit.0)).round() as i32
    }

    fn key_points<Hint: KeyPointHint>(&self, hint: Hint) -> Vec<f64> {
        // Plotters also requests light grid lines; there are none.
        if hint.weight().allow_light_points() { Vec::new() } else { self.ticks.clone() }
    }

    fn range(&self) -> std::ops::Range<f64> {
        self.low..self.high
    }
}

impl ValueFormatter<f64> for Axis {
    fn format(value: &f64) -> String {
        number(*value)
    }

    fn format_ext(&self, value: &f64) -> String {
        self.label(*value)
    }
}

/// Formats a number briefly: `0.02`, `500`, `1e-7`.
fn number(value: f64) -> String {
    let size = value.abs();
    if size < 1e-12 && size == 0.0 {
        "0".into()
    } else if (1e-3..1e5).contains(&size) {
        let digits = (2 - size.log10().floor() as i32).clamp(0, 6) as usize;
        let text = format!("{value:.digits$}");
        let text = if text.contains('.') { text.trim_end_matches('0').trim_end_matches('.') } else { &text };
        text.to_owned()
    } else {
        format!("{:.0e}", value)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn zero_has_a_place_below_all_others() {
        let axis = Axis::over([1e-7, 0.0, 1e-3].into_iter(), true).unwrap();
        let zero = axis.place(0.0).unwrap();
        assert!(zero < axis.place(1e-7).unwrap() && axis.low < zero);
        assert_eq!(axis.label(zero), "0");
        assert_eq!(axis.label(-3.0), "0.001");
        assert_eq!(axis.label(-7.0), "1e-7");
        assert_eq!(axis.place(-1.0), None);
        assert_eq!(axis.place(f64::INFINITY), None);
        assert_eq!(Axis::over([1.0, 2.0].into_iter(), true).unwrap().zero, None);
    }

    #[test]
    fn ticks_are_round_and_few() {
        for (low, high) in [(0.0, 1.0), (-3.0, 977.0), (1e-9, 3e-9), (5.0, 5.0), (1e-9, 1e9)] {
            for log in [false, true] {
                let axis = Axis::over([low, high].into_iter(), log).unwrap();
                assert!((2..=12).contains(&axis.ticks.len()), "{low} {high} {log}: {:?}", axis.ticks);
                assert!(axis.ticks.iter().all(|t| (axis.low..=axis.high).contains(t)));
            }
        }
        assert_eq!(number(0.02), "0.02");
        assert_eq!(number(500.0), "500");
        assert_eq!(number(-0.25), "-0.25");
    }
}
