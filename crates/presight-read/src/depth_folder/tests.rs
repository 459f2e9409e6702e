use super::*;
use image::{ImageBuffer, Luma};

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

/// A cut image, a missing image, and a line of the odometry that is not a pose.
#[test]
fn bad_images_are_left_out_and_named() {
    use crate::log::{BagOptions, Frames};
    let folder = folder(CAMERA, &[("0.png", 3, 500), ("1.png", 3, 500), ("3.png", 3, 500)]);
    let path = |name: &str| folder.path().join("depth").join(name);
    let whole = std::fs::read(path("1.png")).unwrap();
    std::fs::write(path("1.png"), &whole[..whole.len() / 2]).unwrap();
    #[cfg(unix)]
    std::os::unix::fs::symlink(path("moved away.png"), path("2.png")).unwrap();
    let odometry = "0 0 0 0 0 0 0 1\n1 1 0 0 0 0 0\n2 2 0 0 0 0 0 1\n3 3 0 0 0 0 0 1\n";
    std::fs::write(folder.path().join("odometry.txt"), odometry).unwrap();
    let noise = Default::default();
    let open = Frames::open_skipping_bad(folder.path(), None, &noise, &BagOptions::default());
    let mut log = open.unwrap();
    let left: Vec<_> = log.by_ref().map(|o| o.unwrap().frame).collect();
    assert_eq!(left.iter().map(|f| f.stamp).collect::<Vec<_>>(), [0.0, 3.0]);
    assert_eq!(left[1].motion.unwrap().previous_from_current.translation.x, 3.0, "the motion goes over the gap");
    let notices = log.notices().join("\n");
    assert!(notices.contains("odometry.txt: 1 lines are left out, the first is line 2"), "{notices}");
    assert!(notices.contains("frames are left out: 1.png ("), "{notices}");
    assert!(!cfg!(unix) || notices.contains("2 of 4 frames") && notices.contains("2.png ("), "{notices}");
    let ended = Frames::open(folder.path(), None, &noise).and_then(|log| log.collect::<Result<Vec<_>>>());
    assert!(ended.is_err(), "without skipping");
}
