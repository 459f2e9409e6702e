//! Bags that other programs wrote, with the content that their readers found.

use presight_model::ErrorKind;
use presight_ros::message::{LaserScan, Message, PointCloud2};
use presight_ros::{Bag, Lookup, Survey};
use std::path::PathBuf;

fn bag(name: &str) -> Option<Bag> {
    let data = std::env::var_os("PRESIGHT_DATA").map(PathBuf::from);
    let folder = data.unwrap_or_else(|| PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../../../shared/data"));
    let path = folder.join("ros").join(name);
    path.exists().then(|| Bag::open(&path).unwrap())
}

#[test]
fn scans_of_every_container_are_the_same() {
    let mut scans: Vec<Vec<LaserScan>> = Vec::new();
    for name in ["malaga_zstd.mcap", "malaga_humble", "malaga_split"] {
        let Some(bag) = bag(name) else { return };
        let messages = bag.messages(|topic| topic.name == "/scan");
        scans.push(messages.map(|m| LaserScan::decode(&m.unwrap().data).unwrap()).collect());
    }
    assert_eq!(scans[0].len(), 37);
    assert_eq!(scans[0][0].ranges[..3], [2.47, 2.47, 2.47]);
    assert_eq!(scans[0][0].header.stamp_ns, 1_137_772_793_095_000_064);
    // As text, for a range may be NaN.
    let text = |scans: &[LaserScan]| format!("{scans:?}");
    assert!(scans.iter().all(|s| text(s) == text(&scans[0])));
}

/// Recorders compress files as a whole by `--compression-mode file`: the messages are the same, and no file is left next to the bag.
#[test]
fn compressed_files_hold_the_same() {
    let scans = |bag: &Bag| -> Vec<Vec<u8>> {
        bag.messages(|topic| topic.name == "/scan").map(|message| message.unwrap().data).collect()
    };
    for name in ["malaga_humble", "malaga_split"] {
        let Some(bag) = bag(name) else { return };
        let folder = tempfile::tempdir().unwrap();
        let mut metadata = std::fs::read_to_string(bag.path().join("metadata.yaml")).unwrap();
        for file in bag.files() {
            let name = file.file_name().unwrap().to_string_lossy().into_owned();
            let packed = zstd::encode_all(std::fs::File::open(file).unwrap(), 3).unwrap();
            std::fs::write(folder.path().join(format!("{name}.zstd")), packed).unwrap();
            metadata = metadata.replace(&name, &format!("{name}.zstd"));
        }
        let count = || std::fs::read_dir(folder.path()).unwrap().count();
        for metadata in [Some(&metadata), None] {
            let path = folder.path().join("metadata.yaml");
            metadata.map_or_else(|| std::fs::remove_file(&path), |text| std::fs::write(&path, text)).unwrap();
            let (before, expected) = (count(), scans(&bag));
            assert_eq!(expected.len(), 37);
            assert!(Bag::is_bag(folder.path()));
            assert_eq!(scans(&Bag::open(folder.path()).unwrap()), expected, "{name}");
            assert_eq!(count(), before);
        }
        let [first, ..] = bag.files() else { panic!() };
        let packed = folder.path().join(format!("{}.zstd", first.file_name().unwrap().to_string_lossy()));
        assert!(Bag::is_bag(&packed) && !scans(&Bag::open(&packed).unwrap()).is_empty());
    }
}

#[test]
fn a_cut_file_is_read_to_its_last_whole_chunk() {
    let Some(bag) = bag("cut_in_mid_chunk.mcap") else { return };
    let mut messages = bag.messages(|topic| topic.name == "/scan");
    assert_eq!(messages.by_ref().map(Result::unwrap).count(), 26);
    assert!(messages.losses()[0].what.contains("cut within a chunk"), "{:?}", messages.losses());
}

#[test]
fn the_tree_is_found_wherever_it_was_recorded() {
    let Some(bag) = bag("slashes_late_static_clockwise.mcap") else { return };
    let survey = Survey::of(&bag).unwrap();
    let Lookup::Found(mount) = survey.tree.lookup("base_link", "laser", 0) else { panic!("{survey:?}") };
    assert!((mount.translation - glam::DVec3::new(0.78, 0.0, 0.3)).length() < 1e-6);
    let scan = survey.topic("/scan").unwrap();
    assert_eq!((scan.count, scan.frame.as_str()), (12, "laser"));
    assert!(LaserScan::decode(scan.first.as_ref().unwrap()).unwrap().angle_increment < 0.0);
}

#[test]
fn points_have_the_values_that_numpy_reads() {
    let Some(bag) = bag("velodyne_points.mcap") else { return };
    let record = bag.messages(|topic| topic.name == "/velodyne_points").next().unwrap().unwrap();
    let cloud = PointCloud2::decode(&record.data).unwrap();
    assert_eq!((cloud.height, cloud.width, cloud.point_step), (1, 4033, 22));
    let x: Vec<f64> = cloud.values("x").unwrap().unwrap().collect();
    let time: Vec<f64> = cloud.values("time").unwrap().unwrap().collect();
    assert!((x[0] + 1.075559).abs() < 1e-6 && (time[4032] - 0.09966667).abs() < 1e-6);
    assert!(cloud.values("t").unwrap().is_none());
}

#[test]
fn empty_and_odd_bags_are_surveyed() {
    let Some(bag) = bag("rosbag2_empty") else { return };
    let survey = Survey::of(&bag).unwrap();
    assert_eq!(
        survey.topics.iter().map(|t| (t.topic.name.as_str(), t.count)).collect::<Vec<_>>(),
        [("/parameter_events", 0), ("/rosout", 0)]
    );
    let survey = Survey::of(&self::bag("rosbag2_odd_serialization").unwrap()).unwrap();
    assert!(survey.topics.iter().all(|t| t.topic.encoding == "wrong_format"), "{survey:?}");
}

#[test]
fn other_files_are_refused_by_name() {
    let folder = tempfile::tempdir().unwrap();
    let cases: [(&[u8], ErrorKind, &str); 4] = [
        (b"#ROSBAG V2.0\n", ErrorKind::Unsupported, "rosbags-convert"),
        (b"\x28\xb5\x2f\xfd....", ErrorKind::Invalid, "the compressed data is damaged"),
        (b"", ErrorKind::Invalid, "the bag is empty"),
        (b"hello, world", ErrorKind::Invalid, "neither an MCAP nor an SQLite file"),
    ];
    for (bytes, kind, text) in cases {
        let path = folder.path().join("a.mcap");
        std::fs::write(&path, bytes).unwrap();
        let e = Bag::open(&path).unwrap_err();
        assert!(e.kind() == kind && e.to_string().contains(text) && e.to_string().contains("a.mcap"), "{e}");
    }
}
