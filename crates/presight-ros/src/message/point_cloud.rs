//! `sensor_msgs/msg/PointCloud2`.

use super::{Header, Message};
use crate::cdr::{Cursor, Field, Primitive, Sink, fields};
use presight_model::error::{Error, Result};

/// The number format of a field (`PointField.datatype`).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[allow(missing_docs, reason = "the names are those of Rust's types")]
pub enum Scalar {
    I8,
    U8,
    I16,
    U16,
    I32,
    U32,
    F32,
    F64,
}

/// `PointField.datatype`: 1 for the first.
impl<'a> Field<'a> for Option<Scalar> {
    fn read(cursor: &mut Cursor<'a>) -> Result<Self> {
        let datatype = usize::from(u8::read(cursor)?);
        Ok(datatype.checked_sub(1).and_then(|at| Scalar::ALL.get(at)).copied())
    }

    fn write(&self, sink: &mut Sink) {
        let at = Scalar::ALL.iter().position(|scalar| Some(*scalar) == *self);
        at.map_or(0, |at| at as u8 + 1).write(sink);
    }
}

impl Scalar {
    const ALL: [Self; 8] = [Self::I8, Self::U8, Self::I16, Self::U16, Self::I32, Self::U32, Self::F32, Self::F64];

    /// Its size, bytes.
    pub fn size(self) -> usize {
        match self {
            Self::I8 | Self::U8 => 1,
            Self::I16 | Self::U16 => 2,
            Self::I32 | Self::U32 | Self::F32 => 4,
            Self::F64 => 8,
        }
    }

    fn decode(self, bytes: &[u8], big_endian: bool) -> f64 {
        match self {
            Self::I8 => i8::decode(bytes, big_endian).into(),
            Self::U8 => u8::decode(bytes, big_endian).into(),
            Self::I16 => i16::decode(bytes, big_endian).into(),
            Self::U16 => u16::decode(bytes, big_endian).into(),
            Self::I32 => i32::decode(bytes, big_endian).into(),
            Self::U32 => u32::decode(bytes, big_endian).into(),
            Self::F32 => f32::decode(bytes, big_endian).into(),
            Self::F64 => f64::decode(bytes, big_endian),
        }
    }
}

/// A field of every point.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct PointField {
    /// Its name: `x`, `intensity`, `ring`, ...
    pub name: String,
    /// Bytes from the start of a point. They may be unaligned.
    pub offset: u32,
    /// Its number format; `None` for one that the definition does not have.
    pub scalar: Option<Scalar>,
    /// Numbers in the field; 0 means 1, as some drivers write it.
    pub count: u32,
}

/// Points as a driver gives them: an image of points (organized), or a list of one row.
#[derive(Clone, Debug, PartialEq)]
pub struct PointCloud2<'a> {
    /// Stamp, and the frame of the points.
    pub header: Header,
    /// Rows; 1 for a list.
    pub height: u32,
    /// Columns, or points of a list.
    pub width: u32,
    /// The fields of every point.
    pub fields: Vec<PointField>,
    /// True if numbers of several bytes are big endian.
    pub is_bigendian: bool,
    /// Bytes from one point to the next.
    pub point_step: u32,
    /// Bytes from one row to the next.
    pub row_step: u32,
    /// The points.
    pub data: &'a [u8],
    /// True if every point is valid, as the driver claims.
    pub is_dense: bool,
}

impl<'a> Message<'a> for PointCloud2<'a> {
    const TYPE: &'static str = "sensor_msgs/msg/PointCloud2";
}

fields!(PointField { name, offset, scalar, count });
fields!(PointCloud2<'a> { header, height, width, fields, is_bigendian, point_step, row_step, data, is_dense });

impl<'a> PointCloud2<'a> {
    /// The points of the cloud.
    pub fn len(&self) -> usize {
        self.height as usize * self.width as usize
    }

    /// True if it has no points.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// The values of a field, row by row; `None` if the cloud has no field of this name.
    ///
    /// # Errors
    /// [`presight_model::ErrorKind::Invalid`] if the field has an unknown data type or reaches beyond the point, or if
    /// the steps do not fit the data.
    pub fn values<'s>(&'s self, name: &str) -> Result<Option<impl Iterator<Item = f64> + use<'s, 'a>>> {
        let Some(field) = self.fields.iter().find(|f| f.name == name) else { return Ok(None) };
        let invalid =
            |what: String| Error::invalid(what, "the driver must describe its points; record the topic again");
        let scalar = field.scalar.ok_or_else(|| invalid(format!("field \"{name}\" has an unknown data type")))?;
        let (offset, point, row) = (field.offset as usize, self.point_step as usize, self.row_step as usize);
        if offset.saturating_add(scalar.size()) > point {
            return Err(invalid(format!("field \"{name}\" at byte {offset} reaches beyond the point_step of {point}")));
        }
        let (width, height) = (self.width as usize, self.height as usize);
        // Some drivers leave row_step 0 for a list.
        let row = if height == 1 { width.saturating_mul(point) } else { row };
        if row < width.saturating_mul(point) || self.data.len() < row.saturating_mul(height) {
            let what = format!(
                "{height} rows of {width} points of {point} bytes do not fit row_step {row} and {} bytes",
                self.data.len()
            );
            return Err(invalid(what));
        }
        let big_endian = self.is_bigendian;
        Ok(Some(
            (0..height)
                .flat_map(move |y| (0..width).map(move |x| y * row + x * point + offset))
                .map(move |at| scalar.decode(&self.data[at..at + scalar.size()], big_endian)),
        ))
    }
}
