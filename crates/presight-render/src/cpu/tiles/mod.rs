//! Tiles: the second rendering strategy of the engine. Up to 64 rays together search the meshes' trees, nearest first,
//! in f32 with margins. The raster's own arithmetic then decides among the polygons found, so both strategies give the
//! same bits. No polygons are selected, and only polygons that a ray may see are set up.
//!
//! | stage | in | out |
//! |---|---|---|
//! | `search` | a tile, the tree of objects, the trees of meshes | candidates: polygons that a ray certainly or
//! possibly sees |
//! | `decide` | candidates | inverse depth and winner for each ray |
//! | `resolve` of the engine | the band | the requested images |

mod decide;
mod object;
mod search;
mod wide;

use super::batch::{NOTHING, Shade, Winners};
use super::raster_lines::Buffer;
use super::{Bands, CpuEngine, FEW_RAYS, resolve};
use crate::deadline::{DeadlineOutcome, Degradation, DegradationKind, DegradationStep};
use crate::plan::{CountName, FramePlan, Images, StageName, Stats, Way};
use decide::Decision;
pub use object::Margins;
use presight_model::clock::Instant;
use presight_model::error::Result;
use presight_model::sensor::{GROUP, GroupLayout, RayTile, RayTiles};
use rayon::prelude::*;
use search::{Objects, Search};
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Mutex, PoisonError};
use std::time::Duration;
use wide::Width;

/// Price of a tree per polygon of its mesh, in polygons that the raster selects: half of the building time, because
/// sensors that have delivered some frames deliver many. Trees with a price below the second constant are built
/// immediately.
const PRICE: u64 = 4;
const PAID_AT_ONCE: u64 = PRICE * 2000;

/// Price of a frame by the raster, in addition to its polygons.
pub(super) const FRAME_PRICE: u64 = 300;

/// Nanoseconds of a slow core for a tile, and for building a tree per polygon of its mesh: about seven times the
/// measured times.
const TILE_NS: u64 = 100_000;
const TREE_NS: u64 = 2_000;

/// Number of tiles of listed rays in a task.
const LISTED_TILES: usize = 32;

/// Vector instructions for eight lanes of f32.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Vectors {
    /// One register of eight, AVX2 with FMA.
    Avx2,
    /// Two registers of four, SSE4.2.
    Sse42,
    /// Plain loops, as the compiler translates them.
    Plain,
}

impl Vectors {
    /// The widest vectors of this processor.
    pub fn best() -> Self {
        #[cfg(target_arch = "x86_64")]
        match (pulp::x86::V3::try_new(), pulp::x86::V2::try_new()) {
            (Some(_), _) => return Self::Avx2,
            (_, Some(_)) => return Self::Sse42,
            _ => {}
        }
        Self::Plain
    }

    /// Name in reports.
    pub fn name(self) -> &'static str {
        match self {
            Self::Avx2 => "eight lanes (AVX2, FMA)",
            Self::Sse42 => "two times four lanes (SSE4.2)",
            Self::Plain => "plain loops of eight lanes: no vector instructions are named for this processor",
        }
    }

    /// Runs a task of the whole crate with these vectors, or with narrower ones if the processor lacks them.
    /// `pulp::Arch` does not know SSE4.2.
    pub(super) fn dispatch<T: pulp::WithSimd>(self, task: T) -> T::Output {
        use pulp::Simd;
        #[cfg(target_arch = "x86_64")]
        if let (Self::Sse42, Some(v2)) = (self, pulp::x86::V2::try_new()) {
            return Simd::vectorize(v2, task);
        }
        if self == Self::Avx2 { pulp::Arch::new().dispatch(task) } else { Simd::vectorize(pulp::Scalar::new(), task) }
    }
}

/// A task that is compiled for each width.
trait Task {
    type Output;
    fn run<S: Width, const N: usize>(self, simd: S) -> Self::Output;
}

/// The task with the token of its instruction set, which pulp then enables.
struct Op<S, T, const N: usize>(S, T);

impl<S: Width, T: Task, const N: usize> pulp::WithSimd for Op<S, T, N> {
    type Output = T::Output;

    #[inline(always)]
    fn with_simd<P: pulp::Simd>(self, _: P) -> T::Output {
        self.1.run::<S, N>(self.0)
    }
}

/// Chooses the width, once a task, for all tiles.
fn dispatch<T: Task>(vectors: Vectors, task: T) -> T::Output {
    use pulp::Simd;
    #[cfg(target_arch = "x86_64")]
    {
        use pulp::x86::{V2, V3};
        match (vectors, V3::try_new(), V2::try_new()) {
            (Vectors::Avx2, Some(v3), _) => return Simd::vectorize(v3, Op::<_, _, 1>(v3, task)),
            (Vectors::Avx2 | Vectors::Sse42, _, Some(v2)) => return Simd::vectorize(v2, Op::<_, _, 2>(v2, task)),
            _ => {}
        }
    }
    #[cfg(not(target_arch = "x86_64"))]
    let _ = vectors;
    let scalar = pulp::Scalar::new();
    Simd::vectorize(scalar, Op::<_, _, 8>(scalar, task))
}

/// Memory of a thread, from frame to frame.
#[derive(Default)]
pub(super) struct Room {
    known: Vec<(u64, u32)>,
    decision: Option<Decision>,
}

/// Data of a thread during a frame.
struct Worker<'a> {
    objects: Objects<'a>,
    search: Search<'a>,
    decision: Decision,
}

impl<'a> Worker<'a> {
    fn new(room: Room, frame: &Frame<'a>) -> Self {
        let decision = room.decision.unwrap_or_else(Decision::new);
        let objects = Objects::new(frame.plan, room.known, frame.number, frame.margins);
        Self { objects, search: Search::new(), decision }
    }
}

/// A frame during its trace.
struct Frame<'a> {
    plan: &'a FramePlan,
    tiles: &'a RayTiles,
    bands: &'a Bands,
    vectors: Vectors,
    margins: Margins,
    number: u64,
    rooms: Mutex<Vec<Room>>,
    workers: Mutex<Vec<Worker<'a>>>,
    /// True if the time was up before all tiles were traced.
    has_stopped: AtomicBool,
    /// Samples given up.
    given_up: AtomicU64,
}

impl<'a> Frame<'a> {
    /// Lends a task the data of its thread.
    fn with_worker<R>(&self, work: impl FnOnce(&mut Worker<'a>) -> R) -> R {
        let taken = self.workers.lock().unwrap_or_else(PoisonError::into_inner).pop();
        let mut worker = taken.unwrap_or_else(|| {
            let room = self.rooms.lock().unwrap_or_else(PoisonError::into_inner).pop().unwrap_or_default();
            Worker::new(room, self)
        });
        let done = work(&mut worker);
        self.workers.lock().unwrap_or_else(PoisonError::into_inner).push(worker);
        done
    }

    /// Traces a band into its buffer, and fills its images.
    fn trace_band(&self, band: usize, buffer: &mut Buffer, target: &mut resolve::Target<'_>) {
        let lines = self.bands.lines(band);
        buffer.clear(self.bands.axis, lines.len(), self.bands.samples);
        self.with_worker(|worker| {
            let tiles = (self.tiles.first_of_lines(lines.clone()), self.tiles.of_lines(lines.clone()));
            dispatch(self.vectors, TraceBand { tiles, frame: self, worker, buffer, target, band });
        });
    }

    /// True if the time is up, so that no further tile may be traced.
    #[inline(always)]
    fn is_over(&self) -> bool {
        let is_over = self.plan.watch().is_some_and(|watch| watch.is_over_after(TILE_NS));
        if is_over {
            self.has_stopped.store(true, Ordering::Relaxed);
        }
        is_over
    }

    /// Fills the images of a band. If a tile was left out, gives up the band's samples.
    #[inline(always)]
    fn resolve(&self, target: &mut resolve::Target<'_>, buffer: &Buffer, shades: &[Shade], band: usize, all: bool) {
        let complete_to = if all { f32::INFINITY } else { 0.0 };
        let (given_up, _) = resolve::resolve(target, buffer, self.plan, shades, self.bands, band, complete_to);
        self.given_up.fetch_add(given_up, Ordering::Relaxed);
    }

    /// The outcome of the deadline, if there is one.
    fn outcome(&self) -> Option<DeadlineOutcome> {
        let drawn = self.plan.watch()?.elapsed();
        let samples = self.given_up.load(Ordering::Relaxed);
        let at_ms = 1e3 * drawn.as_secs_f64();
        let means = vec![DegradationStep { means: DegradationKind::Clock, at_ms, metres: Some(0.0) }];
        let given_up = Degradation { complete_to: 0.0, samples, means, ..Degradation::default() };
        Some(DeadlineOutcome::drawn(drawn, (samples > 0).then_some(given_up)))
    }

    /// Traces listed rays, which lie in any band.
    fn trace_listed(&self, first: usize, tiles: &[RayTile]) -> Hits {
        self.with_worker(|worker| dispatch(self.vectors, TraceListed { tiles: (first, tiles), frame: self, worker }))
    }
}

/// Finds and decides which polygons the rays of a tile see, given with its number.
#[inline(always)]
fn trace_tile<'a, S: Width, const N: usize>(
    simd: S,
    tiles: &RayTiles,
    (number, tile): (usize, &RayTile),
    objects: &mut Objects<'a>,
    search: &mut Search<'a>,
    decision: &mut Decision,
) {
    if objects.turn_to(tiles.bundle(number)) {
        decision.drop_polygons();
    }
    decision.begin(objects.plan.sensor.grid(), tiles, tile);
    search.begin(objects, tile);
    while !search.go_on::<S, N>(simd, objects, tile) {
        decision.draw_unsure(objects, &mut search.found);
    }
    decision.run(objects, tile, &search.found);
}

/// Traces some tiles of a band, given with the number of the first.
struct TraceBand<'t, 'a, 'i> {
    tiles: (usize, &'t [RayTile]),
    frame: &'t Frame<'a>,
    worker: &'t mut Worker<'a>,
    buffer: &'t mut Buffer,
    target: &'t mut resolve::Target<'i>,
    band: usize,
}

impl Task for TraceBand<'_, '_, '_> {
    type Output = ();

    #[inline(always)]
    fn run<S: Width, const N: usize>(self, simd: S) {
        let Self { tiles, frame, worker, buffer, target, band } = self;
        let Worker { objects, search, decision } = worker;
        let first = frame.bands.lines(band).start;
        decision.clear();
        let mut all = true;
        for (number, tile) in (tiles.0..).zip(tiles.1) {
            if frame.is_over() {
                all = false;
                break;
            }
            trace_tile::<S, N>(simd, frame.tiles, (number, tile), objects, search, decision);
            put(buffer, frame.tiles.layout, tile, decision, first);
        }
        frame.resolve(target, buffer, &decision.winners.shades, band, all);
    }
}

/// Copies the winners of a tile into the buffer of a band, which begins with the line `first`.
#[inline(always)]
fn put(buffer: &mut Buffer, layout: GroupLayout, tile: &RayTile, decision: &Decision, first: usize) {
    for g in 0..tile.groups {
        let [line, sample] = tile.places[g].map(|place| place as usize);
        let line = line - first;
        let (inverse, winner) = (&decision.inverse[g], &decision.winner[g]);
        let is_octet = (layout == GroupLayout::Along) == buffer.few.is_none();
        if is_octet && tile.alive[g] == 0xff {
            let (at, _) = buffer.place(line, sample);
            buffer.inverse[at].0 = *inverse;
            for i in 0..GROUP {
                buffer.winner[at].0[i] = winner[i].into();
            }
            continue;
        }
        for i in (0..GROUP).filter(|i| tile.alive[g] >> i & 1 == 1) {
            let (line, sample) = if layout == GroupLayout::Along { (line, sample + i) } else { (line + i, sample) };
            let (at, lane) = buffer.place(line, sample);
            (buffer.inverse[at].0[lane], buffer.winner[at].0[lane]) = (inverse[i], winner[i].into());
        }
    }
}

/// Hits of some listed rays.
struct Hits {
    /// Pixel, inverse depth and winner.
    rays: Vec<(u32, f64, u32)>,
    winners: Winners,
}

/// Traces some tiles of listed rays, given with the number of the first.
struct TraceListed<'t, 'a> {
    tiles: (usize, &'t [RayTile]),
    frame: &'t Frame<'a>,
    worker: &'t mut Worker<'a>,
}

impl Task for TraceListed<'_, '_> {
    type Output = Hits;

    #[inline(always)]
    fn run<S: Width, const N: usize>(self, simd: S) -> Hits {
        let Worker { objects, search, decision } = self.worker;
        let mut rays = Vec::with_capacity(64 * self.tiles.1.len());
        decision.clear();
        for (number, tile) in (self.tiles.0..).zip(self.tiles.1) {
            if self.frame.is_over() {
                break;
            }
            trace_tile::<S, N>(simd, self.frame.tiles, (number, tile), objects, search, decision);
            for g in 0..tile.groups {
                let pixels = self.frame.tiles.listed(tile.places[g][0]);
                for i in (0..GROUP).filter(|i| tile.alive[g] >> i & 1 == 1) {
                    if decision.winner[g][i] != NOTHING {
                        rays.push((pixels[i], decision.inverse[g][i], decision.winner[g][i]));
                    }
                }
            }
        }
        Hits { rays, winners: std::mem::take(&mut decision.winners) }
    }
}

impl CpuEngine {
    /// Fills the requested images by tiles. Returns false, with empty images, if meshes in view have no trees yet and
    /// it is too early to build them.
    ///
    /// # Errors
    /// Errors of [`CpuEngine::render`]; [`presight_model::ErrorKind::System`] if memory for trees and tiles is short.
    pub(super) fn draw_tiles(&mut self, plan: &FramePlan, images: &mut Images, stats: &mut Stats) -> Result<bool> {
        plan.world_from_sensor.check()?;
        if !plan.chosen().at_once && self.price > self.savings {
            return Ok(false);
        }
        let start = Instant::now();
        let tiles = match plan.bundles() {
            Some(poses) => poses.bundles().ray_tiles(&plan.sensor)?,
            None => plan.sensor.ray_tiles()?,
        };
        let rays = plan.sensor.width() as usize * plan.sensor.height() as usize;
        let here = self.alone || rays <= FEW_RAYS;
        let threads = if here { 1 } else { self.threads() };
        let bands = Bands::new(plan.sensor.grid(), threads);
        self.require_memory(plan, &bands, images)?;
        images.try_prepare(plan.sensor.width(), plan.sensor.height(), plan.drawn())?;
        self.reserve_canvas(&bands)?;
        let counts = loop {
            self.frame += 1;
            let frame = Frame {
                plan,
                tiles,
                bands: &bands,
                vectors: self.vectors,
                margins: self.margins,
                number: self.frame,
                rooms: Mutex::new(std::mem::take(&mut self.rooms)),
                workers: Mutex::default(),
                has_stopped: AtomicBool::new(false),
                given_up: AtomicU64::new(0),
            };
            let canvas = &mut self.canvas[..bands.count()];
            if here {
                trace_here(&frame, canvas, images)
            } else {
                self.pool.install(|| trace(&frame, canvas, images))
            }
            stats.deadline = frame.outcome();
            let (lacking, counts) = self.take_back(frame);
            if lacking.is_empty() {
                break counts;
            }
            if !self.affords(plan, &lacking) {
                return Ok(false);
            }
            self.pool.install(|| plan.world.make_ray_trees(lacking))?;
        };
        (stats.engine, stats.threads, stats.way) = ("cpu", threads, Some(Way::Tiles));
        stats.stage(StageName::Tiles, start);
        for (name, count) in counts {
            stats.counts.push((name, count));
        }
        plan.finish_noting(images, stats)?;
        Ok(true)
    }

    /// True if it is time to build the trees of these objects' meshes: frames without them have cost a good part of the
    /// building time.
    fn affords(&mut self, plan: &FramePlan, lacking: &[u32]) -> bool {
        let objects = plan.environment().objects();
        let polygons: usize = lacking.iter().map(|o| objects[*o as usize].mesh.polygon_count()).sum();
        let price = PRICE * polygons as u64;
        let has_time = plan.watch().is_none_or(|watch| watch.left() >= Duration::from_nanos(TREE_NS * polygons as u64));
        if has_time && (plan.chosen().at_once || price <= PAID_AT_ONCE.max(self.savings)) {
            (self.savings, self.price) = (0, 0);
            return true;
        }
        // If only time is short, the next search for trees waits twice as long.
        self.price = if has_time { price } else { price.max(2 * self.savings + 1) };
        false
    }

    /// Takes back the memory of a frame's threads. Returns objects whose meshes lack a tree, and counts.
    fn take_back(&mut self, frame: Frame<'_>) -> (Vec<u32>, [(CountName, u64); 3]) {
        let mut counts =
            [CountName::TreeNodes, CountName::TriangleBlocks, CountName::RaysInDoubt].map(|name| (name, 0));
        let (mut lacking, mut rooms) = (Vec::new(), frame.rooms.into_inner().unwrap_or_else(PoisonError::into_inner));
        for mut worker in frame.workers.into_inner().unwrap_or_else(PoisonError::into_inner) {
            lacking.append(&mut worker.objects.lacking);
            let own = worker.search.counts;
            let all = [own.nodes, own.blocks, std::mem::take(&mut worker.decision.unsure)];
            counts.iter_mut().zip(all).for_each(|(count, more)| count.1 += more);
            rooms.push(Room { known: worker.objects.into_known(), decision: Some(worker.decision) });
        }
        self.rooms = rooms;
        lacking.sort_unstable();
        lacking.dedup();
        (lacking, counts)
    }
}

/// Traces all tiles on the calling thread.
fn trace_here(frame: &Frame<'_>, canvas: &mut [Buffer], images: &mut Images) {
    let mut targets = resolve::split(images, frame.bands);
    if frame.tiles.layout == GroupLayout::Listed {
        let hits = vec![frame.trace_listed(0, &frame.tiles.tiles)];
        let winners = scatter(frame, canvas, hits);
        for (band, (buffer, target)) in canvas.iter().zip(&mut targets).enumerate() {
            frame.resolve(target, buffer, &winners.shades, band, !frame.has_stopped.load(Ordering::Relaxed));
        }
        return;
    }
    for (band, (buffer, target)) in canvas.iter_mut().zip(&mut targets).enumerate() {
        frame.trace_band(band, buffer, target);
    }
}

/// Traces all tiles on the threads of the pool.
fn trace(frame: &Frame<'_>, canvas: &mut [Buffer], images: &mut Images) {
    let mut targets = resolve::split(images, frame.bands);
    if frame.tiles.layout == GroupLayout::Listed {
        let chunks = frame.tiles.tiles.par_chunks(LISTED_TILES).enumerate();
        let hits = chunks.map(|(chunk, tiles)| frame.trace_listed(chunk * LISTED_TILES, tiles)).collect();
        let winners = scatter(frame, canvas, hits);
        canvas.par_iter().zip(&mut targets).enumerate().for_each(|(band, (buffer, target))| {
            frame.resolve(target, buffer, &winners.shades, band, !frame.has_stopped.load(Ordering::Relaxed));
        });
        return;
    }
    let parts = canvas.par_iter_mut().zip(&mut targets).enumerate();
    parts.for_each(|(band, (buffer, target))| frame.trace_band(band, buffer, target));
}

/// Puts the hits of listed rays at their pixels.
fn scatter(frame: &Frame<'_>, canvas: &mut [Buffer], hits: Vec<Hits>) -> Winners {
    let bands = frame.bands;
    let mut winners = Winners::default();
    winners.clear();
    for (band, buffer) in canvas.iter_mut().enumerate() {
        buffer.clear(bands.axis, bands.lines(band).len(), bands.samples);
    }
    for Hits { rays, winners: own } in hits {
        let before = winners.shades.len() as u32 - 1;
        winners.shades.extend_from_slice(&own.shades[1..]);
        for (pixel, inverse, winner) in rays {
            let width = frame.plan.sensor.width() as usize;
            let (line, sample) = decide::line_and_sample(bands.axis, width, pixel as usize);
            let band = line / bands.per_band;
            let (at, lane) = canvas[band].place(line - band * bands.per_band, sample);
            canvas[band].inverse[at].0[lane] = inverse;
            canvas[band].winner[at].0[lane] = (winner + before).into();
        }
    }
    winners
}
