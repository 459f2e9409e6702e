use super::*;
use crate::preparation::Edges;
use glam::{DAffine3, DQuat};
use presight_model::environment::{Mesh, PolygonOrder};
use presight_model::geometry::Plane;
use proptest::prelude::*;

const TOLERANCE: f64 = 1e-6;

/// A stepped height field over a grid, each cell cut along a diagonal: it has flat parts, ridges and borders.
#[derive(Debug, Clone)]
struct Field {
    width: usize,
    heights: Vec<u8>,
    diagonals: Vec<bool>,
    materials: Vec<u16>,
    holes: Vec<u8>,
    turn: DQuat,
    mirrored: bool,
}

fn field() -> impl Strategy<Value = Field> {
    (2usize..7, 2usize..7).prop_flat_map(|(width, height)| {
        let (corners, cells) = ((width + 1) * (height + 1), width * height);
        (
            // Mostly flat, so that there is something to merge.
            proptest::collection::vec(prop_oneof![6 => Just(0u8), 1 => 1u8..3], corners),
            proptest::collection::vec(any::<bool>(), cells),
            proptest::collection::vec(prop_oneof![5 => Just(0u16), 1 => Just(1u16)], cells),
            proptest::collection::vec(0u8..8, cells),
            (-3.0..3.0f64, -1.5..1.5f64, any::<bool>(), any::<bool>()),
        )
            .prop_map(move |(heights, diagonals, materials, holes, (yaw, roll, plain, mirrored))| Field {
                width,
                heights,
                diagonals,
                materials,
                holes,
                turn: if plain { DQuat::IDENTITY } else { DQuat::from_rotation_z(yaw) * DQuat::from_rotation_x(roll) },
                mirrored,
            })
    })
}

fn triangles(f: &Field) -> TriangleMesh {
    let columns = f.width + 1;
    let mut mesh = TriangleMesh::default();
    for (i, &h) in f.heights.iter().enumerate() {
        let p = DVec3::new((i % columns) as f64, (i / columns) as f64, f64::from(h));
        mesh.vertices.push((f.turn * p).as_vec3());
    }
    for (cell, ((&diagonal, &material), &hole)) in f.diagonals.iter().zip(&f.materials).zip(&f.holes).enumerate() {
        if hole == 0 {
            continue;
        }
        let a = (cell / f.width * columns + cell % f.width) as u32;
        let [a, b, c, d] = [a, a + 1, a + columns as u32, a + columns as u32 + 1];
        let pair = if diagonal { [[a, b, d], [a, d, c]] } else { [[a, b, c], [b, d, c]] };
        for [p, q, r] in pair {
            mesh.push(if f.mirrored { [p, r, q] } else { [p, q, r] }, material);
        }
    }
    mesh
}

fn merged(mesh: &TriangleMesh) -> MergeResult {
    merge(mesh, Edges::of(mesh).twins(), TOLERANCE)
}

fn outlines<'a>(
    mesh: &'a TriangleMesh,
    merged: &'a MergeResult,
) -> impl Iterator<Item = (Vec<DVec3>, Plane, u16)> + 'a {
    merged.parts.records.iter().zip(&merged.parts.planes).map(|(record, plane)| {
        let corners = record.corners(&merged.parts.corners);
        (corners.iter().map(|&c| mesh.vertices[c as usize].as_dvec3()).collect(), *plane, record.material)
    })
}

fn doubled_area(points: &[DVec3], normal: DVec3) -> f64 {
    (1..points.len() - 1).map(|k| (points[k] - points[0]).cross(points[k + 1] - points[0]).dot(normal)).sum()
}

/// Minimum signed distance of a point to the edges of the outline; positive inside.
fn depth_inside(p: DVec3, points: &[DVec3], normal: DVec3) -> f64 {
    let edge = |k: usize| {
        let (a, b) = (points[k], points[(k + 1) % points.len()]);
        normal.cross(b - a).normalize().dot(p - a)
    };
    (0..points.len()).map(edge).fold(f64::INFINITY, f64::min)
}

/// Checks all conditions after merging; an error names the one that fails.
fn check(mesh: &TriangleMesh, merged: &MergeResult) -> Result<(), String> {
    let size = Aabb::of(mesh.vertices.iter().map(|v| v.as_dvec3())).size();
    if merged.parts.records.len() as u64 + merged.merges != mesh.triangles.len() as u64 {
        return Err("each merge takes one polygon away".into());
    }
    if merged.largest_deviation > TOLERANCE * size {
        return Err(format!("{} m off the plane", merged.largest_deviation));
    }
    for (points, plane, _) in outlines(mesh, merged) {
        if points.len() > MERGED_CORNERS || !is_convex(&points, plane.normal) {
            return Err(format!("not convex: {points:?}"));
        }
    }
    let before: f64 = mesh
        .triangles
        .iter()
        .map(|t| {
            let [a, b, c] = mesh.positions(t.corners);
            (b - a).cross(c - a).length()
        })
        .sum();
    let after: f64 = outlines(mesh, merged).map(|(p, plane, _)| doubled_area(&p, plane.normal)).sum();
    if (before - after).abs() > 1e-6 * before {
        return Err(format!("area {before} became {after}"));
    }
    for t in &mesh.triangles {
        let corners = mesh.positions(t.corners);
        let normal = (corners[1] - corners[0]).cross(corners[2] - corners[0]).normalize();
        for [u, v] in [[0.33, 0.33], [0.01, 0.01], [0.98, 0.01], [0.01, 0.98], [0.495, 0.495]] {
            let p = corners[0] + u * (corners[1] - corners[0]) + v * (corners[2] - corners[0]);
            let covers = |(points, plane, material): &(Vec<DVec3>, Plane, u16)| {
                *material == t.material
                    && plane.normal.dot(normal) > 0.999
                    && (plane.normal.dot(p) - plane.offset).abs() <= 2.0 * TOLERANCE * size
                    && depth_inside(p, points, plane.normal) > 1e-6
            };
            let count = outlines(mesh, merged).filter(covers).count();
            if count != 1 {
                return Err(format!("{p} of triangle {} is in {count} polygons", t.source));
            }
        }
    }
    no_new_junctions(mesh, merged)
}

/// No corner of one polygon may lie inside an edge of another.
fn no_new_junctions(mesh: &TriangleMesh, merged: &MergeResult) -> Result<(), String> {
    let all: Vec<_> = outlines(mesh, merged).map(|o| o.0).collect();
    for points in &all {
        for (k, &a) in points.iter().enumerate() {
            let b = points[(k + 1) % points.len()];
            for &v in all.iter().flatten() {
                let along = (v - a).dot(b - a) / (b - a).length_squared();
                if along > 1e-6 && along < 1.0 - 1e-6 && (v - a - along * (b - a)).length() < 1e-6 {
                    return Err(format!("{v} lies inside the edge from {a} to {b}"));
                }
            }
        }
    }
    Ok(())
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(400))]

    #[test]
    fn merging_changes_no_surface(f in field()) {
        let mesh = triangles(&f);
        let merged = merged(&mesh);
        if let Err(what) = check(&mesh, &merged) {
            prop_assert!(false, "{}", what);
        }
        // The public constructor accepts the merged mesh.
        let order = PolygonOrder::Given;
        let stored = Mesh::from_parts("m".into(), mesh.vertices.clone(), &merged.parts, order);
        let polygons = (0..stored.polygon_count() as u32)
            .map(|i| presight_model::Polygon::new(stored.corner_indices(i).to_vec(), stored.material(i)))
            .collect();
        let again = Mesh::new("m", stored.vertices().to_vec(), polygons, order).unwrap();
        for i in 0..stored.polygon_count() as u32 {
            prop_assert_eq!(again.plane(i), stored.plane(i));
        }
    }
}

/// A flat grid of cells with parallel diagonals, and its four outer corners.
fn grid(width: usize, height: usize) -> TriangleMesh {
    triangles(&Field {
        width,
        heights: vec![0; (width + 1) * (height + 1)],
        diagonals: vec![true; width * height],
        materials: vec![0; width * height],
        holes: vec![1; width * height],
        turn: DQuat::IDENTITY,
        mirrored: false,
    })
}

#[test]
fn a_grid_becomes_few_polygons() {
    for (width, height) in [(1, 1), (2, 2), (8, 8), (3, 16)] {
        let mesh = grid(width, height);
        let merged = merged(&mesh);
        check(&mesh, &merged).unwrap();
        let count = merged.parts.records.len();
        assert!(count * 8 <= mesh.triangles.len() + 14, "{width} x {height}: {count}");
    }
}

#[test]
fn bent_beyond_the_tolerance_stays_apart() {
    for (bend, expected) in [(0.0, 1), (1e-6, 1), (1e-5, 2), (0.5, 2)] {
        let mut mesh = grid(1, 1);
        mesh.vertices[3].z = bend;
        let merged = merged(&mesh);
        assert_eq!(merged.parts.records.len(), expected, "{bend}");
        assert!(merged.largest_deviation <= 1e-6);
        assert_eq!(merged.largest_deviation > 0.0, bend == 1e-6, "{bend}");
    }
}

/// A hexagon whose corners lie alternately above and below its plane, each by less than half the tolerance. All its
/// vertices stay corners, so only their own distances from the plane count.
#[test]
fn without_inner_vertices_only_corners_bound_the_deviation() {
    let corner = |k: u32| {
        let angle = std::f64::consts::TAU * f64::from(k) / 6.0;
        DVec3::new(angle.cos(), angle.sin(), if k.is_multiple_of(2) { 8e-7 } else { -8e-7 }).as_vec3()
    };
    let mut mesh = TriangleMesh { vertices: (0..6).map(corner).collect(), ..Default::default() };
    (1..5).for_each(|k| mesh.push([0, k, k + 1], 0));
    let merged = merged(&mesh);
    check(&mesh, &merged).unwrap();
    assert_eq!((merged.parts.records.len(), merged.parts.corners.len()), (1, 6));
    assert!((merged.largest_deviation - 8e-7).abs() < 1e-7, "{}", merged.largest_deviation);
}

#[test]
fn reflex_pairs_stay_apart() {
    let vertices = vec![Vec3::ZERO, Vec3::X, Vec3::new(0.1, 0.1, 0.0), Vec3::Y];
    let mut mesh = TriangleMesh { vertices, ..Default::default() };
    mesh.push([0, 1, 2], 0);
    mesh.push([0, 2, 3], 0);
    assert_eq!(merged(&mesh).merges, 0);
    // A straight corner is not reflex, and the straight vertex of an open border is dropped.
    mesh.vertices[2] = Vec3::new(0.5, 0.5, 0.0);
    let merged = merged(&mesh);
    assert_eq!((merged.merges, merged.parts.corners.len()), (1, 3));
}

#[test]
fn tiny_details_keep_their_angles() {
    // A ridge of 20 um on a mesh of 50 m is within the tolerance on distances.
    let mut mesh = grid(2, 1);
    for v in &mut mesh.vertices {
        *v *= 1e-5;
    }
    for i in [1, 4] {
        mesh.vertices[i].z = 1e-5;
    }
    mesh.vertices.push(Vec3::splat(30.0));
    let merged = merged(&mesh);
    assert_eq!(merged.parts.records.len(), 2, "the two slopes of the ridge");
}

#[test]
fn the_check_catches_what_it_must() {
    let mesh = grid(4, 4);
    let sound = merged(&mesh);
    check(&mesh, &sound).unwrap();
    let polygon = sound.parts.records[0];
    let corner = polygon.first_corner as usize;
    let planted: [&dyn Fn(&mut MergeResult); 4] = [
        &|m| m.parts.corners.swap(corner, corner + 1),
        &|m| m.parts.planes[0].offset += 0.01,
        &|m| m.parts.records[0].material = 3,
        &|m| m.merges += 1,
    ];
    for (i, plant) in planted.iter().enumerate() {
        let mut wrong = MergeResult {
            parts: Parts {
                corners: sound.parts.corners.clone(),
                records: sound.parts.records.clone(),
                planes: sound.parts.planes.clone(),
            },
            ..sound
        };
        plant(&mut wrong);
        assert!(check(&mesh, &wrong).is_err(), "fault {i} was not caught");
    }
}

#[test]
fn convexity_survives_mirrors_and_uneven_scales() {
    let mesh = grid(5, 3);
    let merged = merged(&mesh);
    let turn = DAffine3::from_quat(DQuat::from_rotation_x(1.0));
    let stretched = turn * DAffine3::from_scale(DVec3::new(-3.0, 0.01, 7.0)) * turn.inverse();
    for (points, _, _) in outlines(&mesh, &merged) {
        let world: Vec<DVec3> = points.iter().map(|&p| stretched.transform_point3(p)).collect();
        let plane = presight_model::geometry::plane_of_polygon(&world).unwrap();
        assert!((0..world.len()).all(|k| {
            let n = world.len();
            let (a, b, c) = (world[(k + n - 1) % n], world[k], world[(k + 1) % n]);
            (b - a).cross(c - b).dot(plane.normal) >= -1e-12 * (b - a).length() * (c - b).length()
        }));
    }
}
