//! Surfaces of views: from surfels over regions to convex polygons.

use crate::flat::Flat;
use crate::outline::{Areas, OutlineOptions, Piece, outlines};
use crate::region::Regions;
use crate::solid::{Solid, refitted, shown};
use crate::surfel::{Surface, surfels};
use crate::view::Views;
use glam::DVec3;
use presight_model::error::{Error, Result};
use presight_model::threads::Threads;
use presight_predict::predict::{Backend, Options, Predictor};

/// How an environment is explored.
#[derive(Clone, Debug)]
#[non_exhaustive]
pub struct ExploreOptions {
    /// Most polygons.
    pub polygons: usize,
    /// Side of the smallest pieces of surface that are told apart, metres.
    pub detail: f64,
    /// Threads.
    pub threads: Threads,
}

impl Default for ExploreOptions {
    fn default() -> Self {
        Self { polygons: 2000, detail: 0.02, threads: Threads::default() }
    }
}

presight_model::with_options!(
    ExploreOptions:
    with_polygons polygons: usize,
    with_detail detail: f64,
    with_threads threads: Threads,
);

/// Convex polygons that explain views.
pub struct Surfaces {
    /// Metres in the world: what all coordinates count from.
    pub(crate) base: DVec3,
    pub(crate) planes: Vec<Flat>,
    pub(crate) pieces: Vec<Piece>,
    /// By plane: rays that ended on it, and that went through.
    pub(crate) evidence: Vec<[f64; 2]>,
    /// Areas over all planes.
    pub areas: Areas,
    pub(crate) unseen: Vec<(Vec<DVec3>, f64)>,
    /// Touching planes, by number.
    pub(crate) beside: Vec<[u32; 2]>,
}

impl Surfaces {
    /// The surfaces that views show.
    ///
    /// # Errors
    /// [`presight_model::ErrorKind::Invalid`] if nothing flat is in sight; [`presight_model::ErrorKind::System`] without
    /// threads.
    pub fn of(views: &Views, options: &ExploreOptions) -> Result<Self> {
        let predictor = Predictor::new(Options::new(Backend::Cpu).with_threads(options.threads.clone()))?;
        options.threads.run(|| Self::found(views, options, predictor, |_, _| true))?
    }

    fn found(
        views: &Views,
        options: &ExploreOptions,
        mut predictor: Predictor,
        is_used: impl Fn(usize, usize) -> bool + Sync,
    ) -> Result<Self> {
        let clock = std::time::Instant::now();
        let say = |what: &str| if std::env::var_os("EXPLORE_TIMES").is_some() { eprintln!("{:.2} s {what}", clock.elapsed().as_secs_f64()) };
        let surface = Surface::new(surfels(views, options.detail, is_used));
        say(&format!("{} surfels", surface.surfels.len()));
        if surface.surfels.is_empty() {
            let remedy = "give frames in which neighbouring pixels lie on one surface";
            return Err(Error::invalid("nothing flat is in sight", remedy));
        }
        let env = |name: &str, d: f64| std::env::var(name).ok().and_then(|v| v.parse().ok()).unwrap_or(d);
        let mut regions = Regions::new(&surface, options.detail, (options.polygons as f64 * env("RATIO", 0.35)) as usize, env("CHEAP", 0.0));
        say(&format!("{} planes", regions.planes.len()));
        let members = regions.members();
        let size = |m: &Vec<u32>| m.iter().map(|m| surface.surfels[*m as usize].size).sum::<f64>() / m.len().max(1) as f64;
        let tolerance: Vec<f64> = members.iter().map(|m| SPREAD * size(m)).collect();
        let outline = OutlineOptions { cell: 0.5, tolerance: env("EPS", 0.5), least_hits: (views.all().len() as u32).min(2) };
        let mut round = 0;
        let (mut found, pieces, solid) = loop {
            let mut found = outlines(views, &surface, &regions.planes, &members, &regions.labels, outline);
            let pieces: Vec<Piece> = found.iter_mut().flat_map(|o| std::mem::take(&mut o.pieces)).collect();
            let solid = Solid::new(views, &pieces)?;
            say(&format!("{} pieces", pieces.len()));
            if round == 2 {
                break (found, pieces, solid);
            }
            regions.planes = refitted(&mut predictor, views, &solid, &pieces, &regions.planes, &tolerance)?;
            say("refitted");
            round += 1;
        };
        let shown = shown(&mut predictor, views, &solid, &pieces, &tolerance)?;
        let pieces = earned(pieces, &shown, options.polygons);
        say(&format!("{} pieces left", pieces.len()));
        let mut areas = Areas::default();
        for o in &found {
            areas.surface += o.areas.surface;
            areas.open += o.areas.open;
            areas.unseen += o.areas.unseen;
        }
        let unseen = found.iter_mut().map(|o| std::mem::take(&mut o.unseen)).collect();
        let evidence = found.iter().map(|o| o.evidence).collect();
        let mut beside: Vec<[u32; 2]> = Vec::new();
        for i in 0..surface.surfels.len() {
            let own = regions.labels[i];
            let others = surface.neighbours(i).iter().map(|n| regions.labels[*n as usize]);
            beside.extend(others.filter(|o| *o > own).map(|o| [own, o]));
        }
        beside.sort_unstable();
        beside.dedup();
        Ok(Self { base: views.base(), planes: regions.planes, pieces, evidence, areas, unseen, beside })
    }

    /// Number of polygons.
    pub fn polygons(&self) -> usize {
        self.pieces.len()
    }
}

/// Distance of a ray from its plane at which it counts half, in sizes of surfels.
const SPREAD: f64 = 0.3;
/// Pixels that a piece must explain.
const LEAST_PIXELS: u32 = 20;

/// Pieces that explain enough, and more than they block: the best, in their order.
fn earned(pieces: Vec<Piece>, shown: &[[u32; 2]], most: usize) -> Vec<Piece> {
    let env = |name: &str, d: u32| std::env::var(name).ok().and_then(|v| v.parse().ok()).unwrap_or(d);
    let least = env("LEAST", LEAST_PIXELS);
    let times = env("TIMES", 1);
    let gain = |k: usize| i64::from(shown[k][0]) - i64::from(times) * i64::from(shown[k][1]);
    let mut best: Vec<usize> = (0..pieces.len()).filter(|k| shown[*k][0] >= least && gain(*k) > 0).collect();
    best.sort_by_key(|k| std::cmp::Reverse(gain(*k)));
    best.truncate(most);
    let kept: std::collections::HashSet<usize> = best.into_iter().collect();
    pieces.into_iter().enumerate().filter(|(k, _)| kept.contains(k)).map(|(_, piece)| piece).collect()
}

/// How well surfaces predict views.
#[derive(Clone, Copy, Debug)]
pub struct Judged {
    /// Median distance along the ray, metres.
    pub median: f64,
    /// Share of all measured pixels within 20 mm.
    pub within: f64,
    /// Share that is covered.
    pub covered: f64,
    /// Share that is predicted nearer by over 5 cm.
    pub nearer: f64,
}

impl Surfaces {
    /// Judges views.
    pub fn judged(&self, views: &Views) -> Result<Judged> {
        let mut predictor = Predictor::new(Options::new(Backend::Cpu))?;
        let moved: Vec<Piece> = self.pieces.iter().map(|p| Piece { plane: p.plane, corners: p.corners.iter().map(|c| *c + self.base - views.base()).collect() }).collect();
        let solid = Solid::new(views, &moved)?;
        let mut off = Vec::new();
        let mut near = 0;
        solid.visit(&mut predictor, views, 1, |s| {
            off.push((s.predicted - s.measured).abs());
            near += usize::from(s.predicted < s.measured - 0.05);
        })?;
        let all = views.hits() as f64;
        let within = off.iter().filter(|o| **o < 0.02).count() as f64 / all;
        let covered = off.len() as f64 / all;
        let median = presight_model::statistics::median(&mut off).unwrap_or(f64::NAN);
        Ok(Judged { median, within, covered, nearer: near as f64 / all })
    }
}
