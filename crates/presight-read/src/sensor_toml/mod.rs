//! Sensor TOML, `format = 1`. Unknown keys are errors. Angles are degrees in keys that end in `_deg`.
//!
//! ```toml
//! format = 1
//! kind = "scanner"            # or "camera", "rays"
//! name = "top lidar"          # optional, default: the file's stem
//! class = "laser"             # optional, default: video for cameras, laser for the others
//! range_min = 0.5             # metres, default 0
//! range_max = 100.0           # metres, default inf
//! max_incidence_deg = 80.0    # optional: features seen at a flatter angle are not extracted
//! beam_height_deg = 2.0       # scanner, optional: height of a beam, within which a row sees features
//! turn_s = 0.1                # optional: seconds from the first column to one step behind the last, default 0
//!
//! [azimuth]                   # scanner: beam i is column i, counter-clockwise about +z
//! start_deg = -180.0
//! step_deg = 0.2              # either sign
//! count = 1800                # or angles_deg = [..]
//!
//! [elevation]                 # scanner, in any order: rows are sorted by descending elevation
//! angles_deg = [-15.0, 0.0, 15.0]  # or start_deg, step_deg, count
//!
//! [mount]                     # robot_from_sensor, body axes, default identity
//! xyz = [0.2, 0.0, 1.1]       # metres
//! rpy_deg = [0.0, 10.0, 0.0]  # roll, pitch, yaw about fixed axes, or quaternion = [x, y, z, w]
//!
//! [noise]                     # standard deviations, default 0
//! range_sigma = 0.02          # metres
//! range_sigma_quadratic = 0.0 # 1 / metre: this times the range squared is added to range_sigma
//! angle_sigma_deg = 0.01
//! pixel_sigma = 0.0
//! stamp_sigma_s = 0.0         # of the time stamps
//! p_hit = 0.75                # fractions of beams, with sum 1: hit the predicted surface,
//! p_short = 0.1               # hit something nearer that the model lacks,
//! p_none = 0.05               # hit nothing,
//! p_any = 0.1                 # or return any range
//! beam_dependence = 1.0       # number of beams that carry the information of one independent beam
//! ```
//!
//! `kind = "camera"`: `width, height, fx, fy, cx, cy`, and `[distortion]` with `model = "none" | "plumb_bob" |
//! "rational_polynomial" | "equidistant" | "kannala_brandt" | "fisheye"` and `coefficients` in OpenCV's order (4 or 5;
//! 8, 12 or 14; 4). A rectified camera has `optical_from_image = [x, y, z, w]`, the rotation from the frame of its image
//! to the optical frame of the camera. `kind = "rays"`: `width, height` and `directions = [[x, y, z], ..]`, row-major, body axes, `nan` for no ray; or
//! `file = "X.csv"`, relative to the sensor file, with one direction `x,y,z` per line and `#` for comments.

#[cfg(test)]
mod tests;
mod write;

pub use write::to_string;

use super::text::{check_format, from_settings, from_text, toml_from_str};
use glam::{DQuat, DVec3};
use presight_model::error::{Error, Result};
use presight_model::geometry::Pose;
use presight_model::limits;
use presight_model::printable::quoted;
use presight_model::sensor::{Angles, Camera, Distortion, Geometry, Mixture, Noise, RayTable, Scanner, SensorSpec};
use serde::Deserialize;
use std::path::Path;

/// Reads a sensor file.
///
/// # Errors
/// [`presight_model::ErrorKind::Invalid`] with the line or key at fault, [`presight_model::ErrorKind::Unsupported`] for
/// a newer format, [`presight_model::ErrorKind::System`] if the system refuses.
pub fn read(path: &Path) -> Result<SensorSpec> {
    let name = path.file_stem().map_or_else(|| "sensor".into(), |s| s.to_string_lossy());
    from_settings(path, |text| parse(text, &name, path.parent()))
}

/// Reads the text of a sensor file. `name` is used if the text gives none; `file = "X.csv"` is relative to `folder`.
///
/// # Errors
/// As [`read`], without the file.
pub fn parse(text: &str, name: &str, folder: Option<&Path>) -> Result<SensorSpec> {
    check_format(text)?;
    #[derive(Deserialize)]
    struct Header {
        kind: Option<String>,
    }
    match toml_from_str::<Header>(text)?.kind.as_deref() {
        Some("camera") => toml_from_str::<CameraFile>(text)?.spec(name),
        Some("scanner") => toml_from_str::<ScannerFile>(text)?.spec(name),
        Some("rays") => toml_from_str::<RaysFile>(text)?.spec(name, folder),
        other => Err(Error::invalid(
            other.map_or_else(|| "kind is missing".to_owned(), |k| format!("kind {k:?} is unknown")),
            "write kind = \"camera\", \"scanner\" or \"rays\"",
        )),
    }
}

/// Serde cannot combine `flatten` with `deny_unknown_fields`, so each kind of file repeats the common keys.
macro_rules! sensor_file {
    ($file:ident { $($key:ident: $type:ty),* $(,)? }) => {
        #[derive(Deserialize)]
        #[serde(deny_unknown_fields)]
        struct $file {
            #[serde(rename = "format")]
            _format: i64,
            #[serde(rename = "kind")]
            _kind: String,
            name: Option<String>,
            class: Option<String>,
            range_min: Option<f64>,
            range_max: Option<f64>,
            max_incidence_deg: Option<f64>,
            turn_s: Option<f64>,
            mount: Option<MountTable>,
            noise: Option<NoiseTable>,
            $($key: $type),*
        }

        impl $file {
            fn common(&self, name: &str, class: &str, geometry: Geometry) -> Result<SensorSpec> {
                let text = |given: &Option<String>, otherwise: &str| given.clone().unwrap_or_else(|| otherwise.to_owned());
                let mut spec = SensorSpec::new(text(&self.name, name), text(&self.class, class), geometry);
                spec.range_min = self.range_min.unwrap_or(0.0);
                spec.range_max = self.range_max.unwrap_or(f64::INFINITY);
                spec.turn_s = self.turn_s.unwrap_or(0.0);
                spec.max_incidence = self.max_incidence_deg.map(f64::to_radians);
                spec.mount = self.mount.as_ref().map_or(Ok(Pose::IDENTITY), |m| m.pose().map_err(|e| e.at("[mount]")))?;
                spec.noise = self.noise.as_ref().map(NoiseTable::noise).unwrap_or_default();
                Ok(spec)
            }
        }
    };
}

sensor_file!(CameraFile {
    width: u32,
    height: u32,
    fx: f64,
    fy: f64,
    cx: f64,
    cy: f64,
    distortion: Option<DistortionTable>,
    optical_from_image: Option<[f64; 4]>,
});

sensor_file!(ScannerFile { azimuth: AnglesTable, elevation: AnglesTable, beam_height_deg: Option<f64> });

sensor_file!(RaysFile { width: u32, height: u32, directions: Option<Vec<[f64; 3]>>, file: Option<String> });

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct DistortionTable {
    model: String,
    #[serde(default)]
    coefficients: Vec<f64>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct AnglesTable {
    start_deg: Option<f64>,
    step_deg: Option<f64>,
    count: Option<u32>,
    angles_deg: Option<Vec<f64>>,
}

/// `robot_from_sensor` of a sensor file or a robot file.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct MountTable {
    #[serde(default)]
    xyz: [f64; 3],
    rpy_deg: Option<[f64; 3]>,
    quaternion: Option<[f64; 4]>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct NoiseTable {
    #[serde(default)]
    range_sigma: f64,
    #[serde(default)]
    angle_sigma_deg: f64,
    #[serde(default)]
    pixel_sigma: f64,
    #[serde(default)]
    range_sigma_quadratic: f64,
    #[serde(default)]
    stamp_sigma_s: f64,
    p_hit: Option<f64>,
    p_short: Option<f64>,
    p_none: Option<f64>,
    p_any: Option<f64>,
    beam_dependence: Option<f64>,
}

impl NoiseTable {
    fn noise(&self) -> Noise {
        let usual = Mixture::default();
        Noise {
            range_sigma: self.range_sigma,
            range_sigma_quadratic: self.range_sigma_quadratic,
            angle_sigma: self.angle_sigma_deg.to_radians(),
            pixel_sigma: self.pixel_sigma,
            stamp_sigma: self.stamp_sigma_s,
            mixture: Mixture {
                hit: self.p_hit.unwrap_or(usual.hit),
                short: self.p_short.unwrap_or(usual.short),
                none: self.p_none.unwrap_or(usual.none),
                any: self.p_any.unwrap_or(usual.any),
                beam_dependence: self.beam_dependence.unwrap_or(usual.beam_dependence),
            },
        }
    }
}

impl MountTable {
    pub(super) fn pose(&self) -> Result<Pose> {
        const UNSOUND: &str = "a number is not finite or too large, or the quaternion has no length";
        let wrong = |what: &str| Error::invalid(what, "give xyz in metres, and rpy_deg or quaternion = [x, y, z, w]");
        let translation = DVec3::from_array(self.xyz);
        let pose = match (self.rpy_deg, self.quaternion) {
            (Some(_), Some(_)) => return Err(wrong("rpy_deg and quaternion are both given")),
            (rpy, None) => {
                let [roll, pitch, yaw] = rpy.unwrap_or_default().map(f64::to_radians);
                Pose::from_xyz_rpy(translation, roll, pitch, yaw)
            }
            (None, Some(q)) => {
                let q = DQuat::from_array(q);
                let near = Pose::new(translation, q).map_err(|_| wrong(UNSOUND))?;
                // A unit quaternion keeps its bits, so that a written pose reads back equal.
                let rotation = if (q.length_squared() - 1.0).abs() <= 1e-12 { q } else { near.rotation };
                Pose { rotation, translation }
            }
        };
        // Non-finite angles give a non-finite rotation.
        Pose::new(pose.translation, pose.rotation).map_err(|_| wrong(UNSOUND))?;
        Ok(pose)
    }
}

impl AnglesTable {
    fn angles(self) -> Result<Angles> {
        match (self.start_deg, self.step_deg, self.count, self.angles_deg) {
            (Some(start_deg), Some(step_deg), Some(count), None) => Ok(Angles::Uniform { start_deg, step_deg, count }),
            (None, None, None, Some(listed)) => Ok(Angles::Listed(listed)),
            _ => Err(Error::invalid(
                "neither a uniform grid nor a list",
                "give start_deg, step_deg and count, or angles_deg alone",
            )),
        }
    }
}

impl CameraFile {
    fn spec(self, name: &str) -> Result<SensorSpec> {
        let distortion = match &self.distortion {
            None => Distortion::None,
            Some(d) => Distortion::from_model(&d.model, &d.coefficients).map_err(|e| e.at("[distortion]"))?,
        };
        let camera = Camera {
            width: self.width,
            height: self.height,
            fx: self.fx,
            fy: self.fy,
            cx: self.cx,
            cy: self.cy,
            distortion,
        };
        let mut spec = self.common(name, "video", Geometry::Camera(camera))?;
        if let Some(turn) = self.optical_from_image {
            let turn = MountTable { xyz: [0.0; 3], rpy_deg: None, quaternion: Some(turn) }.pose();
            spec.optical_from_image = turn.map_err(|e| e.at("optical_from_image"))?.rotation;
        }
        Ok(spec)
    }
}

impl ScannerFile {
    fn spec(mut self, name: &str) -> Result<SensorSpec> {
        let empty = || AnglesTable { start_deg: None, step_deg: None, count: None, angles_deg: None };
        let azimuth = std::mem::replace(&mut self.azimuth, empty()).angles().map_err(|e| e.at("[azimuth]"))?;
        let elevation = std::mem::replace(&mut self.elevation, empty()).angles().map_err(|e| e.at("[elevation]"))?;
        let scanner = Scanner { azimuth, elevation, beam_height_deg: self.beam_height_deg };
        self.common(name, "laser", Geometry::Scanner(scanner))
    }
}

impl RaysFile {
    fn spec(mut self, name: &str, folder: Option<&Path>) -> Result<SensorSpec> {
        let directions = match (self.directions.take(), &self.file) {
            (Some(inline), None) => inline.into_iter().map(DVec3::from_array).collect(),
            (None, Some(file)) => from_text(&folder.unwrap_or(Path::new("")).join(file), parse_directions)?,
            _ => {
                return Err(Error::invalid(
                    "a ray table needs either directions or file",
                    "give directions = [[x, y, z], ..] or file = \"X.csv\"",
                ));
            }
        };
        let table = RayTable::new(self.width, self.height, directions)?;
        self.common(name, "laser", Geometry::Rays(table))
    }
}

/// Parses directions `x,y,z`, one per line; skips empty lines and lines that start with `#`.
fn parse_directions(text: &str) -> Result<Vec<DVec3>> {
    let mut directions = Vec::new();
    for (i, line) in text.lines().enumerate() {
        let line = line.trim();
        if line.is_empty() || line.starts_with('#') {
            continue;
        }
        let numbers: Option<Vec<f64>> = line.split(',').map(|n| n.trim().parse().ok()).collect();
        let Some(&[x, y, z]) = numbers.as_deref() else {
            return Err(Error::invalid(
                format!("{} is not a direction", quoted(line)),
                "write x,y,z (nan,nan,nan for no ray)",
            )
            .at(format!("line {}", i + 1)));
        };
        directions.push(DVec3::new(x, y, z));
        if directions.len() as u64 > limits::MAX_PIXELS {
            return Err(Error::invalid("too many directions", format!("give at most {}", limits::MAX_PIXELS)));
        }
    }
    Ok(directions)
}
