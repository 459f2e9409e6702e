//! Both ways of the CPU engine against each other: they share only the last line of arithmetic, so each is an oracle for the other. Bits
//! are equal in every image. Where they are not, the reference must call the pixel an edge.
//!
//! `PROPTEST_CASES` and `PRESIGHT_SEED` as in `hard_scenes`.

#![allow(clippy::print_stderr)] // Prints what was compared.

use presight_testkit as common;

use common::hard::{Case, case, grazing};
use common::{Random, data, hall, reference};
use glam::{DAffine3, DMat3, DVec3, Vec3};
use presight_model::change::Change;
use presight_model::environment::{
    Appearance, Environment, Mark, MarkKind, Material, Mesh, NewObject, Polygon, PolygonOrder,
};
use presight_model::geometry::{Aabb, Pose, SensorPose};
use presight_model::sensor::Sensor;
use presight_model::world::World;
use presight_predict::predict::{Backend, Options, Predictor};
use presight_predict::request::Request;
use presight_render::cpu::{CpuEngine, Margins, Vectors};
use presight_render::plan::{
    ChosenWay, CountName, FramePlan, IdScheme, ImageRequest, Images, Output, Part, PlanBuffers, StageName, Stats, Way,
};
use presight_render::verify::{PixelValues, Precision, compare_values};
use proptest::prelude::*;
use proptest::test_runner::{RngSeed, TestRunner};
use std::cell::RefCell;
use std::sync::Arc;

/// An engine, and counts of compared rays.
struct Ways {
    engine: CpuEngine,
    rays: usize,
    at_edges: usize,
}

impl Ways {
    fn new(threads: usize, vectors: Vectors) -> Self {
        Self { engine: CpuEngine::new(threads).unwrap().with_vectors(vectors), rays: 0, at_edges: 0 }
    }

    fn draw(&mut self, plan: &FramePlan) -> Images {
        let (mut images, mut stats) = (Images::default(), Stats::default());
        self.engine.render(plan, &mut images, &mut stats).expect("the engine renders");
        assert_eq!((stats.way, &stats.notices), (Some(plan.way()), &vec![]));
        images
    }

    /// Compares both ways, with all outputs.
    fn check(&mut self, world: &World, sensor: &Sensor, pose: &Pose) -> Result<(), TestCaseError> {
        self.check_with(world, sensor, pose, IdScheme::Model)
    }

    fn check_with(&mut self, world: &World, sensor: &Sensor, pose: &Pose, ids: IdScheme) -> Result<(), TestCaseError> {
        let request = ImageRequest { ids, ..common::plan(world, sensor, pose).request };
        let plan = FramePlan::new(world, sensor, pose, request).unwrap();
        let by_tiles =
            FramePlan::by(ChosenWay::TILES, PlanBuffers::default(), world, sensor, pose, plan.request).unwrap();
        assert_eq!((plan.way(), by_tiles.way()), (Way::Raster, Way::Tiles));
        let (raster, tiles) = (self.draw(&plan), self.draw(&by_tiles));
        self.rays += raster.range.len();
        let mut differ: Vec<usize> = Vec::new();
        for output in Output::ALL {
            let (a, b) = (common::bits(&raster, output), common::bits(&tiles, output));
            prop_assert_eq!(a.len(), b.len());
            let each = a.len() / raster.range.len();
            differ.extend((0..a.len()).filter(|i| a[*i] != b[*i]).map(|i| i / each.max(1)));
        }
        differ.sort_unstable();
        differ.dedup();
        if !differ.is_empty() {
            self.judge(&plan, &raster, &tiles, &differ)?;
        }
        Ok(())
    }

    /// Where they differ, the reference has to call it an edge.
    fn judge(
        &mut self,
        plan: &FramePlan,
        raster: &Images,
        tiles: &Images,
        differ: &[usize],
    ) -> Result<(), TestCaseError> {
        let truth = reference(plan);
        for &i in differ {
            let at = (i as u32 % truth.width, i as u32 / truth.width);
            let values = [&truth, raster, tiles].map(|images| PixelValues::of(images, i));
            let reports = [values[1], values[2]]
                .map(|value| compare_values([(at, values[0], value)].into_iter(), plan, Precision::F64));
            let edges: usize = reports.iter().map(|report| report.edge + report.coincident).sum();
            let faults: usize = reports.iter().map(|report| report.fault).sum();
            let why = || {
                format!(
                    "{} {at:?}: {} of {} differ: {values:#?}",
                    plan.sensor.spec().name,
                    differ.len(),
                    truth.range.len()
                )
            };
            prop_assert!(faults == 0 && edges > 0, "{}", why());
        }
        self.at_edges += differ.len();
        Ok(())
    }
}

impl Drop for Ways {
    fn drop(&mut self) {
        eprintln!("{} rays, {} differ at edges", self.rays, self.at_edges);
    }
}

fn check_all(cases: impl Strategy<Value = Case>, count: u64, vectors: Vectors) {
    let ways = RefCell::new(Ways::new(1, vectors));
    let rng_seed = RngSeed::Fixed(common::env_number("PRESIGHT_SEED", 1));
    let cases_to_run = common::env_number("PROPTEST_CASES", count) as u32;
    let config = ProptestConfig {
        cases: cases_to_run,
        rng_seed,
        max_shrink_iters: 3000,
        failure_persistence: None,
        ..ProptestConfig::default()
    };
    let check = |case: Case| {
        let (world, pose, sensors) = case.build();
        sensors.iter().try_for_each(|sensor| ways.borrow_mut().check(&world, sensor, &pose))
    };
    TestRunner::new(config).run(&cases, check).unwrap_or_else(|e| panic!("{e}"));
}

#[test]
fn hard_scenes_have_the_same_bits_both_ways() {
    check_all(case(), 800, Vectors::best());
}

#[test]
fn grazing_scenes_have_the_same_bits_both_ways() {
    check_all(grazing(), 400, Vectors::best());
}

#[test]
fn narrower_vectors_find_the_same() {
    check_all(case(), 60, Vectors::Sse42);
    check_all(case(), 60, Vectors::Plain);
}

#[test]
fn all_presets_in_real_scenes_have_the_same_bits_both_ways() {
    let mut ways = Ways::new(2, Vectors::best());
    for (turn, name) in data::SCENES.into_iter().enumerate() {
        let Some(world) = data::scene(name, true) else { return };
        for (i, pose) in data::poses(&world, 2, 7).iter().enumerate() {
            for sensor in data::presets_at(turn, i, 4) {
                ways.check(&world, &sensor, pose).unwrap();
            }
        }
    }
    let hall = World::new(hall::open_hall(3, 60_000));
    for pose in hall::hall_poses(hall.environment(), 3, 1) {
        for sensor in data::presets() {
            ways.check(&hall, &sensor, &pose).unwrap();
        }
    }
}

/// Sensors of every layout of tiles.
fn each_layout() -> Vec<Sensor> {
    vec![
        common::scenes::camera(65, 41),
        common::scenes::scanner(90, 37),
        common::scenes::scanner(400, 3),
        common::scenes::closed(361, 1),
        common::scenes::all_round(36, 18),
        common::scenes::fisheye(49, 33),
    ]
}

fn place(random: &mut Random) -> Pose {
    let at = DVec3::new(random.uniform(-4.0, 4.0), random.uniform(-3.0, 3.0), random.uniform(0.3, 2.5));
    Pose::from_xyz_rpy(at, random.uniform(-3.0, 3.0), random.uniform(-1.0, 1.0), random.uniform(-3.0, 3.0))
}

/// Random moves, inserts, deletes and undo: trees follow, and a fresh world shows the same.
#[test]
fn trees_follow_changes() {
    let (mut ways, mut random) = (Ways::new(1, Vectors::best()), Random(4));
    let (mut world, mut undo) = (common::scenes::room_world(4, 12), Vec::new());
    for step in 0..60 {
        let names: Vec<String> =
            world.environment().objects().iter().filter(|o| !o.is_deleted()).map(|o| o.name.clone()).collect();
        let name = names[random.below(names.len())].clone();
        let mesh = world.environment().object(&name).unwrap().mesh.clone();
        let change = match random.below(4) {
            0 => Change::InsertObject(NewObject::new("new", place(&mut random), mesh)),
            1 if names.len() > 4 => Change::DeleteObject { name },
            2 if !undo.is_empty() => undo.swap_remove(undo.len() - 1),
            _ => Change::MoveObject { name, world_from_object: place(&mut random) },
        };
        // An older inverse may name an object that is gone.
        if let Ok(inverse) = world.apply_unchecked(change) {
            undo.push(inverse);
        }
        let (pose, fresh) = (place(&mut random), World::new((**world.environment()).clone()));
        let sensor = &each_layout()[step % 6];
        ways.check(&world, sensor, &pose).unwrap();
        let request = common::plan(&world, sensor, &pose).request;
        let [own, new] = [&world, &fresh].map(|world| {
            let plan = FramePlan::by(ChosenWay::TILES, PlanBuffers::default(), world, sensor, &pose, request).unwrap();
            ways.draw(&plan)
        });
        for output in Output::ALL {
            assert_eq!(common::bits(&own, output), common::bits(&new, output), "step {step}");
        }
    }
    assert_eq!(ways.at_edges, 0);
}

/// A soup of polygons of four materials in a mirrored and in a plain object: two-sided, one-sided, and either unseen by lasers.
fn soup(random: &mut Random) -> World {
    let mut environment = Environment::new();
    for (one_sided, seen) in [(false, true), (true, true), (false, false), (true, false)] {
        let appearance = if seen { Appearance::Opaque } else { Appearance::Transparent };
        let appearance = [("laser".to_owned(), appearance)].into();
        environment.add_material(Material { one_sided, appearance, ..Material::named("m") }).unwrap();
    }
    let (mut vertices, mut polygons) = (Vec::new(), Vec::new());
    for i in 0..240u32 {
        let at = DVec3::new(random.uniform(-4.0, 4.0), random.uniform(-4.0, 4.0), random.uniform(-2.0, 2.0));
        let normal = DVec3::new(random.normal(1.0), random.normal(1.0), random.normal(1.0)).normalize();
        let ((u, v), corners) = (normal.any_orthonormal_pair(), 3 + i % 5);
        let first = vertices.len() as u32;
        for k in 0..corners {
            let (sin, cos) = (f64::from(k) / f64::from(corners) * std::f64::consts::TAU).sin_cos();
            vertices.push((at + (u * cos + v * sin) * random.uniform(0.8, 0.9)).as_vec3());
        }
        polygons.push(Polygon { corners: (first..first + corners).collect(), material: (i % 4) as u16, source: i / 2 });
    }
    // Corners of an uneven polygon are not all of its hull: keep what the mesh takes.
    let sound = |p: &Polygon| Mesh::new("one", vertices.clone(), vec![p.clone()], PolygonOrder::Given).is_ok();
    let polygons = polygons.into_iter().filter(sound).collect();
    let mesh = Arc::new(Mesh::new("soup", vertices, polygons, PolygonOrder::Spatial).unwrap());
    let mirrored = DAffine3::from_mat3(DMat3::from_diagonal(DVec3::new(-0.7, 1.1, 0.9)));
    environment.insert(NewObject::new("plain", Pose::IDENTITY, mesh.clone())).unwrap();
    environment.insert(NewObject::from_affine("mirrored", mirrored, mesh).unwrap()).unwrap();
    let mut world = World::new(environment);
    let bounds = Some(Aabb { min: DVec3::ZERO, max: DVec3::splat(3.0) });
    let mark = Mark { object: "plain".into(), kind: MarkKind::Absent, class: Some("laser".into()), bounds };
    world.apply(Change::SetMark { name: "gone".into(), mark }).unwrap();
    world
}

#[test]
fn materials_mirrors_marks_and_ids_have_the_same_bits_both_ways() {
    let (mut ways, mut random) = (Ways::new(2, Vectors::best()), Random(9));
    for _ in 0..4 {
        let world = soup(&mut random);
        for sensor in each_layout() {
            for ids in [IdScheme::Model, IdScheme::Source] {
                ways.check_with(&world, &sensor, &place(&mut random), ids).unwrap();
            }
        }
    }
    assert_eq!(ways.at_edges, 0);
}

/// Faces that coincide, slivers, a floor under many small ones, round faces of 64 corners, and nothing at all.
#[test]
fn hard_meshes_have_the_same_bits_both_ways() {
    let mut random = Random(11);
    let corner = |random: &mut Random, size: f64| {
        let p = DVec3::new(random.uniform(-size, size), random.uniform(-size, size), random.uniform(-size, size));
        p.as_vec3()
    };
    let triangle = [Vec3::new(3.0, -2.0, -1.0), Vec3::new(3.0, 2.0, -1.0), Vec3::new(3.0, 0.0, 2.0)].to_vec();
    let coincident = vec![triangle; 2000];
    let mut slivers: Vec<Vec<Vec3>> = Vec::new();
    for _ in 0..2000 {
        let (a, along) = (corner(&mut random, 3.0), corner(&mut random, 2.0));
        let one = vec![a, a + along, a + along * 0.5 + corner(&mut random, 1e-5)];
        slivers.extend(common::scenes::try_mesh(std::slice::from_ref(&one)).map(|_| one));
    }
    let floor =
        [[-50.0, -50.0], [50.0, -50.0], [50.0, 50.0], [-50.0, 50.0]].map(|[x, y]| Vec3::new(x, y, -0.5)).to_vec();
    let small = (0..3000).map(|_| {
        let a = corner(&mut random, 4.0);
        vec![a, a + Vec3::new(0.02, 0.0, 0.0), a + Vec3::new(0.0, 0.02, 0.0)]
    });
    let floor = small.chain([floor]).collect();
    let round = |x: f32| {
        let at = |k: u32| (std::f32::consts::TAU * k as f32 / 64.0).sin_cos();
        (0..64).map(|k| Vec3::new(x, at(k).0 * x, at(k).1 * x)).collect::<Vec<_>>()
    };
    let rounds = (1..20).map(|x| round(0.5 * x as f32)).collect();
    let mut ways = Ways::new(1, Vectors::best());
    for polygons in [coincident, slivers, floor, rounds, Vec::new()] {
        let mut environment = common::scenes::empty();
        let mesh = common::scenes::mesh(&polygons);
        environment.insert(NewObject::new("mesh", Pose::IDENTITY, Arc::new(mesh))).unwrap();
        let world = World::new(environment);
        for sensor in [common::scenes::closed(91, 1), common::scenes::camera(33, 17), common::scenes::all_round(24, 9)]
        {
            ways.check(&world, &sensor, &Pose::from_xyz_rpy(DVec3::new(0.1, 0.2, 0.3), 0.0, 0.1, 0.2)).unwrap();
        }
    }
}

/// What lies on each ray of a camera and a scanner.
#[derive(Clone, Copy)]
enum On {
    /// The side that two triangles share.
    Sides,
    /// A speck as small as a few units in the last place of its corners.
    Specks,
    /// The same, and one far away, so that the tree's boxes are rounded more coarsely than the specks.
    SpecksOfALargeTree,
}

fn on_each_ray(on: On) -> Vec<(World, Sensor, Pose)> {
    let mut random = Random(21);
    let mut cases = Vec::new();
    for sensor in [common::scenes::camera(160, 120), common::scenes::scanner(240, 80)] {
        let pose = Pose::from_xyz_rpy(DVec3::new(31.0, -22.0, 4.5), 0.2, -0.1, 0.7);
        let rotation = pose.rotation_matrix() * sensor.body_from_image();
        let mut polygons = Vec::new();
        for (x, y) in (0..sensor.height()).flat_map(|y| (0..sensor.width()).map(move |x| (x, y))) {
            let Some(ray) = sensor.ray(x, y) else { continue };
            let ray = rotation * ray.normalize();
            let (at, (u, v)) = (pose.translation + ray * random.uniform(100.0, 250.0), ray.any_orthonormal_pair());
            let (first, size) = (random.uniform(0.0, 2.0), random.uniform(1e-5, 5e-5));
            let corner =
                |turn: f64, size: f64| (at + (u * (first + turn).cos() + v * (first + turn).sin()) * size).as_vec3();
            if let On::Sides = on {
                let [a, b, c, d] = [0.0, 0.5, 1.0, 1.5].map(|turns| corner(turns * std::f64::consts::PI, 0.3));
                polygons.extend([vec![a, b, c], vec![a, c, d]]);
            } else {
                let speck = [0.0, 2.1, 4.2].map(|turn| corner(turn, size)).to_vec();
                polygons.extend(common::scenes::try_mesh(std::slice::from_ref(&speck)).map(|_| speck));
            }
        }
        if let On::SpecksOfALargeTree = on {
            let far = Vec3::new(9e3, 8e3, 7e3);
            polygons.push(vec![far, far + Vec3::X, far + Vec3::Y]);
        }
        let mut environment = common::scenes::empty();
        let mesh = Arc::new(common::scenes::mesh(&polygons));
        environment.insert(NewObject::new("mesh", Pose::IDENTITY, mesh)).unwrap();
        cases.push((World::new(environment), sensor, pose));
    }
    cases
}

/// Without the margin of edges, or with the two others turned inward, rays miss what lies on them; with the derived ones none does.
/// At 0 the two others miss nothing here, for boxes are rounded outward, and specks are larger than the rounding of their corners.
#[test]
fn a_margin_of_0_is_found() {
    let missed = |on: On, margins: Margins| -> usize {
        let mut engine = CpuEngine::new(1).unwrap().with_margins(margins);
        let mut missed = 0;
        for (world, sensor, pose) in on_each_ray(on) {
            let request = common::plan(&world, &sensor, &pose).request;
            let [raster, tiles] = [ChosenWay::RASTER, ChosenWay::TILES].map(|way| {
                let plan = FramePlan::by(way, PlanBuffers::default(), &world, &sensor, &pose, request).unwrap();
                let mut images = Images::default();
                engine.render(&plan, &mut images, &mut Stats::default()).unwrap();
                images
            });
            let hits = raster.range.iter().filter(|range| range.is_finite()).count();
            assert!(4 * hits > raster.range.len(), "{hits} of {} rays hit", raster.range.len());
            missed += raster.range.iter().zip(&tiles.range).filter(|(a, b)| a.to_bits() != b.to_bits()).count();
        }
        missed
    };
    let cases = [
        (On::Sides, Margins { edges: 0.0, ..Margins::SOUND }),
        (On::SpecksOfALargeTree, Margins { boxes: -1.0, ..Margins::SOUND }),
        (On::Specks, Margins { places: -1.0, ..Margins::SOUND }),
    ];
    let found = cases.map(|(on, margins)| {
        assert_eq!(missed(on, Margins::SOUND), 0);
        missed(on, margins)
    });
    eprintln!("{found:?} rays differ: edges without a margin, boxes and places with an inward one");
    assert!(found.iter().all(|missed| *missed > 0), "{found:?}");
}

/// A million faces at one place, copies and others, a million small ones under a huge one, and slivers: as exact as the raster, with
/// bounded memory.
#[test]
fn a_million_faces_at_one_place_have_the_same_bits_both_ways() {
    let triangle = [Vec3::new(3.0, -2.0, -1.0), Vec3::new(3.0, 2.0, -1.0), Vec3::new(3.0, 0.0, 2.0)];
    let copies = vec![triangle.to_vec(); 1_000_000];
    // One unit in the last place apart: no two have the same bits, and all are within the margin of each other.
    let apart = |i: u32| {
        let mut corners = triangle.to_vec();
        corners.iter_mut().for_each(|p| p.y += (i % 250) as f32 * 1e-7);
        corners[2].z += (i / 250) as f32 * 2.5e-7;
        corners
    };
    let close = (0..50_000).map(apart).collect();
    let mut random = Random(3);
    let small = (0..1_000_000).map(|_| {
        let a = Vec3::new(
            random.uniform(0.5, 6.0) as f32,
            random.uniform(-4.0, 4.0) as f32,
            random.uniform(-0.4, 2.0) as f32,
        );
        vec![a, a + Vec3::new(0.0, 0.02, 0.0), a + Vec3::new(0.0, 0.0, 0.02)]
    });
    let huge = [[-1e4, -1e4], [1e4, -1e4], [1e4, 1e4], [-1e4, 1e4]].map(|[x, y]| Vec3::new(x, y, -0.5)).to_vec();
    let under = small.chain([huge]).collect();
    let mut ways = Ways::new(1, Vectors::best());
    for polygons in [copies, close, under] {
        let mut environment = common::scenes::empty();
        environment.insert(NewObject::new("m", Pose::IDENTITY, Arc::new(common::scenes::mesh(&polygons)))).unwrap();
        let world = World::new(environment);
        for sensor in [common::scenes::camera(17, 9), common::scenes::closed(24, 1)] {
            let start = std::time::Instant::now();
            ways.check(&world, &sensor, &Pose::from_xyz_rpy(DVec3::new(0.1, 0.2, 0.3), 0.0, 0.02, 0.05)).unwrap();
            eprintln!("{} polygons, {}: {:?}", polygons.len(), sensor.spec().name, start.elapsed());
        }
    }
}

/// A change while trees are made: each version is exact, by whatever trees there are.
#[test]
fn changes_while_trees_are_made_are_exact() {
    let (mut ways, mut random) = (Ways::new(1, Vectors::best()), Random(6));
    let mut world = World::new(hall::open_hall(5, 60_000));
    let lean = Pose::from_xyz_rpy(DVec3::ZERO, 0.05, 0.0, 0.0);
    let pose = hall::hall_poses(world.environment(), 3, 1)[0] * lean;
    std::thread::scope(|scope| {
        let other = world.clone();
        let objects = other.environment().objects().len() as u32;
        let making = scope.spawn(move || other.make_ray_trees(0..objects).unwrap());
        while !making.is_finished() {
            let objects = world.environment().objects();
            let name = objects[random.below(objects.len())].name.clone();
            let mesh = objects[0].mesh.clone();
            _ = world.apply_unchecked(Change::MoveObject { name, world_from_object: place(&mut random) });
            _ = world.apply_unchecked(Change::InsertObject(NewObject::new("new", place(&mut random), mesh)));
            ways.check(&world, &common::scenes::closed(61, 1), &pose).unwrap();
        }
    });
    ways.check(&world, &common::scenes::camera(65, 41), &pose).unwrap();
    assert_eq!(ways.at_edges, 0);
}

/// Opening a model makes no tree, and neither does an image by the raster.
#[test]
fn who_does_not_need_trees_does_not_pay_for_them() {
    let Some(path) = data::file("env/warehouse_small.glb") else { return };
    let imported = presight_read::gltf::import(path, &presight_read::gltf::ImportOptions::default()).unwrap();
    let world = World::new(imported.environment);
    let trees = || world.environment().objects().iter().filter(|o| o.mesh.known_ray_tree().is_some()).count();
    assert_eq!(trees(), 0);
    let mut predictor = Predictor::new(Options::new(Backend::Cpu).with_threads(1).with_way(Way::Counts)).unwrap();
    let pose = data::poses(&world, 1, 3)[0] * Pose::from_xyz_rpy(DVec3::ZERO, 0.05, 0.0, 0.0);
    let mut see = |name: &str| {
        let sensor = presight_read::preset(name).unwrap();
        predictor.predict(&world, &sensor, &SensorPose::new(pose), &Request::default()).unwrap().stats.way
    };
    (0..20).for_each(|_| assert_eq!(see("video-camera"), Some(Way::Raster)));
    assert_eq!(trees(), 0);
    assert!((0..500).any(|_| see("laser-scanner") == Some(Way::Tiles)) && trees() > 0);
}

/// A wide image of a crowded hall turns to tiles after its first wave, once the trees have paid; that of a room does not.
#[test]
fn images_turn_to_tiles_where_many_polygons_are_left() {
    let hall = World::new(hall::open_hall(3, 300_000));
    let pose = hall::hall_poses(hall.environment(), 3, 1)[0];
    let sensor = presight_read::preset("vlp-16").unwrap();
    let mut predictor = Predictor::new(Options::new(Backend::Cpu).with_threads(1).with_way(Way::Counts)).unwrap();
    let mut seen = Vec::new();
    for _ in 0..60 {
        let drawn = predictor.predict(&hall, &sensor, &SensorPose::new(pose), &Request::default()).unwrap();
        let left = drawn.stats.count_of(CountName::PolygonsLeft).expect("they were counted");
        let most = Way::Counts.choose(&hall, &sensor).max_left;
        assert!(left > most, "{left} {most}");
        let why = drawn.stats.taken.iter().find(|row| row.what == StageName::RaysByTiles).map(|row| row.why);
        seen.push((drawn.stats.way, why, common::bits(&drawn.images, Output::Range)));
    }
    let (first, last) = (&seen[0], &seen[59]);
    assert_eq!((first.0, first.1), (Some(Way::Raster), None), "trees are not made for one frame");
    assert_eq!((last.0, last.1), (Some(Way::Tiles), Some("too many polygons may show after the first wave")));
    assert!(seen.iter().all(|frame| frame.2 == first.2));
    let room = common::scenes::room_world(4, 400);
    let stats = predictor.predict(&room, &sensor, &SensorPose::IDENTITY, &Request::default()).unwrap().stats;
    assert_eq!(stats.way, Some(Way::Raster));
}

/// Few rays go by tiles once the trees have paid, images by the raster.
#[test]
fn the_way_is_chosen_by_counts() {
    let world = World::new(hall::open_hall(3, 20_000));
    // Leaning: level scanners are soon searched in the world's cut.
    let lean = Pose::from_xyz_rpy(DVec3::ZERO, 0.05, 0.0, 0.0);
    let pose = hall::hall_poses(world.environment(), 3, 1)[0] * lean;
    let [laser, camera] = ["laser-scanner", "video-camera"].map(|name| presight_read::preset(name).unwrap());
    let predictor = |way| Predictor::new(Options::new(Backend::Cpu).with_threads(1).with_way(way)).unwrap();
    let (mut auto, mut ways) = (predictor(Way::Auto), Vec::new());
    let way_of = |auto: &mut Predictor, sensor: &Sensor, request: &Request| {
        let stats = auto.predict(&world, sensor, &SensorPose::new(pose), request).unwrap().stats;
        (stats.way, stats.left_out.iter().any(|row| row.what == Part::Stage(StageName::RaysByTiles)))
    };
    let (raster, tiles) = ((Some(Way::Raster), true), (Some(Way::Tiles), false));
    for _ in 0..200 {
        ways.push(way_of(&mut auto, &laser, &Request::default()));
    }
    let first = ways.iter().position(|way| *way == tiles).expect("trees are made in time");
    assert!(ways[..first].iter().all(|way| *way == raster) && ways[first..].iter().all(|way| *way == tiles));
    assert_eq!(way_of(&mut auto, &camera, &Request::default()), raster);
    assert_eq!(way_of(&mut predictor(Way::Tiles), &camera, &Request::default()), tiles);
    assert_eq!(way_of(&mut predictor(Way::Raster), &laser, &Request::default()), raster);
    // Trees are kept with their meshes: another predictor finds them.
    assert_eq!(way_of(&mut predictor(Way::Auto), &laser, &Request::default()), tiles);
    let fresh = World::new(hall::open_hall(4, 20_000));
    let mut ready = predictor(Way::Auto);
    ready.make_trees(&fresh).unwrap();
    assert_eq!(
        ready.predict(&fresh, &laser, &SensorPose::new(pose), &Request::default()).unwrap().stats.way,
        Some(Way::Tiles)
    );
}
