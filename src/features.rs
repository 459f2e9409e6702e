//! Features: placed on the model, predicted in images, and generated from the model.
#![doc = include_str!("../docs/features.md")]
//!
//! # Regions of interest
//!
//! The region of interest of a feature is the image box in which it will be found with a stated probability.
//!
//! A [`crate::Request`] asks for them with [`BoxOptions`]; [`roi()`] computes one alone.
//!
//! ## The paper's Fig. 10
//!
//! A robot knows its position to 3 cm in x and y, and its heading to 1 degree. In which columns will it find a vertical
//! line 4 m ahead that is known to 1 cm? Position errors are divided by the distance; the heading error is not:
//!
//! ```
//! use glam::{DMat3, DVec3};
//! use presight::{Pose, PoseCovariance};
//! use presight::features::FeatureShape;
//! use presight::features::{BodyPoint, FeatureErrorModel, Projection, RoiFlag, roi};
//!
//! /// A pinhole camera of 640 x 480 pixels, body axes: x forward, y left, z up.
//! struct Camera;
//! impl Projection for Camera {
//!     fn project(&self, p: DVec3) -> Option<[f64; 2]> {
//!         (p.x > 0.0).then(|| [319.5 - 500.0 * p.y / p.x, 239.5 - 500.0 * p.z / p.x])
//!     }
//!     fn lever(&self, p: DVec3) -> f64 {
//!         p.x
//!     }
//!     fn size(&self) -> (u32, u32) {
//!         (640, 480)
//!     }
//!     fn turn(&self) -> Option<f64> {
//!         None
//!     }
//! }
//!
//! let (xy, heading, line) = (0.03, 1f64.to_radians(), 0.01);
//! let robot = PoseCovariance::from_sigmas([xy, xy, 0.0, 0.0, 0.0, heading]);
//! let ends = [DVec3::new(4.0, 0.0, -0.6), DVec3::new(4.0, 0.0, 0.6)];
//! let covariances = [DMat3::from_diagonal(DVec3::splat(line * line)); 2];
//! let shape = FeatureShape::Segment { ends, covariances, cross: DMat3::ZERO };
//! let uncertain = FeatureErrorModel::new(&Pose::IDENTITY, &robot, &Pose::IDENTITY, None, &shape)?;
//! let points = [0.0, 1.0].map(|t| BodyPoint::on_segment(&ends, t));
//! let found = roi(&Camera, &uncertain, &points, 0.99).expect("it is before the camera");
//!
//! let sigma = 500.0 * ((xy * xy + line * line) / 16.0 + heading * heading).sqrt();
//! let [left, _, right, _] = found.bounds;
//! // One side alone needs 2.58 sigma. Two ends, top and bottom add a little.
//! let deviations = 0.5 * (right - left) / sigma;
//! assert!(2.58 < deviations && deviations < 3.1, "{deviations}");
//! assert!((0.5 * (left + right) - 319.5).abs() < 0.1);
//! assert_eq!(found.flag, RoiFlag::Linear);
//! # Ok::<(), presight::Error>(())
//! ```

#[doc(inline)]
pub use presight_features::generate::{FeatureKind, GenerateOptions, GeneratedLayer, generate, generate_with_progress};
#[doc(inline)]
pub use presight_features::roi::{BodyPoint, FeatureErrorModel, Projection, Roi, RoiFlag, roi};
#[doc(inline)]
pub use presight_features::{
    BoxMethod, BoxOptions, FeatureOptions, FeaturePrediction, FeatureSource, FeatureStats, Hidden, HiddenInterval,
    Reason, SeenFeature, VisibleInterval, sides_seen_in_part,
};
#[doc(inline)]
pub use presight_model::environment::{Existence, Feature, FeatureLayer, FeatureShape, Properties};
#[doc(inline)]
pub use presight_model::place::place;
#[doc(inline)]
pub use presight_model::placement::{PlacedFeature, PlacedFeatures, find, lost, place_layer, why_off};
