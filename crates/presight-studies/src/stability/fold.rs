//! The fold of a lens with tangential or thin prism terms, which has a different radius in each direction. Computed in
//! f64 from the model's formula, independently of the product.
//!
//! Rays are points of the plane z = 1. In each direction from the axis the model is valid as long as the symmetric part
//! of its Jacobian is positive definite. The images of the last valid points are the outline, the limit of all images.

/// Step of the search for the first fold: of the radius, or of the angle from the axis in radians.
pub(super) const STEP: f64 = 1e-3;
/// The search ends at this radius, 87 degrees from the axis. Lenses without a fold up to there count as not folding.
pub(super) const FARTHEST: f64 = 20.0;

/// Accuracy of the outline, relative to the image radius (1 if that is less). The Jacobian is singular across the
/// outline, so an error of the ray's radius enters only by its square.
const TOLERANCE: f64 = 1e-9;

/// The maximum number of iterations for a direction of the outline.
const MOST_STEPS: usize = 60;

/// The parameters of the model.
#[derive(Clone, Debug)]
pub(super) struct Outline {
    /// 1, k1, k2, k3 and 1, k4, k5, k6 in powers of the squared radius.
    pub numerator: [f64; 4],
    pub denominator: [f64; 4],
    /// (p2, p1).
    pub tangential: [f64; 2],
    /// (s1, s3) and (s2, s4).
    pub prism: [[f64; 2]; 2],
}

/// Value and derivative of a polynomial.
fn evaluate(polynomial: &[f64; 4], s: f64) -> (f64, f64) {
    let [a, b, c, d] = *polynomial;
    (a + s * (b + s * (c + s * d)), b + s * (2.0 * c + 3.0 * s * d))
}

impl Outline {
    /// Distance of an image point beyond the outline, negative inside, and its accuracy; `None` without a fold there.
    pub fn beyond(&self, xd: f64, yd: f64) -> Option<(f64, f64)> {
        let radius = xd.hypot(yd);
        let wanted = yd.atan2(xd);
        // Tangential terms change directions only slightly, so correct the ray's direction by the error of its image.
        let mut direction = wanted;
        for _ in 0..MOST_STEPS {
            let [u, v] = self.fold_towards(direction)?;
            let off = (v * wanted.cos() - u * wanted.sin()).atan2(u * wanted.cos() + v * wanted.sin());
            if off.abs() < 1e-14 {
                return Some((radius - u.hypot(v), TOLERANCE * radius.max(1.0)));
            }
            direction -= off;
        }
        Some((0.0, f64::INFINITY))
    }

    /// The image of the first point in a direction where the model folds.
    fn fold_towards(&self, direction: f64) -> Option<[f64; 2]> {
        let (sin, cos) = direction.sin_cos();
        let at = |r: f64| [r * cos, r * sin];
        let first = (1..=(FARTHEST / STEP) as u32).find(|k| !self.is_one_to_one(at(f64::from(*k) * STEP)))?;
        let (mut low, mut high) = (f64::from(first - 1) * STEP, f64::from(first) * STEP);
        for _ in 0..60 {
            let middle = 0.5 * (low + high);
            if self.is_one_to_one(at(middle)) { low = middle } else { high = middle }
        }
        Some(self.image(at(low)))
    }

    /// x R + 2 x (p . x) + s p + s q1 + s^2 q2, with R the radial stretch at s = |x|^2 and q the prism terms.
    fn image(&self, [x, y]: [f64; 2]) -> [f64; 2] {
        let ([px, py], s) = (self.tangential, x * x + y * y);
        let stretch = evaluate(&self.numerator, s).0 / evaluate(&self.denominator, s).0 + 2.0 * (px * x + py * y);
        let [[ax, ay], [bx, by]] = self.prism;
        [x * stretch + s * (px + ax + s * bx), y * stretch + s * (py + ay + s * by)]
    }

    /// Returns true if the symmetric part of the Jacobian is positive definite.
    fn is_one_to_one(&self, [x, y]: [f64; 2]) -> bool {
        let ([px, py], s) = (self.tangential, x * x + y * y);
        let ((n, dn), (d, dd)) = (evaluate(&self.numerator, s), evaluate(&self.denominator, s));
        let slope = 2.0 * (dn * d - n * dd) / (d * d);
        let stretch = n / d + 2.0 * (px * x + py * y);
        let [[ax, ay], [bx, by]] = self.prism;
        let (qx, qy) = (2.0 * ax + 4.0 * s * bx, 2.0 * ay + 4.0 * s * by);
        let xx = stretch + slope * x * x + (4.0 * px + qx) * x;
        let yy = stretch + slope * y * y + (4.0 * py + qy) * y;
        let xy = slope * x * y + 2.0 * (px * y + py * x) + 0.5 * (qx * y + qy * x);
        d > 0.0 && xx > 0.0 && xx * yy > xy * xy
    }
}
