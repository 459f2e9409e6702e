//! Errors of visible fractions of features.
//!
//! Settings: visibility from images or from a ray to every sample, the sampling step, and the sensor's resolution.

use super::one::{Progress, SceneStudy, Truth};
use super::path::{EnginePath, PathName};
use super::results::{PathNotes, Row};
use super::timing::{TimedPath, by_turns};
use super::views::ImageVariant;
use super::{how, regions};
use glam::DVec3;
use presight_features::generate::{FeatureKind, GenerateOptions, generate};
use presight_features::{
    FeatureOptions, FeaturePrediction, FeatureSettings, Hidden, PlacedFeature, PlacedFeatures, STEP, SeenFeature,
    Visibility, place, predict_features,
};
use presight_model::error::Result;
use presight_model::geometry::{Aabb, Pose, SensorPose};
use presight_model::sensor::Sensor;
use presight_predict::predict::Prediction;
use presight_predict::request::Request;
use presight_render::plan::Stats;

/// Features are generated within this distance of the sensor, metres.
const NEAR: f64 = 6.0;
/// Sampling step of the truth, pixels.
const TRUE_STEP: f64 = STEP / 8.0;
/// Smaller errors than this share of the errors at the usual step are not known: the samples of the truth are as far
/// apart.
pub(super) const RESOLUTION: f64 = TRUE_STEP / STEP;
/// Smaller differences of visible fractions are rounding: lengths are summed in different orders.
pub(super) const ROUNDING: f64 = 1e-12;

/// Features in view at one pose, with their true visibility.
pub(super) struct Case<'a> {
    pub pose: &'a Pose,
    pub placed: PlacedFeatures,
    pub truth: FeaturePrediction,
}

/// A path from images to features while it is measured.
struct FeaturePath {
    which: EnginePath,
    visibility: Visibility,
    step: f64,
    view: ImageVariant,
    sensor: Sensor,
    /// The last prediction, whose memory is reused.
    found: Option<Prediction>,
    /// The error of each visible fraction.
    errors: Vec<f64>,
}

/// Adds rows of all paths from images to features, and to their regions of interest. Returns the number of features.
pub(super) fn rows(
    one: &mut SceneStudy<'_>,
    truths: &[Truth],
    rows: &mut Vec<Row>,
    notes: &mut Vec<PathNotes>,
    progress: Progress<'_>,
) -> Result<usize> {
    if let Err(e) = one.sensor.check_projection() {
        one.not_measured.push(format!("features and regions of interest: {e}"));
        return Ok(0);
    }
    let cases: Vec<Case<'_>> =
        one.scene.poses.iter().zip(truths).map(|(p, t)| case(one, p, t)).collect::<Result<_>>()?;
    let count = cases.iter().map(|c| c.placed.features.len()).sum();
    if count == 0 {
        return Ok(0);
    }
    let mut all = paths(one);
    let place = one.sensor.spec().name.clone();
    for case in &cases {
        for TimedPath { what, timing } in &mut all {
            timing.warm(|| what.look(one, case))?;
            what.judge(case);
        }
        let effort = one.effort;
        let look = |what: &mut FeaturePath| what.look(one, case);
        by_turns(effort, &mut all, look, |round| progress(&format!("features by turns, {round}: {place}")))?;
    }
    for TimedPath { what, timing } in all {
        let named = what.named(one);
        let worst = what.errors.iter().copied().fold(0.0, f64::max);
        let mean = what.errors.iter().sum::<f64>() / what.errors.len().max(1) as f64;
        let row = Row { errors: what.errors, ..one.row(&named, &timing) };
        for (error_kind, error) in [("visible_fraction", worst), ("visible_fraction_mean", mean)] {
            rows.push(Row { error_kind, error, bound: None, ..row.clone() });
        }
        notes.push(timing.notes(&named));
    }
    regions::rows(one, &cases, rows, notes, progress)?;
    Ok(count)
}

/// All paths that work with this machine and sensor.
fn paths(one: &mut SceneStudy<'_>) -> Vec<TimedPath<FeaturePath>> {
    use Visibility::{Image, Rays};
    let all = [
        (EnginePath::CpuAll, Rays, STEP, ImageVariant::Whole),
        (EnginePath::CpuAll, Image, STEP / 4.0, ImageVariant::Whole),
        (EnginePath::CpuAll, Image, STEP / 2.0, ImageVariant::Whole),
        (EnginePath::CpuAll, Image, STEP, ImageVariant::Whole),
        (EnginePath::CpuAll, Image, STEP, ImageVariant::Reduced(2)),
        (EnginePath::CpuAll, Image, STEP, ImageVariant::Reduced(4)),
        (EnginePath::Gpu, Image, STEP, ImageVariant::Whole),
    ];
    let mut paths = Vec::new();
    for (which, visibility, step, view) in all {
        if which == EnginePath::Gpu && !one.engines.has_gpu() {
            continue;
        }
        let path = |sensor| FeaturePath { which, visibility, step, view, sensor, found: None, errors: Vec::new() };
        // At a reduced resolution, a ray table may have too few rays for a projection.
        let seen = view
            .of(one.sensor)
            .and_then(|seen| seen.map(|seen| seen.sensor.check_projection().map(|()| seen)).transpose());
        match seen {
            Ok(Some(seen)) => paths.push(TimedPath::new(path(seen.sensor))),
            Ok(None) => {}
            Err(e) => {
                let named = path(one.sensor.clone()).named(one);
                one.leave_out(&named, &e);
            }
        }
    }
    paths
}

impl FeaturePath {
    fn named(&self, one: &SceneStudy<'_>) -> PathName {
        let by = if self.visibility == Visibility::Rays { "rays" } else { "images" };
        let engine = if self.which == EnginePath::Gpu { "gpu" } else { "cpu" };
        let fine = self.step < STEP;
        let finer = if fine { format!(", every {} px", self.step) } else { String::new() };
        let default = !fine && self.visibility == Visibility::Image && self.view == ImageVariant::Whole;
        PathName {
            engine,
            variant: format!("features by {by}{}{finer}", self.view.name()),
            how: how::of_features(self.which, self.visibility, self.step, self.view, one.sensor),
            default: default && self.which == one.engines.default(),
            family: format!("{engine}, by {by}"),
            label: if fine { format!("{} px", self.step) } else { self.view.label().to_owned() },
        }
    }

    /// Predicts the image and the features.
    fn look(&mut self, one: &mut SceneStudy<'_>, case: &Case<'_>) -> Result<Stats> {
        let (world, pose) = (&one.scene.world, case.pose);
        let predictor = one.engines.predictor(self.which)?;
        let options = FeatureOptions::default().with_visibility(self.visibility).with_step(self.step);
        let options = options.with_hidden(Hidden::Full);
        let request = Request::default().with_features(options.with_placed(case.placed.clone()));
        match &mut self.found {
            Some(found) if found.request == request => {
                predictor.predict_again(world, &SensorPose::new(*pose), found)?
            }
            found => *found = Some(predictor.predict(world, &self.sensor, &SensorPose::new(*pose), &request)?),
        }
        // Add entries for features out of view, as in the truth.
        let found = self.found.as_mut();
        Ok(found
            .map(|found| {
                found.features.iter_mut().for_each(|f| f.spell_out(world.environment(), &case.placed.features));
                found.stats.clone()
            })
            .unwrap_or_default())
    }

    /// Adds the errors of one case.
    fn judge(&mut self, case: &Case<'_>) {
        let Some(found) = self.found.as_ref().and_then(|p| p.features.as_ref()) else { return };
        for (seen, truth) in found.features.iter().zip(&case.truth.features) {
            let off = (seen.visible_fraction - truth.visible_fraction).abs();
            self.errors.push(if off < ROUNDING { 0.0 } else { off });
        }
    }
}

/// An evenly spaced selection of the features in the image, with their true visibility.
fn case<'a>(one: &SceneStudy<'_>, pose: &'a Pose, truth: &Truth) -> Result<Case<'a>> {
    let (world, at) = (&one.scene.world, pose.translation);
    let near = Aabb { min: at - DVec3::splat(NEAR), max: at + DVec3::splat(NEAR) };
    // Contours can have several entries, which would not match those of the truth.
    let kinds = FeatureKind::ALL.into_iter().filter(|kind| *kind != FeatureKind::Contour).collect();
    let options = GenerateOptions { kinds, region: Some(near), ..GenerateOptions::default() };
    let layer = generate(world.environment(), &one.sensor.spec().class, &options)?.layer;
    let placed = place(world, &layer)?;
    let by_rays = FeatureSettings { visibility: Visibility::Rays, ..FeatureSettings::default() };
    let all = predict_features(world, one.sensor, pose, &truth.images, &placed, &by_rays)?;
    let in_image = |seen: &SeenFeature| !seen.visible.is_empty() || seen.hidden.iter().any(|h| !h.reason.is_outside());
    let inside: Vec<usize> = (0..placed.len()).filter(|i| in_image(&all.features[*i])).collect();
    let step = inside.len().div_ceil(one.effort.features).max(1);
    let chosen: Vec<usize> = inside.into_iter().step_by(step).collect();
    let placed: Vec<PlacedFeature> = chosen.into_iter().map(|i| placed[i].clone()).collect();
    let finely = FeatureSettings { step: TRUE_STEP, ..by_rays };
    let truth = predict_features(world, one.sensor, pose, &truth.images, &placed, &finely)?;
    Ok(Case { pose, placed: placed.into(), truth })
}
