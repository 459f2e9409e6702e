//! Grey images of scenes as a camera with a light beside it takes them: brightness by the angle of incidence, pixels that mix what
//! they see, blur, and noise. No real grey images with a model are at hand.

use super::Random;
use presight::extract::GreyImage;
use presight::{Camera, Geometry, Images, Output, Outputs, Pose, Predictor, Sensor, World};

/// Rays along each side of a pixel.
const FINE: u32 = 3;

/// What a camera without distortion sees from a pose (body axes). `blur` is the deviation of a Gaussian, pixels; `noise` that of a grey value.
pub fn grey(
    predictor: &mut Predictor,
    world: &World,
    camera: &Sensor,
    world_from_sensor: &Pose,
    (blur, noise): (f64, f64),
    random: &mut Random,
) -> GreyImage {
    let Geometry::Camera(c) = &camera.spec().geometry else { panic!("a camera") };
    let n = f64::from(FINE);
    let centre = |x: f64| n * (x + 0.5) - 0.5;
    let fine = Camera::pinhole(FINE * c.width, FINE * c.height, n * c.fx, n * c.fy, centre(c.cx), centre(c.cy));
    let fine = Sensor::new(camera.spec().clone().with_geometry(Geometry::Camera(fine))).expect("a camera");
    let mut images = Images::default();
    let outputs = Outputs::of(&[Output::Echo]);
    predictor.predict_images(world, &fine, world_from_sensor, outputs, &mut images).expect("a picture");
    let (w, h) = (c.width as usize, c.height as usize);
    let mut picture = vec![0.0; w * h];
    for (i, echo) in images.echo.iter().enumerate() {
        let (column, row) = (i % (w * FINE as usize) / FINE as usize, i / (w * FINE as usize) / FINE as usize);
        // Nothing is black.
        picture[row * w + column] += if echo.is_finite() { f64::from(*echo) / (n * n) } else { 0.0 };
    }
    let picture = blurred(&blurred(&picture, w, blur, 1), w, blur, w);
    let normal = |random: &mut Random| {
        let radius = (-2.0 * random.uniform(1e-300, 1.0).ln()).sqrt();
        radius * random.uniform(0.0, std::f64::consts::TAU).cos()
    };
    let noisy = picture.iter().map(|v| (v + noise * normal(random)) as f32).collect();
    GreyImage::new(c.width, c.height, noisy).expect("a picture")
}

/// Along rows (`step` 1) or columns (`step` w); what is beyond a side is as the side is.
fn blurred(picture: &[f64], w: usize, blur: f64, step: usize) -> Vec<f64> {
    let reach = (3.0 * blur).ceil() as i64;
    let weight = |k: i64| (-0.5 * (k as f64 / blur.max(1e-6)).powi(2)).exp();
    let total: f64 = (-reach..=reach).map(weight).sum();
    let (side, h) = (if step == 1 { w as i64 } else { (picture.len() / w) as i64 }, picture.len() / w);
    debug_assert!(h > 0);
    (0..picture.len())
        .map(|i| {
            let along = (if step == 1 { i % w } else { i / w }) as i64;
            let at = |k: i64| (i as i64 + ((along + k).clamp(0, side - 1) - along) * step as i64) as usize;
            (-reach..=reach).map(|k| weight(k) * picture[at(k)]).sum::<f64>() / total
        })
        .collect()
}
