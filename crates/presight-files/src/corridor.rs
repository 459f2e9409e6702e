//! Motion corridors as JSON: the space through which a robot will move.
//!
//! ```json
//! {"format": 1, "polyline_in_robot": [[0, 0], [4, 0], [6, 1]], "half_width": 0.4, "z_min": 0.05, "z_max": 1.8}
//! ```
//!
//! A polyline on the ground in the robot's frame, half the width of the corridor along it, and the least and greatest
//! height of obstacles above the robot's origin; metres. `format` is optional.

use super::text::{FORMAT, from_settings};
use presight_model::error::{Error, ErrorKind, Result};
use presight_predict::virtual_sensors::{Corridor, CorridorFields};
use std::path::Path;

/// Reads a corridor.
///
/// ```
/// let folder = tempfile::tempdir()?;
/// let path = folder.path().join("corridor.json");
/// let text = r#"{"polyline_in_robot": [[0, 0], [4, 0]], "half_width": 0.4, "z_min": 0.05, "z_max": 1.8}"#;
/// std::fs::write(&path, text)?;
/// assert_eq!(presight::files::read_corridor(&path)?.length(), 4.0);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
///
/// # Errors
/// [`ErrorKind::Invalid`] naming place and field: invalid JSON, unknown or missing keys, errors of [`Corridor::new`];
/// [`ErrorKind::Unsupported`] for a newer format.
pub fn read(path: &Path) -> Result<Corridor> {
    from_settings(path, parse)
}

/// Reads the text of a corridor.
///
/// # Errors
/// As [`read`], without the file.
pub fn parse(text: &str) -> Result<Corridor> {
    #[derive(serde::Deserialize)]
    struct Header {
        format: Option<i64>,
    }
    let remedy = "write polyline_in_robot, half_width, z_min and z_max, metres";
    let wrong = |e: serde_json::Error| {
        let place = format!("line {}, column {}", e.line(), e.column());
        Error::invalid(format!("is not a valid corridor: {e}"), remedy).at(place).caused_by(e)
    };
    // Checked first, because a newer file may hold keys that this build cannot know.
    let header: Header = serde_json::from_str(text).map_err(wrong)?;
    match header.format {
        None | Some(FORMAT) => {}
        Some(newer) if newer > FORMAT => {
            let what = format!("format {newer} is newer than this presight, which reads format {FORMAT}");
            return Err(Error::new(ErrorKind::Unsupported, what, "update presight"));
        }
        Some(other) => {
            return Err(Error::invalid(format!("format {other} never existed"), format!("write \"format\": {FORMAT}")));
        }
    }
    let fields: CorridorFields = serde_json::from_str(text).map_err(wrong)?;
    Corridor::new(fields.polyline_in_robot, fields.half_width, fields.z_min, fields.z_max)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn faults_are_named() {
        let good = r#"{"format": 1, "polyline_in_robot": [[0, 0], [4, 0]], "half_width": 0.4, "z_min": 0, "z_max": 1}"#;
        assert_eq!(parse(good).unwrap().length(), 4.0);
        for (from, to, named) in [
            ("\"half_width\": 0.4", "\"half_width\": 0", "half_width"),
            ("\"half_width\": 0.4, ", "", "half_width"),
            ("0.4", "\"wide\"", "line 1"),
            ("[[0, 0], [4, 0]]", "[[0, 0]]", "polyline_in_robot"),
            ("[[0, 0], [4, 0]]", "[[1, 1], [1, 1]]", "no length"),
            ("[4, 0]", "[4, 1e300]", "point 1"),
            ("[4, 0]", "[4, 0, 0]", "line 1"),
            ("\"z_max\": 1", "\"z_max\": -1", "z_min < z_max"),
            ("\"z_max\"", "\"zmax\"", "zmax"),
            ("\"format\": 1", "\"format\": 2", "newer"),
            ("\"format\": 1", "\"format\": 0", "never existed"),
            ("{", "", "line 1"),
        ] {
            let text = good.replacen(from, to, 1);
            let e = parse(&text).expect_err(&text);
            assert!(e.to_string().contains(named), "{text}: {e}");
            assert_ne!(e.kind(), ErrorKind::Usage);
        }
    }
}
