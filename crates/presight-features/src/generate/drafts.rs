//! Draft features before numbering.

use super::FeatureKind;
use glam::DVec3;
use presight_model::environment::DEFAULT_TOLERANCE;
use presight_model::geometry::Pose;

/// A feature without a number, in the world.
#[derive(Clone, Debug)]
pub(super) struct Draft {
    pub kind: FeatureKind,
    pub object: u32,
    pub points: Vec<DVec3>,
    pub normal: Option<DVec3>,
    /// Distance from its polygons that the layer has to allow, metres.
    pub tolerance: f64,
    /// True if it is a part of a patch that was split into its faces.
    pub is_part: bool,
}

impl Draft {
    pub fn new(kind: FeatureKind, object: u32, points: Vec<DVec3>) -> Self {
        Self { kind, object, points, normal: None, tolerance: DEFAULT_TOLERANCE, is_part: false }
    }

    /// Transforms the draft to the frame of its object.
    pub fn placed(mut self, world_from_object: &Pose) -> Self {
        let turn = world_from_object.rotation_matrix().transpose();
        for p in &mut self.points {
            *p = turn * (*p - world_from_object.translation);
        }
        self.normal = self.normal.map(|n| (turn * n).normalize());
        self
    }
}

pub(super) fn ordered(a: DVec3, b: DVec3) -> Vec<DVec3> {
    if by_place(&a, &b).is_gt() { vec![b, a] } else { vec![a, b] }
}

pub(super) fn by_place(a: &DVec3, b: &DVec3) -> std::cmp::Ordering {
    a.x.total_cmp(&b.x).then(a.y.total_cmp(&b.y)).then(a.z.total_cmp(&b.z))
}
