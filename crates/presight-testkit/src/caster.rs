//! Logs of a sensor on a robot, made by the ray caster of another library: noise, drop-outs, mixed pixels, people who
//! walk by, scans that take time, and odometry that slips. It uses neither presight's engines nor its simulator.

use super::Random;
use super::oracle::Oracle;
use super::route::Route;
use glam::{DQuat, DVec3};
use presight_model::environment::Environment;
use presight_model::geometry::Pose;
use presight_model::measured::{Frame, Measurement, Motion, OdometryNoise, RangeNoise};
use presight_model::sensor::{RayTimes, Sensor};
use std::f64::consts::TAU;

/// A range that differs from its neighbour's by more than this fraction is behind an edge.
const JUMP: f64 = 0.05;
/// A person is an upright cylinder of this radius and height, metres.
const PERSON: (f64, f64) = (0.25, 1.75);
/// Width of a pane of glass, metres, and the least cosine of incidence at which it returns a reading: others pass through.
const PANE: (f64, f64) = (1.5, 0.97);
/// Metres that a person walks before turning round, and metres per second.
const WALK: (f64, f64) = (4.0, 1.0);

/// A person.
#[derive(Clone, Copy, Debug)]
enum Person {
    /// Walks to and fro.
    Walks { from: DVec3, direction: DVec3, ahead: f64 },
    /// Stays at this distance ahead of the robot, metres.
    Before(f64),
    /// Walks with the robot at this offset from it, along the world's axes, metres.
    Along(DVec3),
}

/// Errors of odometry.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Slip {
    /// Ratios of the measured to the true distance and to the true turn.
    pub scale: [f64; 2],
    /// Standard deviations, as shares of the distance and of the turn.
    pub noise: [f64; 2],
}

impl Slip {
    /// Wheels that seem 2 % too large, with 2 % of noise.
    pub const USUAL: Self = Self { scale: [1.02, 0.98], noise: [0.02, 0.02] };
}

/// Casts the frames of one sensor.
pub struct Caster {
    oracle: Oracle,
    sensor: Sensor,
    people: Vec<Person>,
    random: Random,
    /// Share of the pixels without a reading.
    pub drop_outs: f64,
    /// Share of the pixels before a jump that measure something in between.
    pub mixed: f64,
    /// The times at which the rays are measured, whatever the sensor states.
    pub times: RayTimes,
    /// Deviation of the stamps from the times of the scans, seconds.
    pub jitter: f64,
    /// `None` for a robot without odometry.
    pub slip: Option<Slip>,
    /// Share of the upright surfaces that are glass, in panes 1.5 m wide.
    pub glass: f64,
}

impl Caster {
    /// Casts into surfaces that are opaque for the class of the sensor. The same seed gives the same frames.
    pub fn new(real: &Environment, sensor: Sensor, seed: u64) -> Self {
        let bounds = real.bounds();
        let origin = 0.5 * (bounds.min + bounds.max);
        let oracle = Oracle::seen_by(real, origin, &sensor.spec().class).expect("something to see");
        let (drop_outs, mixed, slip) = (0.01, 0.3, Some(Slip::USUAL));
        Self {
            oracle,
            sensor,
            people: Vec::new(),
            random: Random(seed),
            drop_outs,
            mixed,
            times: RayTimes::AtOnce,
            jitter: 0.0,
            slip,
            glass: 0.0,
        }
    }

    /// Adds people who walk to and fro 1 to 2.5 m from the route.
    #[must_use]
    pub fn with_walkers(mut self, count: usize, route: &Route, seed: u64) -> Self {
        let mut random = Random(seed ^ 0x77a1);
        for _ in 0..count {
            let near = route.at(random.uniform(0.0, route.duration())).translation;
            let (heading, aside) = (random.uniform(0.0, TAU), random.uniform(1.0, 2.5));
            let direction = DVec3::new(heading.cos(), heading.sin(), 0.0);
            let from = near + aside * DVec3::new(-direction.y, direction.x, 0.0) - 0.5 * WALK.0 * direction;
            self.people.push(Person::Walks { from, direction, ahead: random.uniform(0.0, 2.0 * WALK.0 / WALK.1) });
        }
        self
    }

    /// Adds a person who is always `metres` ahead of the robot.
    #[must_use]
    pub fn with_person_before(mut self, metres: f64) -> Self {
        self.people.push(Person::Before(metres));
        self
    }

    /// Adds a crowd of people all round, 0.8 to 2 m from the robot, who go where it goes.
    #[must_use]
    pub fn with_crowd(mut self, count: usize, seed: u64) -> Self {
        let mut random = Random(seed ^ 0xc40d);
        for k in 0..count {
            let (azimuth, far) = (TAU * (k as f64 + random.unit()) / count as f64, random.uniform(0.8, 2.0));
            self.people.push(Person::Along(far * DVec3::new(azimuth.cos(), azimuth.sin(), 0.0)));
        }
        self
    }

    /// The frame with its stamp at `time`, with the odometry since `before`. `pose` gives the robot's
    /// true pose at each time, seconds.
    pub fn frame(&mut self, pose: &dyn Fn(f64) -> Pose, time: f64, before: Option<f64>) -> Frame {
        let jitter = self.random.normal(self.jitter);
        let ranges = self.measured(pose, time);
        let mut frame =
            Frame::new(time + jitter, self.sensor.clone(), Measurement::Range(ranges)).expect("a sound frame");
        let slip = self.slip;
        frame.motion =
            before.zip(slip).map(|(before, slip)| self.odometry(&(pose(before).inverse() * pose(time)), slip));
        frame
    }

    fn measured(&mut self, pose: &dyn Fn(f64) -> Pose, time: f64) -> Vec<f32> {
        let (width, height) = (self.sensor.width(), self.sensor.height());
        let mount = self.sensor.spec().mount;
        let columns: Vec<(Pose, f64)> =
            (0..width).map(|c| time + self.times.seconds(c, 0, (width, height))).map(|t| (pose(t), t)).collect();
        let people: Vec<Vec<DVec3>> = columns.iter().map(|(pose, t)| self.people_at(pose, *t)).collect();
        let seen: Vec<Option<(f64, f64)>> = (0..height)
            .flat_map(|r| (0..width).map(move |c| (c, r)))
            .map(|(c, r)| self.seen(&(columns[c as usize].0 * mount), &people[c as usize], (c, r)))
            .collect();
        (0..seen.len()).map(|i| self.disturbed(&seen, i, width as usize)).collect()
    }

    /// The true range of a pixel and its cosine of incidence; `None` without a ray.
    fn seen(&self, world_from_sensor: &Pose, people: &[DVec3], (c, r): (u32, u32)) -> Option<(f64, f64)> {
        let ray = self.sensor.ray(c, r)?;
        let direction = world_from_sensor.rotation * (self.sensor.body_from_image() * ray);
        let from = world_from_sensor.translation;
        let (range, cos) = self.met(from, direction).unwrap_or((f64::INFINITY, 1.0));
        let person = people.iter().filter_map(|at| person_hit(from - *at, direction)).fold(f64::INFINITY, f64::min);
        Some(if person < range { (person, 1.0) } else { (range, cos) })
    }

    /// The first surface that returns a reading, through as many panes of glass as a ray meets.
    fn met(&self, from: DVec3, direction: DVec3) -> Option<(f64, f64)> {
        let mut before = 0.0;
        for _ in 0..16 {
            let (range, cos) = self.oracle.hit(from + before * direction, direction)?;
            let at = from + (before + range) * direction;
            if !(self.glass > 0.0 && cos < PANE.1 && at.z > 0.05 && is_pane(at, self.glass)) {
                return Some((before + range, cos));
            }
            before += range + 1e-6;
        }
        None
    }

    fn people_at(&self, robot: &Pose, time: f64) -> Vec<DVec3> {
        let place = |person: &Person| match person {
            Person::Walks { from, direction, ahead } => {
                let gone = (WALK.1 * (time + ahead)).rem_euclid(2.0 * WALK.0);
                *from + *direction * if gone <= WALK.0 { gone } else { 2.0 * WALK.0 - gone }
            }
            Person::Before(metres) => robot.transform_point(DVec3::X * *metres).with_z(0.0),
            // Each sways by 0.2 m at a pace of their own.
            Person::Along(off) => {
                let sway = 0.2 * (time * (1.0 + off.x.abs()) + off.y).sin();
                (robot.translation + *off * (1.0 + sway)).with_z(0.0)
            }
        };
        self.people.iter().map(place).collect()
    }

    /// The reading of a pixel. Every pixel draws the same random numbers.
    fn disturbed(&mut self, seen: &[Option<(f64, f64)>], i: usize, width: usize) -> f32 {
        let noise = RangeNoise::of(&self.sensor);
        let (along, across) = (self.random.normal(1.0), self.random.normal(1.0));
        let (lost, mixed, between) = (self.random.unit(), self.random.unit(), self.random.unit());
        let spec = self.sensor.spec();
        let Some((mut z, cos)) = seen[i] else { return f32::NAN };
        if lost < self.drop_outs {
            return f32::NAN;
        }
        if z > spec.range_max {
            return f32::INFINITY;
        }
        let next = if (i + 1).is_multiple_of(width) { None } else { seen[i + 1] };
        if let Some((next, _)) = next.filter(|(n, _)| n.is_finite() && (n - z).abs() > JUMP * z)
            && mixed < self.mixed
        {
            z += between * (next - z);
        }
        let cos = cos.clamp(0.05, 1.0);
        z += noise.range_sigma(z) * along + z * noise.angle * (1.0 - cos * cos).sqrt() / cos * across;
        match z {
            _ if z < spec.range_min => f32::NEG_INFINITY,
            _ if z > spec.range_max => f32::INFINITY,
            _ => z as f32,
        }
    }

    fn odometry(&mut self, truth: &Pose, slip: Slip) -> Motion {
        let (axis, angle) = truth.rotation.to_axis_angle();
        let distance = slip.scale[0] + self.random.normal(slip.noise[0]);
        let turn = slip.scale[1] + self.random.normal(slip.noise[1]);
        let measured =
            Pose { translation: distance * truth.translation, rotation: DQuat::from_axis_angle(axis, turn * angle) };
        Motion::of_odometry(measured, &OdometryNoise::default())
    }
}

/// True for this share of the places, pane by pane.
fn is_pane(at: DVec3, share: f64) -> bool {
    let [x, y] = [at.x, at.y].map(|v| ((v + 0.193) / PANE.0).floor() as i64 as u64);
    Random(x.wrapping_mul(0x9e37_79b9) ^ y.wrapping_mul(0x85eb_ca6b_c2b2)).unit() < share
}

/// Metres to a person whose feet are at the origin.
fn person_hit(from: DVec3, direction: DVec3) -> Option<f64> {
    let (p, d) = (from.truncate(), direction.truncate());
    let (a, b, c) = (d.length_squared(), p.dot(d), p.length_squared() - PERSON.0 * PERSON.0);
    let root = b * b - a * c;
    if root < 0.0 || a < 1e-12 || c < 0.0 {
        return None;
    }
    let t = (-b - root.sqrt()) / a;
    (t > 0.0 && (0.0..PERSON.1).contains(&(from.z + t * direction.z))).then_some(t)
}
