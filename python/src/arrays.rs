//! NumPy arrays in and out. What comes in is copied at once, what goes out keeps its buffer.

use super::errors::{raised, usage, warn};
use glam::{DMat3, DQuat, DVec3, Vec3};
use numpy::{Element, PyArray1, PyArrayDyn, PyArrayMethods, PyUntypedArrayMethods};
use presight::predict::SamplesMut;
use presight::sensor::{ExternalPose, PoseFrame, PoseOf, WorldFrame};
use presight::tools;
use presight::{Error, Images, InWorld, Output, Outputs, Pose, PoseCovariance, Result};
use pyo3::prelude::*;
use pyo3::types::{PyString, PyTuple};

/// Makes an array of this shape of a vector, without a copy: C order, writable, its own owner.
pub fn array<'py, T: Element>(py: Python<'py>, values: Vec<T>, shape: &[usize]) -> PyResult<Bound<'py, PyAny>> {
    Ok(PyArray1::from_vec(py, values).reshape(shape)?.into_any())
}

/// The shape and the numbers of an array, or of what NumPy makes one of.
pub fn numbers<T: Element + Copy>(given: &Bound<'_, PyAny>, argument: &str) -> PyResult<(Vec<usize>, Vec<T>)> {
    let py = given.py();
    let array = match given.cast::<PyArrayDyn<T>>() {
        Ok(array) if array.is_c_contiguous() && is_aligned(array)? => array.clone(),
        _ => converted(given, argument)?,
    };
    let shape = array.shape().to_vec();
    let held = array.try_readonly().map_err(|e| usage(py, argument, e.to_string(), "pass a copy of the array"))?;
    let values = held.as_slice().map_err(|e| usage(py, argument, e.to_string(), "pass a copy of the array"))?;
    Ok((shape, values.to_vec()))
}

/// An array of real numbers as one of this type; byte order and strides may be any.
fn converted<'py, T: Element>(given: &Bound<'py, PyAny>, argument: &str) -> PyResult<Bound<'py, PyArrayDyn<T>>> {
    let py = given.py();
    let wrong = |what: String| usage(py, argument, what, "give numbers: a list, or an array of floats or integers");
    let numpy = py.import("numpy")?;
    let array = numpy.call_method1("asarray", (given,)).map_err(|e| wrong(format!("not a valid array: {e}")))?;
    let dtype = array.getattr("dtype")?;
    let kind: String = dtype.getattr("kind")?.extract()?;
    if !["f", "i", "u"].contains(&kind.as_str()) {
        return Err(wrong(format!("its dtype is {}, not a real number", dtype.str()?)));
    }
    // A copy is aligned.
    let array = numpy.call_method1("array", (array, numpy::dtype::<T>(py)))?;
    let array = numpy.call_method1("ascontiguousarray", (array,))?;
    array.cast_into::<PyArrayDyn<T>>().map_err(|e| wrong(e.to_string()))
}

/// True if the numbers lie where the processor expects them.
pub fn is_aligned(array: &Bound<'_, PyAny>) -> PyResult<bool> {
    array.getattr("flags")?.getattr("aligned")?.extract()
}

fn shape_words(shape: &[usize]) -> String {
    let sides: Vec<String> = shape.iter().map(usize::to_string).collect();
    format!("the shape is ({}{})", sides.join(", "), if sides.len() == 1 { "," } else { "" })
}

const POSE: &str = "give (7,) x y z qx qy qz qw, (6,) x y z roll pitch yaw in degrees, or (4, 4)";

/// The conventions of poses, as the command's flags name them.
#[derive(Clone, Copy)]
pub struct Conventions {
    frame: PoseFrame,
    of: PoseOf,
    world: WorldFrame,
}

impl Conventions {
    pub fn new(py: Python<'_>, frame: &str, of: &str, world: &str) -> PyResult<Self> {
        let frame = match frame {
            "body" => PoseFrame::Body,
            "optical" => PoseFrame::Optical,
            _ => return Err(usage(py, "pose_frame", format!("{frame:?}"), "give \"body\" or \"optical\"")),
        };
        let of = match of {
            "sensor" => PoseOf::Sensor,
            "robot" => PoseOf::Robot,
            _ => return Err(usage(py, "pose_of", format!("{of:?}"), "give \"sensor\" or \"robot\"")),
        };
        let world = match world {
            "z-up" => WorldFrame::ZUp,
            "gltf" => WorldFrame::Gltf,
            _ => return Err(usage(py, "world_frame", format!("{world:?}"), "give \"z-up\" or \"gltf\"")),
        };
        Ok(Self { frame, of, world })
    }

    pub fn given(self, pose: Pose) -> ExternalPose {
        ExternalPose::new(pose).with_frame(self.frame).with_of(self.of).with_world(self.world)
    }
}

/// A pose of six or seven numbers, or of a matrix.
pub fn pose_of(given: &Bound<'_, PyAny>, argument: &str) -> PyResult<Pose> {
    let (shape, values) = numbers::<f64>(given, argument)?;
    match shape[..] {
        [6] | [7] | [4, 4] => {
            warn_of_radians(given.py(), &values, values.len())?;
            pose(&values).map_err(|e| raised(given.py(), &e.at(argument)))
        }
        _ => Err(usage(given.py(), argument, shape_words(&shape), POSE)),
    }
}

/// Poses along the first axis.
pub fn poses_of(given: &Bound<'_, PyAny>) -> PyResult<Vec<Pose>> {
    let py = given.py();
    let (shape, values) = numbers::<f64>(given, "poses")?;
    let size = match shape[..] {
        [_, size @ (6 | 7)] => size,
        [_, 4, 4] => 16,
        _ => return Err(usage(py, "poses", shape_words(&shape), format!("{POSE}, with one axis in front"))),
    };
    if values.is_empty() {
        return Err(usage(py, "poses", "there is no pose", "give at least one"));
    }
    warn_of_radians(py, &values, size)?;
    let one = |(i, numbers)| pose(numbers).map_err(|e| raised(py, &e.at(format!("pose {i}"))));
    values.chunks(size).enumerate().map(one).collect()
}

/// Warns if the angles of poses of six numbers are likely in radians.
fn warn_of_radians(py: Python<'_>, values: &[f64], size: usize) -> PyResult<()> {
    if size != 6 {
        return Ok(());
    }
    // A sample says it: millions of poses must not wait for it.
    let every = values.len() / 60_000 + 1;
    let angles: Vec<f64> = values.chunks(6).step_by(every).flat_map(|pose| pose[3..].iter().copied()).collect();
    warn(py, &tools::notice_of_radians(&angles))
}

fn pose(numbers: &[f64]) -> Result<Pose> {
    let at = |i: usize| DVec3::new(numbers[i], numbers[i + 1], numbers[i + 2]);
    match numbers.len() {
        6 => {
            let [roll, pitch, yaw] = at(3).to_array().map(f64::to_radians);
            let pose = Pose::from_xyz_rpy(at(0), roll, pitch, yaw);
            pose.check().map(|()| pose)
        }
        7 => Pose::new(at(0), DQuat::from_xyzw(numbers[3], numbers[4], numbers[5], numbers[6])),
        _ => {
            let columns = [0, 1, 2].map(|c| DVec3::new(numbers[c], numbers[4 + c], numbers[8 + c]));
            let turn = DMat3::from_cols(columns[0], columns[1], columns[2]);
            // A matrix of f32 is a rotation within this.
            let off = (turn * turn.transpose() - DMat3::IDENTITY).to_cols_array();
            let is_rotation = off.iter().all(|x| x.abs() <= 1e-5) && turn.determinant() > 0.0;
            if !is_rotation || numbers[12..] != [0.0, 0.0, 0.0, 1.0] {
                let remedy = "give a rotation and a translation above the row 0 0 0 1, without scale or mirror";
                return Err(Error::usage("the matrix is not a rigid transform", remedy));
            }
            Pose::new(DVec3::new(numbers[3], numbers[7], numbers[11]), DQuat::from_mat3(&turn))
        }
    }
}

/// x y z qx qy qz qw.
pub fn pose_numbers(pose: &Pose) -> [f64; 7] {
    let (t, q) = (pose.translation, pose.rotation);
    [t.x, t.y, t.z, q.x, q.y, q.z, q.w]
}

/// A covariance of six standard deviations, metres and degrees, or of a matrix, metres and radians.
pub fn covariance_of(given: Option<&Bound<'_, PyAny>>) -> PyResult<PoseCovariance<InWorld>> {
    let Some(given) = given else { return Ok(PoseCovariance::default()) };
    let (py, argument) = (given.py(), "pose_cov");
    let (shape, values) = numbers::<f64>(given, argument)?;
    match shape[..] {
        [6] if values.iter().all(|s| *s >= 0.0 && s.is_finite()) => {
            let sigma = |i: usize| if i < 3 { values[i] } else { values[i].to_radians() };
            Ok(PoseCovariance::from_sigmas(std::array::from_fn(sigma)))
        }
        [6] => Err(usage(py, argument, "a standard deviation is negative or not finite", "give 0 or more")),
        [6, 6] => PoseCovariance::from_row_major(&values).map_err(|e| raised(py, &e.at(argument))),
        _ => {
            let remedy = "give (6,) standard deviations in metres and degrees, or (6, 6) in metres and radians";
            Err(usage(py, argument, shape_words(&shape), remedy))
        }
    }
}

/// Vertices and faces of a mesh: a pair of arrays, or an object that has them, as trimesh's and Open3D's do.
pub fn mesh_of(given: &Bound<'_, PyAny>, name: &str) -> PyResult<(Vec<Vec3>, Vec<[u32; 3]>)> {
    let (py, place) = (given.py(), format!("mesh {name:?}"));
    let remedy = "give (V, F): (n, 3) metres and (m, 3) numbers of vertices";
    let faces = ["faces", "triangles"].into_iter().find_map(|faces| given.getattr(faces).ok());
    let (vertices, faces) = match (given.getattr("vertices"), faces) {
        (Ok(vertices), Some(faces)) => (vertices, faces),
        _ => given.extract().map_err(|_| usage(py, &place, "not a valid pair of arrays", remedy))?,
    };
    let (shape, values) = numbers::<f64>(&vertices, &format!("{place}: vertices"))?;
    let [_, 3] = shape[..] else { return Err(usage(py, &place, format!("vertices: {}", shape_words(&shape)), remedy)) };
    let vertices = values.as_chunks::<3>().0.iter().map(|v| DVec3::from_array(*v).as_vec3()).collect();
    let (shape, faces) = integers(&faces, &format!("{place}: faces"))?;
    let [_, 3] = shape[..] else { return Err(usage(py, &place, format!("faces: {}", shape_words(&shape)), remedy)) };
    Ok((vertices, faces.as_chunks::<3>().0.to_vec()))
}

fn integers(given: &Bound<'_, PyAny>, argument: &str) -> PyResult<(Vec<usize>, Vec<u32>)> {
    let py = given.py();
    let (shape, values) = numbers::<f64>(given, argument)?;
    let whole =
        |v: &f64| if v.fract() == 0.0 && *v >= 0.0 && *v < f64::from(u32::MAX) { Some(*v as u32) } else { None };
    match values.iter().map(whole).collect::<Option<Vec<u32>>>() {
        Some(values) => Ok((shape, values)),
        None => Err(usage(py, argument, "a number is negative, too large or not whole", "count vertices from 0")),
    }
}

/// The outputs that a tuple, or a text with commas, names.
pub fn outputs_of(given: Option<&Bound<'_, PyAny>>) -> PyResult<Outputs> {
    let Some(given) = given else { return Ok(Outputs::default()) };
    let parse = |text: &str| text.parse::<Output>().map_err(|e| raised(given.py(), &e.at("outputs")));
    let names: Vec<String> = match given.cast::<PyString>() {
        Ok(text) => text.to_str()?.split(',').map(|name| name.trim().to_owned()).collect(),
        Err(_) => given.extract().map_err(|_| {
            usage(given.py(), "outputs", "not valid names of images", "give a tuple, as (\"range\", \"object_id\")")
        })?,
    };
    let outputs = names.iter().map(|name| parse(name)).collect::<PyResult<Vec<Output>>>()?;
    if outputs.is_empty() {
        return Err(usage(given.py(), "outputs", "there is none", "give a tuple, as (\"range\",)"));
    }
    Ok(Outputs::of(&outputs))
}

/// (rows, columns), and 3 for vectors.
pub fn shape_of(images: (u32, u32), output: Output) -> Vec<usize> {
    presight::files::npy_shape(images.0, images.1, output)
}

/// Moves an image into an array.
pub fn image<'py>(py: Python<'py>, images: &mut Images, output: Output) -> PyResult<Bound<'py, PyAny>> {
    let shape = shape_of((images.width, images.height), output);
    match images.samples_mut(output) {
        SamplesMut::Floats(image) => array(py, std::mem::take(image), &shape),
        SamplesMut::Ids(image) => array(py, std::mem::take(image), &shape),
        SamplesMut::Vectors(image) => array(py, std::mem::take(image).into_flattened(), &shape),
    }
}

/// Copies an array back into its image.
pub fn fill(images: &mut Images, output: Output, array: &Bound<'_, PyAny>) -> PyResult<()> {
    match images.samples_mut(output) {
        SamplesMut::Floats(image) => *image = numbers(array, output.name())?.1,
        SamplesMut::Ids(image) => *image = numbers(array, output.name())?.1,
        SamplesMut::Vectors(image) => *image = numbers::<f32>(array, output.name())?.1.as_chunks::<3>().0.to_vec(),
    }
    Ok(())
}

/// A tuple of (rows, columns).
pub fn size<'py>(py: Python<'py>, height: u32, width: u32) -> PyResult<Bound<'py, PyTuple>> {
    (height, width).into_pyobject(py)
}

/// A pose that `pose_numbers` gave, with the same bits.
pub fn exact_pose([x, y, z, qx, qy, qz, qw]: [f64; 7]) -> Pose {
    Pose { translation: DVec3::new(x, y, z), rotation: DQuat::from_xyzw(qx, qy, qz, qw) }
}

/// An iterator over the items of a sequence; each is made when its turn comes.
pub fn one_by_one<'py>(sequence: &Bound<'py, PyAny>, count: usize) -> PyResult<Bound<'py, PyAny>> {
    let builtins = sequence.py().import("builtins")?;
    let indices = builtins.call_method1("range", (count,))?;
    builtins.call_method1("map", (sequence.getattr("__getitem__")?, indices))
}
