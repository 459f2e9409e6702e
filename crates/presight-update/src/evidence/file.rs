//! Undecided evidence in a file: JSON of format 1.

use crate::evidence::knowledge::Knowledge;
use crate::evidence::objects::Evidence;
use presight_model::environment::Environment;
use presight_model::error::{Error, ErrorKind, Result};
use presight_model::geometry::Pose;
use presight_model::limits;
use presight_read::atomic::write_atomically;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::io::Write;
use std::path::Path;

const FORMAT: u32 = 1;
const KIND: &str = "presight-evidence";

/// The file.
#[derive(Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
struct Document {
    format: u32,
    kind: String,
    /// The store or the scene that the evidence belongs to.
    map: String,
    voxel: f64,
    objects: Vec<ObjectRow>,
    /// Place x, y, z; hits, passes; mean x, y, z.
    voxels: Vec<([i32; 3], u32, u32, [f64; 3])>,
}

/// Log-odds, views, views against, stamp of the last confirmation, log-odds of the views against.
type Numbers = (f64, u32, u32, f64, f64);

#[derive(Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
struct ObjectRow {
    object: String,
    /// Its pose when the evidence was gathered. Evidence on an object that was moved since is not used.
    pose: [f64; 7],
    evidence: Numbers,
    /// Side and place of each cell.
    cells: Vec<(u8, [i32; 3], Numbers)>,
    /// Class of sensors, and whether rays met it at grazing incidence.
    aspects: Vec<(String, bool, Numbers)>,
}

fn numbers(e: &Evidence) -> Numbers {
    (e.l, e.views, e.against, e.confirmed, e.less)
}

fn evidence(&(l, views, against, confirmed, less): &Numbers) -> Evidence {
    Evidence { l, views, against, confirmed, less }
}

fn pose(pose: &Pose) -> [f64; 7] {
    let ([x, y, z], [a, b, c, d]) = (pose.translation.to_array(), pose.rotation.to_array());
    [x, y, z, a, b, c, d]
}

/// As [`Learner::save`](crate::Learner::save).
pub(crate) fn save(known: &Knowledge, path: &Path, environment: &Environment, map: &str) -> Result<()> {
    let row = |(object, own): (&u32, &Evidence)| {
        let o = &environment.objects()[*object as usize];
        let cells = known.book.cells_of(*object).map(|(cell, e)| (cell.1, cell.2, numbers(e))).collect();
        let aspects = known.book.aspects_of(*object).map(|(class, grazes, e)| (class.to_owned(), grazes, numbers(e)));
        let (object, pose) = (o.name.clone(), pose(&o.world_from_object));
        ObjectRow { object, pose, evidence: numbers(own), cells, aspects: aspects.collect() }
    };
    let live = |(object, _): &(&u32, &Evidence)| !environment.objects()[**object as usize].is_deleted();
    let document = Document {
        format: FORMAT,
        kind: KIND.to_owned(),
        map: map.to_owned(),
        voxel: known.voxels.size(),
        objects: known.book.objects.iter().filter(live).map(row).collect(),
        voxels: known.voxels.iter().map(|(key, v)| (key, v.hits, v.passes, v.mean().to_array())).collect(),
    };
    let text = serde_json::to_string(&document).map_err(|e| Error::invalid(e.to_string(), "").in_file(path))?;
    write_atomically(path, |file| file.write_all(text.as_bytes()))
}

/// As [`Learner::load`](crate::Learner::load).
pub(crate) fn load(known: &mut Knowledge, path: &Path, environment: &Environment, map: &str) -> Result<usize> {
    let document = read(path).and_then(|document| check(document, map, known.voxels.size()));
    let document = document.map_err(|e| e.in_file(path))?;
    let mut left_out = 0;
    for row in &document.objects {
        let same = |index: &u32| pose(&environment.objects()[*index as usize].world_from_object) == row.pose;
        let Some(index) = environment.index_of(&row.object).ok().filter(same) else {
            left_out += 1;
            continue;
        };
        known.book.objects.insert(index, evidence(&row.evidence));
        let aspect = |(class, grazes, e): &(String, bool, Numbers)| ((index, class.clone(), *grazes), evidence(e));
        known.book.aspects.extend(row.aspects.iter().map(aspect));
        known.book.cells.extend(row.cells.iter().map(|(side, place, e)| ((index, *side, *place), evidence(e))));
    }
    for (key, hits, passes, mean) in &document.voxels {
        known.voxels.restore(*key, *hits, *passes, glam::DVec3::from_array(*mean));
    }
    Ok(left_out)
}

const REMEDY: &str = "give a file of evidence that presight update wrote, or name one that does not exist";

fn read(path: &Path) -> Result<Document> {
    let length = std::fs::metadata(path).map_err(|e| Error::io(path, "read it", e))?.len();
    if length > limits::MAX_SETTINGS_BYTES * 8 {
        return Err(Error::invalid("it is too long for a file of evidence", REMEDY));
    }
    let text = std::fs::read_to_string(path).map_err(|e| Error::io(path, "read it", e))?;
    let wrong = |e: serde_json::Error| Error::invalid(format!("this is not evidence: {e}"), REMEDY);
    let head: BTreeMap<String, serde_json::Value> = serde_json::from_str(&text).map_err(wrong)?;
    if head.get("format").and_then(serde_json::Value::as_u64).is_some_and(|format| format > u64::from(FORMAT)) {
        let what = format!("its format is newer than this presight, which reads format {FORMAT}");
        return Err(Error::new(ErrorKind::Unsupported, what, "update presight"));
    }
    serde_json::from_str(&text).map_err(wrong)
}

fn check(document: Document, map: &str, voxel: f64) -> Result<Document> {
    if document.format != FORMAT || document.kind != KIND {
        return Err(Error::invalid("this is not evidence", REMEDY));
    }
    if document.map != map {
        let remedy = "give the map that it was gathered with, or another file of evidence";
        return Err(Error::invalid("this evidence is of another map", remedy));
    }
    if document.voxel != voxel {
        let what = format!("its voxels have edges of {} m, not of {voxel} m", document.voxel);
        return Err(Error::invalid(what, "use the same edge, or another file of evidence"));
    }
    Ok(document)
}
