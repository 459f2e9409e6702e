//! Merging of layer files.

use super::read::{LayerFile, read};
use presight_model::environment::FeatureLayer;
use presight_model::error::{Error, Result};
use std::collections::HashMap;
use std::path::Path;

/// Layers for one sensor class, merged.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct MergedLayers {
    /// The remaining features of each file, in the order of reading; see [`merge`].
    pub layers: Vec<LayerFile>,
    /// Number of unused features for other classes.
    pub other_classes: usize,
}

/// Reads layer files and merges the ones for a sensor class with the environment's own layer for it, if any. The own
/// layer comes first and has no path. Features of other classes are counted.
///
/// # Errors
/// As [`read`], also for files of other classes, and as [`merge`].
pub fn load<P: AsRef<Path>>(own: Option<&FeatureLayer>, paths: &[P], class: &str) -> Result<MergedLayers> {
    let files = paths.iter().map(|path| read(path.as_ref())).collect::<Result<Vec<_>>>()?;
    select(own, files, class)
}

/// As [`load`], for layer files that were read before.
///
/// # Errors
/// As [`merge`].
pub fn select(own: Option<&FeatureLayer>, files: Vec<LayerFile>, class: &str) -> Result<MergedLayers> {
    let (mine, others): (Vec<_>, Vec<_>) = files.into_iter().partition(|file| file.layer.class == class);
    let other_classes = others.iter().map(|file| file.layer.features.len()).sum();
    let own = own.map(|layer| LayerFile { layer: layer.clone(), ..LayerFile::default() });
    Ok(MergedLayers { layers: merge(own.into_iter().chain(mine))?, other_classes })
}

/// Merges layers and returns the remaining part of each. A later feature replaces an earlier one with the same id. A
/// removal drops earlier features with its id, and a later layer may use the id again. Removing a missing feature is
/// not an error, because the earlier layer may have been regenerated without it. A later pose covariance of an object
/// replaces an earlier one for all layers. A tolerance applies only to its own layer.
///
/// # Errors
/// [`presight_model::ErrorKind::Invalid`] naming the file if classes differ.
pub fn merge(files: impl IntoIterator<Item = LayerFile>) -> Result<Vec<LayerFile>> {
    let mut files: Vec<LayerFile> = files.into_iter().collect();
    if let Some(other) = files.iter().find(|f| f.layer.class != files[0].layer.class) {
        let (class, first) = (&other.layer.class, &files[0].layer.class);
        let what = format!("a layer for class {class:?} among layers for class {first:?}");
        let wrong = Error::invalid(what, "merge layers of one class");
        return Err(match &other.path {
            Some(path) => wrong.in_file(path),
            None => wrong,
        });
    }
    // A single file needs no merging: it never removes its own features.
    if files.len() < 2 {
        return Ok(files);
    }
    // The last file that names each id, and each object's pose.
    let (mut of_id, mut of_object) = (HashMap::new(), HashMap::new());
    for (i, LayerFile { layer, removed, .. }) in files.iter().enumerate() {
        of_id.extend(removed.iter().copied().chain(layer.features.iter().map(|f| f.id)).map(|id| (id, i)));
        of_object.extend(layer.pose_covariances.iter().map(|(object, _)| (object.clone(), i)));
    }
    for (i, LayerFile { layer, lost, .. }) in files.iter_mut().enumerate() {
        lost.retain(|id| of_id[id] == i);
        layer.features.retain(|f| of_id[&f.id] == i);
        layer.pose_covariances.retain(|(object, _)| of_object[object] == i);
    }
    Ok(files)
}
