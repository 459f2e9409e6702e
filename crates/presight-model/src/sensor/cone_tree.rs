//! A tree of cones over the tiles of a ray table. It finds the tiles that a polygon's cone may meet.

use super::grid::Octet;
use super::ray_grid::Tile;
use glam::DVec3;
use pulp::Simd;
use std::ops::Range;

/// Children of a node along each side.
const SIDE: usize = 4;

/// A level with fewer nodes than this gets no level above it.
const TOP: usize = 32;

/// Far above the rounding errors of cosines and of products of unit vectors.
const SLACK: f64 = 1e-14;

/// Eight cones, with the cosine and the sine of the half angle.
#[derive(Clone, Debug)]
#[repr(align(64))]
struct Caps {
    x: [f64; Octet::LEN],
    y: [f64; Octet::LEN],
    z: [f64; Octet::LEN],
    cosine: [f64; Octet::LEN],
    sine: [f64; Octet::LEN],
}

impl Caps {
    /// In place of cosine and sine: a cone that meets nothing, and one that meets everything (at least a right angle).
    const NOTHING: [f64; 2] = [2.0, -2.0];
    const EVERYTHING: [f64; 2] = [-2.0, 2.0];

    fn new() -> Self {
        let nothing = [0.0; Octet::LEN];
        let [cosine, sine] = Self::NOTHING.map(|v| [v; Octet::LEN]);
        Self { x: nothing, y: nothing, z: nothing, cosine, sine }
    }

    fn set(&mut self, i: usize, cone: &Cone) {
        (self.x[i], self.y[i], self.z[i]) = cone.axis.into();
        [self.cosine[i], self.sine[i]] = match cone.half_angle {
            a if a < 0.0 => Self::NOTHING,
            a if a < 1.57 => [a.cos(), a.sin()],
            _ => Self::EVERYTHING,
        };
    }

    /// Sets a bit for each cone that meets the given cone, which is narrower than a right angle.
    #[inline(always)]
    fn met<S: Simd>(&self, simd: S, axis: DVec3, cosine: f64, sine: f64) -> u32 {
        let [ax, ay, az] = [axis.x, axis.y, axis.z].map(|v| simd.splat_f64s(v));
        let (ca, sa, slack) = (simd.splat_f64s(cosine), simd.splat_f64s(sine), simd.splat_f64s(SLACK));
        let (all, none) = (simd.splat_u64s(1), simd.splat_u64s(0));
        let of = |lanes: &[f64; Octet::LEN], i: usize| S::as_simd_f64s(lanes).0[i];
        let mut flags = [0; Octet::LEN];
        for i in 0..Octet::LEN / S::F64_LANES {
            let xy = simd.add_f64s(simd.mul_f64s(ax, of(&self.x, i)), simd.mul_f64s(ay, of(&self.y, i)));
            let dot = simd.add_f64s(simd.add_f64s(xy, simd.mul_f64s(az, of(&self.z, i))), slack);
            // cos(a + b): cones meet if their axes are at most a + b apart.
            let least = simd.sub_f64s(simd.mul_f64s(ca, of(&self.cosine, i)), simd.mul_f64s(sa, of(&self.sine, i)));
            let meets = simd.greater_than_or_equal_f64s(dot, least);
            S::as_mut_simd_u64s(&mut flags).0[i] = simd.select_u64s(meets, all, none);
        }
        flags.iter().enumerate().fold(0, |bits, (i, flag)| bits | (*flag as u32) << i)
    }
}

#[derive(Clone, Copy, Debug)]
struct Cone {
    axis: DVec3,
    /// Negative for a cone that holds nothing.
    half_angle: f64,
}

impl Cone {
    /// A cone that contains the given cones.
    fn around(cones: &[Self]) -> Self {
        let some = || cones.iter().filter(|c| c.half_angle >= 0.0);
        let sum: DVec3 = some().map(|c| c.axis).sum();
        let axis = if sum.length() > 1e-6 { sum.normalize() } else { DVec3::X };
        let reach = |c: &Self| axis.cross(c.axis).length().atan2(axis.dot(c.axis)) + c.half_angle;
        let half_angle = some().map(reach).fold(-1.0, f64::max);
        Self { axis, half_angle: if half_angle < 0.0 { -1.0 } else { half_angle + 1e-9 } }
    }
}

/// Nodes of one size; level 0 holds the tiles. The children of one parent are stored together, in two groups of eight.
#[derive(Clone, Debug)]
struct Level {
    caps: Vec<Caps>,
    /// Nodes per row.
    across: usize,
    parents_across: usize,
    /// Tiles along a side of a node.
    tiles: usize,
}

/// The tree.
#[derive(Clone, Debug)]
pub struct ConeTree {
    levels: Vec<Level>,
    across: usize,
    down: usize,
}

/// Rows and columns of tiles.
pub(crate) type TileRange = [Range<u32>; 2];

/// No tile yet; `TileBox::take` extends it.
const NOTHING: Range<usize> = Range { start: usize::MAX, end: 0 };

/// Tiles found so far.
struct TileBox {
    rows: Range<usize>,
    columns: Range<usize>,
}

impl ConeTree {
    /// Builds the tree over tiles in rows of `across`.
    pub fn new(tiles: &[Tile], across: usize) -> Self {
        let down = tiles.len() / across;
        let mut nodes: Vec<Cone> = tiles.iter().map(|t| Cone { axis: t.axis, half_angle: t.half_angle }).collect();
        let (mut w, mut h, mut side) = (across, down, 1);
        let mut levels = Vec::new();
        loop {
            let (pw, ph) = (w.div_ceil(SIDE), h.div_ceil(SIDE));
            let mut caps = vec![Caps::new(); 2 * pw * ph];
            let mut parents = Vec::with_capacity(pw * ph);
            for (py, px) in (0..ph).flat_map(|y| (0..pw).map(move |x| (y, x))) {
                let mut children = Vec::with_capacity(SIDE * SIDE);
                for (dy, dx) in (0..SIDE).flat_map(|y| (0..SIDE).map(move |x| (y, x))) {
                    let (x, y, i) = (px * SIDE + dx, py * SIDE + dy, dy * SIDE + dx);
                    if x < w && y < h {
                        caps[2 * (py * pw + px) + i / Octet::LEN].set(i % Octet::LEN, &nodes[y * w + x]);
                        children.push(nodes[y * w + x]);
                    }
                }
                parents.push(Cone::around(&children));
            }
            levels.push(Level { caps, across: w, parents_across: pw, tiles: side });
            if w * h <= TOP {
                return Self { levels, across, down };
            }
            (nodes, w, h, side) = (parents, pw, ph, side * SIDE);
        }
    }

    /// A rectangle of tiles with every tile whose cone meets the given cone, which is narrower than a right angle.
    #[inline(always)]
    pub fn tiles_met<S: Simd>(&self, simd: S, axis: DVec3, cosine: f64) -> TileRange {
        let cosine = cosine - SLACK;
        let sine = (1.0 - cosine * cosine).max(0.0).sqrt();
        let mut found = TileBox { rows: NOTHING, columns: NOTHING };
        // Pending blocks of siblings: at most 16 from each level but the top.
        let mut waiting = [(0u32, 0u32); 160];
        let top = self.levels.len() - 1;
        for block in 0..self.levels[top].caps.len() / 2 {
            let mut count = 1;
            waiting[0] = (top as u32, block as u32);
            while count > 0 {
                count -= 1;
                let (l, block) = (waiting[count].0 as usize, waiting[count].1 as usize);
                let level = &self.levels[l];
                let pair = &level.caps[2 * block..2 * block + 2];
                let mut met =
                    pair[0].met(simd, axis, cosine, sine) | pair[1].met(simd, axis, cosine, sine) << Octet::LEN;
                let (px, py) = (block % level.parents_across, block / level.parents_across);
                while met != 0 {
                    let i = met.trailing_zeros() as usize;
                    met &= met - 1;
                    let (x, y) = (px * SIDE + i % SIDE, py * SIDE + i / SIDE);
                    let columns = x * level.tiles..((x + 1) * level.tiles).min(self.across);
                    let rows = y * level.tiles..((y + 1) * level.tiles).min(self.down);
                    if found.holds(&rows, &columns) {
                        continue;
                    }
                    if l == 0 {
                        found.take(rows, columns);
                    } else {
                        waiting[count] = (l as u32 - 1, (y * level.across + x) as u32);
                        count += 1;
                    }
                }
            }
        }
        if found.rows.is_empty() {
            return [0..0, 0..0];
        }
        [found.rows, found.columns].map(|r| r.start as u32..r.end as u32)
    }

    /// Bytes of memory.
    pub fn bytes(&self) -> usize {
        self.levels.iter().map(|l| size_of_val(&*l.caps)).sum()
    }
}

impl TileBox {
    fn holds(&self, rows: &Range<usize>, columns: &Range<usize>) -> bool {
        self.rows.start <= rows.start
            && rows.end <= self.rows.end
            && self.columns.start <= columns.start
            && columns.end <= self.columns.end
    }

    fn take(&mut self, rows: Range<usize>, columns: Range<usize>) {
        let hull = |a: &Range<usize>, b: Range<usize>| a.start.min(b.start)..a.end.max(b.end);
        (self.rows, self.columns) = (hull(&self.rows, rows), hull(&self.columns, columns));
    }
}
