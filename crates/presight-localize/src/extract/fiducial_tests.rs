//! Rendered fiducials are found at their place and with their identity.

use super::*;
use crate::matching::Shape;
use glam::{DMat3, DVec2, DVec3};
use presight_model::measured::GreyImage;
use presight_model::random::SplitMix64;
use presight_testkit::tags::is_white;

/// Brightness of a tag, in cells from the top left of its white border.
fn tag(code: usize, at: DVec2) -> f64 {
    if !(0.0..10.0).contains(&at.x) || !(0.0..10.0).contains(&at.y) {
        return 0.45;
    }
    let cell = at.floor() - 1.0;
    if is_white(code, cell.x as i32, cell.y as i32) { 0.8 } else { 0.15 }
}

fn through(map: &DMat3, at: DVec2) -> DVec2 {
    let p = *map * at.extend(1.0);
    p.truncate() / p.z
}

/// A tag seen obliquely, `size` pixels wide, at any rotation; and the map from its cells to pixels.
fn view(code: usize, size: f64, noise: f64, random: &mut SplitMix64) -> (GreyImage, DMat3) {
    const SIZE: (u32, u32) = (160, 120);
    let turned = DMat3::from_angle(random.uniform(0.0, std::f64::consts::TAU));
    let slant = DMat3::from_cols(
        DVec3::new(1.0, 0.0, random.uniform(-0.02, 0.02)),
        DVec3::Y * random.uniform(0.6, 1.0),
        DVec3::Z,
    );
    let place = DVec2::new(random.uniform(75.0, 85.0), random.uniform(55.0, 65.0));
    let cells = DMat3::from_translation(DVec2::splat(-5.0));
    let map = DMat3::from_translation(place) * turned * DMat3::from_scale(DVec2::splat(size / 8.0)) * slant * cells;
    let back = map.inverse();
    let value = |i: u32| {
        let (c, r) = (f64::from(i % SIZE.0), f64::from(i / SIZE.0));
        let fine = (0..36u32).map(|k| DVec2::new(f64::from(k % 6) + 0.5, f64::from(k / 6) + 0.5) / 6.0 - 0.5);
        let bright = fine.map(|part| tag(code, through(&back, DVec2::new(c, r) + part))).sum::<f64>() / 36.0;
        (bright + noise * 3f64.sqrt() * random.uniform(-1.0, 1.0)) as f32
    };
    (GreyImage::new(SIZE.0, SIZE.1, (0..SIZE.0 * SIZE.1).map(value).collect()).unwrap(), map)
}

/// Single tags with at least three pixels per cell are all found and identified, with corner errors as stated.
#[test]
fn rendered_tags_are_found() {
    let mut finder = FiducialFinder::new("DICT_APRILTAG_36h11").unwrap();
    let mut random = SplitMix64(36);
    let (mut squares, mut count) = (0.0, 0.0);
    for (k, size) in (0..60usize).zip([24.0, 40.0, 80.0].into_iter().cycle()) {
        let (image, map) = view(k % 4, size, 0.01, &mut random);
        let found = finder.find(&image, PixelBox::whole(&image)).unwrap();
        assert_eq!(found.len(), 1, "{k}: {size} pixels");
        assert_eq!(found[0].properties.marker.as_ref().unwrap().code as usize, k % 4);
        let Shape::Fiducial(corners) = found[0].shape else { panic!("{:?}", found[0].shape) };
        // The black square begins one cell inside.
        let own = [[1.0, 1.0], [9.0, 1.0], [9.0, 9.0], [1.0, 9.0]].map(|at| through(&map, DVec2::from(at)));
        for (corner, own) in corners.into_iter().zip(own) {
            assert!(corner.distance(own) < 0.4, "{k}: {corner} of {own}");
            squares += (corner - own).length_squared() / (2.0 * found[0].covariance.x_axis.x);
            count += 1.0;
        }
        let [x, y] = [found[0].shape.centre().x, found[0].shape.centre().y];
        let near = PixelBox([x - 0.9 * size - 3.0, y - 0.9 * size - 3.0, x + 0.9 * size + 3.0, y + 0.9 * size + 3.0]);
        let again = finder.find(&image, near).unwrap();
        assert!(
            again.len() == 1 && again[0].shape.centre().distance(found[0].shape.centre()) < 0.1,
            "{k}: the same in a box"
        );
    }
    let mean = squares / count;
    assert!((0.3..2.0).contains(&mean), "normalized squared errors of {mean}");
}

/// Planted faults: a mirrored tag, a tag of another dictionary and empty images give nothing, nor do empty boxes.
#[test]
fn what_is_no_tag_is_not_found() {
    let mut finder = FiducialFinder::new("DICT_APRILTAG_36h11").unwrap();
    let mut random = SplitMix64(5);
    let (image, _) = view(0, 60.0, 0.0, &mut random);
    let mirrored = (0..120 * 160).map(|i| image.values()[i / 160 * 160 + 159 - i % 160]).collect();
    let mirrored = GreyImage::new(160, 120, mirrored).unwrap();
    assert!(finder.find(&mirrored, PixelBox::whole(&mirrored)).unwrap().is_empty());
    let mut other = FiducialFinder::new("DICT_APRILTAG_25h9").unwrap();
    assert!(other.find(&image, PixelBox::whole(&image)).unwrap().is_empty());
    for seed in 0..10 {
        let mut random = SplitMix64(seed);
        let noise = (0..120 * 160).map(|_| random.uniform(0.0, 1.0) as f32).collect();
        let noise = GreyImage::new(160, 120, noise).unwrap();
        assert!(finder.find(&noise, PixelBox::whole(&noise)).unwrap().is_empty(), "{seed}");
    }
    for value in [f32::NAN, -3.0, 0.5, 7.0] {
        for (w, h) in [(64, 48), (1, 1), (16, 16), (17, 300)] {
            let flat = GreyImage::new(w, h, vec![value; (w * h) as usize]).unwrap();
            assert!(finder.find(&flat, PixelBox::whole(&flat)).unwrap().is_empty());
        }
    }
    for odd in [[f64::NAN; 4], [50.0, 50.0, 10.0, 10.0], [-90.0, -90.0, -80.0, -80.0], [900.0, 0.0, 1e300, 9.0]] {
        assert!(finder.find(&image, PixelBox(odd)).unwrap().is_empty());
    }
    let unknown = FiducialFinder::new("DICT_4X4_50").err().expect("another dictionary is refused");
    assert!(unknown.to_string().contains("DICT_4X4_50") && unknown.remedy().contains("36h11"));
}
