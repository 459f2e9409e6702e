//! Real depth images in a real map (../shared/data/rgbd/livingroom). The figure next to each bound is the value
//! reached.

use super::*;
use presight_localize::localize::{LocalizeOptions, Localizer, Phase, Search, SearchOptions};
use presight_model::environment::{Polygon, PolygonOrder};
use presight_model::geometry::{PoseEstimate, RobotPose};
use presight_read::gltf::import;
use presight_read::log::Frames;
use std::path::Path;

fn map() -> Option<World> {
    let path = presight_testkit::data::file("rgbd/livingroom/livingroom_map.glb")?;
    Some(World::new(import(path, &Default::default()).unwrap().environment))
}

/// world_from_robot of each line. The file's poses are of optical axes in a world with y up.
fn poses(name: &str) -> Vec<Pose> {
    let path = presight_testkit::data::file(&format!("rgbd/livingroom/{name}")).unwrap();
    let z_up = Pose::from_xyz_rpy(DVec3::ZERO, std::f64::consts::FRAC_PI_2, 0.0, 0.0);
    let optical_from_body = presight_model::sensor::body_from_optical_rotation().conjugate();
    let optical_from_body = Pose { rotation: optical_from_body, translation: DVec3::ZERO };
    let text = std::fs::read_to_string(path).unwrap();
    let pose = |line: &str| {
        let n: Vec<f64> = line.split_whitespace().skip(1).take(7).map(|x| x.parse().unwrap()).collect();
        let rotation = glam::DQuat::from_xyzw(n[3], n[4], n[5], n[6]);
        z_up * Pose::new(DVec3::new(n[0], n[1], n[2]), rotation).unwrap() * optical_from_body
    };
    text.lines().filter(|l| !l.starts_with('#')).map(pose).collect()
}

/// A camera with the same noise at every range.
fn camera_of(range_sigma: f64) -> Sensor {
    let camera = Camera::pinhole(640, 480, 525.0, 525.0, 319.5, 239.5);
    let mut spec = SensorSpec::new("depth camera", "laser", Geometry::Camera(camera));
    spec.noise.range_sigma = range_sigma;
    Sensor::new(spec).unwrap()
}

/// The camera of the noisy frames: its noise grows with the square of the range.
fn noisy_camera() -> Sensor {
    presight_read::load_sensor(concat!(env!("CARGO_MANIFEST_DIR"), "/tests/estimate/noisy_camera.toml")).unwrap().0
}

/// Every fourth column and row of a depth image.
fn frame(folder: &str, k: usize, range_sigma: f64) -> Frame {
    whole_frame(folder, k, camera_of(range_sigma)).thinned(4).unwrap()
}

fn whole_frame(folder: &str, k: usize, camera: Sensor) -> Frame {
    let path = presight_testkit::data::file(&format!("rgbd/livingroom/{folder}/{k:05}.png")).unwrap();
    let depth = image::open(Path::new(&path)).unwrap().into_luma16();
    let metres = |mm: &u16| if *mm == 0 { f32::NAN } else { f32::from(*mm) * 1e-3 };
    let sensed = Measurement::DepthZ(depth.as_raw().iter().map(metres).collect());
    Frame::new(0.0, camera, sensed).unwrap()
}

/// The surface measured by a frame at every other column and row: two triangles between four neighbours, unless one is
/// behind an edge.
fn surface_of(frame: &Frame, pose: &Pose) -> World {
    let thin = frame.thinned(2).unwrap();
    let (sensor, ranges) = (thin.sensor(), thin.ranges());
    let (width, height) = (sensor.width(), sensor.height());
    let body = sensor.body_from_image();
    let corners: Vec<Vec3> = (0..width * height)
        .map(|i| {
            let (ray, range) = (sensor.ray(i % width, i / width).unwrap(), f64::from(ranges[i as usize]));
            // A pixel without a measurement is not a corner of a polygon.
            let range = if range.is_finite() { range } else { 0.0 };
            pose.transform_point(body * (range * ray)).as_vec3()
        })
        .collect();
    let mut polygons = Vec::new();
    for (r, c) in (0..height - 1).flat_map(|r| (0..width - 1).map(move |c| (r, c))) {
        let i = r * width + c;
        let four = [i, i + 1, i + width, i + width + 1].map(|k| ranges[k as usize]);
        let (near, far) = four.iter().fold((f32::MAX, 0.0f32), |(a, b), z| (a.min(*z), b.max(*z)));
        if four.iter().all(|z| z.is_finite()) && far < 1.03 * near {
            polygons.push(Polygon::new(vec![i, i + width, i + 1], 0));
            polygons.push(Polygon::new(vec![i + 1, i + width, i + width + 1], 0));
        }
    }
    let mut environment = Environment::new();
    environment.add_material(Material::named("surface")).unwrap();
    let mesh = Mesh::new("surface", corners, polygons, PolygonOrder::Given).unwrap();
    environment.insert(NewObject::new("surface", Pose::IDENTITY, Arc::new(mesh))).unwrap();
    World::new(environment)
}

/// The surface of the first frame as the map of the next four, whose relative poses are known exactly.
#[test]
fn against_the_first_frame() {
    if map().is_none() {
        return;
    }
    let truth = poses("poses_noisy.txt");
    let cases = [("depth", camera_of(0.001), 0.0003, 0.01), ("depth_noisy", noisy_camera(), 0.005, 0.13)];
    for (folder, camera, most_metres, most_degrees) in cases {
        let surface = surface_of(&whole_frame(folder, 0, camera.clone()), &truth[0]);
        let mut found = estimator(EstimateOptions::default());
        for k in 1..5 {
            let frame = whole_frame(folder, k, camera.clone()).thinned(4).unwrap();
            // Starts from the previous frame's pose.
            let answer = found
                .estimate(&surface, &[&frame], &PoseEstimate::of_sigmas(RobotPose::new(truth[k - 1]), 0.03, 0.02))
                .unwrap();
            let (metres, degrees) = apart(&answer.pose.world_from_robot, &truth[k]);
            assert!(metres <= most_metres && degrees <= most_degrees, "{folder} {k}: {metres} m {degrees} deg");
            assert!(answer.is_determined(), "{folder} {k}: {:?}", answer.state);
        }
    }
}

/// The first five frames, whose poses are known exactly. The map was made with poses that are off by millimetres.
#[test]
fn against_exact_poses() {
    let Some(map) = map() else { return };
    let truth = poses("poses_noisy.txt");
    let mut found = estimator(EstimateOptions::default());
    for (folder, camera, most_metres, most_degrees) in
        [("depth", camera_of(0.005), 0.009, 0.29), ("depth_noisy", noisy_camera(), 0.012, 0.45)]
    {
        for (k, truth) in truth.iter().enumerate() {
            let frame = whole_frame(folder, k, camera.clone()).thinned(4).unwrap();
            let answer =
                found.estimate(&map, &[&frame], &PoseEstimate::of_sigmas(RobotPose::new(*truth), 0.03, 0.02)).unwrap();
            let (metres, degrees) = apart(&answer.pose.world_from_robot, truth);
            assert!(metres <= most_metres && degrees <= most_degrees, "{folder} {k}: {metres} m {degrees} deg");
            assert!(answer.is_determined(), "{folder} {k}: {:?}", answer.state);
        }
    }
}

/// Priors off by exactly 0.2 m and 10 degrees, and by 0.3 m and 20 degrees: the estimates equal those from the
/// reference, or are undetermined. Every 20th frame; PRESIGHT_LIVINGROOM_EVERY=2 takes all odd frames.
#[test]
fn far_off_priors_converge_or_stay_undetermined() {
    let Some(map) = map() else { return };
    let (reference, mut random) = (poses("poses.txt"), Random(9));
    let every = presight_testkit::env_number("PRESIGHT_LIVINGROOM_EVERY", 20) as usize;
    let mut found = estimator(EstimateOptions::default());
    for (metres, degrees, least) in [(0.2, 10.0, 98), (0.3, 20.0, 93)] {
        let (mut right, mut predictions) = (0, Vec::new());
        for k in (1..200).step_by(every) {
            let frame = frame("depth", k, 0.005);
            let there = found
                .estimate(&map, &[&frame], &PoseEstimate::of_sigmas(RobotPose::new(reference[k]), 0.03, 0.02))
                .unwrap();
            let off = off_by(&reference[k], metres, degrees, &mut random);
            let axis = 3f64.sqrt();
            let prior = PoseEstimate::of_sigmas(RobotPose::new(off), metres / axis, f64::to_radians(degrees) / axis);
            let answer = found.estimate(&map, &[&frame], &prior).unwrap();
            let (m, d) = apart(&answer.pose.world_from_robot, &there.pose.world_from_robot);
            let ok = m < 0.01 && d < 0.5;
            right += usize::from(ok);
            predictions.push(answer.predictions);
            assert!(ok || !answer.is_determined(), "frame {k}, wrong and certain: {m} m {d} deg");
        }
        predictions.sort_unstable();
        // Nine of ten frames: the share rounded to whole frames.
        let count = predictions.len();
        assert!(right >= least * count / 100, "{metres} m {degrees} deg: {right} of {count}");
        assert!(predictions[count / 2] <= 4, "{predictions:?} predictions");
    }
}

/// The first 40 frames of the flight, without odometry: none is lost, and each fits the map to 2 mm (median).
#[test]
fn the_flight_is_tracked() {
    let Some(map) = map() else { return };
    let prior = PoseEstimate::of_sigmas(RobotPose::new(poses("poses.txt")[0]), 0.05, 0.035);
    let mut robot = Localizer::new(estimator(EstimateOptions::default()), prior, LocalizeOptions::default());
    for k in 0..40 {
        let seen = frame("depth", k, 0.005);
        let seen = Frame::new(k as f64, seen.sensor().clone(), seen.measurement().clone()).unwrap();
        let step = robot.step(&map, &seen).unwrap();
        assert!(k < 2 || step.phase == Phase::Tracking, "{k}: {}", step.reason);
        let difference = step.estimate.verdicts[0].difference.iter().filter(|d| !d.is_nan());
        let mut off: Vec<f32> = difference.map(|d| d.abs()).collect();
        off.sort_unstable_by(f32::total_cmp);
        assert!(off[off.len() / 2] <= 0.002, "{k}: {} m", off[off.len() / 2]);
    }
}

/// From an unknown start at frame 30, where the camera tilts by 16.6 degrees: no pose is reported for the first two
/// frames, within ten it is tracked (the third was reached), and then the pose agrees with the data.
#[test]
fn an_unknown_start_is_found() {
    let Some(map) = map() else { return };
    let log = presight_testkit::data::file("rgbd/livingroom").unwrap();
    let frames = Frames::open(&log, None, &Default::default()).unwrap().map(Result::unwrap);
    let frames = frames.skip_while(|o| o.frame.stamp < 30.0);
    let mut frames =
        frames.map(|o| (o.frame.thinned(4).unwrap(), o.reference.unwrap().world_from_robot())).take(10).peekable();
    let (floor, floor_to, lean) = (0.75, 1.3, [0.0, 16.6f64.to_radians()]);
    // A coarser grid than the default and half of the candidates: 5 seconds instead of 14.
    let options = SearchOptions::default()
        .with_cell(0.5)
        .with_candidates(20)
        .with_floor(floor)
        .with_floor_to(floor_to)
        .with_lean(lean)
        .with_margin(1.0);
    let options = options.with_surrounded(0.02);
    let mut estimator = estimator(EstimateOptions::default());
    let search = Search::new(&mut estimator, &map, frames.peek().unwrap().0.sensor(), options).unwrap();
    let mut robot = Localizer::unknown(estimator, search, LocalizeOptions::default());
    for (k, (frame, truth)) in frames.enumerate() {
        let step = robot.step(&map, &frame).unwrap();
        assert!(k >= 2 || step.phase != Phase::Tracking, "{k}: {}", step.reason);
        if step.phase == Phase::Tracking {
            let (metres, degrees) = apart(&step.pose.world_from_robot, &truth);
            assert!(metres < 0.05 && degrees < 1.5, "{metres} m {degrees} deg");
            return;
        }
    }
    panic!("the flight is not tracked within ten frames");
}
