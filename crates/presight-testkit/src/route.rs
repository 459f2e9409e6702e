//! Routes of a robot on a level floor, clear of obstacles.

use super::Random;
use super::oracle::Oracle;
use glam::DVec3;
use presight_model::geometry::{Aabb, Pose};
use std::f64::consts::{PI, TAU};

/// Time between the poses of a route, seconds.
const STEP: f64 = 0.02;
/// Heights above the floor that must be clear, metres.
const HEIGHTS: [f64; 3] = [0.2, 0.5, 0.9];
/// Number of directions in which obstacles are searched.
const DIRECTIONS: usize = 24;
/// Accelerations, m/s^2 and rad/s^2.
const ACCELERATION: (f64, f64) = (1.0, 2.5);
/// Maximum number of random starts.
const TRIES: u64 = 2000;

/// Duration and limits of a drive.
#[derive(Clone, Copy, Debug)]
pub struct Driving {
    /// Duration, seconds.
    pub seconds: f64,
    /// Maximum speed, m/s.
    pub speed: f64,
    /// Maximum turn rate, rad/s.
    pub turn: f64,
}

/// The poses of a robot over time, upright on the floor at z = 0.
#[derive(Clone, Debug)]
pub struct Route {
    /// x, y, yaw; the yaw has no jumps.
    places: Vec<[f64; 3]>,
}

impl Route {
    /// A straight route from a place, metres and radians.
    pub fn straight([x, y, yaw]: [f64; 3], speed: f64, seconds: f64) -> Self {
        let at = |k: usize| speed * STEP * k as f64;
        let place = |k: usize| [x + at(k) * yaw.cos(), y + at(k) * yaw.sin(), yaw];
        Self { places: (0..=(seconds / STEP).ceil() as usize).map(place).collect() }
    }

    /// A random route within the environment's `bounds`, at least 0.3 m from all surfaces. Equal seeds give equal
    /// routes.
    ///
    /// # Panics
    /// If no free route is found.
    pub fn wander(oracle: &Oracle, bounds: &Aabb, driving: &Driving, seed: u64) -> Self {
        let mut random = Random(seed);
        for _ in 0..TRIES {
            let [x, y] = [0, 1].map(|i| random.uniform(bounds.min[i], bounds.max[i]));
            let start = [x, y, random.uniform(-PI, PI)];
            let phase = random.uniform(0.0, TAU);
            if !is_inside(oracle, start) {
                continue;
            }
            let places = driven(oracle, driving, start, phase);
            let length: f64 = places.windows(2).map(|p| (p[1][0] - p[0][0]).hypot(p[1][1] - p[0][1])).sum();
            let far = 0.3 * driving.speed * driving.seconds;
            let sees = |p: &&[f64; 3]| is_inside(oracle, **p);
            if length > far && places.iter().step_by(50).filter(sees).count() > places.len() / 55 {
                return Self { places };
            }
        }
        panic!("no free route was found")
    }

    /// The robot's pose at a time from 0 on, seconds. It stands still at the end.
    pub fn at(&self, time: f64) -> Pose {
        let [x, y, yaw] = self.place(time);
        Pose::from_xyz_rpy(DVec3::new(x, y, 0.0), 0.0, 0.0, yaw)
    }

    fn place(&self, time: f64) -> [f64; 3] {
        let last = self.places.len() - 1;
        let k = (time / STEP).clamp(0.0, last as f64);
        let (a, b) = (self.places[k as usize], self.places[(k as usize + 1).min(last)]);
        std::array::from_fn(|i| a[i] + k.fract() * (b[i] - a[i]))
    }

    /// Its places, x and y, some centimetres apart.
    pub fn places(&self) -> impl Iterator<Item = [f64; 2]> + '_ {
        self.places.iter().step_by(5).map(|p| [p[0], p[1]])
    }

    /// Duration, seconds.
    pub fn duration(&self) -> f64 {
        STEP * (self.places.len() - 1) as f64
    }
}

/// Distances to the nearest obstacles in all directions, counter-clockwise from straight ahead.
fn around(oracle: &Oracle, [x, y, yaw]: [f64; 3]) -> [f64; DIRECTIONS] {
    std::array::from_fn(|k| {
        let azimuth = yaw + TAU * k as f64 / DIRECTIONS as f64;
        let direction = DVec3::new(azimuth.cos(), azimuth.sin(), 0.0);
        HEIGHTS.map(|z| oracle.distance(DVec3::new(x, y, z), direction)).into_iter().fold(f64::INFINITY, f64::min)
    })
}

/// True on a free piece of floor from which most directions meet something within 12 m.
fn is_inside(oracle: &Oracle, place: [f64; 3]) -> bool {
    let floor = oracle.distance(DVec3::new(place[0], place[1], 0.9), DVec3::NEG_Z);
    let seen = around(oracle, place);
    (floor - 0.9).abs() < 0.1
        && seen.iter().all(|d| *d > 0.3)
        && seen.iter().filter(|d| **d < 12.0).count() > DIRECTIONS * 2 / 3
}

/// Places every [`STEP`]; the list ends early if something came too near.
fn driven(oracle: &Oracle, driving: &Driving, start: [f64; 3], phase: f64) -> Vec<[f64; 3]> {
    let (mut place, mut speed, mut turn, mut side) = (start, 0.0, 0.0, 0.0);
    let mut places = vec![place];
    let mut wanted = (0.0, 0.0);
    let count = (driving.seconds / STEP).ceil() as usize;
    for k in 0..count {
        if k % 5 == 0 {
            let seen = around(oracle, place);
            if seen.iter().any(|d| *d < 0.3) {
                return Vec::new();
            }
            let ahead = (0..DIRECTIONS).filter(|i| *i <= 3 || *i >= DIRECTIONS - 3).map(|i| seen[i]);
            let ahead = ahead.fold(f64::INFINITY, f64::min);
            let sum = |from: usize| seen[from..from + 6].iter().map(|d| d.min(3.0)).sum::<f64>();
            let is_blocked = ahead < 0.7 + 0.6 * driving.speed;
            side = match (is_blocked, side == 0.0) {
                (false, _) => 0.0,
                (true, true) => {
                    if sum(1) > sum(DIRECTIONS - 6) {
                        1.0
                    } else {
                        -1.0
                    }
                }
                (true, false) => side,
            };
            let idle = 0.6 * (0.9 * STEP * k as f64 + phase).sin();
            let braking = (2.0 * ACCELERATION.0 * (ahead - 0.45).max(0.0) * 0.6).sqrt();
            wanted = (braking.min(driving.speed), driving.turn * if is_blocked { side } else { idle });
        }
        let towards = |x: f64, to: f64, most: f64| x + (to - x).clamp(-most * STEP, most * STEP);
        speed = towards(speed, wanted.0, ACCELERATION.0);
        turn = towards(turn, wanted.1, ACCELERATION.1);
        let yaw = place[2] + 0.5 * STEP * turn;
        place = [place[0] + STEP * speed * yaw.cos(), place[1] + STEP * speed * yaw.sin(), place[2] + STEP * turn];
        places.push(place);
    }
    places
}
