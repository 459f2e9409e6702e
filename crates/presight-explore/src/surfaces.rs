//! Surfaces of views: from surfels over regions to convex polygons.

use crate::detail::{Detail, SMALLEST};
use crate::flat::Flat;
use crate::layers::joined;
use crate::mirror::without_images;
use crate::outline::{Areas, OutlineOptions, Piece, Planes, outlines};
use crate::region::Regions;
use crate::sheet::{are_sparse, sheets};
use crate::solid::{Shown, Solid, refitted, shown};
use crate::surfel::{Surface, Surfel, lasting, surfels};
use crate::view::Views;
use glam::DVec3;
use presight_model::error::Result;
use presight_model::threads::Threads;
use presight_predict::predict::Predictor;
use rayon::prelude::*;
use std::collections::{BTreeMap, BTreeSet};

/// How an environment is explored.
#[derive(Clone, Debug)]
#[non_exhaustive]
pub struct ExploreOptions {
    /// Most polygons.
    pub polygons: usize,
    /// Side of the smallest pieces of surface that are distinguished, metres; `None` for what the noise of the ranges, the distance of
    /// neighbouring points and the number of views allow, 2 cm at least.
    pub detail: Option<f64>,
    /// Height of walls that a level scanner of one row sees, metres.
    pub wall_height: f64,
    /// Height of the floor that these walls stand on, metres.
    pub floor: f64,
    /// A beam of such a scanner this near to a known wall is explained, metres.
    pub wall_tolerance: f64,
    /// Threads.
    pub threads: Threads,
}

impl Default for ExploreOptions {
    fn default() -> Self {
        Self {
            polygons: 2000,
            detail: None,
            wall_height: 2.5,
            floor: 0.0,
            wall_tolerance: 0.1,
            threads: Threads::default(),
        }
    }
}

presight_model::with_options!(
    ExploreOptions:
    with_polygons polygons: usize,
    with_detail detail: Option<f64>,
    with_wall_height wall_height: f64,
    with_floor floor: f64,
    with_wall_tolerance wall_tolerance: f64,
    with_threads threads: Threads,
);

impl ExploreOptions {
    /// The sides of the smallest pieces of surface for these views.
    pub(crate) fn detail(&self, views: &Views) -> Detail {
        let is_sparse = self.detail.is_none() && are_sparse(views, SMALLEST);
        Detail::of(views, if is_sparse { Some(SMALLEST) } else { self.detail })
    }
}

/// Convex polygons that explain views.
pub(crate) struct Surfaces {
    /// Metres in the world: what all coordinates count from.
    pub(crate) base: DVec3,
    pub(crate) detail: f64,
    /// Points behind mirrors, which are left out.
    pub(crate) mirrored: usize,
    pub(crate) planes: Vec<Flat>,
    pub(crate) pieces: Vec<Piece>,
    /// By plane: rays that ended on it, and that went through.
    pub(crate) evidence: Vec<[f64; 2]>,
    /// By plane: its standard deviation along its normal, metres.
    pub(crate) sigmas: Vec<f64>,
    /// By plane: the lowest plane that a chain of views joins it with.
    pub(crate) parts: Vec<u32>,
    /// By plane: places at its border that nobody saw, and the side of their cells.
    pub(crate) unseen: Vec<(Vec<DVec3>, f64)>,
    /// Numbers of planes that touch, rising.
    pub(crate) beside: Vec<[u32; 2]>,
    /// Areas over all planes.
    pub areas: Areas,
}

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

    /// Area of each part that no chain of views joins with another, square metres, the largest first.
    pub(crate) fn parts(&self) -> Vec<f64> {
        let mut areas = BTreeMap::<u32, f64>::new();
        for piece in &self.pieces {
            *areas.entry(self.parts[piece.plane as usize]).or_default() += piece.area();
        }
        let mut areas: Vec<f64> = areas.into_values().collect();
        areas.sort_by(|a, b| b.total_cmp(a));
        areas
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
