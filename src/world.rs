//! The world: a version of the environment with its index, which predictions read; changes make the next version.

use crate::environment::{Environment, Material, NewObject};
use crate::error::Result;
use crate::geometry::Pose;
use crate::index::{Params, Scheme, WorldIndex};
use std::sync::Arc;

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

/// What [`World::apply`] does.
#[derive(Clone, Debug)]
pub enum Change {
    /// Adds a material, for meshes to come.
    AddMaterial(Material),
    /// Adds an object.
    InsertObject(NewObject),
    /// Gives an object another pose.
    MoveObject {
        /// Its full path.
        name: String,
        /// The new pose.
        world_from_object: Pose,
    },
    /// Takes an object out. Its number and its slots are never used again.
    DeleteObject {
        /// Its full path.
        name: String,
    },
}

impl World {
    /// The first version of a world, with the default index.
    pub fn new(environment: Environment) -> Self {
        Self::with_index(environment, Scheme::default(), Params::tuned(Scheme::default()))
    }

    /// The first version of a world, with an index of that scheme.
    pub fn with_index(environment: Environment, scheme: Scheme, params: Params) -> Self {
        let index = Arc::new(WorldIndex::new(&environment, scheme, params));
        Self { environment: Arc::new(environment), index, version: 1 }
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

    /// Finds polygons of this version.
    pub fn index(&self) -> &WorldIndex {
        &self.index
    }

    /// Number of the version; results carry it.
    pub fn version(&self) -> u64 {
        self.version
    }

    /// Makes the next version. Environment and index change in step, in place unless a clone still holds this version.
    ///
    /// # Errors
    /// Those of [`Environment::insert`], [`Environment::set_pose`], [`Environment::delete`] and
    /// [`Environment::add_material`]; the version then stays as it is.
    pub fn apply(&mut self, change: Change) -> Result<()> {
        // Refused before anything is copied.
        if let Change::MoveObject { name, .. } | Change::DeleteObject { name } = &change {
            self.environment.index_of(name)?;
        }
        let environment = Arc::make_mut(&mut self.environment);
        match change {
            Change::AddMaterial(material) => {
                environment.add_material(material)?;
            }
            Change::InsertObject(new) => {
                let object = environment.insert(new)?;
                Arc::make_mut(&mut self.index).insert_object(environment, object);
            }
            Change::MoveObject { name, world_from_object } => {
                let object = environment.set_pose(&name, world_from_object)?;
                Arc::make_mut(&mut self.index).insert_object(environment, object);
            }
            Change::DeleteObject { name } => {
                let object = environment.index_of(&name)?;
                Arc::make_mut(&mut self.index).remove_object(environment, object);
                environment.delete(&name)?;
            }
        }
        self.version += 1;
        Ok(())
    }
}
