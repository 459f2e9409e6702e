//! How long scans take, in which direction, and to which of their rays the stamps belong, from what turning scans show.
//!
//! Matched with its twist open, a scan says by how much its points move from the first column to the last
//! ([`crate::estimate::ScanTwist`]). The robot's twist v is known from the poses before and after, so this displacement
//! is d = b v with the signed duration b of a turn: a weighted regression over the frames, with the scatter of its
//! residuals. A constant delay of the poses shows against odometry only (see [`super::residuals`]): it shows where in
//! the scan the stamp is.

use super::drift::variance_of_means;
use super::residuals::Figure;
use super::scan::Still;
use super::velocity::{rate, twist_of};
use super::{Localizer, Step};
use crate::estimate::{Freedom, ScanTwist};
use crate::motion::{Vector, motion_between};
use presight_model::error::Result;
use presight_model::geometry::{Pose, PoseCovariance, PoseEstimate};
use presight_model::matrix::{Matrix, add_to, apply, inverse, product, quadratic, sandwich, scaled, turn};
use presight_model::measured::{Frame, ScanMotion};
use presight_model::sensor::{Geometry, RayTimes, Sensor, StampAt};
use presight_model::statistics::chi_squared_quantile;
use presight_model::world::World;

/// Minimum number of frames for a duration.
const MIN_FRAMES: usize = 10;
/// A duration counts if it exceeds this multiple of its deviation: by chance one in a million, and neighbouring frames
/// share errors.
const CERTAIN: f64 = 5.0;
/// Maximum relative deviation of a reported duration: the error is then below 5 % with two and a half deviations.
const EXACT: f64 = 0.02;
/// Minimum relative difference from the stated duration.
const MATTERS: f64 = 0.05;
/// The place of the stamp is reported if the second nearest place is as many deviations farther off. A wrong place
/// then needs an error of four deviations: 1 in 30,000.
const APART: f64 = 4.0;
/// Standard normal deviate of the probability that a scan without motion seems to have some: 1 in 10,000.
const VISIBLE: f64 = 3.719;
/// Room that is left to a pose while its scan's motion is estimated, one standard deviation: metres and radians of half
/// a turn.
const ROOM: (f64, f64) = (0.1, 0.05);
/// Once the duration is known, every tenth frame is examined.
const SELDOM: usize = 10;

/// The latest scan, until the next one gives the robot's twist.
#[derive(Clone, Copy, Debug)]
struct Seen {
    scan: ScanTwist,
    /// Variance of the twist's change in one second.
    density: Vector,
}

/// The sums of a drive.
#[derive(Clone, Debug, Default)]
pub(super) struct ScanTime {
    /// Sum of v' W v.
    information: f64,
    /// Sum of v' W d.
    score: f64,
    /// Sum of d' W d.
    squares: f64,
    /// Numbers behind these sums.
    rows: usize,
    frames: usize,
    /// The latest scan and the times and poses of the frames around it, oldest first.
    pending: Option<Seen>,
    poses: Vec<(f64, Pose)>,
    /// The latest scan's information.
    latest: Option<Matrix>,
    /// Error of a pose whose scan is matched as if all points were measured together, metres and radians in the
    /// robot's axes.
    bias: Vector,
    /// The sensor, and the same as if a turn took a second.
    supposed: Option<(Sensor, Sensor)>,
    /// The sensor file's duration of a turn, seconds, negative if the last column comes first, and its stamp.
    stated: (f64, StampAt),
}

impl ScanTime {
    /// For the stated duration of a scan, seconds; 0 if no duration is stated.
    pub fn new(turn_s: f64, stamp: StampAt) -> Self {
        Self { stated: (turn_s, stamp), ..Self::default() }
    }

    /// True if a frame is worth a look: the duration is not known yet, or has to be checked, and if a turn took as long
    /// as the frames are apart, in which the robot moves by `moved`, the scan would show it.
    fn is_due(&self, frame: usize, moved: &Vector, freedom: Freedom) -> bool {
        let least = chi_squared_quantile(freedom.axes().len() as u32, VISIBLE);
        if self.latest.is_some_and(|information| quadratic(&information, moved) < least) && frame > 2 {
            return false;
        }
        let is_known =
            self.frames >= 2 * MIN_FRAMES && self.turn_s().is_some_and(|(b, sigma)| sigma < EXACT * b.abs().max(0.02));
        !is_known || frame.is_multiple_of(SELDOM)
    }

    /// Takes in a frame: its time, its pose if it was tracked, and what its scan says.
    pub fn add(&mut self, time: f64, pose: Option<Pose>, scan: Option<ScanTwist>, density: Vector, freedom: Freedom) {
        let Some(pose) = pose else {
            (self.pending, self.poses) = (None, Vec::new());
            return;
        };
        self.poses.push((time, pose));
        if let ([(t0, a), (t1, b), (t2, c)], Some(seen)) = (&self.poses[..], self.pending) {
            let (first, second) = (rate(&(a.inverse() * *b), t1 - t0), rate(&(b.inverse() * *c), t2 - t1));
            let twist = std::array::from_fn(|i| 0.5 * (first[i] + second[i]));
            self.regress(&twist, &seen, [t1 - t0, t2 - t1], freedom);
        }
        if self.poses.len() > 2 {
            self.poses.remove(0);
        }
        self.latest = scan.map(|scan| scan.information).or(self.latest);
        self.pending = scan.map(|scan| Seen { scan, density });
    }

    /// A sensor as if a turn took a second, with the stamp in its middle: times are then parts of a turn.
    fn supposed(&mut self, sensor: &Sensor) -> Result<Sensor> {
        if let Some((_, supposed)) = self.supposed.as_ref().filter(|(of, _)| of.spec() == sensor.spec()) {
            return Ok(supposed.clone());
        }
        let supposed = Sensor::new(sensor.spec().clone().with_times(RayTimes::turning(1.0, StampAt::Middle)))?;
        self.supposed = Some((sensor.clone(), supposed.clone()));
        Ok(supposed)
    }

    fn regress(&mut self, twist: &Vector, seen: &Seen, [before, after]: [f64; 2], freedom: Freedom) {
        let (axes, ScanTwist { information, pull }) = (freedom.axes(), seen.scan);
        // The twist of a scan differs from the mean between the frames around it. A turn takes no longer than they are
        // apart.
        let (half, turn_s) = (0.25 * (before + after), 0.5 * (before + after));
        let window = variance_of_means(&[(1.0, -half, half), (-1.0, -before, after)]);
        let mut sum = information;
        for i in axes {
            sum[*i][*i] += 1.0 / (turn_s * turn_s * window * seen.density[*i]).max(1e-12);
        }
        // (I^-1 + C)^-1 = I - I (I + C^-1)^-1 I
        let known = inverse(&sum, axes);
        let mut weight = information;
        add_to(&mut weight, &scaled(&product(&product(&information, &known), &information), -1.0));
        let through = apply(&information, &apply(&known, &pull));
        let said: Vector = std::array::from_fn(|i| pull[i] - through[i]);
        let dot = |a: &Vector, b: &Vector| a.iter().zip(b).map(|(x, y)| x * y).sum::<f64>();
        self.information += quadratic(&weight, twist);
        self.score += dot(twist, &said);
        self.squares += dot(&apply(&inverse(&information, axes), &pull), &said);
        (self.rows, self.frames) = (self.rows + axes.len(), self.frames + 1);
    }

    /// The signed duration of a turn, seconds, and its deviation; `None` while there are too few frames, or none that
    /// move.
    pub fn turn_s(&self) -> Option<Figure> {
        if self.frames < MIN_FRAMES || !(self.information > 0.0) {
            return None;
        }
        let turn_s = self.score / self.information;
        let scatter = (self.squares - self.score * turn_s).max(0.0) / (self.rows - 1) as f64;
        Some((turn_s, (scatter.max(1.0) / self.information).sqrt()))
    }

    /// The learnt duration, if it is certain and contradicts the stated one.
    fn contradiction(&self) -> Option<Figure> {
        let (turn_s, sigma) = self.turn_s()?;
        let off = (turn_s - self.stated.0).abs();
        let is_exact = sigma < EXACT * turn_s.abs();
        (is_exact && off > CERTAIN * sigma && off > MATTERS * self.stated.0.abs()).then_some((turn_s, sigma))
    }

    /// The displacement from the first column to the last that a scan shows beyond doubt, metres and radians in the
    /// robot's axes: by the scan itself, or by the duration that was learnt.
    pub fn visible(&self, scan: Option<&ScanTwist>, twist: &Vector, freedom: Freedom) -> Option<Vector> {
        let Some(ScanTwist { information, pull }) = scan else {
            return self.contradiction().map(|(turn_s, _)| twist.map(|x| turn_s * x));
        };
        let moved = apply(&inverse(information, freedom.axes()), pull);
        let least = chi_squared_quantile(freedom.axes().len() as u32, VISIBLE);
        (quadratic(information, &moved) > least).then_some(moved)
    }

    /// A line if scans take another time than stated. `late` is how much later than their stamps scans are dated by
    /// odometry, seconds from the stamp to the middle, if that is known. The second value is true if this explains it.
    pub fn warning(&self, late: Option<Figure>) -> Option<(String, bool)> {
        let (stated_s, stated_at) = self.stated;
        let found = self.contradiction();
        let turn_s = found.or_else(|| self.turn_s().filter(|_| stated_s != 0.0)).map(|(turn_s, _)| turn_s)?;
        let at = late.and_then(|late| stamp_of(turn_s, late));
        let at = at.filter(|at| found.is_some() || *at != stated_at);
        let place = at.map(|at| match at {
            StampAt::First => ("to be stamped at their start", "stamp = \"first\""),
            StampAt::Middle => ("to be stamped in their middle", "stamp = \"middle\""),
            StampAt::Last => ("to be stamped at their end", "stamp = \"last\""),
        });
        let line = match (found, place) {
            (Some((turn_s, sigma)), place) => {
                let (said, stamp) = place.map_or((String::new(), String::new()), |(said, stamp)| {
                    (format!(" and {said}"), format!(" and {stamp}"))
                });
                let (seconds, rounded) = (turn_s.abs(), rounded(turn_s, sigma));
                format!(
                    "the scans seem to take {seconds:.3} +- {sigma:.3} s{said}: write turn_s = {rounded} (negative: last column first){stamp}"
                )
            }
            (None, Some((said, stamp))) => format!("the scans seem {said}: write {stamp}"),
            (None, None) => return None,
        };
        Some((line, at.is_some()))
    }
}

/// The place of the stamp in a scan, by the seconds from the stamp to the middle; `None` if a second place is
/// possible.
fn stamp_of(turn_s: f64, (late, sigma): Figure) -> Option<StampAt> {
    let off = |at: StampAt| (late - (0.5 - at.share()) * turn_s.abs()).abs();
    let mut places = [StampAt::First, StampAt::Middle, StampAt::Last];
    places.sort_by(|a, b| off(*a).total_cmp(&off(*b)));
    (off(places[1]) - off(places[0]) > APART * sigma).then_some(places[0])
}

/// A figure in the digits that its deviation leaves.
fn rounded(figure: f64, sigma: f64) -> String {
    let digits = (-(2.0 * sigma).log10().floor()).clamp(0.0, 3.0) as usize;
    format!("{figure:.digits$}").trim_end_matches('0').to_owned()
}

impl Localizer {
    /// Learns the duration of scans from a frame. If the sensor states no times, it returns the displacement of the
    /// points from the first column to the last, metres and radians in the robot's axes, if it is significant, and
    /// the pose in the middle of the scan.
    pub(super) fn learn_scan_time(
        &mut self,
        world: &World,
        frame: &Frame,
        step: &Step,
        still: Option<&Still>,
    ) -> Result<(Option<Vector>, Option<Pose>)> {
        let freedom = self.estimator.options.freedom;
        let is_first = self.timing.count == 0;
        let mut middle = None;
        let said = match (still, &frame.sensor().spec().times) {
            (Some(still), RayTimes::Columns { turn_s, stamp }) => {
                if is_first {
                    self.timing.scan_time = ScanTime::new(*turn_s, *stamp);
                }
                still.said.map(|said| said.per(*turn_s))
            }
            (None, _) => self.said_by_untimed(world, frame, step)?.map(|(said, pose)| {
                middle = Some(pose);
                said
            }),
            _ => None,
        };
        let is_followed = step.is_known() && !step.carried;
        let pose = is_followed.then_some(middle.unwrap_or(step.pose.world_from_robot));
        let density = std::array::from_fn(|i| self.velocity.density(i));
        self.timing.scan_time.add(step.stamp, pose, said, density, freedom);
        if still.is_some() || !can_turn(frame) {
            return Ok((None, None));
        }
        Ok((self.timing.scan_time.visible(said.as_ref(), self.velocity.twist(), freedom), middle))
    }

    /// The motion of a scan's points from the first column to the last, by the scan itself, if the log does not state when they were
    /// measured, and the pose in its middle.
    fn said_by_untimed(&mut self, world: &World, frame: &Frame, step: &Step) -> Result<Option<(ScanTwist, Pose)>> {
        let (freedom, seconds) = (self.estimator.options.freedom, self.velocity.seconds());
        let moved = self.velocity.twist().map(|x| x * seconds);
        let is_due = can_turn(frame)
            && step.is_known()
            && !step.carried
            && self.timing.scan_time.is_due(self.timing.count, &moved, freedom);
        if !is_due {
            return Ok(None);
        }
        let sensor = self.timing.scan_time.supposed(frame.sensor())?;
        let mut supposed = Frame::new(frame.stamp, sensor, frame.measurement().clone())?;
        let known = self.velocity.first_covariance();
        // The pose of another time of the turn.
        let prior = PoseEstimate::of_sigmas(step.pose.robot(), ROOM.0, ROOM.1);
        let mut so_far = [0.0; 6];
        let mut said = None;
        for _ in 0..2 {
            let motion = ScanMotion::Twist(twist_of(&so_far));
            let still = supposed.with_scan_motion(motion);
            let (estimate, scan) = self.estimator.refine_with_twist(world, &still.deskewed(0.0)?, &prior, &known)?;
            if !estimate.is_determined() {
                break;
            }
            let off = motion_between(&step.pose.world_from_robot, &estimate.pose.world_from_robot);
            self.timing.scan_time.bias = apply(&turn(step.pose.world_from_robot.rotation.conjugate()), &off);
            said = Some((scan.beyond(&so_far), estimate.pose.world_from_robot));
            so_far = scan.beyond(&so_far).with(&inverse(&known, freedom.axes()), &[0.0; 6], freedom).0;
            supposed = still;
        }
        Ok(said)
    }

    /// A pose with the uncertainty of unknown times, while the points of a scan move by `moved` in the robot's axes.
    /// The pose may belong to any time of the scan (a variance of 1/12), and the stamp to the first ray, the middle
    /// or the last (1/6). The match itself adds its bias.
    pub(super) fn widened_by_turn(&self, pose: &PoseEstimate, moved: &Vector) -> PoseEstimate {
        let axes = self.estimator.options.freedom.axes();
        let bias = &self.timing.scan_time.bias;
        let outer = std::array::from_fn(|i| std::array::from_fn(|j| 0.25 * moved[i] * moved[j] + bias[i] * bias[j]));
        let mut covariance = *pose.covariance.as_rows();
        let outer = sandwich(&turn(pose.world_from_robot.rotation), &outer);
        add_to(&mut covariance, &presight_model::matrix::restricted(&outer, axes));
        PoseEstimate::new(pose.robot(), PoseCovariance::from_rows(covariance))
    }
}

/// True if the columns of a frame may be measured one after the other, and the log does not state when.
fn can_turn(frame: &Frame) -> bool {
    let spec = frame.sensor().spec();
    let is_in_columns = match &spec.geometry {
        Geometry::Scanner(_) => true,
        Geometry::Rays(table) => table.height() > 1,
        Geometry::Camera(_) => false,
    };
    is_in_columns && frame.sensor().width() > 1 && spec.times.is_at_once() && frame.grey().is_none()
}
