//! Switches that leave out one means of speed at a time, for `cargo bench --features ablation --bench ablation`.
//!
//! Each switch stands where the means begins. No result may depend on a switch, apart from what a deadline gives up.
//! Without the feature `ablation` every means is in use, and the compiler removes the question.

/// A means of speed that can be left out, with the most that it gained on both of two machines: the CPU time without it over
/// the time with it, at the median or the 95th percentile of a scene and sensor (benches/runs/2026-11-26-h100/ablation.md).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub enum Means {
    /// Runs of samples of a segment are decided together. 1.17 (factory.rhai, video-camera).
    Runs,
    /// Columns of small patches are decided together. 1.42 (factory.rhai, video-camera).
    Grid,
    /// The middles of gaps along a segment are searched in the image before the index is queried. 1.09 (hospital, vlp-16).
    Gaps,
    /// A first query of a tile ends behind what the image shows. 1.14 (hospital, microwave-radar-image).
    FirstLooks,
    /// Cells exclude many polygons of a tile at once. 1.15 (factory.rhai, video-camera), 1.73 in the city.
    Cells,
    /// Few samples have rays of their own, without a tile. 1.08 with twelve features (hospital, microwave-radar-image),
    /// nothing with all.
    FewRays,
    /// Boxes of many features are hidden at once. 1.17 (hospital, video-camera), 2.4 in the city.
    HiddenBoxes,
    /// A feature that one polygon hides is not tested further. 1.07 (office_willowgarage, laser-range-camera).
    HiddenFeatures,
    /// So is a feature that several polygons hide in parts. 1.29 (office_willowgarage, microwave-radar-image).
    HiddenParts,
    /// Workspaces of features are kept between predictions. 1.18 (open hall, microwave-radar-image).
    KeptWorkspaces,
    /// Vertices of a cluster are placed once, and polygons between two lines or samples end there. 1.21 (hospital, vlp-16).
    Sieve,
    /// Runs behind the z-buffer are dropped. 2.3 (hospital, vlp-16).
    HiddenRuns,
    /// An image is thinned, decided after selection. 12 points of kept deadlines (factory.rhai, realsense-d435).
    Stride,
    /// An image is thinned, decided after the first wave's setup. 7 points of kept deadlines and 19 of final samples
    /// (hospital, realsense-d435).
    SecondStride,
    /// The farthest polygons are left out before setup. 45 points of final samples (factory.rhai, all-round scanners).
    Radius,
    /// An image is narrowed. 9 points of final samples (factory.rhai, os1-128); outputs and requests name it.
    Angle,
    /// Estimates that refused recent frames are doubted. Without it one wrong estimate would refuse every later frame;
    /// no other gain was measured.
    Doubt,
}

impl Means {
    /// All of them.
    pub const ALL: [Self; 17] = [
        Self::Runs,
        Self::Grid,
        Self::Gaps,
        Self::FirstLooks,
        Self::Cells,
        Self::FewRays,
        Self::HiddenBoxes,
        Self::HiddenFeatures,
        Self::HiddenParts,
        Self::KeptWorkspaces,
        Self::Sieve,
        Self::HiddenRuns,
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
