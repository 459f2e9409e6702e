//! Lens models with a hundred digits: projection, its inverse from an approximate ray, and the fold. With tangential
//! terms the fold comes from [`super::fold`], with fewer digits.

use super::big::{Big, Vector};
use super::fold::{FARTHEST, Outline, STEP};
use super::truth::Truth;
use glam::DVec3;
use presight_model::sensor::Distortion;

/// The published tolerance of a ray: [`Distortion::distort`] reproduces the image coordinates to this, relative to the
/// image radius (1 if that is less).
pub(super) const TOLERANCE: f64 = 1e-12;

/// The axes of the upright image, x, y and z, in the axes of a sensor that is tilted by Ry(tauY) Rx(tauX).
fn axes_of_sensor([(sx, cx), (sy, cy)]: &[(Big, Big); 2]) -> [Vector; 3] {
    let zero = Big::new(0.0);
    [
        Vector([cy.clone(), zero, sy.clone()]),
        Vector([sy * sx, cx.clone(), -&(cy * sx)]),
        Vector([-&(sy * cx), sx.clone(), cy * cx]),
    ]
}

/// A lens model, exact.
#[derive(Clone, Debug)]
pub(super) struct Exact {
    fisheye: bool,
    /// 1, k1, k2, ... and 1, k4, k5, ... in powers of the squared radius (angle).
    numerator: Vec<Big>,
    denominator: Vec<Big>,
    /// (p2, p1).
    tangential: [Big; 2],
    /// (s1, s3) and (s2, s4).
    prism: [[Big; 2]; 2],
    /// Sine and cosine of tauX and of tauY.
    tilt: Option<[(Big, Big); 2]>,
    /// Image radius of the fold, the limit of the image; `None` without a fold or with tangential terms.
    pub fold: Option<Big>,
    /// The fold of a model with tangential terms.
    outline: Option<Outline>,
}

fn evaluate(polynomial: &[Big], x: &Big) -> Big {
    polynomial.iter().rev().fold(Big::new(0.0), |sum, c| &(&sum * x) + c)
}

fn derivative(polynomial: &[Big]) -> Vec<Big> {
    polynomial.iter().enumerate().skip(1).map(|(i, c)| c * &Big::new(i as f64)).collect()
}

impl Exact {
    pub fn new(model: &Distortion) -> Self {
        let with_one = |k: &[f64]| [1.0].iter().chain(k).map(|c| Big::new(*c)).collect::<Vec<_>>();
        let (mut q, mut tau) = ([[0.0; 2]; 2], [0.0; 2]);
        let (fisheye, n, d, p) = match model {
            Distortion::None => (false, with_one(&[]), with_one(&[]), [0.0; 2]),
            Distortion::PlumbBob([k1, k2, p1, p2, k3]) => {
                (false, with_one(&[*k1, *k2, *k3]), with_one(&[]), [*p2, *p1])
            }
            Distortion::RationalPolynomial([k1, k2, p1, p2, k3, k4, k5, k6, s1, s2, s3, s4, tau_x, tau_y]) => {
                (q, tau) = ([[*s1, *s3], [*s2, *s4]], [*tau_x, *tau_y]);
                (false, with_one(&[*k1, *k2, *k3]), with_one(&[*k4, *k5, *k6]), [*p2, *p1])
            }
            Distortion::Equidistant(k) => (true, with_one(k), with_one(&[]), [0.0; 2]),
        };
        let mut lens = Self {
            fisheye,
            numerator: n,
            denominator: d,
            tangential: p.map(Big::new),
            prism: q.map(|terms| terms.map(Big::new)),
            tilt: (tau != [0.0; 2]).then(|| tau.map(|angle| Big::new(angle).sin_cos())),
            fold: None,
            outline: None,
        };
        if p == [0.0; 2] && q == [[0.0; 2]; 2] {
            lens.fold = lens.first_fold();
        } else {
            let padded = |all: &[Big]| std::array::from_fn(|i| all.get(i).map_or(0.0, Big::to_f64));
            let (numerator, denominator) = (padded(&lens.numerator), padded(&lens.denominator));
            lens.outline = Some(Outline { numerator, denominator, tangential: p, prism: q });
        }
        lens
    }

    /// The radial stretch at a squared radius, and its derivative with respect to the squared radius.
    fn radial(&self, s: &Big) -> (Big, Big) {
        let (n, d) = (evaluate(&self.numerator, s), evaluate(&self.denominator, s));
        let (dn, dd) = (evaluate(&derivative(&self.numerator), s), evaluate(&derivative(&self.denominator), s));
        (&n / &d, &(&(&dn * &d) - &(&n * &dd)) / &(&d * &d))
    }

    /// Derivative of the image radius with respect to the radius.
    fn rising(&self, r: &Big) -> Big {
        let s = r * r;
        let (stretch, slope) = self.radial(&s);
        &stretch + &(&(&slope * &s) * &Big::new(2.0))
    }

    /// The image radius at the first radius where the radial model turns back.
    fn first_fold(&self) -> Option<Big> {
        let end = if self.fisheye { std::f64::consts::PI } else { FARTHEST };
        let steps = (end / STEP) as u32;
        let bad = |r: &Big| evaluate(&self.denominator, &(r * r)) <= Big::new(0.0) || self.rising(r) <= Big::new(0.0);
        let first = (1..=steps).find(|k| bad(&Big::new(f64::from(*k) * STEP)))?;
        let (mut low, mut high) = (Big::new(f64::from(first - 1) * STEP), Big::new(f64::from(first) * STEP));
        for _ in 0..200 {
            let middle = &(&low + &high) * &Big::new(0.5);
            if bad(&middle) { high = middle } else { low = middle }
        }
        Some(&low * &self.radial(&(&low * &low)).0)
    }

    /// Image coordinates of a ray in the optical frame.
    pub fn forward(&self, ray: &Vector) -> [Big; 2] {
        let [x, y, z] = &ray.0;
        if self.fisheye {
            let across = (&(x * x) + &(y * y)).sqrt();
            if across.is_zero() {
                return [Big::new(0.0), Big::new(0.0)];
            }
            let theta = across.atan2(z);
            let radius = &theta * &evaluate(&self.numerator, &(&theta * &theta));
            return [x, y].map(|c| &(&radius * c) / &across);
        }
        let [x, y] = self.image(&[x / z, y / z]);
        let Some(tilt) = &self.tilt else { return [x, y] };
        let [a, b, axis] = axes_of_sensor(tilt);
        let turned = &(&a.scaled(&x) + &b.scaled(&y)) + &axis;
        let onto = |k: usize| &(&(&axis.0[2] * &turned.0[k]) / &turned.0[2]) - &axis.0[k];
        [onto(0), onto(1)]
    }

    /// The coordinates that an upright image sensor would have.
    fn upright(&self, xd: &Big, yd: &Big) -> [Big; 2] {
        let Some(tilt) = &self.tilt else { return [xd.clone(), yd.clone()] };
        let axes = axes_of_sensor(tilt);
        let on_sensor = &Vector([xd.clone(), yd.clone(), Big::new(0.0)]) + &axes[2];
        let [x, y, z] = axes.map(|axis| axis.dot(&on_sensor));
        [&x / &z, &y / &z]
    }

    fn image(&self, [x, y]: &[Big; 2]) -> [Big; 2] {
        let s = &(x * x) + &(y * y);
        let [px, py] = &self.tangential;
        let along = &(&(px * x) + &(py * y)) * &Big::new(2.0);
        let stretch = &self.radial(&s).0 + &along;
        let [first, second] = &self.prism;
        let across = |k: usize, p: &Big| &s * &(&(p + &first[k]) + &(&s * &second[k]));
        [&(&stretch * x) + &across(0, px), &(&stretch * y) + &across(1, py)]
    }

    /// Distance of an image point beyond the fold, negative before it, and its accuracy; `None` if the lens does not
    /// fold.
    pub fn beyond_fold(&self, xd: &Big, yd: &Big) -> Option<(f64, f64)> {
        let [xd, yd] = &self.upright(xd, yd);
        if let Some(outline) = &self.outline {
            return outline.beyond(xd.to_f64(), yd.to_f64());
        }
        let radius = (&(xd * xd) + &(yd * yd)).sqrt();
        self.fold.as_ref().map(|fold| ((&radius - fold).to_f64(), TOLERANCE * radius.to_f64().max(1.0)))
    }

    /// The ray that is imaged at (xd, yd), by iteration from the product's f64 ray `near`. It exists up to the fold.
    ///
    /// # Errors
    /// [`Truth::NoRay`] beyond the fold, [`Truth::Either`] within its accuracy.
    pub fn inverse(&self, xd: &Big, yd: &Big, near: Option<DVec3>) -> Result<Vector, Truth> {
        match self.beyond_fold(xd, yd) {
            Some((beyond, tolerance)) if beyond.abs() <= tolerance => return Err(Truth::Either),
            Some((beyond, _)) if beyond > 0.0 => return Err(Truth::NoRay),
            _ => {}
        }
        // If the product has no ray, start on the axis; the pixel will be judged as lacking its ray.
        let near = near.unwrap_or(DVec3::Z);
        if self.fisheye {
            let radius = (&(xd * xd) + &(yd * yd)).sqrt();
            return Ok(self.inverse_fisheye(xd, yd, &radius, near));
        }
        let [xd, yd] = &self.upright(xd, yd);
        let mut found = self.inverse_from([near.x / near.z, near.y / near.z].map(Big::new), [xd, yd]);
        let ([xx, xy, yx, yy], zero) = (self.jacobian(&found), Big::new(0.0));
        let shear = &(&xy + &yx) * &Big::new(0.5);
        // A ray beyond the fold is another preimage of the same point, and not valid.
        if !(xx > zero && &xx * &yy > &shear * &shear) {
            found = self.inverse_from([zero.clone(), zero], [xd, yd]);
        }
        let [x, y] = found;
        Ok(Vector([x, y, Big::new(1.0)]))
    }

    /// Newton's method.
    fn inverse_from(&self, mut x: [Big; 2], target: [&Big; 2]) -> [Big; 2] {
        for _ in 0..60 {
            let image = self.image(&x);
            let miss = [&image[0] - target[0], &image[1] - target[1]];
            let step = self.newton_step(&x, &miss);
            x = [&x[0] - &step[0], &x[1] - &step[1]];
            if step.iter().all(|s| s.abs().to_f64() < 1e-80) {
                break;
            }
        }
        x
    }

    /// The Jacobian J (see `sensor::undistort`), row by row: xx, xy, yx, yy.
    fn jacobian(&self, [x, y]: &[Big; 2]) -> [Big; 4] {
        let two = Big::new(2.0);
        let s = &(x * x) + &(y * y);
        let (stretch, slope) = self.radial(&s);
        let [px, py] = &self.tangential;
        let diagonal = &stretch + &(&(&(px * x) + &(py * y)) * &two);
        let cross = &(&(&(&(&slope * x) * y) + &(px * y)) + &(py * x)) * &two;
        let own = |c: &Big, p: &Big| &(&diagonal + &(&(&(&slope * c) * c) * &two)) + &(&(p * c) * &Big::new(4.0));
        let [qx, qy] = [0, 1].map(|k| &(&self.prism[0][k] + &(&(&s * &two) * &self.prism[1][k])) * &two);
        [&own(x, px) + &(&qx * x), &cross + &(&qx * y), &cross + &(&qy * x), &own(y, py) + &(&qy * y)]
    }

    /// J^-1 miss.
    fn newton_step(&self, x: &[Big; 2], miss: &[Big; 2]) -> [Big; 2] {
        let [xx, xy, yx, yy] = self.jacobian(x);
        let determinant = &(&xx * &yy) - &(&xy * &yx);
        if determinant.is_zero() {
            return [Big::new(0.0), Big::new(0.0)];
        }
        [
            &(&(&yy * &miss[0]) - &(&xy * &miss[1])) / &determinant,
            &(&(&xx * &miss[1]) - &(&yx * &miss[0])) / &determinant,
        ]
    }

    fn inverse_fisheye(&self, xd: &Big, yd: &Big, radius: &Big, near: DVec3) -> Vector {
        if radius.is_zero() {
            return Vector::new(DVec3::Z);
        }
        let mut theta = Big::new(near.x.hypot(near.y).atan2(near.z));
        for _ in 0..60 {
            let image = &theta * &evaluate(&self.numerator, &(&theta * &theta));
            let slope = self.rising(&theta);
            let step = if slope.is_zero() { Big::new(0.0) } else { &(&image - radius) / &slope };
            theta = &theta - &step;
            if step.abs().to_f64() < 1e-80 {
                break;
            }
        }
        let (sin, cos) = theta.sin_cos();
        Vector([&(&sin * xd) / radius, &(&sin * yd) / radius, cos])
    }
}
