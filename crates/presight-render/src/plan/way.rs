//! How the CPU engine finds what a ray sees.

use presight_model::sensor::{GroupLayout, PixelGrid, Sensor};
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
    /// Whichever is faster: by counts, and by what the sensor's last frames took.
    #[default]
    Auto,
    /// Whichever is faster by counts alone, so that the choice is the same in every run.
    Counts,
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
            Self::Counts => "counts",
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
    /// The raster hands over to tiles if more polygons may show after its first wave.
    pub most_left: u64,
}

/// Most rays of a sensor for which selecting polygons takes longer than finding the visible ones.
const FEW_RAYS: u64 = 4096;

/// Least number of polygons for which a search is faster than drawing all of them.
const FEW_POLYGONS: u32 = 2000;

/// Polygons that may show after the first wave, for each ray, from which on tiles are faster. On lines a polygon costs little, so that
/// five for two rays still pay; in a table it is tested against tiles of rays, and one for four rays is too many. Of 72 frames of six
/// sensors in four scenes, each took at most 1.03 times as long as by the raster; times find the other frames.
fn most_left(sensor: &Sensor, rays: u64) -> u64 {
    match sensor.grid() {
        PixelGrid::Lines(_) => rays.saturating_mul(5) / 2,
        PixelGrid::Rays(_) => rays / 4,
    }
}

impl ChosenWay {
    /// The way of plans with a selection.
    pub const RASTER: Self =
        Self { way: Way::Raster, why: "the selected polygons are drawn", at_once: false, most_left: u64::MAX };

    /// The way of plans without a selection for which there are no trees yet.
    pub const WITHOUT_TREES: Self = Self { why: "the trees for tiles are not made yet", ..Self::RASTER };

    /// The way of plans that tiles may not finish by the deadline.
    pub const TILES_TAKE_TOO_LONG: Self =
        Self { why: "tiles cannot stop at a distance, and may take longer than the deadline leaves", ..Self::RASTER };

    /// The way of plans without a selection.
    pub const TILES: Self = Self { way: Way::Tiles, why: "this way was requested", at_once: true, ..Self::RASTER };

    /// The way of plans with a selection if many polygons are left after the first wave.
    pub const AFTER_A_WAVE: Self =
        Self { why: "too many polygons may show after the first wave", at_once: false, ..Self::TILES };
}

/// Mean half angle of a table's squares, radians. From here on, neighbours in the table differ in direction.
const SCATTERED: f64 = 0.1;

/// True if the table lists rays in an order that is not that of an image: the raster would test each polygon in most squares.
fn is_scattered(sensor: &Sensor) -> bool {
    let PixelGrid::Rays(grid) = sensor.grid() else { return false };
    let sum: f64 = grid.tiles().iter().map(|tile| tile.half_angle.max(0.0)).sum();
    sum > SCATTERED * grid.tiles().len() as f64
}

impl Default for ChosenWay {
    fn default() -> Self {
        Self::RASTER
    }
}

impl Way {
    /// Chooses by counts that are known before the selection, so the choice is the same in every run. The raster may turn to tiles after
    /// its first wave.
    #[doc(hidden)]
    pub fn choose(self, world: &World, sensor: &Sensor) -> ChosenWay {
        let raster = |why| ChosenWay { why, ..ChosenWay::RASTER };
        let tiles = |why| ChosenWay { way: Self::Tiles, ..raster(why) };
        let rays = u64::from(sensor.width()) * u64::from(sensor.height());
        let few_rays = rays <= FEW_RAYS;
        match self {
            Self::Raster => raster("this way was requested"),
            Self::Tiles => ChosenWay::TILES,
            Self::Auto | Self::Counts => match sensor.ray_layout() {
                GroupLayout::Listed if !few_rays && is_scattered(sensor) => tiles("the sensor's rays are listed"),
                _ if world.environment().slot_count() < FEW_POLYGONS => raster("the world has few polygons"),
                _ if few_rays => tiles("the sensor has few rays"),
                _ => ChosenWay {
                    most_left: most_left(sensor, rays),
                    ..raster("few polygons may show after the first wave")
                },
            },
        }
    }
}
