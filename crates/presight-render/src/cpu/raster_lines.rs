//! Spans: one interval of samples per polygon and line, then inverse depth along it (paper section 3.2, Fig. 6).

use super::Bands;
use super::batch::{Batch, NOTHING, PolygonSetup};
use super::cull::{self, TILE};
use presight_model::error::Result;
use presight_model::memory;
use presight_model::sensor::{LineAxis, LineGrid, Octet};
use pulp::Simd;
use std::ops::Range;

/// Number of samples processed together, and the unit of a z-buffer's lines.
pub(super) const EIGHT: usize = Octet::LEN;

/// Inverse depths of eight samples of a line.
#[derive(Clone, Copy, Debug)]
#[repr(align(64))]
pub(super) struct Depths(pub [f64; EIGHT]);

/// Winners of eight samples of a line, as wide as the depths so that one mask serves both.
#[derive(Clone, Copy, Debug)]
#[repr(align(64))]
pub(super) struct Numbers(pub [u64; EIGHT]);

/// The z-buffer of a band in octets of a line. Octets with neighbouring places in the image are neighbours: if lines
/// are image rows, the octets of a line, otherwise the octets with the same samples on neighbouring lines. If lines
/// have few samples, an octet is one sample of eight neighbouring lines.
#[derive(Default)]
pub(super) struct Buffer {
    /// 1 / depth in the frame of the rays: 0 without a polygon, and infinite past the end of a line, where no polygon
    /// is drawn.
    pub inverse: Vec<Depths>,
    /// Number of the polygon in [`super::batch::Winners`].
    pub winner: Vec<Numbers>,
    /// Steps from a line to the next, and from an octet to the next on its line.
    pub per_line: usize,
    pub per_octet: usize,
    /// Number of samples of a line if there are few, so that octets go across lines.
    pub few: Option<usize>,
    /// Minimum inverse depth of every tile, see [`super::cull`], in rows of whole eights. Past the end of a row the
    /// value hides no polygon.
    farthest: Vec<[f64; EIGHT]>,
    /// Number of eights in a row of tiles.
    eights: usize,
}

impl Buffer {
    /// Steps from a line to the next and from an octet to the next on its line, and the number of octets.
    fn layout(axis: LineAxis, lines: usize, samples: usize) -> [usize; 3] {
        let octets = samples.div_ceil(EIGHT);
        match axis {
            LineAxis::Columns if samples <= FEW => [0, 0, samples * lines.div_ceil(EIGHT)],
            LineAxis::Rows => [octets, 1, octets * lines],
            // Odd, so that a line spreads over all sets of the cache.
            LineAxis::Columns => [1, lines | 1, octets * (lines | 1)],
        }
    }

    /// Bytes of memory held.
    pub fn bytes(&self) -> u64 {
        (size_of::<Depths>() * self.inverse.capacity() + size_of::<Numbers>() * self.winner.capacity()) as u64
    }

    /// Reserves the memory for [`Buffer::clear`].
    ///
    /// # Errors
    /// [`presight_model::ErrorKind::System`] if the system refuses it.
    pub fn reserve(&mut self, axis: LineAxis, lines: usize, samples: usize) -> Result<()> {
        let [_, _, size] = Self::layout(axis, lines, samples);
        memory::reserve(&mut self.inverse, size)?;
        memory::reserve(&mut self.winner, size)
    }

    /// Removes all polygons.
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

    /// Sets the minimum inverse depths of all tiles.
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

    /// Minimum inverse depth of a tile.
    #[inline(always)]
    pub fn farthest_of(&mut self, row: usize, column: usize) -> &mut f64 {
        &mut self.farthest[row * self.eights + column / EIGHT][column % EIGHT]
    }

    /// Minimum inverse depths of eight neighbouring tiles.
    #[inline(always)]
    pub fn farthest_of_eight(&self, row: usize, eight: usize) -> &[f64; EIGHT] {
        &self.farthest[row * self.eights + eight]
    }

    /// Minimum inverse depths of a row of tiles.
    #[inline(always)]
    pub fn farthest_of_row(&self, row: usize) -> &[f64] {
        self.farthest[row * self.eights..(row + 1) * self.eights].as_flattened()
    }

    /// True if a polygon lies behind the content of the tiles on some lines.
    #[inline(always)]
    fn hides(&self, polygon: &PolygonSetup, lines: Range<usize>) -> bool {
        let columns = polygon.first_sample as usize / TILE..(polygon.end_sample as usize).div_ceil(TILE);
        let mut rows = lines.start / TILE..lines.end.div_ceil(TILE);
        polygon.nearest_inverse < f64::INFINITY
            && rows.all(|row| self.farthest_of_row(row)[columns.clone()].iter().all(|&k| k > polygon.nearest_inverse))
    }

    /// The octet that holds a sample, and the sample's lane.
    #[inline(always)]
    pub fn place(&self, line: usize, sample: usize) -> (usize, usize) {
        match self.few {
            Some(samples) => (line / EIGHT * samples + sample, line % EIGHT),
            None => (self.at(line, sample / EIGHT), sample % EIGHT),
        }
    }

    /// Index of an octet of a line.
    #[inline(always)]
    pub fn at(&self, line: usize, octet: usize) -> usize {
        line * self.per_line + octet * self.per_octet
    }
}

/// The tiles of a band are measured again within a wave after this number of octets were drawn per octet of the band.
const STALE: usize = 2;

/// Maximum number of samples of a scanner's column for octets across columns.
const FEW: usize = 4;

/// Draws the polygons of some batches into a band. Returns the numbers of tested samples and of spans.
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
            for first in (start..end).step_by(EIGHT) {
                let count = EIGHT.min(end - first);
                let [c0, c1] = grid.eight_lines(first);
                let bounds = bounds_of_lines(polygon.edge_counts(), edges, c0, c1);
                let mut scale = [0.0; EIGHT];
                for l in 0..EIGHT {
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

/// Draws a polygon on some lines of few samples. `band` is the first line of the band, which begins with whole octets.
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
        let mut scale = [0.0; EIGHT];
        for l in 0..EIGHT {
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

/// Positions t where the polygon's cone begins and ends on [`EIGHT`] lines.
#[inline(always)]
pub(super) fn bounds_of_lines(
    [lower, upper, steep]: [u8; 3],
    edges: &[[f64; 2]],
    a: &[f64; EIGHT],
    b: &[f64; EIGHT],
) -> [[f64; EIGHT]; 2] {
    let (lower, rest) = edges.split_at(usize::from(lower));
    let (upper, rest) = rest.split_at(usize::from(upper));
    let mut least = [f64::NEG_INFINITY; EIGHT];
    let mut greatest = [f64::INFINITY; EIGHT];
    for e in lower {
        for l in 0..EIGHT {
            let t = e[0] * a[l] + e[1] * b[l];
            least[l] = if t > least[l] { t } else { least[l] };
        }
    }
    for e in upper {
        for l in 0..EIGHT {
            let t = e[0] * a[l] + e[1] * b[l];
            greatest[l] = if t < greatest[l] { t } else { greatest[l] };
        }
    }
    for e in &rest[..usize::from(steep)] {
        for l in 0..EIGHT {
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
    /// Number of lines.
    count: usize,
    /// Positions where it begins and ends on them.
    bounds: [[f64; EIGHT]; 2],
    /// Coefficients of its inverse depth, `scale w0 + slope w1`.
    scale: [f64; EIGHT],
    slope: f64,
    /// Index of the first line in the band.
    first: usize,
}

impl Spans {
    /// Draws into whole octets, keeping the samples outside the spans, and counts the octets. Returns true if the
    /// buffer held a bit-equal depth anywhere.
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
                // `max`, because a select before a store would become a masked store. The winners are written in the
                // same manner.
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

    /// [`Spans::draw`] for a buffer whose octets go across lines. Eight of them are drawn together.
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

    /// Gives samples with bit-equal inverse depths to the lower slot.
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
