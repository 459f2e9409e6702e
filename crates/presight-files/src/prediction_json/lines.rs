//! Readable JSON: one line for each key of an entry, and each list of numbers on one line.

use serde::Serialize;
use serde_json::Serializer;
use serde_json::ser::{CompactFormatter, Formatter, PrettyFormatter};
use std::io::{self, Write};

/// Deeper lists and objects stay on one line; otherwise a point cloud would take a line per number.
const DEEPEST: usize = 3;

/// Formats a value.
pub fn to_string(value: &impl Serialize) -> serde_json::Result<String> {
    let mut bytes = Vec::new();
    let (pretty, compact) = (PrettyFormatter::new(), CompactFormatter);
    let lines = Lines { depth: 0, pretty, compact, due: None, in_line: false };
    value.serialize(&mut Serializer::with_formatter(&mut bytes, lines))?;
    String::from_utf8(bytes).map_err(serde::ser::Error::custom)
}

struct Lines {
    depth: usize,
    pretty: PrettyFormatter<'static>,
    compact: CompactFormatter,
    /// Set while the next value of a list is awaited; true for the first value.
    due: Option<bool>,
    /// True while a list's value stays on the line, because it is a number.
    in_line: bool,
}

/// Forwards a call to one of the two formatters, by depth.
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

/// Writes a value that stays on the line of its list.
macro_rules! in_line {
    ($($name:ident: $type:ty),+) => {
        $(fn $name<W: ?Sized + Write>(&mut self, writer: &mut W, value: $type) -> io::Result<()> {
            self.number(writer)?;
            self.compact.$name(writer, value)
        })+
    };
}

impl Lines {
    /// Called before a number: lists of numbers stay on one line.
    fn number<W: ?Sized + Write>(&mut self, writer: &mut W) -> io::Result<()> {
        let Some(first) = self.due.take() else { return Ok(()) };
        self.in_line = true;
        self.compact.begin_array_value(writer, first)
    }

    /// Called before any other value: in a shallow list it gets its own line.
    fn line<W: ?Sized + Write>(&mut self, writer: &mut W) -> io::Result<()> {
        self.due.take().map_or(Ok(()), |first| self.pretty.begin_array_value(writer, first))
    }

    fn enter<W: ?Sized + Write>(
        &mut self,
        writer: &mut W,
        pretty: impl FnOnce(&mut PrettyFormatter<'static>, &mut W) -> io::Result<()>,
        compact: impl FnOnce(&mut CompactFormatter, &mut W) -> io::Result<()>,
    ) -> io::Result<()> {
        self.line(writer)?;
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

    fn begin_array_value<W: ?Sized + Write>(&mut self, writer: &mut W, first: bool) -> io::Result<()> {
        if self.depth > DEEPEST {
            return self.compact.begin_array_value(writer, first);
        }
        // The type of the value decides if it starts a line.
        self.due = Some(first);
        Ok(())
    }

    fn end_array_value<W: ?Sized + Write>(&mut self, writer: &mut W) -> io::Result<()> {
        let in_line = std::mem::take(&mut self.in_line);
        if self.depth > DEEPEST || in_line {
            return self.compact.end_array_value(writer);
        }
        self.pretty.end_array_value(writer)
    }

    in_line!(write_bool: bool, write_i8: i8, write_i16: i16, write_i32: i32, write_i64: i64, write_i128: i128);
    in_line!(write_u8: u8, write_u16: u16, write_u32: u32, write_u64: u64, write_u128: u128);
    in_line!(write_f32: f32, write_f64: f64);

    fn write_null<W: ?Sized + Write>(&mut self, writer: &mut W) -> io::Result<()> {
        self.number(writer)?;
        self.compact.write_null(writer)
    }

    fn begin_string<W: ?Sized + Write>(&mut self, writer: &mut W) -> io::Result<()> {
        self.line(writer)?;
        self.compact.begin_string(writer)
    }

    fn write_raw_fragment<W: ?Sized + Write>(&mut self, writer: &mut W, fragment: &str) -> io::Result<()> {
        self.line(writer)?;
        self.compact.write_raw_fragment(writer, fragment)
    }

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
        // A covariance is one line, not 36; values other than numbers get their own lines.
        let value = json!({"a": [1.5, null, -2, 3], "b": [[1], [2]], "c": ["x", "y"], "d": [{"e": 1}]});
        let text = to_string(&value).unwrap();
        assert_eq!(serde_json::from_str::<Value>(&text).unwrap(), value);
        assert!(text.contains("\n  \"a\": [1.5,null,-2,3],\n"), "{text}");
        assert!(text.contains("\n    [1],\n    [2]\n"), "{text}");
        assert!(text.contains("\n    \"x\",\n    \"y\"\n"), "{text}");
    }
}
