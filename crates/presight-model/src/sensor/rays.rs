//! Arbitrary ray tables.

use super::BeamTable;
use crate::error::{Error, Result};
use glam::DVec3;
use std::sync::Arc;

/// Largest distance of the origin of a ray from the origin of its sensor along each axis, metres: no housing is larger.
pub const MAX_ORIGIN: f64 = 2.0;

/// True for a finite origin within [`MAX_ORIGIN`]. The largest element of a vector is no NaN if another one is a number.
pub(super) fn is_near(origin: DVec3) -> bool {
    origin.is_finite() && origin.abs().max_element() <= MAX_ORIGIN
}

/// Rays, row-major, body axes. They start at the origin of the sensor, or each at its own point.
#[derive(Clone, Debug)]
pub struct RayTable {
    width: u32,
    height: u32,
    directions: Vec<DVec3>,
    origins: Option<Vec<DVec3>>,
    /// Points at which rays leave the sensor, if their ranges count from other ones.
    starts: Option<Vec<DVec3>>,
    /// What the rays were made from, if they are those of a spinning sensor.
    beams: Option<Arc<BeamTable>>,
}

/// Two pixels without a ray compare as equal, although NaN is not equal to itself.
impl PartialEq for RayTable {
    fn eq(&self, other: &Self) -> bool {
        let same = |(a, b): (&DVec3, &DVec3)| a == b || (a.is_nan() && b.is_nan());
        (self.width, self.height) == (other.width, other.height)
            && self.directions.len() == other.directions.len()
            && self.origins == other.origins
            && self.directions.iter().zip(&other.directions).all(same)
    }
}

impl RayTable {
    /// Makes a table of directions of any length. A NaN direction means that the pixel has no ray.
    ///
    /// # Errors
    /// [`crate::ErrorKind::Invalid`] if their number is not width x height, or a direction has zero length or is
    /// infinite.
    pub fn new(width: u32, height: u32, directions: Vec<DVec3>) -> Result<Self> {
        if directions.len() as u64 != u64::from(width) * u64::from(height) {
            return Err(Error::invalid(
                format!("{} directions for {width} x {height} pixels", directions.len()),
                "give one direction per pixel, row by row",
            ));
        }
        let mut unit = directions;
        for (i, d) in unit.iter_mut().enumerate() {
            if d.is_nan() {
                *d = DVec3::NAN;
                continue;
            }
            let longest = d.abs().max_element();
            if !(longest > 0.0 && longest.is_finite()) {
                return Err(Error::invalid(
                    format!("direction {i} is {d}"),
                    "give a finite nonzero direction, or NaN for no ray",
                ));
            }
            // Unit directions keep their bits, so that a table written to a file reads back equal.
            if (d.length_squared() - 1.0).abs() > 1e-15 {
                *d = (*d / longest).normalize();
            }
        }
        Ok(Self { width, height, directions: unit, origins: None, starts: None, beams: None })
    }

    /// Rays that start beside the origin of the sensor: an origin for each ray, metres, body axes. Zero for all rays
    /// equals none.
    ///
    /// # Errors
    /// [`crate::ErrorKind::Invalid`] if their number is not width x height, or one is not finite or beyond
    /// 2 m along an axis.
    pub fn with_origins(self, origins: Vec<DVec3>) -> Result<Self> {
        if origins.len() != self.directions.len() {
            let what = format!("{} origins for {} x {} rays", origins.len(), self.width, self.height);
            return Err(Error::invalid(what, "give one origin per ray, row by row"));
        }
        if let Some(at) = origins.iter().position(|o| !is_near(*o)) {
            let what = format!("an origin at {} m", origins[at]);
            let remedy = format!("give metres from the sensor's own origin, at most {MAX_ORIGIN} along each axis");
            return Err(Error::invalid(what, remedy).at(format!("ray {at}")));
        }
        let origins = origins.iter().any(|o| *o != DVec3::ZERO).then_some(origins);
        Ok(Self { origins, starts: None, beams: None, ..self })
    }

    /// The point from which the range of each ray is measured, metres, row-major, body axes; `None` if that is the
    /// origin of the sensor for all. A measured point is this one plus range times direction.
    pub fn origins(&self) -> Option<&[DVec3]> {
        self.origins.as_deref()
    }

    /// The beams of a spinning sensor from which [`RayTable::of_beams`] made the rays.
    pub fn beams(&self) -> Option<&BeamTable> {
        self.beams.as_deref()
    }

    /// The point at which each ray leaves the sensor, metres, row-major, body axes; `None` if that is the origin of the
    /// sensor for all. It lies [`RayTable::range_lead`] ahead of the ray's origin, with the same bits for all rays that
    /// share it.
    pub fn starts(&self) -> Option<&[DVec3]> {
        self.starts.as_deref().or(self.origins.as_deref())
    }

    /// Metres along each ray from its origin to where it leaves the sensor: see [`BeamTable::range_lead`].
    pub fn range_lead(&self) -> f64 {
        if self.starts.is_some() { self.beams().map_or(0.0, |beams| beams.range_lead) } else { 0.0 }
    }

    pub(super) fn with_beams(self, beams: Arc<BeamTable>, starts: Vec<DVec3>) -> Self {
        let starts = (beams.range_lead != 0.0).then_some(starts);
        Self { beams: Some(beams), starts, ..self }
    }

    /// Columns.
    pub fn width(&self) -> u32 {
        self.width
    }

    /// Rows.
    pub fn height(&self) -> u32 {
        self.height
    }

    /// Unit directions, row-major, body axes; NaN means no ray.
    pub fn directions(&self) -> &[DVec3] {
        &self.directions
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn faulty_directions_are_refused() {
        for bad in [DVec3::ZERO, DVec3::new(f64::INFINITY, 0.0, 0.0), DVec3::new(0.0, 0.0, f64::NEG_INFINITY)] {
            let e = RayTable::new(1, 2, vec![DVec3::X, bad]).unwrap_err();
            assert!(e.to_string().contains("direction 1"), "{e}");
        }
        assert!(RayTable::new(2, 2, vec![DVec3::X; 3]).is_err());
        assert!(RayTable::new(u32::MAX, u32::MAX, vec![DVec3::X]).is_err());
    }

    proptest! {
        #[test]
        fn directions_are_unit_and_making_them_so_twice_changes_no_bit(
            x in -1.0..1.0f64, y in -1.0..1.0f64, z in 0.001..1.0f64, e in -300..300i32,
        ) {
            let d = DVec3::new(x, y, z);
            let once = RayTable::new(1, 1, vec![d * 10f64.powi(e)]).unwrap();
            let u = once.directions()[0];
            prop_assert!((u.length() - 1.0).abs() < 1e-15 && u.distance(d.normalize()) < 1e-14);
            let twice = RayTable::new(1, 1, vec![u]).unwrap();
            prop_assert_eq!(u, twice.directions()[0]);
        }
    }
}
