//! The same room exported by trimesh with z up and with y up.

use super::{Place, python};

#[test]
fn a_room_is_the_same_for_either_up_axis() {
    let Some(python) = python() else { return };
    let place = Place::new();
    place.holds(python, "room.py", &[]);
    let view = "--backend cpu --ids source --outputs range,object_id,polygon_id,cos_incidence";
    for (sensor, pose) in [("video-camera", "1,1,1.2,0,10,40"), ("vlp-16", "3,2,1,2,3,4")] {
        for (name, flags) in [("y", ""), ("z", "--up z"), ("fallen", ""), ("mm", "--up z --scale 0.001")] {
            let scene = if name == "fallen" { "z" } else { name };
            place.done(&format!(
                "predict {scene}.glb {flags} --sensor {sensor} --pose {pose} {view} --npy {name}.{{output}}.npy"
            ));
        }
        place.holds(python, "same.py", &["y", "z"]);
        place.holds(python, "same.py", &["y", "mm"]);
        place.fails(python, "same.py", &["y", "fallen"]);
    }
}
