//! A sensor's rays in the shaders' layout: line tables with search buckets, or ray tables with cones.

use super::direction_words;
use super::layout::{BLOCK_WORDS, GridKind, Params, SHORT_GRID, TILE_SIDE, TILES_PER_BLOCK, TILES_PER_SUPERTILE};
use glam::{DMat3, DVec3};
use presight_model::error::Result;
use presight_model::sensor::{ForwardView, LineAxis, LineGrid, PixelGrid, RayGrid, Sensor, Tile, TileLookup};

/// Tables of one sensor and their offsets, words.
pub(super) struct Tables {
    pub kind: GridKind,
    pub words: Vec<u32>,
    /// Only the fields that depend on the sensor.
    pub params: Params,
    /// image_from_line; the identity for ray tables.
    pub image_from_line: DMat3,
    /// Blocks of coarse depth along a line and across lines. Coarse depth is stored behind the words.
    pub blocks: [u32; 2],
}

/// Replaces an infinite position at a pole, so that comparisons stay defined.
const POLE: f32 = 1.0e37;
/// Maximum number of buckets of a search table.
const MAX_BUCKETS: usize = 1 << 16;

impl Tables {
    /// # Errors
    /// [`presight_model::ErrorKind::System`] if the system refuses the memory.
    pub fn new(sensor: &Sensor) -> Result<Self> {
        let mut tables = match sensor.grid() {
            PixelGrid::Lines(grid) => lines(grid),
            PixelGrid::Rays(grid) => rays(grid)?,
        };
        tables.params.width = sensor.width();
        tables.params.height = sensor.height();
        tables.params.range_min = sensor.spec().range_min as f32;
        tables.params.range_max = sensor.spec().range_max as f32;
        let blocks = |pixels: u32| pixels.div_ceil(TILE_SIDE * TILES_PER_BLOCK);
        tables.blocks = [tables.params.sample_count, tables.params.line_count].map(blocks);
        tables.params.coarse_columns = tables.blocks[0];
        tables.params.coarse_at = tables.words.len() as u32;
        Ok(tables)
    }
}

impl Tables {
    /// True if the whole table is read from a uniform buffer.
    pub fn short(&self) -> bool {
        self.kind != GridKind::Rays && self.words.len() <= 4 * SHORT_GRID as usize
    }

    /// Size of the tables and of the coarse depth behind them.
    pub fn bytes(&self) -> u64 {
        let blocks = u64::from(self.blocks[0]) * u64::from(self.blocks[1]);
        4 * (self.words.len() as u64 + blocks * u64::from(BLOCK_WORDS))
    }
}

/// The diamond angle, -2..=2; see common.wgsl.
fn diamond([x, y]: [f64; 2]) -> f64 {
    let p = x / (x.abs() + y.abs());
    if y >= 0.0 { 1.0 - p } else { p - 1.0 }
}

fn lines(grid: &LineGrid) -> Tables {
    let camera = grid.axis() == LineAxis::Rows;
    let mut params = Params {
        line_count: grid.lines().len() as u32,
        sample_count: grid.weights().len() as u32,
        fx: 1.0,
        fy: 1.0,
        ..Params::default()
    };
    let mut words = Vec::new();
    let mut order: Vec<u32> = (0..params.line_count).collect();
    if camera {
        let line = grid.line_from_image();
        // (fy y, z, fx x): the focal lengths are the two off-diagonal entries.
        params.fx = line.x_axis.z as f32;
        params.fy = line.y_axis.x as f32;
        let (first, last) = (grid.lines()[0][0], grid.lines()[grid.lines().len() - 1][0]);
        (params.first_line, params.last_line) = (first as f32, last as f32);
        let t = grid.positions();
        (params.first_sample, params.last_sample) = (t[0] as f32, t[t.len() - 1] as f32);
    } else {
        // Sorted by angle, so that a polygon covers consecutive lines; listed azimuths may be in any order.
        order.sort_by(|&a, &b| {
            diamond(grid.lines()[a as usize]).total_cmp(&diamond(grid.lines()[b as usize])).then(a.cmp(&b))
        });
    }
    params.lines_at = words.len() as u32;
    for &line in &order {
        let [c0, c1] = grid.lines()[line as usize];
        words.extend([(c0 as f32).to_bits(), (c1 as f32).to_bits(), line]);
    }
    params.weights_at = words.len() as u32;
    words.extend(grid.weights().iter().flatten().map(|w| (*w as f32).to_bits()));
    params.positions_at = words.len() as u32;
    words.extend(grid.positions().iter().map(|t| (*t as f32).clamp(-POLE, POLE).to_bits()));
    if !camera {
        let angles: Vec<f64> = order.iter().map(|&l| diamond(grid.lines()[l as usize])).collect();
        (params.line_buckets_at, params.line_buckets) = buckets(&angles, -2.0, 2.0, &mut words);
        let squeezed = grid.positions().iter().map(|t| if t.is_finite() { t / (1.0 + t.abs()) } else { t.signum() });
        let squeezed: Vec<f64> = squeezed.collect();
        (params.sample_buckets_at, params.sample_buckets) = buckets(&squeezed, -1.0, 1.0, &mut words);
    }
    let kind = if camera { GridKind::Camera } else { GridKind::Scanner };
    Tables { kind, words, params, image_from_line: grid.image_from_line(), blocks: [0, 0] }
}

/// Appends a table with the first entry at or above the start of each bucket, and one end word. Returns its offset and
/// the number of buckets. Buckets are so fine that one rarely holds two different entries.
fn buckets(values: &[f64], least: f64, greatest: f64, words: &mut Vec<u32>) -> (u32, u32) {
    let gaps = values.windows(2).map(|p| p[1] - p[0]).filter(|gap| *gap > 0.0);
    let gap = gaps.fold(greatest - least, f64::min).max(1e-9);
    let count = ((4.0 * (greatest - least) / gap).ceil() as usize).clamp(64, MAX_BUCKETS);
    let at = words.len() as u32;
    for b in 0..count {
        // A little early: rounding in the shader may land one bucket too high.
        let start = least + (greatest - least) * (b as f64 - 0.01) / count as f64;
        words.push(values.partition_point(|v| *v < start) as u32);
    }
    words.push(values.len() as u32);
    (at, count as u32)
}

fn rays(grid: &RayGrid) -> Result<Tables> {
    let tile_columns = grid.width().div_ceil(presight_model::sensor::TILE_SIDE);
    let mut words = Vec::new();
    let mut params = Params {
        line_count: grid.height(),
        sample_count: grid.width(),
        tile_columns,
        tile_count: grid.tiles().len() as u32,
        fx: 1.0,
        fy: 1.0,
        ..Params::default()
    };
    supertiles(grid).iter().for_each(|t| push_cone(t, &mut words));
    params.tiles_at = words.len() as u32;
    grid.tiles().iter().for_each(|t| push_cone(t, &mut words));
    params.rays_at = words.len() as u32;
    for ray in grid.directions() {
        let ray = if ray.is_nan() { DVec3::ZERO } else { ray };
        words.extend(ray.as_vec3().to_array().map(f32::to_bits));
    }
    if let TileLookup::Ahead(view) = grid.view() {
        params.ahead_at = words.len() as u32;
        push_ahead(grid, view, &mut words);
    }
    direction_words::push_fit(grid, &mut params, &mut words);
    direction_words::push_map(grid, &mut params, &mut words)?;
    Ok(Tables { kind: GridKind::Rays, words, params, image_from_line: DMat3::IDENTITY, blocks: [0, 0] })
}

/// Appends where forward-looking rays meet a plane at distance 1, in the layout of cull_rays.wgsl.
fn push_ahead(grid: &RayGrid, view: &ForwardView, words: &mut Vec<u32>) {
    let axes = view.turn.unwrap_or([DVec3::X, DVec3::Y, DVec3::Z]);
    words.extend(axes.iter().flat_map(|axis| axis.as_vec3().to_array().map(f32::to_bits)));
    let nothing = [f64::from(POLE), -f64::from(POLE)];
    let side = presight_model::sensor::TILE_SIDE;
    let mut spans = [grid.height(), grid.width()].map(|pixels| vec![nothing; pixels.div_ceil(side) as usize]);
    for row in 0..grid.height() {
        for column in 0..grid.width() {
            let ray = grid.direction(column, row);
            if !ray.is_nan() {
                let depth = ray.dot(axes[2]);
                for (k, (of_tile, along)) in [(row, axes[1]), (column, axes[0])].into_iter().enumerate() {
                    let [least, greatest] = &mut spans[k][(of_tile / side) as usize];
                    let place = ray.dot(along) / depth;
                    (*least, *greatest) = (least.min(place), greatest.max(place));
                }
            }
        }
    }
    for mut spans in spans {
        for i in 1..spans.len() {
            spans[i][1] = spans[i][1].max(spans[i - 1][1]);
        }
        for i in (1..spans.len()).rev() {
            spans[i - 1][0] = spans[i - 1][0].min(spans[i][0]);
        }
        let rounded = |[least, greatest]: [f64; 2]| [(greatest as f32).next_up(), (least as f32).next_down()];
        words.extend(spans.into_iter().flat_map(rounded).map(|place| place.clamp(-POLE, POLE).to_bits()));
    }
}

/// Cones of 8 x 8 tiles each.
fn supertiles(grid: &RayGrid) -> Vec<Tile> {
    let side = TILES_PER_SUPERTILE * presight_model::sensor::TILE_SIDE;
    let ray = |c: u32, r: u32| {
        let d = grid.direction(c, r);
        (!d.is_nan()).then_some(d)
    };
    let mut all = Vec::new();
    for row in (0..grid.height()).step_by(side as usize) {
        for column in (0..grid.width()).step_by(side as usize) {
            let (w, h) = (side.min(grid.width() - column), side.min(grid.height() - row));
            all.push(Tile::around(column, row, w, h, ray));
        }
    }
    all
}

/// Appends a cone: axis and chord of the half angle, rounded up; 4 if it is unbounded, negative if it has no ray.
fn push_cone(tile: &Tile, words: &mut Vec<u32>) {
    let chord = match tile.half_angle {
        a if a < 0.0 => -1.0,
        a if a < 1.5 => 2.0 * (0.5 * (a + 2e-6)).sin(),
        _ => 4.0,
    };
    words.extend(tile.axis.as_vec3().to_array().map(f32::to_bits));
    words.push((chord as f32).to_bits());
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn buckets_begin_at_or_before_what_they_hold() {
        let values = [-1.5, -0.25, -0.25, 0.1, 1.99];
        let mut words = vec![7];
        let (at, count) = buckets(&values, -2.0, 2.0, &mut words);
        assert_eq!((at, words.len()), (1, 2 + count as usize));
        for (i, v) in values.iter().enumerate() {
            let b = ((v + 2.0) / 4.0 * f64::from(count)) as usize;
            assert!(words[1 + b] <= i as u32 && words[1 + b + 1] as usize > i, "{v}");
        }
    }

    #[test]
    fn diamond_rises_with_the_angle() {
        let angles: Vec<f64> = (-1799..=1800).map(|i| f64::from(i) * 0.1).collect();
        let d: Vec<f64> = angles.iter().map(|a| diamond([a.to_radians().cos(), a.to_radians().sin()])).collect();
        assert!(d.windows(2).all(|p| p[0] < p[1]));
        assert_eq!(diamond([-1.0, 0.0]), 2.0);
    }
}
