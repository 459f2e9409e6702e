//! NumPy arrays (`.npy`, format 1.0): little-endian, C order.
//!
//! `numpy.load` and most numerical software read them, without an EXR library. They hold only numbers: sensor, pose and
//! scene are in the EXR file or the file name.

use super::atomic::{open_to_replace, refused, target_of, write_atomically};
use glam::DVec3;
use presight_model::error::{Error, Result};
use presight_model::memory;
use presight_model::sensor::Sensor;
use presight_render::plan::{Images, Output, Samples};
use std::fs::File;
use std::io::{Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};
use std::time::SystemTime;

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

    fn len(&self) -> usize {
        match self {
            Self::F32(values) => values.len(),
            Self::U32(values) => values.len(),
            Self::F64(values) => values.len(),
        }
    }

    /// Writes the numbers, little-endian.
    pub(super) fn write_to(&self, out: &mut impl Write) -> std::io::Result<()> {
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
pub(super) fn header(descr: &str, shape: &[usize]) -> Vec<u8> {
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
/// [`crate::ErrorKind::Invalid`] if the shape does not match the number of values; [`crate::ErrorKind::System`] if the
/// file cannot be written.
pub fn write(path: &Path, shape: &[usize], values: Values<'_>) -> Result<()> {
    if shape.iter().try_fold(1usize, |product, side| product.checked_mul(*side)) != Some(values.len()) {
        let what = format!("{} numbers do not fill an array of shape {shape:?}", values.len());
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
/// As [`write()`]; [`crate::ErrorKind::Invalid`] if the image is missing.
pub fn write_image(path: &Path, images: &Images, output: Output) -> Result<()> {
    let missing = || Error::invalid(format!("there is no {} image", output.name()), "request it").in_file(path);
    let values = Values::of(images, output).ok_or_else(missing)?;
    write(path, &image_shape(images.width, images.height, output), values)
}

/// Writes the unit rays of a sensor as `<f8` of shape (rows, columns, 3): in its body axes (x forward, y left, z up) for
/// every kind of sensor, NaN where a pixel has no ray. A point is its ray times its range.
///
/// # Errors
/// As [`write()`]; [`crate::ErrorKind::System`] if memory is short.
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

/// An array of the images of many poses, written pose by pose. Its shape is (poses, rows, columns), or (poses, rows,
/// columns, 3) for vectors. Until complete, it is named `NAME.npy.unfinished`, and a later process can continue it.
#[derive(Debug)]
pub struct Stack {
    file: File,
    unfinished: PathBuf,
    target: PathBuf,
    path: PathBuf,
    header: Vec<u8>,
    bytes_per_pose: u64,
    descr: &'static str,
}

impl Stack {
    /// Continues an unfinished array if it has the size of that shape and was not modified after `until`. Otherwise, or
    /// if `until` is `None`, starts a new one and returns false.
    ///
    /// # Errors
    /// [`crate::ErrorKind::System`] if the file cannot be written; [`crate::ErrorKind::Usage`] for a device or pipe.
    pub fn open(path: &Path, shape: &[usize], descr: &'static str, until: Option<SystemTime>) -> Result<(Self, bool)> {
        if path.metadata().is_ok_and(|m| !m.is_file()) {
            let what = "an array of all poses is written piece by piece, into a file";
            return Err(Error::usage(what, "name a file, or put {i} into the name").in_file(path));
        }
        let refused = |e| refused(path, e);
        drop(open_to_replace(path)?);
        let target = target_of(path).map_err(refused)?;
        let mut name = target.clone().into_os_string();
        name.push(".unfinished");
        let unfinished = PathBuf::from(name);
        let header = header(descr, shape);
        // Cannot overflow: image sides and the number of poses are limited.
        let bytes_per_pose = shape.iter().skip(1).fold(4, |bytes, side| bytes * *side as u64);
        let length = header.len() as u64 + shape.first().map_or(1, |poses| *poses as u64) * bytes_per_pose;
        let mut file =
            File::options().read(true).write(true).create(true).truncate(false).open(&unfinished).map_err(refused)?;
        let was = file.metadata().map_err(refused)?;
        let untouched = until.zip(was.modified().ok()).is_some_and(|(until, modified)| modified <= until);
        let goes_on = untouched && was.len() == length;
        if !goes_on {
            file.set_len(0).map_err(refused)?;
            file.write_all(&header).and_then(|()| file.set_len(length)).map_err(refused)?;
        }
        Ok((Self { file, unfinished, target, path: path.to_owned(), header, bytes_per_pose, descr }, goes_on))
    }

    /// Writes the image of one pose.
    ///
    /// # Errors
    /// [`crate::ErrorKind::Invalid`] for an image of another size or type; [`crate::ErrorKind::System`] for I/O errors.
    pub fn put(&mut self, pose: usize, values: Values<'_>) -> Result<()> {
        if values.descr() != self.descr || 4 * values.len() as u64 != self.bytes_per_pose {
            let what = format!("an image of {} {} does not fit the array", values.len(), values.descr());
            return Err(Error::invalid(what, "give images of one size and type").in_file(&self.path));
        }
        let at = self.header.len() as u64 + pose as u64 * self.bytes_per_pose;
        let mut write = || {
            self.file.seek(SeekFrom::Start(at))?;
            values.write_to(&mut self.file)
        };
        write().map_err(|e| refused(&self.path, e))
    }

    /// Gives the complete file its final name.
    ///
    /// # Errors
    /// [`crate::ErrorKind::System`] if the system refuses.
    pub fn finish(self) -> Result<()> {
        let old = open_to_replace(&self.path)?;
        let done = || {
            if let Some(old) = old {
                self.file.set_permissions(old.metadata()?.permissions())?;
            }
            self.file.sync_all()?;
            std::fs::rename(&self.unfinished, &self.target)
        };
        done().map_err(|e| refused(&self.path, e))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::preset;

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
    fn a_stack_goes_on_where_it_was_left_and_appears_whole() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.npy");
        let open = |until| Stack::open(&path, &[3, 1, 2], "<f4", until).unwrap();
        let now = || Some(SystemTime::now());
        let (mut stack, goes_on) = open(now());
        assert!(!goes_on);
        stack.put(2, Values::F32(&[5.0, 6.0])).unwrap();
        stack.put(0, Values::F32(&[1.0, 2.0])).unwrap();
        assert!(stack.put(1, Values::F32(&[1.0])).is_err() && stack.put(1, Values::U32(&[1, 2])).is_err());
        drop(stack);
        assert!(!path.exists());
        let (mut stack, goes_on) = open(now());
        assert!(goes_on);
        stack.put(1, Values::F32(&[3.0, 4.0])).unwrap();
        stack.finish().unwrap();
        let whole = std::fs::read(&path).unwrap();
        write(&path, &[3, 1, 2], Values::F32(&[1.0, 2.0, 3.0, 4.0, 5.0, 6.0])).unwrap();
        assert_eq!(std::fs::read(&path).unwrap(), whole);
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1);
        drop(open(now()));
        assert!(!open(None).1, "of another job");
        assert!(!open(Some(SystemTime::UNIX_EPOCH)).1, "written by another");
        assert!(!Stack::open(&path, &[4, 1, 2], "<f4", now()).unwrap().1, "of another size");
        assert_eq!(std::fs::read(&path).unwrap(), whole);
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
