//! What the command, the studies and the test kit of this repository share with the library. It is no part of the API.

pub use crate::engine::add_boxes;
pub use crate::environment::{CUBOID_FACES, cuboid_corners};
pub use crate::io::atomic::{is_given, target_of};
pub use crate::io::png::preview_size;
pub use crate::printable::{clipped, printable};
pub use crate::random::SplitMix64;
pub use crate::reference::{Face, instances};
pub use crate::threads::parallel_or_here;
pub use crate::verify::{FaceBound, span, ulp};

/// Opening what is read.
pub mod file {
    pub use crate::io::file::{open, open_any, starts_with, without_mark};
}

/// Which files were read.
pub mod inputs {
    pub use crate::io::inputs::{forget, record, so_far};
}

/// Files that are not finished.
pub mod temporary {
    pub use crate::io::temporary::{Access, Temporary, abandon};
}

/// Small text files.
pub mod text {
    pub use crate::io::text::read_settings;
}

/// Rows of changes.
#[cfg(feature = "store")]
pub mod row {
    /// From now on many changes are made to a store one by one, and nobody reads its feature layers in between.
    pub fn begin(store: &mut crate::io::store::Store) {
        store.begin_row();
    }
}
