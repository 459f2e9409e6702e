//! Hashes of rows, of all rows together, and of the log.
//!
//! The hash of a row is BLAKE3 of the table's name and each column but the hash itself: one byte for its type (0 null,
//! 1 integer, 2 real, 3 text, 4 blob), for text and blob the length as u64, then the value, little-endian. In place of a
//! mesh's blob stands its XXH3 of 128 bits, least byte first, which takes a fifth of the time of its BLAKE3, which stood
//! there before format 4. The digest of all rows is the sum of their hashes, each taken as four u64, without carries: it
//! follows each change by a subtraction and an addition, whatever the order of rows.

/// BLAKE3.
pub(super) type Hash = [u8; 32];

/// The value of a column.
#[derive(Clone, Copy)]
pub(super) enum Field<'a> {
    Null,
    Integer(i64),
    Real(f64),
    Text(&'a str),
    Blob(&'a [u8]),
}

impl<'a> From<Option<&'a str>> for Field<'a> {
    fn from(text: Option<&'a str>) -> Self {
        text.map_or(Self::Null, Self::Text)
    }
}

impl From<Option<i64>> for Field<'_> {
    fn from(value: Option<i64>) -> Self {
        value.map_or(Self::Null, Self::Integer)
    }
}

/// The hash of a row; `before` is what stands in front (a table's name, or the entry of the log before).
pub(super) fn of_row(before: &[u8], fields: &[Field<'_>]) -> Hash {
    let mut bytes = Vec::with_capacity(512);
    bytes.extend_from_slice(before);
    for field in fields {
        let (kind, value): (u8, &[u8]) = match field {
            Field::Null => (0, &[]),
            Field::Integer(i) => (1, &i.to_le_bytes()),
            Field::Real(x) => (2, &x.to_le_bytes()),
            Field::Text(text) => (3, text.as_bytes()),
            Field::Blob(blob) => (4, blob),
        };
        bytes.push(kind);
        if kind >= 3 {
            bytes.extend_from_slice(&(value.len() as u64).to_le_bytes());
        }
        bytes.extend_from_slice(value);
    }
    *blake3::hash(&bytes).as_bytes()
}

/// The digest of all rows.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Digest([u64; 4]);

impl Digest {
    pub fn add(&mut self, row: &Hash) {
        self.combine(row, u64::wrapping_add);
    }

    pub fn subtract(&mut self, row: &Hash) {
        self.combine(row, u64::wrapping_sub);
    }

    fn combine(&mut self, row: &Hash, with: fn(u64, u64) -> u64) {
        for (sum, part) in self.0.iter_mut().zip(row.as_chunks::<8>().0) {
            *sum = with(*sum, u64::from_le_bytes(*part));
        }
    }

    pub fn to_bytes(self) -> Hash {
        let mut bytes = [0; 32];
        for (to, part) in bytes.as_chunks_mut::<8>().0.iter_mut().zip(self.0) {
            *to = part.to_le_bytes();
        }
        bytes
    }

    pub fn from_bytes(bytes: &Hash) -> Self {
        let mut digest = Self::default();
        digest.add(bytes);
        digest
    }
}

/// The XXH3 of a mesh's blob, in pieces.
pub(super) fn of_content(pieces: &[&[u8]]) -> u128 {
    let mut hasher = twox_hash::XxHash3_128::new();
    pieces.iter().for_each(|piece| hasher.write(piece));
    hasher.finish_128()
}

/// As people read it.
pub(super) fn hex(hash: &Hash) -> String {
    presight_model::environment::ContentHash(*hash).to_string()
}
