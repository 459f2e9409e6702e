//! Queries against brute force, and the scenes of this repository.

use glam::{DVec2, DVec3};
use presight_model::environment::Environment;
use presight_model::error::ErrorKind;
use presight_model::geometry::{Aabb, Pose, RobotPose};
use presight_model::world::World;
use presight_predict::virtual_sensors::Corridor;
use presight_supervise::query::{
    FloorPath, PathOptions, Place, UncertainOptions, docks, find_path, objects_in, surface_distance,
    uncertain_features, uncertain_objects,
};
use presight_testkit::{Random, data, scenes};
use std::collections::{BinaryHeap, HashMap};

fn at(x: f64, y: f64, z: f64) -> Pose {
    Pose::from_xyz_rpy(DVec3::new(x, y, z), 0.0, 0.0, 0.0)
}

/// Distance to a triangle by its own three cases (Ericson 2005, section 5.1.5, written out by barycentric signs).
fn to_triangle(p: DVec3, [a, b, c]: [DVec3; 3]) -> f64 {
    let to_side = |a: DVec3, b: DVec3| {
        let t = ((p - a).dot(b - a) / (b - a).length_squared()).clamp(0.0, 1.0);
        p.distance(a.lerp(b, t))
    };
    let sides = to_side(a, b).min(to_side(b, c)).min(to_side(c, a));
    let n = (b - a).cross(c - a);
    let foot = p - n * (n.dot(p - a) / n.length_squared());
    let inside = [(a, b), (b, c), (c, a)].iter().all(|(a, b)| n.dot((*b - *a).cross(foot - *a)) >= 0.0);
    if inside { p.distance(foot) } else { sides }
}

#[test]
fn the_nearest_surface_is_that_of_brute_force() {
    let world = World::new(scenes::room(3, 40));
    let mut triangles = Vec::new();
    for object in world.environment().objects() {
        for polygon in 0..object.mesh.polygon_count() as u32 {
            let corners = object.polygon_in_world(polygon);
            triangles.extend((1..corners.len() - 1).map(|k| [corners[0], corners[k], corners[k + 1]]));
        }
    }
    let mut random = Random(4);
    for k in 0..10_000 {
        let wide = if k % 10 == 0 { 40.0 } else { 6.0 };
        let p = DVec3::new(random.uniform(-wide, wide), random.uniform(-wide, wide), random.uniform(-1.0, 4.0));
        let brute = triangles.iter().map(|t| to_triangle(p, *t)).fold(f64::INFINITY, f64::min);
        let found = surface_distance(&world, p).unwrap().unwrap().distance;
        assert!((found - brute).abs() < 1e-3, "{p}: {found} and {brute}");
    }
    assert_eq!(surface_distance(&World::new(Environment::new()), DVec3::ZERO).unwrap(), None);
    assert!(surface_distance(&world, DVec3::NAN).is_err());
}

#[test]
fn objects_are_found_where_their_surfaces_are() {
    let mut environment = scenes::empty();
    environment.add_cuboid("near", at(1.0, 0.0, 0.5), DVec3::splat(0.4)).unwrap();
    environment.add_cuboid("far", at(3.0, 0.3, 0.5), DVec3::splat(0.4)).unwrap();
    environment.add_cuboid("beside", at(2.0, 2.0, 0.5), DVec3::splat(0.4)).unwrap();
    let world = World::new(environment);
    let names =
        |place: &Place| -> Vec<String> { objects_in(&world, place).unwrap().into_iter().map(|o| o.name).collect() };
    let bounds = |min: [f64; 3], max: [f64; 3]| Place::Box(Aabb { min: min.into(), max: max.into() });
    assert_eq!(names(&bounds([0.0, -1.0, 0.0], [2.5, 3.0, 1.0])), ["beside", "near"]);
    assert!(names(&bounds([0.9, -0.1, 0.4], [1.1, 0.1, 0.6])).is_empty(), "inside of it there is no surface");
    assert_eq!(names(&Place::Sphere { center: DVec3::new(3.0, 1.0, 0.5), radius: 0.51 }), ["far"]);
    let corridor = Corridor::new(vec![[0.0, 0.0], [4.0, 0.0]], 0.3, 0.1, 1.0).unwrap();
    let found = objects_in(&world, &Place::Along(corridor.clone(), RobotPose::IDENTITY)).unwrap();
    assert_eq!(found.iter().map(|o| o.name.as_str()).collect::<Vec<_>>(), ["near", "far"]);
    assert!((found[0].along.unwrap() - 0.8).abs() < 0.11 && (found[1].along.unwrap() - 2.8).abs() < 0.11);
    let turned = Pose::from_xyz_rpy(DVec3::new(2.0, 0.0, 0.0), 0.0, 0.0, std::f64::consts::FRAC_PI_2);
    assert_eq!(names(&Place::Along(corridor, RobotPose::new(turned))), ["beside"]);
    let inside_out = objects_in(&world, &bounds([1.0, 0.0, 0.0], [0.0, 1.0, 1.0])).unwrap_err();
    assert!(inside_out.kind() == ErrorKind::Usage && inside_out.to_string().contains("least corner"));
    assert!(objects_in(&world, &Place::Sphere { center: DVec3::ZERO, radius: 0.0 }).is_err());
}

/// scenes/docking.rhai has two stations at (4.6, 1.2) and (4.6, -1.2) that face -x, each with three reflectors.
#[test]
fn the_docks_of_the_charging_bay_are_found() {
    let scene = presight::Scene::open(data::root().join("scenes/docking.rhai")).unwrap();
    let found = docks(&scene.world, 1.0).unwrap();
    let laser: Vec<_> = found.iter().filter(|d| d.class == "laser").collect();
    assert_eq!(laser.iter().map(|d| d.name.as_str()).collect::<Vec<_>>(), ["dock1", "dock2"]);
    for (dock, y) in laser.iter().zip([1.2, -1.2]) {
        let pose = dock.world_from_dock;
        assert!((pose.translation.y - y).abs() < 1e-6 && (pose.translation.x - 4.7).abs() < 0.1, "{pose:?}");
        assert!((pose.rotation * DVec3::X).distance(DVec3::NEG_X) < 1e-6 && dock.reflectors.len() == 3);
    }
    assert!(docks(&scene.world, 0.1).unwrap().is_empty());
    assert!(docks(&scene.world, f64::NAN).is_err());
    let uncertain = uncertain_features(&scene.world, &UncertainOptions::default().with_min_existence(0.95)).unwrap();
    assert_eq!(uncertain.iter().map(|u| u.name.as_deref()).collect::<Vec<_>>(), [Some("chipped edge")]);
    let since = UncertainOptions::default().with_since(Some(1.0));
    assert!(uncertain_features(&scene.world, &since).unwrap().len() > 6, "none was ever confirmed");
    assert!(uncertain_features(&scene.world, &UncertainOptions::default().with_time(Some(f64::NAN))).is_err());
}

/// A floor with random pillars, on which a robot of a radius reaches 4 m from the middle along x and y.
fn pillars(seed: u64, count: usize, radius: f64) -> (World, Vec<DVec2>) {
    let mut environment = scenes::empty();
    let side = 8.02 + 2.0 * radius;
    environment.add_cuboid("floor", at(0.0, 0.0, -0.1), DVec3::new(side, side, 0.2)).unwrap();
    let mut random = Random(seed);
    let mut middles = Vec::new();
    for k in 0..count {
        let p = DVec2::new(random.uniform(-3.0, 3.0), random.uniform(-3.5, 3.5));
        environment.add_cuboid(&format!("pillar{k}"), at(p.x, p.y, 1.0), DVec3::new(0.3, 0.3, 2.0)).unwrap();
        middles.push(p);
    }
    (World::new(environment), middles)
}

/// Dijkstra over 32 directions on a grid of 2.5 cm, with squares and a floor worked out by hand.
fn dijkstra(from: DVec2, to: DVec2, pillars: &[DVec2], radius: f64) -> Option<f64> {
    let step = 0.025;
    let free = |p: DVec2| {
        let clear = |m: &DVec2| ((p - *m).abs() - 0.15).max(DVec2::ZERO).length() >= radius;
        p.abs().max_element() <= 4.0 && pillars.iter().all(clear)
    };
    let place = |at: (i32, i32)| from + step * DVec2::new(f64::from(at.0), f64::from(at.1));
    let goal = (((to.x - from.x) / step).round() as i32, ((to.y - from.y) / step).round() as i32);
    let (mut best, mut open) = (HashMap::from([((0, 0), 0u64)]), BinaryHeap::from([(std::cmp::Reverse(0u64), (0, 0))]));
    let steps: Vec<(i32, i32)> = (-3..=3)
        .flat_map(|x| (-3..=3).map(move |y| (x, y)))
        .filter(|(x, y): &(i32, i32)| (x.abs().max(y.abs()) == 1) || (x * y != 0 && gcd(x.abs(), y.abs()) == 1))
        .collect();
    while let Some((std::cmp::Reverse(cost), at)) = open.pop() {
        if at == goal {
            return Some(cost as f64 * 1e-6);
        }
        if best[&at] < cost {
            continue;
        }
        for (x, y) in &steps {
            let next = (at.0 + x, at.1 + y);
            let (a, b) = (place(at), place(next));
            if ![1.0, 0.5, 0.25, 0.75].iter().all(|t| free(a.lerp(b, *t))) {
                continue;
            }
            let reached = cost + (a.distance(b) * 1e6) as u64;
            if best.get(&next).is_none_or(|known| reached < *known) {
                best.insert(next, reached);
                open.push((std::cmp::Reverse(reached), next));
            }
        }
    }
    None
}

fn gcd(a: i32, b: i32) -> i32 {
    if b == 0 { a } else { gcd(b, a % b) }
}

#[test]
fn ways_agree_with_dijkstra_on_a_fine_grid() {
    let (from, to) = (DVec2::new(-3.7, 0.0), DVec2::new(3.7, 0.3));
    let (mut yes, mut no) = (0, 0);
    for seed in 0..12 {
        let (radius, count) = if seed % 2 == 0 { (0.25, 28) } else { (0.45, 60) };
        let (world, middles) = pillars(seed, count, radius);
        let options = PathOptions::default().with_radius(radius);
        let found = find_path(&world, from.extend(0.0), to.extend(0.0), &[], &options);
        let Some(truth) = dijkstra(from, to, &middles, radius) else {
            no += 1;
            assert!(matches!(found, Ok(FloorPath::Blocked { .. }) | Err(_)), "{seed}: {found:?}");
            continue;
        };
        let FloorPath::Found { length, points } = found.unwrap() else { panic!("{seed}: a way of {truth} m") };
        yes += 1;
        assert!(length <= 1.05 * truth && length > 0.97 * truth, "{seed}: {length} and {truth}");
        for pair in points.windows(2) {
            for t in [0.0, 0.3, 0.6] {
                let p = pair[0].lerp(pair[1], t).truncate();
                let clear = |m: &DVec2| ((p - *m).abs() - 0.15).max(DVec2::ZERO).length() > radius - 0.03;
                assert!(middles.iter().all(clear), "{seed}: {p}");
            }
        }
    }
    assert!(yes >= 4 && no >= 1, "{yes} ways, {no} times none");
}

#[test]
fn ways_that_cannot_be_say_why() {
    let (world, middles) = pillars(0, 28, 0.25);
    let options = PathOptions::default().with_radius(0.25);
    let from = DVec3::new(-3.7, 0.0, 0.0);
    let refused = |a: DVec3, b: DVec3| find_path(&world, a, b, &[], &options).unwrap_err().to_string();
    assert!(refused(from, middles[3].extend(0.0)).contains("pillar"));
    assert!(refused(middles[3].extend(0.0), from).contains("the start"));
    assert!(refused(DVec3::new(50.0, 0.0, 0.0), from).contains("no floor"));
    assert!(refused(DVec3::new(-4.1, 0.0, 0.0), from).contains("the floor ends within 0.25 m"));
    assert!(refused(from, DVec3::NAN).contains("finite"));
    let wrong = options.with_radius(f64::NAN);
    assert!(find_path(&world, from, from, &[], &wrong).is_err());
    // A wall that was seen from side to side.
    let wall = Aabb { min: DVec3::new(-3.2, -5.0, 0.0), max: DVec3::new(-3.1, 5.0, 1.0) };
    let blocked = find_path(&world, from, DVec3::new(3.7, 0.3, 0.0), &[wall], &options).unwrap();
    let FloorPath::Blocked { reached, missing, object } = blocked else { panic!("{blocked:?}") };
    assert!(reached.x < -3.4 && missing > 7.0 && object.is_none());
    let low = Aabb { min: DVec3::new(-3.2, -1.0, 0.0), max: DVec3::new(-3.1, 1.0, 1.0) };
    let around = find_path(&world, from, DVec3::new(3.7, 0.3, 0.0), &[low], &options).unwrap();
    let FloorPath::Found { points, .. } = around else { panic!("{around:?}") };
    assert!(points.iter().any(|p| p.y.abs() > 1.2), "around it");
}

/// A wall that is marked as absent for all sensors counts neither as a surface nor as an obstacle. One that a laser
/// alone misses counts as both.
#[test]
fn absent_objects_are_not_in_the_way() {
    use presight_model::environment::{Mark, MarkKind};
    for (class, is_there) in [(None, false), (Some("laser".to_owned()), true)] {
        let mut environment = Environment::new();
        environment.add_cuboid("floor", at(0.0, 0.0, -0.1), DVec3::new(8.0, 8.0, 0.2)).unwrap();
        environment.add_cuboid("wall", at(0.0, 0.0, 1.0), DVec3::new(0.2, 8.0, 2.0)).unwrap();
        let mark = Mark { object: "wall".to_owned(), kind: MarkKind::Absent, class, bounds: None };
        environment.set_mark("gone", mark).unwrap();
        let world = World::new(environment);
        let (from, to) = (DVec3::new(-2.0, 0.0, 0.0), DVec3::new(2.0, 0.0, 0.0));
        let way = find_path(&world, from, to, &[], &PathOptions::default()).unwrap();
        assert_eq!(matches!(way, FloorPath::Blocked { .. }), is_there);
        let nearest = surface_distance(&world, DVec3::new(0.6, 0.0, 1.0)).unwrap().unwrap();
        // The wall's face is 0.5 m away, the floor 1 m.
        assert!((nearest.distance - if is_there { 0.5 } else { 1.0 }).abs() < 1e-6, "{nearest:?}");
    }
}

/// By hand: a shaft of 1 x 2 m between passages that are 1 m wide. Every point keeps the radius from its edges, and a
/// robot of 0.55 m does not pass. Without the shaft the path is straight.
#[test]
fn edges_of_the_floor_keep_their_distance() {
    let tiles = |holes: bool| {
        let mut environment = Environment::new();
        let mut tile = |name: &str, x: [f64; 2], y: [f64; 2]| {
            let (middle, size) = ([0.5 * (x[0] + x[1]), 0.5 * (y[0] + y[1])], [x[1] - x[0], y[1] - y[0]]);
            let size = DVec3::new(size[0], size[1], 0.1);
            environment.add_cuboid(name, at(middle[0], middle[1], -0.05), size).unwrap();
        };
        tile("west", [0.0, 2.5], [0.0, 4.0]);
        tile("east", [3.5, 6.0], [0.0, 4.0]);
        tile("south", [2.5, 3.5], [0.0, 1.0]);
        tile("north", [2.5, 3.5], [3.0, 4.0]);
        if !holes {
            tile("lid", [2.5, 3.5], [1.0, 3.0]);
        }
        World::new(environment)
    };
    let path = |holes: bool, radius: f64| {
        let (from, to) = (DVec3::new(1.0, 2.1, 0.0), DVec3::new(5.0, 2.1, 0.0));
        find_path(&tiles(holes), from, to, &[], &PathOptions::default().with_radius(radius)).unwrap()
    };
    let FloorPath::Found { points, length } = path(true, 0.3) else { panic!("a path beside the shaft") };
    // The shortest one runs along y = 0.7 and 3.3: around the corners it is longer than 4.4 m.
    assert!(length > 4.4 && length < 5.2 && points.len() < 12, "{length}, {points:?}");
    for pair in points.windows(2) {
        for t in 0..=20 {
            let p = pair[0].lerp(pair[1], f64::from(t) / 20.0);
            let off = DVec2::new((2.5 - p.x).max(p.x - 3.5), (1.0 - p.y).max(p.y - 3.0)).max(DVec2::ZERO);
            assert!(off.length() > 0.298, "{p}");
        }
    }
    let FloorPath::Blocked { object, missing, .. } = path(true, 0.55) else { panic!("no path") };
    assert!(object.is_none() && missing > 3.0);
    let FloorPath::Found { points, length } = path(false, 0.55) else { panic!("a straight path") };
    assert!(points.len() == 2 && (length - 4.0).abs() < 1e-9, "{points:?}");
}

/// By hand: a ramp of 2 m that rises by 0.3 m leads to a landing. Its top is an edge for a robot of no slope.
#[test]
fn ramps_lead_to_the_floor_above() {
    use presight_model::environment::{Mesh, NewObject, Polygon, PolygonOrder};
    let mut environment = Environment::new();
    environment.add_cuboid("low", at(0.0, 0.0, -0.1), DVec3::new(4.0, 2.0, 0.2)).unwrap();
    environment.add_cuboid("high", at(6.0, 0.0, 0.1), DVec3::new(4.0, 2.0, 0.4)).unwrap();
    let corners = [[2.0, -1.0, 0.0], [4.0, -1.0, 0.3], [4.0, 1.0, 0.3], [2.0, 1.0, 0.0]];
    let polygon = Polygon::new(vec![0, 1, 2, 3], 0);
    let ramp = Mesh::new("ramp", corners.map(glam::Vec3::from).to_vec(), vec![polygon], PolygonOrder::Given).unwrap();
    environment.insert(NewObject::new("ramp", Pose::IDENTITY, ramp.into())).unwrap();
    let world = World::new(environment);
    let (from, to) = (DVec3::new(-1.0, 0.0, 0.0), DVec3::new(7.0, 0.0, 0.3));
    let up = find_path(&world, from, to, &[], &PathOptions::default()).unwrap();
    let FloorPath::Found { points, length } = up else { panic!("{up:?}") };
    let truth = 3.0 + 2f64.hypot(0.3) + 3.0;
    assert!((length - truth).abs() < 0.01 && (points.last().unwrap().z - 0.3).abs() < 1e-6, "{length}, {points:?}");
    let level = PathOptions::default().with_slope_deg(5.0);
    assert!(matches!(find_path(&world, from, to, &[], &level).unwrap(), FloorPath::Blocked { .. }));
}

#[test]
fn marks_and_little_trust_are_uncertain() {
    use presight_model::environment::{Existence, Mark, MarkKind};
    use presight_supervise::query::UncertaintyReason;
    let mut environment = scenes::empty();
    for name in ["old", "new", "gone"] {
        environment.add_cuboid(name, at(0.0, 0.0, 0.0), DVec3::ONE).unwrap();
    }
    let trust = |p0: f64, confirmed: f64| Some(Existence { p0, confirmed, rate: 0.0 });
    environment.set_trust("old", trust(0.3, 10.0)).unwrap();
    environment.set_trust("new", trust(0.9, 20.0)).unwrap();
    let mark = Mark { object: "gone".to_owned(), kind: MarkKind::Absent, class: None, bounds: None };
    environment.set_mark("m1", mark).unwrap();
    let world = World::new(environment);
    let found = |options: &UncertainOptions| -> Vec<(String, UncertaintyReason)> {
        uncertain_objects(&world, options).unwrap().into_iter().map(|o| (o.object, o.doubt)).collect()
    };
    let marked = ("gone".to_owned(), UncertaintyReason::Marked(MarkKind::Absent));
    let old = ("old".to_owned(), UncertaintyReason::LowExistence);
    assert_eq!(found(&UncertainOptions::default()), [marked.clone(), old.clone()]);
    let since = UncertainOptions::default().with_since(Some(30.0));
    assert_eq!(found(&since), [marked, ("new".to_owned(), UncertaintyReason::NotConfirmed), old]);
}
