//! Fuzz bodies: one function for each kind of input, for `tests/fuzz/main.rs` and for the targets of `fuzz/`.
//!
//! A body panics only at a defect: a reader that panics, or that accepts input which violates its guarantees. It
//! returns true if the input was accepted.

#[path = "check.rs"]
mod check;
#[path = "generate.rs"]
mod generate;

use check::{check_world, near_unit, sound_sensor};
use presight_cli::pose::parse_pose;
use presight_files::{corridor, exr};
use presight_model::geometry::{Pose, Twist};
use presight_model::measured::ScanMotion;
use presight_model::sensor::SensorSpec;
use presight_read::{beams, camera_info, layer, log, materials, pose_covariance, sensor_toml, tum};
use std::borrow::Cow;
use std::path::{Path, PathBuf};

/// A folder for each thread, in memory where the system supports it.
struct Folder(tempfile::TempDir);

impl Folder {
    fn empty() -> Self {
        let memory = Path::new("/dev/shm");
        let made = if memory.is_dir() { tempfile::tempdir_in(memory) } else { tempfile::tempdir() };
        Self(made.expect("a folder"))
    }

    fn new() -> Self {
        let folder = Self::empty();
        folder.put("eye.toml", include_bytes!("corpus/sensor_toml/camera.toml"));
        folder.put("cam.yaml", include_bytes!("corpus/camera_info/calibration.yaml"));
        folder.put("part.glb", include_bytes!("corpus/gltf/triangle.glb"));
        folder.put("parts.rhai", b"fn post(h) { cylinder(0.1, h, 8) }");
        folder.put("scene.bin", &[0, 0, 128, 63].repeat(64));
        folder
    }

    fn put(&self, name: &str, bytes: &[u8]) -> PathBuf {
        let path = self.0.path().join(name);
        std::fs::write(&path, bytes).expect("a file");
        path
    }
}

thread_local! {
    static FOLDER: Folder = Folder::new();
}

/// Runs `f` on the path of a file with the input.
fn with_file<T>(name: &str, bytes: &[u8], f: impl FnOnce(&Path) -> T) -> T {
    FOLDER.with(|folder| f(&folder.put(name, bytes)))
}

fn text(bytes: &[u8]) -> Cow<'_, str> {
    String::from_utf8_lossy(bytes)
}

fn check_pose(pose: &Pose) {
    assert!(pose.translation.is_finite() && near_unit(pose.rotation), "{pose:?}");
}

/// A session of the feature editor: messages, one a line, each a name, a blank and JSON. Accepted if any is answered. A
/// refusal has a remedy, and leaves the state unchanged.
#[cfg(feature = "store")]
pub fn edit(bytes: &[u8]) -> bool {
    use presight_editor::{Answer, Session, SessionOptions};
    let scene = FOLDER.with(|folder| presight::Scene::open(folder.0.path().join("part.glb")).expect("a scene"));
    let own = Folder::empty();
    let mut options = SessionOptions::default();
    options.folder = own.0.path().to_owned();
    options.engine = presight::Options::new(presight::Backend::Cpu).with_threads(1);
    let sensor = presight::preset("laser-scanner").expect("a preset");
    let class = sensor.spec().clone().with_class("video");
    let sensor = presight::Sensor::new(class).expect("a sensor");
    let mut session = Session::open(scene, sensor, options).expect("a session");
    let mut answered = false;
    for line in text(bytes).lines().take(64) {
        let (name, body) = line.split_once(' ').unwrap_or((line, ""));
        let before = session.answer("state", b"");
        match session.answer(name, body.as_bytes()) {
            Answer::Json(_) | Answer::Binary(_) => answered |= name != "state",
            Answer::Behind(_) | Answer::Unknown => {}
            Answer::Wrong(e) => {
                assert!(!e.remedy().is_empty() && !e.to_string().contains('\n'), "{e}");
                let after = session.answer("state", b"");
                assert_eq!(format!("{before:?}"), format!("{after:?}"), "{line}");
            }
        }
    }
    answered
}

/// `.glb` and `.gltf`: an imported scene can be rendered, and is the same after it has been written.
pub fn gltf(bytes: &[u8]) -> bool {
    use presight_read::gltf::{import, write_glb};
    let name = if bytes.starts_with(b"glTF") { "scene.glb" } else { "scene.gltf" };
    with_file(name, bytes, |path| {
        let Ok(scene) = import(path, &Default::default()) else { return false };
        let again = path.with_file_name("again.glb");
        write_glb(&again, &scene.environment).expect("an accepted input can be written");
        let read = import(&again, &Default::default()).expect("a written file can be read").environment;
        assert_eq!(read.content_hash(), scene.environment.content_hash());
        check_world(scene.environment);
        true
    })
}

/// `.rhai`, with the limits of production, in a folder with a model and a module.
#[cfg(feature = "script")]
pub fn script(bytes: &[u8]) -> bool {
    with_file("scene.rhai", bytes, |path| {
        let scene = presight_read::script::load(path, &Default::default(), &mut |_| {});
        scene.is_ok_and(|scene| {
            check_world(scene.environment);
            true
        })
    })
}

/// Sensor TOML; after a NUL, the ray table `rays.csv` that it may refer to.
pub fn sensor_toml(bytes: &[u8]) -> bool {
    let (toml, csv) =
        bytes.iter().position(|b| *b == 0).map_or((bytes, None), |i| (&bytes[..i], Some(&bytes[i + 1..])));
    FOLDER.with(|folder| {
        if let Some(csv) = csv {
            folder.put("rays.csv", csv);
        }
        let spec = sensor_toml::parse(&text(toml), "fuzz", csv.map(|_| folder.0.path()));
        spec.is_ok_and(|spec| sound_sensor(&spec))
    })
}

/// YAML of cameras, raw and rectified.
pub fn camera_info(bytes: &[u8]) -> bool {
    let read = |rectified| camera_info::parse(&text(bytes), "fuzz", None, rectified);
    [false, true].map(read).into_iter().filter(|read| read.as_ref().is_ok_and(|(spec, _)| sound_sensor(spec))).count()
        > 0
}

/// Beam tables: small ones are predicted, and larger ones only read back from what they are written as.
fn sound_beams(spec: &SensorSpec) -> bool {
    let (width, height) = spec.geometry.size();
    if u64::from(width) * u64::from(height) < 2048 {
        return sound_sensor(spec);
    }
    let sound = presight::Sensor::new(spec.clone()).is_ok();
    assert!(
        !sound || sensor_toml::parse(&sensor_toml::to_string(spec), "other", None).is_ok_and(|again| again == *spec)
    );
    sound
}

/// Metadata of Ouster sensors.
pub fn ouster(bytes: &[u8]) -> bool {
    beams::ouster::parse(&text(bytes), "fuzz").is_ok_and(|(spec, _)| sound_beams(&spec))
}

/// Calibrations of Velodyne sensors.
pub fn velodyne(bytes: &[u8]) -> bool {
    beams::velodyne::parse(&text(bytes), "fuzz").is_ok_and(|(spec, _)| sound_beams(&spec))
}

/// Patterns of rays, whole and in part.
pub fn pattern(bytes: &[u8]) -> bool {
    let Ok(pattern) = beams::pattern::parse(&mut &*bytes) else { return false };
    let part = pattern.sensor("fuzz", 1e9, Some(0.3 * pattern.period()));
    assert!(part.is_err() || part.is_ok_and(|spec| spec.geometry.size().1 == 1));
    pattern.sensor("fuzz", 0.0, None).is_ok_and(|spec| sound_beams(&spec))
}

/// Layer files: placed in a scene, predicted with regions of interest, and written again.
pub fn layer(bytes: &[u8]) -> bool {
    let Ok(file) = layer::parse(&text(bytes)) else { return false };
    let written = layer::to_string(&file.layer).expect("an accepted input can be written");
    let again = layer::parse(&written).unwrap_or_else(|e| panic!("{e}: {written}"));
    assert_eq!(again.layer, file.layer);
    check::check_layer(&file.layer);
    true
}

/// A store file: a store that passes the check can be opened, and has exactly the verified content.
#[cfg(feature = "store")]
pub fn store(bytes: &[u8]) -> bool {
    use presight_store as store;
    with_file("fuzz.presight", bytes, |path| {
        let _ = std::fs::remove_file(path.with_extension("presight-journal"));
        let Ok(info) = store::check(path) else {
            // Each of these may stop earlier than the check; none may panic.
            let _ = (store::read(path), store::log(path, |_| Ok(())), store::Store::open(path).is_ok());
            return false;
        };
        let store = store::Store::open(path).expect("a valid store opens");
        assert_eq!(store.world().environment().content_hash(), info.environment.content_hash());
        assert_eq!(store.changes(), info.changes);
        check_world(presight_model::environment::Environment::clone(store.world().environment()));
        true
    })
}

/// Change lines applied to a store and dropped again.
#[cfg(feature = "store")]
pub fn changes(bytes: &[u8]) -> bool {
    use presight_store::{Note, Store, create};
    use std::cell::RefCell;
    thread_local! {
        static OPEN: RefCell<Store> = FOLDER.with(|folder| {
            let path = folder.0.path().join("changed.presight");
            create(&path, &check::stage(), &Note::new("fuzz", 1.5)).expect("a store");
            let none = presight_model::index::IndexKind::None;
            let mut store = Store::open_with_index(&path, &none).expect("a valid store opens");
            store.without_sync().expect("an open store");
            RefCell::new(store)
        });
    }
    OPEN.with(|open| {
        let store = &mut *open.borrow_mut();
        let before = store.world().environment().content_hash();
        let mut batch = store.batch().expect("a batch");
        let note = Note::new("fuzz", 2.5);
        let folder = FOLDER.with(|folder| folder.0.path().to_owned());
        let text = text(bytes);
        let lines = text.lines().filter(|line| !line.is_empty());
        let sound = lines.map(|line| batch.apply_line(line, &folder, &note).is_ok()).take_while(|sound| *sound).count();
        drop(batch);
        assert_eq!(store.world().environment().content_hash(), before, "an uncommitted change is dropped");
        sound > 0
    })
}

/// Poses of the command line: a written pose reads back the same.
pub fn poses(bytes: &[u8]) -> bool {
    let Ok(pose) = parse_pose(&text(bytes)) else { return false };
    check_pose(&pose);
    let again = parse_pose(&presight_read::exr::pose_to_text(&pose)).expect("a written file can be read");
    assert_eq!(again.translation, pose.translation);
    assert!((again.rotation - pose.rotation).length() < 1e-12, "{pose:?} is not {again:?}");
    true
}

/// Trajectories in TUM's form.
pub fn trajectory(bytes: &[u8]) -> bool {
    let Ok(poses) = tum::parse(&text(bytes)) else { return false };
    poses.iter().for_each(|p| check_pose(&p.pose));
    assert!(poses.iter().all(|p| p.time.is_finite()));
    !poses.is_empty()
}

/// Pose covariances: six deviations, or JSON.
pub fn pose_covariance(bytes: &[u8]) -> bool {
    let text = text(bytes);
    let json = text.trim_start().starts_with('[');
    let parsed = match (json, text.contains(',')) {
        (true, _) => pose_covariance::from_json(&text),
        (false, true) => pose_covariance::parse(&text),
        // The name of a file.
        (false, false) => return false,
    };
    let Ok(covariance) = parsed else { return false };
    assert!(covariance.as_rows().as_flattened().iter().all(|x| x.is_finite()), "{covariance:?}");
    assert!((0..6).all(|i| covariance[i][i] >= 0.0), "{covariance:?}");
    true
}

/// Motion corridors.
pub fn corridor(bytes: &[u8]) -> bool {
    let Ok(corridor) = corridor::parse(&text(bytes)) else { return false };
    assert!(corridor.length() > 0.0 && corridor.length().is_finite());
    for p in [[0.0; 3], [1.0, 0.1, 0.5], [1e12, -1e12, 0.5]] {
        let along = corridor.arc_length_at(p);
        assert!(along.is_none_or(|s| (0.0..=corridor.length()).contains(&s)), "{along:?} of {corridor:?}");
    }
    true
}

/// Material files next to a scene.
pub fn materials(bytes: &[u8]) -> bool {
    let Ok(sidecar) = materials::Sidecar::parse(&text(bytes)) else { return false };
    check_pose(&sidecar.world_from_scene);
    let mut materials = ["paint", "glass"].map(presight_model::environment::Material::named);
    if sidecar.apply_to(&mut materials).is_err() {
        return false;
    }
    assert!(materials.iter().all(|m| (0.0..=1.0).contains(&m.reflection)), "{materials:?}");
    true
}

/// Robot files next to sensor files.
pub fn robot(bytes: &[u8]) -> bool {
    with_file("robot.toml", bytes, |path| {
        let Ok((robot, _)) = presight_read::load_robot(path) else { return false };
        assert!(!robot.sensors.is_empty());
        robot.sensors.iter().for_each(|s| check_pose(&s.spec().mount));
        true
    })
}

/// Logs of all kinds: frames fit their sensor, times increase, and everything is the same after writing it as format 1.
pub fn log(bytes: &[u8]) -> bool {
    with_file("fuzz.log", bytes, |path| {
        let Ok(log) = log::open(path) else { return false };
        let spec = log.sensor().spec().clone();
        // Many beams take long to write and add no case.
        if !sound_sensor(&spec) {
            return false;
        }
        let (mut frames, mut sound, mut time) = (Vec::new(), true, f64::NEG_INFINITY);
        for frame in log {
            // After an error there are no more frames.
            assert!(sound, "a frame after an error");
            let Ok(frame) = frame else {
                sound = false;
                continue;
            };
            frame.check(&spec).expect("a frame fits its sensor");
            assert!(frame.time > time, "{} after {time}", frame.time);
            time = frame.time;
            [frame.odometry, frame.reference.map(|robot| robot.world_from_robot())]
                .iter()
                .flatten()
                .for_each(check_pose);
            frames.push(frame);
        }
        let lines: String =
            frames.iter().map(|frame| log::lines::line(frame).expect("a frame that was read") + "\n").collect();
        let again = path.with_file_name("again.jsonl");
        std::fs::write(&again, format!("{}\n{lines}", log::lines::header(&spec))).expect("a file");
        let read = log::open(&again).expect("a written file can be read");
        let read: Vec<_> = read.map(|frame| frame.expect("a frame that was written")).collect();
        // NaN does not equal itself, but its text does.
        assert_eq!(format!("{read:?}"), format!("{frames:?}"));
        sound && !read.is_empty()
    })
}

/// Messages of ROS 2, the first byte chooses the type: an accepted message is the same after it has been written, and
/// transforms and measurements leave a running robot's frames sound.
#[cfg(feature = "ros")]
pub fn messages(bytes: &[u8]) -> bool {
    use presight_ros::message::{
        CameraInfo, CompressedImage, DiagnosticArray, Image, LaserScan, MarkerArray, Message, Odometry, PointCloud2,
        PoseWithCovarianceStamped, TFMessage,
    };
    let Some((kind, data)) = bytes.split_first() else { return false };
    macro_rules! again {
        ($message:ident) => {
            $message::decode(data).ok().map(|message| {
                let written = message.encode();
                // NaN does not equal itself, but its text does.
                let read = format!("{:?}", $message::decode(&written).expect("a written message can be read"));
                assert_eq!(read, format!("{message:?}"));
                $message::TYPE
            })
        };
    }
    let found = match kind % 10 {
        0 => again!(LaserScan),
        1 => again!(PointCloud2),
        2 => again!(Image),
        3 => again!(CompressedImage),
        4 => again!(CameraInfo),
        5 => again!(TFMessage),
        6 => again!(Odometry),
        7 => again!(PoseWithCovarianceStamped),
        8 => again!(DiagnosticArray),
        _ => again!(MarkerArray),
    };
    let Some(message_type) = found else { return false };
    let mut live = log::bag::LiveFrames::new(log::BagOptions::default(), None, Default::default(), "map");
    for (name, message_type) in [("/tf_static", message_type), ("/tf", message_type), ("/scan", message_type)] {
        let topic =
            presight_ros::Topic { name: name.into(), message_type: message_type.into(), encoding: "cdr".into() };
        let record = presight_ros::Record { topic: topic.into(), log_time_ns: 1, data: data.to_vec() };
        let _ = live.add(record);
        live.newest().iter().for_each(|o| o.frame.motion.iter().for_each(|m| check_pose(&m.previous_from_current)));
    }
    true
}

/// Bags: frames have rising stamps and sound poses.
#[cfg(feature = "ros")]
pub fn bag(bytes: &[u8]) -> bool {
    with_file("fuzz.mcap", bytes, |path| {
        let options = log::BagOptions::default();
        let Ok(report) = log::bag::BagReport::of(path, &options) else { return false };
        assert!(!report.lines().is_empty() && report.to_json().starts_with('{'));
        let Ok(log) = log::Frames::open_with(path, None, &Default::default(), &options) else { return false };
        let mut time = f64::NEG_INFINITY;
        for observation in log {
            let Ok(log::Observation { frame, reference, .. }) = observation else { return false };
            assert!(frame.stamp > time, "{} after {time}", frame.stamp);
            time = frame.stamp;
            reference.iter().for_each(|robot| check_pose(&robot.world_from_robot()));
            frame.motion.iter().for_each(|motion| check_pose(&motion.previous_from_current));
        }
        true
    })
}

/// Scans of points: an accepted one has times within a minute of its stamp, and the motion of a robot can be undone.
pub fn cloud(bytes: &[u8]) -> bool {
    let name = if bytes.starts_with(b"ply") { "7.5.ply" } else { "7.5.pcd" };
    with_file(name, bytes, |path| {
        let Ok(mut frames) = log::Frames::open(path, None, &Default::default()) else { return false };
        let frame = frames.next().expect("an opened scan").expect("a scan that was read").frame;
        let [first, last] = frame.sensor().scan_interval();
        assert!(first >= -61.0 && last <= 61.0 && first <= last, "{first} to {last} s");
        assert!(frames.notices().iter().all(|notice| !notice.contains('\n')));
        let twist = Twist::new(glam::DVec3::X, glam::DVec3::Z);
        let frame = frame.with_scan_motion(ScanMotion::Twist(twist));
        let still = frame.deskewed(0.5 * (first + last)).expect("a motion without end");
        assert_eq!(still.ranges().len(), frame.ranges().len());
        true
    })
}

/// Images: an accepted file is complete, and the same after it has been written.
pub fn exr(bytes: &[u8]) -> bool {
    with_file("fuzz.exr", bytes, |path| {
        let Ok(file) = exr::read(path) else { return false };
        let images = &file.images;
        let outputs = images.outputs();
        for output in outputs.iter() {
            let len = images.samples(output).map(|samples| samples.len());
            assert_eq!(len, Some(images.pixels()), "{}", output.name());
        }
        file.attributes.pose.iter().for_each(|pose| check_pose(&pose.world_from_sensor()));
        exr::write(path, images, outputs, &file.attributes).expect("an accepted input can be written");
        let again = exr::read(path).expect("a written file can be read");
        let report = presight_render::verify::compare_exactly(images, &again.images).expect("images of one shape");
        assert_eq!(report.fault, 0);
        assert_eq!(format!("{:?}", again.attributes), format!("{:?}", file.attributes));
        true
    })
}

/// Random polygons in front of random sensors: compares the CPU engine with the reference.
pub fn scenes(bytes: &[u8]) -> bool {
    let Some(case) = generate::case(bytes) else { return false };
    let (world, pose, sensors) = case.build();
    sensors.iter().for_each(|sensor| check::check_view(&world, sensor, &pose));
    true
}
