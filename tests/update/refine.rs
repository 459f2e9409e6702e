//! Minor changes: poses of objects that stand a little off their places.

use super::case::Off;
use super::displaced::{OFF, case, judge, learn};
use super::{camera, hall};
use glam::DVec3;

/// Every object of the hall stands 1 cm off its place. A drive, with poses that are off, teaches where they stand: the
/// middles are then off by less than half, and by as much as the covariances say. Another drive then finds the robot
/// better, and is not surer of that than it should be.
#[test]
fn objects_are_put_where_they_stand() {
    let case = case(hall(), &camera(), 100, 3);
    let off = Off { is: (0.005, 0.1), stated: (0.005, 0.1) };
    let (after, refined) = learn(&case, &camera(), off);
    let (mut squares, mut normalized) = (0.0, 0.0);
    for r in &refined {
        let truth = case.site.environment().object(&r.object).unwrap();
        let middle = truth.mesh.bounds().transformed(&truth.object_from_mesh).center();
        let away: DVec3 = truth.world_from_object.transform_point(middle) - r.world_from_object.transform_point(middle);
        let lever = r.world_from_object.transform_point(middle) - r.world_from_object.translation;
        let covariance = r.covariance.in_world(&r.world_from_object).moved_by(lever);
        let sigmas = covariance.sigmas();
        squares += away.length_squared();
        normalized += (0..3).map(|i| (away[i] / sigmas[i]).powi(2)).sum::<f64>() / 3.0;
    }
    let count = refined.len() as f64;
    let (rms, normalized) = ((squares / count).sqrt(), normalized / count);
    assert!(count >= 25.0 && rms < 0.5 * OFF, "{count} objects are off by {rms} m");
    // Covariances are wider than each object's own error: objects that were seen together err together.
    assert!((0.1..1.2).contains(&normalized), "{normalized}");
    let frames = case.on_another_way(5, 30).drive(&camera(), Off { is: (0.02, 0.5), stated: (0.02, 0.5) });
    let [before, after] = [&case.map, &after].map(|world| judge(world, &frames));
    let report =
        format!("{:.4} m, {:.2} before; {:.4} m, {:.2} after", before.rms(), before.nees(), after.rms(), after.nees());
    assert!(after.views >= 25 && after.rms() < 0.6 * before.rms() && (0.4..1.8).contains(&after.nees()), "{report}");
}
