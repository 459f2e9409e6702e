//! Measures each stage and shader variant, and so the time saved by omitting it: `cargo bench --bench left_out` prints
//! a table in Markdown. Every row compares a prediction with a stage and one without it, in turns in one process; the
//! cost is the median of the differences within pairs. Scenes: the factory hall and the hospital in `PRESIGHT_DATA`
//! (default `../shared/data`), or `scenes/room.glb` without them.
#![expect(clippy::print_stdout, reason = "a bench prints a table")]

use presight_features::generate::{GenerateOptions, generate};
use presight_features::{BoxOptions, FeatureOptions, PlacedFeatures, place};
use presight_model::environment::{Environment, Material, Mesh, NewObject, Polygon, PolygonOrder};
use presight_model::geometry::{Pose, SensorPose};
use presight_model::index::IndexKind;
use presight_model::sensor::{Distortion, Geometry, Sensor, SensorSpec};
use presight_model::world::World;
use presight_predict::free_poses::free_poses;
#[cfg(feature = "gpu")]
use presight_predict::gpu::testing::{self, Setup};
use presight_predict::predict::{Backend, Options, Prediction, Predictor};
use presight_predict::request::Request;
use presight_read::gltf::{ImportOptions, import};
use presight_read::preset;
use presight_render::plan::{Output, Outputs, Stats};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Instant;

/// The number of pairs for each median.
const PAIRS: usize = 40;

/// One side of a pair.
struct Side<'a> {
    predictor: &'a mut Predictor,
    world: &'a World,
    sensor: &'a Sensor,
    outputs: Outputs,
    after: After<'a>,
}

/// The stages after the images.
#[derive(Clone, Copy)]
enum After<'a> {
    Nothing,
    Features(&'a PlacedFeatures),
    FeatureId(&'a PlacedFeatures),
    Boxes(&'a PlacedFeatures),
}

impl Side<'_> {
    fn run(&mut self, pose: &Pose, prediction: &mut Option<Prediction>) -> (f64, Stats) {
        let Self { predictor, world, sensor, outputs, after } = self;
        let placed = |placed: &PlacedFeatures| FeatureOptions::default().with_placed(placed.clone());
        let plain = Request::of(*outputs);
        let request = match after {
            After::Nothing => plain,
            After::Features(of) => plain.with_features(placed(of)),
            After::FeatureId(of) => plain.with_outputs(outputs.with(Output::FeatureId)).with_features(placed(of)),
            After::Boxes(of) => {
                let deviation = |i: usize| if i < 3 { 1e-3f64.sqrt() } else { 1e-2 };
                let boxes = BoxOptions::default().with_sensor_sigmas(std::array::from_fn(deviation));
                plain.with_features(placed(of)).with_regions(boxes)
            }
        };
        let same =
            prediction.as_ref().is_some_and(|p| p.request == request && std::ptr::eq(p.sensor.grid(), sensor.grid()));
        let start = Instant::now();
        match prediction {
            Some(last) if same => predictor.predict_again(world, &SensorPose::new(*pose), last).expect("a prediction"),
            _ => {
                *prediction =
                    Some(predictor.predict(world, sensor, &SensorPose::new(*pose), &request).expect("a prediction"))
            }
        }
        let stats = prediction.as_ref().map(|p| p.stats.clone()).unwrap_or_default();
        (start.elapsed().as_secs_f64() * 1e3, stats)
    }
}

fn median(mut times: Vec<f64>) -> f64 {
    times.sort_by(f64::total_cmp);
    times[times.len() / 2]
}

/// A row: both medians and the median of the differences.
fn row(what: &str, left_out_by: &str, pose: &Pose, with: &mut Side<'_>, without: &mut Side<'_>) {
    let (mut last, mut others) = (None, None);
    let mut all: [Vec<f64>; 3] = Default::default();
    for i in 0..PAIRS + 2 {
        let (a, b) = (with.run(pose, &mut last).0, without.run(pose, &mut others).0);
        // The first pairs warm up.
        if i >= 2 {
            (0..3).for_each(|k| all[k].push([a, b, a - b][k]));
        }
    }
    let [a, b, cost] = all.map(median);
    println!("| {what} | {a:.2} | {b:.2} | {cost:+.2} | {left_out_by} |");
}

struct Scene {
    name: &'static str,
    world: World,
    pose: Pose,
    placed: PlacedFeatures,
}

fn scenes() -> Vec<Scene> {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let data = std::env::var_os("PRESIGHT_DATA").map_or_else(|| root.join("../shared/data"), PathBuf::from);
    let env = |name: &'static str| (name, data.join("env").join(name).with_extension("glb"));
    let mut paths: Vec<_> = ["factory_hall", "hospital"].map(env).into_iter().filter(|(_, p)| p.is_file()).collect();
    if paths.is_empty() {
        paths.push(("room", root.join("scenes/room.glb")));
    }
    let scene = |(name, path): (&'static str, PathBuf)| {
        let environment = import(&path, &ImportOptions::default()).unwrap_or_else(|e| panic!("{e}")).environment;
        let generated = generate(&environment, "video", &GenerateOptions::default()).expect("features");
        let world = World::new(environment);
        let placed = place(&world, &generated.layer).expect("features lie on their polygons");
        let pose = free_poses(&world, 1, 1).expect("a free pose")[0];
        Scene { name, world, pose, placed: placed.into_iter().take(5000).collect::<Vec<_>>().into() }
    };
    paths.into_iter().map(scene).collect()
}

/// The same world, but the last polygon of every mesh is one-sided: the materials of all polygons must be tested.
fn mixed(world: &World) -> World {
    let environment = world.environment();
    let mut other = Environment::new();
    for material in environment.materials() {
        other.add_material(material.clone()).expect("a valid material");
    }
    let name = "one-sided";
    let extra = other.add_material(Material { one_sided: true, ..Material::named(name) }).expect("a valid material");
    for object in environment.objects().iter().filter(|o| o.mesh.polygon_count() > 0) {
        let mesh = &object.mesh;
        let last = mesh.polygon_count() as u32 - 1;
        let material = |i: u32| if i == last { extra } else { mesh.material(i) };
        let polygons = (0..=last).map(|i| Polygon::new(mesh.corner_indices(i).to_vec(), material(i))).collect();
        let mesh = Mesh::new(mesh.name(), mesh.vertices().to_vec(), polygons, PolygonOrder::Given).expect("as before");
        let new = NewObject::from_affine(&object.name, object.world_from_mesh(), Arc::new(mesh)).expect("as before");
        other.insert(new).expect("as before");
    }
    World::new(other)
}

/// The sensor with a lens whose distortion is smaller than rounding but requires the ray table.
fn bent(sensor: &Sensor) -> Sensor {
    let mut spec: SensorSpec = sensor.spec().clone();
    if let Geometry::Camera(camera) = &mut spec.geometry {
        camera.distortion = Distortion::PlumbBob([1e-12, 0.0, 0.0, 0.0, 0.0]);
    }
    Sensor::new(spec).expect("a valid sensor")
}

fn of(outputs: &[Output]) -> Outputs {
    Outputs::of(outputs)
}

fn side<'a>(
    predictor: &'a mut Predictor,
    scene: &'a Scene,
    sensor: &'a Sensor,
    (outputs, after): (Outputs, After<'a>),
) -> Side<'a> {
    Side { predictor, world: &scene.world, sensor, outputs, after }
}

/// The rows that every engine has.
fn table(scene: &Scene, open: &dyn Fn() -> Predictor) {
    let sensor = preset("video-camera").expect("a preset");
    let (mut first, mut second) = (open(), open());
    let range = of(&[Output::Range]);
    let (pose, ids) = (&scene.pose, of(&[Output::PolygonId]));
    println!("\n**{}, {}**, video-camera 512 x 512\n", scene.name, first.engine_name());
    println!("| stage or variant | with, ms | without, ms | cost, ms | left out by |\n|---|---|---|---|---|");
    for output in [Output::DepthZ, Output::PolygonId, Output::ObjectId, Output::CosIncidence, Output::Echo] {
        let with = &mut side(&mut first, scene, &sensor, (range.with(output), After::Nothing));
        let without = &mut side(&mut second, scene, &sensor, (range, After::Nothing));
        row(&format!("{} image in addition to range", output.name()), "requests without it", pose, with, without);
    }
    let features = format!("features ({})", scene.placed.features.len());
    let placed = &scene.placed;
    let rows = [
        (features.as_str(), "requests without a layer", After::Features(placed), After::Nothing),
        ("feature_id image", "requests without it", After::FeatureId(placed), After::Features(placed)),
        ("regions of interest", "requests that show no boxes", After::Boxes(placed), After::Features(placed)),
    ];
    for (what, left_out_by, with, without) in rows {
        let with = &mut side(&mut first, scene, &sensor, (ids, with));
        row(what, left_out_by, pose, with, &mut side(&mut second, scene, &sensor, (ids, without)));
    }
    let every = scene.world.reindexed(&IndexKind::None);
    let mixed = mixed(&scene.world);
    let lens = bent(&sensor);
    let nothing = World::new(Environment::new());
    let (outputs, after) = (Outputs::default(), After::Nothing);
    let variants = [
        ("test of every polygon's box", "the index", &every, &sensor, &scene.world),
        ("material test per polygon", "scenes opaque to the class and two-sided", &mixed, &sensor, &scene.world),
        ("ray table", "pinhole cameras and scanners", &scene.world, &lens, &scene.world),
        ("everything that is in view", "views of nothing", &scene.world, &sensor, &nothing),
    ];
    for (what, left_out_by, world, sensor_with, world_without) in variants {
        let with = &mut Side { predictor: &mut first, world, sensor: sensor_with, outputs, after };
        let without = &mut Side { predictor: &mut second, world: world_without, sensor: &sensor, outputs, after };
        row(what, left_out_by, pose, with, without);
    }
    stages(&mut side(&mut first, scene, &sensor, (outputs, after)), pose);
}

/// The median times of one request's stages, in one line.
fn stages(side: &mut Side<'_>, pose: &Pose) {
    let mut last = None;
    let runs: Vec<Stats> = (0..PAIRS).map(|_| side.run(pose, &mut last).1).collect();
    let of_stage = |at: usize, name: &str| {
        let times = runs.iter().filter_map(|s| s.stages_ms.get(at)).map(|(_, ms)| *ms).collect();
        format!("{name} {:.2}", median(times))
    };
    let names = runs[0].stages_ms.iter().enumerate().map(|(at, (name, _))| of_stage(at, &name.to_string()));
    println!("\nStages with the four default images, ms: {}.", names.collect::<Vec<_>>().join(", "));
}

/// Stages that the device could leave to the CPU, and the saving of 64-bit atomics.
#[cfg(feature = "gpu")]
fn device(scene: &Scene) {
    use presight_predict::gpu::DeviceOptions;
    use presight_render::plan::FramePlan;
    let sensor = preset("video-camera").expect("a preset");
    let plan = FramePlan::new(&scene.world, &sensor, &scene.pose, &Request::default()).expect("a valid pose");
    let engine = |(without_int64, all_on_device)| {
        let options = DeviceOptions { without_int64, ..DeviceOptions::default() };
        testing::open(options, Setup { all_on_device, ..Setup::default() }).unwrap_or_else(|e| panic!("{e}"))
    };
    let pairs = [
        ("resolve on the device", "software adapters", (false, true), (false, false)),
        ("second raster pass", "64-bit atomics", (true, true), (false, true)),
    ];
    for (what, left_out_by, with, without) in pairs {
        let mut engines = [engine(with), engine(without)];
        let mut times: [Vec<f64>; 3] = Default::default();
        let mut images = presight_render::plan::Images::default();
        for i in 0..PAIRS + 2 {
            let both = [0, 1].map(|k| {
                let start = Instant::now();
                engines[k].render(&plan, &mut images, &mut Stats::default()).expect("a prediction");
                start.elapsed().as_secs_f64() * 1e3
            });
            if i >= 2 {
                (0..3).for_each(|k| times[k].push([both[0], both[1], both[0] - both[1]][k]));
            }
        }
        let [a, b, cost] = times.map(median);
        println!("\n{what}, left out by {left_out_by}: {a:.2} ms with, {b:.2} without, {cost:+.2}.");
    }
}

fn main() {
    for scene in scenes() {
        let cpu = || Predictor::new(Options::new(Backend::Cpu)).expect("threads");
        table(&scene, &cpu);
        #[cfg(feature = "gpu")]
        if Predictor::new(Options::new(Backend::Gpu)).is_ok() {
            let gpu = || {
                let engine = testing::open(Default::default(), Setup::ALL_ON_DEVICE).expect("an adapter");
                Predictor::with_engine(Options::new(Backend::Gpu), Box::new(engine))
            };
            table(&scene, &gpu);
            device(&scene);
        }
    }
}
