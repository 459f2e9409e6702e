use super::*;
use glam::{DMat3, DVec3};
use presight_model::sensor::{Camera, Geometry, Sensor};

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

fn raw(text: &str) -> Result<(SensorSpec, Vec<String>)> {
    parse(text, "c", None, false)
}

fn camera_of(text: &str) -> Camera {
    let Geometry::Camera(camera) = raw(text).unwrap().0.geometry else { panic!("no camera") };
    camera
}

#[test]
fn a_calibration_file_is_read_and_its_rectification_is_not() {
    let (spec, notices) = raw(CALIBRATION).unwrap();
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
        "{CALIBRATION}binning_x: 4\nbinning_y: 2\n\
         roi: {{x_offset: 96, y_offset: 72, height: 501, width: 800, do_rectify: false}}\n"
    );
    let small = camera_of(&text);
    assert_eq!((small.width, small.height), (200, 250));
    for (u, v) in [(0.0, 0.0), (17.0, 200.0)] {
        let (x, y) = small.normalized(u, v);
        let (fx, fy) = full.normalized(96.0 + 4.0 * u + 1.5, 72.0 + 2.0 * v + 0.5);
        assert!((x - fx).abs() < 1e-14 && (y - fy).abs() < 1e-14);
    }
    let (_, notices) = raw(&text).unwrap();
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
        ("image_height: 972", "roi: {x_offset: 1000, y_offset: 0, width: 300, height: 9}\nimage_height: 972", "roi"),
    ];
    for (good, bad, place) in faults {
        let text = CALIBRATION.replace(good, bad);
        assert_ne!(text, CALIBRATION);
        // The case zeroes one focal length; zero the other too.
        let text = if place == "camera_matrix" { text.replace("1879.55762", "0.0") } else { text };
        let e = raw(&text).unwrap_err();
        assert_eq!(e.place(), Some(place), "{e}");
    }
    // Each line repeats the one before ten times.
    let bomb: String =
        (0..4).map(|i| format!("k{}: &a{} [{}]\n", i + 1, i + 1, vec![format!("*a{i}"); 10].join(", "))).collect();
    let e = raw(&format!("k0: &a0 [{}]\n{bomb}", ["1"; 10].join(", "))).unwrap_err();
    assert!(e.to_string().contains("budget"), "{e}");
    assert!(raw("a: [b").is_err());
    assert!(raw("").is_err());
    assert!(raw("image_width: 3").is_err());
}

/// Turned by 0.1 rad about the optical y axis: R x looks to the right of the raw camera's axis.
const RECTIFIED: &str = "\
image_width: 640
image_height: 480
camera_matrix: {rows: 3, cols: 3, data: [400., 0., 320., 0., 400., 240., 0., 0., 1.]}
distortion_model: plumb_bob
distortion_coefficients: {rows: 1, cols: 5, data: [-0.2, 0.05, 0.001, 0., 0.]}
rectification_matrix: {rows: 3, cols: 3, data: [0.995004165278026, 0., -0.099833416646828, 0., 1., 0.,
  0.099833416646828, 0., 0.995004165278026]}
projection_matrix: {rows: 3, cols: 4, data: [380., 0., 310., -45.6, 0., 380., 250., 0., 0., 0., 1., 0.]}
";

/// A point of the camera's optical frame is at P R x (homogeneous, without P's last column), multiplied out by hand.
#[test]
fn the_rectified_camera_is_p_and_turned_by_r() {
    let (spec, notices) = parse(RECTIFIED, "c", None, true).unwrap();
    let sensor = Sensor::new(spec).unwrap();
    let (x, y, z) = (0.4, -0.3, 2.0);
    let (sin, cos) = (0.099833416646828, 0.995004165278026);
    let (right, forward) = (cos * x - sin * z, sin * x + cos * z);
    let (u, v) = (380.0 * right / forward + 310.0, 380.0 * y / forward + 250.0);
    let in_body = DVec3::new(z, -x, -y);
    let seen = sensor.project(sensor.body_from_image().transpose() * in_body).unwrap();
    assert!((seen.0 - u).hypot(seen.1 - v) < 1e-9, "{seen:?} {u} {v}");
    // The middle of the image looks along the third row of R: to the right, which is -y in body axes.
    let axis = sensor.body_from_image() * sensor.ray(310, 250).unwrap();
    assert!(axis.distance(DVec3::new(cos, -sin, 0.0)) < 1e-12, "{axis}");
    assert!(notices.len() == 1 && notices[0].contains("0.1200 m right of and 0.0000 m below"), "{notices:?}");
    assert_eq!(sensor.body_from_image().determinant().signum(), 1.0);
    // An unrotated one has the axes of every camera, bit for bit.
    let plain = RECTIFIED.replace("0.995004165278026", "1.0").replace("0.099833416646828", "0.0");
    let (spec, _) = parse(&plain, "c", None, true).unwrap();
    assert_eq!(spec.body_from_image(), DMat3::from_cols(DVec3::NEG_Y, DVec3::NEG_Z, DVec3::X));
    assert_eq!(spec.geometry, Geometry::Camera(Camera::pinhole(640, 480, 380.0, 380.0, 310.0, 250.0)));
}

#[test]
fn binning_and_region_are_those_of_the_raw_image() {
    let text = format!(
        "{RECTIFIED}binning_x: 2\nbinning_y: 2\nroi: {{x_offset: 20, y_offset: 10, width: 600, height: 460}}\n"
    );
    let (spec, _) = parse(&text, "c", None, true).unwrap();
    let half =
        Camera::pinhole(300, 230, 190.0, 190.0, (310.0 - 20.0 + 0.5) / 2.0 - 0.5, (250.0 - 10.0 + 0.5) / 2.0 - 0.5);
    assert_eq!(spec.geometry, Geometry::Camera(half));
}

#[test]
fn what_has_no_rectified_image_is_refused() {
    let zeros =
        RECTIFIED.replace("[380., 0., 310., -45.6, 0., 380., 250., 0., 0., 0., 1., 0.]", &format!("{:?}", [0.0; 12]));
    for (text, place, says) in [
        (zeros, "projection_matrix", "all 0"),
        (RECTIFIED.replace("rectification_matrix", "other"), "rectification_matrix", "missing"),
        (RECTIFIED.replace("projection_matrix", "other"), "projection_matrix", "missing"),
        (RECTIFIED.replace("0., 1., 0.,\n", "0., 2., 0.,\n"), "rectification_matrix", "not a rotation"),
        (RECTIFIED.replace("0., 1., 0.,\n", "0., -1., 0.,\n"), "rectification_matrix", "not a rotation"),
        (RECTIFIED.replace("[380., 0.,", "[380., 3.,"), "projection_matrix", "P is not"),
    ] {
        let e = parse(&text, "c", None, true).unwrap_err();
        assert!(e.place() == Some(place) && e.to_string().contains(says), "{e}");
        assert!(raw(&text).is_ok());
    }
    let e = parse(EUROC, "c", None, true).unwrap_err();
    assert!(e.kind() == ErrorKind::Usage && e.remedy().contains("drop `rectified: true`"), "{e}");
}

const OPENCV: &str = "\
%YAML:1.0
---
# made: by hand
calibration_time: \"Wed 01 Apr 2026 10:00:00\"
image_width: 640
image_height: 480
camera_matrix: !!opencv-matrix
   rows: 3
   cols: 3
   dt: d
   data: [ 463.9, 0., 320., 0., 463.9, 240., 0., 0., 1. ]
distortion_coefficients: !!opencv-matrix
   rows: 5
   cols: 1
   dt: d
   data: [ 1.0e-01, -5.0e-02, 1.0e-03, 2.0e-03, 0. ]
avg_reprojection_error: 3.0e-01
";

#[test]
fn file_storage_of_opencv_is_read() {
    let lens = Distortion::PlumbBob([0.1, -0.05, 1e-3, 2e-3, 0.0]);
    let expected = Camera { distortion: lens, ..Camera::pinhole(640, 480, 463.9, 463.9, 320.0, 240.0) };
    let (spec, notices) = raw(OPENCV).unwrap();
    assert_eq!(spec.geometry, Geometry::Camera(expected.clone()));
    assert!(notices.len() == 2 && notices[0].contains("avg_reprojection_error"), "{notices:?}");
    // Names as other programs choose them, a size in one key, and no directive.
    let renamed = OPENCV
        .replace("%YAML:1.0\n", "")
        .replace("camera_matrix", "cameraMatrix")
        .replace("distortion_coefficients", "distCoeffs")
        .replace("image_width: 640\nimage_height: 480", "imageSize: [ 640, 480 ]");
    assert_eq!(camera_of(&renamed), expected);
    let k = [0.1, -0.05, 0.01, 0.002];
    let fisheye = |text: &str| text.replace("1.0e-01, -5.0e-02, 1.0e-03, 2.0e-03, 0.", "0.1, -0.05, 0.01, 0.002");
    let with = camera_of(&fisheye(&OPENCV.replace("image_width", "fisheye_model: 1\nimage_width")));
    assert_eq!(with.distortion, Distortion::Equidistant(k));
    assert_eq!(camera_of(&fisheye(OPENCV)).distortion, Distortion::PlumbBob([0.1, -0.05, 0.01, 0.002, 0.0]));
    // The number of coefficients names the model.
    let eight = OPENCV.replace("2.0e-03, 0. ]", "2.0e-03, 0., 0.3, 0., 0. ]");
    let notices = raw(&eight).unwrap().1;
    assert_eq!(camera_of(&eight).distortion.model(), "rational_polynomial");
    assert!(notices.iter().any(|n| n.contains("taken as rational_polynomial")), "{notices:?}");
    // Lines are counted in the file.
    let e = raw(&OPENCV.replace("image_height: 480", "image_height: tall")).unwrap_err();
    assert_eq!(e.place(), Some("line 6"), "{e}");
    assert!(
        raw(&OPENCV.replace("image_height", "height_")).unwrap_err().to_string().contains("image_height is missing")
    );
}

const EUROC: &str = "\
sensor_type: camera
comment: VI-Sensor cam0
T_BS:
  cols: 4
  rows: 4
  data: [1,0,0,0,0,1,0,0,0,0,1,0,0,0,0,1]
rate_hz: 20
resolution: [752, 480]
camera_model: pinhole
intrinsics: [458.6, 457.3, 367.2, 248.4]
distortion_model: radial-tangential
distortion_coefficients: [-0.28, 0.07, 0.0001, 0.0002]
";

const CAMCHAIN: &str = "\
cam0:
  cam_overlaps: [1]
  camera_model: pinhole
  distortion_coeffs: [-0.28, 0.07, 0.0001, 0.0002]
  distortion_model: radtan
  intrinsics: [458.6, 457.3, 367.2, 248.4]
  resolution: [752, 480]
  rostopic: /cam0/image_raw
cam1:
  T_cn_cnm1:
  - [1.0, 0.0, 0.0, -0.11]
  - [0.0, 1.0, 0.0, 0.0]
  - [0.0, 0.0, 1.0, 0.0]
  - [0.0, 0.0, 0.0, 1.0]
  camera_model: pinhole
  distortion_coeffs: [0.01, -0.02, 0.003, -0.0004]
  distortion_model: equidistant
  intrinsics: [190.9, 191.1, 254.9, 256.8]
  resolution: [512, 512]
  rostopic: /cam1/image_raw
";

#[test]
fn euroc_and_kalibr_are_read() {
    let lens = Distortion::PlumbBob([-0.28, 0.07, 1e-4, 2e-4, 0.0]);
    let first = Camera { distortion: lens, ..Camera::pinhole(752, 480, 458.6, 457.3, 367.2, 248.4) };
    let (spec, notices) = raw(EUROC).unwrap();
    assert_eq!((spec.name.as_str(), &spec.geometry), ("c", &Geometry::Camera(first.clone())));
    assert!(notices.len() == 1 && notices[0].contains("T_BS") && notices[0].contains("poses"), "{notices:?}");

    let lens = Distortion::Equidistant([0.01, -0.02, 0.003, -0.0004]);
    let second = Camera { distortion: lens, ..Camera::pinhole(512, 512, 190.9, 191.1, 254.9, 256.8) };
    for (choice, name, camera, says) in [
        (None, "cam0", &first, "cam1"),
        (Some("cam0"), "cam0", &first, ""),
        (Some("cam1"), "cam1", &second, "T_cn_cnm1"),
    ] {
        // OpenVINS writes the same file with OpenCV's directive.
        for text in [CAMCHAIN.to_owned(), format!("%YAML:1.0\n\n{CAMCHAIN}")] {
            let (spec, notices) = parse(&text, "c", choice, false).unwrap();
            assert_eq!((spec.name.as_str(), &spec.geometry), (name, &Geometry::Camera(camera.clone())));
            assert!(
                notices.len() == usize::from(!says.is_empty()) && notices.iter().all(|n| n.contains(says)),
                "{notices:?}"
            );
        }
    }
    for (text, choice, place, says) in [
        (CAMCHAIN.to_owned(), Some("cam2"), None, "cam0 or cam1"),
        (EUROC.to_owned(), Some("cam0"), None, "file alone"),
        (CAMCHAIN.replace("254.9, ", ""), Some("cam1"), Some("cam1: intrinsics"), "3 numbers"),
        (CAMCHAIN.replace("resolution: [752, 480]", "a: 1"), None, Some("cam0: resolution"), "missing"),
        (CAMCHAIN.replacen("pinhole", "omni", 1), None, Some("cam0: camera_model"), "omni"),
        (CAMCHAIN.replacen("radtan", "fov", 1), None, Some("cam0: distortion_model"), "fov"),
        (EUROC.replace("sensor_type: camera", "sensor_type: lidar"), None, None, "EuRoC"),
        (EUROC.replace("458.6,", "wide,"), None, Some("line 10"), "floating point"),
        ("cam0:\ncam1: 3\n".to_owned(), None, Some("line 1"), "expected mapping"),
    ] {
        let e = parse(&text, "c", choice, false).unwrap_err();
        assert!(e.place() == place && e.to_string().contains(says) && !e.to_string().contains('\n'), "{e}");
    }
}

#[test]
fn files_of_other_tools_are_refused_by_name() {
    for (text, says) in [
        (
            "%YAML:1.0\n\n#---\n# Camera Parameters: see below\n#---\nCamera.type: \"PinHole\"\nCamera.fx: 535.4\n\
             Camera.width: 640\n",
            "ORB-SLAM",
        ),
        ("%YAML:1.0\nFile.version: \"1.0\"\nCamera1.fx: 458.6\nLEFT.R: !!opencv-matrix\n   data: [1]\n", "ORB-SLAM"),
        (
            "%YAML:1.0\n---\nmodel_type: PINHOLE\ncamera_name: c\nimage_width: 752\nimage_height: 480\n\
             projection_parameters:\n   fx: 4.6e+02\n",
            "VINS",
        ),
        ("%YAML:1.0\n---\nM1: !!opencv-matrix\n   rows: 3\n   data: [1]\nD1: [1]\n", "stereo"),
        ("sensor_type: imu\ngyroscope_noise_density: 1.7e-04\n", "IMU"),
        ("target_type: 'aprilgrid'\ntagCols: 6\n", "target"),
        ("cameras:\n- camera: {type: pinhole}\n", "list of cameras"),
        ("pelvis: 3\n", "no key of a camera"),
    ] {
        let e = raw(text).unwrap_err();
        assert!(e.to_string().contains(says) && !e.to_string().contains('\n') && e.remedy().contains("give"), "{e}");
    }
}

/// K of 516 x 386 pixels, published with the size before 4 x 4 binning.
const BINNED: &str = "\
height: 1544
width: 2064
distortion_model: plumb_bob
D: [-0.0977, 0.0809, -0.0037, 0.002, 0.0]
K: [299.5, 0.0, 254.1, 0.0, 300.1, 183.9, 0.0, 0.0, 1.0]
binning_x: 4
binning_y: 4
";

#[test]
fn a_principal_point_far_from_the_middle_is_a_warning_with_both_readings() {
    let doubt = |text: &str| raw(text).unwrap().1.into_iter().find(|n| n.contains("principal point ("));
    let said = doubt(BINNED).unwrap();
    assert!(said.contains("(254.1, 183.9)") && said.contains("2064 x 1544") && said.contains("516 x 386"), "{said}");
    // Either reading, written down as the warning says, is read without another one.
    let as_binned = BINNED.replace("1544", "386").replace("2064", "516").replace(": 4\n", ": 1\n");
    let camera = camera_of(&as_binned);
    assert_eq!((doubt(&as_binned), camera.width, camera.cx), (None, 516, 254.1));
    // No binning: calibrated at half the size, and at twice the size.
    let plain = BINNED.replace(": 4\n", ": 1\n");
    for (cx, cy, size) in [("511.0", "380.0", "1023 x 761"), ("2100.0", "1500.0", "4201 x 3001")] {
        let said = doubt(&plain.replace("254.1", cx).replace("183.9", cy)).unwrap();
        assert!(said.contains(size), "{said}");
    }
    // An image cut at one side by a sixth, and a usual one.
    for (cx, cy) in [("1031.5", "1028.0"), ("1000.0", "790.0")] {
        assert_eq!(doubt(&plain.replace("254.1", cx).replace("183.9", cy)), None);
    }
}

#[test]
fn trailing_zeros_do_not_matter() {
    let lens = |model: &str, coefficients: &[f64]| {
        let text = CALIBRATION
            .replace("plumb_bob", model)
            .replace("[-0.25, 0.07, 0.0002, 0.00002, 0.0]", &format!("{coefficients:?}"));
        raw(&text).map(|_| camera_of(&text).distortion)
    };
    let k = [0.1, -0.2, 0.03, 0.004, 0.5, 0.06, 0.07, 0.08, 0.001, 0.002, 0.003, 0.004, 0.1, -0.2];
    for (model, counts) in [
        ("plumb_bob", &[4, 5][..]),
        ("equidistant", &[4]),
        ("fisheye", &[4]),
        ("rational_polynomial", &[8, 12, 14]),
        ("none", &[0]),
    ] {
        for count in counts {
            let own = lens(model, &k[..*count]).unwrap();
            for more in [1, 3, 8, 20] {
                assert_eq!(lens(model, &[&k[..*count], &vec![0.0; more]].concat()).unwrap(), own, "{model} {more}");
            }
        }
        // No remedy leaves a coefficient out.
        let e = lens(model, &[k, k].concat()).unwrap_err();
        assert!(!e.remedy().contains("give") && e.remedy().contains("name the model"), "{e}");
    }
    for count in [9, 10, 11, 13] {
        let e = lens("rational_polynomial", &k[..count]).unwrap_err();
        assert!(e.remedy().contains("8 or 12 or 14") && e.remedy().contains("zeros at the end"), "{e}");
    }
    let e = lens("plumb_bob", &k[..8]).unwrap_err();
    assert!(e.remedy().contains("rational_polynomial"), "{e}");
    let tilt = [&k[..12], &[1.6, 0.0]].concat();
    let (spec, _) = raw(&CALIBRATION
        .replace("plumb_bob", "rational_polynomial")
        .replace("[-0.25, 0.07, 0.0002, 0.00002, 0.0]", &format!("{tilt:?}")))
    .unwrap();
    assert!(Sensor::new(spec).unwrap_err().to_string().contains("tauX = 1.6"));
}
