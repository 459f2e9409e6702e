//! Batches: polygons after setup, binned by band.

use super::Bands;
use crate::limits;
use crate::plan::Run;
use glam::DVec3;
use std::ops::Range;

/// A polygon that may cover a ray.
#[derive(Clone, Copy, Debug)]
pub(super) struct SetUp {
    /// Inverse depth of a ray s is m . s, in the line frame (image frame for ray tables).
    pub m: DVec3,
    /// Lines it may cover.
    pub first_line: u32,
    pub end_line: u32,
    /// Its bounds `t >= p c0 + q c1`, then `t <= p c0 + q c1`, then sign tests, in [`Batch::bounds`].
    pub first_edge: u32,
    pub lower: u8,
    pub upper: u8,
    pub steep: u8,
    /// Decides ties.
    pub slot: u32,
}

/// What the resolve stage needs of a winner.
#[derive(Clone, Copy, Debug)]
pub(super) struct Shade {
    /// Distance of the plane from the sensor: cos_incidence = inverse range x this.
    pub distance: f64,
    pub polygon_id: u32,
    pub object_id: u32,
}

/// Polygons of some runs after setup.
#[derive(Debug, Default)]
pub(super) struct Batch {
    pub polygons: Vec<SetUp>,
    /// By polygon, apart: together they stay in the cache while an image is resolved.
    pub shades: Vec<Shade>,
    /// Line grids: (p, q) or, steep, the first two of an edge plane.
    pub bounds: Vec<[f64; 2]>,
    /// Ray tables: edge planes.
    pub edges: Vec<DVec3>,
    pub edge_on: usize,
    /// Polygons by band: `by_band[band_start[b]..band_start[b + 1]]`.
    by_band: Vec<u32>,
    band_start: Vec<u32>,
}

/// Bits of a winner's number that name the polygon inside its batch.
const INDEX_BITS: u32 = 12;
/// No winner.
pub(super) const NOTHING: u32 = 0;
/// What is seen there.
static NOTHING_SEEN: [Shade; 1] = [Shade { distance: f64::NAN, polygon_id: 0, object_id: 0 }];

impl Batch {
    pub fn clear(&mut self) {
        self.polygons.clear();
        self.shades.clear();
        self.bounds.clear();
        self.edges.clear();
        self.edge_on = 0;
    }

    /// Sorts the polygons into bands, keeping their order.
    pub fn bin(&mut self, bands: &Bands) {
        let touched = |p: &SetUp| bands.touched(p.first_line as usize..p.end_line as usize);
        self.band_start.clear();
        self.band_start.resize(bands.count() + 1, 0);
        for band in self.polygons.iter().flat_map(touched) {
            self.band_start[band + 1] += 1;
        }
        for band in 0..bands.count() {
            self.band_start[band + 1] += self.band_start[band];
        }
        self.by_band.clear();
        self.by_band.resize(self.band_start[bands.count()] as usize, 0);
        // Fill from each band's start, then shift the starts back.
        for (i, polygon) in self.polygons.iter().enumerate() {
            for band in touched(polygon) {
                self.by_band[self.band_start[band] as usize] = i as u32;
                self.band_start[band] += 1;
            }
        }
        for band in (1..=bands.count()).rev() {
            self.band_start[band] = self.band_start[band - 1];
        }
        self.band_start[0] = 0;
    }

    /// Polygons that may touch a band.
    pub fn in_band(&self, band: usize) -> &[u32] {
        &self.by_band[self.band_start[band] as usize..self.band_start[band + 1] as usize]
    }
}

/// The number under which a polygon of a batch wins a ray.
#[inline(always)]
pub(super) fn winner(batch: usize, polygon: u32) -> u32 {
    (batch as u32 + 1) << INDEX_BITS | polygon
}

/// The slot of the polygon behind a winner's number, which is not [`NOTHING`].
pub(super) fn slot(batches: &[Batch], winner: u32) -> u32 {
    batches[(winner >> INDEX_BITS) as usize - 1].polygons[(winner & ((1 << INDEX_BITS) - 1)) as usize].slot
}

/// The shades of all batches, for [`look_up`].
pub(super) fn tables(batches: &[Batch]) -> Vec<&[Shade]> {
    std::iter::once(&NOTHING_SEEN[..]).chain(batches.iter().map(|b| b.shades.as_slice())).collect()
}

/// What is seen of a winner, [`NOTHING`] too.
#[inline(always)]
pub(super) fn look_up<'a>(tables: &[&'a [Shade]], winner: u32) -> &'a Shade {
    &tables[(winner >> INDEX_BITS) as usize][(winner & ((1 << INDEX_BITS) - 1)) as usize]
}

/// Most batches that winners can number.
pub(super) const MAX_BATCHES: usize = (1 << (32 - INDEX_BITS)) - 1;

/// Cuts runs into groups of about five hundred polygons, one batch each.
pub(super) fn group_runs(runs: &[Run]) -> Vec<Range<usize>> {
    const TARGET: usize = 512;
    // A polygon over the azimuth seam is set up twice; every number must fit.
    const _: () = assert!(2 * (TARGET + limits::CLUSTER_POLYGONS) <= 1 << INDEX_BITS);
    let mut groups = Vec::new();
    let (mut start, mut polygons) = (0, 0);
    for (i, run) in runs.iter().enumerate() {
        polygons += run.count as usize;
        if polygons >= TARGET || i + 1 == runs.len() {
            groups.push(start..i + 1);
            (start, polygons) = (i + 1, 0);
        }
    }
    groups
}
