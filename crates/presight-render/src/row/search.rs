//! The search for the segments of a [`RowCut`] that the beams of a level scanner meet. Tiles of neighbouring beams
//! search the tree nearest first, and a segment is tested against eight beams at a time.
//!
//! The segment of a beam is certain if no error of an engine or of the search could change it, see
//! `docs/design/row.md`. Other beams get candidates, among which an engine decides.

use super::cut::RowCut;
use super::segment::{Segment, distance};
use super::tree::{Block, Node};
use glam::DVec2;
use presight_model::geometry::Pose;
use presight_model::index::{LEAF, WIDE};
use presight_model::sensor::{Geometry, LineGrid, PixelGrid, Sensor};
use pulp::Simd;

/// Maximum number of groups of eight beams in a tile.
const GROUPS: usize = 4;

/// Maximum width of a tile of one group, as the tangent of its angle, and of a tile with several groups. The search of
/// a tile ends at the farthest of its beams.
const GROUP_WIDTH: f64 = 0.5;
const TILE_WIDTH: f64 = 0.05;

/// Maximum factor of a sine between the ends of a tile over its value at both ends.
const BULGE: f64 = 1.04;

/// Rounding of the search and of an engine, relative to distance.
const ROUNDING: f64 = 64.0 * f64::EPSILON;

/// Relative margin at the range limit and of nearest distances.
const SLACK: f64 = 1e-9;

/// Minimum distance of the scanner from a plane, relative to the distance of the polygon's farthest corner; twice the
/// distance at which engines have edges and depths right to 1e-11.
const CLEAR: f64 = 2e-4;

type Eight = [f64; WIDE];

/// Winner of a beam without a segment, and winner of a beam for which an engine has to decide.
pub(crate) const NOTHING: u32 = u32::MAX;
pub(crate) const UNSURE: u32 = u32::MAX - 1;

/// The beams of a one-row scanner, by column.
#[derive(Debug)]
pub(crate) struct RowBeams {
    sensor: Sensor,
    /// Directions in the sensor's frame, x and y, in groups of eight. The last group of a tile repeats its last beam.
    body: Vec<[Eight; 2]>,
    tiles: Vec<Tile>,
}

/// Neighbouring beams with a common search.
#[derive(Clone, Copy, Debug)]
struct Tile {
    count: usize,
    group: usize,
}

impl RowBeams {
    /// Returns `None` unless the sensor is a one-row scanner in its own horizontal plane.
    pub fn new(sensor: &Sensor) -> Option<Self> {
        let grid = row_grid(sensor)?;
        let beams: Vec<DVec2> = grid.lines().iter().map(|c| DVec2::from(*c)).collect();
        let (mut body, mut tiles) = (Vec::new(), Vec::new());
        let mut first = 0;
        while first < beams.len() {
            let along = beams[first];
            let fits = |(i, b): &(usize, &DVec2)| {
                let widest = if *i < WIDE { GROUP_WIDTH } else { TILE_WIDTH };
                along.dot(**b) > 0.0 && along.perp_dot(**b).abs() <= widest * along.dot(**b)
            };
            let most = beams.len().min(first + GROUPS * WIDE);
            let count = beams[first..most].iter().enumerate().take_while(fits).count().max(1);
            let count = if count > WIDE { count / WIDE * WIDE } else { count };
            tiles.push(Tile { count, group: body.len() });
            for group in beams[first..first + count].chunks(WIDE) {
                let beam = |lane: usize| group[lane.min(group.len() - 1)];
                body.push([std::array::from_fn(|lane| beam(lane).x), std::array::from_fn(|lane| beam(lane).y)]);
            }
            first += count;
        }
        Some(Self { sensor: sensor.clone(), body, tiles })
    }

    /// True if these are the beams of the sensor.
    pub fn are_of(&self, sensor: &Sensor) -> bool {
        std::ptr::eq(self.sensor.grid(), sensor.grid())
    }
}

/// The beams of a one-row scanner in its own horizontal plane.
pub(super) fn row_grid(sensor: &Sensor) -> Option<&LineGrid> {
    let (Geometry::Scanner(scanner), PixelGrid::Lines(grid)) = (&sensor.spec().geometry, sensor.grid()) else {
        return None;
    };
    let level = scanner.elevation.len() == 1 && scanner.elevation.degrees(0) == 0.0;
    level.then_some(grid)
}

/// Position and heading of a level scanner.
#[derive(Clone, Copy, Debug)]
pub(crate) struct RowView {
    place: DVec2,
    /// The sensor's x and y axes in the world.
    axes: [DVec2; 2],
    /// Maximum error of a direction, from tilt and from the rounding of a quaternion.
    pub wobble: f64,
    /// Minimum inverse range of interest, slightly beyond the limit, so that the range decides about surfaces exactly
    /// at the limit.
    horizon: f64,
    /// [`RowCut::margin`].
    margin: f64,
}

impl RowView {
    pub fn new(pose: &Pose, range_max: f64, margin: f64) -> Self {
        let m = pose.rotation_matrix();
        let axes = [m.x_axis.truncate(), m.y_axis.truncate()];
        let tilt = [m.x_axis.z, m.y_axis.z, m.z_axis.x, m.z_axis.y].into_iter().fold(0.0, |a: f64, b| a.max(b.abs()));
        let stretch = axes.map(|axis| (axis.length_squared() - 1.0).abs());
        let wobble = 2.0 * tilt + 4.0 * (stretch[0].max(stretch[1]) + axes[0].dot(axes[1]).abs());
        Self { place: pose.translation.truncate(), axes, wobble, horizon: (1.0 - SLACK) / range_max, margin }
    }
}

/// A search with its scratch memory and its results.
#[derive(Debug, Default)]
pub(crate) struct RowSearch {
    /// For each beam the index of its segment, [`NOTHING`] or [`UNSURE`].
    pub winners: Vec<u32>,
    /// All segments that may win a beam without a certain segment.
    pub candidates: Vec<u32>,
    /// Segments tested against beams.
    pub tested: usize,
    directions: Vec<[Eight; 2]>,
    stack: Vec<(f64, u32)>,
    of_tile: Vec<u32>,
}

/// A search, compiled for each vector width.
pub(crate) struct Search<'a> {
    pub search: &'a mut RowSearch,
    pub beams: &'a RowBeams,
    pub cut: &'a RowCut,
    pub view: RowView,
}

impl pulp::WithSimd for Search<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Self { search, beams, cut, view } = self;
        let [x, y] = view.axes;
        search.directions.clear();
        for [c0, c1] in &beams.body {
            let mut group = [[0.0; WIDE]; 2];
            for l in 0..WIDE {
                group[0][l] = x.x * c0[l] + y.x * c1[l];
                group[1][l] = x.y * c0[l] + y.y * c1[l];
            }
            search.directions.push(group);
        }
        search.winners.clear();
        search.candidates.clear();
        search.tested = 0;
        let RowSearch { winners, candidates, tested, directions, stack, of_tile } = search;
        for tile in &beams.tiles {
            let groups = tile.count.div_ceil(WIDE);
            let directions = &directions[tile.group..tile.group + groups];
            of_tile.clear();
            let mut trace = Trace {
                cut,
                view: &view,
                wedge: Wedge::new(directions, tile.count),
                directions,
                found: Found::new(view.horizon),
                of_tile,
            };
            trace.run(simd, stack);
            *tested += trace.of_tile.len();
            let before = winners.len();
            winners.extend((0..tile.count).map(|i| trace.found.winner(i, view.horizon)));
            if winners[before..].contains(&UNSURE) {
                trace.choose(&winners[before..], candidates);
            }
        }
    }
}

/// The directions of a tile.
struct Wedge {
    /// The first and the last beam, counter-clockwise.
    ends: [DVec2; 2],
    /// Normals of its sides, inside positive.
    sides: [DVec2; 2],
    axis: DVec2,
}

impl Wedge {
    #[inline(always)]
    fn new(directions: &[[Eight; 2]], count: usize) -> Self {
        let beam = |i: usize| DVec2::new(directions[i / WIDE][0][i % WIDE], directions[i / WIDE][1][i % WIDE]);
        let (first, last) = (beam(0), beam(count - 1));
        let ends = if first.perp_dot(last) >= 0.0 { [first, last] } else { [last, first] };
        Self { ends, sides: [ends[0].perp(), -ends[1].perp()], axis: (first + last).normalize() }
    }
}

/// Results for the beams of a tile.
struct Found {
    /// Bounds of the inverse range of the nearest certain segment: lower, then upper.
    low: [Eight; GROUPS],
    high: [Eight; GROUPS],
    segment: [Eight; GROUPS],
    /// Maximum inverse range of other segments.
    rival: [Eight; GROUPS],
}

impl Found {
    #[inline(always)]
    fn new(horizon: f64) -> Self {
        Self {
            low: [[horizon; WIDE]; GROUPS],
            high: [[0.0; WIDE]; GROUPS],
            segment: [[f64::from(NOTHING); WIDE]; GROUPS],
            rival: [[0.0; WIDE]; GROUPS],
        }
    }

    #[inline(always)]
    fn winner(&self, beam: usize, horizon: f64) -> u32 {
        let (group, lane) = (beam / WIDE, beam % WIDE);
        let (segment, rival) = (self.segment[group][lane] as u32, self.rival[group][lane]);
        let least = if segment == NOTHING { horizon } else { self.low[group][lane] };
        // A surface beyond the limit and a missing surface give the same images.
        let is_sure = rival < least || (segment == NOTHING && rival == 0.0);
        if is_sure { segment } else { UNSURE }
    }

    /// Minimum inverse range of a candidate that may win a beam.
    #[inline(always)]
    fn least(&self, beam: usize) -> f64 {
        self.low[beam / WIDE][beam % WIDE]
    }

    /// Minimum inverse range at which a beam may be unhidden.
    #[inline(always)]
    fn farthest<S: Simd>(&self, simd: S, groups: usize) -> f64 {
        let mut least = [f64::INFINITY; WIDE];
        for low in &self.low[..groups] {
            let least = S::as_mut_simd_f64s(&mut least).0;
            let low = S::as_simd_f64s(low).0;
            for i in 0..WIDE / S::F64_LANES {
                least[i] = simd.min_f64s(least[i], low[i]);
            }
        }
        let mut all = f64::INFINITY;
        for l in least {
            all = if l < all { l } else { all };
        }
        all
    }
}

/// The search for one tile.
struct Trace<'a> {
    cut: &'a RowCut,
    view: &'a RowView,
    wedge: Wedge,
    directions: &'a [[Eight; 2]],
    found: Found,
    of_tile: &'a mut Vec<u32>,
}

impl Trace<'_> {
    #[inline(always)]
    fn run<S: Simd>(&mut self, simd: S, stack: &mut Vec<(f64, u32)>) {
        let groups = self.directions.len();
        let mut farthest = self.view.horizon;
        stack.clear();
        if !self.cut.nodes.is_empty() {
            stack.push((0.0, 0));
        }
        while let Some((nearest, at)) = stack.pop() {
            if nearest * farthest > 1.0 + SLACK {
                continue;
            }
            if at & LEAF == 0 {
                self.enter(simd, &self.cut.nodes[at as usize], farthest, stack);
                continue;
            }
            let block = &self.cut.blocks[(at & !LEAF) as usize];
            let mut live =
                if block.pad < f64::INFINITY { self.look(simd, block, farthest) } else { (1 << block.count) - 1 };
            if live == 0 {
                continue;
            }
            while live != 0 {
                let number = block.first + live.trailing_zeros();
                live &= live - 1;
                self.of_tile.push(number);
                self.test(simd, number);
            }
            farthest = self.found.farthest(simd, groups);
        }
    }

    /// Pushes the children of a node that may hold a visible segment, the nearest last.
    #[inline(always)]
    fn enter<S: Simd>(&self, simd: S, node: &Node, farthest: f64, stack: &mut Vec<(f64, u32)>) {
        let slack = self.cut.rounding + (ROUNDING + 2.0 * self.view.wobble) * self.cut.span;
        let (behind, one) = (simd.splat_f64s(-slack), simd.splat_f64s(1.0 + SLACK));
        let (slack, farthest) = (simd.splat_f64s(slack), simd.splat_f64s(farthest));
        let place = splat(simd, self.view.place);
        let Wedge { sides: [right, left], axis, .. } = self.wedge;
        // The corner of each box that is farthest in a direction.
        let (of_right, of_left, of_axis, near) = (node.most(right), node.most(left), node.most(axis), node.most(-axis));
        let (right, left, axis) = (splat(simd, right), splat(simd, left), splat(simd, axis));
        let (yes, no) = (simd.splat_f64s(1.0), simd.splat_f64s(0.0));
        let (mut nearest, mut open) = ([0.0; WIDE], [0.0; WIDE]);
        for i in 0..WIDE / S::F64_LANES {
            let depth = simd.sub_f64s(dot(simd, axis, from(simd, near, i, place)), slack);
            let inside = simd.and_m64s(
                simd.greater_than_or_equal_f64s(dot(simd, right, from(simd, of_right, i, place)), behind),
                simd.greater_than_or_equal_f64s(dot(simd, left, from(simd, of_left, i, place)), behind),
            );
            let seen = simd.and_m64s(
                simd.greater_than_or_equal_f64s(dot(simd, axis, from(simd, of_axis, i, place)), behind),
                simd.less_than_or_equal_f64s(simd.mul_f64s(depth, farthest), one),
            );
            S::as_mut_simd_f64s(&mut nearest).0[i] = depth;
            S::as_mut_simd_f64s(&mut open).0[i] = simd.select_f64s(simd.and_m64s(inside, seen), yes, no);
        }
        let first = stack.len();
        for lane in 0..WIDE {
            if open[lane] == 0.0 {
                continue;
            }
            let mut at = stack.len();
            stack.push((nearest[lane], node.child[lane]));
            while at > first && stack[at - 1].0 < stack[at].0 {
                stack.swap(at - 1, at);
                at -= 1;
            }
        }
    }

    /// Segments of a block that may be visible, a bit each: they may reach into the wedge, in front of the results so
    /// far.
    #[inline(always)]
    fn look<S: Simd>(&self, simd: S, block: &Block, farthest: f64) -> u32 {
        let place = splat(simd, self.view.place);
        let (one_end, other_end) = (splat(simd, self.wedge.ends[0]), splat(simd, self.wedge.ends[1]));
        let relative = simd.splat_f64s(ROUNDING + 2.0 * self.view.wobble);
        let pad = simd.splat_f64s(block.pad + self.cut.rounding);
        let (farthest, bulge, zero) = (simd.splat_f64s(farthest), simd.splat_f64s(BULGE), simd.splat_f64s(0.0));
        let mut open = [0.0; WIDE];
        let one = simd.splat_f64s(1.0);
        for i in 0..WIDE / S::F64_LANES {
            let p = from(simd, [&block.a[0], &block.a[1]], i, place);
            let q = from(simd, [&block.b[0], &block.b[1]], i, place);
            let along = [simd.sub_f64s(q[0], p[0]), simd.sub_f64s(q[1], p[1])];
            let around = simd.add_f64s(size(simd, p), size(simd, q));
            let slack = simd.add_f64s(pad, simd.mul_f64s(relative, around));
            // Twice the area of the triangle with the scanner, positive counter-clockwise.
            let area = cross(simd, p, q);
            let sign = simd.select_f64s(simd.less_than_f64s(area, zero), simd.sub_f64s(zero, one), one);
            let outside = simd.sub_f64s(zero, slack);
            let [first, last] = [cross(simd, p, one_end), cross(simd, p, other_end)];
            let right = simd.max_f64s(simd.mul_f64s(sign, first), simd.mul_f64s(sign, last));
            let [first, last] = [cross(simd, one_end, q), cross(simd, other_end, q)];
            let left = simd.max_f64s(simd.mul_f64s(sign, first), simd.mul_f64s(sign, last));
            // The inverse range at d is (d x along) / area.
            let [first, last] = [cross(simd, one_end, along), cross(simd, other_end, along)];
            let depth = simd.max_f64s(simd.mul_f64s(sign, first), simd.mul_f64s(sign, last));
            let depth = simd.add_f64s(simd.mul_f64s(bulge, depth), simd.mul_f64s(relative, size(simd, along)));
            let (area, rounding) = (simd.mul_f64s(sign, area), simd.mul_f64s(slack, around));
            let beside = simd.and_m64s(
                simd.greater_than_or_equal_f64s(right, outside),
                simd.greater_than_or_equal_f64s(left, outside),
            );
            let behind = simd.mul_f64s(farthest, simd.sub_f64s(area, rounding));
            let seen = simd.and_m64s(beside, simd.greater_than_or_equal_f64s(depth, behind));
            // Edge-on: either side may be visible.
            let seen = simd.or_m64s(seen, simd.less_than_or_equal_f64s(area, rounding));
            S::as_mut_simd_f64s(&mut open).0[i] = simd.select_f64s(seen, one, zero);
        }
        let mut bits = 0;
        for lane in 0..WIDE {
            bits |= u32::from(open[lane] != 0.0) << lane;
        }
        bits
    }

    /// Adds the segments that may win a beam without a certain segment.
    #[cold]
    #[inline(never)]
    fn choose(&self, winners: &[u32], candidates: &mut Vec<u32>) {
        let beam =
            |i: usize| DVec2::new(self.directions[i / WIDE][0][i % WIDE], self.directions[i / WIDE][1][i % WIDE]);
        let unsure = || (0..winners.len()).filter(|i| winners[*i] == UNSURE);
        let may_win = |number: &&u32| {
            let aim = Aim::new(&self.cut.segments[**number as usize], self.view);
            aim.is_some_and(|aim| unsure().any(|i| aim.nearest(beam(i)) >= self.found.least(i)))
        };
        candidates.extend(self.of_tile.iter().filter(may_win));
    }

    /// Tests a segment against all beams.
    #[inline(always)]
    fn test<S: Simd>(&mut self, simd: S, number: u32) {
        let segment = &self.cut.segments[number as usize];
        let Some(aim) = Aim::new(segment, self.view) else { return };
        let (p, q, plane) = (splat(simd, aim.ends[0]), splat(simd, aim.ends[1]), splat(simd, aim.plane));
        let surely = [simd.splat_f64s(aim.margins[0]), simd.splat_f64s(aim.margins[1])];
        let perhaps = [simd.splat_f64s(-aim.margins[0]), simd.splat_f64s(-aim.margins[1])];
        let (nothing, infinite) = (simd.splat_f64s(0.0), simd.splat_f64s(f64::INFINITY));
        let (least, most) = (simd.splat_f64s(1.0 - aim.depth_error), simd.splat_f64s(1.0 + aim.depth_error));
        let number = simd.splat_f64s(number.into());
        for group in 0..self.directions.len() {
            let [x, y] = &self.directions[group];
            let (x, y) = (S::as_simd_f64s(x).0, S::as_simd_f64s(y).0);
            let Found { low, high, segment, rival } = &mut self.found;
            let low = S::as_mut_simd_f64s(&mut low[group]).0;
            let high = S::as_mut_simd_f64s(&mut high[group]).0;
            let winner = S::as_mut_simd_f64s(&mut segment[group]).0;
            let rival = S::as_mut_simd_f64s(&mut rival[group]).0;
            for i in 0..WIDE / S::F64_LANES {
                let beam = [x[i], y[i]];
                let (from_p, to_q) = (cross(simd, p, beam), cross(simd, beam, q));
                let inverse = dot(simd, plane, beam);
                let nearest = simd.mul_f64s(inverse, most);
                let mut meets = simd.and_m64s(
                    simd.greater_than_or_equal_f64s(from_p, perhaps[0]),
                    simd.greater_than_or_equal_f64s(to_q, perhaps[1]),
                );
                if aim.is_sure {
                    let farthest = simd.mul_f64s(inverse, least);
                    let within = simd.and_m64s(
                        simd.greater_than_or_equal_f64s(from_p, surely[0]),
                        simd.greater_than_or_equal_f64s(to_q, surely[1]),
                    );
                    let wins = simd.and_m64s(within, simd.greater_than_f64s(farthest, low[i]));
                    let other = simd.select_f64s(wins, high[i], simd.select_f64s(meets, nearest, nothing));
                    rival[i] = simd.max_f64s(rival[i], other);
                    low[i] = simd.select_f64s(wins, farthest, low[i]);
                    high[i] = simd.select_f64s(wins, nearest, high[i]);
                    winner[i] = simd.select_f64s(wins, number, winner[i]);
                    continue;
                }
                if aim.is_edge_on {
                    let turned = simd.and_m64s(
                        simd.less_than_or_equal_f64s(from_p, surely[0]),
                        simd.less_than_or_equal_f64s(to_q, surely[1]),
                    );
                    meets = simd.or_m64s(meets, turned);
                }
                let depth = if aim.is_anywhere { infinite } else { nearest };
                rival[i] = simd.max_f64s(rival[i], simd.select_f64s(meets, depth, nothing));
            }
        }
    }
}

/// A vector of two numbers in all lanes.
#[inline(always)]
fn splat<S: Simd>(simd: S, p: DVec2) -> [S::f64s; 2] {
    [simd.splat_f64s(p.x), simd.splat_f64s(p.y)]
}

/// Vector `i` of points, relative to a position.
#[inline(always)]
fn from<S: Simd>(simd: S, [x, y]: [&Eight; 2], i: usize, place: [S::f64s; 2]) -> [S::f64s; 2] {
    [simd.sub_f64s(S::as_simd_f64s(x).0[i], place[0]), simd.sub_f64s(S::as_simd_f64s(y).0[i], place[1])]
}

#[inline(always)]
fn dot<S: Simd>(simd: S, a: [S::f64s; 2], b: [S::f64s; 2]) -> S::f64s {
    simd.add_f64s(simd.mul_f64s(a[0], b[0]), simd.mul_f64s(a[1], b[1]))
}

#[inline(always)]
fn cross<S: Simd>(simd: S, a: [S::f64s; 2], b: [S::f64s; 2]) -> S::f64s {
    simd.sub_f64s(simd.mul_f64s(a[0], b[1]), simd.mul_f64s(a[1], b[0]))
}

/// Upper bound of the length of a vector.
#[inline(always)]
fn size<S: Simd>(simd: S, a: [S::f64s; 2]) -> S::f64s {
    // Pulp's abs is not inlined completely.
    let zero = simd.splat_f64s(0.0);
    simd.add_f64s(simd.max_f64s(a[0], simd.sub_f64s(zero, a[0])), simd.max_f64s(a[1], simd.sub_f64s(zero, a[1])))
}

/// A segment in the view of the scanner.
struct Aim {
    /// The ends relative to the scanner, counter-clockwise.
    ends: [DVec2; 2],
    /// Maximum errors of the ends, metres.
    margins: [f64; 2],
    /// The inverse range of a beam is the dot product of its direction with this.
    plane: DVec2,
    /// Relative error of inverse ranges.
    depth_error: f64,
    /// True if beams between the ends, away from them by more than the margins, meet it in every engine.
    is_sure: bool,
    /// True if the scanner's side of the plane is uncertain.
    is_edge_on: bool,
    /// True if its depth is unknown.
    is_anywhere: bool,
}

impl Aim {
    /// `None` if only its back is visible.
    #[inline(always)]
    fn new(segment: &Segment, view: &RowView) -> Option<Self> {
        let (p, q) = (segment.a - view.place, segment.b - view.place);
        let of = |x: f32| f64::from(x);
        // Upper bounds of the lengths, without a root.
        let (length_p, length_q) = (p.x.abs() + p.y.abs(), q.x.abs() + q.y.abs());
        let reach = length_p.max(length_q) + of(segment.extent);
        // Negative if the scanner is on the normal's side.
        let distance_off = segment.offset - segment.normal.dot(view.place);
        let error = view.margin * (of(segment.position) + reach * (ROUNDING + view.wobble));
        let off = error + of(segment.spread);
        if segment.touches {
            return Some(Self::touching(segment, view, of(segment.pad) + error));
        }
        if segment.one_sided && distance_off > off {
            return None;
        }
        let (apart, clearance) = (distance_off.abs(), of(segment.clearance));
        let margins = segment.slopes.map(|slope| error * (1.0 + of(slope)));
        let area = p.perp_dot(q);
        let is_edge_on = area.abs() <= 2.0 * (margins[0] * length_q + margins[1] * length_p) || apart <= 2.0 * off;
        let per_distance = 1.0 / distance_off;
        let depth_error = 2.0 * off * per_distance.abs();
        // All other edges are farther from the beam than their rounding.
        let inside = apart * of(segment.shortest) * clearance > 4.0 * error * reach * reach
            && apart * clearance > 8.0 * of(segment.spread) * reach
            && clearance > 2.0 * error;
        let faces = !segment.one_sided || distance_off < -off;
        let is_sure = apart > CLEAR * reach && depth_error < 1e-3 && inside && faces && !is_edge_on;
        let is_anywhere = is_edge_on || !(depth_error < 0.5);
        let (ends, margins) = if area < 0.0 { ([q, p], [margins[1], margins[0]]) } else { ([p, q], margins) };
        let plane = segment.normal * per_distance;
        Some(Self { ends, margins, plane, depth_error, is_sure, is_edge_on, is_anywhere })
    }

    /// The maximum inverse range at which a beam may meet it.
    fn nearest(&self, beam: DVec2) -> f64 {
        let [from_p, to_q] = [self.ends[0].perp_dot(beam), beam.perp_dot(self.ends[1])];
        let meets = from_p >= -self.margins[0] && to_q >= -self.margins[1];
        let turned = self.is_edge_on && from_p <= self.margins[0] && to_q <= self.margins[1];
        match meets || turned {
            true if self.is_anywhere => f64::INFINITY,
            true => self.plane.dot(beam) * (1.0 + self.depth_error),
            false => f64::NEG_INFINITY,
        }
    }

    /// A polygon that touches the height somewhere within `slack` metres of its segment.
    #[cold]
    #[inline(never)]
    fn touching(segment: &Segment, view: &RowView, slack: f64) -> Self {
        let (p, q) = (segment.a - view.place, segment.b - view.place);
        let near = distance(DVec2::ZERO, [p, q]);
        let far = p.length().max(q.length());
        // The error of an end grows with the ratio of its distance to that of the nearest point.
        let margin = if near > 2.0 * slack { slack * (1.0 + far / (near - slack)) } else { f64::INFINITY };
        let area = p.perp_dot(q);
        let is_edge_on = area.abs() <= 2.0 * margin * (p.length() + q.length());
        let ends = if area < 0.0 { [q, p] } else { [p, q] };
        let plane = DVec2::ZERO;
        Self { ends, margins: [margin; 2], plane, depth_error: 0.0, is_sure: false, is_edge_on, is_anywhere: true }
    }
}
