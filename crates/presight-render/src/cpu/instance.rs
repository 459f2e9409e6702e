//! Instances in the frame of the rays.

use super::batch::Shade;
use crate::plan::{FramePlan, Instance};
use glam::{DMat3, DVec3};
use presight_model::environment::Mesh;
use presight_model::sensor::PixelGrid;

/// One instance in the frame of the rays.
pub(super) struct RayInstance<'a> {
    pub mesh: &'a Mesh,
    pub ray_from_mesh: DMat3,
    /// Maps a mesh normal divided by its plane's distance to m.
    pub m_from_normal: DMat3,
    normal_from_mesh: DMat3,
    /// The value of [`RayInstance::length_per_distance`] for every normal, if there is one.
    uniform: Option<f64>,
    pub center: DVec3,
    /// Upper bound of the factor by which vectors grow from the mesh to the frame of the rays.
    pub stretch: f64,
    pub mirrored: bool,
    /// True if no polygon requires a check of its material.
    pub plain: bool,
    pub object: u32,
    pub first_slot: u32,
}

impl<'a> RayInstance<'a> {
    pub fn new(plan: &'a FramePlan, instance: &Instance) -> Self {
        let (ray_from_image, image_from_ray) = match plan.sensor.grid() {
            PixelGrid::Lines(grid) => (grid.line_from_image(), grid.image_from_line()),
            PixelGrid::Rays(_) => (DMat3::IDENTITY, DMat3::IDENTITY),
        };
        let ray_from_mesh = ray_from_image * instance.image_from_mesh;
        let object = &plan.environment().objects()[instance.object as usize];
        Self {
            mesh: &object.mesh,
            ray_from_mesh,
            m_from_normal: image_from_ray.transpose() * instance.normal_from_mesh,
            normal_from_mesh: instance.normal_from_mesh,
            uniform: uniform_scale(&instance.normal_from_mesh).map(f64::recip),
            center: instance.center_in_mesh,
            stretch: ray_from_mesh.to_cols_array().iter().map(|x| x * x).sum::<f64>().sqrt(),
            mirrored: ray_from_mesh.determinant() < 0.0,
            plain: instance.plain,
            object: instance.object,
            first_slot: object.first_slot,
        }
    }

    /// Ids and distance of a polygon with this plane distance in the mesh frame.
    #[inline(always)]
    pub fn shade(&self, plan: &FramePlan, polygon: u32, distance: f64) -> Shade {
        let normal = self.mesh.planes()[polygon as usize].normal;
        Shade {
            distance: distance.abs() * self.length_per_distance(normal),
            polygon_id: plan.drawn_polygon_id(self.object, polygon),
            object_id: self.object + 1,
        }
    }

    /// Metres per metre of a plane's distance in the mesh frame.
    #[inline(always)]
    fn length_per_distance(&self, normal: DVec3) -> f64 {
        match self.uniform {
            Some(factor) => factor,
            None => (self.normal_from_mesh * normal).length().recip(),
        }
    }
}

/// The length of transformed unit vectors, if it is the same for all up to rounding: most instances are at most scaled.
pub(super) fn uniform_scale(m: &DMat3) -> Option<f64> {
    let squares = [m.x_axis, m.y_axis, m.z_axis].map(|c| c.length_squared());
    let skew = [m.x_axis.dot(m.y_axis), m.y_axis.dot(m.z_axis), m.z_axis.dot(m.x_axis)];
    let rounding = 1e-13 * squares[0];
    let alike = (squares[0] - squares[1]).abs() <= rounding && (squares[0] - squares[2]).abs() <= rounding;
    (alike && skew.iter().all(|s| s.abs() <= rounding)).then(|| squares[0].sqrt())
}
