//! Features and the polygons they lie on, as both change. A new feature must lie on polygons. A feature whose surface
//! is later moved or deleted is kept and reported, but left out of predictions.

use crate::change::Change;
use crate::environment::{DEFAULT_TOLERANCE, Environment, Feature, FeatureLayer};
use crate::error::{Error, Result};
use crate::index::IndexKind;
use crate::place::{place, place_lying};
pub use crate::placed::{PlacedFeature, PlacedFeatures};
use crate::world::World;
use std::collections::HashSet;
use std::sync::Arc;

/// The features of a layer in a version of the world.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Placement {
    /// The features that lie on polygons, in the order of the layer.
    pub placed: Vec<PlacedFeature>,
    /// Ids of the others, in rising order.
    pub off: Vec<u32>,
}

/// Finds the object and the polygons of each feature, as [`place`] does, and separates features that are off their
/// polygons.
///
/// # Errors
/// [`crate::ErrorKind::Invalid`] if the layer is not valid, or names the pose of a missing object.
pub fn find(world: &World, layer: &FeatureLayer) -> Result<Placement> {
    let (placed, off) = place_lying(world, layer)?;
    Ok(Placement { placed, off })
}

/// Places a layer for predictions: features that have lost their surface are listed and left out.
///
/// # Errors
/// As [`find`].
pub fn place_layer(world: &World, layer: &FeatureLayer) -> Result<PlacedFeatures> {
    let Placement { mut placed, off } = find(world, layer)?;
    placed.sort_by_key(|p| p.feature.id);
    let index = |(object, covariance): &(String, _)| Ok((world.environment().index_of(object)?, *covariance));
    let objects = layer.pose_covariances.iter().map(index).collect::<Result<Vec<_>>>()?;
    Ok(PlacedFeatures { features: placed.into(), lost: off.into(), objects: objects.into() })
}

/// The features of the environment's own layers that no longer lie on a polygon, by class and id.
///
/// # Errors
/// As [`find`].
pub fn lost(environment: &Environment) -> Result<Vec<(String, u32)>> {
    let mut lost = Vec::new();
    if environment.layers().iter().all(|layer| layer.features.is_empty()) {
        return Ok(lost);
    }
    let world = World::new(environment.clone());
    for layer in environment.layers() {
        lost.extend(find(&world, layer)?.off.into_iter().map(|id| (layer.class.clone(), id)));
    }
    Ok(lost)
}

/// Explains why a feature lies on no polygon, in an error that names class and feature; `None` if it lies on one.
pub fn why_off(world: &World, class: &str, tolerance: f64, feature: &Feature) -> Option<Error> {
    let (class_name, features) = (class.to_owned(), vec![Arc::new(feature.clone())]);
    let layer = FeatureLayer { class: class_name, tolerance, features, pose_covariances: Vec::new() };
    place(world, &layer).err().map(|e| e.at(format!("class {class:?}")))
}

impl World {
    /// Applies a change, which makes the next version, and returns its inverse. After the change, new and altered
    /// features must lie on polygons. Restored features need not: they may have lost their surface before deletion.
    ///
    /// Environment and index change together, in place unless a clone still holds this version. If features must be
    /// checked, a world without an index gets the default one. Apply an inverse with [`World::apply_unchecked`].
    ///
    /// ```
    /// use presight::features::{Existence, Feature, FeatureShape, Properties};
    /// use presight::environment::{Environment, Material, Mesh, NewObject, Polygon, PolygonOrder};
    /// use presight::{Change, Pose, World};
    /// let mut environment = Environment::new();
    /// let paint = environment.add_material(Material::named("paint"))?;
    /// let corners = [glam::Vec3::ZERO, glam::Vec3::X, glam::Vec3::Y].to_vec();
    /// let mesh = Mesh::new("sign", corners, vec![Polygon::new(vec![0, 1, 2], paint)], PolygonOrder::Given)?;
    /// let mut world = World::new(environment);
    /// world.apply(Change::InsertObject(NewObject::new("sign", Pose::IDENTITY, mesh.into())))?;
    /// let dot = |id, z| Change::InsertFeature {
    ///     class: "video".into(),
    ///     feature: Feature {
    ///         id,
    ///         name: None,
    ///         object: None,
    ///         shape: FeatureShape::Point { at: glam::DVec3::new(0.2, 0.2, z), covariance: glam::DMat3::ZERO },
    ///         existence: Existence::default(),
    ///         properties: Properties::default(),
    ///     },
    /// };
    /// world.apply(dot(1, 0.0))?;
    /// assert!(world.apply(dot(2, 0.5)).is_err(), "half a metre above the sign");
    /// # Ok::<(), presight::Error>(())
    /// ```
    ///
    /// # Errors
    /// Errors of [`World::apply_unchecked`], and [`crate::ErrorKind::Invalid`] naming class and feature if a feature
    /// lies on no polygon; content and version are then unchanged.
    pub fn apply(&mut self, change: Change) -> Result<Change> {
        apply(self, change, false, &[])
    }
}

/// As [`World::apply`]. With `restored_too`, restored features are checked as well. The features `lost` (class, id) are
/// known to have lost their surface and are not checked.
pub fn apply(world: &mut World, change: Change, restored_too: bool, lost: &[(String, u32)]) -> Result<Change> {
    let mut named = Vec::new();
    name_features(&change, restored_too, &mut named);
    if !lost.is_empty() {
        let lost: HashSet<&(String, u32)> = lost.iter().collect();
        named.retain(|feature| !lost.contains(feature));
    }
    if named.is_empty() {
        return world.apply_unchecked(change);
    }
    if matches!(world.index().kind(), IndexKind::None) {
        *world = world.reindexed(&IndexKind::default());
    }
    // A change of one feature moves no polygon, so it is checked first, without a copy.
    if let Change::InsertFeature { class, feature }
    | Change::SetFeature { class, feature }
    | Change::RestoreFeature { class, feature } = &change
    {
        check(world, class, feature)?;
        return world.apply_unchecked(change);
    }
    world.apply_if(change, |world| {
        let mut all = named.iter().filter_map(|(class, id)| Some((class, world.environment().feature(class, *id)?)));
        all.try_for_each(|(class, feature)| check(world, class, feature))
    })
}

/// Collects classes and ids of the features that a change inserts or alters.
fn name_features(change: &Change, restored_too: bool, to: &mut Vec<(String, u32)>) {
    match change {
        Change::InsertFeature { class, feature } | Change::SetFeature { class, feature } => {
            to.push((class.clone(), feature.id));
        }
        Change::RestoreFeature { class, feature } if restored_too => to.push((class.clone(), feature.id)),
        Change::Group(changes) => changes.iter().for_each(|change| name_features(change, restored_too, to)),
        _ => {}
    }
}

fn check(world: &World, class: &str, feature: &Feature) -> Result<()> {
    let tolerance = world.environment().layer(class).map_or(DEFAULT_TOLERANCE, |l| l.tolerance);
    why_off(world, class, tolerance, feature).map_or(Ok(()), Err)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::environment::{Existence, FeatureShape, Material, Mesh, NewObject, Polygon, PolygonOrder, Properties};
    use crate::geometry::Pose;
    use glam::{DMat3, DVec3, Vec3};

    /// Two tiles: one at the origin, one 5 m away.
    fn world() -> World {
        let mut environment = Environment::new();
        environment.add_material(Material::named("m")).unwrap();
        let corners = vec![Vec3::ZERO, Vec3::X, Vec3::new(1.0, 1.0, 0.0), Vec3::Y];
        let mesh = Mesh::new("t", corners, vec![Polygon::new(vec![0, 1, 2, 3], 0)], PolygonOrder::Spatial).unwrap();
        let mesh = Arc::new(mesh);
        for (name, x) in [("near", 0.0), ("far", 5.0)] {
            environment.insert(NewObject::new(name, at(x), mesh.clone())).unwrap();
        }
        World::with_index(environment, &IndexKind::None)
    }

    fn at(x: f64) -> Pose {
        Pose::from_xyz_rpy(DVec3::new(x, 0.0, 0.0), 0.0, 0.0, 0.0)
    }

    fn point(id: u32, x: f64) -> Feature {
        Feature {
            id,
            name: None,
            object: None,
            shape: FeatureShape::Point { at: DVec3::new(x, 0.5, 0.0), covariance: DMat3::IDENTITY },
            existence: Existence::default(),
            properties: Properties::default(),
        }
    }

    fn insert(id: u32, x: f64) -> Change {
        Change::InsertFeature { class: "video".into(), feature: point(id, x) }
    }

    fn move_to(name: &str, x: f64) -> Change {
        Change::MoveObject { name: name.into(), world_from_object: at(x) }
    }

    #[test]
    fn new_features_must_lie_on_polygons_when_all_is_done() {
        let mut world = world();
        world.apply(insert(1, 0.5)).unwrap();
        assert!(matches!(world.index().kind(), IndexKind::TwoLevel(_)));
        let alter = |x| Change::SetFeature { class: "video".into(), feature: point(1, x) };
        let restore = Change::RestoreFeature { class: "video".into(), feature: point(9, 3.0) };
        let group = |changes: &[Change]| Change::Group(changes.to_vec());
        let refused = [
            insert(2, 3.0),
            alter(3.0),
            group(&[insert(2, 0.5), insert(3, 3.0)]),
            group(&[group(&[insert(2, 0.5)]), move_to("near", 2.0)]),
            group(&[insert(2, 0.5), Change::DeleteObject { name: "near".into() }]),
        ];
        let before = (world.environment().content_hash(), world.version());
        for change in refused {
            let e = world.apply(change.clone()).unwrap_err();
            let said = e.to_string();
            assert!(said.starts_with("class \"video\": feature ") && said.contains("off its polygons"), "{said}");
            assert!(!e.remedy().is_empty());
            assert_eq!((world.environment().content_hash(), world.version()), before, "{change:?}");
            world.index().assert_well_formed(world.environment());
        }
        assert!(apply(&mut world, restore.clone(), true, &[]).is_err());
        let taken = [
            group(&[insert(2, 2.5), move_to("near", 2.0)]),
            group(&[insert(3, 3.75), Change::DeleteFeature { class: "video".into(), id: 3 }]),
            alter(5.5),
            restore,
            // Existing features are not checked.
            move_to("far", 7.0),
        ];
        for change in taken {
            world.apply(change.clone()).unwrap_or_else(|e| panic!("{change:?}: {e}"));
        }
    }

    #[test]
    fn what_lost_its_surface_is_set_apart_and_told() {
        let mut world = world();
        world.apply(Change::Group(vec![insert(1, 0.5), insert(2, 5.5), insert(3, 5.25)])).unwrap();
        assert_eq!(lost(world.environment()).unwrap(), []);
        world.apply(move_to("far", 9.0)).unwrap();
        let layer = world.environment().layer("video").unwrap();
        let found = find(&world, layer).unwrap();
        assert_eq!((found.placed[0].feature.id, found.placed.len(), found.off), (1, 1, vec![2, 3]));
    }
}
