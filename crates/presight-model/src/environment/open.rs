//! Feature layers while many changes are made to them at once. In a list each feature that is put in or taken out moves all
//! that come after it, and finding those of an object looks at every one: for a hundred thousand features that is minutes.

use super::{Environment, Feature};
use std::collections::{BTreeMap, BTreeSet, HashMap};
use std::sync::Arc;

/// The covariance of an object's pose.
pub(super) type Covariance = [[f64; 6]; 6];

/// What a layer holds, each part as quick to find as to put in and to take out.
#[derive(Clone, Debug, Default)]
pub(super) struct OpenLayer {
    features: BTreeMap<u32, Arc<Feature>>,
    /// Ids by object.
    of_object: HashMap<String, BTreeSet<u32>>,
    /// By object, with their places in the list.
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

    /// The answer is the one that had the id.
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

    /// What [`OpenLayer::covariance_and_place`] told is so again.
    pub fn restore_covariance(&mut self, object: String, before: Option<(usize, Covariance)>) {
        match before {
            Some(before) => self.covariances.insert(object, before),
            None => self.covariances.remove(&object),
        };
    }

    /// The answer is the one before, whose place a new one takes.
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
    /// Makes features quick to put in and to take out, one by one, until [`Environment::close_layers`]; in between
    /// [`Environment::layers`] shows none.
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

    /// True between the two.
    pub(crate) fn has_open_layers(&self) -> bool {
        self.open.is_some()
    }

    /// Makes them lists again.
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
