//! Parts of an image in which all features are missed, such as those behind dirt on the lens.

use presight_model::sensor::Sensor;
use std::collections::BTreeMap;

/// Number of parts along each side of an image.
const SIDE: f64 = 8.0;
/// Minimum number of features, or of views, that are missed for a common reason.
const MIN_MISSED: u32 = 3;

/// A part of a sensor's image.
pub(crate) type Region = (String, u8);

/// The part of an image that contains a pixel.
pub(crate) fn region(sensor: &Sensor, at: glam::DVec2) -> Region {
    let part = |x: f64, size: u32| ((x + 0.5) / f64::from(size) * SIDE).floor().clamp(0.0, SIDE - 1.0) as u8;
    let (column, row) = (part(at.x, sensor.width()), part(at.y, sensor.height()));
    (sensor.spec().name.clone(), row * SIDE as u8 + column)
}

/// Numbers of views that found and that missed one feature, by part of the image.
pub(crate) type Counts = BTreeMap<Region, (u32, u32)>;

/// True for a blind part of an image: it misses most features that other parts find, or it never showed any of several
/// features.
pub(crate) fn is_blind<'a>(region: &Region, features: impl Iterator<Item = &'a Counts>) -> bool {
    let (mut found, mut missed, mut ever, mut count) = (0, 0, 0, 0);
    for counts in features {
        let Some(&(here, not)) = counts.get(region) else { continue };
        let (all, lost) = counts.values().fold((0, 0), |sum, c| (sum.0 + c.0, sum.1 + c.1));
        // A feature exists if most views in other parts find it.
        if all - here > lost - not {
            (found, missed) = (found + here, missed + not);
        }
        (ever, count) = (ever + here, count + 1);
    }
    (missed > found && found + missed >= MIN_MISSED) || (ever == 0 && count >= MIN_MISSED)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Two features exist, and one is gone. Dirt in part 1 hides all three there.
    #[test]
    fn dirt_is_not_evidence_against_a_feature() {
        let counts = |of: &[(u8, (u32, u32))]| -> Counts {
            of.iter().map(|(part, c)| (("camera".to_owned(), *part), *c)).collect()
        };
        let standing = counts(&[(0, (5, 0)), (1, (0, 4))]);
        let gone = counts(&[(0, (0, 5)), (1, (0, 4))]);
        let part = |k: u8| ("camera".to_owned(), k);
        let all = [standing.clone(), standing.clone(), gone.clone()];
        assert!(is_blind(&part(1), all.iter()) && !is_blind(&part(0), all.iter()));
        // A single feature that is missed is gone, because no other feature shows that the lens is dirty.
        assert!(!is_blind(&part(1), std::iter::once(&gone)));
        // Three features that were never found in a part, and that no other part shows.
        let never = counts(&[(1, (0, 2))]);
        assert!(is_blind(&part(1), [never.clone(), never.clone(), never].iter()));
    }
}
