//! Radar lines: the intersections of surfaces with the scan plane, as line segments.
//!
//! Neighbouring beams that hit the same polygon form one straight line. Polygons whose lines continue each other within
//! [`COPLANAR`] also form one line. A segment ends at the hits of its first and last beam, so it may be up to one beam
//! shorter than the surface. A single beam forms no segment and is only counted.

use super::pixels::{COPLANAR, PARALLEL, Pixels, VisiblePlane};
use super::{View, scan_row};
use glam::DVec3;
use presight_model::error::Result;
use presight_model::sensor::Geometry;
use serde::Serialize;

/// Line segments in the scan plane.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct RadarLines {
    /// The lines in the order of the beams.
    pub lines: Vec<RadarLine>,
    /// Number of beams that hit a surface which neither neighbour hits.
    pub single_beams: usize,
}

/// A line segment hit by consecutive beams.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct RadarLine {
    /// The hits of the first and the last beam, metres, exactly on the polygons.
    pub ends_robot: [[f64; 3]; 2],
    /// Length, metres.
    pub length: f64,
    /// Unit normal in the scan plane, on the sensor's side.
    pub normal_robot: [f64; 3],
    /// Metres from the sensor to the line, along the normal.
    pub distance: f64,
    /// First and last column. Across the seam of a full circle, the first is larger than the last.
    pub columns: [u32; 2],
    /// Number of beams.
    pub beams: u32,
    /// The polygons as numbered in `polygon_id`, in the order of the beams.
    pub polygons: Vec<u32>,
    /// The objects of these polygons, without duplicates.
    pub objects: Vec<String>,
}

impl RadarLines {
    pub(super) fn summary(&self) -> String {
        let total = self.lines.iter().map(|l| l.length).sum::<f64>() + 0.0;
        format!("{} line segments of {total:.3} m together, {} single beams", self.lines.len(), self.single_beams)
    }
}

/// Consecutive beams on one line, in the sensor's body axes.
struct Run {
    columns: [u32; 2],
    beams: u32,
    ends: [DVec3; 2],
    /// Normal in the scan plane.
    normal: DVec3,
    polygons: Vec<u32>,
    objects: Vec<u32>,
}

impl Run {
    /// Returns true if `next` continues this line.
    fn goes_on(&self, next: &Run) -> bool {
        let off = |of: &Run, p: DVec3| (p - of.ends[0]).dot(of.normal).abs();
        self.normal.dot(next.normal) >= PARALLEL
            && next.ends.into_iter().all(|p| off(self, p) <= COPLANAR)
            && self.ends.into_iter().all(|p| off(next, p) <= COPLANAR)
    }

    fn take(&mut self, next: Run) {
        (self.columns[1], self.ends[1]) = (next.columns[1], next.ends[1]);
        self.beams += next.beams;
        self.polygons.extend(next.polygons.into_iter().filter(|p| self.polygons.last() != Some(p)).collect::<Vec<_>>());
        for object in next.objects {
            if !self.objects.contains(&object) {
                self.objects.push(object);
            }
        }
    }
}

pub(super) fn reduce(view: &View<'_>) -> Result<RadarLines> {
    let mut pixels = Pixels::with_ids(view)?;
    let row = match &pixels.sensor.spec().geometry {
        Geometry::Scanner(scanner) => scan_row(scanner).unwrap_or(0),
        _ => 0,
    };
    let mut runs: Vec<Run> = Vec::new();
    let mut gap = true;
    for column in 0..pixels.sensor.distinct_columns() {
        let run = pixels.surface(column, row).and_then(|surface| beam(&pixels, column, row, &surface));
        let Some(run) = run else {
            gap = true;
            continue;
        };
        match runs.last_mut().filter(|last| !gap && last.goes_on(&run)) {
            Some(last) => last.take(run),
            None => runs.push(run),
        }
        gap = false;
    }
    close_circle(&mut runs, &pixels);
    let single_beams = runs.iter().filter(|r| r.beams < 2).count();
    let lines = runs.into_iter().filter(|r| r.beams > 1).map(|run| line(run, &pixels)).collect();
    Ok(RadarLines { lines, single_beams })
}

/// Makes a run of one beam; `None` for a surface parallel to the scan plane.
fn beam(pixels: &Pixels<'_>, column: u32, row: u32, surface: &VisiblePlane) -> Option<Run> {
    let at = pixels.hit(column, row, surface)?;
    let normal = DVec3::new(surface.normal.x, surface.normal.y, 0.0).try_normalize()?;
    let polygon = pixels.polygon_id[pixels.at(column, row)];
    Some(Run {
        columns: [column; 2],
        beams: 1,
        ends: [at; 2],
        normal,
        polygons: vec![polygon],
        objects: vec![surface.object],
    })
}

/// Joins the last run with the first if the scan covers a full circle.
fn close_circle(runs: &mut Vec<Run>, pixels: &Pixels<'_>) {
    let distinct = pixels.sensor.distinct_columns();
    let whole = pixels.sensor.columns_of_a_turn().is_some_and(|turn| (turn - f64::from(distinct)).abs() < 1e-6);
    let last_column = distinct - 1;
    let meets = whole
        && runs.len() > 1
        && runs[0].columns[0] == 0
        && runs.last().is_some_and(|last| last.columns[1] == last_column && last.goes_on(&runs[0]));
    if meets && let Some(mut last) = runs.pop() {
        last.take(runs.remove(0));
        runs.push(last);
    }
}

fn line(run: Run, pixels: &Pixels<'_>) -> RadarLine {
    RadarLine {
        ends_robot: run.ends.map(|p| pixels.in_robot(p)),
        length: run.ends[0].distance(run.ends[1]),
        normal_robot: pixels.turned_to_robot(run.normal),
        distance: -run.ends[0].dot(run.normal),
        columns: run.columns,
        beams: run.beams,
        polygons: run.polygons,
        objects: run.objects.into_iter().map(|object| pixels.name(object)).collect(),
    }
}
