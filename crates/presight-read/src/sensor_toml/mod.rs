//! Sensor TOML, `format = 1` or 2. Unknown keys are errors. Angles are degrees in keys that end in `_deg`.
//!
//! ```toml
//! format = 1
//! kind = "scanner"            # or "camera", "rays"
//! name = "top lidar"          # optional, default: the file's stem
//! class = "laser"             # optional, default: video for cameras, laser for the others
//! range_min = 0.5             # metres, default 0
//! range_max = 100.0           # metres, default inf
//! max_incidence_deg = 80.0    # optional: features seen at a flatter angle are not extracted
//! beam_height_deg = 2.0       # scanner, optional: height of a beam, within which a row sees features
//! turn_s = 0.1                # optional: seconds from the first column to one step behind the last, default 0
//! stamp = "last"              # optional: the stamp is that of the "first" (default), "middle" or "last" ray
//!
//! [azimuth]                   # scanner: beam i is column i, counter-clockwise about +z
//! start_deg = -180.0
//! step_deg = 0.2              # either sign
//! count = 1800                # or angles_deg = [..]
//!
//! [elevation]                 # scanner, in any order: rows are sorted by descending elevation
//! angles_deg = [-15.0, 0.0, 15.0]  # or start_deg, step_deg, count
//!
//! [mount]                     # robot_from_sensor, body axes, default identity
//! xyz = [0.2, 0.0, 1.1]       # metres
//! rpy_deg = [0.0, 10.0, 0.0]  # roll, pitch, yaw about fixed axes, or quaternion = [x, y, z, w]
//!
//! [noise]                     # standard deviations, default 0
//! range_sigma = 0.02          # metres
//! range_sigma_quadratic = 0.0 # 1 / metre: this times the range squared is added to range_sigma
//! angle_sigma_deg = 0.01
//! pixel_sigma = 0.0
//! stamp_sigma_s = 0.0         # of the time stamps
//! p_hit = 0.75                # fractions of beams, with sum 1: hit the predicted surface,
//! p_short = 0.1               # hit something nearer that the model lacks,
//! p_none = 0.05               # hit nothing,
//! p_any = 0.1                 # or return any range
//! beam_dependence = 1.0       # number of beams that carry the information of one independent beam
//! ```
//!
//! `kind = "camera"`: `width, height, fx, fy, cx, cy`, and `[distortion]` with `model = "none" | "plumb_bob" |
//! "rational_polynomial" | "equidistant" | "kannala_brandt" | "fisheye"` and `coefficients` in OpenCV's order (4 or 5;
//! 8, 12 or 14; 4). A rectified camera has `optical_from_image = [x, y, z, w]`, the rotation from the frame of its
//! image to the optical frame of the camera. `kind = "rays"`: `width, height` and `directions = [[x, y, z], ..]`,
//! row-major, body axes, `nan` for no ray; or `file = "X.csv"`, relative to the sensor file, with one direction `x,y,z`
//! per line and `#` for comments.
//!
//! `format = 2` has `[timing]` in place of `turn_s` and `stamp`; a scanner may have `[beams]` in place of
//! `[elevation]`, and rays may have `origins = [[x, y, z], ..]`, metres:
//!
//! ```toml
//! [beams]                     # rows in this order; lists have one value for each row, and those left out are zeros
//! elevations_deg = [15.0, 0.0, -15.0]
//! azimuth_offsets_deg = [1.5, 0.0, -1.5]  # added to the azimuth of the column
//! origins = [[0.02, 0.0, 0.01]]  # where beams leave the sensor, metres, turned with the column; one for all rows
//! range_lead = 0.02           # ranges count from this many metres behind the origins
//! time_offsets_s = [0.0, 2.3e-6, 4.6e-6]  # added to the time of the column
//! shifts = [0, 4, 8]          # columns by which rows move to the right in a destaggered image
//! destaggered = false         # whether they are moved
//! columns = [0, 1023]         # the first and the last column with rays; the first may be the greater one
//! body_from_head = { xyz = [0.0, 0.0, 0.036], rpy_deg = [0.0, 0.0, 180.0] }  # the head's frame at azimuth 0
//!
//! [timing]
//! turn_s = 0.1                # or readout_s, row by row; or times_s = [..], seconds after the stamp for each ray
//! stamp = "first"             # with turn_s and readout_s
//!
//! [pattern]                   # rays of one row, in place of directions and [timing]
//! duration_s = 0.1            # from the first ray to one step behind the last
//! turns = 1.0                 # of the azimuth in that time, from x counter-clockwise
//! swings = 170.0              # of the elevation, from the lower end up and down again
//! elevation_deg = [-7.0, 52.0]
//! ```

mod file;
mod tables;
#[cfg(test)]
mod tests;

pub(super) use tables::MountTable;

use super::text::{check_version, from_settings, toml_from_str};
use file::{BEAMS_FORMAT, CameraFile, RaysFile, ScannerFile};
use presight_model::error::{Error, Result};
use presight_model::sensor::{Geometry, SensorSpec};
use serde::Deserialize;
use std::path::Path;

/// Reads a sensor file.
///
/// # Errors
/// [`presight_model::ErrorKind::Invalid`] with the line or key at fault, [`presight_model::ErrorKind::Unsupported`] for
/// a newer format, [`presight_model::ErrorKind::System`] if the system refuses.
pub fn read(path: &Path) -> Result<SensorSpec> {
    let name = path.file_stem().map_or_else(|| "sensor".into(), |s| s.to_string_lossy());
    from_settings(path, |text| parse(text, &name, path.parent()))
}

/// Reads the text of a sensor file. `name` is used if the text gives none; `file = "X.csv"` is relative to `folder`.
///
/// # Errors
/// As [`read`], without the file.
pub fn parse(text: &str, name: &str, folder: Option<&Path>) -> Result<SensorSpec> {
    #[derive(Deserialize)]
    struct Header {
        format: Option<i64>,
        kind: Option<String>,
    }
    let header: Header = toml_from_str(text)?;
    check_version(header.format, BEAMS_FORMAT, "format = 1")?;
    match header.kind.as_deref() {
        Some("camera") => toml_from_str::<CameraFile>(text)?.spec(name),
        Some("scanner") => toml_from_str::<ScannerFile>(text)?.spec(name),
        Some("rays") => toml_from_str::<RaysFile>(text)?.spec(name, folder),
        other => Err(Error::invalid(
            other.map_or_else(|| "kind is missing".to_owned(), |k| format!("kind {k:?} is unknown")),
            "write kind = \"camera\", \"scanner\" or \"rays\"",
        )),
    }
}

/// Writes a sensor as TOML that [`parse`] reads back as an equal sensor.
///
/// Numbers read back with the same bits. The exception is an angle that was never given in degrees: it may read back
/// one ulp off, because neighbouring values in radians can be less than one ulp of a degree apart.
///
/// ```
/// use presight::files::{read_sensor_toml, sensor_to_toml};
/// let radar = presight::preset("microwave-radar-image")?;
/// let folder = tempfile::tempdir()?;
/// let path = folder.path().join("radar.toml");
/// std::fs::write(&path, sensor_to_toml(radar.spec()))?;
/// assert_eq!(read_sensor_toml(&path)?, *radar.spec());
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub fn to_string(spec: &SensorSpec) -> String {
    let text = match &spec.geometry {
        Geometry::Camera(camera) => toml::to_string(&CameraFile::of(camera, spec)),
        Geometry::Scanner(scanner) => toml::to_string(&ScannerFile::of(scanner, spec)),
        Geometry::Rays(table) => match ScannerFile::of_beams(table, spec) {
            Some(file) => toml::to_string(&file),
            None => toml::to_string(&RaysFile::of(table, spec)),
        },
    };
    text.expect("numbers, strings and lists of numbers are TOML")
}
