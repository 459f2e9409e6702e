//! Conversion from the axes and unit of a scene file to the world.

use glam::{DAffine3, DMat3, DVec3};
use presight_model::error::{Error, Result};
use presight_model::geometry::{Aabb, Pose};
use serde::{Deserialize, Serialize};

/// The axis of a scene file that points up.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Up {
    /// glTF's own: y up, and z towards the viewer.
    #[default]
    Y,
    /// z up, as many robotics exporters write and as in presight's world.
    Z,
}

/// z-up from glTF's y-up: (x, y, z) -> (x, -z, y).
pub const Z_UP_FROM_Y_UP: DMat3 = DMat3::from_cols(DVec3::X, DVec3::Z, DVec3::NEG_Y);

impl Up {
    /// Its name in files and options.
    pub fn name(self) -> &'static str {
        if self == Self::Y { "y" } else { "z" }
    }

    /// z-up from the file's axes.
    fn turn(self) -> DMat3 {
        match self {
            Self::Y => Z_UP_FROM_Y_UP,
            Self::Z => DMat3::IDENTITY,
        }
    }
}

impl std::str::FromStr for Up {
    type Err = Error;

    fn from_str(text: &str) -> Result<Self> {
        match text {
            "y" => Ok(Self::Y),
            "z" => Ok(Self::Z),
            _ => Err(Error::usage(format!("{text:?} is not a valid up axis"), "give y or z")),
        }
    }
}

/// The placement of a scene file in the world: it is turned upright, scaled to metres, then placed.
///
/// ```
/// use presight::files::{SceneFrame, Up};
/// let frame = SceneFrame { up: Up::Z, scale: 0.001, ..SceneFrame::default() };
/// assert_eq!(frame.world_from_file().transform_point3(glam::DVec3::new(0.0, 0.0, 2000.0)).z, 2.0);
/// ```
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SceneFrame {
    /// The axis of the file that points up.
    pub up: Up,
    /// Metres in one unit of the file.
    pub scale: f64,
    /// Pose of the upright scene in the world.
    pub world_from_scene: Pose,
}

impl Default for SceneFrame {
    fn default() -> Self {
        Self { up: Up::Y, scale: 1.0, world_from_scene: Pose::IDENTITY }
    }
}

impl SceneFrame {
    /// Checks a scale.
    ///
    /// # Errors
    /// [`presight_model::ErrorKind::Usage`] unless it is finite and above 0.
    pub fn check_scale(scale: f64) -> Result<()> {
        if scale.is_finite() && scale > 0.0 {
            return Ok(());
        }
        let remedy = "give the metres in one unit of the file, such as 0.001 for millimetres";
        Err(Error::usage(format!("{scale} is not a valid scale"), remedy))
    }

    /// Transforms coordinates of the file into the world.
    pub fn world_from_file(&self) -> DAffine3 {
        self.world_from_scene.to_affine() * DAffine3::from_mat3(self.up.turn() * self.scale)
    }

    /// Transforms coordinates along the file's axes, in metres, into the world.
    pub fn world_from_axes(&self) -> Pose {
        match self.up {
            Up::Y => self.world_from_scene * Pose::from_xyz_rpy(DVec3::ZERO, std::f64::consts::FRAC_PI_2, 0.0, 0.0),
            Up::Z => self.world_from_scene,
        }
    }

    /// Hints if the bounds of the upright scene suggest that it lies on its side or has another unit. Usually empty.
    pub fn hints(&self, scene: &Aabb) -> Vec<String> {
        /// A building is unlikely to be this low or lower, or this high or higher, metres.
        const HEIGHTS: [f64; 2] = [0.2, 200.0];
        /// Height of a storey, metres.
        const USUAL: f64 = 3.0;
        let mut hints = Vec::new();
        if scene.is_empty() {
            return hints;
        }
        let size = scene.max - scene.min;
        if size.y < size.x && size.y < size.z {
            let other = if self.up == Up::Y { Up::Z } else { Up::Y };
            hints.push(format!(
                "it is thinnest along y of the world, {:.3} m: if walls lie on the floor, give `ImportOptions::up` {}",
                size.y,
                other.name()
            ));
        }
        if size.z > 0.0 && (size.z <= HEIGHTS[0] || size.z >= HEIGHTS[1]) {
            let scale = self.scale * 10f64.powf((USUAL / size.z).log10().round());
            hints.push(format!(
                "it is {:.3} m high: if its unit is not the metre, give `ImportOptions::scale`, such as {scale}",
                size.z
            ));
        }
        hints
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn files_are_turned_scaled_and_placed() {
        let place = Pose::from_xyz_rpy(DVec3::new(100.0, 0.0, 0.0), 0.0, 0.0, std::f64::consts::FRAC_PI_2);
        let point = DVec3::new(1.0, 2.0, 3.0);
        for (up, upright) in [(Up::Y, DVec3::new(1.0, -3.0, 2.0)), (Up::Z, point)] {
            let frame = SceneFrame { up, scale: 2.0, world_from_scene: place };
            let world = DVec3::new(100.0 - 2.0 * upright.y, 2.0 * upright.x, 2.0 * upright.z);
            assert!((frame.world_from_file().transform_point3(point) - world).length() < 1e-12, "{up:?}");
            assert!((frame.world_from_axes().transform_point(2.0 * point) - world).length() < 1e-12, "{up:?}");
        }
    }

    #[test]
    fn hints_are_given_for_what_lies_and_for_giants_and_dwarfs() {
        let hints = |up, size: [f64; 3]| {
            let frame = SceneFrame { up, ..SceneFrame::default() };
            frame.hints(&Aabb { min: DVec3::ZERO, max: DVec3::from_array(size) })
        };
        assert!(hints(Up::Y, [20.0, 15.0, 3.0]).is_empty());
        for (up, word) in [(Up::Y, "`ImportOptions::up` z"), (Up::Z, "`ImportOptions::up` y")] {
            let lines = hints(up, [20.0, 3.0, 15.0]);
            assert!(lines.len() == 1 && lines[0].contains(word), "{lines:?}");
        }
        for (height, word) in
            [(200.0, "such as 0.01"), (3000.0, "such as 0.001"), (0.2, "such as 10"), (0.003, "such as 1000")]
        {
            let lines = hints(Up::Y, [height * 5.0, height * 5.0, height]);
            assert!(lines.len() == 1 && lines[0].ends_with(word), "{lines:?}");
        }
        assert!(hints(Up::Y, [2.0, 2.0, 0.0]).is_empty(), "a floor");
        for wrong in [0.0, -1.0, f64::NAN, f64::INFINITY] {
            assert!(SceneFrame::check_scale(wrong).is_err());
        }
    }
}
