//! The material points that a feature's box must hold: those visible at the nominal pose.
//!
//! In a pinhole image a line stays straight under all errors, so its ends remain its extremes. The image of a planar
//! patch is the convex hull of its corners. In other images lines curve, so points in between are added.

use super::image::{Image, Kind};
use super::outermost;
use crate::roi::{BodyPoint, FeatureErrorModel, Projection, Viewpoint};
use crate::{MAX_PATCH_SAMPLES, SeenFeature};
use glam::{DVec2, DVec3};
use presight_model::environment::FeatureShape;
use presight_model::geometry::plane_of_polygon;

/// Number of points on a segment's visible part, if the curvature of lines is unknown.
const POINTS: usize = 9;

/// A point with a smaller cosine of its elevation is steep; its segment gets points along its whole length.
const STEEP: f64 = 0.5;

/// Number of parts of an outline's edge.
const PARTS: usize = 8;

/// Maximum sagitta of a line that is treated as straight, pixels.
const SAGITTA: f64 = 1.0 / 32.0;

/// The defining points of a feature; a contour has none.
pub(super) fn defining(shape: &FeatureShape, into: &mut Vec<BodyPoint>) {
    into.clear();
    match shape {
        FeatureShape::Segment { ends, .. } => into.extend([0.0, 1.0].map(|t| BodyPoint::on_segment(ends, t))),
        FeatureShape::Contour { .. } => {}
        other => into.extend(other.points().iter().map(|p| BodyPoint::rigid(*p))),
    }
}

/// The points that a feature's box must hold.
pub(super) fn seen(
    image: &Image<'_>,
    viewpoint: &Viewpoint,
    uncertain: &FeatureErrorModel,
    seen: &SeenFeature,
    into: &mut Vec<BodyPoint>,
) {
    into.clear();
    let shape = &seen.feature.shape;
    match shape {
        FeatureShape::Segment { ends, .. } => {
            let from = seen.visible.iter().map(|v| v.t[0]).fold(1.0, f64::min);
            let to = seen.visible.iter().map(|v| v.t[1]).fold(0.0, f64::max);
            segment(image, uncertain, ends, [from, to], into);
        }
        FeatureShape::Patch { corners, .. } => patch(image, uncertain, corners, seen, into),
        FeatureShape::Fiducial { corners, .. } => patch(image, uncertain, corners, seen, into),
        FeatureShape::Point { at, .. } | FeatureShape::Reflector { at, .. } => into.push(BodyPoint::rigid(*at)),
        FeatureShape::Contour { .. } => curve(image, viewpoint, uncertain, seen, into),
    }
}

/// Adds points along the visible pieces of a curve, which moves rigidly with its surface.
fn curve(
    image: &Image<'_>,
    viewpoint: &Viewpoint,
    uncertain: &FeatureErrorModel,
    seen: &SeenFeature,
    into: &mut Vec<BodyPoint>,
) {
    for [a, b] in seen.visible.iter().flat_map(|v| seen.along(v.t)) {
        let ends = [a, b].map(|p| uncertain.in_frame(viewpoint.in_body(p)));
        line(image, uncertain, |t| BodyPoint::rigid(ends[0].lerp(ends[1], t)), [0.0, 1.0], into);
    }
    outermost::keep(image, uncertain, into);
}

fn segment(
    image: &Image<'_>,
    uncertain: &FeatureErrorModel,
    ends: &[DVec3; 2],
    between: [f64; 2],
    into: &mut Vec<BodyPoint>,
) {
    line(image, uncertain, |t| BodyPoint::on_segment(ends, t), between, into);
}

fn line(
    image: &Image<'_>,
    uncertain: &FeatureErrorModel,
    point: impl Fn(f64) -> BodyPoint,
    [from, to]: [f64; 2],
    into: &mut Vec<BodyPoint>,
) {
    let mut put = |t: f64| into.push(point(t));
    put(from);
    match image.kind {
        Kind::Pinhole(_) => {}
        Kind::Beams([_, rows]) => {
            let [a, b] = [from, to].map(|t| uncertain.nominal(&point(t)).p);
            // Near a pole the columns change quickly along the line.
            let turns = |p: DVec3| p.x.hypot(p.y) < STEEP * p.length();
            // The sagitta of a great circle is at most an eighth of the squared angle between its ends.
            if turns(a) || turns(b) {
                (1..POINTS - 1).for_each(|i| put(from + (to - from) * i as f64 / (POINTS - 1) as f64));
            } else if a.angle_between(b).powi(2) / 8.0 * rows.abs() > SAGITTA {
                [0.25, 0.5, 0.75].into_iter().for_each(|s| put(from + s * (to - from)));
                if let Some(t) = image.culmination_share(a, b) {
                    put(from + t * (to - from));
                }
            }
        }
        _ => (1..POINTS - 1).for_each(|i| put(from + (to - from) * i as f64 / (POINTS - 1) as f64)),
    }
    put(to);
}

fn patch(
    image: &Image<'_>,
    uncertain: &FeatureErrorModel,
    corners: &[DVec3],
    seen: &SeenFeature,
    into: &mut Vec<BodyPoint>,
) {
    let [visible] = seen.visible.as_slice() else { return };
    let one = [visible.pixels];
    let windows = if seen.windows.is_empty() { &one[..] } else { &seen.windows[..] };
    let windows: Vec<PatchWindow> = windows.iter().map(|seen| PatchWindow::of(image, *seen)).collect();
    // Parts outside the image are not listed as hidden, so all of a patch is visible only if its corners are in the
    // image.
    let (w, h) = image.size();
    let inside_image = |corner: &DVec3| {
        let at = image.project(uncertain.nominal(&BodyPoint::rigid(*corner)).p);
        let within = |x: f64, size: u32| (-0.5..=f64::from(size) - 0.5).contains(&x);
        at.is_some_and(|[u, v]| within(u, w) && within(v, h))
    };
    let whole = seen.hidden.is_empty() && corners.iter().all(inside_image);
    let holds = |p: DVec3| match image.project(uncertain.nominal(&BodyPoint::rigid(p)).p) {
        Some(at) => whole || windows.iter().any(|window| window.holds(at)),
        None => false,
    };
    let straight = matches!(image.kind, Kind::Pinhole(_));
    let parts = if straight && whole { 1 } else { PARTS };
    // In a scanner's image, a straight edge is highest or lowest where it is nearest to the axis.
    let in_body = |p: &DVec3| uncertain.nominal(&BodyPoint::rigid(*p)).p;
    for (k, a) in corners.iter().enumerate() {
        let b = corners[(k + 1) % corners.len()];
        let mut before = (*a, holds(*a));
        let steps = (1..=parts).map(|i| i as f64 / parts as f64);
        let highest = image.culmination_share(in_body(a), in_body(&b));
        let mut stops: Vec<f64> = steps.chain(highest).collect();
        stops.sort_unstable_by(f64::total_cmp);
        for t in stops {
            let p = a.lerp(b, t);
            let here = (p, holds(p));
            if before.1 {
                into.push(BodyPoint::rigid(before.0));
            }
            if before.1 != here.1 {
                let (inside, outside) = if before.1 { (before.0, p) } else { (p, before.0) };
                into.push(BodyPoint::rigid(crossing(inside, outside, &holds)));
            }
            before = here;
        }
    }
    if !(straight && whole) {
        inside(image, uncertain, corners, if whole { &[][..] } else { &windows[..] }, into);
        outermost::keep(image, uncertain, into);
    }
    if into.is_empty() {
        // A patch seen edge-on: use the corners that have an image.
        into.extend(
            corners.iter().map(|p| BodyPoint::rigid(*p)).filter(|p| image.project(uncertain.nominal(p).p).is_some()),
        );
    }
}

/// Finds the last point that is held, between a point that is and one that is not.
fn crossing(mut inside: DVec3, mut outside: DVec3, holds: &impl Fn(DVec3) -> bool) -> DVec3 {
    for _ in 0..30 {
        let middle = 0.5 * (inside + outside);
        if holds(middle) { inside = middle } else { outside = middle }
    }
    inside
}

/// Adds points that are not on the outline of a patch: on the border of the visible part, and on a scanner's axis. A
/// patch around the axis has no outermost points in the image.
fn inside(
    image: &Image<'_>,
    uncertain: &FeatureErrorModel,
    corners: &[DVec3],
    windows: &[PatchWindow],
    into: &mut Vec<BodyPoint>,
) {
    let in_body: Vec<DVec3> = corners.iter().map(|c| uncertain.nominal(&BodyPoint::rigid(*c)).p).collect();
    let Some(plane) = plane_of_polygon(&in_body) else { return };
    let sign = plane.offset.signum();
    let edge = |k: usize| sign * in_body[k].cross(in_body[(k + 1) % in_body.len()] - in_body[k]);
    let edges: Vec<DVec3> = (0..in_body.len()).map(edge).collect();
    let meet = |ray: DVec3| {
        let inverse = plane.normal.dot(ray) / plane.offset;
        let meets = inverse > 0.0 && edges.iter().all(|e| e.dot(ray) >= 0.0);
        meets.then(|| BodyPoint::rigid(uncertain.in_frame(ray / inverse)))
    };
    let body_from_image = image.image_from_body.transpose();
    let at = |pixel: DVec2| image.sensor.ray_at(pixel.x, pixel.y).and_then(|ray| meet(body_from_image * ray));
    let is_row = image.size().1 == 1;
    // Several windows get fewer points each.
    let parts = if windows.len() > 1 { 2 } else { PARTS };
    for window in windows {
        for (seen, beyond) in window.border(parts) {
            // In a one-row image, the outline crosses the row between any two points.
            let beyond = if is_row { DVec2::new(beyond.x, seen.y) } else { beyond };
            into.extend(at(beyond).or_else(|| if is_row { last_of(seen, beyond, at) } else { at(seen) }));
        }
    }
    if matches!(image.kind, Kind::Beams(_) | Kind::Scanner) {
        let shown = |axis: &DVec3| match image.project(body_from_image * *axis) {
            Some(at) => windows.is_empty() || windows.iter().any(|w| (w.low.y..=w.high.y).contains(&at[1])),
            None => true,
        };
        let axes = [DVec3::Z, DVec3::NEG_Z].into_iter().filter(shown);
        into.extend(axes.filter_map(|axis| meet(body_from_image * axis)));
    }
}

/// Returns the last hit between one pixel and another; `None` if the first is not a hit.
fn last_of(from: DVec2, to: DVec2, at: impl Fn(DVec2) -> Option<BodyPoint>) -> Option<BodyPoint> {
    let (mut inside, mut outside, mut last) = (from, to, at(from)?);
    for _ in 0..12 {
        let middle = 0.5 * (inside + outside);
        match at(middle) {
            Some(found) => (inside, last) = (middle, found),
            None => outside = middle,
        }
    }
    Some(last)
}

/// The part of the image in which a patch is visible.
#[derive(Clone, Copy)]
struct PatchWindow {
    low: DVec2,
    high: DVec2,
    /// Minimum and maximum coordinates of the visible pixels.
    seen: [DVec2; 2],
    turn: Option<f64>,
}

impl PatchWindow {
    /// Enlarges the visible pixels by one, since the next pixel is not visible. In curved images, samples of a thin
    /// patch may be farther apart: up to a step of the coarsest sampling grid.
    fn of(image: &Image<'_>, seen: [DVec2; 2]) -> Self {
        let (w, h) = image.size();
        let most = DVec2::new(f64::from(w), f64::from(h)) - 0.5;
        let step = match image.kind {
            Kind::Pinhole(_) => 1.0,
            _ => (f64::from(image.sensor.distinct_columns()) * f64::from(h) / MAX_PATCH_SAMPLES as f64).sqrt().max(1.0),
        };
        let (mut low, mut high) = (seen[0] - step, seen[1] + step);
        // The border limits the visible part. A full circle has no border at the sides.
        let turn = image.turn();
        (low.y, high.y) = (low.y.max(-0.5), high.y.min(most.y));
        if turn.is_none() {
            (low.x, high.x) = (low.x.max(-0.5), high.x.min(most.x));
        }
        Self { low, high, seen, turn }
    }

    /// Points around the visible pixels, each with the corresponding point on the window's border.
    fn border(&self, parts: usize) -> impl Iterator<Item = (DVec2, DVec2)> {
        let around = |low: DVec2, high: DVec2, share: f64| {
            let at = low + share * (high - low);
            [(at.x, low.y), (at.x, high.y), (low.x, at.y), (high.x, at.y)].map(DVec2::from)
        };
        let ([low, high], beyond) = (self.seen, [self.low, self.high]);
        (0..=parts).flat_map(move |i| {
            let share = i as f64 / parts as f64;
            around(low, high, share).into_iter().zip(around(beyond[0], beyond[1], share))
        })
    }

    fn holds(&self, [mut u, v]: [f64; 2]) -> bool {
        if let Some(turn) = self.turn {
            u -= turn * ((u - 0.5 * (self.low.x + self.high.x)) / turn).round();
        }
        u >= self.low.x && u <= self.high.x && v >= self.low.y && v <= self.high.y
    }
}
