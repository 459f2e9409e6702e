//! The tables of a sensor file.

use glam::{DQuat, DVec3};
use presight_model::error::{Error, Result};
use presight_model::geometry::Pose;
use presight_model::sensor::{Angles, Distortion, Mixture, Noise};
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
