//! Beam tables: spinning sensors whose rows have an angle, an origin and a firing time each.

use super::rays::{MAX_ORIGIN, is_near};
use super::scanner::cos_sin_deg;
use super::times::MAX_SCAN_S;
use super::{Angles, RayTable, RayTimes, StampAt};
use crate::error::{Error, ErrorKind, Result};
use crate::geometry::Pose;
use crate::limits;
use crate::memory;
use glam::{DQuat, DVec3};
use std::sync::Arc;

/// The beams of a spinning sensor. Every column repeats them, turned with the head about its z axis.
///
/// [`RayTable::of_beams`] makes the rays. Empty lists stand for zeros.
///
/// ```
/// use presight::sensor::{Angles, BeamTable, RayTable};
/// let azimuth = Angles::Uniform { start_deg: 0.0, step_deg: -90.0, count: 4 };
/// let beams = BeamTable::new(azimuth, vec![0.0, -30.0]).with_origins(vec![glam::DVec3::new(0.02, 0.0, 0.0)]);
/// let table = RayTable::of_beams(beams)?;
/// // The head has turned clockwise once: the beam leaves 2 cm to the right of the axis.
/// assert!(table.origins().unwrap()[1].distance(glam::DVec3::new(0.0, -0.02, 0.0)) < 1e-15);
/// # Ok::<(), presight::Error>(())
/// ```
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub struct BeamTable {
    /// Azimuth of the head at each column, degrees, counter-clockwise about its z axis.
    pub azimuth: Angles,
    /// Elevation of each row's beam, degrees. The rows of the image keep this order.
    pub elevations_deg: Vec<f64>,
    /// Azimuth of each row's beam against the head, degrees, counter-clockwise.
    pub azimuth_offsets_deg: Vec<f64>,
    /// The point at which the beam of each row leaves the sensor, metres, in the frame of the head: x along its
    /// azimuth, z along its axis. A single one holds for all rows.
    pub origins: Vec<DVec3>,
    /// Ranges are measured from this many metres behind that point, along the ray. [`RayTable::origins`] are the points
    /// from which ranges are measured.
    pub range_lead: f64,
    /// Seconds from the time of a column to the time at which each row fires.
    pub time_offsets_s: Vec<f64>,
    /// Columns by which each row moves to the right in a destaggered image.
    pub shifts: Vec<i32>,
    /// True if the rows of the image are moved by `shifts`.
    pub is_destaggered: bool,
    /// The first and the last column with rays, before rows move. The first may be the greater one: the columns then
    /// lie at both ends of the image. `None`: all columns.
    pub columns: Option<[u32; 2]>,
    /// The head's frame at azimuth 0 in the frame of the sensor, body axes.
    pub body_from_head: Pose,
    /// Seconds from the first column to one step behind the last; negative if the last column is measured first.
    pub turn_s: f64,
    /// The column to which the stamp of a frame belongs.
    pub stamp: StampAt,
}

/// Rows from which on [`BeamTable::check`] suspects angles in radians. Every spinning lidar with at least 16 rows sees
/// more than pi degrees: the narrowest published ones see 20.
const MANY_ROWS: usize = 16;

impl BeamTable {
    /// Beams from one centre at the azimuths of the columns, all measured at the stamp.
    pub fn new(azimuth: Angles, elevations_deg: Vec<f64>) -> Self {
        Self {
            azimuth,
            elevations_deg,
            azimuth_offsets_deg: Vec::new(),
            origins: Vec::new(),
            range_lead: 0.0,
            time_offsets_s: Vec::new(),
            shifts: Vec::new(),
            is_destaggered: false,
            columns: None,
            body_from_head: Pose::IDENTITY,
            turn_s: 0.0,
            stamp: StampAt::First,
        }
    }

    /// With origins of the rows: see [`BeamTable::origins`].
    #[must_use]
    pub fn with_origins(self, origins: Vec<DVec3>) -> Self {
        Self { origins, ..self }
    }

    /// Columns and rows.
    pub fn size(&self) -> (u32, u32) {
        (self.azimuth.len() as u32, self.elevations_deg.len() as u32)
    }

    /// Checks lengths and values.
    ///
    /// # Errors
    /// [`ErrorKind::Invalid`] at the name of the list: a length other than the number of elevations, angles that are
    /// not finite or not in degrees, origins beyond 2 m, columns outside the image.
    pub fn check(&self) -> Result<()> {
        let (columns, rows) = (self.azimuth.len(), self.elevations_deg.len());
        let side = 1..=limits::MAX_IMAGE_SIDE as usize;
        if !side.contains(&columns) || !side.contains(&rows) || (columns * rows) as u64 > limits::MAX_PIXELS {
            let remedy = format!("give sides of 1 to {} and at most {} pixels", side.end(), limits::MAX_PIXELS);
            return Err(Error::invalid(format!("image of {columns} x {rows} pixels"), remedy));
        }
        let lengths = [
            ("azimuth_offsets_deg", self.azimuth_offsets_deg.len()),
            ("origins", if self.origins.len() == 1 { rows } else { self.origins.len() }),
            ("time_offsets_s", self.time_offsets_s.len()),
            ("shifts", self.shifts.len()),
        ];
        if let Some((name, length)) = lengths.into_iter().find(|(_, length)| *length != 0 && *length != rows) {
            let what = format!("{length} values for {rows} beams");
            return Err(Error::invalid(what, "give one for each of elevations_deg, or leave the list out").at(name));
        }
        self.check_angles()?;
        let lead = DVec3::new(self.range_lead, 0.0, 0.0);
        check_origins(&self.origins).map_err(|e| e.at("origins"))?;
        check_origins(&[lead]).map_err(|e| e.at("range_lead"))?;
        check_seconds(&self.time_offsets_s).map_err(|e| e.at("time_offsets_s"))?;
        check_seconds(&[self.turn_s]).map_err(|e| e.at("turn_s"))?;
        self.body_from_head.check_as(ErrorKind::Invalid).map_err(|e| e.at("body_from_head"))?;
        if let Some([first, last]) = self.columns
            && first.max(last) as usize >= columns
        {
            let what = format!("columns {first} to {last} of an image with {columns}");
            return Err(Error::invalid(what, format!("give numbers from 0 to {}", columns - 1)).at("columns"));
        }
        if self.is_destaggered && self.shifts.iter().all(|shift| *shift == 0) {
            let remedy = "take the image without destaggering: its rows have no shifts";
            return Err(Error::invalid("a destaggered image of beams without stagger", remedy).at("shifts"));
        }
        Ok(())
    }

    fn check_angles(&self) -> Result<()> {
        let azimuths = (0..self.azimuth.len()).map(|i| self.azimuth.degrees(i));
        if let Some(bad) = azimuths.into_iter().find(|a| !(a.abs() <= 1e6)) {
            return Err(Error::invalid(format!("azimuth of {bad} deg"), "give finite degrees").at("azimuth"));
        }
        if let Some(bad) = self.elevations_deg.iter().find(|e| !(e.abs() <= 90.0)) {
            let what = format!("elevation of {bad} deg is outside -90..=90");
            return Err(Error::invalid(what, "give degrees above the horizontal, not thousandths").at("elevations_deg"));
        }
        if let Some(bad) = self.azimuth_offsets_deg.iter().find(|a| !(a.abs() <= 360.0)) {
            let what = format!("azimuth offset of {bad} deg is outside -360..=360");
            return Err(Error::invalid(what, "give degrees, not thousandths").at("azimuth_offsets_deg"));
        }
        let (low, high) = self.elevations_deg.iter().fold((f64::MAX, f64::MIN), |(a, b), e| (a.min(*e), b.max(*e)));
        if self.elevations_deg.len() >= MANY_ROWS && high - low < std::f64::consts::PI {
            let what = match high - low {
                0.0 => format!("all {} elevations are {low} deg", self.elevations_deg.len()),
                span => format!("{} elevations within {span:.4} deg", self.elevations_deg.len()),
            };
            return Err(Error::invalid(what, "give degrees, not radians, of the beams").at("elevations_deg"));
        }
        Ok(())
    }

    /// The column that is measured where the image shows `column`: another one if rows are moved.
    fn measured_column(&self, column: u32, row: u32) -> u32 {
        if !self.is_destaggered {
            return column;
        }
        let shift = self.shifts.get(row as usize).copied().unwrap_or(0);
        (i64::from(column) - i64::from(shift)).rem_euclid(self.azimuth.len() as i64) as u32
    }

    fn has_ray(&self, column: u32) -> bool {
        match self.columns {
            None => true,
            Some([first, last]) if first <= last => (first..=last).contains(&column),
            Some([first, last]) => column >= first || column <= last,
        }
    }

    /// Directions of the rays and the points at which they leave the sensor, row by row, body axes. Rays from the
    /// sensor's own origin have no points.
    fn rays(&self) -> (Vec<DVec3>, Vec<DVec3>) {
        let (columns, rows) = self.size();
        let turns: Vec<[f64; 2]> = (0..columns as usize).map(|c| cos_sin_deg(self.azimuth.degrees(c))).collect();
        let pixels = columns as usize * rows as usize;
        let (mut directions, mut starts) = (Vec::with_capacity(pixels), Vec::new());
        let is_moved = self.body_from_head.translation != DVec3::ZERO;
        let has_starts = is_moved || !self.origins.is_empty() || self.range_lead != 0.0;
        for row in 0..rows as usize {
            let [cos_up, sin_up] = cos_sin_deg(self.elevations_deg[row]);
            let offset = self.azimuth_offsets_deg.get(row).copied().unwrap_or(0.0);
            for column in 0..columns {
                let column = self.measured_column(column, row as u32);
                let [cos, sin] = cos_sin_deg(self.azimuth.degrees(column as usize) + offset);
                let d_in_head = DVec3::new(cos_up * cos, cos_up * sin, sin_up);
                let direction = self.rotated(d_in_head);
                directions.push(if self.has_ray(column) { direction } else { DVec3::NAN });
                if has_starts {
                    let o =
                        self.origins.get(if self.origins.len() == 1 { 0 } else { row }).copied().unwrap_or_default();
                    let [cos, sin] = turns[column as usize];
                    let o_in_head = DVec3::new(cos * o.x - sin * o.y, sin * o.x + cos * o.y, o.z);
                    starts.push(self.rotated(o_in_head) + self.body_from_head.translation);
                }
            }
        }
        (directions, starts)
    }

    /// A vector of the head's frame in body axes; the same bits where they are the same axes.
    fn rotated(&self, v: DVec3) -> DVec3 {
        let rotation = self.body_from_head.rotation;
        if rotation == DQuat::IDENTITY { v } else { rotation * v }
    }

    /// The times of the rays: [`RayTimes::Columns`] if each column has one time, otherwise a list.
    pub fn times(&self) -> RayTimes {
        let rows_differ = self.is_destaggered || self.time_offsets_s.iter().any(|t| *t != 0.0);
        match (self.turn_s, rows_differ) {
            (0.0, false) => RayTimes::AtOnce,
            (turn_s, false) => RayTimes::Columns { turn_s, stamp: self.stamp },
            (turn_s, true) => {
                let (columns, rows) = self.size();
                let even = RayTimes::Columns { turn_s, stamp: self.stamp };
                let pixels = (0..rows).flat_map(|row| (0..columns).map(move |column| (column, row)));
                let seconds = pixels.map(|(column, row)| {
                    let late = self.time_offsets_s.get(row as usize).copied().unwrap_or(0.0);
                    (even.seconds(self.measured_column(column, row), row, self.size()) + late) as f32
                });
                RayTimes::Listed(seconds.collect())
            }
        }
    }
}

impl RayTable {
    /// The rays of spinning beams. The table remembers the beams, so that files of it stay short.
    ///
    /// # Errors
    /// Those of [`BeamTable::check`]; [`ErrorKind::System`] if there is no memory for the rays.
    pub fn of_beams(beams: BeamTable) -> Result<Self> {
        beams.check()?;
        let (columns, rows) = beams.size();
        memory::require(3 * u64::from(columns) * u64::from(rows) * size_of::<DVec3>() as u64)?;
        let (directions, starts) = beams.rays();
        let mut table = Self::new(columns, rows, directions)?;
        if !starts.is_empty() {
            let rays = starts.iter().zip(table.directions());
            // A pixel without a ray has no direction.
            let origin =
                |(start, d): (&DVec3, &DVec3)| if d.is_nan() { *start } else { *start - beams.range_lead * *d };
            let origins = rays.map(origin).collect();
            table = table.with_origins(origins)?;
        }
        Ok(table.with_beams(Arc::new(beams), starts))
    }
}

/// Refuses origins that are not finite or beyond [`MAX_ORIGIN`].
fn check_origins(origins: &[DVec3]) -> Result<()> {
    match origins.iter().find(|o| !is_near(**o)) {
        Some(bad) => {
            let remedy = format!("give metres, not millimetres, at most {MAX_ORIGIN}");
            Err(Error::invalid(format!("{bad} m from the axis of the head"), remedy))
        }
        None => Ok(()),
    }
}

/// Refuses times that are not finite or longer than any scan.
fn check_seconds(seconds: &[f64]) -> Result<()> {
    match seconds.iter().find(|t| !(t.abs() <= MAX_SCAN_S)) {
        Some(bad) => Err(Error::invalid(format!("{bad} s"), format!("give seconds, at most {MAX_SCAN_S}"))),
        None => Ok(()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn quarters(elevations_deg: Vec<f64>) -> BeamTable {
        BeamTable::new(Angles::Uniform { start_deg: 0.0, step_deg: -90.0, count: 4 }, elevations_deg)
    }

    /// By hand: after a clockwise quarter turn the head looks along -y. A beam 30 degrees down, 10 cm ahead of the axis
    /// and 20 cm up, then starts at (0, -0.1, 0.2) and points along (0, -cos 30, -1/2); its ranges begin 4 cm behind.
    #[test]
    fn rays_turn_with_the_head() {
        let mut beams = quarters(vec![-30.0]).with_origins(vec![DVec3::new(0.1, 0.0, 0.2)]);
        beams.range_lead = 0.04;
        let table = RayTable::of_beams(beams.clone()).unwrap();
        let direction = DVec3::new(0.0, -0.75f64.sqrt(), -0.5);
        assert!(table.directions()[1].distance(direction) < 1e-15);
        let origin = DVec3::new(0.0, -0.1 + 0.04 * 0.75f64.sqrt(), 0.22);
        assert!(table.origins().unwrap()[1].distance(origin) < 1e-15);
        assert!(table.starts().unwrap()[1].distance(DVec3::new(0.0, -0.1, 0.2)) < 1e-15 && table.range_lead() == 0.04);
        // With an offset of 90 degrees counter-clockwise the beam points along +x, and still starts where it did.
        beams.azimuth_offsets_deg = vec![90.0];
        beams.range_lead = 0.0;
        let table = RayTable::of_beams(beams.clone()).unwrap();
        assert!(table.directions()[1].distance(DVec3::new(0.75f64.sqrt(), 0.0, -0.5)) < 1e-15);
        assert!(table.origins().unwrap()[1].distance(DVec3::new(0.0, -0.1, 0.2)) < 1e-15);
        // A head that stands upside down on its own frame.
        beams.body_from_head = Pose::from_xyz_rpy(DVec3::new(1.0, 0.0, 0.0), std::f64::consts::PI, 0.0, 0.0);
        let table = RayTable::of_beams(beams).unwrap();
        assert!(table.directions()[1].distance(DVec3::new(0.75f64.sqrt(), 0.0, 0.5)) < 1e-15);
        assert!(table.origins().unwrap()[1].distance(DVec3::new(1.0, 0.1, -0.2)) < 1e-15);
    }

    /// By hand: row 1 moves one column to the right, so that the ray of column 1 is that of column 0, and that of
    /// column 0 is the last one's. Columns are 0.1 s apart.
    #[test]
    fn rows_move_with_their_times() {
        let mut beams = quarters(vec![0.0, 10.0]);
        beams.shifts = vec![0, 1];
        beams.turn_s = 0.4;
        let still = RayTable::of_beams(beams.clone()).unwrap();
        assert_eq!(beams.times(), RayTimes::Columns { turn_s: 0.4, stamp: StampAt::First });
        beams.is_destaggered = true;
        let moved = RayTable::of_beams(beams.clone()).unwrap();
        assert_eq!(moved.directions()[..4], still.directions()[..4]);
        let rolled: Vec<DVec3> = [7, 4, 5, 6].map(|i| still.directions()[i]).into();
        assert_eq!(moved.directions()[4..], rolled);
        let RayTimes::Listed(times) = beams.times() else { panic!("times of columns") };
        assert_eq!(*times, [0.0, 0.1, 0.2, 0.3, 0.3, 0.0, 0.1, 0.2]);
        beams.stamp = StampAt::Last;
        beams.time_offsets_s = vec![0.0, 0.01];
        let RayTimes::Listed(times) = beams.times() else { panic!("times of columns") };
        assert!((times[5] + 0.29).abs() < 1e-6 && times[3].abs() < 1e-6, "{times:?}");
    }

    #[test]
    fn columns_outside_the_window_have_no_rays() {
        for (window, seen) in [([1, 2], [false, true, true, false]), ([3, 0], [true, false, false, true])] {
            let mut beams = quarters(vec![0.0]);
            beams.columns = Some(window);
            let table = RayTable::of_beams(beams).unwrap();
            assert_eq!(table.directions().iter().map(|d| !d.is_nan()).collect::<Vec<_>>(), seen);
        }
    }

    #[test]
    fn faults_are_named() {
        let many = || (0..32).map(|i| f64::from(i) - 16.0);
        let refused = |fault: &str, change: &dyn Fn(&mut BeamTable)| {
            let mut beams = quarters(many().collect());
            change(&mut beams);
            let e = RayTable::of_beams(beams).expect_err(fault);
            assert!(e.to_string().contains(fault) && !e.remedy().is_empty(), "{fault}: {e}");
        };
        refused("azimuth_offsets_deg: 2 values for 32 beams", &|b| b.azimuth_offsets_deg = vec![0.0; 2]);
        refused("origins: 2 values", &|b| b.origins = vec![DVec3::ZERO; 2]);
        refused("time_offsets_s: 33 values", &|b| b.time_offsets_s = vec![0.0; 33]);
        refused("shifts: 1 values", &|b| b.shifts = vec![3]);
        refused("radians", &|b| b.elevations_deg = many().map(f64::to_radians).collect());
        refused("-16000", &|b| b.elevations_deg = many().map(|e| 1000.0 * e).collect());
        refused("all 32 elevations are 0 deg", &|b| b.elevations_deg = vec![0.0; 32]);
        refused("NaN", &|b| b.elevations_deg[3] = f64::NAN);
        refused("azimuth_offsets_deg", &|b| b.azimuth_offsets_deg = vec![f64::INFINITY; 32]);
        refused("origins", &|b| b.origins = vec![DVec3::new(0.0, 0.0, 15.8)]);
        refused("origins", &|b| b.origins = vec![DVec3::new(0.0, f64::NAN, 0.0)]);
        refused("range_lead", &|b| b.range_lead = f64::INFINITY);
        refused("time_offsets_s", &|b| b.time_offsets_s = vec![f64::NAN; 32]);
        refused("turn_s", &|b| b.turn_s = 61.0);
        refused("columns", &|b| b.columns = Some([0, 4]));
        refused("without stagger", &|b| b.is_destaggered = true);
        refused("0 x 32", &|b| b.azimuth = Angles::Listed(Vec::new()));
        let endless = Angles::Uniform { start_deg: 0.0, step_deg: 1.0, count: u32::MAX };
        refused("4294967295 x 32", &|b| b.azimuth = endless.clone());
    }
}
