//! Tests the engines of this machine, and advises which to use and what to install.

#[cfg(feature = "gpu")]
mod advice;

#[cfg(feature = "gpu")]
use advice::{AdapterState, AdapterTrial, Machine};
use presight_model::error::Result;
use presight_model::threads::Threads;
use presight_predict::engine::{Engine, EngineKind};
#[cfg(feature = "gpu")]
use presight_predict::gpu::{self, DeviceOptions, adapters, preferred, testing};
use presight_predict::probe::{Probe, SensorKind};
use presight_render::cpu::Vectors;
#[cfg(feature = "gpu")]
use presight_render::plan::Raster;
use presight_render::plan::{Outputs, Stats};
use std::fmt::Write;

/// Draws a small scene with every engine of this machine and compares the images with the reference. Returns a report
/// for people, and whether all images are right and each adapter that would be used can be opened.
///
/// # Errors
/// [`presight_model::ErrorKind::System`] if the threads of the CPU engine cannot be started.
pub fn examine_engines() -> Result<(String, bool)> {
    let probe = Probe::new()?;
    let threads = std::thread::available_parallelism().map_or(1, usize::from);
    let mut text = format!("CPU engine, {threads} threads, {}\n", std::env::consts::ARCH);
    let _ = writeln!(text, "  tiles of rays are searched in {}", Vectors::best().name());
    let mut sound = check(&probe, &mut text, &mut *EngineKind::Cpu.open(&Threads::SHARED)?, &SensorKind::ALL);
    sound &= gpus(&probe, &mut text);
    Ok((text, sound))
}

/// Appends one line per task to `text`. Returns true if all images are correct.
fn check(probe: &Probe, text: &mut String, engine: &mut dyn Engine, tasks: &[SensorKind]) -> bool {
    let mut sound = true;
    for &task in tasks {
        let drawn = probe.run(task, Outputs::ALL, |plan, images| engine.render(plan, images, &mut Stats::default()));
        let verdict = match drawn {
            Ok(report) if report.fault == 0 => {
                format!("right: {} of {} pixels equal the reference", report.same, report.pixels)
            }
            Ok(report) => {
                sound = false;
                let first = report.faults.first().map(|f| f.why.as_str()).unwrap_or_default();
                format!("WRONG: {} of {} pixels; the first: {first}", report.fault, report.pixels)
            }
            Err(e) => {
                sound = false;
                format!("FAILED: {e}")
            }
        };
        let _ = writeln!(text, "  {:16}{verdict}", task.name());
    }
    sound
}

#[cfg(not(feature = "gpu"))]
fn gpus(_: &Probe, text: &mut String) -> bool {
    text.push_str("\n--backend auto takes the CPU engine: this presight was built without the cargo feature gpu\n");
    true
}

#[cfg(feature = "gpu")]
fn gpus(probe: &Probe, text: &mut String) -> bool {
    let mut tried = Vec::new();
    for (i, adapter) in adapters().iter().enumerate() {
        let kind = if adapter.hardware { "a GPU" } else { "a software GPU that runs on the CPU" };
        let _ = writeln!(text, "\n{adapter}: {kind}");
        let open = |without_int64, raster| {
            let options = DeviceOptions { adapter: Some(i), without_int64, raster, ..DeviceOptions::default() };
            testing::open(options, testing::Setup::ALL_ON_DEVICE)
        };
        tried.push(AdapterTrial { hardware: adapter.hardware, state: device(probe, text, open) });
    }
    // Variables of the Vulkan loader; VK_DRIVER_FILES is the newer one and takes precedence.
    let set = |name: &'static str| std::env::var(name).ok().map(|value| format!("{name}={value}"));
    let drivers = ["VK_DRIVER_FILES", "VK_ICD_FILENAMES"].into_iter().find_map(set);
    let disabled = set("VK_LOADER_DRIVERS_DISABLE");
    let machine = Machine { tried, auto: preferred(true), any: preferred(false), drivers, disabled };
    let _ = writeln!(text, "\n{}", machine.advice());
    machine.is_sound()
}

/// Tests one device: with 64-bit atomics, if it has them, and without; each with both rasterizers.
#[cfg(feature = "gpu")]
fn device(probe: &Probe, text: &mut String, open: impl Fn(bool, Raster) -> Result<gpu::GpuEngine>) -> AdapterState {
    let mut sound = true;
    for without_int64 in [false, true] {
        let mut engine = match open(without_int64, Raster::Compute) {
            Ok(engine) => engine,
            Err(e) => {
                let _ = writeln!(text, "  not usable: {e}");
                return AdapterState::Unusable;
            }
        };
        let can = engine.abilities();
        if !without_int64 {
            let _ = writeln!(
                text,
                "  64-bit atomics {}, time stamps {}, buffers up to {} MiB, rasterizes by {}{}",
                yes(can.int64_atomics),
                yes(can.timestamps),
                can.largest_binding >> 20,
                Raster::default(),
                if can.render { ", with --raster render by hardware" } else { " only" }
            );
        }
        let passes = if can.int64_atomics { "by 64-bit atomics" } else { "in two passes of 32 bits" };
        let _ = writeln!(text, "  nearest surface {passes}:");
        sound &= check(probe, text, &mut engine, &SensorKind::ALL);
        if can.render {
            let _ = writeln!(text, "  with the hardware rasterizer:");
            match open(without_int64, Raster::Render) {
                Ok(mut engine) => sound &= check(probe, text, &mut engine, &[SensorKind::Camera]),
                Err(e) => {
                    let _ = writeln!(text, "  not usable: {e}");
                    sound = false;
                }
            }
        }
        if !without_int64 {
            let _ = writeln!(text, "  features:");
            sound &= features_of(probe, text, &mut engine);
        }
        if !can.int64_atomics {
            break;
        }
    }
    if sound { AdapterState::Right } else { AdapterState::Wrong }
}

/// Appends one line per task to `text`: the device's results for features, which images do not show.
#[cfg(feature = "gpu")]
fn features_of(probe: &Probe, text: &mut String, engine: &mut gpu::GpuEngine) -> bool {
    let mut sound = true;
    for task in SensorKind::ALL {
        let features = probe.occlusion(task, engine).and_then(|seen| Ok((seen, probe.regions(task, engine)?)));
        let verdict = match features {
            Ok((seen, regions)) => {
                // No region may be wrong.
                let right = seen.is_sound() && regions.wrong == 0;
                sound &= right;
                format!(
                    "{}: {} of {} points decided, {} wrong; {} of {} regions of interest made, {} wrong",
                    if right { "right" } else { "WRONG" },
                    seen.answered,
                    seen.all,
                    seen.wrong,
                    regions.answered,
                    regions.all,
                    regions.wrong
                )
            }
            Err(e) => {
                sound = false;
                format!("FAILED: {e}")
            }
        };
        let _ = writeln!(text, "  {:16}{verdict}", task.name());
    }
    sound
}

#[cfg(feature = "gpu")]
fn yes(able: bool) -> &'static str {
    if able { "yes" } else { "no" }
}

#[cfg(test)]
mod tests {
    use super::*;
    use presight_model::error::Error;

    use presight_render::plan::{FramePlan, Images};
    use presight_render::verify::Precision;

    /// The CPU engine with corrupted images or errors.
    struct Faulty(Box<dyn Engine>, fn(&mut Images) -> Result<()>);

    impl Engine for Faulty {
        fn name(&self) -> String {
            "faulty".into()
        }

        fn precision(&self) -> Precision {
            self.0.precision()
        }

        fn render(&mut self, plan: &FramePlan, images: &mut Images, stats: &mut Stats) -> Result<()> {
            self.0.render(plan, images, stats)?;
            self.1(images)
        }
    }

    #[test]
    fn an_engine_that_draws_wrong_is_named() {
        let probe = Probe::new().unwrap();
        let checked = |spoil: fn(&mut Images) -> Result<()>| {
            let mut text = String::new();
            let engine = EngineKind::Cpu.open(&1.into()).unwrap();
            (check(&probe, &mut text, &mut Faulty(engine, spoil), &SensorKind::ALL), text)
        };
        let (sound, text) = checked(|_| Ok(()));
        assert!(sound && text.matches("right: ").count() == 4, "{text}");
        let (sound, text) = checked(|images| {
            images.range.iter_mut().for_each(|r| *r += 0.01);
            Ok(())
        });
        assert!(!sound && text.matches("WRONG: ").count() == 4, "{text}");
        let (sound, text) = checked(|_| Err(Error::invalid("no", "none")));
        assert!(!sound && text.matches("FAILED: no").count() == 4, "{text}");
    }
}
