//! Finds the pixels that a convex patch covers, line by line.

use super::strategy::FeatureQuery;
use crate::columns;
use crate::sample::PatchCone;
use glam::{DVec2, DVec3};
use presight_model::sensor::{LineAxis, LineGrid, PixelGrid};
use std::ops::Range;

/// Neighbouring pixels of one line that a patch covers.
#[derive(Clone, Debug)]
pub(super) struct Span {
    pub line: u32,
    pub samples: Range<u32>,
    /// Columns to add to get the place in the unwrapped image.
    pub turned: f64,
}

/// The pixels that a patch covers.
pub(super) fn of_patch(query: &FeatureQuery<'_>, cone: &PatchCone) -> Vec<Span> {
    match query.frame.sensor.grid() {
        PixelGrid::Lines(grid) => of_lines(grid, query, cone),
        PixelGrid::Rays(_) => of_rays(query, cone),
    }
}

fn of_lines(grid: &LineGrid, query: &FeatureQuery<'_>, cone: &PatchCone) -> Vec<Span> {
    let mut spans = Vec::new();
    let line_vector = grid.image_from_line().transpose();
    let edges: Vec<DVec3> = cone.edges.iter().map(|e| line_vector * *e).collect();
    let samples = grid.weights().len();
    for (lines, turned) in lines_of(grid, query) {
        for line in lines {
            let [c0, c1] = grid.lines()[line];
            let (mut first, mut end) = (0, samples);
            for e in &edges {
                // A + B t >= 0 on the line.
                let (a, b) = (e.x * c0 + e.y * c1, e.z);
                if b > 0.0 {
                    first = first.max(grid.samples_below(-a / b));
                } else if b < 0.0 {
                    end = end.min(grid.samples_up_to(-a / b));
                } else if a < 0.0 {
                    end = 0;
                }
            }
            if first < end {
                spans.push(Span { line: line as u32, samples: first as u32..end as u32, turned });
            }
        }
    }
    spans
}

/// The lines that may see a patch, each range with the columns to add in the unwrapped image.
fn lines_of(grid: &LineGrid, query: &FeatureQuery<'_>) -> Vec<(Range<usize>, f64)> {
    let (sensor, points) = (query.frame.sensor, query.points);
    let count = grid.lines().len();
    let whole = 0..count;
    let between = |low: f64, high: f64| {
        // One more line on either side, for rounding.
        let bound = |x: f64| x.clamp(0.0, count as f64) as usize;
        bound(low.floor())..bound(high.ceil() + 1.0)
    };
    match grid.axis() {
        LineAxis::Rows => {
            if points.iter().all(|p| p.z <= 0.0) {
                return Vec::new();
            }
            // Corners in front of the camera have the extreme rows.
            let rows = points.iter().map(|p| if p.z > 0.0 { sensor.project(*p).map(|(_, row)| row) } else { None });
            let rows: Option<Vec<f64>> = rows.collect();
            let extremes = |rows: Vec<f64>| {
                let low = rows.iter().copied().fold(f64::INFINITY, f64::min);
                between(low, rows.into_iter().fold(f64::NEG_INFINITY, f64::max))
            };
            vec![(rows.map_or(whole, extremes), 0.0)]
        }
        LineAxis::Columns => {
            let (Some([low, high]), Some(turn)) = (columns::of_corners(sensor, points), columns::turn(sensor)) else {
                return vec![(whole, 0.0)];
            };
            // A column that comes twice counts once. Columns continue only over a seam.
            let count = sensor.distinct_columns() as usize;
            let between = |low: f64, high: f64| {
                let lines = between(low, high);
                lines.start.min(count)..lines.end.min(count)
            };
            let turns = (-1..).map(|k| turn * f64::from(k)).take_while(|by| low + by <= count as f64);
            let goes_on = query.frame.sampler.turn().is_some();
            let lines = turns.map(|by| (between(low + by, high + by), if goes_on { -by } else { 0.0 }));
            lines.filter(|(lines, _)| !lines.is_empty()).collect()
        }
    }
}

fn of_rays(query: &FeatureQuery<'_>, cone: &PatchCone) -> Vec<Span> {
    let sensor = query.frame.sensor;
    let mut spans = Vec::new();
    let Some([low, high]) = query.frame.sampler.patch_bounds(query.points, cone) else { return spans };
    let [first, end] = [low.round().max(DVec2::ZERO), (high.round() + 1.0).max(DVec2::ZERO)];
    for row in first.y as u32..(end.y as u32).min(sensor.height()) {
        let mut begun: Option<u32> = None;
        let columns = first.x as u32..(end.x as u32).min(sensor.width());
        for column in columns.clone() {
            let inside = |ray: DVec3| cone.inverse().dot(ray) > 0.0 && cone.edges.iter().all(|e| e.dot(ray) >= 0.0);
            match (sensor.ray(column, row).is_some_and(inside), begun) {
                (true, None) => begun = Some(column),
                (false, Some(from)) => {
                    spans.push(Span { line: row, samples: from..column, turned: 0.0 });
                    begun = None;
                }
                _ => {}
            }
        }
        if let Some(from) = begun {
            spans.push(Span { line: row, samples: from..columns.end, turned: 0.0 });
        }
    }
    spans
}
