//! Surfaces of views: from surfels over regions to convex polygons.

use super::found::Surfaces;
use super::mirror::without_images;
use super::options::ExploreOptions;
use super::outline::{Areas, OutlineOptions, Piece, Planes, outlines};
use super::region::Regions;
use super::sheet::sheets;
use super::solid::{Shown, Solid, refitted, shown};
use crate::observe::{Views, are_sparse};
use crate::surfels::{Detail, SMALLEST, Surface, Surfel, joined, lasting, surfels};
use presight_model::error::Result;
use presight_predict::predict::Predictor;
use rayon::prelude::*;
use std::collections::BTreeSet;

/// Planes for each polygon: an outline takes several convex polygons.
const PLANES: f64 = 0.35;
/// Distance of a ray from its plane at which it counts half, in sizes of surfels.
const SPREAD: f64 = 0.3;
/// Pixels that a piece must explain.
const LEAST_PIXELS: u32 = 20;
/// How often planes are fitted to the rays that end on them.
const REFITS: usize = 2;
/// Side of a cell, in sizes of surfels.
const CELL: f64 = 0.5;
/// Distance between surfels of planes that touch, in their sizes.
const TOUCH: f64 = 1.5;

/// The sides of the smallest pieces of surface for these views.
pub(crate) fn detail(options: &ExploreOptions, views: &Views) -> Detail {
    let is_sparse = options.detail.is_none() && are_sparse(views, SMALLEST);
    Detail::of(views, if is_sparse { Some(SMALLEST) } else { options.detail })
}

impl Surfaces {
    /// The surfaces of the pixels that are used, by the number of the view and of the pixel; `None` if there are none. `detail` is that
    /// of the views.
    pub(crate) fn unexplained(
        views: &Views,
        (options, detail): (&ExploreOptions, &Detail),
        predictor: &mut Predictor,
        is_used: impl Fn(usize, usize) -> bool + Sync + Send,
    ) -> Result<Option<Self>> {
        if are_sparse(views, options.detail.unwrap_or(SMALLEST)) {
            return sheets(views, options, predictor, is_used);
        }
        if options.detail.is_none() && !detail.serves() {
            return Ok(None);
        }
        let threads = options.threads.clone();
        let most = (options.polygons as f64 * PLANES).ceil() as usize;
        let regions_of = |views: &Views| {
            let whole = joined(&surfels(views, detail, &is_used), detail.least, detail.noise.range);
            let surface = Surface::new(lasting(views, whole));
            let regions = Regions::new(&surface, (detail.least, detail.noise), most);
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
        let (members, beside) = (regions.members(), threads.run(|| touching(&surface, &regions.labels))?);
        let size =
            |m: &Vec<u32>| m.iter().map(|m| surface.surfels[*m as usize].size).sum::<f64>() / m.len().max(1) as f64;
        let tolerance: Vec<f64> = members.iter().map(|m| SPREAD * size(m)).collect();
        let mut outline = OutlineOptions {
            // Coarse until planes are fitted: what ends on them changes little.
            cell: 2.0 * CELL,
            tolerance: if options.polygons < 1000 { 1.0 } else { 0.5 },
        };
        let mut round = 0;
        let (mut found, pieces, solid) = loop {
            if round == REFITS {
                outline.cell = CELL;
            }
            let planes = Planes {
                surface: &surface,
                planes: &regions.planes,
                labels: &regions.labels,
                members: &members,
                beside: &beside,
            };
            let mut found = threads.run(|| outlines(views, planes, outline))?;
            let pieces: Vec<Piece> = found.iter_mut().flat_map(|o| std::mem::take(&mut o.pieces)).collect();
            let solid = Solid::new(views, &pieces)?;
            if round == REFITS {
                break (found, pieces, solid);
            }
            regions.planes = refitted(predictor, views, &solid, &pieces, &regions.planes, &tolerance)?;
            round += 1;
        };
        let verdicts = shown(predictor, views, &solid, &pieces, &tolerance)?;
        let mut areas = Areas::default();
        found.iter().for_each(|o| areas.add(&o.areas));
        Ok(Some(Self {
            base: views.base(),
            detail: detail.least,
            mirrored,
            pieces: earned(pieces, &verdicts.shown, options.polygons),
            evidence: found.iter().map(|o| o.evidence).collect(),
            sigmas: verdicts.sigmas,
            parts: verdicts.parts,
            unseen: found.iter_mut().map(|o| std::mem::take(&mut o.unseen)).collect(),
            beside,
            planes: regions.planes,
            areas,
        }))
    }
}

/// Pairs of planes whose surfels are near each other.
fn touching(surface: &Surface, labels: &[u32]) -> Vec<[u32; 2]> {
    let around = |(i, s): (usize, &Surfel)| {
        let near = surface.near(s.at, TOUCH * s.size).map(|n| labels[n as usize]);
        near.filter(|n| *n > labels[i]).map(|n| [labels[i], n]).collect::<BTreeSet<_>>()
    };
    let sets: Vec<BTreeSet<[u32; 2]>> = surface.surfels.par_iter().enumerate().map(around).collect();
    sets.into_iter().flatten().collect::<BTreeSet<_>>().into_iter().collect()
}

/// Pieces that explain enough, and more than they block: the best, in their order.
fn earned(pieces: Vec<Piece>, shown: &[Shown], most: usize) -> Vec<Piece> {
    let gain = |k: usize| i64::from(shown[k].explains) - i64::from(shown[k].blocks);
    let mut best: Vec<usize> =
        (0..pieces.len()).filter(|k| shown[*k].explains >= LEAST_PIXELS && gain(*k) > 0).collect();
    best.sort_by_key(|k| std::cmp::Reverse(gain(*k)));
    best.truncate(most);
    let kept: BTreeSet<usize> = best.into_iter().collect();
    pieces.into_iter().enumerate().filter(|(k, _)| kept.contains(k)).map(|(_, piece)| piece).collect()
}
