//! Checks what was known of a pose before.

use super::Freedom;
use presight_model::error::{Error, Result};
use presight_model::geometry::PoseEstimate;
use presight_model::matrix::{eigen, restricted};

/// # Errors
/// [`crate::ErrorKind::Usage`] unless the covariance is symmetric and positive on the axes that are estimated.
pub(super) fn check(prior: &PoseEstimate, freedom: Freedom) -> Result<()> {
    prior.world_from_robot.check()?;
    let c = prior.covariance.as_rows();
    let wrong = |what: &str| {
        let remedy = "give a symmetric matrix with positive variances, metres and radians";
        Err(Error::usage(format!("the covariance of the prior {what}"), remedy))
    };
    if !c.as_flattened().iter().all(|x| x.is_finite()) {
        return wrong("is not finite");
    }
    // What rounding leaves on the axes that are not estimated says nothing.
    let axes = freedom.axes();
    if axes.iter().any(|i| !(c[*i][*i] > 0.0)) {
        return wrong("is not positive");
    }
    let scale = |i: usize, j: usize| (c[i][i] * c[j][j]).abs().sqrt();
    let correlations = restricted(
        &std::array::from_fn(|i| std::array::from_fn(|j| if scale(i, j) > 0.0 { c[i][j] / scale(i, j) } else { 0.0 })),
        axes,
    );
    if axes.iter().any(|i| axes.iter().any(|j| (correlations[*i][*j] - correlations[*j][*i]).abs() > 1e-6)) {
        return wrong("is not symmetric");
    }
    let (values, _) = eigen(correlations, 6);
    if values.iter().any(|v| *v < -1e-9) {
        return wrong("is not positive");
    }
    Ok(())
}
