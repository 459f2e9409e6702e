//! Features: what a sensor can extract from its image, with position and uncertainty (paper section 2.3).

use crate::geometry::{InObject, PoseCovariance};
use glam::{DMat3, DVec3};
use std::sync::Arc;

/// The features for one sensor class.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct FeatureLayer {
    /// The sensor class they are for.
    pub class: String,
    /// Allowed distance of a feature from its polygons, metres.
    pub tolerance: f64,
    /// The features, by rising id. They are shared with clones of the layer, placed features and predictions.
    pub features: Vec<Arc<Feature>>,
    /// Covariances of objects' poses, shared by all features of the object, by object path.
    pub pose_covariances: Vec<(String, PoseCovariance<InObject>)>,
}

impl FeatureLayer {
    /// The newest confirmation of all features, UTC seconds (0 without features). Predictions report existence for this
    /// time by default. The clock is never read: the same input gives the same prediction.
    ///
    /// ```
    /// use presight::features::{Existence, Feature, FeatureLayer, FeatureShape, Properties};
    /// use glam::{DMat3, DVec3};
    /// let confirmed = |id: u32, confirmed: f64| Feature {
    ///     id,
    ///     name: None,
    ///     object: None,
    ///     shape: FeatureShape::Point { at: DVec3::ZERO, covariance: DMat3::ZERO },
    ///     existence: Existence { p0: 1.0, confirmed, rate: 0.1 },
    ///     properties: Properties::default(),
    /// };
    /// let features = vec![confirmed(1, 90.0).into(), confirmed(2, 100.0).into()];
    /// let layer = FeatureLayer { features, ..FeatureLayer::default() };
    /// let time = layer.newest_confirmation();
    /// assert_eq!(time, 100.0);
    /// assert_eq!(layer.features[0].existence.at(time), (-1f64).exp());
    /// ```
    pub fn newest_confirmation(&self) -> f64 {
        self.features.iter().map(|f| f.existence.confirmed).reduce(f64::max).unwrap_or(0.0)
    }
}

/// Default for [`FeatureLayer::tolerance`], metres.
pub const DEFAULT_TOLERANCE: f64 = 1e-3;

/// A feature: something that a sensor can extract from its image.
#[derive(Clone, Debug, PartialEq)]
pub struct Feature {
    /// Stable number, never reused; 0 means no feature.
    pub id: u32,
    /// Name, for people.
    pub name: Option<String>,
    /// Path of the object in whose frame the feature is given and with which it moves; `None` means the world.
    pub object: Option<String>,
    /// Geometry with its covariance.
    pub shape: FeatureShape,
    /// Probability that it exists.
    pub existence: Existence,
    /// Further attributes.
    pub properties: Properties,
}

/// Geometry with its covariance, in the frame of the feature's object, metres. Covariances are symmetric and positive
/// semidefinite; singular ones are fine.
#[derive(Clone, Debug, PartialEq)]
pub enum FeatureShape {
    /// A point.
    Point {
        /// Position.
        at: DVec3,
        /// Covariance of the position.
        covariance: DMat3,
    },
    /// A straight edge.
    Segment {
        /// Both ends; they must differ.
        ends: [DVec3; 2],
        /// Covariance of each end.
        covariances: [DMat3; 2],
        /// Cross-covariance of the first end with the second.
        cross: DMat3,
    },
    /// A planar convex patch.
    Patch {
        /// At least three corners, in winding order.
        corners: Vec<DVec3>,
        /// Covariance of its position as a whole.
        covariance: DMat3,
    },
    /// A retro-reflector.
    Reflector {
        /// Position.
        at: DVec3,
        /// Covariance of the position.
        covariance: DMat3,
    },
    /// A square fiducial marker.
    Fiducial {
        /// Clockwise from the top left, seen from the front.
        corners: [DVec3; 4],
        /// Covariance of its position as a whole.
        covariance: DMat3,
        /// OpenCV's name of the dictionary.
        family: String,
        /// Number in the dictionary.
        code: u32,
    },
    /// The silhouettes of a smooth surface: the polygons of one object that are connected to the polygon under the
    /// anchor over edges with at most the crease angle. The line between front and back depends on the pose.
    Contour {
        /// A point on the surface.
        anchor: DVec3,
        /// The angle, degrees, above 0 and at most 90.
        crease_deg: f64,
        /// Covariance of its position as a whole.
        covariance: DMat3,
    },
}

/// Temporal uncertainty: p(t) = p0 exp(-rate (t - t0)).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Existence {
    /// Probability at the last confirmation, 0..=1.
    pub p0: f64,
    /// Last confirmation, UTC seconds.
    pub confirmed: f64,
    /// Decay, 1 / s.
    pub rate: f64,
}

impl Default for Existence {
    fn default() -> Self {
        Self { p0: 1.0, confirmed: 0.0, rate: 0.0 }
    }
}

impl Existence {
    /// The probability at a time (UTC seconds). Before the confirmation it is `p0`.
    pub fn at(&self, time: f64) -> f64 {
        self.p0 * (-self.rate * (time - self.confirmed).max(0.0)).exp()
    }
}

/// Attributes of a feature.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Properties {
    /// Strength or reflectivity, 0..=1.
    pub strength: Option<f64>,
    /// Contrast across an edge, 0..=1.
    pub contrast: Option<f64>,
    /// Unit normal of the surface, in the frame of the feature's object. Landmarks are visible only from its side.
    pub normal: Option<DVec3>,
}

impl FeatureShape {
    /// The kind as files name it.
    pub fn kind(&self) -> &'static str {
        match self {
            Self::Point { .. } => "point",
            Self::Segment { .. } => "segment",
            Self::Patch { .. } => "patch",
            Self::Reflector { .. } => "reflector",
            Self::Fiducial { .. } => "fiducial",
            Self::Contour { .. } => "contour",
        }
    }

    /// True for shapes with an area: patches and fiducials.
    pub fn is_area(&self) -> bool {
        matches!(self, Self::Patch { .. } | Self::Fiducial { .. })
    }

    /// The points that define it.
    pub fn points(&self) -> &[DVec3] {
        match self {
            Self::Point { at, .. } | Self::Reflector { at, .. } => std::slice::from_ref(at),
            Self::Segment { ends, .. } => ends,
            Self::Patch { corners, .. } => corners,
            Self::Fiducial { corners, .. } => corners,
            Self::Contour { anchor, .. } => std::slice::from_ref(anchor),
        }
    }

    /// True for contours.
    pub fn is_contour(&self) -> bool {
        matches!(self, Self::Contour { .. })
    }
}
