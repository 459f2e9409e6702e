//! Cameras: pinhole intrinsics and lens distortion, in OpenCV's conventions.

use super::distortion::Distortion;
use super::grid::{LineAxis, LineGrid, PixelGrid, RayGrid};
use crate::error::{Error, Result};
use glam::{DMat3, DVec3};

/// A camera; pixel (0, 0) is the *centre* of the top-left pixel.
#[derive(Clone, Debug, PartialEq)]
pub struct Camera {
    /// Columns.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// Focal length in pixels along x.
    pub fx: f64,
    /// Focal length in pixels along y.
    pub fy: f64,
    /// Principal point, pixels.
    pub cx: f64,
    /// Principal point, pixels.
    pub cy: f64,
    /// Lens distortion.
    pub distortion: Distortion,
}

impl Camera {
    /// A camera without distortion.
    pub fn pinhole(width: u32, height: u32, fx: f64, fy: f64, cx: f64, cy: f64) -> Self {
        Self { width, height, fx, fy, cx, cy, distortion: Distortion::None }
    }

    /// Normalized image coordinates of a pixel, before undistortion.
    pub fn normalized(&self, u: f64, v: f64) -> (f64, f64) {
        ((u - self.cx) / self.fx, (v - self.cy) / self.fy)
    }

    /// The pixel that a point of the optical frame is imaged at (also outside the image), or `None`: see
    /// [`Distortion::distort`].
    pub fn project(&self, p_in_optical: DVec3) -> Option<(f64, f64)> {
        let (xd, yd) = self.distortion.distort(p_in_optical)?;
        Some((self.fx * xd + self.cx, self.fy * yd + self.cy))
    }

    pub(super) fn grid(&self) -> Result<PixelGrid> {
        let intrinsics = [self.fx, self.fy, self.cx, self.cy];
        if !(intrinsics.iter().all(|x| x.is_finite()) && self.fx > 0.0 && self.fy > 0.0) {
            return Err(Error::invalid(
                format!("intrinsics fx, fy, cx, cy = {intrinsics:?}"),
                "give finite numbers in pixels, fx and fy positive",
            ));
        }
        self.distortion.check()?;
        if self.distortion.is_none() {
            return Ok(PixelGrid::Lines(self.line_grid()));
        }
        let lens = self.distortion.lens();
        let mut directions = Vec::with_capacity(self.width as usize * self.height as usize);
        for row in 0..self.height {
            for column in 0..self.width {
                let (xd, yd) = self.normalized(f64::from(column), f64::from(row));
                let ray = lens.undistort(xd, yd).map(DVec3::normalize);
                directions.push(ray.unwrap_or(DVec3::NAN));
            }
        }
        Ok(PixelGrid::Rays(RayGrid::new(self.width, self.height, directions)))
    }

    /// Lines are image rows; the line frame is (fy y, z, fx x) of the optical frame, so that t = u - cx.
    fn line_grid(&self) -> LineGrid {
        let lines = (0..self.height).map(|v| [f64::from(v) - self.cy, 1.0]).collect();
        let samples: Vec<f64> = (0..self.width).map(|u| f64::from(u) - self.cx).collect();
        LineGrid::new(
            LineAxis::Rows,
            DMat3::from_cols(DVec3::new(0.0, 0.0, self.fx), DVec3::new(self.fy, 0.0, 0.0), DVec3::new(0.0, 1.0, 0.0)),
            lines,
            samples.iter().map(|&t| [1.0, t]).collect(),
        )
    }
}
