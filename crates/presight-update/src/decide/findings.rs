//! Findings: the differences between model and site.

use crate::decide::boxes::UprightBox;
use crate::decide::shapes::Recognized;
use crate::observe::priors::own_bounds;
use glam::DVec3;
use presight_model::environment::Environment;
use presight_model::geometry::{Aabb, Pose, SensorPose};
use std::fmt;

/// The kind of a difference between model and site.
#[derive(Clone, Debug, PartialEq)]
pub enum FindingKind {
    /// An object is gone.
    Gone,
    /// An object was moved.
    Moved {
        /// Its new pose.
        world_from_object: Pose,
        /// Distance that the centre of its bounds moved, metres.
        distance: f64,
    },
    /// An unknown object stands where the model is empty; this box is around its points.
    New(UprightBox),
    /// An object of a known shape stands where the model is empty.
    Recognized(Recognized),
    /// A part of a large object is gone; its box is in the object's frame.
    Part(Aabb),
    /// Sensors of this class see through an object, such as glass. Other sensors see it, or the same sensors at grazing
    /// incidence.
    SeenThrough(String),
    /// An object is present at times and absent at others, such as a door.
    ComesAndGoes,
}

/// A difference between model and site with decisive evidence.
#[derive(Clone, Debug, PartialEq)]
pub struct Finding {
    /// Path of the object; empty for a new object.
    pub object: String,
    /// The kind of the difference.
    pub kind: FindingKind,
    /// Log-odds that support it, positive.
    pub l: f64,
    /// Number of views that support it.
    pub views: u32,
    /// The view that shows it best.
    pub best_view: Option<BestView>,
    /// Log-odds of the object after each view.
    pub growth: Vec<f32>,
}

/// The finding in one line, with its evidence.
impl fmt::Display for Finding {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { object, kind, l, views, .. } = self;
        match kind {
            FindingKind::Gone => write!(f, "gone: {object}")?,
            FindingKind::Moved { distance, .. } => write!(f, "moved: {object} by {distance:.3} m")?,
            FindingKind::New(found) => {
                let (s, at) = (found.size, place(found.pose.translation));
                write!(f, "new: {:.2} x {:.2} x {:.2} m at {at}", s.x, s.y, s.z)?;
            }
            FindingKind::Recognized(known) => {
                let (at, (_, _, yaw)) = (place(known.world_from_object.translation), known.world_from_object.rpy());
                write!(f, "new: {} at {at}, yaw {:.1} degrees", known.shape.name(), yaw.to_degrees())?;
            }
            FindingKind::SeenThrough(class) => write!(f, "seen through by sensors of class {class}: {object}")?,
            FindingKind::ComesAndGoes => write!(f, "comes and goes: {object}")?,
            FindingKind::Part(b) => write!(f, "part gone: {object} from {:.1} to {:.1} in its frame", b.min, b.max)?,
        }
        write!(f, " (log-odds {l:.1}, {views} views)")
    }
}

/// A place to the centimetre, without a negative zero.
fn place(p: DVec3) -> String {
    let [x, y, z] = p.to_array().map(|v| (100.0 * v).round() / 100.0 + 0.0);
    format!("{x:.2},{y:.2},{z:.2}")
}

/// The view that shows a finding best.
#[derive(Clone, Debug, PartialEq)]
pub struct BestView {
    /// Number of the drive, from 0.
    pub drive: usize,
    /// Name of the sensor.
    pub sensor: String,
    /// Stamp of the frame, seconds.
    pub stamp: f64,
    /// Pose of the sensor.
    pub pose: SensorPose,
}

/// A free pose from which a reading would decide a question.
#[derive(Clone, Debug, PartialEq)]
pub struct PlannedView {
    /// Name of the sensor.
    pub sensor: String,
    /// Pose of the sensor.
    pub pose: SensorPose,
    /// Expected logarithm of the likelihood ratio of its reading, with the object to without it.
    pub odds: f64,
}

/// An object with undecided evidence.
#[derive(Clone, Debug, PartialEq)]
pub struct DoubtfulObject {
    /// Path of the object.
    pub object: String,
    /// The reason for the doubt.
    pub why: String,
    /// The free pose from which predictions with and without it differ most; `None` if no pose shows it.
    pub view: Option<PlannedView>,
}

/// All differences between a model and the site of its drives.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct SiteFindings {
    /// The differences, by kind, and by falling odds within each kind.
    pub changes: Vec<Finding>,
    /// Objects with undecided evidence.
    pub doubts: Vec<DoubtfulObject>,
    /// Objects whose presence is confirmed.
    pub confirmed: Vec<String>,
    /// Number of objects without evidence.
    pub unseen: usize,
    /// The reason why the model cannot be changed at all, if there is one.
    pub wrong: Option<String>,
}

impl Finding {
    /// The corners of boxes around the places that the finding changes, world frame, metres: both places of a moved
    /// object. Empty if the environment has no such object.
    pub fn corners(&self, environment: &Environment) -> Vec<DVec3> {
        let object = environment.object(&self.object);
        let at = |pose: &Pose| object.map_or(Vec::new(), |o| corners(&own_bounds(o), pose));
        let own = || object.map_or(Vec::new(), |o| corners(&own_bounds(o), &o.world_from_object));
        match &self.kind {
            FindingKind::Gone | FindingKind::SeenThrough(_) | FindingKind::ComesAndGoes => own(),
            FindingKind::Moved { world_from_object, .. } => [own(), at(world_from_object)].concat(),
            FindingKind::Part(bounds) => object.map_or(Vec::new(), |o| corners(bounds, &o.world_from_object)),
            FindingKind::New(found) => corners(&Aabb { min: -0.5 * found.size, max: 0.5 * found.size }, &found.pose),
            FindingKind::Recognized(known) => corners(&known.shape.bounds(), &known.world_from_object),
        }
    }
}

impl DoubtfulObject {
    /// The corners of the box around the object, world frame, metres; empty if the environment has no such object.
    pub fn corners(&self, environment: &Environment) -> Vec<DVec3> {
        environment.object(&self.object).map_or_else(Vec::new, |o| corners(&own_bounds(o), &o.world_from_object))
    }
}

fn corners(bounds: &Aabb, pose: &Pose) -> Vec<DVec3> {
    let at = |k: u32, axis: usize| if k >> axis & 1 == 0 { bounds.min[axis] } else { bounds.max[axis] };
    (0..8).map(|k| pose.transform_point(DVec3::new(at(k, 0), at(k, 1), at(k, 2)))).collect()
}

/// The order of findings: by kind, then by falling odds.
pub(crate) fn by_rank(a: &Finding, b: &Finding) -> std::cmp::Ordering {
    let rank = |f: &Finding| match f.kind {
        FindingKind::Gone => 0,
        FindingKind::Moved { .. } => 1,
        FindingKind::Recognized(_) => 2,
        FindingKind::New(_) => 3,
        FindingKind::Part(_) => 4,
        FindingKind::SeenThrough(_) => 5,
        FindingKind::ComesAndGoes => 6,
    };
    rank(a).cmp(&rank(b)).then(b.l.total_cmp(&a.l))
}
