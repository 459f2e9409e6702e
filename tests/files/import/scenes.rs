//! The real scenes: compares counts, bounds and source numbers with their descriptions.

use crate::build::SOURCE;
use glam::DVec3;
use presight_read::gltf::{ImportOptions, import};
use presight_read::preparation::ProblemKind;
use presight_testkit::data;
use std::path::{Path, PathBuf};

fn scenes(data: &Path) -> Vec<PathBuf> {
    let mut all: Vec<PathBuf> = std::fs::read_dir(data.join("env"))
        .unwrap()
        .map(|e| e.unwrap().path())
        .filter(|p| p.extension().is_some_and(|e| e == "glb"))
        .collect();
    all.sort();
    assert!(all.len() >= 14, "{all:?}");
    all
}

/// The number after `label` in a text.
fn number_after(text: &str, label: &str) -> Option<u64> {
    let rest = &text[text.find(label)? + label.len()..];
    let digits: String = rest.trim_start().chars().take_while(char::is_ascii_digit).collect();
    digits.parse().ok()
}

/// The numbers in the brackets that follow `label`.
fn vector_after(text: &str, label: &str) -> [f64; 3] {
    let rest = &text[text.find(label).unwrap() + label.len()..];
    let inside = &rest[rest.find('[').unwrap() + 1..rest.find(']').unwrap()];
    let all: Vec<f64> = inside.split(',').map(|n| n.trim().parse().unwrap()).collect();
    all.try_into().unwrap()
}

#[test]
fn counts_and_bounds_equal_the_description() {
    let Some(data) = data::file("") else { return };
    for scene in scenes(&data) {
        let text = std::fs::read_to_string(scene.with_extension("txt")).unwrap();
        let read = import(&scene, &SOURCE).unwrap();
        let name = scene.file_stem().unwrap().to_string_lossy().into_owned();
        let report = &read.report;
        assert_eq!(
            Some(report.triangles_in_scene),
            number_after(&text, "triangles (all instances expanded):"),
            "{name}"
        );
        assert_eq!(Some(report.triangles_stored), number_after(&text, "unique triangles stored:"), "{name}");
        let degenerate = report.total(ProblemKind::DegenerateTriangle);
        // The description also counts areas under 1e-12 m2, which the import keeps.
        assert!(degenerate <= number_after(&text, "area<1e-12 m2)").unwrap(), "{name}: {degenerate}");
        assert_eq!(report.polygons_stored, report.triangles_stored - degenerate, "{name}");
        // The same definitions, counted by another program; one degenerate triangle more or less moves a few borders.
        let exact = degenerate == number_after(&text, "area<1e-12 m2)").unwrap();
        for (kind, label) in [
            (ProblemKind::DuplicateFace, "duplicate faces"),
            (ProblemKind::NonManifoldEdge, "non-manifold edges (>2 faces)"),
            (ProblemKind::OpenBorder, "boundary edges"),
            (ProblemKind::Sliver, "slivers (altitude<1/1000 of longest edge)"),
            (ProblemKind::InsideOut, "negative signed volume (inside-out)"),
        ] {
            let (found, theirs) = (report.total(kind), number_after(&text, label).unwrap());
            eprintln!("{name}: {kind:?} {found}, {theirs} by the description");
            assert!(if exact { found == theirs } else { found.abs_diff(theirs) <= 8 }, "{name}: {kind:?}");
        }
        let (low, high) = (vector_after(&text, "min "), vector_after(&text, "max "));
        // The descriptions have y up: their (x, y, z) is (x, -z, y) here.
        let bounds = read.environment.bounds();
        let expected = [low[0], -high[2], low[1], high[0], -low[2], high[1]];
        let found = [bounds.min.to_array(), bounds.max.to_array()].concat();
        for (f, e) in found.iter().zip(expected) {
            assert!((f - e).abs() < 0.3, "{name}: {found:?} {expected:?}");
        }
    }
}

#[test]
fn source_numbers_follow_the_reference_table() {
    let Some(data) = data::file("") else { return };
    let text = std::fs::read_to_string(data.join("reference/reference.json")).unwrap();
    let reference: serde_json::Value = serde_json::from_str(&text).unwrap();
    for (name, scene) in reference["scenes"].as_object().unwrap() {
        let read = import(data.join("env").join(name).with_extension("glb"), &SOURCE).unwrap();
        assert_eq!(scene["triangles"], read.report.triangles_in_scene, "{name}");
        // One row for each primitive: first number, count, node index, primitive, node name.
        let rows: Vec<&serde_json::Value> = scene["table"].as_array().unwrap().iter().collect();
        let starts: Vec<_> = rows.iter().filter(|r| r[3] == 0).collect();
        let objects = read.environment.objects();
        assert_eq!(objects.len(), starts.len(), "{name}");
        for (object, row) in objects.iter().zip(starts) {
            assert_eq!(row[0], object.first_source, "{name} {}", object.name);
            assert!(object.name.contains(row[4].as_str().unwrap()), "{name} {} {row}", object.name);
        }
    }
}

/// In a real model hardly any path above objects is itself an object: without groups these paths could not be moved.
#[test]
fn paths_above_objects_move_their_descendants() {
    let Some(data) = data::file("") else { return };
    let environment = import(data.join("env/hospital.glb"), &ImportOptions::default()).unwrap().environment;
    let groups: Vec<String> = environment.groups().into_keys().map(str::to_owned).collect();
    // Half of the groups have their parent's pose.
    assert_eq!((groups.len(), environment.framed_groups().count()), (143, 71));
    let mut world = presight_model::world::World::new(environment);
    let before = world.environment().content_hash();
    for path in groups.iter().step_by(7) {
        let start = world.clone();
        let pose = |w: &presight_model::world::World, path: &str| w.environment().frame(path).unwrap();
        let old = pose(&start, path);
        let to =
            presight_model::geometry::Pose::from_xyz_rpy(old.translation + DVec3::new(1.0, 2.0, 0.0), 0.1, 0.2, 1.0);
        let change = presight_model::change::Change::MoveObject { name: path.clone(), world_from_object: to };
        let undo = world.apply(change).unwrap();
        assert_eq!(pose(&world, path), to);
        let motion = to * old.inverse();
        for (a, b) in start.environment().objects().iter().zip(world.environment().objects()) {
            let below = a.name.strip_prefix(path.as_str()).is_some_and(|rest| rest.starts_with('/'));
            let expected = if below { motion * a.world_from_object } else { a.world_from_object };
            assert!((b.world_from_object.translation - expected.translation).length() < 1e-9, "{path}: {}", a.name);
        }
        world.apply(undo).unwrap();
        assert_eq!(world.environment().content_hash(), before, "{path}");
    }
}

#[test]
fn merging_keeps_every_surface() {
    let Some(data) = data::file("") else { return };
    for scene in scenes(&data) {
        let name = scene.file_stem().unwrap().to_string_lossy().into_owned();
        let start = std::time::Instant::now();
        let merged = import(&scene, &ImportOptions::default()).unwrap();
        let time = start.elapsed();
        let source = import(&scene, &SOURCE).unwrap();
        let (m, s) = (&merged.report, &source.report);
        eprintln!(
            "{name}: {} -> {} stored, {} -> {} in scene, {} merges, {:e} m, {time:?}",
            s.polygons_stored,
            m.polygons_stored,
            s.polygons_in_scene,
            m.polygons_in_scene,
            m.merges,
            m.largest_deviation_m
        );
        assert_eq!(m.polygons_stored + m.merges, s.polygons_stored, "{name}");
        assert_eq!((m.triangles_in_scene, &m.problems), (s.triangles_in_scene, &s.problems), "{name}");
        for (a, b) in merged.environment.objects().iter().zip(source.environment.objects()) {
            assert_eq!((&a.name, a.first_source), (&b.name, b.first_source));
            let (bounds, size) = (b.mesh.bounds(), b.mesh.bounds().size());
            // A vertex that vanished inside a merged polygon may have protruded by the tolerance.
            let apart = (a.mesh.bounds().min - bounds.min).abs().max((a.mesh.bounds().max - bounds.max).abs());
            assert!(apart.max_element() <= 1e-6 * size, "{name} {}", a.name);
            let (area_a, area_b) = (area(&a.mesh), area(&b.mesh));
            // A tilt of up to 1e-3 changes the area by 5e-7.
            assert!(
                (area_a - area_b).abs() <= 1e-6 * area_b + 1e-12 * size * size,
                "{name} {}: {area_a} {area_b}",
                a.name
            );
        }
    }
}

#[test]
fn points_of_source_triangles_lie_in_the_same_number_of_merged_polygons() {
    let Some(data) = data::file("") else { return };
    let (mut judged, mut merged_away) = (0u32, 0u32);
    for scene in scenes(&data) {
        let merged = import(&scene, &ImportOptions::default()).unwrap();
        let source = import(&scene, &SOURCE).unwrap();
        for (a, b) in merged.environment.objects().iter().zip(source.environment.objects()).step_by(7) {
            let slack = 2e-6 * b.mesh.bounds().size();
            let count = b.mesh.polygon_count() as u32;
            for triangle in (0..count).step_by((count as usize / 5).max(1)) {
                let p = b.mesh.corners_of(triangle).sum::<DVec3>() / 3.0;
                let normal = b.mesh.plane(triangle).normal;
                let [found, expected] = [&a.mesh, &b.mesh].map(|m| covering(m, p, normal, slack));
                // Within the tolerance of an edge either result is accepted.
                let (Some(found), Some(expected)) = (found, expected) else { continue };
                assert_eq!(found, expected, "{} {} triangle {triangle}", scene.display(), a.name);
                judged += 1;
                merged_away += u32::from(a.mesh.polygon_count() < b.mesh.polygon_count());
            }
        }
    }
    eprintln!("{judged} points judged, {merged_away} of them in meshes that were merged");
    assert!(merged_away > 1000);
}

/// The number of polygons facing along `normal` that contain the point; `None` if that is uncertain for one.
fn covering(mesh: &presight_model::environment::Mesh, p: DVec3, normal: DVec3, slack: f64) -> Option<u32> {
    let mut count = 0;
    for i in 0..mesh.polygon_count() as u32 {
        let plane = mesh.plane(i);
        let (off, facing) = ((plane.normal.dot(p) - plane.offset).abs(), plane.normal.dot(normal));
        if off > slack || facing < 0.99 {
            continue;
        }
        let v: Vec<DVec3> = mesh.corners_of(i).collect();
        let edge = |k: usize| {
            let (a, b) = (v[k], v[(k + 1) % v.len()]);
            plane.normal.cross(b - a).normalize().dot(p - a)
        };
        let depth = (0..v.len()).map(edge).fold(f64::INFINITY, f64::min);
        if depth.abs() <= slack || (facing < 0.999_99 && depth > 0.0) || (off > 0.25 * slack && depth > 0.0) {
            return None;
        }
        count += u32::from(depth > 0.0);
    }
    Some(count)
}

fn area(mesh: &presight_model::environment::Mesh) -> f64 {
    (0..mesh.polygon_count() as u32)
        .map(|i| {
            let v: Vec<_> = mesh.corners_of(i).collect();
            let fan = |k: usize| (v[k] - v[0]).cross(v[k + 1] - v[0]).dot(mesh.plane(i).normal);
            0.5 * (1..v.len() - 1).map(fan).sum::<f64>()
        })
        .sum()
}
