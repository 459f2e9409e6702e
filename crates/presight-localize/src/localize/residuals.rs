//! What the motion between two estimated poses and odometry differ by, regressed on the motion: a scanner that is mounted
//! otherwise than stated, or clocks that differ, leave residuals that hang on speed and turning rate.
//!
//! With d the motion of the odometry in a frame (way x and y, turn t), e the estimated motion less d, and dv the change of the motion's
//! rate, to first order:
//!
//! ```text
//! e_x = a d_x + b d_y - y t + c dv_x
//! e_y = a d_y - b d_x + x t + c dv_y
//! e_t = k t + w |d| + c dv_t
//! ```
//!
//! A scanner that is turned by q farther left than stated, and odometry of scale s, leave a = s cos q - 1 and b = s sin q: the
//! estimated heading is off by q, so the robot seems to drive to the right of it. A scanner that is mounted by (x, y) farther ahead
//! and left than stated moves the estimated origin by as much, and turns about another point. Scans that are taken c seconds later
//! than their stamps see the change of the rate early. Seven numbers by weighted least squares; the scatter of the residuals
//! themselves gives their deviations.

use super::velocity::rate;
use crate::motion::Vector;
use presight_model::geometry::Pose;
use presight_model::matrix::{cholesky, solve_factored};
use presight_model::measured::Motion;

/// a, b, x, y, c, k, w.
const N: usize = 7;
/// Motions from which figures are taken.
const LEAST: usize = 30;
/// A figure counts if it exceeds this multiple of its deviation: by chance one in a million, for each of four.
const SURE: f64 = 5.0;
/// It must also exceed the usual error of a calibration: metres, radians, seconds.
const MATTERS: (f64, f64, f64) = (0.01, 0.006, 0.005);

/// Usual deviations of a, b, x, y, c, k and w, for a fit of the time alone: scales of some per cent, a mount known to some
/// centimetres and degrees, and odometry that drifts by 0.02 rad/m.
const USUAL: [f64; N] = [0.05, 0.05, 0.05, 0.05, 0.0, 0.05, 0.02];

/// A motion, as the next one is needed to know how its rate changes.
#[derive(Clone, Copy, Debug)]
struct Seen {
    estimated: Vector,
    odometry: Vector,
    seconds: f64,
    /// Deviations of way and turn.
    sigmas: [f64; 2],
    /// Rate of the motion before, per second.
    before: Option<Vector>,
}

/// Sums over the motions of a drive.
#[derive(Clone, Debug)]
pub struct Residuals {
    information: [[f64; N]; N],
    right: [f64; N],
    squares: f64,
    rows: usize,
    last: Option<Seen>,
    after_stamp: f64,
}

/// A figure and its deviation.
pub type Figure = (f64, f64);

/// What the residuals say of mount and clock.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Misfit {
    /// By how much the scanner is turned farther left than stated, radians.
    pub turned: Figure,
    /// By how much it is mounted farther ahead, metres.
    pub ahead: Figure,
    /// By how much it is mounted farther left, metres.
    pub left: Figure,
    /// By how much later than their stamps scans are taken, by the clock of the odometry, seconds.
    pub late: Figure,
}

impl Residuals {
    /// For a scanner whose scans are dated `after_stamp` seconds after their stamps.
    pub fn new(after_stamp: f64) -> Self {
        let (information, right) = ([[0.0; N]; N], [0.0; N]);
        Self { information, right, squares: 0.0, rows: 0, last: None, after_stamp }
    }

    /// Takes in a motion between two poses that were both tracked, and the odometry between them.
    pub fn add(&mut self, previous_from_current: &Pose, odometry: &Motion, seconds: f64) {
        let measured = rate(&odometry.previous_from_current, seconds);
        if let Some(last) = self.last {
            self.take(&last, &measured);
        }
        let estimated = rate(previous_from_current, seconds).map(|x| x * seconds);
        let sigma = |i: usize| odometry.covariance[i][i].max(1e-12).sqrt();
        let before = self.last.map(|last| last.odometry.map(|x| x / last.seconds));
        let odometry = measured.map(|x| x * seconds);
        self.last = Some(Seen { estimated, odometry, seconds, sigmas: [sigma(0), sigma(5)], before });
    }

    /// Forgets the last motion: the next one does not follow it.
    pub fn interrupt(&mut self) {
        self.last = None;
    }

    fn take(&mut self, seen: &Seen, after: &Vector) {
        let Some(before) = seen.before else { return };
        let (d, e) = (&seen.odometry, |i: usize| seen.estimated[i] - seen.odometry[i]);
        // From the middle of the motion before to that of the one after are two motions.
        let change = |i: usize| 0.5 * (after[i] - before[i]);
        let (x, y, turn) = (d[0], d[1], d[5]);
        let way = x.hypot(y);
        let rows: [([f64; N], f64, f64); 3] = [
            ([x, y, 0.0, -turn, change(0), 0.0, 0.0], e(0), seen.sigmas[0]),
            ([y, -x, turn, 0.0, change(1), 0.0, 0.0], e(1), seen.sigmas[0]),
            ([0.0, 0.0, 0.0, 0.0, change(5), turn, way], e(5), seen.sigmas[1]),
        ];
        for (row, residual, sigma) in rows {
            let weight = 1.0 / (sigma * sigma);
            for i in 0..N {
                (0..N).for_each(|j| self.information[i][j] += weight * row[i] * row[j]);
                self.right[i] += weight * row[i] * residual;
            }
            self.squares += weight * residual * residual;
            self.rows += 1;
        }
    }

    /// The figures; `None` while there are too few motions, or none that turn and change.
    pub fn misfit(&self) -> Option<Misfit> {
        self.misfit_of(LEAST, &[0.0; N])
    }

    /// How long after their stamps scans are taken in the mean, by the clock of the odometry, seconds, from `least` motions on. Mount
    /// and odometry are taken to be as good as usual.
    pub(super) fn after_stamp(&self, least: usize) -> Option<Figure> {
        self.misfit_of(least, &USUAL).map(|misfit| (misfit.late.0 + self.after_stamp, misfit.late.1))
    }

    /// `known` has the standard deviations of the numbers before the drive; 0 if nothing is known of one.
    fn misfit_of(&self, least: usize, known: &[f64; N]) -> Option<Misfit> {
        if self.rows < 3 * least {
            return None;
        }
        // A number that no motion determines keeps its place, with a large deviation.
        let mut information = self.information;
        (0..N).for_each(|i| information[i][i] += 1e-6);
        let l = cholesky(&information, |x| (x > 0.0).then_some(x))?;
        let found = solve_factored(&l, &self.right);
        let explained: f64 = found.iter().zip(&self.right).map(|(x, r)| x * r).sum();
        let scatter = (self.squares - explained).max(0.0) / (self.rows - N) as f64;
        (0..N).filter(|i| known[*i] > 0.0).for_each(|i| information[i][i] += scatter / known[i].powi(2));
        let l = cholesky(&information, |x| (x > 0.0).then_some(x))?;
        let found = solve_factored(&l, &self.right);
        let sigma = |i: usize| {
            let unit: [f64; N] = std::array::from_fn(|j| if i == j { 1.0 } else { 0.0 });
            (scatter * solve_factored(&l, &unit)[i].max(0.0)).sqrt()
        };
        let [a, b, x, y, c, ..] = found;
        let scale = (1.0 + a).hypot(b).max(0.1);
        Some(Misfit {
            turned: (b.atan2(1.0 + a), sigma(1) / scale),
            ahead: (x, sigma(2)),
            left: (y, sigma(3)),
            late: (c - self.after_stamp, sigma(4)),
        })
    }

    /// One line for each figure that is sure and that matters.
    pub fn warnings(&self) -> Vec<String> {
        self.warnings_but(false)
    }

    /// [`Self::warnings`], without that of the clock if its cause `is_known`.
    pub(super) fn warnings_but(&self, is_known: bool) -> Vec<String> {
        let Some(Misfit { turned, ahead, left, late }) = self.misfit() else { return Vec::new() };
        let (metres, radians, seconds) = MATTERS;
        let is_sure = |(x, sigma): Figure, least: f64| x.abs() > least && x.abs() > SURE * sigma;
        let side = |x: f64, positive: &'static str, negative: &'static str| if x > 0.0 { positive } else { negative };
        let mount = "correct the mount in the sensor file";
        let mut lines = Vec::new();
        if is_sure(turned, radians) {
            let (degrees, sigma) = (turned.0.to_degrees(), turned.1.to_degrees());
            let (side, degrees) = (side(degrees, "left", "right"), degrees.abs());
            lines.push(format!("the scanner seems mounted {degrees:.1} +- {sigma:.1} degrees farther {side}; {mount}"));
        }
        for ((x, sigma), sides) in [(ahead, ("ahead", "back")), (left, ("left", "right"))] {
            if is_sure((x, sigma), metres) {
                let side = side(x, sides.0, sides.1);
                lines.push(format!("the scanner seems mounted {:.3} +- {sigma:.3} m farther {side}; {mount}", x.abs()));
            }
        }
        if is_sure(late, seconds) && !is_known {
            let (ms, sigma) = (1e3 * late.0, 1e3 * late.1);
            let side = side(ms, "later", "earlier");
            let what = format!(
                "the scans seem taken {:.0} +- {sigma:.0} ms {side} than their stamps, by the odometry",
                ms.abs()
            );
            lines.push(format!("{what}; correct the stamps, or state stamp_sigma_s in the sensor file"));
        }
        lines
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::localize::along;
    use glam::DVec3;
    use presight_model::geometry::PoseCovariance;
    use presight_model::random::SplitMix64;

    /// The speed and the turning rate of a robot that starts, stops and winds, per second.
    fn driving(t: f64) -> Vector {
        [0.5 + 0.4 * (0.7 * t).sin(), 0.0, 0.0, 0.0, 0.0, 0.6 * (0.9 * t).sin()]
    }

    /// 30 s at 10 Hz: the robot's true poses, and the poses of its scanner, which is `late` and not mounted as stated.
    fn drive(mount_error: Pose, late: f64, noise: f64) -> Residuals {
        let step = 0.002;
        let mut poses = vec![Pose::IDENTITY];
        (0..16_000).for_each(|k| poses.push(poses[k] * along(&driving(step * k as f64), step)));
        let at = |t: f64| poses[(t / step).round() as usize];
        let (mut residuals, mut random) = (Residuals::new(0.0), SplitMix64(5));
        let mut seen = |t: f64| {
            let off =
                Pose { translation: DVec3::new(random.normal(noise), random.normal(noise), 0.0), ..Pose::IDENTITY };
            at(t + late) * mount_error * off
        };
        let mut before = seen(0.1);
        for k in 2..300 {
            let t = 0.1 * f64::from(k);
            let now = seen(t);
            let odometry = at(t - 0.1).inverse() * at(t);
            let covariance = PoseCovariance::from_sigmas([0.01, 0.01, 0.01, 0.005, 0.005, 0.005]);
            residuals.add(&(before.inverse() * now), &Motion { previous_from_current: odometry, covariance }, 0.1);
            before = now;
        }
        residuals
    }

    #[test]
    fn a_mount_that_is_turned_is_told() {
        let turned = Pose::from_xyz_rpy(DVec3::ZERO, 0.0, 0.0, 2f64.to_radians());
        let residuals = drive(turned, 0.0, 0.001);
        let (found, sigma) = residuals.misfit().unwrap().turned;
        assert!((found.to_degrees() - 2.0).abs() < 0.15 && sigma.to_degrees() < 0.1, "{found} {sigma}");
        let lines = residuals.warnings();
        assert!(lines.len() == 1 && lines[0].contains("degrees farther left; correct the mount"), "{lines:?}");
    }

    #[test]
    fn a_mount_that_is_elsewhere_is_told() {
        let residuals = drive(Pose { translation: DVec3::new(0.3, -0.1, 0.0), ..Pose::IDENTITY }, 0.0, 0.001);
        let Misfit { ahead, left, .. } = residuals.misfit().unwrap();
        assert!((ahead.0 - 0.3).abs() < 0.01 && (left.0 + 0.1).abs() < 0.01, "{ahead:?} {left:?}");
        let lines = residuals.warnings();
        assert!(
            lines.len() == 2 && lines[0].contains("m farther ahead") && lines[1].contains("m farther right"),
            "{lines:?}"
        );
    }

    #[test]
    fn a_clock_that_differs_is_told() {
        let residuals = drive(Pose::IDENTITY, 0.02, 0.0003);
        let (late, sigma) = residuals.misfit().unwrap().late;
        assert!((late - 0.02).abs() < 0.003 && sigma < 0.003, "{late} {sigma}");
        assert!(residuals.warnings()[0].contains("ms later than their stamps"), "{:?}", residuals.warnings());
    }

    /// A correct mount gives no warning, nor does a robot that only turns; a mount turned by 180 degrees does.
    #[test]
    fn what_is_right_is_not_told_and_a_reversed_scanner_is() {
        assert_eq!(drive(Pose::IDENTITY, 0.0, 0.002).warnings(), Vec::<String>::new());
        let reversed = drive(Pose::from_xyz_rpy(DVec3::ZERO, 0.0, 0.0, 3.1), 0.0, 0.001);
        assert!((reversed.misfit().unwrap().turned.0 - 3.1).abs() < 0.02, "{:?}", reversed.misfit());
        assert!(Residuals::new(0.0).misfit().is_none());
    }
}
