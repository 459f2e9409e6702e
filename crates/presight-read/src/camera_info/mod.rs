//! Calibrations of cameras in YAML, each recognized by its keys:
//! - ROS camera_info: a file of `camera_calibration`, or a `sensor_msgs/CameraInfo` message as `topic echo` prints it;
//! - OpenCV's `FileStorage` (`%YAML:1.0`, `!!opencv-matrix`) with keys of the same meaning (`ros` reads both);
//! - Kalibr's camchain, from which one camera is taken, and EuRoC's `sensor.yaml` (`chain` reads both).
//!
//! A file of another tool is recognized by its keys and refused; the error names the tool (`others`).

mod chain;
mod others;
mod ros;
#[cfg(test)]
mod tests;

use super::text::from_settings;
use presight_model::error::{Error, ErrorKind, Result};
use presight_model::sensor::{Distortion, SensorSpec};
use serde::Deserialize;
use serde::de::{DeserializeOwned, IgnoredAny};
use std::borrow::Cow;
use std::collections::BTreeMap;
use std::path::Path;

/// The keys of a mapping.
type Keys = BTreeMap<String, IgnoredAny>;

/// Reads the calibration of a camera. Also returns notices on parts of the file that are not used.
///
/// `camera` is the key of a camera of a camchain, such as `cam1`; by default the first one is taken. `rectified` asks
/// for the rectified camera of a camera_info (P, and R as [`SensorSpec::optical_from_image`]), not the raw one (K and
/// D).
///
/// # Errors
/// [`ErrorKind::Invalid`] with the line or key at fault; [`ErrorKind::Unsupported`] for a format and for a lens that
/// presight lacks; [`ErrorKind::Usage`] for a camera or a rectified image that the file does not have;
/// [`ErrorKind::System`] if the system refuses.
pub fn read(path: &Path, camera: Option<&str>, rectified: bool) -> Result<(SensorSpec, Vec<String>)> {
    let name = path.file_stem().map_or_else(|| "camera".into(), |s| s.to_string_lossy());
    from_settings(path, |text| parse(text, &name, camera, rectified))
}

/// Reads the text of a calibration. `name` is used if the text gives none.
///
/// # Errors
/// As [`read`], without the file.
pub fn parse(text: &str, name: &str, camera: Option<&str>, rectified: bool) -> Result<(SensorSpec, Vec<String>)> {
    let text = &without_opencv(text);
    let text = first_document(text);
    let keys: Keys = yaml(text)?;
    others::refuse(&keys)?;
    let is_chain = chain::cameras(&keys).next().is_some();
    if let Some(camera) = camera.filter(|_| !is_chain) {
        let what = format!("camera {camera:?} of a file with a single one");
        return Err(Error::usage(what, "give the name of the file alone"));
    }
    if !is_chain && !keys.contains_key("intrinsics") {
        return ros::parse(text, &keys, name, rectified);
    }
    if rectified {
        let remedy = "give a camera_info, or drop `rectified: true`";
        return Err(Error::usage("the file has no P and R of a rectified image", remedy));
    }
    chain::parse(text, &keys, name, camera)
}

/// Reads the message of a camera. Also returns notices on parts that are not used.
///
/// # Errors
/// As [`read`], without the file.
#[cfg(feature = "ros")]
pub fn of_message(info: &presight_ros::message::CameraInfo, rectified: bool) -> Result<(SensorSpec, Vec<String>)> {
    ros::of_message(info, rectified)
}

/// Turns OpenCV's YAML into plain YAML with the same lines and columns. Its directive `%YAML:1.0` and its tags
/// `!!opencv-..` are invalid YAML, and the keys hold the same information.
fn without_opencv(text: &str) -> Cow<'_, str> {
    const TAG: &str = "!!opencv-";
    if !text.starts_with('%') && !text.contains(TAG) {
        return Cow::Borrowed(text);
    }
    let mut plain = String::with_capacity(text.len());
    for (number, line) in text.split_inclusive('\n').enumerate() {
        if number == 0 && line.starts_with('%') {
            plain.push('\n');
            continue;
        }
        let mut rest = line;
        while let Some((before, tagged)) = rest.split_once(TAG) {
            let length = tagged.find(|c: char| !c.is_ascii_alphanumeric() && c != '-').unwrap_or(tagged.len());
            plain.push_str(before);
            plain.extend(std::iter::repeat_n(' ', TAG.len() + length));
            rest = &tagged[length..];
        }
        plain.push_str(rest);
    }
    Cow::Owned(plain)
}

/// The text up to the `---` with which `topic echo` ends every message.
fn first_document(text: &str) -> &str {
    let (mut at, mut has_begun) = (0, false);
    for line in text.split_inclusive('\n') {
        if has_begun && line.starts_with("---") {
            return &text[..at];
        }
        has_begun |= !(line.trim().is_empty() || line.starts_with('#') || line.starts_with("---"));
        at += line.len();
    }
    text
}

fn yaml<T: DeserializeOwned>(text: &str) -> Result<T> {
    let remedy = "give a ROS camera_info: image_width, image_height, camera_matrix, distortion_coefficients";
    crate::yaml::yaml(text, remedy)
}

/// Keys without any effect on images, which need no notice.
const SILENT: [&str; 8] =
    ["header", "sensor_type", "comment", "rostopic", "rate_hz", "cam_overlaps", "calibration_time", "camera_name"];

/// The notice on keys that are not used, if there are any.
fn unused(keys: &Keys, is_used: impl Fn(&str) -> bool) -> Option<String> {
    let unused: Vec<String> =
        keys.keys().filter(|k| !is_used(k) && !SILENT.contains(&k.as_str())).map(|k| format!("{k:?}")).collect();
    match unused.as_slice() {
        [] => None,
        [only] => Some(format!("key {only} is not used")),
        several => Some(format!("keys {} are not used", several.join(", "))),
    }
}

/// Names of lens models in these formats that [`Distortion::from_model`] does not know.
const ALIASES: [(&str, &str); 3] =
    [("radtan", "plumb_bob"), ("radial-tangential", "plumb_bob"), ("equi", "equidistant")];

/// Makes a lens from a model's name in any of the formats.
fn lens(model: &str, coefficients: &[f64]) -> Result<Distortion> {
    let model = ALIASES.iter().find(|(alias, _)| *alias == model).map_or(model, |(_, model)| *model);
    if !matches!(model, "none" | "plumb_bob" | "rational_polynomial" | "equidistant" | "kannala_brandt" | "fisheye") {
        return Err(Error::new(
            ErrorKind::Unsupported,
            format!("distortion model {model:?}"),
            "give plumb_bob (radtan), rational_polynomial, equidistant or fisheye",
        )
        .at("distortion_model"));
    }
    Distortion::from_model(model, coefficients).map_err(|e| e.at("distortion_coefficients"))
}

/// The distance of the principal point from the middle of the image, in shares of its sides, from which on the
/// calibration is doubted. K of images with half as many columns and rows puts it at 0.35.
const FAR: f64 = 0.25;

fn from_middle([width, height]: [u32; 2], [cx, cy]: [f64; 2]) -> f64 {
    let off = |c: f64, side: u32| (c + 0.5) / f64::from(side) - 0.5;
    off(cx, width).hypot(off(cy, height))
}

/// A warning with both readings if the principal point is far from the middle of the image: the calibration was then
/// often made on images of another size, before or after binning.
fn off_centre(size: [u32; 2], binned: [u32; 2], c: [f64; 2]) -> Option<String> {
    if !(from_middle(size, c) > FAR) {
        return None;
    }
    let ([width, height], [cx, cy]) = (size, c);
    let far = format!("the principal point ({cx}, {cy}) is far from the middle of {width} x {height}");
    let [w, h] = binned;
    if binned != size && w > 0 && h > 0 && from_middle(binned, c) < from_middle(size, c) {
        return Some(format!(
            "{far}: K is taken for the full image, as ROS defines it; if it is that of the binned image, {w} x {h}, \
             write this size as width and height, and binning_x and binning_y of 1"
        ));
    }
    let [w, h] = c.map(|c| 2.0 * c + 1.0);
    Some(format!(
        "{far}: K is used unchanged; if it was calibrated on images of another size, whose middle this is ({w:.0} x \
         {h:.0}), give that size, or K of this one"
    ))
}

/// A matrix in a calibration file, or a plain list in a message.
#[derive(Deserialize)]
#[serde(untagged)]
enum Numbers {
    List(Vec<f64>),
    Matrix { data: Vec<f64> },
}

impl Numbers {
    fn as_slice(&self) -> &[f64] {
        match self {
            Self::List(data) | Self::Matrix { data } => data,
        }
    }
}
