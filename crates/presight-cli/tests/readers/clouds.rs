//! Images and point clouds as other libraries read them.

use super::{Place, python};

const VIEW: &str = "predict SCENES/room.glb --pose 1.2,1.4,0.9,3,5,40 --backend cpu";
const ALL: &str = "range,echo,cos_incidence,object_id,polygon_id";

fn predicted(sensor: &str, frame: &str) -> Place {
    let place = Place::new();
    for cloud in ["cloud.ply", "cloud.pcd"] {
        place.done(&format!(
            "{VIEW} --sensor {sensor} --outputs {ALL} --out a.exr --npy {{output}}.npy --rays rays.npy \
             --points {cloud} --points-frame {frame}"
        ));
    }
    place
}

#[test]
fn arrays_equal_the_exr() {
    let Some(python) = python() else { return };
    let place = predicted("video-camera", "sensor");
    place.holds(python, "arrays.py", &["a.exr"]);
    place.spoil("object_id.npy", 4 * 512 * 200 + 4);
    place.fails(python, "arrays.py", &["a.exr"]);
}

#[test]
fn clouds_are_read_whole_by_open3d_trimesh_and_as_pcls() {
    let Some(python) = python() else { return };
    for (sensor, frame) in
        [("vlp-16", "sensor"), ("vlp-16", "world"), ("realsense-d435", "sensor"), ("realsense-d435", "world")]
    {
        let place = predicted(sensor, frame);
        place.holds(python, "clouds.py", &[frame]);
        if (sensor, frame) != ("vlp-16", "sensor") {
            continue;
        }
        // The last bytes belong to an id. Further in front is a normal of the last point.
        for (name, before_end) in [("cloud.ply", 2), ("cloud.pcd", 2), ("cloud.ply", 4 * 6 + 1)] {
            let sound = std::fs::read(place.path(name)).unwrap();
            place.spoil(name, before_end);
            place.fails(python, "clouds.py", &[frame]);
            std::fs::write(place.path(name), sound).unwrap();
        }
    }
}

#[test]
fn a_cloud_has_only_the_requested_fields() {
    let Some(python) = python() else { return };
    let place = Place::new();
    place.done(&format!("{VIEW} --sensor vlp-16 --outputs range --points a.ply"));
    place.holds(python, "fields.py", &["a.ply", "x y z range ring"]);
    place.done(&format!("{VIEW} --sensor video-camera --outputs echo,polygon_id --points a.pcd"));
    place.holds(python, "fields.py", &["a.pcd", "x y z intensity polygon_id"]);
    place.done(&format!("{VIEW} --sensor video-camera --points a.pcd"));
    place.holds(python, "fields.py", &["a.pcd", "x y z normal_x normal_y normal_z range object_id polygon_id"]);
    place.fails(python, "fields.py", &["a.pcd", "x y z range"]);
}
