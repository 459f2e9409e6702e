//! Differences between the scene and its model: displaced objects, and people who walk through.

use glam::{DQuat, DVec3, Vec3};
use presight_model::change::Change;
use presight_model::environment::{Material, Mesh, NewObject};
use presight_model::error::{Error, Result};
use presight_model::geometry::{Pose, RobotPose};
use presight_model::random::SplitMix64;
use presight_model::world::World;
use std::f64::consts::TAU;
use std::sync::Arc;

/// Maximum number of people in a scene: it bounds the changes that each frame applies.
const MAX_WALKERS: usize = 1000;
/// Half of a person's width, depth and height, metres.
const PERSON: [f32; 3] = [0.25, 0.15, 0.85];
/// Walking speed of people, metres per second.
const SPEED: f64 = 1.0;
/// Distance that people walk before they turn around, metres.
const DISTANCE: f64 = 4.0;
/// Lateral distance between a person's path and a pose of the robot, metres.
const ASIDE: (f64, f64) = (1.0, 2.5);

/// Displaces every object by `metres` in a random direction, so that the model is inexact. Repeatable by the seed.
///
/// # Examples
/// ```
/// use presight::simulate::displace;
/// use presight::environment::Environment;
/// use presight::{Pose, World};
/// let mut environment = Environment::new();
/// environment.add_cuboid("crate", Pose::IDENTITY, glam::DVec3::ONE)?;
/// let mut world = World::new(environment);
/// displace(&mut world, 0.01, 7)?;
/// let moved = world.environment().objects()[0].world_from_object.translation;
/// assert!((moved.length() - 0.01).abs() < 1e-12);
/// # Ok::<(), presight::Error>(())
/// ```
///
/// # Errors
/// [`presight_model::ErrorKind::Usage`] for a distance that is negative or not finite; errors of [`World::apply`].
pub fn displace(world: &mut World, metres: f64, seed: u64) -> Result<()> {
    if !(metres >= 0.0 && metres.is_finite()) {
        return Err(Error::usage(format!("objects moved by {metres} m"), "give a finite distance of at least 0"));
    }
    let mut random = SplitMix64(seed);
    let moves = world.environment().objects().iter().map(|object| {
        // Uniform on the sphere: height and azimuth are uniform.
        let (z, azimuth) = (random.uniform(-1.0, 1.0), random.uniform(0.0, TAU));
        let flat = (1.0 - z * z).sqrt();
        let direction = DVec3::new(flat * azimuth.cos(), flat * azimuth.sin(), z);
        let pose = object.world_from_object;
        let world_from_object = Pose { translation: pose.translation + metres * direction, ..pose };
        (!object.is_deleted()).then(|| Change::SetPose { name: object.name.clone(), world_from_object })
    });
    let moves = moves.flatten().collect();
    world.apply(Change::Group(moves)).map(drop)
}

/// People who walk back and forth near the robot's path, on the floor below it.
pub struct Walkers {
    walkers: Vec<Walker>,
}

struct Walker {
    name: String,
    from: DVec3,
    direction: DVec3,
    /// Offset of this person's clock, seconds.
    ahead: f64,
}

impl Walkers {
    /// Adds people to a world. `path` holds poses of the robot, whose height above the floor is `height` metres.
    ///
    /// # Errors
    /// [`presight_model::ErrorKind::Usage`] for too many people, no pose or a non-finite height; errors of
    /// [`World::apply`].
    pub fn new(world: &mut World, path: &[RobotPose], height: f64, count: usize, seed: u64) -> Result<Self> {
        if count > MAX_WALKERS || !height.is_finite() || (path.is_empty() && count > 0) {
            let what = format!("{count} walkers near {} poses {height} m above the floor", path.len());
            return Err(Error::usage(what, format!("give at most {MAX_WALKERS}, a pose, and a finite height")));
        }
        let mut random = SplitMix64(seed ^ 0x77a1_6e75);
        let mut walkers = Vec::new();
        for k in 0..count {
            let near = path[random.below(path.len())].world_from_robot().translation;
            let (heading, side) = (random.uniform(0.0, TAU), random.uniform(ASIDE.0, ASIDE.1));
            let direction = DVec3::new(heading.cos(), heading.sin(), 0.0);
            let middle = near + side * DVec3::new(-direction.y, direction.x, 0.0);
            let feet = middle - 0.5 * DISTANCE * direction - height * DVec3::Z;
            let (name, ahead) = (format!("walker {k}"), random.uniform(0.0, 2.0 * DISTANCE / SPEED));
            walkers.push(Walker { name, from: feet, direction, ahead });
        }
        let walkers = Self { walkers };
        if count > 0 {
            let mesh = person(world)?;
            let insert = |w: &Walker| Change::InsertObject(NewObject::new(w.name.clone(), w.pose(0.0), mesh.clone()));
            world.apply(Change::Group(walkers.walkers.iter().map(insert).collect()))?;
        }
        Ok(walkers)
    }

    /// Moves all people to their positions at a time, seconds.
    ///
    /// # Errors
    /// Errors of [`World::apply`].
    pub fn walk(&self, world: &mut World, time: f64) -> Result<()> {
        if self.walkers.is_empty() {
            return Ok(());
        }
        let step = |w: &Walker| Change::SetPose { name: w.name.clone(), world_from_object: w.pose(time) };
        world.apply(Change::Group(self.walkers.iter().map(step).collect())).map(drop)
    }
}

impl Walker {
    /// Walks back and forth; a full cycle is twice the path.
    fn pose(&self, time: f64) -> Pose {
        let gone = (SPEED * (time + self.ahead)).rem_euclid(2.0 * DISTANCE);
        let along = if gone <= DISTANCE { gone } else { 2.0 * DISTANCE - gone };
        let heading = self.direction.y.atan2(self.direction.x);
        Pose { translation: self.from + along * self.direction, rotation: DQuat::from_rotation_z(heading) }
    }
}

/// A box of a person's size, with the origin between the feet.
fn person(world: &mut World) -> Result<Arc<Mesh>> {
    let cloth = world.environment().materials().len() as u16;
    world.apply(Change::AddMaterial(Material::named("walker's cloth")))?;
    let [x, y, z] = PERSON;
    let mesh = Mesh::cuboid("walker", Vec3::new(-x, -y, 0.0), Vec3::new(x, y, 2.0 * z), cloth)?;
    Ok(Arc::new(mesh))
}

#[cfg(test)]
mod tests {
    use super::*;
    use presight_model::environment::Environment;

    /// A walker stays within its 4 m path and 2.5 m to the side of the pose, walks at 1 m/s, and stands on the floor.
    #[test]
    fn walkers_walk_near_the_robot() {
        let path = [RobotPose::from_xyz_rpy(DVec3::new(10.0, -3.0, 1.2), 0.0, 0.0, 0.5)];
        let mut world = World::new(Environment::new());
        let walkers = Walkers::new(&mut world, &path, 1.2, 20, 3).unwrap();
        assert_eq!(world.environment().objects().len(), 20);
        let at = |world: &World| -> Vec<DVec3> {
            world.environment().objects().iter().map(|o| o.world_from_object.translation).collect()
        };
        let mut before = at(&world);
        let mut way = 0.0;
        for k in 1..=40 {
            walkers.walk(&mut world, 0.1 * f64::from(k)).unwrap();
            let now = at(&world);
            for (a, b) in before.iter().zip(&now) {
                let step = a.distance(*b);
                assert!(step < 0.1 + 1e-9 && b.z.abs() < 1e-9, "{step} {b}");
                way += step;
                let off = (*b - path[0].world_from_robot().translation).truncate().length();
                assert!((1.0 - 1e-9..3.3).contains(&off), "{off}");
            }
            before = now;
        }
        // A walker that turns around within a step covers less distance in it.
        assert!(way > 0.9 * 20.0 * 4.0 && way <= 20.0 * 4.0 + 1e-6, "{way}");
        assert!(world.environment().bounds().max.z < 1.71);
    }

    #[test]
    fn what_cannot_be_is_refused() {
        let mut world = World::new(Environment::new());
        assert!(displace(&mut world, -0.1, 1).is_err() && displace(&mut world, f64::NAN, 1).is_err());
        assert!(Walkers::new(&mut world, &[], 1.0, 1, 1).is_err());
        assert!(Walkers::new(&mut world, &[RobotPose::IDENTITY], f64::NAN, 1, 1).is_err());
        assert!(Walkers::new(&mut world, &[RobotPose::IDENTITY], 1.0, 1001, 1).is_err());
        assert!(Walkers::new(&mut world, &[], 1.0, 0, 1).unwrap().walk(&mut world, 1.0).is_ok());
    }
}
