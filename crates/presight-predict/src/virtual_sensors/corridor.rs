//! Motion corridors: the space that a robot's planned path sweeps.

use glam::DVec2;
use presight_model::error::{Error, Result};
use presight_model::limits;
use serde::Deserialize;

/// The space within half a width of a line on the ground, between two heights.
///
/// ```
/// use presight::virtual_sensors::Corridor;
/// let corridor = Corridor::new(vec![[0.0, 0.0], [2.0, 0.0], [2.0, 3.0]], 0.4, 0.05, 1.5)?;
/// assert_eq!(corridor.length(), 5.0);
/// assert_eq!(corridor.arc_length_at([1.5, 0.3, 1.0]), Some(1.5));
/// assert_eq!(corridor.arc_length_at([1.5, 0.3, 0.0]), None, "below it: the floor");
/// # Ok::<(), presight::Error>(())
/// ```
#[derive(Clone, Debug, PartialEq)]
pub struct Corridor {
    polyline_in_robot: Vec<DVec2>,
    half_width: f64,
    z_min: f64,
    z_max: f64,
    /// Bounding box seen from above, for a quick test: most points are outside.
    bounds: [DVec2; 2],
}

/// The fields of a corridor file.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CorridorFields {
    /// Checked before these fields are read.
    #[serde(default, rename = "format")]
    pub _format: Option<i64>,
    /// Points of the middle line, metres.
    pub polyline_in_robot: Vec<[f64; 2]>,
    /// Metres to each side.
    pub half_width: f64,
    /// Lower end, metres.
    pub z_min: f64,
    /// Upper end, metres.
    pub z_max: f64,
}

/// Largest number of points of a line.
const MAX_POINTS: usize = 10_000;

impl Corridor {
    /// Makes a corridor from a line in the robot's x-y plane, half the width, and the lowest and highest z, metres.
    ///
    /// # Errors
    /// [`presight_model::ErrorKind::Invalid`] for fewer than two or too many points, a line without length, a width of
    /// 0, heights out of order, and values that are not finite or beyond the limits.
    pub fn new(polyline_in_robot: Vec<[f64; 2]>, half_width: f64, z_min: f64, z_max: f64) -> Result<Self> {
        let sound = |x: f64| x.abs() <= limits::MAX_COORDINATE;
        let wrong = |what: String, remedy: &str, place: &str| Err(Error::invalid(what, remedy).at(place.to_owned()));
        if !(2..=MAX_POINTS).contains(&polyline_in_robot.len()) {
            let what = format!("has {} points", polyline_in_robot.len());
            return wrong(what, "give 2 to 10,000 points [x, y]", "polyline_in_robot");
        }
        if let Some(i) = polyline_in_robot.iter().position(|p| !p.iter().all(|x| sound(*x))) {
            let what = format!("{:?} is not finite or too far away", polyline_in_robot[i]);
            return wrong(what, "give metres", &format!("polyline_in_robot, point {i}"));
        }
        if !(half_width > 0.0 && sound(half_width)) {
            return wrong(format!("is {half_width}"), "give metres above 0", "half_width");
        }
        if !(z_min < z_max && sound(z_min) && sound(z_max)) {
            return wrong(format!("are {z_min} and {z_max}"), "give z_min < z_max, metres", "z_min, z_max");
        }
        let polyline_in_robot: Vec<DVec2> = polyline_in_robot.into_iter().map(DVec2::from).collect();
        let least = polyline_in_robot.iter().copied().fold(DVec2::INFINITY, DVec2::min);
        let most = polyline_in_robot.iter().copied().fold(DVec2::NEG_INFINITY, DVec2::max);
        let bounds = [least - half_width, most + half_width];
        let corridor = Self { polyline_in_robot, half_width, z_min, z_max, bounds };
        if corridor.length() > 0.0 {
            return Ok(corridor);
        }
        wrong("has no length".into(), "give points that are apart", "polyline_in_robot")
    }

    /// Length of the line, metres.
    pub fn length(&self) -> f64 {
        self.polyline_in_robot.windows(2).map(|w| w[0].distance(w[1])).sum()
    }

    /// Distance along the line to the point nearest to `p_in_robot`, metres. If several straight pieces are within half
    /// the width, the first one counts. Returns `None` outside the corridor.
    pub fn arc_length_at(&self, p_in_robot: [f64; 3]) -> Option<f64> {
        let [x, y, z] = p_in_robot;
        let p = DVec2::new(x, y);
        let inside = p.cmpge(self.bounds[0]).all() && p.cmple(self.bounds[1]).all();
        if !(inside && z >= self.z_min && z <= self.z_max) {
            return None;
        }
        let mut before = 0.0;
        for piece in self.polyline_in_robot.windows(2) {
            let along = piece[1] - piece[0];
            let length = along.length();
            let s = if length > 0.0 { ((p - piece[0]).dot(along) / length).clamp(0.0, length) } else { 0.0 };
            let nearest = piece[0] + along * if length > 0.0 { s / length } else { 0.0 };
            if p.distance(nearest) <= self.half_width {
                return Some(before + s);
            }
            before += length;
        }
        None
    }
}
