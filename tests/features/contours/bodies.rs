//! Curved bodies.

use super::scenes;
use glam::{DQuat, DVec3, Vec3};
use presight_model::environment::Mesh;
use std::f64::consts::{PI, TAU};

fn f32s(p: DVec3) -> Vec3 {
    p.as_vec3()
}

/// An upright prism from z = 0 up, with or without its ends.
pub fn prism(sides: u32, radius: f64, height: f64, closed: bool) -> Mesh {
    let at = |k: u32, z: f64| {
        let a = TAU * f64::from(k % sides) / f64::from(sides);
        f32s(DVec3::new(radius * a.cos(), radius * a.sin(), z))
    };
    let mut loops: Vec<Vec<Vec3>> =
        (0..sides).map(|k| vec![at(k, 0.0), at(k + 1, 0.0), at(k + 1, height), at(k, height)]).collect();
    if closed {
        loops.push((0..sides).map(|k| at(k, height)).collect());
        loops.push((0..sides).rev().map(|k| at(k, 0.0)).collect());
    }
    scenes::mesh(&loops)
}

/// A ball of `columns` x `rows` facets.
pub fn ball(columns: u32, rows: u32, radius: f64) -> Mesh {
    let at = |c: u32, r: u32| {
        let (a, e) = (TAU * f64::from(c % columns) / f64::from(columns), PI * (0.5 - f64::from(r) / f64::from(rows)));
        let flat = if r == 0 || r == rows { 0.0 } else { e.cos() };
        f32s(radius * DVec3::new(flat * a.cos(), flat * a.sin(), e.sin()))
    };
    let mut loops = Vec::new();
    for c in 0..columns {
        for r in 0..rows {
            let mut corners = vec![at(c, r), at(c, r + 1), at(c + 1, r + 1), at(c + 1, r)];
            corners.dedup();
            if corners.first() == corners.last() {
                corners.pop();
            }
            // In f32 the four corners of a facet need not be coplanar, so facets are two triangles.
            match corners[..] {
                [a, b, c, d] => loops.extend([vec![a, b, c], vec![a, c, d]]),
                _ => loops.push(corners),
            }
        }
    }
    scenes::mesh(&loops)
}

/// A quarter of a ring: its centre line has the radius `bend` about z, from +x to +y.
pub fn elbow(sides: u32, steps: u32, radius: f64, bend: f64) -> Mesh {
    let at = |k: u32, s: u32| {
        let a = TAU * f64::from(k % sides) / f64::from(sides);
        let b = 0.5 * PI * f64::from(s) / f64::from(steps);
        let out = bend + radius * a.cos();
        f32s(DVec3::new(out * b.cos(), out * b.sin(), radius * a.sin()))
    };
    let quad = |k: u32, s: u32| {
        let [a, b, c, d] = [at(k, s), at(k, s + 1), at(k + 1, s + 1), at(k + 1, s)];
        [vec![a, b, c], vec![a, c, d]]
    };
    let loops: Vec<Vec<Vec3>> = (0..sides).flat_map(|k| (0..steps).flat_map(move |s| quad(k, s))).collect();
    scenes::mesh(&loops)
}

/// One polygon.
pub fn sheet(corners: [[f32; 3]; 4]) -> Mesh {
    scenes::mesh(&[corners.map(Vec3::from_array).to_vec()])
}

/// The same body, rotated.
pub fn turned(mesh: &Mesh, by: DQuat) -> Mesh {
    let of = |polygon: u32| mesh.corners_of(polygon).map(|p| f32s(by * p)).collect::<Vec<Vec3>>();
    scenes::mesh(&(0..mesh.polygon_count() as u32).map(of).collect::<Vec<_>>())
}
