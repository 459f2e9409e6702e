//! The feature layers of an environment, at most one for each sensor class.

use super::open::OpenLayer;
use super::{DEFAULT_TOLERANCE, Environment, Feature, FeatureLayer};
use crate::error::{Error, Result};
use crate::geometry::{InObject, PoseCovariance};
use std::collections::HashSet;
use std::sync::Arc;

impl Environment {
    /// The feature layers, by rising class name.
    pub fn layers(&self) -> &[FeatureLayer] {
        &self.layers
    }

    /// The features for a sensor class.
    pub fn layer(&self, class: &str) -> Option<&FeatureLayer> {
        let found = self.layers.binary_search_by(|l| l.class.as_str().cmp(class));
        found.ok().map(|i| &self.layers[i])
    }

    /// Adds a layer, or its features to the class's layer. `features::place` checks that they lie on polygons.
    ///
    /// ```
    /// use presight::environment::Environment;
    /// use presight::features::{Existence, Feature, FeatureLayer, FeatureShape, Properties};
    /// use glam::{DMat3, DVec3};
    /// let shape = FeatureShape::Point { at: DVec3::new(1.0, 2.0, 3.0), covariance: 1e-4 * DMat3::IDENTITY };
    /// let (existence, properties) = (Existence::default(), Properties::default());
    /// let point = Feature { id: 1, name: None, object: None, shape, existence, properties };
    /// let layer = FeatureLayer {
    ///     class: "video".into(),
    ///     tolerance: 0.001,
    ///     features: vec![point.into()],
    ///     ..FeatureLayer::default()
    /// };
    /// let mut environment = Environment::new();
    /// environment.add_layer(layer.clone())?;
    /// assert_eq!(environment.layer("video").unwrap().features.len(), 1);
    /// assert!(environment.add_layer(layer).is_err(), "its ids are taken");
    /// # Ok::<(), presight::Error>(())
    /// ```
    ///
    /// # Errors
    /// [`crate::ErrorKind::Invalid`] if the layer is invalid, names an object that does not exist, or repeats an id or
    /// an object's pose covariance. The environment is then unchanged.
    pub fn add_layer(&mut self, layer: FeatureLayer) -> Result<()> {
        let place = format!("layer for class {:?}", layer.class);
        self.check_new_layer(&layer).map_err(|e| e.at(place))?;
        match self.layers.binary_search_by(|l| l.class.cmp(&layer.class)) {
            Err(i) => self.layers.insert(i, layer),
            Ok(i) => {
                let present = &mut self.layers[i];
                present.tolerance = present.tolerance.max(layer.tolerance);
                present.pose_covariances.extend(layer.pose_covariances);
                present.features.extend(layer.features);
                present.features.sort_by_key(|f| f.id);
            }
        }
        Ok(())
    }

    fn check_new_layer(&self, layer: &FeatureLayer) -> Result<()> {
        layer.check()?;
        let of_features = layer.features.iter().filter_map(|f| f.object.as_ref());
        for object in of_features.chain(layer.pose_covariances.iter().map(|(object, _)| object)) {
            self.index_of(object)?;
        }
        layer.features.iter().try_for_each(|f| self.check_unused(&layer.class, f.id))?;
        let Some(present) = self.layer(&layer.class) else { return Ok(()) };
        let taken = |id: u32| present.features.binary_search_by_key(&id, |f| f.id).is_ok();
        if let Some(feature) = layer.features.iter().find(|f| taken(f.id)) {
            let what = format!("id {} is already in use", feature.id);
            return Err(Error::invalid(what, "give each feature of a class a unique id"));
        }
        let known: HashSet<&String> = present.pose_covariances.iter().map(|(object, _)| object).collect();
        let twice = |(object, _): &&(String, _)| known.contains(object);
        match layer.pose_covariances.iter().find(twice) {
            Some((object, _)) => {
                let what = format!("the pose covariance of object {object:?} is given twice");
                Err(Error::invalid(what, "keep one of them"))
            }
            None => Ok(()),
        }
    }

    /// The feature of this class and id.
    pub fn feature(&self, class: &str, id: u32) -> Option<&Feature> {
        if let Some(open) = &self.open {
            return open.get(class)?.feature(id);
        }
        let layer = self.layer(class)?;
        layer.features.binary_search_by_key(&id, |f| f.id).ok().map(|i| &*layer.features[i])
    }

    /// Rising ids of deleted features of a class, which are never used again.
    pub fn retired(&self, class: &str) -> impl Iterator<Item = u32> + '_ {
        self.retired.get(class).into_iter().flatten().copied()
    }

    /// True if the id belonged to a deleted feature.
    pub fn is_retired(&self, class: &str, id: u32) -> bool {
        self.retired.get(class).is_some_and(|ids| ids.contains(&id))
    }

    /// Marks an id as deleted.
    pub fn retire(&mut self, class: &str, id: u32) {
        self.retired.entry(class.to_owned()).or_default().insert(id);
    }

    /// Makes the id of a deleted feature usable again.
    pub(super) fn unretire(&mut self, class: &str, id: u32) {
        if let Some(ids) = self.retired.get_mut(class) {
            ids.remove(&id);
            if ids.is_empty() {
                self.retired.remove(class);
            }
        }
    }

    fn check_unused(&self, class: &str, id: u32) -> Result<()> {
        if !self.is_retired(class, id) {
            return Ok(());
        }
        let what = format!("id {id} belonged to a deleted feature");
        Err(Error::invalid(what, "give each feature an id that was never used"))
    }

    /// Adds a feature, and a layer with the default tolerance if missing. `restored` allows the id of a deleted
    /// feature.
    pub(crate) fn insert_feature(&mut self, class: &str, feature: Feature, restored: bool) -> Result<()> {
        let place = format!("feature {} for class {class:?}", feature.id);
        let check = || {
            if !restored {
                self.check_unused(class, feature.id)?;
                feature.check_dictionary()?;
            }
            if self.feature(class, feature.id).is_some() {
                return Err(Error::invalid("the id is already in use", "give each feature of a class a unique id"));
            }
            self.check_feature(class, &feature)
        };
        check().map_err(|e| e.at(place))?;
        self.unretire(class, feature.id);
        self.layer_or_new(class)?;
        self.put_feature(class, feature);
        Ok(())
    }

    /// Replaces the feature with the same id and returns the previous one.
    pub(crate) fn replace_feature(&mut self, class: &str, feature: Feature) -> Result<Feature> {
        let place = || format!("feature {} for class {class:?}", feature.id);
        let check = || feature.check_dictionary().and_then(|()| self.check_feature(class, &feature));
        check().map_err(|e| e.at(place()))?;
        match self.feature(class, feature.id) {
            Some(_) => {
                let id = feature.id;
                self.put_feature(class, feature).ok_or_else(|| no_feature(class, id))
            }
            None => Err(no_feature(class, feature.id)),
        }
    }

    /// Deletes a feature and returns it. Its id is never used again.
    pub fn delete_feature(&mut self, class: &str, id: u32) -> Result<Feature> {
        let feature = self.take_feature(class, id).ok_or_else(|| no_feature(class, id))?;
        self.retire(class, id);
        Ok(feature)
    }

    /// Puts a feature into an existing layer and returns the previous feature with its id.
    pub(super) fn put_feature(&mut self, class: &str, feature: Feature) -> Option<Feature> {
        if let Some(open) = &mut self.open {
            return open.entry(class.to_owned()).or_default().insert(feature.into()).map(Arc::unwrap_or_clone);
        }
        let feature = Arc::new(feature);
        let layer = self.layers.iter_mut().find(|l| l.class == class)?;
        match layer.features.binary_search_by_key(&feature.id, |f| f.id) {
            Ok(at) => Some(Arc::unwrap_or_clone(std::mem::replace(&mut layer.features[at], feature))),
            Err(at) => {
                layer.features.insert(at, feature);
                None
            }
        }
    }

    /// Removes a feature from its layer and returns it.
    pub(super) fn take_feature(&mut self, class: &str, id: u32) -> Option<Feature> {
        if let Some(open) = &mut self.open {
            return open.get_mut(class)?.remove(id).map(Arc::unwrap_or_clone);
        }
        let layer = self.layers.iter_mut().find(|l| l.class == class)?;
        let at = layer.features.binary_search_by_key(&id, |f| f.id).ok()?;
        Some(Arc::unwrap_or_clone(layer.features.remove(at)))
    }

    /// The covariance of an object's pose, with its position in the layer's list.
    pub(crate) fn covariance_and_place(&self, class: &str, object: &str) -> Option<(usize, PoseCovariance<InObject>)> {
        if let Some(open) = &self.open {
            return open.get(class)?.covariance_and_place(object);
        }
        let all = &self.layer(class)?.pose_covariances;
        let place = all.iter().position(|(path, _)| path == object)?;
        Some((place, all[place].1))
    }

    /// The data attached to an object, by class: whether its pose has a covariance, and the ids of its features.
    pub fn attached_to(&self, object: &str) -> Vec<(String, bool, Vec<u32>)> {
        if let Some(open) = &self.open {
            let of = |(class, layer): (&String, &OpenLayer)| {
                (class.clone(), layer.covariance(object).is_some(), layer.of_object(object))
            };
            return open.iter().map(of).collect();
        }
        let of = |layer: &FeatureLayer| {
            let covariance = layer.pose_covariances.iter().any(|(path, _)| path == object);
            let own = layer.features.iter().filter(|f| f.object.as_deref() == Some(object));
            (layer.class.clone(), covariance, own.map(|f| f.id).collect())
        };
        self.layers.iter().map(of).collect()
    }

    /// Number of features attached to an object, or to all objects below a path; counts up to `most`.
    pub(crate) fn attached_to_path(&self, path: &str, below: bool, most: usize) -> usize {
        let is_on = |object: &str| match object.strip_prefix(path) {
            Some(rest) if below => rest.starts_with('/'),
            Some(rest) => rest.is_empty(),
            None => false,
        };
        let objects = self.layers.iter().flat_map(|layer| &layer.features).filter_map(|f| f.object.as_deref());
        objects.filter(|object| is_on(object)).take(most).count()
    }

    /// The features for a class by rising id, whether the layers are open or not.
    fn features_of(&self, class: &str) -> impl Iterator<Item = &Arc<Feature>> {
        let listed = self.layer(class).into_iter().flat_map(|layer| &layer.features);
        let open = self.open.as_ref().and_then(|open| open.get(class));
        listed.chain(open.into_iter().flat_map(OpenLayer::features))
    }

    fn check_feature(&self, class: &str, feature: &Feature) -> Result<()> {
        feature.check(self.layer(class).map_or(DEFAULT_TOLERANCE, |l| l.tolerance))?;
        feature.object.as_deref().map_or(Ok(()), |object| self.index_of(object).map(drop))
    }

    fn layer_or_new(&mut self, class: &str) -> Result<&mut FeatureLayer> {
        let at = match self.layers.binary_search_by(|l| l.class.as_str().cmp(class)) {
            Ok(at) => at,
            Err(at) => {
                let layer =
                    FeatureLayer { class: class.to_owned(), tolerance: DEFAULT_TOLERANCE, ..FeatureLayer::default() };
                layer.check_header()?;
                self.layers.insert(at, layer);
                at
            }
        };
        Ok(&mut self.layers[at])
    }

    /// Sets the tolerance of a layer, which is created if missing. Returns the previous tolerance if there was a layer.
    pub(crate) fn set_tolerance(&mut self, class: &str, tolerance: f64) -> Result<Option<f64>> {
        let before = self.layer(class).map(|l| l.tolerance);
        let header = FeatureLayer { class: class.to_owned(), tolerance, ..FeatureLayer::default() };
        header.check_header()?;
        self.features_of(class)
            .try_for_each(|f| f.check(tolerance).map_err(|e| e.at(format!("feature {} for class {class:?}", f.id))))?;
        self.layer_or_new(class)?.tolerance = tolerance;
        Ok(before)
    }

    /// Sets or removes the covariance of an object's pose for the features of a class. Returns the previous one.
    pub(crate) fn set_pose_covariance(
        &mut self,
        class: &str,
        object: &str,
        covariance: Option<PoseCovariance<InObject>>,
    ) -> Result<Option<PoseCovariance<InObject>>> {
        let place = || format!("pose covariance of object {object:?} for class {class:?}");
        if let Some(covariance) = &covariance {
            self.index_of(object).map_err(|e| e.at(place()))?;
            covariance.check().map_err(|e| e.at(place()))?;
        }
        self.layer_or_new(class)?;
        if let Some(open) = &mut self.open {
            return Ok(open.entry(class.to_owned()).or_default().set_covariance(object, covariance));
        }
        let all = &mut self.layer_or_new(class)?.pose_covariances;
        let at = all.iter().position(|(path, _)| path == object);
        Ok(match (at, covariance) {
            (Some(at), Some(new)) => Some(std::mem::replace(&mut all[at].1, new)),
            (Some(at), None) => Some(all.remove(at).1),
            (None, Some(new)) => {
                all.push((object.to_owned(), new));
                None
            }
            (None, None) => None,
        })
    }
}

fn no_feature(class: &str, id: u32) -> Error {
    let what = format!("there is no feature {id} for class {class:?}");
    Error::invalid(what, "presight env export writes all features")
}
