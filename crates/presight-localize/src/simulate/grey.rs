//! Grey images of a camera with a light at its centre: brightness is the echo ([`Output::Echo`]), averaged over each
//! pixel, with blur and noise. This is not a renderer: there are no shadows, highlights or textures.

use presight_model::error::{Error, Result};
use presight_model::geometry::RobotPose;
use presight_model::measured::{Frame, GreyImage, Measurement};
use presight_model::random::SplitMix64;
use presight_model::sensor::{Camera, Geometry, Sensor};
use presight_model::world::World;
use presight_predict::predict::Predictor;
use presight_render::plan::{Images, Output, Outputs};

/// Rays along each side of a pixel: grey values at edges come in steps of 1 / 9.
const FINE: u32 = 3;

/// Simulates the grey images of one camera on one robot.
///
/// # Examples
/// ```
/// use presight::simulate::GreySimulator;
/// use presight::environment::Environment;
/// use presight::sensor::{Camera, Geometry, SensorSpec};
/// use presight::{Options, Predictor, RobotPose, Sensor, World};
/// let camera = Camera::pinhole(32, 24, 30.0, 30.0, 15.5, 11.5);
/// let camera = Sensor::new(SensorSpec::new("camera", "video", Geometry::Camera(camera)))?;
/// let mut simulator = GreySimulator::new(Predictor::new(Options::default())?, camera, 0.7, 0.0, 1)?;
/// let frame = simulator.frame(&World::new(Environment::new()), 0.0, &RobotPose::IDENTITY)?;
/// assert!(frame.grey().unwrap().values().iter().all(|v| *v == 0.0), "an empty scene is black");
/// # Ok::<(), presight::Error>(())
/// ```
pub struct GreySimulator {
    predictor: Predictor,
    camera: Sensor,
    /// The camera with each pixel divided, for anti-aliasing.
    fine: Sensor,
    blur: f64,
    noise: f64,
    random: SplitMix64,
}

impl GreySimulator {
    /// Makes a simulator; the same seed gives the same images. `blur` (pixels) and `noise` are standard deviations.
    ///
    /// # Errors
    /// [`presight_model::ErrorKind::Usage`] for a sensor that is not a camera, for a blur outside of 0 to 10 pixels,
    /// and for a noise outside of 0 to 1; [`presight_model::ErrorKind::Invalid`] for an image too large to divide its
    /// pixels.
    pub fn new(predictor: Predictor, camera: Sensor, blur: f64, noise: f64, seed: u64) -> Result<Self> {
        let Geometry::Camera(c) = &camera.spec().geometry else {
            let what = format!("sensor {:?} is not a camera and takes no grey images", camera.spec().name);
            return Err(Error::usage(what, "give a camera"));
        };
        if !((0.0..=10.0).contains(&blur) && (0.0..=1.0).contains(&noise)) {
            let what = format!("a blur of {blur} pixels and a noise of {noise}");
            return Err(Error::usage(what, "give a blur of 0 to 10 pixels and a noise of 0 to 1"));
        }
        let n = f64::from(FINE);
        let centre = |x: f64| n * (x + 0.5) - 0.5;
        let pinhole = Camera::pinhole(FINE * c.width, FINE * c.height, n * c.fx, n * c.fy, centre(c.cx), centre(c.cy));
        let fine = Camera { distortion: c.distortion.clone(), ..pinhole };
        let fine = Sensor::new(camera.spec().clone().with_geometry(Geometry::Camera(fine)))?;
        Ok(Self { predictor, camera, fine, blur, noise, random: SplitMix64(seed) })
    }

    /// The camera.
    pub fn camera(&self) -> &Sensor {
        &self.camera
    }

    /// The image that the camera takes with the robot at a pose.
    ///
    /// # Errors
    /// Errors of [`Predictor::predict_images`], and a stamp that is not finite.
    pub fn frame(&mut self, world: &World, stamp: f64, robot: &RobotPose) -> Result<Frame> {
        let mut images = Images::default();
        let outputs = Outputs::of(&[Output::Echo]);
        self.predictor.predict_images(world, &self.fine, &robot.sensor(&self.camera), outputs, &mut images)?;
        let (w, h) = (self.camera.width() as usize, self.camera.height() as usize);
        let mut picture = vec![0.0; w * h];
        let side = FINE as usize;
        for (i, echo) in images.echo.iter().enumerate() {
            let (column, row) = (i % (w * side) / side, i / (w * side) / side);
            // Pixels without an echo are black.
            let share = f64::from(FINE * FINE);
            picture[row * w + column] += if echo.is_finite() { f64::from(*echo) / share } else { 0.0 };
        }
        let picture = blurred(&blurred(&picture, w, self.blur, 1), w, self.blur, w);
        let noisy = picture.iter().map(|v| (v + self.noise * self.random.normal(1.0)) as f32).collect();
        let image = GreyImage::new(w as u32, h as u32, noisy)?;
        Frame::new(stamp, self.camera.clone(), Measurement::Grey(image))
    }
}

/// Gaussian blur along rows (`step` 1) or columns (`step` w). Beyond the border, the border pixel repeats.
fn blurred(picture: &[f64], w: usize, blur: f64, step: usize) -> Vec<f64> {
    let reach = (3.0 * blur).ceil() as i64;
    let weights: Vec<f64> = (-reach..=reach).map(|k| (-0.5 * (k as f64 / blur.max(1e-6)).powi(2)).exp()).collect();
    let total: f64 = weights.iter().sum();
    let side = if step == 1 { w as i64 } else { (picture.len() / w) as i64 };
    (0..picture.len())
        .map(|i| {
            let along = (if step == 1 { i % w } else { i / w }) as i64;
            let at = |k: i64| (i as i64 + ((along + k).clamp(0, side - 1) - along) * step as i64) as usize;
            (-reach..=reach).zip(&weights).map(|(k, weight)| weight * picture[at(k)]).sum::<f64>() / total
        })
        .collect()
}
