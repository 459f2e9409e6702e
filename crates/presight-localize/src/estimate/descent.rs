//! Gauss-Newton steps from a start to rest, within one prediction.

use super::image::ImageSource;
use super::normal::{Freedom, Normal};
use super::range::RangeSource;
use super::run::{Expectation, FrameMeasurement, Minimum, Run, Start};
use super::scan_twist::{self, ScanStep};
use super::solve::length;
use super::{Gate, Kernel, Residuals};
use crate::motion::{Vector, motion_between, moved};
use crate::verdict::{ExpectedImage, body_from_image};
use presight_model::geometry::Pose;
use presight_model::matrix::{apply, quadratic};
use std::sync::Arc;

/// Points that the wide search looks at.
const SEARCH_POINTS: usize = 2000;
/// Points that a search from a far end looks at.
const FAR_POINTS: usize = 500;
/// Points that the first steps after a prediction look at: they need not be exact.
const APPROACH_POINTS: usize = 5000;
/// Steps that are smaller change nothing any more, metres and radians.
const AT_REST: f64 = 2e-6;
/// Square of half a standard deviation, of independent errors. After a step that is smaller one more is worth while, which is a fifth of it, as
/// the weights of the kernel follow.
const CLOSE: f64 = 0.25;
/// A step that is a smaller part of the gate leaves nothing to find at this width: the gate narrows faster.
const STILL: f64 = 0.05;
/// By how much faster, as steps at once.
const HASTE: i32 = 4;
/// Steps in which the kernel redescends on few points. With all of them little is left to find.
const FEW: usize = 3;
/// A prediction serves for poses that its rays turn by less than this part of a pixel for.
const SERVES: f64 = 0.5;
/// Matches are kept while the measured points move less than this part of a pixel.
const KEPT: f64 = 0.05;

/// How the gate narrows over the steps from one prediction.
pub(super) struct Schedule {
    first: f64,
    shrink: f64,
    least: f64,
    steps: usize,
    /// From this step on the kernel redescends.
    settle: usize,
    /// Most points that steps look at, and those from [`FEW`] steps after `settle` on.
    points: (usize, usize),
}

/// From the prior, as wide as it is.
pub(super) const SEARCH: Schedule =
    Schedule { first: 1.0, shrink: 0.8, least: 0.15, steps: 12, settle: usize::MAX, points: (SEARCH_POINTS, 0) };
/// The same with few points, to see where a start leads.
pub(super) const LOOK: Schedule = Schedule { points: (FAR_POINTS, 0), ..SEARCH };
/// From a start that is one of many, with few points: a gate as wide as the prior would draw neighbouring minima into one.
pub(super) const LOOK_NEAR: Schedule = Schedule { first: 0.3, ..LOOK };
/// In a prediction at the pose that a search found.
pub(super) const SETTLE: Schedule =
    Schedule { first: 0.2, shrink: 0.5, least: 0.01, steps: 13, settle: 4, points: (APPROACH_POINTS, usize::MAX) };

/// The same with few points, for minima that are compared: most of them are left.
pub(super) const JUDGE: Schedule = Schedule { points: (SEARCH_POINTS, SEARCH_POINTS), ..SETTLE };

/// Steps from a start to rest, or until they come to a pose that is `known`.
pub(super) fn descend(
    run: &Run<'_>,
    expected: &Arc<Expectation>,
    start: impl Into<Start>,
    schedule: &Schedule,
    freedom: Freedom,
    known: impl Fn(&Pose) -> bool,
) -> Minimum {
    let sources = sources(run, &expected.images);
    let images = images(run, expected);
    let Start { pose, twist } = start.into();
    let mut end = Minimum { pose, expected: expected.clone(), normal: Normal::default(), spread: 1.0, twist };
    // How late the latest point is, seconds.
    let latest = run.measured.iter().flat_map(|m| &m.points).fold(0.0f32, |most, p| most.max(p.late.abs()));
    let latest = if run.twist_prior.is_some() { f64::from(latest) } else { 0.0 };
    let (mut factor, mut rests) = (schedule.first, false);
    // Where few points are all there are, they are looked at at once.
    let mut few = if run.measured.iter().all(|m| m.points.len() <= schedule.points.0) { 0 } else { FEW };
    let mut matches: Vec<Vec<u32>> = vec![Vec::new(); sources.len()];
    let pitch = sources.iter().map(RangeSource::pitch).fold(f64::INFINITY, f64::min);
    // How far the measured points moved since they were matched, radians.
    let mut since = 0.0;
    for k in 0..schedule.steps {
        let settled = k >= schedule.settle;
        let whole = settled && few == 0;
        let last = k + 1 == schedule.steps || rests;
        let kernel = if settled { Kernel::Redescending { spread: end.spread } } else { Kernel::Wide };
        let gate = Gate {
            translation: factor * run.extent.0,
            rotation: factor * run.extent.1,
            kernel,
            points: if whole { schedule.points.1 } else { schedule.points.0 },
            finally: last && schedule.settle < schedule.steps,
        };
        if k <= schedule.settle || since > KEPT * pitch {
            matches.iter_mut().for_each(Vec::clear);
            since = 0.0;
        }
        let mut normal = Normal::default();
        for (source, matches) in sources.iter().zip(&mut matches) {
            normal.add(&source.linearize_keeping(
                &end.pose,
                run.twist_prior.as_ref().map(|_| &end.twist),
                &gate,
                matches,
            ));
        }
        images.iter().for_each(|source| normal.add(&source.linearize(&end.pose, &gate)));
        end.spread = (1.4826 * normal.spread).clamp(1.0, 3.0);
        end.normal = normal;
        if last && !rests {
            break;
        }
        let (step, twist) = step(&end.normal, run, &end, freedom);
        end.pose = moved(&end.pose, &step);
        (0..6).for_each(|i| end.twist[i] += twist[i]);
        // The way of the latest point.
        let step: Vector = std::array::from_fn(|i| step[i].abs() + latest * twist[i].abs());
        if last {
            break;
        }
        if schedule.settle == usize::MAX {
            end.pose = run.within_reach(&end.pose);
        }
        if known(&end.pose) {
            break;
        }
        let (metres, radians) = (length(&step[..3]), length(&step[3..]));
        since += metres / run.reach + radians;
        let still = metres < STILL * gate.translation && radians < STILL * gate.rotation;
        // With the least gate every further step is like this one.
        let least = factor <= schedule.least;
        if least && still && schedule.settle == usize::MAX {
            break;
        }
        if settled {
            let at_rest = is_at_rest(run, &end.normal, &step, images.is_empty());
            rests = least && at_rest && whole;
            few = if at_rest { 0 } else { few.saturating_sub(1) };
        }
        let narrower = if still { schedule.shrink.powi(HASTE) } else { schedule.shrink };
        factor = (factor * narrower).max(schedule.least);
    }
    end
}

/// True if a step leaves next to nothing to the ones after it. Features make up for few residuals: each of them counts.
fn is_at_rest(run: &Run<'_>, normal: &Normal, step: &Vector, by_ranges: bool) -> bool {
    let known = || quadratic(&normal.information, step) + quadratic(&run.prior_information, step);
    if by_ranges { known() < CLOSE } else { step.iter().all(|x| x.abs() < AT_REST) }
}

/// What was matched in each frame in which features are looked for.
pub(super) fn images<'a>(run: &'a Run<'_>, expected: &Expectation) -> Vec<ImageSource<'a>> {
    let seen = expected.findings.iter().zip(&run.looked);
    seen.map(|(found, frame)| ImageSource::of_findings(frame.sensor(), found)).collect()
}

fn sources<'a>(run: &'a Run<'_>, expected: &'a [ExpectedImage]) -> Vec<RangeSource<'a>> {
    let source = |(e, m): (&'a ExpectedImage, &'a FrameMeasurement<'_>)| {
        let source = RangeSource::new(e, &m.points, m.noise);
        let source = if run.learns_sigma {
            source.with_learnt_sigma(run.model_sigma)
        } else {
            source.with_model_sigma(run.model_sigma)
        };
        match run.only {
            Some(object) => source.only(object),
            None => source,
        }
    };
    expected.iter().zip(&run.measured).map(source).collect()
}

/// The Gauss-Newton step of the pose, with the prior, and of the twist during the scan if it is estimated.
fn step(normal: &Normal, run: &Run<'_>, at: &Minimum, freedom: Freedom) -> (Vector, Vector) {
    let off = motion_between(&run.prior.world_from_robot, &at.pose);
    match &run.twist_prior {
        Some(known) => {
            let pull = apply(&run.prior_information, &off);
            let ScanStep { pose, twist } =
                scan_twist::step(normal, (&run.prior_information, &pull), (known, &at.twist), freedom);
            (pose, twist)
        }
        None => (normal.equations().step(&run.prior_information, &off, freedom.axes()).0, [0.0; 6]),
    }
}

/// True if a prediction serves for estimates at a pose: it shows what is seen from there but for a part of a pixel. What is found of
/// features depends on how well the pose is known, too.
pub(super) fn serves(run: &Run<'_>, expected: &Expectation, pose: &Pose) -> bool {
    let near = |(e, m): (&ExpectedImage, &FrameMeasurement<'_>)| {
        let now = *pose * m.frame.sensor().spec().mount * body_from_image(m.frame.sensor());
        let off = motion_between(&e.world_from_image, &now);
        length(&off[..3]) / run.reach + length(&off[3..]) < SERVES * e.spacing.0.min(e.spacing.1)
    };
    run.looked.is_empty() && expected.images.iter().zip(&run.measured).all(near)
}
