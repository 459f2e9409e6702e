//! A mirror in a wall shows an apparent room behind it, an open door a real one.

use super::rooms::{sensor, views_of};
use glam::{DVec3, Vec3};
use presight_explore::{Exploration, ExploreOptions, Known};
use presight_model::environment::{Environment, NewObject};
use presight_model::geometry::Pose;
use presight_testkit::scenes::{empty, mesh};

/// The faces of a room from x = -1 to x = 2 without its wall x = 2, with a chest and a board in it.
fn faces() -> Vec<Vec<Vec3>> {
    let mut faces: Vec<Vec<Vec3>> = [
        [[-1.0, -1.6, -1.0], [2.0, -1.6, -1.0], [2.0, 1.6, -1.0], [-1.0, 1.6, -1.0]],
        [[-1.0, -1.6, -1.0], [-1.0, 1.6, -1.0], [-1.0, 1.6, 1.2], [-1.0, -1.6, 1.2]],
        [[-1.0, -1.6, -1.0], [2.0, -1.6, -1.0], [2.0, -1.6, 1.2], [-1.0, -1.6, 1.2]],
        [[-1.0, 1.6, -1.0], [2.0, 1.6, -1.0], [2.0, 1.6, 1.2], [-1.0, 1.6, 1.2]],
    ]
    .map(|corners| corners.map(Vec3::from).to_vec())
    .to_vec();
    for (low, high) in [([-0.9, 0.5, -1.0], [-0.3, 1.2, -0.3]), ([-1.0, -1.2, -1.0], [-0.6, -0.5, 0.4])] {
        let (a, b) = (Vec3::from(low), Vec3::from(high));
        let at = |x: bool, y: bool, z: bool| {
            Vec3::new(if x { b.x } else { a.x }, if y { b.y } else { a.y }, if z { b.z } else { a.z })
        };
        let (f, t) = (false, true);
        faces.push(vec![at(t, f, f), at(t, t, f), at(t, t, t), at(t, f, t)]);
        faces.push(vec![at(f, f, t), at(t, f, t), at(t, t, t), at(f, t, t)]);
        faces.push(vec![at(f, f, f), at(t, f, f), at(t, f, t), at(f, f, t)]);
        faces.push(vec![at(f, t, f), at(t, t, f), at(t, t, t), at(f, t, t)]);
    }
    faces
}

/// The room with a wall that is open from y = -0.6 to 0.6 and z = -0.8 to 0.8, and these faces behind.
fn with_behind(behind: Vec<Vec<Vec3>>) -> Environment {
    let wall = |[a, b, c, d]: [f32; 4]| [[2.0, a, c], [2.0, a, d], [2.0, b, d], [2.0, b, c]].map(Vec3::from).to_vec();
    let parts =
        [[0.6, 1.6, -1.0, 1.2], [-1.6, -0.6, -1.0, 1.2], [-0.6, 0.6, 0.8, 1.2], [-0.6, 0.6, -1.0, -0.8]].map(wall);
    let faces: Vec<Vec<Vec3>> = faces().into_iter().chain(parts).chain(behind).collect();
    let mut environment = empty();
    environment.insert(NewObject::new("room", Pose::IDENTITY, mesh(&faces).into())).unwrap();
    environment
}

/// Area of the surfaces found more than 20 cm behind the wall, square metres.
fn behind(found: &Exploration) -> f64 {
    let area = |corners: &[DVec3]| {
        let sum: DVec3 =
            (1..corners.len() - 1).map(|k| (corners[k] - corners[0]).cross(corners[k + 1] - corners[0])).sum();
        0.5 * sum.length()
    };
    let objects = found.environment().objects().iter().filter(|o| !o.is_deleted());
    let polygons = objects.flat_map(|o| (0..o.mesh.polygon_count() as u32).map(|k| o.polygon_in_world(k)));
    polygons.filter(|corners| corners.iter().all(|p| p.x > 2.2)).map(|corners| area(&corners)).sum()
}

fn explored(real: &Environment) -> Exploration {
    let looks = (0..32).map(|k| {
        let turn = f64::from(k) / 32.0 * std::f64::consts::TAU;
        Pose::from_xyz_rpy(DVec3::new(0.6 + 0.1 * turn.cos(), 0.1 * turn.sin(), 0.1), 0.0, 0.1, turn)
    });
    let views = views_of(&sensor(), looks.map(|pose| (real.clone(), pose)));
    Exploration::of(&Environment::new(), Known::Explored, &views, &ExploreOptions::default()).unwrap()
}

#[test]
fn a_room_behind_a_mirror_does_not_become_a_room() {
    let images = faces().into_iter().map(|face| face.into_iter().map(|p| Vec3::new(4.0 - p.x, p.y, p.z)).collect());
    let found = explored(&with_behind(images.collect()));
    println!("mirror: {} points, {:.3} m2 behind", found.mirrored, behind(&found));
    assert!(found.mirrored > 1000 && behind(&found) < 0.01, "{} points, {} m2", found.mirrored, behind(&found));
}

/// The next room continues the floor and the side walls, ends after 2 m, and contains another box.
#[test]
fn a_room_behind_a_door_does() {
    let next = [
        [[2.0, -1.6, -1.0], [4.0, -1.6, -1.0], [4.0, 1.6, -1.0], [2.0, 1.6, -1.0]],
        [[4.0, -1.6, -1.0], [4.0, 1.6, -1.0], [4.0, 1.6, 1.2], [4.0, -1.6, 1.2]],
        [[3.0, -0.3, -1.0], [3.0, 0.3, -1.0], [3.0, 0.3, 0.0], [3.0, -0.3, 0.0]],
    ];
    let found = explored(&with_behind(next.map(|corners| corners.map(Vec3::from).to_vec()).to_vec()));
    println!("door: {} points, {:.3} m2 behind", found.mirrored, behind(&found));
    assert!(found.mirrored == 0 && behind(&found) > 1.0, "{} points, {} m2", found.mirrored, behind(&found));
}
