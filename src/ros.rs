//! ROS 2: answers, predictions and models as messages, and bags of them. ROS need not be installed.
//!
//! A [`Record`] is a message with its topic, serialized as ROS 2 does: a [`BagWriter`] writes it into an MCAP file, and
//! a node can publish its bytes.
//!
//! ```
//! use presight::ros::{MessageOrigin, create_bag, model};
//! use presight::{Options, Output, Outputs, Predictor, Request, Scene, SensorPose};
//!
//! let scene = Scene::open("scenes/room.glb")?;
//! let camera = presight::preset("realsense-d435")?;
//! let pose = SensorPose::from_xyz_rpy(glam::DVec3::new(0.3, 0.35, 1.65), 0.0, 0.2, 0.66);
//! let wanted = MessageOrigin::outputs(&camera, Outputs::of(&[Output::ObjectId]));
//! let seen = Predictor::new(Options::default())?.predict(&scene.world, &camera, &pose, &Request::of(wanted))?;
//!
//! let folder = tempfile::tempdir()?;
//! let mut bag = create_bag(&folder.path().join("view.mcap"))?;
//! let origin = MessageOrigin::of_sensor(1_700_000_000.25, &camera);
//! bag.add(&model(scene.world.environment(), &origin.map, origin.stamp_ns)?)?;
//! bag.add(&origin.mount(&camera))?;
//! bag.add(&origin.localization(&pose.robot(&camera).world_from_robot()))?;
//! for record in origin.prediction(&camera, &seen.images, wanted)? {
//!     bag.add(&record)?;
//! }
//! bag.finish()?;
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

#[cfg(feature = "store")]
mod findings;

#[cfg(feature = "store")]
pub use findings::findings;

use presight_localize::localize::{Phase, Step};
use presight_localize::verdict::{Verdict, Verdicts};
use presight_model::error::Result;
use presight_model::geometry::PoseEstimate;
use presight_model::measured::{Frame, Measurement};
use presight_model::world::World;
use presight_predict::predict::Predictor;
use presight_render::plan::{Images, Output, Outputs};

#[doc(inline)]
pub use presight_files::ros::{
    BagWriter, MarkerKind, MessageOrigin, Record, SceneMarker, Topic, create_bag, initial_pose, measured, model,
};
#[doc(inline)]
pub use presight_read::log::bag::LiveFrames;

/// The answers of a localizer about one frame: the state and its reason on `/diagnostics`, and if the pose is known,
/// the transform on `/tf` and the pose on `/presight/pose`.
pub fn answers(step: &Step, origin: &MessageOrigin) -> Vec<Record> {
    let weak: Vec<&str> = step.estimate.weak.iter().map(|weak| weak.name.as_str()).collect();
    let level = match step.phase {
        Phase::Tracking if weak.is_empty() => 0,
        Phase::Tracking | Phase::Kept | Phase::Candidates => 1,
        Phase::Unknown | Phase::Lost => 2,
    };
    let mut values = vec![
        ("state".to_owned(), step.phase.name().to_owned()),
        ("explained".to_owned(), step.estimate.explained.to_string()),
        ("odds".to_owned(), step.odds.to_string()),
        ("fit_odds".to_owned(), step.fit_odds.map_or_else(String::new, |odds| odds.to_string())),
        ("carried".to_owned(), step.carried.to_string()),
        ("model_sigma".to_owned(), step.estimate.model_sigma.to_string()),
        ("weak".to_owned(), weak.join(", ")),
        ("candidates".to_owned(), step.candidates.len().to_string()),
    ];
    if let Some(verdicts) = step.estimate.verdicts.first() {
        let counts = Verdict::ALL.iter().zip(verdicts.counts());
        values.extend(counts.map(|(verdict, count)| (verdict.name().to_owned(), count.to_string())));
    }
    let mut records = vec![origin.status(level, format!("{}: {}", step.phase.name(), step.reason), values)];
    if step.is_known() {
        records.push(origin.localization(&step.pose.world_from_robot));
        records.push(origin.pose(&step.pose));
    }
    records
}

/// The prediction of a frame of ranges at a pose, that of the moment to which verdicts bring a scan, on
/// `/presight/predicted`, and the verdict on each of its points, on
/// `/presight/verdict`.
///
/// # Errors
/// Those of [`Predictor::predict_images`], and of [`MessageOrigin::predicted`]; [`crate::ErrorKind::Invalid`] for
/// verdicts of another frame.
pub fn comparison(
    predictor: &mut Predictor,
    world: &World,
    (frame, verdicts): (&Frame, &Verdicts),
    robot: &PoseEstimate,
    origin: &MessageOrigin,
) -> Result<Vec<Record>> {
    // The estimate is of that moment.
    let moment = frame.at_one_moment()?;
    let (frame, sensor) = (&*moment.frame, moment.frame.sensor());
    let wanted = Outputs::of(&[Output::Range, Output::ObjectId]);
    let (pose, mut images) = (robot.robot().sensor(sensor), Images::default());
    predictor.predict_images(world, sensor, &pose, MessageOrigin::outputs(sensor, wanted), &mut images)?;
    let numbers: Vec<u8> = verdicts.pixels.iter().map(|verdict| *verdict as u8).collect();
    let colors = Verdict::ALL.map(Verdict::color);
    let mut records = origin.predicted(sensor, &images)?;
    records.push(origin.verdicts(frame, &images, &verdicts.difference, &numbers, &colors)?);
    Ok(records)
}

/// A measured frame as messages of its sensor, as [`MessageOrigin::prediction`] makes them: for logs that hold no
/// messages. A grey image has none.
///
/// # Errors
/// Those of [`MessageOrigin::prediction`].
pub fn sensed(frame: &Frame, origin: &MessageOrigin) -> Result<Vec<Record>> {
    let sensor = frame.sensor();
    let (width, height) = (sensor.width(), sensor.height());
    let mut images = Images { width, height, range: frame.ranges().to_vec(), ..Images::default() };
    match frame.measurement() {
        Measurement::Grey(_) => return Ok(Vec::new()),
        Measurement::DepthZ(depth) => images.depth_z.clone_from(depth),
        Measurement::Range(_) if sensor.is_camera() => {
            let depth = |(i, range): (usize, &f32)| {
                let ray = sensor.ray(i as u32 % width, i as u32 / width);
                ray.map_or(f32::NAN, |ray| (f64::from(*range) * ray.z) as f32)
            };
            images.depth_z = frame.ranges().iter().enumerate().map(depth).collect();
        }
        Measurement::Range(_) => {}
    }
    if let Some(intensities) = frame.intensities() {
        images.echo = intensities.values().to_vec();
    }
    origin.prediction(sensor, &images, images.outputs())
}
