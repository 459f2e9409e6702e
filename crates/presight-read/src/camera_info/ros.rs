//! ROS camera_info, and OpenCV's `FileStorage` with keys of the same meaning.
//!
//! The sensor is the *raw* image, given by K, D, binning and region of interest, or the *rectified* one, given by P and
//! R. R turns the optical frame of the camera into that of the rectified image: x_rectified = R x_camera. Poses stay
//! those of the camera. In P = [fx 0 cx Tx; 0 fy cy Ty; 0 0 1 0] the last column is the offset from the first camera of
//! a stereo pair; the image does not depend on it.
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

use super::{Keys, Numbers, lens, off_centre, unused, yaml};
use glam::{DMat3, DQuat};
use presight_model::error::{Error, ErrorKind, Result};
use presight_model::sensor::{Camera, Distortion, Geometry, SensorSpec};
#[cfg(feature = "ros")]
use presight_ros::message::CameraInfo;
use serde::Deserialize;

#[derive(Deserialize)]
struct File {
    #[serde(alias = "image_width", alias = "image_Width")]
    width: Option<u32>,
    #[serde(alias = "image_height", alias = "image_Height")]
    height: Option<u32>,
    /// OpenCV: width and height.
    #[serde(alias = "imageSize")]
    image_size: Option<[u32; 2]>,
    camera_name: Option<String>,
    #[serde(alias = "K", alias = "k", alias = "cameraMatrix", alias = "Camera_Matrix")]
    camera_matrix: Numbers,
    distortion_model: Option<String>,
    /// An old name of `distortion_model`, or `pinhole`.
    camera_model: Option<String>,
    /// OpenCV: not 0 if the coefficients belong to the fisheye model.
    fisheye_model: Option<i64>,
    #[serde(alias = "D", alias = "d", alias = "distCoeffs", alias = "Distortion_Coefficients")]
    distortion_coefficients: Option<Numbers>,
    #[serde(alias = "R", alias = "r")]
    rectification_matrix: Option<Numbers>,
    #[serde(alias = "P", alias = "p")]
    projection_matrix: Option<Numbers>,
    #[serde(default)]
    binning_x: u32,
    #[serde(default)]
    binning_y: u32,
    #[serde(default)]
    roi: Roi,
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

/// Keys of [`File`] without the keys of the rectified image.
const USED: [&str; 24] = [
    "image_width",
    "image_Width",
    "width",
    "image_height",
    "image_Height",
    "height",
    "image_size",
    "imageSize",
    "camera_matrix",
    "K",
    "k",
    "cameraMatrix",
    "Camera_Matrix",
    "distortion_model",
    "camera_model",
    "fisheye_model",
    "distortion_coefficients",
    "D",
    "d",
    "distCoeffs",
    "Distortion_Coefficients",
    "binning_x",
    "binning_y",
    "roi",
];

/// # Errors
/// Those of [`super::read`].
pub(super) fn parse(text: &str, keys: &Keys, name: &str, rectified: bool) -> Result<(SensorSpec, Vec<String>)> {
    let file: File = yaml(text)?;
    let mut notices = Vec::new();
    let of_rectified = |key: &str| matches!(key, "R" | "r" | "P" | "p" | "rectification_matrix" | "projection_matrix");
    if !rectified && keys.keys().any(|k| of_rectified(k)) {
        notices
            .push("R and P are ignored: the raw image is predicted; `rectified: true` is the rectified one".to_owned());
    }
    notices.extend(unused(keys, |key| USED.contains(&key) || of_rectified(key)));
    let name = file.camera_name.clone().filter(|n| !n.is_empty()).unwrap_or_else(|| name.to_owned());
    Ok((file.spec(name, rectified, &mut notices)?, notices))
}

/// The camera of a message; its name is the frame of the message.
///
/// # Errors
/// Those of [`super::read`].
#[cfg(feature = "ros")]
pub(super) fn of_message(info: &CameraInfo, rectified: bool) -> Result<(SensorSpec, Vec<String>)> {
    let [x_offset, y_offset, height, width] = info.roi;
    let model = if info.distortion_model.is_empty() { "plumb_bob" } else { &info.distortion_model };
    let file = File {
        width: Some(info.width),
        height: Some(info.height),
        image_size: None,
        camera_name: None,
        camera_matrix: Numbers::List(info.k.to_vec()),
        distortion_model: Some(model.to_owned()),
        camera_model: None,
        fisheye_model: None,
        distortion_coefficients: Some(Numbers::List(info.d.clone())),
        rectification_matrix: Some(Numbers::List(info.r.to_vec())),
        projection_matrix: Some(Numbers::List(info.p.to_vec())),
        binning_x: info.binning[0],
        binning_y: info.binning[1],
        // Images of a topic are raw or rectified, whatever a request says.
        roi: Roi { x_offset, y_offset, height, width, do_rectify: false },
    };
    let mut notices = Vec::new();
    Ok((file.spec(info.header.frame_id.clone(), rectified, &mut notices)?, notices))
}

/// fx, fy, cx, cy.
type Intrinsics = [f64; 4];

impl File {
    /// The raw or the rectified camera.
    fn spec(&self, name: String, rectified: bool, notices: &mut Vec<String>) -> Result<SensorSpec> {
        let raw = self.raw()?;
        let (image, turn) = if rectified { self.rectified(notices)? } else { (raw, DQuat::IDENTITY) };
        let size = self.size()?;
        let [bx, by] = self.binning();
        notices.extend(off_centre(size, [size[0] / bx, size[1] / by], [raw[2], raw[3]]));
        let lens = if rectified { Distortion::None } else { self.distortion(notices)? };
        let camera = self.camera(size, image, lens, notices)?;
        let mut spec = SensorSpec::new(name, "video", Geometry::Camera(camera));
        spec.optical_from_image = turn;
        Ok(spec)
    }

    fn size(&self) -> Result<[u32; 2]> {
        let listed = self.image_size.map(|size| size.map(Some)).unwrap_or([self.width, self.height]);
        match listed {
            [Some(width), Some(height)] => Ok([width, height]),
            [width, _] => {
                let key = if width.is_none() { "image_width" } else { "image_height" };
                Err(Error::invalid(format!("{key} is missing"), "add it, in pixels"))
            }
        }
    }

    fn binning(&self) -> [u32; 2] {
        [self.binning_x.max(1), self.binning_y.max(1)]
    }

    /// K.
    fn raw(&self) -> Result<Intrinsics> {
        let at = |e: Error| e.at("camera_matrix");
        let &[fx, skew, cx, zero_1, fy, cy, zero_2, zero_3, one] = self.camera_matrix.as_slice() else {
            let count = self.camera_matrix.as_slice().len();
            return Err(at(Error::invalid(format!("{count} numbers"), "give 9 numbers, row by row")));
        };
        if fx == 0.0 && fy == 0.0 {
            return Err(at(Error::invalid("the focal lengths are 0: the camera is not calibrated", "calibrate it")));
        }
        if [skew, zero_1, zero_2, zero_3] != [0.0; 4] || one != 1.0 {
            let what = "K is not [fx 0 cx; 0 fy cy; 0 0 1]";
            return Err(at(Error::new(ErrorKind::Unsupported, what, "give a camera without skew")));
        }
        Ok([fx, fy, cx, cy])
    }

    /// P, and optical_from_image.
    fn rectified(&self, notices: &mut Vec<String>) -> Result<(Intrinsics, DQuat)> {
        let numbers = |given: &Option<Numbers>, count: usize, place: &'static str| {
            let numbers = given.as_ref().map_or(&[][..], Numbers::as_slice).to_vec();
            let fault = match numbers.len() {
                0 => "it is missing".to_owned(),
                given if given != count => format!("{given} numbers"),
                _ if numbers.iter().all(|x| *x == 0.0) => "it is all 0".to_owned(),
                _ => return Ok(numbers),
            };
            let remedy = format!("give {count} numbers, row by row, or drop `rectified: true` for the raw image");
            Err(Error::invalid(format!("{fault}: the camera has no rectified image"), remedy).at(place))
        };
        let p = numbers(&self.projection_matrix, 12, "projection_matrix")?;
        let r = numbers(&self.rectification_matrix, 9, "rectification_matrix")?;
        let (fx, cx, tx, fy, cy, ty) = (p[0], p[2], p[3], p[5], p[6], p[7]);
        if [p[1], p[4], p[8], p[9], p[11]] != [0.0; 5] || p[10] != 1.0 {
            let what = "P is not [fx 0 cx Tx; 0 fy cy Ty; 0 0 1 0]";
            return Err(Error::new(ErrorKind::Unsupported, what, "give a camera without skew").at("projection_matrix"));
        }
        let image_from_optical = DMat3::from_cols_slice(&r).transpose();
        let off = image_from_optical * image_from_optical.transpose() - DMat3::IDENTITY;
        if !(off.to_cols_array().iter().all(|x| x.abs() < NOT_TURNED) && image_from_optical.determinant() > 0.0) {
            let what = "R is not a rotation";
            return Err(Error::invalid(what, "give its 9 numbers, row by row").at("rectification_matrix"));
        }
        if tx != 0.0 || ty != 0.0 {
            notices.push(format!(
                "P belongs to a camera {:.4} m right of and {:.4} m below the first one of its stereo pair: poses are \
                 poses of this camera",
                0.0 - tx / fx,
                0.0 - ty / fy
            ));
        }
        Ok(([fx, fy, cx, cy], DQuat::from_mat3(&image_from_optical.transpose()).normalize()))
    }

    fn camera(
        &self,
        [width, height]: [u32; 2],
        image: Intrinsics,
        lens: Distortion,
        notices: &mut Vec<String>,
    ) -> Result<Camera> {
        let roi = self.region([width, height], notices)?;
        let [bx, by] = self.binning();
        if bx > 1 || by > 1 {
            notices.push(format!(
                "binning {bx} x {by}: the principal point is that of averaged pixels; image_geometry places it {} and \
                 {} pixels further right and down",
                shift(bx),
                shift(by)
            ));
        }
        debug_assert!(roi.x_offset <= width && roi.y_offset <= height);
        let [fx, fy, cx, cy] = image;
        Ok(Camera {
            width: roi.width / bx,
            height: roi.height / by,
            fx: fx / f64::from(bx),
            fy: fy / f64::from(by),
            cx: binned(cx, roi.x_offset, bx),
            cy: binned(cy, roi.y_offset, by),
            distortion: lens,
        })
    }

    /// The region of interest, or the whole image if all its numbers are zero.
    fn region(&self, full: [u32; 2], notices: &mut Vec<String>) -> Result<Roi> {
        let r = &self.roi;
        if r.do_rectify {
            notices.push("roi.do_rectify is ignored: the raw image is predicted".to_owned());
        }
        let whole = [r.x_offset, r.y_offset, r.width, r.height] == [0; 4];
        let (width, height) = if whole { (full[0], full[1]) } else { (r.width, r.height) };
        let fits =
            |offset: u32, side: u32, full: u32| side > 0 && u64::from(offset) + u64::from(side) <= u64::from(full);
        let inside = fits(r.x_offset, width, full[0]) && fits(r.y_offset, height, full[1]);
        if !(whole || inside) {
            return Err(Error::invalid(
                format!("{width} x {height} pixels from ({}, {}) are not inside the image", r.x_offset, r.y_offset),
                "give the region in pixels of the full resolution, or all zeros",
            )
            .at("roi"));
        }
        Ok(Roi { x_offset: r.x_offset, y_offset: r.y_offset, width, height, do_rectify: false })
    }

    fn distortion(&self, notices: &mut Vec<String>) -> Result<Distortion> {
        let coefficients = self.distortion_coefficients.as_ref().map_or(&[][..], Numbers::as_slice);
        let named =
            self.distortion_model.as_deref().or(self.camera_model.as_deref().filter(|model| *model != "pinhole"));
        let model = match named.filter(|model| !model.is_empty()) {
            Some(model) => model,
            None if self.fisheye_model.is_some_and(|is| is != 0) => "fisheye",
            None => {
                // OpenCV chooses the model by the number of coefficients.
                let rational = coefficients.iter().skip(5).any(|c| *c != 0.0);
                let model = if rational { "rational_polynomial" } else { "plumb_bob" };
                if coefficients.iter().any(|c| *c != 0.0) {
                    notices.push(format!("no distortion_model: taken as {model}, as ROS and OpenCV do"));
                }
                model
            }
        };
        if coefficients.is_empty() && model == "plumb_bob" {
            return Ok(Distortion::None);
        }
        lens(model, coefficients)
    }
}

/// Maximum difference between an element of R R^T and that of the identity; files have at least four digits.
const NOT_TURNED: f64 = 1e-3;

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
