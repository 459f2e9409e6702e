//! How the CPU engine finds what a ray sees.

use presight_model::sensor::{GroupLayout, Sensor};
use presight_model::world::World;
use serde::Serialize;
use std::fmt;

/// How the CPU engine finds what rays see. Images have the same bits either way.
///
/// ```
/// use presight::Way;
/// assert_eq!(Way::default(), Way::Auto);
/// assert_eq!(Way::Tiles.to_string(), "tiles");
/// ```
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Way {
    /// Whichever is faster for the sensor, the world and the request.
    #[default]
    Auto,
    /// Polygons in view are selected, set up and drawn, nearest first.
    Raster,
    /// Tiles of rays search a tree for each mesh; nothing is selected.
    Tiles,
}

impl Way {
    /// The word in files, flags and tables.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Auto => "auto",
            Self::Raster => "raster",
            Self::Tiles => "tiles",
        }
    }
}

impl fmt::Display for Way {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(self.name())
    }
}

/// A way that was chosen for a prediction.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ChosenWay {
    /// [`Way::Raster`] or [`Way::Tiles`].
    pub way: Way,
    /// For people.
    pub why: &'static str,
    /// Trees are made at once, not when frames without them have taken as long.
    pub at_once: bool,
}

/// Sensors of so few rays are searched in tiles: selecting what they may see takes longer.
const FEW_RAYS: u64 = 4096;

/// Of so few polygons the raster looks at each as fast as tiles find one.
const FEW_POLYGONS: u32 = 2000;

impl ChosenWay {
    /// Of plans that select.
    pub const RASTER: Self = Self { way: Way::Raster, why: "what is selected is drawn", at_once: false };

    /// Of plans that select nothing.
    pub const TILES: Self = Self { way: Way::Tiles, why: "it was asked for", at_once: true };
}

impl Default for ChosenWay {
    fn default() -> Self {
        Self::RASTER
    }
}

impl Way {
    /// Chooses by what is known before anything is selected: counts, so that the choice is the same in every run.
    pub fn choose(self, world: &World, sensor: &Sensor, has_deadline: bool) -> ChosenWay {
        let raster = |why| ChosenWay { way: Self::Raster, why, at_once: false };
        let tiles = |why| ChosenWay { way: Self::Tiles, why, at_once: false };
        if has_deadline {
            return raster("only the raster can stop at a deadline");
        }
        let few_rays = u64::from(sensor.width()) * u64::from(sensor.height()) <= FEW_RAYS;
        match self {
            Self::Raster => raster("it was asked for"),
            Self::Tiles => ChosenWay::TILES,
            Self::Auto => match sensor.ray_layout() {
                GroupLayout::Listed if !few_rays => tiles("the sensor's rays are listed"),
                _ if world.environment().slot_count() < FEW_POLYGONS => raster("the world has few polygons"),
                _ if few_rays => tiles("the sensor has few rays"),
                GroupLayout::Across => tiles("the sensor's rows lie far apart"),
                _ => raster("for images of many rays the raster is faster"),
            },
        }
    }
}
