//! Messages that rosbags 0.11.9 serialized (Jazzy's definitions) are read, and written as the same bytes.

use presight_ros::message::{
    CameraInfo, CompressedImage, DiagnosticArray, Image, LaserScan, MarkerArray, MarkerKind, Message, Odometry,
    PointCloud2, PoseWithCovarianceStamped, TFMessage,
};
use std::path::Path;

/// A message of the fuzz corpus, behind the byte that names its type there.
fn serialized(name: &str) -> Vec<u8> {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/fuzz/corpus/messages").join(name);
    std::fs::read(path).unwrap().split_off(1)
}

#[test]
fn rosbags_and_presight_write_the_same_bytes() {
    macro_rules! same {
        ($name:literal, $message:ident) => {{
            let data = serialized($name);
            assert_eq!($message::decode(&data).unwrap().encode(), data, $name);
        }};
    }
    same!("scan", LaserScan);
    same!("cloud", PointCloud2);
    same!("image", Image);
    same!("compressed", CompressedImage);
    same!("camera_info", CameraInfo);
    same!("transforms", TFMessage);
    same!("odometry", Odometry);
    same!("pose", PoseWithCovarianceStamped);
    same!("diagnostics", DiagnosticArray);
    same!("markers", MarkerArray);
}

/// The values that the script gave to rosbags.
#[test]
fn values_are_those_that_were_written() {
    let data = serialized("scan");
    let scan = LaserScan::decode(&data).unwrap();
    assert_eq!((scan.header.stamp_ns, scan.header.frame_id.as_str()), (5_000_000_000, "/laser"));
    assert_eq!(scan.ranges, [1.0, f32::INFINITY, 2.5]);
    let data = serialized("cloud");
    let cloud = PointCloud2::decode(&data).unwrap();
    assert_eq!(cloud.values("y").unwrap().unwrap().collect::<Vec<_>>(), [2.0, 0.0]);
    let data = serialized("pose");
    let pose = PoseWithCovarianceStamped::decode(&data).unwrap();
    assert_eq!(pose.pose.unwrap().translation.to_array(), [1.0, 2.0, 0.0]);
    assert_eq!((pose.covariance[0], pose.covariance[1], pose.covariance[35]), (0.01, 0.0, 0.01));
    let data = serialized("diagnostics");
    let status = &DiagnosticArray::decode(&data).unwrap().status[0];
    assert_eq!((status.level, status.values[0].clone()), (1, ("k".to_owned(), "v".to_owned())));
    let data = serialized("markers");
    let marker = &MarkerArray::decode(&data).unwrap().markers[0];
    assert_eq!((marker.kind, marker.points[1]), (Some(MarkerKind::TriangleList), [1.0, 0.0, 0.0]));
    assert_eq!((marker.namespace.as_str(), marker.id, marker.color), ("wall", 1, [1.0, 0.0, 0.0, 1.0]));
}
