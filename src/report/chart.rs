//! Charts of points and lines as SVG that follows the colours of the page around it.

use crate::error::{Error, ErrorKind, Result};
use plotters::coord::ranged1d::{KeyPointHint, NoDefaultFormatting, Ranged, ValueFormatter};
use plotters::prelude::*;

/// Width and height of a chart, pixels.
const SIZE: (u32, u32) = (920, 460);
/// Width of the legend, pixels.
const LEGEND: u32 = 250;
/// Names in the legend longer than this are cut.
const LONGEST_NAME: usize = 36;
/// Ticks on an axis, at most.
const MOST_TICKS: i32 = 9;

/// How many colours there are; series take them in turn.
pub const COLORS: usize = 8;

/// What is drawn in the page's own text colour. Plotters knows only numbers, so each role has a number nothing else
/// uses, and [`Chart::svg`] puts CSS in its place.
const INK: RGBColor = RGBColor(1, 1, 1);
/// Grid lines.
const FAINT: RGBColor = RGBColor(1, 1, 2);

/// How a series is drawn.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Style {
    /// A mark at every point.
    #[default]
    Points,
    /// A line through the points, with marks.
    LinePoints,
    /// A dashed line without marks: a bound.
    Bound,
    /// Rings around points and a thin line through them, in the text's colour: the Pareto front.
    Front,
}

/// Points of one name.
#[derive(Clone, Debug, Default)]
pub struct Series {
    /// In the legend; without one it is not in it.
    pub name: String,
    /// x and y in the units of the axes; points that are not finite are left out.
    pub points: Vec<(f64, f64)>,
    /// A short text beside each point; empty for none.
    pub labels: Vec<String>,
    /// How they are drawn.
    pub style: Style,
    /// Which colour and mark (modulo [`COLORS`]); a bound may share its engine's.
    pub color: usize,
}

/// A chart with axes, series and a legend.
///
/// On a logarithmic axis a value of 0 (an exact result) stands on a line of its own below all others, labelled 0;
/// negative values are left out.
///
/// ```
/// use presight::report::chart::{Chart, Series};
/// let points = vec![(1.0, 1e-7), (10.0, 0.0)];
/// let series = vec![Series { name: "cpu".into(), points, ..Series::default() }];
/// let chart = Chart { title: "error".into(), x_label: "ms".into(), y_label: "m".into(), x_log: true, y_log: true, series };
/// assert!(chart.svg()?.starts_with("<svg"));
/// # Ok::<(), presight::Error>(())
/// ```
#[derive(Clone, Debug, Default)]
pub struct Chart {
    /// Above the chart.
    pub title: String,
    /// Below the x axis, with its unit.
    pub x_label: String,
    /// Beside the y axis, with its unit.
    pub y_label: String,
    /// The x axis is logarithmic.
    pub x_log: bool,
    /// The y axis is logarithmic.
    pub y_log: bool,
    /// What is drawn, in this order.
    pub series: Vec<Series>,
}

type Drawn<T> = std::result::Result<T, Box<dyn std::error::Error>>;

impl Chart {
    /// The chart as an `<svg>` element. Its colours are the page's CSS variables `--s0` .. `--s7` and `currentColor`, so
    /// that it follows a light or dark page; alone it falls back to colours for a light one.
    ///
    /// # Errors
    /// [`ErrorKind::Invalid`] if there is nothing to draw: no series has a finite point.
    pub fn svg(&self) -> Result<String> {
        let x = Axis::over(self.series.iter().flat_map(|s| &s.points).map(|p| p.0), self.x_log);
        let y = Axis::over(self.series.iter().flat_map(|s| &s.points).map(|p| p.1), self.y_log);
        let (Some(x), Some(y)) = (x, y) else {
            return Err(Error::invalid(format!("the chart {:?} has no point", self.title), "give it one"));
        };
        let mut svg = String::new();
        self.draw(&x, &y, &mut svg)
            .map_err(|e| Error::new(ErrorKind::Invalid, format!("cannot draw the chart {:?}: {e}", self.title), ""))?;
        Ok(themed(&svg, &self.title))
    }

    fn draw(&self, x: &Axis, y: &Axis, svg: &mut String) -> Drawn<()> {
        let area = SVGBackend::with_string(svg, SIZE).into_drawing_area();
        let area = area.titled(&self.title, ("sans-serif", 18).into_font().color(&INK))?;
        let (plot, legend) = area.split_horizontally(SIZE.0 - LEGEND);
        let mut chart = ChartBuilder::on(&plot)
            .margin(8)
            .margin_right(20)
            .x_label_area_size(44)
            .y_label_area_size(70)
            .build_cartesian_2d(x.clone(), y.clone())?;
        let text = ("sans-serif", 13).into_font().color(&INK);
        chart
            .configure_mesh()
            .light_line_style(TRANSPARENT)
            .bold_line_style(FAINT.stroke_width(1))
            .axis_style(INK.stroke_width(1))
            .label_style(text.clone())
            .axis_desc_style(text)
            .x_desc(self.x_label.as_str())
            .y_desc(self.y_label.as_str())
            .x_labels(x.ticks.len())
            .y_labels(y.ticks.len())
            .draw()?;
        for series in &self.series {
            let mut at = Vec::new();
            for (i, point) in series.points.iter().enumerate() {
                if let (Some(px), Some(py)) = (x.place(point.0), y.place(point.1)) {
                    let (cx, cy) = chart.backend_coord(&(px, py));
                    at.push((cx, cy));
                    if let Some(label) = series.labels.get(i) {
                        area_text(&area, label, (cx + 7, cy - 14), 11)?;
                    }
                }
            }
            let (left, top) = area.get_base_pixel();
            let at: Vec<(i32, i32)> = at.into_iter().map(|(cx, cy)| (cx - left, cy - top)).collect();
            draw_series(&area, series, &at)?;
        }
        for (i, series) in self.series.iter().filter(|s| !s.name.is_empty()).enumerate() {
            let y = 20 + 20 * i as i32;
            let ends = match series.style {
                Style::Points | Style::Front => vec![(22, y)],
                _ => vec![(10, y), (34, y)],
            };
            draw_series(&legend, series, &ends)?;
            let name: String = series.name.chars().take(LONGEST_NAME).collect();
            legend.draw(&Text::new(name, (44, y - 7), ("sans-serif", 13).into_font().color(&INK)))?;
        }
        area.present()?;
        Ok(())
    }
}

type Area<'a> = DrawingArea<SVGBackend<'a>, plotters::coord::Shift>;

/// A text at a pixel of the whole picture.
fn area_text(area: &Area<'_>, text: &str, at: (i32, i32), size: i32) -> Drawn<()> {
    let (left, top) = area.get_base_pixel();
    area.draw(&Text::new(text.to_owned(), (at.0 - left, at.1 - top), ("sans-serif", size).into_font().color(&INK)))?;
    Ok(())
}

fn draw_series(area: &Area<'_>, series: &Series, at: &[(i32, i32)]) -> Drawn<()> {
    let color = color(series.color);
    match series.style {
        Style::Points => draw_marks(area, series.color, at)?,
        Style::LinePoints => {
            area.draw(&PathElement::new(at.to_vec(), color.stroke_width(2)))?;
            draw_marks(area, series.color, at)?;
        }
        Style::Bound => {
            for dash in dashes(at) {
                area.draw(&PathElement::new(dash.to_vec(), color.stroke_width(2)))?;
            }
        }
        Style::Front => {
            area.draw(&PathElement::new(at.to_vec(), INK.stroke_width(1)))?;
            for p in at {
                area.draw(&Circle::new(*p, 9, INK.stroke_width(2)))?;
            }
        }
    }
    Ok(())
}

/// Marks differ in shape as well as in colour.
fn draw_marks(area: &Area<'_>, index: usize, at: &[(i32, i32)]) -> Drawn<()> {
    let fill = color(index).filled();
    for &(x, y) in at {
        match index % 4 {
            0 => area.draw(&Circle::new((x, y), 5, fill))?,
            1 => area.draw(&Rectangle::new([(x - 4, y - 4), (x + 5, y + 5)], fill))?,
            2 => area.draw(&Polygon::new(vec![(x, y - 6), (x + 6, y + 5), (x - 6, y + 5)], fill))?,
            _ => area.draw(&Polygon::new(vec![(x, y - 6), (x + 6, y), (x, y + 6), (x - 6, y)], fill))?,
        }
    }
    Ok(())
}

/// A path cut into dashes of 7 pixels and gaps of 5.
fn dashes(at: &[(i32, i32)]) -> Vec<[(i32, i32); 2]> {
    const ON: f64 = 7.0;
    const PERIOD: f64 = 12.0;
    let mut dashes = Vec::new();
    for pair in at.windows(2) {
        let (a, b) = (pair[0], pair[1]);
        let (dx, dy) = (f64::from(b.0 - a.0), f64::from(b.1 - a.1));
        let length = dx.hypot(dy);
        let along = |t: f64| (a.0 + (dx * t).round() as i32, a.1 + (dy * t).round() as i32);
        for k in 0..(length / PERIOD).ceil() as i32 {
            let from = f64::from(k) * PERIOD;
            dashes.push([along(from / length), along(((from + ON) / length).min(1.0))]);
        }
    }
    dashes
}

fn color(index: usize) -> RGBColor {
    RGBColor(2, 2, (index % COLORS) as u8)
}

/// Okabe and Ito's colours, told apart by everybody: for a light page, for a dark one.
pub(super) const PALETTE: [(&str, &str); COLORS] = [
    ("#0072b2", "#56b4e9"),
    ("#d55e00", "#ff8c42"),
    ("#009e73", "#2fd6a3"),
    ("#b8860b", "#f0e442"),
    ("#cc79a7", "#e6a0c8"),
    ("#5b5bd6", "#9f9ff5"),
    ("#7a5230", "#c9a27c"),
    ("#606060", "#b0b0b0"),
];

/// Numbers become CSS. An element of ours has one colour only, so one `style` attribute.
fn themed(svg: &str, title: &str) -> String {
    let mut svg = svg.to_owned();
    let mut set = |color: RGBColor, css: &str| {
        let hex = format!("#{:02X}{:02X}{:02X}", color.0, color.1, color.2);
        for paint in ["fill", "stroke"] {
            svg = svg.replace(&format!("{paint}=\"{hex}\""), &format!("style=\"{paint}:{css}\""));
        }
    };
    set(INK, "currentColor");
    set(FAINT, "var(--faint,#d8d8d8)");
    for (i, (light, _)) in PALETTE.iter().enumerate() {
        set(color(i), &format!("var(--s{i},{light})"));
    }
    let name = title.replace('&', "&amp;").replace('<', "&lt;").replace('"', "&quot;");
    svg.replacen("<svg ", &format!("<svg role=\"img\" aria-label=\"{name}\" "), 1)
}

/// One axis: where values go, and where its ticks are. Plotters sees drawn units only.
#[derive(Clone)]
struct Axis {
    log: bool,
    /// Ends in drawn units: decades if logarithmic.
    low: f64,
    high: f64,
    /// Where 0 stands on a logarithmic axis; `None` if nothing is 0.
    zero: Option<f64>,
    ticks: Vec<f64>,
}

impl Axis {
    /// Around values; `None` if none can be shown.
    fn over(values: impl Iterator<Item = f64> + Clone, log: bool) -> Option<Self> {
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
            return Some(Self { log, low, high, zero: None, ticks: Vec::new() }.with_round_ticks());
        }
        let margin = (0.07 * (high - low)).max(0.4);
        let (first, last) = ((low - margin).floor() as i32, (high + margin).ceil() as i32);
        // Short axes get 2 and 5 as well.
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
        Some(Self { log, low: zero.map_or(low, |z| z - 0.4 * gap), high, zero, ticks })
    }

    /// Ticks at 1, 2 or 5 times a power of ten.
    fn with_round_ticks(mut self) -> Self {
        let raw = (self.high - self.low) / f64::from(MOST_TICKS);
        let power = 10f64.powf(raw.log10().floor());
        let step = [1.0, 2.0, 5.0, 10.0].map(|m| m * power).into_iter().find(|s| *s >= raw).unwrap_or(raw);
        let first = (self.low / step).ceil();
        // Each tick is rounded on its own: sums of steps drift.
        self.ticks = (0..=MOST_TICKS).map(|k| (first + f64::from(k)) * step).filter(|t| *t <= self.high).collect();
        self
    }

    /// Where a value stands; `None` if it cannot be shown.
    fn place(&self, value: f64) -> Option<f64> {
        match (self.log, value) {
            (_, v) if !v.is_finite() => None,
            (false, v) => Some(v),
            (true, 0.0) => self.zero,
            (true, v) => (v > 0.0).then(|| v.log10()),
        }
    }

    fn label(&self, at: f64) -> String {
        match (self.log, self.zero) {
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
        // The mesh asks for light lines, too; there are none.
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

/// Short: `0.02`, `500`, `1e-7`.
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

    fn chart(points: Vec<(f64, f64)>) -> Chart {
        let series = vec![
            Series { name: "a".into(), points: points.clone(), labels: vec!["7".into()], ..Series::default() },
            Series { name: "bound".into(), points: points.clone(), style: Style::Bound, color: 1, ..Series::default() },
            Series { name: "front".into(), points, style: Style::Front, ..Series::default() },
        ];
        let (x_label, y_label) = ("time, ms".into(), "error, m".into());
        Chart { title: "t <&\">".into(), x_label, y_label, x_log: true, y_log: true, series }
    }

    #[test]
    fn no_fixed_colour_is_left() {
        let svg = chart(vec![(1.0, 1e-7), (2.0, 0.0), (30.0, 1e-3)]).svg().unwrap();
        assert!(svg.starts_with("<svg "), "{svg}");
        assert!(svg.contains("currentColor") && svg.contains("var(--s0,"));
        for paint in ["fill=\"#", "stroke=\"#"] {
            let fixed: Vec<&str> = svg.split(paint).skip(1).map(|s| &s[..6]).collect();
            assert!(fixed.is_empty(), "{paint}{fixed:?}");
        }
        assert!(svg.contains("t &lt;&amp;"));
    }

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

    #[test]
    fn extremes_are_drawn_and_nothing_is_an_error() {
        for points in [vec![(1.0, 0.0)], vec![(1e-300, 1e300), (f64::NAN, 1.0)], vec![(3.0, 3.0), (3.0, 3.0)]] {
            chart(points).svg().unwrap();
        }
        assert!(chart(vec![(f64::NAN, 1.0)]).svg().is_err());
        assert!(chart(Vec::new()).svg().is_err());
    }
}
