//! Comparison of two predictions.
