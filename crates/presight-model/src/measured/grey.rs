//! Grey images.

use crate::error::{Error, Result};
use glam::DVec2;

/// A grey image, 0 black and 1 white, row by row. NaN means no measurement.
#[derive(Clone, Debug, PartialEq)]
pub struct GreyImage {
    width: u32,
    height: u32,
    values: Vec<f32>,
}

impl GreyImage {
    /// Makes an image from its values.
    ///
    /// # Errors
    /// [`crate::ErrorKind::Invalid`] if there is not one value for each pixel, or one is infinite.
    pub fn new(width: u32, height: u32, values: Vec<f32>) -> Result<Self> {
        if values.len() as u64 != u64::from(width) * u64::from(height) {
            let what = format!("{} grey values for {width} x {height} pixels", values.len());
            return Err(Error::invalid(what, "give one value per pixel, row by row"));
        }
        if let Some(at) = values.iter().position(|v| v.is_infinite()) {
            let what = format!("pixel {},{} is {}", at % width as usize, at / width as usize, values[at]);
            return Err(Error::invalid(what, "give grey values from 0 to 1, or NaN for none"));
        }
        Ok(Self { width, height, values })
    }

    /// Columns.
    pub fn width(&self) -> u32 {
        self.width
    }

    /// Rows.
    pub fn height(&self) -> u32 {
        self.height
    }

    /// Row by row.
    pub fn values(&self) -> &[f32] {
        &self.values
    }

    /// One pixel's value. Panics outside of the image.
    pub fn pixel(&self, column: u32, row: u32) -> f32 {
        self.values[row as usize * self.width as usize + column as usize]
    }

    /// Bilinear interpolation at a place (column, row). NaN outside of the image and next to an unmeasured pixel.
    pub fn at(&self, place: DVec2) -> f64 {
        let (w, h) = (self.width as usize, self.height as usize);
        if !(place.x >= 0.0 && place.y >= 0.0 && place.x <= w as f64 - 1.0 && place.y <= h as f64 - 1.0) {
            return f64::NAN;
        }
        let (c, r) = (place.x as usize, place.y as usize);
        let (x, y) = (place.x - c as f64, place.y - r as f64);
        let (c1, r1) = ((c + 1).min(w - 1), (r + 1).min(h - 1));
        let v = |c: usize, r: usize| f64::from(self.values[r * w + c]);
        (1.0 - y) * ((1.0 - x) * v(c, r) + x * v(c1, r)) + y * ((1.0 - x) * v(c, r1) + x * v(c1, r1))
    }

    /// Adds the values at `first`, one `step` further, and so on to the sums. NaN outside, as for [`GreyImage::at`].
    pub fn add_along(&self, first: DVec2, step: DVec2, sums: &mut [f64]) {
        let (w, h) = (self.width as usize, self.height as usize);
        let last = DVec2::new(w as f64 - 1.0, h as f64 - 1.0);
        for (k, sum) in sums.iter_mut().enumerate() {
            let p = first + k as f64 * step;
            if !(p.x >= 0.0 && p.y >= 0.0 && p.x < last.x && p.y < last.y) {
                *sum += self.at(p);
                continue;
            }
            let (c, r) = (p.x as usize, p.y as usize);
            let (x, y) = (p.x - c as f64, p.y - r as f64);
            let [above, below] = [r, r + 1].map(|r| &self.values[r * w + c..r * w + c + 2]);
            let between = |pair: &[f32]| f64::from(pair[0]) + x * (f64::from(pair[1]) - f64::from(pair[0]));
            let (above, below) = (between(above), between(below));
            *sum += above + y * (below - above);
        }
    }
}
