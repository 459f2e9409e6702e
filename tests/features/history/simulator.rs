//! A robot with a camera drives through a hall of points. The simulator does not use the tracker's motion model: the
//! robot is a unicycle with limited accelerations, points are fixed in space, and pixels follow by projection.

use glam::{DMat2, DVec2, DVec3};
use presight_localize::history::{Seed, Window};
use presight_localize::matching::{Detection, DetectionProperties, ExpectedProperties, Shape, UncertainValue};
use presight_model::statistics::normal_pair;
use std::f64::consts::{PI, TAU};

/// xorshift64* of G. Marsaglia and S. Vigna.
#[derive(Clone)]
pub struct Random(pub u64);

impl Random {
    pub fn unit(&mut self) -> f64 {
        self.0 ^= self.0 >> 12;
        self.0 ^= self.0 << 25;
        self.0 ^= self.0 >> 27;
        (self.0.wrapping_mul(0x2545_f491_4f6c_dd1d) >> 11) as f64 / (1u64 << 53) as f64
    }

    pub fn between(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * self.unit()
    }

    /// Two independent standard normal numbers (Box-Muller).
    pub fn normal(&mut self) -> DVec2 {
        let [x, y] = [self.unit(), self.unit()];
        normal_pair(1.0 - x, y, 1.0).into()
    }
}

/// A part of the drive: its duration, and the robot's target speeds.
#[derive(Clone, Copy)]
pub struct Leg {
    pub seconds: f64,
    /// Metres a second.
    pub forward: f64,
    /// Radians a second, to the left.
    pub turn: f64,
}

pub const fn leg(seconds: f64, forward: f64, turn: f64) -> Leg {
    Leg { seconds, forward, turn }
}

/// The disturbances of the images.
#[derive(Clone, Copy)]
pub struct Disturbance {
    /// The noise of each detected coordinate, pixels.
    pub noise: f64,
    /// Common to a whole frame, as the camera shakes, pixels.
    pub jitter: f64,
    pub misses: f64,
    /// False detections in each window.
    pub clutter: u32,
    /// True if detections have properties.
    pub properties: bool,
}

impl Default for Disturbance {
    fn default() -> Self {
        Self { noise: 0.5, jitter: 0.2, misses: 0.2, clutter: 3, properties: true }
    }
}

pub const WIDTH: u32 = 640;
pub const HEIGHT: u32 = 480;
pub const FOCAL: f64 = 500.0;
const RATE: f64 = 20.0;
/// m/s^2 and rad/s^2.
pub const ACCELERATIONS: [f64; 2] = [1.0, 1.5];
/// One sigma of the properties.
pub const TOLD: [f64; 3] = [0.05, 0.05, 0.05];

#[derive(Clone, Copy)]
pub struct Point {
    pub at: DVec3,
    pub told: [f64; 3],
}

/// The robot's pose.
#[derive(Clone, Copy, Default)]
pub struct Robot {
    pub x: f64,
    pub y: f64,
    pub heading: f64,
    pub forward: f64,
    pub turn: f64,
}

impl Robot {
    /// The pixel of a world point; `None` if it is behind the camera, outside the image, or too far or near.
    pub fn see(&self, p: DVec3) -> Option<DVec2> {
        let pixel = self.project(p)?;
        let inside =
            pixel.x > 0.0 && pixel.x < f64::from(WIDTH) - 1.0 && pixel.y > 0.0 && pixel.y < f64::from(HEIGHT) - 1.0;
        inside.then_some(pixel)
    }

    pub fn project(&self, p: DVec3) -> Option<DVec2> {
        let (s, c) = self.heading.sin_cos();
        let (dx, dy) = (p.x - self.x, p.y - self.y);
        let (ahead, left) = (c * dx + s * dy, c * dy - s * dx);
        (2.0..25.0)
            .contains(&ahead)
            .then(|| DVec2::new(319.5 - FOCAL * left / ahead, 239.5 - FOCAL * (p.z - 1.2) / ahead))
    }

    fn drive(&mut self, seconds: f64, leg: &Leg) {
        let steps = 50;
        let dt = seconds / f64::from(steps);
        for _ in 0..steps {
            let towards = |now: f64, to: f64, most: f64| now + (to - now).clamp(-most * dt, most * dt);
            self.forward = towards(self.forward, leg.forward, ACCELERATIONS[0]);
            self.turn = towards(self.turn, leg.turn, ACCELERATIONS[1]);
            self.heading += self.turn * dt;
            self.x += self.forward * self.heading.cos() * dt;
            self.y += self.forward * self.heading.sin() * dt;
        }
    }
}

/// The truth of one frame.
pub struct Frame {
    pub time: f64,
    pub robot: Robot,
    pub leg: usize,
    /// The camera's shaking, pixels.
    pub shake: DVec2,
}

pub struct Simulator {
    pub points: Vec<Point>,
    pub random: Random,
    pub disturbance: Disturbance,
}

impl Simulator {
    pub fn new(seed: u64, disturbance: Disturbance) -> Self {
        let mut random = Random(seed * 0x9e37_79b9 + 1);
        let mut point = || {
            let at = DVec3::new(random.between(-40.0, 80.0), random.between(-60.0, 60.0), random.between(0.0, 5.0));
            Point { at, told: [random.unit(), random.unit(), PI * random.unit()] }
        };
        let points = (0..6000).map(|_| point()).collect();
        Self { points, random, disturbance }
    }

    /// The frames of a drive, which starts at the first leg's speeds.
    pub fn drive(&mut self, legs: &[Leg]) -> Vec<Frame> {
        let mut robot = Robot { forward: legs[0].forward, turn: legs[0].turn, ..Robot::default() };
        let (mut time, mut frames) = (0.0, Vec::new());
        for (i, leg) in legs.iter().enumerate() {
            let mut since = 0.0;
            while since < leg.seconds {
                // The camera's clock is accurate to a tenth of a frame.
                let interval = self.random.between(0.9, 1.1) / RATE;
                robot.drive(interval, leg);
                (time, since) = (time + interval, since + interval);
                let shake = self.random.normal() * self.disturbance.jitter;
                frames.push(Frame { time, robot, leg: i, shake });
            }
        }
        frames
    }

    /// The full prediction of this frame at a pose that is a pixel off; at most `most` features.
    pub fn predict_fully(&mut self, frame: &Frame, most: usize) -> Vec<Seed> {
        let off = self.random.normal();
        let mut seeds = Vec::new();
        for (i, point) in self.points.iter().enumerate() {
            if let Some(pixel) = frame.robot.see(point.at)
                && seeds.len() < most
            {
                let told = |k: usize| Some(UncertainValue { mean: point.told[k], variance: TOLD[k] * TOLD[k] });
                seeds.push(Seed {
                    id: i as u32,
                    shape: Shape::Point(pixel + off),
                    covariances: vec![DMat2::IDENTITY],
                    properties: if self.disturbance.properties {
                        ExpectedProperties {
                            strength: told(0),
                            contrast: told(1),
                            direction: told(2),
                            ..ExpectedProperties::default()
                        }
                    } else {
                        ExpectedProperties::default()
                    },
                });
            }
        }
        seeds
    }

    /// A feature's detected place; `None` outside the image.
    pub fn detected_at(&mut self, frame: &Frame, id: u32) -> Option<DVec2> {
        let noise = self.random.normal() * self.disturbance.noise;
        Some(frame.robot.see(self.points[id as usize].at)? + frame.shake + noise)
    }

    /// A detection of a feature, or of clutter.
    pub fn detection(&mut self, at: DVec2, id: Option<u32>) -> Detection {
        let mut detection = Detection::point(at, self.disturbance.noise.max(0.1));
        if self.disturbance.properties {
            let random = &mut self.random;
            let told = match id {
                Some(id) => {
                    let (a, b) = (random.normal(), random.normal());
                    let noise = [a.x, a.y, b.x];
                    let told = self.points[id as usize].told;
                    [0, 1, 2].map(|k| told[k] + TOLD[k] * noise[k])
                }
                None => [random.unit(), random.unit(), PI * random.unit()],
            };
            let [strength, contrast, direction] = told.map(Some);
            detection.properties =
                DetectionProperties { strength, contrast, direction, ..DetectionProperties::default() };
        }
        detection
    }

    /// The extractor's detections in the windows, with the feature of each.
    pub fn extract(&mut self, windows: &[Window], wanted: &[Option<DVec2>]) -> (Vec<Detection>, Vec<Option<u32>>) {
        let (mut found, mut whose) = (Vec::new(), Vec::new());
        for (window, at) in windows.iter().zip(wanted) {
            if let Some(at) = at
                && self.random.unit() >= self.disturbance.misses
                && holds(&window.bounds, *at)
            {
                found.push(self.detection(*at, Some(window.id)));
                whose.push(Some(window.id));
            }
            for _ in 0..self.disturbance.clutter {
                let [x0, y0, x1, y1] = window.bounds;
                let at = DVec2::new(self.random.between(x0, x1), self.random.between(y0, y1));
                found.push(self.detection(at, None));
                whose.push(None);
            }
        }
        (found, whose)
    }
}

pub fn holds([x0, y0, x1, y1]: &[f64; 4], p: DVec2) -> bool {
    p.x >= *x0 && p.x <= *x1 && p.y >= *y0 && p.y <= *y1
}

/// Edges in space and their extraction: broken anywhere, unless a corner ends them.
pub struct Edges {
    pub ends: Vec<[DVec3; 2]>,
    /// True for each end with a corner.
    pub corners: Vec<[bool; 2]>,
    /// Strength and contrast.
    pub told: Vec<[f64; 2]>,
}

impl Edges {
    /// Door frames and shelves: upright and horizontal edges of 0.5 to 2 m.
    pub fn new(random: &mut Random, count: usize) -> Self {
        let mut edges = Self { ends: Vec::new(), corners: Vec::new(), told: Vec::new() };
        for _ in 0..count {
            let at = DVec3::new(random.between(-20.0, 60.0), random.between(-30.0, 30.0), random.between(0.0, 3.0));
            let length = random.between(0.5, 2.0);
            let heading = TAU * random.unit();
            let level = DVec3::new(heading.cos(), heading.sin(), 0.0);
            let along = if random.unit() < 0.5 { DVec3::Z } else { level };
            edges.ends.push([at, at + length * along]);
            edges.told.push([random.unit(), random.unit()]);
            edges.corners.push([random.unit() < 0.5, random.unit() < 0.5]);
        }
        edges
    }

    /// The pixels of both ends; `None` unless both are in the image and 20 pixels apart.
    pub fn see(&self, robot: &Robot, id: u32) -> Option<[DVec2; 2]> {
        let [a, b] = self.ends[id as usize];
        let (a, b) = (robot.see(a)?, robot.see(b)?);
        (a.distance(b) > 20.0).then_some([a, b])
    }

    /// The extractor's result for an edge at these pixels: each end without a corner slides inwards by up to a quarter.
    pub fn detect(&self, random: &mut Random, ends: [DVec2; 2], id: u32, sigma: f64) -> Detection {
        let corners = self.corners[id as usize];
        let mut share = [0.0, 1.0];
        for k in 0..2 {
            if !corners[k] {
                share[k] += (1.0 - 2.0 * share[k]) * 0.25 * random.unit();
            }
        }
        let found = share.map(|t| ends[0].lerp(ends[1], t) + random.normal() * sigma);
        // The ends come in either order.
        let (found, corners) =
            if random.unit() < 0.5 { (found, corners) } else { ([found[1], found[0]], [corners[1], corners[0]]) };
        let noise = random.normal();
        let [strength, contrast] = [0, 1].map(|k| Some(self.told[id as usize][k] + TOLD[k] * noise[k]));
        let properties = DetectionProperties { strength, contrast, ..DetectionProperties::default() };
        Detection { properties, ..Detection::new(Shape::Segment { ends: found, corners }, sigma) }
    }
}
