//! Rows of level scanners by a cut of the world have the bits of other predictions.
//!
//! `PRESIGHT_ROW_RAYS` is the number of rays that are compared, about; `PRESIGHT_SEED` the seed.

#![allow(clippy::print_stderr, reason = "prints counts")]

use super::{common, predictor};
use common::oracle::Oracle;
use common::{Random, bits, data, env_number, hard, scenes};
use glam::{DVec2, DVec3, Vec3};
use presight_model::environment::{Appearance, Environment, Mark, MarkKind, Material, NewObject};
use presight_model::geometry::{Aabb, Pose, SensorPose};
use presight_model::sensor::{Angles, Geometry, Scanner, Sensor, SensorSpec};
use presight_model::world::World;
use presight_predict::batch::BatchRequest;
use presight_predict::request::Request;
use presight_render::cpu::{CpuEngine, Vectors};
use presight_render::plan::{FramePlan, IdScheme, ImageRequest, Images, Output, Outputs, PlanBuffers, Stats};
use presight_render::row::{Making, RowCut, RowCuts};
use proptest::prelude::*;
use proptest::strategy::ValueTree;
use proptest::test_runner::{Config, RngSeed, TestRunner};
use std::sync::Arc;

fn scanner(azimuth: Angles, limits: (f64, f64)) -> Sensor {
    let elevation = Angles::Uniform { start_deg: 0.0, step_deg: 0.0, count: 1 };
    let geometry = Geometry::Scanner(Scanner { azimuth, elevation, beam_height_deg: None });
    let spec = SensorSpec::new("row", "laser", geometry);
    Sensor::new(spec.with_limits(limits.0, limits.1)).unwrap()
}

fn scanners() -> Vec<Sensor> {
    let uniform = |start_deg, step_deg, count| Angles::Uniform { start_deg, step_deg, count };
    vec![
        scanner(uniform(-90.0, 0.5, 361), (0.0, 30.0)),
        scanner(uniform(170.0, -0.37, 900), (0.5, 8.0)),
        scanner(uniform(0.0, 0.1, 3600), (0.0, 2.5)),
        scanner(uniform(13.0, 360.0 / 17.0, 17), (0.0, 100.0)),
        scanner(Angles::Listed(vec![-170.0, -3.0, 0.0, 0.01, 90.0, 179.0]), (1.0, f64::INFINITY)),
        scanner(uniform(45.0, 0.0, 1), (0.0, 30.0)),
        scanner(uniform(-180.0, 0.5, 721), (0.0, 30.0)),
        scanner(uniform(30.0, -360.0 / 7.0, 8), (0.0, 30.0)),
        // Exactly along the axes and diagonals, with others between.
        scanner(uniform(-180.0, 5.625, 64), (0.0, f64::INFINITY)),
    ]
}

/// Both ways to the images of a level scanner, side by side.
struct Both {
    engine: CpuEngine,
    /// One for each width of vectors, in turns.
    by_cut: [CpuEngine; 3],
    frames: usize,
    images: [Images; 2],
    rays: usize,
    differ: usize,
    /// Rays for which the engine had to decide.
    decided: usize,
}

impl Both {
    fn new() -> Self {
        let engine = || CpuEngine::new(1).expect("a thread");
        let by_cut = [Vectors::best(), Vectors::Sse42, Vectors::Plain].map(|vectors| engine().with_vectors(vectors));
        Self {
            engine: engine(),
            by_cut,
            frames: 0,
            images: [Images::default(), Images::default()],
            rays: 0,
            differ: 0,
            decided: 0,
        }
    }

    /// Counts the rays that differ in a bit of any image.
    fn compare(&mut self, world: &World, cut: &Arc<RowCut>, sensor: &Sensor, pose: &Pose) -> usize {
        if !cut.serves(pose.translation.truncate()) {
            return 0;
        }
        let request = ImageRequest { outputs: Outputs::ALL, ids: IdScheme::Model };
        let plan = FramePlan::new(world, sensor, pose, request).expect("a sound pose");
        let by_cut = FramePlan::by_cut(PlanBuffers::default(), world, sensor, pose, request, cut.clone());
        let mut stats = Stats::default();
        self.engine.render(&plan, &mut self.images[0], &mut stats).expect("it renders");
        self.frames += 1;
        self.by_cut[self.frames % 3].render(&by_cut, &mut self.images[1], &mut stats).expect("it renders");
        assert_eq!(stats.engine, "row");
        let all = self.images.each_ref().map(|images| Output::ALL.map(|output| bits(images, output)));
        let rays = sensor.width() as usize;
        let per_ray = |i: usize, of: &Vec<u32>| of[i * of.len() / rays..(i + 1) * of.len() / rays].to_vec();
        let same = |i: usize| all[0].iter().zip(&all[1]).all(|(a, b)| per_ray(i, a) == per_ray(i, b));
        let whole = all[0] == all[1];
        let differ = if whole { 0 } else { (0..rays).filter(|i| !same(*i)).count() };
        assert!(whole || differ > 0, "images of different sizes");
        self.decided += stats.count_of(presight_render::plan::CountName::BeamsDecided).unwrap_or(0) as usize;
        (self.rays, self.differ) = (self.rays + rays, self.differ + differ);
        if differ > 0 {
            let first = (0..rays).find(|i| !same(*i)).expect("one that differs");
            let shown = self.images.each_ref().map(|images| (images.range[first], images.polygon_id[first]));
            eprintln!("{} at {pose:?}: {differ} differ, first ray {first}: {shown:?}", sensor.spec().name);
        }
        differ
    }

    fn check(&self, least: usize) {
        eprintln!("{} rays, {} decided by the engine, {} differ", self.rays, self.decided, self.differ);
        assert_eq!(self.differ, 0);
        assert!(self.rays >= least, "only {} rays", self.rays);
    }
}

fn cut(world: &World, height: f64) -> Arc<RowCut> {
    Arc::new(RowCut::new(world, "laser", height))
}

/// A third of the rays that are to be compared in all.
fn rays() -> usize {
    env_number("PRESIGHT_ROW_RAYS", 1_000_000) as usize / 3
}

#[test]
fn rows_in_generated_rooms_have_the_same_bits() {
    let (mut random, mut both) = (Random(env_number("PRESIGHT_SEED", 21)), Both::new());
    for seed in 0.. {
        let world = World::new(scenes::room(seed, 10 + 8 * (seed % 12) as usize));
        for _ in 0..4 {
            // Exactly at corners and edges, too.
            let z = [random.uniform(0.1, 2.9), 0.0, 1.0, 3.0][random.below(4)];
            let cut = cut(&world, z);
            for sensor in scanners() {
                let (x, y) = (random.uniform(-2.8, 2.8), random.uniform(-2.8, 2.8));
                let turn = if random.below(3) == 0 { 0.0 } else { random.uniform(-4.0, 4.0) };
                both.compare(&world, &cut, &sensor, &Pose::from_xyz_rpy(DVec3::new(x, y, z), 0.0, 0.0, turn));
            }
        }
        if both.rays >= rays() {
            break;
        }
    }
    both.check(rays());
}

#[test]
fn rows_in_real_scenes_have_the_same_bits() {
    let (mut random, mut both) = (Random(env_number("PRESIGHT_SEED", 21)), Both::new());
    for name in data::SCENES {
        let Some(world) = data::scene(name, true) else { return };
        let bounds = world.environment().bounds();
        let (before, share) = (both.rays, rays() / data::SCENES.len());
        while both.rays < before + share {
            let height = bounds.min.z + (bounds.max.z - bounds.min.z).min(4.0) * random.unit();
            let cut = cut(&world, height);
            // Anywhere, within objects, too.
            for k in 0..12 {
                let part = DVec2::new(random.unit(), random.unit());
                let at = bounds.min.truncate() + (bounds.max - bounds.min).truncate() * part;
                let pose = Pose::from_xyz_rpy(at.extend(height), 0.0, 0.0, random.uniform(-4.0, 4.0));
                both.compare(&world, &cut, &scanners()[k % 4], &pose);
            }
        }
    }
    both.check(rays());
}

/// Scenes of 1 mm to 10 km, far from the origin, with slivers, polygons that touch the sensor or are edge-on to it.
#[test]
fn rows_in_hard_scenes_have_the_same_bits() {
    let seed = RngSeed::Fixed(env_number("PRESIGHT_SEED", 21));
    let mut runner = TestRunner::new(Config { rng_seed: seed, failure_persistence: None, ..Config::default() });
    let mut both = Both::new();
    let (all, cases) = (scanners(), [hard::case().boxed(), hard::grazing().boxed()]);
    for k in 0.. {
        let mut case = cases[k % 2].new_tree(&mut runner).expect("a case").current();
        case.turn = [0.0, 0.0, case.turn[2]];
        let (world, pose, _) = case.build();
        let cut = cut(&world, pose.translation.z);
        for sensor in [&all[k % all.len()], &all[4], &all[8]] {
            let limits = case.limits.unwrap_or((0.0, f64::INFINITY));
            let spec = sensor.spec().clone().with_limits(limits.0 * case.unit, limits.1 * case.unit);
            let differ = both.compare(&world, &cut, &Sensor::new(spec).expect("a sound sensor"), &pose);
            assert_eq!(differ, 0, "{case:?}");
        }
        if both.rays >= rays() {
            break;
        }
    }
    both.check(rays());
}

/// A regular prism around the origin whose vertical edges lie exactly on beams, every face of it `copies` times.
fn prism(sides: usize, copies: usize, radius: f32) -> World {
    let corner = |k: usize, z: f32| {
        // Exact on the axes and the diagonals.
        let unit =
            [(1.0, 0.0), (1.0, 1.0), (0.0, 1.0), (-1.0, 1.0), (-1.0, 0.0), (-1.0, -1.0), (0.0, -1.0), (1.0, -1.0)];
        let (x, y): (f32, f32) = unit[k * (8 / sides) % 8];
        Vec3::new(radius * x, radius * y, z)
    };
    let face = |k: usize| vec![corner(k, -1.0), corner(k + 1, -1.0), corner(k + 1, 2.0), corner(k, 2.0)];
    let faces: Vec<Vec<Vec3>> = (0..sides * copies).map(|k| face(k % sides)).collect();
    let mut environment = scenes::empty();
    environment.insert(NewObject::new("prism", Pose::IDENTITY, scenes::mesh(&faces).into())).expect("an object");
    World::new(environment)
}

/// Far from the origin rounding moves corners across beams, which only the margins notice.
#[test]
fn missing_margins_are_found() {
    let (mut right, mut both) = (Both::new(), Both::new());
    let mesh = prism(8, 1, 3.0).environment().objects()[0].mesh.clone();
    let mut random = Random(7);
    for sensor in scanners().iter().cycle().take(200) {
        let turn = random.uniform(-4.0, 4.0);
        let at = DVec3::new(random.uniform(-1e6, 1e6), random.uniform(-1e6, 1e6), 0.0);
        let mut environment = scenes::empty();
        environment
            .insert(NewObject::new("prism", Pose::from_xyz_rpy(at, 0.0, 0.0, turn), mesh.clone()))
            .expect("an object");
        let world = World::new(environment);
        let pose = Pose::from_xyz_rpy(at, 0.0, 0.0, turn);
        right.compare(&world, &cut(&world, 0.0), sensor, &pose);
        both.compare(&world, &Arc::new(RowCut::new(&world, "laser", 0.0).without_margins()), sensor, &pose);
    }
    right.check(1000);
    assert!(both.differ > 0, "no ray of {} differs without margins", both.rays);
}

#[test]
fn corners_on_beams_walls_at_the_sensor_and_coincident_faces_have_the_same_bits() {
    let mut both = Both::new();
    for (sides, copies, radius) in [(4, 1, 1.0), (8, 1, 3.0), (8, 3, 0.7), (4, 2, 100.0)] {
        let world = prism(sides, copies, radius);
        // At corners' heights, and near them.
        for z in [0.0, -1.0, 2.0, 2.0 - 1e-15, 2.0 + 1e-12, -1.0 + 1e-9, 0.3] {
            let cut = cut(&world, z);
            let near = f64::from(radius) - 1e-9;
            for at in [
                DVec2::ZERO,
                DVec2::new(0.25, 0.0),
                DVec2::new(near, 0.0),
                DVec2::new(0.5, 0.5) * near,
                DVec2::X * 2.0 * near,
                DVec2::new(0.0, -3.0 * near),
            ] {
                for turn in [0.0, std::f64::consts::FRAC_PI_2, 1e-12, 0.7] {
                    for sensor in scanners() {
                        both.compare(&world, &cut, &sensor, &Pose::from_xyz_rpy(at.extend(z), 0.0, 0.0, turn));
                    }
                }
            }
        }
    }
    both.check(500_000);
    assert!(both.decided > 1000, "only {} were left to the engine", both.decided);
}

#[test]
fn rows_agree_with_an_independent_ray_caster() {
    let (mut random, mut images, mut engine) = (Random(5), Images::default(), CpuEngine::new(1).expect("a thread"));
    let (mut seen, mut other) = (0, 0);
    for seed in 0..20 {
        let world = World::new(scenes::room(seed, 30));
        let at = DVec3::new(random.uniform(-2.0, 2.0), random.uniform(-2.0, 2.0), random.uniform(0.2, 2.8));
        let pose = Pose::from_xyz_rpy(at, 0.0, 0.0, random.uniform(-3.0, 3.0));
        let sensor = scanner(Angles::Uniform { start_deg: -180.0, step_deg: 0.5, count: 720 }, (0.0, 30.0));
        let oracle = Oracle::new(world.environment(), at).expect("triangles");
        let outputs = Outputs::of(&[Output::Range, Output::CosIncidence]).into();
        let plan = FramePlan::by_cut(PlanBuffers::default(), &world, &sensor, &pose, outputs, cut(&world, at.z));
        engine.render(&plan, &mut images, &mut Stats::default()).expect("it renders");
        for i in 0..sensor.width() {
            let truth = oracle.hit(at, pose.rotation * sensor.ray(i, 0).expect("a ray"));
            let shown = (images.range[i as usize], images.cos_incidence[i as usize]);
            let (range, cos) = truth.map_or((f64::INFINITY, f64::NAN), |(range, cos)| (range, cos));
            let near = |a: f32, b: f64| {
                f64::from(a) == b || (f64::from(a) - b).abs() <= 1e-6 * b.max(1.0) || (a.is_nan() && b.is_nan())
            };
            seen += usize::from(shown.0.is_finite());
            other += usize::from(!(near(shown.0, range) && near(shown.1, cos)));
        }
    }
    assert!(seen > 14_000 && other == 0, "{other} of {seen} differ");
}

#[test]
fn a_cut_is_made_from_the_sixteenth_scan_on_and_follows_the_world() {
    let mut world = World::new(scenes::room(3, 40));
    let (sensor, pose) = (&scanners()[0], Pose::from_xyz_rpy(DVec3::new(0.1, 0.2, 1.0), 0.0, 0.0, 0.4));
    let mut kept = predictor(1);
    let mut scan = |world: &World, pose: &Pose| {
        let seen = kept.predict(world, sensor, &SensorPose::new(*pose), &Request::default()).expect("it predicts");
        let new =
            predictor(1).predict(world, sensor, &SensorPose::new(*pose), &Request::default()).expect("it predicts");
        let same = Output::ALL.iter().all(|output| bits(&seen.images, *output) == bits(&new.images, *output));
        assert!(same, "{}", seen.stats.engine);
        seen.stats.engine
    };
    let before = RowCuts::SCANS as usize - 1;
    let mut scans =
        |world: &World, pose: &Pose, count: usize| (0..count).map(|_| scan(world, pose)).collect::<Vec<_>>();
    assert_eq!(scans(&world, &pose, before), vec!["cpu"; before]);
    let elsewhere = Pose::from_xyz_rpy(DVec3::new(-0.5, 0.3, 1.0), 0.0, 0.0, -2.0);
    assert_eq!(scans(&world, &elsewhere, 3), ["row"; 3]);
    // Leaning, and at another height.
    let leaning = Pose::from_xyz_rpy(pose.translation, 1e-10, 0.0, 0.4);
    let higher = Pose::from_xyz_rpy(DVec3::new(0.1, 0.2, 1.5), 0.0, 0.0, 0.4);
    assert_eq!(scans(&world, &leaning, before + 1), vec!["cpu"; before + 1]);
    assert_eq!(scans(&world, &higher, before), vec!["cpu"; before]);
    assert_eq!(scans(&world, &pose, 1), ["row"]);
    // Every change counts from the beginning.
    let name = world.environment().objects()[1].name.clone();
    let mut random = Random(8);
    for round in 0..4 {
        let mut environment = Environment::clone(world.environment());
        match round {
            0 => environment.set_pose(&name, Pose::from_xyz_rpy(DVec3::new(0.7, 0.1, 0.2), 0.3, 0.1, 1.0)).map(drop),
            1 => environment.delete(&name).map(drop),
            2 => environment
                .insert(NewObject::new(
                    "new",
                    Pose::from_xyz_rpy(DVec3::new(1.2, 0.0, 0.5), 0.2, 0.1, random.unit()),
                    scenes::cuboid(Vec3::splat(-0.4), Vec3::splat(0.4)).into(),
                ))
                .map(drop),
            _ => Ok(()),
        }
        .expect("a sound change");
        world = World::new(environment);
        assert_eq!(scans(&world, &pose, before), vec!["cpu"; before]);
        assert_eq!(scans(&world, &pose, 2), ["row"; 2]);
    }
}

#[test]
fn materials_and_sides_have_the_same_bits() {
    let mut both = Both::new();
    let mut random = Random(12);
    for round in 0..40 {
        let mut environment = Environment::new();
        let mut material = |name: &str, one_sided: bool, seen: Appearance| {
            let mut new = Material::named(name);
            new.one_sided = one_sided;
            new.appearance.insert("laser".into(), seen);
            environment.add_material(new).expect("a material")
        };
        let all = [
            material("both", false, Appearance::Opaque),
            material("one", true, Appearance::Opaque),
            material("glass", false, Appearance::Transparent),
        ];
        for k in 0..12 {
            let size = Vec3::new(random.uniform(0.2, 1.0) as f32, random.uniform(0.2, 1.0) as f32, 1.0);
            let of = all[random.below(3)];
            let mesh = scenes::cuboid(-size, size).with_materials(|_| of);
            let at = DVec3::new(random.uniform(-4.0, 4.0), random.uniform(-4.0, 4.0), random.uniform(-0.5, 0.5));
            let pose = Pose::from_xyz_rpy(at, random.uniform(-0.3, 0.3), 0.1, random.uniform(-3.0, 3.0));
            let scale = DVec3::new(1.0, if k % 3 == 0 { -1.5 } else { 0.7 }, 1.0);
            let object_from_mesh = glam::DAffine3::from_scale(scale);
            let new = NewObject { object_from_mesh, ..NewObject::new(format!("box {k}"), pose, mesh.into()) };
            environment.insert(new).expect("an object");
        }
        // A part of one box is absent, and a whole other one.
        for (object, bounds) in
            [("box 3", Some(Aabb { min: DVec3::splat(-2.0), max: DVec3::new(0.3, 2.0, 2.0) })), ("box 4", None)]
        {
            let mark = Mark { object: object.into(), kind: MarkKind::Absent, class: None, bounds };
            environment.set_mark(object, mark).expect("a sound mark");
        }
        let world = World::new(environment);
        let cut = cut(&world, 0.1);
        for sensor in scanners() {
            let pose = Pose::from_xyz_rpy(DVec3::new(0.0, 0.0, 0.1), 0.0, 0.0, f64::from(round));
            both.compare(&world, &cut, &sensor, &pose);
        }
    }
    both.check(100_000);
}

#[test]
fn a_batch_has_the_images_of_single_predictions() {
    let all = Outputs::ALL.without(Output::DepthZ);
    let world = World::new(scenes::room(9, 60));
    let sensor = &scanners()[0];
    let mut random = Random(4);
    let poses: Vec<Pose> = (0..40)
        .map(|i| {
            let at = DVec3::new(random.uniform(-2.0, 2.0), random.uniform(-2.0, 2.0), 1.0 + f64::from(i % 3));
            Pose::from_xyz_rpy(at, 0.0, 0.0, random.uniform(-3.0, 3.0))
        })
        .collect();
    let request = BatchRequest { images: Some(all.into()), statistics: true, ..BatchRequest::default() };
    let mut predictor = predictor(2);
    let items: Vec<_> = predictor
        .batch(&world, sensor, poses.into_iter().map(SensorPose::new), &request)
        .expect("a request")
        .map(|item| item.expect("a pose"))
        .collect();
    let mut by_cut = 0;
    for item in items {
        let plan = FramePlan::new(&world, sensor, &item.pose.world_from_sensor(), all).expect("a sound pose");
        let mut images = Images::default();
        CpuEngine::new(1).expect("a thread").render(&plan, &mut images, &mut Stats::default()).expect("it renders");
        assert!(Output::ALL.iter().all(|output| bits(&images, *output) == bits(&item.images, *output)));
        by_cut += usize::from(item.stats.expect("statistics").engine == "row");
    }
    assert_eq!(by_cut, 14, "those at the first pose's height");
}

#[test]
fn cuts_are_for_level_rows_only() {
    let (world, cuts) = (World::new(scenes::room(1, 5)), RowCuts::default());
    let one = &scanners()[0];
    let get = |sensor: &Sensor, pose: &Pose| cuts.get(&world, sensor, pose, Making::AtOnce);
    assert!(get(one, &Pose::from_xyz_rpy(DVec3::Z, 0.0, 0.0, 1.0)).is_some());
    assert!(get(one, &Pose::from_xyz_rpy(DVec3::Z, 1e-10, 0.0, 1.0)).is_none());
    assert!(get(one, &Pose::from_xyz_rpy(DVec3::Z, std::f64::consts::PI, 0.0, 1.0)).is_none());
    // Too far away for the margins of the cut.
    assert!(get(one, &Pose::from_xyz_rpy(DVec3::new(1e6, 0.0, 1.0), 0.0, 0.0, 1.0)).is_none());
    for name in ["vlp-16", "video-camera"] {
        assert!(get(&presight_read::preset(name).unwrap(), &Pose::IDENTITY).is_none());
    }
    // Above the whole scene there is nothing in view.
    let above = Pose::from_xyz_rpy(DVec3::Z * 50.0, 0.0, 0.0, 0.0);
    assert!(get(one, &above).expect("a cut of nothing").segments.is_empty());
    assert_eq!(
        predictor(1).predict(&world, one, &SensorPose::new(above), &Request::default()).unwrap().images.range,
        [f32::INFINITY; 361]
    );
}
