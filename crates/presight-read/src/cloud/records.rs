//! Records of numbers: three are the coordinates of a point, one may be its time, others are ignored.

use super::super::text::line_of;
use super::times::{PointTimes, field_of};
use glam::DVec3;
use presight_model::error::{Error, Result};
use presight_model::{limits, memory};

/// The encoding of numbers.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Encoding {
    Text,
    Little,
    Big,
}

/// The type of a number.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Number {
    /// An integer of this many bytes.
    Signed(usize),
    Unsigned(usize),
    /// 4 or 8 bytes.
    Float(usize),
}

impl Number {
    pub fn bytes(self) -> usize {
        match self {
            Self::Signed(n) | Self::Unsigned(n) | Self::Float(n) => n,
        }
    }

    /// Reads the number from little-endian bytes.
    fn read(self, bytes: &[u8]) -> f64 {
        let mut eight = [0; 8];
        eight[..bytes.len()].copy_from_slice(bytes);
        let whole = u64::from_le_bytes(eight);
        match self {
            Self::Float(4) => f64::from(f32::from_bits(whole as u32)),
            Self::Float(_) => f64::from_bits(whole),
            Self::Unsigned(_) => whole as f64,
            Self::Signed(n) => {
                let unused = 64 - 8 * n as u32;
                ((whole << unused) as i64 >> unused) as f64
            }
        }
    }
}

/// The records as the header describes them.
#[derive(Debug)]
pub struct Records {
    pub encoding: Encoding,
    pub count: usize,
    /// Names and types of the numbers in one record.
    pub numbers: Vec<(String, Number)>,
}

impl Records {
    /// Reads the points, and their times if there are any, from the data after the header.
    pub fn points(&self, body: &[u8]) -> Result<(Vec<DVec3>, Option<PointTimes>)> {
        if self.count as u64 > limits::MAX_PIXELS {
            let what = format!("it has {} points", self.count);
            return Err(Error::invalid(what, format!("the limit is {}: give fewer points", limits::MAX_PIXELS)));
        }
        let column = |name: &str| self.numbers.iter().position(|(n, _)| n == name);
        let (Some(x), Some(y), Some(z)) = (column("x"), column("y"), column("z")) else {
            return Err(Error::invalid("its points have no x, y and z", "name the coordinates x, y and z"));
        };
        // In text, a number takes at least two bytes.
        let min_bytes = match self.encoding {
            Encoding::Text => 2 * self.numbers.len(),
            _ => self.numbers.iter().map(|(_, n)| n.bytes()).sum(),
        };
        if (self.count as u64).saturating_mul(min_bytes as u64) > body.len() as u64 + 1 {
            let what = format!("{} bytes follow its header, too few for {} points", body.len(), self.count);
            return Err(Error::invalid(what, "the file is truncated: write it again"));
        }
        let mut points = memory::reserved(self.count)?;
        let Some(t) = field_of(self.numbers.iter().map(|(name, _)| name.as_str())) else {
            self.read(body, [x, y, z], |[x, y, z]| points.push(DVec3::new(x, y, z)))?;
            return Ok((points, None));
        };
        let mut values = memory::reserved(self.count)?;
        self.read(body, [x, y, z, t], |[x, y, z, t]| {
            points.push(DVec3::new(x, y, z));
            values.push(t);
        })?;
        let (field, number) = &self.numbers[t];
        let is_whole = !matches!(number, Number::Float(_));
        Ok((points, Some(PointTimes { field: field.clone(), values, is_whole })))
    }

    /// Calls `add` with some of the numbers of each record.
    fn read<const N: usize>(&self, body: &[u8], columns: [usize; N], add: impl FnMut([f64; N])) -> Result<()> {
        match self.encoding {
            Encoding::Text => self.read_text(body, columns, add),
            _ => {
                self.read_binary(body, columns, add);
                Ok(())
            }
        }
    }

    fn read_text<const N: usize>(&self, body: &[u8], columns: [usize; N], mut add: impl FnMut([f64; N])) -> Result<()> {
        let text = std::str::from_utf8(body);
        let text = text.map_err(|_| Error::invalid("its points are not text", "name the actual encoding"))?;
        let lines = text.lines().filter(|line| !line.trim().is_empty());
        let mut count = 0;
        for line in lines.take(self.count) {
            let words: Vec<&str> = line.split_whitespace().take(self.numbers.len()).collect();
            let number = |i: usize| words.get(i).and_then(|word| word.parse::<f64>().ok());
            let found = columns.map(number);
            if found.contains(&None) {
                let offset = line.as_ptr() as usize - text.as_ptr() as usize;
                let what = format!("line {} after its header is not a point", line_of(text, offset));
                return Err(Error::invalid(what, format!("give {} numbers per line", self.numbers.len())));
            }
            add(found.map(Option::unwrap_or_default));
            count += 1;
        }
        if count < self.count {
            let what = format!("it has {count} points, but its header announces {}", self.count);
            return Err(Error::invalid(what, "the file is truncated: write it again"));
        }
        Ok(())
    }

    fn read_binary<const N: usize>(&self, body: &[u8], columns: [usize; N], mut add: impl FnMut([f64; N])) {
        let size: usize = self.numbers.iter().map(|(_, n)| n.bytes()).sum();
        let start = |i: usize| self.numbers[..i].iter().map(|(_, n)| n.bytes()).sum::<usize>();
        let places = columns.map(|i| (start(i), self.numbers[i].1));
        for record in body.chunks_exact(size).take(self.count) {
            add(places.map(|(at, number)| {
                let mut bytes = [0; 8];
                let bytes = &mut bytes[..number.bytes()];
                bytes.copy_from_slice(&record[at..at + number.bytes()]);
                if self.encoding == Encoding::Big {
                    bytes.reverse();
                }
                number.read(bytes)
            }));
        }
    }
}
