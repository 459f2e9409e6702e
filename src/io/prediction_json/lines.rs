//! JSON that people and editors can read: a line for each key of an entry, and whole lists of numbers on theirs.

use serde::Serialize;
use serde_json::Serializer;
use serde_json::ser::{CompactFormatter, Formatter, PrettyFormatter};
use std::io::{self, Write};

/// Deeper lists and objects are not broken into lines: a point cloud would have one a number.
const DEEPEST: usize = 3;

/// The text of a value.
pub fn to_string(value: &impl Serialize) -> serde_json::Result<String> {
    let mut bytes = Vec::new();
    let lines = Lines { depth: 0, pretty: PrettyFormatter::new(), compact: CompactFormatter };
    value.serialize(&mut Serializer::with_formatter(&mut bytes, lines))?;
    String::from_utf8(bytes).map_err(serde::ser::Error::custom)
}

struct Lines {
    depth: usize,
    pretty: PrettyFormatter<'static>,
    compact: CompactFormatter,
}

/// Hands a call on to the one or the other formatter.
macro_rules! by_depth {
    ($name:ident $(, $argument:ident: $type:ty)?) => {
        fn $name<W: ?Sized + Write>(&mut self, writer: &mut W $(, $argument: $type)?) -> io::Result<()> {
            if self.depth <= DEEPEST {
                self.pretty.$name(writer $(, $argument)?)
            } else {
                self.compact.$name(writer $(, $argument)?)
            }
        }
    };
}

impl Lines {
    fn enter<W: ?Sized + Write>(
        &mut self,
        writer: &mut W,
        pretty: impl FnOnce(&mut PrettyFormatter<'static>, &mut W) -> io::Result<()>,
        compact: impl FnOnce(&mut CompactFormatter, &mut W) -> io::Result<()>,
    ) -> io::Result<()> {
        self.depth += 1;
        if self.depth <= DEEPEST { pretty(&mut self.pretty, writer) } else { compact(&mut self.compact, writer) }
    }

    fn leave<W: ?Sized + Write>(
        &mut self,
        writer: &mut W,
        pretty: impl FnOnce(&mut PrettyFormatter<'static>, &mut W) -> io::Result<()>,
        compact: impl FnOnce(&mut CompactFormatter, &mut W) -> io::Result<()>,
    ) -> io::Result<()> {
        self.depth -= 1;
        if self.depth < DEEPEST { pretty(&mut self.pretty, writer) } else { compact(&mut self.compact, writer) }
    }
}

impl Formatter for Lines {
    fn begin_array<W: ?Sized + Write>(&mut self, writer: &mut W) -> io::Result<()> {
        self.enter(writer, |f, w| f.begin_array(w), |f, w| f.begin_array(w))
    }

    fn end_array<W: ?Sized + Write>(&mut self, writer: &mut W) -> io::Result<()> {
        self.leave(writer, |f, w| f.end_array(w), |f, w| f.end_array(w))
    }

    fn begin_object<W: ?Sized + Write>(&mut self, writer: &mut W) -> io::Result<()> {
        self.enter(writer, |f, w| f.begin_object(w), |f, w| f.begin_object(w))
    }

    fn end_object<W: ?Sized + Write>(&mut self, writer: &mut W) -> io::Result<()> {
        self.leave(writer, |f, w| f.end_object(w), |f, w| f.end_object(w))
    }

    by_depth!(begin_array_value, first: bool);
    by_depth!(end_array_value);
    by_depth!(begin_object_key, first: bool);
    by_depth!(end_object_key);
    by_depth!(begin_object_value);
    by_depth!(end_object_value);
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::{Value, json};

    #[test]
    fn entries_are_lines_and_lists_of_numbers_are_one() {
        let value = json!({"a": [{"b": [1, 2, [3, {"c": 4}]], "d": {}}, []], "e": [], "f": {"g": [[1], [2]]}});
        let text = to_string(&value).unwrap();
        assert_eq!(serde_json::from_str::<Value>(&text).unwrap(), value);
        assert!(text.contains("\n      \"b\": [1,2,[3,{\"c\":4}]]"), "{text}");
        assert_eq!(text.lines().count(), 16, "{text}");
    }
}
