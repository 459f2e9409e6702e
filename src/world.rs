//! The world: a version of the environment with its index, which predictions read; changes make the next version.

use crate::change::Change;
use crate::environment::Environment;
use crate::error::Result;
use crate::index::{Params, Scheme, WorldIndex};
use std::sync::Arc;

mod objects;
#[cfg(test)]
mod tests;

/// Features that a change touches one by one in the lists of their layers; for more these are opened first.
const FEW_FEATURES: usize = 32;

/// One version of the environment and its spatial index, cheap to clone; predictions in flight keep the version they
/// began with.
///
/// ```
/// use presight::{Change, Environment, Pose, World};
/// let mut world = World::new(Environment::new());
/// let before = world.clone();
/// assert!(world.apply(Change::MoveObject { name: "door".into(), world_from_object: Pose::IDENTITY }).is_err());
/// assert_eq!(world.version(), before.version());
/// ```
#[derive(Clone, Debug)]
pub struct World {
    environment: Arc<Environment>,
    index: Arc<WorldIndex>,
    version: u64,
}

impl World {
    /// The first version of a world, with the default index.
    pub fn new(environment: Environment) -> Self {
        Self::with_index(environment, Scheme::default(), Params::tuned(Scheme::default()))
    }

    /// The first version of a world, with an index of that scheme.
    pub fn with_index(environment: Environment, scheme: Scheme, params: Params) -> Self {
        Self::of(WorldIndex::new(&environment, scheme, params), environment)
    }

    /// The first version of a world whose index is there.
    pub(crate) fn of(index: WorldIndex, environment: Environment) -> Self {
        Self { environment: Arc::new(environment), index: Arc::new(index), version: 1 }
    }

    /// The same version of the environment with another index.
    #[must_use]
    pub fn reindexed(&self, scheme: Scheme, params: Params) -> Self {
        let index = Arc::new(WorldIndex::new(&self.environment, scheme, params));
        Self { index, ..self.clone() }
    }

    /// What this version holds.
    pub fn environment(&self) -> &Arc<Environment> {
        &self.environment
    }

    /// What this version holds, without the rest.
    pub fn into_environment(self) -> Arc<Environment> {
        self.environment
    }

    /// Finds polygons of this version.
    pub fn index(&self) -> &WorldIndex {
        &self.index
    }

    /// Number of the version; results carry it.
    pub fn version(&self) -> u64 {
        self.version
    }

    /// Makes the next version; the answer is the change that undoes this one. Environment and index change in step, in
    /// place unless a clone still holds this version.
    ///
    /// What is undone is the content ([`Environment::content_hash`]) to the last bit. Numbers are not: an object that
    /// comes back has new slots.
    ///
    /// ```
    /// use presight::{Change, Environment, Material, Mesh, NewObject, Polygon, PolygonOrder, Pose, World};
    /// let mut environment = Environment::new();
    /// let paint = environment.add_material(Material::named("paint"))?;
    /// let corners = [glam::Vec3::ZERO, glam::Vec3::X, glam::Vec3::Y].to_vec();
    /// let mesh = Mesh::new("sign", corners, vec![Polygon::new(vec![0, 1, 2], paint)], PolygonOrder::Given)?;
    /// let mut world = World::new(environment);
    /// let before = world.environment().content_hash();
    /// let undo = world.apply(Change::InsertObject(NewObject::new("sign", Pose::IDENTITY, mesh.into())))?;
    /// assert_ne!(world.environment().content_hash(), before);
    /// world.apply(undo)?;
    /// assert_eq!(world.environment().content_hash(), before);
    /// # Ok::<(), presight::Error>(())
    /// ```
    ///
    /// # Errors
    /// [`crate::ErrorKind::Invalid`] if there is no such object, group or feature, an id was used before, a feature names an
    /// object that does not exist, or a value is impossible (those of [`Environment::insert`],
    /// [`Environment::set_pose`], [`Environment::set_group`] and [`Environment::add_material`]). Content and version then
    /// stay as they are, of all changes of a [`Change::Group`]. That features lie on polygons is not asked here, but by
    /// [`crate::placement`].
    pub fn apply(&mut self, change: Change) -> Result<Change> {
        let inverse = match change {
            Change::Group(_) => {
                let before = self.clone();
                self.step_all(change).inspect_err(|_| *self = before)?
            }
            single => self.step_all(single)?,
        };
        self.version += 1;
        Ok(inverse)
    }

    /// A change; one that touches many features has them open meanwhile.
    fn step_all(&mut self, change: Change) -> Result<Change> {
        let mut few = FEW_FEATURES;
        if self.touches_few(&change, &mut few) {
            return self.step(change);
        }
        Arc::make_mut(&mut self.environment).open_layers();
        let done = self.step(change);
        Arc::make_mut(&mut self.environment).close_layers();
        done
    }

    /// False once a change puts in, alters or takes out more features, one by one, than are `left`.
    fn touches_few(&self, change: &Change, left: &mut usize) -> bool {
        let count = match change {
            Change::Group(changes) => return changes.iter().all(|change| self.touches_few(change, left)),
            Change::InsertFeature { .. }
            | Change::RestoreFeature { .. }
            | Change::SetFeature { .. }
            | Change::DeleteFeature { .. }
            | Change::SetPoseCovariance { .. } => 1,
            // Each object that is deleted asks for its features, even if it has none.
            Change::DeleteObject { name } => {
                let is_object = self.environment.object(name).is_some();
                let objects = if is_object { 1 } else { self.environment.below(name).take(*left + 1).count() };
                objects + self.environment.attached_to_path(name, !is_object, *left + 1)
            }
            _ => 0,
        };
        match left.checked_sub(count) {
            Some(rest) => *left = rest,
            None => return false,
        }
        true
    }

    /// A change; only a group can fail halfway.
    fn step(&mut self, change: Change) -> Result<Change> {
        if let Change::Group(changes) = change {
            let mut inverses = Vec::with_capacity(changes.len());
            for (i, change) in changes.into_iter().enumerate() {
                inverses.push(self.step(change).map_err(|e| e.at(format!("change {} of the group", i + 1)))?);
            }
            inverses.reverse();
            return Ok(Change::Group(inverses));
        }
        match change {
            Change::InsertObject(new) => self.insert_object(new),
            Change::MoveObject { name, world_from_object } => self.move_path(&name, world_from_object),
            Change::SetPose { name, world_from_object } => self.set_pose(name, world_from_object),
            Change::DeleteObject { name } => self.delete_path(name),
            Change::SetGroup { name, world_from_group } => self.set_group(name, world_from_group),
            other => self.step_features(other),
        }
    }

    fn step_features(&mut self, change: Change) -> Result<Change> {
        let environment = Arc::make_mut(&mut self.environment);
        Ok(match change {
            Change::AddMaterial(material) => {
                environment.add_material(material)?;
                Change::NOTHING
            }
            Change::InsertFeature { class, feature } => {
                let id = feature.id;
                environment.insert_feature(&class, feature, false)?;
                Change::DeleteFeature { class, id }
            }
            Change::RestoreFeature { class, feature } => {
                let id = feature.id;
                environment.insert_feature(&class, feature, true)?;
                Change::DeleteFeature { class, id }
            }
            Change::SetFeature { class, feature } => {
                let feature = environment.replace_feature(&class, feature)?;
                Change::SetFeature { class, feature }
            }
            Change::DeleteFeature { class, id } => {
                let feature = environment.delete_feature(&class, id)?;
                Change::RestoreFeature { class, feature }
            }
            Change::SetTolerance { class, tolerance } => match environment.set_tolerance(&class, tolerance)? {
                Some(tolerance) => Change::SetTolerance { class, tolerance },
                None => Change::NOTHING,
            },
            Change::SetPoseCovariance { class, object, covariance } => {
                let covariance = environment.set_pose_covariance(&class, &object, covariance)?;
                Change::SetPoseCovariance { class, object, covariance }
            }
            // Of objects and paths, and many at once: they went another way.
            _ => Change::NOTHING,
        })
    }

    /// This world with another environment: after a failed write, what the disk has.
    #[cfg(feature = "store")]
    pub(crate) fn reset(&mut self, environment: Environment) {
        self.index = Arc::new(WorldIndex::new(&environment, self.index.scheme(), self.index.params()));
        self.environment = Arc::new(environment);
    }
}
