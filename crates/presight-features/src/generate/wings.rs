//! Classifies a line by the cross-section of its surroundings. *Wings* are the directions in which surfaces leave the
//! line, and *sectors* are the parts of space between them.
//!
//! A sector that is not flat shows an edge to sensors inside it. A flat sector shows an edge only if its two wings
//! differ in material. Windings do not matter, duplicate faces make one wing, and a face along a part of the line (a
//! T-junction) is a wing along that part.

use super::FeatureKind;
use super::effort::{Effort, EffortAllowance, steps};
use super::line::{Line, boxes_along};
use super::soup::{Soup, clip, grown, sides};
use glam::DVec3;
use presight_model::error::Result;
use presight_model::index::QueryResult;
use std::f64::consts::{PI, TAU};

/// Wings within this angle are joined, radians.
const SAME_WING: f64 = 3.0 * PI / 180.0;
/// Sectors narrower than this show no edge, radians.
const NARROW: f64 = 5.0 * PI / 180.0;
/// A face lies along a line if the sine of their angle is below this. Steeper faces pierce it.
const ALONG: f64 = 0.05;

/// The surfaces in one direction.
#[derive(Clone, Debug, Default)]
pub(super) struct Wing {
    pub angle: f64,
    /// Sorted, without duplicates.
    pub materials: Vec<u16>,
}

/// Joins the angles and materials of faces around a line into wings, sorted by angle.
pub(super) fn join(wings: &mut Vec<(f64, u16)>) -> Vec<Wing> {
    wings.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
    let mut joined: Vec<Wing> = Vec::new();
    let mut last = f64::NEG_INFINITY;
    for (angle, material) in wings.drain(..) {
        if angle - last > SAME_WING {
            joined.push(Wing { angle, materials: Vec::new() });
        }
        last = angle;
        if let Some(wing) = joined.last_mut() {
            wing.materials.push(material);
        }
    }
    // Join across the seam of the angles.
    if joined.len() > 1 && joined[0].angle + TAU - last <= SAME_WING {
        let over = joined.pop().unwrap_or_default();
        joined[0].materials.extend(over.materials);
    }
    for wing in &mut joined {
        wing.materials.sort_unstable();
        wing.materials.dedup();
    }
    joined
}

/// The sectors between wings: centre, span, and whether the materials of the two wings differ.
pub(super) fn sectors(wings: &[Wing]) -> impl Iterator<Item = (f64, f64, bool)> + '_ {
    (0..wings.len()).map(|k| {
        let (a, b) = (&wings[k], &wings[(k + 1) % wings.len()]);
        let span = if wings.len() == 1 { TAU } else { (b.angle - a.angle).rem_euclid(TAU) };
        (a.angle + 0.5 * span, span, a.materials != b.materials)
    })
}

/// Returns true if a sector shows a crease.
pub(super) fn creased(span: f64, crease: f64) -> bool {
    span >= NARROW && (span - PI).abs() >= crease - 1e-6
}

/// Classifies lines by their surroundings.
pub(super) struct EdgeClassifier<'a> {
    pub soup: &'a Soup,
    pub effort: &'a Effort<'a>,
    pub solids: &'a super::solids::Solids,
    /// Maximum distance between touching parts, metres.
    pub touch: f64,
    /// Minimum deviation from flat, radians.
    pub crease: f64,
}

/// Memory reused from line to line.
#[derive(Debug, Default)]
pub(super) struct Scratch {
    pub found: QueryResult,
    faces: Vec<NearbyFace>,
    /// Faces that span the current position.
    along: Vec<NearbyFace>,
    cuts: Vec<f64>,
    wings: Vec<(f64, u16)>,
}

/// A face along a part of the line.
#[derive(Clone, Copy, Debug)]
struct NearbyFace {
    face: u32,
    from: f64,
    to: f64,
}

/// Classification of a part of a line.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum EdgeClass {
    Shows(FeatureKind),
    /// Smooth, or a seam between flush surfaces.
    Flat,
    /// Inside a solid.
    Buried,
}

impl EdgeClassifier<'_> {
    /// Splits a line where its surroundings change and appends the class of each part, in order. Neighbours differ.
    ///
    /// # Errors
    /// The errors of [`EffortAllowance::spend`].
    pub fn judge(&self, line: &Line, scratch: &mut Scratch, parts: &mut Vec<(f64, f64, EdgeClass)>) -> Result<()> {
        let (d, length) = (line.direction(), line.length());
        let mut thing = self.effort.allowance(line.object);
        self.gather(line, d, length, scratch, &mut thing)?;
        let Scratch { found, faces, along, cuts, wings } = scratch;
        cuts.sort_by(f64::total_cmp);
        faces.sort_by(|a, b| a.from.total_cmp(&b.from));
        along.clear();
        let mut next = 0;
        let u = d.any_orthonormal_vector();
        let v = d.cross(u);
        let mut from = 0.0;
        let mut done: Option<(f64, f64, EdgeClass)> = None;
        for k in 0..cuts.len() {
            let to = cuts[k];
            // Skip cuts too close to the previous one or to an end.
            if to - from < 3.0 * self.touch && to < length {
                continue;
            }
            let middle = 0.5 * (from + to);
            let p = line.start + d * middle;
            wings.clear();
            let begun = faces[next..].iter().take_while(|n| n.from <= middle).count();
            along.extend_from_slice(&faces[next..next + begun]);
            next += begun;
            along.retain(|n| middle <= n.to);
            thing.spend(steps::WINGS * along.len(), || p)?;
            for near in along.iter() {
                self.wings_of(near.face, p, d, u, v, wings);
            }
            let verdict = self.verdict(line.kind, &join(wings), |angle| {
                let beside = p + (u * angle.cos() + v * angle.sin()) * (4.0 * self.touch);
                self.solids.hold(self.soup, beside, found, |steps| thing.spend(steps, || p))
            })?;
            match &mut done {
                Some(last) if last.2 == verdict => last.1 = to,
                _ => parts.extend(done.replace((from, to, verdict))),
            }
            from = to;
        }
        parts.extend(done);
        Ok(())
    }

    /// Finds the faces along the line, and the positions where a face starts, ends or pierces it.
    fn gather(
        &self,
        line: &Line,
        d: DVec3,
        length: f64,
        scratch: &mut Scratch,
        thing: &mut EffortAllowance<'_>,
    ) -> Result<()> {
        let touch = self.touch;
        scratch.faces.clear();
        scratch.cuts.clear();
        scratch.cuts.push(length);
        let near = self.soup.near_any(boxes_along(line, 2.0 * touch), &mut scratch.found);
        thing.spend(steps::WINGS * near.len(), || line.start + d * (0.5 * length))?;
        for &face in near {
            let f = &self.soup.faces[face as usize];
            let (off, rate) = (f.plane.normal.dot(line.start) - f.plane.offset, f.plane.normal.dot(d));
            let mut range = clip(clip((0.0, length), touch - off, -rate), touch + off, rate);
            // Sharp corners of slivers would extend the range far beyond the face, so it is clipped to the box.
            let b = grown(&f.bounds, touch);
            for axis in 0..3 {
                range = clip(range, line.start[axis] - b.min[axis], d[axis]);
                range = clip(range, b.max[axis] - line.start[axis], -d[axis]);
            }
            for (corner, inward) in sides(self.soup.corners(face), f.plane.normal) {
                range = clip(range, inward.dot(line.start - corner) + touch, inward.dot(d));
            }
            let (from, to) = range;
            if from > to {
                continue;
            }
            if rate.abs() > ALONG {
                scratch.cuts.push(0.5 * (from + to));
            } else if to - from > 4.0 * touch {
                scratch.faces.push(NearbyFace { face, from, to });
                // The range exceeds the face by the tolerance at both ends.
                scratch.cuts.extend([from + touch, to - touch]);
            }
        }
        scratch.cuts.retain(|t| *t > 3.0 * touch && (*t < length - 3.0 * touch || *t == length));
        Ok(())
    }

    /// Adds the directions in which a face leaves the line at `p`.
    fn wings_of(&self, face: u32, p: DVec3, d: DVec3, u: DVec3, v: DVec3, wings: &mut Vec<(f64, u16)>) {
        let f = &self.soup.faces[face as usize];
        let Some(w) = f.plane.normal.cross(d).try_normalize() else { return };
        let mut range = (f64::NEG_INFINITY, f64::INFINITY);
        for (corner, inward) in sides(self.soup.corners(face), f.plane.normal) {
            range = clip(range, inward.dot(p - corner) + self.touch, inward.dot(w));
        }
        let angle = w.dot(v).atan2(w.dot(u));
        if range.1 > 3.0 * self.touch {
            wings.push((angle, f.material));
        }
        if range.0 < -3.0 * self.touch {
            wings.push((if angle > 0.0 { angle - PI } else { angle + PI }, f.material));
        }
    }

    fn verdict(
        &self,
        kind: FeatureKind,
        wings: &[Wing],
        mut solid: impl FnMut(f64) -> Result<bool>,
    ) -> Result<EdgeClass> {
        let mut buried = !wings.is_empty();
        let mut material = false;
        // The widest sector is usually outside of solids, so it comes first.
        let mut all: Vec<_> = sectors(wings).collect();
        all.sort_by(|a, b| b.1.total_cmp(&a.1));
        for (middle, span, differ) in all {
            let crease = creased(span, self.crease);
            let seam = span >= NARROW && differ;
            if !crease && !seam {
                buried &= span < NARROW;
                continue;
            }
            if solid(middle)? {
                continue;
            }
            if crease {
                return Ok(EdgeClass::Shows(match (kind, wings.len()) {
                    (FeatureKind::Intersection, _) => FeatureKind::Intersection,
                    (_, 1) => FeatureKind::Border,
                    _ => FeatureKind::Crease,
                }));
            }
            (material, buried) = (true, false);
        }
        Ok(match (material, buried) {
            (true, _) => EdgeClass::Shows(FeatureKind::Material),
            (_, true) => EdgeClass::Buried,
            _ => EdgeClass::Flat,
        })
    }
}
