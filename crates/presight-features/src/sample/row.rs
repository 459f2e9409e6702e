//! Samples a segment for a scanner of one row: cuts it with the cones above and below the row.

use super::{ON_CONE, Part, Piece, Sample, Sampler};
use crate::Reason;
use glam::DVec3;

impl Sampler<'_> {
    /// Visits the parts of a segment inside and outside the two cones.
    pub(super) fn cut(&self, [low, high]: [f64; 2], a: DVec3, b: DVec3, visit: &mut impl FnMut(Part)) {
        let at = |t: f64| a + t * (b - a);
        let elevation = |p: DVec3| p.z.atan2(p.x.hypot(p.y));
        let within = |p: DVec3| (low - ON_CONE..=high + ON_CONE).contains(&elevation(p));
        let mut places = crossings(a, b, low);
        if high > low {
            places.extend(crossings(a, b, high));
        }
        places.retain(|t| *t > 0.0 && *t < 1.0);
        places.sort_by(f64::total_cmp);
        places.dedup();
        let mut from = 0.0;
        for to in places.iter().copied().chain([1.0]) {
            if within(at(0.5 * (from + to))) {
                self.arc(at(from), at(to), [from, to], visit);
            } else {
                visit(Part::One(Piece::Outside { t: [from, to], reason: Reason::OutsideImage }));
                // A row without height sees only the crossing points.
                if to < 1.0 && low == high {
                    let t = [to, to];
                    visit(Part::One(match self.point(at(to)) {
                        Piece::Inside(sample) => Piece::Inside(Sample { t, ..sample }),
                        Piece::Outside { reason, .. } => Piece::Outside { t, reason },
                    }));
                }
            }
            from = to;
        }
    }
}

/// The parameters t at which a segment crosses the cone of an elevation.
fn crossings(a: DVec3, b: DVec3, elevation: f64) -> Vec<f64> {
    let d = b - a;
    let tan = elevation.tan();
    if tan == 0.0 {
        return if d.z == 0.0 { Vec::new() } else { vec![-a.z / d.z] };
    }
    // z^2 = tan^2 (x^2 + y^2), for z of the same sign as the tangent.
    let square = |p: DVec3, q: DVec3| p.z * q.z - tan * tan * (p.x * q.x + p.y * q.y);
    let (qa, qb, qc) = (square(d, d), square(a, d), square(a, a));
    let mut roots = Vec::new();
    let discriminant = qb * qb - qa * qc;
    if discriminant < 0.0 {
        return roots;
    }
    let q = -(qb + qb.signum() * discriminant.sqrt());
    roots.extend([q / qa, qc / q].into_iter().filter(|t| t.is_finite()));
    roots.retain(|t| (a.z + t * d.z) * tan >= 0.0);
    roots
}
