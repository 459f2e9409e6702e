//! Recall and precision of visible edges against what dense rays say: where neighbouring rays of an image four times as fine see a jump
//! in range, or normals that lean to each other by more than the crease angle.
//!
//! `PRESIGHT_CONTOUR_SCENES` names real scenes, `PRESIGHT_CONTOUR_POSES` how many poses, `PRESIGHT_CONTOUR_WIDTH` how wide the base image is.

#![allow(clippy::print_stderr)] // What was reached is worth reading.

use super::common::oracle::Oracle;
use super::common::{data, env_number};
use super::plant::plant;
use glam::{DVec2, DVec3};
use presight::environment::FeatureLayer;
use presight::features::generate::{GenerateOptions, generate};
use presight::features::{FeatureSettings, PlacedFeature, SeenFeature, place, predict_features};
use presight::{Camera, Geometry, Output, Outputs, Pose, Sensor, SensorSpec, World};

/// Rays of the truth for a pixel of the base image, along each axis.
const FINE: u32 = 4;
/// Pixels of the base image within which an edge is found.
const NEAR: f64 = 2.0;
/// Truth transitions below which a pose says little.
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

/// What a ray sees.
#[derive(Clone, Copy)]
struct Hit {
    ray: DVec3,
    /// Infinite where nothing is.
    range: f64,
    normal: DVec3,
}

/// True if two neighbouring rays do not see one smooth surface.
fn parts(a: &Hit, b: &Hit, crease: f64) -> bool {
    if a.range.is_finite() != b.range.is_finite() {
        return true;
    }
    if a.range.is_infinite() {
        return false;
    }
    // How far one is off the other's plane, along its ray.
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

fn truth(oracle: &Oracle, sensor: &Sensor, pose: &Pose, crease: f64) -> Vec<DVec2> {
    let (w, h) = (sensor.width(), sensor.height());
    let row = |r: u32| -> Vec<Hit> {
        let hit = |c: u32| {
            let seen = oracle.cast(sensor, pose, (c, r)).unwrap();
            let ray = sensor.body_from_image() * sensor.ray(c, r).unwrap();
            let normal = seen.normal.unwrap().map(f64::from);
            Hit { ray, range: f64::from(seen.range.unwrap()), normal: DVec3::from_array(normal) }
        };
        (0..w).map(hit).collect()
    };
    let base = |c: f64, r: f64| (DVec2::new(c, r) + 0.5) / f64::from(FINE) - 0.5;
    let (mut last, mut all) = (Vec::new(), Vec::new());
    for r in 0..h {
        let this = row(r);
        for c in 0..w as usize {
            let (x, y) = (c as f64, f64::from(r));
            if c > 0 && parts(&this[c - 1], &this[c], crease) {
                all.push(base(x - 0.5, y));
            }
            if r > 0 && parts(&last[c], &this[c], crease) {
                all.push(base(x, y - 0.5));
            }
        }
        last = this;
    }
    all
}

/// Places every half pixel on what is seen of segments and contours.
fn predicted(sensor: &Sensor, pose: &Pose, features: &[SeenFeature]) -> Vec<DVec2> {
    let image_from_world = (pose.rotation_matrix() * sensor.body_from_image()).transpose();
    let pixel = |p: DVec3| sensor.project(image_from_world * (p - pose.translation)).map(DVec2::from);
    let mut all = Vec::new();
    for seen in features.iter().filter(|f| ["segment", "contour"].contains(&f.feature.shape.kind())) {
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
                    all.extend((0..n as u32).map(|i| a.lerp(b, (f64::from(i) + 0.5) / n)));
                }
            }
        }
    }
    all
}

/// Shares of true places found, of predicted places right, and of predicted places right though shifted by ten pixels.
#[derive(Clone, Copy, Debug, Default)]
struct Shares {
    truth: usize,
    found: usize,
    predicted: usize,
    right: usize,
    chance: usize,
}

impl Shares {
    fn recall(&self) -> f64 {
        self.found as f64 / self.truth as f64
    }

    fn precision(&self) -> f64 {
        self.right as f64 / self.predicted as f64
    }

    fn add(&mut self, truth: &Places, predicted: Vec<DVec2>) {
        self.truth += truth.all.len();
        self.predicted += predicted.len();
        self.right += predicted.iter().filter(|p| truth.near(**p)).count();
        self.chance += predicted.iter().filter(|p| truth.near(**p + DVec2::splat(10.0 / 2f64.sqrt()))).count();
        let predicted = Places::new((truth.width as u32, truth.height as u32), predicted);
        self.found += truth.all.iter().filter(|p| predicted.near(**p)).count();
    }
}

/// With segments alone, and with contours.
fn shares(world: &World, poses: &[Pose], width: u32) -> ([Shares; 2], usize) {
    let options = GenerateOptions::default();
    let made = generate(world.environment(), "video", &options).unwrap().layer;
    let some = |contours: bool| -> Vec<PlacedFeature> {
        let wanted = |kind: &str| kind == "segment" || contours && kind == "contour";
        let features = made.features.iter().filter(|f| wanted(f.shape.kind())).cloned().collect();
        place(world, &FeatureLayer { features, ..made.clone() }).unwrap()
    };
    let layers = [some(false), some(true)];
    let (base, fine) = (camera(width, 1), camera(width, FINE));
    let (mut sums, mut skipped) = ([Shares::default(); 2], 0);
    for pose in poses {
        let oracle = Oracle::new(world.environment(), pose.translation).unwrap();
        let truth = truth(&oracle, &fine, pose, options.crease);
        if truth.len() < FEWEST {
            skipped += 1;
            continue;
        }
        let truth = Places::new((base.width(), base.height()), truth);
        let request = presight::Request::of(Outputs::of(&[Output::PolygonId]));
        let plan = presight::FramePlan::new(world, &base, pose, &request).unwrap();
        let images = super::common::reference(&plan);
        for (sum, layer) in sums.iter_mut().zip(&layers) {
            let seen = predict_features(world, &base, pose, &images, layer, &FeatureSettings::default()).unwrap();
            sum.add(&truth, predicted(&base, pose, &seen.features));
        }
    }
    (sums, skipped)
}

fn tell(name: &str, (sums, skipped): &([Shares; 2], usize)) {
    for (of, s) in ["segments", "with contours"].iter().zip(sums) {
        let chance = s.chance as f64 / s.predicted as f64;
        eprintln!(
            "{name}, {of}: recall {:.3} of {}, precision {:.3} of {}, by chance {chance:.3}; {skipped} poses skipped",
            s.recall(),
            s.truth,
            s.precision(),
            s.predicted
        );
    }
}

#[test]
fn silhouettes_of_a_plant_are_found_and_little_else() {
    let world = plant(3);
    let (poses, width) = (env_number("PRESIGHT_CONTOUR_POSES", 4), env_number("PRESIGHT_CONTOUR_WIDTH", 240));
    let poses = data::poses(&world, poses as usize, 11);
    let found = shares(&world, &poses, width as u32);
    tell("plant", &found);
    let [without, with] = found.0;
    assert!(with.recall() >= 0.95 && with.precision() >= 0.93, "{with:?}");
    // Without contours this cannot be reached, nor by lines elsewhere.
    assert!(without.recall() < 0.8, "{without:?}");
    assert!((with.chance as f64) < 0.5 * with.right as f64, "{with:?}");
}

#[test]
fn silhouettes_of_real_scenes_are_found() {
    let Ok(names) = std::env::var("PRESIGHT_CONTOUR_SCENES") else { return };
    let (poses, width) = (env_number("PRESIGHT_CONTOUR_POSES", 4), env_number("PRESIGHT_CONTOUR_WIDTH", 240));
    for name in names.split(',') {
        let Some(world) = data::scene(name, true) else { return };
        let poses = data::poses(&world, poses as usize, 11);
        tell(name, &shares(&world, &poses, width as u32));
    }
}

/// What one plane explains is no edge, what stands before something else is.
#[test]
fn the_truth_knows_edges_from_slopes() {
    let hit = |x: f64, range: f64, normal: DVec3| Hit { ray: DVec3::new(1.0, x, 0.0).normalize(), range, normal };
    let crease = 30f64.to_radians();
    let floor = DVec3::new(-0.05, 1.0, 0.0).normalize();
    let on = |x: f64| {
        let ray = DVec3::new(1.0, x, 0.0).normalize();
        hit(x, floor.dot(DVec3::new(5.0, 0.0, 0.0)) / floor.dot(ray), floor)
    };
    assert!(!parts(&on(0.0), &on(0.02), crease), "one slope, seen flat");
    let wall = DVec3::NEG_X;
    assert!(parts(&hit(0.0, 2.0, wall), &hit(0.001, 2.1, wall), crease));
    assert!(!parts(&hit(0.0, 2.0, wall), &hit(0.001, 2.001, wall), crease), "a millimetre");
    assert!(parts(&hit(0.0, 2.0, wall), &hit(0.001, f64::INFINITY, DVec3::NAN), crease));
    assert!(parts(&hit(0.0, 2.0, wall), &hit(0.001, 2.0, DVec3::Y), crease));
}
