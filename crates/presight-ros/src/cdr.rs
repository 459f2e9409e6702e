//! CDR, the wire format of ROS 2 messages, in both directions: [`Cursor`] decodes, [`Sink`] encodes.
//!
//! A message starts with four header bytes: the representation (big or little endian) and two bytes of options. Every
//! primitive is aligned to its own size, counted from behind the header. A string is a length with its final zero, then
//! the bytes; a sequence is a length, then its elements.

use presight_model::error::{Error, Result};

/// Reads one message from front to back. Every length is compared with the remaining bytes before memory is allocated.
#[derive(Clone, Debug)]
pub struct Cursor<'a> {
    /// The message behind its header.
    data: &'a [u8],
    at: usize,
    big_endian: bool,
}

/// Writes one message from front to back, in little endian.
#[derive(Clone, Debug)]
pub struct Sink {
    /// The message with its header.
    bytes: Vec<u8>,
}

/// A value of a message, with both directions of its encoding.
pub trait Field<'a>: Sized {
    /// Minimum number of bytes of an encoded value.
    const MIN_SIZE: usize = 1;

    /// Decodes the next value.
    ///
    /// # Errors
    /// [`presight_model::ErrorKind::Invalid`] if the message ends early or a length is greater than the rest of it.
    fn read(cursor: &mut Cursor<'a>) -> Result<Self>;

    /// Appends the value.
    fn write(&self, sink: &mut Sink);

    /// Decodes the next `count` values; at least `count * MIN_SIZE` bytes remain.
    ///
    /// # Errors
    /// As [`Field::read`].
    fn read_many(count: usize, cursor: &mut Cursor<'a>) -> Result<Vec<Self>> {
        (0..count).map(|_| Self::read(cursor)).collect()
    }

    /// Appends values one after the other.
    fn write_many(values: &[Self], sink: &mut Sink) {
        values.iter().for_each(|value| value.write(sink));
    }
}

/// A numeric primitive of CDR.
pub trait Primitive: Sized + Copy {
    /// Its size and alignment, in bytes.
    const SIZE: usize;
    /// Decodes `SIZE` bytes.
    fn decode(bytes: &[u8], big_endian: bool) -> Self;
}

macro_rules! primitives {
    ($($type:ty),*) => {$(
        impl Primitive for $type {
            const SIZE: usize = size_of::<$type>();
            fn decode(bytes: &[u8], big_endian: bool) -> Self {
                let bytes = bytes.try_into().expect("the caller passes SIZE bytes");
                if big_endian { Self::from_be_bytes(bytes) } else { Self::from_le_bytes(bytes) }
            }
        }

        impl<'a> Field<'a> for $type {
            const MIN_SIZE: usize = size_of::<$type>();
            fn read(cursor: &mut Cursor<'a>) -> Result<Self> {
                cursor.align(Self::SIZE);
                Ok(Self::decode(cursor.take(Self::SIZE)?, cursor.big_endian))
            }
            fn write(&self, sink: &mut Sink) {
                sink.align(Self::SIZE);
                sink.bytes.extend_from_slice(&self.to_le_bytes());
            }
            fn read_many(count: usize, cursor: &mut Cursor<'a>) -> Result<Vec<Self>> {
                cursor.align(if count > 0 { Self::SIZE } else { 1 });
                let bytes = cursor.take(count * Self::SIZE)?;
                Ok(bytes.chunks_exact(Self::SIZE).map(|bytes| Self::decode(bytes, cursor.big_endian)).collect())
            }
            fn write_many(values: &[Self], sink: &mut Sink) {
                sink.align(if values.is_empty() { 1 } else { Self::SIZE });
                sink.bytes.reserve(size_of_val(values));
                values.iter().for_each(|value| sink.bytes.extend_from_slice(&value.to_le_bytes()));
            }
        }
    )*};
}
primitives!(u8, i8, u16, i16, u32, i32, u64, i64, f32, f64);

/// Any byte but 0 is true.
impl<'a> Field<'a> for bool {
    fn read(cursor: &mut Cursor<'a>) -> Result<Self> {
        Ok(u8::read(cursor)? != 0)
    }

    fn write(&self, sink: &mut Sink) {
        u8::from(*self).write(sink);
    }
}

/// A sequence of bytes, which is not copied.
impl<'a> Field<'a> for &'a [u8] {
    const MIN_SIZE: usize = 4;

    fn read(cursor: &mut Cursor<'a>) -> Result<Self> {
        let length = cursor.read_length(1)?;
        cursor.take(length)
    }

    fn write(&self, sink: &mut Sink) {
        sink.write_length(self.len());
        sink.bytes.extend_from_slice(self);
    }
}

/// A byte that is not UTF-8 becomes the replacement character: names are only shown and compared.
impl<'a> Field<'a> for String {
    const MIN_SIZE: usize = 4;

    fn read(cursor: &mut Cursor<'a>) -> Result<Self> {
        let bytes = <&[u8]>::read(cursor)?;
        let text = bytes.strip_suffix(&[0]).unwrap_or(bytes);
        Ok(String::from_utf8_lossy(text).into_owned())
    }

    fn write(&self, sink: &mut Sink) {
        sink.write_length(self.len() + 1);
        sink.bytes.extend_from_slice(self.as_bytes());
        sink.bytes.push(0);
    }
}

/// A sequence.
impl<'a, T: Field<'a>> Field<'a> for Vec<T> {
    const MIN_SIZE: usize = 4;

    fn read(cursor: &mut Cursor<'a>) -> Result<Self> {
        let length = cursor.read_length(T::MIN_SIZE)?;
        T::read_many(length, cursor)
    }

    fn write(&self, sink: &mut Sink) {
        sink.write_length(self.len());
        T::write_many(self, sink);
    }
}

/// An array of fixed size, which has no length in front.
impl<'a, T: Field<'a> + Copy + Default, const N: usize> Field<'a> for [T; N] {
    const MIN_SIZE: usize = N * T::MIN_SIZE;

    fn read(cursor: &mut Cursor<'a>) -> Result<Self> {
        let mut array = [T::default(); N];
        for value in &mut array {
            *value = T::read(cursor)?;
        }
        Ok(array)
    }

    fn write(&self, sink: &mut Sink) {
        T::write_many(self, sink);
    }
}

/// Implements [`Field`] for a structure by the order of its fields in the definition of the message.
macro_rules! fields {
    ($name:ident $(<$life:lifetime>)? { $($field:ident),+ $(,)? }) => {
        impl<'a> $crate::cdr::Field<'a> for $name $(<$life>)? {
            fn read(cursor: &mut $crate::cdr::Cursor<'a>) -> presight_model::error::Result<Self> {
                Ok(Self { $($field: $crate::cdr::Field::read(cursor)?),+ })
            }

            fn write(&self, sink: &mut $crate::cdr::Sink) {
                $($crate::cdr::Field::write(&self.$field, sink);)+
            }
        }
    };
}
pub(crate) use fields;

impl Sink {
    /// Starts a message with its header: plain CDR, little endian, no options.
    #[allow(clippy::new_without_default, reason = "an empty message has no value")]
    pub fn new() -> Self {
        Self { bytes: vec![0, 1, 0, 0] }
    }

    /// The message.
    pub fn into_bytes(self) -> Vec<u8> {
        self.bytes
    }

    /// Fills with zeros to a multiple of `size`, counted from behind the header.
    fn align(&mut self, size: usize) {
        let length = (self.bytes.len() - 4).next_multiple_of(size);
        self.bytes.resize(4 + length, 0);
    }

    /// Appends the length of a sequence. Nothing that presight writes reaches 2^32 elements: limits hold images and
    /// models below.
    fn write_length(&mut self, length: usize) {
        u32::try_from(length).expect("images and models are limited").write(self);
    }
}

impl<'a> Cursor<'a> {
    /// Starts behind the header of a message.
    ///
    /// # Errors
    /// [`presight_model::ErrorKind::Invalid`] if the message is shorter than its header;
    /// [`presight_model::ErrorKind::Unsupported`] if its representation is not plain CDR.
    pub fn new(message: &'a [u8]) -> Result<Self> {
        let Some((header, data)) = message.split_at_checked(4) else {
            return Err(Error::invalid("the message has no header", "record the topic again"));
        };
        match header[..2] {
            [0, endianness @ (0 | 1)] => Ok(Self { data, at: 0, big_endian: endianness == 0 }),
            [high, low] => Err(Error::new(
                presight_model::ErrorKind::Unsupported,
                format!("the representation {high:#04x}{low:02x} of the message is not plain CDR"),
                "record the topic with serialization format cdr",
            )),
            _ => unreachable!("a slice of two bytes"),
        }
    }

    /// The remaining bytes.
    pub fn remaining(&self) -> usize {
        self.data.len() - self.at
    }

    /// The next bytes, without alignment.
    fn take(&mut self, count: usize) -> Result<&'a [u8]> {
        let end = self.at.checked_add(count).filter(|end| *end <= self.data.len());
        let end = end.ok_or_else(|| {
            let what = format!("the message ends after {} bytes where {count} more belong", self.remaining());
            Error::invalid(what, "the recording is damaged, or the type of the topic differs from its definition")
        })?;
        let taken = &self.data[self.at..end];
        self.at = end;
        Ok(taken)
    }

    fn align(&mut self, size: usize) {
        self.at = self.at.next_multiple_of(size).min(self.data.len());
    }

    /// The length of the next sequence, whose elements take at least `element_bytes` each.
    fn read_length(&mut self, element_bytes: usize) -> Result<usize> {
        let length = u32::read(self)? as usize;
        if length.saturating_mul(element_bytes) > self.remaining() {
            let what = format!("a sequence has {length} elements, but {} bytes remain", self.remaining());
            return Err(Error::invalid(
                what,
                "the recording is damaged, or the type of the topic differs from its definition",
            ));
        }
        Ok(length)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A byte, then a double: by hand, the double starts 8 bytes behind the header, not 8 bytes behind its start.
    #[test]
    fn alignment_counts_from_behind_the_header() {
        let mut message = vec![0, 1, 0, 0, 7, 0, 0, 0, 0, 0, 0, 0];
        message.extend(2.5f64.to_le_bytes());
        let mut cursor = Cursor::new(&message).unwrap();
        assert_eq!(u8::read(&mut cursor).unwrap(), 7);
        assert_eq!(f64::read(&mut cursor).unwrap(), 2.5);
        assert_eq!(cursor.remaining(), 0);
    }

    /// By hand: a byte, seven of padding, a double, an empty sequence of doubles without padding behind its length, a
    /// string with its zero.
    #[test]
    fn a_sink_aligns_from_behind_the_header() {
        let mut sink = Sink::new();
        7u8.write(&mut sink);
        2.5f64.write(&mut sink);
        Vec::<f64>::new().write(&mut sink);
        "ab".to_owned().write(&mut sink);
        let mut expected = vec![0, 1, 0, 0, 7, 0, 0, 0, 0, 0, 0, 0];
        expected.extend(2.5f64.to_le_bytes());
        expected.extend([0, 0, 0, 0, 3, 0, 0, 0, b'a', b'b', 0]);
        assert_eq!(sink.into_bytes(), expected);
    }

    #[test]
    fn both_byte_orders_give_the_same() {
        let little = [0, 1, 0, 0, 3, 0, 0, 0, b'a', b'b', 0, 0, 1, 0, 0, 0, 0, 0, 0x80, 0x3f];
        let big = [0, 0, 0, 0, 0, 0, 0, 3, b'a', b'b', 0, 0, 0, 0, 0, 1, 0x3f, 0x80, 0, 0];
        for message in [little, big] {
            let mut cursor = Cursor::new(&message).unwrap();
            assert_eq!(String::read(&mut cursor).unwrap(), "ab");
            assert_eq!(Vec::<f32>::read(&mut cursor).unwrap(), [1.0]);
        }
    }

    #[test]
    fn a_huge_length_is_refused_before_it_is_allocated() {
        let message = [0, 1, 0, 0, 0xff, 0xff, 0xff, 0xff];
        let e = Vec::<f64>::read(&mut Cursor::new(&message).unwrap()).unwrap_err();
        assert!(e.to_string().contains("4294967295 elements"), "{e}");
        let e = Cursor::new(&message[..3]).unwrap_err();
        assert!(e.to_string().contains("no header"), "{e}");
        let e = Cursor::new(&[0, 7, 0, 0]).unwrap_err();
        assert_eq!(e.kind(), presight_model::ErrorKind::Unsupported);
    }
}
