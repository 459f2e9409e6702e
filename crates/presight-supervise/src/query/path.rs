//! Shortest paths on free floor.

use super::floor::{Floor, Obstacle};
use super::options::PathOptions;
use glam::{DVec2, DVec3};
use pathfinding::directed::astar::astar;
use presight_model::error::{Error, Result};
use presight_model::geometry::Aabb;
use presight_model::index::QueryResult;
use presight_model::world::World;
use std::cell::RefCell;
use std::collections::HashMap;

/// The result of a path search.
#[derive(Clone, Debug, PartialEq)]
pub enum FloorPath {
    /// A path from start to end.
    Found {
        /// Points on the floor, world, metres.
        points: Vec<DVec3>,
        /// Length, metres.
        length: f64,
    },
    /// No path exists.
    Blocked {
        /// The reachable position nearest to the end, world, metres.
        reached: DVec3,
        /// Distance from there to the end, metres.
        missing: f64,
        /// Path of the first object on the straight line from there to the end; `None` if the floor ends, or a sensor
        /// saw something.
        object: Option<String>,
    },
}

/// Maximum number of positions that are evaluated.
const MAX_PLACES: usize = 4_000_000;
/// Unit of the integer costs, metres.
const UNIT: f64 = 1e-6;

/// Length of the longest step, in steps of the grid: that of a knight in chess.
const KNIGHT: f64 = 2.24;
/// Maximum distance of the floor above or below a straight part of a path, metres.
const FLAT: f64 = 0.01;

type At = [i32; 2];
/// A position, and the number of its floor.
type Node = (At, u32);

/// Steps to the 8 neighbours, and steps of a knight in chess. With them a path on the grid is at most 2.8 % longer than
/// a straight line.
const STEPS: [At; 16] = [
    [1, 0],
    [1, 1],
    [0, 1],
    [-1, 1],
    [-1, 0],
    [-1, -1],
    [0, -1],
    [1, -1],
    [2, 1],
    [1, 2],
    [-1, 2],
    [-2, 1],
    [-2, -1],
    [-1, -2],
    [1, -2],
    [2, -1],
];

/// Finds a short path of a round robot from one point to another on the floor below them, around the objects of the
/// model and around `seen` boxes (world, metres). Floor polygons must cover the whole robot: edges of the floor, and
/// steps that are higher than the clearance, keep their distance as walls do. Ramps up to the slope of the options
/// belong to the floor. The path is a straight line where that is free. Otherwise it is a shortest path on a grid,
/// whose corners are pulled straight.
///
/// ```
/// use presight::environment::Environment;
/// use presight::query::{FloorPath, PathOptions, find_path};
/// use presight::{Pose, World};
/// use glam::DVec3;
/// let at = |x: f64, y: f64, z: f64| Pose::from_xyz_rpy(DVec3::new(x, y, z), 0.0, 0.0, 0.0);
/// let mut environment = Environment::new();
/// environment.add_cuboid("floor", at(0.0, 0.0, -0.1), DVec3::new(8.0, 8.0, 0.2))?;
/// environment.add_cuboid("wall", at(0.0, 1.0, 1.0), DVec3::new(0.2, 6.0, 2.0))?;
/// let (from, to) = (DVec3::new(-2.0, 0.0, 0.0), DVec3::new(2.0, 0.0, 0.0));
/// let path = find_path(&World::new(environment), from, to, &[], &PathOptions::default())?;
/// // Around the wall's end at y = -2, 0.4 m away from it.
/// let FloorPath::Found { length, .. } = path else { unreachable!() };
/// assert!(length > 6.2 && length < 6.8);
/// # Ok::<(), presight::Error>(())
/// ```
///
/// # Errors
/// [`presight_model::ErrorKind::Usage`] for options and points out of range, without a floor below the start or the
/// end, and for a start or an end at which the robot cannot stand, naming the obstacle.
pub fn find_path(world: &World, from: DVec3, to: DVec3, seen: &[Aabb], options: &PathOptions) -> Result<FloorPath> {
    check(options, from, to)?;
    let floor = Floor::new(world, options, seen);
    let [from, to] =
        [("the start", from), ("the end", to)].map(|(place, p)| ground(&floor, p).map_err(|e| e.at(place)));
    let (from, to) = (from?, to?);
    let search = GridSearch { floor, options, from, places: RefCell::default(), found: RefCell::default() };
    if search.sees(from, to) {
        return Ok(search.found_path(&[from, to]));
    }
    let start = ([0, 0], 0);
    search.places.borrow_mut().insert(start.0, vec![(from.z, true)]);
    let cost = |a: DVec3, b: DVec3| (a.truncate().distance(b.truncate()) / UNIT) as u64;
    let best = RefCell::new((f64::INFINITY, from));
    let neighbours = |node: &Node| {
        let here = search.point(*node);
        let (mut best, missing) = (best.borrow_mut(), here.truncate().distance(to.truncate()));
        if missing < best.0 {
            *best = (missing, here);
        }
        let next = STEPS.iter().filter_map(|step| search.after(*node, *step));
        next.map(|next| (next, cost(here, search.point(next)))).collect::<Vec<_>>()
    };
    // The end may be off the grid.
    let is_last = |node: &Node| {
        let here = search.point(*node);
        here.truncate().distance(to.truncate()) <= options.step && search.sees(here, to)
    };
    let found = astar(&start, neighbours, |node| cost(search.point(*node), to), is_last);
    if search.places.borrow().len() >= MAX_PLACES {
        let what = format!("the search evaluated more than {MAX_PLACES} positions");
        return Err(Error::usage(what, "give a longer step"));
    }
    Ok(match found {
        Some((nodes, _)) => {
            let mut points: Vec<DVec3> = nodes.iter().map(|node| search.point(*node)).collect();
            points.push(to);
            search.found_path(&search.pulled(&points))
        }
        None => search.blocked(best.into_inner().1, to),
    })
}

fn check(options: &PathOptions, from: DVec3, to: DVec3) -> Result<()> {
    let PathOptions { radius, step, clearance, height, slope_deg } = *options;
    let positive = |x: f64| x > 0.0 && x.is_finite();
    let metres = "give metres above 0, the height above the clearance";
    for (name, value, is_sound, remedy) in [
        ("radius", radius, positive(radius), metres),
        ("step", step, positive(step) && step >= 1e-3, metres),
        ("clearance", clearance, positive(clearance), metres),
        ("height", height, positive(height) && height > clearance, metres),
        ("slope", slope_deg, options.mobility().is_sound(), "give 0 to 60 degrees"),
    ] {
        if !is_sound {
            return Err(Error::usage(format!("a {name} of {value}"), remedy));
        }
    }
    match [from, to].iter().find(|p| !p.is_finite()) {
        Some(p) => Err(Error::usage(format!("a path from or to {p}"), "give finite metres")),
        None => Ok(()),
    }
}

/// The point of the floor below a point at which a robot can stand; otherwise an error that names the obstacle.
fn ground(floor: &Floor<'_>, p: DVec3) -> Result<DVec3> {
    let below = floor.height_below(p);
    let no_floor = || Error::usage(format!("no floor below {}, {}, {}", p.x, p.y, p.z), "give a point above a floor");
    let below = p.with_z(below.ok_or_else(no_floor)?);
    let radius = floor.radius();
    let what = match floor.stand(below, &mut QueryResult::default()) {
        Ok(height) => return Ok(p.with_z(height)),
        Err(Obstacle::Object(object)) => format!("{:?} is within {radius} m of {}, {}", floor.name(object), p.x, p.y),
        Err(Obstacle::Seen) => format!("something was seen within {radius} m of {}, {}", p.x, p.y),
        Err(Obstacle::NoFloor) => format!("the floor ends within {radius} m of {}, {}", p.x, p.y),
    };
    Err(Error::usage(what, "give a point on free floor, or a smaller radius"))
}

/// Positions around the start, which are evaluated when the search reaches them. A position may have several floors,
/// one above another.
struct GridSearch<'a> {
    floor: Floor<'a>,
    options: &'a PathOptions,
    from: DVec3,
    /// Heights of the floors, and whether a robot can stand there.
    places: RefCell<HashMap<At, Vec<(f64, bool)>>>,
    found: RefCell<QueryResult>,
}

impl GridSearch<'_> {
    fn point(&self, (at, floor): Node) -> DVec3 {
        let p = self.from.truncate() + self.options.step * DVec2::new(f64::from(at[0]), f64::from(at[1]));
        p.extend(self.places.borrow()[&at][floor as usize].0)
    }

    /// The floor of a position at about a height, if a robot can stand there.
    fn place(&self, at: At, near: f64) -> Option<Node> {
        let change = self.floor.change(KNIGHT * self.options.step);
        let mut places = self.places.borrow_mut();
        if places.len() >= MAX_PLACES {
            return None;
        }
        let known = places.entry(at).or_default();
        let floor = known.iter().position(|(height, _)| (height - near).abs() <= change).unwrap_or_else(|| {
            let p = self.from.truncate() + self.options.step * DVec2::new(f64::from(at[0]), f64::from(at[1]));
            let height = self.floor.stand(p.extend(near), &mut self.found.borrow_mut());
            known.push((*height.as_ref().unwrap_or(&near), height.is_ok()));
            known.len() - 1
        });
        known[floor].1.then_some((at, floor as u32))
    }

    /// The position after a step, if the positions that the step passes are free.
    fn after(&self, node: Node, [dx, dy]: At) -> Option<Node> {
        let ([x, y], near) = (node.0, self.point(node).z);
        let place = |a: At| self.place([x + a[0], y + a[1]], near);
        let between = match (dx.abs(), dy.abs()) {
            (2, 1) => [[dx / 2, 0], [dx / 2, dy]],
            (1, 2) => [[0, dy / 2], [dx, dy / 2]],
            _ => [[dx, dy]; 2],
        };
        between.into_iter().all(|a| place(a).is_some()).then(|| place([dx, dy])).flatten()
    }

    /// Points on the floor every half step along a straight line, up to and without the first at which a robot cannot
    /// stand.
    fn line(&self, from: DVec3, to: DVec3) -> (Vec<DVec3>, Option<Obstacle>) {
        let count = (from.truncate().distance(to.truncate()) / (0.5 * self.options.step)).ceil().max(1.0) as u32;
        let mut points = vec![from];
        let mut height = from.z;
        for k in 1..=count {
            let p = from.truncate().lerp(to.truncate(), f64::from(k) / f64::from(count));
            match self.floor.stand(p.extend(height), &mut self.found.borrow_mut()) {
                Ok(here) => height = here,
                Err(obstacle) => return (points, Some(obstacle)),
            }
            points.push(p.extend(height));
        }
        (points, None)
    }

    /// True if a robot can drive straight from one point of the floor to another.
    fn sees(&self, from: DVec3, to: DVec3) -> bool {
        let (points, obstacle) = self.line(from, to);
        let change = self.floor.change(self.options.step);
        obstacle.is_none() && points.last().is_some_and(|last| (last.z - to.z).abs() <= change)
    }

    /// The corners of a path after each corner that can be left out is left out.
    fn pulled(&self, points: &[DVec3]) -> Vec<DVec3> {
        let (mut kept, mut at) = (vec![points[0]], 0);
        while at + 1 < points.len() {
            // Neighbours on the grid see each other. The farthest visible point is bracketed by doubling, then halving.
            let (mut near, mut stride) = (at + 1, 2);
            while at + stride < points.len() && self.sees(points[at], points[at + stride]) {
                (near, stride) = (at + stride, 2 * stride);
            }
            let mut far = (at + stride).min(points.len());
            while near + 1 < far {
                let middle = usize::midpoint(near, far);
                if self.sees(points[at], points[middle]) { near = middle } else { far = middle }
            }
            at = near;
            kept.push(points[at]);
        }
        kept
    }

    fn found_path(&self, corners: &[DVec3]) -> FloorPath {
        let mut points = vec![corners[0]];
        for pair in corners.windows(2) {
            match self.line(pair[0], pair[1]) {
                (line, None) => add_profile(&line, &mut points),
                // Neighbours on the grid, between which a corner reaches in by less than a millimetre.
                (_, Some(_)) => points.push(pair[1]),
            }
        }
        let length = points.windows(2).map(|w| w[0].distance(w[1])).sum();
        FloorPath::Found { points, length }
    }

    /// The result if this is the reachable position nearest to the end.
    fn blocked(&self, reached: DVec3, to: DVec3) -> FloorPath {
        let missing = reached.truncate().distance(to.truncate());
        let object = match self.line(reached, to).1 {
            Some(Obstacle::Object(object)) => Some(self.floor.name(object).to_owned()),
            _ => None,
        };
        FloorPath::Blocked { reached, missing, object }
    }
}

/// Adds the points of a straight line after the first, without those that lie as high as a line between others says.
fn add_profile(line: &[DVec3], points: &mut Vec<DVec3>) {
    let (Some(first), Some(last)) = (line.first(), line.last()) else { return };
    let off = |k: usize| (line[k].z - first.lerp(*last, k as f64 / (line.len() - 1) as f64).z).abs();
    match (1..line.len().saturating_sub(1)).max_by(|a, b| off(*a).total_cmp(&off(*b))).filter(|k| off(*k) > FLAT) {
        Some(k) => {
            add_profile(&line[..=k], points);
            add_profile(&line[k..], points);
        }
        None => points.push(*last),
    }
}
