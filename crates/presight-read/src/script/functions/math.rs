//! Numbers. `libm` gives the same bits on every machine.

use crate::script::call::{Call, Function};
use crate::script::random::Random;
use presight_model::error::{Error, Result};
use rhai::Dynamic;

/// Returns a number to the script. NaN and infinity are errors here, before they cause others.
fn finite(x: f64) -> Result<Dynamic> {
    if x.is_finite() {
        return Ok(Dynamic::from(x));
    }
    Err(Error::invalid(format!("the result is {x}"), "give a number for which it is defined"))
}

fn of(c: &Call<'_, '_>, f: fn(f64) -> f64) -> Result<Dynamic> {
    finite(f(c.number(0)?))
}

fn of_two(c: &Call<'_, '_>, f: fn(f64, f64) -> f64) -> Result<Dynamic> {
    finite(f(c.number(0)?, c.number(1)?))
}

fn random(c: &Call<'_, '_>) -> Result<Random> {
    let wrong = || Error::invalid("rng is not a generator", "give random numbers made by rng(seed)");
    c.args[0].read_lock::<Random>().map(|r| r.clone()).ok_or_else(wrong)
}

fn to_int(c: &mut Call<'_, '_>) -> Result<Dynamic> {
    let x = c.number(0)?;
    if x.abs() < 9e15 {
        return Ok(Dynamic::from(x.trunc() as i64));
    }
    Err(Error::invalid(format!("x is {x}, too large for a whole number"), "give one below 9e15"))
}

fn uniform(c: &mut Call<'_, '_>) -> Result<Dynamic> {
    let (low, high) = (c.number(1)?, c.number(2)?);
    if low > high {
        return Err(Error::invalid(format!("there is no number from {low} to {high}"), "give the lower one first"));
    }
    // In halves, because the span may overflow; this rounds alike. The sum may round beyond `high`.
    let half = 0.5 * low + (0.5 * high - 0.5 * low) * random(c)?.unit();
    finite((2.0 * half).clamp(low, high))
}

fn integer(c: &mut Call<'_, '_>) -> Result<Dynamic> {
    let (low, high) = (c.arg(1).integer()?, c.arg(2).integer()?);
    if low > high {
        let what = format!("there is no whole number from {low} to {high}");
        return Err(Error::invalid(what, "give the lower one first"));
    }
    let span = (i128::from(high) - i128::from(low) + 1) as u128;
    Ok(Dynamic::from(low.wrapping_add(random(c)?.below(span) as i64)))
}

pub(super) const FUNCTIONS: &[Function] = &[
    Function { signature: "sin(x) -> float", does: "of radians", run: |c| of(c, libm::sin) },
    Function { signature: "cos(x) -> float", does: "of radians", run: |c| of(c, libm::cos) },
    Function { signature: "tan(x) -> float", does: "of radians", run: |c| of(c, libm::tan) },
    Function { signature: "asin(x) -> float", does: "radians", run: |c| of(c, libm::asin) },
    Function { signature: "acos(x) -> float", does: "radians", run: |c| of(c, libm::acos) },
    Function { signature: "atan(x) -> float", does: "radians", run: |c| of(c, libm::atan) },
    Function {
        signature: "atan2(y, x) -> float",
        does: "radians, in the correct quadrant",
        run: |c| of_two(c, libm::atan2),
    },
    Function { signature: "to_radians(deg) -> float", does: "of degrees", run: |c| of(c, f64::to_radians) },
    Function { signature: "to_degrees(x) -> float", does: "of radians", run: |c| of(c, f64::to_degrees) },
    Function { signature: "PI() -> float", does: "half a turn, radians", run: |_| finite(std::f64::consts::PI) },
    Function { signature: "sqrt(x) -> float", does: "square root", run: |c| of(c, f64::sqrt) },
    Function { signature: "hypot(x, y) -> float", does: "length of [x, y]", run: |c| of_two(c, libm::hypot) },
    Function {
        signature: "pow(x, y) -> float",
        does: "x to the power y (there is no **)",
        run: |c| of_two(c, libm::pow),
    },
    Function { signature: "exp(x) -> float", does: "e to the power x", run: |c| of(c, libm::exp) },
    Function { signature: "ln(x) -> float", does: "natural logarithm", run: |c| of(c, libm::log) },
    Function { signature: "floor(x) -> float", does: "rounded down", run: |c| of(c, f64::floor) },
    Function { signature: "ceil(x) -> float", does: "rounded up", run: |c| of(c, f64::ceil) },
    Function { signature: "round(x) -> float", does: "rounded, half away from 0", run: |c| of(c, f64::round) },
    Function { signature: "to_int(x) -> int", does: "without its fraction", run: to_int },
    Function { signature: "to_float(x) -> float", does: "of a whole number", run: |c| of(c, |x| x) },
    Function {
        signature: "rng(seed) -> rng",
        does: "a random number generator; the same seed gives the same numbers; copies share one sequence",
        run: |c| Ok(Dynamic::from(Random::new(c.arg(0).integer()?))),
    },
    Function { signature: "uniform(rng, low, high) -> float", does: "the next number, from low to high", run: uniform },
    Function {
        signature: "integer(rng, low, high) -> int",
        does: "the next whole number, both ends included",
        run: integer,
    },
    Function {
        signature: "chance(rng, share) -> bool",
        does: "true with that probability",
        run: |c| Ok(Dynamic::from(random(c)?.unit() < c.number(1)?)),
    },
];
