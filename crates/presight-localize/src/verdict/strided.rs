//! Predicted points in the order in which windows of an image are searched: columns that are one stride apart lie side
//! by side.

use super::pixel::ExpectedPixel;
use std::sync::OnceLock;

/// Points compared by one vector instruction: the f32 lanes of AVX-512.
pub const LANES: usize = 16;
/// Maximum stride with an order in memory: windows with wider steps contain few points of an image.
const WIDEST: usize = 16;
/// Padding before and after a row, points. Windows reach seven steps beyond an image, and so do their middles, which is
/// fourteen.
const AROUND: usize = 16;

/// The points of an image, by stride, each order made at its first use. Columns outside the image and pixels without a
/// point are NaN.
#[derive(Clone, Debug, Default)]
pub(crate) struct StridedPoints {
    by_stride: [OnceLock<Strided>; WIDEST],
}

/// Columns grouped by their remainder modulo the stride.
#[derive(Clone, Debug)]
struct Strided {
    /// Number of points in one row and remainder, padding included.
    length: usize,
    axes: [Vec<f32>; 3],
}

impl Strided {
    fn new(pixels: &[ExpectedPixel], width: usize, stride: usize) -> Self {
        let length = AROUND + width.div_ceil(stride) + AROUND + LANES;
        let mut axes = [(); 3].map(|()| vec![f32::NAN; pixels.len() / width.max(1) * stride * length]);
        for (i, pixel) in pixels.iter().enumerate() {
            let (row, column) = (i / width, i % width);
            let at = (row * stride + column % stride) * length + AROUND + column / stride;
            (0..3).for_each(|k| axes[k][at] = pixel.point[k]);
        }
        Self { length, axes }
    }
}

/// Rows of a window, which begin in one column and take every `stride`-th column from there.
pub(crate) struct WindowRows<'a> {
    pixels: &'a [ExpectedPixel],
    width: usize,
    first: i32,
    stride: usize,
    /// The ordered points, the index at which a row of these columns begins, and the distance between rows.
    ordered: Option<(&'a [Vec<f32>; 3], usize, usize)>,
}

impl StridedPoints {
    /// The rows that begin in column `first`.
    #[inline(always)]
    pub fn rows<'a>(&'a self, pixels: &'a [ExpectedPixel], width: usize, first: i32, stride: usize) -> WindowRows<'a> {
        let (step, phase) = (first.div_euclid(stride as i32), first.rem_euclid(stride as i32) as usize);
        let from = AROUND as i32 + step;
        let mut ordered = None;
        if stride <= WIDEST && from >= 0 {
            let all = self.by_stride[stride - 1].get_or_init(|| Strided::new(pixels, width, stride));
            let from = from as usize;
            if from + LANES <= all.length {
                ordered = Some((&all.axes, phase * all.length + from, stride * all.length));
            }
        }
        WindowRows { pixels, width, first, stride, ordered }
    }
}

impl WindowRows<'_> {
    /// x, y and z of the points in a row of the image.
    #[inline(always)]
    pub fn row(&self, row: usize) -> [[f32; LANES]; 3] {
        if let Some((axes, from, apart)) = self.ordered {
            let at = from + row * apart;
            return axes.each_ref().map(|axis| axis[at..at + LANES].try_into().unwrap_or([f32::NAN; LANES]));
        }
        let mut found = [[f32::NAN; LANES]; 3];
        for lane in 0..LANES {
            let column = self.first + (lane * self.stride) as i32;
            if (0..self.width as i32).contains(&column) {
                let point = self.pixels[row * self.width + column as usize].point;
                (0..3).for_each(|k| found[k][lane] = point[k]);
            }
        }
        found
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::verdict::pixel::NOTHING;
    use glam::Vec3;

    /// For every stride and first column, each lane has the point of its column, or NaN outside the image.
    #[test]
    fn lanes_have_the_points_of_their_columns() {
        let (width, height) = (37, 3);
        let pixel = |i: usize| ExpectedPixel { point: Vec3::new(i as f32, -(i as f32), 0.5), ..NOTHING };
        let pixels: Vec<ExpectedPixel> = (0..width * height).map(pixel).collect();
        let strided = StridedPoints::default();
        for stride in 1..40 {
            for first in -300..300 {
                let [x, y, _] = strided.rows(&pixels, width, first, stride).row(1);
                for lane in 0..LANES {
                    let column = first + (lane * stride) as i32;
                    let inside = (0..width as i32).contains(&column);
                    let expected = if inside { (width as i32 + column) as f32 } else { f32::NAN };
                    assert_eq!(x[lane].to_bits(), expected.to_bits(), "stride {stride}, from {first}, lane {lane}");
                    assert!(!inside || y[lane] == -expected);
                }
            }
        }
    }
}
