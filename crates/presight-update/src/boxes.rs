//! The box around a group of points: upright, turned to be smallest.

use glam::{DQuat, DVec2, DVec3};
use presight_model::geometry::Pose;
use presight_model::statistics::quantile;

/// Steps of a quarter turn.
const TURNS: usize = 45;
/// Share of the points that may stick out on each side.
const OUT: f64 = 0.005;
/// A box is never thinner, metres.
const THINNEST: f64 = 0.02;

/// An upright box.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct UprightBox {
    /// The pose of its middle; its axes are its edges.
    pub pose: Pose,
    /// Its edges, metres.
    pub size: DVec3,
}

impl UprightBox {
    /// The smallest upright box that holds all but a few of the points, metres. Without points it is a point.
    pub fn of(points: &[DVec3]) -> Self {
        let extent =
            |values: &mut Vec<f64>| (quantile(values, OUT).unwrap_or(0.0), quantile(values, 1.0 - OUT).unwrap_or(0.0));
        let sides = |angle: f64| {
            let (x, y) = (DVec2::from_angle(angle), DVec2::from_angle(angle).perp());
            [x, y].map(|axis| extent(&mut points.iter().map(|p| p.truncate().dot(axis)).collect()))
        };
        let area = |[(a, b), (c, d)]: [(f64, f64); 2]| (b - a + THINNEST) * (d - c + THINNEST);
        let turn = |step: usize| step as f64 / TURNS as f64 * std::f64::consts::FRAC_PI_2;
        let best = (0..TURNS).map(turn).min_by(|a, b| area(sides(*a)).total_cmp(&area(sides(*b)))).unwrap_or(0.0);
        let ([(a, b), (c, d)], (low, high)) = (sides(best), extent(&mut points.iter().map(|p| p.z).collect()));
        let rotation = DQuat::from_rotation_z(best);
        let middle = rotation * DVec3::new(0.5 * (a + b), 0.5 * (c + d), 0.5 * (low + high));
        let size = DVec3::new(b - a, d - c, high - low).max(DVec3::splat(THINNEST));
        Self { pose: Pose { translation: middle, rotation }, size }
    }

    /// True if it holds a point, or misses it by at most `slack` metres.
    pub fn holds(&self, p: DVec3, slack: f64) -> bool {
        let q = self.pose.inverse().transform_point(p).abs();
        q.cmple(0.5 * self.size + slack).all()
    }
}
