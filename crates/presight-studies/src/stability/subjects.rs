//! The subjects of the study: engines, judged by their images and regions of interest.

use presight_features::{BoxOptions, BoxQuery, FeaturePrediction, PlacedFeature};
use presight_model::error::Result;
use presight_model::geometry::Pose;
use presight_model::sensor::Sensor;
use presight_model::threads::Threads;
use presight_model::world::World;
use presight_predict::engine::add_boxes;
use presight_predict::engine::{Engine, EngineKind};
use presight_render::plan::{CountName, FramePlan, Images, Stats};

/// Features in front of a sensor, with their uncertainty and that of the pose.
#[derive(Clone, Debug)]
pub struct BoxSetting {
    /// The world of the features.
    pub world: World,
    /// The sensor.
    pub sensor: Sensor,
    /// The sensor's pose, body axes.
    pub world_from_sensor: Pose,
    /// The features.
    pub placed: Vec<PlacedFeature>,
    /// Their predicted visibility.
    pub prediction: FeaturePrediction,
    /// Covariances and confidence.
    pub options: BoxOptions,
}

/// An engine under study. Tests also use faulty ones.
pub struct Subject {
    /// The name in tables.
    pub name: String,
    /// The engine.
    pub engine: Box<dyn Engine>,
    /// Threads for its work on the CPU.
    pub threads: Threads,
}

impl Subject {
    /// Fills the requested images. Returns the number of polygons left out as edge-on.
    ///
    /// # Errors
    /// Engine errors.
    pub fn draw(&mut self, plan: &FramePlan, images: &mut Images) -> Result<usize> {
        let mut stats = Stats::default();
        self.engine.render(plan, images, &mut stats)?;
        Ok(stats.counts.iter().filter(|(name, _)| *name == CountName::PolygonsEdgeOn).map(|(_, n)| *n as usize).sum())
    }

    /// Predicts the regions of interest of a setting's features; `None` for the reference, which does not compute them.
    ///
    /// # Errors
    /// Engine errors.
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

/// A note for software adapters.
const LEFT_TO_CPU: &str = "gpu: this adapter is a software GPU, for which the engine computes regions of interest on \
                           the CPU. Its rows of condition-box, stiff-box and indefinite are results of the CPU; \
                           gpu-32-bit computes on the device whatever it can. Image covariances (condition, stiff) are \
                           always computed on the CPU.";

/// Every engine of this build and machine, and notes about them: the adapter, or why there is none.
///
/// # Errors
/// [`presight::ErrorKind::System`] if threads cannot be started.
pub fn subjects(threads: usize) -> Result<(Vec<Subject>, Vec<String>)> {
    let (mut all, mut notes) = (Vec::new(), Vec::new());
    let threads = Threads::from(threads).started()?;
    // The hardware rasterizer would add nothing here: it shares setup, edges and depth with compute spans.
    for kind in EngineKind::ALL.into_iter().filter(|kind| *kind != EngineKind::GpuRender) {
        let mut engine = match kind.open(&threads) {
            Ok(engine) => engine,
            Err(e) if kind.needs_device() => {
                if kind == EngineKind::Gpu {
                    notes.push(match cfg!(feature = "gpu") {
                        true => format!("SKIPPED: the GPU engine: {}; see presight doctor", e.what()),
                        false => "SKIPPED: the GPU engine is not in this build".into(),
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
