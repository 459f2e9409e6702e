//! Polygons that a sensor's last frame showed, for its next frame in the same version of the world. They only affect
//! the order in which runs are drawn: every run that is not hidden is still drawn.

use super::frame_buffers::Readback;
use super::uploads::FrameUploads;
use presight_render::plan::{FramePlan, Run};

/// Maximum polygons of a world that is tracked: 2 MiB for each sensor.
pub(super) const MAX_SLOTS: u32 = 1 << 24;

/// One bit for each slot of the environment.
#[derive(Default)]
pub(super) struct Shown {
    /// The stamp of the drawn version of the world.
    world: Option<u64>,
    words: Vec<u32>,
    /// Number of set bits.
    polygons: u32,
}

impl Shown {
    /// Returns the last frame's polygons; `None` if it drew another version of the world, or showed nothing.
    pub fn of(&self, plan: &FramePlan) -> Option<&Self> {
        (self.world == Some(plan.world.stamp()) && self.polygons > 0).then_some(self)
    }

    /// True if this number of polygons is less than half of those shown.
    pub fn is_mostly_without(&self, polygons: u32) -> bool {
        2 * polygons < self.polygons
    }

    /// Number of shown polygons in a run.
    pub fn count_in(&self, plan: &FramePlan, run: &Run) -> u32 {
        let object = plan.instances[run.instance as usize].object;
        let first = plan.environment().objects()[object as usize].first_slot + run.first;
        self.count(first, first + run.count)
    }

    /// Number of shown polygons in these slots.
    fn count(&self, first: u32, end: u32) -> u32 {
        let (mut at, mut count) = (first, 0);
        while at < end {
            let next = end.min((at | 31) + 1);
            let mask = (u32::MAX >> (32 - (next - at))) << (at & 31);
            count += self.words.get(at as usize >> 5).map_or(0, |word| (word & mask).count_ones());
            at = next;
        }
        count
    }

    /// Records which polygons a frame showed, from the device's answer.
    pub fn note(&mut self, plan: &FramePlan, frame: &FrameUploads, answer: &[u8]) {
        let at = Readback::of(frame);
        self.words.clear();
        if frame.on_host {
            self.words.resize(frame.slots.div_ceil(32) as usize, 0);
            let keys: &[[u32; 2]] = bytemuck::cast_slice(&answer[..at.slots as usize]);
            // Neighbours mostly show the same polygon.
            for slot in keys.chunk_by(|a, b| a[0] == b[0]).map(|same| !same[0][0]) {
                // An empty pixel has no valid slot.
                if let Some(word) = self.words.get_mut(slot as usize >> 5) {
                    *word |= 1 << (slot & 31);
                }
            }
        } else {
            let bytes = &answer[at.shown as usize..][..4 * frame.shown_words() as usize];
            self.words.extend(bytes.chunks_exact(4).map(bytemuck::pod_read_unaligned::<u32>));
        }
        self.polygons = self.words.iter().map(|word| word.count_ones()).sum();
        self.world = Some(plan.world.stamp());
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bits_are_counted_across_words() {
        let slots = |slot: &u32| slot.is_multiple_of(3) || slot.is_multiple_of(7);
        let words = (0..4).map(|w| (0..32).filter(|bit| slots(&(32 * w + bit))).fold(0, |word, bit| word | 1 << bit));
        let shown = Shown { world: None, words: words.collect(), polygons: 0 };
        for first in 0..128 {
            for end in first..140 {
                // Slots beyond the last word are not shown.
                let expected = (first..end.min(128)).filter(slots).count();
                assert_eq!(shown.count(first, end) as usize, expected, "{first}..{end}");
            }
        }
    }
}
