//! The parts in which frames are drawn.

use super::frame_buffers::Readback;
use super::layout::Counters;
use super::uploads::FrameUploads;

/// The part of its frames that a submission draws.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(super) enum Part {
    /// Everything, from cleared keys to images.
    Whole,
    /// Polygons on top of the present keys, which the first piece clears. Only counters are read back.
    Piece { is_first: bool },
    /// The images, from the keys that the pieces drew.
    Images,
}

impl Part {
    pub fn clears(self) -> bool {
        matches!(self, Self::Whole | Self::Piece { is_first: true })
    }

    pub fn draws(self) -> bool {
        self != Self::Images
    }

    pub fn resolves(self) -> bool {
        !matches!(self, Self::Piece { .. })
    }

    /// Offset of the counters in a frame's answer, and the size of the answer, bytes.
    pub fn counters_and_end(self, frame: &FrameUploads) -> [u64; 2] {
        let at = Readback::of(frame);
        if self.resolves() { [at.counters, at.bytes] } else { [0, size_of::<Counters>() as u64] }
    }
}
