//! Accessors: every size is checked against the buffer it claims before anything is allocated.

use crate::error::{Error, ErrorKind, Result};
use crate::limits;
use glam::Vec3;
use gltf::json;
use json::accessor::{Accessor, ComponentType, Type};
use json::validation::Checked;

const REPAIR: &str = "repair the model or export it again";

/// The parsed file with the bytes of its buffers.
pub(super) struct Document<'a> {
    pub root: json::Root,
    pub buffers: Vec<std::borrow::Cow<'a, [u8]>>,
}

/// Positions of a primitive, mesh frame.
pub(super) enum Positions<'a> {
    /// Plain f32 triples, read in place.
    Plain { bytes: &'a [u8], stride: usize, count: usize },
    /// What had to be computed: sparse or quantized.
    Computed(Vec<Vec3>),
}

impl Positions<'_> {
    pub fn count(&self) -> usize {
        match self {
            Self::Plain { count, .. } => *count,
            Self::Computed(v) => v.len(),
        }
    }

    /// Position i, which must be below the count.
    pub fn get(&self, i: usize) -> Vec3 {
        match self {
            Self::Plain { bytes, stride, .. } => vec3_at(&bytes[i * stride..]),
            Self::Computed(v) => v[i],
        }
    }
}

fn f32_at(b: &[u8]) -> f32 {
    f32::from_le_bytes([b[0], b[1], b[2], b[3]])
}

fn vec3_at(b: &[u8]) -> Vec3 {
    Vec3::new(f32_at(b), f32_at(&b[4..]), f32_at(&b[8..]))
}

/// `count` elements of `size` bytes, `stride` apart.
struct Elements<'a> {
    bytes: &'a [u8],
    stride: usize,
}

impl<'a> Document<'a> {
    pub fn accessor(&self, index: json::Index<Accessor>) -> Result<&Accessor> {
        self.root.accessors.get(index.value()).ok_or_else(|| {
            Error::invalid(
                format!("accessor {} does not exist, there are {}", index.value(), self.root.accessors.len()),
                REPAIR,
            )
        })
    }

    /// The count of an accessor once its data is proven to be there, before anything is read.
    pub fn proven_count(&self, index: json::Index<Accessor>) -> Result<u64> {
        let accessor = self.accessor(index)?;
        let prove = || {
            let count = accessor.count.0;
            let components = if matches!(accessor.type_, Checked::Valid(Type::Vec3)) { 3 } else { 1 };
            let size = components * component_of(accessor)?.size();
            match accessor.buffer_view {
                None => zero_filled(count).map(drop)?,
                Some(view) => {
                    let offset = accessor.byte_offset.map_or(0, |o| o.0);
                    self.elements(view.value(), offset, count, size, components == 3).map(drop)?;
                }
            }
            Ok(count)
        };
        prove().map_err(|e: Error| e.at(format!("accessor {}", index.value())))
    }

    /// The bytes of a view from `offset` on, proven to hold `count` elements.
    fn elements(&self, view: usize, offset: u64, count: u64, size: usize, strided: bool) -> Result<Elements<'_>> {
        let place = |e: Error| e.at(format!("buffer view {view}"));
        let views = &self.root.buffer_views;
        let v = views
            .get(view)
            .ok_or_else(|| Error::invalid(format!("it does not exist, there are {}", views.len()), REPAIR))
            .map_err(place)?;
        let buffer = v.buffer.value();
        let bytes = self.buffers.get(buffer).ok_or_else(|| {
            place(Error::invalid(format!("buffer {buffer} does not exist, there are {}", self.buffers.len()), REPAIR))
        })?;
        let (start, length) = (v.byte_offset.map_or(0, |o| o.0), v.byte_length.0);
        let end = start.checked_add(length).filter(|&end| end <= bytes.len() as u64).ok_or_else(|| {
            place(Error::invalid(
                format!("bytes {start} + {length} are claimed, buffer {buffer} has {}", bytes.len()),
                "the buffer is truncated or the model broken; export it again",
            ))
        })?;
        let stride = v.byte_stride.filter(|_| strided).map_or(size, |s| s.0);
        if stride < size || stride > 252.max(size) {
            return Err(place(Error::invalid(format!("a byte stride of {stride} is not possible here"), REPAIR)));
        }
        let needed = match count.checked_sub(1) {
            None => Some(0),
            Some(before) => before
                .checked_mul(stride as u64)
                .and_then(|n| n.checked_add(size as u64))
                .and_then(|n| n.checked_add(offset)),
        };
        if needed.is_none_or(|n| n > length) {
            return Err(place(Error::invalid(
                format!("{count} elements are claimed, the view has {length} bytes"),
                "the buffer is truncated or the model broken; export it again",
            )));
        }
        // Both ends lie inside a slice, so they fit usize. An empty accessor may point anywhere.
        let whole = &bytes[start as usize..end as usize];
        Ok(Elements { bytes: whole.get(offset as usize..).unwrap_or_default(), stride })
    }

    /// The POSITION data of an accessor.
    pub fn positions(&self, index: json::Index<Accessor>) -> Result<Positions<'_>> {
        let place = format!("accessor {}", index.value());
        let accessor = self.accessor(index)?;
        self.positions_of(accessor).map_err(|e| e.at(place))
    }

    fn positions_of(&self, accessor: &Accessor) -> Result<Positions<'_>> {
        let component = component_of(accessor)?;
        if !matches!(accessor.type_, Checked::Valid(Type::Vec3)) {
            return Err(Error::invalid("positions must be VEC3", REPAIR));
        }
        let size = 3 * component.size();
        let count = accessor.count.0;
        let base = match accessor.buffer_view {
            None => None,
            Some(view) => {
                Some(self.elements(view.value(), accessor.byte_offset.map_or(0, |o| o.0), count, size, true)?)
            }
        };
        if let (Some(e), None, ComponentType::F32) = (&base, &accessor.sparse, component) {
            return Ok(Positions::Plain { bytes: e.bytes, stride: e.stride, count: count as usize });
        }
        let decode = |b: &[u8]| {
            let c = component.size();
            Vec3::new(
                component_at(b, component, accessor.normalized),
                component_at(&b[c..], component, accessor.normalized),
                component_at(&b[2 * c..], component, accessor.normalized),
            )
        };
        let mut all: Vec<Vec3> = match &base {
            Some(e) => (0..count as usize).map(|i| decode(&e.bytes[i * e.stride..])).collect(),
            None => vec![Vec3::ZERO; zero_filled(count)?],
        };
        self.apply_sparse(accessor, size, |i, b| all[i] = decode(b))?;
        Ok(Positions::Computed(all))
    }

    /// Vertex indices of an accessor.
    pub fn indices(&self, index: json::Index<Accessor>) -> Result<Vec<u32>> {
        let place = format!("accessor {}", index.value());
        let accessor = self.accessor(index)?;
        self.indices_of(accessor).map_err(|e| e.at(place))
    }

    fn indices_of(&self, accessor: &Accessor) -> Result<Vec<u32>> {
        let component = component_of(accessor)?;
        let integer = matches!(component, ComponentType::U8 | ComponentType::U16 | ComponentType::U32);
        if !integer || !matches!(accessor.type_, Checked::Valid(Type::Scalar)) {
            return Err(Error::invalid("indices must be SCALAR of u8, u16 or u32", REPAIR));
        }
        let size = component.size();
        let count = accessor.count.0;
        let mut all = match accessor.buffer_view {
            None => vec![0; zero_filled(count)?],
            Some(view) => {
                let offset = accessor.byte_offset.map_or(0, |o| o.0);
                let e = self.elements(view.value(), offset, count, size, false)?;
                let bytes = &e.bytes[..count as usize * size];
                bytes.chunks_exact(size).map(|b| index_at(b, component)).collect::<Vec<u32>>()
            }
        };
        self.apply_sparse(accessor, size, |i, b| all[i] = index_at(b, component))?;
        Ok(all)
    }

    fn apply_sparse(&self, accessor: &Accessor, size: usize, mut set: impl FnMut(usize, &[u8])) -> Result<()> {
        let Some(sparse) = &accessor.sparse else { return Ok(()) };
        let broken = |what: String| Error::invalid(what, REPAIR).at("sparse");
        let Checked::Valid(kind) = sparse.indices.component_type else {
            return Err(broken("indices must be u8, u16 or u32".into()));
        };
        let kind = kind.0;
        let count = sparse.count.0;
        if count > accessor.count.0 {
            return Err(broken(format!("{count} values replace {}", accessor.count.0)));
        }
        let i = &sparse.indices;
        let at = self.elements(i.buffer_view.value(), i.byte_offset.0, count, kind.size(), false)?;
        let v = &sparse.values;
        let values = self.elements(v.buffer_view.value(), v.byte_offset.0, count, size, false)?;
        let mut before = None;
        for k in 0..count as usize {
            let target = index_at(&at.bytes[k * at.stride..], kind);
            if u64::from(target) >= accessor.count.0 || before.is_some_and(|b| b >= target) {
                return Err(broken(format!(
                    "index {k} is {target}; indices must rise and stay below {}",
                    accessor.count.0
                )));
            }
            before = Some(target);
            set(target as usize, &values.bytes[k * values.stride..]);
        }
        Ok(())
    }
}

fn component_of(accessor: &Accessor) -> Result<ComponentType> {
    match accessor.component_type {
        Checked::Valid(c) => Ok(c.0),
        Checked::Invalid => Err(Error::new(ErrorKind::Invalid, "unknown component type", REPAIR)),
    }
}

/// An accessor without bytes behind it is all zeros: a tiny file could ask for any amount.
fn zero_filled(count: u64) -> Result<usize> {
    if count > limits::MAX_ZERO_FILLED {
        return Err(Error::invalid(
            format!("{count} elements are claimed without data, {} are the limit", limits::MAX_ZERO_FILLED),
            REPAIR,
        ));
    }
    Ok(count as usize)
}

fn index_at(b: &[u8], component: ComponentType) -> u32 {
    match component {
        ComponentType::U8 => u32::from(b[0]),
        ComponentType::U16 => u32::from(u16::from_le_bytes([b[0], b[1]])),
        _ => u32::from_le_bytes([b[0], b[1], b[2], b[3]]),
    }
}

/// One component as f32; normalized integers by the formulas of glTF 2.0, section 3.11.
fn component_at(b: &[u8], component: ComponentType, normalized: bool) -> f32 {
    let (value, top) = match component {
        ComponentType::F32 => return f32_at(b),
        ComponentType::I8 => (f32::from(b[0] as i8), 127.0),
        ComponentType::U8 => (f32::from(b[0]), 255.0),
        ComponentType::I16 => (f32::from(i16::from_le_bytes([b[0], b[1]])), 32767.0),
        ComponentType::U16 => (f32::from(u16::from_le_bytes([b[0], b[1]])), 65535.0),
        ComponentType::U32 => (index_at(b, component) as f32, u32::MAX as f32),
    };
    if normalized { (value / top).max(-1.0) } else { value }
}
