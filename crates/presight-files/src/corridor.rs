//! Motion corridors as JSON: the space through which a robot will move.
//!
//! ```json
//! {"format": 1, "polyline_in_robot": [[0, 0], [4, 0], [6, 1]], "half_width": 0.4, "z_min": 0.05, "z_max": 1.8}
//! {"format": 2, "polyline_in_world": [[3, 1], [7, 1]], "half_width": 0.4, "z_min": 0.05, "z_max": 1.8}
//! {"format": 2, "polygon": [[0, -0.5], [4, -0.5], [5, 2]], "z_min": 0.05, "z_max": 1.8}
//! {"format": 2, "footprint": [[-0.4, -0.3], [0.5, -0.3], [0.5, 0.3], [-0.4, 0.3]],
//!  "poses": [[0, 0, 0], [2, 0, 0], [3, 1, 90]], "z_min": 0.05, "z_max": 1.8}
//! ```
//!
//! A polyline on the ground with half the width of the corridor along it, a polygon on the ground, or the robot's
//! footprint and the poses (x, y, yaw_deg) that it moves over. `z_min` and `z_max` are the least and greatest height of
//! obstacles. All of it is in the robot's frame, with `polyline_in_world` in the world's; metres. `format` is optional;
//! format 2 has one of the four, format 1 only the first.

use presight_model::error::{Error, Result};
use presight_predict::virtual_sensors::Corridor;
use presight_read::text::{check_version, from_settings};
use std::path::Path;

/// The newest format.
const NEWEST: i64 = 2;

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
/// [`presight_model::ErrorKind::Invalid`] naming place and field: invalid JSON, unknown or missing keys, errors of
/// [`Corridor::new`], [`Corridor::polygon`] and [`Corridor::swept`]; [`presight_model::ErrorKind::Unsupported`] for a
/// newer format.
pub fn read(path: &Path) -> Result<Corridor> {
    from_settings(path, parse)
}

/// The fields of a corridor file.
#[derive(serde::Deserialize)]
#[serde(deny_unknown_fields)]
struct Fields {
    format: Option<i64>,
    polyline_in_robot: Option<Vec<[f64; 2]>>,
    polyline_in_world: Option<Vec<[f64; 2]>>,
    polygon: Option<Vec<[f64; 2]>>,
    footprint: Option<Vec<[f64; 2]>>,
    poses: Option<Vec<[f64; 3]>>,
    half_width: Option<f64>,
    z_min: f64,
    z_max: f64,
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
    check_version(header.format.or(Some(1)), NEWEST, "\"format\": 1")?;
    serde_json::from_str::<Fields>(text).map_err(wrong)?.corridor()
}

impl Fields {
    fn corridor(self) -> Result<Corridor> {
        let missing = |key: &str| Error::invalid(format!("{key} is missing"), format!("write {key}"));
        let given = [
            ("polyline_in_robot", self.polyline_in_robot.is_some()),
            ("polyline_in_world", self.polyline_in_world.is_some()),
            ("polygon", self.polygon.is_some()),
            ("footprint", self.footprint.is_some()),
        ];
        let named: Vec<&str> = given.iter().filter(|(_, is_given)| *is_given).map(|(key, _)| *key).collect();
        match named[..] {
            [] => return Err(missing("polyline_in_robot")),
            [_] => {}
            _ => return Err(Error::invalid(format!("has {}", named.join(" and ")), "give one of them")),
        }
        if self.format == Some(1) && named != ["polyline_in_robot"] {
            return Err(Error::invalid(format!("{} in format 1", named[0]), "write \"format\": 2"));
        }
        let is_line = named[0].starts_with("polyline");
        if !is_line && self.half_width.is_some() {
            return Err(Error::invalid(format!("half_width together with {}", named[0]), "drop half_width"));
        }
        if self.footprint.is_none() && self.poses.is_some() {
            return Err(Error::invalid("poses without footprint", "write footprint, or drop poses"));
        }
        let half_width = self.half_width.ok_or_else(|| missing("half_width"));
        let (low, high) = (self.z_min, self.z_max);
        match (self.polyline_in_robot, self.polyline_in_world, self.polygon, self.footprint) {
            (Some(line), ..) => Corridor::new(line, half_width?, low, high),
            (_, Some(line), ..) => Corridor::in_world(line, half_width?, low, high),
            (_, _, Some(corners), _) => Corridor::polygon(corners, low, high),
            (.., footprint) => {
                let poses = self.poses.ok_or_else(|| missing("poses"))?;
                let poses: Vec<[f64; 3]> = poses.into_iter().map(|[x, y, yaw]| [x, y, yaw.to_radians()]).collect();
                Corridor::swept(footprint.unwrap_or_default(), &poses, low, high)
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use presight_model::error::ErrorKind;

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
            ("\"format\": 1", "\"format\": 3", "newer"),
            ("\"format\": 1", "\"format\": 0", "never existed"),
            ("{", "", "line 1"),
        ] {
            let text = good.replacen(from, to, 1);
            let e = parse(&text).expect_err(&text);
            assert!(e.to_string().contains(named), "{text}: {e}");
            assert_ne!(e.kind(), ErrorKind::Usage);
        }
    }

    #[test]
    fn format_2_has_one_of_four_shapes() {
        use presight_predict::virtual_sensors::CorridorFrame::{Robot, World};
        let text = |shape: &str| format!(r#"{{"format": 2, {shape}, "z_min": 0, "z_max": 1}}"#);
        let square = "[[-0.5, -0.3], [0.5, -0.3], [0.5, 0.3], [-0.5, 0.3]]";
        for (shape, frame, length) in [
            (r#""polyline_in_robot": [[0, 0], [4, 0]], "half_width": 0.4"#.to_owned(), Robot, 4.0),
            (r#""polyline_in_world": [[7, 7], [7, 9]], "half_width": 0.4"#.to_owned(), World, 2.0),
            (r#""polygon": [[0, -1], [3, 0], [0, 1]]"#.to_owned(), Robot, 3.0),
            (format!(r#""footprint": {square}, "poses": [[0, 0, 0], [0, 3, 90]]"#), Robot, 3.0),
        ] {
            let corridor = parse(&text(&shape)).expect(&shape);
            assert_eq!((corridor.frame(), corridor.length()), (frame, length), "{shape}");
        }
        for (shape, named) in [
            (r#""polygon": [[0, -1], [3, 0], [0, 1]], "half_width": 1"#.to_owned(), "half_width"),
            (format!(r#""polygon": {square}, "footprint": {square}"#), "polygon and footprint"),
            (format!(r#""footprint": {square}"#), "poses"),
            (format!(r#""polygon": {square}, "poses": [[0, 0, 0]]"#), "footprint"),
            (r#""footprint": [[0, 0], [1, 1], [1, 0], [0, 1]], "poses": [[0, 0, 0]]"#.to_owned(), "cross"),
            (r#""polyline_in_world": [[0, 0], [1, 0]]"#.to_owned(), "half_width"),
        ] {
            let e = parse(&text(&shape)).expect_err(&shape);
            assert!(e.to_string().contains(named), "{shape}: {e}");
        }
        let e = parse(&text(r#""polygon": [[0, -1], [3, 0], [0, 1]]"#).replace('2', "1")).unwrap_err();
        assert!(e.to_string().contains("format 1"), "{e}");
    }
}
