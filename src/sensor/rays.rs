//! Free ray tables.

use crate::error::{Error, Result};
use glam::DVec3;

/// Ray directions of a single-centre sensor, row-major, body axes.
#[derive(Clone, Debug, PartialEq)]
pub struct RayTable {
    width: u32,
    height: u32,
    directions: Vec<DVec3>,
}

impl RayTable {
    /// Directions need not have unit length; a NaN direction is no ray.
    ///
    /// # Errors
    /// [`crate::ErrorKind::Invalid`] if their number is not width x height, or one has no length or is infinite.
    pub fn new(width: u32, height: u32, directions: Vec<DVec3>) -> Result<Self> {
        if directions.len() as u64 != u64::from(width) * u64::from(height) {
            return Err(Error::invalid(
                format!("{} directions for {width} x {height} pixels", directions.len()),
                "give one direction a pixel, row by row",
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
                    "give a finite direction with a length, or NaN for no ray",
                ));
            }
            *d = (*d / longest).normalize();
        }
        Ok(Self { width, height, directions: unit })
    }

    /// Columns.
    pub fn width(&self) -> u32 {
        self.width
    }

    /// Rows.
    pub fn height(&self) -> u32 {
        self.height
    }

    /// Unit directions, row-major, body axes; NaN is no ray.
    pub fn directions(&self) -> &[DVec3] {
        &self.directions
    }
}
