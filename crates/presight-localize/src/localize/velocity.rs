//! How fast the robot moves, and how well that is known.
//!
//! The state is the pose, the twist (metres and radians per second in the robot's axes, constant between two frames) and two
//! scales: by how much odometry measures too long a way, and too wide a turn. Pose, twist and scales share one covariance. A
//! frame that corrects the pose also corrects the twist, through their covariance. In a direction that no frame has measured,
//! the speed keeps its large deviation, and the deviation of the position grows accordingly.
//!
//! Between frames the twist changes by white acceleration; its noise is stated per second, whatever the rate of the frames.
//! Odometry is a measurement of the twist (an extended Kalman filter; Maybeck, Stochastic Models, Estimation and Control,
//! volume 1, 1979, chapter 5). What the twist is at another time than in the mean between two frames, [`Velocity::within`] says.

use super::drift::variance_of_means;
use super::on_the_floor;
use super::scan::DuringScan;
use crate::estimate::Freedom;
use crate::motion::{Vector, motion_between};
use glam::DVec3;
use in_scan::Learnt;
use presight_model::geometry::{Pose, PoseCovariance, PoseEstimate, RobotPose, Twist};
use presight_model::matrix::{Matrix, apply, inverse, product, restricted, turn};
use presight_model::measured::Motion;
use presight_model::statistics::chi_squared_quantile;

mod in_scan;

/// Numbers of the state: six of the pose, six of the twist, two scales.
const N: usize = 14;
/// Where the twist begins.
const TWIST: usize = 6;
/// Where the scales begin.
const SCALES: usize = 12;

/// A covariance of the whole state.
type Joint = [[f64; N]; N];

/// How a robot's speed may change, one standard deviation each.
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
pub struct MotionNoise {
    /// Change of speed along each axis in one second, m/s; it grows with the root of the time.
    pub speed: f64,
    /// Change of the turning rate about each axis in one second, rad/s; it grows with the root of the time.
    pub turn: f64,
    /// Speed before the first motion, m/s.
    pub first_speed: f64,
    /// Turning rate before the first motion, rad/s.
    pub first_turn: f64,
    /// Relative error of the scale of odometry before anything is learnt of it.
    pub scale: f64,
    /// Change of that scale in one second.
    pub scale_drift: f64,
    /// Without odometry, the most by which a frame's motion may differ from the one before, metres: frames that are farther apart in
    /// time cannot be followed by their speed, and the stamps of some logs only count the frames.
    pub most_step: f64,
    /// The same limit for the turn of a frame, radians.
    pub most_turn: f64,
}

impl Default for MotionNoise {
    /// An acceleration of 1 m/s^2 that lasts a third of a second changes the speed of one second by `1 * sqrt(1/3)`, about
    /// 0.6 m/s, as a random walk; wheels and carts turn about as fast in rad/s. Wheels are worn by some per cent.
    fn default() -> Self {
        let (speed, turn, first_speed, first_turn) = (0.6, 0.7, 0.5, 0.3);
        let (scale, scale_drift, most_step, most_turn) = (0.05, 0.002, 0.05, 0.03);
        Self { speed, turn, first_speed, first_turn, scale, scale_drift, most_step, most_turn }
    }
}

presight_model::with_options!(
    MotionNoise:
    with_speed speed: f64,
    with_turn turn: f64,
    with_first_speed first_speed: f64,
    with_first_turn first_turn: f64,
    with_scale scale: f64,
    with_scale_drift scale_drift: f64,
    with_most_step most_step: f64,
    with_most_turn most_turn: f64,
);

/// The twist of a robot, the scales of its odometry, and their covariance with its pose.
#[derive(Clone, Debug)]
pub struct Velocity {
    noise: MotionNoise,
    twist: Vector,
    scales: [f64; 2],
    covariance: Joint,
    /// By how much odometry is worse than it states, as a factor of its variance.
    mistrust: f64,
    /// Whether odometry took part in the motion that the next frame is compared with.
    by_odometry: bool,
    /// Frames that contradict odometry, and all that are compared with it.
    contradicted: (usize, usize),
    /// No motion has been seen since the start, or since the robot was found.
    is_fresh: bool,
    /// Seconds of the latest motion.
    seconds: f64,
    /// Twist and seconds of the motion before, if there was one.
    earlier: Option<(Vector, f64)>,
    /// How much the twist changes, as far as it was learnt: variance in one second, and motions that taught it.
    learnt: [(f64, f64); 6],
    /// The twist during the scan of the latest frame, and how much the twists of scans in a row differ, and the motions between them:
    /// variances in one second, and the scans that taught them.
    scan: Option<DuringScan>,
    scan_change: [Learnt; 6],
    scan_bend: [Learnt; 6],
    /// What the motions before say of the one that the next frame is compared with.
    foretold: Option<[Foretold; 6]>,
}

/// The mean of one number of the twist in a window of time, as the motions before say.
#[derive(Clone, Copy, Debug, Default)]
struct Foretold {
    mean: f64,
    /// Its variance per unit of the noise of the twist, seconds.
    window: f64,
    /// Its variance by the errors of the frames.
    noise: f64,
}

/// How the times of frames are known.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Stamps {
    /// Their error, one standard deviation, seconds.
    pub sigma: f64,
    /// By how much later than its stamp a frame counts as measured, seconds. Odometry is of the time of the stamps.
    pub late: f64,
}

/// Part by which a frame changes the mistrust of odometry.
const MISTRUST_GAIN: f64 = 0.3;
/// Greatest mistrust: a hundred times the stated deviation.
const MOST_MISTRUST: f64 = 1e4;
/// Motions that the stated noise of the twist counts as: a few frames teach more.
const STATED_MOTIONS: f64 = 4.0;
/// Part of the motions before that is forgotten in each: robots drive evenly for seconds, and then turn.
const FORGET: f64 = 0.03;
/// Least part of the stated noise of the twist: no robot moves evenly for ever.
const LEAST_CHANGE: f64 = 0.01;
/// Standard normal deviate of 1 in 10,000: odometry that is farther from a frame contradicts it.
const CONTRADICTS: f64 = 3.719;

impl MotionNoise {
    /// Variance of the change of a number of the twist in one second.
    pub(super) fn density(&self, i: usize) -> f64 {
        if i < 3 { self.speed.powi(2) } else { self.turn.powi(2) }
    }
}

impl Velocity {
    /// A robot that may stand or move.
    pub fn new(noise: MotionNoise) -> Self {
        let (mistrust, by_odometry, contradicted, is_fresh) = (1.0, false, (0, 0), true);
        let (twist, scales, covariance) = ([0.0; 6], [0.0; 2], [[0.0; N]; N]);
        let (seconds, earlier, foretold) = (0.0, None, None);
        let learnt = std::array::from_fn(|i| (noise.density(i), 0.0));
        let mut unknown = Self {
            noise,
            twist,
            scales,
            covariance,
            mistrust,
            by_odometry,
            contradicted,
            is_fresh,
            seconds,
            earlier,
            learnt,
            scan: None,
            scan_change: learnt.map(Learnt::stated),
            scan_bend: learnt.map(Learnt::stated),
            foretold,
        };
        (0..2).for_each(|k| unknown.covariance[SCALES + k][SCALES + k] = noise.scale.powi(2));
        unknown.restart();
        unknown
    }

    /// Forgets the speed of the robot, and keeps the scales of its odometry.
    pub fn restart(&mut self) {
        (self.twist, self.is_fresh) = ([0.0; 6], true);
        (self.seconds, self.earlier, self.foretold, self.scan) = (0.0, None, None, None);
        let scales: Vec<f64> = (SCALES..N).map(|i| self.covariance[i][i]).collect();
        self.covariance = [[0.0; N]; N];
        (SCALES..N).for_each(|i| self.covariance[i][i] = scales[i - SCALES]);
        (0..6).for_each(|i| self.covariance[TWIST + i][TWIST + i] = self.first(i));
    }

    fn first(&self, i: usize) -> f64 {
        if i < 3 { self.noise.first_speed.powi(2) } else { self.noise.first_turn.powi(2) }
    }

    /// Seconds of the latest motion; 0 before the first.
    pub(super) fn seconds(&self) -> f64 {
        self.seconds
    }

    /// The covariance of the twist before the first motion.
    pub(super) fn first_covariance(&self) -> Matrix {
        std::array::from_fn(|i| std::array::from_fn(|j| if i == j { self.first(i) } else { 0.0 }))
    }

    /// Metres and radians per second, in the robot's axes.
    pub fn twist(&self) -> &Vector {
        &self.twist
    }

    /// The covariance of the twist.
    pub fn twist_covariance(&self) -> Matrix {
        std::array::from_fn(|i| std::array::from_fn(|j| self.covariance[TWIST + i][TWIST + j]))
    }

    /// By how much odometry measures too long a way and too wide a turn, as parts of them, each with its deviation.
    pub fn scales(&self) -> [(f64, f64); 2] {
        [0, 1].map(|k| (self.scales[k], self.covariance[SCALES + k][SCALES + k].max(0.0).sqrt()))
    }

    /// Frames that contradict the odometry beyond 1 in 10,000, and all frames that were compared with it.
    pub fn contradicted(&self) -> (usize, usize) {
        self.contradicted
    }

    /// The change of the twist between two frames.
    fn add_change(&mut self, seconds: f64, has_odometry: bool) {
        self.foretold = self.earlier.map(|_| self.foretell(0.0, seconds));
        self.earlier = (!self.is_fresh && self.seconds > 0.0).then_some((self.twist, self.seconds));
        for i in 0..6 {
            let most = self.most_change(i, seconds, has_odometry);
            let change = (self.noise.density(i) * seconds).min(most);
            let variance = &mut self.covariance[TWIST + i][TWIST + i];
            if self.is_fresh {
                *variance = variance.min(most);
            }
            *variance += change;
        }
        (self.is_fresh, self.seconds) = (false, seconds);
    }

    /// Most variance of the twist's change between two frames.
    fn most_change(&self, i: usize, seconds: f64, has_odometry: bool) -> f64 {
        let most = if i < 3 { self.noise.most_step } else { self.noise.most_turn };
        if has_odometry { f64::INFINITY } else { (most / seconds).powi(2) }
    }

    /// The mean twist in a window of time, seconds after the latest frame (before it if negative), and its covariance.
    ///
    /// The twist of the state is the mean between the two latest frames. It goes on as it has changed from the motion before, as
    /// far as this change exceeds what frames make of it by their own errors. The acceleration is not known: with
    /// white acceleration, what the means of different windows differ by has the variance of [`variance_of_means`]. Its noise is
    /// learnt from how well each motion was foretold.
    pub(super) fn within(&self, from: f64, to: f64) -> (Vector, Matrix) {
        let (foretold, mut covariance) = (self.foretell(from, to), self.twist_covariance());
        for (i, Foretold { window, noise, .. }) in foretold.iter().enumerate() {
            covariance[i][i] += self.density(i) * window + noise;
        }
        (foretold.map(|f| f.mean), covariance)
    }

    fn foretell(&self, from: f64, to: f64) -> [Foretold; 6] {
        let seconds = self.seconds;
        std::array::from_fn(|i| {
            let mut mean = self.twist[i];
            if to <= from || seconds <= 0.0 {
                return Foretold { mean, ..Foretold::default() };
            }
            let known = self.covariance[TWIST + i][TWIST + i];
            let (mut gain, mut windows) = (0.0f64, vec![(1.0, from, to), (-1.0, -seconds, 0.0)]);
            if let Some((earlier, before)) = self.earlier {
                // By the mean of a random walk over two windows in a row.
                let change = self.density(i) * (seconds + before) / 3.0;
                let ahead = (from + to + seconds) / (seconds + before);
                gain = if change > 0.0 { ahead * change / (change + 2.0 * known) } else { 0.0 };
                mean += gain * (mean - earlier[i]);
                windows.extend([(-gain, -seconds, 0.0), (gain, -seconds - before, -seconds)]);
            }
            let (window, noise) = (variance_of_means(&windows), 2.0 * gain.abs() * (1.0 + gain.abs()) * known);
            Foretold { mean, window, noise }
        })
    }

    /// Variance of the twist's change in one second, as it was learnt.
    pub(super) fn density(&self, i: usize) -> f64 {
        let most = self.most_change(i, self.seconds, self.by_odometry) / self.seconds.max(1e-9);
        self.learnt[i].0.max(LEAST_CHANGE * self.noise.density(i)).min(most)
    }

    /// Learns how much the twist changes from what a frame makes of it, where the frame says more than the motions before.
    fn learn_density(&mut self) {
        let Some(foretold) = self.foretold.take() else { return };
        for (i, Foretold { mean, window, noise }) in foretold.into_iter().enumerate() {
            let known = self.covariance[TWIST + i][TWIST + i];
            if !(known < self.noise.density(i) * self.seconds) {
                continue;
            }
            let seen = ((self.twist[i] - mean).powi(2) - noise - 2.0 * known) / window;
            let (density, motions) = &mut self.learnt[i];
            *density += (seen - *density) * (1.0 / (STATED_MOTIONS + *motions)).max(FORGET);
            *motions += 1.0;
        }
    }

    /// The robot's motion over `seconds`, by its odometry or its own speed, and the pose that follows. The covariance of the pose
    /// includes the correlation of motion and pose; that of the motion does not. Stamps that err make the pose of a moving robot
    /// less certain, and odometry between the stamps of frames that count as measured later is that of another motion.
    pub fn carry(
        &mut self,
        belief: &PoseEstimate,
        seconds: f64,
        odometry: Option<&Motion>,
        stamps: Stamps,
        freedom: Freedom,
    ) -> (Motion, PoseEstimate) {
        let odometry = odometry.map(|odometry| self.of_stamps(odometry, seconds, stamps.late));
        self.hold(belief);
        self.by_odometry = odometry.is_some();
        self.add_change(seconds, odometry.is_some());
        (SCALES..N).for_each(|i| self.covariance[i][i] += self.noise.scale_drift.powi(2) * seconds);
        let mut pose = belief.world_from_robot;
        if let Some(odometry) = &odometry {
            let correction = self.measure(odometry, seconds);
            pose = crate::motion::moved(&pose, &restricted_vector(&correction, freedom));
        }
        let covariance =
            PoseCovariance::from_rows(self.twist_covariance().map(|row| row.map(|x| x * seconds * seconds)));
        let motion = Motion { previous_from_current: along(&self.twist, seconds), covariance };
        let by_twist = if freedom == Freedom::Planar { on_the_floor(&pose, &motion) } else { motion };
        let to = pose * by_twist.previous_from_current;
        self.spread(&pose, &to, seconds, freedom);
        // Two stamps bound the time between two frames.
        self.add_jitter(&to, 2f64.sqrt() * stamps.sigma, freedom);
        (
            odometry.unwrap_or(motion),
            PoseEstimate::new(RobotPose::new(to), PoseCovariance::from_rows(self.pose_covariance())),
        )
    }

    /// The odometry between two stamps as a measurement of the motion between two frames that count as measured `late` seconds
    /// later: with white acceleration both motions differ by a variance of its own.
    fn of_stamps(&self, odometry: &Motion, seconds: f64, late: f64) -> Motion {
        let mut measured = *odometry;
        if late != 0.0 {
            let windows = [(1.0, 0.0, seconds), (-1.0, -late, seconds - late)];
            let share = seconds * seconds * variance_of_means(&windows);
            (0..6).for_each(|i| measured.covariance[i][i] += share * self.noise.density(i));
        }
        measured
    }

    /// The pose `seconds` before a belief, with a stamp that errs by `stamp_sigma` seconds.
    pub fn before(&self, belief: &PoseEstimate, seconds: f64, stamp_sigma: f64, freedom: Freedom) -> PoseEstimate {
        let mut then = self.clone();
        then.hold(belief);
        let (twist, covariance) = self.within(-seconds, 0.0);
        (0..6).for_each(|i| then.covariance[TWIST + i][TWIST + i] = covariance[i][i]);
        then.twist = twist;
        then.led_back(belief, seconds, stamp_sigma, freedom)
    }

    /// The pose `seconds` before a belief by this twist and its covariance.
    fn led_back(mut self, belief: &PoseEstimate, seconds: f64, stamp_sigma: f64, freedom: Freedom) -> PoseEstimate {
        let from = belief.world_from_robot;
        let motion = Motion { previous_from_current: along(&self.twist, -seconds), covariance: PoseCovariance::ZERO };
        let motion = if freedom == Freedom::Planar { on_the_floor(&from, &motion) } else { motion };
        let to = from * motion.previous_from_current;
        self.spread(&from, &to, -seconds, freedom);
        self.add_jitter(&to, stamp_sigma, freedom);
        PoseEstimate::new(RobotPose::new(to), PoseCovariance::from_rows(self.pose_covariance()))
    }

    /// What the pose may be off by because its time is.
    fn add_jitter(&mut self, pose: &Pose, stamp_sigma: f64, freedom: Freedom) {
        let moving = restricted_vector(&apply(&turn(pose.rotation), &self.twist), freedom);
        for i in 0..6 {
            (0..6).for_each(|j| self.covariance[i][j] += stamp_sigma * stamp_sigma * moving[i] * moving[j]);
        }
    }

    /// Corrects the twist and the scales by a frame's correction of the pose, through their covariance.
    pub fn learn(&mut self, prior: &PoseEstimate, posterior: &PoseEstimate, freedom: Freedom) {
        let (before, after) = (prior.covariance.as_rows(), posterior.covariance.as_rows());
        let axes = freedom.axes();
        let known = inverse(before, axes);
        let off = motion_between(&prior.world_from_robot, &posterior.world_from_robot);
        let pull = apply(&known, &restricted_vector(&off, freedom));
        self.compare_odometry((0..6).map(|i| pull[i] * off[i]).sum(), axes.len());
        let shared: Vec<[f64; 6]> = (TWIST..N).map(|i| std::array::from_fn(|j| self.covariance[i][j])).collect();
        let gains: Vec<[f64; 6]> = shared.iter().map(|row| apply(&known, row)).collect();
        let change: Matrix = std::array::from_fn(|i| std::array::from_fn(|j| after[i][j] - before[i][j]));
        for (k, row) in shared.iter().enumerate() {
            let step: f64 = (0..6).map(|j| row[j] * pull[j]).sum();
            if k < 6 {
                self.twist[k] += step
            } else {
                self.scales[k - 6] += step
            }
            let moved = apply(&change, &gains[k]);
            for (l, gain) in gains.iter().enumerate() {
                self.covariance[TWIST + k][TWIST + l] += (0..6).map(|j| moved[j] * gain[j]).sum::<f64>();
            }
        }
        for (k, gain) in gains.iter().enumerate() {
            let with = apply(after, gain);
            (0..6).for_each(|j| {
                self.covariance[TWIST + k][j] = with[j];
                self.covariance[j][TWIST + k] = with[j];
            });
        }
        (0..6).for_each(|i| self.covariance[i][..6].copy_from_slice(&after[i]));
        self.keep_positive();
        self.learn_density();
    }

    /// Trusts odometry the less the farther frames lead from where it has led, in squared deviations.
    fn compare_odometry(&mut self, squared: f64, axes: usize) {
        if !self.by_odometry {
            return;
        }
        let is_far = squared > chi_squared_quantile(axes as u32, CONTRADICTS);
        // Mistrust begins with a contradiction; by chance alone the mean is a little high.
        if is_far || self.mistrust > 1.0 {
            let change = MISTRUST_GAIN * (squared / axes as f64 - 1.0);
            self.mistrust = (self.mistrust * (1.0 + change)).clamp(1.0, MOST_MISTRUST);
        }
        self.contradicted = (self.contradicted.0 + usize::from(is_far), self.contradicted.1 + 1);
    }

    /// Takes over a pose that came from elsewhere: it shares nothing with the twist.
    fn hold(&mut self, belief: &PoseEstimate) {
        let rows = belief.covariance.as_rows();
        if self.pose_covariance() == *rows {
            return;
        }
        for i in 0..6 {
            self.covariance[i] = [0.0; N];
            self.covariance[i][..6].copy_from_slice(&rows[i]);
            (TWIST..N).for_each(|j| self.covariance[j][i] = 0.0);
        }
    }

    fn pose_covariance(&self) -> Matrix {
        std::array::from_fn(|i| std::array::from_fn(|j| self.covariance[i][j]))
    }

    /// Odometry measures the twist times the seconds, too long by the scales. Returns its correction of the pose before.
    fn measure(&mut self, odometry: &Motion, seconds: f64) -> Vector {
        let measured = rate(&odometry.previous_from_current, seconds).map(|x| x * seconds);
        let scale = |i: usize| 1.0 + self.scales[i / 3];
        // Row i of H has two entries: of the twist, and of the scale.
        let entries: [(usize, [(usize, f64); 2]); 6] =
            std::array::from_fn(|i| (i, [(TWIST + i, seconds * scale(i)), (SCALES + i / 3, measured[i] / scale(i))]));
        let innovation: Vector = std::array::from_fn(|i| measured[i] - seconds * scale(i) * self.twist[i]);
        // P H': what every number of the state shares with the measurement.
        let shared: Vec<[f64; 6]> = (0..N)
            .map(|n| entries.map(|(_, row)| row.iter().map(|(at, h)| self.covariance[n][*at] * h).sum()))
            .collect();
        let noise = odometry.covariance.as_rows().map(|row| row.map(|x| self.mistrust * x));
        let total: Matrix = std::array::from_fn(|i| {
            std::array::from_fn(|j| entries[i].1.iter().map(|(at, h)| h * shared[*at][j]).sum::<f64>() + noise[i][j])
        });
        let known = inverse(&total, &[0, 1, 2, 3, 4, 5]);
        let pull = apply(&known, &innovation);
        let steps: Vec<f64> = shared.iter().map(|row| (0..6).map(|j| row[j] * pull[j]).sum()).collect();
        let gains: Vec<[f64; 6]> = shared.iter().map(|row| apply(&known, row)).collect();
        for (n, gain) in gains.iter().enumerate() {
            for (m, row) in shared.iter().enumerate() {
                self.covariance[n][m] -= (0..6).map(|j| gain[j] * row[j]).sum::<f64>();
            }
        }
        (0..6).for_each(|i| self.twist[i] += steps[TWIST + i]);
        (0..2).for_each(|k| self.scales[k] += steps[SCALES + k]);
        self.keep_positive();
        std::array::from_fn(|i| steps[i])
    }

    /// The covariance after a motion: a turn of the robot moves where it is now, and so does its twist.
    fn spread(&mut self, from: &Pose, to: &Pose, seconds: f64, freedom: Freedom) {
        let arm = to.translation - from.translation;
        let mut step = [[0.0; N]; N];
        (0..N).for_each(|i| step[i][i] = 1.0);
        (step[0][4], step[0][5]) = (arm.z, -arm.y);
        (step[1][3], step[1][5]) = (-arm.z, arm.x);
        (step[2][3], step[2][4]) = (arm.y, -arm.x);
        let axes = freedom.axes();
        let turned = product(
            &turn(from.rotation),
            &std::array::from_fn(|i| std::array::from_fn(|j| if i == j { seconds } else { 0.0 })),
        );
        axes.iter().for_each(|i| step[*i][TWIST..SCALES].copy_from_slice(&turned[*i]));
        // The other rows are rows of the identity.
        let mut half = self.covariance;
        (0..6)
            .for_each(|i| half[i] = std::array::from_fn(|j| (0..N).map(|k| step[i][k] * self.covariance[k][j]).sum()));
        let mut whole = half;
        for i in 0..N {
            (0..6).for_each(|j| whole[i][j] = (0..N).map(|k| half[i][k] * step[j][k]).sum());
        }
        for i in (0..6).filter(|i| !axes.contains(i)) {
            (0..N).for_each(|j| (whole[i][j], whole[j][i]) = (0.0, 0.0));
        }
        self.covariance = whole;
        self.keep_positive();
    }

    /// Rounding leaves neither asymmetry nor negative variances.
    fn keep_positive(&mut self) {
        for i in 0..N {
            self.covariance[i][i] = self.covariance[i][i].max(0.0);
            for j in 0..i {
                let most = (self.covariance[i][i].max(0.0) * self.covariance[j][j].max(0.0)).sqrt();
                let mean = (0.5 * (self.covariance[i][j] + self.covariance[j][i])).clamp(-most, most);
                (self.covariance[i][j], self.covariance[j][i]) = (mean, mean);
            }
        }
    }
}

fn restricted_vector(v: &Vector, freedom: Freedom) -> Vector {
    let ones = restricted(&[[1.0; 6]; 6], freedom.axes());
    std::array::from_fn(|i| v[i] * ones[i][i])
}

/// The motion of a constant twist over `seconds`: previous_from_current.
pub fn along(twist: &Vector, seconds: f64) -> Pose {
    twist_of(twist).over(seconds)
}

/// The constant twist that leads to a pose in `seconds`: the inverse of [`along`].
pub fn rate(previous_from_current: &Pose, seconds: f64) -> Vector {
    let Twist { linear, angular } = Twist::to(previous_from_current, seconds);
    [linear.x, linear.y, linear.z, angular.x, angular.y, angular.z]
}

/// Six numbers as a twist.
pub fn twist_of([x, y, z, rx, ry, rz]: &Vector) -> Twist {
    Twist::new(DVec3::new(*x, *y, *z), DVec3::new(*rx, *ry, *rz))
}

#[cfg(test)]
#[path = "velocity_tests.rs"]
mod tests;
