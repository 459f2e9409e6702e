//! Scanners: azimuth by elevation on a sphere (laser scanners, lidars, scanning radars).

use super::grid::{LineAxis, LineGrid, PixelGrid};
use crate::error::{Error, Result};
use crate::limits;
use glam::{DMat3, DVec3};

/// Beam angles in degrees, as in files. Degrees represent the common values exactly; radians would round them.
#[derive(Clone, Debug, PartialEq)]
pub enum Angles {
    /// `start + i * step`.
    Uniform {
        /// Angle of beam 0, degrees.
        start_deg: f64,
        /// Degrees; either sign for azimuth.
        step_deg: f64,
        /// Number of beams.
        count: u32,
    },
    /// Any angles, degrees.
    Listed(Vec<f64>),
}

impl Angles {
    /// Number of beams.
    #[inline]
    pub fn len(&self) -> usize {
        match self {
            Self::Uniform { count, .. } => *count as usize,
            Self::Listed(angles) => angles.len(),
        }
    }

    /// True if there are no beams.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Mean angle from beam to beam, degrees, of either sign; 0 for fewer than two beams.
    pub fn mean_step(&self) -> f64 {
        match self {
            Self::Uniform { step_deg, count: 2.., .. } => *step_deg,
            Self::Listed(angles) if angles.len() > 1 => {
                (angles[angles.len() - 1] - angles[0]) / (angles.len() - 1) as f64
            }
            _ => 0.0,
        }
    }

    /// True if the last beam has the direction of the first, one turn on, within [`SAME_ANGLE`].
    fn is_closed(&self) -> bool {
        let (step, count) = (self.mean_step().abs(), self.len());
        step.is_normal() && (step * (count - 1) as f64 - 360.0).abs() <= SAME_ANGLE * step
    }

    /// Azimuths whose last beam is exactly one turn on from the first if the two have one direction.
    pub(super) fn closed(self) -> Self {
        if !self.is_closed() {
            return self;
        }
        match self {
            Self::Uniform { start_deg, step_deg, count } => {
                Self::Uniform { start_deg, step_deg: 360f64.copysign(step_deg) / f64::from(count - 1), count }
            }
            Self::Listed(mut angles) => {
                let turn = 360f64.copysign(angles[angles.len() - 1] - angles[0]);
                let last = angles.len() - 1;
                angles[last] = angles[0] + turn;
                Self::Listed(angles)
            }
        }
    }

    /// Angle of beam `i`, degrees.
    #[inline]
    pub fn degrees(&self, i: usize) -> f64 {
        match self {
            Self::Uniform { start_deg, step_deg, .. } => start_deg + i as f64 * step_deg,
            Self::Listed(angles) => angles[i],
        }
    }
}

/// A scanner with azimuth columns (counter-clockwise about +z, zero at +x) and elevation rows (falling elevation).
#[derive(Clone, Debug, PartialEq)]
pub struct Scanner {
    /// Column i is azimuth beam i.
    pub azimuth: Angles,
    /// Elevations in any order. Image rows are sorted by falling elevation.
    pub elevation: Angles,
    /// Height of a beam, degrees: a row sees features up to half of it above and below. `None` means the row step, or 0
    /// if there is one row.
    pub beam_height_deg: Option<f64>,
}

/// Directions that are at most this part of the mean step apart are one: drivers round their angles.
pub const SAME_ANGLE: f64 = 1e-3;

/// Degrees. Closer azimuths have no representable separating line between them.
const MIN_STEP: f64 = 1e-9;

impl Scanner {
    /// Elevations of the rows, falling, degrees.
    pub fn rows_deg(&self) -> Vec<f64> {
        let mut rows: Vec<f64> = (0..self.elevation.len()).map(|i| self.elevation.degrees(i)).collect();
        rows.sort_by(|a, b| b.total_cmp(a));
        rows
    }

    /// Number of columns of a full turn, if the last column is next to the first: nearer than two steps, the widest
    /// ones.
    pub(super) fn columns_of_a_turn(&self) -> Option<f64> {
        match &self.azimuth {
            Angles::Uniform { step_deg, count, .. } => {
                let turn = 360.0 / step_deg.abs();
                (*count > 1 && f64::from(*count) > turn - 1.0 + 1e-6).then_some(turn)
            }
            Angles::Listed(angles) => {
                let [first, .., last] = angles[..] else { return None };
                let widest = angles.array_windows().map(|[a, b]| (b - a).abs()).fold(0.0, f64::max);
                let distinct = angles.len() - usize::from(self.azimuth.is_closed());
                (360.0 - (last - first).abs() < 2.0 * widest).then_some(distinct as f64)
            }
        }
    }

    /// Checks that columns go round at most once, in one direction. Then only the first direction may occur again, as
    /// the last, and an interval of angles is an interval of columns.
    fn check_azimuths(&self, azimuths: &[f64]) -> Result<()> {
        let [first, .., last] = azimuths else { return Ok(()) };
        let rising = last > first;
        if let Angles::Listed(_) = self.azimuth
            && !azimuths.windows(2).all(|pair| if rising { pair[0] < pair[1] } else { pair[0] > pair[1] })
        {
            return Err(Error::invalid("the azimuths listed are not in order", "list them all rising or all falling"));
        }
        if let Some([a, b]) = azimuths.array_windows().find(|[a, b]| !((b - a).abs() >= MIN_STEP)) {
            return Err(Error::invalid(
                format!("azimuths {a:e} and {b:e} deg are too close together"),
                "keep them 1e-6 deg apart",
            ));
        }
        if last == first || !(self.azimuth.is_closed() || (last - first).abs() < 360.0) {
            return Err(Error::invalid(
                format!("azimuths from {first} to {last} deg, {} of them", azimuths.len()),
                "give a step that goes round at most once",
            ));
        }
        Ok(())
    }

    pub(super) fn grid(&self) -> Result<PixelGrid> {
        let (n, m) = (self.azimuth.len(), self.elevation.len());
        debug_assert!(n <= limits::MAX_IMAGE_SIDE as usize && m <= limits::MAX_IMAGE_SIDE as usize);
        let azimuths: Vec<f64> = (0..n).map(|i| self.azimuth.degrees(i)).collect();
        let rows = self.rows_deg();
        if let Some(bad) = azimuths.iter().find(|a| !(a.abs() <= 1e6)) {
            return Err(Error::invalid(format!("azimuth of {bad} deg"), "give finite degrees"));
        }
        if let Some(bad) = rows.iter().find(|e| !(e.abs() <= 90.0)) {
            return Err(Error::invalid(
                format!("elevation of {bad} deg is outside -90..=90"),
                "give degrees above the horizontal",
            ));
        }
        if let Some(pair) = rows.windows(2).find(|pair| pair[0] == pair[1]) {
            return Err(Error::invalid(format!("elevation {} deg occurs twice", pair[0]), "give every elevation once"));
        }
        self.check_azimuths(&azimuths)?;
        let height = self.beam_height_deg.unwrap_or(0.0);
        if !(height >= 0.0 && height.is_finite()) {
            return Err(Error::invalid(format!("beam_height of {height} deg"), "give finite degrees of at least 0"));
        }
        let weights: Vec<[f64; 2]> = rows
            .iter()
            .map(|&e| {
                let [cos, sin] = cos_sin_deg(e);
                // abs: the cosine of 90 degrees may be -0, which would put the zenith below the nadir.
                [cos.abs(), -sin]
            })
            .collect();
        let too_close = |i: &usize| !(weights[*i][1] / weights[*i][0] < weights[i + 1][1] / weights[i + 1][0]);
        if let Some(i) = (0..m.saturating_sub(1)).find(too_close) {
            return Err(Error::invalid(
                format!("elevations {} and {} deg are too close together", rows[i], rows[i + 1]),
                "keep them 1e-6 deg apart",
            ));
        }
        let mut lines: Vec<[f64; 2]> = azimuths.iter().map(|&a| cos_sin_deg(a)).collect();
        if self.azimuth.is_closed() {
            // With other bits one of the two beams could miss a polygon near its edge.
            lines[n - 1] = lines[0];
        }
        // Line frame: (x, y, -z), so that the sample position -tan(elevation) rises with the row.
        let frame = DMat3::from_diagonal(DVec3::new(1.0, 1.0, -1.0));
        Ok(PixelGrid::Lines(LineGrid::new(LineAxis::Columns, frame, lines, weights)))
    }
}

/// Cosine and sine of an angle in degrees, exact at multiples of 90 and never -0 there: a pole's w1 / w0 is infinite,
/// with the sign of w1.
pub(super) fn cos_sin_deg(degrees: f64) -> [f64; 2] {
    let quarter = (degrees / 90.0).round();
    // The subtraction is exact: its result is a multiple of the last place of `degrees` and not larger.
    let (sin, cos) = (degrees - 90.0 * quarter).to_radians().sin_cos();
    let [x, y] = match quarter.rem_euclid(4.0) as u32 {
        0 => [cos, sin],
        1 => [-sin, cos],
        2 => [-cos, -sin],
        _ => [sin, -cos],
    };
    [x + 0.0, y + 0.0]
}

#[cfg(test)]
mod tests {
    use super::*;

    use crate::sensor::{Geometry, Sensor, SensorSpec};
    use proptest::prelude::*;

    fn uniform(start_deg: f64, step_deg: f64, count: u32) -> Angles {
        Angles::Uniform { start_deg, step_deg, count }
    }

    fn sensor(azimuth: Angles, elevation: Angles) -> Result<Sensor> {
        let scanner = Scanner { azimuth, elevation, beam_height_deg: None };
        Sensor::new(SensorSpec::new("s", "laser", Geometry::Scanner(scanner)))
    }

    #[test]
    fn quarter_turns_are_exact() {
        assert_eq!(cos_sin_deg(-180.0), [-1.0, 0.0]);
        assert_eq!(cos_sin_deg(90.0), [0.0, 1.0]);
        assert_eq!(cos_sin_deg(-90.0), [0.0, -1.0]);
        let [c, s] = cos_sin_deg(37.5);
        assert!((c - 37.5f64.to_radians().cos()).abs() < 1e-15);
        assert!((s - 37.5f64.to_radians().sin()).abs() < 1e-15);
    }

    #[test]
    fn zeros_have_no_sign() {
        for quarter in -8..=8 {
            for x in cos_sin_deg(90.0 * f64::from(quarter)) {
                assert!(x != 0.0 || x.is_sign_positive(), "{quarter} quarter turns");
            }
        }
    }

    #[test]
    fn poles_are_the_first_and_the_last_row() {
        let s = sensor(uniform(-180.0, 90.0, 4), Angles::Listed(vec![0.0, -90.0, 90.0])).unwrap();
        for column in 0..4 {
            assert_eq!(s.ray(column, 0), Some(DVec3::Z));
            assert_eq!(s.ray(column, 2), Some(DVec3::NEG_Z));
        }
        let PixelGrid::Lines(grid) = s.grid() else { panic!("no lines") };
        assert_eq!(grid.positions(), [f64::NEG_INFINITY, 0.0, f64::INFINITY]);
        assert_eq!(s.ray(0, 1), Some(DVec3::NEG_X));
        assert_eq!(s.ray(1, 1), Some(DVec3::NEG_Y));
        assert_eq!(s.ray(4, 1), None);
        assert_eq!(s.ray(0, 3), None);
    }

    #[test]
    fn a_direction_twice_is_refused() {
        let one = || uniform(0.0, 0.0, 1);
        let refused = [
            sensor(uniform(-180.0, 1.0, 362), one()),
            sensor(uniform(180.0, -1.0, 362), one()),
            sensor(uniform(0.0, 1.001 * 360.0 / 7.0, 8), one()),
            sensor(uniform(0.0, 1.0, 1000), one()),
            sensor(uniform(0.0, 0.0, 2), one()),
            sensor(Angles::Listed(vec![-180.0, 0.0, 181.0]), one()),
            sensor(Angles::Listed(vec![0.0, 20.0, 10.0]), one()),
            sensor(Angles::Listed(vec![0.0, f64::NAN]), one()),
            sensor(Angles::Listed(vec![0.0, f64::INFINITY]), one()),
            sensor(uniform(0.0, f64::INFINITY, 2), one()),
            sensor(uniform(0.0, 5e-324, 3), one()),
            sensor(uniform(1e5, 1e-11, 3), one()),
            sensor(one(), uniform(1.0, 0.0, 2)),
            sensor(one(), Angles::Listed(vec![0.0, 5.0, -0.0])),
            sensor(one(), Angles::Listed(vec![1e-323, 5e-324])),
            sensor(one(), uniform(-90.0, 1.0, 182)),
        ];
        for (i, result) in refused.into_iter().enumerate() {
            assert!(result.is_err(), "{i}");
        }
        assert!(sensor(uniform(-180.0, 1.0, 360), uniform(-90.0, 1.0, 181)).is_ok());
        assert!(sensor(uniform(180.0, -1.0, 360), uniform(90.0, -1.0, 181)).is_ok());
        assert!(sensor(Angles::Listed(vec![30.0, 0.0, -3.0]), one()).is_ok());
    }

    /// Drivers that go fully round deliver the first direction again as the last, exactly or rounded: TurtleBot3 to
    /// 6.28318977 radians, others from -pi to pi in f32.
    #[test]
    fn a_last_beam_one_turn_on_has_the_first_ones_direction() {
        let one = || uniform(0.0, 0.0, 1);
        let listed = |last: f64| Angles::Listed((0..9).map(|i| 37.0 * f64::from(i)).chain([last]).collect());
        let tb3 = 6.283_189_77f64.to_degrees();
        let pi = f64::from(std::f32::consts::PI).to_degrees();
        for (azimuth, columns) in [
            (uniform(-180.0, 1.0, 361), 360),
            (uniform(180.0, -1.0, 361), 360),
            (uniform(0.0, 360.0 / 7.0, 8), 7),
            (uniform(0.0, tb3 / 359.0, 360), 359),
            (uniform(-pi, 2.0 * pi / 719.0, 720), 719),
            (uniform(0.0, 359.999_999_9 / 719.0, 720), 719),
            (listed(360.0), 9),
            (listed(360.03), 9),
            (listed(359.97), 9),
        ] {
            let s = sensor(azimuth.clone(), one()).unwrap();
            assert_eq!((s.width(), s.distinct_columns()), (columns + 1, columns), "{azimuth:?}");
            assert_eq!(s.ray(0, 0), s.ray(columns, 0), "{azimuth:?}");
            // A file with this specification gives the same sensor.
            assert_eq!(Sensor::new(s.spec().clone()).unwrap().spec(), s.spec(), "{azimuth:?}");
        }
        for azimuth in [uniform(-180.0, 1.0, 360), listed(359.0), uniform(0.0, 0.998 * 360.0 / 7.0, 8), one()] {
            let s = sensor(azimuth.clone(), one()).unwrap();
            assert_eq!(s.distinct_columns(), s.width(), "{azimuth:?}");
        }
    }

    proptest! {
        #[test]
        fn rays_are_the_textbooks(
            start in -360.0..360.0f64, step in prop_oneof![-3.0..-0.01f64, 0.01..3.0f64], columns in 1..100u32,
            listed in prop::collection::vec(-90.0..=90.0f64, 1..20),
        ) {
            let mut falling = listed.clone();
            falling.sort_by(|a, b| b.total_cmp(a));
            prop_assume!(falling.windows(2).all(|w| w[0] - w[1] > 1e-5));
            let s = sensor(uniform(start, step, columns), Angles::Listed(listed)).unwrap();
            let PixelGrid::Lines(grid) = s.grid() else { return Err(TestCaseError::fail("no lines")) };
            prop_assert!(grid.positions().windows(2).all(|t| t[0] < t[1]));
            for column in [0, columns / 2, columns - 1] {
                for (row, elevation) in falling.iter().enumerate() {
                    let row = row as u32;
                    let ray = s.ray(column, row).unwrap();
                    // Reduced exactly first: sin_cos of 300 degrees in radians is off by more than the bound.
                    let azimuth = (start + f64::from(column) * step) % 360.0;
                    let azimuth = if azimuth.abs() > 180.0 { azimuth - 360.0f64.copysign(azimuth) } else { azimuth };
                    let ((sa, ca), (se, ce)) = (azimuth.to_radians().sin_cos(), elevation.to_radians().sin_cos());
                    prop_assert!(ray.distance(DVec3::new(ce * ca, ce * sa, se)) < 1e-15, "{} {}", column, row);
                    let (line, sample) = grid.line_sample(column, row);
                    let of_line = grid.image_from_line() * grid.line_ray(line, sample);
                    prop_assert!(of_line.distance(ray) < 1e-15);
                    let [w0, w1] = grid.weights()[sample];
                    prop_assert!(w0 >= 0.0 && grid.positions()[sample] == w1 / w0);
                }
            }
        }
    }
}
