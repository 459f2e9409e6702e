//! Minor changes of features: existence, strength, contrast and covariance, by Bayes from the looks at them; and new features.

use crate::blind::{Counts, Region, is_blind, region};
use crate::caster::Caster;
use crate::located::{Eye, Sums, located};
use crate::sightings::{Kind, Sighting, Track, Tracks, place_of};
use crate::view::BOUND;
use glam::{DMat3, DVec3};
use presight_localize::extract::{FeatureClass, FeatureFinding, FeatureFindings};
use presight_model::environment::{Environment, Existence, Feature, FeatureShape, Properties};
use presight_model::geometry::{Pose, PoseEstimate};
use presight_model::measured::Frame;
use presight_read::layer::to_fields;
use serde_json::{Value, json};
use std::collections::{BTreeMap, BTreeSet};

/// The share of looks in which an extractor finds something where nothing is.
const FALSE: f64 = 0.05;
/// Existence where the layer says 1: one in a hundred features of a model is not there.
const UNSTATED: f64 = 0.99;
/// The share of successful looks is learnt from here on: nine of ten.
const BEFORE: (f64, f64) = (9.0, 10.0);
/// Below this existence a feature is deleted.
const LEAST: f64 = 0.02;
/// In one view: if fewer of the features that might be found are found, they fail for one reason.
const TOGETHER: f64 = 0.5;
/// The most that the evidence of one run counts, natural logarithm of odds.
const MOST: f64 = 13.8;
/// Strength and contrast of the layer count as much as this number of looks.
const KNOWN: f64 = 10.0;

/// One view of a feature.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Look {
    pub class: String,
    pub id: u32,
    pub found: bool,
    pub strength: Option<f64>,
    pub contrast: Option<f64>,
    /// The part of the image where it should be.
    pub region: Region,
    /// How far from its place it was found.
    pub off: Option<Sums>,
}

/// What one image shows of features.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct Looked {
    pub looks: Vec<Look>,
    /// Features that the layer lacks.
    pub only_found: Vec<Sighting>,
}

/// What frames of a class are compared with.
#[derive(Clone, Copy)]
pub(crate) struct Known<'a> {
    pub environment: &'a Environment,
    pub caster: &'a Caster,
}

impl Known<'_> {
    /// Where along an edge the points of its part are; `None` for another feature.
    fn shares(&self, class: &str, found: &FeatureFinding) -> Option<[f64; 2]> {
        let feature = self.environment.feature(class, found.id)?;
        let FeatureShape::Segment { ends, .. } = &feature.shape else { return None };
        let pose = pose_of(self.environment, feature);
        let [a, b] = ends.map(|p| pose.transform_point(p));
        let share = |p: &DVec3| (*p - a).dot(b - a) / (b - a).length_squared();
        Some([share(found.points_world.first()?), share(found.points_world.last()?)])
    }
}

/// The pose of a feature's object; the world's for one without.
fn pose_of(environment: &Environment, feature: &Feature) -> Pose {
    let object = feature.object.as_deref().and_then(|path| environment.object(path));
    object.map_or(Pose::IDENTITY, |o| o.world_from_object)
}

/// The looks of one image. What fails together fails for one reason, such as a dark image, and says nothing.
pub(crate) fn looks_of(frame: &Frame, findings: &FeatureFindings, pose: &PoseEstimate, known: &Known<'_>) -> Looked {
    let eye = Eye::new(frame.sensor(), pose);
    let class = &frame.sensor().spec().class;
    let mut looks: BTreeMap<u32, Look> = BTreeMap::new();
    let (mut found, mut all) = (0usize, 0usize);
    for feature in &findings.features {
        let at = match feature.class {
            FeatureClass::Matched(at) => Some(&findings.detections[at]),
            FeatureClass::Missing | FeatureClass::Undecidable => None,
            FeatureClass::Occluded => continue,
        };
        (found, all) = (found + usize::from(at.is_some()), all + 1);
        // Parts of one edge are one feature: it is found if one of its parts is.
        let before = looks.get(&feature.id).is_some_and(|look| look.found);
        if !before {
            let look = Look {
                class: class.clone(),
                id: feature.id,
                found: at.is_some(),
                strength: at.and_then(|d| d.properties.strength),
                contrast: at.and_then(|d| d.properties.contrast),
                region: region(frame.sensor(), feature.predicted.centre()),
                off: at.and_then(|d| Sums::of(&eye, d, &feature.points_world, known.shares(class, feature))),
            };
            looks.insert(feature.id, look);
        }
    }
    if (found as f64) < TOGETHER * all as f64 || (found == 0 && all > 0) {
        return Looked::default();
    }
    let detected = findings.only_found.iter().map(|at| &findings.detections[*at]);
    let only_found = detected.filter_map(|d| place_of(&eye, d, known.caster)).collect();
    Looked { looks: looks.into_values().collect(), only_found }
}

/// The looks at one feature.
#[derive(Clone, Debug, Default, PartialEq)]
struct Looks {
    found: u32,
    missed: u32,
    /// Stamp of the last view that found it, seconds.
    last: f64,
    /// Sums and numbers of measured strengths and contrasts.
    strength: (f64, f64),
    contrast: (f64, f64),
    off: Sums,
    /// The same looks, by part of the image.
    regions: Counts,
}

/// All looks so far.
#[derive(Clone, Debug, Default)]
pub(crate) struct LookBook {
    all: BTreeMap<(String, u32), Looks>,
    /// Features that were only found.
    new: Tracks,
}

impl LookBook {
    pub fn add(&mut self, looked: &Looked, stamp: f64) {
        for look in &looked.looks {
            let looks = self.all.entry((look.class.clone(), look.id)).or_default();
            let here = looks.regions.entry(look.region.clone()).or_default();
            *here = (here.0 + u32::from(look.found), here.1 + u32::from(!look.found));
            if !look.found {
                looks.missed += 1;
                continue;
            }
            (looks.found, looks.last) = (looks.found + 1, stamp);
            for (sum, value) in [(&mut looks.strength, look.strength), (&mut looks.contrast, look.contrast)] {
                *sum = value.map_or(*sum, |value| (sum.0 + value, sum.1 + 1.0));
            }
            look.off.iter().for_each(|off| looks.off.add(off));
        }
        self.new.add(&looked.only_found, stamp);
    }

    /// All looks, without the misses in blind parts of images.
    fn sighted(&self) -> BTreeMap<&(String, u32), Looks> {
        let regions: BTreeSet<&Region> = self.all.values().flat_map(|looks| looks.regions.keys()).collect();
        let counts = || self.all.values().map(|looks| &looks.regions);
        let blind: BTreeSet<&Region> = regions.into_iter().filter(|region| is_blind(region, counts())).collect();
        let seen = |looks: &Looks| {
            let lost: u32 =
                looks.regions.iter().filter(|(r, _)| blind.contains(r)).map(|(_, (_, missed))| missed).sum();
            Looks { missed: looks.missed - lost, ..looks.clone() }
        };
        self.all.iter().map(|(key, looks)| (key, seen(looks))).collect()
    }

    /// The share of looks in which the extractor finds a feature of a class that exists.
    fn share(&self, class: &str) -> f64 {
        let all = self.sighted();
        let standing = all.iter().filter(|((own, _), looks)| own == class && looks.found > looks.missed);
        let (found, all) = standing.fold(BEFORE, |(found, all), (_, looks)| {
            (found + f64::from(looks.found), all + f64::from(looks.found + looks.missed))
        });
        (found / all).clamp(0.5, 0.99)
    }

    /// Operations that set the attributes of features, and delete features that hardly exist. `stood` is the world that was looked at, and
    /// `stands` the same with objects where they were found.
    pub fn changes(&self, (stood, stands): (&Environment, &Environment), least_views: u32, utc: f64) -> Vec<Value> {
        let all = self.sighted();
        let shares: BTreeMap<&str, f64> = all.keys().map(|(class, _)| (class.as_str(), self.share(class))).collect();
        let change = |((class, id), looks): (&&(String, u32), &Looks)| {
            let feature = stood.feature(class, *id).filter(|_| looks.found + looks.missed > 0)?;
            let existence = after(&feature.existence, looks, shares[class.as_str()], utc);
            if existence.p0 < LEAST && looks.missed >= least_views {
                return Some(json!({"op": "delete_feature", "class": class, "feature": id}));
            }
            let properties = Properties {
                strength: mean(feature.properties.strength, looks.strength),
                contrast: mean(feature.properties.contrast, looks.contrast),
                ..feature.properties.clone()
            };
            let shape = located(feature, &looks.off, (&pose_of(stood, feature), &pose_of(stands, feature)));
            let feature = Feature { existence, properties, shape, ..feature.clone() };
            let fields = serde_json::to_value(to_fields(&feature)).ok()?;
            Some(json!({"op": "set_feature", "class": class, "feature": fields}))
        };
        all.iter().filter_map(change).collect()
    }

    /// Operations that insert features that were only found, at one place in space from several views: on the surface there, or
    /// a reflector on a small provisional object. `base` names it.
    pub fn insertions(
        &self,
        (environment, casters): (&Environment, &BTreeMap<String, Caster>),
        least_views: u32,
        utc: f64,
        base: &str,
    ) -> Vec<Value> {
        let mut next: BTreeMap<&str, u32> = BTreeMap::new();
        let mut all = Vec::new();
        for track in self.new.iter().filter(|track| track.views >= least_views) {
            let class = track.class.as_str();
            let last = || environment.layer(class).and_then(|l| l.features.iter().map(|f| f.id).max()).unwrap_or(0);
            let id = next.get(class).copied().unwrap_or_else(last) + 1;
            let name = format!("provisional/{base} reflector {id}");
            let Some((object, shape, support)) = placed(track, environment, casters.get(class), &name) else {
                continue;
            };
            next.insert(class, id);
            let looks = Looks { found: track.views, last: track.last, ..Looks::default() };
            let prior = Existence { p0: FALSE, confirmed: track.last + utc, rate: 0.0 };
            let existence = after(&prior, &looks, self.share(class), utc);
            let properties = Properties {
                strength: mean(None, track.strength),
                contrast: mean(None, track.contrast),
                ..Properties::default()
            };
            let feature = Feature { id, name: None, object: Some(object), shape, existence, properties };
            let Ok(fields) = serde_json::to_value(to_fields(&feature)) else { continue };
            let insert = json!({"op": "insert_feature", "class": class, "feature": fields});
            let changes: Vec<Value> = support.into_iter().flatten().chain([insert]).collect();
            let what = match track.kind {
                Kind::Reflector => "a reflector",
                Kind::Corner => "a corner",
                Kind::Edge => "an edge",
            };
            let cause = format!("{what} was found at {:.2} from {} views", track.places()[0].0, track.views);
            all.push(json!({"op": "group", "changes": changes, "cause": cause, "evidence": {"views": track.views}}));
        }
        all
    }
}

type Placed = (String, FeatureShape, Option<[Value; 2]>);

/// Where a new feature lies: on the surface near all its points, which are of one object. A reflector that stands free gets
/// a support with this name.
fn placed(track: &Track, environment: &Environment, caster: Option<&Caster>, name: &str) -> Option<Placed> {
    let places = track.places();
    let on = |(p, covariance): &(DVec3, DMat3)| {
        // The place of an edge is known across it only.
        let [x, y, z] = [0, 1, 2].map(|i| covariance.col(i)[i]);
        caster?.on(*p, BOUND * x.min(y).min(z).sqrt() + 0.02)
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
            let (op, at) = support(name, *place, track.from);
            Some((name.to_owned(), FeatureShape::Reflector { at, covariance: *covariance }, Some(op)))
        }
        (Kind::Corner, [Some((object, at))], [(_, c)]) => {
            Some((path(*object), FeatureShape::Point { at: *at, covariance: turned(*object, *c) }, None))
        }
        (Kind::Edge, [Some((object, a)), Some((other, b))], [(_, first), (_, last)]) if object == other => {
            let covariances = [turned(*object, *first), turned(*object, *last)];
            let middle = caster?.foot(*object, 0.5 * (*a + *b), 1e-3)?;
            let straight = middle.distance_squared < 1e-6 && a.distance(*b) > 0.0;
            straight.then(|| {
                (path(*object), FeatureShape::Segment { ends: [*a, *b], covariances, cross: DMat3::ZERO }, None)
            })
        }
        _ => None,
    }
}

/// A small upright plate through a point that faces where it was seen from, marked as uncertain: its operations, and the point in
/// its frame.
fn support(name: &str, place: DVec3, from: DVec3) -> ([Value; 2], DVec3) {
    const HALF: f32 = 0.02;
    let yaw = (from.y - place.y).atan2(from.x - place.x);
    let corner = |y: f32, z: f32| [0.0, y * HALF, z * HALF];
    let vertices = [corner(-1.0, -1.0), corner(1.0, -1.0), corner(1.0, 1.0), corner(-1.0, 1.0)];
    let pose = [place.x, place.y, place.z, 0.0, 0.0, yaw.to_degrees()];
    let insert =
        json!({"op": "insert_object", "object": name, "pose": pose, "vertices": vertices, "polygons": [[0, 1, 2, 3]]});
    let mark = json!({"op": "set_mark", "mark": name, "object": name, "kind": "uncertain"});
    ([insert, mark], DVec3::ZERO)
}

/// A mean of what the layer says, which counts as several looks, and of the looks.
fn mean(before: Option<f64>, (sum, count): (f64, f64)) -> Option<f64> {
    let (known, weight) = before.map_or((0.0, 0.0), |value| (value, KNOWN));
    (count > 0.0).then(|| ((KNOWN.min(weight) * known + sum) / (weight + count)).clamp(0.0, 1.0)).or(before)
}

/// The existence of a feature after looks at it.
fn after(before: &Existence, looks: &Looks, share: f64, utc: f64) -> Existence {
    let time = if looks.found > 0 { looks.last + utc } else { before.confirmed };
    // A layer that states no doubt knows no better than others.
    let known = if before.p0 == 1.0 { UNSTATED } else { 1.0 };
    let prior = (known * before.at(time)).clamp(1e-6, 1.0 - 1e-6);
    let each = [(share / FALSE).ln(), ((1.0 - share) / (1.0 - FALSE)).ln()];
    let l = f64::from(looks.found) * each[0] + f64::from(looks.missed) * each[1];
    let odds = (prior / (1.0 - prior)).ln() + l.clamp(-MOST, MOST);
    Existence { p0: 1.0 / (1.0 + (-odds).exp()), confirmed: time.max(before.confirmed), rate: before.rate }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// By hand, with a share of 0.9: a look that finds it multiplies the odds by 18, one that misses it by 0.1 / 0.95.
    #[test]
    fn existence_follows_bayes() {
        let half = Existence { p0: 0.5, confirmed: 10.0, rate: 0.0 };
        let seen = |found, missed| after(&half, &Looks { found, missed, last: 20.0, ..Looks::default() }, 0.9, 0.0);
        let odds = |e: Existence| e.p0 / (1.0 - e.p0);
        assert!((odds(seen(1, 0)) - 18.0).abs() < 1e-9 && seen(1, 0).confirmed == 20.0);
        assert!((odds(seen(0, 2)) - (0.1 / 0.95f64).powi(2)).abs() < 1e-9 && seen(0, 2).confirmed == 10.0);
        // Ten passes that miss it; and the limit of one run.
        assert!(seen(0, 10).p0 < 0.02 && (odds(seen(0, 100)).ln() + MOST).abs() < 1e-6);
        // A confirmation long ago has decayed to the least prior, one in a million, when the next one comes.
        let old = Existence { p0: 1.0, confirmed: 0.0, rate: 1.0 };
        let again = after(&old, &Looks { found: 1, last: 100.0, ..Looks::default() }, 0.9, 0.0);
        assert!((odds(again) / 18e-6 - 1.0).abs() < 1e-5, "{again:?}");
    }

    fn scan() -> Frame {
        let text = "format = 1\nkind = \"scanner\"\nclass = \"laser\"\nrange_max = 20\n[azimuth]\nstart_deg = -90\nstep_deg = 1\ncount = 181\n[elevation]\nstart_deg = 0\nstep_deg = 1\ncount = 1\n";
        let spec = presight_read::sensor_toml::parse(text, "scan", None).unwrap();
        let sensor = presight_model::sensor::Sensor::new(spec).unwrap();
        Frame::new(0.0, sensor, presight_model::measured::Measurement::Range(vec![1.0; 181])).unwrap()
    }

    fn exact() -> PoseEstimate {
        PoseEstimate::new(Pose::IDENTITY, presight_model::geometry::PoseCovariance::from_sigmas([0.001; 6]))
    }

    #[test]
    fn a_dark_image_teaches_nothing() {
        let world = presight_model::world::World::new(Environment::new());
        let caster = Caster::new(&world, "laser");
        let known = Known { environment: world.environment(), caster: &caster };
        let finding = |id: u32, class: FeatureClass| FeatureFinding {
            id,
            points_world: Vec::new(),
            place: DMat3::ZERO,
            existence: 1.0,
            predicted: presight_localize::matching::Shape::Point(glam::DVec2::ZERO),
            class,
        };
        let of = |classes: &[FeatureClass]| {
            let features = (1..).zip(classes).map(|(id, class)| finding(id, *class)).collect();
            let detection = presight_localize::matching::Detection::point(glam::DVec2::ZERO, 0.5);
            looks_of(
                &scan(),
                &FeatureFindings { features, detections: vec![detection], ..FeatureFindings::default() },
                &exact(),
                &known,
            )
        };
        let (matched, missing) = (FeatureClass::Matched(0), FeatureClass::Missing);
        assert!(of(&[missing, missing, missing, matched]).looks.is_empty());
        let looks = of(&[matched, matched, missing, FeatureClass::Occluded]).looks;
        assert_eq!(
            looks.iter().map(|look| (look.id, look.found)).collect::<Vec<_>>(),
            [(1, true), (2, true), (3, false)]
        );
    }

    /// A layer's strength counts as ten looks.
    #[test]
    fn strength_follows_its_looks() {
        assert_eq!(mean(None, (1.5, 3.0)), Some(0.5));
        assert_eq!(mean(Some(0.8), (0.0, 0.0)), Some(0.8));
        assert!((mean(Some(0.8), (4.0, 10.0)).unwrap() - 0.6).abs() < 1e-12);
    }
}
