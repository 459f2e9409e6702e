//! The scenes of this repository: each gives the right result on every engine for the fault that it was made to reveal.

use super::common::{compare_or_show, engines, plan, reference, scenes};
use super::load;
use presight_model::geometry::Pose;
use presight_model::sensor::Sensor;
use presight_model::world::World;
use presight_render::plan::{FramePlan, Images};
use presight_render::verify::Precision;
use std::path::Path;

fn world(name: &str) -> World {
    let (outcome, said) = load(Path::new(&format!("scenes/{name}.rhai")));
    assert!(said.is_empty(), "{name} prints {said:?}");
    World::new(outcome.unwrap_or_else(|e| panic!("{e}")).environment)
}

fn sensor(file: &str) -> Sensor {
    presight_read::load_sensor(&format!("scenes/{file}.toml")).unwrap().0
}

/// The images of every engine with its name, each compared with the reference.
fn seen(world: &World, sensor: &Sensor) -> Vec<(&'static str, Images)> {
    let plan = plan(world, sensor, &Pose::IDENTITY);
    let expected = reference(&plan);
    let held = |name: &str, images: &Images, precision| {
        let report = compare_or_show(&expected, images, &plan, precision);
        assert_eq!(report.fault, 0, "{name}: {:#?}", report.faults.first());
    };
    let render = |engine: &mut dyn FnMut(&FramePlan) -> Images| engine(&plan);
    let cpu = render(&mut engines::cpu(1));
    held("cpu", &cpu, Precision::F64);
    let mut all = vec![("reference", expected.clone()), ("cpu", cpu)];
    if let Some(mut gpu) = engines::gpu() {
        let gpu = render(&mut gpu);
        held("gpu", &gpu, Precision::F32);
        all.push(("gpu", gpu));
    }
    all
}

fn ids(images: &Images) -> std::collections::BTreeSet<u32> {
    images.object_id.iter().copied().collect()
}

/// No ray inside the disc passes between two triangles. Each triangle is visible, and the one at the centre belongs to
/// the disc.
#[test]
fn shared_edge() {
    let (world, sensor) = (world("shared_edge"), sensor("small"));
    for (name, images) in seen(&world, &sensor) {
        let mut polygons = std::collections::BTreeSet::new();
        for (i, id) in images.polygon_id.iter().enumerate() {
            let (x, y) = ((i % 161) as f64 - 80.0, (i / 161) as f64 - 60.0);
            // The disc is a decagon of radius 1 at 2 m: 40 pixels, with its sides at least 38 away.
            let apart = x.hypot(y);
            assert!(apart > 38.0 || *id > 0, "{name}: a crack at {x}, {y}");
            assert!(apart < 40.1 || *id == 0, "{name}: {x}, {y}");
            polygons.extend((*id > 0).then_some(*id));
        }
        assert_eq!(polygons.len(), 10, "{name}");
    }
}

#[test]
fn tie() {
    let world = world("tie");
    for sensor in [sensor("small"), scenes::scanner(180, 21), scenes::fan()] {
        for (name, images) in seen(&world, &sensor) {
            assert_eq!(ids(&images), [0, 1].into(), "{name}, {}: the first one wins everywhere", sensor.spec().name);
        }
    }
}

#[test]
fn seam() {
    let (world, sensor) = (world("seam"), sensor("all_round"));
    for (name, images) in seen(&world, &sensor) {
        let level = 90 * 360;
        let hits: Vec<bool> = images.polygon_id[level..level + 360].iter().map(|id| *id > 0).collect();
        // The wall is 2 m wide at 2 m: 26.6 degrees to each side of the seam.
        assert!((0..=26).all(|k| hits[k] && hits[(360 - k) % 360]), "{name}");
        assert!((27..=333).all(|k| !hits[k]), "{name}");
        let [first, last] = [images.range[level], images.range[level + 359]];
        assert_eq!(first, 2.0, "{name}");
        assert!((f64::from(last) - 2.0 / 1f64.to_radians().cos()).abs() < 1e-6, "{name}");
    }
}

#[test]
fn pole() {
    let (world, sensor) = (world("pole"), sensor("all_round"));
    for (name, images) in seen(&world, &sensor) {
        let row = |r: usize| r * 360..(r + 1) * 360;
        assert!(images.object_id[row(0)].iter().all(|id| *id == 1), "{name}: above, at all azimuths");
        assert!(images.object_id[row(180)].iter().all(|id| *id == 2), "{name}: below, at all azimuths");
        assert!(images.range[row(0)].iter().chain(&images.range[row(180)]).all(|r| (r - 1.0).abs() < 1e-6), "{name}");
        assert!(images.object_id[row(90)].iter().all(|id| *id == 0), "{name}: nothing at the horizon");
    }
}

#[test]
fn behind() {
    let (world, sensor) = (world("behind"), sensor("small"));
    for (name, images) in seen(&world, &sensor) {
        assert_eq!(ids(&images), [0, 1].into(), "{name}: the post behind the camera must not be visible");
        let horizon = 60 * 161;
        assert!(images.object_id[..horizon + 161].iter().all(|id| *id == 0), "{name}: above the horizon");
        // The floor's far side is 20 m away, 4 rows below the horizon.
        assert!(images.object_id[horizon + 5 * 161..].iter().all(|id| *id == 1), "{name}: below");
    }
}

#[test]
fn empty() {
    let world = world("empty");
    for sensor in
        [sensor("small"), presight_read::preset("laser-scanner").unwrap(), presight_read::preset("vlp-16").unwrap()]
    {
        for (name, images) in seen(&world, &sensor) {
            assert!(images.range.iter().all(|r| *r == f32::INFINITY), "{name}");
            assert_eq!(ids(&images), [0].into(), "{name}");
            assert!(images.cos_incidence.iter().all(|c| c.is_nan()), "{name}");
        }
    }
}

/// A hall of many objects made of few shared parts.
#[test]
fn the_hall_is_large_and_its_parts_are_shared() {
    let (outcome, _) = load(Path::new("scenes/factory.rhai"));
    let scene = outcome.unwrap();
    let (objects, polygons) = (scene.environment.objects().len(), scene.report.polygons_in_scene);
    assert!(objects >= 300 && polygons >= 50_000, "{objects} objects, {polygons} polygons");
    assert!(scene.report.polygons_stored * 10 < polygons, "{} stored", scene.report.polygons_stored);
    for part in ["line/machine10/", "cell4/robot2/gripper", "docks/dock4/marker", "line/conveyor17", "office/stairs"] {
        assert!(scene.environment.objects().iter().any(|o| o.name.starts_with(part)), "{part}");
    }
}

/// Their features lie on their objects, each class has some, and classes see through the right materials.
#[test]
fn the_halls_features_lie_on_their_objects() {
    for (name, classes) in [("factory", 3), ("docking", 3), ("corridor", 3)] {
        let world = world(name);
        assert_eq!(world.environment().layers().len(), classes, "{name}");
        for layer in world.environment().layers() {
            let placed = presight_features::place(&world, layer).unwrap_or_else(|e| panic!("{name}: {e}"));
            assert!(placed.len() >= 3 && placed.iter().all(|f| !f.slots.is_empty()), "{name}, {}", layer.class);
        }
    }
    let world = world("corridor");
    // Towards the glass door at 22.5 m: a camera and a laser see through it to the end, a radar does not.
    let pose = Pose::from_xyz_rpy(glam::DVec3::new(20.0, 0.4, 1.4), 0.0, 0.0, 0.0);
    let at = |class: &str| {
        let mut spec = scenes::camera(3, 3).spec().clone();
        spec.class = class.to_owned();
        let images = reference(&plan(&world, &Sensor::new(spec).unwrap(), &pose));
        images.range[4]
    };
    assert_eq!([at("video"), at("laser"), at("radar")], [10.0, 10.0, 2.5]);
}

/// Compares the CPU engine with the reference at the most crowded places.
#[test]
fn the_scenes_are_right_on_the_cpu() {
    let mut cpu = engines::cpu(2);
    for (name, at) in [("factory", [1.0, 17.0, 2.0]), ("docking", [0.2, -0.6, 1.5]), ("corridor", [2.0, -0.2, 1.6])] {
        let world = world(name);
        for sensor in [scenes::camera(49, 33), scenes::scanner(60, 13)] {
            let plan = plan(&world, &sensor, &Pose::from_xyz_rpy(at.into(), 0.0, 0.1, -0.05));
            let report = compare_or_show(&reference(&plan), &cpu(&plan), &plan, Precision::F64);
            assert_eq!(report.fault, 0, "{name}: {:#?}", report.faults.first());
        }
    }
}
