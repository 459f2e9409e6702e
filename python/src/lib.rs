//! The module behind the Python package `presight`. Its users see `python/package/presight/_presight.pyi`.
//!
//! Rules: arguments are read while the interpreter is held; all work, and each lock, is apart from it (`errors::apart`), so that no
//! thread waits for another that waits for the interpreter. Classes are frozen. Nothing of a parent process is used after a fork
//! (`process`).

mod arrays;
mod errors;
mod learner;
mod many;
mod measured;
mod messages;
mod motion;
mod prediction;
mod predictor;
mod process;
mod scene;
mod sensor;

use errors::{Failed, apart};
use presight::measured::{Frame, Measurement};
use presight::predict::{BatchRequest, PoseCell, RangeLikelihood};
use pyo3::prelude::*;
use std::ffi::OsString;
use std::time::Instant;

/// Runs the command `presight` with these arguments, without the program's name, and returns its exit status.
#[pyfunction]
fn _command(py: Python<'_>, arguments: Vec<OsString>) -> PyResult<u8> {
    let all = std::iter::once(OsString::from("presight")).chain(arguments);
    apart(py, || Ok::<_, Failed>(presight_cli::run(all)))
}

/// Panics, for the test that no panic crosses the border.
#[pyfunction]
fn _panic(py: Python<'_>) -> PyResult<()> {
    apart(py, || panic!("on purpose"))
}

/// The seconds that `Predictor::batch` takes for these poses, to compare with: of ranges, or to weigh `sensed`.
#[pyfunction]
#[pyo3(signature = (predictor, scene, sensor, poses, sensed = None))]
fn _batch_seconds(
    py: Python<'_>,
    predictor: &Bound<'_, predictor::Predictor>,
    scene: &Bound<'_, scene::Scene>,
    sensor: &Bound<'_, sensor::Sensor>,
    poses: &Bound<'_, PyAny>,
    sensed: Option<&Bound<'_, PyAny>>,
) -> PyResult<f64> {
    let poses = arrays::poses_of(poses)?;
    let sensed = sensed.map(|sensed| arrays::numbers::<f32>(sensed, "sensed")).transpose()?;
    let (predictor, scene, sensor) = (predictor.get(), scene.get(), &sensor.get().0);
    apart(py, || {
        let world = scene.seen().world;
        let mut request = BatchRequest { images: Some(predictor::RANGE.into()), ..BatchRequest::default() };
        if let Some((_, ranges)) = sensed {
            let frame = Frame::new(0.0, sensor.clone(), Measurement::Range(ranges))?;
            let likelihood = Some(RangeLikelihood::new(&frame, PoseCell::default())?);
            request = BatchRequest { likelihood, ..BatchRequest::default() };
        }
        let start = Instant::now();
        predictor.with(|predictor| {
            predictor
                .batch(&world, sensor, poses.into_iter().map(presight::SensorPose::new), &request)?
                .try_for_each(|item| item.map(drop))?;
            Ok(())
        })?;
        Ok(start.elapsed().as_secs_f64())
    })
}

#[pymodule(gil_used = false)]
mod _presight {
    use super::{errors, learner, many, measured, messages, prediction, predictor, scene, sensor};
    use pyo3::prelude::*;

    #[pymodule_export]
    use super::_batch_seconds;
    #[pymodule_export]
    use super::_command;
    #[pymodule_export]
    use super::_panic;
    #[pymodule_export]
    use learner::Learner;
    #[pymodule_export]
    use many::Chunks;
    #[pymodule_export]
    use measured::{Frame, Localizer, Log, Step, Verdicts};
    #[pymodule_export]
    use messages::Messages;
    #[pymodule_export]
    use prediction::{Feature, Features, Layer, Prediction};
    #[pymodule_export]
    use predictor::Predictor;
    #[pymodule_export]
    use scene::{Scene, Store};
    #[pymodule_export]
    use sensor::Sensor;

    #[pymodule_init]
    fn init(module: &Bound<'_, PyModule>) -> PyResult<()> {
        let py = module.py();
        module.add("__version__", env!("CARGO_PKG_VERSION"))?;
        module.add("Error", py.get_type::<errors::Error>())?;
        module.add("DeviceError", py.get_type::<errors::DeviceError>())?;
        module.add("SystemFault", py.get_type::<errors::SystemFault>())?;
        module.add("DeadlineError", py.get_type::<errors::DeadlineError>())?;
        module.add("Notice", py.get_type::<errors::Notice>())
    }
}
