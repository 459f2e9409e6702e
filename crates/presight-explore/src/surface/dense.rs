//! Surfaces of dense views: surfels, regions on planes, outlines, and the pieces that the views confirm.

use super::found::Surfaces;
use super::mirror::without_images;
use super::options::ExploreOptions;
use super::outline::{Areas, Outline, OutlineOptions, Piece, Planes, outlines};
use super::region::{Regions, SPREAD};
use super::sheet::sheets;
use super::solid::{PixelCounts, Solid, refitted, verdicts};
use crate::observe::{Views, are_sparse};
use crate::surfels::{Detail, MIN_SIZE, Surface, Surfel, merged, permanent, surfels};
use presight_model::error::Result;
use presight_model::threads::Threads;
use presight_predict::predict::Predictor;
use rayon::prelude::*;
use std::collections::BTreeSet;

/// Number of planes for each polygon: an outline takes several convex polygons.
const PLANES: f64 = 0.35;
/// Minimum number of pixels that a piece must explain.
const MIN_PIXELS: u32 = 20;
/// Number of times that planes are fitted to the rays that end on them.
const REFITS: usize = 2;
/// Size of a cell, in sizes of surfels.
const CELL: f64 = 0.5;
/// Maximum distance between surfels of planes that touch, in their sizes.
const TOUCH: f64 = 1.5;

/// The sizes of the smallest surfels for these views.
pub(crate) fn detail(options: &ExploreOptions, views: &Views) -> Detail {
    let is_sparse = options.detail.is_none() && are_sparse(views, MIN_SIZE);
    Detail::of(views, if is_sparse { Some(MIN_SIZE) } else { options.detail })
}

/// The surfaces that explain the used pixels, or `None` if there are none. `detail` is that of the views. `is_used`
/// selects pixels by the indices of view and pixel.
pub(crate) fn explain(
    views: &Views,
    (options, detail): (&ExploreOptions, &Detail),
    predictor: &mut Predictor,
    is_used: impl Fn(usize, usize) -> bool + Sync + Send,
) -> Result<Option<Surfaces>> {
    if are_sparse(views, options.detail.unwrap_or(MIN_SIZE)) {
        return sheets(views, options, predictor, is_used);
    }
    if options.detail.is_none() && !detail.is_resolved() {
        return Ok(None);
    }
    let threads = &options.threads;
    let max_planes = (options.polygons as f64 * PLANES).ceil() as usize;
    let regions_of = |views: &Views| {
        let all = merged(&surfels(views, detail, &is_used), detail.min_size, detail.noise.range);
        let surface = Surface::new(permanent(views, all));
        let regions = Regions::new(&surface, (detail.min_size, detail.noise), max_planes);
        (surface, regions)
    };
    let (mut surface, mut regions) = threads.run(|| regions_of(views))?;
    let cleaned = threads.run(|| without_images(views, &surface, &regions))?;
    let (views, mirrored) = cleaned.as_ref().map_or((views, 0), |(views, points)| (views, *points));
    if mirrored > 0 {
        (surface, regions) = threads.run(|| regions_of(views))?;
    }
    if surface.surfels.is_empty() {
        return Ok(None);
    }
    let fitted = Fitted::new(surface, regions, threads)?;
    let tolerance = if options.polygons < 1000 { 1.0 } else { 0.5 };
    fitted.surfaces(views, (options, tolerance), predictor, (detail.min_size, mirrored)).map(Some)
}

/// Regions with what the fit of their planes needs.
struct Fitted<'a> {
    surface: Surface,
    regions: Regions,
    members: Vec<Vec<u32>>,
    /// Pairs of planes that touch.
    adjacent: Vec<[u32; 2]>,
    /// By plane: the distance at which the weight of a ray is halved, metres.
    tolerance: Vec<f64>,
    threads: &'a Threads,
}

impl<'a> Fitted<'a> {
    fn new(surface: Surface, regions: Regions, threads: &'a Threads) -> Result<Self> {
        let (members, adjacent) = (regions.members(), threads.run(|| touching(&surface, &regions.labels))?);
        let size =
            |m: &Vec<u32>| m.iter().map(|m| surface.surfels[*m as usize].size).sum::<f64>() / m.len().max(1) as f64;
        let tolerance = members.iter().map(|m| SPREAD * size(m)).collect();
        Ok(Self { surface, regions, members, adjacent, tolerance, threads })
    }

    /// The outlines of the current planes, with all their pieces as a solid.
    fn outlines(&self, views: &Views, options: OutlineOptions) -> Result<(Vec<Outline>, Vec<Piece>, Solid)> {
        let planes = Planes {
            surface: &self.surface,
            planes: &self.regions.planes,
            labels: &self.regions.labels,
            members: &self.members,
            adjacent: &self.adjacent,
        };
        let mut outlines = self.threads.run(|| outlines(views, planes, options))?;
        let pieces: Vec<Piece> = outlines.iter_mut().flat_map(|o| std::mem::take(&mut o.pieces)).collect();
        let solid = Solid::new(views, &pieces)?;
        Ok((outlines, pieces, solid))
    }

    /// Fits the planes and keeps the pieces that the views confirm. `tolerance` is that of the outlines, in cells.
    fn surfaces(
        mut self,
        views: &Views,
        (options, tolerance): (&ExploreOptions, f64),
        predictor: &mut Predictor,
        (detail, mirrored): (f64, usize),
    ) -> Result<Surfaces> {
        for _ in 0..REFITS {
            // Coarse outlines suffice for the fit: the rays that end on the planes hardly change.
            let (_, pieces, solid) = self.outlines(views, OutlineOptions { cell: 2.0 * CELL, tolerance })?;
            let planes = &self.regions.planes;
            self.regions.planes = refitted(predictor, views, &solid, &pieces, planes, &self.tolerance)?;
        }
        let (mut outlines, pieces, solid) = self.outlines(views, OutlineOptions { cell: CELL, tolerance })?;
        let verdicts = verdicts(predictor, views, &solid, &pieces, &self.tolerance)?;
        let mut areas = Areas::default();
        outlines.iter().for_each(|o| areas.add(&o.areas));
        Ok(Surfaces {
            base: views.base(),
            detail,
            mirrored,
            pieces: confirmed(pieces, &verdicts.pixels, options.polygons),
            evidence: outlines.iter().map(|o| o.evidence).collect(),
            sigmas: verdicts.sigmas,
            parts: verdicts.parts,
            unseen: outlines.iter_mut().map(|o| std::mem::take(&mut o.unseen)).collect(),
            adjacent: self.adjacent,
            planes: self.regions.planes,
            areas,
        })
    }
}

/// Pairs of planes with surfels that touch.
fn touching(surface: &Surface, labels: &[u32]) -> Vec<[u32; 2]> {
    let around = |(i, s): (usize, &Surfel)| {
        let near = surface.near(s.at, TOUCH * s.size).map(|n| labels[n as usize]);
        near.filter(|n| *n > labels[i]).map(|n| [labels[i], n]).collect::<BTreeSet<_>>()
    };
    let sets: Vec<BTreeSet<[u32; 2]>> = surface.surfels.par_iter().enumerate().map(around).collect();
    sets.into_iter().flatten().collect::<BTreeSet<_>>().into_iter().collect()
}

/// At most `max` pieces, in their order: those with the highest gains, which explain enough pixels and more than they
/// block.
fn confirmed(pieces: Vec<Piece>, pixels: &[PixelCounts], max: usize) -> Vec<Piece> {
    let mut best: Vec<usize> =
        (0..pieces.len()).filter(|k| pixels[*k].explained >= MIN_PIXELS && pixels[*k].gain() > 0).collect();
    best.sort_by_key(|k| std::cmp::Reverse(pixels[*k].gain()));
    best.truncate(max);
    let kept: BTreeSet<usize> = best.into_iter().collect();
    pieces.into_iter().enumerate().filter(|(k, _)| kept.contains(k)).map(|(_, piece)| piece).collect()
}
