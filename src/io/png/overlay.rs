//! Features drawn over a preview: what is seen solid, what is hidden dashed, regions of interest as boxes.

use super::canvas::{Canvas, Rgb, TEXT_HEIGHT};
use crate::environment::FeatureShape;
use crate::features::{FeaturePrediction, SeenFeature};
use crate::geometry::Pose;
use crate::sensor::Sensor;
use glam::{DMat3, DVec2, DVec3};

/// What is seen.
const SEEN: Rgb = [0xff, 0x4f, 0xd8];
/// What is hidden.
const HIDDEN: Rgb = [0xff, 0xd1, 0x66];
/// Regions of interest.
const REGION: Rgb = [0xf2, 0xf4, 0xf8];
/// Dashes and the gaps between them, page pixels.
const DASH: f64 = 7.0;
/// Straight pieces that a curve is drawn with.
const PIECES: u32 = 48;

/// Features to draw over a preview.
#[derive(Clone, Copy, Debug)]
pub struct Overlay<'a> {
    /// What the sensor of the preview sees of them.
    pub features: &'a FeaturePrediction,
    /// The sensor.
    pub sensor: &'a Sensor,
    /// Its pose, body axes.
    pub world_from_sensor: &'a Pose,
    /// Write their numbers beside them.
    pub numbers: bool,
}

impl Overlay<'_> {
    /// Over an image; `page` turns pixel coordinates into places on the page.
    pub(super) fn draw(&self, canvas: &mut Canvas, page: &impl Fn(DVec2) -> [f64; 2]) {
        let inside = |pixel: &DVec2| {
            let size = DVec2::new(f64::from(self.sensor.width()), f64::from(self.sensor.height()));
            pixel.cmpge(DVec2::splat(-0.5)).all() && pixel.cmple(size - 0.5).all()
        };
        let place = |p: DVec3| self.sensor.project(p).map(DVec2::from).filter(inside).map(page);
        let widest = page(DVec2::new(0.5 * f64::from(self.sensor.width()), 0.0))[0] - page(DVec2::ZERO)[0];
        self.features(canvas, &place, widest.abs().max(8.0));
        for roi in self.features.features.iter().filter_map(|f| f.roi) {
            let [x0, y0, x1, y1] = roi;
            let corners = [(x0, y0), (x1, y0), (x1, y1), (x0, y1)].map(|c| page(DVec2::from(c)));
            for k in 0..4 {
                canvas.stroke(corners[k], corners[(k + 1) % 4], 0.4, REGION);
            }
        }
    }

    /// Over a scan seen from above; `page` turns metres (x forward, y left) into places on the page.
    pub(super) fn draw_from_above(&self, canvas: &mut Canvas, page: &impl Fn(DVec2) -> [f64; 2]) {
        let body_from_image = self.sensor.body_from_image();
        let place = |p: DVec3| Some(page((body_from_image * p).truncate()));
        self.features(canvas, &place, f64::INFINITY);
    }

    fn features(&self, canvas: &mut Canvas, place: &impl Fn(DVec3) -> Option<[f64; 2]>, widest: f64) {
        let image_from_world = (self.world_from_sensor.rotation_matrix() * self.sensor.body_from_image()).transpose();
        // Hidden parts first: what is seen lies over them.
        for seen in [false, true] {
            for feature in &self.features.features {
                self.feature(canvas, feature, image_from_world, seen, &Pen { place, widest });
            }
        }
    }

    fn feature<F: Fn(DVec3) -> Option<[f64; 2]>>(
        &self,
        canvas: &mut Canvas,
        feature: &SeenFeature,
        image_from_world: DMat3,
        seen: bool,
        pen: &Pen<'_, F>,
    ) {
        let points: Vec<DVec3> =
            feature.points_world.iter().map(|p| image_from_world * (*p - self.world_from_sensor.translation)).collect();
        let hidden = || feature.hidden.iter().filter(|h| !h.reason.is_outside());
        let any = if seen { !feature.visible.is_empty() } else { hidden().next().is_some() };
        if !any {
            return;
        }
        match &feature.feature.shape {
            FeatureShape::Point { .. } | FeatureShape::Reflector { .. } => {
                if let Some(at) = (pen.place)(points[0]) {
                    canvas.disc(at, if seen { 4.0 } else { 2.0 }, if seen { SEEN } else { HIDDEN });
                }
            }
            FeatureShape::Segment { .. } => {
                let at = |t: f64| points[0] + t * (points[1] - points[0]);
                if seen {
                    feature.visible.iter().for_each(|v| pen.curve(canvas, at(v.t[0]), at(v.t[1]), true));
                } else {
                    hidden().for_each(|h| pen.curve(canvas, at(h.t[0]), at(h.t[1]), false));
                }
            }
            FeatureShape::Patch { .. } | FeatureShape::Fiducial { .. } => {
                // What is seen of an area in part does not tell which of its outline is.
                let whole = feature.visible_fraction > 0.99;
                if seen == whole {
                    for k in 0..points.len() {
                        pen.curve(canvas, points[k], points[(k + 1) % points.len()], seen);
                    }
                }
            }
        }
        if seen && self.numbers {
            let middle = points.iter().sum::<DVec3>() / points.len() as f64;
            if let Some([x, y]) = (pen.place)(middle).filter(|[x, y]| *x >= 0.0 && *y >= f64::from(TEXT_HEIGHT)) {
                canvas.text(x as u32 + 6, y as u32 - TEXT_HEIGHT, &feature.feature.id.to_string(), REGION);
            }
        }
    }
}

struct Pen<'a, F> {
    place: &'a F,
    /// Longer steps on the page are jumps over the seam.
    widest: f64,
}

impl<F: Fn(DVec3) -> Option<[f64; 2]>> Pen<'_, F> {
    /// The image of a straight line.
    fn curve(&self, canvas: &mut Canvas, from: DVec3, to: DVec3, solid: bool) {
        let mut walked = 0.0;
        let mut last = (self.place)(from);
        if from == to
            && let Some(at) = last
        {
            canvas.disc(at, 3.0, if solid { SEEN } else { HIDDEN });
        }
        for i in 1..=PIECES {
            let next = (self.place)(from.lerp(to, f64::from(i) / f64::from(PIECES)));
            if let (Some(a), Some(b)) = (last, next) {
                let length = (b[0] - a[0]).hypot(b[1] - a[1]);
                if length < self.widest {
                    line(canvas, a, b, &mut walked, solid);
                }
            }
            last = next;
        }
    }
}

/// A straight line, dashed by the length walked so far.
fn line(canvas: &mut Canvas, a: [f64; 2], b: [f64; 2], walked: &mut f64, solid: bool) {
    let length = (b[0] - a[0]).hypot(b[1] - a[1]);
    if solid {
        return canvas.stroke(a, b, 1.0, SEEN);
    }
    let at = |s: f64| [0, 1].map(|i| a[i] + s / length * (b[i] - a[i]));
    let mut done = 0.0;
    while done < length {
        let phase = (*walked + done) % (2.0 * DASH);
        let to = (done + if phase < DASH { DASH - phase } else { 2.0 * DASH - phase } + 1e-9).min(length);
        if phase < DASH {
            canvas.stroke(at(done), at(to), 0.6, HIDDEN);
        }
        done = to;
    }
    *walked += length;
}
