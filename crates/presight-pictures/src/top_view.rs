//! Features over a scan of one row, seen from above.
//!
//! A patch is drawn where the row's rays meet it, because from above its outline would overlap itself. A region of
//! interest is an interval of the row, drawn as an arc at the feature's range.

use super::canvas::{Canvas, PageRect};
use super::overlay::Overlay;
use super::pen::{Pen, Style};
use glam::{DVec2, DVec3};
use presight_features::{SeenFeature, along};
use presight_model::environment::FeatureShape;
use presight_model::geometry::plane_of_polygon;

/// A patch is hidden where a ray meets it beyond the scan by this fraction of the range, which is above the rounding of
/// f32 and invisible in a picture.
const HIDDEN_FROM: f64 = 2e-3;
/// Distance of an arc beyond its feature, and length of its ends, page pixels.
const OFF: f64 = 9.0;

/// Draws over a scan with these `ranges`; `page` maps metres (x forward, y left) to the page.
pub fn draw_from_above(
    overlay: &Overlay<'_>,
    canvas: &mut Canvas,
    frame: PageRect,
    ranges: &[f32],
    page: &impl Fn(DVec2) -> [f64; 2],
) {
    let rays = (0..overlay.sensor.width()).map(|column| overlay.sensor.ray(column, 0)).collect();
    let above = TopView { overlay, frame, ranges, page, rays };
    canvas.inside(frame, |canvas| {
        // Hidden parts first, so that visible parts cover them.
        for seen in [false, true] {
            overlay.features.features.iter().for_each(|f| above.feature(canvas, f, seen));
        }
        overlay.features.features.iter().for_each(|f| above.region(canvas, f));
        overlay.number(canvas, frame, &|f| above.middle(f));
    });
}

struct TopView<'a, F> {
    overlay: &'a Overlay<'a>,
    frame: PageRect,
    ranges: &'a [f32],
    page: &'a F,
    /// By column, image frame.
    rays: Vec<Option<DVec3>>,
}

/// The intersection of a column's ray with a patch; true if the patch is visible there.
type PatchHit = Option<(DVec3, bool)>;

impl<F: Fn(DVec2) -> [f64; 2]> TopView<'_, F> {
    fn place(&self, p: DVec3) -> [f64; 2] {
        (self.page)((self.overlay.sensor.body_from_image() * p).truncate())
    }

    fn feature(&self, canvas: &mut Canvas, feature: &SeenFeature, seen: bool) {
        let (points, parts) = (self.overlay.points(feature), Overlay::parts(feature, seen));
        let mut pen = Pen::of(canvas, self.frame, Style::of(seen), feature.feature.id);
        match &feature.feature.shape {
            FeatureShape::Point { .. } | FeatureShape::Reflector { .. } => {
                parts.iter().for_each(|_| pen.dot(self.place(points[0]), if seen { 4.0 } else { 2.0 }));
            }
            FeatureShape::Segment { .. } | FeatureShape::Contour { .. } => {
                for (t, ends) in parts.iter().flat_map(|t| along(&points, *t).into_iter().map(move |ends| (t, ends))) {
                    let [from, to] = ends.map(|p| self.place(p));
                    // A row without height sees an edge as a point.
                    if t[0] == t[1] { pen.dot(from, 3.0) } else { pen.line(from, to) }
                }
            }
            FeatureShape::Patch { .. } | FeatureShape::Fiducial { .. } => {
                let met = self.met(&points, feature);
                if met.iter().any(Option::is_some) {
                    self.along(&mut pen, &met, seen);
                } else if let Some(style) = Overlay::outline(feature, seen) {
                    // Within the height of the beam, but off the middle of the row.
                    pen.style = style;
                    (0..points.len()).for_each(|k| {
                        pen.line(self.place(points[k]), self.place(points[(k + 1) % points.len()]));
                    });
                }
            }
        }
    }

    /// The intersections of the row's rays with a patch, by column.
    fn met(&self, corners: &[DVec3], feature: &SeenFeature) -> Vec<PatchHit> {
        let spec = self.overlay.sensor.spec();
        let any = feature.visible.iter().len() + feature.hidden.iter().filter(|h| !h.reason.is_outside()).count() > 0;
        let Some(plane) = plane_of_polygon(corners).filter(|_| any) else { return Vec::new() };
        let sign = plane.offset.signum();
        let edge = |k: usize| sign * corners[k].cross(corners[(k + 1) % corners.len()]);
        let edges: Vec<DVec3> = (0..corners.len()).map(edge).collect();
        let meet = |(ray, range): (&Option<DVec3>, &f32)| {
            let ray = (*ray)?;
            let far = plane.offset / plane.normal.dot(ray);
            let held = far >= spec.range_min && far <= spec.range_max && edges.iter().all(|e| e.dot(ray) >= 0.0);
            let seen = !feature.visible.is_empty() && f64::from(*range) >= far * (1.0 - HIDDEN_FROM);
            held.then_some((ray * far, seen))
        };
        self.rays.iter().zip(self.ranges).map(meet).collect()
    }

    /// Draws lines from column to column, also across the seam.
    fn along(&self, pen: &mut Pen<'_>, met: &[PatchHit], seen: bool) {
        let n = met.len();
        let closed = self.overlay.sensor.columns_of_a_turn().is_some();
        let before = |i: usize| if i > 0 { met[i - 1] } else { met[n - 1].filter(|_| closed) };
        let after = |i: usize| if i + 1 < n { met[i + 1] } else { met[0].filter(|_| closed) };
        for (i, here) in met.iter().enumerate() {
            let Some((p, p_seen)) = *here else { continue };
            match after(i) {
                // A line is visible if both of its ends are.
                Some((q, q_seen)) if (p_seen && q_seen) == seen => pen.line(self.place(p), self.place(q)),
                None if before(i).is_none() && p_seen == seen => pen.dot(self.place(p), 3.0),
                _ => {}
            }
        }
    }

    /// Draws a region of interest as an arc behind its feature, with short lines towards the sensor at its ends.
    fn region(&self, canvas: &mut Canvas, feature: &SeenFeature) {
        let Some(([x0, _, x1, _], range)) = feature.roi.zip(feature.range) else { return };
        let origin = DVec2::from((self.page)(DVec2::ZERO));
        let at = |u: f64, beyond: f64| {
            let on_page = DVec2::from(self.place(self.overlay.sensor.ray_at(u, 0.0)? * range));
            let away = (on_page - origin).try_normalize()?;
            Some((on_page + beyond * away).to_array())
        };
        let mut pen = Pen::of(canvas, self.frame, Style::Region, feature.feature.id);
        let mut line = |from: Option<[f64; 2]>, to: Option<[f64; 2]>| {
            if let Some((from, to)) = from.zip(to) {
                pen.line(from, to);
            }
        };
        // A column is rarely more than a degree.
        let pieces = (x1 - x0).ceil().clamp(8.0, 4096.0);
        let number = |i: u32| x0 + (x1 - x0) * f64::from(i) / pieces;
        (0..pieces as u32).for_each(|i| line(at(number(i), OFF), at(number(i + 1), OFF)));
        [x0, x1].into_iter().for_each(|u| line(at(u, OFF), at(u, -OFF)));
    }

    /// The middle of a feature's visible part.
    fn middle(&self, feature: &SeenFeature) -> Option<[f64; 2]> {
        let points = self.overlay.points(feature);
        let seen = feature.visible.first()?;
        let middle = match &feature.feature.shape {
            FeatureShape::Segment { .. } => points[0].lerp(points[1], 0.5 * (seen.t[0] + seen.t[1])),
            FeatureShape::Contour { .. } => along(&points, seen.t).first()?[0],
            FeatureShape::Patch { .. } | FeatureShape::Fiducial { .. } => {
                let met: Vec<DVec3> =
                    self.met(&points, feature).into_iter().flatten().filter(|m| m.1).map(|m| m.0).collect();
                met.get(met.len() / 2).copied().unwrap_or(points.iter().sum::<DVec3>() / points.len() as f64)
            }
            _ => points[0],
        };
        Some(self.place(middle))
    }
}
