use super::*;
use crate::environment::{Polygon, PolygonOrder};
use crate::random::SplitMix64;

/// Some polygons of three to six corners, from specks to a floor that holds them all.
fn mesh(count: usize, seed: u64) -> Mesh {
    let mut random = SplitMix64(seed);
    let (mut vertices, mut polygons) = (Vec::new(), Vec::new());
    for i in 0..count {
        let corners = 3 + i % 4;
        let size = 10f64.powf(4.0 * random.unit() - 3.0);
        let middle = DVec3::new(random.unit() * 30.0, random.unit() * 20.0, random.unit() * 4.0);
        let (u, v) = (DVec3::new(random.unit() - 0.5, random.unit() - 0.5, random.unit() - 0.5))
            .normalize()
            .any_orthonormal_pair();
        let first = vertices.len() as u32;
        for k in 0..corners {
            let (sin, cos) = (k as f64 / corners as f64 * std::f64::consts::TAU).sin_cos();
            vertices.push((middle + (u * cos + v * sin) * size).as_vec3());
        }
        polygons.push(Polygon::new((first..first + corners as u32).collect(), 0));
    }
    Mesh::new("m", vertices, polygons, PolygonOrder::Spatial).unwrap()
}

/// A wavy sheet of two triangles a square.
fn sheet(side: u32) -> Mesh {
    let wave = |i: u32| (0.3 * f64::from(i)).sin() as f32;
    let places = (0..=side).flat_map(|i| (0..=side).map(move |k| (i, k)));
    let vertices = places.map(|(i, k)| Vec3::new(i as f32, k as f32, wave(i) + wave(k))).collect();
    let squares = (0..side).flat_map(|i| (0..side).map(move |k| i * (side + 1) + k));
    let halves = squares.flat_map(|at| [[at, at + side + 1, at + side + 2], [at, at + side + 2, at + 1]]);
    let polygons = halves.map(|corners| Polygon::new(corners.to_vec(), 0)).collect();
    Mesh::new("sheet", vertices, polygons, PolygonOrder::Spatial).unwrap()
}

/// The least and greatest corner of a box.
type Box = ([f32; 3], [f32; 3]);

/// Every corner of every polygon is in a block that names it, and in all boxes above; every fan triangle occurs once,
/// unless its polygon copies an earlier one.
fn check(mesh: &Mesh) -> RayTree {
    let tree = RayTree::new(mesh).unwrap();
    let mut met = vec![0usize; mesh.polygon_count()];
    let mut stack: Vec<(u32, Option<Box>)> = if tree.nodes.is_empty() { vec![] } else { vec![(0, None)] };
    let (mut nodes, mut blocks) = (0, 0);
    while let Some((name, around)) = stack.pop() {
        let holds = |p: DVec3| {
            around.is_none_or(|(low, high)| (0..3).all(|k| f64::from(low[k]) <= p[k] && p[k] <= f64::from(high[k])))
        };
        if name & LEAF == 0 {
            nodes += 1;
            let node = &tree.nodes[name as usize];
            for lane in (0..WIDE).filter(|lane| node.children[*lane] != NO_CHILD) {
                let of = |c: &[[f32; WIDE]; 3]| [0, 1, 2].map(|axis| c[axis][lane]);
                let (low, high) = (of(&node.low), of(&node.high));
                assert!(
                    holds(Vec3::from(low).as_dvec3()) && holds(Vec3::from(high).as_dvec3()),
                    "a box leaves its node"
                );
                assert!(low.iter().chain(&high).all(|x| x.abs() <= tree.reach));
                stack.push((node.children[lane], Some((low, high))));
            }
            continue;
        }
        blocks += 1;
        let block = &tree.blocks[(name & !LEAF) as usize];
        assert!((1..=WIDE as u32).contains(&block.count));
        for lane in 0..block.count as usize {
            let polygon = block.polygons[lane];
            met[polygon as usize] += 1;
            let of = |c: &[[f32; WIDE]; 3]| DVec3::from([0, 1, 2].map(|axis| f64::from(c[axis][lane])));
            let base = Vec3::from(block.base).as_dvec3();
            let first = base + of(&block.corner);
            let near = |p: DVec3| {
                mesh.corners_of(polygon).map(|c| (c - tree.origin).distance(p)).fold(f64::INFINITY, f64::min)
            };
            for p in [first, first + of(&block.edges[0]), first + of(&block.edges[1])] {
                // Corner and side are rounded to f32: no more than the diagonal and twice that long.
                let rounding = 3.0 * 2f64.powi(-24) * f64::from(block.diagonal);
                assert!(near(p) <= rounding + 1e-12, "a corner is elsewhere");
                assert!(p.distance(base) <= f64::from(block.diagonal) * (1.0 + 1e-6));
            }
            assert!(mesh.corners_of(polygon).count() > 3 || mesh.corners_of(polygon).all(|c| holds(c - tree.origin)));
        }
    }
    assert_eq!((nodes, blocks), (tree.nodes.len(), tree.blocks.len()));
    let mut before = std::collections::HashSet::new();
    for (polygon, met) in met.iter().enumerate() {
        let corners = mesh.corner_indices(polygon as u32).iter().map(|c| mesh.vertices()[*c as usize]);
        let is_first = before.insert((
            mesh.material(polygon as u32),
            corners.map(|p| p.to_array().map(f32::to_bits)).collect::<Vec<_>>(),
        ));
        let expected = if is_first { mesh.polygons()[polygon].corner_count as usize - 2 } else { 0 };
        assert_eq!(*met, expected, "polygon {polygon}");
    }
    tree
}

#[test]
fn trees_hold_every_triangle_once_and_surfaces_take_at_most_80_bytes_each() {
    for count in [0, 1, 2, 9, 100] {
        check(&mesh(count, count as u64));
    }
    // A soup of specks and floors fills its blocks less well than surfaces do: 81 bytes.
    check(&mesh(20_000, 7));
    let tree = check(&sheet(100));
    let triangles: u32 = tree.blocks.iter().map(|b| b.count).sum();
    let each = tree.bytes() as f64 / f64::from(triangles);
    assert!(each <= 80.0, "{each} bytes a triangle");
}

#[test]
fn coincident_faces_and_slivers_make_shallow_trees() {
    let vertices = vec![Vec3::ZERO, Vec3::X, Vec3::Y];
    let faces: Vec<_> = (0..5000).map(|_| Polygon::new(vec![0, 1, 2], 0)).collect();
    let tree = check(&Mesh::new("m", vertices.clone(), faces.clone(), PolygonOrder::Given).unwrap());
    assert_eq!(tree.blocks.iter().map(|b| b.count).sum::<u32>(), 1, "one of all copies is kept");
    // Other materials may be seen where the first is not, and other orders of corners have planes with other bits.
    let differ = |i: usize| Polygon::new([[0, 1, 2], [1, 2, 0], [2, 1, 0]][i % 3].to_vec(), (i / 3 % 2) as u16);
    let tree = check(&Mesh::new("m", vertices.clone(), (0..600).map(differ).collect(), PolygonOrder::Given).unwrap());
    assert_eq!(tree.blocks.iter().map(|b| b.count).sum::<u32>(), 6);
    // Vertices of their own in another order: engines subtract the ends of edges in reverse.
    let mut twice = vertices.clone();
    twice.extend(vertices.iter().rev());
    let faces = vec![Polygon::new(vec![0, 1, 2], 0), Polygon::new(vec![5, 4, 3], 0)];
    let tree = RayTree::new(&Mesh::new("m", twice, faces, PolygonOrder::Given).unwrap()).unwrap();
    assert_eq!(tree.blocks[0].count, 2);
    // Ever smaller: each plane parts a few from all others.
    let mut vertices = Vec::new();
    for i in 0..600 {
        let x = 1e9 * 0.9f32.powi(i);
        vertices.extend([
            Vec3::new(x, 0.0, 0.0),
            Vec3::new(1.01 * x, 1e-3 * x, 0.0),
            Vec3::new(1.02 * x, 0.0, 1e-6 * x),
        ]);
    }
    let faces = (0..600).map(|i| Polygon::new(vec![3 * i, 3 * i + 1, 3 * i + 2], 0)).collect();
    check(&Mesh::new("m", vertices, faces, PolygonOrder::Spatial).unwrap());
}
