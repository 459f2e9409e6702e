//! Features drawn over a preview: visible parts solid, hidden parts dashed, regions of interest as boxes.

use super::canvas::{Canvas, INK, PageRect, TEXT_HEIGHT, text_width};
use super::pen::{Pen, REGION, Style};
use glam::{DMat3, DVec2, DVec3};
use presight_features::{FeaturePrediction, SeenFeature, along};
use presight_model::environment::FeatureShape;
use presight_model::geometry::SensorPose;
use presight_model::sensor::{Angles, Geometry, Sensor};
use std::collections::HashSet;

/// Maximum length of a curve piece that is drawn straight, radians: it bends by less than a pixel.
const PIECE: f64 = 0.5 * std::f64::consts::PI / 180.0;
/// Minimum number of pieces of a curve, for a distorting lens with a narrow field of view.
const MIN_PIECES: f64 = 16.0;
/// Height of the legend with its gap, page pixels.
pub const LEGEND: u32 = TEXT_HEIGHT + 10;

/// Features to draw over a preview.
#[derive(Clone, Copy, Debug)]
pub struct Overlay<'a> {
    /// The features as the sensor of the preview sees them.
    pub features: &'a FeaturePrediction,
    /// Sides of partly visible patches ([`presight_features::sides_seen_in_part`]), as the sensor sees them. Without
    /// them, the whole outline of such a patch is dashed in the colour of visible features.
    pub sides: &'a [SeenFeature],
    /// The sensor.
    pub sensor: &'a Sensor,
    /// Its pose.
    pub pose: SensorPose,
    /// If true, the ids of visible features are written next to them.
    pub numbers: bool,
}

impl Overlay<'_> {
    /// Draws over an image; `page` maps pixel coordinates to the page linearly.
    pub(super) fn draw(&self, canvas: &mut Canvas, frame: PageRect, page: &impl Fn(DVec2) -> [f64; 2]) {
        let view = PageView { overlay: self, frame, page, turn: turn_of(self.sensor), by_sides: self.by_sides() };
        canvas.inside(frame, |canvas| {
            // Hidden parts first, so that visible parts cover them.
            for seen in [false, true] {
                self.features.features.iter().for_each(|f| view.feature(canvas, f, seen));
                self.sides.iter().for_each(|side| view.feature(canvas, side, seen));
            }
            self.features.features.iter().for_each(|f| view.region(canvas, f));
            self.number(canvas, frame, &|f| view.middle(f));
        });
    }

    /// Points of a feature in the sensor's image frame.
    pub(super) fn points(&self, feature: &SeenFeature) -> Vec<DVec3> {
        let (image_from_world, place) = (self.image_from_world(), self.pose.world_from_sensor().translation);
        feature.points_world.iter().map(|p| image_from_world * (*p - place)).collect()
    }

    fn image_from_world(&self) -> DMat3 {
        (self.pose.world_from_sensor().rotation_matrix() * self.sensor.body_from_image()).transpose()
    }

    /// The visible parts of a segment, or those in the image but hidden, as intervals of 0..1.
    pub(super) fn parts(feature: &SeenFeature, seen: bool) -> Vec<[f64; 2]> {
        let hidden = feature.hidden.iter().filter(|h| !h.reason.is_outside());
        if seen { feature.visible.iter().map(|v| v.t).collect() } else { hidden.map(|h| h.t).collect() }
    }

    /// Ids of features whose sides are drawn separately.
    fn by_sides(&self) -> HashSet<u32> {
        self.sides.iter().map(|side| side.feature.id).collect()
    }

    /// The style of an area's whole outline; `None` if it is not drawn with the visible (`seen`) or hidden parts.
    pub(super) fn outline(feature: &SeenFeature, seen: bool) -> Option<Style> {
        let any = |seen| !Self::parts(feature, seen).is_empty();
        match (any(true), any(false)) {
            (true, false) if seen => Some(Style::Seen),
            (true, true) if seen => Some(Style::InPart),
            (false, true) if !seen => Some(Style::Hidden),
            _ => None,
        }
    }

    /// Writes the ids of visible features, each completely inside the frame.
    pub(super) fn number(&self, canvas: &mut Canvas, frame: PageRect, at: &impl Fn(&SeenFeature) -> Option<[f64; 2]>) {
        let seen = self.features.features.iter().filter(|f| self.numbers && !f.visible.is_empty());
        for (feature, [x, y]) in seen.filter_map(|f| Some((f, at(f).filter(|p| frame.holds(*p, 0.0))?))) {
            let text = feature.feature.id.to_string();
            let most = |from: u32, size: u32, own: u32| from + size.saturating_sub(own);
            let x = (x as u32 + 6).clamp(frame.left, most(frame.left, frame.width, text_width(&text)));
            let y = (y as u32).saturating_sub(TEXT_HEIGHT).clamp(frame.top, most(frame.top, frame.height, TEXT_HEIGHT));
            canvas.text(x, y, &text, REGION);
        }
    }
}

/// Draws the legend of the styles in one line from `top`.
pub fn legend(canvas: &mut Canvas, left: u32, top: u32) {
    const SAMPLE: u32 = 42;
    let mut x = left;
    for (name, style) in [("seen", Some(Style::Seen)), ("hidden", Some(Style::Hidden)), ("region", None)] {
        let frame = PageRect { left: x, top, width: SAMPLE, height: TEXT_HEIGHT };
        let middle = f64::from(top) + 0.5 * f64::from(TEXT_HEIGHT);
        let (from, to) = ([f64::from(x), middle], [f64::from(x + SAMPLE), middle]);
        match style {
            Some(style) => Pen::new(canvas, frame, style).line(from, to),
            None => {
                let corners = [(1, 1), (SAMPLE - 2, 1), (SAMPLE - 2, TEXT_HEIGHT - 2), (1, TEXT_HEIGHT - 2)];
                let corners = corners.map(|(dx, dy)| [x + dx, top + dy].map(f64::from));
                (0..4).for_each(|k| canvas.stroke(corners[k], corners[(k + 1) % 4], 0.4, REGION));
            }
        }
        canvas.text(x + SAMPLE + 8, top, name, INK);
        x += SAMPLE + 8 + text_width(name) + 24;
    }
}

/// Columns of a full turn, for scanners with evenly spaced columns.
fn turn_of(sensor: &Sensor) -> Option<f64> {
    match &sensor.spec().geometry {
        Geometry::Scanner(s) => match s.azimuth {
            Angles::Uniform { step_deg, .. } => Some(360.0 / step_deg.abs()).filter(|turn| turn.is_finite()),
            Angles::Listed(_) => None,
        },
        Geometry::Camera(_) | Geometry::Rays(_) => None,
    }
}

/// The placement of the image on the page.
struct PageView<'a, F> {
    overlay: &'a Overlay<'a>,
    frame: PageRect,
    page: &'a F,
    turn: Option<f64>,
    by_sides: HashSet<u32>,
}

impl<F: Fn(DVec2) -> [f64; 2]> PageView<'_, F> {
    fn feature(&self, canvas: &mut Canvas, feature: &SeenFeature, seen: bool) {
        let points = self.overlay.points(feature);
        let parts = Overlay::parts(feature, seen);
        let mut pen = Pen::of(canvas, self.frame, Style::of(seen), feature.feature.id);
        match &feature.feature.shape {
            FeatureShape::Point { .. } | FeatureShape::Reflector { .. } => {
                if let Some(at) = self.project(points[0]).filter(|_| !parts.is_empty()) {
                    self.each_turn([at, at], |[at, _]| pen.dot(at, if seen { 4.0 } else { 2.0 }));
                }
            }
            FeatureShape::Segment { .. } | FeatureShape::Contour { .. } => {
                parts.iter().flat_map(|t| along(&points, *t)).for_each(|[a, b]| self.curve(&mut pen, a, b));
            }
            FeatureShape::Patch { .. } | FeatureShape::Fiducial { .. } => {
                let whole = !self.by_sides.contains(&feature.feature.id);
                if let Some(style) = Overlay::outline(feature, seen).filter(|_| whole) {
                    pen.style = style;
                    (0..points.len()).for_each(|k| self.curve(&mut pen, points[k], points[(k + 1) % points.len()]));
                }
            }
        }
    }

    fn project(&self, p: DVec3) -> Option<DVec2> {
        self.overlay.sensor.project(p).map(DVec2::from)
    }

    /// Draws the image of a straight line in pieces of equal angle as seen from the sensor.
    fn curve(&self, pen: &mut Pen<'_>, a: DVec3, b: DVec3) {
        let (near, far) = (a.length(), b.length());
        let angle = a.cross(b).length().atan2(a.dot(b));
        let pieces = (angle / PIECE).ceil().max(MIN_PIECES);
        let at = |s: f64| {
            let (x, y) = (near * (s * angle).sin(), far * ((1.0 - s) * angle).sin());
            let t = x / (x + y);
            self.project(if t.is_finite() { a.lerp(b, t) } else { a.lerp(b, s) })
        };
        let mut last = at(0.0);
        if a == b
            && let Some(at) = last
        {
            return self.each_turn([at, at], |[at, _]| pen.dot(at, 3.0));
        }
        for i in 1..=pieces as u32 {
            let next = at(f64::from(i) / pieces);
            if let Some((p, mut q)) = last.zip(next) {
                if let Some(turn) = self.turn {
                    q.x += turn * ((p.x - q.x) / turn).round();
                }
                // A jump means that the line crosses a seam, unless the columns of a full turn are known.
                if self.turn.is_some() || (q.x - p.x).abs() < 0.5 * f64::from(self.overlay.sensor.width()) {
                    self.each_turn([p, q], |[p, q]| pen.line(p, q));
                }
            }
            last = next;
        }
    }

    /// Calls `draw` with two image points on the page, for each turn of a scanner that may bring them into the image.
    fn each_turn(&self, ends: [DVec2; 2], mut draw: impl FnMut([[f64; 2]; 2])) {
        let shifts: &[f64] = if self.turn.is_some() { &[0.0, -1.0, 1.0] } else { &[0.0] };
        for shift in shifts {
            let by = DVec2::new(shift * self.turn.unwrap_or(0.0), 0.0);
            let on_page = ends.map(|p| (self.page)(p + by));
            if self.frame.part_of_line(on_page[0], on_page[1], 8.0).is_some() {
                draw(on_page);
            }
        }
    }

    /// Draws a region of interest; across the seam, both of its parts.
    fn region(&self, canvas: &mut Canvas, feature: &SeenFeature) {
        let Some([x0, y0, x1, y1]) = feature.roi else { return };
        let mut pen = Pen::of(canvas, self.frame, Style::Region, feature.feature.id);
        let corners = [(x0, y0), (x1, y0), (x1, y1), (x0, y1)].map(DVec2::from);
        for k in 0..4 {
            self.each_turn([corners[k], corners[(k + 1) % 4]], |[p, q]| pen.line(p, q));
        }
    }

    /// The middle of a feature's visible part.
    fn middle(&self, feature: &SeenFeature) -> Option<[f64; 2]> {
        let [from, mut to] = feature.visible.first()?.pixels;
        let segment = matches!(feature.feature.shape, FeatureShape::Segment { .. } | FeatureShape::Contour { .. });
        if let Some(turn) = self.turn.filter(|_| segment) {
            to.x += turn * ((from.x - to.x) / turn).round();
        }
        // `from` and `to` bound an area's visible part; across a seam that is the whole image. So try its centre first.
        let points = self.overlay.points(feature);
        let own = self.project(points.iter().sum::<DVec3>() / points.len() as f64).filter(|_| !segment);
        let mut middle = None;
        let mut take = |at: [f64; 2]| middle = middle.or(Some(at).filter(|at| self.frame.holds(*at, 0.0)));
        for at in own.into_iter().chain([0.5 * (from + to)]) {
            self.each_turn([at; 2], |[at, _]| take(at));
        }
        middle
    }
}

#[cfg(test)]
mod tests;
