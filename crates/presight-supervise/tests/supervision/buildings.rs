//! Paths through random buildings, against discs that a clipper of the tests' own cuts.

use glam::{DVec2, DVec3};
use presight_model::world::World;
use presight_supervise::query::{FloorPath, PathOptions, find_path};
use presight_testkit::Random;
use presight_testkit::buildings::Building;
use std::collections::{HashSet, VecDeque};

/// True if a disc of the world lies on the main floor, clear of boxes.
fn is_clear(building: &Building, p: DVec2, radius: f64) -> bool {
    let disc: Vec<DVec2> =
        (0..24).map(|k| p + radius * DVec2::from_angle(std::f64::consts::TAU * f64::from(k) / 24.0)).collect();
    building.box_distance(p) >= radius && building.missing_area(&disc) < 1e-7
}

/// True if a robot that is 6 cm wider finds a way on a grid of 5 cm.
fn is_connected(building: &Building, from: DVec2, to: DVec2, radius: f64) -> bool {
    let (step, wide) = (0.05, radius + 0.06);
    let at = |k: [i32; 2]| from + step * DVec2::new(f64::from(k[0]), f64::from(k[1]));
    let (mut known, mut next) = (HashSet::from([[0, 0]]), VecDeque::from([[0, 0]]));
    if !is_clear(building, from, wide) || !is_clear(building, to, wide) {
        return false;
    }
    while let Some([x, y]) = next.pop_front() {
        if at([x, y]).distance(to) < step {
            return true;
        }
        for k in [[x - 1, y], [x + 1, y], [x, y - 1], [x, y + 1]] {
            if known.insert(k) && is_clear(building, at(k), wide) {
                next.push_back(k);
            }
        }
    }
    false
}

/// The points of a path a centimetre apart.
fn dense(points: &[DVec3]) -> impl Iterator<Item = DVec3> + '_ {
    points.windows(2).flat_map(|w| {
        let count = (w[0].distance(w[1]) / 0.01).ceil().max(1.0) as u32;
        (0..=count).map(move |k| w[0].lerp(w[1], f64::from(k) / f64::from(count)))
    })
}

/// Every point of a path has floor below the whole robot and no box within its radius, lies on the floor, and is
/// straight where that is free. There is no path only where a slightly wider robot finds none either.
/// `PRESIGHT_BUILDINGS=10000` tests as many buildings.
#[test]
fn paths_through_buildings_are_true() {
    let count = std::env::var("PRESIGHT_BUILDINGS").ok().and_then(|n| n.parse().ok()).unwrap_or(150);
    let (mut found, mut none, mut straight, mut ramps) = (0, 0, 0, 0);
    for seed in 0..count {
        let building = Building::new(seed);
        let world = World::new(building.environment.clone());
        let mut random = Random(seed + 77);
        let radius = random.uniform(0.15, 0.4);
        let mut draw = || {
            let floor = building.floors[random.below(building.floors.len())].0;
            let p = DVec2::new(random.uniform(floor.min.x, floor.max.x), random.uniform(floor.min.y, floor.max.y));
            building.in_world(p)
        };
        let (from, to) = (draw(), draw());
        let options = PathOptions::default().with_radius(radius);
        let result = find_path(&world, from + 0.02 * DVec3::Z, to + 0.02 * DVec3::Z, &[], &options);
        let Ok(FloorPath::Found { points, length }) = result else {
            none += 1;
            let way = is_connected(&building, from.truncate(), to.truncate(), radius);
            assert!(!way, "building {seed}: {result:?} from {from} to {to}, radius {radius}");
            continue;
        };
        found += 1;
        for p in dense(&points) {
            assert!(is_clear(&building, p.truncate(), radius - 0.005), "building {seed}: {p}, radius {radius}");
            let floor = building.in_world(building.on_plan(p.truncate())).z;
            assert!((p.z - floor).abs() < 0.03, "building {seed}: {p}, floor at {floor}");
        }
        ramps += usize::from(points.iter().any(|p| (p.z - points[0].z).abs() > 0.05));
        if dense(&[from, to]).all(|p| is_clear(&building, p.truncate(), radius + 0.01)) {
            straight += 1;
            let corners = points.iter().map(|p| p.truncate()).collect::<Vec<_>>();
            let plan: f64 = corners.windows(2).map(|w| w[0].distance(w[1])).sum();
            assert!((plan - from.truncate().distance(to.truncate())).abs() < 1e-6, "building {seed}: {length}");
        }
    }
    println!("{count} buildings: {found} paths, {straight} of them straight, {ramps} over ramps; {none} times none");
    let enough = count as usize / 30;
    assert!(found > 5 * enough && straight > 2 * enough && none > enough && ramps > 0);
}

/// The checks above find a path that only its middle keeps on the floor, and a path of a narrower robot.
#[test]
fn planted_faults_of_paths_are_found() {
    let (mut hanging, mut near) = (0, 0);
    for seed in 0..60 {
        let building = Building::new(seed);
        let world = World::new(building.environment.clone());
        let mut random = Random(seed + 77);
        let mut draw = || {
            let hall = building.floors[0].0;
            building.in_world(DVec2::new(random.uniform(0.3, hall.max.x - 0.3), random.uniform(0.3, hall.max.y - 0.3)))
        };
        let narrow = PathOptions::default().with_radius(0.05);
        if let Ok(FloorPath::Found { points, .. }) = find_path(&world, draw(), draw(), &[], &narrow) {
            let is_bad = |radius: f64| dense(&points).any(|p| !is_clear(&building, p.truncate(), radius));
            hanging += usize::from(is_bad(0.4));
            near += usize::from(is_bad(0.1));
        }
    }
    assert!(hanging > 10 && near > 3, "{hanging}, {near}");
}
