//! Every solid is closed, its normals point outwards, its polygons are planar and convex, and its volume and area agree
//! with the textbook formulas.

use super::*;
use glam::DVec2;
use presight_model::environment::{Mesh, Polygon, PolygonOrder};
use presight_model::error::{ErrorKind, Result};
use proptest::prelude::*;
use std::collections::HashMap;
use std::f64::consts::TAU;

fn corners_of<'a>(solid: &'a Solid, polygon: &'a [u32]) -> Vec<DVec3> {
    polygon.iter().map(|&k| solid.vertices[k as usize]).collect()
}

/// Half the sum of cross products.
fn area_vector(p: &[DVec3]) -> DVec3 {
    (0..p.len()).fold(DVec3::ZERO, |sum, k| sum + 0.5 * (p[k] - p[0]).cross(p[(k + 1) % p.len()] - p[0]))
}

fn volume(solid: &Solid) -> f64 {
    solid.polygons().map(|c| corners_of(solid, c)).map(|p| area_vector(&p).dot(p[0]) / 3.0).sum()
}

fn area(solid: &Solid) -> f64 {
    solid.polygons().map(|c| area_vector(&corners_of(solid, c)).length()).sum()
}

fn size(solid: &Solid) -> f64 {
    solid.vertices.iter().map(|v| v.abs().max_element()).fold(0.0, f64::max)
}

/// The first fault of a solid, if it has any.
fn fault(solid: &Solid) -> Option<String> {
    let mut sides: HashMap<(u32, u32), u32> = HashMap::new();
    for polygon in solid.polygons() {
        if !(3..=limits::MAX_CORNERS).contains(&polygon.len()) {
            return Some(format!("{} corners", polygon.len()));
        }
        for k in 0..polygon.len() {
            *sides.entry((polygon[k], polygon[(k + 1) % polygon.len()])).or_default() += 1;
        }
        let p = corners_of(solid, polygon);
        let normal = area_vector(&p).normalize_or_zero();
        let tolerance = 1e-12 * size(solid);
        for k in 0..p.len() {
            let (a, b, c) = (p[k], p[(k + 1) % p.len()], p[(k + 2) % p.len()]);
            if normal.dot(a - p[0]).abs() > tolerance {
                return Some(format!("not planar: {p:?}"));
            }
            if (b - a).cross(c - b).dot(normal) < -tolerance * size(solid) {
                return Some(format!("not convex: {p:?}"));
            }
        }
    }
    // Closed and consistently wound: every side once in each direction.
    if let Some((side, n)) = sides.iter().find(|(side, n)| **n != 1 || sides.get(&(side.1, side.0)) != Some(&1)) {
        return Some(format!("side {side:?} {n} times, its twin {:?} times", sides.get(&(side.1, side.0))));
    }
    let mut seen: Vec<[u64; 3]> = solid.vertices.iter().map(|v| v.to_array().map(f64::to_bits)).collect();
    seen.sort_unstable();
    if seen.windows(2).any(|w| w[0] == w[1]) {
        return Some("a corner is stored twice".into());
    }
    if volume(solid) <= 0.0 { Some("inside out".into()) } else { None }
}

fn mesh(solid: &Solid) -> Result<Mesh> {
    let vertices = solid.vertices.iter().map(|v| v.as_vec3()).collect();
    let polygons = solid.polygons().map(|c| Polygon::new(c.to_vec(), 0)).collect();
    Mesh::new("test", vertices, polygons, PolygonOrder::Given)
}

#[track_caller]
fn check(solid: Solid, expected_volume: f64, expected_area: f64) {
    assert_eq!(fault(&solid), None);
    let near = |a: f64, b: f64| (a - b).abs() <= 1e-11 * b;
    assert!(near(volume(&solid), expected_volume), "volume {} is not {expected_volume}", volume(&solid));
    assert!(near(area(&solid), expected_area), "area {} is not {expected_area}", area(&solid));
    assert_eq!(mesh(&solid).unwrap().polygon_count(), solid.polygon_count());
}

fn area_of_ngon(n: u32, r: f64) -> f64 {
    0.5 * f64::from(n) * r * r * (TAU / f64::from(n)).sin()
}

/// Side and apothem.
fn of_ngon(n: u32, r: f64) -> (f64, f64) {
    let half = TAU / f64::from(n) / 2.0;
    (2.0 * r * half.sin(), r * half.cos())
}

#[test]
fn straight_solids() {
    check(cuboid(2.0, 3.0, 0.5).unwrap(), 3.0, 17.0);
    check(wedge(3.0, 2.0, 4.0).unwrap(), 12.0, 2.0 * 6.0 + 2.0 * (3.0 + 4.0 + 5.0));
    let slant = (1.0f64 + 9.0).sqrt();
    check(pyramid(2.0, 2.0, 3.0, 0.0, 0.0).unwrap(), 4.0, 4.0 + 4.0 * slant);
    check(pyramid(4.0, 4.0, 3.0, 2.0, 2.0).unwrap(), 3.0 / 3.0 * (16.0 + 4.0 + 8.0), 20.0 + 12.0 * slant);
    // A roof: ridge of 2 along x, 4 by 2 at its foot, 1 high.
    let [ends, sides] = [2.0 * 2.0f64.sqrt() / 2.0, (4.0 + 2.0) / 2.0 * 2.0f64.sqrt()];
    check(pyramid(4.0, 2.0, 1.0, 2.0, 0.0).unwrap(), 2.0 + 4.0 / 3.0, 8.0 + 2.0 * (ends + sides));
    // 1 + 2 + 3 blocks of 0.3 by 0.2 by 1.
    check(
        stairs(3, 1.0, 0.3, 0.2).unwrap(),
        6.0 * 0.3 * 0.2,
        2.0 * 6.0 * 0.3 * 0.2 + 2.0 * 3.0 * 0.3 + 2.0 * 3.0 * 0.2,
    );
    assert!(fault(&stairs(255, 1.0, 0.3, 0.2).unwrap()).is_none());
}

#[test]
fn round_solids() {
    for n in [3, 5, 24, 63, 64, 65, 200] {
        let (side, apothem) = of_ngon(n, 0.5);
        let base = area_of_ngon(n, 0.5);
        let around = f64::from(n) * side;
        check(cylinder(0.5, 2.0, n).unwrap(), 2.0 * base, 2.0 * base + 2.0 * around);
        check(prism(n, 0.5, 2.0).unwrap(), 2.0 * base, 2.0 * base + 2.0 * around);
        let slant = (apothem * apothem + 4.0).sqrt();
        check(cone(0.5, 0.0, 2.0, n).unwrap(), 2.0 * base / 3.0, base + 0.5 * around * slant);
        check(cone(0.0, 0.5, 2.0, n).unwrap(), 2.0 * base / 3.0, base + 0.5 * around * slant);
        let top = area_of_ngon(n, 0.25);
        let slant = (0.25 * apothem * apothem + 4.0).sqrt();
        let cut = 2.0 / 3.0 * (base + top + (base * top).sqrt());
        check(cone(0.5, 0.25, 2.0, n).unwrap(), cut, base + top + 0.75 * around * slant);
        let wall = base - area_of_ngon(n, 0.4);
        check(tube(0.5, 0.4, 2.0, n).unwrap(), 2.0 * wall, 2.0 * wall + 2.0 * around * 1.8);
    }
}

/// An octahedron, then solids whose volume approaches that of the sphere from below.
#[test]
fn spheres() {
    check(sphere(1.0, 4).unwrap(), 4.0 / 3.0, 4.0 * 3f64.sqrt());
    let mut last = 4.0 / 3.0;
    for n in [5, 8, 24, 65, 200] {
        let solid = sphere(1.0, n).unwrap();
        assert_eq!(fault(&solid), None, "{n}");
        assert!(volume(&solid) > last && volume(&solid) < 2.0 * TAU / 3.0);
        last = volume(&solid);
        assert!(solid.vertices.iter().all(|v| (v.length() - 1.0).abs() < 1e-15));
        assert!(mesh(&solid).is_ok());
    }
    assert!(2.0 * TAU / 3.0 - last < 2e-3);
}

#[test]
fn outlines() {
    let square = [[0., 0.], [2., 0.], [2., 2.], [0., 2.]].map(DVec2::from);
    check(extrude(&square, 3.0).unwrap(), 12.0, 8.0 + 24.0);
    let mut clockwise = square;
    clockwise.reverse();
    check(extrude(&clockwise, 3.0).unwrap(), 12.0, 8.0 + 24.0);
    // A comb, with points within straight sides.
    let comb: Vec<DVec2> = [
        [0., 0.],
        [1., 0.],
        [3., 0.],
        [5., 0.],
        [5., 3.],
        [4., 3.],
        [4., 1.],
        [3., 1.],
        [3., 3.],
        [2., 3.],
        [2., 1.],
        [1., 1.],
        [1., 2.],
        [1., 3.],
        [0., 3.],
    ]
    .map(DVec2::from)
    .to_vec();
    check(extrude(&comb, 1.0).unwrap(), 11.0, 22.0 + (5.0 + 3.0 * 2.0 + 3.0 + 2.0 + 4.0 * 2.0));
}

#[test]
fn bad_parameters_are_named() {
    let points = |p: &[[f64; 2]]| p.iter().map(|p| DVec2::from(*p)).collect::<Vec<_>>();
    let bow = points(&[[0., 0.], [1., 1.], [1., 0.], [0., 1.]]);
    let spike = points(&[[0., 0.], [2., 0.], [1., 0.], [1., 1.]]);
    let touching = points(&[[0., 0.], [4., 0.], [4., 2.], [2., 0.], [0., 2.]]);
    let twice = points(&[[0., 0.], [1., 0.], [1., 0.], [0., 1.]]);
    let nan = points(&[[0., 0.], [1., f64::NAN], [0., 1.]]);
    let cases = [
        (cuboid(f64::NAN, 1.0, 1.0), "size_x is NaN"),
        (cuboid(1.0, -1.0, 1.0), "size_y is -1"),
        (cuboid(1.0, 1.0, 0.0), "height is 0"),
        (cuboid(1e13, 1.0, 1.0), "size_x"),
        (wedge(1.0, f64::INFINITY, 1.0), "size_y is inf"),
        (pyramid(1.0, 1.0, 1.0, -0.5, 0.0), "top_x is -0.5"),
        (stairs(0, 1.0, 1.0, 1.0), "steps is 0"),
        (stairs(u32::MAX, 1.0, 1.0, 1.0), "steps"),
        (stairs(256, 1.0, 1.0, 1.0), "256 steps"),
        (prism(2, 1.0, 1.0), "sides is 2"),
        (cylinder(1.0, 1.0, 1_000_000_000), "facets is 1000000000"),
        (cone(0.0, 0.0, 1.0, 12), "both radii"),
        (sphere(1.0, 3), "facets is 3"),
        (tube(1.0, 1.0, 1.0, 12), "no wall"),
        (rectangle(0.0, 1.0), "size_x is 0"),
        (face(&[DVec3::ZERO, DVec3::X]), "2 corners"),
        (face(&[DVec3::ZERO, DVec3::X, DVec3::X * 2.0]), "no area"),
        (face(&[DVec3::ZERO, DVec3::X, DVec3::NAN]), "corner 2"),
        (extrude(&bow, 1.0), "side 0 of the outline meets side 2"),
        (extrude(&spike, 1.0), "runs back on itself"),
        (extrude(&touching, 1.0), "meets side"),
        (extrude(&twice, 1.0), "point 1"),
        (extrude(&nan, 1.0), "point 1"),
        (extrude(&bow[..2], 1.0), "2 points"),
    ];
    for (made, part) in cases {
        let e = made.expect_err(part);
        assert!(e.kind() == ErrorKind::Invalid && e.to_string().contains(part), "{part:?}: {e}");
        assert!(!e.remedy().is_empty(), "{e}");
    }
}

#[test]
fn the_check_finds_planted_faults() {
    let sound = cuboid(1.0, 2.0, 3.0).unwrap();
    let mut open = sound.clone();
    open.ends.pop();
    open.corners.truncate(*open.ends.last().unwrap() as usize);
    assert!(fault(&open).unwrap().contains("side"));
    let mut inside_out = sound.clone();
    inside_out.map(true, |p| p);
    assert_eq!(fault(&inside_out).unwrap(), "inside out");
    let mut bent = sound.clone();
    bent.vertices[0].z -= 0.1;
    assert!(fault(&bent).unwrap().contains("not planar"));
    let mut mirrored = sound.clone();
    mirrored.map(true, |p| p * DVec3::new(-1.0, 1.0, 1.0));
    assert_eq!(fault(&mirrored), None);
    let mut two = sound.clone();
    two.append(&sound);
    assert!(fault(&two).unwrap().contains("twice"));
    let star = [[0., 3.], [-1., 1.], [-3., 0.], [-1., -1.], [0., -3.], [1., -1.], [3., 0.], [1., 1.]].map(DVec2::from);
    let mut dented = Solid { vertices: star.map(|p| p.extend(0.0)).to_vec(), ..Solid::default() };
    dented.push(0..8);
    assert!(fault(&dented).unwrap().contains("not convex"));
}

/// A star-shaped outline about the origin: simple by construction, and very concave.
fn star() -> impl Strategy<Value = Vec<DVec2>> {
    prop::collection::vec(0.05..1.0f64, 3..40).prop_map(|radii| {
        let n = radii.len() as u32;
        let at = |k: u32| presight_model::geometry::sin_cos_of_turn(k, n);
        radii.iter().zip(0..).map(|(r, k)| DVec2::new(at(k).1, at(k).0) * *r).collect()
    })
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    #[test]
    fn concave_outlines_become_closed_solids_of_convex_parts(outline in star(), h in 0.01..10.0f64, reversed: bool) {
        let mut outline = outline;
        if reversed { outline.reverse(); }
        let n = outline.len();
        let doubled: f64 = (0..n).map(|k| outline[k].perp_dot(outline[(k + 1) % n])).sum();
        let around: f64 = (0..n).map(|k| outline[k].distance(outline[(k + 1) % n])).sum();
        let solid = extrude(&outline, h).unwrap();
        prop_assert_eq!(fault(&solid), None);
        prop_assert!((volume(&solid) - 0.5 * doubled.abs() * h).abs() < 1e-11);
        prop_assert!((area(&solid) - (doubled.abs() + around * h)).abs() < 1e-10);
        // There are never more parts than triangles.
        let caps = solid.polygon_count() - n;
        prop_assert!(caps / 2 <= n - 2);
    }

    #[test]
    fn any_sound_size_gives_a_sound_solid(
        x in 0.001..100.0f64, y in 0.001..100.0f64, z in 0.001..100.0f64, share in 0.05..0.95f64, n in 4..70u32
    ) {
        let all = [
            cuboid(x, y, z), wedge(x, y, z), pyramid(x, y, z, 0.0, 0.0), pyramid(x, y, z, share * x, 0.0),
            pyramid(x, y, z, share * x, y / share), stairs(n, x, y, z), prism(n, x, z), cylinder(x, z, n),
            cone(x, 0.0, z, n), cone(x, share * x, z, n), sphere(x, n), tube(x, share * x, z, n),
        ];
        for solid in all {
            let solid = solid.unwrap();
            prop_assert_eq!(fault(&solid), None);
            prop_assert!(mesh(&solid).is_ok());
        }
    }
}
