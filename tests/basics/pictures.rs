//! A failing image test writes pictures that show the difference.

use presight_testkit as common;

use common::{plan, reference, scenes};
use glam::DVec3;
use presight_model::geometry::Pose;
use presight_render::verify::Precision;

#[test]
fn the_difference_shows_the_wrong_pixels_and_no_others() {
    let world = scenes::room_world(3, 12);
    let sensor = scenes::camera(97, 61);
    let plan = plan(&world, &sensor, &Pose::from_xyz_rpy(DVec3::new(0.1, 0.2, 1.3), 0.02, 0.05, 0.7));
    let right = reference(&plan);
    let mut wrong = right.clone();
    let faults = [(12, 7), (13, 7), (96, 60)];
    for (column, row) in faults {
        wrong.range[row * 97 + column] *= 1.01;
    }
    let folder = tempfile::tempdir().unwrap();
    common::pictures::leave(folder.path(), &right, &wrong, &plan, Precision::F64).unwrap();
    let picture = |name: &str| image::open(folder.path().join(name)).unwrap();
    assert_ne!(picture("expected.png"), picture("actual.png"));
    let difference = picture("difference.png").to_luma8();
    assert_eq!(difference.dimensions(), (97, 61));
    let white: Vec<_> = difference.enumerate_pixels().filter(|(.., p)| p.0 == [255]).map(|(x, y, _)| (x, y)).collect();
    assert_eq!(white, faults.map(|(column, row)| (column as u32, row as u32)));
    // Rounding is not a fault.
    let mut rounded = right.clone();
    rounded.range.iter_mut().filter(|r| r.is_finite()).for_each(|r| *r = r.next_up());
    common::pictures::leave(folder.path(), &right, &rounded, &plan, Precision::F32).unwrap();
    assert!(picture("difference.png").to_luma8().iter().all(|p| *p == 0));
}
