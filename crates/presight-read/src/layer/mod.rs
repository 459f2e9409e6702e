//! Layer files: the features of one sensor class as JSON. The format is 2 in files with contours, otherwise 1. Unknown
//! keys are errors.
//!
//! ```json
//! {
//!   "format": 1,
//!   "class": "video",
//!   "tolerance": 0.001,
//!   "pose_covariances": {"hall/door": [1e-4, 0, 0, 0, 0, 0,  0, 1e-4, 0, 0, 0, 0,  0, 0, 0, 0, 0, 0,
//!                                      0, 0, 0, 0, 0, 0,     0, 0, 0, 0, 0, 0,     0, 0, 0, 0, 0, 1e-6]},
//!   "features": [
//!     {"id": 1, "kind": "segment", "name": "door, left edge", "object": "hall/door",
//!      "points": [[0, 0, 0], [0, 0, 2]], "sigma": 0.005, "properties": {"contrast": 0.8}},
//!     {"id": 2, "kind": "reflector", "points": [[4.2, -1.0, 1.5]], "sigma": [0.002, 0.002, 0.01],
//!      "existence": 0.95, "confirmed": 1790000000, "rate": 1e-7,
//!      "properties": {"strength": 1, "normal": [0, 1, 0]}},
//!     {"id": 3, "kind": "fiducial", "points": [[1, 0, 2], [1.2, 0, 2], [1.2, 0, 1.8], [1, 0, 1.8]],
//!      "properties": {"family": "DICT_APRILTAG_36h11", "code": 17}},
//!     {"id": 4, "remove": true}
//!   ]
//! }
//! ```
//!
//! - `id`: stable number from 1, never reused
//! - `kind`: `point`, `segment`, `patch`, `reflector`, `fiducial`, and in format 2 `contour`
//! - `object`: path of the object whose frame it uses and with which it moves; absent: the world
//! - `anchor`, `crease_deg`: contours, in place of `points`: a point on the surface, metres, and the greatest angle
//!   between adjacent facets, degrees
//! - `points`: metres: 1 for points and reflectors; 2 ends of a segment; 3 or more corners of a convex patch; 4 corners
//!   of a fiducial, clockwise from the top left when seen from the front
//! - `sigma`: standard deviation of each point, metres: one for all axes, or three
//! - `covariance`: in place of `sigma`: covariance of each point, 9 numbers, row-major
//! - `covariances`: segments: one covariance for each end
//! - `cross_covariance`: segments: covariance of the first end with the second
//! - `existence`, `confirmed`, `rate`: p(t) = existence exp(-rate (t - confirmed)); 1, 0 and 0 if absent; UTC seconds
//! - `properties`: `strength`, `contrast` (0 to 1), `normal` (unit vector of the surface), `family` and `code` of a
//!   fiducial: OpenCV's name of the dictionary, and the marker's number in it
//! - `surface`: `lost`: the surface has since been moved or deleted. Such a feature is kept; if it is off its polygons,
//!   this is not an error, but predictions omit it. Stores export it
//! - `remove`: `true`: drops the feature with this id of layers read before; other keys must be absent
//!
//! Absent covariances are zero. `tolerance` (metres, default 0.001) is the greatest distance of a feature in this file
//! from the polygons it lies on; they are found by geometry when the layer is used (`presight_features::place`).
//! `pose_covariances` are 6 x 6, row-major: x y z, then rotation about the fixed axes x y z, in the object's frame. A
//! `$schema` key is allowed for editors; it should point to [`schema`].

mod fields;
mod merge;
mod read;
mod schema;
#[cfg(test)]
mod tests;
mod write;

pub use fields::FeatureFields;
pub use merge::{MergedLayers, load, merge, select};
pub use read::{LayerFile, from_fields, parse, read};
pub use schema::schema;
pub use write::{entry, fields as to_fields, serializable, to_string, write, write_with_lost};

/// The newest format that this build reads, used for files with contours.
const FORMAT: u32 = 2;
/// The format of files without contours.
const FORMAT_WITHOUT_CONTOURS: u32 = 1;
