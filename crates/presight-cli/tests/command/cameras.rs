//! Calibrations as drivers and tools write them (`tests/files/cases/camera-*`): rays computed with OpenCV.

use super::Place;
use std::fs;
use std::path::Path;

/// The files of a case.
fn case(name: &str) -> Place {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/files/cases").join(name);
    let place = Place { folder: tempfile::tempdir().unwrap() };
    for entry in fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        place.write(path.file_name().unwrap().to_str().unwrap(), &fs::read(&path).unwrap());
    }
    place
}

/// Predicts the wall 2 m ahead; returns the notices.
fn predict(place: &Place, sensor: &str) -> String {
    let line =
        "predict wall.glb --pose 0,0,0,0,0,0 --backend cpu --outputs depth_z --npy z.npy --rays rays.npy --sensor";
    let outcome = place.run(&format!("{line} {sensor}"));
    assert_eq!(outcome.status, Some(0), "{}", outcome.stderr);
    outcome.stderr
}

/// The numbers of an array, after its header.
fn numbers<const N: usize, T>(place: &Place, name: &str, of: impl Fn([u8; N]) -> T) -> Vec<T> {
    let bytes = fs::read(place.path(name)).unwrap();
    let start = 10 + usize::from(u16::from_le_bytes([bytes[8], bytes[9]]));
    bytes[start..].chunks_exact(N).map(|number| of(number.try_into().unwrap())).collect()
}

/// Checks rays in body axes, by column and row of an image of this width, and that the wall is where they meet it.
fn check_rays(place: &Place, width: usize, expected: &[((usize, usize), [f64; 3])]) {
    let (rays, depth) = (numbers(place, "rays.npy", f64::from_le_bytes), numbers(place, "z.npy", f32::from_le_bytes));
    for ((column, row), ray) in expected {
        let pixel = row * width + column;
        let off = rays[3 * pixel..][..3].iter().zip(ray).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
        assert!(off < 1e-9, "({column}, {row}): {off}");
        assert!(ray[0] < 0.2 || (depth[pixel] - 2.0).abs() < 1e-6, "({column}, {row}): {}", depth[pixel]);
    }
}

#[test]
fn a_fifth_coefficient_of_zero_does_not_matter() {
    let place = case("camera-five-of-four");
    assert_eq!(predict(&place, "camera.yaml"), "");
    let expected = [
        // Behind the camera, which OpenCV's normalized coordinates say by their sign.
        ((0, 400), [-0.35799786692564334, 0.9335496625304182, 0.01795981252774095]),
        ((424, 408), [0.9999975499176804, 0.002100838643036246, 0.000697592740903494]),
        ((423, 799), [0.11601513583094447, 0.004082147625624967, -0.9932390569892477]),
    ];
    check_rays(&place, 848, &expected);
    let all = fs::read(place.path("rays.npy")).unwrap();
    let text = fs::read_to_string(place.path("camera.yaml")).unwrap();
    place.write("four.yaml", text.replace(", 0.0]}\n", "]}\n").as_bytes());
    assert_ne!(fs::read_to_string(place.path("four.yaml")).unwrap(), text);
    predict(&place, "four.yaml");
    assert_eq!(fs::read(place.path("rays.npy")).unwrap(), all);
}

#[test]
fn a_tilted_sensor_has_the_rays_of_opencv() {
    let place = case("camera-tilted-sensor");
    assert_eq!(predict(&place, "camera.yaml"), "");
    let expected = [
        ((0, 0), [0.7503870037833729, 0.525784648934122, 0.40058687883932786]),
        ((639, 0), [0.7510845141645695, -0.5268944262570767, 0.39781191053235043]),
        ((320, 240), [0.999984941152828, -0.003990610923391385, 0.0037672924007941303]),
        ((100, 400), [0.8569290165359345, 0.4175353470752656, -0.30221994401676006]),
        ((639, 479), [0.7464317318780892, -0.5356224512249298, -0.39490284803894965]),
    ];
    check_rays(&place, 640, &expected);
    // Its sensor file has the same rays, bit for bit.
    let rays = fs::read(place.path("rays.npy")).unwrap();
    place.write("again.toml", place.done("sensors camera.yaml").as_bytes());
    assert_eq!(predict(&place, "again.toml"), "");
    assert_eq!(fs::read(place.path("rays.npy")).unwrap(), rays);
}

#[test]
fn opencv_and_euroc_are_read() {
    let place = case("camera-opencv-yaml");
    assert!(predict(&place, "opencv.yaml").contains("taken as plumb_bob"));
    let expected = [
        ((0, 0), [0.7697206056113555, 0.5108267117800257, 0.3828658509573487]),
        ((320, 240), [1.0, 0.0, 0.0]),
        ((639, 479), [0.7738888740827751, -0.5067294365392493, -0.37989641840310856]),
    ];
    check_rays(&place, 640, &expected);
    assert!(predict(&place, "sensor.yaml").contains("T_BS"));
    let expected = [
        ((0, 0), [0.5980686100432657, 0.6632556704422311, 0.44989538040209137]),
        ((376, 240), [0.9996472414885311, -0.01918564000260845, 0.018365832463044355]),
        ((751, 479), [0.5948332737432113, -0.6885079923789975, -0.4148856720569852]),
    ];
    check_rays(&place, 752, &expected);
}

#[test]
fn a_principal_point_of_binned_images_is_a_warning() {
    let place = case("camera-calibrated-binned");
    let said = predict(&place, "camera.yaml");
    let warning = said.lines().find(|line| line.contains("principal point (254.1, 183.9)")).unwrap();
    assert!(["middle of 2064 x 1544", "516 x 386"].iter().all(|word| warning.contains(word)), "{warning}");
    // Followed, it gives the image of the calibration.
    let text = fs::read_to_string(place.path("camera.yaml")).unwrap();
    let followed = text.replace("1544", "386").replace("2064", "516").replace(": 4", ": 1");
    place.write("camera.yaml", followed.as_bytes());
    assert_eq!(predict(&place, "camera.yaml"), "");
    assert_eq!(numbers(&place, "z.npy", f32::from_le_bytes).len(), 516 * 386);
}

/// R turns the image 90 degrees about the optical axis, so that its columns run downwards and its rows to the left: with
/// x_rectified = y and y_rectified = -x. The pose stays that of the raw camera.
#[test]
fn the_rectified_image_turns_and_its_pose_does_not() {
    let place = case("camera-opencv-yaml");
    let info = "image_width: 4\nimage_height: 3\ncamera_matrix: [9, 0, 1.5, 0, 9, 1, 0, 0, 1]\n\
        D: [0.1, 0, 0, 0, 0]\nR: [0, 1, 0, -1, 0, 0, 0, 0, 1]\nP: [1, 0, 1, 0, 0, 1, 1, 0, 0, 0, 1, 0]\n";
    place.write("camera.yaml", info.as_bytes());
    assert!(predict(&place, "camera.yaml").contains("--rectified"));
    assert_eq!(predict(&place, "camera.yaml --rectified"), "");
    let third = 1.0 / 3f64.sqrt();
    let half = 0.5f64.sqrt();
    // Column 2, row 1 looks along x_rectified = 1, which is y = 1 of the camera: down, -z in body axes.
    let expected = [
        ((1, 1), [1.0, 0.0, 0.0]),
        ((2, 1), [half, 0.0, -half]),
        ((1, 2), [half, half, 0.0]),
        ((2, 2), [third, third, -third]),
    ];
    check_rays(&place, 4, &expected);
    place.write("again.toml", place.done("sensors camera.yaml --rectified").as_bytes());
    assert_eq!(predict(&place, "again.toml"), "");
    check_rays(&place, 4, &expected);
    let robot = "format = 1\n[[sensors]]\nsensor = \"camera.yaml\"\nrectified = true\n";
    place.write("robot.toml", robot.as_bytes());
    place.done("predict wall.glb --robot robot.toml --pose 0,0,0,0,0,0 --backend cpu --rays rays.npy");
    check_rays(&place, 4, &expected);
    // Turned to the right by the angle of a 3-4-5 triangle: the axis of the image meets the wall 2.5 m away. Its normal
    // is still given in the axes of the camera.
    let turned = info.replace("R: [0, 1, 0, -1, 0, 0, 0, 0, 1]", "R: [0.8, 0, -0.6, 0, 1, 0, 0.6, 0, 0.8]");
    place.write("camera.yaml", turned.as_bytes());
    assert_eq!(predict(&place, "camera.yaml --rectified"), "");
    assert!((numbers(&place, "z.npy", f32::from_le_bytes)[5] - 2.5).abs() < 1e-6);
    assert!((numbers(&place, "rays.npy", f64::from_le_bytes)[16] + 0.6).abs() < 1e-12);
    place.done("predict wall.glb --sensor camera.yaml --rectified --pose 0,0,0,0,0,0 --backend cpu --outputs normal --npy n.npy");
    let normal = &numbers(&place, "n.npy", f32::from_le_bytes)[15..18];
    assert!(normal.iter().zip([-1.0, 0.0, 0.0]).all(|(a, b)| (a - b).abs() < 1e-6), "{normal:?}");
    for (line, says) in [
        ("--sensor opencv.yaml --rectified", "drop --rectified"),
        ("--sensor sensor.yaml --rectified", "drop --rectified"),
        ("--sensor vlp-16 --rectified", "drop --rectified"),
        ("--rectified --robot robot.toml", "write rectified = true"),
    ] {
        let outcome = place.run(&format!("predict wall.glb --pose 0,0,0,0,0,0 {line}"));
        assert!(outcome.status != Some(0) && outcome.stderr.contains(says), "{}", outcome.stderr);
    }
}

/// Each file is refused with these words; the other one follows the remedy and is read.
#[test]
fn remedies_of_calibrations_work() {
    let place = case("camera-opencv-yaml");
    let info = |model: &str, coefficients: &str| {
        format!(
            "image_width: 4\nimage_height: 3\nK: [9, 0, 1.5, 0, 9, 1, 0, 0, 1]\ndistortion_model: {model}\nD: [{coefficients}]\n"
        )
    };
    let eight = "0.1, 0, 0, 0, 0, 0, 0, 0.02";
    let nine = "0.1, 0, 0, 0, 0, 0, 0, 0, 0.01";
    let good = info("plumb_bob", "0.1, 0, 0, 0, 0");
    let chain = "cam0: {resolution: [4, 3], intrinsics: [9, 9, 1.5, 1]}\ncam1: {resolution: [4, 3], intrinsics: [9, 9, 1.5, 1]}\n";
    let orb = "%YAML:1.0\n\nCamera.type: \"PinHole\"\nCamera.fx: 9.0\nCamera.width: 4\n".to_owned();
    let rows = [
        (
            info("rational_polynomial", nine),
            "",
            "zeros at the end",
            info("rational_polynomial", &format!("{nine}, 0, 0, 0")),
            "",
        ),
        (info("plumb_bob", eight), "", "rational_polynomial for 8", info("rational_polynomial", eight), ""),
        (
            info("rational_polynomial", &format!("{nine}, 0, 0, 0, 1.6, 0")),
            "",
            "at most 1.5",
            info("rational_polynomial", &format!("{nine}, 0, 0, 0, 1.5, 0")),
            "",
        ),
        (chain.to_owned(), ":cam7", "give cam0 or cam1", chain.to_owned(), ":cam1"),
        (good.clone(), ":cam0", "the file alone", good.clone(), ""),
        (orb, "", "ORB-SLAM; give a ROS camera_info", good.clone(), ""),
        (good.replace("image_height: 3\n", ""), "", "image_height is missing; add it", good, ""),
    ];
    for (text, camera, says, followed, of) in rows {
        place.write("bad.yaml", text.as_bytes());
        let outcome =
            place.run(&format!("predict wall.glb --pose 0,0,0,0,0,0 --backend cpu --sensor bad.yaml{camera}"));
        assert!(outcome.status != Some(0) && outcome.stderr.contains(says), "{says}: {}", outcome.stderr);
        assert_eq!(outcome.stderr.lines().count(), 1, "{}", outcome.stderr);
        place.write("good.yaml", followed.as_bytes());
        predict(&place, &format!("good.yaml{of}"));
    }
}
