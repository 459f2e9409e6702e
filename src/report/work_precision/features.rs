//! Features: how much of each is seen, and how often its region of interest misses it.
//!
//! Knobs: by images or by a ray to every sample, how finely features are sampled, the sensor's resolution; for regions of
//! interest how errors go through the projection, with errors of the pose from small to large.

use super::paths::Which;
use super::timing::Timing;
use super::views::View;
use super::{One, PathNotes, Row, Truth, request};
use crate::acquire::features::{GenerateOptions, generate};
use crate::environment::FeatureShape;
use crate::error::Result;
use crate::features::{
    BoxMethod, BoxOptions, FeatureOptions, FeaturePrediction, PlacedFeature, STEP, SeenFeature, Visibility,
    VisibleInterval, place, predict_features,
};
use crate::geometry::{Aabb, Pose};
use crate::plan::{Images, Stats};
use crate::random::SplitMix64;
use crate::sensor::Sensor;
use glam::{DMat3, DQuat, DVec3};
use rayon::prelude::*;
use std::f64::consts::TAU;

/// Features are made of what is so near, metres.
const NEAR: f64 = 6.0;
/// Standard deviations of the pose: metres, degrees.
const POSE_ERRORS: [(f64, f64); 3] = [(0.01, 0.3), (0.1, 3.0), (0.2, 8.0)];
/// Times of regions of interest are told for so many.
const PER: f64 = 100.0;
/// The truth has a sample so often, pixels.
const TRUE_STEP: f64 = STEP / 8.0;
/// Visible fractions that differ by less are the same: lengths were added up in another order.
pub(super) const ROUNDING: f64 = 1e-12;
/// Points of each visible stretch that a region is to hold.
const POINTS: usize = 5;

/// Features before the sensor at one pose, and what is true of them.
struct Case<'a> {
    pose: &'a Pose,
    placed: Vec<PlacedFeature>,
    truth: FeaturePrediction,
}

/// Rows of all paths from images to features.
pub(super) fn rows(one: &mut One<'_>, truths: &[Truth], rows: &mut Vec<Row>, notes: &mut Vec<PathNotes>) -> Result<()> {
    let cases: Vec<Case<'_>> =
        one.scene.poses.iter().zip(truths).map(|(p, t)| case(one, p, t)).collect::<Result<_>>()?;
    if cases.iter().all(|c| c.placed.is_empty()) {
        return Ok(());
    }
    use Visibility::{Image, Rays};
    let paths = [
        (Which::CpuAll, Rays, STEP, View::Whole),
        (Which::CpuAll, Image, STEP / 4.0, View::Whole),
        (Which::CpuAll, Image, STEP / 2.0, View::Whole),
        (Which::CpuAll, Image, STEP, View::Whole),
        (Which::CpuAll, Image, STEP, View::Reduced(2)),
        (Which::CpuAll, Image, STEP, View::Reduced(4)),
        (Which::Gpu, Image, STEP, View::Whole),
    ];
    for (which, visibility, step, view) in paths {
        if which == Which::Gpu && !one.engines.has_gpu() {
            continue;
        }
        if let Some(seen) = view.of(one.sensor)? {
            let options = FeatureOptions { visibility, step, ..FeatureOptions::default() };
            let (timing, worst, mean) = visible(one, &cases, which, &options, &seen.sensor)?;
            let by = if visibility == Rays { "rays" } else { "images" };
            let engine = if which == Which::Gpu { "gpu" } else { "cpu" };
            let finer = if step < STEP { format!(", every {step} px") } else { String::new() };
            let variant = format!("features by {by}{}{finer}", view.name());
            let label = if step < STEP { format!("{step} px") } else { view.label().to_owned() };
            let row = Row { family: format!("{engine}, by {by}"), label, ..one.row(engine, &variant, &timing) };
            for (error_kind, error) in [("visible_fraction", worst), ("visible_fraction_mean", mean)] {
                rows.push(Row { error_kind, error, bound: None, ..row.clone() });
            }
            notes.push(timing.notes(engine.to_owned(), variant));
        }
    }
    for (metres, degrees) in POSE_ERRORS {
        regions(one, &cases, (metres, degrees), rows, notes)?;
    }
    Ok(())
}

/// The features that have a part in the image, spread over all there are, and how they are seen.
fn case<'a>(one: &One<'_>, pose: &'a Pose, truth: &Truth) -> Result<Case<'a>> {
    let (world, at) = (&one.scene.world, pose.translation);
    let near = Aabb { min: at - DVec3::splat(NEAR), max: at + DVec3::splat(NEAR) };
    let options = GenerateOptions { region: Some(near), ..GenerateOptions::default() };
    let layer = generate(world.environment(), &one.sensor.spec().class, &options)?.layer;
    let placed = place(world, &layer)?;
    let by_rays = FeatureOptions { visibility: Visibility::Rays, ..FeatureOptions::default() };
    let all = predict_features(world, one.sensor, pose, &truth.images, &placed, &by_rays)?;
    let in_image = |seen: &SeenFeature| !seen.visible.is_empty() || seen.hidden.iter().any(|h| !h.reason.is_outside());
    let inside: Vec<usize> = (0..placed.len()).filter(|i| in_image(&all.features[*i])).collect();
    let step = inside.len().div_ceil(one.effort.features).max(1);
    let chosen: Vec<usize> = inside.into_iter().step_by(step).collect();
    let placed: Vec<PlacedFeature> = chosen.into_iter().map(|i| placed[i].clone()).collect();
    let finely = FeatureOptions { step: TRUE_STEP, ..by_rays };
    let truth = predict_features(world, one.sensor, pose, &truth.images, &placed, &finely)?;
    Ok(Case { pose, placed, truth })
}

/// Times of image and features together; greatest and mean error of visible fractions.
fn visible(
    one: &mut One<'_>,
    cases: &[Case<'_>],
    which: Which,
    options: &FeatureOptions,
    sensor: &Sensor,
) -> Result<(Timing, f64, f64)> {
    let world = &one.scene.world;
    let (mut timing, mut worst, mut sum, mut count) = (Timing::default(), 0f64, 0.0, 0usize);
    for case in cases {
        let Some(predictor) = one.engines.predictor(which) else { continue };
        let (mut images, mut found) = (Images::default(), FeaturePrediction::default());
        timing.measure(one.effort, || {
            let mut stats = predictor.predict_into(world, sensor, case.pose, &request(), &mut images)?;
            found = predictor.predict_features(world, sensor, case.pose, &images, &case.placed, options, &mut stats)?;
            Ok(stats)
        })?;
        for (seen, truth) in found.features.iter().zip(&case.truth.features) {
            let off = (seen.visible_fraction - truth.visible_fraction).abs();
            let off = if off < ROUNDING { 0.0 } else { off };
            worst = worst.max(off);
            sum += off;
        }
        count += case.truth.features.len();
    }
    Ok((timing, worst, sum / count.max(1) as f64))
}

/// Regions of interest of the same features by every method.
fn regions(
    one: &mut One<'_>,
    cases: &[Case<'_>],
    (metres, degrees): (f64, f64),
    rows: &mut Vec<Row>,
    notes: &mut Vec<PathNotes>,
) -> Result<()> {
    let mut covariance = [[0.0; 6]; 6];
    for i in 0..6 {
        let sigma = if i < 3 { metres } else { f64::to_radians(degrees) };
        covariance[i][i] = sigma * sigma;
    }
    let methods = [(BoxMethod::AsNeeded, "as needed"), (BoxMethod::Linear, "linear"), (BoxMethod::Set, "set")];
    for (method, name) in methods {
        let options = BoxOptions { sensor: covariance, method, ..BoxOptions::default() };
        let (mut timing, mut found) = (Timing::default(), Vec::new());
        for case in cases {
            found.extend(boxed(one, case, &options, (metres, degrees), &mut timing)?);
        }
        if found.is_empty() {
            continue;
        }
        // Of so many at each pose.
        let timing = timing.scaled(PER * cases.len() as f64 / found.len() as f64);
        let cm = 100.0 * metres;
        let variant = format!("roi {name}, pose {cm} cm {degrees} deg");
        let row = Row { family: format!("roi {name}"), label: format!("{cm} cm"), ..one.row("cpu", &variant, &timing) };
        let fail = 1.0 - options.confidence;
        let n = one.effort.draws as f64;
        // What chance alone may add to the share of one region, at three sigma.
        let luck = 3.0 * (fail * options.confidence / n).sqrt();
        let mean = |of: fn(&Region) -> f64| found.iter().map(of).sum::<f64>() / found.len() as f64;
        let worst = found.iter().map(|r| r.missed).fold(0.0, f64::max);
        let kinds = [
            ("roi_missed", mean(|r| r.missed), Some(fail)),
            ("roi_missed_worst", worst, Some(1.1 * fail + luck)),
            ("roi_area_share", mean(|r| r.area), None),
        ];
        rows.extend(kinds.map(|(error_kind, error, bound)| Row { error_kind, error, bound, ..row.clone() }));
        notes.push(timing.notes("cpu".to_owned(), variant));
    }
    Ok(())
}

/// What is told of one region.
struct Region {
    /// Share of draws in which it misses its feature.
    missed: f64,
    /// Its share of the image.
    area: f64,
}

/// The regions of all that is seen, and their time.
fn boxed(
    one: &mut One<'_>,
    case: &Case<'_>,
    options: &BoxOptions,
    errors: (f64, f64),
    timing: &mut Timing,
) -> Result<Vec<Region>> {
    let (world, sensor, effort) = (&one.scene.world, one.sensor, one.effort);
    let Some(predictor) = one.engines.predictor(Which::CpuAll) else { return Ok(Vec::new()) };
    // A patch's region is of the part that is seen, which no list of points holds.
    let judged = |i: &usize| {
        let patch = matches!(case.placed[*i].feature.shape, FeatureShape::Patch { .. });
        !patch && !case.truth.features[*i].visible.is_empty()
    };
    let judged: Vec<usize> = (0..case.placed.len()).filter(judged).collect();
    let features = judged.iter().map(|i| case.truth.features[*i].clone()).collect();
    let mut seen = FeaturePrediction { features, ..FeaturePrediction::default() };
    let placed: Vec<PlacedFeature> = judged.iter().map(|i| case.placed[*i].clone()).collect();
    timing.measure(effort, || {
        let mut stats = Stats::default();
        predictor.add_boxes(&mut seen, &placed, world, sensor, case.pose, options, &mut stats)?;
        for (flag, name) in [("linear", "linear regions"), ("set", "regions as sets"), ("whole_image", "whole images")]
        {
            stats.count(name, seen.features.iter().filter(|f| f.roi_flag == Some(flag)).count());
        }
        Ok(stats)
    })?;
    let pixels = f64::from(sensor.width()) * f64::from(sensor.height());
    let told = |(i, seen): (usize, &SeenFeature)| {
        let [x0, y0, x1, y1] = seen.roi?;
        let missed = missed(sensor, case.pose, seen, errors, effort.draws, i as u64);
        Some(Region { missed, area: (x1 - x0) * (y1 - y0) / pixels })
    };
    Ok(seen.features.par_iter().enumerate().filter_map(told).collect())
}

/// The share of draws in which what is seen of a feature is not in its region. Poses and points are moved in space and
/// imaged by [`Sensor::project`]; nothing of the code under test is used.
fn missed(
    sensor: &Sensor,
    pose: &Pose,
    seen: &SeenFeature,
    (metres, degrees): (f64, f64),
    draws: usize,
    seed: u64,
) -> f64 {
    let Some(bounds) = seen.roi else { return 0.0 };
    let (a, b) = (seen.points_world[0], *seen.points_world.last().unwrap_or(&seen.points_world[0]));
    let spread = |i: usize| i as f64 / (POINTS - 1) as f64;
    let along = |v: &VisibleInterval| (0..POINTS).map(|i| v.t[0] + (v.t[1] - v.t[0]) * spread(i)).collect::<Vec<_>>();
    let shares: Vec<f64> = match seen.feature.shape {
        FeatureShape::Segment { .. } => seen.visible.iter().flat_map(along).collect(),
        // A point has one error, whatever part of it.
        _ => vec![0.0],
    };
    let sigma = deviation(&seen.feature.shape);
    let image_from_world = sensor.body_from_image().transpose() * pose.rotation_matrix().transpose();
    let turn = sensor.columns_of_a_turn().unwrap_or(0.0);
    let mut random = Normal(SplitMix64(seed), None);
    let out = |random: &mut Normal| {
        let (shift, angle) = (random.vector() * metres, random.vector() * degrees.to_radians());
        let ends = [random.vector() * sigma, random.vector() * sigma];
        let turned = image_from_world * DMat3::from_quat(DQuat::from_scaled_axis(-angle));
        let at = |t: &f64| turned * (a.lerp(b, *t) + ends[0].lerp(ends[1], *t) - pose.translation - shift);
        // What left the image need not be found in it.
        shares
            .iter()
            .map(at)
            .filter_map(|p| sensor.project(p))
            .any(|at| in_image(sensor, at) && !holds(&bounds, at, turn))
    };
    (0..draws).filter(|_| out(&mut random)).count() as f64 / draws.max(1) as f64
}

fn in_image(sensor: &Sensor, (u, v): (f64, f64)) -> bool {
    let (w, h) = (f64::from(sensor.width()) - 0.5, f64::from(sensor.height()) - 0.5);
    (-0.5..=w).contains(&u) && (-0.5..=h).contains(&v)
}

fn holds(bounds: &[f64; 4], (u, v): (f64, f64), turn: f64) -> bool {
    let across = |u: f64| u >= bounds[0] - 1e-9 && u <= bounds[2] + 1e-9;
    (across(u) || across(u + turn)) && v >= bounds[1] - 1e-9 && v <= bounds[3] + 1e-9
}

/// Standard deviation of a generated feature's points: the same along all axes.
fn deviation(shape: &FeatureShape) -> f64 {
    match shape {
        FeatureShape::Segment { covariances, .. } => covariances[0].x_axis.x,
        FeatureShape::Point { covariance, .. } | FeatureShape::Patch { covariance, .. } => covariance.x_axis.x,
        FeatureShape::Reflector { covariance, .. } | FeatureShape::Fiducial { covariance, .. } => covariance.x_axis.x,
    }
    .sqrt()
}

/// Standard normal numbers, by Box and Muller.
struct Normal(SplitMix64, Option<f64>);

impl Normal {
    fn next(&mut self) -> f64 {
        if let Some(kept) = self.1.take() {
            return kept;
        }
        let length = (-2.0 * self.0.unit().max(1e-300).ln()).sqrt();
        let (sin, cos) = (TAU * self.0.unit()).sin_cos();
        self.1 = Some(length * sin);
        length * cos
    }

    fn vector(&mut self) -> DVec3 {
        DVec3::new(self.next(), self.next(), self.next())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::environment::{Existence, Feature, Properties};
    use crate::preset;

    /// A point 3 m before a camera with a region of so many pixels to each side.
    fn point(half: f64) -> (Sensor, SeenFeature) {
        let sensor = preset("video-camera").unwrap();
        let (at, covariance) = (DVec3::X * 3.0, DMat3::IDENTITY * 1e-4);
        let shape = FeatureShape::Point { at, covariance };
        let (existence, properties) = (Existence::default(), Properties::default());
        let feature = Feature { id: 1, name: None, object: None, shape, existence, properties };
        let roi = Some([255.5 - half, -0.5, 255.5 + half, 511.5]);
        let seen = SeenFeature { roi, roi_flag: Some("linear"), ..SeenFeature::whole(&feature) };
        (sensor, seen)
    }

    /// Sideways errors of 3 cm at 3 m and of the point's centimetre go by columns of 5.2 / 1.7 pixels: a region of two
    /// standard deviations misses 4.55 %.
    #[test]
    fn draws_miss_as_often_as_normal_tails_say() {
        let sigma = 523.636 / 3.0 * (0.03f64 * 0.03 + 0.01 * 0.01).sqrt();
        for (deviations, missed_share) in [(1.0, 0.3173), (2.0, 0.0455)] {
            let (sensor, seen) = point(deviations * sigma);
            let missed = missed(&sensor, &Pose::IDENTITY, &seen, (0.03, 0.0), 20_000, 1);
            assert!((missed - missed_share).abs() < 0.012, "{deviations} sigma: {missed}");
        }
    }
}
