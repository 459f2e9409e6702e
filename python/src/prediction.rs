//! Predictions: arrays, features, pictures, points.

use super::arrays::{array, fill, image, one_by_one, pose_numbers, size};
use super::errors::{apart, usage};
use presight::environment::Environment;
use presight::features::{Reason, SeenFeature};
use presight::files;
use presight::predict::{PointCloud, PointsFrame};
use presight::{Error, Images, Output, Prediction as Ours};
use presight_cli::summary::Summary;
use presight_pictures as pictures;
use pyo3::exceptions::{PyAttributeError, PyIndexError};
use pyo3::prelude::*;
use pyo3::types::{PyBytes, PyTuple};
use std::path::PathBuf;
use std::sync::{Arc, OnceLock};

/// What a sensor should see at a pose: images as NumPy arrays, features, statistics.
///
/// Each image that was requested is an attribute, of (rows, columns): `range` and `depth_z` in metres (float32; inf beyond the
/// sensor's reach, -inf too near, NaN without a ray), `polygon_id` and `object_id` (uint32; 0 for nothing), `cos_incidence`, `echo`
/// (float32, 0 to 1), `feature_id` (uint32), and `normal` of (rows, columns, 3) in the sensor's body axes. The arrays are the engine's
/// own buffers; they stay when everything else is gone, and no later call changes them. Notebooks show the picture.
///
/// >>> import presight
/// >>> out = presight.predict(presight.Scene.example(), "vlp-16", [1, 1.5, 0.5, 0, 0, 0])
/// >>> out.range.shape, out.range.dtype.name, out.object_id.dtype.name
/// ((16, 1800), 'float32', 'uint32')
/// >>> print(out)  # doctest: +ELLIPSIS
/// vlp-16 1800 x 16, 99.1 % of rays hit at ...
#[pyclass(frozen, module = "presight")]
pub struct Prediction {
    /// Without its images.
    pub prediction: Ours,
    pub size: (u32, u32),
    pub arrays: Vec<(Output, Py<PyAny>)>,
    pub about: About,
    features: OnceLock<Option<Py<Features>>>,
}

/// What the prediction itself does not hold.
pub struct About {
    pub scene: PathBuf,
    pub objects: usize,
    pub engine: String,
    pub ms: f64,
    /// Where features were predicted, the environment that names their objects, and the header of their file.
    pub features: Option<(Arc<Environment>, files::PredictionHeader)>,
}

impl Prediction {
    pub fn new(py: Python<'_>, mut prediction: Ours, about: About) -> PyResult<Self> {
        let mut images = std::mem::take(&mut prediction.images);
        let mut arrays = Vec::new();
        for output in images.outputs().iter() {
            arrays.push((output, image(py, &mut images, output)?.unbind()));
        }
        let size = (images.width, images.height);
        Ok(Self { prediction, size, arrays, about, features: OnceLock::new() })
    }

    fn get<'py>(&self, py: Python<'py>, output: Output) -> PyResult<Bound<'py, PyAny>> {
        match self.arrays.iter().find(|(known, _)| *known == output) {
            Some((_, array)) => Ok(array.bind(py).clone()),
            None => {
                let name = output.name();
                Err(PyAttributeError::new_err(format!(
                    "there is no image {name}; request it: outputs=(\"{name}\", ..)"
                )))
            }
        }
    }

    /// The prediction with its images as the arrays now are.
    pub fn whole(&self, py: Python<'_>, wanted: impl Fn(Output) -> bool) -> PyResult<Ours> {
        let (width, height) = self.size;
        let mut images = Images { width, height, ..Images::default() };
        for (output, array) in self.arrays.iter().filter(|(output, _)| wanted(*output)) {
            fill(&mut images, *output, array.bind(py))?;
        }
        let mut whole = self.prediction.clone();
        whole.images = images;
        Ok(whole)
    }

    fn summary(&self, py: Python<'_>) -> PyResult<(Ours, Summary)> {
        let whole = self.whole(py, |output| [Output::Range, Output::ObjectId].contains(&output))?;
        let objects = self.about.objects;
        apart(py, move || Ok((Summary::of(&whole, objects), whole))).map(|(summary, whole)| (whole, summary))
    }
}

macro_rules! image_getters {
    ($($name:ident $output:ident $about:literal),* $(,)?) => {
        #[pymethods]
        impl Prediction {
            $(
                #[doc = $about]
                #[getter]
                fn $name<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
                    self.get(py, Output::$output)
                }
            )*

            /// The image of a name.
            fn __getitem__<'py>(&self, py: Python<'py>, name: &str) -> PyResult<Bound<'py, PyAny>> {
                match Output::named(name) {
                    Some(output) => self.get(py, output),
                    None => Err(usage(py, "image", format!("unknown output {name:?}"), "see outputs")),
                }
            }

            /// The names of the images.
            #[getter]
            fn outputs(&self) -> Vec<&'static str> {
                self.arrays.iter().map(|(output, _)| output.name()).collect()
            }

            /// The picture of an image as the bytes of a PNG file, as `presight predict --png` draws it without features.
            ///
            /// >>> out.png("object_id")[1:4]
            /// b'PNG'
            #[pyo3(signature = (output = None))]
            fn png<'py>(&self, py: Python<'py>, output: Option<&str>) -> PyResult<Bound<'py, PyBytes>> {
                let first = || self.arrays.first().map_or("range", |(output, _)| output.name());
                let parsed = output.unwrap_or_else(first).parse::<Output>();
                let output = parsed.map_err(|e| super::errors::raised(py, &e.at("output")))?;
                self.get(py, output)?;
                let needs = pictures::preview_needs(&self.prediction.sensor, output);
                let whole = self.whole(py, |output| needs.has(output))?;
                let bytes = apart(py, || Ok(pictures::preview_png(&whole.images, &whole.sensor, output)?))?;
                Ok(PyBytes::new(py, &bytes))
            }

            /// For notebooks.
            fn _repr_png_<'py>(&self, py: Python<'py>) -> PyResult<Option<Bound<'py, PyBytes>>> {
                if self.arrays.is_empty() { Ok(None) } else { self.png(py, None).map(Some) }
            }

            /// The points of the pixels: (rows, columns, 3), float64, metres, NaN where nothing is seen, in the frame of the "world" or
            /// the "sensor".
            ///
            /// >>> out.points("world").shape
            /// (16, 1800, 3)
            ///
            /// Points of a moving scan in the sensor's frame are as sensed, each at the time of its ray, or with `deskew` all in the
            /// frame at this time, seconds after the stamp.
            #[pyo3(signature = (frame = "sensor", deskew = None))]
            fn points<'py>(&self, py: Python<'py>, frame: &str, deskew: Option<f64>) -> PyResult<Bound<'py, PyAny>> {
                let frame = match frame {
                    "sensor" => PointsFrame::Sensor,
                    "world" => PointsFrame::World,
                    _ => return Err(usage(py, "frame", format!("{frame:?}"), "give \"world\" or \"sensor\"")),
                };
                let whole = self.whole(py, |output| output == Output::Range)?;
                let (width, height) = self.size;
                let points = apart(py, || {
                    let motion = whole.request.motion.as_ref();
                    let cloud = PointCloud::of_scan(&whole.images, &whole.sensor, &whole.pose, frame, motion, deskew)?;
                    Ok(cloud.positions().iter().flat_map(|p| p.to_array()).collect::<Vec<f64>>())
                })?;
                array(py, points, &[height as usize, width as usize, 3])
            }

            /// The features, or None if none were requested.
            #[getter]
            fn features(&self, py: Python<'_>) -> PyResult<Option<Py<Features>>> {
                if let Some(known) = self.features.get() {
                    return Ok(known.as_ref().map(|features| features.clone_ref(py)));
                }
                let made = match (&self.prediction.features, &self.about.features) {
                    (Some(seen), Some((environment, header))) => {
                        let (environment, header) = (environment.clone(), header.clone());
                        Some(Py::new(py, Features { seen: seen.clone(), environment, header })?)
                    }
                    _ => None,
                };
                let made = self.features.get_or_init(|| made);
                Ok(made.as_ref().map(|features| features.clone_ref(py)))
            }

            /// The summary as the JSON of `presight predict --json`.
            fn json(&self, py: Python<'_>) -> PyResult<String> {
                let (whole, summary) = self.summary(py)?;
                let About { scene, ms, engine, .. } = &self.about;
                Ok(summary.json(scene, &whole, *ms, engine).to_string())
            }

            /// Statistics: engine, stages in milliseconds, counts, and the reasons of omissions.
            ///
            /// >>> out.stats["engine"] in ("cpu", "gpu")
            /// True
            #[getter]
            fn stats<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
                let text = serde_json::to_string(&self.prediction.stats).unwrap_or_default();
                py.import("json")?.call_method1("loads", (text,))
            }

            /// What happened on the way, one line each, such as a GPU that was lost.
            #[getter]
            fn notices(&self) -> Vec<String> {
                self.prediction.stats.notices.clone()
            }

            /// One line about the parts given up for `deadline_ms`; None if the prediction is complete.
            #[getter]
            fn given_up(&self) -> Option<String> {
                self.prediction.degradation().map(|given_up| given_up.summary())
            }

            /// The pixels that were given up for `deadline_ms`: (rows, columns), bool.
            fn not_predicted<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
                let (width, height) = self.size;
                let mut pixels = self.whole(py, |_| true)?.not_predicted();
                pixels.resize(width as usize * height as usize, false);
                array(py, pixels, &[height as usize, width as usize])
            }

            /// The pose of the sensor, body axes: (7,) x y z qx qy qz qw.
            #[getter]
            fn pose<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
                array(py, pose_numbers(&self.prediction.pose.world_from_sensor()).to_vec(), &[7])
            }

            /// (rows, columns).
            #[getter]
            fn shape<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyTuple>> {
                size(py, self.size.1, self.size.0)
            }

            fn __str__(&self, py: Python<'_>) -> PyResult<String> {
                let (whole, summary) = self.summary(py)?;
                Ok(summary.in_words(&whole))
            }

            fn __repr__(&self, py: Python<'_>) -> PyResult<String> {
                Ok(format!("<presight.Prediction {}>", self.__str__(py)?))
            }
        }
    };
}

image_getters!(
    range Range "Metres along the ray.",
    depth_z DepthZ "Metres along the optical axis; cameras only.",
    polygon_id PolygonId "The visible polygon; 0 for none.",
    object_id ObjectId "The visible object: its place in `Scene.objects`, plus 1; 0 for none.",
    cos_incidence CosIncidence "Cosine of the angle between ray and surface normal, 0 to 1.",
    echo Echo "Strength of the echo: reflection factor times `cos_incidence`.",
    normal Normal "Unit normals towards the sensor, body axes: (rows, columns, 3).",
    feature_id FeatureId "The visible feature; 0 for none.",
);

/// The features of a prediction: columns as arrays, and one by one by index or loop.
#[pyclass(frozen, module = "presight")]
pub struct Features {
    seen: presight::features::FeaturePrediction,
    environment: Arc<Environment>,
    header: files::PredictionHeader,
}

/// Why nothing of a feature is visible; empty if a part is.
fn reason(feature: &SeenFeature) -> &'static str {
    match feature.visible.is_empty() {
        true => feature.hidden.iter().map(|hidden| hidden.reason).max().map_or("", Reason::name),
        false => "",
    }
}

impl Features {
    fn column<'py, T: numpy::Element>(
        &self,
        py: Python<'py>,
        value: impl Fn(&SeenFeature) -> T,
    ) -> PyResult<Bound<'py, PyAny>> {
        let values: Vec<T> = self.seen.features.iter().map(value).collect();
        let count = values.len();
        array(py, values, &[count])
    }
}

#[pymethods]
impl Features {
    /// Their numbers: (n,), uint32.
    #[getter]
    fn id<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        self.column(py, |f| f.feature.id)
    }

    /// Visible share of the length or area inside the image and the range limits: (n,), float64.
    #[getter]
    fn visible_fraction<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        self.column(py, |f| f.visible_fraction)
    }

    /// Metres to the nearest visible sample: (n,), float64, NaN if nothing is visible.
    #[getter]
    fn range<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        self.column(py, |f| f.range.unwrap_or(f64::NAN))
    }

    /// Regions of interest: the box in pixels that holds the feature, x0 y0 x1 y1: (n, 4), float64, NaN without one.
    #[getter]
    fn roi<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        let boxes: Vec<f64> = self.seen.features.iter().flat_map(|f| f.roi.unwrap_or([f64::NAN; 4])).collect();
        let count = self.seen.features.len();
        array(py, boxes, &[count, 4])
    }

    /// Why nothing is visible, as "occluded", for each feature; empty if a part is.
    #[getter]
    fn reason(&self) -> Vec<&'static str> {
        self.seen.features.iter().map(reason).collect()
    }

    /// The features file that `presight predict --features` writes.
    fn json(&self, py: Python<'_>) -> PyResult<String> {
        apart(py, || Ok(files::prediction_to_json(&self.header, &self.seen, &self.environment, None)?))
    }

    fn __len__(&self) -> usize {
        self.seen.features.len()
    }

    fn __getitem__(&self, index: isize) -> PyResult<Feature> {
        let count = self.seen.features.len() as isize;
        let at = if index < 0 { index + count } else { index };
        match self.seen.features.get(usize::try_from(at).unwrap_or(usize::MAX)) {
            Some(feature) => Ok(Feature(feature.clone())),
            None => Err(PyIndexError::new_err(format!("feature {index} of {count}"))),
        }
    }

    fn __iter__<'py>(slf: &Bound<'py, Self>) -> PyResult<Bound<'py, PyAny>> {
        one_by_one(slf.as_any(), slf.get().__len__())
    }

    fn __repr__(&self) -> String {
        let visible = self.seen.features.iter().filter(|f| !f.visible.is_empty()).count();
        format!("<presight.Features {visible} of {} visible>", self.seen.features.len())
    }
}

/// One predicted feature.
#[pyclass(frozen, module = "presight")]
pub struct Feature(SeenFeature);

type Part = ((f64, f64), ((f64, f64), (f64, f64)));

#[pymethods]
impl Feature {
    /// Its number.
    #[getter]
    fn id(&self) -> u32 {
        self.0.feature.id
    }

    /// Its name, if it has one.
    #[getter]
    fn name(&self) -> Option<&str> {
        self.0.feature.name.as_deref()
    }

    /// The path of its object, if it has one.
    #[getter]
    fn object(&self) -> Option<&str> {
        self.0.feature.object.as_deref()
    }

    /// Its defining points in the world: (n, 3), metres.
    #[getter]
    fn points<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        let points: Vec<f64> = self.0.points_world.iter().flat_map(|p| p.to_array()).collect();
        array(py, points, &[self.0.points_world.len(), 3])
    }

    /// The visible share.
    #[getter]
    fn visible_fraction(&self) -> f64 {
        self.0.visible_fraction
    }

    /// The visible parts: ((from, to), ((column, row), (column, row))), fractions of the length and pixels of both ends.
    #[getter]
    fn visible(&self) -> Vec<Part> {
        let part =
            |v: &presight::features::VisibleInterval| ((v.t[0], v.t[1]), (v.pixels[0].into(), v.pixels[1].into()));
        self.0.visible.iter().map(part).collect()
    }

    /// The hidden parts: (from, to, reason).
    #[getter]
    fn hidden(&self) -> Vec<(f64, f64, &'static str)> {
        self.0.hidden.iter().map(|h| (h.t[0], h.t[1], h.reason.name())).collect()
    }

    /// Metres to the nearest visible sample.
    #[getter]
    fn range(&self) -> Option<f64> {
        self.0.range
    }

    /// The region of interest: x0, y0, x1, y1 in pixels.
    #[getter]
    fn roi(&self) -> Option<(f64, f64, f64, f64)> {
        self.0.roi.map(Into::into)
    }

    /// Probability that it exists.
    #[getter]
    fn existence(&self) -> f64 {
        self.0.existence
    }

    /// Why nothing is visible; empty if a part is.
    #[getter]
    fn reason(&self) -> &'static str {
        reason(&self.0)
    }

    fn __repr__(&self) -> String {
        format!("<presight.Feature {} {:.0} % visible>", self.0.feature.id, 100.0 * self.0.visible_fraction)
    }
}

/// A feature layer for `predict`: the features of one sensor class, as `presight features` writes them.
///
/// Load a file once and pass the layer, if many predictions use it. Layers pickle by content.
#[pyclass(frozen, module = "presight")]
pub struct Layer {
    text: String,
    pub file: Arc<presight::files::LayerFile>,
}

impl Layer {
    fn of(text: String, path: Option<PathBuf>) -> Result<Self, Error> {
        let file = presight::files::parse_layer(&text).map_err(|e| match &path {
            Some(path) => e.in_file(path),
            None => e,
        })?;
        Ok(Self { text, file: Arc::new(presight::files::LayerFile { path, ..file }) })
    }

    pub fn read(path: PathBuf) -> Result<Self, Error> {
        Self::of(presight::tools::read_text(&path)?, Some(path))
    }
}

#[pymethods]
impl Layer {
    /// Reads a layer file.
    #[staticmethod]
    fn load(py: Python<'_>, path: PathBuf) -> PyResult<Self> {
        apart(py, || Ok(Self::read(path)?))
    }

    /// Reads the text of a layer file.
    ///
    /// >>> import presight
    /// >>> layer = presight.Layer.parse('{"format": 1, "class": "video", "features": []}')
    /// >>> layer.sensor_class, len(layer)
    /// ('video', 0)
    #[staticmethod]
    #[pyo3(signature = (text, path = None))]
    fn parse(py: Python<'_>, text: String, path: Option<PathBuf>) -> PyResult<Self> {
        apart(py, || Ok(Self::of(text, path)?))
    }

    /// The class of sensors that see its features.
    #[getter]
    fn sensor_class(&self) -> &str {
        &self.file.layer.class
    }

    fn __len__(&self) -> usize {
        self.file.layer.features.len()
    }

    fn __repr__(&self) -> String {
        format!("<presight.Layer of {} features for {:?}>", self.file.layer.features.len(), self.file.layer.class)
    }

    fn __reduce__<'py>(&self, py: Python<'py>) -> PyResult<(Bound<'py, PyAny>, Bound<'py, PyTuple>)> {
        let path = self.file.path.as_ref().map(|path| path.to_string_lossy().into_owned());
        Ok((py.get_type::<Self>().getattr("parse")?, (self.text.clone(), path).into_pyobject(py)?))
    }
}
