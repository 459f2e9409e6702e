//! NumPy arrays (`.npy`, format 1.0): little-endian, C order.
//!
//! `numpy.load` and most numerical software read them, without an EXR library. They hold only numbers: sensor, pose and
//! scene are in the EXR file or the file name.

use glam::DVec3;
use presight_model::error::{Error, Result};
use presight_model::memory;
use presight_model::sensor::Sensor;
use presight_read::atomic::write_atomically;
use presight_render::plan::{Images, Output, Samples};
use std::io::Write;
use std::path::Path;

/// The numbers of an array.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Values<'a> {
    /// `<f4`.
    F32(&'a [f32]),
    /// `<u4`.
    U32(&'a [u32]),
    /// `<f8`.
    F64(&'a [f64]),
}

impl<'a> Values<'a> {
    /// The values of an image; `None` if it is missing. The components of a vector are adjacent.
    pub fn of(images: &'a Images, output: Output) -> Option<Self> {
        Some(match images.samples(output)? {
            Samples::Floats(image) => Self::F32(image),
            Samples::Ids(image) => Self::U32(image),
            Samples::Vectors(image) => Self::F32(image.as_flattened()),
        })
    }

    /// NumPy's name of the type.
    pub fn descr(&self) -> &'static str {
        match self {
            Self::F32(_) => "<f4",
            Self::U32(_) => "<u4",
            Self::F64(_) => "<f8",
        }
    }

    /// Number of numbers.
    pub fn count(&self) -> usize {
        match self {
            Self::F32(values) => values.len(),
            Self::U32(values) => values.len(),
            Self::F64(values) => values.len(),
        }
    }

    /// Writes the numbers, little-endian.
    pub fn write_to(&self, out: &mut impl Write) -> std::io::Result<()> {
        if cfg!(target_endian = "little") {
            return out.write_all(match self {
                Self::F32(values) => bytemuck::cast_slice(values),
                Self::U32(values) => bytemuck::cast_slice(values),
                Self::F64(values) => bytemuck::cast_slice(values),
            });
        }
        match self {
            Self::F32(values) => values.iter().try_for_each(|v| out.write_all(&v.to_le_bytes())),
            Self::U32(values) => values.iter().try_for_each(|v| out.write_all(&v.to_le_bytes())),
            Self::F64(values) => values.iter().try_for_each(|v| out.write_all(&v.to_le_bytes())),
        }
    }
}

/// The header; its length is a multiple of 64.
pub fn header(descr: &str, shape: &[usize]) -> Vec<u8> {
    let sides: String = shape.iter().map(|side| format!("{side}, ")).collect();
    let mut text = format!("{{'descr': '{descr}', 'fortran_order': False, 'shape': ({}), }}", sides.trim_end());
    // Magic, version and length take 10 bytes, the newline 1.
    while !(text.len() + 11).is_multiple_of(64) {
        text.push(' ');
    }
    text.push('\n');
    // Fits 16 bits, because a shape has few dimensions.
    [b"\x93NUMPY\x01\x00".as_slice(), &(text.len() as u16).to_le_bytes(), text.as_bytes()].concat()
}

/// Writes an array of that shape, with the last dimension varying fastest. The file is written atomically.
///
/// # Errors
/// [`presight_model::ErrorKind::Invalid`] if the shape does not match the number of values;
/// [`presight_model::ErrorKind::System`] if the file cannot be written.
pub fn write(path: &Path, shape: &[usize], values: Values<'_>) -> Result<()> {
    if shape.iter().try_fold(1usize, |product, side| product.checked_mul(*side)) != Some(values.count()) {
        let what = format!("{} numbers do not fill an array of shape {shape:?}", values.count());
        return Err(Error::invalid(what, "give the shape of the numbers").in_file(path));
    }
    let header = header(values.descr(), shape);
    write_atomically(path, |file| {
        file.write_all(&header)?;
        values.write_to(file)
    })
}

/// The shape of an image: (rows, columns), and 3 for vectors.
pub fn image_shape(width: u32, height: u32, output: Output) -> Vec<usize> {
    let numbers = output.info().kind.numbers();
    [height as usize, width as usize].into_iter().chain((numbers > 1).then_some(numbers)).collect()
}

/// Writes an image as `<f4` or `<u4` of shape (rows, columns), vectors as `<f4` of shape (rows, columns, 3).
///
/// # Errors
/// As [`write()`]; [`presight_model::ErrorKind::Invalid`] if the image is missing.
pub fn write_image(path: &Path, images: &Images, output: Output) -> Result<()> {
    let missing = || Error::invalid(format!("there is no {} image", output.name()), "request it").in_file(path);
    let values = Values::of(images, output).ok_or_else(missing)?;
    write(path, &image_shape(images.width, images.height, output), values)
}

/// Writes the unit rays of a sensor as `<f8` of shape (rows, columns, 3): in its body axes (x forward, y left, z up)
/// for every kind of sensor, NaN where a pixel has no ray. A point is its ray times its range.
///
/// # Errors
/// As [`write()`]; [`presight_model::ErrorKind::System`] if memory is short.
pub fn write_rays(path: &Path, sensor: &Sensor) -> Result<()> {
    let (width, height) = (sensor.width(), sensor.height());
    let body_from_image = sensor.body_from_image();
    let mut rays = memory::reserved(3 * width as usize * height as usize)?;
    for (row, column) in (0..height).flat_map(|row| (0..width).map(move |column| (row, column))) {
        let ray = sensor.ray(column, row).map_or(DVec3::NAN, |ray| body_from_image * ray);
        rays.extend(ray.to_array());
    }
    write(path, &[height as usize, width as usize, 3], Values::F64(&rays))
}

#[cfg(test)]
mod tests {
    use super::*;
    use presight_read::preset;

    #[test]
    fn headers_end_at_a_multiple_of_64() {
        for shape in [&[1usize] as &[_], &[2, 3], &[1000, 16, 1800], &[123_456_789, 16_384, 16_384], &[]] {
            let header = header("<f4", shape);
            assert!(header.len().is_multiple_of(64) && header.ends_with(b"\n"), "{shape:?}");
            assert_eq!(usize::from(u16::from_le_bytes([header[8], header[9]])), header.len() - 10);
        }
        let text = String::from_utf8_lossy(&header("<u4", &[7])).into_owned();
        assert!(text.contains("{'descr': '<u4', 'fortran_order': False, 'shape': (7,), }"), "{text}");
    }

    #[test]
    fn shapes_are_those_of_the_numbers() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.npy");
        for shape in [&[2usize, 2] as &[_], &[3, 1, 2], &[usize::MAX, 2]] {
            assert!(write(&path, shape, Values::F32(&[1.0; 5])).is_err(), "{shape:?}");
        }
        assert!(!path.exists());
    }

    #[test]
    fn rays_are_in_body_axes() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("rays.npy");
        let sensor = preset("video-camera").unwrap();
        write_rays(&path, &sensor).unwrap();
        let bytes = std::fs::read(&path).unwrap();
        let numbers: Vec<f64> = bytes[128..].chunks(8).map(|b| f64::from_le_bytes(b.try_into().unwrap())).collect();
        assert_eq!(numbers.len(), 3 * 512 * 512);
        let ray = |row: usize, column: usize| DVec3::from_slice(&numbers[3 * (row * 512 + column)..]);
        assert!(ray(0, 0).x > 0.5 && ray(0, 0).y > 0.1 && ray(0, 0).z > 0.1, "left and up: {}", ray(0, 0));
        assert!(ray(511, 511).y < -0.1 && (ray(511, 511).length() - 1.0).abs() < 1e-15);
    }
}
