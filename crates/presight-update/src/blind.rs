//! Parts of an image in which features fail together: dirt on a lens is one reason for all of them.

use presight_model::sensor::Sensor;
use std::collections::BTreeMap;

/// Parts of an image along each side.
const SIDE: f64 = 8.0;
/// Fewest features, or looks, that fail for one reason.
const FEW: u32 = 3;

/// A part of a sensor's image.
pub(crate) type Region = (String, u8);

/// The part of an image that a pixel is in.
pub(crate) fn region(sensor: &Sensor, at: glam::DVec2) -> Region {
    let part = |x: f64, size: u32| ((x + 0.5) / f64::from(size) * SIDE).floor().clamp(0.0, SIDE - 1.0) as u8;
    let (column, row) = (part(at.x, sensor.width()), part(at.y, sensor.height()));
    (sensor.spec().name.clone(), row * SIDE as u8 + column)
}

/// Looks at one feature in each part of the image: how many found it, and how many missed it.
pub(crate) type Counts = BTreeMap<Region, (u32, u32)>;

/// True for a part of the image that shows nothing. Features that are found elsewhere are mostly missed there; or of several
/// features none was ever found there.
pub(crate) fn is_blind<'a>(region: &Region, features: impl Iterator<Item = &'a Counts>) -> bool {
    let (mut found, mut missed, mut ever, mut count) = (0, 0, 0, 0);
    for counts in features {
        let Some(&(here, not)) = counts.get(region) else { continue };
        let (all, lost) = counts.values().fold((0, 0), |sum, c| (sum.0 + c.0, sum.1 + c.1));
        // A feature stands that most of the other looks find.
        if all - here > lost - not {
            (found, missed) = (found + here, missed + not);
        }
        (ever, count) = (ever + here, count + 1);
    }
    (missed > found && found + missed >= FEW) || (ever == 0 && count >= FEW)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Two features that stand, and one that is gone. Dirt in part 1 hides all three there.
    #[test]
    fn dirt_is_no_reason_to_doubt_a_feature() {
        let counts = |of: &[(u8, (u32, u32))]| -> Counts {
            of.iter().map(|(part, c)| (("camera".to_owned(), *part), *c)).collect()
        };
        let standing = counts(&[(0, (5, 0)), (1, (0, 4))]);
        let gone = counts(&[(0, (0, 5)), (1, (0, 4))]);
        let part = |k: u8| ("camera".to_owned(), k);
        let all = [standing.clone(), standing.clone(), gone.clone()];
        assert!(is_blind(&part(1), all.iter()) && !is_blind(&part(0), all.iter()));
        // One feature alone that is missed is gone: no other one says that the lens is dirty.
        assert!(!is_blind(&part(1), std::iter::once(&gone)));
        // Three that were never found in a part, and nowhere else.
        let never = counts(&[(1, (0, 2))]);
        assert!(is_blind(&part(1), [never.clone(), never.clone(), never].iter()));
    }
}
