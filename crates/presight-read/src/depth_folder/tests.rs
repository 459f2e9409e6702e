use super::*;
use image::{DynamicImage, ImageBuffer, Luma, LumaA, Rgb, Rgba};

fn folder(camera: &str, images: &[(&str, u32, u16)]) -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("camera.json"), camera).unwrap();
    std::fs::create_dir(folder.path().join("depth")).unwrap();
    for (name, width, value) in images {
        let image: ImageBuffer<Luma<u16>, Vec<u16>> = ImageBuffer::from_pixel(*width, 2, Luma([*value]));
        image.save(folder.path().join("depth").join(name)).unwrap();
    }
    folder
}

const CAMERA: &str = r#"{"width": 3, "height": 2, "fx": 4, "fy": 4, "cx": 1, "cy": 0.5, "depth_unit_m": 0.002}"#;

#[test]
fn images_are_read_in_order_with_their_times() {
    let folder = folder(CAMERA, &[("00007.png", 3, 0), ("00003.png", 3, 500)]);
    let frames: Vec<Frame> = DepthFolder::open(folder.path(), None).unwrap().map(|f| f.unwrap()).collect();
    assert_eq!(frames.iter().map(|f| f.stamp).collect::<Vec<_>>(), [3.0, 7.0]);
    assert_eq!(frames[0].measurement(), &Measurement::DepthZ(vec![1.0; 6]));
    assert!(frames[1].ranges().iter().all(|r| r.is_nan()));
}

/// The camera is 2 m above the floor and looks along -z of a y-up world, which is y of the z-up world.
#[test]
fn poses_are_turned_to_body_axes_and_z_up() {
    let folder = folder(CAMERA, &[("0.png", 3, 1)]);
    let pose = "# time tx ty tz qx qy qz qw split\n0 5 2 -3 1 0 0 0 map\n";
    std::fs::write(folder.path().join("poses.txt"), pose).unwrap();
    let log = DepthFolder::open(folder.path(), None).unwrap();
    let pose = log.reference()[0].pose;
    assert!(pose.translation.distance(DVec3::new(5.0, 3.0, 2.0)) < 1e-12, "{pose:?}");
    assert!((pose.rotation * DVec3::X).distance(DVec3::Y) < 1e-12, "it looks along y");
    assert!((pose.rotation * DVec3::Z).distance(DVec3::Z) < 1e-12, "and its head is up");
}

#[test]
fn what_is_wrong_is_named() {
    let error_of = |camera: &str, images: &[(&str, u32, u16)]| {
        let folder = folder(camera, images);
        let end = DepthFolder::open(folder.path(), None).and_then(|log| log.collect::<Result<Vec<_>>>().map(|_| ()));
        end.unwrap_err().to_string()
    };
    assert!(error_of(CAMERA, &[]).contains("no .png"));
    assert!(error_of(CAMERA, &[("0.png", 4, 1)]).contains("4 x 2 pixels"));
    assert!(error_of("{\"width\": 3", &[("0.png", 3, 1)]).contains("camera.json"));
    assert!(error_of(&CAMERA.replace("0.002", "-1"), &[("0.png", 3, 1)]).contains("depth unit"));
    let broken = folder(CAMERA, &[]);
    std::fs::write(broken.path().join("depth/0.png"), b"no image").unwrap();
    let mut log = DepthFolder::open(broken.path(), None).unwrap();
    assert!(log.next().unwrap().unwrap_err().to_string().contains("0.png"));
}

/// Grey and coloured images, of 8 and 16 bits and with or without transparency.
#[test]
fn luminances_are_those_of_the_image_crate() {
    let camera = CAMERA.replace("\"width\": 3", "\"width\": 64").replace("\"height\": 2", "\"height\": 3");
    let samples =
        |count: u32| (0..64 * 3 * count).map(|i| i.wrapping_mul(2_654_435_761_u32.rotate_right(i % 7)) as u16);
    let bytes = |count| samples(count).map(|v| (v >> 8) as u8).collect::<Vec<u8>>();
    let words = |count| samples(count).collect::<Vec<u16>>();
    let pictures: [DynamicImage; 6] = [
        ImageBuffer::<Luma<u8>, _>::from_vec(64, 3, bytes(1)).unwrap().into(),
        ImageBuffer::<Luma<u16>, _>::from_vec(64, 3, words(1)).unwrap().into(),
        ImageBuffer::<LumaA<u8>, _>::from_vec(64, 3, bytes(2)).unwrap().into(),
        ImageBuffer::<Rgb<u8>, _>::from_vec(64, 3, bytes(3)).unwrap().into(),
        ImageBuffer::<Rgb<u16>, _>::from_vec(64, 3, words(3)).unwrap().into(),
        ImageBuffer::<Rgba<u8>, _>::from_vec(64, 3, bytes(4)).unwrap().into(),
    ];
    for picture in pictures {
        let folder = tempfile::tempdir().unwrap();
        std::fs::write(folder.path().join("camera.json"), &camera).unwrap();
        std::fs::create_dir(folder.path().join("grey")).unwrap();
        picture.save(folder.path().join("grey/0.png")).unwrap();
        let frame = DepthFolder::open(folder.path(), None).unwrap().next().unwrap().unwrap();
        let Measurement::Grey(grey) = frame.measurement() else { panic!("a grey image") };
        let of_16_bits = |value: u16| f32::from(value) / f32::from(u16::MAX);
        let color = picture.color();
        let expected: Vec<f32> = picture.into_luma16().into_raw().into_iter().map(of_16_bits).collect();
        assert_eq!(grey.values(), expected, "{color:?}");
    }
}

/// Camera, images and poses as the simulator writes them.
#[test]
fn written_cameras_and_poses_are_read_again() {
    let camera = Camera {
        distortion: Distortion::PlumbBob([0.1, -0.02, 1e-3, 0.0, 0.0]),
        ..Camera::pinhole(3, 2, 4.0, 5.0, 1.1, 0.5)
    };
    let mut spec = SensorSpec::new("c", "laser", Geometry::Camera(camera));
    spec.mount = Pose::from_xyz_rpy(DVec3::new(0.2, 0.0, 1.0), 0.0, 0.1, 0.3);
    let sensor = Sensor::new(spec).unwrap();
    let robot = StampedPose { time: 12.5, pose: Pose::from_xyz_rpy(DVec3::new(3.0, -1.0, 0.2), 0.01, 0.02, 2.0) };
    let folder = folder(&camera_json(&sensor).unwrap(), &[(&image_name(12.5), 3, 1500)]);
    std::fs::write(folder.path().join("poses.txt"), poses_txt(&sensor, &[robot])).unwrap();
    let log = DepthFolder::open(folder.path(), Some(&sensor)).unwrap();
    let there = log.reference()[0];
    let expected = robot.pose * sensor.spec().mount;
    assert!(there.pose.translation.distance(expected.translation) < 1e-12);
    assert!(there.pose.rotation.angle_between(expected.rotation) < 1e-7 && there.time == 12.5);
    let own = DepthFolder::open(folder.path(), None).unwrap();
    assert_eq!(own.sensor().spec().geometry, sensor.spec().geometry);
    let frames: Vec<Frame> = log.map(|f| f.unwrap()).collect();
    assert_eq!((frames.len(), frames[0].stamp, frames[0].measurement()), (1, 12.5, &Measurement::DepthZ(vec![1.5; 6])));
    assert!(image_name(9.0) < image_name(10.0));
    assert!(camera_json(&crate::preset("laser-scanner").unwrap()).is_err());
}
