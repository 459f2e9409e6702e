//! Plots as SVG.

use super::index_study::Row;
use crate::error::{Error, ErrorKind, Result};
use crate::index::Scheme;
use plotters::prelude::*;

/// One value of a row.
type Value = fn(&Row) -> Option<f64>;

/// Title, value, and whether its axis is logarithmic.
const PANELS: [(&str, Value, bool); 3] = [
    ("access time, us (log)", |r| Some(r.access_us), true),
    ("selectivity: needed / returned", |r| Some(r.selectivity), false),
    ("whole prediction, ms (log)", |r| r.prediction_ms, true),
];

/// Okabe and Ito's colours, told apart by everybody.
const COLORS: [RGBColor; 6] = [
    RGBColor(120, 120, 120),
    RGBColor(230, 159, 0),
    RGBColor(86, 180, 233),
    RGBColor(0, 158, 115),
    RGBColor(213, 94, 0),
    RGBColor(0, 114, 178),
];

/// Three panels of bars: for every query a bar each scheme.
pub(super) fn index_study(rows: &[Row], title: &str) -> Result<String> {
    let mut svg = String::new();
    draw(rows, title, &mut svg).map_err(|e| Error::new(ErrorKind::Invalid, format!("cannot plot: {e}"), ""))?;
    Ok(svg)
}

fn draw(rows: &[Row], title: &str, svg: &mut String) -> std::result::Result<(), Box<dyn std::error::Error>> {
    let area = SVGBackend::with_string(svg, (1200, 1080)).into_drawing_area();
    area.fill(&WHITE)?;
    let area = area.titled(title, ("sans-serif", 22))?;
    let (legend, area) = area.split_vertically(34);
    let schemes: Vec<Scheme> = Scheme::ALL.into_iter().filter(|s| rows.iter().any(|r| r.scheme == *s)).collect();
    for (i, scheme) in schemes.iter().enumerate() {
        let x = 60 + 150 * i as i32;
        legend.draw(&Rectangle::new([(x, 6), (x + 18, 24)], color(*scheme).filled()))?;
        legend.draw(&Text::new(scheme.name(), (x + 26, 8), ("sans-serif", 18)))?;
    }
    let mut queries: Vec<&str> = Vec::new();
    for row in rows {
        if !queries.contains(&row.query.as_str()) {
            queries.push(&row.query);
        }
    }
    for ((name, value, log), panel) in PANELS.into_iter().zip(area.split_evenly((3, 1))) {
        let values: Vec<f64> = rows.iter().filter_map(value).filter(|v| v.is_finite() && *v > 0.0).collect();
        let greatest = values.iter().copied().fold(0.0, f64::max).max(1e-9);
        let least = values.iter().copied().fold(f64::INFINITY, f64::min).min(greatest);
        let (low, high) = if log { (least * 0.5, greatest * 1.5) } else { (0.0, 1.0) };
        let scale = move |v: f64| if log { (v.max(low) / low).ln() / (high / low).ln() } else { v / high };
        let mut chart = ChartBuilder::on(&panel)
            .caption(name, ("sans-serif", 18))
            .margin(10)
            .x_label_area_size(30)
            .y_label_area_size(70)
            .build_cartesian_2d(0.0..queries.len() as f64, 0.0..1.0f64)?;
        let label = |y: &f64| {
            let v = if log { low * (y * (high / low).ln()).exp() } else { y * high };
            format!("{v:.*}", if v < 1.0 { 2 } else { usize::from(v < 100.0) })
        };
        chart
            .configure_mesh()
            .disable_x_mesh()
            .disable_x_axis()
            .max_light_lines(0)
            .y_labels(6)
            .y_label_formatter(&label)
            .draw()?;
        for (q, query) in queries.iter().enumerate() {
            for (s, scheme) in schemes.iter().enumerate() {
                let Some(row) = rows.iter().find(|r| r.query == *query && r.scheme == *scheme) else { continue };
                let Some(v) = value(row) else { continue };
                let wide = 0.84 / schemes.len() as f64;
                let x = q as f64 + 0.08 + wide * s as f64;
                let bar = [(x, 0.0), (x + 0.9 * wide, scale(v).clamp(0.0, 1.0))];
                chart.draw_series([Rectangle::new(bar, color(*scheme).filled())])?;
            }
            // Neighbours' names keep out of each other's way.
            let (x, y) = chart.backend_coord(&(q as f64 + 0.08, 0.0));
            let (left, top) = panel.get_base_pixel();
            panel.draw(&Text::new(
                (*query).to_owned(),
                (x - left, y - top + 6 + 13 * (q % 2) as i32),
                ("sans-serif", 13),
            ))?;
        }
    }
    area.present()?;
    Ok(())
}

fn color(scheme: Scheme) -> RGBColor {
    COLORS[Scheme::ALL.iter().position(|s| *s == scheme).unwrap_or(0)]
}
