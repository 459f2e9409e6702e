//! Two predictions of one view, compared pixel by pixel: which pixels are equal, at an accepted edge or tie, or wrong.

use presight::files::ImageFile;
use presight_model::error::{Error, Result};
use presight_model::geometry::SensorPose;
use presight_model::measured::{ScanMotion, ScanPoses};
use presight_model::sensor::Sensor;
use presight_model::world::World;
use presight_render::plan::{FramePlan, IdScheme, ImageRequest, Images, PlanBuffers};
use presight_render::verify;
pub use presight_render::verify::{Precision, Report};

/// The model and the view of both predictions: they tell edges, ties and rounding from wrong pixels.
#[derive(Clone, Debug)]
pub struct View {
    /// The world.
    pub world: World,
    /// The sensor.
    pub sensor: Sensor,
    /// The pose of the sensor.
    pub pose: SensorPose,
    /// The motion of the robot during the scan; `None` if it stood.
    pub motion: Option<ScanMotion>,
    /// What the ids of the images count.
    pub ids: IdScheme,
    /// The precision of the images to check.
    pub precision: Precision,
}

/// Compares the images of two files. Without a view, every difference is a fault. A file whose prediction gave up a
/// part for a deadline is compared where it was predicted.
///
/// # Errors
/// [`presight_model::ErrorKind::Invalid`] if the files hold different images, or both gave up a part.
pub fn compare(reference: &ImageFile, other: &ImageFile, view: Option<&View>) -> Result<Report> {
    let compare = |a: &Images, b: &Images| match view {
        None => verify::compare_exactly(a, b),
        Some(view) => {
            let request = ImageRequest { outputs: reference.images.outputs(), ids: view.ids };
            let (world, sensor, pose) = (&view.world, &view.sensor, view.pose.world_from_sensor());
            let plan = match ScanPoses::new(sensor, &pose, view.motion.as_ref())? {
                Some(poses) => FramePlan::in_bundles(PlanBuffers::default(), world, sensor, &pose, request, poses)?,
                None => FramePlan::new(world, sensor, &pose, request)?,
            };
            verify::compare(a, b, &plan, view.precision)
        }
    };
    let (a, b) = (&reference.images, &other.images);
    match (&reference.attributes.given_up, &other.attributes.given_up) {
        (None, None) => compare(a, b),
        (None, Some(_)) => verify::compare_partial(a, b, compare),
        (Some(_), None) => verify::compare_partial(b, a, |b, a| compare(a, b)),
        (Some(_), Some(_)) => {
            Err(Error::invalid("both files are incomplete because of a deadline", "compare with a full prediction"))
        }
    }
}
