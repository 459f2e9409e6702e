//! Numbers with a hundred digits, and vectors of them, for computing the truth.

use dashu_float::FBig;
use dashu_float::round::mode::HalfEven;
use glam::{DQuat, DVec3};
use std::cmp::Ordering;
use std::ops::{Add, Div, Mul, Neg, Sub};

/// Precision in bits: 105 decimal digits.
const BITS: usize = 350;

/// A number with a hundred digits, which represents every f64 exactly.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Big(FBig<HalfEven, 2>);

impl Big {
    /// The exact value of a finite number. Other numbers are bugs in the study, and become 0 in release builds.
    pub fn new(x: f64) -> Self {
        debug_assert!(x.is_finite(), "{x}");
        // Raise the precision from the 53 bits of an f64, because results inherit the precision of their operands.
        Self(FBig::try_from(x).unwrap_or(FBig::ZERO).with_precision(BITS).value())
    }

    /// The nearest f64.
    pub fn to_f64(&self) -> f64 {
        self.0.to_f64().value()
    }

    /// The square root of a number of at least 0.
    pub fn sqrt(&self) -> Self {
        if self.is_zero() { self.clone() } else { Self(self.0.sqrt()) }
    }

    /// Sine and cosine of an angle in degrees.
    pub fn sin_cos_deg(&self) -> (Self, Self) {
        let (sin, cos) = self.0.sin_cos_unit(360);
        (Self(sin), Self(cos))
    }

    /// Sine and cosine of an angle in radians.
    pub fn sin_cos(&self) -> (Self, Self) {
        let (sin, cos) = self.0.sin_cos();
        (Self(sin), Self(cos))
    }

    /// The angle of the direction (x, self), radians.
    pub fn atan2(&self, x: &Self) -> Self {
        Self(self.0.atan2(&x.0))
    }

    pub fn is_zero(&self) -> bool {
        *self == Self::new(0.0)
    }

    pub fn is_negative(&self) -> bool {
        *self < Self::new(0.0)
    }

    pub fn abs(&self) -> Self {
        if self.is_negative() { -self } else { self.clone() }
    }
}

impl PartialOrd for Big {
    fn partial_cmp(&self, other: &Self) -> Option<Ordering> {
        self.0.partial_cmp(&other.0)
    }
}

impl Neg for &Big {
    type Output = Big;

    fn neg(self) -> Big {
        Big(-self.0.clone())
    }
}

macro_rules! operator {
    ($($operator:ident $name:ident),*) => {$(
        impl $operator<&Big> for &Big {
            type Output = Big;

            fn $name(self, other: &Big) -> Big {
                Big((&self.0).$name(&other.0))
            }
        }
    )*};
}

operator!(Add add, Sub sub, Mul mul, Div div);

/// A vector.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Vector(pub [Big; 3]);

impl Vector {
    pub fn new(v: DVec3) -> Self {
        Self(v.to_array().map(Big::new))
    }

    #[cfg(test)]
    pub fn to_f64(&self) -> DVec3 {
        DVec3::from_array([0, 1, 2].map(|i| self.0[i].to_f64()))
    }

    pub fn dot(&self, other: &Self) -> Big {
        let [x, y, z] = [0, 1, 2].map(|i| &self.0[i] * &other.0[i]);
        &(&x + &y) + &z
    }

    pub fn cross(&self, other: &Self) -> Self {
        let (a, b) = (&self.0, &other.0);
        let minor = |i: usize, j: usize| &(&a[i] * &b[j]) - &(&a[j] * &b[i]);
        Self([minor(1, 2), minor(2, 0), minor(0, 1)])
    }

    pub fn scaled(&self, by: &Big) -> Self {
        Self([0, 1, 2].map(|i| &self.0[i] * by))
    }

    pub fn length(&self) -> Big {
        self.dot(self).sqrt()
    }

    /// The vector scaled to unit length; a zero vector is returned unchanged.
    pub fn normalized(&self) -> Self {
        let length = self.length();
        if length.is_zero() { self.clone() } else { Self([0, 1, 2].map(|i| &self.0[i] / &length)) }
    }

    /// Rotated by a quaternion, which is normalized exactly.
    pub fn turned(&self, by: DQuat) -> Self {
        let q = Self::new(DVec3::new(by.x, by.y, by.z));
        let w = Big::new(by.w);
        let square = &q.dot(&q) + &(&w * &w);
        let across = q.cross(self);
        let twice = &across.scaled(&w) + &q.cross(&across);
        self + &twice.scaled(&(&Big::new(2.0) / &square))
    }
}

impl Add<&Vector> for &Vector {
    type Output = Vector;

    fn add(self, other: &Vector) -> Vector {
        Vector([0, 1, 2].map(|i| &self.0[i] + &other.0[i]))
    }
}

impl Sub<&Vector> for &Vector {
    type Output = Vector;

    fn sub(self, other: &Vector) -> Vector {
        Vector([0, 1, 2].map(|i| &self.0[i] - &other.0[i]))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::str::FromStr;

    /// Parses a decimal number.
    fn known(digits: &str) -> Big {
        let decimal = dashu_float::DBig::from_str(digits).unwrap();
        Big(decimal.with_base_and_precision::<2>(BITS + 20).value().with_rounding().with_precision(BITS).value())
    }

    fn near(a: &Big, digits: &str) {
        let off = (a - &known(digits)).abs().to_f64();
        assert!(off < 1e-100, "{digits}: off by {off:e}");
    }

    /// Digits by mpmath 1.3 (`mp.dps = 120`).
    #[test]
    fn trigonometry_has_a_hundred_digits() {
        let (sin, cos) = Big::new(1.0).sin_cos();
        near(&sin, SIN_1);
        near(&cos, COS_1);
        let (sin, cos) = Big::new(-1e6).sin_cos();
        near(&sin, SIN_MINUS_1E6);
        near(&cos, COS_MINUS_1E6);
        near(&(&sin / &cos), TAN_MINUS_1E6);
        near(&Big::new(1.0).atan2(&Big::new(3.0)), ATAN_THIRD);
        let (sin, cos) = Big::new(37.5).sin_cos_deg();
        near(&sin, SIN_37_5_DEG);
        near(&cos, COS_37_5_DEG);
        near(&Big::new(2.0).sqrt(), SQRT_2);
    }

    #[test]
    fn quarter_turns_are_exact_and_f64_comes_back() {
        let (sin, cos) = Big::new(-270.0).sin_cos_deg();
        assert_eq!((sin.to_f64(), cos.to_f64()), (1.0, 0.0));
        assert!(cos.is_zero());
        for x in [0.1, -3e300, 5e-324, 1.0 / 3.0] {
            assert_eq!(Big::new(x).to_f64(), x);
        }
        // A sum that f64 would round away.
        let kept = &(&Big::new(1e60) + &Big::new(1.0)) - &Big::new(1e60);
        assert_eq!(kept.to_f64(), 1.0);
    }

    #[test]
    fn vectors_turn_as_glam_turns_them() {
        let q = DQuat::from_euler(glam::EulerRot::ZYX, 0.3, -1.1, 2.0);
        let v = DVec3::new(1.0, -2.0, 0.5);
        assert!(Vector::new(v).turned(q).to_f64().distance(q * v) < 1e-15);
        // A rotation preserves lengths even if the quaternion is not a unit quaternion.
        let off = &Vector::new(v).turned(q * 3.0).length() - &Vector::new(v).length();
        assert!(off.abs().to_f64() < 1e-100);
        let (a, b) = (Vector::new(DVec3::X), Vector::new(DVec3::Y));
        assert_eq!(a.cross(&b).to_f64(), DVec3::Z);
    }

    const SIN_1: &str = concat!(
        "0.84147098480789650665250232163029899962256306079837",
        "106567275170999191040439123966894863974354305269585434903791"
    );
    const COS_1: &str = concat!(
        "0.54030230586813971740093660744297660373231042061792",
        "222767009725538110039477447176451795185608718308934357173116"
    );
    const SIN_MINUS_1E6: &str = concat!(
        "0.34999350217129295211765248678077146906140660532871",
        "627385705905464464122639545050506566689766889400811273316906"
    );
    const COS_MINUS_1E6: &str = concat!(
        "0.93675212753314478693853253507491877570809780421236",
        "587972057834111681042133160098200703394087652808410912273006"
    );
    const TAN_MINUS_1E6: &str = concat!(
        "0.37362445398759902917349708857538141978530379801059",
        "302641978134928241630973083185036468400297912242943117420474"
    );
    const ATAN_THIRD: &str = concat!(
        "0.32175055439664219340140461435866131902075529555765",
        "619143280305935675623740581054435640842235064137443900716938"
    );
    const SIN_37_5_DEG: &str = concat!(
        "0.60876142900872063941609754289816400451639371196247",
        "523002497396790137603444499283952625164811099385020895439127"
    );
    const COS_37_5_DEG: &str = concat!(
        "0.79335334029123516457977696150129927662867592105191",
        "023422448078294540218227127872910059956585805247319221357878"
    );
    const SQRT_2: &str = concat!(
        "1.41421356237309504880168872420969807856967187537694",
        "80731766797379907324784621070388503875343276415727350138462"
    );
}
