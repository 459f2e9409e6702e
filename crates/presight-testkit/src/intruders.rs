//! Corridors with something in them: sensors, places and intruders for tests of supervision.

use super::Random;
use super::scenes::cuboid;
use glam::{DVec3, Vec3};
use presight_model::environment::{Environment, Mesh, NewObject};
use presight_model::floor::{Mobility, height_below};
use presight_model::geometry::{Pose, PoseCovariance, PoseEstimate, RobotPose};
use presight_model::index::QueryResult;
use presight_model::sensor::{Angles, Geometry, Noise, Scanner, Sensor, SensorSpec};
use presight_model::world::World;
use std::f64::consts::TAU;
use std::sync::Arc;

/// Length, half the width, and heights of the corridors, metres.
pub const LENGTH: f64 = 4.0;
/// See [`LENGTH`].
pub const HALF_WIDTH: f64 = 0.4;
/// See [`LENGTH`].
pub const HEIGHTS: [f64; 2] = [0.06, 1.8];
/// What intrudes: the name, and the size of its box along x, y and z, metres, the bottom's height included.
pub const KINDS: [(&str, [f64; 3], f64); 4] = [
    ("leg", [0.07, 0.07, 1.0], 0.0),
    ("box", [0.2, 0.2, 0.2], 0.0),
    ("pallet", [1.2, 0.8, 0.15], 0.0),
    ("fork", [1.0, 0.1, 0.06], 0.08),
];

/// The object's name of every intruder.
pub const INTRUDER: &str = "intruder";

/// A laser range camera, a lidar of 32 rows and a planar scanner, each mounted on a robot.
pub fn sensors() -> [(&'static str, Sensor); 3] {
    let uniform = |start_deg: f64, step_deg: f64, count: u32| Angles::Uniform { start_deg, step_deg, count };
    let made = |name: &'static str, azimuth: Angles, elevation: Angles, mount: DVec3, reach: f64| {
        let geometry = Geometry::Scanner(Scanner { azimuth, elevation, beam_height_deg: None });
        let spec = SensorSpec::new(name, "laser", geometry)
            .with_limits(0.05, reach)
            .with_mount(Pose::from_xyz_rpy(mount, 0.0, 0.0, 0.0))
            .with_noise(Noise { range_sigma: 0.01, ..Noise::default() });
        (name, Sensor::new(spec).expect("a sound sensor"))
    };
    [
        made(
            "laser range camera",
            uniform(-30.0, 0.1875, 321),
            uniform(-55.0, 1.5, 41),
            DVec3::new(0.2, 0.0, 1.2),
            10.0,
        ),
        made(
            "lidar of 32 rows",
            uniform(-180.0, 0.4, 900),
            uniform(-25.0, 4.0 / 3.0, 32),
            DVec3::new(0.2, 0.0, 0.9),
            30.0,
        ),
        made("planar scanner", uniform(-90.0, 0.5, 361), uniform(0.0, 1.0, 1), DVec3::new(0.2, 0.0, 0.2), 30.0),
    ]
}

/// The box of a kind of intruder, as a mesh that stands on z = 0; a leg is round.
pub fn mesh_of(kind: usize) -> Mesh {
    let (name, [x, y, z], from) = KINDS[kind];
    if name == "leg" {
        return round_leg(0.5 * x, z);
    }
    let half = Vec3::new(0.5 * x as f32, 0.5 * y as f32, 0.0);
    cuboid(Vec3::new(-half.x, -half.y, from as f32), Vec3::new(half.x, half.y, (from + z) as f32))
}

/// A prism of 16 sides around a circle, so that it is nowhere thinner.
fn round_leg(radius: f64, height: f64) -> Mesh {
    let sides = 16;
    let outer = radius / (TAU / f64::from(2 * sides)).cos();
    let corner = |i: u32, z: f64| {
        let (sin, cos) = (TAU * f64::from(i % sides) / f64::from(sides)).sin_cos();
        DVec3::new(outer * cos, outer * sin, z).as_vec3()
    };
    let side = |i: u32| vec![corner(i, 0.0), corner(i + 1, 0.0), corner(i + 1, height), corner(i, height)];
    let mut polygons: Vec<Vec<Vec3>> = (0..sides).map(side).collect();
    polygons.push((0..sides).map(|i| corner(i, height)).collect());
    polygons.push((0..sides).rev().map(|i| corner(i, 0.0)).collect());
    super::scenes::mesh(&polygons)
}

/// A random place of an intruder in the corridor, robot's frame.
pub fn random_place(random: &mut Random) -> Pose {
    let at = DVec3::new(random.uniform(0.6, LENGTH), random.uniform(-HALF_WIDTH, HALF_WIDTH), 0.0);
    Pose::from_xyz_rpy(at, 0.0, 0.0, random.uniform(0.0, TAU))
}

/// The environment with an intruder of a kind.
pub fn with_intruder(environment: &Environment, world_from_intruder: Pose, kind: usize) -> Environment {
    let mut environment = environment.clone();
    environment.insert(NewObject::new(INTRUDER, world_from_intruder, Arc::new(mesh_of(kind)))).expect("a sound object");
    environment
}

/// Level poses of a robot on the floor of a world, with what `is_wanted` wants ahead; `None` if there are too few.
pub fn floor_poses(
    world: &World,
    count: usize,
    random: &mut Random,
    is_wanted: &mut dyn FnMut(&Pose) -> bool,
) -> Option<Vec<Pose>> {
    let bounds = world.environment().bounds();
    let mut found = QueryResult::default();
    let mut poses = Vec::new();
    for _ in 0..20_000 * count {
        if poses.len() == count {
            return Some(poses);
        }
        let part = DVec3::new(random.unit(), random.unit(), random.unit());
        let at = bounds.min + (bounds.max - bounds.min) * part;
        let yaw = random.uniform(0.0, TAU);
        let floor = height_below(world, at, bounds.size(), &Mobility::default(), &mut found);
        let Some(floor) = floor.filter(|floor| at.z - floor > 0.3) else { continue };
        let pose = Pose::from_xyz_rpy(at.with_z(floor), 0.0, 0.0, yaw);
        if is_wanted(&pose) {
            poses.push(pose);
        }
    }
    None
}

/// An estimate of a robot's true pose: off by a random error of these deviations along all axes.
pub fn believed(truth: &Pose, [metres, radians]: [f64; 2], random: &mut Random) -> PoseEstimate {
    let mut off = |sigma: f64| DVec3::new(random.normal(sigma), random.normal(sigma), random.normal(sigma));
    let (shift, turn) = (off(metres), off(radians));
    let pose = Pose {
        translation: truth.translation + shift,
        rotation: (glam::DQuat::from_scaled_axis(turn) * truth.rotation).normalize(),
    };
    let (t, r) = (metres, radians);
    PoseEstimate::new(RobotPose::new(pose), PoseCovariance::from_sigmas([t, t, t, r, r, r]))
}

/// The rays of the test kit's caster that hit an intruder.
pub mod truth {
    use super::INTRUDER;
    use crate::oracle::Oracle;
    use glam::{DVec3, Quat, Vec3};
    use presight_model::environment::{Environment, NewObject};
    use presight_model::geometry::Pose;
    use presight_model::measured::Frame;
    use presight_model::sensor::{Geometry, Sensor};
    use presight_model::world::World;
    use presight_predict::virtual_sensors::Corridor;
    use presight_render::verify::PixelValues;

    /// The intruder without its surroundings, seen from a place.
    pub struct Alone {
        oracle: Oracle,
        from: DVec3,
    }

    /// The intruder of an environment, seen from a sensor.
    pub fn alone(environment: &Environment, world_from_sensor: &Pose) -> Alone {
        let intruder = environment.object(INTRUDER).expect("an intruder");
        let mut only = crate::scenes::empty();
        only.insert(NewObject::new(INTRUDER, intruder.world_from_object, intruder.mesh.clone()))
            .expect("a sound object");
        let from = world_from_sensor.translation;
        Alone { oracle: Oracle::new(&only, from).expect("triangles"), from }
    }

    /// True ranges of the pixels that see the intruder in the corridor (robot's frame) and measured it, neither lost
    /// nor mixed with their background, metres.
    pub fn pixels(world: &World, alone: &Alone, frame: &Frame, robot: &Pose, corridor: &Corridor) -> Vec<f64> {
        let sensor = frame.sensor();
        let world_from_sensor = *robot * sensor.spec().mount;
        let all = Oracle::new(world.environment(), world_from_sensor.translation).expect("triangles");
        let range = |values: Option<PixelValues>| values.and_then(|v| v.range).filter(|r| r.is_finite());
        let mut seen = Vec::new();
        for (column, row) in (0..sensor.height()).flat_map(|row| (0..sensor.width()).map(move |column| (column, row))) {
            let Some(own) = range(alone.oracle.cast(sensor, &world_from_sensor, (column, row))) else { continue };
            let first = range(all.cast(sensor, &world_from_sensor, (column, row)));
            let ray = sensor.body_from_image() * sensor.ray(column, row).expect("a ray");
            let p_in_robot = sensor.spec().mount.transform_point(f64::from(own) * ray);
            let at = (row * sensor.width() + column) as usize;
            let is_measured = (frame.ranges()[at] - own).abs() < 5.0 * sensor.spec().noise.range_sigma as f32;
            if first.is_some_and(|first| (first - own).abs() < 1e-4)
                && is_measured
                && corridor.arc_length_at(p_in_robot.to_array()).is_some()
            {
                seen.push(f64::from(own));
            }
        }
        seen
    }

    /// True if a scanner has rays around a point of its body axes, by its angles.
    pub fn is_in_view(sensor: &Sensor, p: DVec3) -> bool {
        let Geometry::Scanner(scanner) = &sensor.spec().geometry else { unreachable!("a scanner") };
        let azimuth = p.y.atan2(p.x).to_degrees();
        let elevation = p.z.atan2(p.x.hypot(p.y)).to_degrees();
        let ends = |angles: &presight_model::sensor::Angles| {
            let (first, last) = (angles.degrees(0), angles.degrees(angles.len() - 1));
            let half = 0.5 * (last - first).abs() / (angles.len().max(2) - 1) as f64;
            (first.min(last) - half, first.max(last) + half)
        };
        let (a, e) = (ends(&scanner.azimuth), ends(&scanner.elevation));
        azimuth >= a.0 && azimuth <= a.1 && elevation >= e.0 && elevation <= e.1
    }

    impl Alone {
        /// True if rays from the sensor meet the intruder inside of a box of the robot's frame on a whole disc of this
        /// width across them: then a part at least so wide is in the box.
        pub fn holds_part(&self, robot: &Pose, min: DVec3, max: DVec3, width: f64) -> bool {
            let (middle, radius) = (0.5 * (min + max), 0.5 * (max - min).length());
            let eye = robot.inverse().transform_point(self.from);
            let distance = middle.distance(eye);
            let towards = (middle - eye) / distance;
            // No part of the intruder near the box: one ray fan would be enough, but a bound is quicker.
            let turn = Quat::from_rotation_arc(Vec3::X, towards.as_vec3()).as_dquat();
            let (across, up) = (turn * DVec3::Y, turn * DVec3::Z);
            let pitch = width / 6.0;
            let n = (radius / pitch).ceil() as i32;
            let side = (2 * n + 1) as usize;
            let mut hit = vec![false; side * side];
            for (i, j) in (-n..=n).flat_map(|i| (-n..=n).map(move |j| (i, j))) {
                let target = middle + pitch * (f64::from(i) * across + f64::from(j) * up);
                let ray = (target - eye).normalize();
                let Some((near, far)) = through(eye, ray, min, max) else { continue };
                let direction = robot.rotation * ray;
                let meets = |length: f64| self.oracle.hides(self.from, direction, length, &[]);
                hit[(i + n) as usize * side + (j + n) as usize] = meets(far) && !meets(near.max(1e-6));
            }
            let at = |i: i32, j: i32| {
                (-n..=n).contains(&i) && (-n..=n).contains(&j) && hit[(i + n) as usize * side + (j + n) as usize]
            };
            let disc: Vec<(i32, i32)> =
                (-3..=3).flat_map(|i| (-3..=3).map(move |j| (i, j))).filter(|(i, j)| i * i + j * j <= 9).collect();
            (-n..=n).any(|i| (-n..=n).any(|j| disc.iter().all(|(u, v)| at(i + u, j + v))))
        }
    }

    /// The distances at which a ray enters and leaves a box.
    fn through(eye: DVec3, ray: DVec3, min: DVec3, max: DVec3) -> Option<(f64, f64)> {
        let (a, b) = ((min - eye) / ray, (max - eye) / ray);
        let (near, far) = (a.min(b).max_element(), a.max(b).min_element());
        (near < far && far > 0.0).then_some((near, far))
    }
}
