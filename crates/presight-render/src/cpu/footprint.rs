//! The pixels that polygons may cover, and the extents of their corners.

use std::ops::Range;

/// Number of polygons processed together; a multiple of every vector width.
pub(super) const LANES: usize = 8;
/// One number for each lane.
pub(super) type Lanes = [f64; LANES];

/// The lines that a polygon may cover: up to two ranges, the second one for polygons over the azimuth seam.
pub(super) type LineCover = [Range<u32>; 2];

/// The pixels that a polygon, or any convex hull of corners, may cover.
#[derive(Clone, Debug)]
pub(super) struct Footprint {
    /// Lines; both ranges are empty if it covers no ray.
    pub lines: LineCover,
    /// Samples on each of them.
    pub samples: Range<u32>,
    /// Lower bound of the depth, metres; 0 if unknown.
    pub nearest: f64,
}

pub(super) const NOTHING: Footprint = Footprint { lines: [0..0, 0..0], samples: 0..0, nearest: 0.0 };

/// For a vertex the first line and the first sample at or behind it, then the last ones before it, negated, each with a
/// small margin: the reach of a polygon is the minimum over its corners. Whole numbers below 2^24.
pub(super) type Reach = [f32; 4];

/// Relative widening of every bound, far above f64 rounding and far below a pixel.
pub(super) const SLACK: f64 = 1e-9;

/// Extent of the corners so far, by lane.
pub(super) struct Extent {
    pub least: [Lanes; 3],
    pub(super) greatest: [Lanes; 3],
    /// Camera: lines and samples. Scanner: azimuth in `low[0]`, and the maximum squared distance from the axis.
    pub low: [Lanes; 2],
    pub high: [Lanes; 2],
    pub(super) outside: [Lanes; 5],
    pub(super) axis_distance_squared: Lanes,
    pub(super) first: Lanes,
    pub(super) previous: Lanes,
    pub(super) turned: Lanes,
    pub(super) astray: Lanes,
}

impl Extent {
    #[inline(always)]
    pub fn new() -> Self {
        Self {
            least: [[f64::INFINITY; LANES]; 3],
            greatest: [[f64::NEG_INFINITY; LANES]; 3],
            low: [[f64::INFINITY; LANES]; 2],
            high: [[f64::NEG_INFINITY; LANES]; 2],
            outside: [[f64::NEG_INFINITY; LANES]; 5],
            axis_distance_squared: [0.0; LANES],
            first: [0.0; LANES],
            previous: [0.0; LANES],
            turned: [0.0; LANES],
            astray: [0.0; LANES],
        }
    }

    #[inline(always)]
    pub fn hold(&mut self, corner: &[Lanes; 3]) {
        for axis in 0..3 {
            for l in 0..LANES {
                self.least[axis][l] = self.least[axis][l].min(corner[axis][l]);
                self.greatest[axis][l] = self.greatest[axis][l].max(corner[axis][l]);
            }
        }
    }

    /// Takes a corner into an image plane at z = 1 with these sides.
    #[inline(always)]
    pub fn hold_ahead(&mut self, [y, z, x]: [&Lanes; 3], [top, bottom, left, right]: [f64; 4]) {
        for l in 0..LANES {
            // Maximum signed distance inside each side so far: negative if all corners are outside.
            self.outside[0][l] = self.outside[0][l].max(y[l] - top * z[l]);
            self.outside[1][l] = self.outside[1][l].max(bottom * z[l] - y[l]);
            self.outside[2][l] = self.outside[2][l].max(x[l] - left * z[l]);
            self.outside[3][l] = self.outside[3][l].max(right * z[l] - x[l]);
            self.outside[4][l] = self.outside[4][l].max(z[l]);
            self.least[1][l] = self.least[1][l].min(z[l]);
            let per_z = 1.0 / z[l];
            self.low[0][l] = self.low[0][l].min(y[l] * per_z);
            self.high[0][l] = self.high[0][l].max(y[l] * per_z);
            self.low[1][l] = self.low[1][l].min(x[l] * per_z);
            self.high[1][l] = self.high[1][l].max(x[l] * per_z);
        }
    }

    /// True if all corners that [`Extent::hold_ahead`] took are outside one side, behind, or too far.
    #[inline(always)]
    pub fn is_beside(&self, l: usize, range_max_squared: f64) -> bool {
        let outside = self.outside.iter().any(|side| side[l] < 0.0);
        // Depth is at most range: a polygon entirely deeper than range_max is beyond it.
        outside || (self.least[1][l] > 0.0 && self.least[1][l] * self.least[1][l] > range_max_squared)
    }

    /// Squared distances of the box around the corners from the sensor and from its axis.
    #[inline(always)]
    pub fn box_distances_squared(&self) -> (Lanes, Lanes) {
        let (mut all, mut axis) = ([0.0; LANES], [0.0; LANES]);
        for l in 0..LANES {
            let gap = |a: usize| self.least[a][l].max(-self.greatest[a][l]).max(0.0);
            axis[l] = gap(0) * gap(0) + gap(1) * gap(1);
            all[l] = axis[l] + gap(2) * gap(2);
        }
        (all, axis)
    }
}
