//! The rays of a sensor in compact tiles of up to 64, for the search in trees. Made once for each sensor.

use super::bundles::{BundleNumbers, Bundles};
use super::{Geometry, LineAxis, LineGrid, PixelGrid, Sensor};
use crate::error::Result;
use crate::memory;
use glam::DVec3;
use std::ops::Range;

/// Rays of a group, which are processed together.
pub const GROUP: usize = 8;

/// Maximum number of groups of a tile.
pub const GROUPS: usize = 8;

/// Rays of one tile as (1, s, t) in axes of its own.
#[derive(Clone, Debug)]
#[repr(align(64))]
pub struct RayTile {
    /// By group. Lanes without a ray repeat another one.
    pub s: [[f32; GROUP]; GROUPS],
    /// By group.
    pub t: [[f32; GROUP]; GROUPS],
    /// Minimum and maximum s of each group; an empty interval for groups without a ray.
    pub s_of_groups: [[f32; GROUPS]; 2],
    /// Minimum and maximum t of each group.
    pub t_of_groups: [[f32; GROUPS]; 2],
    /// Minimum and maximum s of all groups.
    pub s_range: [f32; 2],
    /// Minimum and maximum t of all groups.
    pub t_range: [f32; 2],
    /// Unit axes in the image frame: forward, along s, along t.
    pub axes: [DVec3; 3],
    /// A bit for each lane with a ray, by group.
    pub alive: [u32; GROUPS],
    /// Line and sample of each group's first lane. For listed rays, the number of the group in the list and 0.
    pub places: [[u32; 2]; GROUPS],
    /// Groups in use.
    pub groups: usize,
}

/// Arrangement of the lanes of a group among lines and samples.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum GroupLayout {
    /// Neighbouring samples of one line, from a multiple of eight on.
    Along,
    /// One sample of neighbouring lines.
    Across,
    /// Pixels in no order, by [`RayTiles::listed`].
    Listed,
}

/// All rays of a sensor in tiles.
#[derive(Clone, Debug)]
pub struct RayTiles {
    /// The tiles, line by line. No ray is in two of them.
    pub tiles: Vec<RayTile>,
    /// Arrangement of the lanes of a group.
    pub layout: GroupLayout,
    /// No tile reaches over a multiple of this number of lines.
    lines_of_block: usize,
    /// First tile of each block of lines, then the number of tiles.
    block_starts: Vec<u32>,
    /// Pixels (row times width plus column) of the lanes of each group, for listed rays.
    listed: Vec<[u32; GROUP]>,
    /// Bundle of each tile; empty if all rays are in one.
    bundles: Vec<u32>,
}

/// Lines of a block where lanes lie across them.
const ACROSS: usize = 32;

/// Cosine of the greatest angle between a tile's forward axis and its rays: wider tiles are split.
const NARROW: f64 = 0.725;

/// Rows this many times as far apart as columns are tiles of their own.
const SPARSE: f64 = 3.0;

/// Widest tile of one row, radians.
const WIDEST_ROW: f64 = 4.5 * std::f64::consts::PI / 180.0;

/// A group before it is in a tile: its first line and sample, and its lanes with a ray.
#[derive(Clone, Copy)]
struct Place {
    at: [u32; 2],
    lanes: u32,
}

impl RayTiles {
    /// # Errors
    /// [`crate::ErrorKind::System`] if there is no memory for them.
    pub(super) fn new(sensor: &Sensor) -> Result<Self> {
        let rays = u64::from(sensor.width()) * u64::from(sensor.height());
        let bytes = rays.div_ceil(GROUP as u64) * (size_of::<RayTile>() / 2) as u64;
        if bytes > 64 << 20 {
            memory::require(bytes)?;
        }
        let (layout, groups) = Self::layout_of(sensor);
        let (size, axis) = match sensor.grid() {
            PixelGrid::Rays(grid) => ([grid.height() as usize, grid.width() as usize], LineAxis::Rows),
            PixelGrid::Lines(grid) => ([grid.lines().len(), grid.weights().len()], grid.axis()),
        };
        Ok(match layout {
            GroupLayout::Listed => Self::listed_of(sensor),
            GroupLayout::Across => Self::across(sensor, size, groups),
            GroupLayout::Along => Self::along(sensor, size, axis, size[0].min(GROUPS)),
        })
    }

    /// Tiles that each hold rays of one bundle.
    ///
    /// # Errors
    /// [`crate::ErrorKind::System`] if there is no memory for them.
    pub(super) fn of_bundles(sensor: &Sensor, bundles: &Bundles) -> Result<Self> {
        let rays = u64::from(sensor.width()) * u64::from(sensor.height());
        let tiles = (bundles.len() as u64 + rays / (GROUP * GROUPS) as u64).min(rays);
        memory::require(tiles * size_of::<RayTile>() as u64)?;
        let (lines, axis) = match sensor.grid() {
            PixelGrid::Lines(grid) => ([grid.lines().len(), grid.weights().len()], grid.axis()),
            PixelGrid::Rays(grid) => ([grid.height() as usize, grid.width() as usize], LineAxis::Rows),
        };
        let is_table = matches!(sensor.spec().geometry, Geometry::Rays(_));
        Ok(match (bundles.numbers(), axis) {
            (BundleNumbers::Columns, LineAxis::Columns) | (BundleNumbers::Rows, LineAxis::Rows) if !is_table => {
                let mut tiles = Self::along(sensor, lines, axis, 1);
                tiles.bundles = tiles.tiles.iter().map(|tile| tile.places[0][0]).collect();
                tiles
            }
            _ => Self::listed_in_bundles(sensor, bundles),
        })
    }

    /// How lanes lie, and of how many groups a tile across lines is.
    pub(super) fn layout_of(sensor: &Sensor) -> (GroupLayout, usize) {
        match (sensor.grid(), &sensor.spec().geometry) {
            (PixelGrid::Rays(_), Geometry::Rays(_)) => (GroupLayout::Listed, GROUPS),
            (PixelGrid::Rays(_), _) => (GroupLayout::Along, GROUPS),
            (PixelGrid::Lines(grid), _) => match rows_apart(grid) {
                Some(groups) => (GroupLayout::Across, groups),
                None => (GroupLayout::Along, GROUPS),
            },
        }
    }

    /// Tiles of some lines, which begin at a multiple of 8, and of 32 where lanes lie across lines.
    pub fn of_lines(&self, lines: Range<usize>) -> &[RayTile] {
        &self.tiles[self.range_of_lines(lines)]
    }

    fn range_of_lines(&self, lines: Range<usize>) -> Range<usize> {
        debug_assert!(lines.start.is_multiple_of(self.lines_of_block));
        let block = |line: usize| line.div_ceil(self.lines_of_block).min(self.block_starts.len() - 1);
        let [first, end] = [block(lines.start), block(lines.end)].map(|block| self.block_starts[block] as usize);
        first..end
    }

    /// Pixels of the lanes of a group of listed rays.
    #[inline(always)]
    pub fn listed(&self, group: u32) -> &[u32; GROUP] {
        &self.listed[group as usize]
    }

    /// Bytes of memory.
    pub fn bytes(&self) -> u64 {
        (size_of_val(&*self.tiles) + size_of_val(&*self.listed)) as u64
    }

    /// Bundle of a tile: see [`Sensor::bundles`]. 0 if all rays are in one.
    #[inline(always)]
    pub fn bundle(&self, tile: usize) -> u32 {
        self.bundles.get(tile).copied().unwrap_or(0)
    }

    /// Number of the first tile of [`RayTiles::of_lines`].
    pub fn first_of_lines(&self, lines: Range<usize>) -> usize {
        self.range_of_lines(lines).start
    }

    fn empty(layout: GroupLayout, lines_of_block: usize) -> Self {
        let (tiles, listed, bundles) = (Vec::new(), Vec::new(), Vec::new());
        Self { tiles, layout, lines_of_block, block_starts: vec![0], listed, bundles }
    }

    /// Tiles of `tall` lines: squares of eight lines and eight samples, or stretches of fewer lines.
    fn along(sensor: &Sensor, [lines, samples]: [usize; 2], axis: LineAxis, tall: usize) -> Self {
        let mut all = Self::empty(GroupLayout::Along, if tall == 1 { 1 } else { GROUPS });
        let ray = |line: u32, sample: u32| match axis {
            LineAxis::Rows => sensor.ray(sample, line),
            LineAxis::Columns => sensor.ray(line, sample),
        };
        let ray = |at: [u32; 2], lane: u32| ray(at[0], at[1] + lane);
        // A tile of fewer lines has more samples.
        let octets = GROUPS / tall.next_power_of_two();
        for line in (0..lines).step_by(tall) {
            for octet in (0..samples.div_ceil(GROUP)).step_by(octets) {
                let own = line..lines.min(line + tall);
                let octets = octet..samples.div_ceil(GROUP).min(octet + octets);
                let places = own.flat_map(|l| octets.clone().map(move |o| [l as u32, (o * GROUP) as u32]));
                all.add(places, samples, &ray);
            }
            all.block_starts.push(all.tiles.len() as u32);
        }
        all
    }

    /// Stretches of some groups of neighbouring lines at one sample.
    fn across(sensor: &Sensor, [lines, samples]: [usize; 2], groups: usize) -> Self {
        let mut all = Self::empty(GroupLayout::Across, ACROSS);
        let ray = |at: [u32; 2], lane: u32| sensor.ray(at[0] + lane, at[1]);
        for first in (0..lines).step_by(ACROSS) {
            let end = lines.min(first + ACROSS);
            for sample in 0..samples {
                for line in (first..end).step_by(GROUP * groups) {
                    let own = (line..end.min(line + GROUP * groups)).step_by(GROUP);
                    all.add(own.map(|line| [line as u32, sample as u32]), usize::MAX, &ray);
                }
            }
            all.block_starts.push(all.tiles.len() as u32);
        }
        all
    }

    /// Tiles of neighbours in direction, however they are listed.
    fn listed_of(sensor: &Sensor) -> Self {
        let mut all = Self::empty(GroupLayout::Listed, usize::MAX);
        all.list(sensor, 0..sensor.width() * sensor.height());
        all.block_starts.push(all.tiles.len() as u32);
        all
    }

    /// Tiles of neighbours in direction within each bundle.
    fn listed_in_bundles(sensor: &Sensor, bundles: &Bundles) -> Self {
        let mut all = Self::empty(GroupLayout::Listed, usize::MAX);
        let width = sensor.width();
        let number = |pixel: u32| bundles.of_pixel(pixel % width, pixel / width);
        let mut pixels: Vec<u32> = (0..width * sensor.height()).collect();
        pixels.sort_by_key(|pixel| number(*pixel));
        for own in pixels.chunk_by(|a, b| number(*a) == number(*b)) {
            all.list(sensor, own.iter().copied());
            all.bundles.resize(all.tiles.len(), number(own[0]));
        }
        all.block_starts.push(all.tiles.len() as u32);
        all
    }

    /// Adds tiles of neighbours in direction.
    fn list(&mut self, sensor: &Sensor, pixels: impl Iterator<Item = u32>) {
        let (all, width) = (self, sensor.width());
        let direction = |pixel: u32| sensor.ray(pixel % width, pixel / width);
        let mut rays: Vec<([f32; 3], u32)> =
            pixels.filter_map(|pixel| Some((direction(pixel)?.as_vec3().to_array(), pixel))).collect();
        gather(&mut rays, GROUP);
        for tile in rays.chunks(GROUP * GROUPS) {
            let first = all.listed.len() as u32;
            for group in tile.chunks(GROUP) {
                all.listed.push(std::array::from_fn(|lane| group[lane.min(group.len() - 1)].1));
            }
            let listed = all.listed[first as usize..].to_vec();
            let ray = |at: [u32; 2], lane: u32| {
                let there = ((at[0] - first) as usize * GROUP + lane as usize) < tile.len();
                there.then(|| direction(listed[(at[0] - first) as usize][lane as usize])).flatten()
            };
            all.add((first..all.listed.len() as u32).map(|group| [group, 0]), usize::MAX, &ray);
        }
    }

    /// Adds a tile of some groups, or several if it would be too wide.
    fn add(
        &mut self,
        places: impl Iterator<Item = [u32; 2]>,
        samples: usize,
        ray: &impl Fn([u32; 2], u32) -> Option<DVec3>,
    ) {
        let lanes = |at: [u32; 2]| {
            let there = |lane: &u32| samples == usize::MAX || ((at[1] + lane) as usize) < samples;
            (0..GROUP as u32)
                .filter(there)
                .filter(|lane| ray(at, *lane).is_some())
                .fold(0, |bits, lane| bits | 1 << lane)
        };
        let places: Vec<Place> = places.map(|at| Place { at, lanes: lanes(at) }).filter(|p| p.lanes != 0).collect();
        if !places.is_empty() {
            self.add_or_split(&places, ray);
        }
    }

    fn add_or_split(&mut self, places: &[Place], ray: &impl Fn([u32; 2], u32) -> Option<DVec3>) {
        if let Some(tile) = RayTile::of(places, ray) {
            self.tiles.push(tile);
        } else if let [one] = places {
            // Half of its rays each; a single ray is narrow.
            let half = (0..GROUP)
                .map(|n| one.lanes & ((1 << n) - 1))
                .find(|low| 2 * low.count_ones() >= one.lanes.count_ones());
            let low = half.unwrap_or(one.lanes >> 1);
            for lanes in [low, one.lanes & !low] {
                self.add_or_split(&[Place { lanes, ..*one }], ray);
            }
        } else {
            let (some, others) = places.split_at(places.len() / 2);
            self.add_or_split(some, ray);
            self.add_or_split(others, ray);
        }
    }
}

impl RayTile {
    /// `None` if it would be too wide.
    fn of(places: &[Place], ray: &impl Fn([u32; 2], u32) -> Option<DVec3>) -> Option<Self> {
        let rays_of = |place: &Place| {
            let place = *place;
            (0..GROUP as u32)
                .filter(move |lane| place.lanes >> lane & 1 == 1)
                .filter_map(move |lane| Some((lane, ray(place.at, lane)?)))
        };
        let sum: DVec3 = places.iter().flat_map(rays_of).map(|(_, d)| d).sum();
        let forward = sum.try_normalize()?;
        if !places.iter().flat_map(rays_of).all(|(_, d)| d.dot(forward) >= NARROW) {
            return None;
        }
        let (first, last) = (rays_of(&places[0]).next()?.1, rays_of(&places[0]).last()?.1);
        let across = last - first;
        let across = (across - forward * across.dot(forward)).try_normalize();
        let along_s = across.unwrap_or_else(|| forward.any_orthonormal_vector());
        let axes = [forward, along_s, forward.cross(along_s)];
        let (nothing, room) = ([f32::INFINITY, f32::NEG_INFINITY], [[0.0; GROUP]; GROUPS]);
        let of_groups = nothing.map(|x| [x; GROUPS]);
        let mut tile = Self {
            s: room,
            t: room,
            s_of_groups: of_groups,
            t_of_groups: of_groups,
            s_range: nothing,
            t_range: nothing,
            axes,
            alive: [0; GROUPS],
            places: [[0; 2]; GROUPS],
            groups: places.len(),
        };
        let hold = |range: [f32; 2], x: f32| [range[0].min(x), range[1].max(x)];
        for (g, place) in places.iter().enumerate() {
            (tile.places[g], tile.alive[g]) = (place.at, place.lanes);
            let (mut s_range, mut t_range) = (nothing, nothing);
            for (lane, d) in rays_of(place) {
                let ahead = d.dot(axes[0]);
                let [s, t] = [(d.dot(axes[1]) / ahead) as f32, (d.dot(axes[2]) / ahead) as f32];
                if s_range == nothing {
                    (tile.s[g], tile.t[g]) = ([s; GROUP], [t; GROUP]);
                }
                (tile.s[g][lane as usize], tile.t[g][lane as usize]) = (s, t);
                (s_range, t_range) = (hold(s_range, s), hold(t_range, t));
            }
            for end in 0..2 {
                (tile.s_of_groups[end][g], tile.t_of_groups[end][g]) = (s_range[end], t_range[end]);
                tile.s_range = hold(tile.s_range, s_range[end]);
                tile.t_range = hold(tile.t_range, t_range[end]);
            }
        }
        Some(tile)
    }
}

/// For scanners whose rows are few, or far apart: how many groups of columns a tile of one row has.
fn rows_apart(grid: &LineGrid) -> Option<usize> {
    if grid.axis() == LineAxis::Rows {
        return None;
    }
    let (lines, samples) = (grid.lines().len(), grid.weights().len());
    let angle = |a: (usize, usize), b: (usize, usize)| grid.line_ray(a.0, a.1).angle_between(grid.line_ray(b.0, b.1));
    let (line, sample) = (lines / 2, samples / 2);
    let columns = if line + 1 < lines { angle((line, sample), (line + 1, sample)) } else { 0.0 };
    let rows = if sample + 1 < samples { angle((line, sample), (line, sample + 1)) } else { 0.0 };
    let sparse = samples < 4 || rows > SPARSE * columns;
    let groups = (WIDEST_ROW / (GROUP as f64 * columns.max(1e-6))).round();
    sparse.then_some(if groups >= 4.0 {
        4
    } else if groups >= 2.0 {
        2
    } else {
        1
    })
}

/// Orders directions by halving: every 64 of them, and every 8, are neighbours.
fn gather(rays: &mut [([f32; 3], u32)], least: usize) {
    if rays.len() <= least {
        return;
    }
    let start = ([f32::INFINITY; 3], [f32::NEG_INFINITY; 3]);
    let (low, high) = rays
        .iter()
        .fold(start, |(low, high), (d, _)| ([0, 1, 2].map(|k| low[k].min(d[k])), [0, 1, 2].map(|k| high[k].max(d[k]))));
    let wide = [0, 1, 2].map(|k| high[k] - low[k]);
    let axis = (0..3).fold(0, |widest, k| if wide[k] > wide[widest] { k } else { widest });
    // Whole tiles, or whole groups of one.
    let unit = if rays.len() > GROUP * GROUPS { GROUP * GROUPS } else { GROUP };
    let middle = (rays.len() / 2).div_ceil(unit) * unit;
    let middle = if middle >= rays.len() { middle - unit } else { middle };
    if middle == 0 {
        return;
    }
    rays.select_nth_unstable_by(middle, |a, b| a.0[axis].total_cmp(&b.0[axis]).then(a.1.cmp(&b.1)));
    let (some, others) = rays.split_at_mut(middle);
    gather(some, least);
    gather(others, least);
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::SplitMix64;
    use crate::sensor::{Angles, Camera, RayTable, Scanner, SensorSpec};

    fn sensor(geometry: Geometry) -> Sensor {
        Sensor::new(SensorSpec::new("s", "laser", geometry)).unwrap()
    }

    fn scanner(columns: u32, step_deg: f64, rows: u32, row_step: f64) -> Sensor {
        let azimuth = Angles::Uniform { start_deg: -90.0, step_deg, count: columns };
        let elevation =
            Angles::Uniform { start_deg: -0.5 * row_step * f64::from(rows - 1), step_deg: row_step, count: rows };
        sensor(Geometry::Scanner(Scanner { azimuth, elevation, beam_height_deg: None }))
    }

    /// Pixel of a lane.
    fn pixel(sensor: &Sensor, tiles: &RayTiles, [line, sample]: [u32; 2], lane: usize) -> (u32, u32) {
        let columns = matches!(sensor.grid(), PixelGrid::Lines(grid) if grid.axis() == LineAxis::Columns);
        let (line, sample) = match tiles.layout {
            GroupLayout::Along => (line, sample + lane as u32),
            GroupLayout::Across => (line + lane as u32, sample),
            GroupLayout::Listed => {
                let pixel = tiles.listed(line)[lane];
                return (pixel % sensor.width(), pixel / sensor.width());
            }
        };
        if columns { (line, sample) } else { (sample, line) }
    }

    fn check(sensor: &Sensor) -> usize {
        let tiles = sensor.ray_tiles().unwrap();
        let mut met = std::collections::BTreeSet::new();
        for tile in &tiles.tiles {
            for g in 0..tile.groups {
                for lane in (0..GROUP).filter(|lane| tile.alive[g] >> lane & 1 == 1) {
                    let (x, y) = pixel(sensor, tiles, tile.places[g], lane);
                    assert!(met.insert((x, y)), "{x} {y} twice");
                    let (s, t) = (tile.s[g][lane], tile.t[g][lane]);
                    let [a, u, v] = tile.axes;
                    let ray = a + u * f64::from(s) + v * f64::from(t);
                    assert!(ray.normalize().distance(sensor.ray(x, y).unwrap()) < 1e-6);
                    assert!(tile.s_of_groups[0][g] <= s && s <= tile.s_of_groups[1][g]);
                    assert!(tile.t_of_groups[0][g] <= t && t <= tile.t_of_groups[1][g]);
                }
                assert!(tile.s_range[0] <= tile.s_of_groups[0][g] && tile.s_of_groups[1][g] <= tile.s_range[1]);
            }
            assert!(tile.s_range.iter().chain(&tile.t_range).all(|x| x.abs() < 0.96), "too wide");
        }
        let rays = (0..sensor.width()).flat_map(|x| (0..sensor.height()).map(move |y| (x, y)));
        assert_eq!(met, rays.filter(|(x, y)| sensor.ray(*x, *y).is_some()).collect());
        tiles.tiles.len()
    }

    #[test]
    fn every_ray_is_in_one_tile() {
        assert_eq!(check(&sensor(Geometry::Camera(Camera::pinhole(50, 20, 40.0, 40.0, 25.0, 10.0)))), 7 * 3);
        check(&sensor(Geometry::Camera(Camera::pinhole(100, 1, 40.0, 40.0, 25.0, 0.0))));
        check(&scanner(361, 0.5, 1, 0.0));
        check(&scanner(70, 0.2, 16, 2.0));
        check(&scanner(70, 1.0, 40, 1.0));
        // Wider than a tile may be: from pole to pole, and a quarter turn from ray to ray.
        check(&scanner(12, 30.0, 7, 30.0));
        check(&scanner(4, 90.0, 3, 90.0));
        let mut random = SplitMix64(5);
        let ray = |i: usize, random: &mut SplitMix64| match i % 7 {
            3 => DVec3::NAN,
            _ => DVec3::new(random.normal(1.0), random.normal(1.0), random.normal(1.0)),
        };
        for count in [1, 5, 64, 65, 1000] {
            let rays = (0..count).map(|i| ray(i, &mut random)).collect();
            check(&sensor(Geometry::Rays(RayTable::new(count as u32, 1, rays).unwrap())));
        }
    }

    #[test]
    fn listed_rays_make_full_tiles_of_neighbours() {
        let mut random = SplitMix64(6);
        let rays = (0..24_000).map(|_| DVec3::new(1.0, random.uniform(-0.3, 0.3), random.uniform(-0.3, 0.3)));
        let table = sensor(Geometry::Rays(RayTable::new(24_000, 1, rays.collect()).unwrap()));
        assert_eq!(check(&table), 375);
        let tiles = &table.ray_tiles().unwrap().tiles;
        // 375 squares of 0.031.
        assert!(tiles.iter().all(|t| t.s_range[1] - t.s_range[0] + t.t_range[1] - t.t_range[0] < 0.2));
    }
}
