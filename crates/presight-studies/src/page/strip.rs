//! Strip charts: curves of values by frame or view.

use maud::{Markup, html};

/// Height of a strip chart, pixels.
const HEIGHT: f64 = 90.0;

/// A curve of a value by frame or view, which breaks where there is no value.
#[derive(Clone, Debug, Default)]
pub struct Strip {
    /// Its accessible name.
    pub name: String,
    /// Values in order.
    pub values: Vec<Option<f64>>,
    /// Values drawn as dashed lines, such as the expected one.
    pub levels: Vec<f64>,
    /// True for a logarithmic scale.
    pub logarithmic: bool,
}

impl Strip {
    /// The least and the greatest of the finite values, without the levels.
    pub(super) fn range(&self) -> [f64; 2] {
        extremes(self.values.iter().flatten().copied())
    }

    /// The chart as an `<svg>` element; `mark` is drawn over it.
    pub(super) fn svg(&self, mark: Option<&Markup>) -> Markup {
        let place = |v: f64| if self.logarithmic { v.max(1e-3).log10() } else { v };
        let [min, max] = extremes(self.values.iter().flatten().chain(&self.levels).map(|v| place(*v)));
        let height = |v: f64| HEIGHT - 4.0 - (HEIGHT - 8.0) * (place(v) - min) / (max - min).max(1e-9);
        let numbered: Vec<(usize, Option<f64>)> = self.values.iter().copied().enumerate().collect();
        let stretches = numbered.split(|(_, v)| !v.is_some_and(f64::is_finite)).filter(|s| !s.is_empty());
        let lines = stretches.map(|stretch| {
            let at = |(k, v): &(usize, Option<f64>)| {
                format!("{:.2},{:.2}", across(*k, self.values.len()), height(v.unwrap_or(0.0)))
            };
            stretch.iter().map(at).collect::<Vec<_>>().join(" ")
        });
        html! {
            svg.strip viewBox=(format!("0 0 1000 {HEIGHT}")) preserveAspectRatio="none" role="img"
                aria-label=(self.name) {
                @for v in &self.levels { line.expected x1="0" x2="1000" y1=(height(*v)) y2=(height(*v)) {} }
                @for line in lines { polyline points=(line) {} }
                @if let Some(mark) = mark { (mark) }
            }
        }
    }

    /// Height of a chart, pixels.
    pub(super) fn height() -> f64 {
        HEIGHT
    }
}

/// The x coordinate of a value in a strip, from 0 to 1000.
fn across(k: usize, count: usize) -> f64 {
    1000.0 * (k as f64 + 0.5) / count.max(1) as f64
}

fn extremes(values: impl Iterator<Item = f64>) -> [f64; 2] {
    let finite = values.filter(|v| v.is_finite());
    finite.fold([f64::INFINITY, f64::NEG_INFINITY], |[min, max], v| [min.min(v), max.max(v)])
}
