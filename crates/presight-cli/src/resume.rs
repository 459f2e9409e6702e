//! Runs that were interrupted go on where they ended, by the same command.
//!
//! Until it is complete a run keeps FILE.resume next to FILE.tum and FILE.jsonl, with its arguments and inputs. The
//! same command on the same inputs finds it, keeps the lines of the frames so far, and continues after them from the
//! last pose.

use super::print;
use presight::tools::write_atomically;
use presight::{Error, Pose, Result, RobotPose};
use std::fs;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::time::UNIX_EPOCH;

/// Where a run goes on.
#[derive(Clone, Debug, PartialEq)]
pub struct Resumed {
    /// Time of the last frame that is complete, seconds.
    pub time: f64,
    /// world_from_robot then; `None` if it was not known.
    pub pose: Option<RobotPose>,
    /// Bytes of FILE.tum and of FILE.jsonl that belong to complete frames.
    pub lengths: [u64; 2],
}

/// The mark of a run that is not complete.
#[derive(Debug)]
pub struct Mark {
    path: PathBuf,
    text: String,
}

/// The part of a line of FILE.jsonl that a run goes on with.
#[derive(serde::Deserialize)]
struct Line {
    time: f64,
    state: String,
    translation: [f64; 3],
    rotation_xyzw: [f64; 4],
}

impl Mark {
    /// For outputs next to `out`. The text holds all arguments; `inputs` lists the files and folders that a run reads.
    pub fn new(out: &Path, asked: &str, inputs: &[&Path]) -> Self {
        let seen: Vec<String> = inputs.iter().map(|path| stamp(path)).collect();
        let text = serde_json::json!({ "format": 1, "kind": "interrupted-run", "asked": asked, "inputs": seen });
        Self { path: out.with_extension("resume"), text: format!("{text}\n") }
    }

    /// What an earlier run with the same arguments and inputs has left; `None` without one.
    pub fn resumed(&self, poses: &Path, details: &Path) -> Option<Resumed> {
        if fs::read_to_string(&self.path).ok()? != self.text {
            return None;
        }
        let (tum, jsonl) = (fs::read_to_string(poses).ok()?, fs::read_to_string(details).ok()?);
        let whole = |text: &str| text.rfind('\n').map_or(0, |at| at + 1);
        let kept = whole(&jsonl);
        let last: Line = serde_json::from_str(jsonl[..kept].lines().last()?).ok()?;
        // A pose without its line of details comes again.
        let is_earlier =
            |line: &str| line.split(' ').next().and_then(|t| t.parse::<f64>().ok()).is_some_and(|t| t <= last.time);
        let poses: usize =
            tum[..whole(&tum)].lines().take_while(|line| is_earlier(line)).map(|line| line.len() + 1).sum();
        let is_known = last.state == "tracking" || last.state == "kept";
        let [x, y, z, w] = last.rotation_xyzw;
        let pose = Pose::new(last.translation.into(), glam::DQuat::from_xyzw(x, y, z, w)).ok()?;
        print::notices(&[format!(
            "continuing after the frame at {} s, where an earlier run of this command ended; \
             delete {} to start from the first frame",
            last.time,
            self.path.display()
        )]);
        Some(Resumed {
            time: last.time,
            pose: is_known.then_some(RobotPose::new(pose)),
            lengths: [poses as u64, kept as u64],
        })
    }

    /// Marks the run as not complete.
    ///
    /// # Errors
    /// [`presight::ErrorKind::System`] if the file cannot be written.
    pub fn set(&self) -> Result<()> {
        write_atomically(&self.path, |file| file.write_all(self.text.as_bytes()))
    }

    /// The run is complete.
    ///
    /// # Errors
    /// [`presight::ErrorKind::System`] if the file cannot be deleted.
    pub fn clear(&self) -> Result<()> {
        fs::remove_file(&self.path).map_err(|e| Error::io(&self.path, "delete it", e))
    }
}

/// Path, size and time of change: another file of this name is another input.
fn stamp(path: &Path) -> String {
    let known = fs::metadata(path).ok();
    let size = known.as_ref().map_or(0, fs::Metadata::len);
    let changed = known.and_then(|m| m.modified().ok()).and_then(|t| t.duration_since(UNIX_EPOCH).ok());
    format!("{}: {size} bytes, {} s", path.display(), changed.map_or(0.0, |t| t.as_secs_f64()))
}
