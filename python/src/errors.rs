//! Errors as Python knows them, notices as warnings, and work that runs without the interpreter.

use presight::tools;
use presight::{Error as Ours, ErrorKind};
use pyo3::exceptions::{PyMemoryError, PyRuntimeError, PyUserWarning, PyValueError};
use pyo3::prelude::*;
use pyo3::{PyTypeInfo, create_exception};
use std::any::Any;
use std::ffi::CString;
use std::panic::{AssertUnwindSafe, catch_unwind};

create_exception!(
    presight,
    Error,
    PyValueError,
    "A file or a value is not valid. The text is one line: file, place, fault and remedy; `kind`, `file`, `place` and `remedy`\n\
     hold its parts.\n\n\
     >>> import presight\n\
     >>> try:\n\
     ...     presight.Sensor.load(\"vlp-17\")\n\
     ... except presight.Error as e:\n\
     ...     print(e.kind, \"|\", str(e).split(\";\")[0])\n\
     usage | \"vlp-17\" is neither a preset nor a sensor file"
);
create_exception!(
    presight,
    DeviceError,
    PyRuntimeError,
    "There is no device for the backend, or it was lost. Attributes as `Error`."
);
create_exception!(
    presight,
    SystemFault,
    PyRuntimeError,
    "The operating system refused, for example a full disk, or presight itself is at fault. Attributes as `Error`."
);
create_exception!(
    presight,
    DeadlineError,
    PyRuntimeError,
    "Nothing can be predicted within `deadline_ms`. Attributes as `Error`."
);
create_exception!(
    presight,
    Notice,
    PyUserWarning,
    "The category of presight's warnings: parts of inputs and predictions that were left out."
);

/// The library's words for arguments, and Python's words.
const WORDS: &[(&str, &str)] = &[
    ("`BagOptions::base`", "base="),
    ("`BagOptions::mount`", "mount="),
    ("`BagOptions::reflector`", "reflector="),
    ("`BagOptions::topic`", "topic="),
    ("`Backend::Cpu`", "backend=\"cpu\""),
    ("`Existing::Replace`", "replace"),
    ("`ImportOptions::scale`", "scale="),
    ("`ImportOptions::up`", "up="),
    ("`PoseFrame::Optical`", "pose_frame=\"optical\""),
    ("`PoseOf::Robot`", "pose_of=\"robot\""),
    ("`SceneOptions::exclude`", "exclude="),
    ("`rectified: true`", "rectified=True"),
    ("(Request::with_features)", "(layers=)"),
    ("start fewer `Threads`", "lower threads="),
];

/// What ends work: an error of the library, or an exception such as KeyboardInterrupt.
pub enum Failed {
    Ours(Ours),
    Python(PyErr),
}

impl From<Ours> for Failed {
    fn from(e: Ours) -> Self {
        Self::Ours(e)
    }
}

impl From<PyErr> for Failed {
    fn from(e: PyErr) -> Self {
        Self::Python(e)
    }
}

/// Runs work without the interpreter, so that other Python threads go on meanwhile. A panic becomes a `SystemFault`.
pub fn apart<T: Send>(py: Python<'_>, work: impl FnOnce() -> Result<T, Failed> + Send) -> PyResult<T> {
    match py.detach(|| catch_unwind(AssertUnwindSafe(work))) {
        Ok(Ok(done)) => Ok(done),
        Ok(Err(Failed::Ours(e))) => Err(raised(py, &e)),
        Ok(Err(Failed::Python(e))) => Err(e),
        Err(panic) => Err(raised(py, &of_panic(&*panic))),
    }
}

fn of_panic(panic: &(dyn Any + Send)) -> Ours {
    let text = panic.downcast_ref::<&str>().copied().map(str::to_owned);
    let text = text.or_else(|| panic.downcast_ref::<String>().cloned()).unwrap_or_default();
    Ours::new(ErrorKind::System, format!("presight is at fault: {text}"), "report this line, and what you called")
}

/// The exception for an error of the library.
pub fn raised(py: Python<'_>, e: &Ours) -> PyErr {
    let (text, kind) = (named(&e.to_string()), e.kind());
    let (exception, kind) = match kind {
        ErrorKind::Invalid => (Error::new_err(text), "invalid"),
        ErrorKind::Unsupported => (Error::new_err(text), "unsupported"),
        ErrorKind::Usage => (Error::new_err(text), "usage"),
        ErrorKind::NoDevice => (DeviceError::new_err(text), "no_device"),
        ErrorKind::DeviceLost => (DeviceError::new_err(text), "device_lost"),
        ErrorKind::DeviceMemory => (DeviceError::new_err(text), "device_memory"),
        ErrorKind::Deadline => (DeadlineError::new_err(text), "deadline"),
        _ => (SystemFault::new_err(text), "system"),
    };
    let value = exception.value(py);
    let file = e.file().map(|file| file.to_string_lossy().into_owned());
    let done = value
        .setattr("kind", kind)
        .and_then(|()| value.setattr("file", file))
        .and_then(|()| value.setattr("place", e.place()))
        .and_then(|()| value.setattr("remedy", named(e.remedy())));
    match done {
        Ok(()) => exception,
        Err(e) => e,
    }
}

/// A usage error of an argument.
pub fn usage(py: Python<'_>, argument: &str, what: impl Into<String>, remedy: impl Into<String>) -> PyErr {
    raised(py, &Ours::usage(what, remedy).at(argument))
}

/// A text of the library in Python's words.
fn named(text: &str) -> String {
    WORDS.iter().fold(text.to_owned(), |text, (ours, python)| text.replace(ours, python))
}

/// Raises notices as warnings.
pub fn warn<'a>(py: Python<'_>, notices: impl IntoIterator<Item = &'a String>) -> PyResult<()> {
    for notice in notices {
        let text = CString::new(named(notice).replace('\0', " ")).unwrap_or_default();
        PyErr::warn(py, &Notice::type_object(py), &text, 1)?;
    }
    Ok(())
}

/// Checks that this many bytes are there before an array of them is begun.
pub fn room_for(bytes: Option<u64>) -> PyResult<()> {
    let remedy = "take fewer poses at a time: predict_chunks gives them in parts";
    match bytes.filter(|bytes| *bytes <= isize::MAX as u64) {
        None => Err(PyMemoryError::new_err(format!("the arrays are larger than any memory; {remedy}"))),
        Some(bytes) => {
            tools::require_memory(bytes).map_err(|e| PyMemoryError::new_err(format!("{}; {remedy}", e.what())))
        }
    }
}
