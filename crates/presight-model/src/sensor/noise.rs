//! Measurement noise: errors of a sensor's readings, and how often they come from another surface than predicted.

use crate::error::{Error, Result};

/// Measurement noise, as standard deviations. It is used to estimate poses and never added to predictions.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Noise {
    /// Range error, metres.
    pub range_sigma: f64,
    /// Growth of the range error, 1 / metre: the error is `range_sigma + range_sigma_quadratic * range^2`.
    pub range_sigma_quadratic: f64,
    /// Angle error, radians.
    pub angle_sigma: f64,
    /// Pixel error, pixels.
    pub pixel_sigma: f64,
    /// Error of the time stamps, seconds.
    pub stamp_sigma: f64,
    /// Sources of a beam's reading.
    pub mixture: Mixture,
}

/// How often a beam measures the predicted surface, and how often something else. The four shares add up to 1.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Mixture {
    /// The predicted surface.
    pub hit: f64,
    /// An unmodelled surface nearer than the predicted one.
    pub short: f64,
    /// No return is measured.
    pub none: f64,
    /// A random range.
    pub any: f64,
    /// How many beams carry as much information as one independent beam, at least 1. Beams on one wall share its error.
    pub beam_dependence: f64,
}

impl Default for Mixture {
    fn default() -> Self {
        Self { hit: 0.75, short: 0.1, none: 0.05, any: 0.1, beam_dependence: 1.0 }
    }
}

impl Noise {
    /// Checks that all values are valid.
    ///
    /// # Errors
    /// [`crate::ErrorKind::Invalid`], naming the invalid value.
    pub(super) fn check(&self) -> Result<()> {
        let Self { range_sigma, range_sigma_quadratic, angle_sigma, pixel_sigma, stamp_sigma, mixture } = *self;
        let sigmas = [range_sigma, range_sigma_quadratic, angle_sigma, pixel_sigma, stamp_sigma];
        if !sigmas.iter().all(|s| *s >= 0.0 && s.is_finite()) {
            return Err(Error::invalid(format!("noise {sigmas:?}"), "give finite sigmas of at least 0"));
        }
        let Mixture { hit, short, none, any, beam_dependence } = mixture;
        // Above 0, so that no reading is impossible.
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
