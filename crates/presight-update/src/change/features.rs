//! Changes of features: existence, strength, contrast and covariance by Bayes, and the insertion of new features.

use crate::change::edits::mark;
use crate::change::existence::{UNSTATED, posterior};
use crate::decide::fit::POINT_SIGMA;
use crate::evidence::features::book::{FeatureBook, FeatureEvidence, pose_of};
use crate::evidence::features::located::located;
use crate::evidence::features::sightings::{Kind, Mean, Track};
use crate::evidence::knowledge::Knowledge;
use glam::{DMat3, DVec3};
use presight_model::caster::RayCaster;
use presight_model::change::Change;
use presight_model::environment::{Environment, Existence, Feature, FeatureShape, MarkKind, Properties};
use presight_model::statistics::NOISE_BOUND;
use presight_store::{Edit, EditPose, ShapeSource};
use std::collections::BTreeMap;

/// The share of views in which an extractor finds a feature that does not exist.
const FALSE_SHARE: f64 = 0.05;
/// Features with a lower probability of existence are deleted.
const MIN_EXISTENCE: f64 = 0.02;
/// Weight of the layer's strength and contrast, in views.
const LAYER_WEIGHT: f64 = 10.0;
/// Half of the edge of the plate below a new reflector, metres.
const HALF_PLATE: f32 = 0.02;

/// The insertion of a new feature.
pub(crate) struct Insertion {
    pub edit: Edit,
    pub cause: String,
    pub views: u32,
}

/// Changes that set the attributes of features, and that delete features which hardly exist. `before` is the
/// environment of the views, and `now` has the new poses of the objects.
pub(crate) fn changes(
    book: &FeatureBook,
    (before, now): (&Environment, &Environment),
    min_views: u32,
    utc: f64,
) -> Vec<Change> {
    let all = book.sighted();
    let shares: BTreeMap<&str, f64> = all.keys().map(|(class, _)| (class.as_str(), book.share(class))).collect();
    let change = |((class, id), views): (&&(String, u32), &FeatureEvidence)| {
        let feature = before.feature(class, *id).filter(|_| views.found + views.missed > 0)?;
        let existence = after(&feature.existence, views, shares[class.as_str()], utc);
        let class = class.clone();
        if existence.p0 < MIN_EXISTENCE && views.missed >= min_views {
            return Some(Change::DeleteFeature { class, id: *id });
        }
        let properties = Properties {
            strength: mean(feature.properties.strength, views.strength),
            contrast: mean(feature.properties.contrast, views.contrast),
            ..feature.properties.clone()
        };
        let shape = located(feature, &views.offsets, (&pose_of(before, feature), &pose_of(now, feature)));
        Some(Change::SetFeature { class, feature: Feature { existence, properties, shape, ..feature.clone() } })
    };
    all.iter().filter_map(change).collect()
}

/// Insertions of features that several views found at one place and that the layer lacks: on the surface there, or a
/// reflector on a small provisional object whose name contains `base`.
pub(crate) fn insertions(known: &Knowledge, environment: &Environment, utc: f64, base: &str) -> Vec<Insertion> {
    let mut next: BTreeMap<&str, u32> = BTreeMap::new();
    let mut all = Vec::new();
    for track in known.features.new.iter().filter(|track| track.views >= known.options.min_views) {
        let class = track.class.as_str();
        let last = || environment.layer(class).and_then(|l| l.features.iter().map(|f| f.id).max()).unwrap_or(0);
        let id = next.get(class).copied().unwrap_or_else(last) + 1;
        let name = format!("provisional/{base} reflector {id}");
        let Some((object, shape, plate)) = placed(track, environment, known.casters.get(class), &name) else {
            continue;
        };
        next.insert(class, id);
        let views = FeatureEvidence { found: track.views, last: track.last, ..FeatureEvidence::default() };
        let prior = Existence { p0: FALSE_SHARE, confirmed: track.last + utc, rate: 0.0 };
        let existence = after(&prior, &views, known.features.share(class), utc);
        let (strength, contrast) = (mean(None, track.strength), mean(None, track.contrast));
        let properties = Properties { strength, contrast, ..Properties::default() };
        let feature = Feature { id, name: None, object: Some(object), shape, existence, properties };
        let insert = Edit::from(Change::InsertFeature { class: class.to_owned(), feature });
        let what = match track.kind {
            Kind::Reflector => "a reflector",
            Kind::Corner => "a corner",
            Kind::Edge => "an edge",
        };
        let cause = format!("{what} was found at {:.2} from {} views", track.places()[0].0, track.views);
        let edit = Edit::Group(plate.into_iter().flatten().chain([insert]).collect());
        all.push(Insertion { edit, cause, views: track.views });
    }
    all
}

/// The object and the shape of a new feature: on the surface near all its points, if they belong to one object. A
/// reflector without a surface gets a plate with this name.
fn placed(
    track: &Track,
    environment: &Environment,
    caster: Option<&RayCaster>,
    name: &str,
) -> Option<(String, FeatureShape, Option<[Edit; 2]>)> {
    let places = track.places();
    let on = |(p, covariance): &(DVec3, DMat3)| {
        // The place of an edge is measured across it only.
        let [x, y, z] = [0, 1, 2].map(|i| covariance.col(i)[i]);
        let (object, nearest) = caster?.nearest(*p, NOISE_BOUND * x.min(y).min(z).sqrt() + POINT_SIGMA)?;
        Some((object, nearest.point))
    };
    let feet: Vec<Option<(u32, DVec3)>> = places.iter().map(on).collect();
    let turned = |object: u32, covariance: DMat3| {
        let turn = DMat3::from_quat(environment.objects()[object as usize].world_from_object.rotation);
        turn.transpose() * covariance * turn
    };
    let path = |object: u32| environment.objects()[object as usize].name.clone();
    match (track.kind, &feet[..], &places[..]) {
        (Kind::Reflector, [Some((object, at))], [(_, c)]) => {
            Some((path(*object), FeatureShape::Reflector { at: *at, covariance: turned(*object, *c) }, None))
        }
        (Kind::Reflector, [None], [(place, covariance)]) => {
            let reflector = FeatureShape::Reflector { at: DVec3::ZERO, covariance: *covariance };
            Some((name.to_owned(), reflector, Some(plate(name, *place, track.from))))
        }
        (Kind::Corner, [Some((object, at))], [(_, c)]) => {
            Some((path(*object), FeatureShape::Point { at: *at, covariance: turned(*object, *c) }, None))
        }
        (Kind::Edge, [Some((object, a)), Some((other, b))], [(_, first), (_, last)]) if object == other => {
            let covariances = [turned(*object, *first), turned(*object, *last)];
            let middle = caster?.nearest_on(*object, 0.5 * (*a + *b), 1e-3)?;
            let is_on_surface = middle.distance_squared < 1e-6 && a.distance(*b) > 0.0;
            is_on_surface.then(|| {
                (path(*object), FeatureShape::Segment { ends: [*a, *b], covariances, cross: DMat3::ZERO }, None)
            })
        }
        _ => None,
    }
}

/// A small upright plate at a point of the world that faces the sensor, marked as uncertain. The point is its origin.
fn plate(name: &str, place: DVec3, sensor: DVec3) -> [Edit; 2] {
    let yaw = (sensor.y - place.y).atan2(sensor.x - place.x);
    let corner = |y: f32, z: f32| [0.0, y * HALF_PLATE, z * HALF_PLATE];
    let vertices = vec![corner(-1.0, -1.0), corner(1.0, -1.0), corner(1.0, 1.0), corner(-1.0, 1.0)];
    let shape = ShapeSource::Polygons { vertices, polygons: vec![vec![0, 1, 2, 3]] };
    let pose = EditPose::Upright { translation: place, yaw };
    let insert = Edit::Insert { object: name.to_owned(), pose, shape };
    [insert, mark(name.to_owned(), name, MarkKind::Uncertain, None, None)]
}

/// Weighted mean of the layer's value and of measured values.
fn mean(before: Option<f64>, (sum, count): Mean) -> Option<f64> {
    let (known, weight) = before.map_or((0.0, 0.0), |value| (value, LAYER_WEIGHT));
    (count > 0.0).then(|| ((weight * known + sum) / (weight + count)).clamp(0.0, 1.0)).or(before)
}

/// The posterior existence of a feature.
fn after(before: &Existence, views: &FeatureEvidence, share: f64, utc: f64) -> Existence {
    let time = if views.found > 0 { views.last + utc } else { before.confirmed };
    // A layer that states certainty gets the usual prior.
    let unstated = if before.p0 == 1.0 { UNSTATED } else { 1.0 };
    let prior = (unstated * before.at(time)).clamp(1e-6, 1.0 - 1e-6);
    let [found, missed] = [(share / FALSE_SHARE).ln(), ((1.0 - share) / (1.0 - FALSE_SHARE)).ln()];
    let l = f64::from(views.found) * found + f64::from(views.missed) * missed;
    Existence { p0: posterior(prior, l), confirmed: time.max(before.confirmed), rate: before.rate }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::change::existence::MAX_LOG_ODDS;

    /// By hand, with a share of 0.9: a view that finds it multiplies the odds by 18, a view that misses it by 0.1 /
    /// 0.95.
    #[test]
    fn existence_follows_bayes() {
        let half = Existence { p0: 0.5, confirmed: 10.0, rate: 0.0 };
        let views = |found, missed, last| FeatureEvidence { found, missed, last, ..FeatureEvidence::default() };
        let seen = |found, missed| after(&half, &views(found, missed, 20.0), 0.9, 0.0);
        let odds = |e: Existence| e.p0 / (1.0 - e.p0);
        assert!((odds(seen(1, 0)) - 18.0).abs() < 1e-9 && seen(1, 0).confirmed == 20.0);
        assert!((odds(seen(0, 2)) - (0.1 / 0.95f64).powi(2)).abs() < 1e-9 && seen(0, 2).confirmed == 10.0);
        // Ten passes that miss it, and the limit of one run.
        assert!(seen(0, 10).p0 < 0.02 && (odds(seen(0, 100)).ln() + MAX_LOG_ODDS).abs() < 1e-6);
        // An old confirmation has decayed to the lowest prior, one in a million, when the next one comes.
        let old = Existence { p0: 1.0, confirmed: 0.0, rate: 1.0 };
        let again = after(&old, &views(1, 0, 100.0), 0.9, 0.0);
        assert!((odds(again) / 18e-6 - 1.0).abs() < 1e-5, "{again:?}");
    }

    /// A layer's strength has the weight of ten views.
    #[test]
    fn strength_is_a_weighted_mean() {
        assert_eq!(mean(None, (1.5, 3.0)), Some(0.5));
        assert_eq!(mean(Some(0.8), (0.0, 0.0)), Some(0.8));
        assert!((mean(Some(0.8), (4.0, 10.0)).unwrap() - 0.6).abs() < 1e-12);
    }
}
