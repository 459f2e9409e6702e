//! What a tracker is told once.

use crate::matching::PropertyNoise;
use presight_model::error::{Error, Result};
use presight_model::sensor::Sensor;

/// The image that features move in.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ImageExtent {
    /// Columns.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// Columns of a full turn, if the image goes round.
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

/// What a [`super::Tracker`] is told once; pixels and seconds.
///
/// ```
/// use presight::history::{ImageExtent, TrackerOptions};
/// let options = TrackerOptions { confidence: 0.95, ..TrackerOptions::new(ImageExtent::new(640, 480)) };
/// assert!(options.check().is_ok());
/// let wrong = TrackerOptions { confidence: 1.0, ..options };
/// assert_eq!(wrong.check().unwrap_err().to_string(), "confidence 1 is not in 0.5..1; give a probability such as 0.99");
/// ```
#[derive(Clone, Debug, PartialEq)]
pub struct TrackerOptions {
    /// Where features are.
    pub image: ImageExtent,
    /// Probability with which a window holds its feature.
    pub confidence: f64,
    /// A track is dropped after so many misses in a row. The paper's 3.
    pub misses: u32,
    /// Frames that the filter remembers: the time constant with which it follows while nothing changes. Longer windows are
    /// smaller on smooth motion.
    pub memory: f64,
    /// One sigma of a detected coordinate, until a track's own detections say.
    pub detection_sigma: f64,
    /// How far an end without a corner slides along its segment, one sigma.
    pub slide_sigma: f64,
    /// Speed of a new track, one sigma, pixels a second; tracks around it tell better.
    pub speed_sigma: f64,
    /// Its acceleration, pixels by s^2.
    pub acceleration_sigma: f64,
    /// The same of what is left when the flow of a known motion is taken out.
    pub residual_speed_sigma: f64,
    /// Probability that a feature in its window is detected: the less, the cheaper is not being seen.
    pub detection_probability: f64,
    /// Clutter by pixel squared, until frames say.
    pub clutter_density: f64,
    /// How well properties are told.
    pub properties: PropertyNoise,
    /// Longest time between two frames that tracks outlive, seconds.
    pub longest_gap: f64,
    /// Fewer tracks ask for a full prediction.
    pub least_tracks: usize,
    /// Of the nine ninths of the image at least so many must hold a track.
    pub least_spread: usize,
    /// Share of the tracks of the last full prediction that must be left.
    pub least_share: f64,
}

impl TrackerOptions {
    /// Usual ones.
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
    /// [`crate::ErrorKind::Usage`] naming the first option that is out of its range.
    pub fn check(&self) -> Result<()> {
        if !(0.5..1.0).contains(&self.confidence) {
            let what = format!("confidence {} is not in 0.5..1", self.confidence);
            return Err(Error::usage(what, "give a probability such as 0.99"));
        }
        let image = self.image;
        if image.width == 0 || image.height == 0 || image.turn.is_some_and(|turn| !(turn >= 1.0 && turn.is_finite())) {
            return Err(Error::usage(format!("there is no image of {image:?}"), "give columns and rows from 1 on"));
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
                Err(Error::usage(format!("{name} {x} is not in {low}..{high}"), "give a number of that range"))
            }
            None => Ok(()),
        }
    }
}
