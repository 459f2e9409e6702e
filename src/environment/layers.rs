//! The feature layers of an environment, at most one for each sensor class.

use super::{Environment, FeatureLayer};
use crate::error::{Error, Result};

impl Environment {
    /// Its feature layers, by rising class name.
    pub fn layers(&self) -> &[FeatureLayer] {
        &self.layers
    }

    /// The features for a sensor class.
    pub fn layer(&self, class: &str) -> Option<&FeatureLayer> {
        let found = self.layers.binary_search_by(|l| l.class.as_str().cmp(class));
        found.ok().map(|i| &self.layers[i])
    }

    /// Adds a layer; features for a class that has a layer already join it. Whether they lie on polygons is found when
    /// the layer is placed ([`crate::features::place`]).
    ///
    /// ```
    /// use presight::Environment;
    /// use presight::io::layer;
    /// let file = layer::parse(r#"{"format": 1, "class": "video", "features": [
    ///     {"id": 1, "kind": "point", "points": [[1, 2, 3]], "sigma": 0.01}]}"#)?;
    /// let mut environment = Environment::new();
    /// environment.add_layer(file.layer.clone())?;
    /// assert_eq!(environment.layer("video").unwrap().features.len(), 1);
    /// assert!(environment.add_layer(file.layer).is_err(), "its ids are taken");
    /// # Ok::<(), presight::Error>(())
    /// ```
    ///
    /// # Errors
    /// [`crate::ErrorKind::Invalid`] if the layer is not sound, an object it names does not exist, or an id or an
    /// object's pose covariance is given already; nothing is added then.
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
        let Some(present) = self.layer(&layer.class) else { return Ok(()) };
        let taken = |id: u32| present.features.binary_search_by_key(&id, |f| f.id).is_ok();
        if let Some(feature) = layer.features.iter().find(|f| taken(f.id)) {
            let what = format!("id {} is taken", feature.id);
            return Err(Error::invalid(what, "give each feature of a class an id of its own"));
        }
        let twice = |(object, _): &&(String, _)| present.pose_covariances.iter().any(|(other, _)| other == object);
        match layer.pose_covariances.iter().find(twice) {
            Some((object, _)) => {
                let what = format!("the pose covariance of object {object:?} is given twice");
                Err(Error::invalid(what, "keep one of them"))
            }
            None => Ok(()),
        }
    }
}
