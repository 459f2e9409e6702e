//! Scanners: azimuth by elevation on a sphere (laser scanners, lidars, scanning radars).

use super::grid::{LineAxis, LineGrid, PixelGrid};
use crate::error::{Error, Result};
use crate::limits;
use glam::{DMat3, DVec3};

/// Beam angles in degrees, as files give them: degrees keep 0.1 and 90 exact where radians do not.
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

    /// Angle of beam `i`, degrees.
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
    /// In any order; image rows are sorted by falling elevation.
    pub elevation: Angles,
    /// How far off a row a feature still counts, degrees; `None` is the step, or 0 for one row.
    pub beam_height_deg: Option<f64>,
}

impl Scanner {
    /// Elevations as rows have them: falling, degrees.
    pub fn rows_deg(&self) -> Vec<f64> {
        let mut rows: Vec<f64> = (0..self.elevation.len()).map(|i| self.elevation.degrees(i)).collect();
        rows.sort_by(|a, b| b.total_cmp(a));
        rows
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
            return Err(Error::invalid(
                format!("elevation {} deg is there twice", pair[0]),
                "give every elevation once",
            ));
        }
        if let Angles::Uniform { step_deg, count, .. } = self.azimuth
            && count > 1
            && (step_deg == 0.0 || step_deg.abs() * f64::from(count - 1) >= 360.0)
        {
            return Err(Error::invalid(
                format!("azimuth step of {step_deg} deg, {count} times"),
                "give a step that goes round less than once",
            ));
        }
        // Line frame: (x, y, -z), so that the sample position -tan(elevation) rises with the row.
        Ok(PixelGrid::Lines(LineGrid::new(
            LineAxis::Columns,
            DMat3::from_diagonal(DVec3::new(1.0, 1.0, -1.0)),
            azimuths.iter().map(|&a| cos_sin_deg(a)).collect(),
            rows.iter()
                .map(|&e| {
                    let [cos, sin] = cos_sin_deg(e);
                    // abs: the cosine of 90 degrees may be -0, which would put the zenith below the nadir.
                    [cos.abs(), -sin]
                })
                .collect(),
        )))
    }
}

/// Cosine and sine of an angle in degrees, exact at multiples of 90.
fn cos_sin_deg(degrees: f64) -> [f64; 2] {
    let turned = degrees.rem_euclid(360.0);
    let quarter = (turned / 90.0).round();
    let (sin, cos) = (turned - 90.0 * quarter).to_radians().sin_cos();
    match quarter as u32 % 4 {
        0 => [cos, sin],
        1 => [-sin, cos],
        2 => [-cos, -sin],
        _ => [sin, -cos],
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quarter_turns_are_exact() {
        assert_eq!(cos_sin_deg(-180.0), [-1.0, 0.0]);
        assert_eq!(cos_sin_deg(90.0), [0.0, 1.0]);
        assert_eq!(cos_sin_deg(-90.0), [0.0, -1.0]);
        let [c, s] = cos_sin_deg(37.5);
        assert!((c - 37.5f64.to_radians().cos()).abs() < 1e-15);
        assert!((s - 37.5f64.to_radians().sin()).abs() < 1e-15);
    }
}
