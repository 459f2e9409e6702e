//! ROS 2 bags as rosbags and mcap-ros2-support read them.

use super::{Place, python};

const DRIVE: &str = "1700000000.1 1.2 1.4 0.9 0 0 0 1\n1700000000.2 1.25 1.4 0.9 0 0 0.05 0.99874921777\n";

/// Every message of a bag is read by both, rosbags serializes it to the same bytes, and its values are those of the
/// arrays that the same prediction wrote. A bit in an array is found.
#[test]
fn bags_equal_the_arrays() {
    let Some(python) = python() else { return };
    for (sensor, image, before_end) in [
        ("laser-scanner", "range", 4 * 200 + 3),
        ("vlp-16", "object_id", 4 * 9000 + 4),
        ("realsense-d435", "depth_z", 3),
    ] {
        let place = Place::new();
        std::fs::write(place.path("drive.tum"), DRIVE).unwrap();
        let depth = if sensor == "realsense-d435" { ",depth_z" } else { "" };
        place.done(&format!(
            "predict SCENES/room.glb --sensor {sensor} --backend cpu --poses drive.tum \
             --outputs range,object_id,polygon_id{depth} --npy {{i}}.{{output}}.npy --mcap a.mcap"
        ));
        let topic = sensor.replace('-', "_");
        place.holds(python, "bags.py", &["a.mcap", &topic]);
        place.spoil(&format!("1.{image}.npy"), before_end);
        place.fails(python, "bags.py", &["a.mcap", &topic]);
    }
}
