//! Rendering strategies of the CPU engine.

use presight_model::sensor::{GroupLayout, PixelGrid, Sensor};
use presight_model::world::World;
use serde::Serialize;

presight_model::words! {
    /// Strategy of the CPU engine for finding the polygon that a ray sees. All strategies give the same bits.
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
        Auto = "auto",
        /// Whichever is faster by counts alone, so that the choice is the same in every run.
        Counts = "counts",
        /// Polygons in view are selected, set up and drawn, nearest first.
        Raster = "raster",
        /// Tiles of rays search a tree for each mesh, without a selection.
        Tiles = "tiles",
    }
}

/// A strategy that was chosen for a prediction.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ChosenWay {
    /// [`Way::Raster`] or [`Way::Tiles`].
    pub way: Way,
    /// The reason, in words.
    pub why: &'static str,
    /// True to build missing trees immediately, instead of after frames without them have taken as long.
    pub at_once: bool,
    /// The raster hands over to tiles if more polygons may be visible after its first wave.
    pub max_left: u64,
}

/// Maximum number of rays of a sensor for which selecting polygons takes longer than finding the visible ones.
const FEW_RAYS: u64 = 4096;

/// Minimum number of polygons for which a search is faster than drawing all of them.
const FEW_POLYGONS: u32 = 2000;

/// Number of polygons that may be visible after the first wave from which on tiles are faster, relative to the number
/// of rays. On lines a polygon costs little, so that five for two rays are still worth drawing; in a table it is tested
/// against tiles of rays, and one for four rays is too many. Each of 72 frames of six sensors in four scenes took at
/// most 1.03 times as long as by the raster. Learnt times correct other cases.
fn max_left(sensor: &Sensor, rays: u64) -> u64 {
    match sensor.grid() {
        PixelGrid::Lines(_) => rays.saturating_mul(5) / 2,
        PixelGrid::Rays(_) => rays / 4,
    }
}

impl ChosenWay {
    /// Strategy of plans with a selection.
    pub const RASTER: Self =
        Self { way: Way::Raster, why: "the selected polygons are drawn", at_once: false, max_left: u64::MAX };

    /// Strategy of plans without a selection whose trees are not built yet.
    pub const WITHOUT_TREES: Self = Self { why: "the trees for tiles are not made yet", ..Self::RASTER };

    /// Strategy of plans that tiles may not finish by the deadline.
    pub const TILES_TAKE_TOO_LONG: Self =
        Self { why: "tiles cannot stop at a distance, and may take longer than the deadline leaves", ..Self::RASTER };

    /// Strategy of plans without a selection.
    pub const TILES: Self = Self { way: Way::Tiles, why: "this way was requested", at_once: true, ..Self::RASTER };

    /// Strategy of plans whose rays have poses of their own.
    pub const BUNDLES: Self = Self { why: "the rays have origins or times of their own", ..Self::TILES };

    /// Strategy of plans with a selection if many polygons are left after the first wave.
    pub const AFTER_A_WAVE: Self =
        Self { why: "too many polygons may show after the first wave", at_once: false, ..Self::TILES };
}

/// Mean half angle of a table's squares, radians, above which neighbours in the table differ in direction.
const SCATTERED: f64 = 0.1;

/// True if the table does not list rays in the order of an image: the raster would test each polygon in most squares.
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
    /// Chooses by counts that are available before the selection, so that the choice is the same in every run. The
    /// raster may turn to tiles after its first wave.
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
                    max_left: max_left(sensor, rays),
                    ..raster("few polygons may show after the first wave")
                },
            },
        }
    }
}
