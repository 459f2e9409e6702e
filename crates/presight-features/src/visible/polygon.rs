//! Polygons set up for tests against features' own rays; each is set up once for all samples.

use super::VisibilityContext;
use glam::DVec3;
use presight_render::reference::Face;
use presight_render::verify::{PlaneBound, Precision};

/// A polygon in the image frame, with error bounds of its plane.
pub(super) struct PreparedPolygon {
    pub slot: u32,
    pub material: u16,
    /// True if it covers rays: opaque, seen from this side, not edge-on.
    pub covers: bool,
    /// Unit normal; true in `faces_sensor` if the sensor is on its side.
    pub normal: DVec3,
    pub faces_sensor: bool,
    /// n / d. Its product with a point is the ratio of the point's range to the polygon's range on the same ray.
    pub inverse: DVec3,
    /// Error of that ratio per metre of the point's range, and per unit of the ratio; infinite if it is unknown.
    off: [f64; 2],
    /// First edge plane and corner, and their number.
    edges: (u32, u32),
}

/// The order of a polygon and a point on a ray that the polygon covers.
pub(super) enum RelativeDepth {
    Yes,
    No,
    /// The polygon's range is unknown.
    Unknown,
}

/// The part of the line from p to q inside all edge planes, as shares of the line, ascending. `None` if it is empty.
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
    /// Decides whether the polygon is nearer, by more than rounding, than a point at `range` that may be off by
    /// `rounding` metres. `share` is the point's product with [`PreparedPolygon::inverse`].
    ///
    /// Let k = n . u / d be the reciprocal of the polygon's range, r the range of the point and `off` the bound of k
    /// ([`presight_render::verify::Precision`]). Then k > 1 / r + off is the same as `share` = r k > 1 + r off.
    #[inline]
    pub fn nearer(&self, share: f64, range: f64, rounding: f64) -> RelativeDepth {
        if !(share > 1.0 + rounding / range + 8.0 * f64::EPSILON) {
            return RelativeDepth::No;
        }
        let least = self.min_share(share, range, rounding);
        if share > least {
            RelativeDepth::Yes
        } else if least.is_finite() {
            RelativeDepth::No
        } else {
            RelativeDepth::Unknown
        }
    }

    /// Returns true if the polygon's distance is unknown.
    pub fn is_unknown(&self) -> bool {
        self.off[0].is_infinite()
    }

    /// Returns true if it is nearer than all points in its cone with ranges up to `far` and shares of at least `least`.
    pub fn hides_all(&self, least: f64, far: f64, rounding: f64) -> bool {
        // No point behind the polygon is nearer than its plane.
        let near = self.inverse.length().recip();
        let bound = [near, far].map(|range| self.min_share(least, range, rounding));
        least > bound[0].max(bound[1]) * (1.0 + 8.0 * f64::EPSILON)
    }

    /// The share above which the polygon is nearer.
    #[inline]
    pub fn min_share(&self, share: f64, range: f64, rounding: f64) -> f64 {
        1.0 + rounding / range + 8.0 * f64::EPSILON + self.off[0] * range + self.off[1] * share
    }
}

/// Prepared polygons by number and by slot.
pub(super) struct PolygonCache {
    /// By slot: number + 1. Memory pages that are never touched use no memory.
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

    /// Removes all polygons, for another prediction.
    pub fn renew(&mut self, frame: &VisibilityContext<'_>) {
        let Self { at, known, planes, corners, .. } = self;
        known.iter().for_each(|known| at[known.slot as usize] = 0);
        at.resize(frame.environment.slot_count() as usize, 0);
        known.clear();
        planes.clear();
        corners.clear();
    }

    #[inline]
    pub fn get(&self, number: u32) -> &PreparedPolygon {
        &self.known[number as usize]
    }

    /// The number of the polygon in a slot; `None` if the slot is empty.
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

    /// Planes through the sensor and the polygon's sides. A ray is inside if all products are >= 0.
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

    /// Returns true if a point's ray is in the polygon's cone.
    #[inline]
    pub fn holds(&self, known: &PreparedPolygon, at: DVec3) -> bool {
        self.planes_of(known).iter().all(|e| e.dot(at) >= 0.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Expected by hand: the line runs from (0, 1) to (2, 1); the planes keep x from 0.5 y to 1.5 y.
    #[test]
    fn a_way_is_cut_at_edges() {
        let [p, q] = [DVec3::new(0.0, 1.0, 0.0), DVec3::new(2.0, 1.0, 0.0)];
        let (least, most) = (DVec3::new(1.0, -0.5, 0.0), DVec3::new(-1.0, 1.5, 0.0));
        assert_eq!(within_edges(&[least, most], p, q), Some([0.25, 0.75]));
        assert_eq!(within_edges(&[most, least], q, p), Some([0.25, 0.75]));
        assert_eq!(within_edges(&[least], p, q), Some([0.25, 1.0]));
        assert_eq!(within_edges(&[], p, q), Some([0.0, 1.0]));
        // Outside one edge; and outside two contradictory edges: x at most 0.5 y and at least 1.5 y.
        assert_eq!(within_edges(&[DVec3::NEG_Y], p, q), None);
        assert_eq!(within_edges(&[-least, -most], p, q), None);
    }
}
