//! Switches that leave out one means of speed at a time, for `cargo bench --features ablation --bench ablation`.
//!
//! Each switch stands where the means begins. No result may depend on a switch, apart from what a deadline gives up.
//! Without the feature `ablation` every means is in use, and the compiler removes the question.

/// A means of speed that can be left out.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub enum Means {
    /// Runs of samples of a segment are decided together.
    Runs,
    /// Columns of small patches are decided together.
    Grid,
    /// The middles of gaps along a segment are searched in the image before the index is queried.
    Gaps,
    /// A first query of a tile ends behind what the image shows.
    FirstLooks,
    /// A polygon that covers a tile hides those behind it.
    Cover,
    /// Cells exclude many polygons of a tile at once.
    Cells,
    /// Few samples have rays of their own, without a tile.
    FewRays,
    /// Boxes of many features are hidden at once.
    HiddenBoxes,
    /// A feature that one polygon hides is not tested further.
    HiddenFeatures,
    /// So is a feature that several polygons hide in parts.
    HiddenParts,
    /// Workspaces of features are kept between predictions.
    KeptWorkspaces,
    /// Vertices of a cluster are placed once, and polygons between two lines or samples end there.
    Sieve,
    /// Runs behind the z-buffer are dropped.
    HiddenRuns,
    /// Polygons behind the z-buffer are dropped.
    HiddenPolygons,
    /// An image is thinned, decided after selection.
    Stride,
    /// An image is thinned, decided after the first wave's setup.
    SecondStride,
    /// The farthest polygons are left out before setup.
    Radius,
    /// An image is narrowed.
    Angle,
    /// Estimates that refused recent frames are doubted.
    Doubt,
}

impl Means {
    /// All of them.
    pub const ALL: [Self; 19] = [
        Self::Runs,
        Self::Grid,
        Self::Gaps,
        Self::FirstLooks,
        Self::Cover,
        Self::Cells,
        Self::FewRays,
        Self::HiddenBoxes,
        Self::HiddenFeatures,
        Self::HiddenParts,
        Self::KeptWorkspaces,
        Self::Sieve,
        Self::HiddenRuns,
        Self::HiddenPolygons,
        Self::Stride,
        Self::SecondStride,
        Self::Radius,
        Self::Angle,
        Self::Doubt,
    ];

    /// Returns true unless the means is left out.
    #[inline(always)]
    pub fn is_used(self) -> bool {
        #[cfg(feature = "ablation")]
        let is_used = LEFT_OUT.load(std::sync::atomic::Ordering::Relaxed) != self as u8;
        #[cfg(not(feature = "ablation"))]
        let is_used = true;
        is_used
    }
}

#[cfg(feature = "ablation")]
static LEFT_OUT: std::sync::atomic::AtomicU8 = std::sync::atomic::AtomicU8::new(u8::MAX);

/// Leaves out a means in this process, in place of the one before.
#[cfg(feature = "ablation")]
pub fn leave_out(means: Option<Means>) {
    LEFT_OUT.store(means.map_or(u8::MAX, |means| means as u8), std::sync::atomic::Ordering::Relaxed);
}
