//! Predicted track positions, and the innovations measured against them.

use super::common::{CommonMotion, PointEvidence};
use super::motion::PointMotion;
use super::options::TrackerOptions;
use super::track::Track;
use crate::matching::{Aligned, Assignment, Candidates, Detection, ExpectedFeature, align};
use glam::{DMat2, DVec2};

/// The predicted points of all tracks, one track after another, and the motion that all tracks share.
pub(super) struct Motions {
    pub points: Vec<PointMotion>,
    /// Index of each track's first point, and the total as last entry.
    pub starts: Vec<u32>,
    pub common: CommonMotion,
}

impl Motions {
    pub fn of(&self, row: usize) -> &[PointMotion] {
        &self.points[self.starts[row] as usize..self.starts[row + 1] as usize]
    }

    pub fn of_mut(&mut self, row: usize) -> &mut [PointMotion] {
        &mut self.points[self.starts[row] as usize..self.starts[row + 1] as usize]
    }
}

/// The predictions of a frame and the detections assigned to them.
pub(super) struct Pairing {
    pub moved: Motions,
    pub expected: Vec<ExpectedFeature>,
    pub candidates: Candidates,
    pub assignment: Assignment,
    /// Rows whose detection may well be another feature's; they have none.
    pub doubtful: Vec<usize>,
}

/// The measurement of one defining point of a track.
#[derive(Clone, Copy, Debug)]
pub(super) struct Sighting {
    /// Measured minus predicted position.
    pub innovation: DVec2,
    pub covariance: DMat2,
    /// Unit direction along which the point is not fixed (the end of a segment without a corner).
    pub slides: Option<DVec2>,
}

/// The measurements of all tracks.
pub(super) struct Sightings {
    pub points: Vec<Sighting>,
    /// Index of each track's first point, and the total as last entry. Missed tracks have no points.
    starts: Vec<u32>,
}

impl Sightings {
    pub fn new(
        expected: &[ExpectedFeature],
        found: &[Detection],
        assignment: &Assignment,
        options: &TrackerOptions,
    ) -> Self {
        let mut all = Self { points: Vec::with_capacity(expected.len()), starts: vec![0] };
        let mut aligned: Vec<Aligned> = Vec::new();
        for (expected, column) in expected.iter().zip(&assignment.columns) {
            if let Some(column) = column {
                let detection = &found[*column as usize];
                align(expected, detection, 1.0, options.slide_sigma, options.image.turn, &mut aligned);
                for (seen, p) in aligned.iter().zip(expected.shape.points()) {
                    let Aligned { at, covariance, slides } = *seen;
                    all.points.push(Sighting { innovation: at - *p, covariance, slides });
                }
            }
            all.starts.push(all.points.len() as u32);
        }
        all
    }

    pub fn of(&self, row: usize) -> &[Sighting] {
        &self.points[self.starts[row] as usize..self.starts[row + 1] as usize]
    }

    /// Returns the evidence for the shared motion from tracks that are old enough to be well known.
    pub fn witnesses(&self, tracks: &[Track], moved: &Motions, scale: f64) -> Vec<PointEvidence> {
        let mut witnesses = Vec::with_capacity(self.points.len());
        for (row, _) in tracks.iter().enumerate().filter(|(_, t)| t.seen >= super::tracker::OLD_ENOUGH) {
            for (seen, motion) in self.of(row).iter().zip(moved.of(row)) {
                let information = ((motion.pp + seen.covariance) * scale).inverse();
                witnesses.push(PointEvidence { innovation: seen.innovation, information });
            }
        }
        witnesses
    }
}

/// Returns the sum of squared innovations divided by their predicted variances, and the number of coordinates in it.
pub(super) fn squares(seen: &[Sighting], points: &[PointMotion], scale: f64) -> (f64, u32) {
    let (mut squares, mut coordinates) = (0.0, 0);
    for (seen, motion) in seen.iter().zip(points) {
        let covariance = (motion.pp + seen.covariance) * scale;
        match seen.slides {
            Some(along) => {
                let across = along.perp();
                squares += across.dot(seen.innovation).powi(2) / across.dot(covariance * across);
                coordinates += 1;
            }
            None => {
                squares += seen.innovation.dot(covariance.inverse() * seen.innovation);
                coordinates += 2;
            }
        }
    }
    (squares, coordinates)
}
