//! The world: a version of the environment with its index, for predictions to read. Each change makes the next version.

use crate::change::Change;
use crate::environment::{Environment, Mesh, Revert};
use crate::error::Result;
use crate::index::{IndexKind, QueryResult, Region, WorldIndex};
use crate::threads::parallel_or_here;
use rayon::prelude::*;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

mod objects;
#[cfg(test)]
mod tests;

/// Number of features that a change may touch in the lists of their layers. For more, the layers are opened first.
const FEW_FEATURES: usize = 32;

/// One version of the environment with its spatial index. It is cheap to clone, and a running prediction keeps the
/// version with which it started.
///
/// ```
/// use presight::environment::Environment;
/// use presight::{Change, Pose, World};
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
    /// Differs from the stamp of any other content of any world in this process.
    stamp: u64,
    /// During a series of changes: the number of features that may still be touched in the lists of their layers.
    row: Option<usize>,
    /// While a group of changes is applied: the steps that take it back, oldest first.
    journal: Option<Vec<Revert>>,
}

impl World {
    /// The first version of a world, with the default index.
    pub fn new(environment: Environment) -> Self {
        Self::with_index(environment, &IndexKind::default())
    }

    /// The first version of a world, with an index of this kind.
    pub fn with_index(environment: Environment, kind: &IndexKind) -> Self {
        Self::of(WorldIndex::new(&environment, kind), environment)
    }

    /// The first version of a world, with an existing index.
    #[doc(hidden)]
    pub fn of(index: WorldIndex, environment: Environment) -> Self {
        Self {
            environment: Arc::new(environment),
            index: Arc::new(index),
            version: 1,
            stamp: new_stamp(),
            row: None,
            journal: None,
        }
    }

    /// This version of the environment with another index.
    #[must_use]
    pub fn reindexed(&self, kind: &IndexKind) -> Self {
        let index = Arc::new(WorldIndex::new(&self.environment, kind));
        Self { index, ..self.clone() }
    }

    /// The environment of this version.
    pub fn environment(&self) -> &Arc<Environment> {
        &self.environment
    }

    /// Takes the environment out of the world.
    pub fn into_environment(self) -> Arc<Environment> {
        self.environment
    }

    /// Finds polygons of this version.
    #[doc(hidden)]
    pub fn index(&self) -> &WorldIndex {
        &self.index
    }

    /// Object and polygon of each present polygon whose box meets a region. A polygon that is marked as absent for the
    /// sensor class, or without a class for all sensors, is left out. `found` is memory that queries share.
    #[doc(hidden)]
    pub fn polygons_in<'a>(
        &'a self,
        region: &Region,
        class: Option<&'a str>,
        found: &'a mut QueryResult,
    ) -> impl Iterator<Item = (u32, u32)> + use<'a> {
        found.clear();
        self.index.query(&self.environment, region, found);
        let located = found.all().filter_map(|slot| self.environment.locate(slot));
        located.filter(move |(object, polygon)| !self.environment.is_absent(*object, *polygon, class))
    }

    /// Makes the trees for rays of the meshes of some objects, where there are none; by all threads of a pool if called
    /// on one of them.
    ///
    /// # Errors
    /// [`crate::ErrorKind::System`] if there is no memory for them.
    pub fn make_ray_trees(&self, objects: impl IntoIterator<Item = u32>) -> Result<()> {
        let mut meshes: Vec<&Arc<Mesh>> =
            objects.into_iter().map(|object| &self.environment.objects()[object as usize].mesh).collect();
        meshes.sort_unstable_by_key(|mesh| Arc::as_ptr(mesh));
        meshes.dedup_by_key(|mesh| Arc::as_ptr(mesh));
        parallel_or_here(|| meshes.par_iter().with_max_len(1).try_for_each(|mesh| mesh.ray_tree().map(drop)))
    }

    /// Number of the version. Predictions report it.
    pub fn version(&self) -> u64 {
        self.version
    }

    /// A number that differs from that of every other version in this process, including versions of other worlds.
    pub fn stamp(&self) -> u64 {
        self.stamp
    }

    /// Applies a change like [`World::apply`], but does not check that its features lie on polygons. Use it for
    /// inverses: a feature that they restore may have lost its surface.
    ///
    /// The inverse of a change restores the content ([`Environment::content_hash`]) to the last bit. It does not
    /// restore numbers: a restored object has new slots.
    ///
    /// ```
    /// use presight::environment::{Environment, Material, Mesh, NewObject, Polygon, PolygonOrder};
    /// use presight::{Change, Pose, World};
    /// let mut environment = Environment::new();
    /// let paint = environment.add_material(Material::named("paint"))?;
    /// let corners = [glam::Vec3::ZERO, glam::Vec3::X, glam::Vec3::Y].to_vec();
    /// let mesh = Mesh::new("sign", corners, vec![Polygon::new(vec![0, 1, 2], paint)], PolygonOrder::Given)?;
    /// let mut world = World::new(environment);
    /// let before = world.environment().content_hash();
    /// let undo = world.apply(Change::InsertObject(NewObject::new("sign", Pose::IDENTITY, mesh.into())))?;
    /// assert_ne!(world.environment().content_hash(), before);
    /// world.apply_unchecked(undo)?;
    /// assert_eq!(world.environment().content_hash(), before);
    /// # Ok::<(), presight::Error>(())
    /// ```
    ///
    /// # Errors
    /// [`crate::ErrorKind::Invalid`] if there is no such object, group or feature, an id was used before, a feature
    /// names an object that does not exist, or a value is invalid (see [`Environment::insert`],
    /// [`Environment::set_pose`], [`Environment::set_frame`] and [`Environment::add_material`]). Content and version
    /// then do not change, even for a [`Change::Group`].
    pub fn apply_unchecked(&mut self, change: Change) -> Result<Change> {
        match change {
            Change::Group(_) => self.apply_if(change, |_| Ok(())),
            single => {
                let inverse = self.with_open_layers(single, Self::step)?;
                self.advance();
                Ok(inverse)
            }
        }
    }

    /// Applies a change and makes the next version if `check` then succeeds; otherwise content, numbers and version do
    /// not change: the change is reverted step by step, without a copy of the world.
    pub fn apply_if(&mut self, change: Change, check: impl FnOnce(&Self) -> Result<()>) -> Result<Change> {
        self.with_open_layers(change, |world, change| {
            world.journal = Some(Vec::new());
            let done = world.step(change).and_then(|inverse| check(world).map(|()| inverse));
            let journal = world.journal.take().unwrap_or_default();
            match &done {
                Ok(_) => world.advance(),
                Err(_) => journal.into_iter().rev().for_each(|step| world.revert(step)),
            }
            done
        })
    }

    fn advance(&mut self) {
        self.version += 1;
        self.stamp = new_stamp();
    }

    /// Records how to revert the next step, if a journal is kept.
    fn note(&mut self, revert: impl FnOnce(&Environment) -> Revert) {
        if let Some(journal) = &mut self.journal {
            journal.push(revert(&self.environment));
        }
    }

    fn revert(&mut self, step: Revert) {
        let moved = match &step {
            Revert::Pose { object, .. } | Revert::Delete { object, .. } => Some(*object),
            Revert::Insert { .. } => {
                let last = self.environment.objects().len() as u32 - 1;
                Arc::make_mut(&mut self.index).remove_last(&self.environment, last);
                None
            }
            _ => None,
        };
        Arc::make_mut(&mut self.environment).revert(step);
        if let Some(object) = moved {
            Arc::make_mut(&mut self.index).insert_object(&self.environment, object);
        }
    }

    /// Starts a series of changes. Opened layers stay open, because the lists of features are not read in between.
    pub fn begin_row(&mut self) {
        self.row = Some(FEW_FEATURES);
    }

    /// Calls `work` with a change. Opens the layers first if the series of changes so far touches many features.
    fn with_open_layers(
        &mut self,
        change: Change,
        work: impl FnOnce(&mut Self, Change) -> Result<Change>,
    ) -> Result<Change> {
        if self.environment.has_open_layers() {
            return work(self, change);
        }
        let mut left = self.row.unwrap_or(FEW_FEATURES);
        let touches_few = self.touches_few(&change, &mut left);
        self.row = self.row.map(|_| left);
        if touches_few {
            return work(self, change);
        }
        Arc::make_mut(&mut self.environment).open_layers();
        let done = work(self, change);
        if self.row.is_none() {
            Arc::make_mut(&mut self.environment).close_layers();
        }
        done
    }

    /// False if a change inserts, alters or removes more than `left` features one at a time.
    fn touches_few(&self, change: &Change, left: &mut usize) -> bool {
        let count = match change {
            Change::Group(changes) => return changes.iter().all(|change| self.touches_few(change, left)),
            Change::InsertFeature { .. }
            | Change::RestoreFeature { .. }
            | Change::SetFeature { .. }
            | Change::DeleteFeature { .. }
            | Change::SetPoseCovariance { .. } => 1,
            // Deleting an object searches for its features, so the object itself counts too.
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

    /// Applies a change. Only a group can fail halfway.
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
            Change::SetFrame { name, world_from_group } => self.set_frame(name, world_from_group),
            Change::SetMark { name, mark } => self.set_mark(name, mark),
            Change::RemoveMark { name } => self.remove_mark(name),
            Change::SetTrust { object, trust } => self.set_trust(object, trust),
            other => self.step_features(other),
        }
    }

    fn step_features(&mut self, change: Change) -> Result<Change> {
        self.note_layer(&change);
        let environment = Arc::make_mut(&mut self.environment);
        let (done, revert) = match change {
            Change::AddMaterial(material) => {
                environment.add_material(material)?;
                (Change::NOTHING, Some(Revert::Material))
            }
            Change::InsertFeature { class, feature } => {
                let id = feature.id;
                environment.insert_feature(&class, feature, false)?;
                let revert = Revert::InsertFeature { class: class.clone(), id, retired: false };
                (Change::DeleteFeature { class, id }, Some(revert))
            }
            Change::RestoreFeature { class, feature } => {
                let id = feature.id;
                let retired = environment.is_retired(&class, id);
                environment.insert_feature(&class, feature, true)?;
                let revert = Revert::InsertFeature { class: class.clone(), id, retired };
                (Change::DeleteFeature { class, id }, Some(revert))
            }
            Change::SetFeature { class, feature } => {
                let feature = environment.replace_feature(&class, feature)?;
                let revert = Revert::SetFeature { class: class.clone(), feature: feature.clone() };
                (Change::SetFeature { class, feature }, Some(revert))
            }
            Change::DeleteFeature { class, id } => {
                let feature = environment.delete_feature(&class, id)?;
                let revert = Revert::DeleteFeature { class: class.clone(), feature: feature.clone() };
                (Change::RestoreFeature { class, feature }, Some(revert))
            }
            Change::SetTolerance { class, tolerance } => match environment.set_tolerance(&class, tolerance)? {
                Some(tolerance) => {
                    let revert = Revert::Tolerance { class: class.clone(), tolerance };
                    (Change::SetTolerance { class, tolerance }, Some(revert))
                }
                None => (Change::NOTHING, None),
            },
            Change::SetPoseCovariance { class, object, covariance } => {
                let covariance = environment.set_pose_covariance(&class, &object, covariance)?;
                // The journal has it already, with its position in the list.
                (Change::SetPoseCovariance { class, object, covariance }, None)
            }
            // Groups and changes of objects are handled by `step`.
            _ => (Change::NOTHING, None),
        };
        if let (Some(journal), Some(revert)) = (&mut self.journal, revert) {
            journal.push(revert);
        }
        Ok(done)
    }

    /// Records what a change of a layer may have to revert in addition: a new layer, or a pose covariance at its
    /// position. Reverting this is correct even if the change fails.
    fn note_layer(&mut self, change: &Change) {
        if self.journal.is_none() {
            return;
        }
        let class = match change {
            Change::InsertFeature { class, .. }
            | Change::RestoreFeature { class, .. }
            | Change::SetTolerance { class, .. }
            | Change::SetPoseCovariance { class, .. } => class,
            _ => return,
        };
        let revert = match (self.environment.layer(class), change) {
            (None, _) => Revert::NewLayer { class: class.clone() },
            (Some(_), Change::SetPoseCovariance { object, .. }) => {
                let before = self.environment.covariance_and_place(class, object);
                Revert::PoseCovariance { class: class.clone(), object: object.clone(), before }
            }
            _ => return,
        };
        self.note(|_| revert);
    }

    /// Replaces the environment by the state on disk, after a failed write.
    pub fn reset(&mut self, environment: Environment) {
        self.index = Arc::new(WorldIndex::new(&environment, &self.index.kind()));
        self.environment = Arc::new(environment);
        self.stamp = new_stamp();
    }
}

fn new_stamp() -> u64 {
    static NEXT: AtomicU64 = AtomicU64::new(0);
    NEXT.fetch_add(1, Ordering::Relaxed)
}
