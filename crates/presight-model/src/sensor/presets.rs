//! Sensor presets, stored as the text of sensor files and read by the same reader as user files.
//!
//! Real multi-beam lidars have offset beam origins and staggered azimuths, and depth cameras have two imagers. A preset
//! is the ideal grid with one centre, but for those whose name ends in `-real`, which have the published beam table.
//! Its text names the source and the omissions. `preset` makes a sensor from one.

/// A named sensor with its text.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Preset {
    /// The name, as `--sensor` accepts it.
    pub name: &'static str,
    /// Its sensor TOML, whose comments name the source and what the ideal sensor omits.
    pub toml: &'static str,
}

/// Every preset: the sensors of the paper first, then products.
pub const PRESETS: &[Preset] = &[
    Preset { name: "video-camera", toml: include_str!("presets/video-camera.toml") },
    Preset { name: "microwave-radar-scan", toml: include_str!("presets/microwave-radar-scan.toml") },
    Preset { name: "microwave-radar-image", toml: include_str!("presets/microwave-radar-image.toml") },
    Preset { name: "laser-range-camera", toml: include_str!("presets/laser-range-camera.toml") },
    Preset { name: "laser-scanner", toml: include_str!("presets/laser-scanner.toml") },
    Preset { name: "vlp-16", toml: include_str!("presets/vlp-16.toml") },
    Preset { name: "vlp-16-real", toml: include_str!("presets/vlp-16-real.toml") },
    Preset { name: "vlp-32c-real", toml: include_str!("presets/vlp-32c-real.toml") },
    Preset { name: "os1-128", toml: include_str!("presets/os1-128.toml") },
    Preset { name: "os1-128-real", toml: include_str!("presets/os1-128-real.toml") },
    Preset { name: "mid-360-like", toml: include_str!("presets/mid-360-like.toml") },
    Preset { name: "realsense-d435", toml: include_str!("presets/realsense-d435.toml") },
];
