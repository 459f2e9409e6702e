//! Options of a tracker.

use crate::matching::PropertyNoise;
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
/// let wrong = options.with_confidence(1.0);
/// assert_eq!(wrong.check().unwrap_err().to_string(), "confidence 1 is not in 0.5..1; give a probability such as 0.99");
/// ```
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub struct TrackerOptions {
    /// Image in which the features move.
    pub image: ImageExtent,
    /// Probability with which a window holds its feature.
    pub confidence: f64,
    /// Number of consecutive misses after which a track is dropped; the paper uses 3.
    pub misses: u32,
    /// Time constant of the filter, in frames, for steady motion. A longer one gives smaller windows for smooth motion.
    pub memory: f64,
    /// Standard deviation of a detected coordinate, used until a track has detections.
    pub detection_sigma: f64,
    /// Standard deviation by which a segment's end without a corner slides along the segment.
    pub slide_sigma: f64,
    /// Standard deviation of the speed of a new track, pixels per second. Nearby tracks give a better estimate.
    pub speed_sigma: f64,
    /// Standard deviation of the acceleration of a new track, pixels per s^2.
    pub acceleration_sigma: f64,
    /// Standard deviation of the speed left after the flow of a known motion is removed, pixels per second.
    pub residual_speed_sigma: f64,
    /// Probability that a feature in its window is detected. The lower it is, the less a miss costs in the assignment.
    pub detection_probability: f64,
    /// Clutter detections per pixel squared, used until frames give an estimate.
    pub clutter_density: f64,
    /// Noise of measured properties.
    pub properties: PropertyNoise,
    /// Longest time between two frames that tracks survive, seconds.
    pub longest_gap: f64,
    /// A full prediction is needed if fewer tracks are left.
    pub least_tracks: usize,
    /// Fewest cells of a 3 x 3 grid over the image that must hold a track.
    pub least_spread: usize,
    /// Smallest share of the tracks since the last full prediction that must be left.
    pub least_share: f64,
}

impl TrackerOptions {
    /// Default options for this image.
    pub fn new(image: ImageExtent) -> Self {
        Self {
            image,
            confidence: 0.99,
            misses: 3,
            memory: 5.0,
            detection_sigma: 0.5,
            slide_sigma: 10.0,
            speed_sigma: 200.0,
            acceleration_sigma: 400.0,
            residual_speed_sigma: 20.0,
            detection_probability: 0.9,
            clutter_density: 1e-4,
            properties: PropertyNoise::default(),
            longest_gap: 1.0,
            least_tracks: 12,
            least_spread: 3,
            least_share: 0.5,
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
            ("slide_sigma", self.slide_sigma),
            ("speed_sigma", self.speed_sigma),
            ("acceleration_sigma", self.acceleration_sigma),
            ("residual_speed_sigma", self.residual_speed_sigma),
            ("clutter_density", self.clutter_density),
            ("properties.strength", self.properties.strength),
            ("properties.contrast", self.properties.contrast),
            ("properties.direction", self.properties.direction),
            ("longest_gap", self.longest_gap),
        ];
        let within = |x: f64, low: f64, high: f64| x >= low && x <= high;
        if let Some((name, x)) = positive.into_iter().find(|(_, x)| !within(*x, 1e-9, 1e9)) {
            return Err(Error::usage(format!("{name} {x} is not in 1e-9..1e9"), "give a number above 0"));
        }
        let ranges = [
            ("memory", self.memory, 1.0, 100.0),
            ("detection_probability", self.detection_probability, 0.01, 0.999),
            ("least_share", self.least_share, 0.0, 1.0),
            ("misses", f64::from(self.misses), 1.0, 1e6),
        ];
        match ranges.into_iter().find(|(_, x, low, high)| !within(*x, *low, *high)) {
            Some((name, x, low, high)) => {
                Err(Error::usage(format!("{name} {x} is not in {low}..{high}"), "give a number in that range"))
            }
            None => Ok(()),
        }
    }
}

presight_model::with_options!(
    TrackerOptions:
    with_image image: ImageExtent,
    with_confidence confidence: f64,
    with_misses misses: u32,
    with_memory memory: f64,
    with_detection_sigma detection_sigma: f64,
    with_slide_sigma slide_sigma: f64,
    with_speed_sigma speed_sigma: f64,
    with_acceleration_sigma acceleration_sigma: f64,
    with_residual_speed_sigma residual_speed_sigma: f64,
    with_detection_probability detection_probability: f64,
    with_clutter_density clutter_density: f64,
    with_properties properties: PropertyNoise,
    with_longest_gap longest_gap: f64,
    with_least_tracks least_tracks: usize,
    with_least_spread least_spread: usize,
    with_least_share least_share: f64,
);
