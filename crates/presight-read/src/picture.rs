//! Pictures in logs: PNG files of 16-bit depth, and of brightness. The crate `image` reads them, which only the cargo
//! feature `images` builds.

use presight_model::error::Result;
use std::io::{BufRead, Seek};

#[cfg(feature = "images")]
use image::{DynamicImage, ImageDecoder, codecs::png::PngDecoder};
#[cfg(feature = "images")]
use presight_model::error::Error;

/// A picture in memory, row-major.
#[cfg(feature = "images")]
pub(crate) struct Picture(DynamicImage);

#[cfg(feature = "images")]
impl Picture {
    /// Reads a PNG whose width and height `fits` accepts. The size is checked before decoding, because a small file may
    /// claim a huge image.
    ///
    /// # Errors
    /// [`presight_model::ErrorKind::Invalid`] naming the defect; the errors of `fits`;
    /// [`presight_model::ErrorKind::Unsupported`] in a build without the feature `images`.
    pub(crate) fn read(file: impl BufRead + Seek, fits: impl FnOnce((u32, u32)) -> Result<()>) -> Result<Self> {
        let wrong = |e: image::ImageError| Error::invalid(e.to_string(), "give a PNG");
        let decoder = PngDecoder::new(file).map_err(wrong)?;
        fits(decoder.dimensions())?;
        Ok(Self(DynamicImage::from_decoder(decoder).map_err(wrong)?))
    }

    /// The samples of a 16-bit grey picture.
    ///
    /// # Errors
    /// [`presight_model::ErrorKind::Invalid`] for any other picture.
    pub(crate) fn into_grey16(self) -> Result<Vec<u16>> {
        match self.0 {
            DynamicImage::ImageLuma16(picture) => Ok(picture.into_raw()),
            _ => {
                let remedy = "give a 16-bit grey PNG, depth in whole units";
                Err(Error::invalid("this is not a 16-bit grey image", remedy))
            }
        }
    }

    /// The luminance of each pixel from 0 (black) to 1 (white), in steps of 1/65535.
    ///
    /// # Errors
    /// None; a build without the feature `images` has no picture.
    pub(crate) fn into_luminances(self) -> Result<Vec<f32>> {
        Ok(self.0.into_luma16().into_raw().into_iter().map(|v| f32::from(v) / f32::from(u16::MAX)).collect())
    }
}

/// No picture: the build lacks the feature `images`.
#[cfg(not(feature = "images"))]
pub(crate) enum Picture {}

#[cfg(not(feature = "images"))]
impl Picture {
    pub(crate) fn read(_: impl BufRead + Seek, _: impl FnOnce((u32, u32)) -> Result<()>) -> Result<Self> {
        Err(crate::not_built("pictures of logs", "images"))
    }

    pub(crate) fn into_grey16(self) -> Result<Vec<u16>> {
        match self {}
    }

    pub(crate) fn into_luminances(self) -> Result<Vec<f32>> {
        match self {}
    }
}
