//! Writes layer files with one feature per line, so that people can edit and compare them.

use super::fields::{FeatureFields, Kind, PropertyFields, Surface};
use super::{FORMAT, FORMAT_WITHOUT_CONTOURS};
use crate::atomic::write_atomically;
use glam::DMat3;
use presight_model::environment::{Existence, Feature, FeatureLayer, FeatureShape};
use presight_model::error::{Error, Result};
use serde::Serialize;
use std::io::Write;
use std::path::Path;

/// Writes a layer file, which [`super::read`] reads back bit for bit.
///
/// # Errors
/// [`presight_model::ErrorKind::Invalid`] if the layer is invalid ([`FeatureLayer::check`]), because such a file could
/// not be read. [`presight_model::ErrorKind::System`] if writing fails; an existing file is then not changed.
pub fn write(path: &Path, layer: &FeatureLayer) -> Result<()> {
    write_with_lost(path, layer, &[])
}

/// Like [`write()`], but marks the features with these rising ids as having lost their surface. When the file is read,
/// they need not lie on polygons.
///
/// # Errors
/// As [`write()`].
pub fn write_with_lost(path: &Path, layer: &FeatureLayer, lost: &[u32]) -> Result<()> {
    let text = text_of(layer, lost)?;
    write_atomically(path, |file| file.write_all(text.as_bytes()))
}

/// Returns the text of a layer file.
///
/// # Errors
/// [`presight_model::ErrorKind::Invalid`] if the layer is invalid.
pub fn to_string(layer: &FeatureLayer) -> Result<String> {
    text_of(layer, &[])
}

fn text_of(layer: &FeatureLayer, lost: &[u32]) -> Result<String> {
    layer.check()?;
    let has_contour = layer.features.iter().any(|f| f.shape.is_contour());
    let format = if has_contour { FORMAT } else { FORMAT_WITHOUT_CONTOURS };
    let mut text = format!(
        "{{\n  \"format\": {format},\n  \"class\": {},\n  \"tolerance\": {},\n",
        json(&layer.class)?,
        json(&layer.tolerance)?
    );
    if !layer.pose_covariances.is_empty() {
        let lines: Result<Vec<String>> = layer
            .pose_covariances
            .iter()
            .map(|(path, covariance)| {
                Ok(format!("    {}: {}", json(path)?, json(&covariance.as_rows().as_flattened())?))
            })
            .collect();
        text.push_str(&format!("  \"pose_covariances\": {{\n{}\n  }},\n", lines?.join(",\n")));
    }
    text.push_str("  \"features\": [");
    for (i, feature) in layer.features.iter().enumerate() {
        text.push_str(if i == 0 { "\n    " } else { ",\n    " });
        let surface = lost.binary_search(&feature.id).is_ok().then_some(Surface::Lost);
        text.push_str(&json(&FeatureFields { surface, ..fields(feature) })?);
    }
    text.push_str(if layer.features.is_empty() { "]\n}\n" } else { "\n  ]\n}\n" });
    Ok(text)
}

/// Returns the line of one feature for the list `features`.
///
/// # Errors
/// [`presight_model::ErrorKind::Invalid`] if the feature is invalid.
pub fn entry(feature: &Feature) -> Result<String> {
    feature.check(presight_model::environment::DEFAULT_TOLERANCE)?;
    json(&fields(feature))
}

fn json(value: &impl Serialize) -> Result<String> {
    serde_json::to_string(value).map_err(|e| Error::invalid(format!("cannot be written as JSON: {e}"), "").caused_by(e))
}

/// A feature as an object of a layer file, to be written as JSON.
pub fn serializable(feature: &Feature) -> impl Serialize + use<> {
    fields(feature)
}

/// The keys of a feature, as layer files and stores have them.
pub fn fields(feature: &Feature) -> FeatureFields {
    let mut to = FeatureFields {
        id: feature.id,
        kind: Some(kind(&feature.shape)),
        name: feature.name.clone(),
        object: feature.object.clone(),
        points: Some(feature.shape.points().iter().map(|p| p.to_array()).collect()),
        ..FeatureFields::default()
    };
    let mut properties = PropertyFields {
        strength: feature.properties.strength,
        contrast: feature.properties.contrast,
        normal: feature.properties.normal.map(|n| n.to_array()),
        ..PropertyFields::default()
    };
    match &feature.shape {
        FeatureShape::Segment { covariances, cross, .. } => {
            let [first, second] = covariances.map(|c| rows(&c));
            match first.map(f64::to_bits) == second.map(f64::to_bits) {
                true => to.covariance = unless_zero(first),
                false => to.covariances = Some([first, second]),
            }
            to.cross_covariance = unless_zero(rows(cross));
        }
        FeatureShape::Point { covariance, .. }
        | FeatureShape::Patch { covariance, .. }
        | FeatureShape::Reflector { covariance, .. } => to.covariance = unless_zero(rows(covariance)),
        FeatureShape::Fiducial { covariance, family, code, .. } => {
            to.covariance = unless_zero(rows(covariance));
            (properties.family, properties.code) = (Some(family.clone()), Some(*code));
        }
        FeatureShape::Contour { anchor, crease_deg, covariance } => {
            (to.points, to.anchor, to.crease_deg) = (None, Some(anchor.to_array()), Some(*crease_deg));
            to.covariance = unless_zero(rows(covariance));
        }
    }
    to.properties = (properties != PropertyFields::default()).then_some(properties);
    let (e, default) = (feature.existence, Existence::default());
    let unless = |value: f64, default: f64| (value.to_bits() != default.to_bits()).then_some(value);
    to.existence = unless(e.p0, default.p0);
    to.confirmed = unless(e.confirmed, default.confirmed);
    to.rate = unless(e.rate, default.rate);
    to
}

fn kind(shape: &FeatureShape) -> Kind {
    match shape {
        FeatureShape::Point { .. } => Kind::Point,
        FeatureShape::Segment { .. } => Kind::Segment,
        FeatureShape::Patch { .. } => Kind::Patch,
        FeatureShape::Reflector { .. } => Kind::Reflector,
        FeatureShape::Fiducial { .. } => Kind::Fiducial,
        FeatureShape::Contour { .. } => Kind::Contour,
    }
}

fn rows(m: &DMat3) -> [f64; 9] {
    m.transpose().to_cols_array()
}

/// Zeros are left out, but not negative zeros, which an absent key would lose.
fn unless_zero(rows: [f64; 9]) -> Option<[f64; 9]> {
    rows.iter().any(|x| x.to_bits() != 0).then_some(rows)
}
