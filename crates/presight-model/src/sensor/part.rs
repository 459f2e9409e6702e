//! Parts of a sensor's image: a range of columns, and every k-th column and row.

use super::{Angles, Geometry, PixelGrid, Projector, RayGrid, Sensor, SensorData};
use crate::error::Result;
use std::sync::{Arc, OnceLock};

/// The pixels of an image part: columns `first_column + i stride` before `end_column`, rows `i stride`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ImagePart {
    /// First column.
    pub first_column: u32,
    /// Exclusive.
    pub end_column: u32,
    /// Step between columns and between rows, at least 1.
    pub stride: u32,
}

/// Strides that are allowed for frames.
pub const STRIDES: [u32; 3] = [2, 4, 8];

const LARGEST_STRIDE: u32 = STRIDES[STRIDES.len() - 1];

/// Parts with all columns, by stride; made on first use.
pub(super) type Thinned = [OnceLock<Sensor>; STRIDES.len()];

impl ImagePart {
    /// Number of columns of the part.
    #[inline]
    pub fn width(&self) -> u32 {
        (self.end_column - self.first_column).div_ceil(self.stride)
    }

    /// Number of rows of the part, in an image of `rows` rows.
    #[inline]
    pub fn height(&self, rows: u32) -> u32 {
        rows.div_ceil(self.stride)
    }

    /// The column of the whole image that is column `column` of the part.
    pub fn column(&self, column: u32) -> u32 {
        self.first_column + column * self.stride
    }
}

impl Sensor {
    /// The sensor with every `stride`-th column and row of this one.
    ///
    /// # Errors
    /// As [`Sensor::part`].
    pub fn thinned(&self, stride: u32) -> Result<Self> {
        self.part(ImagePart { stride: stride.max(1), ..self.whole() })
    }

    /// All columns and rows.
    #[doc(hidden)]
    #[inline]
    pub fn whole(&self) -> ImagePart {
        ImagePart { first_column: 0, end_column: self.width(), stride: 1 }
    }

    /// The sensor with a part of this one's rays, identical to the bit. Its specification is still that of the whole.
    ///
    /// # Errors
    /// [`crate::ErrorKind::System`] if there is no memory for the ray tables.
    #[doc(hidden)]
    pub fn part(&self, part: ImagePart) -> Result<Self> {
        let is_whole = part.first_column == 0 && part.end_column == self.width();
        let slot = STRIDES.iter().position(|stride| *stride == part.stride).filter(|_| is_whole);
        if let Some(made) = slot.and_then(|slot| self.0.thinned[slot].get()) {
            return Ok(made.clone());
        }
        let made = self.make_part(part)?;
        Ok(slot.map_or(made.clone(), |slot| self.0.thinned[slot].get_or_init(|| made).clone()))
    }

    /// Step between columns and between rows in the whole sensor's pixels; 1 if this is not a part.
    #[inline]
    pub fn part_stride(&self) -> u32 {
        self.0.part.map_or(1, |part| part.stride)
    }

    fn make_part(&self, part: ImagePart) -> Result<Self> {
        let (width, height) = (part.width(), part.height(self.height()));
        let grid = match self.grid() {
            PixelGrid::Lines(grid) => PixelGrid::Lines(grid.part(&part)),
            PixelGrid::Rays(grid) => {
                let rows = (0..height).map(|row| row * part.stride);
                let columns = || (0..width).map(|column| part.column(column));
                let rays: Vec<_> = rows.flat_map(|r| columns().map(move |c| grid.direction(c, r))).collect();
                PixelGrid::Rays(RayGrid::with_fit(width, height, &rays, grid.pixel_fit().part(&part))?)
            }
        };
        let spec = self.spec().clone();
        let projector = Projector::new(&spec);
        Ok(Self(Arc::new(SensorData {
            spec,
            grid,
            projector,
            width,
            height,
            part: Some(part),
            directory: OnceLock::new(),
            tiles: OnceLock::new(),
            bundles: Default::default(),
            thinned: Thinned::default(),
        })))
    }

    /// `columns` columns around a heading (radians from the forward axis, counter-clockwise), starting at a multiple of
    /// the largest stride. `None` for sensors whose columns have no order, and if the part would be the whole image.
    #[doc(hidden)]
    pub fn columns_around(&self, heading: f64, columns: u32) -> Option<ImagePart> {
        if columns >= self.width() || matches!(self.spec().geometry, Geometry::Rays(_)) {
            return None;
        }
        let off = |column: u32| {
            let off = (self.azimuth_of(column)? - heading).sin_cos();
            Some(off.0.atan2(off.1).abs())
        };
        let offs = (0..self.width()).filter_map(|column| Some((off(column)?, column)));
        let (_, middle) = offs.min_by(|a, b| a.0.total_cmp(&b.0))?;
        let first = middle.saturating_sub(columns / 2).min(self.width() - columns);
        let first_column = first / LARGEST_STRIDE * LARGEST_STRIDE;
        Some(ImagePart { first_column, end_column: first + columns, stride: 1 })
    }

    /// Azimuth of a column at half the image height, radians counter-clockwise from the forward axis.
    fn azimuth_of(&self, column: u32) -> Option<f64> {
        let ray = self.body_from_image() * self.ray(column, self.height() / 2)?;
        Some(ray.y.atan2(ray.x))
    }

    /// Heading of a part's columns, counter-clockwise from the forward axis, and the angle they span, degrees.
    #[doc(hidden)]
    pub fn opening_of(&self, part: &ImagePart) -> [f64; 2] {
        let azimuths: Vec<f64> =
            (part.first_column..part.end_column).filter_map(|column| self.azimuth_of(column)).collect();
        let turned = |from: f64, to: f64| {
            let (sin, cos) = (to - from).sin_cos();
            sin.atan2(cos)
        };
        let opening: f64 = azimuths.windows(2).map(|pair| turned(pair[0], pair[1])).sum();
        let heading = azimuths.first().map_or(0.0, |first| turned(0.0, first + 0.5 * opening));
        [heading.to_degrees(), opening.abs().to_degrees()]
    }

    /// The azimuth of a scanner's first column and the step between columns, degrees, for the part if this is one.
    /// Returns `None` for listed azimuths and for other sensors.
    pub fn uniform_columns(&self) -> Option<[f64; 2]> {
        match &self.spec().geometry {
            Geometry::Scanner(scanner) => match scanner.azimuth {
                Angles::Uniform { start_deg, step_deg, count } if count > 1 => Some(match self.0.part {
                    None => [start_deg, step_deg],
                    Some(part) => {
                        [start_deg + f64::from(part.first_column) * step_deg, step_deg * f64::from(part.stride)]
                    }
                }),
                _ => None,
            },
            _ => None,
        }
    }

    /// The column of the whole image that a column of this sensor corresponds to.
    #[inline]
    pub fn whole_column(&self, column: u32) -> u32 {
        self.0.part.map_or(column, |part| part.column(column))
    }
}
