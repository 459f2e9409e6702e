//! `sensor_msgs/msg/Image`, `CompressedImage` and `CameraInfo`.

use super::{Header, Message};
use crate::cdr::fields;
use presight_model::error::{Error, Result};

/// An image without compression.
#[derive(Clone, Debug, PartialEq)]
pub struct Image<'a> {
    /// Stamp, and the optical frame of the camera.
    pub header: Header,
    /// Rows.
    pub height: u32,
    /// Columns.
    pub width: u32,
    /// Meaning of the bytes: `32FC1`, `16UC1`, `mono8`, ...
    pub encoding: String,
    /// True if numbers of several bytes are big endian.
    pub is_bigendian: bool,
    /// Bytes from one row to the next.
    pub step: u32,
    /// `height` times `step` bytes.
    pub data: &'a [u8],
}

impl<'a> Message<'a> for Image<'a> {
    const TYPE: &'static str = "sensor_msgs/msg/Image";
}

fields!(Image<'a> { header, height, width, encoding, is_bigendian, step, data });

impl Image<'_> {
    /// The rows of the image, each of `width` pixels of `N` bytes, without the padding behind them.
    ///
    /// # Errors
    /// [`presight_model::ErrorKind::Invalid`] if `step` is less than a row or the data is shorter than the rows.
    pub fn rows<const N: usize>(&self) -> Result<impl Iterator<Item = &[[u8; N]]>> {
        let (row, step, height) = (self.width as usize * N, self.step as usize, self.height as usize);
        if step < row || self.data.len() < step.saturating_mul(height) {
            let what = format!(
                "an image of {} x {} pixels of {N} bytes has a step of {step} and {} bytes",
                self.width,
                self.height,
                self.data.len()
            );
            return Err(Error::invalid(what, "the driver must fill step and data; record the topic again"));
        }
        Ok(self.data.chunks(step.max(1)).take(height).map(move |bytes| bytes[..row].as_chunks().0))
    }
}

/// A compressed image. Depth images of `compressedDepth` have 12 bytes of their own before the PNG.
#[derive(Clone, Debug, PartialEq)]
pub struct CompressedImage<'a> {
    /// Stamp, and the optical frame of the camera.
    pub header: Header,
    /// Encoding and compression, for example `16UC1; compressedDepth png`.
    pub format: String,
    /// The compressed bytes.
    pub data: &'a [u8],
}

impl<'a> Message<'a> for CompressedImage<'a> {
    const TYPE: &'static str = "sensor_msgs/msg/CompressedImage";
}

fields!(CompressedImage<'a> { header, format, data });

/// The calibration of a camera: of the raw image by K and D, and of the rectified one by P.
#[derive(Clone, Debug, PartialEq)]
pub struct CameraInfo {
    /// Stamp, and the optical frame of the camera.
    pub header: Header,
    /// Rows of the full image.
    pub height: u32,
    /// Columns of the full image.
    pub width: u32,
    /// `plumb_bob`, `rational_polynomial`, `equidistant`, or empty.
    pub distortion_model: String,
    /// Coefficients of the distortion model.
    pub d: Vec<f64>,
    /// Intrinsics of the raw image, row-major.
    pub k: [f64; 9],
    /// Rectification, row-major.
    pub r: [f64; 9],
    /// Projection of the rectified image, row-major.
    pub p: [f64; 12],
    /// Pixels of the full image per pixel, along x and y; 0 means 1.
    pub binning: [u32; 2],
    /// Region of interest of the full image: x offset, y offset, height, width; zeros mean all.
    pub roi: [u32; 4],
    /// True if the region of interest is to be rectified.
    pub do_rectify: bool,
}

impl Message<'_> for CameraInfo {
    const TYPE: &'static str = "sensor_msgs/msg/CameraInfo";
}

fields!(CameraInfo { header, height, width, distortion_model, d, k, r, p, binning, roi, do_rectify });
