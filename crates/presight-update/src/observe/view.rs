//! Views: frames compared with a world.

use crate::observe::mount::PoseCorrections;
use crate::observe::pixels::SampledPixels;
use crate::observe::spot::Spot;
use crate::observe::terms::Terms;
use glam::DVec3;
use presight_localize::verdict::body_from_image;
use presight_model::geometry::{Pose, SensorPose};
use presight_model::measured::RangeNoise;
use presight_model::statistics::NOISE_BOUND;
use std::sync::Arc;

/// Minimum cosine of the incidence of a ray that is informative.
pub(crate) const MIN_COSINE: f64 = 0.1;
/// Index of no object: the ray meets no surface.
pub(crate) const NO_OBJECT: u32 = u32::MAX;
/// A reading beyond this share of the sensor's reach may be missing.
pub(crate) const SAFE_REACH: f64 = 0.95;
/// Points nearer than this to a surface belong to it, metres.
pub(crate) const KNOWN: f64 = 0.05;
/// Rays are cast no farther, metres.
const MAX_REACH: f64 = 1e5;

/// The evidence of a pixel on the first object on its ray.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum PixelEvidence {
    /// The pixel has no reading, or its ray went on near an edge of the object or almost parallel to its surface.
    Unknown,
    /// The object is there. Without it the range would differ.
    Present,
    /// The ray passed through the object.
    SeenThrough,
    /// Something else is before every predicted surface.
    Covered,
    /// The range would be about the same without the object.
    Ambiguous,
}

/// A frame compared with a world.
#[derive(Clone, Debug)]
pub(crate) struct View {
    pub stamp: f64,
    /// Number of the drive, from 0.
    pub drive: usize,
    pub world_from_image: Pose,
    pub pixels: Arc<SampledPixels>,
    pub noise: RangeNoise,
    /// Measured ranges of the sampled pixels, metres.
    pub ranges: Vec<f32>,
    /// The first object on each ray, or [`NO_OBJECT`].
    pub objects: Vec<u32>,
    pub evidence: Vec<PixelEvidence>,
    /// Standard deviations of the sensor's position and rotation: metres, radians.
    pub pose_sigma: (f64, f64),
    /// The correction of the stated pose by the readings.
    pub correction: PoseCorrections,
    /// The terms of the readings, if poses of objects are uncertain.
    pub terms: Option<Terms>,
    /// Measured points that no object explains, world frame, metres.
    pub new_points: Vec<DVec3>,
    /// Number of pixels with both a reading and a predicted surface, and number of pixels among them that the
    /// prediction explains.
    pub compared: (usize, usize),
}

/// The distance to which the rays of a sensor are cast, metres.
pub(crate) fn reach_of(spec: &presight_model::sensor::SensorSpec) -> f64 {
    spec.range_max.min(MAX_REACH)
}

impl View {
    /// The sensor's class.
    pub fn class(&self) -> &str {
        &self.pixels.sensor.spec().class
    }

    /// The sensor's name.
    pub fn sensor_name(&self) -> &str {
        &self.pixels.sensor.spec().name
    }

    /// Position of the sensor, world, metres.
    pub fn origin(&self) -> DVec3 {
        self.world_from_image.translation
    }

    /// The distance to which its rays are cast, metres.
    pub fn reach(&self) -> f64 {
        reach_of(self.pixels.sensor.spec())
    }

    /// The pose of the sensor's body axes, for a pose of its image axes.
    pub fn sensor_pose(&self, world_from_image: &Pose) -> SensorPose {
        SensorPose::new(*world_from_image * body_from_image(&self.pixels.sensor).inverse())
    }

    /// The measured point of a sampled pixel, world frame; `None` without a finite reading.
    pub fn point(&self, at: usize) -> Option<DVec3> {
        let z = f64::from(self.ranges[at]);
        let ray = self.pixels.rays[at];
        (z.is_finite() && !ray.is_nan()).then(|| self.world_from_image.transform_point(z * ray))
    }

    /// The measured points that no other object explains, world frame.
    pub fn unexplained(&self, object: u32) -> impl Iterator<Item = DVec3> {
        let is_explained = move |at: &usize| {
            matches!(self.evidence[*at], PixelEvidence::Present | PixelEvidence::Ambiguous)
                && self.objects[*at] != object
        };
        (0..self.ranges.len()).filter(move |at| !is_explained(at)).filter_map(|at| self.point(at))
    }

    /// True if a ray passed through the spot of a voxel with this edge: the reading is farther by more than the voxel,
    /// or it confirms a surface of the model behind the spot, however near, such as the floor below a person's feet.
    pub fn passed(&self, spot: &Spot, size: f64) -> bool {
        let p = self.world_from_image.inverse().transform_point(spot.mean);
        let distance = p.length();
        let Some(at) = self.pixels.nearest(p) else { return false };
        let (ray, z) = (self.pixels.rays[at], f64::from(self.ranges[at]));
        let offset = ray.dot(p) * ray - p;
        let is_known = matches!(self.evidence[at], PixelEvidence::Present | PixelEvidence::Ambiguous);
        let beyond = if is_known { 0.0 } else { size };
        let sigma = self.noise.range_sigma(distance) + self.pose_sigma.0 + distance * self.pose_sigma.1;
        let reach = SAFE_REACH * self.pixels.sensor.spec().range_max;
        z > distance + beyond + NOISE_BOUND * sigma
            && distance < reach
            && spot.holds(self.world_from_image.rotation * offset)
    }
}
