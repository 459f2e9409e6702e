//! Polygons set up for tests against features' own rays, once for all samples that come near them.

use super::VisibilityContext;
use glam::DVec3;
use presight_render::reference::Face;
use presight_render::verify::{PlaneBound, Precision};

/// A polygon in the image frame, and how far off its plane may be.
pub(super) struct PreparedPolygon {
    pub slot: u32,
    pub material: u16,
    /// It covers rays: opaque, seen from this side, not edge-on.
    pub covers: bool,
    /// Unit normal, and whether the sensor is on its side.
    pub normal: DVec3,
    pub faces_sensor: bool,
    /// n / d: its product with a point is the point's range over that of the polygon on the same ray.
    pub inverse: DVec3,
    /// Error of that product, for a unit of the point's range, and for a unit of the product; infinite where nothing is
    /// known of the distance.
    off: [f64; 2],
    /// First edge plane and corner, and how many.
    edges: (u32, u32),
}

/// Is a polygon that covers a point's ray nearer than the point?
pub(super) enum RelativeDepth {
    Yes,
    No,
    /// Nothing is known about its range.
    Unknown,
}

/// The part of the straight way from p to q that lies within edge planes, as shares of the way, the lesser one first. `None` if there is none.
#[inline]
pub(super) fn within_edges(planes: &[DVec3], p: DVec3, q: DVec3) -> Option<[f64; 2]> {
    let (mut from, mut to) = (0.0f64, 1.0f64);
    for e in planes {
        let (f, g) = (e.dot(p), e.dot(q));
        if f < 0.0 && g < 0.0 {
            return None;
        }
        if f < 0.0 {
            from = from.max(f / (f - g));
        } else if g < 0.0 {
            to = to.min(f / (f - g));
        }
    }
    (from <= to).then_some([from, to])
}

impl PreparedPolygon {
    /// Is it nearer by more than rounding than a point at `range` that may itself be off by `rounding` metres? `share` is
    /// the product with [`PreparedPolygon::inverse`].
    ///
    /// With k = n . u / d one over the polygon's range, r the point's range and `off` the bound of k
    /// ([`crate::verify::Precision`]), k > 1 / r + off is `share` = r k > 1 + r off.
    #[inline]
    pub fn nearer(&self, share: f64, range: f64, rounding: f64) -> RelativeDepth {
        if !(share > 1.0 + rounding / range + 8.0 * f64::EPSILON) {
            return RelativeDepth::No;
        }
        let least = self.least_share(share, range, rounding);
        if share > least {
            RelativeDepth::Yes
        } else if least.is_finite() {
            RelativeDepth::No
        } else {
            RelativeDepth::Unknown
        }
    }

    /// True if nothing is known of its distance.
    pub fn is_unknown(&self) -> bool {
        self.off[0].is_infinite()
    }

    /// True if it is nearer than all points up to the range `far`, in its cone, of which none has a lesser share than `least`.
    pub fn hides_all(&self, least: f64, far: f64, rounding: f64) -> bool {
        // What is behind it is no nearer than its plane.
        let near = self.inverse.length().recip();
        let bound = [near, far].map(|range| self.least_share(least, range, rounding));
        least > bound[0].max(bound[1]) * (1.0 + 8.0 * f64::EPSILON)
    }

    /// The share above which it is.
    #[inline]
    pub fn least_share(&self, share: f64, range: f64, rounding: f64) -> f64 {
        1.0 + rounding / range + 8.0 * f64::EPSILON + self.off[0] * range + self.off[1] * share
    }
}

/// Polygons that were set up, by number and by slot.
pub(super) struct PolygonCache {
    /// By slot: number + 1. Pages that nothing touches cost nothing.
    at: Vec<u32>,
    known: Vec<PreparedPolygon>,
    planes: Vec<DVec3>,
    corners: Vec<DVec3>,
    face: Face,
}

impl PolygonCache {
    pub fn new(frame: &VisibilityContext<'_>) -> Self {
        let at = vec![0; frame.environment.slot_count() as usize];
        Self {
            at,
            known: Vec::with_capacity(256),
            planes: Vec::with_capacity(1024),
            corners: Vec::with_capacity(1024),
            face: Face::default(),
        }
    }

    /// Forgets all polygons, for another prediction.
    pub fn renew(&mut self, frame: &VisibilityContext<'_>) {
        let Self { at, known, planes, corners, .. } = self;
        known.iter().for_each(|known| at[known.slot as usize] = 0);
        at.resize(frame.environment.slot_count() as usize, 0);
        known.clear();
        planes.clear();
        corners.clear();
    }

    /// The polygon of a number.
    #[inline]
    pub fn get(&self, number: u32) -> &PreparedPolygon {
        &self.known[number as usize]
    }

    /// The number of the polygon of a slot; `None` if there is none.
    #[inline]
    pub fn of_slot(&mut self, frame: &VisibilityContext<'_>, slot: u32) -> Option<u32> {
        match self.at.get(slot as usize) {
            Some(0) => self.set_up(frame, slot),
            Some(at) => Some(at - 1),
            None => None,
        }
    }

    fn set_up(&mut self, frame: &VisibilityContext<'_>, slot: u32) -> Option<u32> {
        let (object, polygon) = frame.environment.locate(slot)?;
        let instance = frame.instance(object);
        let mesh = &frame.environment.objects()[object as usize].mesh;
        let face = &mut self.face;
        face.renew(instance, mesh, polygon);
        let bound = PlaneBound::new(face, instance.center_in_mesh, Precision::F64);
        let known = face.distance.abs() - bound.distance;
        let off = if known > 0.0 { [bound.cosine / known, bound.distance / known] } else { [f64::INFINITY; 2] };
        let material = mesh.material(polygon);
        let facing = frame.facings[usize::from(material)];
        let first = self.planes.len() as u32;
        self.planes.extend(face.edges.iter().map(|e| e.plane));
        self.corners.extend_from_slice(&face.corners);
        self.known.push(PreparedPolygon {
            slot,
            material,
            covers: facing.opaque && (!facing.one_sided || face.distance < 0.0) && !face.edge_on(),
            normal: face.normal,
            faces_sensor: face.distance < 0.0,
            inverse: face.normal / face.distance,
            off,
            edges: (first, face.edges.len() as u32),
        });
        self.at[slot as usize] = self.known.len() as u32;
        Some(self.known.len() as u32 - 1)
    }

    /// Planes through the sensor and the sides of a polygon: inside is where all products are >= 0.
    #[inline]
    pub fn planes_of(&self, known: &PreparedPolygon) -> &[DVec3] {
        let (first, count) = known.edges;
        &self.planes[first as usize..(first + count) as usize]
    }

    /// Corners, image frame.
    pub fn corners_of(&self, known: &PreparedPolygon) -> &[DVec3] {
        let (first, count) = known.edges;
        &self.corners[first as usize..(first + count) as usize]
    }

    /// True if a point's ray is in the polygon's cone.
    #[inline]
    pub fn holds(&self, known: &PreparedPolygon, at: DVec3) -> bool {
        self.planes_of(known).iter().all(|e| e.dot(at) >= 0.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// By hand: from (0, 1) to (2, 1), where x is at least half of y and at most one and a half of it.
    #[test]
    fn a_way_is_cut_at_edges() {
        let [p, q] = [DVec3::new(0.0, 1.0, 0.0), DVec3::new(2.0, 1.0, 0.0)];
        let (least, most) = (DVec3::new(1.0, -0.5, 0.0), DVec3::new(-1.0, 1.5, 0.0));
        assert_eq!(within_edges(&[least, most], p, q), Some([0.25, 0.75]));
        assert_eq!(within_edges(&[most, least], q, p), Some([0.25, 0.75]));
        assert_eq!(within_edges(&[least], p, q), Some([0.25, 1.0]));
        assert_eq!(within_edges(&[], p, q), Some([0.0, 1.0]));
        // Beside one edge, and between none of both: x at most half of y, at least one and a half of it.
        assert_eq!(within_edges(&[DVec3::NEG_Y], p, q), None);
        assert_eq!(within_edges(&[-least, -most], p, q), None);
    }
}
