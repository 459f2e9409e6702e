//! Measurement noise: how far off a sensor's readings are, and how often they are of something else.

use crate::error::{Error, Result};

/// Measurement noise, one standard deviation each. It is used when poses are estimated and never added to predictions.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Noise {
    /// Metres.
    pub range_sigma: f64,
    /// Added to `range_sigma` for each square metre of range, 1 / metre: `range_sigma + range_sigma_quadratic * range^2`.
    pub range_sigma_quadratic: f64,
    /// Radians.
    pub angle_sigma: f64,
    /// Pixels.
    pub pixel_sigma: f64,
    /// What else a beam may have met.
    pub mixture: Mixture,
}

/// How often a beam measures the predicted surface, or something else. The four shares add up to 1.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Mixture {
    /// The predicted surface.
    pub hit: f64,
    /// Something nearer that the model does not have.
    pub short: f64,
    /// Nothing is sensed.
    pub none: f64,
    /// Any range at all.
    pub any: f64,
    /// How many beams tell as much as one independent beam, 1 or more: beams on one wall share its error.
    pub beam_dependence: f64,
}

impl Default for Mixture {
    fn default() -> Self {
        Self { hit: 0.75, short: 0.1, none: 0.05, any: 0.1, beam_dependence: 1.0 }
    }
}

impl Noise {
    /// Checks that all numbers are possible.
    ///
    /// # Errors
    /// [`crate::ErrorKind::Invalid`] naming what is not.
    pub(super) fn check(&self) -> Result<()> {
        let Self { range_sigma, range_sigma_quadratic, angle_sigma, pixel_sigma, mixture } = *self;
        let sigmas = [range_sigma, range_sigma_quadratic, angle_sigma, pixel_sigma];
        if !sigmas.iter().all(|s| *s >= 0.0 && s.is_finite()) {
            return Err(Error::invalid(format!("noise {sigmas:?}"), "give finite sigmas of at least 0"));
        }
        let Mixture { hit, short, none, any, beam_dependence } = mixture;
        // Above 0: no reading is impossible then.
        let sound = hit >= 0.0 && short >= 0.0 && none >= 1e-9 && any >= 1e-9;
        let sum = hit + short + none + any;
        if !(sound && (sum - 1.0).abs() <= 1e-9) {
            let what = format!("noise: p_hit {hit}, p_short {short}, p_none {none} and p_any {any} add up to {sum}");
            return Err(Error::invalid(what, "give all four, p_none and p_any above 0, so that they add up to 1"));
        }
        if !(1.0..=1e9).contains(&beam_dependence) {
            let what = format!("noise: beam_dependence of {beam_dependence}");
            return Err(Error::invalid(what, "give 1 for independent beams, or more"));
        }
        Ok(())
    }
}
