//! Evidence on features: which views found them, and which missed them.

use crate::evidence::features::blind::{Counts, Region, is_blind, region};
use crate::evidence::features::located::{Offsets, SensorAtPose};
use crate::evidence::features::sightings::{Mean, Sighting, Tracks, add_value, place_of};
use presight_localize::extract::{FeatureClass, FeatureFinding, FeatureFindings};
use presight_model::caster::RayCaster;
use presight_model::environment::{Environment, Feature, FeatureShape};
use presight_model::geometry::{Pose, PoseEstimate};
use presight_model::measured::Frame;
use std::collections::{BTreeMap, BTreeSet};

/// Prior of the share of visible features that an extractor finds: nine of ten.
const PRIOR_SHARE: (f64, f64) = (9.0, 10.0);
/// A view that finds a smaller share of the visible features misses them for a common reason.
const MIN_FOUND: f64 = 0.5;

/// One view of a feature.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct FeatureView {
    pub class: String,
    pub id: u32,
    pub found: bool,
    pub strength: Option<f64>,
    pub contrast: Option<f64>,
    /// The part of the image in which it is predicted.
    pub region: Region,
    /// Its offset from the predicted place.
    pub offset: Option<Offsets>,
}

/// The features that one image shows.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct FeatureViews {
    pub known: Vec<FeatureView>,
    /// Features that the layer lacks.
    pub unknown: Vec<Sighting>,
}

/// The features and surfaces that frames of a class are compared with.
#[derive(Clone, Copy)]
pub(crate) struct KnownFeatures<'a> {
    pub environment: &'a Environment,
    pub caster: &'a RayCaster,
}

impl KnownFeatures<'_> {
    /// Positions of the points of an edge's part along the edge, 0 to 1; `None` for another feature.
    fn shares(&self, class: &str, found: &FeatureFinding) -> Option<[f64; 2]> {
        let feature = self.environment.feature(class, found.id)?;
        let FeatureShape::Segment { ends, .. } = &feature.shape else { return None };
        let pose = pose_of(self.environment, feature);
        let [a, b] = ends.map(|p| pose.transform_point(p));
        let share = |p: &glam::DVec3| (*p - a).dot(b - a) / (b - a).length_squared();
        Some([share(found.points_world.first()?), share(found.points_world.last()?)])
    }
}

/// The pose of a feature's object; the identity for a feature of the world.
pub(crate) fn pose_of(environment: &Environment, feature: &Feature) -> Pose {
    let object = feature.object.as_deref().and_then(|path| environment.object(path));
    object.map_or(Pose::IDENTITY, |o| o.world_from_object)
}

/// The features in one image. If most of them are missed, a common reason such as a dark image is assumed, and the
/// image is ignored.
pub(crate) fn features_in(
    frame: &Frame,
    findings: &FeatureFindings,
    pose: &PoseEstimate,
    known: &KnownFeatures<'_>,
) -> FeatureViews {
    let sensor = SensorAtPose::new(frame.sensor(), pose);
    let class = &frame.sensor().spec().class;
    let mut views: BTreeMap<u32, FeatureView> = BTreeMap::new();
    let (mut found, mut all) = (0usize, 0usize);
    for feature in &findings.features {
        let at = match feature.class {
            FeatureClass::Matched(at) => Some(&findings.detections[at]),
            FeatureClass::Missing | FeatureClass::Undecidable => None,
            FeatureClass::Occluded => continue,
        };
        (found, all) = (found + usize::from(at.is_some()), all + 1);
        // The parts of one edge are one feature, which is found if one of its parts is.
        if views.get(&feature.id).is_some_and(|view| view.found) {
            continue;
        }
        let offset = |d| Offsets::of(&sensor, d, &feature.points_world, known.shares(class, feature));
        let view = FeatureView {
            class: class.clone(),
            id: feature.id,
            found: at.is_some(),
            strength: at.and_then(|d| d.properties.strength),
            contrast: at.and_then(|d| d.properties.contrast),
            region: region(frame.sensor(), feature.predicted.centre()),
            offset: at.and_then(offset),
        };
        views.insert(feature.id, view);
    }
    if (found as f64) < MIN_FOUND * all as f64 || (found == 0 && all > 0) {
        return FeatureViews::default();
    }
    let detected = findings.only_found.iter().map(|at| &findings.detections[*at]);
    let unknown = detected.filter_map(|d| place_of(&sensor, d, known.caster)).collect();
    FeatureViews { known: views.into_values().collect(), unknown }
}

/// All views of one feature.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct FeatureEvidence {
    pub found: u32,
    pub missed: u32,
    /// Stamp of the last view that found it, seconds.
    pub last: f64,
    pub strength: Mean,
    pub contrast: Mean,
    pub offsets: Offsets,
    /// Views that found and that missed it, by part of the image.
    pub regions: Counts,
}

/// All evidence on features.
#[derive(Clone, Debug, Default)]
pub(crate) struct FeatureBook {
    all: BTreeMap<(String, u32), FeatureEvidence>,
    /// Features that the layers lack.
    pub new: Tracks,
}

impl FeatureBook {
    pub fn add(&mut self, views: &FeatureViews, stamp: f64) {
        for view in &views.known {
            let own = self.all.entry((view.class.clone(), view.id)).or_default();
            let here = own.regions.entry(view.region.clone()).or_default();
            *here = (here.0 + u32::from(view.found), here.1 + u32::from(!view.found));
            if !view.found {
                own.missed += 1;
                continue;
            }
            (own.found, own.last) = (own.found + 1, stamp);
            add_value(&mut own.strength, view.strength);
            add_value(&mut own.contrast, view.contrast);
            view.offset.iter().for_each(|offset| own.offsets.add(offset));
        }
        self.new.add(&views.unknown, stamp);
    }

    /// The evidence on each feature, without views that missed it in a blind part of the image.
    pub fn sighted(&self) -> BTreeMap<&(String, u32), FeatureEvidence> {
        let regions: BTreeSet<&Region> = self.all.values().flat_map(|own| own.regions.keys()).collect();
        let counts = || self.all.values().map(|own| &own.regions);
        let blind: BTreeSet<&Region> = regions.into_iter().filter(|region| is_blind(region, counts())).collect();
        let sighted = |own: &FeatureEvidence| {
            let hidden: u32 =
                own.regions.iter().filter(|(r, _)| blind.contains(r)).map(|(_, (_, missed))| missed).sum();
            FeatureEvidence { missed: own.missed - hidden, ..own.clone() }
        };
        self.all.iter().map(|(key, own)| (key, sighted(own))).collect()
    }

    /// The share of views in which the extractor finds an existing feature of a class.
    pub fn share(&self, class: &str) -> f64 {
        let all = self.sighted();
        let standing = all.iter().filter(|((own, _), views)| own == class && views.found > views.missed);
        let (found, all) = standing.fold(PRIOR_SHARE, |(found, all), (_, views)| {
            (found + f64::from(views.found), all + f64::from(views.found + views.missed))
        });
        (found / all).clamp(0.5, 0.99)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::{DMat3, DVec2};
    use presight_localize::matching::{Detection, Shape};
    use presight_model::geometry::{PoseCovariance, RobotPose};
    use presight_model::measured::Measurement;
    use presight_model::sensor::Sensor;
    use presight_model::world::World;

    fn scan() -> Frame {
        let text = "format = 1\nkind = \"scanner\"\nclass = \"laser\"\nrange_max = 20\n[azimuth]\nstart_deg = -90\n\
            step_deg = 1\ncount = 181\n[elevation]\nstart_deg = 0\nstep_deg = 1\ncount = 1\n";
        let spec = presight_read::sensor_toml::parse(text, "scan", None).unwrap();
        Frame::new(0.0, Sensor::new(spec).unwrap(), Measurement::Range(vec![1.0; 181])).unwrap()
    }

    #[test]
    fn a_dark_image_is_ignored() {
        let world = World::new(Environment::new());
        let caster = RayCaster::new(&world, "laser");
        let known = KnownFeatures { environment: world.environment(), caster: &caster };
        let finding = |id: u32, class: FeatureClass| FeatureFinding {
            id,
            points_world: Vec::new(),
            place: DMat3::ZERO,
            existence: 1.0,
            predicted: Shape::Point(DVec2::ZERO),
            class,
        };
        let pose = PoseEstimate::new(RobotPose::IDENTITY, PoseCovariance::from_sigmas([0.001; 6]));
        let of = |classes: &[FeatureClass]| {
            let features = (1..).zip(classes).map(|(id, class)| finding(id, *class)).collect();
            let detections = vec![Detection::point(DVec2::ZERO, 0.5)];
            features_in(&scan(), &FeatureFindings { features, detections, ..FeatureFindings::default() }, &pose, &known)
        };
        let (matched, missing) = (FeatureClass::Matched(0), FeatureClass::Missing);
        assert!(of(&[missing, missing, missing, matched]).known.is_empty());
        let views = of(&[matched, matched, missing, FeatureClass::Occluded]).known;
        let found: Vec<_> = views.iter().map(|view| (view.id, view.found)).collect();
        assert_eq!(found, [(1, true), (2, true), (3, false)]);
    }
}
