//! Accessors. Every size is checked against its buffer before anything is allocated.

use super::buffers::{Buffers, REPAIR};
use glam::Vec3;
use gltf::json;
use json::accessor::{Accessor, ComponentType, Type};
use json::mesh::{Primitive, Semantic};
use json::validation::Checked;
use presight_model::error::{Error, ErrorKind, Result};
use presight_model::limits;
use std::cmp::Ordering;
use std::collections::HashMap;

/// The parsed file with the bytes of its buffers.
pub(super) struct Document<'a> {
    pub root: json::Root,
    pub buffers: Buffers<'a>,
}

/// The elements of an accessor, such as the positions of a primitive in the mesh frame. They are not copied, because a
/// small primitive may use a small part of a large accessor.
pub(super) struct Values<'a> {
    count: usize,
    /// `None` means all zeros.
    base: Option<Elements<'a>>,
    component: ComponentType,
    normalized: bool,
    sparse: Option<Sparse<'a>>,
}

/// Values that replace some elements, by rising indices.
struct Sparse<'a> {
    count: usize,
    component: ComponentType,
    indices: Elements<'a>,
    values: Elements<'a>,
}

impl Values<'_> {
    pub fn count(&self) -> usize {
        self.count
    }

    /// The numbers of element i, which must be below the count. `N` must be the type's number of components.
    pub fn numbers<const N: usize>(&self, i: usize) -> [f32; N] {
        let replaced = self.sparse.as_ref().and_then(|sparse| sparse.of(i));
        let Some(bytes) = replaced.or_else(|| self.base.as_ref().map(|base| base.at(i))) else { return [0.0; N] };
        let size = self.component.size();
        std::array::from_fn(|k| component_at(&bytes[k * size..], self.component, self.normalized))
    }

    /// Vector i of three numbers, which must be below the count.
    pub fn get(&self, i: usize) -> Vec3 {
        Vec3::from_array(self.numbers(i))
    }
}

impl<'a> Sparse<'a> {
    fn index(&self, k: usize) -> u32 {
        index_at(self.indices.at(k), self.component)
    }

    /// The bytes of the value that replaces element i, if any.
    fn of(&self, i: usize) -> Option<&'a [u8]> {
        let (mut low, mut high) = (0, self.count);
        while low < high {
            let middle = low + (high - low) / 2;
            match (self.index(middle) as usize).cmp(&i) {
                Ordering::Less => low = middle + 1,
                Ordering::Equal => return Some(self.values.at(middle)),
                Ordering::Greater => high = middle,
            }
        }
        None
    }

    /// Checks that the indices rise and stay below `elements`.
    fn prove(&self, elements: u64) -> Result<()> {
        let mut before = None;
        for k in 0..self.count {
            let target = self.index(k);
            if u64::from(target) >= elements || before.is_some_and(|b| b >= target) {
                let what = format!("index {k} is {target}; indices must rise and stay below {elements}");
                return Err(Error::invalid(what, REPAIR).at("sparse"));
            }
            before = Some(target);
        }
        Ok(())
    }
}

fn f32_at(b: &[u8]) -> f32 {
    f32::from_le_bytes([b[0], b[1], b[2], b[3]])
}

/// Elements of an accessor or a part of it, whose bytes exist.
#[derive(Clone, Copy)]
struct Elements<'a> {
    bytes: &'a [u8],
    stride: usize,
}

impl<'a> Elements<'a> {
    /// The bytes from the start of element i.
    fn at(&self, i: usize) -> &'a [u8] {
        &self.bytes[i * self.stride..]
    }
}

/// Counts of the accessors that were checked. Each is checked once, however many primitives use it.
pub(super) type AccessorCounts = HashMap<usize, u64>;

impl<'a> Document<'a> {
    pub fn accessor(&self, index: json::Index<Accessor>) -> Result<&Accessor> {
        self.root.accessors.get(index.value()).ok_or_else(|| {
            Error::invalid(
                format!("accessor {} does not exist, there are {}", index.value(), self.root.accessors.len()),
                REPAIR,
            )
        })
    }

    /// Checks that the data of an accessor exist, and returns its count.
    pub fn proven_count(&self, index: json::Index<Accessor>, proven: &mut AccessorCounts) -> Result<u64> {
        if let Some(&count) = proven.get(&index.value()) {
            return Ok(count);
        }
        let accessor = self.accessor(index)?;
        let prove = || {
            let Checked::Valid(type_) = accessor.type_ else { return Err(Error::invalid("unknown type", REPAIR)) };
            let size = type_.multiplicity() * component_of(accessor)?.size();
            self.base(accessor, size, type_ != Type::Scalar)?;
            if let Some(sparse) = self.sparse(accessor, size)? {
                sparse.prove(accessor.count.0)?;
            }
            Ok(accessor.count.0)
        };
        let count = prove().map_err(|e: Error| e.at(format!("accessor {}", index.value())))?;
        proven.insert(index.value(), count);
        Ok(count)
    }

    /// The elements of an accessor without its sparse part; `None` if all are zeros.
    fn base(&self, accessor: &Accessor, size: usize, strided: bool) -> Result<Option<Elements<'_>>> {
        let count = accessor.count.0;
        let Some(view) = accessor.buffer_view else { return zero_filled(count).map(|()| None) };
        let offset = accessor.byte_offset.map_or(0, |o| o.0);
        self.elements(view.value(), offset, count, size, strided).map(Some)
    }

    /// The sparse part of an accessor whose elements have `size` bytes.
    fn sparse(&self, accessor: &Accessor, size: usize) -> Result<Option<Sparse<'_>>> {
        let Some(sparse) = &accessor.sparse else { return Ok(None) };
        let broken = |what: String| Error::invalid(what, REPAIR).at("sparse");
        let Checked::Valid(kind) = sparse.indices.component_type else {
            return Err(broken("indices must be u8, u16 or u32".into()));
        };
        let component = kind.0;
        let count = sparse.count.0;
        if count > accessor.count.0 {
            return Err(broken(format!("{count} values replace {}", accessor.count.0)));
        }
        let i = &sparse.indices;
        let indices = self.elements(i.buffer_view.value(), i.byte_offset.0, count, component.size(), false)?;
        let v = &sparse.values;
        let values = self.elements(v.buffer_view.value(), v.byte_offset.0, count, size, false)?;
        Ok(Some(Sparse { count: count as usize, component, indices, values }))
    }

    /// The bytes of a view from `offset` on. Checks that they hold `count` elements.
    fn elements(&self, view: usize, offset: u64, count: u64, size: usize, strided: bool) -> Result<Elements<'_>> {
        let place = |e: Error| e.at(format!("buffer view {view}"));
        let views = &self.root.buffer_views;
        let v = views
            .get(view)
            .ok_or_else(|| Error::invalid(format!("it does not exist, there are {}", views.len()), REPAIR))
            .map_err(place)?;
        let buffer = v.buffer.value();
        let bytes = self.buffers.get(buffer).map_err(place)?;
        let (start, length) = (v.byte_offset.map_or(0, |o| o.0), v.byte_length.0);
        let end = start.checked_add(length).filter(|&end| end <= bytes.len() as u64).ok_or_else(|| {
            place(Error::invalid(
                format!("bytes {start} + {length} are claimed, buffer {buffer} has {}", bytes.len()),
                "the buffer is truncated or the model is broken; export it again",
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
                "the buffer is truncated or the model is broken; export it again",
            )));
        }
        // Both ends lie inside a slice, so they fit usize. An empty accessor may point anywhere.
        let whole = &bytes[start as usize..end as usize];
        Ok(Elements { bytes: whole.get(offset as usize..).unwrap_or_default(), stride })
    }

    /// The data of an accessor whose elements are of this type. `words` names them in messages. Its sparse part must
    /// have been checked ([`Document::proven_count`]).
    pub fn values(&self, index: json::Index<Accessor>, type_: Type, words: &str) -> Result<Values<'_>> {
        let place = format!("accessor {}", index.value());
        let accessor = self.accessor(index)?;
        self.values_of(accessor, type_, words).map_err(|e| e.at(place))
    }

    fn values_of(&self, accessor: &Accessor, type_: Type, words: &str) -> Result<Values<'_>> {
        let component = component_of(accessor)?;
        if accessor.type_ != Checked::Valid(type_) {
            let type_ = format!("{type_:?}").to_uppercase();
            return Err(Error::invalid(format!("{words} must be {type_}"), REPAIR));
        }
        let size = type_.multiplicity() * component.size();
        let base = self.base(accessor, size, true)?;
        let sparse = self.sparse(accessor, size)?;
        Ok(Values { count: accessor.count.0 as usize, base, component, normalized: accessor.normalized, sparse })
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
        let count = accessor.count.0 as usize;
        let mut all = match self.base(accessor, size, false)? {
            None => vec![0; count],
            Some(e) => e.bytes[..count * size].chunks_exact(size).map(|b| index_at(b, component)).collect::<Vec<u32>>(),
        };
        if let Some(sparse) = self.sparse(accessor, size)? {
            sparse.prove(accessor.count.0)?;
            for k in 0..sparse.count {
                all[sparse.index(k) as usize] = index_at(sparse.values.at(k), component);
            }
        }
        Ok(all)
    }
}

/// The accessor of a primitive's positions.
pub(super) fn position_accessor(primitive: &Primitive) -> Option<json::Index<Accessor>> {
    primitive.attributes.get(&Checked::Valid(Semantic::Positions)).copied()
}

fn component_of(accessor: &Accessor) -> Result<ComponentType> {
    match accessor.component_type {
        Checked::Valid(c) => Ok(c.0),
        Checked::Invalid => Err(Error::new(ErrorKind::Invalid, "unknown component type", REPAIR)),
    }
}

/// Limits accessors without data, which are all zeros: a tiny file could request any amount of memory.
fn zero_filled(count: u64) -> Result<()> {
    if count > limits::MAX_ZERO_FILLED {
        return Err(Error::invalid(
            format!("{count} elements are claimed without data, {} is the limit", limits::MAX_ZERO_FILLED),
            REPAIR,
        ));
    }
    Ok(())
}

fn index_at(b: &[u8], component: ComponentType) -> u32 {
    match component {
        ComponentType::U8 => u32::from(b[0]),
        ComponentType::U16 => u32::from(u16::from_le_bytes([b[0], b[1]])),
        _ => u32::from_le_bytes([b[0], b[1], b[2], b[3]]),
    }
}

/// One component as f32. Normalized integers follow glTF 2.0, section 3.11.
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
