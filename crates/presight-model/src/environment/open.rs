//! Feature layers during a series of changes. In a list, every insertion and removal shifts all later features, and
//! finding the features of an object scans them all: minutes for a hundred thousand features.

use super::{Environment, Feature};
use crate::geometry::{InObject, PoseCovariance};
use std::collections::{BTreeMap, BTreeSet, HashMap};
use std::sync::Arc;

/// The covariance of an object's pose.
pub(super) type Covariance = PoseCovariance<InObject>;

/// The content of a layer, with fast lookup, insertion and removal.
#[derive(Clone, Debug, Default)]
pub(super) struct OpenLayer {
    features: BTreeMap<u32, Arc<Feature>>,
    /// Ids by object.
    of_object: HashMap<String, BTreeSet<u32>>,
    /// By object, each with its position in the list.
    covariances: HashMap<String, (usize, Covariance)>,
    next_place: usize,
}

impl OpenLayer {
    pub fn feature(&self, id: u32) -> Option<&Feature> {
        self.features.get(&id).map(|feature| &**feature)
    }

    pub fn features(&self) -> impl Iterator<Item = &Arc<Feature>> {
        self.features.values()
    }

    /// Rising ids of the features in an object's frame.
    pub fn of_object(&self, object: &str) -> Vec<u32> {
        self.of_object.get(object).into_iter().flatten().copied().collect()
    }

    /// Returns the previous feature with this id.
    pub fn insert(&mut self, feature: Arc<Feature>) -> Option<Arc<Feature>> {
        let before = self.remove(feature.id);
        if let Some(object) = &feature.object {
            self.of_object.entry(object.clone()).or_default().insert(feature.id);
        }
        self.features.insert(feature.id, feature);
        before
    }

    pub fn remove(&mut self, id: u32) -> Option<Arc<Feature>> {
        let feature = self.features.remove(&id)?;
        if let Some(ids) = feature.object.as_ref().and_then(|object| self.of_object.get_mut(object)) {
            ids.remove(&id);
        }
        Some(feature)
    }

    pub fn covariance(&self, object: &str) -> Option<&Covariance> {
        self.covariances.get(object).map(|(_, covariance)| covariance)
    }

    pub fn covariance_and_place(&self, object: &str) -> Option<(usize, Covariance)> {
        self.covariances.get(object).copied()
    }

    /// Restores the covariance and position from [`OpenLayer::covariance_and_place`].
    pub fn restore_covariance(&mut self, object: String, before: Option<(usize, Covariance)>) {
        match before {
            Some(before) => self.covariances.insert(object, before),
            None => self.covariances.remove(&object),
        };
    }

    /// Returns the previous covariance. The new one takes its position.
    pub fn set_covariance(&mut self, object: &str, covariance: Option<Covariance>) -> Option<Covariance> {
        let before = self.covariances.remove(object);
        if let Some(covariance) = covariance {
            let place = before.map_or(self.next_place, |(place, _)| place);
            self.next_place = self.next_place.max(place + 1);
            self.covariances.insert(object.to_owned(), (place, covariance));
        }
        before.map(|(_, covariance)| covariance)
    }
}

impl Environment {
    /// Makes insertion and removal of single features fast until [`Environment::close_layers`]. Until then
    /// [`Environment::layers`] has no features.
    pub(crate) fn open_layers(&mut self) {
        let mut all = BTreeMap::new();
        for layer in &mut self.layers {
            let mut open = OpenLayer::default();
            for (place, (object, covariance)) in layer.pose_covariances.drain(..).enumerate() {
                open.covariances.insert(object, (place, covariance));
                open.next_place = place + 1;
            }
            for feature in layer.features.drain(..) {
                open.insert(feature);
            }
            all.insert(layer.class.clone(), open);
        }
        self.open = Some(all);
    }

    /// True between [`Environment::open_layers`] and [`Environment::close_layers`].
    pub(crate) fn has_open_layers(&self) -> bool {
        self.open.is_some()
    }

    /// Turns the open layers into lists again.
    pub(crate) fn close_layers(&mut self) {
        let mut all = self.open.take().unwrap_or_default();
        for layer in &mut self.layers {
            let Some(OpenLayer { features, covariances, .. }) = all.remove(&layer.class) else { continue };
            layer.features.extend(features.into_values());
            let mut listed: Vec<_> = covariances.into_iter().collect();
            listed.sort_unstable_by_key(|(_, (place, _))| *place);
            layer.pose_covariances.extend(listed.into_iter().map(|(object, (_, covariance))| (object, covariance)));
        }
    }
}
