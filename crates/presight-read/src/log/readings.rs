//! Readings as drivers send them: how they are written in JSON, and how many of a log were taken as what.

use presight_model::measured::Frame;
use presight_model::plausible;
use serde::de::{Deserialize, Deserializer, Error, Unexpected, Visitor};
use std::fmt;

/// A number, null, or a word for a number that is not finite. Metres, after REP-117.
pub(super) struct Reading(pub f32);

impl<'de> Deserialize<'de> for Reading {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        deserializer.deserialize_any(ReadingVisitor)
    }
}

struct ReadingVisitor;

impl Visitor<'_> for ReadingVisitor {
    type Value = Reading;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("a number, null, \"inf\", \"-inf\" or \"nan\"")
    }

    /// A number too large for f32 stays a finite one.
    fn visit_f64<E: Error>(self, metres: f64) -> Result<Reading, E> {
        Ok(Reading(metres.clamp(f64::from(f32::MIN), f64::from(f32::MAX)) as f32))
    }

    fn visit_u64<E: Error>(self, metres: u64) -> Result<Reading, E> {
        self.visit_f64(metres as f64)
    }

    fn visit_i64<E: Error>(self, metres: i64) -> Result<Reading, E> {
        self.visit_f64(metres as f64)
    }

    fn visit_unit<E>(self) -> Result<Reading, E> {
        Ok(Reading(f32::NAN))
    }

    fn visit_str<E: Error>(self, text: &str) -> Result<Reading, E> {
        of_word(text).map(Reading).ok_or_else(|| E::invalid_value(Unexpected::Str(text), &self))
    }
}

/// The number that a word such as `NaN`, `-inf` or `Infinity` stands for.
fn of_word(text: &str) -> Option<f32> {
    let unsigned = text.strip_prefix(['-', '+']).unwrap_or(text);
    let is_word = ["nan", "inf", "infinity"].iter().any(|word| unsigned.eq_ignore_ascii_case(word));
    text.parse().ok().filter(|_| is_word)
}

/// Puts bare words for numbers into quotes. JSON has no such numbers, but Python and C print them: `NaN`, `-Infinity`.
pub(super) fn with_quoted_words(text: &str) -> String {
    let (mut quoted, mut rest) = (String::with_capacity(text.len()), text);
    while let Some(at) = rest.find(|c: char| c == '"' || c == '+' || c == '-' || c.is_ascii_alphabetic()) {
        let (before, from) = rest.split_at(at);
        quoted += before;
        let length = if from.starts_with('"') { string_length(from) } else { word_length(from) };
        let (word, after) = from.split_at(length);
        match of_word(word) {
            Some(_) => quoted.extend(["\"", word, "\""]),
            None => quoted += word,
        }
        rest = after;
    }
    quoted + rest
}

/// Bytes of the JSON string at the start of a text.
fn string_length(text: &str) -> usize {
    let mut escaped = true;
    let end = text.bytes().position(|byte| {
        let ends = byte == b'"' && !escaped;
        // The first byte is the opening quote.
        escaped = byte == b'\\' && !escaped;
        ends
    });
    end.map_or(text.len(), |end| end + 1)
}

/// Bytes of the sign and the letters at the start of a text, at least one.
fn word_length(text: &str) -> usize {
    1 + text.bytes().skip(1).take_while(u8::is_ascii_alphabetic).count()
}

/// The notice on the readings of one frame that stand for no range; `None` if all are ranges.
pub fn notice_of_readings(frame: &Frame) -> Option<String> {
    let mut readings = Readings::new("null or NaN");
    readings.add(frame);
    match (readings.notice(), readings.notice_at_reach()) {
        (Some(a), Some(b)) => Some(format!("{a}; {b}")),
        (a, b) => a.or(b),
    }
}

/// Numbers of readings of a log by their interpretation.
#[derive(Clone, Debug)]
pub struct Readings {
    /// The log's notation for a missing reading.
    missing_as: &'static str,
    limits: (f64, f64),
    all: u64,
    missing: u64,
    zero: u64,
    outside: u64,
    nothing: u64,
    too_near: u64,
    at_reach: u64,
}

impl Readings {
    /// No reading yet. `missing_as` is how this kind of log writes that there is no reading.
    pub fn new(missing_as: &'static str) -> Self {
        Self {
            missing_as,
            limits: (0.0, 0.0),
            all: 0,
            missing: 0,
            zero: 0,
            outside: 0,
            nothing: 0,
            too_near: 0,
            at_reach: 0,
        }
    }

    /// Adds the readings of a frame; a grey image has none.
    pub fn add(&mut self, frame: &Frame) {
        if frame.grey().is_some() {
            return;
        }
        let sensor = frame.sensor();
        self.limits = (sensor.spec().range_min, sensor.spec().range_max);
        let (sensed, reach) = (frame.measurement().values(), self.limits.1 as f32);
        self.all += sensed.len() as u64;
        for (i, (value, range)) in sensed.iter().zip(frame.ranges()).enumerate() {
            let pixel = i as u32;
            match *value {
                v if v.is_nan() => self.missing += 1,
                f32::INFINITY => self.nothing += 1,
                f32::NEG_INFINITY => self.too_near += 1,
                0.0 => self.zero += 1,
                _ if *range == reach => self.at_reach += 1,
                // A pixel without a ray has a depth, but no range.
                _ if range.is_nan() && sensor.ray(pixel % sensor.width(), pixel / sensor.width()).is_some() => {
                    self.outside += 1;
                }
                _ => {}
            }
        }
    }

    /// The notice on readings at exactly the maximum range.
    pub fn notice_at_reach(&self) -> Option<String> {
        plausible::at_reach(self.at_reach, self.all, self.limits.1)
    }

    /// One line that counts the readings by their meaning; `None` if every reading is a distance.
    pub fn notice(&self) -> Option<String> {
        let outside = format!("outside of {}..{} m", self.limits.0, self.limits.1);
        let none = [(self.missing, self.missing_as), (self.zero, "0"), (self.outside, outside.as_str())];
        let count: u64 = none.iter().map(|(count, _)| count).sum();
        let listed: Vec<String> =
            none.iter().filter(|(count, _)| *count > 0).map(|(count, what)| format!("{count} x {what}")).collect();
        let none = format!("no measurement ({})", listed.join(", "));
        let parts =
            [(count, none.as_str()), (self.nothing, "nothing within reach (inf)"), (self.too_near, "too near (-inf)")];
        let taken: Vec<String> = parts
            .iter()
            .filter(|(count, _)| *count > 0)
            .map(|(count, as_what)| format!("{count} as {as_what}"))
            .collect();
        (!taken.is_empty()).then(|| format!("of {} readings, presight takes {}", self.all, taken.join(", ")))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use presight_model::measured::Measurement;
    use presight_model::sensor::{Angles, Geometry, Scanner, Sensor, SensorSpec};

    /// Only words outside of strings, in any text.
    #[test]
    fn bare_words_are_quoted() {
        for (text, quoted) in [
            ("[NaN,inf, -Infinity,+nan]", r#"["NaN","inf", "-Infinity","+nan"]"#),
            (r#"{"inf": "NaN", "a\"inf": nan}"#, r#"{"inf": "NaN", "a\"inf": "nan"}"#),
            (r#"["\\", inf]"#, r#"["\\", "inf"]"#),
            ("[1e5, -2E+3, null, true, -1, infinite, - inf", "[1e5, -2E+3, null, true, -1, infinite, - \"inf\""),
            ("\u{e9}nan \"cut \\", "\u{e9}\"nan\" \"cut \\"),
            ("", ""),
            ("-", "-"),
        ] {
            assert_eq!(with_quoted_words(text), quoted);
        }
    }

    #[test]
    fn readings_mean_what_drivers_mean() {
        let text =
            r#"[1.5, 0, -1, null, NaN, -nan, "nan", inf, "inf", Infinity, "+Infinity", -inf, "-Infinity", 1e300]"#;
        let readings: Vec<Reading> = serde_json::from_str(&with_quoted_words(text)).unwrap();
        let kind = |r: f32| if r.is_nan() { "none".to_owned() } else { r.to_string() };
        let all: Vec<String> = readings.iter().map(|r| kind(r.0)).collect();
        let expected = ["1.5", "0", "-1", "none", "none", "none", "none", "inf", "inf", "inf", "inf", "-inf", "-inf"];
        assert_eq!(all, [&expected[..], &[&f32::MAX.to_string()]].concat());
        for wrong in ["[\"2.5\"]", "[\"\"]", "[\"infinit\"]", "[true]", "[[1]]", "[1e999]", "[infinit]"] {
            assert!(serde_json::from_str::<Vec<Reading>>(&with_quoted_words(wrong)).is_err(), "{wrong}");
        }
    }

    #[test]
    fn what_was_taken_as_what_is_counted() {
        let uniform = |count| Angles::Uniform { start_deg: 0.0, step_deg: 1.0, count };
        let scanner = Scanner { azimuth: uniform(9), elevation: uniform(1), beam_height_deg: None };
        let spec = SensorSpec::new("s", "laser", Geometry::Scanner(scanner)).with_limits(0.5, 16.0);
        let frame = |ranges: [f32; 9]| {
            Frame::new(0.0, Sensor::new(spec.clone()).unwrap(), Measurement::Range(ranges.to_vec())).unwrap()
        };
        let mut readings = Readings::new("null or NaN");
        readings.add(&frame([1.0, 16.0, 0.5, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0]));
        assert_eq!(readings.notice(), None);
        readings.add(&frame([1.0, f32::INFINITY, f32::INFINITY, f32::NEG_INFINITY, f32::NAN, 0.0, 65.5, 0.4, -1.0]));
        let expected = "of 18 readings, presight takes 5 as no measurement (1 x null or NaN, 1 x 0, 3 x outside of \
                        0.5..16 m), 2 as nothing within reach (inf), 1 as too near (-inf)";
        assert_eq!(readings.notice().unwrap(), expected);
    }
}
