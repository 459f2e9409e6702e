//! Reads and checks layer files.

use super::FORMAT;
use super::fields::{FeatureFields, Keyed, Kind, LayerFields, PropertyFields, Surface, Whole};
use crate::text::{check_json_memory, check_version, from_text};
use glam::{DMat3, DVec3};
use presight_model::environment::{DEFAULT_TOLERANCE, Existence, Feature, FeatureLayer, FeatureShape, Properties};
use presight_model::error::{Error, Result, short};
use presight_model::threads::parallel;
use rayon::prelude::*;
use serde::Deserialize;
use serde_json::value::RawValue;
use std::collections::HashMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// The content of a layer file: a layer, or changes to layers read before it.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct LayerFile {
    /// The features of the file, by rising id.
    pub layer: FeatureLayer,
    /// Rising ids of the features that it removes. They are not in the layer.
    pub removed: Vec<u32>,
    /// Rising ids of the features that have lost their surface. They may be off the polygons.
    pub lost: Vec<u32>,
    /// The path of the file.
    pub path: Option<PathBuf>,
}

/// Reads a layer file.
///
/// # Errors
/// [`presight_model::ErrorKind::Invalid`] with the line, or the feature's index and id;
/// [`presight_model::ErrorKind::Unsupported`] for a newer format; [`presight_model::ErrorKind::System`] if the file
/// cannot be read.
pub fn read(path: &Path) -> Result<LayerFile> {
    Ok(LayerFile { path: Some(path.to_owned()), ..from_text(path, parse)? })
}

/// Reads the text of a layer file.
///
/// # Errors
/// As [`read`], without the file.
pub fn parse(text: &str) -> Result<LayerFile> {
    check_json_memory(text)?;
    let fields = match from_json::<Keyed<LayerFields<'_>>>(text, text) {
        Ok(Keyed(fields)) => fields,
        // A newer format may have keys that this build does not know, so report the format first.
        Err(e) => return Err(newer_or(e, text)),
    };
    let tolerance = fields.tolerance.unwrap_or(DEFAULT_TOLERANCE);
    let read = |(i, entry): (usize, &&RawValue)| {
        let Keyed(entry) = from_json::<Keyed<FeatureFields>>(entry.get(), text).map_err(Fault::Form)?;
        let (id, is_lost) = (entry.id, entry.surface == Some(Surface::Lost));
        let feature = entry.checked(tolerance, fields.format).map_err(|e| Fault::Content(e.at(place(i, id)), id))?;
        Ok(Entry { id, feature: feature.map(Arc::new), is_lost })
    };
    let texts = fields.features;
    let entries = texts.par_iter().enumerate().with_min_len(BATCH).map(read);
    let mut entries: Vec<Result<Entry, Fault>> = parallel(|| entries.collect())?;
    drop(texts);
    if let Some(at) = entries.iter().position(|entry| matches!(entry, Err(Fault::Form(_))))
        && let Err(Fault::Form(e)) = entries.swap_remove(at)
    {
        return Err(newer_or(e, text));
    }
    check_format(Some(fields.format))?;
    let mut layer = FeatureLayer {
        class: fields.class,
        tolerance,
        features: Vec::with_capacity(entries.len()),
        pose_covariances: fields.pose_covariances.0,
    };
    layer.check_header()?;
    let (mut removed, mut lost) = (Vec::new(), Vec::new());
    // Rising ids are unique, so `first_use` stays empty. Files that we write have rising ids.
    let rises = entries.windows(2).all(|pair| id_of(&pair[0]) < id_of(&pair[1]));
    let mut first_use: HashMap<u32, usize> = HashMap::new();
    for (i, entry) in entries.into_iter().enumerate() {
        let (id, entry) = match entry {
            Ok(entry) => (entry.id, Ok(entry)),
            Err(Fault::Content(e, id)) => (id, Err(e)),
            Err(Fault::Form(e)) => return Err(e),
        };
        if let Some(first) = (!rises).then(|| first_use.insert(id, i)).flatten() {
            let what = format!("features[{first}] has this id already");
            return Err(Error::invalid(what, "give each feature its own id, never used before").at(place(i, id)));
        }
        let entry = entry?;
        match entry.feature {
            Some(feature) => {
                layer.features.push(feature);
                lost.extend(entry.is_lost.then_some(id));
            }
            None => removed.push(id),
        }
    }
    layer.features.sort_by_key(|f| f.id);
    removed.sort_unstable();
    lost.sort_unstable();
    Ok(LayerFile { layer, removed, lost, path: None })
}

/// Least number of entries that a worker reads at a time.
const BATCH: usize = 256;

/// A feature, or the removal of one.
struct Entry {
    id: u32,
    feature: Option<Arc<Feature>>,
    is_lost: bool,
}

/// The error of an entry. Errors in the form of any entry are reported before errors in the content of others.
enum Fault {
    Form(Error),
    Content(Error, u32),
}

fn id_of(entry: &Result<Entry, Fault>) -> Option<u32> {
    match entry {
        Ok(entry) => Some(entry.id),
        Err(Fault::Content(_, id)) => Some(*id),
        Err(Fault::Form(_)) => None,
    }
}

fn place(i: usize, id: u32) -> String {
    format!("features[{i}] (id {id})")
}

/// Returns the error of a newer format if the file has one, otherwise `e`.
fn newer_or(e: Error, text: &str) -> Error {
    format_of(text).and_then(check_format).err().unwrap_or(e)
}

/// Reads JSON, the whole text of a file or a part of it.
fn from_json<'a, T: Deserialize<'a>>(part: &'a str, whole: &str) -> Result<T> {
    serde_json::from_str(part).map_err(|e| {
        let remedy = "correct the file; presight features schema prints the allowed keys";
        // serde_json appends the position to its message.
        let what = e.to_string();
        let what = what.split(" at line ").next().unwrap_or(&what).to_owned();
        // `part` is a slice of `whole`.
        let before = &whole.as_bytes()[..(part.as_ptr() as usize).saturating_sub(whole.as_ptr() as usize)];
        let lines = before.iter().filter(|byte| **byte == b'\n').count();
        let columns = before.iter().rev().take_while(|byte| **byte != b'\n').count();
        let (line, column) = (lines + e.line(), e.column() + if e.line() == 1 { columns } else { 0 });
        Error::invalid(what, remedy).at(format!("line {line}, column {column}")).caused_by(e)
    })
}

/// Reads a file's format and ignores its other keys.
fn format_of(text: &str) -> Result<Option<u32>> {
    #[derive(Deserialize)]
    struct Header {
        format: Option<Whole>,
    }
    Ok(from_json::<Keyed<Header>>(text, text)?.0.format.map(|Whole(format)| format))
}

fn check_format(format: Option<u32>) -> Result<()> {
    check_version(format.map(i64::from), i64::from(FORMAT), "\"format\": 1")
}

/// The feature of an entry, checked with a layer's tolerance.
pub fn from_fields(fields: FeatureFields, tolerance: f64) -> Result<Feature> {
    let id = fields.id;
    if fields.surface.is_some() {
        let what = "\"surface\" is only for layer files: features in changes must lie on polygons";
        return Err(Error::invalid(what, "leave it out").at(format!("feature {id}")));
    }
    let gone = || Error::invalid("\"remove\" is only for layer files", "delete it with delete_feature");
    fields.feature(tolerance)?.ok_or_else(gone).map_err(|e| e.at(format!("feature {id}")))
}

impl FeatureFields {
    /// Like `feature`, with the checks for files.
    fn checked(self, tolerance: f64, format: u32) -> Result<Option<Feature>> {
        let feature = self.feature(tolerance)?;
        feature.as_ref().map_or(Ok(()), Feature::check_dictionary)?;
        if format < FORMAT && feature.as_ref().is_some_and(|feature| feature.shape.is_contour()) {
            let what = format!("contours need format {FORMAT}, but the file has format {format}");
            return Err(Error::invalid(what, format!("write \"format\": {FORMAT}")));
        }
        Ok(feature)
    }

    /// The feature; `None` for a removal.
    fn feature(self, tolerance: f64) -> Result<Option<Feature>> {
        if self.remove == Some(true) {
            return self.removal().map(|()| None);
        }
        let shape = self.shape()?;
        let default = Existence::default();
        let existence = Existence {
            p0: self.existence.unwrap_or(default.p0),
            confirmed: self.confirmed.unwrap_or(default.confirmed),
            rate: self.rate.unwrap_or(default.rate),
        };
        let properties = self.properties.unwrap_or_default().properties(&shape)?;
        let feature = Feature { id: self.id, name: self.name, object: self.object, shape, existence, properties };
        feature.check(tolerance)?;
        Ok(Some(feature))
    }

    fn removal(&self) -> Result<()> {
        // Other keys would be silently ignored.
        let alone = Self { id: self.id, remove: self.remove, ..Self::default() };
        if self.id == 0 {
            return Err(Error::invalid("id 0 is nothing", "name the feature to remove"));
        }
        match (serde_json::to_string(self), serde_json::to_string(&alone)) {
            (Ok(given), Ok(alone)) if given == alone => Ok(()),
            _ => Err(Error::invalid("\"remove\": true does not allow other keys", "give only id and remove")),
        }
    }

    fn shape(&self) -> Result<FeatureShape> {
        let Some(kind) = self.kind else {
            return Err(Error::invalid(
                "kind is missing",
                "give point, segment, patch, reflector, fiducial or contour",
            ));
        };
        let points: Vec<DVec3> = self.points.iter().flatten().map(|p| DVec3::from_array(*p)).collect();
        if kind != Kind::Segment && (self.covariances.is_some() || self.cross_covariance.is_some()) {
            return Err(Error::invalid("covariances and cross_covariance are for segments", "give covariance"));
        }
        let covariance = self.covariance()?;
        if kind != Kind::Contour && (self.anchor.is_some() || self.crease_deg.is_some()) {
            return Err(Error::invalid("anchor and crease_deg are for contours", "give points"));
        }
        let properties = self.properties.as_ref();
        match kind {
            Kind::Point | Kind::Reflector => {
                let [at] = exactly(&points)?;
                Ok(match kind {
                    Kind::Point => FeatureShape::Point { at, covariance },
                    _ => FeatureShape::Reflector { at, covariance },
                })
            }
            Kind::Segment => {
                let covariances = self.covariances.as_ref().map(|both| both.each_ref().map(from_rows));
                let cross = self.cross_covariance.as_ref().map_or(DMat3::ZERO, from_rows);
                let covariances = covariances.unwrap_or([covariance; 2]);
                Ok(FeatureShape::Segment { ends: exactly(&points)?, covariances, cross })
            }
            Kind::Patch => Ok(FeatureShape::Patch { corners: points, covariance }),
            Kind::Contour => {
                let given = self.anchor.map(DVec3::from_array).zip(self.crease_deg).filter(|_| self.points.is_none());
                let (anchor, crease_deg) = given.ok_or_else(|| {
                    Error::invalid("a contour is given by anchor and crease_deg alone", "give both in place of points")
                })?;
                Ok(FeatureShape::Contour { anchor, crease_deg, covariance })
            }
            Kind::Fiducial => {
                let given = properties.and_then(|p| p.family.clone().zip(p.code));
                let (family, code) = given.ok_or_else(|| {
                    Error::invalid("a fiducial needs its family and code", "give both under properties")
                })?;
                Ok(FeatureShape::Fiducial { corners: exactly(&points)?, covariance, family, code })
            }
        }
    }

    /// The covariance of each point.
    fn covariance(&self) -> Result<DMat3> {
        match (self.sigma, &self.covariance, &self.covariances) {
            (None, None, _) => Ok(DMat3::ZERO),
            (Some(sigma), None, None) => {
                if let Some(s) = sigma.0.iter().find(|s| !(**s >= 0.0)) {
                    return Err(Error::invalid(format!("sigma {} is negative", short(*s)), "give metres, 0 or more"));
                }
                Ok(DMat3::from_diagonal(DVec3::from_array(sigma.0.map(|s| s * s))))
            }
            (None, Some(rows), None) => Ok(from_rows(rows)),
            _ => Err(Error::invalid("the covariance is given twice", "give one of sigma, covariance and covariances")),
        }
    }
}

impl PropertyFields {
    fn properties(self, shape: &FeatureShape) -> Result<Properties> {
        let of_fiducials = self.family.is_some() || self.code.is_some();
        if of_fiducials && !matches!(shape, FeatureShape::Fiducial { .. }) {
            return Err(Error::invalid("family and code are for fiducials", "leave them out"));
        }
        let normal = self.normal.map(|n| unit(DVec3::from_array(n))).transpose()?;
        Ok(Properties { strength: self.strength, contrast: self.contrast, normal })
    }
}

/// Normalizes a normal written with few digits. A unit vector is not changed, so that written normals read back
/// exactly.
fn unit(n: DVec3) -> Result<DVec3> {
    /// Allowed error of the length: three digits.
    const WRITTEN: f64 = 1e-3;
    let length = n.length();
    if !((length - 1.0).abs() <= WRITTEN) {
        return Err(Error::invalid(format!("the normal {n} has length {length}, not 1"), "divide it by its length"));
    }
    Ok(if (n.length_squared() - 1.0).abs() <= 1e-9 { n } else { n / length })
}

fn exactly<const N: usize>(points: &[DVec3]) -> Result<[DVec3; N]> {
    points.try_into().map_err(|_| {
        Error::invalid(format!("{} points, but this kind has {N}", points.len()), "give points as [[x, y, z], ..]")
    })
}

fn from_rows(rows: &[f64; 9]) -> DMat3 {
    DMat3::from_cols_array(rows).transpose()
}
