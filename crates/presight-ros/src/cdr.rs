//! Decoding of CDR, the wire format of ROS 2 messages.
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
    )*};
}
primitives!(u8, i8, u16, i16, u32, i32, u64, i64, f32, f64);

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

    /// The next primitive.
    ///
    /// # Errors
    /// [`presight_model::ErrorKind::Invalid`] if the message ends before it; the same for every method below.
    pub fn read<T: Primitive>(&mut self) -> Result<T> {
        self.align(T::SIZE);
        let bytes = self.take(T::SIZE)?;
        Ok(T::decode(bytes, self.big_endian))
    }

    /// The next boolean: any byte but 0 is true.
    pub fn read_bool(&mut self) -> Result<bool> {
        Ok(self.read::<u8>()? != 0)
    }

    /// The next `N` primitives of an array of fixed size, which has no length in front.
    pub fn read_array<T: Primitive + Default, const N: usize>(&mut self) -> Result<[T; N]> {
        let mut array = [T::default(); N];
        for value in &mut array {
            *value = self.read()?;
        }
        Ok(array)
    }

    /// The length of the next sequence, whose elements take at least `element_bytes` each.
    pub fn read_length(&mut self, element_bytes: usize) -> Result<usize> {
        let length = self.read::<u32>()? as usize;
        if length.saturating_mul(element_bytes) > self.remaining() {
            let what = format!("a sequence has {length} elements, but {} bytes remain", self.remaining());
            return Err(Error::invalid(
                what,
                "the recording is damaged, or the type of the topic differs from its definition",
            ));
        }
        Ok(length)
    }

    /// The next sequence of primitives.
    pub fn read_sequence<T: Primitive>(&mut self) -> Result<Vec<T>> {
        let length = self.read_length(T::SIZE)?;
        if length > 0 {
            self.align(T::SIZE);
        }
        let bytes = self.take(length * T::SIZE)?;
        Ok(bytes.chunks_exact(T::SIZE).map(|bytes| T::decode(bytes, self.big_endian)).collect())
    }

    /// The next sequence of bytes, without copying it.
    pub fn read_bytes(&mut self) -> Result<&'a [u8]> {
        let length = self.read_length(1)?;
        self.take(length)
    }

    /// The next string. A byte that is not UTF-8 becomes the replacement character: names are only shown and compared.
    pub fn read_string(&mut self) -> Result<String> {
        let bytes = self.read_bytes()?;
        let text = bytes.strip_suffix(&[0]).unwrap_or(bytes);
        Ok(String::from_utf8_lossy(text).into_owned())
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
        assert_eq!(cursor.read::<u8>().unwrap(), 7);
        assert_eq!(cursor.read::<f64>().unwrap(), 2.5);
        assert_eq!(cursor.remaining(), 0);
    }

    #[test]
    fn both_byte_orders_give_the_same() {
        let little = [0, 1, 0, 0, 3, 0, 0, 0, b'a', b'b', 0, 0, 1, 0, 0, 0, 0, 0, 0x80, 0x3f];
        let big = [0, 0, 0, 0, 0, 0, 0, 3, b'a', b'b', 0, 0, 0, 0, 0, 1, 0x3f, 0x80, 0, 0];
        for message in [little, big] {
            let mut cursor = Cursor::new(&message).unwrap();
            assert_eq!(cursor.read_string().unwrap(), "ab");
            assert_eq!(cursor.read_sequence::<f32>().unwrap(), [1.0]);
        }
    }

    #[test]
    fn a_huge_length_is_refused_before_it_is_allocated() {
        let message = [0, 1, 0, 0, 0xff, 0xff, 0xff, 0xff];
        let e = Cursor::new(&message).unwrap().read_sequence::<f64>().unwrap_err();
        assert!(e.to_string().contains("4294967295 elements"), "{e}");
        let e = Cursor::new(&message[..3]).unwrap_err();
        assert!(e.to_string().contains("no header"), "{e}");
        let e = Cursor::new(&[0, 7, 0, 0]).unwrap_err();
        assert_eq!(e.kind(), presight_model::ErrorKind::Unsupported);
    }
}
