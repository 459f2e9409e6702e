//! Batches: polygons after setup, binned by band.

use super::Bands;
use crate::plan::Run;
use glam::DVec3;
use std::ops::Range;

/// A polygon that may cover a ray.
#[derive(Clone, Copy, Debug)]
pub(super) struct PolygonSetup {
    /// Inverse depth of a ray s is m . s, in the line frame (image frame for ray tables).
    pub m: DVec3,
    /// Line grids: upper bound of its inverse depth; infinite if unknown.
    pub nearest_inverse: f64,
    /// Lines it may cover.
    pub first_line: u32,
    pub end_line: u32,
    /// Samples that it may cover on them.
    pub first_sample: u32,
    pub end_sample: u32,
    /// Its bounds `t >= p c0 + q c1`, then `t <= p c0 + q c1`, then sign tests, in [`Batch::bounds`].
    pub first_edge: u32,
    pub lower: u8,
    pub upper: u8,
    pub steep: u8,
}

impl PolygonSetup {
    /// Lower bounds, upper ones, and sign tests.
    #[inline(always)]
    pub fn edge_counts(&self) -> [u8; 3] {
        [self.lower, self.upper, self.steep]
    }
}

/// Data of a winner for the resolve stage.
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
    pub polygons: Vec<PolygonSetup>,
    /// By polygon, until [`Winners::number`] moves them.
    pub shades: Vec<Shade>,
    pub slots: Vec<u32>,
    /// Polygon i wins rays as number `first_number + i`.
    pub first_number: u32,
    /// Line grids: (p, q) or, steep, the first two of an edge plane.
    pub bounds: Vec<[f64; 2]>,
    /// Ray tables: edge planes.
    pub edges: Vec<DVec3>,
    /// Polygons whose vertices were placed among the samples.
    pub placed: usize,
    /// Placed polygons that may cover a sample.
    pub passed: usize,
    /// Passed polygons that were bounded one by one, because the positions of their vertices did not suffice.
    pub bounded: usize,
    pub edge_on: usize,
    /// Polygons left out because they lie between samples.
    pub between: usize,
    /// Lower bound of the polygons' distances, metres.
    pub nearest: f32,
    /// False if the time was up before its setup.
    pub is_set_up: bool,
    /// Pixels of the boxes around its polygons' images; only in the first wave, with a deadline.
    pub pixels: u64,
    /// Polygons by band: `by_band[band_start[b]..band_start[b + 1]]`.
    by_band: Vec<u32>,
    band_start: Vec<u32>,
}

/// The number of no polygon.
pub(super) const NOTHING: u32 = 0;

/// All polygons that were set up for a frame, by the numbers under which they win rays.
#[derive(Debug, Default)]
pub(super) struct Winners {
    /// Data for the resolve stage, in one table, which stays in the cache while an image is resolved.
    pub shades: Vec<Shade>,
    /// The slots decide ties.
    pub slots: Vec<u32>,
}

impl Winners {
    /// Removes all polygons but [`NOTHING`], which has no visible surface.
    pub fn clear(&mut self) {
        self.shades.clear();
        self.shades.push(Shade { distance: f64::NAN, polygon_id: 0, object_id: 0 });
        self.slots.clear();
        self.slots.push(0);
    }

    /// Adds a polygon and returns its number.
    #[inline]
    pub fn push(&mut self, shade: Shade, slot: u32) -> u32 {
        self.shades.push(shade);
        self.slots.push(slot);
        self.slots.len() as u32 - 1
    }

    /// Numbers a batch's polygons.
    pub fn number(&mut self, batch: &mut Batch) {
        batch.first_number = self.shades.len() as u32;
        self.shades.extend_from_slice(&batch.shades);
        self.slots.extend_from_slice(&batch.slots);
    }
}

impl Batch {
    pub fn clear(&mut self) {
        self.polygons.clear();
        self.shades.clear();
        self.slots.clear();
        self.bounds.clear();
        self.edges.clear();
        (self.placed, self.passed, self.bounded) = (0, 0, 0);
        (self.edge_on, self.between) = (0, 0);
    }

    /// Sorts the polygons into bands, keeping their order.
    pub fn bin(&mut self, bands: &Bands) {
        let touched = |p: &PolygonSetup| bands.touched(p.first_line as usize..p.end_line as usize);
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

/// Cuts runs into groups of about five hundred polygons, one batch each.
pub(super) fn group_runs(runs: &[Run]) -> Vec<Range<usize>> {
    const TARGET: usize = 512;
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
