//! The exact view of a pixel.

/// The truth at a pixel.
#[derive(Clone, Debug)]
pub(super) enum Truth {
    /// The sensor has no ray here.
    NoRay,
    /// Too near to the fold of a lens to decide whether there is a ray.
    Either,
    /// The geometry of each polygon along the ray.
    Ray(Vec<PolygonOnRay>),
}

/// One polygon along one ray.
#[derive(Clone, Debug)]
pub(super) struct PolygonOnRay {
    /// Angle of the ray inside the plane of each edge, radians; negative outside.
    pub margins: Vec<f64>,
    /// One over the range on the polygon's plane.
    pub inverse_range: f64,
    /// |cos| of the angle of incidence.
    pub cos_incidence: f64,
}
