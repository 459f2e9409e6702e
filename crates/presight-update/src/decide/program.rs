//! A recognizer that runs a program: it writes points to its standard input, and reads proposals from its standard
//! output.

use crate::decide::recognize::{Proposal, Recognizer};
use glam::DVec3;
use presight_model::clock::Instant;
use presight_model::error::{Error, ErrorKind, Result};
use presight_model::geometry::Pose;
use serde::Deserialize;
use std::io::{BufWriter, Read, Write};
use std::process::{Child, Command, Stdio};
use std::sync::mpsc::{Receiver, channel};
use std::time::Duration;

/// Maximum length of an answer, bytes.
const MAX_ANSWER: u64 = 1 << 20;
/// Interval at which the end of the program is polled.
const POLL: Duration = Duration::from_millis(2);

/// Runs a program for each group of points. The program reads the points as a binary little-endian PLY of doubles `x`,
/// `y`, `z` (world frame, metres). It prints a line `{"object": NAME, "pose": [..]}` for each possible object, or no
/// line, and ends with status 0. The pose is x, y, z and roll, pitch, yaw in degrees, or x, y, z, qx, qy, qz, qw.
///
/// ```
/// # #[cfg(unix)] {
/// use presight::update::{ProgramRecognizer, Recognizer};
/// use std::time::Duration;
/// let mut silent = ProgramRecognizer::new("true", Duration::from_secs(10))?;
/// assert!(silent.recognize(&[glam::DVec3::ONE])?.is_empty());
/// # }
/// # Ok::<(), presight::Error>(())
/// ```
#[derive(Clone, Debug)]
pub struct ProgramRecognizer {
    words: Vec<String>,
    within: Duration,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Line {
    object: String,
    pose: Vec<f64>,
}

impl ProgramRecognizer {
    /// Makes a recognizer from a program and its arguments, separated by spaces, and the maximum time for an answer. No
    /// shell is used.
    ///
    /// # Errors
    /// [`ErrorKind::Usage`] if there is no word.
    pub fn new(command: &str, within: Duration) -> Result<Self> {
        let words: Vec<String> = command.split_whitespace().map(str::to_owned).collect();
        if words.is_empty() {
            return Err(Error::usage("a recognizer without a name", "give a program and its arguments"));
        }
        Ok(Self { words, within })
    }

    fn answer(&self, points: &[DVec3]) -> Result<Vec<Proposal>> {
        let started = Instant::now();
        let mut command = Command::new(&self.words[0]);
        command.args(&self.words[1..]).stdin(Stdio::piped()).stdout(Stdio::piped());
        let mut child = command.spawn().map_err(|e| Error::io(&self.words[0], "start it", e))?;
        let ended = self.exchange(&mut child, points, started);
        if ended.is_err() {
            // Both fail if it has ended.
            let _ = child.kill();
            let _ = child.wait();
        }
        parse(&ended?)
    }

    /// Writes the points to the program, and waits for its answer and its end. Two threads write and read, so that a
    /// program that does neither does not block. They end when its pipes close.
    fn exchange(&self, child: &mut Child, points: &[DVec3], started: Instant) -> Result<Vec<u8>> {
        let (Some(stdin), Some(stdout)) = (child.stdin.take(), child.stdout.take()) else { return Ok(Vec::new()) };
        let points = points.to_vec();
        // A program need not read all points.
        thread(move || drop(write_points(stdin, &points)))?;
        let (sender, answer) = channel();
        thread(move || {
            let mut bytes = Vec::new();
            let read = stdout.take(MAX_ANSWER + 1).read_to_end(&mut bytes);
            drop(sender.send(read.map(|_| bytes)));
        })?;
        let bytes = self.received(&answer, started)?;
        if bytes.len() as u64 > MAX_ANSWER {
            let what = format!("its answer is longer than {MAX_ANSWER} bytes");
            return Err(Error::invalid(what, "print one line for each possible object"));
        }
        loop {
            let status = child.try_wait().map_err(|e| Error::io(&self.words[0], "wait for its end", e))?;
            match status {
                Some(status) if status.success() => return Ok(bytes),
                Some(status) => {
                    let what = format!("it failed with {status}");
                    return Err(Error::invalid(
                        what,
                        "run it in a terminal to see the reason; it ends with 0 if it does not know an object",
                    ));
                }
                None if started.elapsed() >= self.within => return Err(self.late()),
                None => std::thread::sleep(POLL),
            }
        }
    }

    fn received(&self, answer: &Receiver<std::io::Result<Vec<u8>>>, started: Instant) -> Result<Vec<u8>> {
        let left = self.within.saturating_sub(started.elapsed());
        let read = answer.recv_timeout(left).map_err(|_| self.late())?;
        read.map_err(|e| Error::io(&self.words[0], "read its answer", e))
    }

    fn late(&self) -> Error {
        let what = format!("it gave no answer within {} ms", self.within.as_millis());
        Error::new(ErrorKind::System, what, "give it more time with `ProgramRecognizer::within`, or mend it")
    }
}

impl Recognizer for ProgramRecognizer {
    fn recognize(&mut self, points: &[DVec3]) -> Result<Vec<Proposal>> {
        self.answer(points).map_err(|e| e.at(format!("recognizer {:?}", self.words.join(" "))))
    }
}

/// Writes points in the world as PLY.
fn write_points(stdin: impl Write, points: &[DVec3]) -> std::io::Result<()> {
    let mut out = BufWriter::new(stdin);
    write!(
        out,
        "ply\nformat binary_little_endian 1.0\ncomment presight world frame, metres\nelement vertex {}\n\
         property double x\nproperty double y\nproperty double z\nend_header\n",
        points.len()
    )?;
    points.iter().flat_map(|p| p.to_array()).try_for_each(|x| out.write_all(&x.to_le_bytes()))?;
    out.flush()
}

fn thread(work: impl FnOnce() + Send + 'static) -> Result<()> {
    let started = std::thread::Builder::new().spawn(work);
    started.map(drop).map_err(|e| {
        Error::new(ErrorKind::System, format!("no thread starts: {e}"), "free some memory or threads").caused_by(e)
    })
}

fn parse(bytes: &[u8]) -> Result<Vec<Proposal>> {
    let remedy = "print {\"object\": NAME, \"pose\": [x, y, z, qx, qy, qz, qw]} on a line of its own, or nothing";
    let text = std::str::from_utf8(bytes).map_err(|_| Error::invalid("its answer is not UTF-8", remedy))?;
    let lines = (1..).zip(text.lines()).filter(|(_, line)| !line.trim().is_empty());
    let proposal = |(number, line): (usize, &str)| {
        let wrong =
            |e: String| Error::invalid(format!("line {number} of its answer is not a valid proposal: {e}"), remedy);
        let Line { object, pose } = serde_json::from_str(line).map_err(|e| wrong(e.to_string()))?;
        let world_from_object = Pose::of_numbers(&pose).map_err(|e| wrong(e.what().to_owned()))?;
        Ok(Proposal { object, world_from_object })
    };
    lines.map(proposal).collect()
}
