//! The second estimate (paper section 3.3): after the setup of the first wave it is known which boxes of pixels its polygons may
//! cover. If they take longer than there is time, more samples may come of every k-th column and row than of all of them up to where
//! the drawing stops.

use super::batch::{Batch, PolygonSetup};
use crate::plan::Pace;
use crate::sensor::{PixelGrid, STRIDES};

/// A frame after the setup of its first wave.
pub(super) struct Frame<'a> {
    pub batches: &'a [Batch],
    /// Metres: nothing that follows is nearer.
    pub beyond: f32,
    pub grid: &'a PixelGrid,
    pub pace: &'a Pace,
    /// Seconds left for drawing.
    pub left: f64,
    /// Seconds that the setup took, and would take again.
    pub set_up: f64,
}

/// Pixels of the box around a polygon's image.
pub(super) fn pixels(polygon: &PolygonSetup) -> u64 {
    u64::from(polygon.end_line - polygon.first_line) * u64::from(polygon.end_sample - polygon.first_sample)
}

/// Seconds for drawing polygons with so many pixels in the boxes around them.
pub(super) fn seconds(pace: &Pace, polygons: u64, pixels: u64, stride: u32) -> f64 {
    let pixels = pixels as f64 / f64::from(stride * stride);
    pace.wave + pace.polygon * polygons as f64 + pace.sample * pixels
}

/// The stride of which most samples are to be expected in time; the least of those that are as good.
pub(super) fn stride(frame: &Frame<'_>) -> u32 {
    let ranges: Vec<Vec<(u64, f64)>> = frame.batches.iter().map(|batch| ranges(batch, frame.grid)).collect();
    let mut best = (expected(frame, &ranges, 1), 1);
    for stride in STRIDES {
        let samples = expected(frame, &ranges, stride);
        if samples > best.0 {
            best = (samples, stride);
        }
    }
    best.1
}

/// Pixels of the boxes of polygons, and the distance in the middle of each, metres.
fn ranges(batch: &Batch, grid: &PixelGrid) -> Vec<(u64, f64)> {
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
        (pixels(polygon), if inverse > 0.0 { length / inverse } else { f64::INFINITY })
    };
    batch.polygons.iter().filter(|polygon| pixels(polygon) > 0).map(of_polygon).collect()
}

/// About how many samples are final when the time is up: those in the middle of boxes that are nearer than the first batch that is
/// not drawn by then.
fn expected(frame: &Frame<'_>, ranges: &[Vec<(u64, f64)>], stride: u32) -> f64 {
    let left = frame.left + frame.pace.saved(stride) - if stride > 1 { frame.set_up } else { 0.0 };
    let (mut polygons, mut pixels, mut drawn) = (0, 0, 0);
    for batch in ranges {
        polygons += batch.len() as u64;
        pixels += batch.iter().map(|(pixels, _)| pixels).sum::<u64>();
        if seconds(frame.pace, polygons, pixels, stride) > left {
            break;
        }
        drawn += 1;
    }
    let complete_to = f64::from(frame.batches.get(drawn).map_or(frame.beyond, |batch| batch.nearest));
    let near = ranges[..drawn].iter().flatten().filter(|(_, range)| *range < complete_to);
    near.map(|(pixels, _)| *pixels as f64).sum::<f64>() / f64::from(stride * stride)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sensor::{Camera, Geometry, Sensor, SensorSpec};
    use glam::DVec3;

    /// A batch of one polygon over 100 x 100 pixels of a plane so many metres ahead.
    fn batch(nearest: f32, depth: f64) -> Batch {
        let polygon = PolygonSetup {
            m: DVec3::Y / depth,
            first_line: 200,
            end_line: 300,
            first_sample: 300,
            end_sample: 400,
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

    /// By hand: 10 ms for each batch, and 12 ms left. All pixels: the first batch alone; what is seen at 5 m is final only if the second
    /// one begins farther away. Every second column and row: both batches in 5 ms, a quarter of 20,000 samples.
    #[test]
    fn thinning_is_weighed_against_stopping() {
        let camera = Camera::pinhole(640, 480, 500.0, 500.0, 349.5, 249.5);
        let sensor = Sensor::new(SensorSpec::new("camera", "video", Geometry::Camera(camera))).unwrap();
        let pace = Pace { wave: 0.0, polygon: 0.0, sample: 1e-6, images: 0.0 };
        let of = |batches: &[Batch], left: f64, set_up: f64| {
            let frame = Frame { batches, beyond: 10.0, grid: sensor.grid(), pace: &pace, left, set_up };
            let ranges: Vec<_> = batches.iter().map(|batch| ranges(batch, sensor.grid())).collect();
            (stride(&frame), expected(&frame, &ranges, 1))
        };
        let (near, far) = ([batch(0.5, 5.0), batch(1.0, 6.0)], [batch(0.5, 5.0), batch(5.5, 6.0)]);
        assert_eq!(of(&near, 12e-3, 0.0), (2, 0.0));
        assert_eq!(of(&far, 12e-3, 0.0), (1, 1e4));
        // No time even for every second one, which would have to be set up again.
        assert_eq!(of(&near, 12e-3, 8e-3).0, 4);
        // Nothing fits: nothing is gained.
        assert_eq!(of(&near, 1e-5, 0.0).0, 1);
        assert_eq!(of(&near, 21e-3, 0.0), (1, 2e4));
        // No time is left but what thinned images save: 16 ms by half of three quarters, enough for both batches in 5 ms.
        let pace = Pace { images: 16e-3, ..pace };
        let frame = Frame { batches: &near, beyond: 10.0, grid: sensor.grid(), pace: &pace, left: 0.0, set_up: 0.0 };
        assert_eq!(stride(&frame), 2);
    }
}
