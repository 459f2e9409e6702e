//! Hashes of rows, of all rows together, and of the log.
//!
//! The hash of a row is BLAKE3 of the table's name and every column but the hash itself. A column contributes one byte
//! for its type (0 null, 1 integer, 2 real, 3 text, 4 blob), the length as u64 (text and blob only), and the value, all
//! little-endian. A mesh's blob is represented by its 128-bit XXH3, which takes a fifth of the time of BLAKE3 (used
//! before format 4). The digest of all rows is the sum of their hashes, each as four u64 without carries. It does not
//! depend on the order of rows, so a changed row costs one subtraction and one addition.

/// A BLAKE3 hash.
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

/// The hash of a row. `before` is hashed first: the table's name, or the hash of the previous log entry.
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

/// Hexadecimal form for output.
pub(super) fn hex(hash: &Hash) -> String {
    presight_model::environment::ContentHash(*hash).to_string()
}
