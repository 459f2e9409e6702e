//! The inverse of the lens models, in the region where it exists.
//!
//! The polynomials of lens models are fitted inside the image and turn back outside it. Beyond that fold, several rays
//! share one image point. The model is used in the connected region around the axis where it is one to one:
//! - Without tangential terms this is a disc. It ends where the derivative of the image radius or the denominator first
//!   falls to zero (roots of polynomials, see [`super::polynomial`]). The inverse is a root in one unknown.
//! - With tangential terms p and thin prism terms the Jacobian is J = R I + 2 R' x x^T + 2 p x^T + 2 x p^T + 2 (p . x)
//!   I + 2 q x^T with q = (s1, s3) + 2 r^2 (s2, s4). The model is one to one on every convex region where the symmetric
//!   part S of J is positive definite. S is the identity at the axis, and positive definite until det S falls to zero
//!   away from it. With u the unit vector towards x, a = p . u and b = p x u: det S = (g' + 6 a r + 2 (q . u) r) (R + 2
//!   a r) - (2 b + q x u)^2 r^2, g' the radial derivative. Without prism terms S is J, because the model is then a
//!   gradient.
//! - The plane of a tilted image sensor is a perspective image of these coordinates ([`tilt`]): one to one without
//!   further conditions.

#[cfg(test)]
mod tests;
mod tilt;

use super::distortion::Distortion;
use super::polynomial::{derivative, evaluate, product, sign_changes};
use glam::{DMat2, DVec2, DVec3};
use tilt::Tilt;

/// Radii beyond this (within a microradian of 90 degrees from the axis) are imaged only by fisheyes.
const RADIUS_LIMIT: f64 = 1e6;

/// Maximum distance of a solution's image from its image point, relative to the point's radius (1 if that is less).
const RESIDUAL: f64 = 1e-13;

/// A lens model with precomputed data for its inverse, made once for all pixels by [`Distortion::lens`].
#[derive(Clone, Debug)]
pub struct Lens(Kind);

#[derive(Clone, Debug)]
#[expect(clippy::large_enum_variant, reason = "a sensor has one; a box would cost every projection")]
enum Kind {
    Pinhole,
    Brown(Brown, Option<Tilt>),
    Fisheye(Fisheye),
}

impl Distortion {
    /// The model with the region in which it is one to one. Use this for many points.
    #[doc(hidden)]
    pub fn lens(&self) -> Lens {
        Lens::new(self)
    }

    /// The ray that is imaged at distorted normalized coordinates. It is not normalized, and z may be 0 or negative for
    /// fisheyes. Returns `None` beyond the fold: outside the image of the region around the axis in which the model is
    /// one to one. [`Distortion::distort`] maps the ray back to these coordinates to 1e-12.
    ///
    /// Finding that region takes longer than inverting a point. For many points use [`Distortion::lens`].
    ///
    /// ```
    /// use presight::sensor::Distortion;
    /// let barrel = Distortion::PlumbBob([-0.3, 0.0, 0.0, 0.0, 0.0]);
    /// let ray = barrel.undistort(0.4, -0.2).unwrap();
    /// let (xd, yd) = barrel.distort(ray).unwrap();
    /// assert!((xd - 0.4).abs() < 1e-12 && (yd + 0.2).abs() < 1e-12);
    /// // r (1 - 0.3 r^2) never exceeds 0.703, so the image ends there.
    /// assert!(barrel.undistort(0.71, 0.0).is_none());
    /// ```
    pub fn undistort(&self, xd: f64, yd: f64) -> Option<DVec3> {
        self.lens().undistort(xd, yd)
    }

    /// Distorted normalized coordinates of a point of the optical frame (any length): pixel = (fx xd + cx, fy yd + cy).
    /// Returns `None` for points that the model does not image: points behind a lens that is not a fisheye, and points
    /// outside the region around the axis in which the model is one to one.
    pub fn distort(&self, p_in_optical: DVec3) -> Option<(f64, f64)> {
        self.lens().distort(p_in_optical)
    }
}

impl Lens {
    fn new(model: &Distortion) -> Self {
        Self(match *model {
            Distortion::None => Kind::Pinhole,
            Distortion::PlumbBob([k1, k2, p1, p2, k3]) => {
                Kind::Brown(Brown::new([k1, k2, k3], [0.0; 3], [p1, p2], [0.0; 4]), None)
            }
            Distortion::RationalPolynomial([k1, k2, p1, p2, k3, k4, k5, k6, s1, s2, s3, s4, tau_x, tau_y]) => {
                let tilt = (tau_x != 0.0 || tau_y != 0.0).then(|| Tilt::new(tau_x, tau_y));
                Kind::Brown(Brown::new([k1, k2, k3], [k4, k5, k6], [p1, p2], [s1, s2, s3, s4]), tilt)
            }
            Distortion::Equidistant(k) => Kind::Fisheye(Fisheye::new(k)),
        })
    }

    /// See [`Distortion::undistort`].
    pub fn undistort(&self, xd: f64, yd: f64) -> Option<DVec3> {
        if !(xd.is_finite() && yd.is_finite()) {
            return None;
        }
        match &self.0 {
            Kind::Pinhole => Some(DVec3::new(xd, yd, 1.0)),
            Kind::Brown(brown, tilt) => {
                let image = DVec2::new(xd, yd);
                let upright = tilt.as_ref().map_or(Some(image), |tilt| tilt.upright(image))?;
                brown.undistort(upright).map(|p| p.extend(1.0))
            }
            Kind::Fisheye(fisheye) => fisheye.undistort(xd, yd),
        }
    }

    /// See [`Distortion::distort`].
    pub fn distort(&self, p_in_optical: DVec3) -> Option<(f64, f64)> {
        let p = p_in_optical;
        if let Kind::Fisheye(fisheye) = &self.0 {
            return fisheye.distort(p);
        }
        let x = (p.is_finite() && p.z > 0.0).then(|| DVec2::new(p.x / p.z, p.y / p.z))?;
        match &self.0 {
            Kind::Brown(brown, tilt) => {
                let upright = brown.contains(x).then(|| brown.forward(x))?;
                tilt.as_ref().map_or(Some(upright), |tilt| tilt.tilted(upright)).map(DVec2::into)
            }
            _ => Some(x.into()),
        }
    }
}

/// `plumb_bob` and `rational_polynomial`.
#[derive(Clone, Debug)]
struct Brown {
    /// 1, k1, k2, k3.
    numerator: [f64; 4],
    /// 1, k4, k5, k6.
    denominator: [f64; 4],
    /// (p2, p1).
    tangential: DVec2,
    /// (s1, s3) and (s2, s4).
    prism: [DVec2; 2],
    /// Radius at which the radial part alone turns back.
    radial_fold: f64,
    /// Radius at which the denominator falls to zero.
    pole: f64,
    /// Radius up to which the model is one to one in every direction.
    safe: f64,
    /// Upper bound of the image radius; infinite if there is none.
    reach: f64,
}

/// The radial part at one radius.
struct Radial {
    /// R(r^2), the stretch.
    stretch: f64,
    /// Derivative of R with respect to r^2.
    slope: f64,
}

impl Brown {
    fn new(numerator: [f64; 3], denominator: [f64; 3], [p1, p2]: [f64; 2], [s1, s2, s3, s4]: [f64; 4]) -> Self {
        let with_one = |[a, b, c]: [f64; 3]| [1.0, a, b, c];
        let (n, d) = (with_one(numerator), with_one(denominator));
        let first = |a: &[f64]| {
            let upper = RADIUS_LIMIT * RADIUS_LIMIT;
            sign_changes(a, upper).first().copied().unwrap_or(upper).sqrt()
        };
        // With s = r^2 the derivative of r N(s) / D(s) has the sign of (N + 2 s N') D - 2 s N D'.
        let twice_s = [0.0, 2.0];
        let rising = add(&n, &product(&twice_s, &derivative(&n)));
        let falling = product(&product(&twice_s, &n), &derivative(&d));
        let turn = add(&product(&rising, &d), &falling.iter().map(|c| -c).collect::<Vec<_>>());
        let pole = first(&d);
        let mut brown = Self {
            numerator: n,
            denominator: d,
            tangential: DVec2::new(p2, p1),
            prism: [DVec2::new(s1, s3), DVec2::new(s2, s4)],
            radial_fold: first(&turn).min(pole),
            pole,
            safe: 0.0,
            reach: f64::INFINITY,
        };
        brown.safe = brown.safe_radius();
        if !brown.is_round() {
            brown.reach = brown.image_reach();
        }
        brown
    }

    /// True if the model is the same in every direction.
    fn is_round(&self) -> bool {
        self.tangential == DVec2::ZERO && self.prism == [DVec2::ZERO; 2]
    }

    /// Half the derivative of the thin prism terms along a direction, divided by the radius.
    fn bend(&self, s: f64) -> DVec2 {
        self.prism[0] + 2.0 * s * self.prism[1]
    }

    fn radial(&self, s: f64) -> Radial {
        let [_, n1, n2, n3] = self.numerator;
        let [_, d1, d2, d3] = self.denominator;
        let (n, d) = (evaluate(&self.numerator, s), evaluate(&self.denominator, s));
        let (dn, dd) = (n1 + s * (2.0 * n2 + 3.0 * s * n3), d1 + s * (2.0 * d2 + 3.0 * s * d3));
        Radial { stretch: n / d, slope: (dn * d - n * dd) / (d * d) }
    }

    fn forward(&self, x: DVec2) -> DVec2 {
        let s = x.length_squared();
        let across = self.tangential + self.prism[0] + s * self.prism[1];
        x * (self.radial(s).stretch + 2.0 * self.tangential.dot(x)) + s * across
    }

    fn jacobian(&self, x: DVec2) -> DMat2 {
        let Radial { stretch, slope } = self.radial(x.length_squared());
        let p = self.tangential;
        let diagonal = stretch + 2.0 * p.dot(x);
        let cross = 2.0 * (slope * x.x * x.y + p.x * x.y + p.y * x.x);
        let xx = diagonal + 2.0 * slope * x.x * x.x + 4.0 * p.x * x.x;
        let yy = diagonal + 2.0 * slope * x.y * x.y + 4.0 * p.y * x.y;
        let bend = 2.0 * self.bend(x.length_squared());
        DMat2::from_cols(DVec2::new(xx, cross) + bend * x.x, DVec2::new(cross, yy) + bend * x.y)
    }

    /// True if S is positive definite at radius r, where p and q have these components along the direction and across
    /// it.
    fn definite(&self, r: f64, [p_along, p_across]: [f64; 2], [q_along, q_across]: [f64; 2]) -> bool {
        let Radial { stretch, slope } = self.radial(r * r);
        let along = stretch + 2.0 * slope * r * r + 6.0 * p_along * r + 2.0 * q_along * r;
        let across = stretch + 2.0 * p_along * r;
        let shear = (2.0 * p_across + q_across) * r;
        along > 0.0 && across > 0.0 && along * across > shear * shear
    }

    /// The radius up to which S is positive definite for any direction of the tangential and prism terms.
    fn safe_radius(&self) -> f64 {
        if self.is_round() {
            return self.radial_fold;
        }
        let p = self.tangential.length();
        let [q, q_slope] = self.prism.map(DVec2::length);
        // Conservative: no component exceeds the length, but not all can reach it.
        let definite = |r: f64| {
            let q = q + 2.0 * r * r * q_slope;
            self.definite(r, [-p, p], [-q, q])
        };
        let mut good = 0.0;
        let mut bad = 1e-3;
        while bad < self.radial_fold && definite(bad) {
            (good, bad) = (bad, bad * 1.002);
        }
        bad = bad.min(self.radial_fold);
        for _ in 0..60 {
            let middle = 0.5 * (good + bad);
            if definite(middle) { good = middle } else { bad = middle }
        }
        good
    }

    /// True in the region around the axis where the model is one to one.
    fn contains(&self, x: DVec2) -> bool {
        let radius = x.length();
        radius <= self.safe || !self.is_round() && radius < self.pole && self.fold(x / radius, radius).is_none()
    }

    /// The first radius along `towards`, beyond the safe one and up to `end`, at which S is not positive definite.
    fn fold(&self, towards: DVec2, end: f64) -> Option<f64> {
        let parts = |v: DVec2| [v.dot(towards), v.perp_dot(towards)];
        let p = parts(self.tangential);
        let mut r = self.safe;
        while r < end {
            // Not `clamp`, which panics if `end` is below the first step.
            r = (r * 1.002).max(1e-6).min(end);
            if !self.definite(r, p, parts(self.bend(r * r))) {
                return Some(r);
            }
        }
        None
    }

    /// The largest image radius on the boundary of the region. Its outline is smooth, so sampled directions suffice.
    fn image_reach(&self) -> f64 {
        let mut reach: f64 = 0.0;
        for k in 0..90 {
            let towards = DVec2::from_angle(f64::from(4 * k).to_radians());
            match self.fold(towards, self.pole) {
                Some(r) => reach = reach.max(self.forward(towards * r).length()),
                None => return f64::INFINITY,
            }
        }
        reach * 1.01
    }

    fn undistort(&self, xd: DVec2) -> Option<DVec2> {
        let radius = xd.length();
        if radius == 0.0 {
            return Some(DVec2::ZERO);
        }
        if radius > self.reach {
            return None;
        }
        let image_radius = |r: f64| {
            let Radial { stretch, slope } = self.radial(r * r);
            (r * stretch, stretch + 2.0 * slope * r * r)
        };
        let radial = solve_rising(image_radius, radius, self.radial_fold);
        if self.is_round() {
            return radial.map(|r| xd * (r / radius));
        }
        // The radial solution is usually close. If Newton fails from there, follow the path from the axis.
        let near = radial.map(|r| xd * (r / radius)).and_then(|start| self.newton(start, xd));
        near.filter(|x| self.contains(*x)).or_else(|| self.follow(xd)).filter(|x| self.contains(*x))
    }

    /// Newton's method, kept where det J is positive. Returns `None` if it does not converge.
    fn newton(&self, start: DVec2, target: DVec2) -> Option<DVec2> {
        let tolerance = RESIDUAL * target.length().max(1.0);
        let mut x = start;
        let mut miss = self.forward(x) - target;
        for _ in 0..40 {
            let j = self.jacobian(x);
            if !(j.determinant() > 0.0) {
                return None;
            }
            let step = j.inverse() * miss;
            let mut scale = 1.0;
            let (next, next_miss) = loop {
                let next = x - step * scale;
                let next_miss = self.forward(next) - target;
                let inside = next.length() < self.pole && self.jacobian(next).determinant() > 0.0;
                if inside && next_miss.length_squared() < miss.length_squared() {
                    break (next, next_miss);
                }
                scale *= 0.5;
                if scale < 1e-9 {
                    // No further progress in floating point.
                    return (miss.length() <= tolerance).then_some(x);
                }
            };
            (x, miss) = (next, next_miss);
            if miss == DVec2::ZERO {
                break;
            }
        }
        (miss.length() <= tolerance).then_some(x)
    }

    /// Moves the image point outwards from the axis and tracks the solution, which thus stays in the region.
    fn follow(&self, target: DVec2) -> Option<DVec2> {
        let (mut x, mut done, mut stride) = (DVec2::ZERO, 0.0f64, 0.25);
        while done < 1.0 {
            let next = (done + stride).min(1.0);
            match self.newton(x, target * next) {
                Some(found) if self.contains(found) => (x, done, stride) = (found, next, stride * 1.5),
                _ => stride *= 0.5,
            }
            if stride < 1e-7 {
                return None;
            }
        }
        Some(x)
    }
}

/// `equidistant`.
#[derive(Clone, Debug)]
struct Fisheye {
    /// 1, k1, k2, k3, k4 in powers of theta^2.
    stretch: [f64; 5],
    /// 1, 3 k1, 5 k2, 7 k3, 9 k4: the derivative of the image radius.
    slope: [f64; 5],
    /// Angle at which the model turns back, at most 180 degrees.
    fold: f64,
}

impl Fisheye {
    fn new([k1, k2, k3, k4]: [f64; 4]) -> Self {
        use std::f64::consts::PI;
        let slope = [1.0, 3.0 * k1, 5.0 * k2, 7.0 * k3, 9.0 * k4];
        let fold = sign_changes(&slope, PI * PI).first().map_or(PI, |s| s.sqrt());
        Self { stretch: [1.0, k1, k2, k3, k4], slope, fold }
    }

    fn undistort(&self, xd: f64, yd: f64) -> Option<DVec3> {
        let radius = xd.hypot(yd);
        if radius == 0.0 {
            return Some(DVec3::Z);
        }
        let image_radius = |t: f64| (t * evaluate(&self.stretch, t * t), evaluate(&self.slope, t * t));
        let (sin, cos) = solve_rising(image_radius, radius, self.fold)?.sin_cos();
        Some(DVec3::new(sin * (xd / radius), sin * (yd / radius), cos))
    }

    fn distort(&self, p: DVec3) -> Option<(f64, f64)> {
        let across = p.x.hypot(p.y);
        let theta = across.atan2(p.z);
        if !(p.is_finite() && p != DVec3::ZERO && theta <= self.fold) {
            return None;
        }
        if across == 0.0 {
            return (p.z > 0.0).then_some((0.0, 0.0));
        }
        let radius = theta * evaluate(&self.stretch, theta * theta);
        Some((radius * (p.x / across), radius * (p.y / across)))
    }
}

/// Solves f(r) = target for a function that rises from f(0) = 0 to f(end); `f` gives value and derivative.
/// Newton's method inside a bracket that halves whenever Newton does not.
fn solve_rising(f: impl Fn(f64) -> (f64, f64), target: f64, end: f64) -> Option<f64> {
    if !(f(end).0 >= target) {
        return None;
    }
    let (mut low, mut high) = (0.0, end);
    let mut r = target.min(0.5 * end);
    for _ in 0..200 {
        let (value, slope) = f(r);
        if value == target {
            return Some(r);
        }
        if value < target {
            low = r
        } else {
            high = r
        }
        let newton = r - (value - target) / slope;
        let next = if newton > low && newton < high { newton } else { 0.5 * (low + high) };
        if (next - r).abs() <= 0.5 * f64::EPSILON * r || next == low || next == high {
            return Some(next);
        }
        r = next;
    }
    Some(r)
}

fn add(a: &[f64], b: &[f64]) -> Vec<f64> {
    let at = |p: &[f64], i: usize| p.get(i).copied().unwrap_or(0.0);
    (0..a.len().max(b.len())).map(|i| at(a, i) + at(b, i)).collect()
}
