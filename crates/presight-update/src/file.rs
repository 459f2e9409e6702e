//! Evidence that is not decided yet, in a file: JSON of format 1.

use crate::caster::Caster;
use crate::evidence::Evidence;
use crate::learn::Learner;
use presight_model::environment::Environment;
use presight_model::error::{Error, ErrorKind, Result};
use presight_model::geometry::Pose;
use presight_model::limits;
use presight_model::world::World;
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
    /// What the evidence is of: the store or the scene.
    map: String,
    voxel: f64,
    objects: Vec<ObjectRow>,
    /// Place x, y, z; hits, passes; mean x, y, z.
    voxels: Vec<([i32; 3], u32, u32, [f64; 3])>,
}

/// Log odds, views, views against, stamp of the last confirmation, what the views against said.
type Numbers = (f64, u32, u32, f64, f64);

#[derive(Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
struct ObjectRow {
    object: String,
    /// Its pose when the evidence was gathered: what moved since has to be looked at again.
    pose: [f64; 7],
    evidence: Numbers,
    /// Side and place of each cell.
    cells: Vec<(u8, [i32; 3], Numbers)>,
    /// Class of sensors, and whether rays met it flat.
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

impl Learner {
    /// Writes all evidence, whole or not at all. `map` names the map that it belongs to.
    ///
    /// # Errors
    /// [`ErrorKind::System`] if the file cannot be written.
    pub fn save(&self, path: &Path, environment: &Environment, map: &str) -> Result<()> {
        let row = |(object, known): (&u32, &Evidence)| {
            let o = &environment.objects()[*object as usize];
            let cells = self.book.cells_of(*object).map(|(cell, e)| (cell.1, cell.2, numbers(e))).collect();
            let range = (*object, String::new(), false)..(object + 1, String::new(), false);
            let aspect = |((_, class, flat), e): (&(u32, String, bool), &Evidence)| (class.clone(), *flat, numbers(e));
            let aspects = self.book.aspects.range(range).map(aspect).collect();
            let (object, pose) = (o.name.clone(), pose(&o.world_from_object));
            ObjectRow { object, pose, evidence: numbers(known), cells, aspects }
        };
        let live = |(object, _): &(&u32, &Evidence)| !environment.objects()[**object as usize].is_deleted();
        let document = Document {
            format: FORMAT,
            kind: KIND.to_owned(),
            map: map.to_owned(),
            voxel: self.voxels.size(),
            objects: self.book.objects.iter().filter(live).map(row).collect(),
            voxels: self.voxels.iter().map(|(key, v)| (key, v.hits, v.passes, v.mean().to_array())).collect(),
        };
        let text = serde_json::to_string(&document).map_err(|e| Error::invalid(e.to_string(), "").in_file(path))?;
        write_atomically(path, |file| file.write_all(text.as_bytes()))
    }

    /// Adds what a file knows. Objects that are gone or stand elsewhere by now are left out; returns their number.
    ///
    /// # Errors
    /// [`ErrorKind::Invalid`] if it is not a file of evidence, or is of another map; [`ErrorKind::Unsupported`] if it is of
    /// a newer format; [`ErrorKind::System`] if it cannot be read.
    pub fn load(&mut self, path: &Path, environment: &Environment, map: &str) -> Result<usize> {
        self.load_unnamed(path, environment, map).map_err(|e| e.in_file(path))
    }

    fn load_unnamed(&mut self, path: &Path, environment: &Environment, map: &str) -> Result<usize> {
        let length = std::fs::metadata(path).map_err(|e| Error::io(path, "read it", e))?.len();
        let remedy = "give a file of evidence that presight update wrote, or name one that does not exist";
        if length > limits::MAX_SETTINGS_BYTES * 8 {
            return Err(Error::invalid("it is too long for a file of evidence", remedy));
        }
        let text = std::fs::read_to_string(path).map_err(|e| Error::io(path, "read it", e))?;
        let wrong = |e: serde_json::Error| Error::invalid(format!("this is not evidence: {e}"), remedy);
        let head: BTreeMap<String, serde_json::Value> = serde_json::from_str(&text).map_err(wrong)?;
        if head.get("format").and_then(serde_json::Value::as_u64).is_some_and(|format| format > u64::from(FORMAT)) {
            let what = format!("its format is newer than this presight, which reads format {FORMAT}");
            return Err(Error::new(ErrorKind::Unsupported, what, "update presight"));
        }
        let document: Document = serde_json::from_str(&text).map_err(wrong)?;
        if document.format != FORMAT || document.kind != KIND {
            return Err(Error::invalid("this is not evidence", remedy));
        }
        if document.map != map {
            let remedy = "give the map that it was gathered with, or another file of evidence";
            return Err(Error::invalid("this evidence is of another map", remedy));
        }
        if document.voxel != self.voxels.size() {
            let what = format!("its voxels have edges of {} m, not of {} m", document.voxel, self.voxels.size());
            return Err(Error::invalid(what, "go on with the edge that it began with"));
        }
        let mut left_out = 0;
        for row in &document.objects {
            let same = |index: &u32| pose(&environment.objects()[*index as usize].world_from_object) == row.pose;
            let Some(index) = environment.index_of(&row.object).ok().filter(same) else {
                left_out += 1;
                continue;
            };
            self.book.objects.insert(index, evidence(&row.evidence));
            let aspect = |(class, flat, e): &(String, bool, Numbers)| ((index, class.clone(), *flat), evidence(e));
            self.book.aspects.extend(row.aspects.iter().map(aspect));
            self.book.cells.extend(row.cells.iter().map(|(side, place, e)| ((index, *side, *place), evidence(e))));
        }
        for (key, hits, passes, mean) in &document.voxels {
            self.voxels.restore(*key, *hits, *passes, glam::DVec3::from_array(*mean));
        }
        Ok(left_out)
    }

    /// Forgets decided evidence: on objects that changed, and the voxels near surfaces of the new model.
    pub fn forget(&mut self, world: &World, changed: &[String]) {
        let environment = world.environment();
        let gone = |object: &u32| changed.contains(&environment.objects()[*object as usize].name);
        self.book.objects.retain(|object, _| !gone(object));
        self.book.cells.retain(|cell, _| !gone(&cell.0));
        self.book.aspects.retain(|aspect, _| !gone(&aspect.0));
        let class = self.views.back().map_or_else(String::new, |view| view.kept.sensor.spec().class.clone());
        let caster = Caster::new(world, &class);
        let reach = 2.0 * self.voxels.size();
        self.voxels.retain(|_, voxel| caster.near(voxel.mean(), reach).is_none());
    }
}
