//! Several layer files made one.

use super::read::{LayerFile, read};
use crate::environment::FeatureLayer;
use crate::error::{Error, Result};
use std::collections::BTreeMap;
use std::path::Path;

/// Layers for one sensor class, merged.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Loaded {
    /// All features for the class.
    pub layer: FeatureLayer,
    /// Features for other classes, which are in no way used.
    pub other_classes: usize,
}

/// Reads layer files and merges those for a sensor class over the environment's own layer for it, if it has one; the
/// features of other classes in the files are counted.
///
/// # Errors
/// Those of [`read`] and [`merge`], for all files alike.
pub fn load<P: AsRef<Path>>(own: Option<&FeatureLayer>, paths: &[P], class: &str) -> Result<Loaded> {
    let mut files = Vec::with_capacity(paths.len() + 1);
    files.extend(own.map(|layer| LayerFile { layer: layer.clone(), removed: Vec::new(), path: None }));
    let mut other_classes = 0;
    for path in paths {
        let file = read(path.as_ref())?;
        if file.layer.class == class {
            files.push(file);
        } else {
            other_classes += file.layer.features.len();
        }
    }
    let mut layer = merge(files)?;
    layer.class = class.to_owned();
    Ok(Loaded { layer, other_classes })
}

/// One layer of several: later features win by id, removals drop what came before and may be followed by the same id
/// again. A removal of what is not there does nothing: the layer below may have been made anew without it. Covariances
/// of poses: later ones win by object. The tolerance is the largest.
///
/// # Errors
/// [`crate::ErrorKind::Invalid`] naming the file if classes differ.
pub fn merge(files: impl IntoIterator<Item = LayerFile>) -> Result<FeatureLayer> {
    let mut merged: Option<FeatureLayer> = None;
    let mut features = BTreeMap::new();
    for file in files {
        let LayerFile { layer, removed, path } = file;
        let merged =
            merged.get_or_insert_with(|| FeatureLayer { class: layer.class.clone(), ..FeatureLayer::default() });
        if merged.class != layer.class {
            let what = format!("a layer for class {:?} among layers for class {:?}", layer.class, merged.class);
            let wrong = Error::invalid(what, "merge layers of one class");
            return Err(match path {
                Some(path) => wrong.in_file(path),
                None => wrong,
            });
        }
        for id in removed {
            features.remove(&id);
        }
        features.extend(layer.features.into_iter().map(|f| (f.id, f)));
        merged.tolerance = merged.tolerance.max(layer.tolerance);
        for (object, covariance) in layer.pose_covariances {
            match merged.pose_covariances.iter_mut().find(|(path, _)| *path == object) {
                Some((_, earlier)) => *earlier = covariance,
                None => merged.pose_covariances.push((object, covariance)),
            }
        }
    }
    let mut merged = merged.unwrap_or_else(|| FeatureLayer {
        tolerance: crate::environment::DEFAULT_TOLERANCE,
        ..FeatureLayer::default()
    });
    merged.features = features.into_values().collect();
    Ok(merged)
}
