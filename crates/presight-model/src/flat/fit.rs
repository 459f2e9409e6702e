//! Heights as a plane or a quadratic surface, by least squares.

use glam::DVec3;

/// Coefficients of a plane, and of a quadratic surface.
pub(super) const PLANE: usize = 3;
pub(super) const QUADRATIC: usize = 6;

/// A frame whose z axis is the normal of a neighbourhood.
#[derive(Clone, Copy, Debug)]
pub(super) struct Frame {
    origin: DVec3,
    axes: [DVec3; 3],
    /// Metres in one unit of x and y, so that all terms have similar sizes.
    unit: f64,
}

impl Frame {
    pub fn new(origin: DVec3, normal: DVec3, unit: f64) -> Self {
        let x = normal.any_orthonormal_vector();
        Self { origin, axes: [x, normal.cross(x), normal], unit }
    }

    /// Area of the circle with a radius of one unit, square metres.
    pub fn area(&self) -> f64 {
        std::f64::consts::PI * self.unit * self.unit
    }

    /// x and y in units, z in metres.
    pub fn place(&self, p: DVec3) -> [f64; 3] {
        let w = p - self.origin;
        let [x, y, z] = self.axes.map(|axis| axis.dot(w));
        [x / self.unit, y / self.unit, z]
    }

    /// Normal, and offset from the origin of coordinates, of the plane with these coefficients.
    pub fn plane(&self, c: [f64; PLANE]) -> (DVec3, f64) {
        let [x, y, z] = self.axes;
        let normal = (z - (x * c[1] + y * c[2]) / self.unit).normalize();
        (normal, normal.dot(self.origin + z * c[0]))
    }
}

/// The terms of a surface at a point.
pub(super) fn terms<const N: usize>([x, y, _]: [f64; 3]) -> [f64; N] {
    let all = [1.0, x, y, x * x, x * y, y * y];
    std::array::from_fn(|k| all[k])
}

/// Sums of a weighted least-squares fit of heights.
#[derive(Clone, Copy, Debug)]
pub(super) struct Fit<const N: usize> {
    matrix: [[f64; N]; N],
    right: [f64; N],
}

impl<const N: usize> Fit<N> {
    pub fn new() -> Self {
        Self { matrix: [[0.0; N]; N], right: [0.0; N] }
    }

    pub fn of(points: impl Iterator<Item = ([f64; 3], f64)>) -> Self {
        let mut fit = Self::new();
        points.for_each(|(p, weight)| fit.add(p, weight));
        fit
    }

    pub fn add(&mut self, p: [f64; 3], weight: f64) {
        let t: [f64; N] = terms(p);
        for (k, row) in self.matrix.iter_mut().enumerate() {
            row.iter_mut().zip(t).for_each(|(m, other)| *m += weight * t[k] * other);
            self.right[k] += weight * t[k] * p[2];
        }
    }

    /// The coefficients; `None` if the points do not determine them.
    pub fn solve(&self) -> Option<[f64; N]> {
        solve(self.matrix, self.right)
    }

    /// The height at x = y = 0, and its variance if each height has variance 1. Weights must be 1.
    pub fn middle(&self) -> Option<(f64, f64)> {
        let mut first = [0.0; N];
        first[0] = 1.0;
        let row = solve(self.matrix, first)?;
        Some((row.iter().zip(self.right).map(|(a, b)| a * b).sum(), row[0]))
    }
}

/// Height of a point above a surface.
pub(super) fn above<const N: usize>(p: [f64; 3], c: &[f64; N]) -> f64 {
    p[2] - terms::<N>(p).iter().zip(c).map(|(t, c)| t * c).sum::<f64>()
}

/// Solves a system of equations by elimination; `None` if it is singular within rounding.
fn solve<const N: usize>(mut a: [[f64; N]; N], mut b: [f64; N]) -> Option<[f64; N]> {
    let least = 1e-10 * (0..N).map(|k| a[k][k].abs()).fold(0.0, f64::max);
    for k in 0..N {
        let pivot = (k..N).max_by(|i, j| a[*i][k].abs().total_cmp(&a[*j][k].abs()))?;
        if !(a[pivot][k].abs() > least) {
            return None;
        }
        a.swap(k, pivot);
        b.swap(k, pivot);
        for i in k + 1..N {
            let factor = a[i][k] / a[k][k];
            let row = a[k];
            a[i].iter_mut().zip(row).skip(k).for_each(|(x, y)| *x -= factor * y);
            b[i] -= factor * b[k];
        }
    }
    for k in (0..N).rev() {
        let known: f64 = (k + 1..N).map(|j| a[k][j] * b[j]).sum();
        b[k] = (b[k] - known) / a[k][k];
    }
    Some(b)
}

/// The standard deviation of normal errors with these absolute values, from their median by weight.
pub(super) fn deviation(mut errors: Vec<(f64, f64)>) -> f64 {
    errors.sort_by(|a, b| a.0.total_cmp(&b.0));
    let half = 0.5 * errors.iter().map(|e| e.1).sum::<f64>();
    let mut sum = 0.0;
    let median = errors.iter().find(|e| {
        sum += e.1;
        sum >= half
    });
    // The median of |x| for a standard normal x.
    median.map_or(0.0, |m| m.0 / 0.674_489_750_196_082)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_quadratic_surface_and_its_plane_are_found() {
        let frame = Frame::new(DVec3::new(1.0, 2.0, 3.0), DVec3::Z, 0.5);
        let [x, y] = [frame.axes[0], frame.axes[1]];
        let at = |u: f64, v: f64, z: f64| frame.place(frame.origin + (x * u + y * v) * 0.5 + DVec3::Z * z);
        let grid = || (0..25).map(|k| (f64::from(k % 5) - 2.0, f64::from(k / 5) - 2.0));
        let curved = Fit::<QUADRATIC>::of(grid().map(|(u, v)| (at(u, v, 0.1 + 0.2 * u - 0.3 * u * v), 1.0)));
        let c = curved.solve().unwrap();
        for (got, expected) in c.iter().zip([0.1, 0.2, 0.0, 0.0, -0.3, 0.0]) {
            assert!((got - expected).abs() < 1e-12, "{c:?}");
        }
        // The plane z = 3.1 + 0.4 u, with u along x: in metres u is half as large.
        let plane = Fit::<PLANE>::of(grid().map(|(u, v)| (at(u, v, 0.1 + 0.2 * u), 1.0))).solve().unwrap();
        let (normal, offset) = frame.plane(plane);
        assert!((normal - (DVec3::Z - 0.4 * x).normalize()).length() < 1e-12, "{normal}");
        assert!((offset - normal.dot(frame.origin + 0.1 * DVec3::Z)).abs() < 1e-12);
        // One place does not determine a plane.
        assert!(Fit::<PLANE>::of([([0.0; 3], 1.0)].into_iter()).solve().is_none());
        // The mean of four heights has a quarter of their variance.
        let square = [[-1.0, -1.0, 1.0], [-1.0, 1.0, 2.0], [1.0, -1.0, 3.0], [1.0, 1.0, 4.0]];
        let (height, variance) = Fit::<PLANE>::of(square.into_iter().map(|p| (p, 1.0))).middle().unwrap();
        assert!((height - 2.5).abs() < 1e-12 && (variance - 0.25).abs() < 1e-12);
        assert!((deviation(vec![(0.0, 1.0), (0.674_489_750_196_082, 1.0), (9.0, 1.0)]) - 1.0).abs() < 1e-12);
    }
}
