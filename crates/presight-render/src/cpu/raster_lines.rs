//! Spans: one interval of samples per polygon and line, then inverse depth along it (paper section 3.2, Fig. 6).

use super::Bands;
use super::batch::{Batch, NOTHING, PolygonSetup};
use super::cull::{self, TILE};
use presight_model::error::Result;
use presight_model::memory;
use presight_model::sensor::{LineAxis, LineGrid, Octet};
use pulp::Simd;
use std::ops::Range;

/// Samples taken together, and the unit in which the lines of a z-buffer are kept.
pub(super) const EIGHT: usize = Octet::LEN;

/// Inverse depths of eight samples of a line.
#[derive(Clone, Copy, Debug)]
#[repr(align(64))]
pub(super) struct Depths(pub [f64; EIGHT]);

/// Winners of eight samples of a line, as wide as the depths so that one mask serves both.
#[derive(Clone, Copy, Debug)]
#[repr(align(64))]
pub(super) struct Numbers(pub [u64; EIGHT]);

/// The z-buffer of a band in octets of a line. Octets that go to the same place in an image are neighbours: those of a
/// line where lines are rows, else those with the same samples on neighbouring lines. Where lines have few samples, an octet is one
/// sample of eight neighbouring lines.
#[derive(Default)]
pub(super) struct Buffer {
    /// 1 / depth in the frame of the rays; 0 is nothing, and infinite past the end of a line, where nothing is drawn.
    pub inverse: Vec<Depths>,
    /// The polygon that is there, by its number in [`super::batch::Winners`].
    pub winner: Vec<Numbers>,
    /// From a line to the next one, and from an octet to the next one on its line.
    pub per_line: usize,
    pub per_octet: usize,
    /// Samples of a line where they are few, and octets go across lines.
    pub few: Option<usize>,
    /// Least inverse depth of every tile, see [`super::cull`]; rows of them in whole eights, past the end of which nothing is
    /// hidden behind less than everything.
    farthest: Vec<[f64; EIGHT]>,
    /// Eights of tiles in a row of them.
    eights: usize,
}

impl Buffer {
    /// From a line to the next one, from an octet to the next one on its line, and the octets in all.
    fn layout(axis: LineAxis, lines: usize, samples: usize) -> [usize; 3] {
        let octets = samples.div_ceil(EIGHT);
        match axis {
            LineAxis::Columns if samples <= FEW => [0, 0, samples * lines.div_ceil(EIGHT)],
            LineAxis::Rows => [octets, 1, octets * lines],
            // Odd, so that a line is spread over all sets of the cache.
            LineAxis::Columns => [1, lines | 1, octets * (lines | 1)],
        }
    }

    /// Bytes of memory held.
    pub fn bytes(&self) -> u64 {
        (size_of::<Depths>() * self.inverse.capacity() + size_of::<Numbers>() * self.winner.capacity()) as u64
    }

    /// Takes the memory that [`Buffer::clear`] needs.
    ///
    /// # Errors
    /// [`presight_model::ErrorKind::System`] if the system refuses it.
    pub fn reserve(&mut self, axis: LineAxis, lines: usize, samples: usize) -> Result<()> {
        let [_, _, size] = Self::layout(axis, lines, samples);
        memory::reserve(&mut self.inverse, size)?;
        memory::reserve(&mut self.winner, size)
    }

    /// Nothing drawn yet.
    pub fn clear(&mut self, axis: LineAxis, lines: usize, samples: usize) {
        let octets = samples.div_ceil(EIGHT);
        let size;
        [self.per_line, self.per_octet, size] = Self::layout(axis, lines, samples);
        self.inverse.clear();
        self.inverse.resize(size, Depths([0.0; EIGHT]));
        self.winner.clear();
        self.winner.resize(size, Numbers([NOTHING.into(); EIGHT]));
        self.few = (axis == LineAxis::Columns && samples <= FEW).then_some(samples);
        if let Some(samples) = self.few {
            if !lines.is_multiple_of(EIGHT) {
                let last = size - samples;
                self.inverse[last..].iter_mut().for_each(|octet| octet.0[lines % EIGHT..].fill(f64::INFINITY));
            }
            return;
        }
        if !samples.is_multiple_of(EIGHT) {
            for line in 0..lines {
                let last = self.at(line, octets - 1);
                self.inverse[last].0[samples % EIGHT..].fill(f64::INFINITY);
            }
        }
    }

    /// Least inverse depths for all tiles.
    pub fn clear_farthest(&mut self, lines: usize, samples: usize, inverse: f64) {
        let across = samples.div_ceil(TILE);
        self.eights = across.div_ceil(EIGHT);
        self.farthest.clear();
        self.farthest.resize(self.eights * lines.div_ceil(TILE), [inverse; EIGHT]);
        if !across.is_multiple_of(EIGHT) {
            for row in self.farthest.chunks_mut(self.eights) {
                row[across / EIGHT][across % EIGHT..].fill(f64::INFINITY);
            }
        }
    }

    /// Least inverse depth of a tile.
    #[inline(always)]
    pub fn farthest_of(&mut self, row: usize, column: usize) -> &mut f64 {
        &mut self.farthest[row * self.eights + column / EIGHT][column % EIGHT]
    }

    /// Least inverse depths of eight tiles side by side.
    #[inline(always)]
    pub fn farthest_of_eight(&self, row: usize, eight: usize) -> &[f64; EIGHT] {
        &self.farthest[row * self.eights + eight]
    }

    /// Least inverse depths of a row of tiles.
    #[inline(always)]
    pub fn farthest_of_row(&self, row: usize) -> &[f64] {
        self.farthest[row * self.eights..(row + 1) * self.eights].as_flattened()
    }

    /// True if a polygon lies behind what the tiles of some lines are known to hold.
    #[inline(always)]
    fn hides(&self, polygon: &PolygonSetup, lines: Range<usize>) -> bool {
        let columns = polygon.first_sample as usize / TILE..(polygon.end_sample as usize).div_ceil(TILE);
        let mut rows = lines.start / TILE..lines.end.div_ceil(TILE);
        polygon.nearest_inverse < f64::INFINITY
            && rows.all(|row| self.farthest_of_row(row)[columns.clone()].iter().all(|&k| k > polygon.nearest_inverse))
    }

    /// The octet that holds a sample, and where in it.
    #[inline(always)]
    pub fn place(&self, line: usize, sample: usize) -> (usize, usize) {
        match self.few {
            Some(samples) => (line / EIGHT * samples + sample, line % EIGHT),
            None => (self.at(line, sample / EIGHT), sample % EIGHT),
        }
    }

    /// Where an octet of a line is.
    #[inline(always)]
    pub fn at(&self, line: usize, octet: usize) -> usize {
        line * self.per_line + octet * self.per_octet
    }
}

/// After so many octets drawn for each of a band, what its tiles hold is measured again within a wave.
const STALE: usize = 2;

/// Samples of a scanner's column up to which octets go across columns.
const FEW: usize = 4;

/// Lines whose intervals are found together.
const TOGETHER: usize = 8;

/// Draws the polygons of some batches into a band. Returns how many samples were tested, and in how many spans.
#[inline(always)]
pub(super) fn rasterize<S: Simd>(
    simd: S,
    buffer: &mut Buffer,
    grid: &LineGrid,
    batches: &[Batch],
    slots: &[u32],
    bands: &Bands,
    band: usize,
) -> [u64; 2] {
    let lines = bands.lines(band);
    let (mut octets, mut spans_drawn, mut measured) = (0, 0, 0);
    for batch in batches {
        for &i in batch.in_band(band) {
            let polygon = &batch.polygons[i as usize];
            let edges = &batch.bounds[polygon.first_edge as usize..];
            let number = batch.first_number + i;
            let start = lines.start.max(polygon.first_line as usize);
            let end = lines.end.min(polygon.end_line as usize);
            if octets > measured + STALE * buffer.inverse.len() {
                cull::measure(buffer, lines.len(), bands.samples);
                measured = octets;
            }
            if buffer.hides(polygon, start - lines.start..end - lines.start) {
                continue;
            }
            if buffer.few.is_some() {
                let bounded = BoundedPolygon { polygon, edges, number };
                draw_across(simd, buffer, grid, &bounded, start..end, lines.start, slots);
                let eights = end.div_ceil(EIGHT).saturating_sub(start / EIGHT);
                octets += eights * grid.weights().len();
                spans_drawn += end.saturating_sub(start);
                continue;
            }
            for first in (start..end).step_by(TOGETHER) {
                let count = TOGETHER.min(end - first);
                let [c0, c1] = grid.eight_lines(first);
                let bounds = bounds_of_lines(polygon.edge_counts(), edges, c0, c1);
                let mut scale = [0.0; TOGETHER];
                for l in 0..TOGETHER {
                    scale[l] = polygon.m.x * c0[l] + polygon.m.y * c1[l];
                }
                let spans = Spans { number, count, bounds, scale, slope: polygon.m.z, first: first - lines.start };
                if spans.draw(simd, buffer, grid, (&mut octets, &mut spans_drawn)) {
                    spans.settle_ties(buffer, grid, slots);
                }
            }
        }
    }
    [octets * EIGHT, spans_drawn].map(|count| count as u64)
}

/// A polygon with its edges and its number in the frame.
struct BoundedPolygon<'a> {
    polygon: &'a PolygonSetup,
    edges: &'a [[f64; 2]],
    number: u32,
}

/// Draws a polygon on some lines of few samples; `band` is the first line of the band, which begins with whole octets.
#[inline(always)]
fn draw_across<S: Simd>(
    simd: S,
    buffer: &mut Buffer,
    grid: &LineGrid,
    bounded: &BoundedPolygon<'_>,
    lines: Range<usize>,
    band: usize,
    slots: &[u32],
) {
    let BoundedPolygon { polygon, edges, number } = *bounded;
    for first in (lines.start / EIGHT * EIGHT..lines.end).step_by(EIGHT) {
        let [c0, c1] = grid.eight_lines(first);
        let mut bounds = bounds_of_lines(polygon.edge_counts(), edges, c0, c1);
        let mut scale = [0.0; TOGETHER];
        for l in 0..TOGETHER {
            scale[l] = polygon.m.x * c0[l] + polygon.m.y * c1[l];
        }
        if first < lines.start || lines.end < first + EIGHT {
            for l in (first..first + EIGHT).filter(|l| !lines.contains(l)) {
                bounds[1][l - first] = f64::NEG_INFINITY;
            }
        }
        let spans = Spans { number, count: EIGHT, bounds, scale, slope: polygon.m.z, first: first - band };
        if spans.draw_across(simd, buffer, grid) {
            spans.settle_ties(buffer, grid, slots);
        }
    }
}

/// Where the polygon's cone begins and ends on [`TOGETHER`] lines, as positions t.
#[inline(always)]
pub(super) fn bounds_of_lines(
    [lower, upper, steep]: [u8; 3],
    edges: &[[f64; 2]],
    a: &[f64; TOGETHER],
    b: &[f64; TOGETHER],
) -> [[f64; TOGETHER]; 2] {
    let (lower, rest) = edges.split_at(usize::from(lower));
    let (upper, rest) = rest.split_at(usize::from(upper));
    let mut least = [f64::NEG_INFINITY; TOGETHER];
    let mut greatest = [f64::INFINITY; TOGETHER];
    for e in lower {
        for l in 0..TOGETHER {
            let t = e[0] * a[l] + e[1] * b[l];
            least[l] = if t > least[l] { t } else { least[l] };
        }
    }
    for e in upper {
        for l in 0..TOGETHER {
            let t = e[0] * a[l] + e[1] * b[l];
            greatest[l] = if t < greatest[l] { t } else { greatest[l] };
        }
    }
    for e in &rest[..usize::from(steep)] {
        for l in 0..TOGETHER {
            greatest[l] = if e[0] * a[l] + e[1] * b[l] < 0.0 { f64::NEG_INFINITY } else { greatest[l] };
        }
    }
    [least, greatest]
}

/// True if any lane is not zero.
#[inline(always)]
fn any_of<S: Simd>(_: S, lanes: S::u64s) -> bool {
    let mut all = [0; EIGHT];
    S::as_mut_simd_u64s(&mut all).0[0] = lanes;
    all.iter().fold(0, |any, lane| any | lane) != 0
}

/// A polygon on some lines.
struct Spans {
    number: u32,
    /// Lines.
    count: usize,
    /// Where it begins and ends on them.
    bounds: [[f64; TOGETHER]; 2],
    /// Its inverse depth is `scale w0 + slope w1`.
    scale: [f64; TOGETHER],
    slope: f64,
    /// First line in the band.
    first: usize,
}

impl Spans {
    /// Draws into whole octets, whose samples outside the spans stay as they are, and counts them. The answer is true if anywhere
    /// the buffer held the same depth.
    #[inline(always)]
    fn draw<S: Simd>(
        &self,
        simd: S,
        buffer: &mut Buffer,
        grid: &LineGrid,
        (tested, drawn): (&mut usize, &mut usize),
    ) -> bool {
        let octets = grid.octets();
        let [least, greatest] = &self.bounds;
        let samples = grid.samples_around(simd, least, greatest);
        let (number, slope) = (simd.splat_u64s(self.number.into()), simd.splat_f64s(self.slope));
        let (none, all, nowhere) = (simd.splat_u64s(0), simd.splat_u64s(u64::MAX), simd.splat_f64s(-1.0));
        let mut ties = none;
        for l in 0..self.count {
            let (from, to) = (samples[0][l] as usize, samples[1][l] as usize);
            if from >= to {
                continue;
            }
            let (from, to) = (from / EIGHT, to.div_ceil(EIGHT));
            *tested += to - from;
            *drawn += 1;
            let line = (self.first + l) * buffer.per_line;
            let (low, high) = (simd.splat_f64s(least[l]), simd.splat_f64s(greatest[l]));
            let scale = simd.splat_f64s(self.scale[l]);
            for (o, octet) in (from..to).zip(&octets[from..to]) {
                let at = line + o * buffer.per_octet;
                let inverse = S::as_mut_simd_f64s(&mut buffer.inverse[at].0).0;
                let winners = S::as_mut_simd_u64s(&mut buffer.winner[at].0).0;
                let (w0, w1) = (S::as_simd_f64s(&octet.w0).0, S::as_simd_f64s(&octet.w1).0);
                let t = S::as_simd_f64s(&octet.t).0;
                // A maximum, for a select before a store becomes a masked store (as that of the winners, written as it may be).
                for i in 0..EIGHT / S::F64_LANES {
                    let k = simd.add_f64s(simd.mul_f64s(scale, w0[i]), simd.mul_f64s(slope, w1[i]));
                    let inside = simd
                        .and_m64s(simd.greater_than_or_equal_f64s(t[i], low), simd.less_than_or_equal_f64s(t[i], high));
                    let k = simd.select_f64s(inside, k, nowhere);
                    let before = inverse[i];
                    let nearer = simd.select_u64s(simd.greater_than_f64s(k, before), all, none);
                    ties = simd.select_u64s(simd.equal_f64s(k, before), all, ties);
                    inverse[i] = simd.max_f64s(k, before);
                    winners[i] = simd.xor_u64s(winners[i], simd.and_u64s(simd.xor_u64s(winners[i], number), nearer));
                }
            }
        }
        any_of(simd, ties)
    }

    /// As [`Spans::draw`], where the buffer's octets go across lines; eight of them are drawn together.
    #[inline(always)]
    fn draw_across<S: Simd>(&self, simd: S, buffer: &mut Buffer, grid: &LineGrid) -> bool {
        let [least, greatest] = self.bounds.each_ref().map(|t| S::as_simd_f64s(t).0);
        let scale = S::as_simd_f64s(&self.scale).0;
        let (number, slope) = (simd.splat_u64s(self.number.into()), simd.splat_f64s(self.slope));
        let (none, all, nowhere) = (simd.splat_u64s(0), simd.splat_u64s(u64::MAX), simd.splat_f64s(-1.0));
        let mut ties = none;
        for (sample, (&t, &[w0, w1])) in grid.positions().iter().zip(grid.weights()).enumerate() {
            let (at, _) = buffer.place(self.first, sample);
            let inverse = S::as_mut_simd_f64s(&mut buffer.inverse[at].0).0;
            let winners = S::as_mut_simd_u64s(&mut buffer.winner[at].0).0;
            let (t, w0, from_slope) =
                (simd.splat_f64s(t), simd.splat_f64s(w0), simd.mul_f64s(slope, simd.splat_f64s(w1)));
            for i in 0..EIGHT / S::F64_LANES {
                let k = simd.add_f64s(simd.mul_f64s(scale[i], w0), from_slope);
                let inside = simd.and_m64s(
                    simd.greater_than_or_equal_f64s(t, least[i]),
                    simd.less_than_or_equal_f64s(t, greatest[i]),
                );
                let k = simd.select_f64s(inside, k, nowhere);
                let before = inverse[i];
                let nearer = simd.select_u64s(simd.greater_than_f64s(k, before), all, none);
                ties = simd.select_u64s(simd.equal_f64s(k, before), all, ties);
                inverse[i] = simd.max_f64s(k, before);
                winners[i] = simd.xor_u64s(winners[i], simd.and_u64s(simd.xor_u64s(winners[i], number), nearer));
            }
        }
        any_of(simd, ties)
    }

    /// On bit-equal inverse depth the lower slot wins.
    #[cold]
    #[inline(never)]
    fn settle_ties(&self, buffer: &mut Buffer, grid: &LineGrid, slots: &[u32]) {
        let octets = grid.octets();
        let own = slots[self.number as usize];
        for l in 0..self.count {
            let span = self.bounds[0][l]..=self.bounds[1][l];
            let from = grid.samples_below(*span.start());
            for sample in from..grid.samples_up_to(*span.end()) {
                let (octet, i) = (sample / EIGHT, sample % EIGHT);
                let k = self.scale[l] * octets[octet].w0[i] + self.slope * octets[octet].w1[i];
                let (at, i) = buffer.place(self.first + l, sample);
                let winner = &mut buffer.winner[at].0[i];
                let drawn = *winner != u64::from(NOTHING);
                if drawn && k == buffer.inverse[at].0[i] && own < slots[*winner as usize] {
                    *winner = self.number.into();
                }
            }
        }
    }
}
