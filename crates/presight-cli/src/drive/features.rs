//! The features of a drive: the list it searches for, and its findings.

use super::Drive;
use presight::features::{FeatureShape, PlacedFeatures};
use presight::localize::{FeatureClass, FeatureFindings, is_sought};
use presight::measured::Frame;
use presight::sensor::{Geometry, Scanner};
use presight::{Error, Result, Scene, Sensor};

/// Feature counts of one frame.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct FeatureCounts {
    /// Predicted features, in the order of [`FeatureClass::NAMES`].
    pub classes: [usize; 4],
    /// Detections without a predicted feature.
    pub only_found: usize,
}

impl FeatureCounts {
    /// Sums over all images in which features were searched; `None` without one.
    pub fn of(findings: &[FeatureFindings]) -> Option<Self> {
        let count = |name: &str| findings.iter().map(|f| f.count(name)).sum();
        let only_found = findings.iter().map(|f| f.only_found.len()).sum();
        (!findings.is_empty()).then(|| Self { classes: FeatureClass::NAMES.map(count), only_found })
    }

    /// Names and numbers, for files and pages.
    pub fn named(&self) -> impl Iterator<Item = (&'static str, usize)> {
        FeatureClass::NAMES.into_iter().zip(self.classes).chain(std::iter::once(("only_found", self.only_found)))
    }
}

impl Drive {
    /// The features that the sensor can detect; `None` if none are requested.
    pub fn placed(&self, scene: &Scene, sensor: &Sensor) -> Result<Option<PlacedFeatures>> {
        let class = &sensor.spec().class;
        if self.own_features && scene.world.environment().layer(class).is_none() {
            let what = format!("--own-features: the scene has none for class {class:?}");
            return Err(Error::usage(what, "give a --layer (presight features generates one)"));
        }
        let asked = self.own_features || !self.layers.is_empty();
        let Some(found) = asked.then(|| scene.place_layers(&self.layers, class)).transpose()? else { return Ok(None) };
        if found.placed.features.is_empty() && found.other_classes > 0 {
            let what = format!("--layer: {} features, none of them of class {class:?}", found.other_classes);
            return Err(Error::usage(what, "give a layer and a sensor of the same class"));
        }
        Ok(Some(found.placed))
    }
}

/// A notice about features that are not searched for in scans, or only in a limited way.
pub(super) fn not_sought_in_scans(placed: &PlacedFeatures, first: &Frame) -> Option<String> {
    let is_reflector = |shape: &FeatureShape| matches!(shape, FeatureShape::Reflector { .. });
    let reflectors = placed.features.iter().filter(|p| is_reflector(&p.feature.shape)).count();
    let others = placed.features.len() - reflectors;
    let is_row = |s: &Scanner| s.elevation.len() == 1 && s.beam_height_deg.is_none();
    let row = matches!(&first.sensor().spec().geometry, Geometry::Scanner(s) if is_row(s));
    if reflectors == 0 {
        return Some("the layer has no reflectors, so scans are not searched for its features".to_owned());
    }
    if first.intensities().is_none() {
        return Some(
            "the first scan has no intensities; reflectors are found only in scans with intensities".to_owned(),
        );
    }
    if row {
        let remedy = "set beam_height_deg in the sensor file";
        return Some(format!(
            "the scanner's row has no height, so only reflectors exactly in its plane are found; {remedy}"
        ));
    }
    (others > 0)
        .then(|| format!("only reflectors are found in scans; {others} other features of the layer are ignored"))
}

/// A notice about fiducials that are not searched for, if any.
pub(super) fn not_sought(placed: &PlacedFeatures) -> Option<String> {
    let is_left = |shape: &FeatureShape| matches!(shape, FeatureShape::Fiducial { .. }) && !is_sought(shape);
    let count = placed.features.iter().filter(|p| is_left(&p.feature.shape)).count();
    let why = if cfg!(feature = "fiducials") {
        "their dictionaries are other than DICT_APRILTAG_16h5, 25h9 and 36h11"
    } else {
        "this presight was built without the feature `fiducials`"
    };
    (count > 0).then(|| format!("{count} fiducials of the layer are not searched for: {why}"))
}
