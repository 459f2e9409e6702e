//! Stages that a request does not need neither run nor allocate. For a matrix of sensors, scenes, requests and engines
//! the test compares the stages that ran, the passes and workgroups of the device, the bytes transferred and the bytes
//! of images with the needs of the request. These are counts, not times, so a needless stage fails on any machine.

use presight_testkit as common;

#[cfg(feature = "gpu")]
use common::skip::no_adapter;
use common::{Random, scenes};
use glam::{DMat3, DVec3, Vec3};
use presight_features::{BoxOptions, FeatureOptions, Hidden, PlacedFeature};
use presight_model::environment::{Appearance, Existence, Feature, FeatureShape, Properties};
use presight_model::environment::{Environment, Material, Mesh, NewObject, Polygon, PolygonOrder};
use presight_model::geometry::{Pose, SensorPose};
use presight_model::sensor::{Camera, Distortion, Geometry, Sensor, SensorSpec};
use presight_model::world::World;
use presight_predict::predict::{Backend, Options, Predictor};
use presight_predict::request::Request;
use presight_render::plan::{IdScheme, Images, Output, Outputs, Stats, Work};
use presight_render::plan::{Part, SamplesMut, StageName};
use presight_studies::index::Scheme;
use std::sync::Arc;

/// The place of a prediction.
#[derive(Clone, Copy, Debug, PartialEq)]
enum On {
    Cpu,
    /// Every stage on the device.
    Device,
    /// A software adapter: the same cores resolve images and check features directly.
    Software,
}

/// The features requested with the images.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Features {
    No,
    /// A layer without features.
    Empty,
    Seen,
    WithId,
    WithBoxes,
}

#[derive(Clone, Copy)]
struct Case<'a> {
    on: On,
    world: &'a World,
    sensor: &'a Sensor,
    outputs: Outputs,
    ids: IdScheme,
    features: Features,
}

/// The work of a prediction.
#[derive(Clone, Debug)]
struct Did {
    stats: Stats,
    /// The room of each image in bytes, in the order of [`Output::WITH_FEATURES`].
    room: [usize; Output::WITH_FEATURES.len()],
    pixels: usize,
    polygons: u64,
}

fn room(images: &mut Images) -> [usize; Output::WITH_FEATURES.len()] {
    Output::WITH_FEATURES.map(|output| match images.samples_mut(output) {
        SamplesMut::Floats(image) => 4 * image.capacity(),
        SamplesMut::Ids(image) if output == Output::FeatureId => 4 * image.len(),
        SamplesMut::Ids(image) => 4 * image.capacity(),
        SamplesMut::Vectors(image) => 12 * image.capacity(),
    })
}

fn count(stats: &Stats, name: &str) -> u64 {
    stats.counts.iter().find(|(n, _)| n.name() == name).map_or(0, |(_, n)| *n)
}

impl Case<'_> {
    fn name(&self) -> String {
        let outputs: Vec<_> = self.outputs.iter().map(Output::name).collect();
        let (on, sensor, features) = (self.on, &self.sensor.spec().name, self.features);
        format!("{on:?}, {sensor}, {}, {:?}, {features:?}", outputs.join("+"), self.ids)
    }

    /// Predicts twice: buffers grow in the first prediction, and the second must allocate none.
    fn run(&self, predictor: &mut Predictor, placed: &[PlacedFeature]) -> Did {
        self.run_once(predictor, placed);
        self.run_once(predictor, placed)
    }

    fn run_once(&self, predictor: &mut Predictor, placed: &[PlacedFeature]) -> Did {
        let (world, sensor, pose) = (self.world, self.sensor, pose());
        let outputs =
            if self.features == Features::WithId { self.outputs.with(Output::FeatureId) } else { self.outputs };
        let mut request = Request::of(outputs).with_ids(self.ids);
        if self.features != Features::No {
            let placed = if self.features == Features::Empty { Vec::new() } else { placed.to_vec() };
            request = request.with_features(FeatureOptions::default().with_placed(placed).with_hidden(Hidden::Full));
        }
        if self.features == Features::WithBoxes {
            request = request.with_regions(BoxOptions::default());
        }
        let prediction = predictor.predict(world, sensor, &SensorPose::new(pose), &request).unwrap();
        let (mut images, stats) = (prediction.images, prediction.stats);
        let polygons = count(&stats, "polygons selected");
        Did { stats, room: room(&mut images), pixels: images.pixels(), polygons }
    }

    /// The images that engines must fill: the requested ones, and the inputs of echoes and normals.
    fn drawn(&self) -> Outputs {
        let asked = self.outputs.without(Output::FeatureId);
        let factors: Vec<f64> = self.world.environment().materials().iter().map(|m| m.reflection).collect();
        let asked = match asked.has(Output::Normal) {
            true => asked.with(Output::PolygonId).with(Output::ObjectId),
            false => asked,
        };
        match asked.has(Output::Echo) {
            false => asked,
            true if factors.windows(2).all(|w| w[0] == w[1]) => asked.with(Output::CosIncidence),
            true => asked.with(Output::CosIncidence).with(Output::PolygonId).with(Output::ObjectId),
        }
    }

    /// Compares the work with the needs of the request.
    fn check(&self, did: &Did) -> Result<(), String> {
        self.check_stages(did)?;
        self.check_rows(did)?;
        self.check_images(did)?;
        self.check_device(did)
    }

    /// Returns true if the device tests samples.
    fn asks_device(&self) -> bool {
        self.on == On::Device && !matches!(self.features, Features::No | Features::Empty)
    }

    fn check_stages(&self, did: &Did) -> Result<(), String> {
        let some = did.polygons > 0;
        let mut expected = vec!["selection"];
        if some {
            expected.extend(match self.on {
                On::Cpu => ["setup", "rasterization"].as_slice(),
                On::Device => &["upload", "device", "cull", "setup", "raster", "resolve", "readback"],
                On::Software => &["upload", "device", "cull", "setup", "raster", "resolve on the CPU"],
            });
        }
        if self.outputs.has(Output::Echo) {
            expected.push("echo");
        }
        if self.outputs.has(Output::Normal) {
            expected.push("normal");
        }
        if self.asks_device() && some {
            expected.push("features on the device");
        }
        if !matches!(self.features, Features::No | Features::Empty) {
            expected.push("features");
        }
        if self.features == Features::WithBoxes {
            expected.push("regions of interest");
        }
        let ran: Vec<&str> = did.stats.stages_ms.iter().map(|(name, _)| name.name()).collect();
        same("stages", &ran, &expected)
    }

    /// The list for users: no duplicates, and every variant correctly either used or omitted.
    fn check_rows(&self, did: &Did) -> Result<(), String> {
        let rows = did.stats.stages();
        let state = |name: &str| {
            let mut of_name = rows.iter().filter(|r| r.name == name).map(|r| r.ran);
            (of_name.next(), of_name.next())
        };
        let rays = matches!(self.sensor.grid(), presight_model::sensor::PixelGrid::Rays(_));
        let materials = self.world.environment().materials();
        let mixed = |m: &Material| m.one_sided || m.appearance(&self.sensor.spec().class) != Appearance::Opaque;
        same("ray table", state("ray table"), (Some(rays), None))?;
        let tested = did.polygons > 0 && materials.iter().any(mixed);
        same("material test", state("material test per polygon"), (Some(tested), None))?;
        let asked = !matches!(self.features, Features::No | Features::Empty);
        same("features", state("features"), (Some(asked), None))?;
        let boxed = self.features == Features::WithBoxes;
        same("regions of interest", state("regions of interest"), (Some(boxed), None))?;
        if self.on != On::Cpu && did.polygons > 0 {
            same("rays from a storage buffer", state("rays from a storage buffer"), (Some(rays), None))?;
        }
        for output in Output::ALL {
            let left_out = state(&format!("{} image", output.name())) == (Some(false), None);
            same("image row", left_out, !self.drawn().has(output))?;
        }
        Ok(())
    }

    fn check_images(&self, did: &Did) -> Result<(), String> {
        let wanted =
            if self.features == Features::WithId { self.drawn().with(Output::FeatureId) } else { self.drawn() };
        let room =
            Output::WITH_FEATURES.map(|o| if wanted.has(o) { 4 * o.info().kind.numbers() * did.pixels } else { 0 });
        same("bytes of images", did.room, room)?;
        same("image_bytes", did.stats.work.image_bytes, room[..Output::ALL.len()].iter().sum::<usize>() as u64)
    }

    fn check_device(&self, did: &Did) -> Result<(), String> {
        let work = Work { image_bytes: 0, ..did.stats.work };
        same("bytes made in steady state", work.gpu_bytes_made, 0)?;
        let some = did.polygons > 0;
        let groups = |n: u64| n.div_ceil(64);
        let (mut passes, mut workgroups, mut read) = (0, 0, 0);
        if self.on != On::Cpu && some {
            let names = ["runs selected", "polygons in view", "work items"];
            let [runs, survivors, items] = names.map(|name| count(&did.stats, name));
            // These few polygons fit in one wave, and no run here has more than the eight of a unit.
            passes += 3;
            workgroups += groups(8 * runs) + groups(survivors) + groups(items);
            // Counters and times in addition to the payload, and padding.
            read += 136 + 3 * 16;
        }
        let pixels = did.pixels as u64;
        if self.on == On::Device && some {
            passes += 1;
            workgroups += groups(pixels);
            read += 16 + 4 * pixels * self.drawn().without(Output::Echo).without(Output::Normal).iter().count() as u64;
        }
        if self.on == On::Software && some {
            read += 8 * pixels + 16 * u64::from(self.world.environment().slot_count());
        }
        if self.asks_device() && some {
            let samples = count(&did.stats, "feature samples");
            passes += 1;
            workgroups += groups(samples);
            read += 4 * samples;
        }
        let boxes = count(&did.stats, "regions of interest made on the device");
        if self.features == Features::WithBoxes && boxes > 0 {
            passes += 1;
            workgroups += 1;
            read += 32 * boxes;
        }
        same("passes", work.gpu_passes, passes)?;
        same("workgroups", work.gpu_workgroups, workgroups)?;
        same("written to an idle device", work.gpu_bytes_written > 0, passes > 0)?;
        same("bytes read back, in words of padding", work.gpu_bytes_read.abs_diff(read) / 16, 0)
    }
}

fn same<T: PartialEq + std::fmt::Debug>(what: &str, found: T, expected: T) -> Result<(), String> {
    if found == expected { Ok(()) } else { Err(format!("{what}: {found:?} instead of {expected:?}")) }
}

fn pose() -> Pose {
    Pose::from_xyz_rpy(DVec3::new(0.2, -0.1, 1.4), 0.05, 0.1, 0.4)
}

/// A sensor of each kind for which engines have a path, none square.
fn sensors() -> Vec<Sensor> {
    let lens = Camera {
        distortion: Distortion::PlumbBob([-0.2, 0.05, 0.001, -0.001, 0.0]),
        ..Camera::pinhole(48, 36, 40.0, 41.0, 23.5, 17.5)
    };
    let lens = Sensor::new(SensorSpec::new("lens", "video", Geometry::Camera(lens))).unwrap();
    vec![scenes::camera(64, 48), scenes::scanner(90, 16), scenes::scanner(1440, 1), lens, scenes::all_round(36, 18)]
}

/// A room of two-sided, opaque polygons of one factor; one with all kinds of materials; an empty world.
fn worlds() -> [(&'static str, World); 3] {
    let mut mixed = Environment::new();
    let glass = [("video", Appearance::Transparent), ("laser", Appearance::Invisible)];
    let appearance = glass.map(|(class, a)| (class.to_owned(), a)).into();
    for material in [
        Material::named("wall"),
        Material { appearance, reflection: 0.1, ..Material::named("glass") },
        Material { one_sided: true, reflection: 0.4, ..Material::named("leaf") },
    ] {
        mixed.add_material(material).unwrap();
    }
    let mut random = Random(11);
    for i in 0..24 {
        let corners: Vec<Vec3> =
            (0..3).map(|_| [-3.0, -3.0, 0.0].map(|least| random.uniform(least, 3.0) as f32).into()).collect();
        let face = vec![Polygon::new(vec![0, 1, 2], i % 3)];
        let mesh = Mesh::new("face", corners, face, PolygonOrder::Given).unwrap();
        mixed.insert(NewObject::new("face", Pose::IDENTITY, Arc::new(mesh))).unwrap();
    }
    [("plain", scenes::room_world(7, 12)), ("mixed", World::new(mixed)), ("empty", World::new(scenes::empty()))]
}

/// Sides of polygons; in a world without any, a segment in the air.
fn features(world: &World) -> Vec<PlacedFeature> {
    let environment = world.environment();
    let outline = |slot| environment.polygon_in_world(slot).filter(|corners| corners.len() >= 3);
    let mut all: Vec<(Vec<u32>, [DVec3; 2])> =
        (0..environment.slot_count()).filter_map(|slot| outline(slot).map(|c| (vec![slot], [c[0], c[1]]))).collect();
    all.push((Vec::new(), [DVec3::new(2.0, 0.8, 1.3), DVec3::new(2.1, 1.2, 1.2)]));
    let place = |(i, (slots, ends)): (usize, (Vec<u32>, [DVec3; 2]))| {
        let shape = FeatureShape::Segment { ends, covariances: [DMat3::ZERO; 2], cross: DMat3::ZERO };
        let (existence, properties) = (Existence::default(), Properties::default());
        let feature = Feature { id: i as u32 + 1, name: None, object: None, shape, existence, properties };
        PlacedFeature { feature: feature.into(), object: None, slots }
    };
    all.into_iter().enumerate().map(place).collect()
}

fn of(outputs: &[Output]) -> Outputs {
    Outputs::of(outputs)
}

/// Each output alone, a pair, and all; camera outputs for cameras only.
fn requests(sensor: &Sensor) -> Vec<Outputs> {
    let depth = |o: &Outputs| sensor.is_camera() || !o.has(Output::DepthZ);
    let all = if sensor.is_camera() { Outputs::ALL } else { Outputs::ALL.without(Output::DepthZ) };
    let single = Output::ALL.into_iter().map(|o| of(&[o]));
    single.chain([of(&[Output::Range, Output::ObjectId]), Outputs::default(), all]).filter(depth).collect()
}

/// The case with one more output or feature, where possible.
fn one_more(case: Case<'_>) -> Option<Case<'_>> {
    let more = |o: &Output| !case.outputs.has(*o) && (*o != Output::DepthZ || case.sensor.is_camera());
    if let Some(output) = Output::ALL.into_iter().find(more) {
        return Some(Case { outputs: case.outputs.with(output), ..case });
    }
    let features = match case.features {
        Features::No => Features::Seen,
        Features::Seen => Features::WithBoxes,
        Features::Empty | Features::WithId | Features::WithBoxes => return None,
    };
    Some(Case { features, ..case })
}

/// Checks every case, and checks that the smaller request's expectation refuses a larger request.
fn hold(case: Case<'_>, scene: &str, predictor: &mut Predictor, placed: &[PlacedFeature]) {
    let did = case.run(predictor, placed);
    case.check(&did).unwrap_or_else(|e| panic!("{scene}, {}: {e}\n{:?}", case.name(), did.stats));
    if let Some(more) = one_more(case) {
        let did = more.run(predictor, placed);
        assert!(case.check(&did).is_err(), "{scene}, {}: {} passes for it", case.name(), more.name());
    }
}

fn matrix(on: On, predictor: &mut Predictor) {
    for (scene, world) in &worlds() {
        let placed = features(world);
        for sensor in &sensors() {
            let case =
                Case { on, world, sensor, outputs: Outputs::default(), ids: IdScheme::Model, features: Features::No };
            for outputs in requests(sensor) {
                hold(Case { outputs, ..case }, scene, predictor, &placed);
            }
            hold(Case { ids: IdScheme::Source, ..case }, scene, predictor, &placed);
            let id = of(&[Output::PolygonId]);
            for features in [Features::Empty, Features::Seen, Features::WithId, Features::WithBoxes] {
                hold(Case { outputs: id, features, ..case }, scene, predictor, &placed);
            }
        }
    }
}

fn cpu() -> Predictor {
    Predictor::new(Options::new(Backend::Cpu).with_threads(2)).unwrap()
}

#[test]
fn the_cpu_engine_does_nothing_needless() {
    matrix(On::Cpu, &mut cpu());
}

#[test]
fn every_index_leaves_out_geometry_out_of_view() {
    let (_, world) = &worlds()[0];
    let sensor = &scenes::camera(64, 48);
    let mut selected = Vec::new();
    for scheme in Scheme::ALL {
        let world = &world.reindexed(&scheme.tuned());
        let case = Case {
            on: On::Cpu,
            world,
            sensor,
            outputs: Outputs::default(),
            ids: IdScheme::Model,
            features: Features::No,
        };
        let did = case.run(&mut cpu(), &[]);
        case.check(&did).unwrap_or_else(|e| panic!("{}: {e}", scheme.name()));
        selected.push((scheme, did.polygons));
    }
    let all = u64::from(world.environment().slot_count());
    assert!(selected.iter().all(|(_, n)| *n > 0 && 2 * *n < all), "{selected:?} of {all}");
}

/// Only a scene of several waves is sifted, and never for ray tables.
#[test]
fn geometry_of_one_wave_is_not_sifted() {
    for (boxes, waves) in [(12, false), (1500, true)] {
        let world = scenes::room_world(7, boxes);
        for sensor in [scenes::scanner(90, 16), scenes::all_round(36, 18)] {
            let stats = cpu().predict(&world, &sensor, &SensorPose::new(pose()), &Request::default()).unwrap().stats;
            let row = stats.stages().into_iter().find(|r| r.name == "hidden").unwrap();
            assert_eq!((row.ran, row.ms.is_some(), row.why.is_empty()), (waves, waves, waves));
        }
    }
}

/// Each count is checked separately: with one more of anything the check fails.
#[test]
fn one_stage_pass_group_byte_or_image_too_many_is_found() {
    let (_, world) = &worlds()[0];
    let sensor = &scenes::camera(64, 48);
    let outputs = of(&[Output::Range]);
    let on = On::Cpu;
    let case = Case { on, world, sensor, outputs, ids: IdScheme::Model, features: Features::No };
    let did = case.run(&mut cpu(), &[]);
    assert_eq!(case.check(&did), Ok(()));
    let faults: [fn(&mut Did); 10] = [
        |did| did.stats.stages_ms.push((StageName::Features, 0.0)),
        |did| did.stats.stages_ms.swap(0, 1),
        |did| did.stats.left_out.retain(|l| l.what != StageName::RayTable.into()),
        |did| did.stats.take(StageName::MaterialTest, ""),
        |did| did.stats.left_out.retain(|l| l.what != Part::Image(Output::Echo)),
        |did| did.room[6] = 4,
        |did| did.stats.work.image_bytes += 4,
        |did| did.stats.work.gpu_passes += 1,
        |did| did.stats.work.gpu_workgroups += 1,
        |did| did.stats.work.gpu_bytes_made += 1,
    ];
    for (n, fault) in faults.iter().enumerate() {
        let mut worse = did.clone();
        fault(&mut worse);
        assert!(case.check(&worse).is_err(), "fault {n}");
    }
}

#[cfg(feature = "gpu")]
mod device {
    use super::*;
    use presight_predict::gpu::testing;
    use presight_predict::gpu::testing::Setup;
    use presight_predict::gpu::{DeviceOptions, GpuEngine};
    use presight_render::plan::FramePlan;

    /// Returns `None` where there is no adapter and the machine may lack one.
    fn there<T>(made: presight_model::error::Result<T>) -> Option<T> {
        made.inspect_err(|e| no_adapter(e)).ok()
    }

    fn predictor(all_on_device: bool) -> Option<Predictor> {
        let engine = there(engine(all_on_device))?.with_threads(2);
        Some(Predictor::with_engine(Options::new(Backend::Gpu).with_threads(2), Box::new(engine)))
    }

    fn engine(all_on_device: bool) -> presight_model::error::Result<GpuEngine> {
        testing::open(DeviceOptions::default(), Setup { all_on_device, ..Setup::default() })
    }

    #[test]
    fn the_device_does_nothing_needless() {
        let Some(mut predictor) = predictor(true) else { return };
        matrix(On::Device, &mut predictor);
    }

    #[test]
    fn a_software_adapter_does_nothing_needless() {
        let Some(mut predictor) = predictor(false) else { return };
        if predictor.engine_name().contains("llvmpipe") {
            matrix(On::Software, &mut predictor);
        }
    }

    /// The bytes of the buffers that a new engine allocates for one frame.
    fn made(all_on_device: bool, world: &World, outputs: Outputs) -> Option<(u64, GpuEngine)> {
        let mut engine = there(engine(all_on_device))?;
        let (before, sensor) = (engine.allocations().bytes, scenes::camera(256, 128));
        let plan = FramePlan::new(world, &sensor, &pose(), &Request::of(outputs)).unwrap();
        let mut stats = Stats::default();
        engine.render(&plan, &mut Images::default(), &mut stats).unwrap();
        assert_eq!(stats.work.gpu_bytes_made, engine.allocations().bytes - before);
        Some((stats.work.gpu_bytes_made, engine))
    }

    /// One more image needs one more buffer only where images are made on the device.
    #[test]
    fn buffers_are_allocated_only_for_requested_outputs() {
        let world = scenes::room_world(7, 12);
        let (one, four) = (of(&[Output::Range]), Outputs::default());
        let image = 4 * 256 * 128;
        let Some((small, engine)) = made(true, &world, one) else { return };
        let Some((large, _)) = made(true, &world, four) else { return };
        // The images themselves, and a readback buffer with room for counters and times, which is therefore twice as
        // large.
        assert_eq!(large - small, 3 * image + 2 * 3 * image, "{small} and {large}");
        assert_eq!(made(true, &World::new(scenes::empty()), four).unwrap().0, 0, "an empty view allocates nothing");
        if !engine.adapter().hardware {
            let [small, large] = [one, four].map(|outputs| made(false, &world, outputs).unwrap().0);
            assert_eq!(small, large, "a software adapter makes no images");
        }
    }

    /// The device allocates no room for samples or boxes of features before a request for them.
    #[test]
    fn buffers_of_features_are_allocated_on_request() {
        let Some(mut predictor) = predictor(true) else { return };
        let (world, sensor) = (&scenes::room_world(7, 12), &scenes::camera(64, 48));
        let placed = features(world);
        let mut before = None;
        for (features, more) in [(Features::No, 0), (Features::Empty, 0), (Features::Seen, 3), (Features::WithBoxes, 8)]
        {
            let outputs = of(&[Output::PolygonId]);
            let case = Case { on: On::Device, world, sensor, outputs, ids: IdScheme::Model, features };
            case.run(&mut predictor, &placed);
            let made = testing::allocations(predictor.engine()).unwrap();
            let growth = made.buffers - before.unwrap_or(made.buffers);
            assert!(growth >= more && (growth == 0) == (more == 0), "{features:?}: {growth} buffers");
            before = Some(made.buffers);
        }
    }
}
