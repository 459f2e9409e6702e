//! Features with the polygons on which they lie.

use crate::environment::Feature;
use crate::geometry::{InObject, PoseCovariance};
use std::sync::Arc;

/// A feature with its object and polygons in one version of the world.
#[derive(Clone, Debug, PartialEq)]
pub struct PlacedFeature {
    /// The feature from the layer, in the frame of its object.
    pub feature: Arc<Feature>,
    /// Index of its object; `None` means the world.
    pub object: Option<u32>,
    /// Slots of the polygons on which it lies. They never hide the feature. For a contour these are the polygons of its
    /// surface; a polygon does not hide the parts of a curve that touch it.
    pub slots: Vec<u32>,
}

/// Features with the polygons on which they lie in one world. Clones share the data.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct PlacedFeatures {
    /// The features.
    pub features: Arc<[PlacedFeature]>,
    /// Indices, in ascending order, of features that no longer lie on a polygon and are omitted.
    pub lost: Arc<[u32]>,
    /// Covariances of objects' poses by index of the object.
    pub objects: Arc<[(u32, PoseCovariance<InObject>)]>,
}

impl From<Vec<PlacedFeature>> for PlacedFeatures {
    fn from(features: Vec<PlacedFeature>) -> Self {
        Self { features: features.into(), ..Self::default() }
    }
}
