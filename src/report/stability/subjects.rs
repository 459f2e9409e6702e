//! What is studied: engines, by what they draw and which boxes they give.

use crate::compare::Precision;
use crate::cpu;
use crate::error::Result;
use crate::features::{BoxOptions, FeaturePrediction, PlacedFeature, add_boxes};
use crate::geometry::Pose;
#[cfg(feature = "gpu")]
use crate::gpu;
use crate::plan::{EDGE_ON, FramePlan, Images, Stats};
use crate::reference;
use crate::sensor::Sensor;
use crate::world::World;

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
pub trait Subject {
    /// As the tables name it.
    fn name(&self) -> String;

    /// Whose bounds it is held to.
    fn precision(&self) -> Precision;

    /// Fills the asked images; the answer is how many polygons it left out as edge-on.
    ///
    /// # Errors
    /// The engine's.
    fn draw(&mut self, plan: &FramePlan, images: &mut Images) -> Result<usize>;

    /// Gives the features of a setting their boxes; `None` for engines that have no part in that.
    ///
    /// # Errors
    /// The engine's.
    fn boxes(&mut self, _setting: &BoxSetting) -> Result<Option<FeaturePrediction>> {
        Ok(None)
    }
}

/// The reference.
#[derive(Debug)]
pub struct Reference;

impl Subject for Reference {
    fn name(&self) -> String {
        "reference".into()
    }

    fn precision(&self) -> Precision {
        Precision::F64
    }

    fn draw(&mut self, plan: &FramePlan, images: &mut Images) -> Result<usize> {
        reference::render(plan, images).map(|counts| counts.edge_on)
    }
}

/// What an engine counted as edge-on.
fn edge_on(stats: &Stats) -> usize {
    stats.counts.iter().filter(|(name, _)| name == EDGE_ON).map(|(_, n)| *n as usize).sum()
}

/// The CPU engine.
pub struct Cpu(cpu::Engine);

impl Cpu {
    /// On so many threads, 0 for all cores.
    ///
    /// # Errors
    /// [`crate::ErrorKind::System`] if they cannot be started.
    pub fn new(threads: usize) -> Result<Self> {
        Ok(Self(cpu::Engine::new(threads)?))
    }
}

impl Subject for Cpu {
    fn name(&self) -> String {
        "cpu".into()
    }

    fn precision(&self) -> Precision {
        Precision::F64
    }

    fn draw(&mut self, plan: &FramePlan, images: &mut Images) -> Result<usize> {
        let mut stats = Stats::default();
        self.0.render(plan, images, &mut stats)?;
        Ok(edge_on(&stats))
    }

    fn boxes(&mut self, setting: &BoxSetting) -> Result<Option<FeaturePrediction>> {
        let mut prediction = setting.prediction.clone();
        let BoxSetting { world, sensor, world_from_sensor, placed, options, .. } = setting;
        add_boxes(&mut prediction, placed, world, sensor, world_from_sensor, options)?;
        Ok(Some(prediction))
    }
}

/// The GPU engine, on whatever adapter there is.
#[cfg(feature = "gpu")]
pub struct Gpu(gpu::Engine, &'static str);

#[cfg(feature = "gpu")]
impl Gpu {
    /// Both ways to keep the nearest: as the device likes it, and with 32-bit atomics and every stage on the device.
    ///
    /// # Errors
    /// [`crate::ErrorKind::NoDevice`] without an adapter.
    pub fn both() -> Result<[Self; 2]> {
        let open = |other: bool| {
            gpu::Engine::new(gpu::DeviceOptions { without_int64: other, all_on_device: other, ..Default::default() })
        };
        Ok([Self(open(false)?, "gpu"), Self(open(true)?, "gpu-32-bit")])
    }

    /// Adapter and driver.
    pub fn adapter(&self) -> String {
        self.0.adapter().to_string()
    }
}

#[cfg(feature = "gpu")]
impl Subject for Gpu {
    fn name(&self) -> String {
        self.1.into()
    }

    fn precision(&self) -> Precision {
        Precision::F32
    }

    fn draw(&mut self, plan: &FramePlan, images: &mut Images) -> Result<usize> {
        let mut stats = Stats::default();
        self.0.render(plan, images, &mut stats)?;
        Ok(edge_on(&stats))
    }

    fn boxes(&mut self, setting: &BoxSetting) -> Result<Option<FeaturePrediction>> {
        let mut prediction = setting.prediction.clone();
        let BoxSetting { world, sensor, world_from_sensor, placed, options, .. } = setting;
        self.0.add_boxes(&mut prediction, placed, world, sensor, world_from_sensor, options)?;
        Ok(Some(prediction))
    }
}

/// Of adapters that are programs.
#[cfg(feature = "gpu")]
const LEFT_TO_CPU: &str = "gpu: this adapter is a program that plays a GPU, on which the engine leaves regions of interest to the \
                           CPU: its rows of condition-box, stiff-box and indefinite are the CPU's; gpu-32-bit is asked to do on the \
                           device what it can. Image covariances (condition, stiff) are the CPU's on every device.";

/// Engines under study.
pub type Subjects = Vec<Box<dyn Subject>>;

/// Every engine of this build and machine, and what is to be said of them: which adapter, or that there is none.
///
/// # Errors
/// [`crate::ErrorKind::System`] if threads cannot be started.
pub fn subjects(threads: usize) -> Result<(Subjects, Vec<String>)> {
    let (mut all, mut notes): (Subjects, _) = (vec![Box::new(Reference)], Vec::new());
    all.push(Box::new(Cpu::new(threads)?));
    #[cfg(feature = "gpu")]
    match Gpu::both() {
        Ok(both) => {
            notes.push(format!("gpu: {}", both[0].adapter()));
            if !both[0].0.adapter().hardware {
                notes.push(LEFT_TO_CPU.into());
            }
            both.into_iter().for_each(|g| all.push(Box::new(g)));
        }
        Err(e) => notes.push(format!("SKIPPED: the GPU engine: {}; see presight doctor", e.what())),
    }
    #[cfg(not(feature = "gpu"))]
    notes.push("SKIPPED: the GPU engine: this build is without it".into());
    Ok((all, notes))
}
