//! Residuals of flat surfaces that were found: line segments in scans, planes in range images.
//!
//! Each point that stands for a found surface ([`crate::extract::FoundSurface`]) is compared with the plane of the model, as a measured point
//! of a range image is: e = n x - d, J = [n, (x - c) cross n].

use super::normal::{CommonError, GroupSum, Normal};
use super::{Gate, Residuals};
use crate::extract::FoundSurface;
use crate::verdict::body_from_image;
use glam::DVec3;
use presight_model::geometry::{Plane, Pose};
use presight_model::sensor::Sensor;
use presight_model::statistics::upper_median;

/// A surface of the model, and what was found of it.
#[derive(Clone, Debug, PartialEq)]
pub struct SeenSurface {
    /// The model's, world frame.
    pub plane: Plane,
    /// Points on what was found, image frame of the sensor, metres; their errors are independent.
    pub points: Vec<DVec3>,
    /// Of each along the normal, one standard deviation, metres.
    pub sigma: f64,
    /// Surfaces with one number share an offset.
    pub group: u32,
}

impl SeenSurface {
    /// What was found of a plane of the model.
    pub fn new(plane: Plane, found: &FoundSurface, group: u32) -> Self {
        Self { plane, points: found.points.clone(), sigma: found.sigma, group }
    }
}

/// What flat surfaces say of the pose.
#[derive(Clone, Debug)]
pub struct SurfaceSource {
    robot_from_image: Pose,
    surfaces: Vec<SeenSurface>,
}

impl SurfaceSource {
    /// A source of surfaces that a sensor found.
    pub fn new(sensor: &Sensor, surfaces: Vec<SeenSurface>) -> Self {
        Self { robot_from_image: sensor.spec().mount * body_from_image(sensor), surfaces }
    }
}

impl Residuals for SurfaceSource {
    fn linearize(&self, world_from_robot: &Pose, gate: &Gate) -> Normal {
        let world_from_image = *world_from_robot * self.robot_from_image;
        let mut normal = Normal::default();
        let mut sizes = Vec::new();
        for s in &self.surfaces {
            let n = s.plane.normal;
            for point in &s.points {
                let x = world_from_image.transform_point(*point);
                let arm = x - world_from_robot.translation;
                let turned = arm.cross(n);
                let e = n.dot(x) - s.plane.offset;
                let j = [n.x, n.y, n.z, turned.x, turned.y, turned.z].map(|j| j / s.sigma);
                let wide = (gate.translation + gate.rotation * arm.length()) / s.sigma;
                let weight = normal.add_residual(e / s.sigma, &j, wide, gate.kernel);
                normal.measured += 1;
                sizes.push((e / s.sigma).abs());
                if gate.finally {
                    let w = weight / (s.sigma * s.sigma);
                    let group: &mut GroupSum = normal.groups.entry(CommonError::Offset(s.group)).or_default();
                    (0..6).for_each(|a| group.pull[a][0] -= w * s.sigma * j[a]);
                    group.weight += w;
                    group.residual += w * e;
                    group.variance += w * weight;
                }
            }
        }
        normal.spread = upper_median(&mut sizes, f64::total_cmp).unwrap_or(0.0);
        normal
    }
}
