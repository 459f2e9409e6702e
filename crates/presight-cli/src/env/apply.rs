//! `presight env apply`: applies changes from lines of JSON, and acknowledges each line once it is safely on disk.

use super::{NoteArgs, open_store};
use crate::print;
use presight::tools::{self, without_mark};
use presight::{Error, Result};
use std::collections::BTreeSet;
use std::io::{BufRead, BufReader, Read};
use std::path::{Path, PathBuf};

/// The maximum number of lines committed together.
const BATCH: usize = 100;

const EXAMPLES: &str = r#"One change per line.
Poses are [x, y, z, roll_deg, pitch_deg, yaw_deg] or [x, y, z, qx, qy, qz, qw].
PATH names an object; "move", "set_pose" and "delete_object" also accept the path of a group:
  {"op":"move","object":PATH,"pose":[..]}      everything below PATH moves with it
  {"op":"set_pose","object":PATH,"pose":[..]}  an object moves alone
  {"op":"delete_object","object":PATH}         also deletes its features; for a group all below it
  {"op":"set_group","group":PATH,"pose":[..]}  sets a group's frame; nothing else moves
  {"op":"insert_object","object":PATH,"pose":[..],"from":"press.glb"}
                                               "from_object" if the file holds several
  {"op":"insert_object","object":PATH,"pose":[..],"like":PATH}
  {"op":"insert_object","object":PATH,"vertices":[[x,y,z],..],"polygons":[[0,1,2],..],
   "material":NAME}
  {"op":"add_material","name":NAME,"reflection":0.4,"classes":{"radar":"transparent"}}
  {"op":"insert_feature","class":C,"feature":{..}}  as in a layer file; also "set_feature";
                                               it must lie on polygons
  {"op":"delete_feature","class":C,"feature":ID}
  {"op":"set_tolerance","class":C,"tolerance":M}
  {"op":"set_pose_covariance","class":C,"object":PATH,"covariance":[36 numbers]}
  {"op":"set_mark","mark":NAME,"object":PATH,"kind":"uncertain","box":[[x,y,z],[x,y,z]]}
                                               or "absent"; optional "class"; no box: all of it
  {"op":"remove_mark","mark":NAME}
  {"op":"set_trust","object":PATH,"trust":{"existence":P,"confirmed":UTC,"rate":R}}
  {"op":"group","changes":[..]}                all of them or none
A line may have a "cause", an "id", "evidence", which the log keeps, and "was":[{"object":PATH,"pose":[..]}]:
it is refused unless these objects stand there. A line whose id has been applied before is acknowledged
and has no effect; another change with the same id is an error."#;

/// Apply changes, one JSON object per line; prints `ack K` once line K is safely on disk
///
/// Lines that have already arrived are committed together, at most 100 at a time, so a program that waits for each
/// acknowledgement gets it immediately. Stops at the first invalid line; lines before it are still acknowledged.
#[derive(Debug, clap::Args)]
#[command(after_help = EXAMPLES)]
pub struct Args {
    /// The store
    store: PathBuf,

    /// The changes; - reads standard input
    changes: PathBuf,

    #[command(flatten)]
    note: NoteArgs,
}

/// Runs the command.
///
/// # Errors
/// Store errors; an error in a line names its number.
pub fn run(args: &Args) -> Result<()> {
    let from_stdin = args.changes == Path::new("-");
    let path = if from_stdin { Path::new("stdin") } else { &args.changes };
    // Check --time before opening the store.
    args.note.note(String::new)?;
    let (input, folder): (Box<dyn Read>, &Path) = if from_stdin {
        (Box::new(std::io::stdin()), Path::new("."))
    } else {
        (Box::new(tools::open_stream(&args.changes, &args.changes)?), args.changes.parent().unwrap_or(Path::new(".")))
    };
    let mut store = open_store(&args.store)?;
    store.begin_row();
    let mut lines = Lines { reader: BufReader::with_capacity(1 << 16, input), number: 0, path };
    let mut said = BTreeSet::new();
    let mut ended = false;
    while !ended {
        let mut batch = store.batch()?;
        let mut applied = Vec::with_capacity(BATCH);
        let mut wrong = None;
        loop {
            let (number, line) = match lines.next() {
                Ok(Some(next)) => next,
                Ok(None) => {
                    ended = true;
                    break;
                }
                // As with an invalid change, first commit and acknowledge the lines before it.
                Err(e) => {
                    wrong = Some(e);
                    break;
                }
            };
            if !line.is_empty() {
                let note = args.note.note(|| format!("{} line {number}", path.display()))?;
                if let Err(e) = batch.apply_line(&line, folder, &note) {
                    wrong = Some(e.named_in(path, format!("line {number}")));
                    break;
                }
            }
            print::notices(batch.take_notices().iter().filter(|notice| said.insert((*notice).clone())));
            applied.push(number);
            if applied.len() == BATCH || !lines.has_another() {
                break;
            }
        }
        // After a store error the batch is empty.
        if wrong.as_ref().is_none_or(|_| batch.is_whole()) {
            batch.commit()?;
            let acks: String = applied.iter().map(|number| format!("ack {number}\n")).collect();
            print::data(&acks)?;
        }
        if let Some(e) = wrong {
            return Err(e);
        }
    }
    Ok(())
}

struct Lines<'a> {
    reader: BufReader<Box<dyn Read>>,
    number: u64,
    path: &'a Path,
}

impl Lines<'_> {
    /// Waits for the next line, and returns it with its number, from 1.
    fn next(&mut self) -> Result<Option<(u64, String)>> {
        let mut bytes = Vec::new();
        let limit = tools::MAX_LINE_BYTES;
        let mut bounded = self.reader.by_ref().take(limit + 1);
        let read = bounded.read_until(b'\n', &mut bytes).map_err(|e| Error::io(self.path, "read it", e))?;
        if read == 0 {
            return Ok(None);
        }
        self.number += 1;
        let place = |e: Error| e.at(format!("line {}", self.number)).in_file(self.path);
        if bytes.len() as u64 > limit {
            let what = format!("it is over {limit} bytes long");
            return Err(place(Error::invalid(what, "give one change per line, and large shapes by \"from\"")));
        }
        let text = String::from_utf8(bytes)
            .map_err(|_| place(Error::invalid("it is not UTF-8", "write the changes as UTF-8 text")))?;
        let text = if self.number == 1 { without_mark(text) } else { text };
        Ok(Some((self.number, text.trim().to_owned())))
    }

    /// Returns true if a whole line has already arrived.
    fn has_another(&self) -> bool {
        self.reader.buffer().contains(&b'\n')
    }
}
