//! The engines under test, each as a function from a plan to images.

use super::skip::no_adapter;
use presight_predict::engine::{Engine, EngineKind};
use presight_render::plan::{ChosenWay, CountName, FramePlan, Images, Output, PlanBuffers, SamplesMut, Stats, Way};
use presight_render::verify::Precision;

/// Images filled with other values, because an engine must write every pixel.
fn used(plan: &FramePlan) -> Images {
    let mut images = Images::default();
    images.prepare(plan.sensor.width(), plan.sensor.height(), plan.request.outputs);
    for output in Output::WITH_FEATURES {
        match images.samples_mut(output) {
            SamplesMut::Floats(image) => image.fill(-7.0),
            SamplesMut::Ids(image) => image.fill(0x7777_7777),
            SamplesMut::Vectors(image) => image.fill([-7.0; 3]),
        }
    }
    images
}

/// A function that renders a plan with an engine.
pub type Renderer = Box<dyn FnMut(&FramePlan) -> Images>;

/// Every available engine, with two threads, and the CPU engine with both strategies: kind, precision and renderer.
pub fn all() -> Vec<(EngineKind, Precision, Renderer)> {
    let engines = EngineKind::ALL.into_iter().filter_map(|kind| Some((kind, open(kind, 2)?)));
    let by_tiles = (EngineKind::Cpu, Precision::F64, cpu_by_tiles(2));
    engines.map(|(kind, engine)| (kind, engine.precision(), renderer(engine))).chain([by_tiles]).collect()
}

/// The CPU engine with a number of threads.
pub fn cpu(threads: usize) -> Renderer {
    renderer(EngineKind::Cpu.open(&threads.into()).expect("threads"))
}

/// The CPU engine with a number of threads, by tiles of rays whatever the plan says.
pub fn cpu_by_tiles(threads: usize) -> Renderer {
    let mut render = cpu(threads);
    Box::new(move |plan| {
        let FramePlan { world, sensor, world_from_sensor, request, .. } = plan;
        let plan = FramePlan::by(ChosenWay::TILES, PlanBuffers::default(), world, sensor, world_from_sensor, *request);
        render(&plan.expect("a valid pose"))
    })
}

/// The GPU engine on any available adapter; `None` if there is none and none is required.
#[expect(clippy::print_stderr, reason = "it says which adapter is tested")]
pub fn gpu() -> Option<Renderer> {
    let engine = open(EngineKind::Gpu, 0)?;
    eprintln!("{}", engine.name());
    Some(renderer(engine))
}

/// Opens an engine; `None` if there is no adapter and none is required (see [`no_adapter`] and `PRESIGHT_REQUIRE_GPU`).
fn open(kind: EngineKind, threads: usize) -> Option<Box<dyn Engine>> {
    match kind.open(&threads.into()) {
        Ok(engine) => Some(engine),
        Err(e) if kind.needs_device() => {
            assert!(std::env::var_os("PRESIGHT_REQUIRE_GPU").is_none(), "an adapter is required here: {e}");
            if cfg!(feature = "gpu") {
                no_adapter(e);
            }
            None
        }
        Err(e) => panic!("{}: {e}", kind.name()),
    }
}

fn renderer(mut engine: Box<dyn Engine>) -> Renderer {
    Box::new(move |plan| {
        let (mut images, mut stats) = (used(plan), Stats::default());
        engine.render(plan, &mut images, &mut stats).expect("the engine renders");
        assert!(plan.way() != Way::Tiles || stats.way == Some(Way::Tiles), "{:?}", stats.notices);
        let lost = stats.count_of(CountName::HitsWithoutId).unwrap_or(0);
        assert_eq!(lost, 0, "hits without id");
        images
    })
}
