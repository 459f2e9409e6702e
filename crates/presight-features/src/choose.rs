//! Selects the few features that determine the pose best, greedily by information gain.
//!
//! A measured feature adds J' J / s^2 to the information matrix of the sensor's pose. J is the derivative of its image
//! coordinates with respect to the pose, and s^2 is the variance of the measurement plus that of the feature's
//! position. Each step adds the feature that increases the log determinant of the total information most (D-optimal).

use super::boxes::Image;
use super::prediction::given_at;
use super::roi::Projection;
use super::{FeaturePrediction, PlacedFeature, SeenFeature, Vantage};
use glam::{DMat3, DVec2, DVec3};
use presight_model::environment::FeatureShape;
use presight_model::geometry::{InWorld, Pose, PoseCovariance};
use presight_model::matrix::{Matrix, add_to, cholesky};
use std::cmp::Reverse;
use std::collections::BinaryHeap;

/// Limit on the number of gain evaluations; takes some seconds. Nearly equal features need new evaluations after each
/// choice. Beyond the limit, their last known gains are used.
const MAX_EVALUATIONS: usize = 1 << 24;

/// Keeps the best `most` of the visible features and all hidden ones; returns how many were dropped. Information is
/// weighted by existence and contrast (1 if unknown). Among equal features the lower id is kept. `known` is the prior
/// covariance of the pose along the world's axes; a variance of 0 in it is replaced by (1 m)^2 or (1 rad)^2.
pub fn choose(
    prediction: &mut FeaturePrediction,
    placed: &[PlacedFeature],
    vantage: &Vantage<'_>,
    known: Option<&PoseCovariance<InWorld>>,
    most: usize,
) -> usize {
    let seen: Vec<usize> =
        (0..prediction.features.len()).filter(|i| !prediction.features[*i].visible.is_empty()).collect();
    if seen.len() <= most {
        return 0;
    }
    let informations = informations(prediction, placed, vantage);
    let informations: Vec<(u32, Matrix)> =
        informations.into_iter().map(|(i, information)| (prediction.features[i].feature.id, information)).collect();
    let mut keep: Vec<bool> = prediction.features.iter().map(|f| f.visible.is_empty()).collect();
    for chosen in greedy(&prior(known), &informations, most, MAX_EVALUATIONS) {
        keep[seen[chosen]] = true;
    }
    let numbers = (0..keep.len()).filter(|i| keep[*i]).map(|i| prediction.given_at(i) as u32).collect();
    prediction.given = numbers;
    let mut kept = keep.iter();
    prediction.features.retain(|_| *kept.next().unwrap_or(&false));
    seen.len() - most
}

/// Returns the information of each visible feature about the pose, with its index in the prediction. The pose has
/// translation along and rotation about the world's axes. Weights are existence and contrast (1 if unknown).
pub fn informations(
    prediction: &FeaturePrediction,
    placed: &[PlacedFeature],
    vantage: &Vantage<'_>,
) -> Vec<(usize, Matrix)> {
    let Vantage { world, sensor, world_from_sensor } = *vantage;
    let image = Image::of(sensor);
    let turn = |object: u32| world.environment().objects()[object as usize].world_from_object.rotation_matrix();
    let seen = prediction.features.iter().enumerate().filter(|(_, feature)| !feature.visible.is_empty());
    seen.map(|(i, feature)| {
        let world_from_frame = placed[given_at(&prediction.given, i)].object.map_or(DMat3::IDENTITY, turn);
        let weight = feature.existence * feature.feature.properties.contrast.unwrap_or(1.0);
        (i, information(&image, feature, world_from_sensor, world_from_frame, weight))
    })
    .collect()
}

/// Returns the chosen indices in order. Evaluates at most `evaluations` gains beyond the first of each feature.
fn greedy(prior: &Matrix, informations: &[(u32, Matrix)], most: usize, mut evaluations: usize) -> Vec<usize> {
    /// A gain with a total order.
    #[derive(PartialEq)]
    struct Gain(f64);
    impl Eq for Gain {}
    impl PartialOrd for Gain {
        fn partial_cmp(&self, other: &Self) -> Option<std::cmp::Ordering> {
            Some(self.cmp(other))
        }
    }
    impl Ord for Gain {
        fn cmp(&self, other: &Self) -> std::cmp::Ordering {
            self.0.total_cmp(&other.0)
        }
    }
    let mut sum = *prior;
    // Gains only shrink as features are chosen, so an old gain is an upper bound.
    let all = informations.iter().enumerate().map(|(i, (id, _))| (Gain(f64::INFINITY), Reverse(*id), Reverse(i), 0));
    let mut heap: BinaryHeap<_> = all.collect();
    let mut chosen = Vec::with_capacity(most);
    while let Some((_, id, Reverse(i), known)) = heap.pop() {
        if chosen.len() == most {
            break;
        }
        // Rounds count from 1, so that every gain is computed at least once.
        if known == chosen.len() + 1 || known > 0 && evaluations == 0 {
            add_to(&mut sum, &informations[i].1);
            chosen.push(i);
        } else {
            evaluations = evaluations.saturating_sub(1);
            let mut with = sum;
            add_to(&mut with, &informations[i].1);
            let gain = Gain(log_determinant(&with) - log_determinant(&sum));
            heap.push((gain, id, Reverse(i), chosen.len() + 1));
        }
    }
    chosen
}

fn prior(known: Option<&PoseCovariance<InWorld>>) -> Matrix {
    let mut prior = [[0.0; 6]; 6];
    for i in 0..6 {
        let variance = known.map_or(0.0, |c| c[i][i]);
        prior[i][i] = if variance > 0.0 { 1.0 / variance } else { 1.0 };
    }
    prior
}

/// Information of one feature about the sensor's pose: translation along and rotation about the world's axes.
fn information(image: &Image<'_>, seen: &SeenFeature, pose: &Pose, world_from_frame: DMat3, weight: f64) -> Matrix {
    let sigma = image.sensor.spec().noise.pixel_sigma;
    let variance = if sigma > 0.0 { sigma * sigma } else { 1.0 };
    let rotation = pose.rotation_matrix();
    let mut sum = [[0.0; 6]; 6];
    let mut take = |at: DVec3, along: DVec2, covariance: &DMat3| {
        let in_body = rotation.transpose() * (at - pose.translation);
        let Some(gradient) = image.project(in_body).and_then(|pixel| image.gradient(in_body, pixel)) else { return };
        let slope = rotation * (along.x * gradient[0] + along.y * gradient[1]);
        let in_frame = world_from_frame.transpose() * slope;
        let weight = weight / (variance + in_frame.dot(*covariance * in_frame));
        let turn = (at - pose.translation).cross(slope);
        let row = [slope.x, slope.y, slope.z, turn.x, turn.y, turn.z];
        (0..6).for_each(|i| (0..6).for_each(|j| sum[i][j] += weight * row[i] * row[j]));
    };
    match &seen.feature.shape {
        FeatureShape::Contour { covariance, .. } => {
            // A curve is measured across itself, at the midpoints of a few visible pieces.
            const PIECES: usize = 16;
            let pixel = |p: DVec3| image.project(rotation.transpose() * (p - pose.translation)).map(DVec2::from);
            let pieces: Vec<[DVec3; 2]> = seen.visible.iter().flat_map(|v| seen.along(v.t)).collect();
            for [a, b] in pieces.iter().step_by(pieces.len().div_ceil(PIECES).max(1)) {
                let Some((p, q)) = pixel(*a).zip(pixel(*b)) else { continue };
                let mut along = q - p;
                if let Some(turn) = image.turn() {
                    along.x -= turn * (along.x / turn).round();
                }
                if let Some(along) = along.try_normalize() {
                    take(a.midpoint(*b), along.perp(), covariance);
                }
            }
        }
        FeatureShape::Segment { covariances, .. } => {
            let from = seen.visible.iter().map(|v| v.t[0]).fold(1.0, f64::min);
            let to = seen.visible.iter().map(|v| v.t[1]).fold(0.0, f64::max);
            let places = [from, to].map(|t| seen.points_world[0].lerp(seen.points_world[1], t));
            let pixel = |p: DVec3| image.project(rotation.transpose() * (p - pose.translation)).map(DVec2::from);
            let [Some(a), Some(b)] = places.map(pixel) else { return sum };
            let mut along = b - a;
            if let Some(turn) = image.turn() {
                along.x -= turn * (along.x / turn).round();
            }
            // A line can only be measured across itself.
            match along.try_normalize() {
                Some(along) => (0..2).for_each(|k| take(places[k], along.perp(), &covariances[k])),
                None => DVec2::AXES.into_iter().for_each(|axis| take(places[0], axis, &covariances[0])),
            }
        }
        FeatureShape::Point { covariance, .. }
        | FeatureShape::Reflector { covariance, .. }
        | FeatureShape::Patch { covariance, .. }
        | FeatureShape::Fiducial { covariance, .. } => {
            for at in &seen.points_world {
                DVec2::AXES.into_iter().for_each(|axis| take(*at, axis, covariance));
            }
        }
    }
    sum
}

/// Log determinant of a positive definite matrix.
fn log_determinant(matrix: &Matrix) -> f64 {
    let l = cholesky(matrix, |rest| Some(rest.max(f64::MIN_POSITIVE))).unwrap_or_default();
    (0..6).fold(0.0, |sum, i| sum + 2.0 * l[i][i].ln())
}

#[cfg(test)]
mod tests {
    use super::*;
    use presight_model::environment::{Environment, Existence, Feature, Properties};
    use presight_model::geometry::Pose;
    use presight_model::random::SplitMix64;
    use presight_model::world::World;

    fn random(seed: u64, count: u32) -> Vec<(u32, Matrix)> {
        let mut random = SplitMix64(seed);
        let one = |id: u32| {
            let mut sum = [[0.0; 6]; 6];
            for _ in 0..1 + id % 3 {
                let row: [f64; 6] = std::array::from_fn(|_| random.unit() - 0.5);
                (0..6).for_each(|i| (0..6).for_each(|j| sum[i][j] += 50.0 * row[i] * row[j]));
            }
            (id, sum)
        };
        (0..count).map(one).collect()
    }

    #[test]
    fn the_heap_chooses_as_asking_each_does() {
        for seed in 0..20 {
            let all = random(seed, 60);
            let mut sum = prior(None);
            let mut expected = Vec::new();
            for _ in 0..10 {
                let gain = |i: &usize| {
                    let mut with = sum;
                    add_to(&mut with, &all[*i].1);
                    log_determinant(&with)
                };
                let best = (0..all.len()).filter(|i| !expected.contains(i));
                let best = best.fold(None, |best: Option<usize>, i| match best {
                    Some(b) if gain(&b) >= gain(&i) => Some(b),
                    _ => Some(i),
                });
                add_to(&mut sum, &all[best.unwrap()].1);
                expected.push(best.unwrap());
            }
            assert_eq!(greedy(&prior(None), &all, 10, usize::MAX), expected, "{seed}");
        }
        // Equal features are chosen by id, in any input order.
        let one = random(3, 1)[0].1;
        assert_eq!(greedy(&prior(None), &[(9, one), (4, one), (7, one)], 2, usize::MAX), [1, 2]);
    }

    /// Equal features would all be evaluated again after each choice. With no evaluations left, each has one old gain.
    #[test]
    fn equal_features_are_not_asked_about_for_ever() {
        let one = random(3, 1)[0].1;
        let twice = one.map(|row| row.map(|x| 2.0 * x));
        let mut all: Vec<(u32, Matrix)> = (1..=1000).map(|id| (id, one)).collect();
        all[700].1 = twice;
        for evaluations in [0, 1000, 3000, usize::MAX] {
            assert_eq!(greedy(&prior(None), &all, 3, evaluations), [700, 0, 1], "{evaluations}");
        }
    }

    #[test]
    fn determinants_are_those_of_known_matrices() {
        let mut m = [[0.0; 6]; 6];
        (0..6).for_each(|i| m[i][i] = (i + 1) as f64);
        assert!((log_determinant(&m) - 720f64.ln()).abs() < 1e-12);
        // The block |2 1; 1 2| has determinant 3; it replaces 1 * 2.
        (m[0][0], m[1][1], m[0][1], m[1][0]) = (2.0, 2.0, 1.0, 1.0);
        assert!((log_determinant(&m) - 1080f64.ln()).abs() < 1e-12);
    }

    /// A camera looks along x at two points in one place and another point to the side. The point to the side adds new
    /// information; the copy adds almost none. A point without contrast comes last.
    #[test]
    fn what_tells_something_new_is_chosen() {
        let point = |id: u32, y: f64, contrast: Option<f64>| {
            let shape = FeatureShape::Point { at: DVec3::new(4.0, y, 0.0), covariance: DMat3::ZERO };
            let properties = Properties { contrast, ..Properties::default() };
            Feature { id, name: None, object: None, shape, existence: Existence::default(), properties }
        };
        let features = [point(5, 0.0, None), point(6, 0.0, None), point(8, 1.0, Some(1e-6)), point(9, -1.0, None)];
        let placed: Vec<_> =
            features.iter().map(|f| PlacedFeature { feature: f.clone().into(), object: None, slots: vec![] }).collect();
        let all =
            FeaturePrediction { features: features.iter().map(SeenFeature::whole).collect(), ..Default::default() };
        let (world, sensor) = (World::new(Environment::new()), presight_read::preset("video-camera").unwrap());
        let vantage = Vantage { world: &world, sensor: &sensor, world_from_sensor: &Pose::IDENTITY };
        let ids = |most: usize| {
            let mut some = all.clone();
            let dropped = choose(&mut some, &placed, &vantage, None, most);
            assert_eq!(dropped + some.features.len(), 4);
            assert!(some.features.iter().enumerate().all(|(i, f)| placed[some.given_at(i)].feature == f.feature));
            some.features.iter().map(|f| f.feature.id).collect::<Vec<_>>()
        };
        assert_eq!(ids(4), [5, 6, 8, 9]);
        assert_eq!(ids(2), [5, 9]);
        assert_eq!(ids(3), [5, 6, 9]);
        assert_eq!(ids(0), [0; 0]);
    }
}
