//! Batches into arrays, a few poses at a time, so that signals are seen.

use super::arrays::{is_aligned, outputs_of, shape_of};
use super::errors::{Failed, apart, raised, room_for, usage};
use super::predictor::{Predictor, RANGE};
use numpy::{Element, PyArrayDyn, PyArrayMethods, PyReadwriteArrayDyn, PyUntypedArrayMethods};
use presight::measured::ScanMotion;
use presight::predict::{Batch, BatchItem, BatchRequest, Samples};
use presight::{Images, Output, Outputs, Sensor, SensorPose, World};
use pyo3::prelude::*;
use pyo3::types::PyDict;
use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};
use std::vec::IntoIter;

/// Signals are looked at this often.
const LOOK: Duration = Duration::from_millis(50);
/// A chunk takes about so long.
const CHUNK: f64 = 0.1;
/// Bytes of the images of a part of `predict_chunks`.
const PART: usize = 64 << 20;

/// The outputs of a batch, which predicts no features.
pub fn outputs(given: Option<&Bound<'_, PyAny>>) -> PyResult<Outputs> {
    let Some(given) = given else { return Ok(RANGE) };
    let outputs = outputs_of(Some(given))?;
    if outputs.has(Output::FeatureId) {
        return Err(usage(given.py(), "outputs", "feature_id: a batch predicts no features", "drop it"));
    }
    Ok(outputs)
}

/// Runs a batch and hands over its items in order. Chunks grow until they take a tenth of a second.
pub fn run(mut batch: Batch<'_, IntoIter<SensorPose>>, mut each: impl FnMut(BatchItem)) -> Result<(), Failed> {
    let most = batch.chunk();
    let (mut chunk, mut left, mut looked, mut begun) = (1, 1, Instant::now(), Instant::now());
    batch.set_chunk(chunk);
    while let Some(item) = batch.next() {
        each(item?);
        left -= 1;
        if left > 0 {
            continue;
        }
        let pace = begun.elapsed().as_secs_f64() / chunk as f64;
        chunk = ((CHUNK / pace.max(1e-9)) as usize).clamp(1, most).min(8 * chunk);
        batch.set_chunk(chunk);
        left = chunk;
        if looked.elapsed() > LOOK {
            Python::attach(|py| py.check_signals())?;
            looked = Instant::now();
        }
        begun = Instant::now();
    }
    Ok(())
}

/// The arrays that a batch fills.
pub struct Targets<'py> {
    outputs: Outputs,
    count: usize,
    arrays: Bound<'py, PyDict>,
}

/// A borrowed array.
enum Borrowed<'py> {
    Floats(PyReadwriteArrayDyn<'py, f32>),
    Ids(PyReadwriteArrayDyn<'py, u32>),
}

/// The images of one output in a borrowed array. Each is written once, by the thread that drew it.
enum Places<'a> {
    Floats(Vec<Mutex<&'a mut [f32]>>),
    Ids(Vec<Mutex<&'a mut [u32]>>),
}

impl<'a> Places<'a> {
    fn of(borrowed: &'a mut Borrowed<'_>, count: usize) -> Result<Self, numpy::AsSliceError> {
        fn each<T>(all: &mut [T], count: usize) -> Vec<Mutex<&mut [T]>> {
            all.chunks_exact_mut((all.len() / count).max(1)).map(Mutex::new).collect()
        }
        Ok(match borrowed {
            Borrowed::Floats(array) => Self::Floats(each(array.as_slice_mut()?, count)),
            Borrowed::Ids(array) => Self::Ids(each(array.as_slice_mut()?, count)),
        })
    }

    fn put(&self, index: usize, image: Samples<'_>) {
        fn copy<T: Copy>(to: &Mutex<&mut [T]>, image: &[T]) {
            to.lock().unwrap_or_else(PoisonError::into_inner).copy_from_slice(image);
        }
        match (self, image) {
            (Self::Floats(all), Samples::Floats(image)) => copy(&all[index], image),
            (Self::Floats(all), Samples::Vectors(image)) => copy(&all[index], image.as_flattened()),
            (Self::Ids(all), Samples::Ids(image)) => copy(&all[index], image),
            _ => {}
        }
    }

    /// The first and one past the last address.
    fn span(&self) -> (usize, usize) {
        fn span<T>(all: &[Mutex<&mut [T]>]) -> (usize, usize) {
            let ends = |place: &Mutex<&mut [T]>| {
                let range = place.lock().unwrap_or_else(PoisonError::into_inner).as_ptr_range();
                (range.start.addr(), range.end.addr())
            };
            (all.first().map_or(0, |first| ends(first).0), all.last().map_or(0, |last| ends(last).1))
        }
        match self {
            Self::Floats(all) => span(all),
            Self::Ids(all) => span(all),
        }
    }
}

fn borrowed<'py, T: Element>(
    array: &Bound<'py, PyAny>,
    name: &str,
    shape: &[usize],
) -> PyResult<PyReadwriteArrayDyn<'py, T>> {
    let py = array.py();
    let remedy = format!("give a C-contiguous, writable array of {} and shape {shape:?}", numpy::dtype::<T>(py).str()?);
    let wrong = |what: String| usage(py, &format!("out[{name:?}]"), what, remedy.clone());
    let Ok(typed) = array.cast::<PyArrayDyn<T>>() else {
        return Err(wrong(match array.getattr("dtype") {
            Ok(dtype) => format!("its dtype is {}", dtype.str()?),
            Err(_) => "not a valid array".into(),
        }));
    };
    if typed.shape() != shape {
        return Err(wrong(format!("its shape is {:?}", typed.shape())));
    }
    if !typed.is_c_contiguous() || !is_aligned(array)? {
        return Err(wrong("is not C-contiguous and aligned".into()));
    }
    typed.try_readwrite().map_err(|e| wrong(format!("cannot be written: {e}")))
}

impl<'py> Targets<'py> {
    pub fn new(
        py: Python<'py>,
        count: usize,
        sensor: &Sensor,
        outputs: Outputs,
        out: Option<&Bound<'py, PyDict>>,
    ) -> PyResult<Self> {
        presight::Request::of(outputs).check(sensor).map_err(|e| raised(py, &e))?;
        if let Some(out) = out {
            let known = |name: &str| outputs.iter().any(|output| output.name() == name);
            for name in out.keys() {
                if !known(&name.extract::<String>()?) {
                    return Err(usage(py, "out", format!("{} is not requested", name.repr()?), "name it in outputs"));
                }
            }
            return Ok(Self { outputs, count, arrays: out.clone() });
        }
        let pixels = u64::from(sensor.width()) * u64::from(sensor.height());
        room_for((count as u64).checked_mul(pixels).and_then(|n| n.checked_mul(4 * outputs.numbers() as u64)))?;
        let (numpy, arrays) = (py.import("numpy")?, PyDict::new(py));
        for output in outputs.iter() {
            let shape = [vec![count], shape_of((sensor.width(), sensor.height()), output)].concat();
            let dtype = if output.is_of_ids() { "uint32" } else { "float32" };
            arrays.set_item(output.name(), numpy.call_method1("empty", (shape, dtype))?)?;
        }
        Ok(Self { outputs, count, arrays })
    }

    /// Borrows the arrays, predicts into them, and gives them.
    pub fn fill(
        self,
        py: Python<'py>,
        predictor: &Predictor,
        world: &World,
        sensor: &Sensor,
        poses: Vec<SensorPose>,
        motion: Option<ScanMotion>,
    ) -> PyResult<Bound<'py, PyDict>> {
        let mut held = Vec::new();
        for output in self.outputs.iter() {
            let name = output.name();
            let missing = || usage(py, "out", format!("there is no array {name:?}"), "give one for each of outputs");
            let array = self.arrays.get_item(name)?.ok_or_else(missing)?;
            let shape = [vec![self.count], shape_of((sensor.width(), sensor.height()), output)].concat();
            held.push((
                output,
                match output.is_of_ids() {
                    true => Borrowed::Ids(borrowed(&array, name, &shape)?),
                    false => Borrowed::Floats(borrowed(&array, name, &shape)?),
                },
            ));
        }
        let contiguous = |e: numpy::AsSliceError| usage(py, "out", e.to_string(), "give C-contiguous arrays");
        let mut places = Vec::new();
        for (output, borrowed) in &mut held {
            places.push((*output, Places::of(borrowed, self.count).map_err(contiguous)?));
        }
        let mut spans: Vec<_> = places.iter().map(|(output, places)| (places.span(), output.name())).collect();
        spans.sort_unstable();
        if let Some([(_, a), (_, b)]) = spans.array_windows().find(|[(a, _), (b, _)]| b.0 < a.1) {
            let remedy = "give arrays that share no memory";
            return Err(usage(py, "out", format!("{a:?} and {b:?} overlap"), remedy));
        }
        let motions = motion.into_iter().collect();
        let request = BatchRequest { images: Some(self.outputs.into()), motions, ..BatchRequest::default() };
        let show = |index: usize, images: &Images| {
            for (output, places) in &places {
                if let Some(image) = images.samples(*output) {
                    places.put(index, image);
                }
            }
        };
        apart(py, || {
            predictor.with(|predictor| run(predictor.batch(world, sensor, poses, &request)?.shown_to(&show), drop))
        })?;
        Ok(self.arrays)
    }
}

/// The parts of a batch, one by one: an iterator of dicts.
#[pyclass(frozen, module = "presight")]
pub struct Chunks {
    predictor: Py<Predictor>,
    world: World,
    sensor: Sensor,
    motion: Option<ScanMotion>,
    outputs: Outputs,
    poses: Vec<SensorPose>,
    size: usize,
    next: Mutex<usize>,
}

impl Chunks {
    pub fn new(
        predictor: Py<Predictor>,
        (world, sensor, motion): (World, Sensor, Option<ScanMotion>),
        outputs: Outputs,
        poses: Vec<SensorPose>,
        size: Option<usize>,
    ) -> Self {
        let bytes = 4 * outputs.numbers() * sensor.width() as usize * sensor.height() as usize;
        let size = size.unwrap_or((PART / bytes.max(1)).max(1));
        Self { predictor, world, sensor, motion, outputs, poses, size, next: Mutex::new(0) }
    }
}

#[pymethods]
impl Chunks {
    fn __iter__(slf: Py<Self>) -> Py<Self> {
        slf
    }

    fn __next__<'py>(&self, py: Python<'py>) -> PyResult<Option<Bound<'py, PyDict>>> {
        let part = apart(py, || {
            let mut next = self.next.lock().unwrap_or_else(PoisonError::into_inner);
            let from = *next;
            *next = self.poses.len().min(from + self.size);
            Ok::<_, Failed>(self.poses[from..*next].to_vec())
        })?;
        if part.is_empty() {
            return Ok(None);
        }
        let targets = Targets::new(py, part.len(), &self.sensor, self.outputs, None)?;
        targets.fill(py, self.predictor.get(), &self.world, &self.sensor, part, self.motion.clone()).map(Some)
    }
}
