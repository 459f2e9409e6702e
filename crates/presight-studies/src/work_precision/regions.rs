//! Regions of interest: how often each misses its feature for random samples of the errors, and how large it is.
//!
//! Settings: the method of propagating errors through the projection, at small to large pose errors.

use super::features::Case;
use super::how;
use super::one::{Progress, SceneStudy};
use super::path::{EnginePath, PathName};
use super::results::{PathNotes, Row};
use super::timing::{TimedPath, by_turns};
use glam::{DMat3, DQuat, DVec3};
use presight_features::roi::RoiFlag;
use presight_features::{
    BoxMethod, BoxOptions, BoxQuery, FeaturePrediction, PlacedFeature, SeenFeature, VisibleInterval,
};
use presight_model::clock::Instant;
use presight_model::environment::FeatureShape;
use presight_model::error::Result;
use presight_model::geometry::Pose;
use presight_model::random::SplitMix64;
use presight_model::sensor::Sensor;
use presight_model::statistics::normal_pair;
use presight_model::threads::parallel_or_here;
use presight_predict::engine::add_boxes;
use presight_render::plan::{CountName, StageName, Stats};
use rayon::prelude::*;

/// Standard deviations of the pose: metres, degrees.
const POSE_ERRORS: [(f64, f64); 3] = [(0.01, 0.3), (0.1, 3.0), (0.2, 8.0)];
/// Times are reported for this number of regions of interest.
const PER: f64 = 100.0;
/// Test points on each visible interval of a segment.
const POINTS: usize = 5;

/// A path to regions of interest while it is measured.
struct RegionPath {
    which: EnginePath,
    method: BoxMethod,
    /// Standard deviations of the pose: metres, degrees.
    errors: (f64, f64),
    options: BoxOptions,
    found: Vec<Region>,
}

/// The results of one region.
struct Region {
    /// Fraction of samples in which it misses its feature.
    missed: f64,
    /// Fraction of the image that it covers.
    area: f64,
}

/// The visible features of a case.
struct VisibleFeatures {
    placed: Vec<PlacedFeature>,
    seen: FeaturePrediction,
}

/// Adds rows of all paths to regions of interest, for the same features.
pub(super) fn rows(
    one: &mut SceneStudy<'_>,
    cases: &[Case<'_>],
    rows: &mut Vec<Row>,
    notes: &mut Vec<PathNotes>,
    progress: Progress<'_>,
) -> Result<()> {
    let mut all = paths(one);
    let place = one.sensor.spec().name.clone();
    for case in cases {
        let judged = judged(case);
        for TimedPath { what, timing } in &mut all {
            let mut seen = judged.seen.clone();
            timing.warm(|| what.make(one, case, &judged.placed, &mut seen))?;
            what.found.extend(what.evaluated(one, case, &seen));
        }
        let (mut seen, effort) = (judged.seen.clone(), one.effort);
        let make = |what: &mut RegionPath| what.make(one, case, &judged.placed, &mut seen);
        by_turns(effort, &mut all, make, |round| progress(&format!("regions by turns, {round}: {place}")))?;
    }
    for TimedPath { what, timing } in all.into_iter().filter(|one| !one.what.found.is_empty()) {
        // Scale from the mean number of regions per pose to PER.
        let timing = timing.scaled(PER * cases.len() as f64 / what.found.len() as f64);
        let named = what.named(one);
        let row = one.row(&named, &timing);
        let kinds = what.kinds(one.effort.draws);
        rows.extend(kinds.map(|(error_kind, error, bound)| Row { error_kind, error, bound, ..row.clone() }));
        notes.push(timing.notes(&named));
    }
    Ok(())
}

/// All paths that work on this machine, at every pose error.
fn paths(one: &SceneStudy<'_>) -> Vec<TimedPath<RegionPath>> {
    use BoxMethod::{AsNeeded, Linear, Set};
    let all = [
        (EnginePath::CpuAll, AsNeeded),
        (EnginePath::CpuAll, Linear),
        (EnginePath::CpuAll, Set),
        (EnginePath::Gpu, AsNeeded),
    ];
    let all = all.into_iter().filter(|(which, _)| *which != EnginePath::Gpu || one.engines.has_gpu());
    let paths = all.flat_map(|(which, method)| POSE_ERRORS.map(|errors| (which, method, errors)));
    let path = |(which, method, errors): (EnginePath, BoxMethod, (f64, f64))| {
        let (t, r) = (errors.0, errors.1.to_radians());
        let options = BoxOptions::default().with_sensor_sigmas([t, t, t, r, r, r]).with_method(method);
        TimedPath::new(RegionPath { which, method, errors, options, found: Vec::new() })
    };
    paths.map(path).collect()
}

fn judged(case: &Case<'_>) -> VisibleFeatures {
    // Areas are left out: their regions are for the visible part, which is not given by a list of points.
    let judged =
        |i: &usize| !case.placed.features[*i].feature.shape.is_area() && !case.truth.features[*i].visible.is_empty();
    let judged: Vec<usize> = (0..case.placed.features.len()).filter(judged).collect();
    let features = judged.iter().map(|i| case.truth.features[*i].clone()).collect();
    let seen = FeaturePrediction { features, ..FeaturePrediction::default() };
    VisibleFeatures { placed: judged.iter().map(|i| case.placed.features[*i].clone()).collect(), seen }
}

impl RegionPath {
    fn named(&self, one: &SceneStudy<'_>) -> PathName {
        let engine = if self.which == EnginePath::Gpu { "gpu" } else { "cpu" };
        let name = match self.method {
            BoxMethod::AsNeeded => "as needed",
            BoxMethod::Linear => "linear",
            BoxMethod::Set => "set",
        };
        let (cm, degrees) = (100.0 * self.errors.0, self.errors.1);
        PathName {
            engine,
            variant: format!("roi {name}, pose {cm} cm {degrees} deg"),
            how: how::of_regions(self.which, self.method),
            default: self.method == BoxMethod::AsNeeded && self.which == one.engines.default(),
            family: format!("{engine}, roi {name}"),
            label: format!("{cm} cm"),
        }
    }

    fn make(
        &self,
        one: &mut SceneStudy<'_>,
        case: &Case<'_>,
        placed: &[PlacedFeature],
        seen: &mut FeaturePrediction,
    ) -> Result<Stats> {
        let (world, sensor, mut stats) = (&one.scene.world, one.sensor, Stats::default());
        let (engine, threads) = one.engines.predictor(self.which)?.engine_mut();
        let start = Instant::now();
        let query = BoxQuery { placed, world, sensor, world_from_sensor: case.pose, options: &self.options };
        let made = add_boxes(engine, threads, seen, &query)?;
        made.into_iter().for_each(|made| stats.count(CountName::RegionsOnDevice, made));
        stats.stage(StageName::RegionsOfInterest, start);
        for (flag, name) in [
            (RoiFlag::Linear, CountName::LinearRegions),
            (RoiFlag::Set, CountName::SetRegions),
            (RoiFlag::WholeImage, CountName::WholeImages),
        ] {
            stats.count(name, seen.features.iter().filter(|f| f.roi_flag == Some(flag)).count());
        }
        Ok(stats)
    }

    /// Evaluates the predicted regions with random samples of the errors.
    fn evaluated(&self, one: &SceneStudy<'_>, case: &Case<'_>, seen: &FeaturePrediction) -> Vec<Region> {
        let (sensor, draws) = (one.sensor, one.effort.draws);
        let pixels = f64::from(sensor.width()) * f64::from(sensor.height());
        let region = |(i, seen): (usize, &SeenFeature)| {
            let [x0, y0, x1, y1] = seen.roi?;
            let missed = missed(sensor, case.pose, seen, self.errors, draws, i as u64);
            Some(Region { missed, area: (x1 - x0) * (y1 - y0) / pixels })
        };
        parallel_or_here(|| seen.features.par_iter().enumerate().filter_map(region).collect())
    }

    /// The kinds of errors: name, error, and the bound if there is one.
    fn kinds(&self, draws: usize) -> [(&'static str, f64, Option<f64>); 3] {
        let fail = 1.0 - self.options.confidence;
        // Three standard deviations of the fraction of one region by chance.
        let luck = 3.0 * (fail * self.options.confidence / draws as f64).sqrt();
        let mean = |of: fn(&Region) -> f64| self.found.iter().map(of).sum::<f64>() / self.found.len().max(1) as f64;
        let worst = self.found.iter().map(|r| r.missed).fold(0.0, f64::max);
        [
            ("roi_missed", mean(|r| r.missed), Some(fail)),
            ("roi_missed_worst", worst, Some(1.1 * fail + luck)),
            ("roi_area_share", mean(|r| r.area), None),
        ]
    }
}

/// The fraction of samples in which a visible point of a feature is outside its region. Poses and points are moved in
/// space and projected by [`Sensor::project`], independently of the code under test.
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
        // A point feature has one point.
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
        // Points that leave the image are not expected in the region.
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

/// Standard deviation of a generated feature's points, which is the same along all axes.
fn deviation(shape: &FeatureShape) -> f64 {
    match shape {
        FeatureShape::Segment { covariances, .. } => covariances[0].x_axis.x,
        FeatureShape::Point { covariance, .. } | FeatureShape::Patch { covariance, .. } => covariance.x_axis.x,
        FeatureShape::Reflector { covariance, .. }
        | FeatureShape::Fiducial { covariance, .. }
        | FeatureShape::Contour { covariance, .. } => covariance.x_axis.x,
    }
    .sqrt()
}

/// Standard normal random numbers, by the Box-Muller transform.
struct Normal(SplitMix64, Option<f64>);

impl Normal {
    fn next(&mut self) -> f64 {
        if let Some(kept) = self.1.take() {
            return kept;
        }
        let [x, y] = [self.0.unit(), self.0.unit()];
        let [now, later] = normal_pair(x.max(1e-300), y, 1.0);
        self.1 = Some(later);
        now
    }

    fn vector(&mut self) -> DVec3 {
        DVec3::new(self.next(), self.next(), self.next())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use presight_model::environment::{Existence, Feature, Properties};
    use presight_read::preset;

    /// A point 3 m in front of a camera, with a region of `half` pixels to each side.
    fn point(half: f64) -> (Sensor, SeenFeature) {
        let sensor = preset("video-camera").unwrap();
        let (at, covariance) = (DVec3::X * 3.0, DMat3::IDENTITY * 1e-4);
        let shape = FeatureShape::Point { at, covariance };
        let (existence, properties) = (Existence::default(), Properties::default());
        let feature = Feature { id: 1, name: None, object: None, shape, existence, properties };
        let roi = Some([255.5 - half, -0.5, 255.5 + half, 511.5]);
        let seen = SeenFeature { roi, roi_flag: Some(RoiFlag::Linear), ..SeenFeature::whole(&feature) };
        (sensor, seen)
    }

    /// Lateral errors of 3 cm of the pose and 1 cm of the point, at 3 m, spread over columns. A region of two standard
    /// deviations misses 4.55 % of the samples.
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
