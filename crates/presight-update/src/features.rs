//! Minor changes of features: whether they exist, by Bayes from the looks at them.

use presight_files::layer::to_fields;
use presight_localize::extract::{FeatureClass, Findings};
use presight_model::environment::{Environment, Existence, Feature};
use serde_json::{Value, json};
use std::collections::BTreeMap;

/// The share of looks in which an extractor finds something where nothing is.
const FALSE: f64 = 0.05;
/// The share of successful looks is learnt from here on: nine of ten.
const BEFORE: (f64, f64) = (9.0, 10.0);
/// Below this existence a feature is deleted.
const LEAST: f64 = 0.02;
/// In one view: if fewer of the features that might be found are found, they fail for one reason.
const TOGETHER: f64 = 0.5;
/// The most that the evidence of one run counts, natural logarithm of odds.
const MOST: f64 = 13.8;

/// The looks at one feature.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct Looks {
    found: u32,
    missed: u32,
    /// Stamp of the last view that found it, seconds.
    last: f64,
}

/// One view of a feature: its class of sensors, its id, and whether it was found.
pub(crate) type Look = (String, u32, bool);

/// The looks of one image. What fails together fails for one reason, such as a dark image, and says nothing.
pub(crate) fn looks_of(class: &str, findings: &Findings) -> Vec<Look> {
    let look = |found: bool| move |id: u32| (class.to_owned(), id, found);
    let (mut all, mut found) = (Vec::new(), 0usize);
    for feature in &findings.features {
        match feature.class {
            FeatureClass::Matched(_) => {
                found += 1;
                all.push(look(true)(feature.id));
            }
            FeatureClass::Missing | FeatureClass::Undecidable => all.push(look(false)(feature.id)),
            FeatureClass::Occluded => {}
        }
    }
    if (found as f64) < TOGETHER * all.len() as f64 || found == 0 {
        return Vec::new();
    }
    // Parts of one edge are one feature: it is found if one of its parts is.
    let mut merged: BTreeMap<u32, bool> = BTreeMap::new();
    all.into_iter().for_each(|(_, id, found)| *merged.entry(id).or_default() |= found);
    merged.into_iter().map(|(id, found)| look(found)(id)).collect()
}

/// All looks so far.
#[derive(Clone, Debug, Default)]
pub(crate) struct LookBook {
    all: BTreeMap<(String, u32), Looks>,
}

impl LookBook {
    pub fn add(&mut self, looks: &[Look], stamp: f64) {
        for (class, id, found) in looks {
            let looks = self.all.entry((class.clone(), *id)).or_default();
            if *found {
                (looks.found, looks.last) = (looks.found + 1, stamp);
            } else {
                looks.missed += 1;
            }
        }
    }

    /// The share of looks in which the extractor finds a feature of a class that exists.
    fn share(&self, class: &str) -> f64 {
        let standing = self.all.iter().filter(|((own, _), looks)| own == class && looks.found > looks.missed);
        let (found, all) = standing.fold(BEFORE, |(found, all), (_, looks)| {
            (found + f64::from(looks.found), all + f64::from(looks.found + looks.missed))
        });
        (found / all).clamp(0.5, 0.99)
    }

    /// Operations that set the existence of features, and delete features that hardly exist.
    pub fn changes(&self, environment: &Environment, least_views: u32, utc: f64) -> Vec<Value> {
        let change = |((class, id), looks): (&(String, u32), &Looks)| {
            let feature = environment.feature(class, *id)?;
            let after = after(&feature.existence, looks, self.share(class), utc);
            if after.p0 < LEAST && looks.missed >= least_views {
                return Some(json!({"op": "delete_feature", "class": class, "feature": id}));
            }
            let feature = Feature { existence: after, ..feature.clone() };
            let fields = serde_json::to_value(to_fields(&feature)).ok()?;
            Some(json!({"op": "set_feature", "class": class, "feature": fields}))
        };
        self.all.iter().filter_map(change).collect()
    }
}

/// The existence of a feature after looks at it.
fn after(before: &Existence, looks: &Looks, share: f64, utc: f64) -> Existence {
    let time = if looks.found > 0 { looks.last + utc } else { before.confirmed };
    let prior = before.at(time).clamp(1e-9, 1.0 - 1e-9);
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
        let seen = |found, missed| after(&half, &Looks { found, missed, last: 20.0 }, 0.9, 0.0);
        let odds = |e: Existence| e.p0 / (1.0 - e.p0);
        assert!((odds(seen(1, 0)) - 18.0).abs() < 1e-9 && seen(1, 0).confirmed == 20.0);
        assert!((odds(seen(0, 2)) - (0.1 / 0.95f64).powi(2)).abs() < 1e-9 && seen(0, 2).confirmed == 10.0);
        // Ten passes that miss it; and the limit of one run.
        assert!(seen(0, 10).p0 < 0.02 && (odds(seen(0, 100)).ln() + MOST).abs() < 1e-6);
        // A confirmation long ago has decayed when the next one comes.
        let old = Existence { p0: 1.0, confirmed: 0.0, rate: 1.0 };
        assert!(after(&old, &Looks { found: 1, missed: 0, last: 100.0 }, 0.9, 0.0).p0 < 1e-6);
    }

    #[test]
    fn a_dark_image_teaches_nothing() {
        let finding = |id: u32, class: FeatureClass| presight_localize::extract::FeatureFinding {
            id,
            points_world: Vec::new(),
            place: glam::DMat3::ZERO,
            predicted: presight_localize::matching::Shape::Point(glam::DVec2::ZERO),
            class,
        };
        let of = |classes: &[FeatureClass]| {
            let features = (1..).zip(classes).map(|(id, class)| finding(id, *class)).collect();
            looks_of("video", &Findings { features, ..Findings::default() })
        };
        let (matched, missing) = (FeatureClass::Matched(0), FeatureClass::Missing);
        assert!(of(&[missing, missing, missing, matched]).is_empty());
        let told = of(&[matched, matched, missing, FeatureClass::Occluded]);
        assert_eq!(
            told.iter().map(|(_, id, found)| (*id, *found)).collect::<Vec<_>>(),
            [(1, true), (2, true), (3, false)]
        );
    }
}
