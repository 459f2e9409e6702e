//! Makes texts of files and users safe to print in a message. Data formats keep such texts unchanged.

use std::borrow::Cow;

/// Maximum length of a quotation from a file in a message, characters.
const QUOTED: usize = 60;

/// Escapes unprintable characters, including line breaks, so that a name cannot break a line or control a terminal.
pub fn printable(text: &str) -> Cow<'_, str> {
    if text.bytes().all(|byte| (b' '..=b'~').contains(&byte)) {
        return Cow::Borrowed(text);
    }
    let mut line = String::with_capacity(text.len());
    for c in text.chars() {
        match c {
            ' '..='~' => line.push(c),
            // Combining marks are printable only after a letter.
            _ => line.extend(String::from_iter(['a', c]).escape_debug().skip(1)),
        }
    }
    Cow::Owned(line)
}

/// Jaro similarity from which on two words are alike: below it a typing error is less likely than another word. The command
/// line parser has the same limit.
const ALIKE: f64 = 0.7;

/// `did you mean "floor"? ` with the name most like a word, or nothing if no name is alike.
pub fn did_you_mean<'a>(word: &str, names: impl IntoIterator<Item = &'a str>) -> String {
    let rated = names.into_iter().map(|name| (strsim::jaro(&word.to_lowercase(), &name.to_lowercase()), name));
    let best = rated.filter(|(alike, _)| *alike > ALIKE).max_by(|a, b| a.0.total_cmp(&b.0));
    best.map_or(String::new(), |(_, name)| format!("did you mean {}? ", quoted(name)))
}

/// The first `longest` characters, and `..` if there are more.
pub fn clipped(text: &str, longest: usize) -> Cow<'_, str> {
    match text.char_indices().nth(longest) {
        None => Cow::Borrowed(text),
        Some((end, _)) => Cow::Owned(format!("{}..", &text[..end])),
    }
}

/// At most about `longest` characters: the start and the end of a longer text, because paths differ mostly at the end.
pub fn clipped_inside(text: &str, longest: usize) -> Cow<'_, str> {
    if text.chars().nth(longest).is_none() {
        return Cow::Borrowed(text);
    }
    let end = text.char_indices().nth(longest / 2).map_or(0, |(i, _)| i);
    let start = text.char_indices().nth_back(longest / 2 - 1).map_or(0, |(i, _)| i);
    Cow::Owned(format!("{}..{}", &text[..end], &text[start..]))
}

/// A text in quotation marks for a message; a long one is cut and its length added.
pub fn quoted(text: &str) -> String {
    match text.char_indices().nth(QUOTED) {
        None => format!("{text:?}"),
        Some((end, _)) => format!("{:?}.. ({} bytes)", &text[..end], text.len()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_cannot_be_printed_is_escaped() {
        let cases = [
            ("a \"b\" \\ 'c'", "a \"b\" \\ 'c'"),
            ("wall\nnorth\r\t", "wall\\nnorth\\r\\t"),
            ("\u{1b}[31mred\u{9b}\u{7f}\0", "\\u{1b}[31mred\\u{9b}\\u{7f}\\0"),
            // Both forms of an accent; bidirectional text, a line separator, a zero-width space.
            ("é e\u{301} 壁 🤖", "é e\u{301} 壁 🤖"),
            ("\u{202e}a\u{2028}b\u{200b}\u{feff}", "\\u{202e}a\\u{2028}b\\u{200b}\\u{feff}"),
        ];
        for (text, line) in cases {
            assert_eq!(printable(text), line);
            assert_eq!(printable(line), line, "printable text is unchanged");
        }
    }

    #[test]
    fn long_texts_are_cut_between_characters() {
        assert_eq!(clipped("äöü", 3), "äöü");
        assert_eq!(clipped("äöüß", 3), "äöü..");
        assert_eq!(clipped_inside("abcdef", 6), "abcdef");
        assert_eq!(clipped_inside("äbcdefg", 6), "äbc..efg");
        assert_eq!(quoted("a\"\n"), r#""a\"\n""#);
        assert_eq!(quoted(&"x".repeat(60)), format!("{:?}", "x".repeat(60)));
        assert_eq!(quoted(&"é".repeat(61)), format!("{:?}.. (122 bytes)", "é".repeat(60)));
    }
}
