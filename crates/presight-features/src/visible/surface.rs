//! The polygons a feature lies on, and reasons other than occlusion for not seeing it.

use super::VisibilityContext;
use super::context::InImage;
use super::polygon::PolygonCache;
use crate::{PlacedFeature, Reason};
use glam::DVec3;
use presight_model::environment::FeatureShape;
use presight_model::geometry::plane_of_polygon;

pub(super) struct FeatureSurface<'a> {
    slots: &'a [u32],
    /// Normals of its polygons that may be seen, image frame.
    normals: Vec<DVec3>,
    /// Normal of a landmark, which is seen only from the front.
    front: Option<DVec3>,
    /// A reason that hides all of the feature.
    reason: Option<Reason>,
    /// Bound of the rounding errors of its points, metres.
    rounding: f64,
}

impl<'a> FeatureSurface<'a> {
    /// The surface of a feature, with the slots of polygons that do not hide it and its points in the image frame.
    pub fn new(
        frame: &VisibilityContext<'_>,
        polygons: &mut PolygonCache,
        placed: &PlacedFeature,
        slots: &'a [u32],
        in_image: &InImage,
    ) -> Self {
        let InImage { points, image_from_object, rounding } = in_image;
        let mut normals = Vec::new();
        let reason = lies_on(frame, polygons, slots, |normal| normals.push(normal));
        let landmark = matches!(placed.feature.shape, FeatureShape::Reflector { .. } | FeatureShape::Fiducial { .. });
        let given = placed.feature.properties.normal.and_then(|n| (*image_from_object * n).try_normalize());
        // Corners are clockwise seen from the front, so the right-hand normal points to the back.
        let of_outline = (points.len() > 2).then(|| plane_of_polygon(points)).flatten().map(|p| p.normal);
        let fiducial = matches!(placed.feature.shape, FeatureShape::Fiducial { .. });
        let front = given.or(of_outline.filter(|_| fiducial).map(|n| -n)).filter(|_| landmark);
        normals.extend(front);
        if normals.is_empty() && reason != Some(Reason::FacingAway) {
            normals.extend(given.or(of_outline));
        }
        FeatureSurface { slots, normals, front, reason, rounding: *rounding }
    }

    /// The surface of a piece of a silhouette; no angle of incidence applies at the end of a surface.
    pub fn of_silhouette(
        frame: &VisibilityContext<'_>,
        polygons: &mut PolygonCache,
        slots: &'a [u32],
        rounding: f64,
    ) -> Self {
        let reason = lies_on(frame, polygons, slots, |_| ());
        FeatureSurface { slots, normals: Vec::new(), front: None, reason, rounding }
    }

    /// Returns true if only occlusion can hide it, apart from the limits of range and incidence.
    pub fn is_plain(&self) -> bool {
        self.reason.is_none() && self.front.is_none()
    }

    /// Bound of the rounding errors of its points, metres.
    pub fn rounding(&self) -> f64 {
        self.rounding
    }

    /// Returns true if it lies on the polygon in this slot.
    pub fn holds(&self, slot: u32) -> bool {
        self.slots.contains(&slot)
    }

    /// The cosine of incidence on its surface that faces the ray most directly.
    pub fn cosine(&self, ray: DVec3) -> Option<f64> {
        self.normals.iter().map(|n| n.dot(ray).abs().min(1.0)).reduce(f64::max)
    }

    /// The first reason other than occlusion for not seeing a place on it.
    #[inline]
    pub fn before_occlusion(&self, frame: &VisibilityContext<'_>, at: DVec3, range: f64) -> Option<Reason> {
        let spec = frame.sensor.spec();
        if range < spec.range_min {
            return Some(Reason::BelowRangeMin);
        }
        if range > spec.range_max {
            return Some(Reason::BeyondRangeMax);
        }
        if !(range > 0.0) {
            return Some(Reason::Undecided);
        }
        if self.reason.is_some() {
            return self.reason;
        }
        if self.front.is_some_and(|n| !(n.dot(at) < 0.0)) {
            return Some(Reason::FacingAway);
        }
        let flat = |most: f64| self.cosine(at / range).is_some_and(|cosine| cosine < most.cos());
        spec.max_incidence.is_some_and(flat).then_some(Reason::Oblique)
    }
}

/// The reason why nothing on these polygons is seen, even without occlusion. Visits the normals of the visible ones.
fn lies_on(
    frame: &VisibilityContext<'_>,
    polygons: &mut PolygonCache,
    slots: &[u32],
    mut visit: impl FnMut(DVec3),
) -> Option<Reason> {
    let (mut there, mut away) = (0, 0);
    for slot in slots {
        let Some(number) = polygons.of_slot(frame, *slot) else { continue };
        let known = polygons.get(number);
        if frame.invisible[usize::from(known.material)] {
            continue;
        }
        there += 1;
        if frame.facings[usize::from(known.material)].one_sided && !known.faces_sensor {
            away += 1;
        } else {
            visit(known.normal);
        }
    }
    match (slots.len(), there) {
        (0, _) => None,
        (_, 0) => Some(Reason::Material),
        _ if there == away => Some(Reason::FacingAway),
        _ => None,
    }
}
