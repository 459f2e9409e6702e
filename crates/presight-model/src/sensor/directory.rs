//! Finds the approximate pixel of a direction in a ray table, fast enough to do it for every measured point.

use super::RayGrid;
use glam::{DVec2, DVec3};

/// Pixels by direction. An octahedral map turns the sphere into square cells; each holds a pixel near its middle.
#[derive(Debug)]
pub(crate) struct Directory {
    side: usize,
    pixels: Vec<u32>,
}

const NONE: u32 = u32::MAX;

impl Directory {
    pub(super) fn of(table: &RayGrid) -> Self {
        let (width, height) = (table.width(), table.height());
        let rays = (0..width * height).map(|i| (i, table.direction(i % width, i / width))).filter(|(_, d)| !d.is_nan());
        let side = (2.0 * f64::from(width * height).sqrt()).ceil().clamp(1.0, 4096.0) as usize;
        let mut pixels = vec![NONE; side * side];
        let mut ends = Vec::new();
        for (i, ray) in rays {
            let at = cell(ray, side);
            if pixels[at] == NONE {
                ends.push(at);
            }
            pixels[at] = i;
        }
        // Cells without a ray inherit a neighbour's pixel, ring by ring.
        while !ends.is_empty() {
            let mut next = Vec::new();
            for at in ends {
                let (x, y) = (at % side, at / side);
                let beside = [(x > 0, at.wrapping_sub(1)), (x + 1 < side, at + 1)];
                let above = [(y > 0, at.wrapping_sub(side)), (y + 1 < side, at + side)];
                for (_, to) in beside.into_iter().chain(above).filter(|(there, _)| *there) {
                    if pixels[to] == NONE {
                        pixels[to] = pixels[at];
                        next.push(to);
                    }
                }
            }
            ends = next;
        }
        Self { side, pixels }
    }

    /// A pixel whose ray is nearer to a direction than its neighbours' rays are. `None` only for a table without rays.
    pub(super) fn near(&self, table: &RayGrid, direction: DVec3) -> Option<(u32, u32)> {
        let first = self.pixels[cell(direction, self.side)];
        if first == NONE {
            return None;
        }
        let (width, height) = (i64::from(table.width()), i64::from(table.height()));
        let (mut column, mut row) = (i64::from(first) % width, i64::from(first) / width);
        let apart = |c: i64, r: i64| table.direction(c as u32, r as u32).distance_squared(direction);
        let mut best = apart(column, row);
        loop {
            let (c, r) = (column, row);
            for (dc, dr) in [(-1, 0), (1, 0), (0, -1), (0, 1)] {
                let (c, r) = (c + dc, r + dr);
                if (0..width).contains(&c) && (0..height).contains(&r) && apart(c, r) < best {
                    (best, column, row) = (apart(c, r), c, r);
                }
            }
            if (c, r) == (column, row) {
                return Some((column as u32, row as u32));
            }
        }
    }
}

/// The cell of a direction, by the octahedral map (Z. H. Cigolle et al., A Survey of Efficient Representations for
/// Independent Unit Vectors, 2014).
fn cell(d: DVec3, side: usize) -> usize {
    let d = d / (d.x.abs() + d.y.abs() + d.z.abs());
    let sign = |x: f64| if x < 0.0 { -1.0 } else { 1.0 };
    let p = match d.z < 0.0 {
        true => DVec2::new((1.0 - d.y.abs()) * sign(d.x), (1.0 - d.x.abs()) * sign(d.y)),
        false => DVec2::new(d.x, d.y),
    };
    let index = |x: f64| ((0.5 * (x + 1.0) * side as f64) as usize).min(side - 1);
    index(p.y) * side + index(p.x)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::SplitMix64;
    use crate::sensor::{Angles, Scanner};
    use crate::sensor::{Geometry, RayTable, Sensor, SensorSpec};

    /// The result is nearly always the nearest ray and never far from it, inside and outside the table.
    #[test]
    fn directions_are_found() {
        let mut random = SplitMix64(3);
        let (width, height) = (120, 50);
        let rays = (0..width * height).map(|i| {
            let (c, r) = (f64::from(i % width), f64::from(i / width));
            let azimuth = (3.0 * (c + random.uniform(-0.3, 0.3))).to_radians();
            let elevation = (80.0 - 2.0 * (r + random.uniform(-0.3, 0.3))).to_radians();
            DVec3::new(elevation.cos() * azimuth.cos(), elevation.cos() * azimuth.sin(), elevation.sin())
        });
        let rays: Vec<DVec3> = rays.collect();
        let table = Geometry::Rays(RayTable::new(width, height, rays.clone()).unwrap());
        let sensor = Sensor::new(SensorSpec::new("s", "laser", table)).unwrap();
        let (mut nearest, mut worst) = (0, 0.0f64);
        for _ in 0..500 {
            let (azimuth, z) = (random.uniform(-3.0, 3.0), random.uniform(-0.3, 0.98));
            let flat = f64::sqrt(1.0 - z * z);
            let d = DVec3::new(flat * azimuth.cos(), flat * azimuth.sin(), z);
            let (column, row) = sensor.near_pixel(d).unwrap();
            let found = rays[(row * width + column) as usize].distance(d);
            let best = rays.iter().map(|r| r.distance(d)).fold(f64::INFINITY, f64::min);
            nearest += usize::from(found <= best + 1e-12);
            worst = worst.max(found - best);
        }
        assert!(nearest >= 475 && worst < 0.1, "{nearest} of 500, worst by {worst}");
        let uniform = |count| Angles::Uniform { start_deg: 0.0, step_deg: 0.5, count };
        let beams = Scanner { azimuth: uniform(361), elevation: uniform(1), beam_height_deg: None };
        let scanner = Sensor::new(SensorSpec::new("s", "laser", Geometry::Scanner(beams))).unwrap();
        assert_eq!(scanner.near_pixel(DVec3::X), None);
    }
}
