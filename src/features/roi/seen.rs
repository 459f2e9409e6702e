//! Nominal images of material points, with what each error does to them.

use super::Projection;
use super::errors::{Material, Uncertain};
use super::passing::dot;
use glam::DVec3;

/// A point in the image with what each error does to it.
pub(super) struct Seen {
    pub point: Material,
    pub at: [f64; 2],
    /// Derivatives of column and row by each error.
    pub slopes: [Vec<f64>; 2],
    pub sigma: [f64; 2],
    pub lever: f64,
    pub lever_sigma: f64,
    /// Standard deviation of its position, body frame.
    pub spread: f64,
}

/// Nominal images and their slopes. Columns are unwrapped to the first point's.
pub(super) fn see(projection: &impl Projection, uncertain: &Uncertain, points: &[Material]) -> Vec<Seen> {
    let mut all: Vec<Seen> = Vec::with_capacity(points.len());
    for point in points {
        let p = uncertain.place(point, &[]);
        let Some(mut at) = projection.project(p) else { continue };
        if let Some(first) = all.first() {
            at[0] = unwrapped(projection, at[0], first.at[0]);
        }
        let Some(gradient) = gradient(projection, p, at) else { continue };
        let moves = uncertain.slopes(point);
        let slopes = gradient.map(|g| moves.iter().map(|s| g.dot(*s)).collect::<Vec<f64>>());
        let sigma = [0, 1].map(|k| dot(&slopes[k], &slopes[k]).sqrt());
        let spread = moves.iter().map(|s| s.length_squared()).sum::<f64>().sqrt();
        let lever = projection.lever(p);
        let towards = |s: &DVec3| (projection.lever(p + *s * 1e-6) - projection.lever(p - *s * 1e-6)) / 2e-6;
        let lever_sigma = moves.iter().map(|s| towards(s).powi(2)).sum::<f64>().sqrt();
        all.push(Seen { point: *point, at, slopes, sigma, lever, lever_sigma, spread });
    }
    all
}

/// The column nearest to another, where columns go round.
pub(super) fn unwrapped(projection: &impl Projection, column: f64, near: f64) -> f64 {
    match projection.turn() {
        Some(turn) => column - turn * ((column - near) / turn).round(),
        None => column,
    }
}

/// Derivatives of column and row by the position, by central differences: their error is of the second order of 1e-5.
fn gradient(projection: &impl Projection, p: DVec3, at: [f64; 2]) -> Option<[DVec3; 2]> {
    let step = 1e-5 * projection.lever(p).abs().max(1e-9 * p.length());
    let mut gradient = [DVec3::ZERO; 2];
    for k in 0..3 {
        let mut by = DVec3::ZERO;
        by[k] = step;
        let (up, down) = (projection.project(p + by)?, projection.project(p - by)?);
        gradient[0][k] = (unwrapped(projection, up[0], at[0]) - unwrapped(projection, down[0], at[0])) / (2.0 * step);
        gradient[1][k] = (up[1] - down[1]) / (2.0 * step);
    }
    Some(gradient)
}
