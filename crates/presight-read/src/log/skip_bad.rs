//! Logs with single bad frames: the frames that are left out, by count and by name.

use super::Observation;
use super::notices::Notices;
use presight_model::error::{Error, ErrorKind, Result};
use presight_model::geometry::Pose;
use presight_model::measured::{Motion, OdometryNoise};
use std::collections::VecDeque;

/// Maximum number of frames that the notice names; the others are counted.
const MAX_NAMED: usize = 10;

/// An item of a log: a frame with its place, or a fault. A fault without a place is not that of a single frame.
pub(super) type Placed = (Option<String>, Result<Observation>);

/// The reference of a frame's odometry.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Chain {
    /// To the frame before it in the log: behind a frame that cannot be read the motion is unknown.
    Frames,
    /// To poses at the stamps of the frames.
    Stamps,
}

/// The frames of a log without bad ones. When a stamp falls, the next frame decides: if it is later than the earlier
/// frame, the frame that fell is bad; otherwise the earlier frame is bad. The motion over a frame with a bad stamp is
/// kept, and the motion over an unreadable frame of a [`Chain::Frames`] is unknown.
pub(super) struct SkipBad<I> {
    items: I,
    chain: Chain,
    noise: OdometryNoise,
    notices: Notices,
    /// Readable frames that follow the last one given out.
    waiting: VecDeque<(String, Observation)>,
    /// The stamp of the last frame given out.
    last: Option<f64>,
    /// True behind an unreadable frame of a chain.
    is_broken: bool,
    read: usize,
    named: Vec<String>,
    left_out: usize,
    first_fault: Option<Error>,
    ended: bool,
}

impl<I: Iterator<Item = Placed>> SkipBad<I> {
    /// The notice on the frames left out is among `notices` when the log has ended.
    pub fn new(items: I, chain: Chain, noise: OdometryNoise, notices: Notices) -> Self {
        Self {
            items,
            chain,
            noise,
            notices,
            waiting: VecDeque::new(),
            last: None,
            is_broken: false,
            read: 0,
            named: Vec::new(),
            left_out: 0,
            first_fault: None,
            ended: false,
        }
    }

    fn leave_out(&mut self, place: &str, why: Error) {
        self.left_out += 1;
        if self.named.len() < MAX_NAMED {
            self.named.push(format!("{place} ({})", why.what()));
        }
        self.first_fault.get_or_insert(why);
    }

    /// Reads until `count` frames wait or the log ends; false if fewer wait.
    fn fill(&mut self, count: usize) -> Result<bool> {
        while self.waiting.len() < count {
            let Some((place, item)) = self.items.next() else { return Ok(false) };
            self.read += 1;
            match (place, item) {
                (Some(place), Ok(mut observation)) => {
                    if std::mem::take(&mut self.is_broken) {
                        observation.frame.motion = None;
                    }
                    self.waiting.push_back((place, observation));
                }
                (Some(place), Err(e)) if is_of_frame(&e) => {
                    self.is_broken = self.chain == Chain::Frames;
                    self.leave_out(&place, e);
                }
                (_, Err(e)) => return Err(e),
                (None, Ok(_)) => unreachable!("every frame has a place"),
            }
        }
        Ok(true)
    }

    /// Leaves out the waiting frame `index`; its motion goes to the frame behind it.
    fn drop_waiting(&mut self, index: usize, before: f64) {
        let Some((place, dropped)) = self.waiting.remove(index) else { return };
        let what = format!(
            "its time {} s does not fit between its neighbours; the frame before is at {before} s",
            dropped.frame.stamp
        );
        self.leave_out(&place, Error::invalid(what, "sort the frames by time, each once"));
        if let Some((_, next)) = self.waiting.get_mut(index) {
            let motion = |frame: &Observation| frame.frame.motion.as_ref().map(|m| m.previous_from_current);
            let whole = motion(&dropped).zip(motion(next)).map(|(a, b): (Pose, Pose)| a * b);
            next.frame.motion = whole.map(|motion| Motion::of_odometry(motion, &self.noise));
        } else if index == self.waiting.len() {
            self.is_broken = true;
        }
    }

    fn read(&mut self) -> Result<Option<Observation>> {
        loop {
            if !self.fill(1)? {
                return Ok(None);
            }
            let first = self.waiting[0].1.frame.stamp;
            if let Some(last) = self.last.filter(|last| !(first > *last)) {
                // The motion of the frame behind is needed.
                self.fill(2)?;
                self.drop_waiting(0, last);
                continue;
            }
            if self.fill(2)? {
                let second = self.waiting[1].1.frame.stamp;
                if !(second > first) {
                    let goes_on = !self.fill(3)? || self.waiting[2].1.frame.stamp > first;
                    let is_after_last = self.last.is_none_or(|last| second > last);
                    let bad = usize::from(goes_on || !is_after_last || second == first);
                    let before = if bad == 1 { first } else { self.last.unwrap_or(second) };
                    self.drop_waiting(bad, before);
                    continue;
                }
            }
            self.last = Some(first);
            return Ok(self.waiting.pop_front().map(|(_, observation)| observation));
        }
    }

    /// States at the end of the log which frames were left out.
    fn end(&mut self) -> Option<Result<Observation>> {
        self.ended = true;
        let fault = self.first_fault.take()?;
        if self.last.is_none() {
            return Some(Err(fault));
        }
        let more = self.left_out - self.named.len();
        let more = if more > 0 { format!(", and {more} more") } else { String::new() };
        self.notices.add(format!(
            "{} of {} frames are left out: {}{more}",
            self.left_out,
            self.read,
            self.named.join(", ")
        ));
        None
    }
}

/// True for a fault of one frame: its content, or its file in a folder.
fn is_of_frame(e: &Error) -> bool {
    matches!(e.kind(), ErrorKind::Invalid | ErrorKind::Unsupported | ErrorKind::Usage | ErrorKind::System)
}

impl<I: Iterator<Item = Placed>> Iterator for SkipBad<I> {
    type Item = Result<Observation>;

    fn next(&mut self) -> Option<Self::Item> {
        if self.ended {
            return None;
        }
        match self.read() {
            Ok(Some(observation)) => Some(Ok(observation)),
            Ok(None) => self.end(),
            Err(e) => {
                self.ended = true;
                Some(Err(e))
            }
        }
    }
}
