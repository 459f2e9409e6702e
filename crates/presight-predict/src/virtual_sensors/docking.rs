//! Docking: the visible landmarks, and how accurately they determine the robot's pose relative to them.
//!
//! A landmark at q in the robot's frame gives the measurements that the sensor makes of a point, with the noise in the
//! sensor's specification:
//! - scanners: range, azimuth and, with more than one row, elevation;
//! - cameras of class `laser` (depth cameras): range, column and row;
//! - ray tables: range and two angles across the ray.
//!
//! A small motion (t, r) of the robot, along and about its own axes, moves the landmark to q - t + q x r. J holds the
//! derivatives of all measurements with respect to that motion, and R is their covariance. No unbiased estimate of the
//! pose can be better than (J^T R^-1 J)^-1 (Cramer and Rao), and least squares reaches this bound for small noise.
//! Landmark positions are assumed exact; the uncertainty of the dock's own position is not included.
//!
//! A sensor with one row measures in a plane, so the pose has 3 degrees of freedom: x, y and yaw. Otherwise it has x,
//! y, z, roll, pitch and yaw. If the landmarks leave directions undetermined, these are listed and there is no
//! covariance. Fiducials count only if fully visible, by their corners, or by their centre for a sensor with one row.

use super::View;
use super::landmarks::{self, Landmark};
use glam::DVec3;
use presight_features::FeaturePrediction;
use presight_model::error::{Error, Result};
use presight_model::matrix::{Matrix, eigen};
use presight_model::sensor::{Geometry, Sensor};
use serde::Serialize;

/// Degrees of freedom of a pose, in the order of a covariance.
const AXES: [&str; 6] = ["x", "y", "z", "roll", "pitch", "yaw"];
/// Degrees of freedom of a planar sensor, as indices into [`AXES`].
const PLANAR: [usize; 3] = [0, 1, 5];
/// Minimum visible fraction at which a fiducial is decoded.
const WHOLE: f64 = 0.99;
/// A direction is undetermined if its information is below this share of the largest, with angles scaled to lengths at
/// the landmarks' distance. Its standard deviation is then over 10^5 times the smallest. Rounding is at 10^-16.
const OPEN: f64 = 1e-10;

/// The landmarks of a dock, and the resulting pose covariance.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Docking {
    /// The visible landmarks.
    pub landmarks: Vec<Landmark>,
    /// Number of landmarks in the prediction, visible or not.
    pub known: usize,
    /// Number of scalar measurements.
    pub measurements: usize,
    /// The degrees of freedom, in the order of `covariance`: `x, y, yaw`, or `x, y, z, roll, pitch, yaw`.
    pub freedom: Vec<&'static str>,
    /// Covariance of a small motion of the robot along and about its own axes, row by row, metres and radians; `None`
    /// if a direction is undetermined.
    pub covariance: Option<Vec<Vec<f64>>>,
    /// Standard deviations by degree of freedom; `None` if a direction is undetermined.
    pub sigmas: Option<Vec<f64>>,
    /// Information matrix J^T R^-1 J.
    pub information: Vec<Vec<f64>>,
    /// Undetermined directions.
    pub unobservable: Vec<Unobservable>,
}

/// A motion of the robot that changes no measurement.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Unobservable {
    /// The degrees of freedom involved, joined by `+`.
    pub name: String,
    /// The motion by degree of freedom, metres and radians, scaled so that the largest entry is 1.
    pub motion: Vec<f64>,
}

impl Docking {
    pub(super) fn summary(&self) -> String {
        let seen = format!("{} of {} landmarks are seen", self.landmarks.len(), self.known);
        let Some(sigmas) = &self.sigmas else {
            let open: Vec<&str> = self.unobservable.iter().map(|u| u.name.as_str()).collect();
            return format!("{seen}; the pose is not fixed: {}", open.join(", "));
        };
        let deviations = self.freedom.iter().zip(sigmas).map(|(axis, sigma)| match *axis {
            "x" | "y" | "z" => format!("{axis} {:.2} mm", sigma * 1e3),
            _ => format!("{axis} {:.4} deg", sigma.to_degrees()),
        });
        format!("{seen}; one sigma: {}", deviations.collect::<Vec<_>>().join(", "))
    }
}

/// Checks that the sensor states the noise of each measured quantity.
pub(super) fn check_noise(sensor: &Sensor) -> Result<()> {
    let noise = sensor.spec().noise;
    let across = match sensor.spec().geometry {
        Geometry::Camera(_) => ("pixel_sigma", noise.pixel_sigma),
        Geometry::Scanner(_) | Geometry::Rays(_) => ("angle_sigma_deg", noise.angle_sigma),
    };
    match [("range_sigma", noise.range_sigma), across].into_iter().find(|(_, sigma)| *sigma == 0.0) {
        None => Ok(()),
        Some((name, _)) => Err(Error::usage(
            format!("docking: sensor {:?} does not state {name}", sensor.spec().name),
            format!(
                "write {name} above 0 under [noise] in the sensor's file (presight sensors NAME prints a preset's)"
            ),
        )),
    }
}

pub(super) fn reduce(view: &View<'_>, features: &FeaturePrediction) -> Result<Docking> {
    let sensor = view.sensor;
    check_noise(sensor)?;
    let found = landmarks::reduce(view, features);
    let planar = sensor.height() == 1;
    let points = found.landmarks.iter().flat_map(|l| measured(l, planar)).collect::<Vec<_>>();
    let axes: Vec<usize> = if planar { PLANAR.to_vec() } else { (0..6).collect() };
    let mut information = [[0.0; 6]; 6];
    let mut measurements = 0;
    for p in &points {
        for row in rows(sensor, *p) {
            measurements += 1;
            for (i, a) in axes.iter().enumerate() {
                for (j, b) in axes.iter().enumerate() {
                    information[i][j] += row[*a] * row[*b];
                }
            }
        }
    }
    let reach = points.iter().map(|p| p.length_squared()).sum::<f64>() / points.len().max(1) as f64;
    let (covariance, unobservable) = invert(&information, &axes, reach.sqrt().max(1e-3));
    let n = axes.len();
    Ok(Docking {
        landmarks: found.landmarks,
        known: found.known,
        measurements,
        freedom: axes.iter().map(|a| AXES[*a]).collect(),
        sigmas: covariance.map(|c| (0..n).map(|i| c[i][i].sqrt()).collect()),
        covariance: covariance.map(|c| to_rows(&c, n)),
        information: to_rows(&information, n),
        unobservable,
    })
}

fn to_rows(matrix: &Matrix, n: usize) -> Vec<Vec<f64>> {
    matrix[..n].iter().map(|row| row[..n].to_vec()).collect()
}

/// The measured points of a landmark, robot frame.
fn measured(landmark: &Landmark, planar: bool) -> Vec<DVec3> {
    let middle = vec![DVec3::from(landmark.position_robot)];
    if landmark.corners_robot.is_empty() {
        return middle;
    }
    if landmark.visible_fraction < WHOLE {
        return Vec::new();
    }
    if planar { middle } else { landmark.corners_robot.iter().map(|p| DVec3::from(*p)).collect() }
}

/// Derivatives of a point's measurements with respect to the robot's motion, divided by their standard deviations.
fn rows(sensor: &Sensor, p_in_robot: DVec3) -> Vec<[f64; 6]> {
    let mount = &sensor.spec().mount;
    let s = mount.inverse().transform_point(p_in_robot);
    gradients(sensor, s)
        .into_iter()
        .map(|(gradient, sigma)| {
            let g = mount.rotation * gradient / sigma;
            // The point is at q - t + q x r. The derivative by t is -g; by r it follows from g . (q x r) = (g x q) . r.
            let turned = g.cross(p_in_robot);
            [-g.x, -g.y, -g.z, turned.x, turned.y, turned.z]
        })
        .collect()
}

/// Gradients of the measurements with respect to the point's position in body axes, with standard deviations.
fn gradients(sensor: &Sensor, s: DVec3) -> Vec<(DVec3, f64)> {
    let noise = sensor.spec().noise;
    let (range, flat) = (s.length(), s.x.hypot(s.y));
    let mut found = vec![(s / range, noise.range_sigma)];
    match &sensor.spec().geometry {
        Geometry::Scanner(_) => {
            // On the axis the azimuth is undefined.
            if flat > 1e-9 * range {
                found.push((DVec3::new(-s.y, s.x, 0.0) / (flat * flat), noise.angle_sigma));
                if sensor.height() > 1 {
                    let upward = DVec3::new(-s.x * s.z, -s.y * s.z, flat * flat) / (flat * range * range);
                    found.push((upward, noise.angle_sigma));
                }
            }
        }
        Geometry::Rays(_) => {
            let (a, b) = (s / range).any_orthonormal_pair();
            found.extend([a, b].map(|tangent| (tangent / range, noise.angle_sigma)));
        }
        Geometry::Camera(_) => found.extend(pixel_gradients(sensor, s).map(|g| (g, noise.pixel_sigma))),
    }
    found
}

/// Gradients of column and row by central differences, for any lens; accurate to 8 digits.
fn pixel_gradients(sensor: &Sensor, s: DVec3) -> [DVec3; 2] {
    let image_from_body = sensor.body_from_image().transpose();
    let step = 1e-6 * s.length();
    let mut gradients = [DVec3::ZERO; 2];
    for (k, axis) in DVec3::AXES.into_iter().enumerate() {
        let at = |sign: f64| sensor.project(image_from_body * (s + sign * step * axis));
        if let (Some(after), Some(before)) = (at(1.0), at(-1.0)) {
            gradients[0][k] = (after.0 - before.0) / (2.0 * step);
            gradients[1][k] = (after.1 - before.1) / (2.0 * step);
        }
    }
    gradients
}

/// Returns the inverse, or the undetermined directions. `reach` (metres) scales angles to lengths.
fn invert(information: &Matrix, axes: &[usize], reach: f64) -> (Option<Matrix>, Vec<Unobservable>) {
    let n = axes.len();
    let scale = |i: usize| if axes[i] >= 3 { reach } else { 1.0 };
    let scaled = std::array::from_fn(|i| {
        std::array::from_fn(|j| if i < n && j < n { information[i][j] / (scale(i) * scale(j)) } else { 0.0 })
    });
    let (values, vectors) = eigen(scaled, n);
    let most = values[..n].iter().copied().fold(0.0, f64::max);
    let open: Vec<usize> = (0..n).filter(|k| !(values[*k] > OPEN * most)).collect();
    if !open.is_empty() {
        let motions = open.iter().map(|k| (0..n).map(|i| vectors[i][*k]).collect()).collect();
        let unscaled = |motion: Vec<f64>| motion.into_iter().enumerate().map(|(i, m)| m / scale(i)).collect();
        return (None, reduced(motions).into_iter().map(|m| named(unscaled(m), axes, reach)).collect());
    }
    let entry = |i: usize, j: usize| {
        (0..n).map(|k| vectors[i][k] * vectors[j][k] / values[k]).sum::<f64>() / (scale(i) * scale(j))
    };
    (Some(std::array::from_fn(|i| std::array::from_fn(|j| if i < n && j < n { entry(i, j) } else { 0.0 }))), Vec::new())
}

/// Changes the basis so that each vector has a component in which all others are 0, which makes it simple to name.
fn reduced(mut rows: Vec<Vec<f64>>) -> Vec<Vec<f64>> {
    for done in 0..rows.len() {
        let n = rows[done].len();
        let at = |k: usize| (k / n + done, k % n);
        let places = (0..n * (rows.len() - done)).map(at);
        let Some((r, c)) = places.max_by(|a, b| rows[a.0][a.1].abs().total_cmp(&rows[b.0][b.1].abs())) else { break };
        rows.swap(done, r);
        let pivot = rows[done].clone();
        for (k, row) in rows.iter_mut().enumerate() {
            let factor = row[c] / pivot[c];
            for (x, p) in row.iter_mut().zip(&pivot) {
                *x = if k == done { *x / pivot[c] } else { *x - factor * p };
            }
        }
    }
    rows
}

fn named(mut motion: Vec<f64>, axes: &[usize], reach: f64) -> Unobservable {
    // Components below a thousandth, as lengths at the landmarks' distance, are left out of the name.
    let length = |i: usize, m: f64| m.abs() * if axes[i] >= 3 { reach } else { 1.0 };
    let longest = motion.iter().enumerate().map(|(i, m)| length(i, *m)).fold(0.0, f64::max);
    let part: Vec<usize> = (0..motion.len()).filter(|i| length(*i, motion[*i]) > 1e-3 * longest).collect();
    let largest = motion.iter().copied().fold(0.0, |a: f64, b| if b.abs() > a.abs() { b } else { a });
    motion.iter_mut().for_each(|m| *m /= largest);
    Unobservable { name: part.iter().map(|i| AXES[axes[*i]]).collect::<Vec<_>>().join("+"), motion }
}
