//! Files of other tools, known by their keys. They are refused by name, because their numbers mean something else.

use super::Keys;
use presight_model::error::{Error, ErrorKind, Result};

/// A key, or the start of keys, what has it, and what to give in its place.
const OTHERS: [(&str, &str, &str); 13] = [
    ("Camera.", ORB_SLAM, FROM_ORB_SLAM),
    ("Camera1.", ORB_SLAM, FROM_ORB_SLAM),
    ("model_type", "a camera of camodocal (VINS)", ONE_CAMERA),
    ("projection_parameters", "a camera of camodocal (VINS)", ONE_CAMERA),
    ("cam0_calib", "the settings of VINS", ONE_CAMERA),
    ("imu_topic", "the settings of VINS", ONE_CAMERA),
    ("M1", "OpenCV's calibration of a stereo pair", ONE_CAMERA),
    ("K1", "OpenCV's calibration of a stereo pair", ONE_CAMERA),
    ("cameraMatrix1", "OpenCV's calibration of a stereo pair", ONE_CAMERA),
    ("cameras", "a list of cameras (maplab, rovio)", ONE_CAMERA),
    ("target_type", "the calibration target of Kalibr", "give its camchain"),
    ("accelerometer_noise_density", "the calibration of an IMU", "give that of a camera"),
    ("gyroscope_noise_density", "the calibration of an IMU", "give that of a camera"),
];

const ORB_SLAM: &str = "the settings of ORB-SLAM";

const FROM_ORB_SLAM: &str = "give a ROS camera_info with camera_matrix from its fx, fy, cx, cy and \
                             distortion_coefficients from its k1, k2, p1, p2, k3";

const ONE_CAMERA: &str =
    "give a ROS camera_info of one camera: image_width, image_height, camera_matrix, distortion_coefficients";

/// # Errors
/// [`ErrorKind::Unsupported`] for the file of another tool; [`ErrorKind::Invalid`] without any key of a camera.
pub(super) fn refuse(keys: &Keys) -> Result<()> {
    let has = |start: &str| keys.keys().any(|key| key == start || start.ends_with('.') && key.starts_with(start));
    // EuRoC's file of a camera has its intrinsics; that of an IMU has densities.
    if let Some((_, name, remedy)) = OTHERS.iter().find(|(start, ..)| has(start)) {
        return Err(Error::new(ErrorKind::Unsupported, format!("this is {name}"), *remedy));
    }
    let of_camera = ["matrix", "Matrix", "width", "height", "intrinsics", "resolution"];
    let is_camera = |key: &String| {
        of_camera.iter().any(|word| key.contains(word))
            || ["K", "k"].contains(&key.as_str())
            || super::chain::is_camera(key)
    };
    if keys.keys().any(is_camera) {
        return Ok(());
    }
    let what = "no key of a camera: neither ROS's camera_info, Kalibr's camchain, EuRoC's sensor.yaml nor OpenCV's \
                FileStorage";
    Err(Error::invalid(what, ONE_CAMERA))
}
