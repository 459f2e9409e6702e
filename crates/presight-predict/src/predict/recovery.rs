//! Which engine predicts: its choice, its test on a tiny scene, and what takes over after a fault.

use super::{Backend, Prediction, Predictor, ProbeResults};
use crate::engine::{Device, Engine};
use crate::probe::{Probe, SensorKind};
use presight_model::error::{Error, ErrorKind, Result};
use presight_model::sensor::Sensor;
use presight_model::threads::Threads;
use presight_model::world::World;
use presight_render::cpu;
use presight_render::plan::{FramePlan, Images, Outputs, Raster, Stats};

impl Predictor {
    /// One-time checks of a device for a kind of sensor do not count towards a deadline.
    pub(super) fn get_ready(&mut self, sensor: &Sensor, outputs: Outputs) -> Result<()> {
        match self.prove(sensor, outputs) {
            Ok(()) => Ok(()),
            Err(fault) => self.recover(fault, true),
        }
    }

    /// Fulfils a request on the CPU engine instead of the automatically chosen one.
    pub(super) fn fill_on_stand_in(&mut self, world: &World, prediction: &mut Prediction) -> Result<()> {
        let engine = self.stand_in()?;
        let chosen = std::mem::replace(&mut self.engine, engine);
        let filled = self.fill(world, prediction);
        self.stand_in = Some(std::mem::replace(&mut self.engine, chosen));
        filled
    }

    /// Takes the CPU engine that stands in for the chosen one.
    pub(super) fn stand_in(&mut self) -> Result<Box<dyn Engine>> {
        match self.stand_in.take() {
            Some(engine) => Ok(engine),
            None => Ok(Box::new(cpu::CpuEngine::new(self.threads.clone())?)),
        }
    }

    /// Recovers from a fault: opens a lost device again (if `again` allows it) or, with an automatically chosen
    /// backend, switches to the CPU engine. Stops using a hardware rasterizer that draws wrong or loses the device.
    pub(super) fn recover(&mut self, fault: Error, again: bool) -> Result<()> {
        let Some(device) = self.engine.device() else { return Err(fault) };
        let may_be_raster = matches!(fault.kind(), ErrorKind::DeviceLost | ErrorKind::NoDevice);
        if again && may_be_raster && device.raster() == Raster::Render && device.take_compute().is_ok() {
            self.proven = ProbeResults::default();
            self.notice = Some(format!("compute spans took over from the hardware rasterizer: {fault}"));
            return Ok(());
        }
        if again && fault.kind() == ErrorKind::DeviceLost && device.reopen().is_ok() {
            self.proven = ProbeResults::default();
            self.notice = Some(format!("the GPU was opened again after this: {fault}"));
            return Ok(());
        }
        if self.backend != Backend::Auto {
            return Err(fault);
        }
        self.engine = Box::new(cpu::CpuEngine::new(self.threads.clone())?);
        self.notice = Some(format!("the CPU engine took over: {fault}"));
        Ok(())
    }

    /// [`Predictor::prove`], for a plan that draws polygons.
    pub(super) fn prove_for(&mut self, plan: &FramePlan) -> Result<()> {
        if plan.polygon_count == 0 { Ok(()) } else { self.prove(&plan.sensor, plan.drawn()) }
    }

    /// Verifies a device on a tiny scene before its first use for a kind of sensor. This costs little, because the
    /// following prediction uses the same pipelines.
    pub(super) fn prove(&mut self, sensor: &Sensor, outputs: Outputs) -> Result<()> {
        let task = SensorKind::of(sensor);
        if self.engine.device().is_none() || self.proven.images.contains(&task) {
            return Ok(());
        }
        let engine = &mut *self.engine;
        let draw = |plan: &FramePlan, images: &mut Images| engine.render(plan, images, &mut Stats::default());
        let report = Probe::new()?.run(task, outputs, draw)?;
        if let (Some(first), Some(device)) = (report.faults.first(), self.engine.device()) {
            let (n, all) = (report.fault, report.pixels);
            return Err(faulty(device, format!("draws {n} of {all} pixels of a probe wrong: {}", first.why)));
        }
        self.proven.images.push(task);
        Ok(())
    }
}

/// The error for a device that gives wrong results.
pub(super) fn faulty(device: &dyn Device, what: String) -> Error {
    let remedy = "update its driver, or use `Backend::Cpu`; see presight doctor";
    Error::new(ErrorKind::NoDevice, format!("{} {what}", device.adapter()), remedy)
}

/// The engine of a backend, with a notice if there is one. `open_gpu` opens a GPU; with `true` it accepts hardware
/// only.
pub(super) fn choose_engine(
    backend: Backend,
    threads: &Threads,
    open_gpu: impl Fn(&Threads, bool) -> Result<Box<dyn Engine>>,
) -> Result<(Box<dyn Engine>, Option<String>)> {
    let on_cpu = || Ok::<_, Error>(Box::new(cpu::CpuEngine::new(threads.clone())?));
    match backend {
        Backend::Cpu => Ok((on_cpu()?, None)),
        Backend::Gpu => Ok((open_gpu(threads, false)?, None)),
        Backend::Auto => match open_gpu(threads, true) {
            Ok(engine) => Ok((engine, None)),
            // No hardware GPU is the normal case on CI machines, so there is no notice.
            Err(e) if e.kind() == ErrorKind::NoDevice => Ok((on_cpu()?, None)),
            Err(e) => Ok((on_cpu()?, Some(format!("the CPU engine is used: {e}")))),
        },
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn without_an_adapter_auto_takes_the_cpu_and_gpu_is_an_error() {
        let fails =
            |kind: ErrorKind| move |_: &Threads, _: bool| Err(Error::new(kind, "no adapter", "use `Backend::Cpu`"));
        let threads = Threads::from(1);
        let (engine, notice) = choose_engine(Backend::Auto, &threads, fails(ErrorKind::NoDevice)).unwrap();
        assert_eq!((engine.name().as_str(), notice), ("cpu", None));
        let (engine, notice) = choose_engine(Backend::Auto, &threads, fails(ErrorKind::System)).unwrap();
        assert_eq!(engine.name(), "cpu");
        assert!(notice.is_some_and(|n| n.starts_with("the CPU engine is used: no adapter")));
        let refused = choose_engine(Backend::Gpu, &threads, fails(ErrorKind::NoDevice)).err();
        assert_eq!(refused.map(|e| e.kind()), Some(ErrorKind::NoDevice));
        assert!(choose_engine(Backend::Cpu, &threads, fails(ErrorKind::System)).is_ok());
    }
}
