//! The probability of existence of objects and features, by Bayes.

/// Prior probability of existence where the model states none: one in a hundred objects or features of a model is
/// missing.
pub(crate) const UNSTATED: f64 = 0.99;
/// Maximum log-odds that one run adds, natural logarithm: one in a million.
pub(crate) const MAX_LOG_ODDS: f64 = 13.8;

/// The posterior probability of existence by the log-odds of one run.
pub(crate) fn posterior(prior: f64, log_odds: f64) -> f64 {
    let odds = (prior / (1.0 - prior)).ln() + log_odds.clamp(-MAX_LOG_ODDS, MAX_LOG_ODDS);
    1.0 / (1.0 + (-odds).exp())
}
