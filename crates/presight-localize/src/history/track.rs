//! One feature that is followed from frame to frame.

use super::filter::PointFilter;
use super::options::{ImageExtent, TrackerOptions};
use super::seed::Seed;
use crate::matching::{Detection, ExpectedFeature, ExpectedProperties, Shape, aligned, floored};
use glam::{DMat2, DVec2};

/// A feature that is followed from frame to frame.
#[derive(Clone, Debug)]
pub struct Track {
    pub(super) id: u32,
    /// Kind and corners. Its points equal the positions of the filters.
    shape: Shape,
    filters: Vec<PointFilter>,
    properties: ExpectedProperties,
    /// Covariance of the last detection.
    pub(super) detection: DMat2,
    pub(super) misses: u32,
    seen: u32,
}

impl Track {
    pub(super) fn new(seed: Seed, options: &TrackerOptions) -> Self {
        let filter = |(p, c): (&DVec2, &DMat2)| PointFilter::new(*p, *c, options.speed_sigma);
        Self {
            id: seed.id,
            filters: seed.shape.points().iter().zip(&seed.covariances).map(filter).collect(),
            shape: seed.shape,
            properties: seed.properties,
            detection: DMat2::from_diagonal(DVec2::splat(options.detection_sigma.powi(2))),
            misses: 0,
            seen: 0,
        }
    }

    /// The feature's number.
    pub fn id(&self) -> u32 {
        self.id
    }

    /// Position estimated from the history up to the last frame.
    pub fn shape(&self) -> &Shape {
        &self.shape
    }

    /// Speed of each defining point, pixels per second.
    pub fn speeds(&self) -> impl Iterator<Item = DVec2> + '_ {
        self.filters.iter().map(|f| f.speed)
    }

    /// Covariance of each defining point, pixels squared.
    pub fn covariances(&self) -> impl Iterator<Item = DMat2> + '_ {
        self.filters.iter().map(|f| f.position_covariance)
    }

    /// Number of consecutive misses.
    pub fn misses(&self) -> u32 {
        self.misses
    }

    /// Number of frames in which the feature was detected.
    pub fn seen(&self) -> u32 {
        self.seen
    }

    /// The track `interval` seconds later.
    pub(super) fn advanced(&self, interval: f64, options: &TrackerOptions) -> Self {
        let mut track = self.clone();
        if interval > 0.0 {
            track.filters.iter_mut().for_each(|f| f.advance(interval, options.acceleration_sigma));
            track.place(options.image.turn);
        }
        track
    }

    /// Copies the filters' positions into the shape, with columns wrapped into one turn.
    fn place(&mut self, turn: Option<f64>) {
        if let Some(turn) = turn {
            let shift = -turn * ((self.filters[0].position.x + 0.5) / turn).floor();
            self.filters.iter_mut().for_each(|f| f.position.x += shift);
        }
        for (p, filter) in self.shape.points_mut().iter_mut().zip(&self.filters) {
            *p = filter.position;
        }
    }

    /// Returns the expected feature, without a window.
    pub(super) fn expected(&self) -> ExpectedFeature {
        ExpectedFeature {
            shape: self.shape.clone(),
            covariances: self.covariances().collect(),
            window: [0.0; 4],
            properties: self.properties.clone(),
        }
    }

    /// Corrects the track by its detection.
    pub(super) fn correct(&mut self, expected: &ExpectedFeature, found: &Detection, turn: Option<f64>) {
        for (filter, (at, covariance)) in self.filters.iter_mut().zip(aligned(expected, found, turn)) {
            filter.correct(at, covariance);
        }
        self.place(turn);
        self.detection = floored(found.covariance);
        self.misses = 0;
        self.seen = self.seen.saturating_add(1);
    }

    /// Returns true if the track is still in the image.
    pub(super) fn is_within(&self, image: &ImageExtent) -> bool {
        let p = self.shape.centre();
        let inside = |x: f64, size: u32| x >= -0.5 && x <= f64::from(size) - 0.5;
        (image.turn.is_some() || inside(p.x, image.width)) && inside(p.y, image.height)
    }

    /// False after numerical overflow.
    pub(super) fn is_finite(&self) -> bool {
        self.filters.iter().all(PointFilter::is_finite)
    }
}
