//! Finds the candidate detections of each expected feature, and the cost of each pair.

use super::assign::CandidatePair;
use super::bins::Bins;
use super::detection::{
    Detection, DetectionProperties, ExpectedFeature, ExpectedProperties, Rejection, Shape, UncertainValue,
};
use super::distance::{Distance, FoundLine, Gate, compare, turn_apart};
use glam::DVec2;
use std::f64::consts::PI;

/// Maximum number of candidates of one feature; the cheapest are kept. An optimum needs one per feature of a group.
pub const MAX_CANDIDATES: usize = 64;

/// Length along a ray over which clutter is uniform, metres: the reach of a usual laser scanner.
const DEPTHS: f64 = 30.0;
/// Minimum standard deviation of a measured range, metres. With a smaller one, the gate rejects nearly everything.
const MIN_DEPTH_SIGMA: f64 = 1e-3;

/// Noise of an extractor's properties, as standard deviations.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PropertyNoise {
    /// Strength, which is 0..=1.
    pub strength: f64,
    /// Contrast, which is 0..=1.
    pub contrast: f64,
    /// Direction, radians.
    pub direction: f64,
}

impl Default for PropertyNoise {
    /// 0.05, 0.05 and 3 degrees.
    fn default() -> Self {
        Self { strength: 0.05, contrast: 0.05, direction: 3f64.to_radians() }
    }
}

presight_model::options! {
    /// Gates and costs.
    #[derive(Clone, Copy, Debug, PartialEq)]
    pub struct Matcher {
        /// Standard normal deviate of the probability that a feature's own detection passes the gate; 3.09 means 99.9
        /// %.
        gate_deviate: f64 = 3.090_232, with_gate_deviate;
        /// Probability that a feature in its window is detected.
        detection_probability: f64 = 0.9, with_detection_probability;
        /// Clutter detections per pixel squared.
        clutter_density: f64 = 1e-4, with_clutter_density;
        /// Factor on the covariance of every detection.
        noise: f64 = 1.0, with_noise;
        /// Noise of measured properties.
        properties: PropertyNoise = PropertyNoise::default(), with_properties;
        /// Columns of a full turn, for an image that covers 360 degrees.
        turn: Option<f64> = None, with_turn;
    }
}

/// Candidate pairs of features and detections.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Candidates {
    /// Rows are expected features, columns detections.
    pub pairs: Vec<CandidatePair>,
    /// Detections with invalid values.
    pub rejected: Vec<(u32, Rejection)>,
}

/// Constants of gates and costs, computed once.
struct Level {
    gate: Gate,
    log_clutter: f64,
    log_detection: f64,
}

/// Position of a detection, for the search in windows.
#[derive(Clone, Copy, Debug, Default)]
struct Place {
    centre: DVec2,
    /// Half extent of a segment along columns and rows; 0 for other shapes.
    extent: DVec2,
    column: u32,
}

impl Place {
    fn of(column: u32, shape: &Shape) -> Self {
        let extent = match shape {
            Shape::Segment { ends, .. } => 0.5 * (ends[1] - ends[0]).abs(),
            _ => DVec2::ZERO,
        };
        Self { centre: shape.centre(), extent, column }
    }
}

impl Matcher {
    /// Cost of a feature without a detection.
    #[doc(hidden)]
    pub fn unseen_cost(&self) -> f64 {
        -(1.0 - self.detection_probability).ln()
    }

    /// Returns the pairs of one kind with the detection in the window, and position and properties within the gate.
    #[doc(hidden)]
    pub fn candidates(&self, expected: &[ExpectedFeature], found: &[Detection]) -> Candidates {
        let mut all = Candidates::default();
        let mut places = Vec::with_capacity(found.len());
        for (i, detection) in found.iter().enumerate() {
            match detection.check() {
                Ok(()) => {
                    let place = Place::of(i as u32, &detection.shape);
                    places.push((place, self.wrapped(place.centre)));
                }
                Err(why) => all.rejected.push((i as u32, why)),
            }
        }
        let (bins, level) = (Bins::new(&places), self.level());
        let has_segments = expected.iter().any(|feature| matches!(feature.shape, Shape::Segment { .. }));
        let lines: Vec<Option<FoundLine>> =
            if has_segments { found.iter().map(|d| FoundLine::of(d, self.noise)).collect() } else { Vec::new() };
        let mut near: Vec<CandidatePair> = Vec::new();
        let mut room = vec![0; found.len() * if self.turn.is_some() { 3 } else { 1 } + 1];
        for (row, feature) in expected.iter().enumerate() {
            let inside = self.find_inside(feature, &bins, &mut room);
            near.clear();
            for column in inside {
                if let Shape::Segment { ends, .. } = &feature.shape
                    && let Some(line) = &lines[*column as usize]
                    && !line.may_be(ends, &feature.covariances, self.turn, &level.gate)
                {
                    continue;
                }
                if let Some(cost) = self.cost(feature, &found[*column as usize], &level) {
                    near.push(CandidatePair { row: row as u32, column: *column, cost });
                }
            }
            near.sort_unstable_by(|a, b| a.cost.total_cmp(&b.cost).then(a.column.cmp(&b.column)));
            all.pairs.extend(near.iter().take(MAX_CANDIDATES));
        }
        all
    }

    /// Returns the detections in a feature's window. A segment only has to cross the window. `room` must hold all
    /// detections at each shift, and one more.
    fn find_inside<'a>(&self, feature: &ExpectedFeature, bins: &Bins<Place>, room: &'a mut [u32]) -> &'a [u32] {
        let [x0, y0, x1, y1] = feature.window;
        let middle = DVec2::new(0.5 * (x0 + x1), 0.5 * (y0 + y1));
        let half = DVec2::new(0.5 * (x1 - x0), 0.5 * (y1 - y0));
        let (reach, turn) = (reach(feature), self.turn);
        let mut count = 0;
        for shift in self.shifts(&feature.window) {
            bins.each_near([reach[0] + shift, reach[1], reach[2] + shift, reach[3]], |place| {
                let over = super::distance::unwrap(turn, middle.x, place.centre.x);
                let off = (place.centre + DVec2::new(over, 0.0) - middle).abs();
                // The condition is hard to predict, so the column is always written and only counted if it is inside.
                room[count] = place.column;
                count += usize::from(off.cmple(half + place.extent).all());
            });
        }
        let inside = &mut room[..count];
        if turn.is_none() {
            return inside;
        }
        // A detection may be found from both sides of the seam.
        inside.sort_unstable();
        let mut kept = 0;
        for i in 0..inside.len() {
            if kept == 0 || inside[kept - 1] != inside[i] {
                inside[kept] = inside[i];
                kept += 1;
            }
        }
        &inside[..kept]
    }

    /// Wraps the column into one turn if the image covers 360 degrees.
    fn wrapped(&self, p: DVec2) -> DVec2 {
        match self.turn {
            Some(turn) => DVec2::new(p.x - turn * (p.x / turn).floor(), p.y),
            None => p,
        }
    }

    /// Returns the shifts that move a window to detections within one turn.
    fn shifts(&self, window: &[f64; 4]) -> impl Iterator<Item = f64> + use<> {
        let (x0, turn) = (window[0], self.turn);
        let first = turn.map_or(0.0, |turn| -turn * (x0 / turn).floor());
        [Some(first), turn.map(|turn| first - turn), turn.map(|turn| first + turn)].into_iter().flatten()
    }

    /// Returns true if a detection is within the gate by position alone.
    pub(crate) fn is_near(&self, feature: &ExpectedFeature, detection: &Detection) -> bool {
        compare(feature, detection, self.noise, self.turn, &Gate::new(self.gate_deviate)).is_some()
    }

    fn level(&self) -> Level {
        let gate = Gate::new(self.gate_deviate);
        Level { gate, log_clutter: self.clutter_density.ln(), log_detection: self.detection_probability.ln() }
    }

    /// Cost of a pair; `None` outside the gate.
    fn cost(&self, feature: &ExpectedFeature, detection: &Detection, level: &Level) -> Option<f64> {
        // The position test is the cheapest and rejects the majority of pairs.
        let distance = compare(feature, detection, self.noise, self.turn, &level.gate)?;
        let alike = self.compare_properties(&feature.properties, &detection.properties)?;
        let dimensions = distance.dimensions + alike.dimensions;
        let squared = distance.squared + alike.squared;
        if squared > level.gate.limit(dimensions) {
            return None;
        }
        let target = 0.5 * squared + distance.log_volume + alike.log_volume;
        let clutter = level.log_clutter + distance.log_clutter + alike.log_clutter;
        Some(target + clutter - level.log_detection)
    }

    /// Returns the distance between the properties that both sides know; `None` for two different markers.
    fn compare_properties(&self, expected: &ExpectedProperties, found: &DetectionProperties) -> Option<Distance> {
        if let (Some(a), Some(b)) = (&expected.marker, &found.marker)
            && a != b
        {
            return None;
        }
        let mut all = Distance { squared: 0.0, dimensions: 0, log_volume: 0.0, log_clutter: 0.0 };
        // The variances are multiplied, so that one logarithm suffices.
        let mut volume_squared = 1.0;
        let mut add = |apart: f64, variance: f64| {
            all.squared += apart * apart / variance;
            all.dimensions += 1;
            volume_squared *= 2.0 * PI * variance;
        };
        let noise = &self.properties;
        let told = [
            (&expected.strength, found.strength, noise.strength),
            (&expected.contrast, found.contrast, noise.contrast),
        ];
        for (expected, found, sigma) in told {
            if let (Some(UncertainValue { mean, variance }), Some(found)) = (expected, found) {
                add(found - mean, variance + sigma * sigma);
            }
        }
        if let (Some(UncertainValue { mean, variance }), Some(found)) = (&expected.direction, found.direction) {
            add(turn_apart(found, *mean), variance + noise.direction * noise.direction);
            all.log_clutter = -PI.ln();
        }
        if let (Some(expected), Some(found)) = (&expected.range, &found.range) {
            add(found.mean - expected.mean, expected.variance + found.variance + MIN_DEPTH_SIGMA * MIN_DEPTH_SIGMA);
            all.log_clutter -= DEPTHS.ln();
        }
        all.log_volume = 0.5 * volume_squared.ln();
        Some(all)
    }
}

/// Box that holds the centres of possible detections. A segment may be detected in part, or longer than expected.
fn reach(feature: &ExpectedFeature) -> [f64; 4] {
    let [x0, y0, x1, y1] = feature.window;
    match &feature.shape {
        Shape::Segment { ends, .. } => {
            let more = (ends[1] - ends[0]).abs();
            [x0 - more.x, y0 - more.y, x1 + more.x, y1 + more.y]
        }
        _ => feature.window,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DMat2;

    fn point(x: f64, y: f64) -> ExpectedFeature {
        ExpectedFeature {
            shape: Shape::Point(DVec2::new(x, y)),
            covariances: vec![DMat2::IDENTITY],
            window: [x - 4.0, y - 4.0, x + 4.0, y + 4.0],
            properties: ExpectedProperties::default(),
        }
    }

    #[test]
    fn nearer_is_cheaper_and_far_is_no_candidate() {
        let found: Vec<Detection> =
            [0.0, 1.0, 3.0, 30.0].map(|x| Detection::point(DVec2::new(100.0 + x, 50.0), 1.0)).into();
        let got = Matcher::default().candidates(&[point(100.0, 50.0)], &found);
        assert_eq!(got.pairs.iter().map(|p| p.column).collect::<Vec<_>>(), [0, 1, 2]);
        // The variance is 2 and the squared distance is 1, so the cost differs by 1/2 * 1/2.
        assert!((got.pairs[1].cost - got.pairs[0].cost - 0.25).abs() < 1e-4);
    }

    #[test]
    fn properties_gate_and_weigh() {
        let mut feature = point(100.0, 50.0);
        feature.properties.contrast = Some(UncertainValue { mean: 0.5, variance: 0.0 });
        feature.properties.direction = Some(UncertainValue { mean: 0.01, variance: 0.0 });
        let alike = |contrast: f64, direction: f64| {
            let mut d = Detection::point(DVec2::new(100.0, 50.0), 1.0);
            (d.properties.contrast, d.properties.direction) = (Some(contrast), Some(direction));
            d
        };
        let found = [alike(0.5, 0.01), alike(0.56, 0.01), alike(0.9, 0.01), alike(0.5, 1.0), alike(0.5, PI)];
        let got = Matcher::default().candidates(&[feature], &found);
        let columns: Vec<u32> = got.pairs.iter().map(|p| p.column).collect();
        assert_eq!(columns, [0, 4, 1], "unlike ones are out; directions are modulo pi");
    }

    /// Two detections are in one direction: the one at the expected range is first, one metres away is not a candidate.
    #[test]
    fn ranges_gate_and_weigh() {
        let mut feature = point(100.0, 50.0);
        feature.properties.range = Some(UncertainValue { mean: 3.0, variance: 0.01 });
        let at = |mean: f64| {
            let mut d = Detection::point(DVec2::new(100.0, 50.0), 1.0);
            d.properties.range = Some(UncertainValue { mean, variance: 1e-4 });
            d
        };
        let got = Matcher::default().candidates(&[feature], &[at(3.2), at(5.0), at(3.01)]);
        assert_eq!(got.pairs.iter().map(|p| p.column).collect::<Vec<_>>(), [2, 0]);
        assert_eq!(at(f64::NAN).check(), Err(Rejection::NotFinite));
    }

    #[test]
    fn markers_are_never_taken_for_others() {
        let corners = [DVec2::ZERO, DVec2::X, DVec2::ONE, DVec2::Y].map(|c| 10.0 * c);
        let marker = |code| Some(super::super::Marker { family: "DICT_4X4_50".into(), code });
        let feature = ExpectedFeature {
            shape: Shape::Fiducial(corners),
            covariances: vec![DMat2::IDENTITY; 4],
            window: [-4.0, -4.0, 14.0, 14.0],
            properties: ExpectedProperties { marker: marker(3), ..ExpectedProperties::default() },
        };
        let mut other = Detection::new(Shape::Fiducial(corners), 1.0);
        other.properties.marker = marker(4);
        let mut own = other.clone();
        own.properties.marker = marker(3);
        let got = Matcher::default().candidates(&[feature], &[other, own]);
        assert_eq!(got.pairs.iter().map(|p| p.column).collect::<Vec<_>>(), [1]);
    }

    #[test]
    fn the_seam_is_no_border() {
        let matcher = Matcher { turn: Some(720.0), ..Matcher::default() };
        for x in [719.5, -0.5] {
            for column in [719.0, -1.0, 0.0, 720.0] {
                let got = matcher.candidates(&[point(x, 50.0)], &[Detection::point(DVec2::new(column, 50.0), 1.0)]);
                assert_eq!(got.pairs.len(), 1, "{x} {column}");
            }
        }
    }

    #[test]
    fn thousands_in_one_window_leave_the_nearest() {
        let found: Vec<Detection> =
            (0..5000).map(|i| Detection::point(DVec2::new(100.0 + f64::from(i) * 2e-4, 50.0), 1.0)).collect();
        let got = Matcher::default().candidates(&[point(100.0, 50.0)], &found);
        assert_eq!(got.pairs.len(), MAX_CANDIDATES);
        assert_eq!(got.pairs[0].column, 0);
    }

    #[test]
    fn what_is_not_finite_is_rejected() {
        let bad = [
            Detection::point(DVec2::new(f64::NAN, 0.0), 1.0),
            Detection::point(DVec2::new(100.0, 50.0), f64::INFINITY),
            Detection::point(DVec2::new(1e300, 50.0), 1.0),
            Detection::segment([DVec2::new(100.0, 50.0); 2], 1.0),
            Detection {
                covariance: DMat2::from_cols_array(&[1.0, 2.0, 2.0, 1.0]),
                ..Detection::point(DVec2::new(100.0, 50.0), 1.0)
            },
        ];
        let got = Matcher::default().candidates(&[point(100.0, 50.0)], &bad);
        let why: Vec<Rejection> = got.rejected.iter().map(|(_, why)| *why).collect();
        assert!(got.pairs.is_empty());
        let (not_finite, degenerate) = (Rejection::NotFinite, Rejection::Degenerate);
        assert_eq!(why, [not_finite, not_finite, not_finite, degenerate, Rejection::Covariance]);
    }
}
