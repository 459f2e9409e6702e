//! Vertical and horizontal planar patches: coplanar polygons of an object, joined if their union is convex.

use super::FeatureKind;
use super::drafts::Draft;
use super::effort::{Effort, steps};
use super::soup::Soup;
use glam::{DVec2, DVec3};
use presight_model::error::Result;
use presight_model::geometry::{Aabb, Plane, plane_of_polygon};
use presight_model::index::QueryResult;
use presight_model::limits;
use std::collections::BTreeMap;

/// A convex patch in the world.
#[derive(Clone, Debug)]
pub(super) struct Patch {
    pub corners: Vec<DVec3>,
    pub object: u32,
    pub kind: FeatureKind,
    pub normal: DVec3,
}

impl From<Patch> for Draft {
    fn from(p: Patch) -> Self {
        Self { normal: Some(p.normal), ..Self::new(p.kind, p.object, p.corners) }
    }
}

/// Maximum distance of a part's corners from the plane of its patch, metres.
const PART: f64 = 1e-3;

/// A convex piece of a plane, counter-clockwise in the plane's coordinates.
#[derive(Clone, Debug)]
struct Piece {
    corners: Vec<DVec2>,
    area: f64,
    low: DVec2,
    high: DVec2,
}

/// All patches of at least `least` m^2 whose planes are vertical or horizontal within `tilt` (radians). Duplicate faces
/// give one patch. Objects for which `skips` is true have none.
pub(super) fn patches(
    soup: &Soup,
    skips: impl Fn(u32) -> bool,
    tilt: f64,
    least: f64,
    touch: f64,
    effort: &Effort<'_>,
) -> Result<Vec<Patch>> {
    let mut planes: BTreeMap<(u32, bool), Vec<(Plane, u32)>> = BTreeMap::new();
    for (i, f) in soup.faces.iter().enumerate() {
        let up = f.plane.normal.z.abs();
        let horizontal = up >= tilt.cos();
        if (horizontal || up <= tilt.sin()) && !skips(f.object) {
            planes.entry((f.object, horizontal)).or_default().push((f.plane, i as u32));
        }
    }
    let mut all = Vec::new();
    let stage = effort.stage("planes", planes.len());
    for ((object, horizontal), faces) in planes {
        stage.step();
        let kind = if horizontal { FeatureKind::Horizontal } else { FeatureKind::Vertical };
        for (plane, faces) in coplanar(soup, faces, touch, effort)? {
            let patch = |corners| Patch { corners, object, kind, normal: plane.normal };
            all.extend(of_plane(soup, plane.normal, &faces, touch, least, effort)?.into_iter().map(patch));
        }
    }
    Ok(all)
}

/// Corners of the patches formed by the faces of one plane.
fn of_plane(
    soup: &Soup,
    normal: DVec3,
    faces: &[u32],
    touch: f64,
    least: f64,
    effort: &Effort<'_>,
) -> Result<Vec<Vec<DVec3>>> {
    let Some(first) = faces.first() else { return Ok(Vec::new()) };
    let (u, v) = normal.any_orthonormal_pair();
    let origin = soup.corners(*first)[0];
    let flat = |p: DVec3| DVec2::new((p - origin).dot(u), (p - origin).dot(v));
    let pieces = faces.iter().filter_map(|&f| Piece::around(soup.corners(f).iter().map(|p| flat(*p)).collect()));
    let object = soup.faces[*first as usize].object;
    let place = |at: DVec2| origin + u * at.x + v * at.y;
    let begin = |again| {
        let mut thing = if again { effort.allowance(object).again() } else { effort.allowance(object) };
        move |steps: usize, at: DVec2| thing.spend(steps, || place(at))
    };
    let large = joined(pieces.collect(), touch, begin)?.into_iter().filter(|p| p.area >= least);
    Ok(large.map(|piece| piece.corners.iter().map(|c| place(*c)).collect()).collect())
}

/// Splits a patch into its faces and joins them again with a tolerance of 0.
pub(super) fn parts(
    soup: &Soup,
    whole: &Draft,
    least: f64,
    found: &mut QueryResult,
    effort: &Effort<'_>,
) -> Result<Vec<Patch>> {
    let (Some(plane), Some(normal)) = (plane_of_polygon(&whole.points), whole.normal) else { return Ok(Vec::new()) };
    let bounds = Aabb::of(whole.points.iter().copied());
    let inside = |p: DVec3| {
        let sides = super::soup::sides(&whole.points, plane.normal);
        sides.into_iter().all(|(corner, inward)| inward.dot(p - corner) >= 0.0)
    };
    let belongs = |face: &u32| {
        let corners = soup.corners(*face);
        let middle = corners.iter().sum::<DVec3>() / corners.len() as f64;
        let flat = |c: &DVec3| plane.normal.dot(*c - whole.points[0]).abs() <= PART;
        soup.faces[*face as usize].object == whole.object && corners.iter().all(flat) && inside(middle)
    };
    let faces: Vec<u32> = soup.near(&bounds, found).iter().copied().filter(belongs).collect();
    let patch = |corners| Patch { corners, object: whole.object, kind: whole.kind, normal };
    Ok(of_plane(soup, normal, &faces, 0.0, least, effort)?.into_iter().map(patch).collect())
}

/// Groups faces by plane, in either winding. A group has the plane of its first face.
fn coplanar(soup: &Soup, faces: Vec<(Plane, u32)>, touch: f64, effort: &Effort<'_>) -> Result<Vec<(Plane, Vec<u32>)>> {
    // Faces are binned by rounded normal. Faces of one plane in different bins are not merged, which is harmless.
    let mut groups: Vec<(Plane, Vec<u32>)> = Vec::new();
    let mut cells: BTreeMap<[i64; 3], Vec<usize>> = BTreeMap::new();
    for (plane, face) in faces {
        let n = plane.normal;
        let flip = [n.z, n.y, n.x].into_iter().find(|c| c.abs() > 1e-6).is_some_and(|c| c < 0.0);
        let side = if flip { -n } else { n };
        let cell = (side * 64.0).round().to_array().map(|c| c as i64);
        let known = cells.entry(cell).or_default();
        let mut tried = 0;
        let fits = |g: &&usize| {
            tried += 1;
            let p = &groups[**g].0;
            soup.corners(face).iter().all(|c| (p.normal.dot(*c) - p.offset).abs() <= touch)
                && p.normal.dot(n).abs() > 0.999_99
        };
        let group = known.iter().find(fits).copied();
        effort.allowance(soup.faces[face as usize].object).spend(tried, || soup.corners(face)[0])?;
        match group {
            Some(g) => groups[g].1.push(face),
            None => {
                known.push(groups.len());
                groups.push((plane, vec![face]));
            }
        }
    }
    Ok(groups)
}

impl Piece {
    /// The convex hull of points; `None` without area.
    fn around(mut points: Vec<DVec2>) -> Option<Self> {
        points.sort_by(|a, b| a.x.total_cmp(&b.x).then(a.y.total_cmp(&b.y)));
        points.dedup();
        let mut hull: Vec<DVec2> = Vec::with_capacity(points.len() + 1);
        // Andrew's monotone chain: lower hull, then upper hull.
        for pass in 0..2 {
            let base = hull.len();
            let mut add = |p: DVec2| {
                while hull.len() >= base + 2 && turns_right(hull[hull.len() - 2], hull[hull.len() - 1], p) {
                    hull.pop();
                }
                hull.push(p);
            };
            if pass == 0 {
                points.iter().for_each(|p| add(*p))
            } else {
                points.iter().rev().for_each(|p| add(*p))
            }
            hull.pop();
        }
        let area = 0.5 * (0..hull.len()).map(|k| hull[k].perp_dot(hull[(k + 1) % hull.len()])).sum::<f64>();
        let (low, high) = hull.iter().fold((DVec2::INFINITY, DVec2::NEG_INFINITY), |(l, h), p| (l.min(*p), h.max(*p)));
        (hull.len() >= 3 && area > 0.0).then_some(Self { corners: hull, area, low, high })
    }

    fn is_apart(&self, other: &Self, touch: f64) -> bool {
        self.low.cmpgt(other.high + touch).any() || other.low.cmpgt(self.high + touch).any()
    }

    /// The union with another piece, if it is convex or one piece contains the other.
    fn with(&self, other: &Self, touch: f64) -> Option<Self> {
        if self.is_apart(other, touch) {
            return None;
        }
        let hull = Self::around(self.corners.iter().chain(&other.corners).copied().collect())?;
        // Rounding of vertices may add a strip along the perimeter.
        let slack = 1e-6 * hull.area + 0.05 * touch * (hull.high - hull.low).length();
        let fits = hull.area <= self.area + other.area + slack || hull.area <= self.area.max(other.area) + slack;
        // Two partly overlapping pieces may match the area of their hull and still leave a gap.
        let overlapping = self.area + other.area > hull.area + slack && hull.area > self.area.max(other.area) + slack;
        (fits && !overlapping && hull.corners.len() <= limits::MAX_CORNERS).then_some(hull)
    }
}

/// Returns true unless the path a, b, c turns left beyond rounding.
fn turns_right(a: DVec2, b: DVec2, c: DVec2) -> bool {
    let (ab, bc) = (b - a, c - b);
    ab.perp_dot(bc) <= 1e-7 * ab.length() * bc.length()
}

/// Joins pieces until no two have a convex union. Pieces are tried in order of their lower x. `begin` is called for
/// each piece, with true if it is tried again, and returns a function that counts steps.
fn joined<S: FnMut(usize, DVec2) -> Result<()>>(
    mut pieces: Vec<Piece>,
    touch: f64,
    begin: impl Fn(bool) -> S,
) -> Result<Vec<Piece>> {
    let mut again = false;
    loop {
        pieces.sort_by(|a, b| {
            a.low.x.total_cmp(&b.low.x).then(a.low.y.total_cmp(&b.low.y)).then(a.area.total_cmp(&b.area))
        });
        // Pieces joined to an earlier one.
        let mut gone = vec![false; pieces.len()];
        for i in 0..pieces.len() {
            if gone[i] {
                continue;
            }
            let mut spend = begin(again);
            for j in i + 1..pieces.len() {
                if pieces[j].low.x > pieces[i].high.x + touch {
                    break;
                }
                let apart = gone[j] || pieces[i].is_apart(&pieces[j], touch);
                spend(if apart { 1 } else { steps::HULL }, pieces[i].low)?;
                if !apart && let Some(union) = pieces[i].with(&pieces[j], touch) {
                    pieces[i] = union;
                    gone[j] = true;
                }
            }
        }
        if !gone.contains(&true) {
            return Ok(pieces);
        }
        again = true;
        let mut gone = gone.into_iter();
        pieces.retain(|_| gone.next() == Some(false));
    }
}
