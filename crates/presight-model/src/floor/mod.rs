//! The floor: where a robot of a given height, step and slope can drive.
//!
//! A floor is a surface that is at most as steep as the robot's slope. Surfaces of one place whose heights are at most
//! a step apart count as one floor, so that carpets, kerbs and thin slabs need no special case. A place has a floor
//! only if polygons of this floor cover all of it: they are subtracted from its outline, and nothing may remain.
//!
//! [`HeightField`] holds all floors of a scene on a grid, divided into levels. [`Footing`] is the floor around one
//! point of a world.

mod cover;
mod cut;
mod field;
mod footing;
mod level;
mod raster;

pub use cover::SEAM;
pub use cut::{distance_from_above, half};
pub use field::{FieldOptions, HeightField};
pub use footing::{Footing, height_below};
pub use level::Level;
pub use raster::GridFrame;

use glam::DVec3;

crate::options! {
    /// What a robot drives over and under.
    #[derive(Clone, Copy, Debug, PartialEq)]
    pub struct Mobility {
        /// Maximum height of a step, metres. Surfaces higher than this above the floor are obstacles.
        step: f64 = 0.1, with_step;
        /// Height of the robot, metres. Surfaces higher than this above the floor are not in its way.
        height: f64 = 1.8, with_height;
        /// Maximum slope of a floor, degrees. The default lies between ramps for vehicles (at most 9 degrees) and
        /// stairs (at least 20 degrees).
        slope_deg: f64 = 15.0, with_slope_deg;
    }
}

impl Mobility {
    /// True for finite numbers in order: a step of at least 0 below the height, and a slope of 0 to 60 degrees.
    pub fn is_sound(&self) -> bool {
        let Self { step, height, slope_deg } = *self;
        step >= 0.0 && step < height && height.is_finite() && (0.0..=60.0).contains(&slope_deg)
    }

    /// Rise of the steepest floor over a distance, metres.
    pub fn rise(&self, distance: f64) -> f64 {
        self.slope_deg.to_radians().tan() * distance
    }

    /// The direction of the normal of a floor polygon; `None` if the polygon is too steep.
    fn facing(&self, corners: &[DVec3]) -> Option<Facing> {
        let normal: DVec3 =
            (2..corners.len()).map(|k| (corners[k - 1] - corners[0]).cross(corners[k] - corners[0])).sum();
        // A margin for the rounding of corners in f32, so that a floor of exactly this slope counts.
        let is_level = normal.z.abs() >= (self.slope_deg.to_radians().cos() - 1e-6) * normal.length();
        (is_level && normal.z != 0.0).then_some(if normal.z > 0.0 { Facing::Up } else { Facing::Down })
    }
}

/// The side to which the front of a level polygon points.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Facing {
    Up,
    Down,
}
