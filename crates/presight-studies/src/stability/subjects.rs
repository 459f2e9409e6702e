//! What is studied: engines, by what they draw and which boxes they give.

use presight::Result;
use presight::Threads;
use presight::World;
use presight::engine::{Engine, EngineKind};
use presight::features::{BoxOptions, BoxQuery, FeaturePrediction, PlacedFeature};
use presight::geometry::Pose;
use presight::plan::{CountName, FramePlan, Images, Stats};
use presight::sensor::Sensor;
use presight_predict::engine::add_boxes;

/// Features before a sensor, and how uncertain all is.
#[derive(Clone, Debug)]
pub struct BoxSetting {
    /// The world of the features.
    pub world: World,
    /// The sensor.
    pub sensor: Sensor,
    /// Its pose, body axes.
    pub world_from_sensor: Pose,
    /// Where the features are.
    pub placed: Vec<PlacedFeature>,
    /// What is seen of them.
    pub prediction: FeaturePrediction,
    /// Covariances and confidence.
    pub options: BoxOptions,
}

/// An engine under study, or one that tests have spoiled.
pub struct Subject {
    /// As the tables name it.
    pub name: String,
    /// What is studied.
    pub engine: Box<dyn Engine>,
    /// Its work on the CPU is done there.
    pub threads: Threads,
}

impl Subject {
    /// Fills the requested images. Returns how many polygons it left out as edge-on.
    ///
    /// # Errors
    /// The engine's.
    pub fn draw(&mut self, plan: &FramePlan, images: &mut Images) -> Result<usize> {
        let mut stats = Stats::default();
        self.engine.render(plan, images, &mut stats)?;
        Ok(stats.counts.iter().filter(|(name, _)| *name == CountName::PolygonsEdgeOn).map(|(_, n)| *n as usize).sum())
    }

    /// Gives the features of a setting their boxes; `None` for the reference, which has no part in that.
    ///
    /// # Errors
    /// The engine's.
    pub fn boxes(&mut self, setting: &BoxSetting) -> Result<Option<FeaturePrediction>> {
        if self.name == EngineKind::Reference.name() {
            return Ok(None);
        }
        let mut prediction = setting.prediction.clone();
        let BoxSetting { world, sensor, world_from_sensor, placed, options, .. } = setting;
        let query = BoxQuery { placed, world, sensor, world_from_sensor, options };
        add_boxes(&mut *self.engine, &self.threads, &mut prediction, &query)?;
        Ok(Some(prediction))
    }
}

/// Of adapters that are programs.
const LEFT_TO_CPU: &str = "gpu: this adapter is a program that plays a GPU, on which the engine leaves regions of interest to the \
                           CPU: its rows of condition-box, stiff-box and indefinite are the CPU's; gpu-32-bit is asked to do on the \
                           device what it can. Image covariances (condition, stiff) are the CPU's on every device.";

/// Every engine of this build and machine, and what is to be said of them: which adapter, or that there is none.
///
/// # Errors
/// [`presight::ErrorKind::System`] if threads cannot be started.
pub fn subjects(threads: usize) -> Result<(Vec<Subject>, Vec<String>)> {
    let (mut all, mut notes) = (Vec::new(), Vec::new());
    let threads = Threads::from(threads).started()?;
    // The hardware rasterizer decides nothing that is measured here: setup, edges and depth are those of compute spans.
    for kind in EngineKind::ALL.into_iter().filter(|kind| *kind != EngineKind::GpuRender) {
        let mut engine = match kind.open(&threads) {
            Ok(engine) => engine,
            Err(e) if kind.needs_device() => {
                if kind == EngineKind::Gpu {
                    notes.push(match cfg!(feature = "gpu") {
                        true => format!("SKIPPED: the GPU engine: {}; see presight doctor", e.what()),
                        false => "SKIPPED: the GPU engine: this build is without it".into(),
                    });
                }
                continue;
            }
            Err(e) => return Err(e),
        };
        if let Some(device) = engine.device().filter(|_| kind == EngineKind::Gpu) {
            notes.push(format!("gpu: {}", device.adapter()));
            if !device.takes_features() {
                notes.push(LEFT_TO_CPU.into());
            }
        }
        all.push(Subject { name: kind.name().into(), engine, threads: threads.clone() });
    }
    Ok((all, notes))
}
