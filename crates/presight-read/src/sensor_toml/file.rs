//! The serde model of a sensor file, one struct for each kind, which reads and writes it.

use super::tables::{
    AnglesTable, BeamsTable, DistortionTable, MountTable, NoiseTable, PatternTable, StampName, TimingTable, degrees,
};
use crate::text::{FORMAT, from_text};
use glam::{DQuat, DVec3};
use presight_model::error::{Error, Result};
use presight_model::geometry::Pose;
use presight_model::limits;
use presight_model::printable::quoted;
use presight_model::sensor::{Camera, Distortion, Geometry, RayTable, RayTimes, Scanner, SensorSpec};
use serde::{Deserialize, Serialize};
use std::path::Path;

/// The format that has [timing], [beams] and origins.
pub const BEAMS_FORMAT: i64 = 2;

/// Serde cannot combine `flatten` with `deny_unknown_fields`, so each kind of file repeats the common keys.
macro_rules! sensor_file {
    ($file:ident, $kind:literal, $class:literal { $($key:ident: $type:ty),* $(,)? }) => {
        #[derive(Default, Deserialize, Serialize)]
        #[serde(deny_unknown_fields)]
        pub struct $file {
            format: i64,
            kind: String,
            name: Option<String>,
            class: Option<String>,
            range_min: Option<f64>,
            range_max: Option<f64>,
            max_incidence_deg: Option<f64>,
            turn_s: Option<f64>,
            stamp: Option<StampName>,
            $($key: $type,)*
            mount: Option<MountTable>,
            noise: Option<NoiseTable>,
            timing: Option<TimingTable>,
        }

        impl $file {
            /// The common keys of a sensor.
            fn of_common(spec: &SensorSpec) -> Self {
                Self {
                    format: FORMAT,
                    kind: $kind.to_owned(),
                    name: Some(spec.name.clone()),
                    class: Some(spec.class.clone()),
                    range_min: Some(spec.range_min),
                    range_max: Some(spec.range_max),
                    max_incidence_deg: spec.max_incidence.map(degrees),
                    mount: MountTable::of(&spec.mount),
                    noise: NoiseTable::of(&spec.noise),
                    ..Self::default()
                }
                .with_times(&spec.times)
            }

            /// With times in format 1 if it has words for them.
            fn with_times(self, times: &RayTimes) -> Self {
                match times {
                    RayTimes::AtOnce => self,
                    &RayTimes::Columns { turn_s, stamp } => {
                        Self { turn_s: Some(turn_s), stamp: StampName::of(stamp), ..self }
                    }
                    times => Self { format: BEAMS_FORMAT, timing: TimingTable::of(times), ..self },
                }
            }

            /// When rays are measured, and whether the keys are those of the format.
            fn times(&self) -> Result<RayTimes> {
                match (self.format, &self.timing) {
                    (FORMAT, Some(_)) => {
                        let remedy = "write format = 2, or turn_s and stamp before the first table";
                        Err(Error::invalid("format 1 has no such table", remedy).at("[timing]"))
                    }
                    (FORMAT, None) => {
                        Ok(RayTimes::turning(self.turn_s.unwrap_or(0.0), StampName::stamp(self.stamp)))
                    }
                    (_, timing) if self.turn_s.is_none() && self.stamp.is_none() => {
                        timing.as_ref().map_or(Ok(RayTimes::AtOnce), |t| t.times().map_err(|e| e.at("[timing]")))
                    }
                    _ => {
                        let remedy = "write turn_s and stamp in [timing]";
                        Err(Error::invalid("turn_s and stamp are keys of format 1", remedy))
                    }
                }
            }

            fn common(&self, name: &str, geometry: Geometry) -> Result<SensorSpec> {
                let (name, class) = (self.name.as_deref().unwrap_or(name), self.class.as_deref().unwrap_or($class));
                let mut spec = SensorSpec::new(name, class, geometry);
                spec.range_min = self.range_min.unwrap_or(0.0);
                spec.range_max = self.range_max.unwrap_or(f64::INFINITY);
                spec.times = self.times()?;
                spec.max_incidence = self.max_incidence_deg.map(f64::to_radians);
                spec.mount = self.mount.as_ref().map_or(Ok(Pose::IDENTITY), |m| m.pose().map_err(|e| e.at("[mount]")))?;
                spec.noise = self.noise.as_ref().map(NoiseTable::noise).unwrap_or_default();
                Ok(spec)
            }
        }
    };
}

sensor_file!(CameraFile, "camera", "video" {
    width: u32,
    height: u32,
    fx: f64,
    fy: f64,
    cx: f64,
    cy: f64,
    optical_from_image: Option<[f64; 4]>,
    distortion: Option<DistortionTable>,
});

sensor_file!(ScannerFile, "scanner", "laser" {
    beam_height_deg: Option<f64>,
    azimuth: AnglesTable,
    elevation: Option<AnglesTable>,
    beams: Option<BeamsTable>,
});

sensor_file!(RaysFile, "rays", "laser" {
    width: u32,
    height: u32,
    directions: Option<Vec<[f64; 3]>>,
    file: Option<String>,
    origins: Option<Vec<[f64; 3]>>,
    pattern: Option<PatternTable>,
});

impl CameraFile {
    pub fn of(camera: &Camera, spec: &SensorSpec) -> Self {
        let &Camera { width, height, fx, fy, cx, cy, ref distortion } = camera;
        let turn = Some(spec.optical_from_image).filter(|turn| *turn != DQuat::IDENTITY);
        let optical_from_image = turn.map(|turn| turn.to_array());
        let distortion = DistortionTable::of(distortion);
        Self { width, height, fx, fy, cx, cy, optical_from_image, distortion, ..Self::of_common(spec) }
    }

    pub fn spec(self, name: &str) -> Result<SensorSpec> {
        let distortion = self.distortion.as_ref().map_or(Ok(Distortion::None), DistortionTable::distortion);
        let distortion = distortion.map_err(|e| e.at("[distortion]"))?;
        let Self { width, height, fx, fy, cx, cy, .. } = self;
        let mut spec = self.common(name, Geometry::Camera(Camera { width, height, fx, fy, cx, cy, distortion }))?;
        if let Some(turn) = self.optical_from_image {
            let turn = MountTable::of_rotation(turn).pose();
            spec.optical_from_image = turn.map_err(|e| e.at("optical_from_image"))?.rotation;
        }
        Ok(spec)
    }
}

impl ScannerFile {
    pub fn of(scanner: &Scanner, spec: &SensorSpec) -> Self {
        let Scanner { azimuth, elevation, beam_height_deg } = scanner;
        let (azimuth, elevation) = (AnglesTable::of(azimuth), Some(AnglesTable::of(elevation)));
        Self { beam_height_deg: *beam_height_deg, azimuth, elevation, ..Self::of_common(spec) }
    }

    pub fn spec(self, name: &str) -> Result<SensorSpec> {
        let azimuth = self.azimuth.angles().map_err(|e| e.at("[azimuth]"))?;
        match (&self.elevation, &self.beams) {
            (Some(elevation), None) => {
                let elevation = elevation.angles().map_err(|e| e.at("[elevation]"))?;
                let scanner = Scanner { azimuth, elevation, beam_height_deg: self.beam_height_deg };
                self.common(name, Geometry::Scanner(scanner))
            }
            (None, Some(_)) if self.format == FORMAT => {
                Err(Error::invalid("format 1 has no such table", "write format = 2").at("[beams]"))
            }
            (None, Some(table)) if self.beam_height_deg.is_none() => {
                let beams = table.beams(azimuth, self.timing.as_ref())?;
                let times = beams.times();
                let rays = RayTable::of_beams(beams).map_err(|e| e.at("[beams]"))?;
                Ok(self.common(name, Geometry::Rays(rays))?.with_times(times))
            }
            _ => Err(Error::invalid(
                "a scanner needs either [elevation] or [beams]",
                "give [elevation], with beam_height_deg if you like, or [beams] without it",
            )),
        }
    }

    /// The beams of a spinning sensor, if its rays and times are still theirs.
    pub fn of_beams(table: &RayTable, spec: &SensorSpec) -> Option<Self> {
        let beams = table.beams().filter(|beams| beams.times() == spec.times)?;
        let timing = TimingTable::of(&RayTimes::turning(beams.turn_s, beams.stamp));
        let common = Self::of_common(&spec.clone().with_times(RayTimes::AtOnce));
        let (azimuth, beams) = (AnglesTable::of(&beams.azimuth), Some(BeamsTable::of(beams)));
        Some(Self { format: BEAMS_FORMAT, timing, azimuth, beams, ..common })
    }
}

impl RaysFile {
    pub fn of(table: &RayTable, spec: &SensorSpec) -> Self {
        let directions = Some(table.directions().iter().map(DVec3::to_array).collect());
        let origins: Option<Vec<_>> = table.origins().map(|origins| origins.iter().map(DVec3::to_array).collect());
        let (width, height) = (table.width(), table.height());
        if origins.is_none() {
            return Self { width, height, directions, ..Self::of_common(spec) };
        }
        let common = Self::of_common(&spec.clone().with_times(RayTimes::AtOnce));
        let timing = TimingTable::of(&spec.times);
        Self { format: BEAMS_FORMAT, width, height, directions, origins, timing, ..common }
    }

    pub fn spec(mut self, name: &str, folder: Option<&Path>) -> Result<SensorSpec> {
        self.check_format()?;
        let mut times = None;
        let directions = match (self.directions.take(), &self.file, &self.pattern) {
            (Some(inline), None, None) => inline.into_iter().map(DVec3::from_array).collect(),
            (None, Some(file), None) => from_text(&folder.unwrap_or(Path::new("")).join(file), parse_directions)?,
            (None, None, Some(pattern)) if self.height == 1 && self.timing.is_none() => {
                let (directions, of_pattern) = pattern.rays(self.width).map_err(|e| e.at("[pattern]"))?;
                times = Some(of_pattern);
                directions
            }
            (None, None, Some(_)) => {
                let remedy = "write height = 1 and no [timing]: a pattern has its own duration";
                return Err(Error::invalid("a pattern is a row of rays with times", remedy).at("[pattern]"));
            }
            _ => {
                return Err(Error::invalid(
                    "a ray table needs either directions, file or [pattern]",
                    "give directions = [[x, y, z], ..] or file = \"X.csv\"",
                ));
            }
        };
        let mut table = RayTable::new(self.width, self.height, directions)?;
        if let Some(origins) = self.origins.take() {
            let origins = origins.into_iter().map(DVec3::from_array).collect();
            table = table.with_origins(origins).map_err(|e| e.at("origins"))?;
        }
        let mut spec = self.common(name, Geometry::Rays(table))?;
        spec.times = times.unwrap_or(spec.times);
        Ok(spec)
    }

    /// Refuses keys that format 1 does not have.
    fn check_format(&self) -> Result<()> {
        let newer = [(self.origins.is_some(), "origins"), (self.pattern.is_some(), "[pattern]")];
        match newer.into_iter().find(|(given, _)| *given && self.format == FORMAT) {
            Some((_, key)) => Err(Error::invalid("format 1 has no such key", "write format = 2").at(key)),
            None => Ok(()),
        }
    }
}

/// Parses directions `x,y,z`, one per line; skips empty lines and lines that start with `#`.
fn parse_directions(text: &str) -> Result<Vec<DVec3>> {
    let mut directions = Vec::new();
    for (i, line) in text.lines().enumerate() {
        let line = line.trim();
        if line.is_empty() || line.starts_with('#') {
            continue;
        }
        let numbers: Option<Vec<f64>> = line.split(',').map(|n| n.trim().parse().ok()).collect();
        let Some(&[x, y, z]) = numbers.as_deref() else {
            return Err(Error::invalid(
                format!("{} is not a direction", quoted(line)),
                "write x,y,z (nan,nan,nan for no ray)",
            )
            .at(format!("line {}", i + 1)));
        };
        directions.push(DVec3::new(x, y, z));
        if directions.len() as u64 > limits::MAX_PIXELS {
            return Err(Error::invalid("too many directions", format!("give at most {}", limits::MAX_PIXELS)));
        }
    }
    Ok(directions)
}
