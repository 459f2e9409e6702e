//! Generated hard scenes for rasterizers and ray casters.
//!
//! A case is plain data, from which [`Case::build`] makes the world, the sensors and the pose. So proptest can shrink
//! it, and its `Debug` text reproduces a failure.
#![allow(missing_docs, reason = "the names of the fields of shapes suffice")]

use super::scenes;
use glam::{DAffine3, DMat3, DQuat, DVec3, Vec3};
use presight_model::environment::NewObject;
use presight_model::geometry::Pose;
use presight_model::sensor::Sensor;
use presight_model::world::World;
use proptest::prelude::*;
use std::sync::Arc;

/// A polygon or several, in units, with the sensor at the origin.
#[derive(Clone, Debug)]
pub enum Shape {
    /// A regular polygon around `at` with a normal, a number of corners and a radius.
    Disc { at: [f64; 3], normal: [f64; 3], radius: f64, corners: usize },
    /// A triangle of length `long` and width `long / aspect`.
    Sliver { at: [f64; 3], along: [f64; 3], long: f64, aspect: f64 },
    /// A polygon whose plane is `off` units from the sensor, shifted in its plane by `shift` radii (below 1: over it).
    InPlane { normal: [f64; 3], off: f64, shift: f64, radius: f64, corners: usize },
    /// A square that touches the sensor with a corner or an edge.
    Touching { normal: [f64; 3], radius: f64, edge: bool },
    /// A polygon around the pole above or below, wide or narrow.
    Pole { height: f64, radius: f64, corners: usize },
    /// A square across the azimuth seam (behind a scanner).
    Seam { distance: f64, half: f64 },
    /// A ring of quads around the whole horizon.
    Horizon { radius: f64, half_height: f64, quads: usize },
    /// Two equal polygons. The corners of the second are rotated by `turn`, and optionally reversed.
    Twice { at: [f64; 3], normal: [f64; 3], radius: f64, turn: usize, reversed: bool },
    /// Overlapping squares in one plane perpendicular to the forward axis, with corners on pixel rays.
    Wall { distance: f64, half: f64, shift: f64 },
    /// A grid of cells with shared corners, often far smaller than a pixel.
    Carpet { at: [f64; 3], normal: [f64; 3], cell: f64, cells: usize },
}

/// The transform of an object. Its mesh has the inverse, so the shape stays the same.
#[derive(Clone, Debug)]
pub struct ShapePlacement {
    /// Rotation vector.
    pub turn: [f64; 3],
    /// Scale of the axes; negative factors mirror.
    pub scale: [f64; 3],
    /// Shear of x by y.
    pub shear: f64,
}

/// One generated scene.
#[derive(Clone, Debug)]
pub struct Case {
    /// Shapes with their transforms.
    pub shapes: Vec<(Shape, ShapePlacement)>,
    /// Size of one unit of the shapes, metres.
    pub unit: f64,
    /// Position of the sensor in the world, metres.
    pub at: [f64; 3],
    /// Roll, pitch and yaw of the sensor, radians.
    pub turn: [f64; 3],
    /// Range limits in units, if any.
    pub limits: Option<(f64, f64)>,
    /// Use sensors with small pixels ahead instead of wide ones.
    pub fine: bool,
}

impl Case {
    /// The world, the pose and the sensors to test.
    pub fn build(&self) -> (World, Pose, Vec<Sensor>) {
        self.build_from(mesh_of)
    }

    /// As [`Case::build`] with triangles only, for comparison with a ray caster of triangles. Corners of larger
    /// polygons are not exactly in one plane in f32, which matters if the sensor is equally close to that plane.
    pub fn build_triangles(&self) -> (World, Pose, Vec<Sensor>) {
        self.build_from(|polygons| scenes::try_mesh(&triangles(polygons)))
    }

    fn build_from(
        &self,
        mesh_of: impl Fn(&[Vec<Vec3>]) -> Option<presight_model::environment::Mesh>,
    ) -> (World, Pose, Vec<Sensor>) {
        let mut environment = scenes::empty();
        let pose = Pose::from_xyz_rpy(DVec3::from(self.at), self.turn[0], self.turn[1], self.turn[2]);
        for (shape, placing) in &self.shapes {
            let faces = shape.faces();
            let scale = DMat3::from_diagonal(DVec3::from(placing.scale));
            let shear = DMat3::from_cols(DVec3::X, DVec3::new(placing.shear, 1.0, 0.0), DVec3::Z);
            let turn = DMat3::from_quat(DQuat::from_scaled_axis(DVec3::from(placing.turn)));
            let body_from_mesh = turn * shear * scale * self.unit;
            let mesh_from_body = (turn * shear * scale).inverse();
            let polygons: Vec<Vec<Vec3>> =
                faces.iter().map(|face| face.iter().map(|p| (mesh_from_body * *p).as_vec3()).collect()).collect();
            let Some(mesh) = mesh_of(&polygons) else {
                continue;
            };
            let world_from_mesh = pose.to_affine() * DAffine3::from_mat3(body_from_mesh);
            if let Ok(object) = NewObject::from_affine("shape", world_from_mesh, Arc::new(mesh)) {
                environment.insert(object).expect("a sound object");
            }
        }
        (World::new(environment), pose, self.sensors())
    }

    fn sensors(&self) -> Vec<Sensor> {
        if self.fine {
            return scenes::fine().into();
        }
        [
            scenes::camera(33, 25),
            scenes::scanner(48, 13),
            scenes::scanner(180, 1),
            scenes::closed(46, 5),
            scenes::all_round(24, 13),
            scenes::fan(),
            scenes::lens(29, 19),
            scenes::fisheye(25, 18),
        ]
        .into_iter()
        .map(|sensor| match self.limits {
            None => sensor,
            Some((least, most)) => {
                let mut spec = sensor.spec().clone();
                (spec.range_min, spec.range_max) = (least * self.unit, most * self.unit);
                Sensor::new(spec).expect("a sound sensor")
            }
        })
        .collect()
    }
}

/// A mesh of the polygons, or of their triangles if the mesh refuses a polygon after rounding to f32.
fn mesh_of(polygons: &[Vec<Vec3>]) -> Option<presight_model::environment::Mesh> {
    scenes::try_mesh(polygons).or_else(|| scenes::try_mesh(&triangles(polygons)))
}

fn triangles(polygons: &[Vec<Vec3>]) -> Vec<Vec<Vec3>> {
    let fan = |p: &Vec<Vec3>| (1..p.len() - 1).map(|k| vec![p[0], p[k], p[k + 1]]).collect::<Vec<_>>();
    polygons.iter().flat_map(fan).collect()
}

fn ring(at: DVec3, normal: [f64; 3], radius: f64, corners: usize) -> Vec<DVec3> {
    let (x, y) = unit(normal).any_orthonormal_pair();
    let angle = |k: usize| std::f64::consts::TAU * k as f64 / corners as f64 + 0.3;
    (0..corners).map(|k| at + (x * angle(k).cos() + y * angle(k).sin()) * radius).collect()
}

fn unit(v: [f64; 3]) -> DVec3 {
    DVec3::from(v).try_normalize().unwrap_or(DVec3::Z)
}

impl Shape {
    /// The corners of each polygon in units, body axes of the sensor.
    fn faces(&self) -> Vec<Vec<DVec3>> {
        match *self {
            Self::Disc { at, normal, radius, corners } => vec![ring(at.into(), normal, radius, corners)],
            Self::Sliver { at, along, long, aspect } => {
                let (along, from) = (unit(along), DVec3::from(at));
                let across = along.any_orthonormal_vector() * (long / aspect);
                vec![vec![from, from + along * long, from + along * (0.4 * long) + across]]
            }
            Self::InPlane { normal, off, shift, radius, corners } => {
                let n = unit(normal);
                vec![ring(n * off + n.any_orthonormal_vector() * (shift * radius), normal, radius, corners)]
            }
            Self::Touching { normal, radius, edge } => {
                let (x, y) = unit(normal).any_orthonormal_pair();
                let start = if edge { -x * (0.5 * radius) } else { DVec3::ZERO };
                vec![vec![start, start + x * radius, start + (x + y) * radius, start + y * radius]]
            }
            Self::Pole { height, radius, corners } => {
                vec![ring(DVec3::new(0.1 * radius, 0.0, height), [0.0, 0.0, 1.0], radius, corners)]
            }
            Self::Seam { distance, half } => {
                let p = |y: f64, z: f64| DVec3::new(-distance, y * half, z * half);
                vec![vec![p(-1.0, -1.0), p(1.0, -1.0), p(1.0, 1.0), p(-1.0, 1.0)]]
            }
            Self::Horizon { radius, half_height, quads } => {
                let p = |k: usize, z: f64| {
                    let angle = std::f64::consts::TAU * (k % quads) as f64 / quads as f64;
                    DVec3::new(angle.cos() * radius, angle.sin() * radius, z * half_height)
                };
                (0..quads).map(|k| vec![p(k, -1.0), p(k + 1, -1.0), p(k + 1, 1.0), p(k, 1.0)]).collect()
            }
            Self::Twice { at, normal, radius, turn, reversed } => {
                let first = ring(at.into(), normal, radius, 5);
                let mut second = first.clone();
                second.rotate_left(turn % 5);
                if reversed {
                    second.reverse();
                }
                vec![first, second]
            }
            Self::Wall { distance, half, shift } => {
                let p = |s: f64, y: f64, z: f64| DVec3::new(distance, (y + s) * half, z * half);
                let quad = |s: f64| vec![p(s, -1.0, -1.0), p(s, 1.0, -1.0), p(s, 1.0, 1.0), p(s, -1.0, 1.0)];
                vec![quad(0.0), quad(shift), quad(0.0)]
            }
            Self::Carpet { at, normal, cell, cells } => {
                let (x, y) = unit(normal).any_orthonormal_pair();
                let p = |i: usize, j: usize| DVec3::from(at) + x * (i as f64 * cell) + y * (j as f64 * cell);
                let quad = |i, j| vec![p(i, j), p(i + 1, j), p(i + 1, j + 1), p(i, j + 1)];
                (0..cells).flat_map(|i| (0..cells).map(move |j| quad(i, j))).collect()
            }
        }
    }
}

/// A length, uniform in its logarithm.
fn length(least: f64, most: f64) -> impl Strategy<Value = f64> {
    (least.ln()..most.ln()).prop_map(f64::exp)
}

fn direction() -> impl Strategy<Value = [f64; 3]> {
    prop_oneof![
        2 => [-1.0..1.0f64, -1.0..1.0f64, -1.0..1.0f64],
        1 => prop::sample::select(vec![
            [1.0, 0.0, 0.0],
            [0.0, 1.0, 0.0],
            [0.0, 0.0, 1.0],
            [1.0, 1.0, 0.0],
            [0.0, 1.0, 1.0],
        ]),
    ]
}

fn place() -> impl Strategy<Value = [f64; 3]> {
    (direction(), length(1e-3, 1e2)).prop_map(|(d, r)| (unit(d) * r).into())
}

fn shape() -> impl Strategy<Value = Shape> {
    let off = prop::sample::select(vec![0.0, 1e-9, -1e-9, 1e-6, -1e-6, 1e-12, 1e-3]);
    prop_oneof![
        3 => (place(), direction(), length(1e-4, 1e3), 3..9usize)
            .prop_map(|(at, normal, radius, corners)| Shape::Disc { at, normal, radius, corners }),
        2 => (place(), direction(), length(1e-2, 1e2), length(1e1, 1e6))
            .prop_map(|(at, along, long, aspect)| Shape::Sliver { at, along, long, aspect }),
        2 => (direction(), off, 0.0..3.0f64, length(1e-2, 1e2), 3..7usize)
            .prop_map(|(normal, off, shift, radius, corners)| Shape::InPlane { normal, off, shift, radius, corners }),
        1 => (direction(), length(1e-2, 1e2), any::<bool>())
            .prop_map(|(normal, radius, edge)| Shape::Touching { normal, radius, edge }),
        1 => (prop::sample::select(vec![1.0, -1.0, 20.0]), length(1e-2, 1e2), 3..9usize)
            .prop_map(|(height, radius, corners)| Shape::Pole { height, radius, corners }),
        1 => (length(0.1, 50.0), length(0.01, 100.0)).prop_map(|(distance, half)| Shape::Seam { distance, half }),
        1 => (length(0.1, 50.0), length(0.01, 20.0), 3..20usize)
            .prop_map(|(radius, half_height, quads)| Shape::Horizon { radius, half_height, quads }),
        1 => (place(), direction(), length(1e-2, 1e2), 0..5usize, any::<bool>())
            .prop_map(|(at, normal, radius, turn, reversed)| Shape::Twice { at, normal, radius, turn, reversed }),
        1 => (length(0.1, 50.0), length(0.01, 100.0), prop::sample::select(vec![0.0, 0.5, 1.0, 2.0]))
            .prop_map(|(distance, half, shift)| Shape::Wall { distance, half, shift }),
        1 => (place(), direction(), length(1e-4, 1.0), 1..12usize)
            .prop_map(|(at, normal, cell, cells)| Shape::Carpet { at, normal, cell, cells }),
    ]
}

fn placing() -> impl Strategy<Value = ShapePlacement> {
    let plain = Just(ShapePlacement { turn: [0.0; 3], scale: [1.0; 3], shear: 0.0 });
    let signed = || prop_oneof![0.1..10.0f64, -10.0..-0.1f64];
    let any = ([-3.0..3.0f64, -3.0..3.0f64, -3.0..3.0f64], [signed(), signed(), signed()], -2.0..2.0f64)
        .prop_map(|(turn, scale, shear)| ShapePlacement { turn, scale, shear });
    prop_oneof![1 => plain, 1 => any]
}

/// Hard scenes of 1 mm to 10 km, at the world's origin or 5,000,000 m from it.
pub fn case() -> impl Strategy<Value = Case> {
    let at =
        prop::sample::select(vec![[0.0, 0.0, 0.0], [12.3, -4.5, 1.7], [5e6, -5e6, 100.0], [5e6 + 0.1, 3e6 + 0.7, 0.0]]);
    let turn = prop_oneof![Just([0.0; 3]), [-3.0..3.0f64, -1.5..1.5f64, -3.0..3.0f64]];
    let unit = prop::sample::select(vec![1.0, 1e-3, 1e2, 1.0, 1e3]);
    let limits = prop::option::weighted(0.4, (0.05..2.0f64, 3.0..60.0f64));
    (prop::collection::vec((shape(), placing()), 1..8), unit, at, turn, limits)
        .prop_map(|(shapes, unit, at, turn, limits)| Case { shapes, unit, at, turn, limits, fine: false })
}

/// Directions exactly or nearly towards the poles, forward or backward, or random ones.
fn towards() -> impl Strategy<Value = [f64; 3]> {
    let axis = prop::sample::select(vec![[0.0, 0.0, 1.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0], [-1.0, 0.0, 0.0]]);
    let beside = (axis, [-1.0..1.0f64, -1.0..1.0f64, -1.0..1.0f64], prop_oneof![Just(0.0), length(1e-7, 0.3)]);
    let beside = beside.prop_map(|(axis, off, by)| (unit(axis) + DVec3::from(off) * by).into());
    prop_oneof![3 => beside, 1 => direction()]
}

/// A carpet of up to 11 x 11 cells seen at 1e-1 to 1e-8 rad, near a given ray.
fn grazing_carpet() -> impl Strategy<Value = Shape> {
    let size = (length(1e-2, 1e2), length(1e-4, 1.0), prop_oneof![1 => Just(11usize), 2 => 1..12usize]);
    let tilt = (length(1e-8, 0.1), any::<bool>()).prop_map(|(t, back)| if back { -t } else { t });
    (towards(), 0.0..std::f64::consts::TAU, tilt, size, [-0.2..1.2f64, -0.2..1.2f64]).prop_map(
        |(towards, angle, tilt, (far, cell, cells), over)| {
            let d = unit(towards);
            let (p, q) = d.any_orthonormal_pair();
            let normal = (p * angle.cos() + q * angle.sin()) * tilt.cos() + d * tilt.sin();
            let (x, y) = unit(normal.into()).any_orthonormal_pair();
            let corner = d * far - (x * over[0] + y * over[1]) * (cell * cells as f64);
            Shape::Carpet { at: corner.into(), normal: normal.into(), cell, cells }
        },
    )
}

/// Nearly edge-on carpets of small cells, whose edge planes nearly coincide with their own plane.
pub fn grazing() -> impl Strategy<Value = Case> {
    let at = prop::sample::select(vec![[0.0, 0.0, 0.0], [12.3, -4.5, 1.7], [5e6 + 0.1, 3e6 + 0.7, 0.0]]);
    let turn = prop_oneof![Just([0.0; 3]), [-3.0..3.0f64, -1.5..1.5f64, -3.0..3.0f64]];
    let unit = prop::sample::select(vec![1.0, 1e-3, 1e2]);
    (prop::collection::vec((grazing_carpet(), placing()), 1..3), unit, at, turn, any::<bool>())
        .prop_map(|(shapes, unit, at, turn, fine)| Case { shapes, unit, at, turn, limits: None, fine })
}
