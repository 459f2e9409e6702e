//! The fields of points in PLY and PCD files, except the position.

use glam::{DVec3, Vec3};
use presight_render::plan::Output;

/// A field of all points.
#[derive(Clone, Copy, Debug)]
pub enum Field<'a, 'b> {
    Normal(&'b [Vec3]),
    Float(Output, &'a [f32]),
    /// The row of the image; holds its number of columns.
    Ring(usize),
    Id(Output, &'a [u32]),
}

impl Field<'_, '_> {
    /// The conventional name of the field.
    pub fn name(&self) -> &'static str {
        match self {
            Self::Normal(_) => "normal",
            Self::Float(Output::Echo, _) => "intensity",
            Self::Ring(_) => "ring",
            Self::Float(output, _) | Self::Id(output, _) => output.name(),
        }
    }

    /// Appends the bytes of a pixel, little-endian. A ring has 4 bytes, or 2 as in PCL's scanner points.
    pub fn append(&self, pixel: usize, wide_ring: bool, bytes: &mut Vec<u8>) {
        match *self {
            Self::Normal(normals) => bytes.extend(normals[pixel].to_array().iter().flat_map(|v| v.to_le_bytes())),
            Self::Float(_, image) => bytes.extend(image[pixel].to_le_bytes()),
            Self::Ring(columns) if wide_ring => bytes.extend(((pixel / columns) as u32).to_le_bytes()),
            // An image has at most 16,384 rows.
            Self::Ring(columns) => bytes.extend(((pixel / columns) as u16).to_le_bytes()),
            Self::Id(_, image) => bytes.extend(image[pixel].to_le_bytes()),
        }
    }
}

/// Appends a position, little-endian, in f64 or f32.
pub fn append_position(p: DVec3, wide: bool, bytes: &mut Vec<u8>) {
    match wide {
        true => bytes.extend(p.to_array().iter().flat_map(|v| v.to_le_bytes())),
        false => bytes.extend(p.to_array().iter().flat_map(|v| (*v as f32).to_le_bytes())),
    }
}
