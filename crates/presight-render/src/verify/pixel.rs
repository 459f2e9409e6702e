//! One pixel: its values, and its comparison with a polygon.

use super::bound::Precision;
use super::candidates::Candidate;
use crate::plan::{FramePlan, Images};
use presight_model::sensor::SensorSpec;
use serde::Serialize;

/// The values of one pixel; `None` for images that were not requested.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct PixelValues {
    /// Metres.
    pub range: Option<f32>,
    /// Metres.
    pub depth_z: Option<f32>,
    /// 0 without a hit.
    pub polygon_id: Option<u32>,
    /// 0 without a hit.
    pub object_id: Option<u32>,
    /// 0..=1 or NaN.
    pub cos_incidence: Option<f32>,
    /// 0..=1 or NaN.
    pub echo: Option<f32>,
    /// A unit vector or NaN.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub normal: Option<[f32; 3]>,
}

/// Errors of a pixel's outputs as shares of their bounds; 1 is the bound itself.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct BoundShares {
    /// Share of the range bound.
    pub range: f64,
    /// Share of the depth_z bound.
    pub depth_z: f64,
    /// Share of the cos_incidence bound.
    pub cos_incidence: f64,
    /// Share of the echo bound.
    pub echo: f64,
    /// Maximum share of the bound among the normal's components.
    pub normal: f64,
}

impl BoundShares {
    pub(super) fn most(&self) -> f64 {
        self.range.max(self.depth_z).max(self.cos_incidence).max(self.echo).max(self.normal)
    }

    pub(super) fn max(self, other: Self) -> Self {
        Self {
            range: self.range.max(other.range),
            depth_z: self.depth_z.max(other.depth_z),
            cos_incidence: self.cos_incidence.max(other.cos_incidence),
            echo: self.echo.max(other.echo),
            normal: self.normal.max(other.normal),
        }
    }
}

impl std::fmt::Display for BoundShares {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let Self { range, depth_z, cos_incidence, echo, normal } = self;
        write!(f, "range {range:.3}, depth_z {depth_z:.3}, cos_incidence {cos_incidence:.3}, echo {echo:.3}, ")?;
        write!(f, "normal {normal:.3}")
    }
}

impl PixelValues {
    /// The values of pixel number `at`.
    pub fn of(images: &Images, at: usize) -> Self {
        Self {
            range: images.range.get(at).copied(),
            depth_z: images.depth_z.get(at).copied(),
            polygon_id: images.polygon_id.get(at).copied(),
            object_id: images.object_id.get(at).copied(),
            cos_incidence: images.cos_incidence.get(at).copied(),
            echo: images.echo.get(at).copied(),
            normal: images.normal.get(at).copied(),
        }
    }

    /// Bit-equal, except that all NaN are equal.
    pub(super) fn identical(&self, other: &Self) -> bool {
        let to_bits = |x: f32| if x.is_nan() { f32::NAN.to_bits() } else { x.to_bits() };
        let floats = |v: &Self| [v.range, v.depth_z, v.cos_incidence, v.echo].map(|x| x.map(to_bits));
        let vector = |v: &Self| v.normal.map(|n| n.map(to_bits));
        floats(self) == floats(other)
            && vector(self) == vector(other)
            && self.polygon_id == other.polygon_id
            && self.object_id == other.object_id
    }

    /// True if the pixel has no hit: `+inf`, ids 0, no angle.
    pub(super) fn is_miss(&self) -> bool {
        let far = |v: Option<f32>| v.is_none_or(|x| x == f32::INFINITY);
        self.has_no_ids() && far(self.range) && far(self.depth_z)
    }

    /// True if the pixel has no ray: all NaN, ids 0.
    pub(super) fn is_no_ray(&self) -> bool {
        let nan = |v: Option<f32>| v.is_none_or(f32::is_nan);
        self.has_no_ids() && nan(self.range) && nan(self.depth_z)
    }

    fn has_no_ids(&self) -> bool {
        let zero = |v: Option<u32>| v.is_none_or(|id| id == 0);
        let no_share = self.cos_incidence.is_none_or(f32::is_nan) && self.echo.is_none_or(f32::is_nan);
        let no_normal = self.normal.is_none_or(|n| n.iter().all(|x| x.is_nan()));
        zero(self.polygon_id) && zero(self.object_id) && no_share && no_normal
    }

    /// Errors of the values relative to a polygon, as shares of the bounds; `None` if they do not fit it at all (other
    /// ids, a limit outside the bound). `base` replaces the exact values by another image's.
    pub(super) fn off(
        &self,
        c: &Candidate,
        base: Option<&Self>,
        spec: &SensorSpec,
        p: Precision,
    ) -> Option<BoundShares> {
        let same_id = |asked: Option<u32>, id: u32| asked.is_none_or(|x| x == id);
        if !(same_id(self.polygon_id, c.polygon_id) && same_id(self.object_id, c.object_id)) {
            return None;
        }
        let based = |value: Option<f32>, exact: f64| value.filter(|x| x.is_finite()).map_or(exact, f64::from);
        let base = base.copied().unwrap_or_default();
        let cos = based(base.cos_incidence, c.cos_incidence);
        let cos_incidence = share(self.cos_incidence, cos, [c.cos_error, c.cos_error], p);
        let echo_off = echo_error(c, cos as f32, p);
        let echo = share(self.echo, based(base.echo, c.reflection * cos), [echo_off, echo_off], p);
        let normal = self.normal_off(c, base.normal, spec, p);
        let slack = p.limit_slack();
        let too_near = |v: Option<f32>| v.is_none_or(|x| x == f32::NEG_INFINITY);
        if c.nearest < spec.range_min * slack && too_near(self.range) && too_near(self.depth_z) {
            return Some(BoundShares { cos_incidence, echo, normal, ..BoundShares::default() });
        }
        if c.farthest * slack < spec.range_min || c.nearest > spec.range_max * slack {
            return None;
        }
        let known = c.range > 0.0 && c.range.is_finite();
        let off = [c.range - c.nearest, c.farthest - c.range].map(|d| if known { d } else { f64::INFINITY });
        let z = c.depth_per_range;
        let depth_off = if z >= 0.0 { off.map(|d| d * z) } else { [off[1] * -z, off[0] * -z] };
        Some(BoundShares {
            range: share(self.range, based(base.range, c.range), off, p),
            depth_z: share(self.depth_z, based(base.depth_z, c.range * z), depth_off, p),
            cos_incidence,
            echo,
            normal,
        })
    }

    /// Error of the normal, as a share. A component is the normal times a body axis, a unit vector like a ray, so the
    /// bound is that of cos_incidence. If the sensor's side of the plane is uncertain, either normal fits.
    fn normal_off(&self, c: &Candidate, base: Option<[f32; 3]>, spec: &SensorSpec, p: Precision) -> f64 {
        let Some(normal) = self.normal else { return 0.0 };
        let exact = spec.body_from_image() * c.normal;
        let based = base.filter(|n| n.iter().all(|x| x.is_finite())).map(|n| n.map(f64::from));
        let off = |side: f64| {
            let exact = based.unwrap_or_else(|| exact.to_array()).map(|x| side * x);
            let shares = normal.into_iter().zip(exact).map(|(x, e)| share(Some(x), e, [c.cos_error; 2], p));
            shares.fold(0.0, f64::max)
        };
        if c.farthest.is_finite() { off(1.0) } else { off(1.0).min(off(-1.0)) }
    }
}

/// value - base| as a share of the bound below or above it; infinite for NaN and infinities.
fn share(value: Option<f32>, base: f64, [below, above]: [f64; 2], p: Precision) -> f64 {
    let Some(value) = value else {
        return 0.0;
    };
    if !value.is_finite() {
        return f64::INFINITY;
    }
    if [below, above] == [f64::INFINITY; 2] {
        return 0.0;
    }
    let off = f64::from(value) - base;
    let ulp = ulp(base as f32);
    let bound = if off < 0.0 { below } else { above } + p.output_ulps() * ulp;
    if off == 0.0 { 0.0 } else { off.abs() / bound }
}

/// The echo is the material's factor times cos_incidence as f32: its bound and output rounding are scaled, and the
/// product adds its own rounding.
fn echo_error(c: &Candidate, cos_incidence: f32, p: Precision) -> f64 {
    c.reflection * (c.cos_error + p.output_ulps() * ulp(cos_incidence))
}

/// The distance from |x| to the next f32.
pub fn ulp(x: f32) -> f64 {
    let x = x.abs().clamp(f32::MIN_POSITIVE, f32::MAX / 2.0);
    f64::from(x.next_up()) - f64::from(x)
}

/// Maximum differences of a pixel's outputs from the reference.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Tolerances {
    /// Metres.
    pub range: f64,
    /// Metres.
    pub depth_z: f64,
    /// Tolerance of cos_incidence.
    pub cos_incidence: f64,
    /// Tolerance of echo.
    pub echo: f64,
    /// Tolerance of each component of the normal.
    pub normal: [f64; 3],
}

impl Tolerances {
    /// The tolerances of a polygon above a reference's values.
    pub(super) fn above(c: &Candidate, reference: &PixelValues, p: Precision) -> Self {
        let out = |v: Option<f32>| v.map_or(0.0, |x| p.output_ulps() * ulp(x));
        let range = c.farthest - c.range;
        Self {
            range: range + out(reference.range),
            depth_z: range * c.depth_per_range + out(reference.depth_z),
            cos_incidence: c.cos_error + out(reference.cos_incidence),
            echo: echo_error(c, reference.cos_incidence.unwrap_or(c.cos_incidence as f32), p) + out(reference.echo),
            normal: reference.normal.unwrap_or([0.0; 3]).map(|x| c.cos_error + out(Some(x))),
        }
    }
}

/// Column and row of pixel number `at`.
pub(super) fn pixel(plan_width: u32, at: usize) -> (u32, u32) {
    ((at % plan_width as usize) as u32, (at / plan_width as usize) as u32)
}

/// Finds the object and polygon of a `polygon_id`.
pub(super) struct Lookup {
    by_source: std::collections::HashMap<u32, (u32, u32)>,
}

impl Lookup {
    pub fn new(plan: &FramePlan) -> Self {
        let mut by_source = std::collections::HashMap::new();
        if plan.request.ids == crate::plan::IdScheme::Source {
            for (object, o) in plan.environment().objects().iter().enumerate() {
                for polygon in 0..o.mesh.polygon_count() as u32 {
                    by_source.insert(plan.polygon_id(object as u32, polygon), (object as u32, polygon));
                }
            }
        }
        Self { by_source }
    }

    pub fn find(&self, plan: &FramePlan, id: u32) -> Option<(u32, u32)> {
        match plan.request.ids {
            crate::plan::IdScheme::Model => plan.environment().locate(id.checked_sub(1)?),
            crate::plan::IdScheme::Source => self.by_source.get(&id).copied(),
        }
    }
}

impl std::fmt::Display for PixelValues {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let mut parts = Vec::new();
        parts.extend(self.polygon_id.map(|v| format!("polygon {v}")));
        parts.extend(self.object_id.map(|v| format!("object {v}")));
        parts.extend(self.range.map(|v| format!("range {v}")));
        parts.extend(self.depth_z.map(|v| format!("depth_z {v}")));
        parts.extend(self.cos_incidence.map(|v| format!("cos_incidence {v}")));
        parts.extend(self.echo.map(|v| format!("echo {v}")));
        parts.extend(self.normal.map(|[x, y, z]| format!("normal {x} {y} {z}")));
        f.write_str(&parts.join(", "))
    }
}
