//! Motion corridors: the space that a robot's planned path sweeps.

use glam::DVec2;
use presight_model::error::{Error, Result};
use presight_model::limits;

/// Frame of a corridor's coordinates.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum CorridorFrame {
    /// The robot's: the corridor moves with it.
    Robot,
    /// The world's.
    World,
}

/// An area on the ground between two heights.
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
    frame: CorridorFrame,
    area: Area,
    length: f64,
    z_min: f64,
    z_max: f64,
    /// Bounding box seen from above, for a quick test: most points are outside.
    bounds: [DVec2; 2],
}

/// What a corridor covers, seen from above.
#[derive(Clone, Debug, PartialEq)]
enum Area {
    /// All points within half a width of a line.
    Along { line: Vec<DVec2>, half_width: f64 },
    /// A simple polygon.
    Polygon(Vec<DVec2>),
    /// A footprint moved over poses.
    Swept(Sweep),
}

/// A footprint at poses so close together that no point of it moves farther than [`SWEEP_STEP`] between two.
#[derive(Clone, Debug, PartialEq)]
struct Sweep {
    footprint: Vec<DVec2>,
    radius: f64,
    placements: Vec<Placement>,
}

#[derive(Clone, Copy, Debug, PartialEq)]
struct Placement {
    at: DVec2,
    /// Cosine and sine of the heading.
    heading: DVec2,
    /// Distance travelled so far, metres.
    arc: f64,
}

/// Maximum number of points of a line, and of poses.
const MAX_POINTS: usize = 10_000;
/// Maximum number of corners of a polygon or footprint.
const MAX_CORNERS: usize = 256;
/// Metres between two placements of a swept footprint.
const SWEEP_STEP: f64 = 0.01;
/// Maximum number of placements of a swept footprint.
const MAX_PLACEMENTS: usize = 20_000;

fn wrong<T>(what: String, remedy: &str, place: impl Into<String>) -> Result<T> {
    Err(Error::invalid(what, remedy).at(place.into()))
}

fn is_sound(x: f64) -> bool {
    x.abs() <= limits::MAX_COORDINATE
}

/// Checks a list of points under its key.
fn checked(key: &str, points: Vec<[f64; 2]>, [least, most]: [usize; 2]) -> Result<Vec<DVec2>> {
    if !(least..=most).contains(&points.len()) {
        return wrong(format!("has {} points", points.len()), &format!("give {least} to {most} points [x, y]"), key);
    }
    if let Some(i) = points.iter().position(|p| !p.iter().all(|x| is_sound(*x))) {
        let what = format!("{:?} is not finite or too far away", points[i]);
        return wrong(what, "give metres", format!("{key}, point {i}"));
    }
    Ok(points.into_iter().map(DVec2::from).collect())
}

/// Checks the corners of a simple polygon under its key. A corner that repeats the one before it counts once, and so
/// does a last corner that repeats the first: GeoJSON and WKT close their rings that way.
fn checked_polygon(key: &str, mut corners: Vec<[f64; 2]>) -> Result<Vec<DVec2>> {
    corners.dedup();
    if corners.len() > 1 && corners.first() == corners.last() {
        corners.pop();
    }
    let corners = checked(key, corners, [3, MAX_CORNERS])?;
    let n = corners.len();
    let side = |i: usize| (corners[i], corners[(i + 1) % n]);
    for i in 0..n {
        if let Some(j) = (i + 2..n).find(|j| (j + 1) % n != i && do_cross(side(i), side(*j))) {
            return wrong(format!("its sides {i} and {j} cross"), "give the corners in order around it", key);
        }
    }
    let doubled: f64 = (0..n).map(|i| side(i).0.perp_dot(side(i).1)).sum();
    if doubled.abs() > 0.0 { Ok(corners) } else { wrong("has no area".into(), "give corners that are apart", key) }
}

/// True if two sides have a point in common.
fn do_cross((a, b): (DVec2, DVec2), (c, d): (DVec2, DVec2)) -> bool {
    let side = |from: DVec2, to: DVec2, p: DVec2| (to - from).perp_dot(p - from);
    let within = |from: DVec2, to: DVec2, p: DVec2| p.cmpge(from.min(to)).all() && p.cmple(from.max(to)).all();
    let (s, t) = ([side(a, b, c), side(a, b, d)], [side(c, d, a), side(c, d, b)]);
    let touches = [(s[0], a, b, c), (s[1], a, b, d), (t[0], c, d, a), (t[1], c, d, b)];
    s[0] * s[1] < 0.0 && t[0] * t[1] < 0.0 || touches.into_iter().any(|(s, a, b, p)| s == 0.0 && within(a, b, p))
}

fn holds(corners: &[DVec2], p: DVec2) -> bool {
    let mut inside = false;
    let mut before = corners[corners.len() - 1];
    for &corner in corners {
        if (corner.y > p.y) != (before.y > p.y)
            && p.x < corner.x + (p.y - corner.y) / (before.y - corner.y) * (before.x - corner.x)
        {
            inside = !inside;
        }
        before = corner;
    }
    inside
}

impl Corridor {
    /// Makes a corridor from a line in the robot's x-y plane, half the width, and the lowest and highest z, metres.
    ///
    /// # Errors
    /// [`presight_model::ErrorKind::Invalid`] for fewer than two or too many points, a line without length, a width of
    /// 0, heights out of order, and values that are not finite or beyond the limits.
    pub fn new(polyline_in_robot: Vec<[f64; 2]>, half_width: f64, z_min: f64, z_max: f64) -> Result<Self> {
        Self::along("polyline_in_robot", CorridorFrame::Robot, polyline_in_robot, half_width, [z_min, z_max])
    }

    /// As [`Corridor::new`], with the line and the heights in the world.
    ///
    /// # Errors
    /// As [`Corridor::new`].
    pub fn in_world(polyline_in_world: Vec<[f64; 2]>, half_width: f64, z_min: f64, z_max: f64) -> Result<Self> {
        Self::along("polyline_in_world", CorridorFrame::World, polyline_in_world, half_width, [z_min, z_max])
    }

    fn along(key: &str, frame: CorridorFrame, line: Vec<[f64; 2]>, half_width: f64, heights: [f64; 2]) -> Result<Self> {
        let line = checked(key, line, [2, MAX_POINTS])?;
        if !(half_width > 0.0 && is_sound(half_width)) {
            return wrong(format!("is {half_width}"), "give metres above 0", "half_width");
        }
        let length = line.windows(2).map(|w| w[0].distance(w[1])).sum();
        if !(length > 0.0) {
            return wrong("has no length".into(), "give points that are apart", key);
        }
        let bounds = bounds_of(&line, half_width);
        Self::of(frame, Area::Along { line, half_width }, length, heights, bounds)
    }

    /// Makes a corridor from the corners of a simple polygon in the robot's x-y plane, and the lowest and highest z,
    /// metres. Distances along it are distances from the robot's origin.
    ///
    /// # Errors
    /// [`presight_model::ErrorKind::Invalid`] for fewer than three or too many corners, sides that cross, no area,
    /// heights out of order, and values that are not finite or beyond the limits.
    pub fn polygon(corners: Vec<[f64; 2]>, z_min: f64, z_max: f64) -> Result<Self> {
        let corners = checked_polygon("polygon", corners)?;
        let length = corners.iter().map(|p| p.length()).fold(0.0, f64::max);
        let bounds = bounds_of(&corners, 0.0);
        Self::of(CorridorFrame::Robot, Area::Polygon(corners), length, [z_min, z_max], bounds)
    }

    /// Makes a corridor from the corners of the robot's footprint and the poses over which it moves: x, y, metres, and
    /// yaw, radians, all in the robot's current frame. Between two poses the footprint moves along a straight line and
    /// turns evenly from the one yaw to the other: counter-clockwise if the yaw grows. Yaws that are more than half a turn
    /// apart count as wrapped by one turn, such as from 3.1 to -3.1, if that leaves less than a quarter turn.
    ///
    /// # Errors
    /// As [`Corridor::polygon`], and for no poses, too many, a sweep that is too long, or a turn that may be meant either
    /// way.
    pub fn swept(footprint: Vec<[f64; 2]>, poses: &[[f64; 3]], z_min: f64, z_max: f64) -> Result<Self> {
        let footprint = checked_polygon("footprint", footprint)?;
        let radius = footprint.iter().map(|p| p.length()).fold(0.0, f64::max);
        if !(1..=MAX_POINTS).contains(&poses.len()) {
            let what = format!("has {} poses", poses.len());
            return wrong(what, &format!("give 1 to {MAX_POINTS} poses [x, y, yaw_deg]"), "poses");
        }
        if let Some(i) = poses.iter().position(|p| !p.iter().all(|x| is_sound(*x))) {
            let what = format!("{:?} is not finite or too far away", poses[i]);
            return wrong(what, "give metres and degrees", format!("poses, pose {i}"));
        }
        let mut placements = Vec::new();
        let mut arc = 0.0;
        let mut before = poses[0];
        for pose in poses {
            let (from, to) = (DVec2::new(before[0], before[1]), DVec2::new(pose[0], pose[1]));
            let turn = turn_between(before[2], pose[2])?;
            let steps = ((from.distance(to) + turn.abs() * radius) / SWEEP_STEP).ceil().max(1.0);
            if placements.len() as f64 + steps > MAX_PLACEMENTS as f64 {
                let most = MAX_PLACEMENTS as f64 * SWEEP_STEP;
                let what = format!("the footprint moves farther than {most} m");
                return wrong(what, "give a shorter way", "poses");
            }
            for k in 1..=steps as u32 {
                let t = f64::from(k) / steps;
                let (sin, cos) = (before[2] + t * turn).sin_cos();
                let at = from.lerp(to, t);
                placements.push(Placement { at, heading: DVec2::new(cos, sin), arc: arc + t * from.distance(to) });
            }
            arc += from.distance(to);
            before = *pose;
        }
        let middles: Vec<DVec2> = placements.iter().map(|p| p.at).collect();
        let bounds = bounds_of(&middles, radius);
        let area = Area::Swept(Sweep { footprint, radius, placements });
        Self::of(CorridorFrame::Robot, area, arc.max(f64::MIN_POSITIVE), [z_min, z_max], bounds)
    }

    fn of(frame: CorridorFrame, area: Area, length: f64, [z_min, z_max]: [f64; 2], bounds: [DVec2; 2]) -> Result<Self> {
        if !(z_min < z_max && is_sound(z_min) && is_sound(z_max)) {
            return wrong(format!("are {z_min} and {z_max}"), "give z_min < z_max, metres", "z_min, z_max");
        }
        Ok(Self { frame, area, length, z_min, z_max, bounds })
    }

    /// Frame of the coordinates.
    pub fn frame(&self) -> CorridorFrame {
        self.frame
    }

    /// Length of the corridor, metres: that of its line or path; for a polygon the distance of its farthest corner.
    pub fn length(&self) -> f64 {
        self.length
    }

    /// Minimum and maximum z, metres.
    pub fn heights(&self) -> [f64; 2] {
        [self.z_min, self.z_max]
    }

    /// A box around it, seen from above: minimum and maximum x and y, metres.
    pub fn bounds(&self) -> [DVec2; 2] {
        self.bounds
    }

    /// Distance along the corridor, metres, of a point in its frame: along the line to the point nearest to it, along
    /// the path that the footprint travels until it covers the point, or from the robot's origin in a polygon. If
    /// several straight pieces of a line are within half the width, the first one counts. Returns `None` outside the
    /// corridor.
    pub fn arc_length_at(&self, [x, y, z]: [f64; 3]) -> Option<f64> {
        if z >= self.z_min && z <= self.z_max { self.arc_length_from_above(DVec2::new(x, y)) } else { None }
    }

    /// As [`Corridor::arc_length_at`], at any height.
    pub fn arc_length_from_above(&self, p: DVec2) -> Option<f64> {
        if !(p.cmpge(self.bounds[0]).all() && p.cmple(self.bounds[1]).all()) {
            return None;
        }
        match &self.area {
            Area::Along { line, half_width } => along_line(line, *half_width, p),
            Area::Polygon(corners) => holds(corners, p).then(|| p.length()),
            Area::Swept(sweep) => {
                let near = sweep.placements.iter().filter(|place| p.distance(place.at) <= sweep.radius);
                let covers = |place: &&Placement| {
                    let off = p - place.at;
                    // Into the footprint's frame: turned back by the heading.
                    holds(&sweep.footprint, DVec2::new(place.heading.dot(off), place.heading.perp_dot(off)))
                };
                near.into_iter().find(covers).map(|place| place.arc)
            }
        }
    }
}

/// The turn from one yaw to another, radians: see [`Corridor::swept`].
fn turn_between(from: f64, to: f64) -> Result<f64> {
    use std::f64::consts::{FRAC_PI_2, PI, TAU};
    let stated = to - from;
    // Half a turn in degrees need not be half a turn in radians to the last bit.
    if stated.abs() <= PI * (1.0 + f64::EPSILON * 4.0) {
        return Ok(stated);
    }
    let shorter = (stated + PI).rem_euclid(TAU) - PI;
    if shorter.abs() < FRAC_PI_2 {
        return Ok(shorter);
    }
    let [from, to, stated] = [from, to, stated].map(f64::to_degrees);
    let what = format!("from yaw {from:.0} to {to:.0} degrees are {:.0} degrees, either way around", stated.abs());
    wrong(what, "give a pose in between, so that no turn is over 180 degrees", "poses")
}

fn bounds_of(points: &[DVec2], by: f64) -> [DVec2; 2] {
    let least = points.iter().copied().fold(DVec2::INFINITY, DVec2::min);
    let most = points.iter().copied().fold(DVec2::NEG_INFINITY, DVec2::max);
    [least - by, most + by]
}

fn along_line(line: &[DVec2], half_width: f64, p: DVec2) -> Option<f64> {
    let mut before = 0.0;
    for piece in line.windows(2) {
        let along = piece[1] - piece[0];
        let length = along.length();
        let s = if length > 0.0 { ((p - piece[0]).dot(along) / length).clamp(0.0, length) } else { 0.0 };
        let nearest = piece[0] + along * if length > 0.0 { s / length } else { 0.0 };
        if p.distance(nearest) <= half_width {
            return Some(before + s);
        }
        before += length;
    }
    None
}

#[cfg(test)]
mod tests {
    use super::*;

    const SQUARE: [[f64; 2]; 4] = [[-0.5, -0.3], [0.5, -0.3], [0.5, 0.3], [-0.5, 0.3]];

    /// A footprint of 1 x 0.6 m drives 2 m ahead, then turns left on the spot, which sweeps its corners.
    #[test]
    fn a_footprint_sweeps_what_it_moves_over() {
        let quarter = std::f64::consts::FRAC_PI_2;
        let poses = [[0.0, 0.0, 0.0], [2.0, 0.0, 0.0], [2.0, 0.0, quarter]];
        let corridor = Corridor::swept(SQUARE.to_vec(), &poses, 0.0, 1.0).unwrap();
        assert_eq!(corridor.length(), 2.0);
        let at = |x: f64, y: f64| corridor.arc_length_at([x, y, 0.5]);
        assert_eq!(at(0.4, 0.0), Some(0.0), "under it at the start");
        let reached = at(1.495, 0.25).unwrap();
        assert!((0.995..=0.995 + SWEEP_STEP).contains(&reached), "its front is half a metre ahead: {reached}");
        assert_eq!(at(2.0, 0.45), Some(2.0), "only once it has turned");
        assert_eq!((at(1.0, 0.35), at(2.6, 0.0)), (None, None));
        let corner = 0.5f64.hypot(0.3) - 0.01;
        assert!(at(2.0 + corner * 0.7f64.cos(), corner * 0.7f64.sin()).is_some(), "swept while turning");
    }

    /// A post 40 degrees to the left, at the corner of the turning footprint.
    #[test]
    fn turns_follow_the_sign_of_their_yaw() {
        let swept = |yaws: &[f64]| {
            let poses: Vec<[f64; 3]> = yaws.iter().map(|yaw| [0.0, 0.0, yaw.to_radians()]).collect();
            Corridor::swept(vec![[0.0, -0.1], [1.0, -0.1], [1.0, 0.1], [0.0, 0.1]], &poses, 0.0, 1.0)
        };
        let [left, right] = [40f64, -40.0].map(|deg| (0.9 * deg.to_radians().cos(), 0.9 * deg.to_radians().sin()));
        let sees = |yaws: &[f64]| {
            let corridor = swept(yaws).unwrap();
            [left, right].map(|(x, y)| corridor.arc_length_at([x, y, 0.5]).is_some())
        };
        assert_eq!(sees(&[0.0, 180.0]), [true, false]);
        assert_eq!(sees(&[0.0, -180.0]), [false, true]);
        assert_eq!(sees(&[0.0, 90.0, 180.0, 270.0]), [true, false]);
        assert_eq!(sees(&[20.0, -20.0 + 360.0, -60.0]), [false, true], "wrapped yaws");
        let refused = swept(&[0.0, 270.0]).unwrap_err().to_string();
        assert!(refused.contains("270 degrees") && refused.contains("pose in between"), "{refused}");
    }

    #[test]
    fn repeated_corners_count_once() {
        let open = Corridor::polygon(vec![[0.0, 0.0], [2.0, 0.0], [2.0, 1.0]], 0.0, 1.0).unwrap();
        for more in
            [vec![[0.0, 0.0], [2.0, 0.0], [2.0, 1.0], [0.0, 0.0]], vec![[0.0, 0.0], [2.0, 0.0], [2.0, 0.0], [2.0, 1.0]]]
        {
            assert_eq!(Corridor::polygon(more, 0.0, 1.0).unwrap(), open);
        }
        assert!(Corridor::polygon(vec![[0.0, 0.0], [1.0, 0.0], [0.0, 0.0]], 0.0, 1.0).is_err());
    }

    #[test]
    fn polygons_are_simple_and_may_be_concave() {
        let angle = vec![[0.0, 0.0], [3.0, 0.0], [3.0, 1.0], [1.0, 1.0], [1.0, 3.0], [0.0, 3.0]];
        let corridor = Corridor::polygon(angle, 0.0, 1.0).unwrap();
        assert_eq!(corridor.arc_length_at([2.0, 0.5, 0.1]), Some(2.0f64.hypot(0.5)));
        assert_eq!(corridor.arc_length_at([2.0, 2.0, 0.1]), None);
        assert_eq!(corridor.length(), 3.0f64.hypot(1.0));
        let refused = |corners: &[[f64; 2]]| Corridor::polygon(corners.to_vec(), 0.0, 1.0).unwrap_err().to_string();
        assert!(refused(&[[0.0, 0.0], [1.0, 1.0], [1.0, 0.0], [0.0, 1.0]]).contains("cross"));
        assert!(refused(&[[0.0, 0.0], [1.0, 0.0], [2.0, 0.0]]).contains("polygon"));
        assert!(refused(&[[0.0, 0.0], [1.0, 0.0]]).contains("2 points"));
        assert!(Corridor::swept(vec![SQUARE[0], SQUARE[2], SQUARE[1], SQUARE[3]], &[[0.0; 3]], 0.0, 1.0).is_err());
        assert!(Corridor::swept(SQUARE.to_vec(), &[], 0.0, 1.0).is_err());
        assert!(Corridor::swept(SQUARE.to_vec(), &[[0.0; 3], [1e9, 0.0, 0.0]], 0.0, 1.0).is_err());
    }
}
