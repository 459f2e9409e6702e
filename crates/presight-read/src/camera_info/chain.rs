//! Kalibr's camchain (`cam0: {..}`, `cam1: {..}`) and EuRoC's `sensor.yaml`, which is one camera of it.
//!
//! `intrinsics` are fx, fy, cx, cy in pixels of `resolution`. The camera's place on its rig (`T_cam_imu`, `T_cn_cnm1`,
//! `T_BS`) is not used: poses given to presight are poses of the camera.

use super::{Keys, lens, off_centre, unused, yaml};
use presight_model::error::{Error, ErrorKind, Result};
use presight_model::sensor::{Camera, Geometry, SensorSpec};
use serde::Deserialize;
use std::collections::BTreeMap;

/// One camera. Missing keys are found after the camera is chosen.
#[derive(Deserialize)]
struct Entry {
    sensor_type: Option<String>,
    camera_model: Option<String>,
    intrinsics: Option<Vec<f64>>,
    resolution: Option<[u32; 2]>,
    distortion_model: Option<String>,
    #[serde(alias = "distortion_coefficients")]
    distortion_coeffs: Option<Vec<f64>>,
}

/// True for the key of a camera in a chain: `cam0`, `cam1`, ..
pub(super) fn is_camera(key: &str) -> bool {
    key.strip_prefix("cam").is_some_and(|number| !number.is_empty() && number.bytes().all(|b| b.is_ascii_digit()))
}

/// The cameras of a chain, by name.
pub(super) fn cameras(keys: &Keys) -> impl Iterator<Item = &str> {
    keys.keys().map(String::as_str).filter(|key| is_camera(key))
}

/// # Errors
/// Those of [`super::read`].
pub(super) fn parse(text: &str, keys: &Keys, name: &str, camera: Option<&str>) -> Result<(SensorSpec, Vec<String>)> {
    let mut notices = Vec::new();
    let Some(first) = cameras(keys).next() else {
        return yaml::<Entry>(text)?.spec(name, keys, &mut notices).map(|spec| (spec, notices));
    };
    let names: Vec<&str> = cameras(keys).collect();
    let chosen = camera.unwrap_or(first);
    if !names.contains(&chosen) {
        return Err(Error::usage(format!("the file has no camera {chosen:?}"), format!("give {}", names.join(" or "))));
    }
    if camera.is_none() && names.len() > 1 {
        let others = names[1..].join(", ");
        notices.push(format!("camera {first} is taken, not {others}: write FILE:{} for another one", names[1]));
    }
    let mut entries: BTreeMap<String, Entry> = yaml(text)?;
    let own: BTreeMap<String, Keys> = yaml(text)?;
    let entry = entries.remove(chosen).zip(own.get(chosen));
    let (entry, keys) = entry.ok_or_else(|| Error::invalid("it is empty", "give its intrinsics").at(chosen))?;
    let spec = entry.spec(chosen, keys, &mut notices).map_err(|e| e.at(chosen))?;
    Ok((spec, notices))
}

impl Entry {
    fn spec(self, name: &str, keys: &Keys, notices: &mut Vec<String>) -> Result<SensorSpec> {
        if let Some(kind) = self.sensor_type.filter(|kind| kind != "camera") {
            let what = format!("this is EuRoC's file of a sensor of type {kind:?}");
            return Err(Error::new(ErrorKind::Unsupported, what, "give the sensor.yaml of a camera"));
        }
        if let Some(model) = self.camera_model.filter(|model| model != "pinhole") {
            let remedy = "calibrate it with Kalibr's pinhole-radtan or pinhole-equi";
            return Err(
                Error::new(ErrorKind::Unsupported, format!("camera model {model:?}"), remedy).at("camera_model")
            );
        }
        let missing = |key: &'static str| move || Error::invalid(format!("{key} is missing"), "add it").at(key);
        let [width, height] = self.resolution.ok_or_else(missing("resolution"))?;
        let intrinsics = self.intrinsics.ok_or_else(missing("intrinsics"))?;
        let &[fx, fy, cx, cy] = intrinsics.as_slice() else {
            let what = format!("{} numbers", intrinsics.len());
            return Err(Error::invalid(what, "give 4: fx, fy, cx, cy").at("intrinsics"));
        };
        let coefficients = self.distortion_coeffs.unwrap_or_default();
        let model = self.distortion_model.as_deref().unwrap_or(if coefficients.is_empty() { "none" } else { "radtan" });
        let is_used = |key: &str| {
            let used = ["camera_model", "intrinsics", "resolution", "distortion_model", "distortion_coeffs"];
            used.contains(&key) || key == "distortion_coefficients"
        };
        let on_rig = if keys.keys().any(|key| key.starts_with("T_")) { ": poses are poses of the camera" } else { "" };
        notices.extend(unused(keys, is_used).map(|notice| notice + on_rig));
        notices.extend(off_centre([width, height], [width, height], [cx, cy]));
        let distortion = lens(model, &coefficients)?;
        Ok(SensorSpec::new(name, "video", Geometry::Camera(Camera { width, height, fx, fy, cx, cy, distortion })))
    }
}
