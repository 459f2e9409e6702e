//! Recall and precision of visible edges relative to dense rays. The truth is where neighbouring rays of an image four
//! times as fine differ by a jump in range, or in their normals by more than the crease angle.
//!
//! All scenes: `cargo test --release --test features visible_edges -- --ignored --nocapture`. `PRESIGHT_EDGE_SCENES`
//! names other scenes, `PRESIGHT_EDGE_POSES` sets the number of poses and `PRESIGHT_EDGE_WIDTH` the width of the base
//! image, and `PRESIGHT_EDGE_WHY` prints the missed edges by kind.

#![allow(clippy::print_stderr)] // Prints the values reached.

use super::common::oracle::Oracle;
use super::common::{data, env_number};
use super::plant::plant;
use glam::{DVec2, DVec3};
use presight_features::generate::{GenerateOptions, generate};
use presight_features::{FeatureOptions, PlacedFeature, PlacedFeatures, SeenFeature, place};
use presight_model::environment::FeatureLayer;
use presight_model::environment::FeatureShape;
use presight_model::geometry::{Pose, SensorPose};
use presight_model::sensor::{Camera, Geometry, Sensor, SensorSpec};
use presight_model::world::World;
use presight_predict::predict::{Backend, Options, Predictor};
use presight_predict::request::Request;
use presight_read::gltf::{ImportOptions, import};
use presight_render::plan::{Output, Outputs};
use rayon::prelude::*;
use std::cell::RefCell;
use std::collections::{BTreeMap, HashSet};

/// Truth rays for each pixel of the base image, along each axis.
const FINE: u32 = 4;
/// The distance within which an edge counts as found, in pixels of the base image.
const NEAR: f64 = 2.0;
/// With fewer truth transitions a pose is not significant.
const FEWEST: usize = 500;

fn camera(width: u32, fine: u32) -> Sensor {
    let (w, f) = (f64::from(width), 0.8 * f64::from(width));
    let height = width * 3 / 4;
    let scale = |c: f64| (c + 0.5) * f64::from(fine) - 0.5;
    let (cx, cy) = (scale(0.5 * (w - 1.0)), scale(0.5 * (f64::from(height) - 1.0)));
    let f = f * f64::from(fine);
    let camera = Camera::pinhole(width * fine, height * fine, f, f, cx, cy);
    Sensor::new(SensorSpec::new("c", "video", Geometry::Camera(camera))).unwrap()
}

/// A ray's hit.
#[derive(Clone, Copy)]
struct Hit {
    ray: DVec3,
    /// Infinite without a hit.
    range: f64,
    normal: DVec3,
    polygon: u32,
}

/// Returns true unless two neighbouring rays hit one smooth surface.
fn parts(a: &Hit, b: &Hit, crease: f64) -> bool {
    if a.range.is_finite() != b.range.is_finite() {
        return true;
    }
    if a.range.is_infinite() {
        return false;
    }
    // The distance of one hit from the other's plane, along its ray.
    let off = |a: &Hit, b: &Hit| (a.range * a.normal.dot(a.ray) / a.normal.dot(b.ray) - b.range).abs();
    let jump = off(a, b).min(off(b, a));
    jump > 0.003 && jump > 0.01 * a.range.min(b.range) || a.normal.angle_between(b.normal) > crease
}

/// Places on a base image, by pixel.
struct Places {
    width: usize,
    height: usize,
    cells: Vec<Vec<DVec2>>,
    all: Vec<DVec2>,
}

impl Places {
    fn new((width, height): (u32, u32), all: Vec<DVec2>) -> Self {
        let (width, height) = (width as usize, height as usize);
        let mut places = Self { width, height, cells: vec![Vec::new(); width * height], all: Vec::new() };
        for p in &all {
            if let Some(at) = places.cell(*p) {
                places.cells[at].push(*p);
            }
        }
        places.all = all;
        places
    }

    fn cell(&self, p: DVec2) -> Option<usize> {
        let (x, y) = ((p.x + 0.5).floor(), (p.y + 0.5).floor());
        let inside = x >= 0.0 && y >= 0.0 && x < self.width as f64 && y < self.height as f64;
        inside.then(|| y as usize * self.width + x as usize)
    }

    fn near(&self, p: DVec2) -> bool {
        (-3..=3).any(|dy| {
            (-3..=3).any(|dx| {
                let cell = self.cell(p + DVec2::new(f64::from(dx), f64::from(dy)));
                cell.is_some_and(|cell| self.cells[cell].iter().any(|q| q.distance(p) <= NEAR))
            })
        })
    }
}

/// The places where neighbouring rays differ by an edge, with the polygons on both sides.
fn truth(oracle: &Oracle, sensor: &Sensor, pose: &Pose, crease: f64) -> Vec<(DVec2, [u32; 2])> {
    let (w, h) = (sensor.width(), sensor.height());
    let row = |r: u32| -> Vec<Hit> {
        let hit = |c: u32| {
            let seen = oracle.cast(sensor, pose, (c, r)).unwrap();
            let ray = sensor.body_from_image() * sensor.ray(c, r).unwrap();
            let normal = DVec3::from_array(seen.normal.unwrap().map(f64::from));
            Hit { ray, range: f64::from(seen.range.unwrap()), normal, polygon: seen.polygon_id.unwrap() }
        };
        (0..w).map(hit).collect()
    };
    let base = |c: f64, r: f64| (DVec2::new(c, r) + 0.5) / f64::from(FINE) - 0.5;
    // The last row of a block is also the first row of the next.
    const ROWS: u32 = 32;
    let rows = |some: u32| {
        let (first, mut all) = (some * ROWS, Vec::new());
        let mut last = if first > 0 { row(first - 1) } else { Vec::new() };
        for r in first..(first + ROWS).min(h) {
            let this = row(r);
            for c in 0..w as usize {
                let (x, y) = (c as f64, f64::from(r));
                if c > 0 && parts(&this[c - 1], &this[c], crease) {
                    all.push((base(x - 0.5, y), [this[c - 1].polygon, this[c].polygon]));
                }
                if r > 0 && parts(&last[c], &this[c], crease) {
                    all.push((base(x, y - 0.5), [last[c].polygon, this[c].polygon]));
                }
            }
            last = this;
        }
        all
    };
    (0..h.div_ceil(ROWS)).into_par_iter().flat_map_iter(rows).collect()
}

/// Places every half pixel on the visible parts of segments and contours, with their feature numbers.
fn predicted(sensor: &Sensor, pose: &Pose, features: &[SeenFeature]) -> Vec<(DVec2, usize)> {
    let image_from_world = (pose.rotation_matrix() * sensor.body_from_image()).transpose();
    let pixel = |p: DVec3| sensor.project(image_from_world * (p - pose.translation)).map(DVec2::from);
    let mut all = Vec::new();
    for (number, seen) in features.iter().enumerate() {
        let points = &seen.points_world;
        let whole: f64 = points.windows(2).map(|p| p[0].distance(p[1])).sum();
        for v in &seen.visible {
            let mut before = 0.0;
            for pair in points.windows(2) {
                let length = pair[0].distance(pair[1]);
                let part = v.t.map(|t| ((t * whole - before) / length).clamp(0.0, 1.0));
                before += length;
                let ends = part.map(|t| pixel(pair[0].lerp(pair[1], t)));
                let [Some(a), Some(b)] = ends else { continue };
                if part[0] < part[1] {
                    let n = (2.0 * a.distance(b)).ceil().max(1.0);
                    all.extend((0..n as u32).map(|i| (a.lerp(b, (f64::from(i) + 0.5) / n), number)));
                }
            }
        }
    }
    all
}

/// The shares of true places found, of predicted places that are right, and of predicted places that are right although
/// shifted by ten pixels.
#[derive(Clone, Debug, Default)]
struct Shares {
    truth: usize,
    found: usize,
    /// True places on lines under the minimum length only, which do not count.
    short: usize,
    predicted: usize,
    right: usize,
    chance: usize,
    /// Predicted places on borders of materials, which do not count.
    material: usize,
    /// True places missed, and predicted places wrong, by kind.
    missed: BTreeMap<String, usize>,
    wrong: BTreeMap<String, usize>,
}

impl Shares {
    fn recall(&self) -> f64 {
        self.found as f64 / self.truth as f64
    }

    fn precision(&self) -> f64 {
        self.right as f64 / self.predicted as f64
    }
}

/// Features with a predictor that keeps its preparation for them: the edges of a city's surfaces take seconds.
struct Watched {
    placed: PlacedFeatures,
    predictor: RefCell<Predictor>,
}

impl Watched {
    fn new(placed: Vec<PlacedFeature>) -> Self {
        let predictor = Predictor::new(Options::new(Backend::Cpu)).unwrap();
        Self { placed: placed.into(), predictor: predictor.into() }
    }

    fn segments(&self) -> Self {
        Self::new(self.placed.features.iter().filter(|p| p.feature.shape.kind() != "contour").cloned().collect())
    }
}

/// A layer's lines, and the lines of a second layer with a tenth of the minimum length.
struct Lines {
    placed: Watched,
    short: Watched,
    crease: f64,
}

impl Lines {
    fn of(world: &World) -> Self {
        let options = GenerateOptions::default();
        let made = generate(world.environment(), "video", &options).unwrap().layer;
        let less = GenerateOptions { min_length: 0.1 * options.min_length, ..options.clone() };
        let finer = generate(world.environment(), "video", &less).unwrap().layer;
        let length = |shape: &FeatureShape| match shape {
            FeatureShape::Segment { ends: [a, b], .. } => Some(a.distance(*b)),
            _ => None,
        };
        let bits = |at: DVec3| at.to_array().map(f64::to_bits);
        let anchor = |shape: &FeatureShape| match shape {
            FeatureShape::Contour { anchor, .. } => Some(bits(*anchor)),
            _ => None,
        };
        let anchors: HashSet<_> = made.features.iter().filter_map(|f| anchor(&f.shape)).collect();
        let is_line = |kind: &str| ["segment", "contour"].contains(&kind);
        let is_short = |shape: &FeatureShape| match length(shape) {
            Some(length) => length < options.min_length,
            None => anchor(shape).is_some_and(|anchor| !anchors.contains(&anchor)),
        };
        let some = |of: &FeatureLayer, wanted: &dyn Fn(&FeatureShape) -> bool| {
            let features = of.features.iter().filter(|f| wanted(&f.shape)).cloned().collect();
            place(world, &FeatureLayer { features, ..of.clone() }).unwrap()
        };
        let placed = some(&made, &|shape| is_line(shape.kind()));
        Self { placed: Watched::new(placed), short: Watched::new(some(&finer, &is_short)), crease: options.crease }
    }

    fn segments(&self) -> Self {
        Self { placed: self.placed.segments(), short: self.short.segments(), crease: self.crease }
    }
}

/// One pose with its truth.
struct View<'a> {
    world: &'a World,
    pose: &'a Pose,
    base: &'a Sensor,
    truth: Vec<(DVec2, [u32; 2])>,
}

impl<'a> View<'a> {
    fn new(world: &'a World, pose: &'a Pose, (base, fine): (&'a Sensor, &Sensor), crease: f64) -> Self {
        let oracle = Oracle::new(world.environment(), pose.translation).unwrap();
        Self { world, pose, base, truth: truth(&oracle, fine, pose, crease) }
    }

    fn see(&self, watched: &Watched) -> Vec<SeenFeature> {
        let features = FeatureOptions::default().with_placed(watched.placed.clone());
        let request = Request::of(Outputs::of(&[Output::PolygonId])).with_features(features);
        let mut predictor = watched.predictor.borrow_mut();
        predictor
            .predict(self.world, self.base, &SensorPose::new(*self.pose), &request)
            .unwrap()
            .features
            .unwrap()
            .features
    }

    fn places(&self, all: Vec<DVec2>) -> Places {
        Places::new((self.base.width(), self.base.height()), all)
    }

    fn add_to(&self, sum: &mut Shares, lines: &Lines) {
        let seen = self.see(&lines.placed);
        let name = |number: usize| seen[number].feature.name.as_deref().unwrap_or("");
        let (material, predicted): (Vec<_>, Vec<_>) =
            predicted(self.base, self.pose, &seen).into_iter().partition(|(_, number)| name(*number) == "material");
        sum.material += material.len();
        sum.predicted += predicted.len();
        let truth = self.places(self.truth.iter().map(|(at, _)| *at).collect());
        for (at, number) in &predicted {
            if truth.near(*at) {
                sum.right += 1;
            } else {
                let feature = &seen[*number].feature;
                *sum.wrong.entry(format!("{} {}", name(*number), feature.id)).or_default() += 1;
            }
            sum.chance += usize::from(truth.near(*at + DVec2::splat(10.0 / 2f64.sqrt())));
        }
        let predicted = self.places(predicted.into_iter().map(|(at, _)| at).collect());
        let of_short = |features: &[SeenFeature]| {
            self.places(self::predicted(self.base, self.pose, features).into_iter().map(|(at, _)| at).collect())
        };
        let short = of_short(&self.see(&lines.short));
        let object = |id: u32| match id.checked_sub(1).and_then(|slot| self.world.environment().locate(slot)) {
            Some((object, _)) => self.world.environment().objects()[object as usize].name.clone(),
            None => "nothing".to_owned(),
        };
        for (at, [a, b]) in &self.truth {
            if predicted.near(*at) {
                sum.found += 1;
            } else if short.near(*at) {
                sum.short += 1;
                continue;
            } else {
                let names = [*a, *b].map(object);
                let [a, b] = if names[0] <= names[1] { [&names[0], &names[1]] } else { [&names[1], &names[0]] };
                *sum.missed.entry(format!("{a} / {b}")).or_default() += 1;
            }
            sum.truth += 1;
        }
    }
}

/// The shares with segments alone and with contours, and the number of poses with too few edges.
fn shares(world: &World, poses: &[Pose], width: u32) -> ([Shares; 2], usize) {
    let with = Lines::of(world);
    let lines = [with.segments(), with];
    let (base, fine) = (camera(width, 1), camera(width, FINE));
    let (mut sums, mut skipped) = ([Shares::default(), Shares::default()], 0);
    for pose in poses {
        let view = View::new(world, pose, (&base, &fine), lines[0].crease);
        if view.truth.len() < FEWEST {
            skipped += 1;
            continue;
        }
        sums.iter_mut().zip(&lines).for_each(|(sum, lines)| view.add_to(sum, lines));
    }
    (sums, skipped)
}

fn tell(name: &str, (sums, skipped): &([Shares; 2], usize)) {
    for (of, s) in ["segments", "with contours"].iter().zip(sums) {
        let share = |n: usize, of: usize| n as f64 / of.max(1) as f64;
        eprintln!(
            "{name}, {of}: recall {:.3} of {}, precision {:.3} of {}, by chance {:.3}; left out: {:.3} of the truth as short, \
             {} predicted of materials; {skipped} poses skipped",
            s.recall(),
            s.truth,
            s.precision(),
            s.predicted,
            share(s.chance, s.predicted),
            share(s.short, s.truth + s.short),
            s.material,
        );
    }
    if std::env::var_os("PRESIGHT_EDGE_WHY").is_some() {
        for (what, by) in [("missed", &sums[1].missed), ("wrong", &sums[1].wrong)] {
            let mut all: Vec<_> = by.iter().collect();
            all.sort_by_key(|(_, count)| std::cmp::Reverse(**count));
            all.iter().take(15).for_each(|(name, count)| eprintln!("    {what} {count} {name}"));
        }
    }
}

#[test]
fn silhouettes_of_a_plant_are_found_and_little_else() {
    let world = plant(3);
    let poses = data::poses(&world, 4, 11);
    let found = shares(&world, &poses, 240);
    tell("plant", &found);
    let [without, with] = found.0;
    assert!(with.recall() >= 0.95 && with.precision() >= 0.93, "{with:?}");
    // Neither segments alone nor lines in wrong places reach this.
    assert!(without.recall() < 0.8, "{without:?}");
    assert!((with.chance as f64) < 0.5 * with.right as f64, "{with:?}");
}

#[test]
#[ignore = "a study of many minutes"]
fn visible_edges_are_found_and_little_else() {
    let names = std::env::var("PRESIGHT_EDGE_SCENES")
        .unwrap_or_else(|_| "plant,room,factory_hall,hospital,office_willowgarage,city".to_owned());
    let (poses, width) = (env_number("PRESIGHT_EDGE_POSES", 20), env_number("PRESIGHT_EDGE_WIDTH", 640));
    let mut short = Vec::new();
    for name in names.split(',') {
        let world = match name {
            "plant" => plant(3),
            "room" => {
                World::new(import(data::root().join("scenes/room.glb"), &ImportOptions::default()).unwrap().environment)
            }
            _ => match data::scene(name, true) {
                Some(world) => world,
                None => return,
            },
        };
        let found = shares(&world, &data::poses(&world, poses as usize, 11), width as u32);
        tell(name, &found);
        let [_, with] = found.0;
        if with.recall() < 0.95 || with.precision() < 0.93 {
            short.push(name);
        }
    }
    assert!(short.is_empty(), "{short:?}");
}

/// Points of one plane are not an edge; a foreground surface in front of another is.
#[test]
fn the_truth_distinguishes_edges_from_slopes() {
    let hit =
        |x: f64, range: f64, normal: DVec3| Hit { ray: DVec3::new(1.0, x, 0.0).normalize(), range, normal, polygon: 1 };
    let crease = 30f64.to_radians();
    let floor = DVec3::new(-0.05, 1.0, 0.0).normalize();
    let on = |x: f64| {
        let ray = DVec3::new(1.0, x, 0.0).normalize();
        hit(x, floor.dot(DVec3::new(5.0, 0.0, 0.0)) / floor.dot(ray), floor)
    };
    assert!(!parts(&on(0.0), &on(0.02), crease), "one slope at a grazing angle");
    let wall = DVec3::NEG_X;
    assert!(parts(&hit(0.0, 2.0, wall), &hit(0.001, 2.1, wall), crease));
    assert!(!parts(&hit(0.0, 2.0, wall), &hit(0.001, 2.001, wall), crease), "a millimetre");
    assert!(parts(&hit(0.0, 2.0, wall), &hit(0.001, f64::INFINITY, DVec3::NAN), crease));
    assert!(parts(&hit(0.0, 2.0, wall), &hit(0.001, 2.0, DVec3::Y), crease));
}
