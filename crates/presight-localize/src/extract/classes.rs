//! Classifies features (paper section 3.5): matched, only predicted, only found.

use crate::matching::{Detection, ExpectedFeature, Matcher, assign};
use crate::verdict::{Verdict, Verdicts};
use glam::DVec2;
use presight_model::error::Result;

/// The classification of a predicted feature.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FeatureClass {
    /// Matched to the detection with this index.
    Matched(usize),
    /// Not found, because an unknown object is in front of it. The feature may still exist.
    Occluded,
    /// Not found, and rays passed through its predicted place.
    Missing,
    /// Not found, and ranges do not show why.
    Undecidable,
}

impl FeatureClass {
    /// All names, in the order of the classes.
    pub const NAMES: [&str; 4] = ["matched", "occluded", "missing", "undecidable"];

    /// The name in files.
    pub fn name(self) -> &'static str {
        match self {
            Self::Matched(_) => Self::NAMES[0],
            Self::Occluded => Self::NAMES[1],
            Self::Missing => Self::NAMES[2],
            Self::Undecidable => Self::NAMES[3],
        }
    }
}

/// The classification of all features and detections.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Classes {
    /// By predicted feature.
    pub features: Vec<FeatureClass>,
    /// Detections that match no predicted feature.
    pub only_found: Vec<usize>,
}

/// Assigns detections to features at least total cost, and classifies the rest. `verdicts` holds counts by
/// [`Verdict::ALL`] near each feature, as from [`verdicts_along`]; it is empty if no ranges were measured.
///
/// # Examples
/// One of two features is found; rays passed through the place of the other.
///
/// # Errors
/// Errors of [`assign`].
pub fn classify(
    expected: &[ExpectedFeature],
    found: &[Detection],
    matcher: &Matcher,
    verdicts: &[[usize; 7]],
) -> Result<Classes> {
    let candidates = matcher.candidates(expected, found);
    let assigned = assign(&candidates.pairs, &vec![matcher.unseen_cost(); expected.len()])?;
    let mut features: Vec<FeatureClass> =
        (0..expected.len()).map(|i| verdicts.get(i).map_or(FeatureClass::Undecidable, unmatched)).collect();
    let mut only_found: Vec<bool> = vec![true; found.len()];
    for (feature, column) in features.iter_mut().zip(&assigned.columns) {
        if let Some(column) = column.map(|c| c as usize) {
            *feature = FeatureClass::Matched(column);
            only_found[column] = false;
        }
    }
    let only_found = only_found.iter().enumerate().filter(|(_, only)| **only).map(|(i, _)| i).collect();
    Ok(Classes { features, only_found })
}

/// Classifies an unmatched feature: more than half of the decided pixels must agree.
pub(super) fn unmatched(counts: &[usize; 7]) -> FeatureClass {
    let of = |v: Verdict| counts[v as usize];
    let decided = of(Verdict::Confirmed) + of(Verdict::Nearer) + of(Verdict::Farther);
    if 2 * of(Verdict::Nearer) > decided {
        FeatureClass::Occluded
    } else if 2 * of(Verdict::Farther) > decided {
        FeatureClass::Missing
    } else {
        FeatureClass::Undecidable
    }
}

/// Counts verdicts, by [`Verdict::ALL`], along both sides of an image segment at a distance of `aside` pixels: on an
/// edge itself, hardly any verdict is certain. Both images must have the same pixels.
pub fn verdicts_along(verdicts: &Verdicts, ends: [DVec2; 2], aside: f64) -> [usize; 7] {
    let mut counts = [0; 7];
    let way = ends[1] - ends[0];
    let across = aside * DVec2::new(-way.y, way.x).normalize_or_zero();
    let stations = (way.length().ceil() as usize).clamp(1, 1 << 14);
    let (width, height) = (verdicts.width as usize, verdicts.height as usize);
    for k in 0..=stations {
        let on = ends[0] + way * (k as f64 / stations as f64);
        for place in [on - across, on + across] {
            let (c, r) = (place.x.round(), place.y.round());
            if c >= 0.0 && r >= 0.0 && c < width as f64 && r < height as f64 {
                counts[verdicts.pixels[r as usize * width + c as usize] as usize] += 1;
            }
        }
    }
    counts
}
