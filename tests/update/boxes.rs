//! Boxes around points, by hand.

use glam::DVec3;
use presight_model::geometry::Pose;
use presight_update::UprightBox;

/// Points on a box of 2 x 1 x 0.5 m turned by 20 degrees.
#[test]
fn boxes_turn_with_their_points() {
    let truth = Pose::from_xyz_rpy(DVec3::new(4.0, -3.0, 1.0), 0.0, 0.0, 20f64.to_radians());
    let grid = |n: usize| (0..=n).map(move |k| k as f64 / n as f64 - 0.5);
    let all = grid(20).flat_map(|x| grid(20).flat_map(move |y| grid(5).map(move |z| DVec3::new(2.0 * x, y, 0.5 * z))));
    let points: Vec<DVec3> = all.map(|p| truth.transform_point(p)).collect();
    let found = UprightBox::of(&points);
    assert!((found.pose.translation - truth.translation).length() < 1e-9, "{found:?}");
    assert!((found.size - DVec3::new(2.0, 1.0, 0.5)).abs().max_element() < 1e-9, "{found:?}");
    assert!(points.iter().all(|p| found.holds(*p, 1e-9)) && !found.holds(truth.translation + DVec3::Z, 0.1));
    assert!(UprightBox::of(&[]).size.max_element() < 0.1);
}
