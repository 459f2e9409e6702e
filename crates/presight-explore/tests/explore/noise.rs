//! The measured noise determines the size of the smallest surfels, without an option.

use super::rooms::views_of;
use glam::{DVec3, Vec3};
use presight_explore::{Exploration, ExploreOptions, Known};
use presight_model::environment::{Environment, NewObject};
use presight_model::geometry::Pose;
use presight_model::sensor::{Camera, Geometry, Noise, Sensor, SensorSpec};
use presight_testkit::caster::Caster;
use presight_testkit::judge::{Judged, Placed, judge};
use presight_testkit::scenes::empty;

/// A floor, two walls, and a column of radius 0.4 m.
fn room() -> Environment {
    let on_circle = |k: usize, z: f32| {
        let angle = k as f32 / 48.0 * std::f32::consts::TAU;
        Vec3::new(1.6 + 0.4 * angle.cos(), -0.4 + 0.4 * angle.sin(), z)
    };
    let side = |k: usize| vec![on_circle(k, -1.0), on_circle(k + 1, -1.0), on_circle(k + 1, 1.5), on_circle(k, 1.5)];
    let flat = [
        [[2.5, -2.5, -1.0], [2.5, -2.5, 1.5], [2.5, 1.5, 1.5], [2.5, 1.5, -1.0]],
        [[0.0, 1.5, -1.0], [0.0, 1.5, 1.5], [2.5, 1.5, 1.5], [2.5, 1.5, -1.0]],
        [[0.0, -2.5, -1.0], [2.5, -2.5, -1.0], [2.5, 1.5, -1.0], [0.0, 1.5, -1.0]],
    ];
    let flat = flat.map(|corners| corners.map(Vec3::from).to_vec());
    let polygons: Vec<Vec<Vec3>> = flat.into_iter().chain((0..48).map(side)).collect();
    let mut environment = empty();
    let mesh = presight_testkit::scenes::mesh(&polygons);
    environment.insert(NewObject::new("room", Pose::IDENTITY, mesh.into())).unwrap();
    environment
}

fn camera(width: u32, sigma: f64) -> Sensor {
    let (height, focal) = (width * 3 / 4, f64::from(width) / 2.0);
    let (cx, cy) = (f64::from(width) / 2.0 - 0.5, f64::from(height) / 2.0 - 0.5);
    let camera = Geometry::Camera(Camera::pinhole(width, height, focal, focal, cx, cy));
    let spec = SensorSpec::new("camera", "laser", camera).with_limits(0.2, 8.0);
    Sensor::new(spec.with_noise(Noise { range_sigma: sigma, ..Noise::default() })).unwrap()
}

fn looks(count: usize) -> impl Iterator<Item = Pose> {
    (0..count).map(move |k| {
        let turn = (k as f64 + 0.5) / count as f64 - 0.5;
        Pose::from_xyz_rpy(DVec3::new(0.2 * turn, 0.4 * turn, 0.1), 0.0, 0.3 - 0.3 * turn * turn, 0.1 + 0.8 * turn)
    })
}

/// Explores a room by a number of views with this noise, and predicts the views of a sensor without noise.
fn explored(width: u32, sigma: f64, count: usize, detail: Option<f64>) -> (Exploration, Judged) {
    let real = room();
    let views = views_of(&camera(width, sigma), looks(count).map(|pose| (real.clone(), pose)));
    let options = ExploreOptions::default().with_detail(detail);
    let found = Exploration::of(&Environment::new(), Known::Explored, &views, &options).unwrap();
    // The caster's ranges have a centimetre of noise.
    let mut caster = Caster::new(&real, camera(64, 0.0), 3);
    (caster.drop_outs, caster.mixed) = (0.0, 0.0);
    let held_out: Vec<Placed> = looks(5).map(|pose| (caster.frame(&|_| pose, 0.0, None), pose)).collect();
    let judged = judge(found.environment(), &held_out, 0.03 + sigma, 0.06 + 3.0 * sigma);
    (found, judged)
}

/// Measured: 99.7, 99.0, 99.6 and 92.7 % covered; with pieces of 2 cm 91.7, 96.7, 4.2 and 2.4 %.
#[test]
fn coarse_and_noisy_cameras_need_no_advice() {
    let cases = [(96, 0.01, 12), (48, 0.01, 12), (96, 0.03, 24), (96, 0.01, 2)];
    for (width, sigma, count) in cases {
        let (found, judged) = explored(width, sigma, count, None);
        println!("{width} columns, {sigma} m, {count} views: {judged:.3?} {} polygons", found.polygons());
        let (fixed, advised) = explored(width, sigma, count, Some(0.02));
        println!("    pieces of 2 cm: {advised:.3?} {} polygons", fixed.polygons());
        // Planted: a size that ignores the noise.
        assert!(judged.covered > advised.covered + 2.0, "{judged:?} {advised:?}");
        assert!(judged.covered > 90.0 && judged.within > 85.0, "{width} columns, {sigma} m, {count} views: {judged:?}");
    }
}

/// Planes of the column, by hand: half of it is seen. A plane whose middle is e nearer than its ends covers 2 acos(1 -
/// e / r) of the arc.
fn by_hand(error: f64) -> f64 {
    std::f64::consts::PI / (2.0 * (1.0 - error / 0.4).acos())
}

/// The areas of the column's planes, the largest first, square metres. Walls and floor are farther from it than 10 cm.
fn facets(found: &Exploration) -> Vec<f64> {
    let mut planes = Vec::<(DVec3, f64, f64)>::new();
    let objects = found.environment().objects().iter().filter(|o| !o.is_deleted());
    for corners in objects.flat_map(|o| (0..o.mesh.polygon_count() as u32).map(|k| o.polygon_in_world(k))) {
        let n = corners.len();
        let outer: DVec3 = (1..n - 1).map(|k| (corners[k] - corners[0]).cross(corners[k + 1] - corners[0])).sum();
        let (middle, area, normal) =
            (corners.iter().sum::<DVec3>() / n as f64, 0.5 * outer.length(), outer.normalize());
        let radius = (middle - DVec3::new(1.6, -0.4, 0.0)).truncate().length();
        if (radius - 0.4).abs() > 0.1 || middle.z < -0.9 {
            continue;
        }
        let is_same = |(n, off, _): &(DVec3, f64, f64)| n.dot(normal) > 0.9999 && (middle.dot(*n) - off).abs() < 0.002;
        match planes.iter().position(is_same) {
            Some(k) => planes[k].2 += area,
            None => planes.push((normal, middle.dot(normal), area)),
        }
    }
    let mut areas: Vec<f64> = planes.into_iter().map(|(_, _, area)| area).collect();
    areas.sort_by(|a, b| b.total_cmp(a));
    areas
}

/// Merging in pairs leaves planes with between half of the error that noise hides and all of it: up to twice as many as
/// by hand make nine tenths of the column. Fragments at the silhouettes and between planes are half as many again.
/// Measured: 9, 7 and 6 planes, with fragments 15, 15 and 9; when merges ignored the noise, 13, 100 and 86, with
/// fragments 23, 187 and 126.
#[test]
fn a_column_becomes_as_many_planes_as_its_noise_asks_for() {
    let counts = [0.002, 0.005, 0.01].map(|sigma| {
        let (found, judged) = explored(160, sigma, 24, None);
        let (areas, by_hand) = (facets(&found), by_hand(3.0 * sigma));
        let mut left = 0.9 * areas.iter().sum::<f64>();
        let is_needed = |area: &&f64| {
            let is_needed = left > 0.0;
            left -= **area;
            is_needed
        };
        let most = areas.iter().take_while(is_needed).count();
        println!("{sigma} m: {most} planes, {} with fragments, by hand {by_hand:.1}: {judged:.4?}", areas.len());
        assert!(most as f64 > 0.5 * by_hand && most as f64 <= 2.0 * by_hand, "{sigma} m: {most} of {areas:.3?}");
        assert!(areas.len() as f64 <= 3.0 * by_hand, "{sigma} m: {} of {areas:.3?}", areas.len());
        assert!(judged.covered > 99.0 && judged.within > 98.5, "{sigma} m: {judged:?}");
        most
    });
    assert!(counts[0] > counts[1] && counts[0] > counts[2] && counts[1] >= counts[2], "{counts:?}");
}
