//! Options of a tracker.

use crate::matching::Matcher;
use presight_model::error::{Error, Result};
use presight_model::sensor::Sensor;

/// Size of the image in which features move.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ImageExtent {
    /// Columns.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// Columns of a full turn, for an image that covers 360 degrees.
    pub turn: Option<f64>,
}

impl ImageExtent {
    /// An image with borders on all sides.
    pub fn new(width: u32, height: u32) -> Self {
        Self { width, height, turn: None }
    }

    /// A sensor's image.
    pub fn of(sensor: &Sensor) -> Self {
        Self { width: sensor.width(), height: sensor.height(), turn: sensor.columns_of_a_turn() }
    }
}

/// Options of a [`super::Tracker`]; units are pixels and seconds.
///
/// ```
/// use presight::localize::{ImageExtent, TrackerOptions};
/// let options = TrackerOptions::new(ImageExtent::new(640, 480)).with_confidence(0.95);
/// assert!(options.check().is_ok());
/// let wrong = options.with_confidence(1.0).check().unwrap_err();
/// assert_eq!(wrong.to_string(), "confidence 1 is not in 0.5..1; give a probability such as 0.99");
/// ```
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub struct TrackerOptions {
    /// Image in which the features move.
    pub image: ImageExtent,
    /// Probability with which a window holds its feature.
    pub confidence: f64,
    /// Number of consecutive misses after which a track is dropped; the paper uses 3.
    pub max_misses: u32,
    /// Standard deviation of a detected coordinate, used until a track has a detection.
    pub detection_sigma: f64,
    /// Standard deviation of the speed of a new track, pixels per second. By default 200: a camera with a focal length
    /// of 500 pixels on a robot that turns by 0.4 rad/s.
    pub speed_sigma: f64,
    /// Standard deviation of a feature's acceleration in the image, pixels per s^2. By default 400: the same camera on
    /// a robot whose turn accelerates by 0.8 rad/s^2.
    pub acceleration_sigma: f64,
    /// Gates and costs of the assignment; its `turn` is that of the image.
    pub matcher: Matcher,
}

impl TrackerOptions {
    /// Default options for this image.
    pub fn new(image: ImageExtent) -> Self {
        Self {
            image,
            confidence: 0.99,
            max_misses: 3,
            detection_sigma: 0.5,
            speed_sigma: 200.0,
            acceleration_sigma: 400.0,
            matcher: Matcher::default(),
        }
    }

    /// # Errors
    /// [`presight_model::ErrorKind::Usage`] naming the first option that is out of range.
    pub fn check(&self) -> Result<()> {
        if !(0.5..1.0).contains(&self.confidence) {
            let what = format!("confidence {} is not in 0.5..1", self.confidence);
            return Err(Error::usage(what, "give a probability such as 0.99"));
        }
        let image = self.image;
        if image.width == 0 || image.height == 0 || image.turn.is_some_and(|turn| !(turn >= 1.0 && turn.is_finite())) {
            return Err(Error::usage(format!("{image:?} is not a valid image"), "give columns and rows from 1 on"));
        }
        let positive = [
            ("detection_sigma", self.detection_sigma),
            ("speed_sigma", self.speed_sigma),
            ("acceleration_sigma", self.acceleration_sigma),
            ("max_misses", f64::from(self.max_misses)),
            ("matcher.clutter_density", self.matcher.clutter_density),
        ];
        if let Some((name, x)) = positive.into_iter().find(|(_, x)| !(1e-9..=1e9).contains(x)) {
            return Err(Error::usage(format!("{name} {x} is not in 1e-9..1e9"), "give a number above 0"));
        }
        let probability = self.matcher.detection_probability;
        if !(probability > 0.0 && probability < 1.0) {
            let what = format!("matcher.detection_probability {probability} is not in 0..1");
            return Err(Error::usage(what, "give a probability such as 0.9"));
        }
        Ok(())
    }
}

presight_model::with_options!(
    TrackerOptions:
    with_image image: ImageExtent,
    with_confidence confidence: f64,
    with_max_misses max_misses: u32,
    with_detection_sigma detection_sigma: f64,
    with_speed_sigma speed_sigma: f64,
    with_acceleration_sigma acceleration_sigma: f64,
    with_matcher matcher: Matcher,
);
