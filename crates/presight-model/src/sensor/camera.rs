//! Cameras: pinhole intrinsics and lens distortion, in OpenCV's conventions.

use super::distortion::Distortion;
use super::grid::{LineAxis, LineGrid, PixelGrid};
use super::ray_grid::RayGrid;
use crate::error::{Error, Result};
use crate::memory;
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
    #[inline]
    pub fn normalized(&self, u: f64, v: f64) -> (f64, f64) {
        ((u - self.cx) / self.fx, (v - self.cy) / self.fy)
    }

    /// Projects a point of the optical frame to pixel coordinates, which may lie outside the image. Returns `None` as
    /// [`Distortion::distort`] does.
    #[inline]
    pub fn project(&self, p_in_optical: DVec3) -> Option<(f64, f64)> {
        let (xd, yd) = self.distortion.distort(p_in_optical)?;
        Some((self.fx * xd + self.cx, self.fy * yd + self.cy))
    }

    pub(super) fn grid(&self) -> Result<PixelGrid> {
        let intrinsics = [self.fx, self.fy, self.cx, self.cy];
        // The bounds keep the determinant of the line frame far from overflow.
        if !(intrinsics.iter().all(|x| x.abs() <= 1e9) && self.fx >= 1e-6 && self.fy >= 1e-6) {
            return Err(Error::invalid(
                format!("intrinsics fx, fy, cx, cy = {intrinsics:?}"),
                "give pixels, at most 1e9, fx and fy at least 1e-6",
            ));
        }
        self.distortion.check()?;
        if self.distortion.is_none() {
            return Ok(PixelGrid::Lines(self.line_grid()));
        }
        let lens = self.distortion.lens();
        let mut directions = memory::reserved(self.width as usize * self.height as usize)?;
        for row in 0..self.height {
            for column in 0..self.width {
                let (xd, yd) = self.normalized(f64::from(column), f64::from(row));
                let ray = lens.undistort(xd, yd).map(DVec3::normalize);
                directions.push(ray.unwrap_or(DVec3::NAN));
            }
        }
        Ok(PixelGrid::Rays(RayGrid::new(self.width, self.height, &directions)?))
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sensor::{Geometry, Sensor, SensorSpec};
    use proptest::prelude::*;

    fn sensor(camera: Camera) -> Result<Sensor> {
        Sensor::new(SensorSpec::new("c", "video", Geometry::Camera(camera)))
    }

    #[test]
    fn faulty_intrinsics_are_refused() {
        let good = Camera::pinhole(4, 3, 2.0, 2.0, 1.5, 1.0);
        assert!(sensor(good.clone()).is_ok());
        let k = Distortion::PlumbBob([0.1, f64::NAN, 0.0, 0.0, 0.0]);
        let faulty = [
            Camera { fx: 0.0, ..good.clone() },
            Camera { fy: -1.0, ..good.clone() },
            Camera { cx: f64::NAN, ..good.clone() },
            Camera { cy: f64::INFINITY, ..good.clone() },
            Camera { width: 0, ..good.clone() },
            Camera { height: 100_000, ..good.clone() },
            Camera { distortion: k, ..good },
        ];
        for camera in faulty {
            assert!(sensor(camera.clone()).is_err(), "{camera:?}");
        }
    }

    /// A lens model whose coefficients are all zero uses straight lines, with the same rays as a pinhole.
    #[test]
    fn a_lens_without_effect_needs_no_table() {
        let plain = Camera::pinhole(5, 4, 3.0, 2.0, 1.7, 1.2);
        let zero = Camera { distortion: Distortion::PlumbBob([0.0; 5]), ..plain.clone() };
        let (plain, zero) = (sensor(plain).unwrap(), sensor(zero).unwrap());
        assert!(matches!(zero.grid(), PixelGrid::Lines(_)));
        assert!((0..20).all(|i| plain.ray(i % 5, i / 5) == zero.ray(i % 5, i / 5)));
        let fisheye =
            Camera { distortion: Distortion::Equidistant([0.0; 4]), ..Camera::pinhole(5, 4, 3.0, 2.0, 1.7, 1.2) };
        assert!(matches!(sensor(fisheye).unwrap().grid(), PixelGrid::Rays(_)));
    }

    proptest! {
        #[test]
        fn rays_are_the_inverse_of_the_camera_matrix(
            (w, h) in (1..40u32, 1..40u32), (fx, fy) in (0.5..2000.0f64, 0.5..2000.0f64),
            (cx, cy) in (-50.0..90.0f64, -50.0..90.0f64), (i, j) in (0..40u32, 0..40u32),
        ) {
            let (column, row) = (i % w, j % h);
            let camera = Camera::pinhole(w, h, fx, fy, cx, cy);
            let s = sensor(camera.clone()).unwrap();
            let ray = s.ray(column, row).unwrap();
            let p = DVec3::new((f64::from(column) - cx) / fx, (f64::from(row) - cy) / fy, 1.0);
            prop_assert!(ray.distance(p.normalize()) < 1e-15, "{} {}", ray, p.normalize());
            let PixelGrid::Lines(grid) = s.grid() else { return Err(TestCaseError::fail("no lines")) };
            prop_assert!(grid.positions().windows(2).all(|t| t[0] < t[1]));
            let (line, sample) = grid.line_sample(column, row);
            prop_assert_eq!((line, sample), (row as usize, column as usize));
            let of_line = grid.image_from_line() * grid.line_ray(line, sample);
            // Not normalized: z is 1, so 1 / (m . s) is depth_z.
            prop_assert!(of_line.distance(p) < 1e-15 * p.length() * 4.0 && (of_line.z - 1.0).abs() < 1e-15);
            prop_assert!((grid.line_from_image() * of_line).distance(grid.line_ray(line, sample)) < 1e-12);
            let (u, v) = camera.project(ray * 7.0).unwrap();
            prop_assert!((u - f64::from(column)).hypot(v - f64::from(row)) < 1e-11);
        }
    }
}
