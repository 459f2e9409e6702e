//! Calibrations of Velodyne's sensors in YAML, as the ROS driver `velodyne_pointcloud` has them: radians, corrections
//! by `laser_id`. Points of predicted ranges are those of the driver's arithmetic for the same ranges.
//!
//! A column is one firing of all lasers, from azimuth 0 (x forward) clockwise; rows are lasers by falling elevation. A
//! file has neither the speed nor the model: columns are the firings of a turn at 600 revolutions a minute, and the
//! number of lasers determines the times of firing. The driver turns lasers on with their times for 16 and 128 lasers.

use super::sensor_of;
use crate::text::from_settings;
use crate::yaml::yaml;
use glam::DVec3;
use presight_model::error::{Error, Result};
use presight_model::sensor::{Angles, BeamTable, SensorSpec};
use serde::Deserialize;
use std::path::Path;

#[derive(Deserialize)]
struct Calibration {
    lasers: Vec<Laser>,
    num_lasers: Option<usize>,
}

#[derive(Deserialize)]
struct Laser {
    laser_id: usize,
    rot_correction: f64,
    vert_correction: f64,
    #[serde(default)]
    vert_offset_correction: f64,
    #[serde(default)]
    horiz_offset_correction: f64,
    #[serde(default)]
    dist_correction: f64,
    #[serde(default)]
    dist_correction_x: f64,
    #[serde(default)]
    dist_correction_y: f64,
}

/// When lasers fire.
struct Firing {
    /// Seconds from one firing of all lasers to the next.
    cycle_s: f64,
    /// Lasers that fire together.
    together: usize,
    /// Seconds from one group to the next.
    step_s: f64,
    /// Whether the driver moves each laser's azimuth on by its time.
    turns: bool,
}

/// VLP-16 and VLP-32C: 2.304 us from shot to shot in 55.296 us; HDL-32E: 1.152 us in 46.08 us; VLS-128: eight lasers
/// each 2.665 us in 53.5 us (constants of the driver). HDL-64E: 1.3333 million shots a second; no times are published.
fn firing(lasers: &[Laser]) -> Option<Firing> {
    let has_azimuths = lasers.iter().any(|laser| laser.rot_correction != 0.0);
    let (cycle, together, step, turns) = match lasers.len() {
        16 => (55.296, 1, 2.304, true),
        32 if has_azimuths => (55.296, 2, 2.304, false),
        32 => (46.08, 1, 1.152, false),
        64 => (48.0, 64, 0.0, false),
        128 => (53.5, 8, 2.665, true),
        _ => return None,
    };
    Some(Firing { cycle_s: cycle * 1e-6, together, step_s: step * 1e-6, turns })
}

/// Seconds of a turn, for the number of columns.
const TURN_S: f64 = 0.1;

/// True if the text is such a calibration.
pub fn is_calibration(text: &str) -> bool {
    text.lines().any(|line| line.starts_with("lasers:"))
}

/// Reads a calibration. Also returns notices on corrections that are not used or missing.
///
/// # Errors
/// [`presight_model::ErrorKind::Invalid`] with the laser and the field at fault;
/// [`presight_model::ErrorKind::System`] if the system refuses.
pub fn read(path: &Path) -> Result<(SensorSpec, Vec<String>)> {
    let name = path.file_stem().map_or_else(|| "velodyne".into(), |s| s.to_string_lossy());
    from_settings(path, |text| parse(text, &name))
}

/// Reads the text of a calibration of a sensor named `name`.
///
/// # Errors
/// As [`read`], without the file.
pub fn parse(text: &str, name: &str) -> Result<(SensorSpec, Vec<String>)> {
    const REMEDY: &str =
        "give a calibration of velodyne_pointcloud: lasers with laser_id, rot_correction, vert_correction";
    let Calibration { mut lasers, num_lasers } = yaml(text, REMEDY)?;
    if let Some(number) = num_lasers.filter(|number| *number != lasers.len()) {
        let what = format!("{number} where {} lasers are listed", lasers.len());
        return Err(Error::invalid(what, "list every laser once").at("num_lasers"));
    }
    lasers.sort_by_key(|laser| laser.laser_id);
    if let Some((i, laser)) = lasers.iter().enumerate().find(|(i, laser)| laser.laser_id != *i) {
        let what = format!("laser_id {} where {i} is expected", laser.laser_id);
        return Err(Error::invalid(what, "number the lasers from 0, each once").at("lasers"));
    }
    for laser in &lasers {
        check(laser).map_err(|e| e.at(format!("laser_id {}", laser.laser_id)))?;
    }
    let Some(firing) = firing(&lasers) else {
        let what = format!("a sensor of {} lasers", lasers.len());
        return Err(
            Error::invalid(what, "give 16, 32, 64 or 128 lasers, or write a sensor file with [beams]").at("lasers")
        );
    };
    let notices = notices(&lasers);
    // Rows from the highest laser down; the sort keeps the order by id where two are as high.
    lasers.sort_by(|a, b| b.vert_correction.total_cmp(&a.vert_correction));
    let names = [("elevations_deg", "vert_correction"), ("azimuth_offsets_deg", "rot_correction")];
    Ok((sensor_of(name, beams(&lasers, &firing), &names)?, notices))
}

fn check(laser: &Laser) -> Result<()> {
    let angles = [("vert_correction", laser.vert_correction, 0.5), ("rot_correction", laser.rot_correction, 2.0)];
    for (name, angle, most) in angles {
        if !(angle.abs() <= most * std::f64::consts::PI) {
            return Err(Error::invalid(format!("an angle of {angle}"), "give radians, not degrees").at(name));
        }
    }
    let offsets = [
        ("vert_offset_correction", laser.vert_offset_correction),
        ("horiz_offset_correction", laser.horiz_offset_correction),
    ];
    for (name, offset) in offsets {
        if !(offset.abs() <= 1.0) {
            return Err(Error::invalid(format!("an offset of {offset} m"), "give metres, at most 1").at(name));
        }
    }
    Ok(())
}

fn beams(lasers: &[Laser], firing: &Firing) -> BeamTable {
    let columns = (TURN_S / firing.cycle_s).round();
    let step_deg = -360.0 / columns;
    let azimuth = Angles::Uniform { start_deg: 0.0, step_deg, count: columns as u32 };
    let mut beams = BeamTable::new(azimuth, lasers.iter().map(|laser| laser.vert_correction.to_degrees()).collect());
    for laser in lasers {
        let late = (laser.laser_id / firing.together) as f64 * firing.step_s;
        let turned = if firing.turns { step_deg * late / firing.cycle_s } else { 0.0 };
        // The driver subtracts the correction from the azimuth, which is clockwise.
        let offset_deg = turned + laser.rot_correction.to_degrees();
        let (sin_up, cos_up) = laser.vert_correction.sin_cos();
        let (ahead, left) = (-laser.vert_offset_correction * sin_up, laser.horiz_offset_correction);
        let (sin, cos) = offset_deg.to_radians().sin_cos();
        let up = laser.vert_offset_correction * cos_up;
        beams.origins.push(DVec3::new(cos * ahead - sin * left, sin * ahead + cos * left, up));
        beams.azimuth_offsets_deg.push(offset_deg);
        beams.time_offsets_s.push(late);
    }
    beams.turn_s = columns * firing.cycle_s;
    beams
}

fn notices(lasers: &[Laser]) -> Vec<String> {
    let mut notices = Vec::new();
    let distances = |laser: &Laser| [laser.dist_correction, laser.dist_correction_x, laser.dist_correction_y];
    if lasers.iter().any(|laser| distances(laser) != [0.0; 3]) {
        notices
            .push("dist_correction is not used: ranges are the true ones, from which drivers have removed it".into());
    }
    if lasers.len() == 64 {
        notices.push("no firing times are known for 64 lasers: each column is taken to be measured at once".into());
    }
    let no_offsets =
        lasers.iter().all(|laser| [laser.vert_offset_correction, laser.horiz_offset_correction] == [0.0; 2]);
    if no_offsets {
        let sees =
            |degrees: f64| lasers.iter().any(|laser| (laser.vert_correction.to_degrees() - degrees).abs() < 0.01);
        let instead = match lasers.len() {
            16 if sees(15.0) => ": the sensor vlp-16-real has the offsets of the manual, up to 11.2 mm",
            32 if sees(15.0) => ": the sensor vlp-32c-real has them",
            _ => "",
        };
        notices.push(format!("all lasers start on the axis: vert_offset_correction is 0{instead}"));
    }
    notices
}
