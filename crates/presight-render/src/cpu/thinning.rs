//! The second estimate (paper section 3.3). After the setup of the first wave, the boxes of pixels that its polygons
//! may cover are known. If drawing them takes longer than the time left, every k-th column and row may give more
//! samples than all samples up to the point where drawing stops. Later waves are predicted by the costs learnt for
//! whole frames.

use super::batch::{Batch, PolygonSetup};
use crate::plan::{Pace, Run};
use presight_model::sensor::{PixelGrid, STRIDES};
use std::ops::Range;

/// A frame after the setup of its first wave.
pub(super) struct Frame<'a> {
    pub batches: &'a [Batch],
    /// The runs that follow, nearest first, and the seconds that they should take; 0 if unknown.
    pub later: &'a [Run],
    pub rest: f64,
    /// Lower bound of the distance of the polygons that follow, metres.
    pub beyond: f32,
    /// Radius to which the image is complete when all polygons are drawn, metres.
    pub radius: f32,
    pub grid: &'a PixelGrid,
    pub pace: &'a Pace,
    /// Seconds left for drawing.
    pub left: f64,
    /// Seconds that the setup took, and would take again.
    pub set_up: f64,
}

/// Cells along each side of the image, in which coverage is counted.
const CELLS: usize = 24;

/// A polygon's image: its pixels, the cells that it touches, and the distance of its middle, metres.
struct Seen {
    pixels: u64,
    lines: Range<usize>,
    samples: Range<usize>,
    range: f64,
}

/// Pixels of the box around a polygon's image.
pub(super) fn pixels(polygon: &PolygonSetup) -> u64 {
    u64::from(polygon.end_line - polygon.first_line) * u64::from(polygon.end_sample - polygon.first_sample)
}

/// Seconds for drawing a number of polygons with this number of pixels in the boxes around them.
pub(super) fn seconds(pace: &Pace, polygons: u64, pixels: u64, stride: u32) -> f64 {
    let pixels = pixels as f64 / f64::from(stride * stride);
    pace.wave + pace.polygon * polygons as f64 + pace.sample * pixels
}

/// The stride with the largest expected number of samples in time; the smallest if several have it.
pub(super) fn stride(frame: &Frame<'_>) -> u32 {
    let seen: Vec<Vec<Seen>> = frame.batches.iter().map(|batch| seen(batch, frame.grid)).collect();
    let mut best = (expected(frame, &seen, 1), 1);
    for stride in STRIDES {
        let samples = expected(frame, &seen, stride);
        if samples > best.0 {
            best = (samples, stride);
        }
    }
    best.1
}

/// Lines and samples of an image.
fn size(grid: &PixelGrid) -> [usize; 2] {
    match grid {
        PixelGrid::Lines(grid) => [grid.lines().len(), grid.weights().len()],
        PixelGrid::Rays(grid) => [grid.height() as usize, grid.width() as usize],
    }
}

fn seen(batch: &Batch, grid: &PixelGrid) -> Vec<Seen> {
    let [lines, samples] = size(grid);
    let of_polygon = |polygon: &PolygonSetup| {
        let line = polygon.first_line.midpoint(polygon.end_line - 1);
        let sample = polygon.first_sample.midpoint(polygon.end_sample - 1);
        let (ray, length) = match grid {
            PixelGrid::Lines(grid) => {
                let ray = grid.line_ray(line as usize, sample as usize);
                (ray, (grid.image_from_line() * ray).length())
            }
            PixelGrid::Rays(grid) => (grid.direction(sample, line), 1.0),
        };
        let inverse = polygon.m.dot(ray);
        let range = if inverse > 0.0 { length / inverse } else { f64::INFINITY };
        // Cells whose middle is in the box, at least one.
        let cells = |first: u32, end: u32, of: usize| {
            let cell = |at: u32| (at as usize * CELLS + of / 2) / of;
            let first = cell(first).min(CELLS - 1);
            first..cell(end).max(first + 1)
        };
        Seen {
            pixels: pixels(polygon),
            lines: cells(polygon.first_line, polygon.end_line, lines),
            samples: cells(polygon.first_sample, polygon.end_sample, samples),
            range,
        }
    };
    batch.polygons.iter().filter(|polygon| pixels(polygon) > 0).map(of_polygon).collect()
}

/// Expected number of final samples when the time is up: all samples if all polygons are drawn by then, otherwise those
/// whose cell shows a polygon nearer than every polygon left out.
fn expected(frame: &Frame<'_>, seen: &[Vec<Seen>], stride: u32) -> f64 {
    let left = frame.left + frame.pace.saved(stride) - if stride > 1 { frame.set_up } else { 0.0 };
    let (mut polygons, mut pixels, mut drawn, mut took) = (0, 0, 0, 0.0);
    for batch in seen {
        polygons += batch.len() as u64;
        pixels += batch.iter().map(|polygon| polygon.pixels).sum::<u64>();
        let with_it = seconds(frame.pace, polygons, pixels, stride);
        if with_it > left {
            break;
        }
        (drawn, took) = (drawn + 1, with_it);
    }
    let complete_to = frame.batches.get(drawn).map_or_else(|| frame.reached(left - took), |batch| batch.nearest);
    let share = if complete_to < f32::INFINITY { nearer(&seen[..drawn], f64::from(complete_to)) } else { 1.0 };
    let [lines, samples] = size(frame.grid);
    share * (lines * samples) as f64 / f64::from(stride * stride)
}

/// The share of the cells that show a polygon nearer than a distance.
fn nearer(seen: &[Vec<Seen>], metres: f64) -> f64 {
    let mut near = [[false; CELLS]; CELLS];
    for polygon in seen.iter().flatten().filter(|polygon| polygon.range < metres) {
        near[polygon.lines.clone()].iter_mut().for_each(|line| line[polygon.samples.clone()].fill(true));
    }
    near.iter().flatten().filter(|near| **near).count() as f64 / (CELLS * CELLS) as f64
}

impl Frame<'_> {
    /// Radius to which the image is complete after some seconds of drawing the later runs, metres.
    fn reached(&self, seconds: f64) -> f32 {
        if self.later.is_empty() || self.rest <= 0.0 {
            return self.beyond;
        }
        let polygons = self.later.iter().map(|run| f64::from(run.count)).sum::<f64>();
        let mut in_time = polygons * seconds / self.rest;
        let first_left_out = self.later.iter().find(|run| {
            in_time -= f64::from(run.count);
            in_time < 0.0
        });
        first_left_out.map_or(self.radius, |run| run.nearest)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DVec3;
    use presight_model::sensor::{Camera, Geometry, Sensor, SensorSpec};

    /// A batch of one polygon over a quarter of the image, 76,800 pixels, on a plane `depth` metres ahead.
    fn batch(nearest: f32, depth: f64) -> Batch {
        let polygon = PolygonSetup {
            m: DVec3::Y / depth,
            nearest_inverse: f64::INFINITY,
            first_line: 240,
            end_line: 480,
            first_sample: 320,
            end_sample: 640,
            first_edge: 0,
            lower: 0,
            upper: 0,
            steep: 0,
        };
        let mut batch = Batch::default();
        batch.polygons.push(polygon);
        batch.nearest = nearest;
        batch
    }

    /// By hand: 10 ms for each batch, and 12 ms left. All pixels: the first batch alone; samples at 5 m are final only
    /// if the second batch begins farther away. Every second column and row: both batches in 5 ms, a quarter of 76,800
    /// samples.
    #[test]
    fn thinning_is_weighed_against_stopping() {
        let camera = Camera::pinhole(640, 480, 5000.0, 5000.0, 349.5, 249.5);
        let sensor = Sensor::new(SensorSpec::new("camera", "video", Geometry::Camera(camera))).unwrap();
        let pace = Pace { sample: 1e-2 / 76_800.0, ..Pace::default() };
        let grid = sensor.grid();
        fn of<'a>(batches: &'a [Batch], grid: &'a PixelGrid, pace: &'a Pace, left: f64, set_up: f64) -> Frame<'a> {
            let (later, rest, beyond, radius) = (&[][..], 0.0, 10.0, f32::INFINITY);
            Frame { batches, later, rest, beyond, radius, grid, pace, left, set_up }
        }
        let decide = |frame: &Frame<'_>| {
            let seen: Vec<_> = frame.batches.iter().map(|batch| seen(batch, grid)).collect();
            (stride(frame), expected(frame, &seen, 1))
        };
        let made = |batches: &[Batch], left: f64, set_up: f64| decide(&of(batches, grid, &pace, left, set_up));
        let (near, far) = ([batch(0.5, 5.0), batch(1.0, 6.0)], [batch(0.5, 5.0), batch(5.5, 6.0)]);
        assert_eq!(made(&near, 12e-3, 0.0), (2, 0.0));
        assert_eq!(made(&far, 12e-3, 0.0), (1, 76_800.0));
        // Too little time even for every second column, which would have to be set up again.
        assert_eq!(made(&near, 12e-3, 8e-3).0, 4);
        // Every stride is too slow, so thinning has no advantage.
        assert_eq!(made(&near, 1e-5, 0.0).0, 1);
        assert_eq!(made(&near, 21e-3, 0.0), (1, 76_800.0));
        // The only time left is what thinned images save: 6 ms, enough for both batches in 5 ms.
        let saving = Pace { saved: [6e-3; 3], ..pace };
        assert_eq!(stride(&of(&near, grid, &saving, 0.0, 0.0)), 2);
        // 100 runs follow from 10 m on, 0.1 m apart, and take 10 ms. After 25 ms half of them are drawn, up to 15 m,
        // and no sample at 30 m is final. Every second column and row takes 5 ms and these 10: a quarter of all
        // samples.
        let run = |i| Run { instance: 0, first: 0, count: 10, nearest: 10.0 + 0.1 * i as f32 };
        let later: Vec<Run> = (0..100).map(run).collect();
        let (near, far) = ([batch(0.5, 5.0), batch(1.0, 6.0)], [batch(0.5, 30.0), batch(1.0, 30.0)]);
        let whole = |batches: &[Batch], left: f64| {
            decide(&Frame { later: &later, rest: 10e-3, ..of(batches, grid, &pace, left, 0.0) })
        };
        assert_eq!(whole(&far, 25e-3), (2, 0.0));
        // Samples at 5 m are all final, as many as with thinning. If all polygons are drawn in time, all samples are
        // final.
        assert_eq!(whole(&near, 25e-3), (1, 76_800.0));
        assert_eq!(whole(&far, 31e-3), (1, 307_200.0));
        let frame = Frame { later: &later, rest: 10e-3, ..of(&far, grid, &pace, 25e-3, 0.0) };
        assert!((frame.reached(5e-3) - 15.0).abs() < 0.11);
    }
}
