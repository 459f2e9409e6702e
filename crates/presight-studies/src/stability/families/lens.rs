//! Lenses near their fold, inside and beyond.

use super::family::{Case, Family, Finding, powers};
use super::scenes::measure;
use super::shapes::{Scene, frame, wall};
use crate::stability::big::{Big, Vector};
use crate::stability::lens::{Exact, TOLERANCE};
use crate::stability::subjects::Subject;
use glam::DVec3;
use presight_model::error::Result;
use presight_model::geometry::Pose;
use presight_model::sensor::{Camera, Distortion, Geometry, Sensor, SensorSpec};

/// Image points ever closer to the fold, on one side.
#[derive(Clone, Copy)]
pub(super) struct Fold {
    /// -1 inside, +1 beyond.
    side: f64,
}

impl Fold {
    pub const INSIDE: Self = Self { side: -1.0 };
    pub const BEYOND: Self = Self { side: 1.0 };
}

/// One folding lens of each model. The last three have tangential and thin prism terms, so the radius of their fold
/// depends on the direction; the very last has a tilted image sensor too.
fn models() -> [Distortion; 6] {
    let prism = [-0.4, 0.02, 1e-3, -2e-3, 0.0, 0.05, 0.0, 0.0, 4e-3, -2e-3, -3e-3, 1e-3, 0.0, 0.0];
    let mut tilted = prism;
    tilted[12..].copy_from_slice(&[0.03, -0.02]);
    [
        Distortion::PlumbBob([-0.3, 0.0, 0.0, 0.0, 0.0]),
        Distortion::RationalPolynomial(std::array::from_fn(|i| if [0, 1, 5].contains(&i) { prism[i] } else { 0.0 })),
        Distortion::Equidistant([-0.05, -0.01, 0.0, 0.0]),
        Distortion::PlumbBob([-0.3, 0.0, 0.003, -0.002, 0.0]),
        Distortion::RationalPolynomial(prism),
        Distortion::RationalPolynomial(tilted),
    ]
}

/// Image radius of the fold; for models with other terms, of their radial part.
fn fold(model: &Distortion) -> f64 {
    let radial = match model {
        Distortion::PlumbBob([k1, k2, _, _, k3]) => Distortion::PlumbBob([*k1, *k2, 0.0, 0.0, *k3]),
        Distortion::RationalPolynomial([k1, k2, _, _, k3, k4, k5, k6, ..]) => {
            let [k1, k2, k3, k4, k5, k6] = [*k1, *k2, *k3, *k4, *k5, *k6];
            Distortion::RationalPolynomial([k1, k2, 0., 0., k3, k4, k5, k6, 0., 0., 0., 0., 0., 0.])
        }
        other => other.clone(),
    };
    Exact::new(&radial).fold.map_or(1.0, |fold| fold.to_f64())
}

impl Family for Fold {
    fn name(&self) -> &'static str {
        if self.side < 0.0 { "lens-inside" } else { "lens-beyond" }
    }

    fn about(&self) -> &'static str {
        if self.side < 0.0 {
            "Image points ever closer to the fold of six lenses (for terms that are not radial, the fold of the radial \
             part; the true fold is known to 1e-9): image coordinates of rays (engine \"sensor\"), and ranges of a \
             wall."
        } else {
            "The family beyond the fold, where no pixel may have a ray."
        }
    }

    fn axis(&self) -> &'static str {
        "distance from the fold / its image radius"
    }

    fn error(&self) -> &'static str {
        "relative error of the range; for \"sensor\" of the image coordinates"
    }

    fn difficulties(&self, quick: bool) -> Vec<f64> {
        [vec![0.6], powers(-1, -12, quick)].concat()
    }

    fn measure(&self, difficulty: f64, _quick: bool, subjects: &mut [Subject]) -> Result<Vec<Finding>> {
        let mut findings = vec![rays(1.0 + self.side * difficulty)];
        let mut cases = Vec::new();
        for model in models() {
            match case(model, 1.0 + self.side * difficulty) {
                Ok(one) => cases.extend(one),
                Err(e) => return Ok(vec![Finding::rejected(&e)]),
            }
        }
        findings.extend(measure(&cases, subjects)?);
        Ok(findings)
    }
}

/// Checks the lens models alone: from image coordinates, at a fraction of the fold's radius, to rays and exactly back.
fn rays(share: f64) -> Finding {
    let (mut worst, mut wrong) = (0.0f64, None);
    for model in models() {
        let (lens, exact, radius) = (model.lens(), Exact::new(&model), share * fold(&model));
        for k in 0..24 {
            let (sin, cos) = (0.1 + std::f64::consts::TAU * f64::from(k) / 24.0).sin_cos();
            let (xd, yd) = (radius * cos, radius * sin);
            let target = [xd, yd].map(Big::new);
            let off = |ray: &Vector| {
                let [u, v] = exact.forward(ray);
                let off = [&u - &target[0], &v - &target[1]].map(|c| c.to_f64());
                off[0].hypot(off[1]) / radius.max(1.0)
            };
            let found = lens.undistort(xd, yd);
            if let Some(ray) = found {
                worst = worst.max(off(&Vector::new(ray)));
            }
            let Some((beyond, known)) = exact.beyond_fold(&target[0], &target[1]) else { continue };
            if beyond.abs() > known && found.is_some() != (beyond < 0.0) {
                wrong = Some(format!("{}: image radius {radius} is {beyond:e} beyond the fold", model.model()));
            }
        }
    }
    let mut finding = Finding::of("sensor", worst, TOLERANCE);
    if let Some(note) = wrong {
        (finding.note, finding.outcome) = (note, super::Outcome::Fault);
    }
    finding
}

/// A wall in front of a camera whose left and right columns are at a fraction of the fold's radius.
fn case(model: Distortion, share: f64) -> Result<Vec<Case>> {
    let mut scene = Scene::new(frame(DVec3::new(0.2, 0.4, -0.3)))?;
    scene.add(&[wall(2.0, [-40.0, 3.0], [-40.0, 40.0])], Pose::from_xyz_rpy(DVec3::ZERO, 0.0, 0.1, 0.2))?;
    scene.add(&[wall(-5.0, [-99.0, 99.0], [-99.0, 99.0])], Pose::IDENTITY)?;
    let f = 16.0 / (share * fold(&model));
    let camera = Camera { distortion: model, ..Camera::pinhole(33, 17, f, f, 16.0, 8.0) };
    let sensor = Sensor::new(SensorSpec::new("lens", "study", Geometry::Camera(camera)))?;
    Ok(scene.seen_by([(sensor, Pose::IDENTITY)]))
}
