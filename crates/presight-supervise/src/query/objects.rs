//! Objects in a part of space.

use super::clip::clipped;
use crate::grid::Cells;
use glam::DVec3;
use presight_model::error::{Error, Result};
use presight_model::geometry::{Aabb, Pose, RobotPose};
use presight_model::index::{QueryResult, Region};
use presight_model::world::World;
use presight_predict::free_poses::distance;
use presight_predict::virtual_sensors::{Corridor, CorridorFrame};
use std::collections::{BTreeMap, BTreeSet};

/// A part of space.
#[derive(Clone, Debug)]
pub enum Place {
    /// An axis-aligned box, world, metres.
    Box(Aabb),
    /// A ball, world, metres.
    Sphere {
        /// Its middle.
        center: DVec3,
        /// Its radius.
        radius: f64,
    },
    /// A corridor, and the robot's pose if it is in the robot's frame.
    Along(Corridor, RobotPose),
}

/// An object with a surface in a part of space.
#[derive(Clone, Debug, PartialEq)]
pub struct ObjectFound {
    /// Full path.
    pub name: String,
    /// Its pose.
    pub world_from_object: Pose,
    /// Box around all of it, world, metres.
    pub bounds: Aabb,
    /// Polygons with a point in the part of space.
    pub polygons: usize,
    /// Minimum distance along the corridor, metres; `None` for other parts of space.
    pub along: Option<f64>,
    /// Features on it.
    pub features: usize,
    /// The newest confirmation of its features, UTC seconds; `None` without features.
    pub confirmed: Option<f64>,
    /// Minimum probability of existence of its features at the newest confirmation of their layer; `None` without
    /// features.
    pub existence: Option<f64>,
    /// Standard deviations of its pose in a layer: x, y, z in metres, and the rotations about them in radians.
    pub pose_sigmas: Option<[f64; 6]>,
}

/// Objects with a surface in a part of space, each with its features, by name; in a corridor by distance along it.
///
/// ```
/// use presight::environment::Environment;
/// use presight::query::{Place, objects_in};
/// use presight::{Pose, World};
/// use glam::DVec3;
/// let mut environment = Environment::new();
/// environment.add_cuboid("crate", Pose::IDENTITY, DVec3::ONE)?;
/// let world = World::new(environment);
/// let found = |x: f64| objects_in(&world, &Place::Sphere { center: DVec3::new(x, 0.0, 0.0), radius: 0.2 });
/// assert_eq!(found(0.6)?[0].name, "crate");
/// assert!(found(0.8)?.is_empty());
/// # Ok::<(), presight::Error>(())
/// ```
///
/// # Errors
/// [`presight_model::ErrorKind::Usage`] for a box turned inside out, a radius that is not above 0, and values that are
/// not finite.
pub fn objects_in(world: &World, place: &Place) -> Result<Vec<ObjectFound>> {
    let polygons = match place {
        Place::Box(bounds) => in_box(world, bounds)?,
        Place::Sphere { center, radius } => in_sphere(world, *center, *radius)?,
        Place::Along(corridor, pose) => along(world, corridor, pose)?,
    };
    let mut objects: Vec<ObjectFound> =
        polygons.into_iter().map(|(object, (polygons, along))| found(world, object, polygons, along)).collect();
    objects.sort_by(|a, b| {
        let along = |o: &ObjectFound| o.along.unwrap_or(0.0);
        along(a).total_cmp(&along(b)).then_with(|| a.name.cmp(&b.name))
    });
    Ok(objects)
}

/// Number of polygons, and minimum distance along the corridor, by object.
type Found = BTreeMap<u32, (usize, Option<f64>)>;

fn count(world: &World, region: &Region, holds: impl Fn(u32, u32) -> bool) -> Found {
    let mut found = Found::new();
    for (object, polygon) in world.polygons_in(region, None, &mut QueryResult::default()) {
        if holds(object, polygon) {
            found.entry(object).or_default().0 += 1;
        }
    }
    found
}

fn in_box(world: &World, bounds: &Aabb) -> Result<Found> {
    if !(bounds.min.is_finite() && bounds.max.is_finite() && bounds.min.cmple(bounds.max).all()) {
        let what = format!("a box from {} to {}", bounds.min, bounds.max);
        return Err(Error::usage(what, "give the least corner first, then the greatest"));
    }
    let objects = world.environment().objects();
    let holds =
        |object: u32, polygon: u32| !clipped(objects[object as usize].polygon_in_world(polygon), bounds).is_empty();
    Ok(count(world, &Region::cuboid(bounds), holds))
}

fn in_sphere(world: &World, center: DVec3, radius: f64) -> Result<Found> {
    if !(center.is_finite() && radius > 0.0 && radius.is_finite()) {
        return Err(Error::usage(
            format!("a sphere of {radius} m about {center}"),
            "give finite metres, the radius above 0",
        ));
    }
    let objects = world.environment().objects();
    let holds = |object: u32, polygon: u32| distance(&objects[object as usize], polygon, center) <= radius;
    Ok(count(world, &Region::ball(center, radius), holds))
}

/// Side of the cells by which a corridor is searched, metres.
const CELL: f64 = 0.1;

fn along(world: &World, corridor: &Corridor, robot: &RobotPose) -> Result<Found> {
    let world_from_robot = robot.world_from_robot();
    world_from_robot.check()?;
    let cells = Cells::new(corridor, CELL)?;
    let world_from_corridor = if corridor.frame() == CorridorFrame::World { Pose::IDENTITY } else { world_from_robot };
    let ([min, max], [low, high]) = (corridor.bounds(), corridor.heights());
    let bounds = Aabb { min: min.extend(low), max: max.extend(high) };
    let corridor_from_world = world_from_corridor.inverse();
    let environment = world.environment();
    let (mut result, mut found) = (QueryResult::default(), Found::new());
    let region = Region::cuboid(&bounds.transformed(&world_from_corridor.to_affine()));
    for (object, polygon) in world.polygons_in(&region, None, &mut result) {
        let corners = environment.objects()[object as usize].polygon_in_world(polygon);
        let corners: Vec<DVec3> = corners.iter().map(|p| corridor_from_world.transform_point(*p)).collect();
        let inside = clipped(corners, &bounds);
        if inside.is_empty() {
            continue;
        }
        if let Some(along) = first_cell(&cells, &inside) {
            let entry = found.entry(object).or_default();
            entry.0 += 1;
            entry.1 = Some(entry.1.map_or(along, |before| before.min(along)));
        }
    }
    Ok(found)
}

/// Minimum distance along the corridor of the columns of cells that a polygon inside the box around the corridor
/// intersects.
fn first_cell(cells: &Cells, corners: &[DVec3]) -> Option<f64> {
    let around = Aabb::of(corners.iter().copied());
    let mut done = BTreeSet::new();
    let mut nearest = None;
    for (column, at) in cells.columns.iter().enumerate() {
        let min = DVec3::from(cells.origin) + DVec3::new(f64::from(at[0]), f64::from(at[1]), 0.0) * cells.side;
        let max = DVec3::new(min.x + cells.side, min.y + cells.side, f64::INFINITY);
        let min = min.with_z(f64::NEG_INFINITY);
        let near = min.cmple(around.max).all() && max.cmpge(around.min).all();
        if near && done.insert(column) && !clipped(corners.to_vec(), &Aabb { min, max }).is_empty() {
            let along = cells.along[column];
            nearest = Some(nearest.map_or(along, |before: f64| before.min(along)));
        }
    }
    nearest
}

fn found(world: &World, object: u32, polygons: usize, along: Option<f64>) -> ObjectFound {
    let environment = world.environment();
    let o = &environment.objects()[object as usize];
    let (mut features, mut confirmed, mut existence, mut pose_sigmas) = (0, None::<f64>, None::<f64>, None);
    for layer in environment.layers() {
        let time = layer.newest_confirmation();
        for feature in layer.features.iter().filter(|f| f.object.as_deref() == Some(o.name.as_str())) {
            features += 1;
            let e = feature.existence;
            confirmed = Some(confirmed.map_or(e.confirmed, |before| before.max(e.confirmed)));
            existence = Some(existence.map_or(e.at(time), |before| before.min(e.at(time))));
        }
        let stated = layer.pose_covariances.iter().find(|(name, _)| *name == o.name);
        pose_sigmas = pose_sigmas.or(stated.map(|(_, covariance)| covariance.sigmas()));
    }
    ObjectFound {
        name: o.name.clone(),
        world_from_object: o.world_from_object,
        bounds: o.world_bounds(),
        polygons,
        along,
        features,
        confirmed,
        existence,
        pose_sigmas,
    }
}
