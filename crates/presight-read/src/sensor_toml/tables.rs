//! The tables of a sensor file.

use glam::{DQuat, DVec3};
use presight_model::error::{Error, Result};
use presight_model::geometry::Pose;
use presight_model::limits;
use presight_model::sensor::{Angles, BeamTable, Distortion, Mixture, Noise, RayTimes, StampAt};
use serde::{Deserialize, Serialize};

#[derive(Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub struct DistortionTable {
    model: String,
    #[serde(default)]
    coefficients: Vec<f64>,
}

impl DistortionTable {
    pub fn of(lens: &Distortion) -> Option<Self> {
        let table = || Self { model: lens.model().to_owned(), coefficients: lens.coefficients().to_vec() };
        (*lens != Distortion::None).then(table)
    }

    pub fn distortion(&self) -> Result<Distortion> {
        Distortion::from_model(&self.model, &self.coefficients)
    }
}

#[derive(Default, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub struct AnglesTable {
    start_deg: Option<f64>,
    step_deg: Option<f64>,
    count: Option<u32>,
    angles_deg: Option<Vec<f64>>,
}

impl AnglesTable {
    pub fn of(angles: &Angles) -> Self {
        match angles {
            &Angles::Uniform { start_deg, step_deg, count } => {
                Self { start_deg: Some(start_deg), step_deg: Some(step_deg), count: Some(count), angles_deg: None }
            }
            Angles::Listed(listed) => Self { angles_deg: Some(listed.clone()), ..Self::default() },
        }
    }

    pub fn angles(&self) -> Result<Angles> {
        match (self.start_deg, self.step_deg, self.count, &self.angles_deg) {
            (Some(start_deg), Some(step_deg), Some(count), None) => Ok(Angles::Uniform { start_deg, step_deg, count }),
            (None, None, None, Some(listed)) => Ok(Angles::Listed(listed.clone())),
            _ => Err(Error::invalid(
                "neither a uniform grid nor a list",
                "give start_deg, step_deg and count, or angles_deg alone",
            )),
        }
    }
}

/// The ray of a scan to which the stamp belongs.
#[derive(Clone, Copy, Deserialize, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum StampName {
    First,
    Middle,
    Last,
}

impl StampName {
    /// `None` for the first ray, the default.
    pub fn of(stamp: StampAt) -> Option<Self> {
        match stamp {
            StampAt::First => None,
            StampAt::Middle => Some(Self::Middle),
            StampAt::Last => Some(Self::Last),
        }
    }

    pub fn stamp(this: Option<Self>) -> StampAt {
        match this {
            None | Some(Self::First) => StampAt::First,
            Some(Self::Middle) => StampAt::Middle,
            Some(Self::Last) => StampAt::Last,
        }
    }
}

#[derive(Default, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub struct TimingTable {
    turn_s: Option<f64>,
    readout_s: Option<f64>,
    stamp: Option<StampName>,
    times_s: Option<Vec<f32>>,
}

impl TimingTable {
    pub fn of(times: &RayTimes) -> Option<Self> {
        match times {
            RayTimes::AtOnce => None,
            RayTimes::Columns { turn_s, stamp } => {
                Some(Self { turn_s: Some(*turn_s), stamp: StampName::of(*stamp), ..Self::default() })
            }
            RayTimes::Rows { readout_s, stamp } => {
                Some(Self { readout_s: Some(*readout_s), stamp: StampName::of(*stamp), ..Self::default() })
            }
            RayTimes::Listed(times) => Some(Self { times_s: Some(times.to_vec()), ..Self::default() }),
        }
    }

    pub fn times(&self) -> Result<RayTimes> {
        let stamp = StampName::stamp(self.stamp);
        match (self.turn_s, self.readout_s, &self.times_s) {
            (Some(turn_s), None, None) => Ok(RayTimes::turning(turn_s, stamp)),
            (None, Some(0.0), None) => Ok(RayTimes::AtOnce),
            (None, Some(readout_s), None) => Ok(RayTimes::Rows { readout_s, stamp }),
            (None, None, Some(times)) if self.stamp.is_none() => Ok(RayTimes::Listed(times.clone().into())),
            _ => Err(Error::invalid(
                "not one way to say when rays are measured",
                "give turn_s (columns) or readout_s (rows), with stamp, or times_s (for each ray) alone",
            )),
        }
    }

    /// The turn of beams and the column of the stamp.
    pub fn turn(&self) -> Result<(f64, StampAt)> {
        if self.readout_s.is_some() || self.times_s.is_some() {
            let remedy = "give turn_s and stamp here, and time_offsets_s in [beams]";
            return Err(Error::invalid("beams turn by columns", remedy));
        }
        Ok((self.turn_s.unwrap_or(0.0), StampName::stamp(self.stamp)))
    }
}

#[derive(Default, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub struct BeamsTable {
    elevations_deg: Vec<f64>,
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    azimuth_offsets_deg: Vec<f64>,
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    origins: Vec<[f64; 3]>,
    range_lead: Option<f64>,
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    time_offsets_s: Vec<f64>,
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    shifts: Vec<i32>,
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    destaggered: bool,
    columns: Option<[u32; 2]>,
    body_from_head: Option<MountTable>,
}

impl BeamsTable {
    pub fn of(beams: &BeamTable) -> Self {
        Self {
            elevations_deg: beams.elevations_deg.clone(),
            azimuth_offsets_deg: beams.azimuth_offsets_deg.clone(),
            origins: beams.origins.iter().map(DVec3::to_array).collect(),
            range_lead: Some(beams.range_lead).filter(|lead| *lead != 0.0),
            time_offsets_s: beams.time_offsets_s.clone(),
            shifts: beams.shifts.clone(),
            destaggered: beams.is_destaggered,
            columns: beams.columns,
            body_from_head: MountTable::of(&beams.body_from_head),
        }
    }

    pub fn beams(&self, azimuth: Angles, timing: Option<&TimingTable>) -> Result<BeamTable> {
        let mut beams = BeamTable::new(azimuth, self.elevations_deg.clone());
        beams.azimuth_offsets_deg.clone_from(&self.azimuth_offsets_deg);
        beams.origins = self.origins.iter().copied().map(DVec3::from_array).collect();
        beams.range_lead = self.range_lead.unwrap_or(0.0);
        beams.time_offsets_s.clone_from(&self.time_offsets_s);
        beams.shifts.clone_from(&self.shifts);
        beams.is_destaggered = self.destaggered;
        beams.columns = self.columns;
        if let Some(table) = &self.body_from_head {
            beams.body_from_head = table.pose().map_err(|e| e.at("[beams]: body_from_head"))?;
        }
        if let Some(timing) = timing {
            (beams.turn_s, beams.stamp) = timing.turn().map_err(|e| e.at("[timing]"))?;
        }
        Ok(beams)
    }
}

/// Rays whose azimuth turns evenly while their elevation swings evenly between two ends.
#[derive(Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub struct PatternTable {
    duration_s: f64,
    turns: f64,
    swings: f64,
    elevation_deg: [f64; 2],
}

impl PatternTable {
    /// The directions of so many rays, and their seconds after the first one.
    pub fn rays(&self, count: u32) -> Result<(Vec<DVec3>, RayTimes)> {
        let [low, high] = self.elevation_deg;
        let numbers = [self.duration_s, self.turns, self.swings];
        let are_sound = numbers.iter().all(|x| x.is_finite()) && low >= -90.0 && low <= high && high <= 90.0;
        if !are_sound || count > limits::MAX_LISTED_RAYS {
            let what = format!("{count} rays in {} s between {low} and {high} deg", self.duration_s);
            let remedy =
                format!("give finite numbers, elevations within +-90, at most {} rays", limits::MAX_LISTED_RAYS);
            return Err(Error::invalid(what, remedy));
        }
        let share = |i: u32| f64::from(i) / f64::from(count);
        let direction = |i: u32| {
            let up = 1.0 - (2.0 * (self.swings * share(i)).rem_euclid(1.0) - 1.0).abs();
            let (sin_up, cos_up) = (low + (high - low) * up).to_radians().sin_cos();
            let (sin, cos) = (360.0 * (self.turns * share(i)).rem_euclid(1.0)).to_radians().sin_cos();
            DVec3::new(cos_up * cos, cos_up * sin, sin_up)
        };
        let times: Vec<f32> = (0..count).map(|i| (self.duration_s * share(i)) as f32).collect();
        Ok(((0..count).map(direction).collect(), RayTimes::Listed(times.into())))
    }
}

/// `robot_from_sensor` of a sensor file or a robot file.
#[derive(Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub struct MountTable {
    #[serde(default)]
    xyz: [f64; 3],
    rpy_deg: Option<[f64; 3]>,
    quaternion: Option<[f64; 4]>,
}

impl MountTable {
    pub fn of(mount: &Pose) -> Option<Self> {
        let table = || Self { xyz: mount.translation.to_array(), ..Self::of_rotation(mount.rotation.to_array()) };
        (*mount != Pose::IDENTITY).then(table)
    }

    pub fn of_rotation(quaternion: [f64; 4]) -> Self {
        Self { xyz: [0.0; 3], rpy_deg: None, quaternion: Some(quaternion) }
    }

    pub fn pose(&self) -> Result<Pose> {
        const UNSOUND: &str = "a number is not finite or too large, or the quaternion has no length";
        let wrong = |what: &str| Error::invalid(what, "give xyz in metres, and rpy_deg or quaternion = [x, y, z, w]");
        let translation = DVec3::from_array(self.xyz);
        let pose = match (self.rpy_deg, self.quaternion) {
            (Some(_), Some(_)) => return Err(wrong("rpy_deg and quaternion are both given")),
            (rpy, None) => {
                let [roll, pitch, yaw] = rpy.unwrap_or_default().map(f64::to_radians);
                Pose::from_xyz_rpy(translation, roll, pitch, yaw)
            }
            (None, Some(q)) => {
                let q = DQuat::from_array(q);
                let near = Pose::new(translation, q).map_err(|_| wrong(UNSOUND))?;
                // A unit quaternion keeps its bits, so that a written pose reads back equal.
                let rotation = if (q.length_squared() - 1.0).abs() <= 1e-12 { q } else { near.rotation };
                Pose { rotation, translation }
            }
        };
        // Non-finite angles give a non-finite rotation.
        Pose::new(pose.translation, pose.rotation).map_err(|_| wrong(UNSOUND))?;
        Ok(pose)
    }
}

#[derive(Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub struct NoiseTable {
    #[serde(default)]
    range_sigma: f64,
    #[serde(default)]
    angle_sigma_deg: f64,
    #[serde(default)]
    pixel_sigma: f64,
    range_sigma_quadratic: Option<f64>,
    stamp_sigma_s: Option<f64>,
    p_hit: Option<f64>,
    p_short: Option<f64>,
    p_none: Option<f64>,
    p_any: Option<f64>,
    beam_dependence: Option<f64>,
}

impl NoiseTable {
    /// The parts of a noise that differ from the default; `None` if none does.
    pub fn of(noise: &Noise) -> Option<Self> {
        if *noise == Noise::default() {
            return None;
        }
        let unless_zero = |sigma: f64| Some(sigma).filter(|sigma| *sigma != 0.0);
        let mixture = Some(noise.mixture).filter(|mixture| *mixture != Mixture::default());
        Some(Self {
            range_sigma: noise.range_sigma,
            angle_sigma_deg: degrees(noise.angle_sigma),
            pixel_sigma: noise.pixel_sigma,
            range_sigma_quadratic: unless_zero(noise.range_sigma_quadratic),
            stamp_sigma_s: unless_zero(noise.stamp_sigma),
            p_hit: mixture.map(|m| m.hit),
            p_short: mixture.map(|m| m.short),
            p_none: mixture.map(|m| m.none),
            p_any: mixture.map(|m| m.any),
            beam_dependence: mixture.map(|m| m.beam_dependence),
        })
    }

    pub fn noise(&self) -> Noise {
        let usual = Mixture::default();
        Noise {
            range_sigma: self.range_sigma,
            range_sigma_quadratic: self.range_sigma_quadratic.unwrap_or(0.0),
            angle_sigma: self.angle_sigma_deg.to_radians(),
            pixel_sigma: self.pixel_sigma,
            stamp_sigma: self.stamp_sigma_s.unwrap_or(0.0),
            mixture: Mixture {
                hit: self.p_hit.unwrap_or(usual.hit),
                short: self.p_short.unwrap_or(usual.short),
                none: self.p_none.unwrap_or(usual.none),
                any: self.p_any.unwrap_or(usual.any),
                beam_dependence: self.beam_dependence.unwrap_or(usual.beam_dependence),
            },
        }
    }
}

/// The roundest degrees that convert to exactly these radians, or the nearest if none do.
pub fn degrees(radians: f64) -> f64 {
    let near = radians.to_degrees();
    let round = format!("{near:.12e}").parse().unwrap_or(near);
    let candidates = [round, near, near.next_up(), near.next_down()];
    candidates.into_iter().find(|d| d.to_radians() == radians).unwrap_or(near)
}
