//! Progress and limits of feature generation.
//!
//! Every stage examines the neighbourhood of a polygon, line or feature, which normally holds a few polygons. If
//! thousands of polygons overlap, time and memory grow with the square of their number. Therefore the work is counted
//! in steps of about ten nanoseconds on one core. Each item has a free allowance, so no model is too large. Steps
//! beyond it are limited in total, and the error names the place with the most steps.

use glam::DVec3;
use presight_model::environment::Environment;
use presight_model::error::{Error, Result, short};
use presight_model::limits;
use std::sync::atomic::{AtomicU64, AtomicUsize, Ordering::Relaxed};
use std::sync::{Mutex, PoisonError};

/// Progress of a stage of [`super::generate`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Progress {
    /// Name of the stage.
    pub stage: &'static str,
    /// Steps done, 0 to `of`.
    pub done: usize,
    /// Steps of the stage.
    pub of: usize,
}

/// Costs of repeated work in steps, measured on heaps of triangles.
pub(super) mod steps {
    /// Comparing a polygon or line with another one near it.
    pub const FOUND: usize = 3;
    /// Computing the directions in which a polygon leaves a line.
    pub const WINGS: usize = 10;
    /// Processing a line where polygons cross.
    pub const LINE: usize = 100;
    /// Computing the hull of two pieces of a plane.
    pub const HULL: usize = 50;
    /// Transforming a polygon on which a feature may lie.
    pub const PLACED: usize = 12;
    /// Testing a polygon that may cover a side of another under a patch.
    pub const COVER: usize = 5;
}

/// Free steps per item. An item among a few hundred others takes fewer.
const FREE: usize = 4096;

/// Number of progress reports per stage.
const TOLD: usize = 200;

pub(super) struct Effort<'a> {
    environment: &'a Environment,
    watch: &'a (dyn Fn(Progress) + Sync),
    /// Steps beyond the free allowances.
    taken: AtomicU64,
    most: u64,
    /// Maximum step count at one place.
    crowd: AtomicUsize,
    /// All steps, including free ones.
    #[cfg(test)]
    all: AtomicU64,
    /// The place with the largest step count: steps, object, position in the world.
    place: Mutex<(usize, u32, DVec3)>,
}

impl<'a> Effort<'a> {
    pub fn new(environment: &'a Environment, watch: &'a (dyn Fn(Progress) + Sync)) -> Self {
        Self {
            environment,
            watch,
            taken: AtomicU64::new(0),
            #[cfg(test)]
            all: AtomicU64::new(0),
            most: limits::MAX_FEATURE_STEPS,
            crowd: AtomicUsize::new(0),
            place: Mutex::new((0, 0, DVec3::ZERO)),
        }
    }

    /// Sets the limit.
    #[cfg(test)]
    pub fn with_most(self, most: u64) -> Self {
        Self { most, ..self }
    }

    /// Starts an item of an object.
    pub fn allowance(&self, object: u32) -> EffortAllowance<'_> {
        EffortAllowance { effort: self, object, taken: 0 }
    }

    fn spend(&self, steps: usize, object: u32, at: impl FnOnce() -> DVec3) -> Result<()> {
        if steps > self.crowd.load(Relaxed) {
            let mut place = self.place.lock().unwrap_or_else(PoisonError::into_inner);
            if steps > place.0 {
                *place = (steps, object, at());
                self.crowd.store(steps, Relaxed);
            }
        }
        let before = self.taken.fetch_add(steps as u64, Relaxed);
        if before.saturating_add(steps as u64) <= self.most { Ok(()) } else { Err(self.too_much()) }
    }

    fn too_much(&self) -> Error {
        let (_, object, at) = *self.place.lock().unwrap_or_else(PoisonError::into_inner);
        let name = self.environment.objects().get(object as usize).map_or("", |o| &o.name);
        let at = at.to_array().map(|x| short((x * 1e3).round() / 1e3)).join(", ");
        let what = format!(
            "too many polygons overlap, most of them near [{at}] in the world: processing them takes over {} steps",
            self.most
        );
        Error::invalid(what, "remove duplicate and overlapping polygons there").at(format!("object {name:?}"))
    }

    /// Starts a stage with this number of items; the result counts them.
    pub fn stage(&self, stage: &'static str, of: usize) -> Steps<'_> {
        (self.watch)(Progress { stage, done: 0, of });
        Steps { watch: self.watch, stage, of, done: AtomicUsize::new(0), every: (of / TOLD).max(1) }
    }
}

/// Counts the steps of one item after its free allowance.
pub(super) struct EffortAllowance<'a> {
    effort: &'a Effort<'a>,
    object: u32,
    taken: usize,
}

impl EffortAllowance<'_> {
    /// Removes the free allowance, for an item that is examined again.
    pub fn again(self) -> Self {
        Self { taken: FREE, ..self }
    }

    /// Counts steps at a place, before they are done.
    ///
    /// # Errors
    /// [`presight_model::ErrorKind::Invalid`] naming the place with the most steps, if the total exceeds the limit.
    #[inline]
    pub fn spend(&mut self, steps: usize, at: impl FnOnce() -> DVec3) -> Result<()> {
        #[cfg(test)]
        self.effort.all.fetch_add(steps as u64, Relaxed);
        self.taken = self.taken.saturating_add(steps);
        match self.taken.saturating_sub(FREE).min(steps) {
            0 => Ok(()),
            beyond => self.effort.spend(beyond, self.object, at),
        }
    }
}

/// The progress of a stage.
pub(super) struct Steps<'a> {
    watch: &'a (dyn Fn(Progress) + Sync),
    stage: &'static str,
    of: usize,
    done: AtomicUsize,
    every: usize,
}

impl Steps<'_> {
    /// Counts one finished item.
    #[inline]
    pub fn step(&self) {
        let done = self.done.fetch_add(1, Relaxed) + 1;
        if done.is_multiple_of(self.every) || done == self.of {
            (self.watch)(Progress { stage: self.stage, done: done.min(self.of), of: self.of });
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::{GenerateOptions, generate, generate_with, generate_with_progress};
    use super::*;
    use glam::Vec3;
    use presight_model::{Material, Mesh, NewObject, Polygon, PolygonOrder, Pose};

    fn environment(vertices: Vec<Vec3>, triangles: &[[u32; 3]]) -> Environment {
        let mut environment = Environment::new();
        environment.add_material(Material::named("m")).unwrap();
        let polygons = triangles.iter().map(|t| Polygon::new(t.to_vec(), 0)).collect();
        let mesh = Mesh::new("mesh", vertices, polygons, PolygonOrder::Spatial).unwrap();
        environment.insert(NewObject::new("hall/heap", Pose::IDENTITY, mesh.into())).unwrap();
        environment
    }

    /// Triangles around one edge on the z axis from 0 to 1.
    fn fan(n: u32) -> Environment {
        let turn = |k: u32| std::f32::consts::TAU * k as f32 / n as f32;
        let mut vertices = vec![Vec3::ZERO, Vec3::Z];
        vertices.extend((0..n).map(|k| Vec3::new(turn(k).cos(), turn(k).sin(), 0.5)));
        environment(vertices, &(0..n).map(|k| [0, 1, 2 + k]).collect::<Vec<_>>())
    }

    fn equal(n: u32) -> Environment {
        environment(vec![Vec3::ZERO, Vec3::X, Vec3::Y], &vec![[0, 1, 2]; n as usize])
    }

    /// Mostly overlapping triangles in one plane.
    fn overlapping(n: u32) -> Environment {
        let mut random = presight_model::random::SplitMix64(3);
        let mut at = |least: f64| Vec3::new((least + random.unit()) as f32, random.unit() as f32, 0.0);
        let corners = (0..n).flat_map(|_| [at(0.0), at(1.0), at(0.5) + Vec3::Y]).collect();
        environment(corners, &(0..n).map(|k| [3 * k, 3 * k + 1, 3 * k + 2]).collect::<Vec<_>>())
    }

    /// Adjacent tiles.
    fn tiles(side: u32) -> Environment {
        let at = |x: u32, y: u32| Vec3::new(x as f32, y as f32, ((x * 7 + y * 3) % 5) as f32 * 0.2);
        let vertices = (0..=side).flat_map(|y| (0..=side).map(move |x| at(x, y))).collect();
        let tile = |k: u32| {
            let first = k / side * (side + 1) + k % side;
            [[first, first + 1, first + side + 2], [first, first + side + 2, first + side + 1]]
        };
        environment(vertices, &(0..side * side).flat_map(tile).collect::<Vec<_>>())
    }

    fn steps_of(environment: &Environment) -> u64 {
        let effort = Effort::new(environment, &|_| {});
        generate_with(environment, "video", &GenerateOptions::default(), &effort).unwrap();
        effort.all.into_inner()
    }

    #[test]
    fn equal_polygons_are_looked_at_once() {
        let options = GenerateOptions::default();
        let one = generate(&equal(1), "video", &options).unwrap();
        let many = generate(&equal(50_000), "video", &options).unwrap();
        assert_eq!((many.layer, many.counts.made), (one.layer, one.counts.made));
        assert_eq!((many.counts.polygons, one.counts.polygons), (50_000, 1));
        assert_eq!(steps_of(&equal(50_000)), steps_of(&equal(1)));
    }

    #[test]
    fn what_lies_apart_costs_by_its_number() {
        let (few, many) = (steps_of(&tiles(20)), steps_of(&tiles(80)));
        assert!(few > 1000 && many < 20 * few, "{many} are over 16 times {few}");
    }

    #[test]
    fn a_limit_names_the_place_where_it_is_met() {
        for (what, environment, near) in [("fan", fan(3000), true), ("overlapping", overlapping(2000), false)] {
            let effort = Effort::new(&environment, &|_| {}).with_most(100_000);
            let e = generate_with(&environment, "video", &GenerateOptions::default(), &effort).unwrap_err();
            let said = e.to_string();
            assert!(said.starts_with("object \"hall/heap\": too many polygons overlap"), "{what}: {said}");
            assert!(e.kind() == presight_model::ErrorKind::Invalid && !e.remedy().is_empty(), "{what}: {said}");
            // The work stops at the limit, apart from the current item of each thread.
            let taken = effort.taken.load(Relaxed);
            assert!(taken > 100_000 && taken < 100_000 + 64 * 3000 * 16, "{what}: {taken}");
            let (_, _, at) = *effort.place.lock().unwrap();
            assert!(!near || at.truncate().length() <= 1.0 + 1e-6 && (0.0..=1.0).contains(&at.z), "{what}: {at}");
        }
        // A hundred triangles around one edge are far below the limit.
        let hundred = fan(100);
        let effort = Effort::new(&hundred, &|_| {});
        generate_with(&hundred, "video", &GenerateOptions::default(), &effort).unwrap();
        let taken = effort.taken.load(Relaxed);
        assert!(taken < limits::MAX_FEATURE_STEPS / 1000, "{taken}");
    }

    #[test]
    fn each_thing_has_free_steps_once() {
        let environment = equal(1);
        let effort = Effort::new(&environment, &|_| {}).with_most(10);
        let spend = |thing: &mut EffortAllowance<'_>, steps| thing.spend(steps, || DVec3::X);
        let taken = || effort.taken.load(Relaxed);
        let (mut one, mut other) = (effort.allowance(0), effort.allowance(0));
        assert!(spend(&mut one, FREE).is_ok() && spend(&mut other, FREE - 1).is_ok() && taken() == 0);
        assert!(spend(&mut one, 4).is_ok() && spend(&mut other, 3).is_ok() && taken() == 6);
        assert!(spend(&mut effort.allowance(0).again(), 4).is_ok() && taken() == 10);
        assert!(spend(&mut effort.allowance(0), FREE).is_ok());
        let e = spend(&mut one, 1).unwrap_err().to_string();
        assert!(e.contains("near [1, 0, 0] in the world") && e.contains("over 10 steps"), "{e}");
    }

    #[test]
    fn the_watch_is_told_of_every_stage_to_its_end() {
        let reports = Mutex::new(Vec::new());
        let watch = |progress: Progress| reports.lock().unwrap().push(progress);
        let environment = tiles(20);
        let watched = generate_with_progress(&environment, "video", &GenerateOptions::default(), &watch).unwrap();
        assert_eq!(watched, generate(&environment, "video", &GenerateOptions::default()).unwrap());
        let reports = reports.into_inner().unwrap();
        assert!(reports.iter().all(|p| p.done <= p.of));
        for stage in ["crossings", "edges", "checking features"] {
            let of_stage: Vec<_> = reports.iter().filter(|p| p.stage == stage).collect();
            assert!(of_stage[0].done == 0 && of_stage.iter().any(|p| p.done == p.of), "{stage}: {of_stage:?}");
            assert!(of_stage.len() <= TOLD * 2 + 2, "{stage}: {}", of_stage.len());
        }
    }
}
