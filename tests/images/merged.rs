//! Compares merged polygons with their source triangles in real scenes, with the same sensor at the same pose.
//!
//! A pixel agrees if the merged world's hit is in the plane and at the range of the source world's triangle, within the
//! deviation that the import reports. The merged world may show another polygon only next to a border.

#![allow(clippy::print_stderr)] // Prints skips and results.

use presight_testkit as common;

use common::{data, env_number, plan, reference, scenes};
use glam::DVec3;
use presight_model::geometry::Pose;
use presight_model::sensor::Sensor;
use presight_model::world::World;
use presight_read::gltf::{ImportOptions, import};
use presight_render::plan::Images;

/// A scene as merged, as stored, and the largest displacement by merging in metres.
fn both(scene: &str) -> Option<(World, World, f64)> {
    let path = data::file(&format!("env/{scene}.glb"))?;
    let read = |merge| import(&path, &ImportOptions { merge, ..ImportOptions::default() }).expect("the scene imports");
    let (merged, source) = (read(true), read(false));
    assert!(merged.report.merges > 0, "{scene}: nothing was merged");
    assert_eq!(source.report.merges, 0, "{scene}");
    Some((World::new(merged.environment), World::new(source.environment), merged.report.largest_deviation_m))
}

#[derive(Debug, Default)]
struct Found {
    pixels: usize,
    agree: usize,
    beside_a_border: usize,
    wrong: Vec<String>,
}

struct Pair<'a> {
    merged: (&'a World, &'a Images),
    source: (&'a World, &'a Images),
    deviation: f64,
}

impl Pair<'_> {
    fn agrees(&self, at: usize) -> bool {
        let (merged, source) = (self.merged.1, self.source.1);
        let ids = [merged.polygon_id[at], source.polygon_id[at]];
        if ids.contains(&0) {
            // No ray, or no hit within the limits: compares bits, because NaN occurs.
            return ids == [0, 0] && merged.range[at].to_bits() == source.range[at].to_bits();
        }
        let ranges = [merged.range[at], source.range[at]].map(f64::from);
        // Both hits are on one ray. The triangle's corners are within the deviation of the polygon's plane, so the hit
        // is, too, and that distance is the difference of the ranges times the cosine.
        let cosine = f64::from(merged.cos_incidence[at].min(source.cos_incidence[at]));
        let near_enough = ranges[0] == ranges[1]
            || (ranges[0] - ranges[1]).abs() * cosine
                <= 2.0 * self.deviation + 2.0 * f64::from(f32::EPSILON) * ranges[0];
        near_enough && self.off_plane(ids) <= 2.0 * self.deviation + 1e-9
    }

    /// The largest distance of the triangle's corners from the merged polygon's plane.
    fn off_plane(&self, [polygon, triangle]: [u32; 2]) -> f64 {
        let corners = |world: &World, id: u32| world.environment().polygon_in_world(id - 1).expect("a polygon");
        let (flat, triangle) = (corners(self.merged.0, polygon), corners(self.source.0, triangle));
        let cross = |k: usize| (flat[k] - flat[0]).cross(flat[k + 1] - flat[0]);
        let normal = (1..flat.len() - 1).map(cross).sum::<DVec3>().normalize();
        let middle = flat.iter().sum::<DVec3>() / flat.len() as f64;
        triangle.iter().map(|p| normal.dot(*p - middle).abs()).fold(0.0, f64::max)
    }

    /// Returns true if the 3 x 3 pixels around one show more than one polygon of the merged world.
    fn border(&self, at: usize) -> bool {
        let images = self.merged.1;
        let (w, h) = (images.width as usize, images.height as usize);
        let (column, row) = (at % w, at / w);
        (row.saturating_sub(1)..(row + 2).min(h))
            .flat_map(|r| (0..3).map(move |c| r * w + (column + w + c - 1) % w))
            .any(|beside| images.polygon_id[beside] != images.polygon_id[at])
    }

    fn check(&self, found: &mut Found) {
        for at in 0..self.merged.1.pixels() {
            found.pixels += 1;
            if self.agrees(at) {
                found.agree += 1;
            } else if self.border(at) {
                found.beside_a_border += 1;
            } else {
                let show = |i: &Images| format!("polygon {} at {} m", i.polygon_id[at], i.range[at]);
                found.wrong.push(format!("pixel {at}: {} merged, {} source", show(self.merged.1), show(self.source.1)));
            }
        }
    }
}

fn compare(worlds: &(World, World, f64), sensor: &Sensor, poses: [&Pose; 2], found: &mut Found) {
    let (merged, source, deviation) = worlds;
    let images = [(merged, poses[0]), (source, poses[1])].map(|(w, pose)| reference(&plan(w, sensor, pose)));
    let pair = Pair { merged: (merged, &images[0]), source: (source, &images[1]), deviation: *deviation };
    pair.check(found);
}

/// `PRESIGHT_SEED` and `PRESIGHT_MERGE_POSES` (per scene) vary the runs.
#[test]
fn merged_polygons_lie_on_their_triangles() {
    let (seed, poses) = (env_number("PRESIGHT_SEED", 1), env_number("PRESIGHT_MERGE_POSES", 2) as usize);
    for scene in data::SCENES {
        let Some(worlds) = both(scene) else { return };
        let mut found = Found::default();
        for pose in data::poses(&worlds.0, poses, seed) {
            for sensor in [scenes::camera(193, 149), scenes::scanner(360, 46)] {
                compare(&worlds, &sensor, [&pose, &pose], &mut found);
            }
        }
        let (agree, border, pixels) = (found.agree, found.beside_a_border, found.pixels);
        eprintln!("{scene}: {pixels} pixels, {agree} agree, {border} at borders; deviation {:.3e} m", worlds.2);
        assert!(found.wrong.is_empty(), "{scene}, seed {seed}: {:#?}", &found.wrong[..found.wrong.len().min(5)]);
        assert!(border < 5 || border as f64 <= 1e-3 * pixels as f64, "{scene}: {border} of {pixels} differ at borders");
    }
}

#[test]
fn a_source_world_seen_from_a_little_higher_does_not_pass() {
    let Some(worlds) = both("office_willowgarage") else { return };
    let pose = data::poses(&worlds.0, 1, 1).remove(0);
    let higher = Pose { translation: pose.translation + DVec3::new(0.0, 0.0, 4.0 * worlds.2 + 1e-4), ..pose };
    let mut found = Found::default();
    compare(&worlds, &scenes::scanner(360, 46), [&pose, &higher], &mut found);
    assert!(found.wrong.len() > 100, "{} of {} pixels are found wrong", found.wrong.len(), found.pixels);
}
