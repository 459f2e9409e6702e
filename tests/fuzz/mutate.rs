//! Makes inputs by mutation, as a fuzzer does but without its feedback, on any toolchain.

use crate::common::Random;

/// Replacements for numbers.
const NUMBERS: [&str; 29] = [
    "0",
    "-0",
    "1",
    "-1",
    "2",
    "0.5",
    "nan",
    "NaN",
    "inf",
    "-inf",
    "Infinity",
    "1e999",
    "1e308",
    "-1e308",
    "5e-324",
    "1e-300",
    "1e200",
    "1e13",
    "1e12",
    "1e-12",
    "90",
    "-180",
    "360",
    "16384",
    "16385",
    "4294967295",
    "4294967296",
    "9223372036854775807",
    "18446744073709551616",
];

/// Punctuation of all formats.
const TOKENS: [&str; 20] = [
    "{", "}", "[", "]", "[[", "]]", "\"", "'", ",", ":", "=", "\n", "\0", "#", "null", "true", "{}", "[]", "\u{fffd}",
    "\\u0000",
];

/// Makes inputs from a corpus and words of the format.
pub struct Mutator<'a> {
    dice: Random,
    corpus: &'a [Vec<u8>],
    words: &'a [&'a str],
    most: usize,
}

impl<'a> Mutator<'a> {
    /// The largest input is twice the longest in the corpus.
    pub fn new(corpus: &'a [Vec<u8>], words: &'a [&'a str], seed: u64) -> Self {
        let most = 2 * corpus.iter().map(Vec::len).max().unwrap_or(0) + 64;
        Self { dice: Random(seed), corpus, words, most }
    }

    /// The next input.
    pub fn next(&mut self, out: &mut Vec<u8>) {
        out.clear();
        out.extend_from_slice(&self.corpus[self.dice.below(self.corpus.len())]);
        // Mostly one change, rarely sixteen: with many changes every reader refuses the input at once.
        let changes = 1 + self.dice.bits().trailing_zeros().min(15);
        for _ in 0..changes {
            self.change(out);
        }
        out.truncate(self.most);
    }

    fn change(&mut self, out: &mut Vec<u8>) {
        let at = self.dice.below(out.len() + 1);
        match self.dice.below(12) {
            0 if at < out.len() => out[at] ^= 1 << self.dice.below(8),
            1 if at < out.len() => out[at] = self.dice.bits() as u8,
            2 if at < out.len() => out[at] = [0, 0xff, 0x7f, 0x80, b'0', b'9', b'-', b'.'][self.dice.below(8)],
            3 => out.truncate(at),
            4 => drop(out.drain(at..(at + 1 + self.dice.below(16)).min(out.len()))),
            5 => {
                let end = (at + 1 + self.dice.below(64)).min(out.len());
                let again = out[at..end].to_vec();
                put(out, at, 0, &again);
            }
            6 => self.splice(out, at),
            7 => self.token(out, at),
            8 => {
                let word = self.dice.bits().to_le_bytes();
                let len = 1 << self.dice.below(4);
                put(out, at, len, &word[..len]);
            }
            _ => self.number(out, at),
        }
    }

    /// Inserts a part of another input.
    fn splice(&mut self, out: &mut Vec<u8>, at: usize) {
        let other = &self.corpus[self.dice.below(self.corpus.len())];
        let from = self.dice.below(other.len() + 1);
        let to = (from + 1 + self.dice.below(200)).min(other.len());
        let over = if self.dice.below(2) == 0 { 0 } else { to - from };
        put(out, at, over, &other[from..to]);
    }

    fn token(&mut self, out: &mut Vec<u8>, at: usize) {
        let i = self.dice.below(TOKENS.len() + self.words.len());
        let token = TOKENS.get(i).copied().unwrap_or_else(|| self.words[i - TOKENS.len()]);
        let over = if self.dice.below(2) == 0 { 0 } else { token.len() };
        put(out, at, over, token.as_bytes());
    }

    /// Replaces the first number at or after a place, or the text's last one.
    fn number(&mut self, out: &mut Vec<u8>, at: usize) {
        let digit = |b: &u8| b.is_ascii_digit();
        let Some(start) = out[at..].iter().position(digit).map(|i| at + i).or_else(|| out.iter().rposition(digit))
        else {
            return self.token(out, at);
        };
        let part = |b: &u8| b.is_ascii_digit() || matches!(b, b'.' | b'e' | b'E' | b'+' | b'-');
        let len = out[start..].iter().take_while(|b| part(b)).count();
        match self.dice.below(3) {
            0 => put(out, start, len, NUMBERS[self.dice.below(NUMBERS.len())].as_bytes()),
            1 => put(out, start, len, self.dice.below(300).to_string().as_bytes()),
            _ => put(out, start, len, format!("{:e}", f64::from_bits(self.dice.bits())).as_bytes()),
        }
    }
}

/// Replaces `over` bytes by others, or inserts these if `over` is 0.
fn put(out: &mut Vec<u8>, at: usize, over: usize, bytes: &[u8]) {
    let end = (at + over).min(out.len());
    out.splice(at..end, bytes.iter().copied());
}
