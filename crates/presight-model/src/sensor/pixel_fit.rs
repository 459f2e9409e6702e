//! Approximates the pixel of any direction in a ray table. Each cell of directions has quadratics for column and row,
//! with their largest error over its rays. Errors are measured ray by ray, so they hold for any table.

use super::ImagePart;
use crate::error::Result;
use crate::matrix::{cholesky, solve_factored};
use crate::memory;
use glam::DVec3;

/// Pixels. Quadratics with a larger error are discarded.
const MAX_ERROR: f64 = 0.4;

/// Rays that suffice to fit the quadratics of all cells.
const ENOUGH: usize = 60_000;

/// 1, x, y, xx, xy, yy.
const TERMS: usize = 6;

type Terms = [f64; TERMS];

/// The quadratic for the columns, or for the rows, of the rays around a cell.
#[derive(Clone, Copy, Debug, Default)]
pub struct Fitted {
    pub terms: Terms,
    /// Maximum error over the rays, pixels.
    pub off: f64,
    /// Norm of the second derivative.
    pub bend: f64,
}

/// A cell of directions. Its quadratics also cover a margin of half a cell on every side.
#[derive(Clone, Copy, Debug, Default)]
pub struct FitCell {
    /// Position on the cube side.
    pub middle: [f64; 2],
    /// True if no ray points there.
    pub is_empty: bool,
    /// Quadratics for column and row, over -1..1 across the cell and its margin. `None` if they do not fit well enough.
    pub fitted: Option<[Fitted; 2]>,
}

/// Cells of directions on the sides of a cube.
#[derive(Clone, Debug)]
pub struct PixelFit {
    cells: Vec<FitCell>,
}

/// The sums of a least-squares fit over the rays of a cell.
#[derive(Clone, Copy)]
struct Sums {
    count: f64,
    matrix: [Terms; TERMS],
    right: [Terms; 2],
}

/// The components of a direction along a cube side's axis and along its two edges. The index of a side is twice its
/// axis, plus one for the negative direction.
#[inline(always)]
pub fn on_side(side: usize, d: [f64; 3]) -> [f64; 3] {
    let [along, u, v] = match side / 2 {
        0 => d,
        1 => [d[1], d[2], d[0]],
        _ => [d[2], d[0], d[1]],
    };
    [if side.is_multiple_of(2) { along } else { -along }, u, v]
}

#[inline(always)]
fn terms(x: f64, y: f64) -> Terms {
    [1.0, x, y, x * x, x * y, y * y]
}

/// Calls `cell` for every cell whose margin contains the direction, with the position in that cell.
fn surroundings(d: DVec3, mut cell: impl FnMut(usize, [f64; 2])) {
    for side in 0..6 {
        let [along, u, v] = on_side(side, d.to_array());
        if !(along > 0.1) {
            continue;
        }
        let place = [u / along, v / along];
        let around = place.map(|t| {
            let at = (t + 1.0) / FitCell::SIDE;
            let (first, last) = ((at - 1.5).ceil().max(0.0), (at + 0.5).floor().min(f64::from(FitCell::ACROSS) - 1.0));
            (first, last)
        });
        if around.iter().any(|(first, last)| first > last) {
            continue;
        }
        for row in around[1].0 as u32..=around[1].1 as u32 {
            for column in around[0].0 as u32..=around[0].1 as u32 {
                let middle = [column, row].map(middle_of);
                let at = [0, 1].map(|k| (place[k] - middle[k]) / FitCell::SIDE);
                cell(index(side, [column, row]), at);
            }
        }
    }
}

fn middle_of(cell: u32) -> f64 {
    (f64::from(cell) + 0.5) * FitCell::SIDE - 1.0
}

fn index(side: usize, [column, row]: [u32; 2]) -> usize {
    (side * FitCell::ACROSS as usize + row as usize) * FitCell::ACROSS as usize + column as usize
}

impl Sums {
    const NONE: Self = Self { count: 0.0, matrix: [[0.0; TERMS]; TERMS], right: [[0.0; TERMS]; 2] };

    fn add(&mut self, terms: Terms, pixel: [f64; 2]) {
        self.count += 1.0;
        for i in 0..TERMS {
            for j in 0..=i {
                self.matrix[i][j] += terms[i] * terms[j];
            }
            self.right[0][i] += terms[i] * pixel[0];
            self.right[1][i] += terms[i] * pixel[1];
        }
    }

    /// The least-squares quadratics, by Cholesky decomposition. Terms that the rays do not determine come out near 0.
    fn solve(&self) -> [Terms; 2] {
        let pivot = |rest: f64| Some((rest + 1e-7 * self.count).max(1e-12 * self.count));
        let l = cholesky(&self.matrix, pivot).unwrap_or([[0.0; TERMS]; TERMS]);
        self.right.map(|right| solve_factored(&l, &right))
    }
}

impl PixelFit {
    /// Fits the cells. `directions` are unit vectors, row-major; NaN means no ray.
    ///
    /// # Errors
    /// [`crate::ErrorKind::System`] if the system refuses the memory, about a megabyte.
    pub fn new(width: u32, directions: &[DVec3]) -> Result<Self> {
        let count = 6 * (FitCell::ACROSS * FitCell::ACROSS) as usize;
        let rays = || directions.iter().zip(0u32..).filter(|(d, _)| !d.is_nan());
        let pixel = |i: u32| [i % width, i / width].map(f64::from);
        let mut sums = memory::reserved(count)?;
        sums.resize(count, Sums::NONE);
        // A large table is sampled for the fit. The errors are then measured on all rays.
        let step = (directions.len() / ENOUGH) | 1;
        for (d, i) in rays().step_by(step) {
            surroundings(*d, |cell, [x, y]| sums[cell].add(terms(x, y), pixel(i)));
        }
        let mut cells = memory::reserved(count)?;
        cells.extend((0..count).map(|i| {
            let (column, row) = (i as u32 % FitCell::ACROSS, i as u32 / FitCell::ACROSS % FitCell::ACROSS);
            FitCell { middle: [column, row].map(middle_of), is_empty: true, fitted: fitted(&sums[i]) }
        }));
        for (d, i) in rays() {
            surroundings(*d, |cell, [x, y]| {
                cells[cell].is_empty = false;
                for (fitted, pixel) in cells[cell].fitted.iter_mut().flatten().zip(pixel(i)) {
                    let off = (fitted.at(x, y) - pixel).abs();
                    fitted.off = if off > fitted.off { off } else { fitted.off };
                }
            });
        }
        for cell in &mut cells {
            cell.fitted = cell.fitted.filter(|both| both.iter().all(|fitted| fitted.off < MAX_ERROR));
        }
        Ok(Self { cells })
    }

    /// This approximation in the pixel coordinates of a part of the image.
    pub fn part(&self, part: &ImagePart) -> Self {
        let stride = f64::from(part.stride);
        let of_part = |fitted: Fitted, first: f64| {
            let mut terms = fitted.terms.map(|t| t / stride);
            terms[0] -= first / stride;
            Fitted { terms, off: fitted.off / stride + 1e-9, bend: fitted.bend / stride }
        };
        let cell = |cell: &FitCell| {
            let fitted = cell.fitted.map(|[c, r]| [of_part(c, f64::from(part.first_column)), of_part(r, 0.0)]);
            FitCell { fitted, ..*cell }
        };
        Self { cells: self.cells.iter().map(cell).collect() }
    }

    /// The side and the cell of a direction of any nonzero length.
    pub fn around(&self, d: DVec3) -> Option<(usize, &FitCell)> {
        let [x, y, z] = d.abs().to_array();
        let axis = if x >= y && x >= z { 0 } else { 1 + usize::from(z > y) };
        let side = 2 * axis + usize::from(d[axis] < 0.0);
        let [along, u, v] = on_side(side, d.to_array());
        // The cast saturates, and NaN becomes 0.
        let cell = [u, v].map(|t| (((t / along + 1.0) / FitCell::SIDE) as u32).min(FitCell::ACROSS - 1));
        (along > 0.0).then(|| (side, &self.cells[index(side, cell)]))
    }

    /// All cells, by side, then by row.
    pub fn cells(&self) -> &[FitCell] {
        &self.cells
    }

    pub fn bytes(&self) -> usize {
        size_of_val(&*self.cells)
    }
}

/// The best quadratics; their errors are not measured yet.
fn fitted(sums: &Sums) -> Option<[Fitted; 2]> {
    let bend = |t: &Terms| (4.0 * (t[3] * t[3] + t[5] * t[5]) + 2.0 * t[4] * t[4]).sqrt();
    (sums.count > 0.0).then(|| sums.solve().map(|terms| Fitted { bend: bend(&terms), terms, off: 0.0 }))
}

impl Fitted {
    #[inline(always)]
    pub fn at(&self, x: f64, y: f64) -> f64 {
        let t = &self.terms;
        t[0] + x * (t[1] + x * t[3] + y * t[4]) + y * (t[2] + y * t[5])
    }
}

impl FitCell {
    /// Edge of a cell, on a cube of half edge 1.
    pub const SIDE: f64 = 0.1;

    /// Cells along an edge of the cube.
    pub const ACROSS: u32 = 20;

    /// Converts an offset on the cube side to the argument of the quadratics.
    pub const PER_UNIT: f64 = 1.0 / Self::SIDE;
}

#[cfg(test)]
mod tests {
    use super::*;

    /// 80 x 60 rays of a fisheye that looks along an axis.
    fn fisheye(axis: DVec3, step: f64) -> Vec<DVec3> {
        let (right, down) = axis.any_orthonormal_pair();
        let ray = |i: u32| {
            let (x, y) = (step * (f64::from(i % 80) - 39.5), step * (f64::from(i / 80) - 29.5));
            let angle = x.hypot(y);
            axis * angle.cos() + (right * x + down * y) * (angle.sin() / angle)
        };
        (0..4800).map(ray).collect()
    }

    #[test]
    fn no_ray_is_farther_off_than_told() {
        for axis in [DVec3::Z, DVec3::new(0.7, -0.5, 0.6).normalize(), DVec3::NEG_X] {
            let rays = fisheye(axis, 0.02);
            let fit = PixelFit::new(80, &rays).unwrap();
            let mut told = 0;
            for (d, i) in rays.iter().zip(0u32..) {
                let (side, cell) = fit.around(*d).unwrap();
                let Some(fitted) = &cell.fitted else { continue };
                let [along, u, v] = on_side(side, d.to_array());
                let [x, y] = [u / along - cell.middle[0], v / along - cell.middle[1]].map(|t| t * FitCell::PER_UNIT);
                assert!(x.abs() <= 0.5 + 1e-9 && y.abs() <= 0.5 + 1e-9, "{x} {y}");
                for (fitted, pixel) in fitted.iter().zip([i % 80, i / 80]) {
                    assert!((fitted.at(x, y) - f64::from(pixel)).abs() <= fitted.off, "{i}");
                    // Otherwise a large enough stated error would pass any fit.
                    assert!(fitted.off < 0.05, "{}", fitted.off);
                }
                told += 1;
            }
            assert_eq!(told, 4800);
            assert!(fit.around(-axis).unwrap().1.is_empty);
        }
    }

    #[test]
    fn a_part_is_told_as_its_own_rays_are() {
        let rays = fisheye(DVec3::Z, 0.02);
        let part = ImagePart { first_column: 16, end_column: 63, stride: 2 };
        let fit = PixelFit::new(80, &rays).unwrap().part(&part);
        for (row, column) in (0..30).flat_map(|row| (0..24).map(move |column| (row, column))) {
            let d = rays[(2 * row * 80 + part.column(column)) as usize];
            let (side, cell) = fit.around(d).unwrap();
            let [along, u, v] = on_side(side, d.to_array());
            let [x, y] = [u / along - cell.middle[0], v / along - cell.middle[1]].map(|t| t * FitCell::PER_UNIT);
            for (fitted, pixel) in cell.fitted.unwrap().iter().zip([column, row]) {
                let off = (fitted.at(x, y) - f64::from(pixel)).abs();
                assert!(off <= fitted.off && fitted.off < 0.03, "{row}, {column}: {off}");
            }
        }
    }

    #[test]
    fn rays_in_no_order_are_not_told() {
        let mut rays = fisheye(DVec3::Z, 0.02);
        for i in 0..2400 {
            if i % 3 == 0 {
                rays.swap(i, 4799 - i);
            }
        }
        let fit = PixelFit::new(80, &rays).unwrap();
        let told = rays.iter().filter(|d| fit.around(**d).unwrap().1.fitted.is_some()).count();
        assert!(told < 100, "{told}");
        let none = PixelFit::new(80, &[DVec3::NAN; 4800]).unwrap();
        assert!(none.around(DVec3::X).unwrap().1.is_empty);
    }
}
