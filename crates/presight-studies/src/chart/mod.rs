//! Charts of points and lines as SVG that uses the colours of the surrounding page.

mod axis;
mod rect;

use crate::page::PALETTE;
use axis::Axis;
use plotters::prelude::*;
use presight_model::error::{Error, ErrorKind, Result};
use rect::Rect;

/// Width and height of a chart, pixels.
const SIZE: (u32, u32) = (980, 500);
/// Width of the legend, pixels.
const LEGEND: u32 = 290;
/// Text heights for plotters, a quarter larger than drawn: the title; axes and legend; labels of marks.
const TEXT: [i32; 3] = [21, 18, 15];
/// Longer names in the legend are cut.
const LONGEST_NAME: usize = 36;

/// The number of colours; series use them in turn.
pub const COLORS: usize = PALETTE.len();

/// The page's text colour. Plotters supports only fixed colours, so each role has a unique placeholder that
/// [`Chart::svg`] replaces by CSS.
const INK: RGBColor = RGBColor(1, 1, 1);
/// Grid lines.
const FAINT: RGBColor = RGBColor(1, 1, 2);

/// The drawing style of a series.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Style {
    /// A mark at every point.
    #[default]
    Points,
    /// A line through the points, with marks.
    LinePoints,
    /// A dashed line without marks: a bound. Infinite values are arrows above all others, at "no bound".
    Bound,
    /// Rings around points and a thin line through them, in the text colour: the Pareto front.
    Front,
}

/// A series of points.
#[derive(Clone, Debug, Default)]
pub struct Series {
    /// The name in the legend; a series without a name is not listed.
    pub name: String,
    /// x and y in the units of the axes. Lines break at points that are not finite, which are not drawn.
    pub points: Vec<(f64, f64)>,
    /// A short label for each point; may be empty.
    pub labels: Vec<String>,
    /// The style.
    pub style: Style,
    /// Index of the colour and mark (modulo [`COLORS`]). A bound can share the colour of its engine.
    pub color: usize,
}

/// A chart with axes, series and a legend.
///
/// On a logarithmic axis a value of 0 (an exact result) is drawn below all others at the label 0, and negative values
/// are not drawn. An infinite bound is drawn above all others at the label "no bound".
///
/// ```
/// use presight_studies::chart::{Chart, Series};
/// let points = vec![(1.0, 1e-7), (10.0, 0.0)];
/// let series = vec![Series { name: "cpu".into(), points, ..Series::default() }];
/// let (title, x_label, y_label) = ("error".into(), "ms".into(), "m".into());
/// let chart = Chart { title, x_label, y_label, x_log: true, y_log: true, series };
/// assert!(chart.svg()?.starts_with("<svg"));
/// # Ok::<(), presight::Error>(())
/// ```
#[derive(Clone, Debug, Default)]
pub struct Chart {
    /// The title above the chart.
    pub title: String,
    /// Label of the x axis, with its unit.
    pub x_label: String,
    /// Label of the y axis, with its unit.
    pub y_label: String,
    /// True for a logarithmic x axis.
    pub x_log: bool,
    /// True for a logarithmic y axis.
    pub y_log: bool,
    /// The series, in drawing order.
    pub series: Vec<Series>,
}

type Drawn<T> = std::result::Result<T, Box<dyn std::error::Error>>;

impl Chart {
    /// The chart as an `<svg>` element. Its colours are the page's CSS variables `--s0` .. `--s7` and `currentColor`,
    /// so it fits a light or dark page. Outside a page it falls back to colours for light backgrounds.
    ///
    /// # Errors
    /// [`ErrorKind::Invalid`] if no series has a finite point.
    pub fn svg(&self) -> Result<String> {
        let x = Axis::over(self.series.iter().flat_map(|s| &s.points).map(|p| p.0), self.x_log);
        let y = Axis::over(self.series.iter().flat_map(|s| &s.points).map(|p| p.1), self.y_log);
        let (Some(x), Some(mut y)) = (x, y) else {
            return Err(Error::invalid(format!("the chart {:?} has no finite point", self.title), "add a point"));
        };
        if self.series.iter().any(|s| s.points.iter().any(|p| s.lacks_bound(*p))) {
            y.add_top();
        }
        let mut svg = String::new();
        self.draw(&x, &y, &mut svg)
            .map_err(|e| Error::new(ErrorKind::Invalid, format!("cannot draw the chart {:?}: {e}", self.title), ""))?;
        Ok(themed(&svg, &self.title))
    }

    fn draw(&self, x: &Axis, y: &Axis, svg: &mut String) -> Drawn<()> {
        let area = SVGBackend::with_string(svg, SIZE).into_drawing_area();
        let area = area.titled(&self.title, ("sans-serif", TEXT[0]).into_font().color(&INK))?;
        let (plot, legend) = area.split_horizontally(SIZE.0 - LEGEND);
        let mut chart = ChartBuilder::on(&plot)
            .margin(8)
            .margin_right(20)
            .x_label_area_size(54)
            .y_label_area_size(96)
            .build_cartesian_2d(x.clone(), y.clone())?;
        let text = ("sans-serif", TEXT[1]).into_font().color(&INK);
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
        let (left, top) = area.get_base_pixel();
        let pixel = |px: f64, py: f64| {
            let (cx, cy) = chart.backend_coord(&(px, py));
            (cx - left, cy - top)
        };
        let place = |point: &(f64, f64)| Some(pixel(x.place(point.0)?, y.place(point.1)?));
        let mut without_bound = 0;
        for series in &self.series {
            for stretch in series.points.split(|point| place(point).is_none()).filter(|s| !s.is_empty()) {
                draw_series(&area, series, &stretch.iter().filter_map(place).collect::<Vec<_>>())?;
            }
            let lacking = series.points.iter().filter(|p| series.lacks_bound(**p));
            let at: Vec<_> = lacking.filter_map(|p| Some(pixel(x.place(p.0)?, y.top?))).collect();
            // Offset the arrows so that none hides another.
            at.iter().try_for_each(|(cx, cy)| draw_arrow(&area, series.color, (cx + 12 * without_bound, *cy)))?;
            without_bound += i32::from(!at.is_empty());
        }
        self.draw_labels(&area, place)?;
        self.draw_legend(&legend)?;
        area.present()?;
        Ok(())
    }

    /// Draws the labels of points beside their marks. `place` is the pixel of a point.
    fn draw_labels(&self, area: &Area<'_>, place: impl Fn(&(f64, f64)) -> Option<(i32, i32)>) -> Drawn<()> {
        let mut drawn: Vec<(&str, (i32, i32))> = Vec::new();
        let mut taken: Vec<Rect> =
            self.series.iter().flat_map(|s| &s.points).filter_map(&place).map(Rect::of_mark).collect();
        for series in &self.series {
            for (point, label) in series.points.iter().zip(&series.labels).filter(|(_, label)| !label.is_empty()) {
                let Some(at) = place(point) else { continue };
                // Nearby marks with the same label share one.
                if drawn.iter().any(|(other, by)| other == label && at.0.abs_diff(by.0).max(at.1.abs_diff(by.1)) < 10) {
                    continue;
                }
                drawn.push((label, at));
                let room = Rect::beside(at, label, &taken);
                let style = ("sans-serif", TEXT[2]).into_font().color(&INK);
                area.draw(&Text::new(label.clone(), (room.left, room.top), style))?;
                taken.push(room);
            }
        }
        Ok(())
    }

    fn draw_legend(&self, legend: &Area<'_>) -> Drawn<()> {
        for (i, series) in self.series.iter().filter(|s| !s.name.is_empty()).enumerate() {
            let y = 20 + 24 * i as i32;
            let ends = match series.style {
                Style::Points | Style::Front => vec![(22, y)],
                _ => vec![(10, y), (34, y)],
            };
            draw_series(legend, series, &ends)?;
            let name: String = series.name.chars().take(LONGEST_NAME).collect();
            legend.draw(&Text::new(name, (44, y - 9), ("sans-serif", TEXT[1]).into_font().color(&INK)))?;
        }
        Ok(())
    }
}

impl Series {
    /// Returns true if the series is a bound that is infinite at this point.
    fn lacks_bound(&self, (x, y): (f64, f64)) -> bool {
        self.style == Style::Bound && x.is_finite() && y == f64::INFINITY
    }
}

type Area<'a> = DrawingArea<SVGBackend<'a>, plotters::coord::Shift>;

/// Draws an upward arrow for an infinite bound.
fn draw_arrow(area: &Area<'_>, index: usize, (x, y): (i32, i32)) -> Drawn<()> {
    let corners = vec![(x - 5, y + 4), (x, y - 6), (x + 5, y + 4), (x - 5, y + 4)];
    area.draw(&PathElement::new(corners, color(index).stroke_width(2)))?;
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

/// Draws marks. Series differ by the shape and the colour of their marks.
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

/// Splits a path into dashes of 7 pixels with gaps of 5.
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

/// Replaces placeholder colours by CSS. Each element has only one of them, so it gets one `style` attribute.
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

    /// The line has two parts, with an arrow at the top between them.
    #[test]
    fn lines_break_where_there_is_no_bound() {
        let points = vec![(1e-3, 1e-5), (1e-2, 1e-4), (1e-1, f64::INFINITY), (1.0, 1e-6), (10.0, 1e-5)];
        let drawn = |style, points: Vec<(f64, f64)>| {
            let series = vec![Series { points, style, ..Series::default() }];
            Chart { x_log: true, y_log: true, series, ..Chart::default() }.svg().unwrap()
        };
        // Dashes and arrows are polylines in the series' colour.
        let lines = |svg: &str| {
            let all = svg.split("<polyline").skip(1).filter(|line| line.contains("var(--s0,"));
            all.map(|line| line.split("points=\"").nth(1).unwrap().split('"').next().unwrap().to_owned()).collect()
        };
        let ends = |line: &str| {
            let mut x = line.split_whitespace().map(|p| p.split(',').next().unwrap().parse::<i32>().unwrap());
            let first = x.next().unwrap();
            (first, x.next_back().unwrap())
        };
        let svg = drawn(Style::LinePoints, points.clone());
        let whole: Vec<String> = lines(&svg);
        let [a, b] = whole.as_slice() else { panic!("{whole:?}") };
        assert!(ends(a).1 < ends(b).0 && !svg.contains("no bound"), "{whole:?}");
        let svg = drawn(Style::Bound, points.clone());
        let dashes: Vec<String> = lines(&svg);
        let inside = |l: &&String| ends(l).0 > ends(a).1 + 1 && ends(l).1 < ends(b).0 - 1;
        assert_eq!(dashes.iter().filter(inside).count(), 1, "the arrow alone: {dashes:?}");
        assert!(svg.contains("no bound"));
        let finite: Vec<(f64, f64)> = points.into_iter().filter(|p| p.1.is_finite()).collect();
        assert!(!drawn(Style::Bound, finite).contains("no bound"));
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
