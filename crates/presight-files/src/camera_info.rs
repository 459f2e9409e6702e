//! ROS camera_info YAML: a file of `camera_calibration`, or a `sensor_msgs/CameraInfo` message as `topic echo` prints
//! it.
//!
//! The sensor is the *raw* image, given by K, D, binning and region of interest. R and P describe the rectified image
//! and are ignored, with a notice.
//!
//! The region of interest is given in pixels of the full resolution and cut out first. Then `binning_x` x `binning_y`
//! pixels become one ("combines rectangular neighborhoods of pixels into larger super-pixels", CameraInfo.msg). With
//! pixel centres at integers, super-pixel i covers pixels b i .. b i + b - 1 and has its centre at b i + (b - 1) / 2,
//! so
//!
//! `fx' = fx / b`, `cx' = (cx - x_offset + 0.5) / b - 0.5`
//!
//! ROS's `image_geometry` omits both halves, `cx' = (cx - x_offset) / b`, which is right only for cameras that skip
//! pixels and keep the first. The difference is (b - 1) / (2 b), under half a binned pixel; a notice reports it.

use super::text::{from_settings, line_of};
use presight_model::error::{Error, ErrorKind, Result};
use presight_model::sensor::{Camera, Distortion, Geometry, SensorSpec};
use serde::Deserialize;
use serde::de::{DeserializeOwned, IgnoredAny};
use std::collections::BTreeMap;
use std::path::Path;

/// Reads a camera_info YAML. Also returns notices on parts of the file that are not used.
///
/// # Errors
/// [`ErrorKind::Invalid`] with the line or key at fault; [`ErrorKind::Unsupported`] for a distortion
/// model that presight lacks; [`ErrorKind::System`] if the system refuses.
pub fn read(path: &Path) -> Result<(SensorSpec, Vec<String>)> {
    let name = path.file_stem().map_or_else(|| "camera".into(), |s| s.to_string_lossy());
    from_settings(path, |text| parse(text, &name))
}

#[derive(Deserialize)]
struct File {
    #[serde(alias = "image_width")]
    width: u32,
    #[serde(alias = "image_height")]
    height: u32,
    camera_name: Option<String>,
    #[serde(alias = "K", alias = "k")]
    camera_matrix: Numbers,
    #[serde(alias = "camera_model")]
    distortion_model: Option<String>,
    #[serde(alias = "D", alias = "d")]
    distortion_coefficients: Option<Numbers>,
    #[serde(default)]
    binning_x: u32,
    #[serde(default)]
    binning_y: u32,
    #[serde(default)]
    roi: Roi,
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

#[derive(Default, Deserialize)]
#[serde(default)]
struct Roi {
    x_offset: u32,
    y_offset: u32,
    height: u32,
    width: u32,
    do_rectify: bool,
}

/// Reads the text of a camera_info YAML. `name` is used if the text gives no `camera_name`.
///
/// # Errors
/// As [`read`], without the file.
pub fn parse(text: &str, name: &str) -> Result<(SensorSpec, Vec<String>)> {
    let text = first_document(text);
    let keys: BTreeMap<String, IgnoredAny> = yaml(text)?;
    let file: File = yaml(text)?;
    let mut notices = Vec::new();
    notice_keys(&keys, &mut notices);
    let camera = camera(&file, &mut notices)?;
    let name = file.camera_name.filter(|n| !n.is_empty()).unwrap_or_else(|| name.to_owned());
    Ok((SensorSpec::new(name, "video", Geometry::Camera(camera)), notices))
}

/// The text up to the `---` with which `topic echo` ends every message.
fn first_document(text: &str) -> &str {
    let first_key = text.find(':').unwrap_or(text.len());
    let end = text[first_key..].find("\n---").map_or(text.len(), |i| first_key + i + 1);
    &text[..end]
}

/// Most nodes of a file, with every use of an alias counted.
const MAX_NODES: usize = 10_000;

fn yaml<T: DeserializeOwned>(text: &str) -> Result<T> {
    // Aliases can expand into very many nodes; a camera has under a hundred.
    let options = serde_saphyr::options! { budget: serde_saphyr::budget! { max_nodes: MAX_NODES } };
    serde_saphyr::from_str_with_options(text, options).map_err(|e| {
        let wrong = Error::invalid(
            e.without_snippet().to_string(),
            "give a ROS camera_info: image_width, image_height, camera_matrix, distortion_coefficients",
        );
        match e.location() {
            // Line 0 means unknown.
            Some(place) if place.line() > 0 => {
                wrong.at(format!("line {}", place.line().min(line_of(text, text.len()) as u64)))
            }
            _ => wrong,
        }
    })
}

fn notice_keys(keys: &BTreeMap<String, IgnoredAny>, notices: &mut Vec<String>) {
    let used = |key: &str| {
        matches!(
            key,
            "image_width"
                | "width"
                | "image_height"
                | "height"
                | "camera_name"
                | "camera_matrix"
                | "K"
                | "k"
                | "distortion_model"
                | "camera_model"
                | "distortion_coefficients"
                | "D"
                | "d"
                | "binning_x"
                | "binning_y"
                | "roi"
                | "header"
        )
    };
    let rectified = |key: &str| matches!(key, "R" | "r" | "P" | "p" | "rectification_matrix" | "projection_matrix");
    if keys.keys().any(|k| rectified(k)) {
        notices.push("R and P are ignored: the raw image is predicted, not the rectified one".to_owned());
    }
    for key in keys.keys().filter(|k| !used(k) && !rectified(k)) {
        notices.push(format!("key {key:?} is not used"));
    }
}

fn camera(file: &File, notices: &mut Vec<String>) -> Result<Camera> {
    let &[fx, skew, cx, zero_1, fy, cy, zero_2, zero_3, one] = file.camera_matrix.as_slice() else {
        let count = file.camera_matrix.as_slice().len();
        return Err(Error::invalid(format!("{count} numbers"), "give 9 numbers, row by row").at("camera_matrix"));
    };
    if fx == 0.0 && fy == 0.0 {
        return Err(
            Error::invalid("the focal lengths are 0: the camera is not calibrated", "calibrate it").at("camera_matrix")
        );
    }
    if [skew, zero_1, zero_2, zero_3] != [0.0; 4] || one != 1.0 {
        return Err(Error::new(
            ErrorKind::Unsupported,
            "K is not [fx 0 cx; 0 fy cy; 0 0 1]",
            "give a camera without skew",
        )
        .at("camera_matrix"));
    }
    let (width, height) = (file.width, file.height);
    let roi = region(file, notices)?;
    let (bx, by) = (file.binning_x.max(1), file.binning_y.max(1));
    if bx > 1 || by > 1 {
        notices.push(format!(
            "binning {bx} x {by}: the principal point is that of averaged pixels; image_geometry places it {} and {} \
             pixels further right and down",
            shift(bx),
            shift(by)
        ));
    }
    debug_assert!(roi.x_offset <= width && roi.y_offset <= height);
    Ok(Camera {
        width: roi.width / bx,
        height: roi.height / by,
        fx: fx / f64::from(bx),
        fy: fy / f64::from(by),
        cx: binned(cx, roi.x_offset, bx),
        cy: binned(cy, roi.y_offset, by),
        distortion: distortion(file, notices)?,
    })
}

/// Principal point after cutting and binning; see the module documentation.
fn binned(c: f64, offset: u32, binning: u32) -> f64 {
    if binning == 1 {
        return c - f64::from(offset);
    }
    (c - f64::from(offset) + 0.5) / f64::from(binning) - 0.5
}

/// Offset of the principal point in image_geometry, which omits 0.5 / b - 0.5.
fn shift(binning: u32) -> f64 {
    0.5 - 0.5 / f64::from(binning)
}

/// The region of interest, or the whole image if all its numbers are zero.
fn region(file: &File, notices: &mut Vec<String>) -> Result<Roi> {
    let r = &file.roi;
    if r.do_rectify {
        notices.push("roi.do_rectify is ignored: the raw image is predicted".to_owned());
    }
    let whole = [r.x_offset, r.y_offset, r.width, r.height] == [0; 4];
    let (width, height) = if whole { (file.width, file.height) } else { (r.width, r.height) };
    let fits = |offset: u32, side: u32, full: u32| side > 0 && u64::from(offset) + u64::from(side) <= u64::from(full);
    let inside = fits(r.x_offset, width, file.width) && fits(r.y_offset, height, file.height);
    if !(whole || inside) {
        return Err(Error::invalid(
            format!("{width} x {height} pixels from ({}, {}) are not inside the image", r.x_offset, r.y_offset),
            "give the region in pixels of the full resolution, or all zeros",
        )
        .at("roi"));
    }
    Ok(Roi { x_offset: r.x_offset, y_offset: r.y_offset, width, height, do_rectify: false })
}

fn distortion(file: &File, notices: &mut Vec<String>) -> Result<Distortion> {
    let mut coefficients = file.distortion_coefficients.as_ref().map_or(&[][..], Numbers::as_slice);
    let model = match file.distortion_model.as_deref() {
        None | Some("") => {
            if coefficients.iter().any(|c| *c != 0.0) {
                notices.push("no distortion_model: taken as plumb_bob, as ROS does".to_owned());
            }
            "plumb_bob"
        }
        Some(model) => model,
    };
    if !matches!(model, "none" | "plumb_bob" | "rational_polynomial" | "equidistant" | "kannala_brandt" | "fisheye") {
        return Err(Error::new(
            ErrorKind::Unsupported,
            format!("distortion model {model:?}"),
            "give plumb_bob, rational_polynomial, equidistant or fisheye",
        )
        .at("distortion_model"));
    }
    if coefficients.is_empty() && model == "plumb_bob" {
        return Ok(Distortion::None);
    }
    // In OpenCV, thin prism and tilt terms follow; drivers fill them with zeros.
    if model == "rational_polynomial" && coefficients.len() > 8 && coefficients[8..].iter().all(|c| *c == 0.0) {
        coefficients = &coefficients[..8];
    }
    Distortion::from_model(model, coefficients).map_err(|e| e.at("distortion_coefficients"))
}

#[cfg(test)]
mod tests {
    use super::*;

    const CALIBRATION: &str = "\
image_width: 1296
image_height: 972
camera_name: narrow_stereo
camera_matrix:
  rows: 3
  cols: 3
  data: [1874.63171,    0.     ,  647.5    ,
            0.     , 1879.55762,  485.5    ,
            0.     ,    0.     ,    1.     ]
distortion_model: plumb_bob
distortion_coefficients:
  rows: 1
  cols: 5
  data: [-0.25, 0.07, 0.0002, 0.00002, 0.0]
rectification_matrix: {rows: 3, cols: 3, data: [1., 0., 0., 0., 1., 0., 0., 0., 1.]}
projection_matrix: {rows: 3, cols: 4, data: [1854., 0., 649., 0., 0., 1863., 485., 0., 0., 0., 1., 0.]}
";

    fn camera_of(text: &str) -> Camera {
        let Geometry::Camera(camera) = parse(text, "c").unwrap().0.geometry else { panic!("no camera") };
        camera
    }

    #[test]
    fn a_calibration_file_is_read_and_its_rectification_is_not() {
        let (spec, notices) = parse(CALIBRATION, "c").unwrap();
        assert_eq!((spec.name.as_str(), spec.class.as_str()), ("narrow_stereo", "video"));
        assert_eq!(
            spec.geometry,
            Geometry::Camera(Camera {
                width: 1296,
                height: 972,
                fx: 1874.63171,
                fy: 1879.55762,
                cx: 647.5,
                cy: 485.5,
                distortion: Distortion::PlumbBob([-0.25, 0.07, 0.0002, 0.00002, 0.0]),
            })
        );
        assert_eq!(notices.len(), 1, "{notices:?}");
        assert!(notices[0].contains("R and P"));
    }

    #[test]
    fn a_message_as_topic_echo_prints_it_is_read() {
        let text = "header:\n  stamp: {sec: 1, nanosec: 2}\n  frame_id: cam\nheight: 480\nwidth: 640\n\
            distortion_model: equidistant\nd:\n- 0.1\n- -0.01\n- 0\n- 0.0\nk:\n- 300.0\n- 0.0\n- 320\n- 0.0\n- 301.0\n\
            - 240.5\n- 0.0\n- 0.0\n- 1.0\nbinning_x: 0\nbinning_y: 0\nroi:\n  x_offset: 0\n  y_offset: 0\n  height: 0\n\
            \x20 width: 0\n  do_rectify: false\n---\n";
        let camera = camera_of(text);
        assert_eq!((camera.width, camera.height, camera.cx, camera.cy), (640, 480, 320.0, 240.5));
        assert_eq!(camera.distortion, Distortion::Equidistant([0.1, -0.01, 0.0, 0.0]));
    }

    /// A binned pixel has the ray of the full image through the mean position of its pixels.
    #[test]
    fn region_first_then_binning_and_the_half_pixel_is_kept() {
        let full = camera_of(CALIBRATION);
        let text = format!(
            "{CALIBRATION}binning_x: 4\nbinning_y: 2\nroi: {{x_offset: 96, y_offset: 72, height: 501, width: 800, do_rectify: false}}\n"
        );
        let small = camera_of(&text);
        assert_eq!((small.width, small.height), (200, 250));
        for (u, v) in [(0.0, 0.0), (17.0, 200.0)] {
            let (x, y) = small.normalized(u, v);
            let (fx, fy) = full.normalized(96.0 + 4.0 * u + 1.5, 72.0 + 2.0 * v + 0.5);
            assert!((x - fx).abs() < 1e-14 && (y - fy).abs() < 1e-14);
        }
        let (_, notices) = parse(&text, "c").unwrap();
        assert!(notices.iter().any(|n| n.contains("0.375") && n.contains("0.25")), "{notices:?}");
    }

    #[test]
    fn faults_are_named() {
        let faults = [
            ("image_width: 1296", "image_width: wide", "line 1"),
            ("1874.63171", "0.0", "camera_matrix"),
            ("647.5    ,", "647.5, 3.0,", "camera_matrix"),
            ("plumb_bob", "thin_prism", "distortion_model"),
            ("[-0.25, 0.07,", "[", "distortion_coefficients"),
            (
                "image_height: 972",
                "roi: {x_offset: 1000, y_offset: 0, width: 300, height: 9}\nimage_height: 972",
                "roi",
            ),
        ];
        for (good, bad, place) in faults {
            let text = CALIBRATION.replace(good, bad);
            assert_ne!(text, CALIBRATION);
            // The case zeroes one focal length; zero the other too.
            let text = if place == "camera_matrix" { text.replace("1879.55762", "0.0") } else { text };
            let e = parse(&text, "c").unwrap_err();
            assert_eq!(e.place(), Some(place), "{e}");
        }
        // Each line repeats the one before ten times.
        let bomb: String =
            (0..4).map(|i| format!("k{}: &a{} [{}]\n", i + 1, i + 1, vec![format!("*a{i}"); 10].join(", "))).collect();
        let e = parse(&format!("k0: &a0 [{}]\n{bomb}", ["1"; 10].join(", ")), "c").unwrap_err();
        assert!(e.to_string().contains("budget"), "{e}");
        assert!(parse("a: [b", "c").is_err());
        assert!(parse("", "c").is_err());
        assert!(parse("image_width: 3", "c").is_err());
    }
}
