//! Metadata of Ouster sensors as JSON: flat (up to firmware 2.x, and files of drivers) and nested (`beam_intrinsics`,
//! `lidar_data_format`, ..). Images have the vendor's rows and columns; poses are of Ouster's sensor frame.
//!
//! A range counts from the lidar's origin by way of the beam's (`XYZLut` of ouster-sdk): it is longer than the way from
//! where the beam leaves the sensor by the distance of the two, [`BeamTable::range_lead`]. A field that old firmware
//! lacks gets the value that ouster-sdk takes for it, and a notice.

use super::sensor_of;
use crate::text::{check_json_memory, from_settings};
use glam::{DMat3, DQuat, DVec3};
use presight_model::error::{Error, ErrorKind, Result};
use presight_model::geometry::Pose;
use presight_model::sensor::{Angles, BeamTable, MAX_ORIGIN, SensorSpec};
use serde_json::Value;
use std::path::Path;

/// Sections of nested metadata, all of which ouster-sdk requires.
const SECTIONS: [&str; 7] = [
    "beam_intrinsics",
    "calibration_status",
    "config_params",
    "imu_intrinsics",
    "lidar_data_format",
    "lidar_intrinsics",
    "sensor_info",
];

/// The newest `json_calibration_version` known.
const NEWEST: i64 = 4;

const MILLIMETRE: f64 = 1e-3;

/// Degrees of 16 beams or more, below which they are radians: Ouster's narrowest sensors see 20 degrees.
const MIN_VIEW_DEG: f64 = std::f64::consts::PI;

/// Reads the metadata of an Ouster sensor. Also returns notices on missing fields.
///
/// # Errors
/// [`ErrorKind::Invalid`] with the field at fault; [`ErrorKind::Unsupported`] for an unknown version;
/// [`ErrorKind::System`] if the system refuses.
pub fn read(path: &Path) -> Result<(SensorSpec, Vec<String>)> {
    let name = path.file_stem().map_or_else(|| "ouster".into(), |s| s.to_string_lossy());
    from_settings(path, |text| parse(text, &name))
}

/// Reads the text of the metadata of an Ouster sensor, which is named `name`.
///
/// # Errors
/// As [`read`], without the file.
pub fn parse(text: &str, name: &str) -> Result<(SensorSpec, Vec<String>)> {
    check_json_memory(text)?;
    let root: Value = serde_json::from_str(text).map_err(|e| {
        let wrong = Error::invalid("it is not JSON", "give the metadata of an Ouster sensor as its driver saves it");
        wrong.at(format!("line {}", e.line())).caused_by(e)
    })?;
    let mut metadata = Metadata::new(&root)?;
    let beams = metadata.beams()?;
    let names = [
        ("elevations_deg", "beam_altitude_angles"),
        ("azimuth_offsets_deg", "beam_azimuth_angles"),
        ("origins", "lidar_origin_to_beam_origin_mm"),
        ("range_lead", "lidar_origin_to_beam_origin_mm"),
        ("shifts", "pixel_shift_by_row"),
        ("columns", "column_window"),
        ("body_from_head", "lidar_to_sensor_transform"),
    ];
    Ok((sensor_of(name, beams, &names)?, metadata.notices))
}

/// A field: its section in nested and in flat metadata, and its name.
#[derive(Clone, Copy)]
struct Field(&'static str, &'static str, &'static str);

const ALTITUDES: Field = Field("beam_intrinsics", "", "beam_altitude_angles");
const AZIMUTHS: Field = Field("beam_intrinsics", "", "beam_azimuth_angles");
const ORIGIN: Field = Field("beam_intrinsics", "", "lidar_origin_to_beam_origin_mm");
const BEAM_TO_LIDAR: Field = Field("beam_intrinsics", "", "beam_to_lidar_transform");
const LIDAR_TO_SENSOR: Field = Field("lidar_intrinsics", "", "lidar_to_sensor_transform");
const MODE: Field = Field("config_params", "", "lidar_mode");
const PRODUCT: Field = Field("sensor_info", "", "prod_line");
const SHIFTS: Field = Field("lidar_data_format", "data_format", "pixel_shift_by_row");
const WINDOW: Field = Field("lidar_data_format", "data_format", "column_window");
const COLUMNS: Field = Field("lidar_data_format", "data_format", "columns_per_frame");
const ROWS: Field = Field("lidar_data_format", "data_format", "pixels_per_column");

struct Metadata<'a> {
    root: &'a Value,
    is_nested: bool,
    notices: Vec<String>,
}

impl<'a> Metadata<'a> {
    fn new(root: &'a Value) -> Result<Self> {
        let is_nested = SECTIONS.iter().any(|section| root.get(section).is_some());
        if is_nested && let Some(missing) = SECTIONS.iter().find(|section| root.get(section).is_none()) {
            let remedy = "fetch the metadata of the sensor again: nested metadata has all its sections, and flat none";
            return Err(Error::invalid("the section is missing", remedy).at(missing));
        }
        if let Some(version) = root.get("json_calibration_version") {
            match version.as_i64() {
                Some(1..=NEWEST) => {}
                Some(newer) if newer > NEWEST => {
                    let what = format!("version {newer} is newer than this presight, which reads up to {NEWEST}");
                    return Err(
                        Error::new(ErrorKind::Unsupported, what, "update presight").at("json_calibration_version")
                    );
                }
                _ => {
                    let remedy = format!("give metadata of a version from 1 to {NEWEST}");
                    return Err(
                        Error::invalid(format!("{version} never existed"), remedy).at("json_calibration_version")
                    );
                }
            }
        }
        Ok(Self { root, is_nested, notices: Vec::new() })
    }

    fn section(&self, field: Field) -> &'static str {
        if self.is_nested { field.0 } else { field.1 }
    }

    /// The name of a field with its section, for messages.
    fn place(&self, field: Field) -> String {
        match self.section(field) {
            "" => field.2.to_owned(),
            section => format!("{section}.{}", field.2),
        }
    }

    /// Old firmware writes a text in place of a section that it lacks.
    fn value(&self, field: Field) -> Option<&'a Value> {
        let section = self.section(field);
        let from = if section.is_empty() { Some(self.root) } else { self.root.get(section) };
        from?.get(field.2).filter(|value| !value.is_null())
    }

    fn fault(&self, field: Field, what: impl Into<String>, remedy: impl Into<String>) -> Error {
        Error::invalid(what, remedy).at(self.place(field))
    }

    fn numbers(&self, field: Field) -> Result<Option<Vec<f64>>> {
        let Some(value) = self.value(field) else { return Ok(None) };
        let numbers = value.as_array().and_then(|list| list.iter().map(Value::as_f64).collect());
        numbers.map(Some).ok_or_else(|| self.fault(field, "it is not a list of numbers", "give a list of numbers"))
    }

    /// A list of exactly `count` numbers.
    fn exactly(&self, field: Field, count: usize, of: &str) -> Result<Option<Vec<f64>>> {
        let numbers = self.numbers(field)?;
        match &numbers {
            Some(list) if list.len() != count => {
                let what = format!("{} values for {count} {of}", list.len());
                Err(self.fault(field, what, format!("give {count} values")))
            }
            _ => Ok(numbers),
        }
    }

    fn whole(&self, field: Field) -> Result<Option<u32>> {
        let Some(value) = self.value(field) else { return Ok(None) };
        let whole = value.as_u64().and_then(|n| u32::try_from(n).ok());
        whole.map(Some).ok_or_else(|| self.fault(field, format!("{value} is not a count"), "give a whole number"))
    }

    fn text(&self, field: Field) -> Result<Option<&'a str>> {
        let Some(value) = self.value(field) else { return Ok(None) };
        value.as_str().map(Some).ok_or_else(|| self.fault(field, "it is not a text", "give a text in quotes"))
    }

    /// The value of a field, or the usual one with a notice.
    fn or_usual<T>(&mut self, field: Field, given: Option<T>, usual: T, shown: &str) -> T {
        given.unwrap_or_else(|| {
            self.notices.push(format!("{} is missing: {shown} is taken, as ouster-sdk does", self.place(field)));
            usual
        })
    }

    fn beams(&mut self) -> Result<BeamTable> {
        let (columns, turns_per_second) = self.mode()?;
        let product = self.text(PRODUCT)?.unwrap_or_default();
        let elevations = self.angles(ALTITUDES, product)?;
        let rows = elevations.len();
        let offsets = self.exactly(AZIMUTHS, rows, "beams")?.ok_or_else(|| self.missing(AZIMUTHS))?;
        self.check_angles(&elevations, &offsets)?;
        let step_deg = -360.0 / f64::from(columns);
        let mut beams = BeamTable::new(Angles::Uniform { start_deg: 0.0, step_deg, count: columns }, elevations);
        // Ouster counts clockwise.
        beams.azimuth_offsets_deg = offsets.iter().map(|a| -a).collect();
        beams.turn_s = 1.0 / turns_per_second;
        beams.body_from_head = self.sensor_from_lidar()?;
        let origin = self.beam_origin(product)?;
        beams.origins = vec![origin];
        beams.range_lead = if origin.z == 0.0 { origin.x } else { origin.length() };
        beams.shifts = self.shifts(columns, rows)?;
        beams.columns = self.window(columns)?;
        Ok(beams)
    }

    fn missing(&self, field: Field) -> Error {
        self.fault(field, "it is missing", "give the complete metadata of an Ouster sensor")
    }

    /// Columns of a turn and turns per second.
    fn mode(&mut self) -> Result<(u32, f64)> {
        let mode = self.text(MODE)?.ok_or_else(|| self.missing(MODE))?;
        let parts = mode.split_once('x').and_then(|(c, hz)| Some((c.parse::<u32>().ok()?, hz.parse::<u32>().ok()?)));
        let Some((columns, hz)) = parts.filter(|(c, hz)| (1..=8192).contains(c) && (1..=100).contains(hz)) else {
            let what = format!("mode {mode:?} is unknown");
            return Err(self.fault(MODE, what, "give columns by turns per second, such as \"1024x10\""));
        };
        match self.whole(COLUMNS)? {
            Some(other) if other != columns => {
                let what = format!("{other} columns where {} is {mode:?}", self.place(MODE));
                Err(self.fault(COLUMNS, what, "give the metadata of one mode of the sensor"))
            }
            given => {
                // Without a format at all its notices name the other fields.
                if self.value(ROWS).is_some() {
                    self.or_usual(COLUMNS, given, columns, &columns.to_string());
                }
                Ok((columns, f64::from(hz)))
            }
        }
    }

    /// The elevations, as many as the sensor has beams.
    fn angles(&self, field: Field, product: &str) -> Result<Vec<f64>> {
        let of_product = product.split('-').nth(2).and_then(|beams| beams.parse::<usize>().ok());
        let rows = self.whole(ROWS)?.map(|rows| rows as usize).or(of_product);
        match rows {
            Some(rows) => self.exactly(field, rows, "beams"),
            None => self.numbers(field),
        }?
        .ok_or_else(|| self.missing(field))
    }

    fn check_angles(&self, elevations: &[f64], offsets: &[f64]) -> Result<()> {
        let in_degrees = "give degrees, neither radians nor thousandths of a degree";
        for (field, angles, most) in [(ALTITUDES, elevations, 90.0), (AZIMUTHS, offsets, 180.0)] {
            if let Some(bad) = angles.iter().find(|a| !(a.abs() <= most)) {
                return Err(self.fault(field, format!("{bad} deg is beyond +-{most}"), in_degrees));
            }
        }
        if elevations.iter().all(|e| *e == 0.0) {
            let remedy = "the sensor is not calibrated: fetch its metadata again once it runs";
            return Err(self.fault(ALTITUDES, "all angles are 0", remedy));
        }
        let (low, high) = elevations.iter().fold((f64::MAX, f64::MIN), |(a, b), e| (a.min(*e), b.max(*e)));
        if elevations.len() >= 16 && high - low < MIN_VIEW_DEG {
            let what = format!("{} beams within {:.4} deg", elevations.len(), high - low);
            return Err(self.fault(ALTITUDES, what, in_degrees));
        }
        Ok(())
    }

    /// Where a beam leaves the sensor, metres in the frame of the lidar turned with its head.
    fn beam_origin(&mut self, product: &str) -> Result<DVec3> {
        let distance = match self.value(ORIGIN) {
            Some(value) => Some(value.as_f64().ok_or_else(|| self.fault(ORIGIN, "it is not a number", "give mm"))?),
            None => None,
        };
        let matrix = self.exactly(BEAM_TO_LIDAR, 16, "numbers of a 4 x 4 matrix")?;
        let field = if matrix.is_some() { BEAM_TO_LIDAR } else { ORIGIN };
        let origin = match (matrix, distance) {
            (Some(matrix), distance) => {
                // ouster-sdk uses these two numbers of the matrix.
                let (ahead, up) = (matrix[3], matrix[11]);
                if let Some(distance) = distance.filter(|d| !((d - ahead.hypot(up)).abs() <= 1e-3)) {
                    let what = format!("{distance} mm where {} has {}", self.place(BEAM_TO_LIDAR), ahead.hypot(up));
                    return Err(self.fault(ORIGIN, what, "give one of the two, or the same distance in both"));
                }
                DVec3::new(ahead, 0.0, up)
            }
            (None, distance) => {
                let usual = match product.get(..5) {
                    Some("OS-0-") => 27.67,
                    Some("OS-1-") => 15.806,
                    Some("OS-2-") => 13.762,
                    _ => 12.163,
                };
                DVec3::new(self.or_usual(ORIGIN, distance, usual, &format!("{usual} mm")), 0.0, 0.0)
            }
        };
        if !(origin.abs().max_element() * MILLIMETRE <= MAX_ORIGIN) {
            let what = format!("a beam leaves the sensor {} mm from its origin", origin.length());
            return Err(self.fault(field, what, "give millimetres, as the sensor's metadata has them"));
        }
        Ok(origin * MILLIMETRE)
    }

    fn sensor_from_lidar(&mut self) -> Result<Pose> {
        let matrix = self.exactly(LIDAR_TO_SENSOR, 16, "numbers of a 4 x 4 matrix")?;
        let usual = [-1.0, 0.0, 0.0, 0.0, 0.0, -1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 36.18, 0.0, 0.0, 0.0, 1.0];
        let m = self.or_usual(LIDAR_TO_SENSOR, matrix, usual.to_vec(), "a half turn 36.18 mm up");
        let rotation = DMat3::from_cols_array(&[m[0], m[1], m[2], m[4], m[5], m[6], m[8], m[9], m[10]]).transpose();
        let off = (rotation * rotation.transpose() - DMat3::IDENTITY).to_cols_array();
        // Numbers of seven digits deviate by less; at 100 m it is a tenth of a millimetre.
        let is_rotation = off.iter().all(|x| x.abs() <= 1e-6) && rotation.determinant() > 0.0;
        if !is_rotation || m[12..] != [0.0, 0.0, 0.0, 1.0] {
            let remedy = "give 4 x 4 numbers, row by row: a rotation, millimetres, and 0 0 0 1";
            return Err(self.fault(LIDAR_TO_SENSOR, "it is not a rotation with a translation", remedy));
        }
        let translation = DVec3::new(m[3], m[7], m[11]) * MILLIMETRE;
        if !translation.is_finite() || translation.abs().max_element() > 1.0 {
            let remedy = "give millimetres from the lidar's origin to the sensor's";
            return Err(self.fault(LIDAR_TO_SENSOR, format!("it moves the lidar by {translation} m"), remedy));
        }
        Ok(Pose { rotation: DQuat::from_mat3(&rotation).normalize(), translation })
    }

    fn shifts(&mut self, columns: u32, rows: usize) -> Result<Vec<i32>> {
        let shifts = self.exactly(SHIFTS, rows, "beams")?;
        let most = f64::from(columns);
        if let Some(bad) = shifts.iter().flatten().find(|s| !(s.abs() < most && s.fract() == 0.0)) {
            let what = format!("{bad} is not a number of columns of an image with {columns}");
            return Err(self.fault(SHIFTS, what, "give whole numbers of columns"));
        }
        let given = shifts.map(|shifts| shifts.iter().map(|s| *s as i32).collect());
        // 18, 12, 6, 0 for 1024 columns, again and again.
        let usual = (0..rows).map(|row| (6 * (3 - row % 4)) as i32 * columns as i32 / 1024).collect();
        Ok(self.or_usual(SHIFTS, given, usual, "that of the first sensors"))
    }

    fn window(&mut self, columns: u32) -> Result<Option<[u32; 2]>> {
        let window = self.exactly(WINDOW, 2, "ends of the window")?;
        let Some([first, last]) = window.as_deref() else { return Ok(None) };
        let is_column = |c: f64| c.fract() == 0.0 && (0.0..f64::from(columns)).contains(&c);
        if !is_column(*first) || !is_column(*last) {
            let what = format!("columns {first} to {last} of an image with {columns}");
            return Err(self.fault(WINDOW, what, format!("give whole numbers from 0 to {}", columns - 1)));
        }
        let ends = [*first as u32, *last as u32];
        Ok(Some(ends).filter(|ends| *ends != [0, columns - 1]))
    }
}
