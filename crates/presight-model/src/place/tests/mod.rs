mod covered;

use super::*;
use crate::environment::{Existence, Material, Mesh, NewObject, Polygon, PolygonOrder, Properties};
use crate::error::ErrorKind;
use crate::geometry::PoseCovariance;
use glam::{DAffine3, DMat3, DQuat, Vec3};
use parry3d_f64::query::PointQuery;
use parry3d_f64::shape::Triangle;
use proptest::prelude::*;
use std::sync::Arc;

const TOLERANCE: f64 = 1e-3;

/// A box from the origin, in triangles or rectangles. Each side is cut into `cuts` strips along its first axis, so that
/// lines cross several polygons.
fn cuboid(size: DVec3, cuts: u32, triangles: bool) -> Arc<Mesh> {
    let (mut vertices, mut polygons) = (Vec::new(), Vec::new());
    for axis in 0..3 {
        let (u, v) = ((axis + 1) % 3, (axis + 2) % 3);
        for side in [0.0, 1.0] {
            for k in 0..cuts {
                let first = vertices.len() as u32;
                let at = |a: u32, b: f64| {
                    let mut p = DVec3::ZERO;
                    (p[axis], p[u], p[v]) = (side * size[axis], size[u] * f64::from(a) / f64::from(cuts), b * size[v]);
                    p.as_vec3()
                };
                vertices.extend([at(k, 0.0), at(k + 1, 0.0), at(k + 1, 1.0), at(k, 1.0)]);
                let parts: &[&[u32]] = if triangles { &[&[0, 1, 2], &[0, 2, 3]] } else { &[&[0, 1, 2, 3]] };
                polygons.extend(parts.iter().map(|p| Polygon::new(p.iter().map(|c| first + c).collect(), 0)));
            }
        }
    }
    Arc::new(Mesh::new("box", vertices, polygons, PolygonOrder::Given).unwrap())
}

fn world_of(objects: Vec<NewObject>) -> World {
    let mut environment = Environment::new();
    environment.add_material(Material::named("m")).unwrap();
    for object in objects {
        environment.insert(object).unwrap();
    }
    World::new(environment)
}

fn feature(object: Option<&str>, shape: FeatureShape) -> Feature {
    Feature {
        id: 7,
        name: None,
        object: object.map(str::to_owned),
        shape,
        existence: Existence::default(),
        properties: Properties::default(),
    }
}

fn point(at: DVec3) -> FeatureShape {
    FeatureShape::Point { at, covariance: DMat3::ZERO }
}

fn segment(a: DVec3, b: DVec3) -> FeatureShape {
    FeatureShape::Segment { ends: [a, b], covariances: [DMat3::ZERO; 2], cross: DMat3::ZERO }
}

fn patch(corners: &[[f64; 3]]) -> FeatureShape {
    FeatureShape::Patch { corners: corners.iter().map(|c| DVec3::from_array(*c)).collect(), covariance: DMat3::ZERO }
}

fn place_one(world: &World, object: Option<&str>, shape: FeatureShape) -> Result<PlacedFeature> {
    let features = vec![feature(object, shape).into()];
    let layer = FeatureLayer { class: "video".into(), tolerance: TOLERANCE, features, ..FeatureLayer::default() };
    place(world, &layer).map(|mut placed| placed.remove(0))
}

/// Normals of the polygons a feature lies on, in the mesh's frame, without signs: x 1, y 2, z 4.
fn axes(world: &World, slots: &[u32]) -> Vec<u32> {
    let object = &world.environment().objects()[0];
    let axis = |s: &u32| object.mesh.plane(*s - object.first_slot).normal.abs().max_position() as u32;
    let mut axes: Vec<u32> = slots.iter().map(axis).collect();
    axes.sort_unstable();
    axes
}

#[test]
fn edges_lie_on_both_faces_and_on_all_in_line() {
    // Far from the origin, rotated, and given in the object's frame: full precision is kept.
    let pose = Pose::from_xyz_rpy(DVec3::new(5e6, -5e6, 512.0), 0.3, -0.2, 1.1);
    let world = world_of(vec![NewObject::new("box", pose, cuboid(DVec3::new(2.0, 1.0, 3.0), 4, false))]);
    // Along y: the x faces are cut along y (four strips each), the z faces along x, the y faces along z.
    let edge = place_one(&world, Some("box"), segment(DVec3::ZERO, DVec3::Y)).unwrap();
    assert_eq!((edge.object, axes(&world, &edge.slots)), (Some(0), vec![0, 0, 0, 0, 2]));
    // Inside one face, across its strips and along one strip.
    let across = place_one(&world, Some("box"), segment(DVec3::new(0.0, 0.1, 1.0), DVec3::new(0.0, 0.9, 2.0))).unwrap();
    assert_eq!(axes(&world, &across.slots), [0, 0, 0, 0]);
    let along = place_one(&world, Some("box"), segment(DVec3::new(0.0, 0.1, 1.0), DVec3::new(0.0, 0.1, 2.0))).unwrap();
    assert_eq!(axes(&world, &along.slots), [0]);
    // A corner is on three faces; so is the same point given in the world, in spite of its rounding.
    let corner = place_one(&world, Some("box"), point(DVec3::ZERO)).unwrap();
    assert_eq!(axes(&world, &corner.slots), [0, 1, 2]);
    let in_world = place_one(&world, None, point(pose.translation)).unwrap();
    assert_eq!((in_world.object, &in_world.slots), (None, &corner.slots));
    // Just within the tolerance, and just beyond.
    let near = |d: f64| place_one(&world, Some("box"), segment(DVec3::new(-d, 0.1, 0.1), DVec3::new(-d, 0.8, 0.1)));
    assert_eq!(axes(&world, &near(0.999e-3).unwrap().slots), [0, 0, 0, 0]);
    let error = near(1.001e-3).unwrap_err();
    assert_eq!((error.kind(), error.place()), (ErrorKind::Invalid, Some("feature 7")));
    let said = error.to_string();
    assert!(said.contains("0.001001 m off its polygons") && said.contains("object \"box\""), "{said}");
}

#[test]
fn what_is_off_names_feature_object_and_distance() {
    let world = world_of(vec![NewObject::new("box", Pose::IDENTITY, cuboid(DVec3::splat(2.0), 1, true))]);
    let said = |object: Option<&str>, shape: FeatureShape| place_one(&world, object, shape).unwrap_err().to_string();
    let unknown = said(Some("door"), point(DVec3::ZERO));
    assert!(unknown.contains("feature 7: there is no object \"door\""), "{unknown}");
    assert!(said(None, point(DVec3::new(-0.25, 1.0, 1.0))).contains("0.250000 m off its polygons"));
    assert!(said(None, point(DVec3::splat(1e5))).contains("m off its polygons"));
    // Both ends on the box, with nothing between them.
    let through = said(None, segment(DVec3::new(0.0, 1.0, 1.0), DVec3::new(2.0, 1.0, 1.0)));
    assert!(through.contains("segment is 1.000000 m off its polygons at [1, 1, 1]"), "{through}");
    // One end over the edge, by more and by less than the tolerance.
    let over = |z: f64| segment(DVec3::new(0.0, 1.0, 1.0), DVec3::new(0.0, 1.0, z));
    assert!(said(None, over(2.0 + 2e-3)).contains("0.002000 m off"));
    assert!(place_one(&world, None, over(2.0 + 0.9e-3)).is_ok());
    let nothing = place_one(&world_of(vec![]), None, point(DVec3::ZERO)).unwrap_err();
    assert!(nothing.to_string().contains("no polygons"), "{nothing}");
    let layer = FeatureLayer {
        class: "video".into(),
        tolerance: TOLERANCE,
        pose_covariances: vec![("door".into(), PoseCovariance::ZERO)],
        ..FeatureLayer::default()
    };
    assert!(place(&world, &layer).unwrap_err().to_string().contains("pose covariance of object \"door\""));
    // Values that no file can hold are also rejected here.
    assert!(said(None, point(DVec3::NAN)).contains("not a finite position"));
}

#[test]
fn a_segment_that_ends_on_a_polygon_does_not_lie_on_it() {
    // A pillar on a floor; the two are separate objects.
    let floor = NewObject::new("floor", Pose::IDENTITY, cuboid(DVec3::new(10.0, 10.0, 1.0), 1, false));
    let pose = Pose::from_xyz_rpy(DVec3::new(4.0, 4.0, 1.0), 0.0, 0.0, 0.5);
    let pillar = NewObject::new("pillar", pose, cuboid(DVec3::new(0.5, 0.5, 3.0), 1, false));
    let world = world_of(vec![floor, pillar]);
    let first = world.environment().objects()[1].first_slot;
    let upright = place_one(&world, Some("pillar"), segment(DVec3::ZERO, 3.0 * DVec3::Z)).unwrap();
    assert!(upright.slots.len() == 2 && upright.slots.iter().all(|s| *s >= first), "{:?}", upright.slots);
    // Its foot lies on the floor and on the pillar's bottom and side.
    let foot = place_one(&world, Some("pillar"), segment(DVec3::ZERO, 0.5 * DVec3::X)).unwrap();
    assert_eq!(foot.slots.iter().filter(|s| **s < first).count(), 1);
    assert_eq!(foot.slots.len(), 3);
    // The polygons stay when the objects move together, or when only the pillar is lifted off the floor.
    let mut moved = world.clone();
    let lifted = Pose { translation: pose.translation + 0.1 * DVec3::Z, ..pose };
    moved.apply(crate::Change::MoveObject { name: "pillar".into(), world_from_object: lifted }).unwrap();
    let foot = place_one(&moved, Some("pillar"), segment(DVec3::ZERO, 0.5 * DVec3::X)).unwrap();
    assert!(foot.slots.len() == 2 && foot.slots.iter().all(|s| *s >= first));
}

#[test]
fn patches_lie_on_what_they_overlap_and_nowhere_else() {
    let far = Pose::from_xyz_rpy(DVec3::new(-5e6, 5e6, 0.0), 0.1, 0.7, -2.0);
    let world = world_of(vec![NewObject::new("box", far, cuboid(DVec3::new(2.0, 4.0, 3.0), 4, true))]);
    let on = |corners: &[[f64; 3]]| place_one(&world, Some("box"), patch(corners)).map(|p| p.slots);
    // The x = 0 face has four strips of 1 m along y, two triangles each.
    let whole = on(&[[0., 0., 0.], [0., 4., 0.], [0., 4., 3.], [0., 0., 3.]]).unwrap();
    assert_eq!(axes(&world, &whole), [0; 8]);
    // Either winding; half of the strips; within one triangle.
    assert_eq!(on(&[[0., 0., 3.], [0., 4., 3.], [0., 4., 0.], [0., 0., 0.]]).unwrap(), whole);
    assert_eq!(on(&[[0., 0., 0.], [0., 2., 0.], [0., 2., 3.], [0., 0., 3.]]).unwrap().len(), 4);
    assert_eq!(on(&[[0., 0.8, 0.1], [0., 0.9, 0.1], [0., 0.9, 0.2]]).unwrap().len(), 1);
    // Too large by less than the tolerance; by more; floating; tilted.
    assert_eq!(on(&[[0., -9e-4, 0.], [0., 4., 0.], [0., 4., 3.], [0., -9e-4, 3.]]).unwrap(), whole);
    let off = |corners: &[[f64; 3]]| on(corners).unwrap_err().to_string();
    assert!(off(&[[0., -2e-3, 0.], [0., 4., 0.], [0., 4., 3.], [0., -2e-3, 3.]]).contains("0.002000 m off"));
    assert!(off(&[[-0.5, 1., 1.], [-0.5, 2., 1.], [-0.5, 2., 2.]]).contains("0.500000 m off"));
    assert!(off(&[[0., 1., 1.], [0., 2., 1.], [-0.01, 2., 2.]]).contains("0.010000 m off"));
    // A marker on the face is also a patch.
    let marker = FeatureShape::Fiducial {
        corners: [[0., 0.6, 1.], [0., 0.4, 1.], [0., 0.4, 0.8], [0., 0.6, 0.8]].map(DVec3::from_array),
        covariance: DMat3::ZERO,
        family: "DICT_4X4_50".into(),
        code: 1,
    };
    let slots = place_one(&world, Some("box"), marker).unwrap().slots;
    assert!(!slots.is_empty() && slots.iter().all(|s| whole.contains(s)));
}

/// A square wall of 4 x 4 m at x = 0 with a square hole in it, in eight rectangles.
fn wall_with_hole(hole: f64) -> World {
    let cuts = [0.0, 2.0 - 0.5 * hole, 2.0 + 0.5 * hole, 4.0];
    let vertices: Vec<Vec3> = (0..16).map(|k| DVec3::new(0.0, cuts[k % 4], cuts[k / 4]).as_vec3()).collect();
    let cells = (0..9u32).filter(|k| *k != 4).map(|k| 4 * (k / 3) + k % 3);
    let polygons = cells.map(|c| Polygon::new(vec![c, c + 1, c + 5, c + 4], 0)).collect();
    let mesh = Mesh::new("wall", vertices, polygons, PolygonOrder::Given).unwrap();
    world_of(vec![NewObject::new("wall", Pose::IDENTITY, Arc::new(mesh))])
}

#[test]
fn holes_under_patches_are_found() {
    let all = patch(&[[0., 0., 0.], [0., 4., 0.], [0., 4., 4.], [0., 0., 4.]]);
    for hole in [1.0, 0.1, 3e-3] {
        let error = place_one(&wall_with_hole(hole), None, all.clone()).unwrap_err();
        assert!(error.to_string().contains("patch is"), "{hole}: {error}");
    }
    // Its middle is within the tolerance of its sides.
    assert_eq!(place_one(&wall_with_hole(1.9e-3), None, all).unwrap().slots.len(), 8);
    let beside = patch(&[[0., 0., 0.], [0., 1.4, 0.], [0., 1.4, 4.], [0., 0., 4.]]);
    assert_eq!(place_one(&wall_with_hole(1.0), None, beside).unwrap().slots.len(), 3);
}

/// Distance of a point from a polygon by another library, in the world.
fn oracle_distance(corners: &[DVec3], p: DVec3) -> f64 {
    let v = |p: DVec3| parry3d_f64::math::Vector::new(p.x, p.y, p.z);
    let fan = corners[1..].windows(2).map(|pair| Triangle::new(v(corners[0]), v(pair[0]), v(pair[1])));
    fan.map(|t| t.distance_to_local_point(v(p), true)).fold(f64::INFINITY, f64::min)
}

/// Samples along a segment: less than the tolerance apart in all tests.
const SAMPLES: u32 = 6000;

/// The share of a segment, by samples, within the tolerance of a polygon.
fn oracle_share(corners: &[DVec3], a: DVec3, b: DVec3, tolerance: f64) -> f64 {
    let on =
        (0..=SAMPLES).filter(|k| oracle_distance(corners, a.lerp(b, f64::from(*k) / f64::from(SAMPLES))) <= tolerance);
    on.count() as f64 / f64::from(SAMPLES + 1)
}

/// The length of a segment within a distance of a polygon, metres. The distance from a convex body is convex along a
/// line, so the part is one interval around the nearest place.
fn oracle_stretch(corners: &[DVec3], a: DVec3, b: DVec3, reach: f64) -> f64 {
    const HALVINGS: u32 = 60;
    let distance = |t: f64| oracle_distance(corners, a.lerp(b, t));
    let (mut low, mut high) = (0.0, 1.0);
    for _ in 0..2 * HALVINGS {
        let [p, q] = [low + (high - low) / 3.0, high - (high - low) / 3.0];
        if distance(p) <= distance(q) { high = q } else { low = p }
    }
    let nearest = 0.5 * (low + high);
    if distance(nearest) > reach {
        return 0.0;
    }
    let end = |mut out: f64| {
        let mut inner = nearest;
        if distance(out) <= reach {
            return out;
        }
        for _ in 0..HALVINGS {
            let middle = 0.5 * (inner + out);
            if distance(middle) <= reach { inner = middle } else { out = middle }
        }
        inner
    };
    (end(1.0) - end(0.0)) * (b - a).length()
}

/// The first error that brute force finds in the slots of a segment (world). Lengths counted by samples have a slack of
/// two samples. Where polygons support the segment within rounding, a stretch of twice that is enough.
fn disagreement(slots: &[u32], all: &[Vec<DVec3>], a: DVec3, b: DVec3) -> Option<String> {
    let length = (b - a).length();
    let margin = 2.0 * length / f64::from(SAMPLES) + 1e-6;
    let [least, min_closely] = [TOLERANCE, ROUNDING].map(|tolerance| (2.0 * tolerance).min(0.5 * length));
    let held_within = |tolerance: f64| {
        (0..=SAMPLES).all(|k| {
            let p = a.lerp(b, f64::from(k) / f64::from(SAMPLES));
            slots.iter().any(|s| oracle_distance(&all[*s as usize], p) < tolerance)
        })
    };
    let (closely, somehow) = (held_within(2.0 * ROUNDING), held_within(TOLERANCE + 1e-7));
    (0..).zip(all).find_map(|(slot, corners)| {
        let stretch = length * oracle_share(corners, a, b, TOLERANCE);
        let normal = (corners[1] - corners[0]).cross(corners[2] - corners[0]).normalize();
        let rise = normal.dot(b - a).abs() / length;
        let held = |reach: f64| oracle_stretch(corners, a, b, reach);
        if slots.contains(&slot) {
            let lies = stretch > (least - margin).max(0.0) || closely && held(2.0 * ROUNDING) > min_closely - 1e-6;
            let sound = lies && rise < LYING.max(2.0 * TOLERANCE / length) + 1e-6;
            (!sound).then(|| format!("slot {slot} supports only {stretch} m of {length} m, at a slope of {rise}"))
        } else {
            // If other polygons support it within rounding, a near polygon may hide it; so may one that it crosses.
            let near = || held(0.5 * ROUNDING) < 2.0 * min_closely;
            let excused = closely && near() || somehow && passes_through(corners, a, b);
            let sound = stretch < least + margin || rise > 0.99 * LYING || excused;
            (!sound).then(|| format!("slot {slot}, which supports {stretch} m of {length} m, is missing"))
        }
    })
}

fn passes_through(corners: &[DVec3], a: DVec3, b: DVec3) -> bool {
    let normal = (corners[1] - corners[0]).cross(corners[2] - corners[0]);
    normal.dot(a - corners[0]) * normal.dot(b - corners[0]) < 0.0
}

prop_compose! {
    fn scene()(
        boxes in prop::collection::vec(
            (
                [0.2..3.0f64, 0.2..3.0f64, 0.2..3.0f64],
                [-3.0..3.0f64, -3.0..3.0f64, -3.0..3.0f64],
                -3.1..3.1f64,
                1u32..4,
                any::<bool>(),
                any::<bool>(),
            ),
            1..5,
        ),
        far in any::<bool>(),
    ) -> World {
        let origin = if far { DVec3::new(4469320.25, -5333710.5, 512.0) } else { DVec3::ZERO };
        world_of(boxes.into_iter().map(|(size, at, yaw, cuts, triangles, level)| {
            let tilt = if level { 0.0 } else { 0.4 };
            let pose = Pose::from_xyz_rpy(origin + DVec3::from_array(at), tilt, -tilt, yaw);
            let new = NewObject::new("box", pose, cuboid(DVec3::from_array(size), cuts, triangles));
            // Some are mirrored and scaled instances.
            let m = DAffine3::from_scale(DVec3::new(1.0, if level { -1.0 } else { 1.0 }, 1.25));
            NewObject { object_from_mesh: m, ..new }
        }).collect())
    }
}

/// Two points, each within the tolerance of all 48 triangles of a box.
#[test]
fn tolerances_that_reach_very_many_polygons_are_refused() {
    let world = world_of(vec![NewObject::new("box", Pose::IDENTITY, cuboid(DVec3::ONE, 4, true))]);
    let numbered = |id| Arc::new(Feature { id, ..feature(Some("box"), point(DVec3::ZERO)) });
    let features = vec![numbered(1), numbered(2)];
    let layer = FeatureLayer { class: "video".into(), tolerance: 10.0, features, ..Default::default() };
    let mut finder = SupportFinder::new(&world, &layer).unwrap();
    finder.max_pairs = 96;
    assert_eq!(finder.lie_all(&layer).unwrap().len(), 2);
    finder.max_pairs = 95;
    let refused = finder.lie_all(&layer).map(|all| all.len()).unwrap_err();
    assert_eq!(refused.kind(), ErrorKind::Invalid);
    assert!(refused.to_string().contains("tolerance of 10 m"), "{refused}");
}

/// The comparison detects a missing polygon, and an extra one.
fn find_planted_faults(slots: &[u32], all: &[Vec<DVec3>], a: DVec3, b: DVec3) -> Result<(), TestCaseError> {
    let share = |s: &u32| oracle_share(&all[*s as usize], a, b, TOLERANCE);
    let most = slots.iter().copied().max_by(|x, y| share(x).total_cmp(&share(y))).unwrap();
    let fewer: Vec<u32> = slots.iter().copied().filter(|s| *s != most).collect();
    if !passes_through(&all[most as usize], a, b) {
        prop_assert!(disagreement(&fewer, all, a, b).is_some(), "{most}");
    }
    if let Some(apart) = (0..all.len() as u32).find(|s| share(s) == 0.0) {
        prop_assert!(disagreement(&[slots, &[apart]].concat(), all, a, b).is_some());
    }
    // A polygon that shares only the tolerance with the segment.
    let touches = |s: &u32| {
        let [wide, close] = [TOLERANCE, 2.0 * ROUNDING].map(|reach| oracle_stretch(&all[*s as usize], a, b, reach));
        wide > 0.0 && wide < TOLERANCE.min(0.25 * (b - a).length()) && close == 0.0
    };
    if let Some(touching) = (0..all.len() as u32).find(touches) {
        prop_assert!(disagreement(&[slots, &[touching]].concat(), all, a, b).is_some());
    }
    Ok(())
}

/// The polygons of a point (world), by brute force.
fn check_point(world: &World, all: &[Vec<DVec3>], a: DVec3) -> Result<(), TestCaseError> {
    let first = place_one(world, None, point(a));
    let near = |most: f64| -> Vec<u32> {
        (0..).zip(all).filter(|(_, c)| oracle_distance(c, a) <= most).map(|(s, _)| s).collect()
    };
    // Near polygons count only if no polygon is within rounding, including the rounding of vertices.
    let closest = if near(2.0 * ROUNDING).is_empty() { TOLERANCE - 1e-7 } else { 0.5 * ROUNDING };
    let (surely, perhaps) = (near(closest), near(TOLERANCE + 1e-7));
    match first {
        Ok(p) => {
            prop_assert!(surely.iter().all(|s| p.slots.contains(s)) && p.slots.iter().all(|s| perhaps.contains(s)))
        }
        Err(_) => prop_assert!(surely.is_empty()),
    }
    Ok(())
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    /// Compares with brute force over all polygons, by another library's distances, in the world's frame.
    #[test]
    fn segments_and_points_agree_with_brute_force(
        world in scene(),
        pick in any::<prop::sample::Index>(),
        from in (0.0..1.0f64, 0.0..1.0f64),
        to in (0.0..1.0f64, 0.0..1.0f64),
        edge in 0..3u32,
        lift in prop_oneof![Just(0.0), -3e-3..3e-3f64],
        in_world in any::<bool>(),
    ) {
        let environment = world.environment();
        let slot = pick.index(environment.slot_count() as usize) as u32;
        let (index, polygon) = environment.locate(slot).unwrap();
        let object = &environment.objects()[index as usize];
        let corners: Vec<DVec3> =
            object.mesh.corners_of(polygon).map(|p| object.object_from_mesh.transform_point3(p)).collect();
        let normal = (corners[1] - corners[0]).cross(corners[2] - corners[0]).normalize();
        // On a side of the polygon, or anywhere in its parallelogram.
        let at = |(s, t): (f64, f64)| {
            let t = if edge == 0 { 0.0 } else { t };
            corners[0] + s * (corners[1] - corners[0]) + t * (corners[2] - corners[1])
        };
        let [a, b] = [at(from), at(to)].map(|p| p + lift * normal);
        prop_assume!((b - a).length() > 0.01);
        // At the threshold of the rounding of files either answer is right, and one polygon may be missing.
        prop_assume!(lift == 0.0 || lift.abs() > 4.0 * ROUNDING);
        let name = object.name.clone();
        let to_world = |p: DVec3| object.world_from_object.transform_point(p);
        let (whose, shape) = if in_world {
            (None, segment(to_world(a), to_world(b)))
        } else {
            (Some(name.as_str()), segment(a, b))
        };
        let (a, b) = (to_world(a), to_world(b));
        let placed = place_one(&world, whose, shape);
        let slots = 0..environment.slot_count();
        let all: Vec<Vec<DVec3>> = slots.map(|s| environment.polygon_in_world(s).unwrap()).collect();
        // World coordinates of a far site are rounded to a nanometre.
        let farthest = (0..=SAMPLES).map(|k| {
            let p = a.lerp(b, f64::from(k) / f64::from(SAMPLES));
            all.iter().map(|c| oracle_distance(c, p)).fold(f64::INFINITY, f64::min)
        }).fold(0.0, f64::max);
        if farthest < TOLERANCE - 1e-7 && edge != 2 {
            // On the chosen polygon's face all along: no crossed polygon is needed.
            prop_assert!(placed.is_ok(), "{farthest}: {}", placed.unwrap_err());
        }
        if farthest > TOLERANCE + 1e-7 {
            prop_assert!(placed.is_err(), "{farthest}");
        }
        let Ok(placed) = placed else { return Ok(()) };
        prop_assert_eq!(disagreement(&placed.slots, &all, a, b), None);
        find_planted_faults(&placed.slots, &all, a, b)?;
        check_point(&world, &all, a)?;
    }

    /// A rectangle inside a face of a box is found on that face, whatever its tessellation. It is not found there if it
    /// is lifted, or shifted over the rim.
    #[test]
    fn patches_agree_with_brute_force(
        size in [0.5..3.0f64, 0.5..3.0f64, 0.5..3.0f64],
        cuts in 1u32..20,
        triangles in any::<bool>(),
        from in (0.0..1.0f64, 0.0..1.0f64),
        to in (0.0..1.0f64, 0.0..1.0f64),
        shift in prop_oneof![Just(0.0), -3e-3..3e-3f64],
        yaw in -3.1..3.1f64,
    ) {
        let size = DVec3::from_array(size);
        let pose = Pose { rotation: DQuat::from_rotation_z(yaw), translation: DVec3::new(5e6, 5e6, -5e6) };
        let world = world_of(vec![NewObject::new("box", pose, cuboid(size, cuts, triangles))]);
        // On z = 0, which is cut along x.
        let size = DVec3::new(f64::from(size.x as f32), f64::from(size.y as f32), 0.0);
        let (low, high) = ([from.0.min(to.0), from.1.min(to.1)], [from.0.max(to.0), from.1.max(to.1)]);
        prop_assume!(high[0] - low[0] > 0.02 && high[1] - low[1] > 0.02);
        let (x, y) = ([low[0] * size.x + shift, high[0] * size.x + shift], [low[1] * size.y, high[1] * size.y]);
        let corners = [[x[0], y[0], 0.0], [x[1], y[0], 0.0], [x[1], y[1], 0.0], [x[0], y[1], 0.0]];
        let over = (-x[0]).max(x[1] - size.x);
        let placed = place_one(&world, Some("box"), patch(&corners));
        prop_assert!(over > TOLERANCE - 1e-6 || placed.is_ok(), "{over}: {:?}", placed.err());
        prop_assert!(over < TOLERANCE + 1e-6 || placed.is_err(), "{over}");
        let Ok(placed) = placed else { return Ok(()) };
        let mesh = &world.environment().objects()[0].mesh;
        for slot in 0..mesh.polygon_count() as u32 {
            let c: Vec<DVec3> = mesh.corners_of(slot).collect();
            if c.iter().any(|p| p.z != 0.0) {
                prop_assert!(!placed.slots.contains(&slot));
                continue;
            }
            // Samples strictly inside the polygon prove an overlap; a polygon beyond the patch has none.
            let sample = |k: u32| {
                let (s, t) = (f64::from(k % 40) / 39.0, f64::from(k / 40) / 39.0);
                DVec3::new(x[0] + s * (x[1] - x[0]), y[0] + t * (y[1] - y[0]), 0.0)
            };
            let inside = |p: DVec3| {
                let turn = |k: usize| {
                    let side = c[(k + 1) % c.len()] - c[k];
                    side.cross(p - c[k]).z / side.length()
                };
                (0..c.len()).all(|k| turn(k) > 4.0 * TOLERANCE) || (0..c.len()).all(|k| turn(k) < -4.0 * TOLERANCE)
            };
            if (0..1600).any(|k| inside(sample(k))) {
                prop_assert!(placed.slots.contains(&slot), "slot {slot} is missing");
            }
            if (0..1600).all(|k| oracle_distance(&c, sample(k)) > 1e-9) && c.iter().all(|p| p.x < x[0] || p.x > x[1]) {
                let beyond = c.iter().all(|p| p.x <= x[0]) || c.iter().all(|p| p.x >= x[1]);
                prop_assert!(!beyond || !placed.slots.contains(&slot), "slot {slot} does not belong");
            }
        }
    }
}
