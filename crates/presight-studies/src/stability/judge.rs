//! Checks an engine's images against the truth, pixel by pixel, within the product's published bounds.

use super::oracle::{ExactFace, Oracle};
use super::truth::{PolygonOnRay, Truth};
use presight_model::sensor::Sensor;
use presight_model::threads::parallel_or_here;
use presight_render::plan::{FramePlan, Images};
use presight_render::verify::{PixelValues, Precision};
use presight_render::verify::{span, ulp};
use rayon::prelude::*;

/// The truth of all pixels of a plan, row by row.
pub(super) struct TruthImage<'a> {
    oracle: Oracle<'a>,
    plan: &'a FramePlan,
    pixels: Vec<Truth>,
}

/// The judgement of an engine's image.
#[derive(Clone, Debug, Default)]
pub(super) struct ErrorSummary {
    /// Maximum relative error of the range at pixels where the true polygon is shown or was left out as edge-on. If
    /// there is a fault, the error at the first faulty pixel.
    pub error: f64,
    /// Maximum bound over the pixels; each pixel is checked against its own bound. Infinite if a pixel has no finite
    /// bound.
    pub bound: f64,
    /// Pixels that differ from the truth in their polygon, or in hitting one at all, as the bounds allow.
    pub other: usize,
    /// Pixels that show a polygon.
    pub hits: usize,
    /// Pixels without a finite bound.
    pub unbounded: usize,
    /// Description of the first faulty pixel.
    pub fault: Option<String>,
}

/// A pixel that is correct within the bounds.
#[derive(Default)]
struct PixelPass {
    /// It shows a polygon.
    hit: bool,
    /// It differs from the truth in its polygon, or in hitting one at all.
    other: bool,
    /// Relative error of the range and its bound, if they refer to the true polygon.
    range: Option<(f64, f64)>,
}

/// A faulty pixel: the error of its range, if it has one, the bound, and a description.
struct PixelFault(f64, f64, String);

impl<'a> TruthImage<'a> {
    pub fn new(plan: &'a FramePlan) -> Self {
        let oracle = Oracle::new(plan);
        let (w, h) = (plan.sensor.width(), plan.sensor.height());
        let pixels = (0..h).flat_map(|row| (0..w).map(move |column| (column, row)));
        let pixels: Vec<_> = pixels.collect();
        let look = |(column, row)| oracle.look(column, row);
        let pixels = parallel_or_here(|| pixels.into_par_iter().map(look).collect());
        Self { oracle, plan, pixels }
    }

    /// Judges images of all outputs.
    pub fn judge(&self, images: &Images, precision: Precision) -> ErrorSummary {
        let mut verdict = ErrorSummary::default();
        for (at, truth) in self.pixels.iter().enumerate() {
            let pixel = (at as u32 % self.plan.sensor.width(), at as u32 / self.plan.sensor.width());
            match self.pixel(pixel, truth, &PixelValues::of(images, at), precision) {
                Ok(PixelPass { hit, other, range }) => {
                    verdict.hits += usize::from(hit);
                    verdict.other += usize::from(other);
                    let Some((error, bound)) = range else { continue };
                    verdict.unbounded += usize::from(bound.is_infinite());
                    if verdict.fault.is_none() {
                        verdict.error = verdict.error.max(error);
                        verdict.bound = verdict.bound.max(bound);
                    }
                }
                Err(PixelFault(error, bound, what)) if verdict.fault.is_none() => {
                    (verdict.error, verdict.bound) = (error, bound);
                    verdict.fault = Some(format!("pixel ({}, {}): {what}", pixel.0, pixel.1));
                }
                Err(_) => {}
            }
        }
        verdict
    }

    fn pixel(
        &self,
        pixel: (u32, u32),
        truth: &Truth,
        shown: &PixelValues,
        p: Precision,
    ) -> Result<PixelPass, PixelFault> {
        let wrong = |what: &str| PixelFault(f64::INFINITY, 0.0, format!("{shown}: {what}"));
        let nothing = [shown.polygon_id, shown.object_id].iter().all(|id| id.is_none_or(|id| id == 0));
        let all = |is: fn(f32) -> bool| [shown.range, shown.depth_z].into_iter().flatten().all(is);
        let shares_nan = [shown.cos_incidence, shown.echo].into_iter().flatten().all(f32::is_nan);
        let no_ray = nothing && all(f32::is_nan) && shares_nan;
        let sights = match truth {
            Truth::NoRay => return if no_ray { Ok(PixelPass::default()) } else { Err(wrong("this pixel has no ray")) },
            Truth::Either => return Ok(PixelPass::default()),
            Truth::Ray(sights) => sights,
        };
        if no_ray {
            return Err(wrong("this pixel has a ray"));
        }
        let looked = PixelTruth::new(self, pixel, sights, p);
        if nothing {
            let miss = all(|x| x == f32::INFINITY) && shares_nan;
            return match (miss, looked.surely_hit) {
                (false, _) => Err(wrong("neither a hit nor a miss")),
                (_, Some(k)) => Err(wrong(&format!("polygon {} is surely hit", self.oracle.faces[k].polygon_id))),
                _ => Ok(looked.instead(f64::INFINITY)),
            };
        }
        let Some(k) = self.oracle.faces.iter().position(|f| Some(f.polygon_id) == shown.polygon_id) else {
            return Err(wrong("no such polygon"));
        };
        if Some(self.oracle.faces[k].object_id) != shown.object_id {
            return Err(wrong("the polygon belongs to another object"));
        }
        let (error, bound) =
            looked.shown(k, shown).map_err(|PixelFault(e, b, what)| PixelFault(e, b, format!("{shown}: {what}")))?;
        Ok(match looked.truth {
            Some(truth) if truth == k => PixelPass { hit: true, other: false, range: Some((error, bound)) },
            _ => PixelPass { hit: true, ..looked.instead(f64::from(shown.range.unwrap_or(f32::NAN))) },
        })
    }
}

/// The values that an engine is allowed to show at a pixel.
struct PixelTruth<'a> {
    faces: &'a [ExactFace],
    sights: &'a [PolygonOnRay],
    sensor: &'a Sensor,
    pixel: (u32, u32),
    precision: Precision,
    /// Distance of the ray from the outline of each polygon, in units of the bound, positive inside.
    inside: Vec<f64>,
    /// The polygon that the ray meets first.
    truth: Option<usize>,
    /// Maximum possible range of the nearest polygon that is certainly hit.
    wall: f64,
    surely_hit: Option<usize>,
}

impl<'a> PixelTruth<'a> {
    fn new(picture: &'a TruthImage<'_>, pixel: (u32, u32), sights: &'a [PolygonOnRay], precision: Precision) -> Self {
        let faces = &picture.oracle.faces;
        let sensor = &picture.plan.sensor;
        let span = span(picture.plan, pixel.0, pixel.1, precision);
        let inside = faces.iter().zip(sights).map(|(face, sight)| face.inside(sight, precision, span)).collect();
        let met = (0..faces.len()).filter(|k| faces[*k].is_met(&sights[*k]));
        let truth = met.fold(None, |nearest: Option<usize>, k| match nearest {
            Some(other) if sights[other].inverse_range >= sights[k].inverse_range => Some(other),
            _ => Some(k),
        });
        let mut looked =
            Self { faces, sights, sensor, pixel, precision, inside, truth, wall: f64::INFINITY, surely_hit: None };
        for k in 0..faces.len() {
            // Every engine decides in f64 whether a polygon is edge-on, independent of its drawing precision.
            let sure = looked.inside[k] >= 1.0 && !faces[k].bound(Precision::F64).may_be_edge_on;
            if !sure {
                continue;
            }
            let [_, farthest] = looked.reach(k);
            if farthest < looked.wall || looked.surely_hit.is_none() {
                (looked.wall, looked.surely_hit) = (farthest.min(looked.wall), Some(k));
            }
        }
        looked
    }

    /// Error bound of the inverse range.
    fn inverse_error(&self, k: usize) -> f64 {
        let ray = self.sensor.ray(self.pixel.0, self.pixel.1);
        ray.map_or(f64::INFINITY, |ray| self.faces[k].bound(self.precision).inverse_range(&self.faces[k].face, ray))
    }

    /// Minimum and maximum range within the bound.
    fn reach(&self, k: usize) -> [f64; 2] {
        let (inverse, error) = (self.sights[k].inverse_range, self.inverse_error(k));
        [inverse + error, inverse - error].map(|i| if i > 0.0 { i.recip() } else { f64::INFINITY })
    }

    /// Passes a pixel that is allowed not to show the true polygon. At an outline its range is not compared. If the
    /// true polygon may be left out as edge-on, the range of the polygon behind it counts as an error without a bound.
    fn instead(&self, range: f64) -> PixelPass {
        let Some(truth) = self.truth else { return PixelPass { other: range.is_finite(), ..PixelPass::default() } };
        let left_out = self.faces[truth].bound(self.precision).may_be_edge_on;
        let off = (range * self.sights[truth].inverse_range - 1.0).abs();
        PixelPass { hit: false, other: true, range: left_out.then_some((off, f64::INFINITY)) }
    }

    /// Judges a hit. Returns the relative error of the range on the polygon shown, and its bound.
    fn shown(&self, k: usize, shown: &PixelValues) -> Result<(f64, f64), PixelFault> {
        let sight = &self.sights[k];
        let ulps = |x: f64| self.precision.output_ulps() * ulp(x as f32);
        let true_range = sight.inverse_range.recip();
        let [nearest, farthest] = self.reach(k);
        let range = f64::from(shown.range.unwrap_or(f32::NAN));
        let off = (range - true_range) / true_range;
        // Outside its outline, a polygon's plane can lie behind the sensor along the ray.
        let ahead = true_range > 0.0;
        let known = ahead && farthest.is_finite();
        let below_or_above = if off < 0.0 { true_range - nearest } else { farthest - true_range };
        let bound = if known { (below_or_above + ulps(true_range)) / true_range } else { f64::INFINITY };
        let error = if ahead { off.abs() } else { 0.0 };
        let wrong =
            |what: String| Err(PixelFault(off.abs(), if what.starts_with("range") { bound } else { 0.0 }, what));
        if self.inside[k] < -1.0 {
            return wrong(format!("the ray is {:.3} edge bounds outside", -self.inside[k]));
        }
        if nearest > self.wall * self.precision.limit_slack() {
            let hiding = self.surely_hit.map_or(0, |k| self.faces[k].polygon_id);
            return wrong(format!("at {nearest:e} m it is hidden by {hiding} at {:e} m", self.wall));
        }
        if !range.is_finite() || !(error <= bound) {
            return wrong(format!("range {true_range:e} m would be right; its error {error:e} exceeds {bound:e}"));
        }
        let ray_z = self.sensor.ray(self.pixel.0, self.pixel.1).map_or(f64::NAN, |r| r.z);
        if let Some(z) = shown.depth_z.map(f64::from).filter(|_| known)
            && !((z - true_range * ray_z).abs() <= bound * true_range * ray_z.abs() + ulps(z))
        {
            return wrong(format!("depth_z {:e} m would be right", true_range * ray_z));
        }
        let face = &self.faces[k];
        let cos = f64::from(shown.cos_incidence.unwrap_or(f32::NAN));
        let cos_bound = face.bound(self.precision).shown_cosine + ulps(sight.cos_incidence);
        if !((cos - sight.cos_incidence).abs() <= cos_bound) {
            return wrong(format!("cos_incidence {} would be right within {cos_bound:e}", sight.cos_incidence));
        }
        if shown.echo.is_some_and(|e| !e.is_finite()) {
            return wrong("echo is not a number".into());
        }
        Ok((error, bound))
    }
}
