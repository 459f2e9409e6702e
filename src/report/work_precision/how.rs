//! How a user takes a path: flags of `presight predict`, keys of the sensor's file, or the library.

use super::paths::{Path, Which};
use super::views::View;
use crate::features::{BoxMethod, STEP, Visibility};
use crate::sensor::{Geometry, Sensor};

/// Of a path to images. What begins with flags is for `presight predict`; the rest follows after a semicolon.
pub(super) fn of_image(path: &Path, sensor: &Sensor) -> String {
    let engine = match path.which {
        Which::Reference => "library: reference::render",
        Which::CpuOne => "--backend cpu --threads 1",
        Which::CpuAll => "--backend cpu",
        Which::Gpu => "--backend gpu",
        Which::GpuNarrow => "library: gpu::DeviceOptions::without_int64 (by itself on devices without 64-bit atomics)",
    };
    let index = path.index.map(|s| format!(" --index {}", s.name())).unwrap_or_default();
    format!("{engine}{index}{}", of_view(path.view, sensor))
}

/// What is to be changed in the sensor's file.
fn of_view(view: View, sensor: &Sensor) -> String {
    let geometry = &sensor.spec().geometry;
    match (view, geometry) {
        (View::Whole, _) => String::new(),
        (View::Rays, _) => "; sensor file: kind = \"rays\" with the directions of all pixels".into(),
        (View::Reduced(n), Geometry::Camera(_)) => {
            format!("; sensor file: width, height, fx, fy by {n}, cx and cy to (c + 0.5) / {n} - 0.5")
        }
        (View::Reduced(n), Geometry::Scanner(_)) => {
            let further = 0.5 * f64::from(n - 1);
            format!("; sensor file: count by {n}, step_deg times {n}, start_deg {further} of the old steps further")
        }
        (View::Reduced(n), Geometry::Rays(_)) => format!("; sensor file: every {n}th direction of every {n}th row"),
        (View::Region, Geometry::Scanner(_)) => "; sensor file: another start and count of [azimuth]".into(),
        (View::Region, _) => "; sensor file: width, height, cx, cy of the part, or the roi of a ROS camera_info".into(),
    }
}

/// Of a path to features.
pub(super) fn of_features(which: Which, visibility: Visibility, step: f64, view: View, sensor: &Sensor) -> String {
    let engine = if which == Which::Gpu { "--backend gpu" } else { "--backend cpu" };
    let mut options = Vec::new();
    if visibility == Visibility::Rays {
        options.push("FeatureOptions::visibility = Visibility::Rays".to_owned());
    }
    if step != STEP {
        options.push(format!("FeatureOptions::step = {step}"));
    }
    match options.is_empty() {
        true => format!("{engine}{}", of_view(view, sensor)),
        false => format!("library: {}", options.join(", ")),
    }
}

/// Of a path to regions of interest.
pub(super) fn of_regions(which: Which, method: BoxMethod) -> String {
    match (which, method) {
        (_, BoxMethod::Linear) => "library: BoxOptions::method = BoxMethod::Linear".into(),
        (_, BoxMethod::Set) => "library: BoxOptions::method = BoxMethod::Set".into(),
        (Which::Gpu, BoxMethod::AsNeeded) => "--backend gpu".into(),
        (_, BoxMethod::AsNeeded) => "--backend cpu".into(),
    }
}
