//! Boxes for predicted features: the sensor as a projection, and which points of a feature the box is to hold.

use super::roi::{Material, PoseCovariance, Projection, Uncertain, image_covariance, roi};
use super::{FeaturePrediction, PlacedFeature, SeenFeature};
use crate::environment::FeatureShape;
use crate::error::{Error, Result};
use crate::geometry::Pose;
use crate::sensor::{Distortion, Geometry, Sensor};
use crate::world::World;
use glam::{DMat3, DVec3};
use rayon::prelude::*;

/// How uncertain everything is, and how sure boxes are to be.
#[derive(Clone, Debug)]
pub struct BoxOptions {
    /// Covariance of the sensor's pose, along the world's axes: translation added, rotation by Exp(dtheta) from the left.
    pub sensor: PoseCovariance,
    /// Covariances of objects' poses by index of the object, in the object's own axes.
    pub objects: Vec<(u32, PoseCovariance)>,
    /// Probability with which a box holds its feature.
    pub confidence: f64,
}

impl Default for BoxOptions {
    fn default() -> Self {
        Self { sensor: [[0.0; 6]; 6], objects: Vec::new(), confidence: 0.99 }
    }
}

/// Points of a segment's visible part that its box is made of: enough for the curved images of scanners and lenses.
const POINTS: usize = 9;

/// Gives every feature that is seen its box and the covariance of its defining points in the image.
///
/// # Errors
/// [`crate::ErrorKind::Usage`] for a confidence outside 0.5..1.
pub fn add_boxes(
    prediction: &mut FeaturePrediction,
    placed: &[PlacedFeature],
    world: &World,
    sensor: &Sensor,
    world_from_sensor: &Pose,
    options: &BoxOptions,
) -> Result<()> {
    if !(0.5..1.0).contains(&options.confidence) {
        return Err(Error::usage(
            format!("confidence {} is not in 0.5..1", options.confidence),
            "give a probability such as 0.99",
        ));
    }
    let projection = Image::of(sensor);
    prediction.features.par_iter_mut().zip(placed).with_min_len(16).for_each(|(seen, placed)| {
        let object = placed.object.map(|object| &world.environment().objects()[object as usize]);
        let world_from_frame = object.map_or(Pose::IDENTITY, |o| o.world_from_object);
        let known = |object: u32| options.objects.iter().find(|(o, _)| *o == object).map(|(_, c)| c);
        let covariance = placed.object.and_then(known);
        let shape = &placed.feature.shape;
        let uncertain = Uncertain::new(world_from_sensor, &options.sensor, &world_from_frame, covariance, shape);
        add_box(seen, shape, &projection, &uncertain, options.confidence);
    });
    Ok(())
}

fn add_box(seen: &mut SeenFeature, shape: &FeatureShape, image: &Image<'_>, uncertain: &Uncertain, confidence: f64) {
    let defining: Vec<Material> = match shape {
        FeatureShape::Segment { ends, .. } => [0.0, 1.0].map(|t| Material::on_segment(ends, t)).to_vec(),
        other => other.points().iter().map(|p| Material::rigid(*p)).collect(),
    };
    seen.image_covariance = defining.iter().map(|p| image_covariance(image, uncertain, p)).collect();
    if seen.visible.is_empty() {
        return;
    }
    let points = match shape {
        FeatureShape::Segment { ends, .. } => {
            let from = seen.visible.iter().map(|v| v.t[0]).fold(1.0, f64::min);
            let to = seen.visible.iter().map(|v| v.t[1]).fold(0.0, f64::max);
            let at = |i: usize| from + (to - from) * i as f64 / (POINTS - 1) as f64;
            (0..POINTS).map(|i| Material::on_segment(ends, at(i))).collect()
        }
        _ => defining,
    };
    if let Some(found) = roi(image, uncertain, &points, confidence) {
        seen.roi = Some(found.bounds);
        seen.roi_flag = Some(found.flag.name());
    }
}

/// A sensor's image as a projection of its body frame.
struct Image<'a> {
    sensor: &'a Sensor,
    image_from_body: DMat3,
    lever: Lever,
}

/// Where the projection is singular.
#[derive(Clone, Copy, Debug)]
enum Lever {
    /// In the plane of a camera's centre.
    Depth,
    /// On a scanner's axis.
    Axis,
    /// In the centre only.
    Center,
}

impl<'a> Image<'a> {
    fn of(sensor: &'a Sensor) -> Self {
        let lever = match &sensor.spec().geometry {
            Geometry::Camera(camera) => match camera.distortion {
                Distortion::Equidistant(_) => Lever::Center,
                _ => Lever::Depth,
            },
            Geometry::Scanner(_) => Lever::Axis,
            Geometry::Rays(_) => Lever::Center,
        };
        Self { sensor, image_from_body: sensor.body_from_image().transpose(), lever }
    }
}

impl Projection for Image<'_> {
    fn project(&self, p_in_body: DVec3) -> Option<[f64; 2]> {
        self.sensor.project(self.image_from_body * p_in_body).map(|(u, v)| [u, v])
    }

    fn lever(&self, p_in_body: DVec3) -> f64 {
        let p = self.image_from_body * p_in_body;
        match self.lever {
            Lever::Depth => p.z,
            Lever::Axis => p.x.hypot(p.y),
            Lever::Center => p.length(),
        }
    }

    fn size(&self) -> (u32, u32) {
        (self.sensor.width(), self.sensor.height())
    }

    fn turn(&self) -> Option<f64> {
        self.sensor.columns_of_a_turn()
    }
}

/// The covariance of a sensor's pose from that of the robot which carries it: both along the world's axes.
/// `world_axes_lever` is the sensor's position relative to the robot's, along the world's axes, metres.
pub fn sensor_covariance(robot: &PoseCovariance, world_axes_lever: DVec3) -> PoseCovariance {
    let l = world_axes_lever;
    // d_sensor = d_robot + dtheta x lever.
    let cross = [[0.0, l.z, -l.y], [-l.z, 0.0, l.x], [l.y, -l.x, 0.0]];
    let mut adjoint = [[0.0; 6]; 6];
    for i in 0..6 {
        adjoint[i][i] = 1.0;
    }
    for i in 0..3 {
        for j in 0..3 {
            adjoint[i][3 + j] = cross[i][j];
        }
    }
    let mut moved = [[0.0; 6]; 6];
    for (i, j) in (0..6).flat_map(|i| (0..6).map(move |j| (i, j))) {
        for (k, l) in (0..6).flat_map(|k| (0..6).map(move |l| (k, l))) {
            moved[i][j] += adjoint[i][k] * robot[k][l] * adjoint[j][l];
        }
    }
    moved
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_lever_turns_heading_into_position() {
        let mut robot = [[0.0; 6]; 6];
        robot[5][5] = 0.01;
        let moved = sensor_covariance(&robot, DVec3::new(2.0, 0.0, 1.0));
        // A turn by 0.1 moves what is 2 m ahead by 0.2 m to the left.
        assert!((moved[1][1] - 0.04).abs() < 1e-15 && (moved[1][5] - 0.02).abs() < 1e-15);
        assert_eq!((moved[0][0], moved[2][2], moved[5][5]), (0.0, 0.0, 0.01));
    }
}
