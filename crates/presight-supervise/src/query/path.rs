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
        /// Path of the first object on the straight line from there to the end.
        object: Option<String>,
    },
}

/// Maximum number of positions that are evaluated.
const MAX_PLACES: usize = 4_000_000;
/// Unit of the integer costs, metres.
const UNIT: f64 = 1e-6;

type At = [i32; 2];

/// Steps to the 8 neighbours, and steps of a knight in chess. With them a path is at most 2.8 % longer than a straight
/// line.
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

/// Finds a shortest path of a round robot from one point to another on the floor below them, around the objects of the
/// model and around `seen` boxes (world, metres). The floor may be uneven by 5 cm. Ramps and stairs are not floor.
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
/// [`presight_model::ErrorKind::Usage`] for options and points out of range, without a floor below the start, for an
/// end on another floor, and for a start or an end at which the robot cannot stand, naming the obstacle.
pub fn find_path(world: &World, from: DVec3, to: DVec3, seen: &[Aabb], options: &PathOptions) -> Result<FloorPath> {
    check(options, from, to)?;
    let no_floor = |place: &str, p: DVec3| {
        Error::usage(format!("no floor below {}, {}, {}", p.x, p.y, p.z), "give a point above a floor").at(place)
    };
    let height = Floor::height_below(world, from).ok_or_else(|| no_floor("the start", from))?;
    Floor::height_below(world, to).ok_or_else(|| no_floor("the end", to))?;
    let floor = Floor { world, options, height, seen };
    let ends = [("the start", from), ("the end", to)];
    ends.into_iter().try_for_each(|(place, p)| can_stand(&floor, p).map_err(|e| e.at(place)))?;
    let search = GridSearch { floor, from: from.truncate(), places: RefCell::default(), result: RefCell::default() };
    let goal = search.nearest_to(to.truncate());
    let target = to.truncate();
    let cost = |a: DVec2, b: DVec2| (a.distance(b) / UNIT) as u64;
    let best = RefCell::new((f64::INFINITY, [0, 0]));
    let neighbours = |at: &At| {
        let here = search.point(*at);
        let mut best = best.borrow_mut();
        if here.distance(target) < best.0 {
            *best = (here.distance(target), *at);
        }
        let next = STEPS.iter().filter(|step| search.is_free_step(*at, **step));
        next.map(|step| [at[0] + step[0], at[1] + step[1]])
            .map(|to| (to, cost(here, search.point(to))))
            .collect::<Vec<_>>()
    };
    let found = astar(&[0, 0], neighbours, |at| cost(search.point(*at), search.point(goal)), |at| *at == goal);
    if search.places.borrow().len() >= MAX_PLACES {
        let what = format!("the search evaluated more than {MAX_PLACES} positions");
        return Err(Error::usage(what, "give a longer step"));
    }
    Ok(match found {
        Some((places, _)) => found_path(&search, &places, to, height),
        None => search.blocked(best.into_inner().1, to, height),
    })
}

fn check(options: &PathOptions, from: DVec3, to: DVec3) -> Result<()> {
    let PathOptions { radius, step, clearance, height } = *options;
    let positive = |x: f64| x > 0.0 && x.is_finite();
    for (name, value, is_sound) in [
        ("radius", radius, positive(radius)),
        ("step", step, positive(step) && step >= 1e-3),
        ("clearance", clearance, positive(clearance)),
        ("height", height, positive(height) && height > clearance),
    ] {
        if !is_sound {
            return Err(Error::usage(
                format!("a {name} of {value}"),
                "give metres above 0, the height above the clearance",
            ));
        }
    }
    match [from, to].iter().find(|p| !p.is_finite()) {
        Some(p) => Err(Error::usage(format!("a path from or to {p}"), "give finite metres")),
        None => Ok(()),
    }
}

/// An error that names the obstacle at a point.
fn can_stand(floor: &Floor<'_>, p: DVec3) -> Result<()> {
    let what = match floor.obstacle(p.truncate(), &mut QueryResult::default()) {
        None => return Ok(()),
        Some(Obstacle::Object(object)) => {
            let name = &floor.world.environment().objects()[object as usize].name;
            format!("{name:?} is within {} m of {}, {}", floor.options.radius, p.x, p.y)
        }
        Some(Obstacle::Seen) => format!("something was seen within {} m of {}, {}", floor.options.radius, p.x, p.y),
        Some(Obstacle::NoFloor) => format!("no floor at the height of the start below {}, {}", p.x, p.y),
    };
    Err(Error::usage(what, "give a point on free floor, or a smaller radius"))
}

/// Positions around the start, which are evaluated when the search reaches them.
struct GridSearch<'a> {
    floor: Floor<'a>,
    from: DVec2,
    places: RefCell<HashMap<At, bool>>,
    result: RefCell<QueryResult>,
}

impl GridSearch<'_> {
    fn point(&self, at: At) -> DVec2 {
        self.from + self.floor.options.step * DVec2::new(f64::from(at[0]), f64::from(at[1]))
    }

    fn nearest_to(&self, p: DVec2) -> At {
        let at = ((p - self.from) / self.floor.options.step).round();
        [at.x as i32, at.y as i32]
    }

    fn is_free(&self, at: At) -> bool {
        let mut places = self.places.borrow_mut();
        if let Some(known) = places.get(&at) {
            return *known;
        }
        let is_free =
            places.len() < MAX_PLACES && self.floor.obstacle(self.point(at), &mut self.result.borrow_mut()).is_none();
        places.insert(at, is_free);
        is_free
    }

    /// True if the positions that a step passes are free.
    fn is_free_step(&self, [x, y]: At, [dx, dy]: At) -> bool {
        let passes = |a: At| self.is_free([x + a[0], y + a[1]]);
        let between = match (dx.abs(), dy.abs()) {
            (2, 1) => [[dx / 2, 0], [dx / 2, dy]],
            (1, 2) => [[0, dy / 2], [dx, dy / 2]],
            _ => [[dx, dy]; 2],
        };
        passes([dx, dy]) && between.into_iter().all(passes)
    }

    /// The result if this is the reachable position nearest to the end.
    fn blocked(&self, nearest: At, to: DVec3, height: f64) -> FloorPath {
        let reached = self.point(nearest);
        let target = to.truncate();
        let missing = reached.distance(target);
        let steps = (missing / self.floor.options.step).ceil().max(1.0);
        let mut result = QueryResult::default();
        let on_line = (1..=steps as u32).map(|k| reached.lerp(target, f64::from(k) / steps));
        let object = on_line.map(|p| self.floor.obstacle(p, &mut result)).find(Option::is_some).flatten();
        let object = match object {
            Some(Obstacle::Object(object)) => {
                Some(self.floor.world.environment().objects()[object as usize].name.clone())
            }
            _ => None,
        };
        FloorPath::Blocked { reached: reached.extend(height), missing, object }
    }
}

fn found_path(search: &GridSearch<'_>, places: &[At], to: DVec3, height: f64) -> FloorPath {
    let mut points: Vec<DVec3> = places.iter().map(|at| search.point(*at).extend(height)).collect();
    // The end may be off the grid.
    if let Some(last) = points.last_mut() {
        *last = to.truncate().extend(height);
    }
    // Inner points of straight lines are left out.
    let mut kept: Vec<DVec3> = Vec::new();
    for p in points {
        let is_straight = |a: DVec3, b: DVec3| (b - a).normalize_or_zero().distance((p - b).normalize_or_zero()) < 1e-6;
        if let [.., a, b] = kept[..]
            && is_straight(a, b)
        {
            kept.pop();
        }
        kept.push(p);
    }
    let length = kept.windows(2).map(|w| w[0].distance(w[1])).sum();
    FloorPath::Found { points: kept, length }
}
