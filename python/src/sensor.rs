//! Sensors.

use super::arrays::{array, numbers, pose_numbers, pose_of};
use super::errors::{Failed, apart, raised, usage, warn};
use glam::{DQuat, DVec3};
use presight::files::{self, SensorOptions, load_sensor_with};
use presight::sensor::{Angles, Camera, Distortion, Geometry, PRESETS, RayTable, RayTimes, Scanner, SensorSpec};
use presight::tools;
use presight::{Error, Sensor as Ours};
use pyo3::prelude::*;
use pyo3::types::{PyDict, PyTuple};
use std::path::PathBuf;

/// A sensor: a camera, a scanner, or any rays.
///
/// `Sensor.load` takes presets and files; `Sensor.camera`, `Sensor.scanner` and `Sensor.from_rays` make sensors of numbers. Sensors
/// do not change; `replace` makes another one. They pickle by content.
///
/// >>> import presight
/// >>> lidar = presight.Sensor.load("vlp-16")
/// >>> lidar.name, lidar.shape, lidar.range_max
/// ('vlp-16', (16, 1800), 100.0)
#[pyclass(frozen, module = "presight")]
pub struct Sensor(pub Ours);

/// The sensor of an argument: one, or the name of a preset or file.
pub fn sensor_of(given: &Bound<'_, PyAny>) -> PyResult<Ours> {
    if let Ok(sensor) = given.cast::<Sensor>() {
        return Ok(sensor.get().0.clone());
    }
    let remedy = "give a Sensor, or the name of a preset or file";
    let name: PathBuf = given.extract().map_err(|_| usage(given.py(), "sensor", "is neither", remedy))?;
    load(given.py(), &name.to_string_lossy(), SensorOptions::default())
}

fn load(py: Python<'_>, name: &str, options: SensorOptions) -> PyResult<Ours> {
    let (sensor, notices) = apart(py, || -> Result<_, Failed> { Ok(load_sensor_with(name, options)?) })?;
    warn(py, &notices)?;
    Ok(sensor)
}

/// Makes a sensor with the properties that all kinds share.
fn made(py: Python<'_>, spec: SensorSpec, more: Option<&Bound<'_, PyDict>>) -> PyResult<Sensor> {
    let spec = with(spec, more)?;
    apart(py, || Ok(Sensor(Ours::new(spec)?)))
}

/// A specification with other properties, by name.
fn with(mut spec: SensorSpec, more: Option<&Bound<'_, PyDict>>) -> PyResult<SensorSpec> {
    for (name, value) in more.into_iter().flatten() {
        let name: String = name.extract()?;
        let number = || value.extract::<f64>().map_err(|_| usage(value.py(), &name, "not a number", "give a float"));
        match name.as_str() {
            "name" => spec.name = value.extract()?,
            "sensor_class" => spec.class = value.extract()?,
            "range_min" => spec.range_min = number()?,
            "range_max" => spec.range_max = number()?,
            "max_incidence_deg" => spec.max_incidence = Some(number()?.to_radians()),
            "mount" => spec.mount = pose_of(&value, "mount")?,
            "range_sigma" => spec.noise.range_sigma = number()?,
            "range_sigma_quadratic" => spec.noise.range_sigma_quadratic = number()?,
            "angle_sigma_deg" => spec.noise.angle_sigma = number()?.to_radians(),
            "pixel_sigma" => spec.noise.pixel_sigma = number()?,
            _ => {
                let remedy = "choose from name, sensor_class, range_min, range_max, max_incidence_deg, mount, range_sigma, \
                              range_sigma_quadratic, angle_sigma_deg, pixel_sigma";
                return Err(usage(value.py(), &name, "a sensor has no such property", remedy));
            }
        }
    }
    Ok(spec)
}

fn angles(given: &Bound<'_, PyAny>, argument: &str) -> PyResult<Angles> {
    match numbers::<f64>(given, argument)? {
        (shape, degrees) if shape.len() == 1 && !degrees.is_empty() => Ok(Angles::Listed(degrees)),
        _ => Err(usage(given.py(), argument, "not a valid list of angles", "give (n,) degrees")),
    }
}

impl Sensor {
    /// Three numbers for each pixel, by column and row.
    fn of_pixels<'py>(
        &self,
        py: Python<'py>,
        value: impl Fn(u32, u32) -> [f64; 3] + Send + Sync,
    ) -> PyResult<Bound<'py, PyAny>> {
        let (height, width) = (self.0.height(), self.0.width());
        let values = apart(py, || {
            let mut values = tools::reserved(3 * width as usize * height as usize)?;
            for row in 0..height {
                values.extend((0..width).flat_map(|column| value(column, row)));
            }
            Ok(values)
        })?;
        array(py, values, &[height as usize, width as usize, 3])
    }
}

#[pymethods]
impl Sensor {
    /// Loads a preset or a sensor file: TOML, the YAML of a ROS camera_info, of Kalibr (`chain.yaml:cam1`) or of a Velodyne, the
    /// metadata of an Ouster (JSON), or a pattern (`pattern.csv`, or its part `pattern.csv:0.2..0.3`, seconds).
    ///
    /// `rectified` takes the rectified image of a camera_info (P and R), and `destagger` the destaggered image of a lidar's beam table.
    /// Raises `Error` for an unknown name or an invalid file.
    ///
    /// >>> presight.Sensor.load("realsense-d435").shape
    /// (720, 1280)
    #[staticmethod]
    #[pyo3(signature = (name, rectified = false, destagger = false))]
    fn load(py: Python<'_>, name: PathBuf, rectified: bool, destagger: bool) -> PyResult<Self> {
        let options = SensorOptions::default().with_rectified(rectified).with_destagger(destagger);
        load(py, &name.to_string_lossy(), options).map(Self)
    }

    /// The names of the presets.
    ///
    /// >>> "vlp-16" in presight.Sensor.presets()
    /// True
    #[staticmethod]
    fn presets() -> Vec<&'static str> {
        PRESETS.iter().map(|preset| preset.name).collect()
    }

    /// Makes a camera: `K` is (3, 3) as OpenCV's, or fx, fy, cx, cy in pixels; `size` is (columns, rows). Pixel (0, 0) is the centre of
    /// the top-left pixel.
    ///
    /// `D` are lens coefficients in OpenCV's order and `model` is `plumb_bob` (the default with D), `rational_polynomial` or
    /// `equidistant`. Further properties, by name: `name`, `sensor_class` ("video"), `range_min` (0), `range_max` (inf), metres;
    /// `mount` (the sensor's pose on the robot), `range_sigma` (metres), `range_sigma_quadratic` (1 / metre), `angle_sigma_deg`,
    /// `pixel_sigma`, `max_incidence_deg`.
    ///
    /// >>> presight.Sensor.camera([[525, 0, 319.5], [0, 525, 239.5], [0, 0, 1]], (640, 480), range_max=5).shape
    /// (480, 640)
    #[staticmethod]
    #[pyo3(signature = (K, size, D = None, model = None, **more))]
    #[expect(non_snake_case, reason = "the names of OpenCV and ROS")]
    fn camera(
        py: Python<'_>,
        K: &Bound<'_, PyAny>,
        size: (u32, u32),
        D: Option<&Bound<'_, PyAny>>,
        model: Option<&str>,
        more: Option<&Bound<'_, PyDict>>,
    ) -> PyResult<Self> {
        let (shape, k) = numbers::<f64>(K, "K")?;
        let [fx, fy, cx, cy] = match (&shape[..], &k[..]) {
            ([4], [fx, fy, cx, cy]) => [*fx, *fy, *cx, *cy],
            ([3, 3], [fx, skew, cx, zero, fy, cy, rest @ ..])
                if [*skew, *zero] == [0.0; 2] && *rest == [0.0, 0.0, 1.0] =>
            {
                [*fx, *fy, *cx, *cy]
            }
            _ => {
                let remedy = "give (3, 3) as fx 0 cx, 0 fy cy, 0 0 1, or (4,) fx fy cx cy";
                return Err(usage(py, "K", "not a valid camera matrix without skew", remedy));
            }
        };
        let coefficients = D.map_or(Ok(Vec::new()), |d| numbers::<f64>(d, "D").map(|(_, values)| values))?;
        let model = model.unwrap_or(if coefficients.is_empty() { "none" } else { "plumb_bob" });
        let distortion = Distortion::from_model(model, &coefficients).map_err(|e| raised(py, &e.at("D")))?;
        let camera = Camera { distortion, ..Camera::pinhole(size.0, size.1, fx, fy, cx, cy) };
        made(py, SensorSpec::new("camera", "video", Geometry::Camera(camera)), more)
    }

    /// Makes a scanner: a column for each azimuth, degrees counter-clockwise from x, all rising or all falling, and a row for each
    /// elevation, degrees. Rows are sorted by falling elevation. Further properties as for `camera`; `sensor_class` is "laser".
    ///
    /// >>> import numpy as np
    /// >>> presight.Sensor.scanner(np.arange(-90, 91), range_max=30, range_sigma=0.02).shape
    /// (1, 181)
    #[staticmethod]
    #[pyo3(signature = (azimuth_deg, elevation_deg = None, **more))]
    fn scanner(
        py: Python<'_>,
        azimuth_deg: &Bound<'_, PyAny>,
        elevation_deg: Option<&Bound<'_, PyAny>>,
        more: Option<&Bound<'_, PyDict>>,
    ) -> PyResult<Self> {
        let azimuth = angles(azimuth_deg, "azimuth_deg")?;
        let elevation = elevation_deg.map_or(Ok(Angles::Listed(vec![0.0])), |given| angles(given, "elevation_deg"))?;
        let scanner = Scanner { azimuth, elevation, beam_height_deg: None };
        made(py, SensorSpec::new("scanner", "laser", Geometry::Scanner(scanner)), more)
    }

    /// Makes a sensor of any rays: (rows, columns, 3) or (n, 3), body axes (x forward, y left, z up), of any length; NaN where a pixel
    /// has no ray. `origins` of the same shape are the points from which ranges are measured, metres (default: the sensor's origin), and
    /// `times` of the same shape without its last axis are seconds after the stamp. Further properties as for `camera`; `sensor_class`
    /// is "laser".
    ///
    /// >>> presight.Sensor.from_rays([[1, 0, 0], [1, 1, 0]], times=[0, 0.1]).times().tolist()
    /// [[0.0, 0.10000000149011612]]
    #[staticmethod]
    #[pyo3(signature = (directions, origins = None, times = None, **more))]
    fn from_rays(
        py: Python<'_>,
        directions: &Bound<'_, PyAny>,
        origins: Option<&Bound<'_, PyAny>>,
        times: Option<&Bound<'_, PyAny>>,
        more: Option<&Bound<'_, PyDict>>,
    ) -> PyResult<Self> {
        let (shape, values) = numbers::<f64>(directions, "directions")?;
        let (rows, columns) = match shape[..] {
            [rows, columns, 3] => (rows, columns),
            [columns, 3] => (1, columns),
            _ => return Err(usage(py, "directions", format!("shape {shape:?}"), "give (rows, columns, 3) or (n, 3)")),
        };
        if values.chunks(3).all(|ray| ray.iter().any(|x| x.is_nan())) {
            return Err(usage(py, "directions", "there is no ray", "give at least one that is not NaN"));
        }
        let rays = values.as_chunks::<3>().0.iter().map(|ray| DVec3::from_array(*ray)).collect();
        let sides = u32::try_from(rows).and_then(|rows| Ok((u32::try_from(columns)?, rows)));
        let (columns, rows) = sides.map_err(|_| usage(py, "directions", "too many rays", "give fewer"))?;
        let mut table = RayTable::new(columns, rows, rays).map_err(|e| raised(py, &e.at("directions")))?;
        if let Some(given) = origins {
            let (other, values) = numbers::<f64>(given, "origins")?;
            if other != shape {
                return Err(usage(py, "origins", format!("shape {other:?}"), format!("give {shape:?}, as directions")));
            }
            let points = values.as_chunks::<3>().0.iter().map(|point| DVec3::from_array(*point)).collect();
            table = table.with_origins(points).map_err(|e| raised(py, &e.at("origins")))?;
        }
        let mut spec = SensorSpec::new("rays", "laser", Geometry::Rays(table));
        if let Some(given) = times {
            let (other, values) = numbers::<f32>(given, "times")?;
            let wanted = &shape[..shape.len() - 1];
            if other != wanted {
                return Err(usage(
                    py,
                    "times",
                    format!("shape {other:?}"),
                    format!("give {wanted:?}, one for each ray"),
                ));
            }
            spec = spec.with_times(RayTimes::Listed(values.into()));
        }
        made(py, spec, more)
    }

    /// Reads the text of a sensor file, as `toml` writes it.
    ///
    /// >>> presight.Sensor.parse(presight.Sensor.load("vlp-16").toml()).name
    /// 'vlp-16'
    #[staticmethod]
    fn parse(py: Python<'_>, toml: &str) -> PyResult<Self> {
        apart(py, || Ok(Self(Ours::new(files::parse_sensor_toml(toml, "sensor", None)?)?)))
    }

    /// The same sensor with other properties, by the names that `camera` lists.
    ///
    /// >>> presight.Sensor.load("vlp-16").replace(range_max=50).range_max
    /// 50.0
    #[pyo3(signature = (**more))]
    fn replace(&self, py: Python<'_>, more: Option<&Bound<'_, PyDict>>) -> PyResult<Self> {
        made(py, self.0.spec().clone(), more)
    }

    /// The text of its sensor file, which `presight --sensor` takes.
    fn toml(&self) -> String {
        files::sensor_to_toml(self.0.spec())
    }

    /// The unit rays of the pixels: (rows, columns, 3), float64, body axes (x forward, y left, z up), NaN without a ray. A point is its
    /// origin (`origins`) plus its ray times its range.
    ///
    /// >>> presight.Sensor.load("laser-scanner").rays()[0, 180].tolist()
    /// [1.0, 0.0, 0.0]
    fn rays<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        let body_from_image = self.0.body_from_image();
        let ray = |column, row| self.0.ray(column, row).map_or(DVec3::NAN, |ray| body_from_image * ray).to_array();
        self.of_pixels(py, ray)
    }

    /// Where the range of each pixel is measured from: (rows, columns, 3), float64, metres from the sensor's origin, body axes.
    ///
    /// >>> float(presight.Sensor.load("vlp-16-real").origins()[0, 0, 2])
    /// -0.0112
    fn origins<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        self.of_pixels(py, |column, row| self.0.origin(column, row).to_array())
    }

    /// When each pixel is measured: (rows, columns), float64, seconds after the stamp of a frame.
    ///
    /// >>> float(presight.Sensor.load("laser-scanner").times().max())
    /// 0.0
    fn times<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        let (height, width) = (self.0.height(), self.0.width());
        let times = apart(py, || {
            let mut times = tools::reserved(width as usize * height as usize)?;
            for row in 0..height {
                times.extend((0..width).map(|column| self.0.seconds_after_stamp(column, row)));
            }
            Ok(times)
        })?;
        array(py, times, &[height as usize, width as usize])
    }

    /// Its name.
    #[getter]
    fn name(&self) -> &str {
        &self.0.spec().name
    }

    /// Its class, as materials and feature layers name it, such as "laser".
    #[getter]
    fn sensor_class(&self) -> &str {
        &self.0.spec().class
    }

    /// (rows, columns).
    #[getter]
    fn shape(&self) -> (u32, u32) {
        (self.0.height(), self.0.width())
    }

    /// Metres; a nearer surface reads -inf.
    #[getter]
    fn range_min(&self) -> f64 {
        self.0.spec().range_min
    }

    /// Metres; beyond it, ranges are inf.
    #[getter]
    fn range_max(&self) -> f64 {
        self.0.spec().range_max
    }

    /// Its pose on the robot, body axes: (7,) x y z qx qy qz qw.
    #[getter]
    fn mount<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        array(py, pose_numbers(&self.0.spec().mount).to_vec(), &[7])
    }

    fn __repr__(&self) -> String {
        format!("<presight.Sensor {} {} x {}>", self.0.spec().name, self.0.width(), self.0.height())
    }

    fn __eq__(&self, other: &Bound<'_, PyAny>) -> bool {
        other.cast::<Self>().is_ok_and(|other| other.get().0.spec() == self.0.spec())
    }

    fn __hash__(&self) -> u64 {
        use std::hash::{DefaultHasher, Hash, Hasher};
        let (spec, mut hasher) = (self.0.spec(), DefaultHasher::new());
        (&spec.name, &spec.class, self.0.width(), self.0.height()).hash(&mut hasher);
        hasher.finish()
    }

    /// By content: the text of its file, and what texts in degrees would round.
    fn __reduce__<'py>(&self, py: Python<'py>) -> PyResult<(Bound<'py, PyAny>, Bound<'py, PyTuple>)> {
        let spec = self.0.spec();
        let q = spec.optical_from_image;
        let exact = (spec.max_incidence, spec.noise.angle_sigma, [q.x, q.y, q.z, q.w]);
        let restore = py.get_type::<Self>().getattr("_restored")?;
        Ok((restore, (self.toml(), exact).into_pyobject(py)?))
    }

    #[staticmethod]
    fn _restored(py: Python<'_>, toml: &str, exact: (Option<f64>, f64, [f64; 4])) -> PyResult<Self> {
        apart(py, || {
            let mut spec = files::parse_sensor_toml(toml, "sensor", None)?;
            spec.max_incidence = exact.0;
            spec.noise.angle_sigma = exact.1;
            spec.optical_from_image = DQuat::from_array(exact.2);
            Ok::<_, Failed>(Self(Ours::new(spec).map_err(|e: Error| e.at("the pickle"))?))
        })
    }
}
