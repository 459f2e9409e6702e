//! Residuals of range images: how far measured points are from the planes of the polygons that are predicted there.
//!
//! A measured point x of a ray u is compared with the polygon of the nearest predicted point in a window of the predicted image,
//! as wide as the pose is uncertain. Its residual is e = n x - d, with the exact plane (n, d) of that polygon; by a motion of the
//! robot at c it changes by J = [n, (x - c) cross n]. Its variance is that of the measurement along n.

use super::deviation::{LEAST, SeenDeviation, WITHIN};
use super::normal::{CommonError, GroupSum, Normal};
use super::scan_twist::LateSums;
use super::{Gate, Kernel, Residuals};
use crate::motion::Vector;
use crate::verdict::{ExpectedImage, ExpectedPixel, LANES, ObjectError, body_from_image};
use glam::{DAffine3, DVec3, Vec3};
use presight_model::geometry::{Pose, Twist};
use presight_model::matrix::{Matrix, add_to, apply, product, sandwich, turn};
use presight_model::measured::{Frame, RangeNoise};
use presight_model::statistics::upper_median;
use presight_model::threads::parallel_or_here;
use rayon::prelude::*;
use std::collections::{BTreeMap, HashMap};

/// Surfaces that a ray meets flatter than this say too little along the ray, cosine.
const FLATTEST: f64 = 0.1;
/// Residuals up to so many standard deviations are explained.
pub(crate) const EXPLAINED: f64 = 3.3;
/// Beyond so many standard deviations the last kernel gives no weight (Tukey's biweight, 95 % efficient).
const TUKEY: f64 = 4.685;
/// Most probes of a window in one direction from its middle.
const PROBES: i32 = 6;
/// Points of one task: a scan of one row is work for two threads.
const CHUNK: usize = 192;
/// Points that tell the median of residuals: more tell no other.
const SPREAD_POINTS: usize = 4096;
/// The match of a point that has none.
const NOWHERE: u32 = u32::MAX;

/// A range image and what was expected of it.
pub struct RangeSource<'a> {
    expected: &'a ExpectedImage,
    noise: RangeNoise,
    /// Variance of each surface along its normal, square metres.
    surface: f64,
    /// Least variance of a residual, square metres.
    least: f64,
    robot_from_image: Pose,
    /// Measured points that are worth looking at, image frame.
    points: &'a [MeasuredPoint],
    /// Objects whose surfaces count; all if `None`.
    only: Option<u32>,
}

/// A measured point with the normal of the surface through its neighbours; 0 where there is none. Image frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MeasuredPoint {
    /// Metres.
    pub point: Vec3,
    /// Unit length, towards the sensor.
    pub normal: Vec3,
    /// Seconds from the moment to which a scan was deskewed to when the point was measured; 0 if it was not.
    pub late: f32,
}

/// The measured points of a frame, image frame, metres: those with a finite range within the sensor's limits. A beam
/// that comes twice counts once.
pub fn measured_points(frame: &Frame) -> Vec<MeasuredPoint> {
    let sensor = frame.sensor();
    let (width, distinct) = (sensor.width() as usize, sensor.distinct_columns() as usize);
    let spec = sensor.spec();
    let height = sensor.height() as usize;
    let point = |(i, range): (usize, &f32)| {
        let range = f64::from(*range);
        let inside = range.is_finite() && range >= spec.range_min && range <= spec.range_max;
        let ray = inside.then(|| sensor.ray((i % width) as u32, (i / width) as u32)).flatten();
        ray.map_or(Vec3::NAN, |ray| (range * ray).as_vec3())
    };
    let pixels = frame.ranges().par_iter().enumerate().with_min_len(CHUNK);
    let points: Vec<Vec3> = parallel_or_here(|| pixels.map(point).collect());
    let upright = height == 1 && !sensor.is_camera();
    let late = |c: usize, r: usize| {
        frame.deskewed_by().map_or(0.0, |by| sensor.seconds_after_stamp(c as u32, r as u32) - by) as f32
    };
    let row = |row| points_of_row(&points, width, distinct, row, upright, late);
    let rows = (0..height).into_par_iter().with_min_len(CHUNK.div_ceil(width.max(1)));
    let rows: Vec<Vec<MeasuredPoint>> = parallel_or_here(|| rows.map(row).collect());
    rows.concat()
}

/// Those in the first `distinct` columns of one row. One row alone shows surfaces as lines: they are taken to stand `upright` on it.
fn points_of_row(
    points: &[Vec3],
    width: usize,
    distinct: usize,
    row: usize,
    upright: bool,
    late: impl Fn(usize, usize) -> f32,
) -> Vec<MeasuredPoint> {
    /// Columns and rows between a point and the neighbours that tell its normal.
    const N: usize = 2;
    let last = points.len() / width - 1;
    let at = |c: usize, r: usize| points[r * width + c];
    let mut found = Vec::with_capacity(width);
    for c in 0..distinct {
        let p = at(c, row);
        if p.is_nan() {
            continue;
        }
        let across = at((c + N).min(width - 1), row) - at(c.saturating_sub(N), row);
        let down = if upright { Vec3::Z } else { at(c, (row + N).min(last)) - at(c, row.saturating_sub(N)) };
        let n = across.cross(down).normalize_or_zero();
        let n = if n.is_nan() {
            Vec3::ZERO
        } else if n.dot(p) > 0.0 {
            -n
        } else {
            n
        };
        found.push(MeasuredPoint { point: p, normal: n, late: late(c, row) });
    }
    found
}

/// What one chunk of points adds; J in the axes of the expected image.
#[derive(Clone)]
struct Sum {
    information: Matrix,
    noise: Matrix,
    gradient: [f64; 6],
    cost: f64,
    explained: usize,
    /// Points of other objects than the one that counts.
    others: usize,
    normalized: Vec<f32>,
    deviation: SeenDeviation,
    late: LateSums,
    groups: HashMap<CommonError, GroupSum>,
}

impl Default for Sum {
    fn default() -> Self {
        let zero = [[0.0; 6]; 6];
        Self {
            information: zero,
            noise: zero,
            gradient: [0.0; 6],
            cost: 0.0,
            explained: 0,
            others: 0,
            normalized: Vec::new(),
            deviation: SeenDeviation::default(),
            late: LateSums::default(),
            groups: HashMap::new(),
        }
    }
}

impl<'a> RangeSource<'a> {
    /// A source of measured points (see [`measured_points`]) and what is expected of them. `robot_from_sensor` is the sensor's
    /// mount.
    pub fn new(expected: &'a ExpectedImage, points: &'a [MeasuredPoint], noise: RangeNoise) -> Self {
        let mount = expected.sensor.spec().mount;
        let robot_from_image = mount * body_from_image(&expected.sensor);
        Self { expected, noise, surface: 0.0, least: 1e-12, robot_from_image, points, only: None }
    }

    /// Surfaces may be off along their normals, at each point by its own, one standard deviation, metres.
    #[must_use]
    pub fn with_model_sigma(self, sigma: f64) -> Self {
        Self { surface: sigma * sigma, ..self }
    }

    /// The same of a deviation that was learnt: residuals are off by a centimetre at least, noise included.
    #[must_use]
    pub fn with_learnt_sigma(self, sigma: f64) -> Self {
        Self { surface: sigma * sigma, least: LEAST * LEAST, ..self }
    }

    /// Only the surfaces of one object count: for a pose relative to it.
    #[must_use]
    pub fn only(self, object: u32) -> Self {
        Self { only: Some(object), ..self }
    }

    /// The expected pixel nearest to a point, both in the expected image's frame.
    #[inline(always)]
    fn nearest(&self, q: Vec3, m: Vec3, lambda2: f32, half: (i32, i32)) -> Option<usize> {
        let e = self.expected;
        let (u, v) = self.project(q)?;
        let (w, h) = (e.width as i32, e.height as i32);
        let (u, v) = (u.round_ties_even(), v.round_ties_even());
        let near = |x: f32, side: i32, half: i32| x >= -(half as f32) && x <= (side + half) as f32;
        if !(near(u, w, half.0) && near(v, h, half.1)) {
            return None;
        }
        let (mut cu, mut cv) = (u as i32, v as i32);
        let mut best = (0, f32::INFINITY);
        let (mut hu, mut hv) = half;
        loop {
            let (su, sv) = ((hu + PROBES - 1) / PROBES, (hv + PROBES - 1) / PROBES);
            let (su, sv) = (su.max(1), sv.max(1));
            let (nu, nv) = (hu / su, hv / sv);
            let (mut bu, mut bv) = (cu, cv);
            let first = cu - nu * su;
            let (rows, looked) = (e.strided.rows(&e.pixels, e.width, first, su as usize), 2 * nu as usize + 1);
            for n in 0..=2 * nv {
                // From the middle on: what is near is found soon, and bounds the rest.
                let row = cv + sv * if n % 2 == 0 { n / 2 } else { -(n / 2) - 1 };
                if row < 0 || row >= h {
                    continue;
                }
                let [x, y, z] = rows.row(row as usize);
                let mut apart = [0.0f32; LANES];
                for k in 0..LANES {
                    let (dx, dy, dz) = (x[k] - q.x, y[k] - q.y, z[k] - q.z);
                    let a = dx * dx + dy * dy + dz * dz;
                    // Not a number where nothing is predicted.
                    apart[k] = if k < looked && a < f32::INFINITY { a } else { f32::INFINITY };
                }
                // The nearest one first: it bounds the rest. Most are too far off whatever their normals.
                loop {
                    let (least, lane) = least_of(&apart);
                    if !(least < best.1) {
                        break;
                    }
                    apart[lane] = f32::INFINITY;
                    let column = first + lane as i32 * su;
                    let at = (row * w + column) as usize;
                    let pixel = &e.pixels[at];
                    let agree = pixel.normal.dot(m);
                    let agree = if pixel.offset > 0.0 { -agree } else { agree };
                    let apart = least + lambda2 * (1.0 - agree);
                    if apart < best.1 {
                        best = (at, apart);
                        (bu, bv) = (column, row);
                    }
                }
            }
            if su == 1 && sv == 1 {
                return (best.1 < f32::INFINITY).then_some(best.0);
            }
            (cu, cv) = (bu, bv);
            (hu, hv) = ((su - 1).max(0), (sv - 1).max(0));
        }
    }

    #[inline(always)]
    fn project(&self, q: Vec3) -> Option<(f32, f32)> {
        // Windows make up for what this is off.
        self.expected.sensor.project_nearly(q)
    }

    /// True if some of what noise makes of an expected range is beyond the sensor's limits: what is left of it is nearer, or farther, than
    /// the surface in the mean.
    #[inline(always)]
    fn is_cut_off(&self, pixel: &ExpectedPixel, compared: &Comparison) -> bool {
        let spec = self.expected.sensor.spec();
        let range = f64::from(pixel.range);
        let nearest = if spec.range_min > 0.0 { range - spec.range_min } else { f64::INFINITY };
        let room = compared.cos * nearest.min(spec.range_max - range);
        room < TUKEY * compared.noise.sqrt()
    }

    /// The expected pixel on the ray of a point.
    #[inline(always)]
    fn on_ray(&self, q: Vec3) -> Option<usize> {
        let (u, v) = self.project(q)?;
        let (w, h) = (self.expected.width as f32, self.expected.height as f32);
        let (u, v) = (u.round_ties_even(), v.round_ties_even());
        let inside = u >= 0.0 && v >= 0.0 && u < w && v < h;
        inside.then(|| v as usize * self.expected.width + u as usize)
    }

    /// How far a point is from the plane of a pixel; `None` without a plane, or where its ray meets that too flatly.
    #[inline(always)]
    fn compare(&self, pixel: &ExpectedPixel, q: DVec3, range: f64, moved: &FramePoses) -> Option<Comparison> {
        let normal = pixel.normal.as_dvec3();
        let cos = normal.dot(q - moved.centre).abs() / range;
        // NaN where nothing is predicted.
        if !(cos >= FLATTEST) {
            return None;
        }
        // The noise is that of the range that is expected here: were it that of the measured one, points that noise has brought nearer would
        // weigh more than those that it has taken farther off.
        let noise = self.noise.variance_along_normal(f64::from(pixel.range), cos);
        let e = normal.dot(q) - f64::from(pixel.offset);
        Some(Comparison { normal, cos, e, noise, per_sigma: (noise + self.surface).max(self.least).sqrt().recip() })
    }

    /// The expected pixel that a point is compared with; [`NOWHERE`] without one.
    #[inline(always)]
    fn matched(&self, p: &MeasuredPoint, moved: &FramePoses, gate: &Gate) -> u32 {
        let q = moved.place(p);
        let m = moved.expected_from_now.transform_vector3(p.normal.as_dvec3());
        let range = f64::from(p.point.length());
        // Once outliers have no weight, what the point's own ray should meet comes first: of surfaces that are no farther apart than noise is
        // wide, the nearest one is the one that noise chose, which hides a part of every error. Where noise does not explain it, and the model may be
        // off, the nearest one is the best guess.
        if self.surface == 0.0
            && matches!(gate.kernel, Kernel::Redescending { .. })
            && let Some(at) = self.on_ray(q.as_vec3())
            && let Some(compared) = self.compare(&self.expected.pixels[at], q, range, moved)
            && compared.e * compared.e <= EXPLAINED * EXPLAINED * compared.noise
        {
            return at as u32;
        }
        let reach = gate.translation + gate.rotation * range;
        let (su, sv) = self.expected.spacing;
        let (lambda, range) = (reach as f32, range as f32);
        // Columns of a scanner are closer together the higher a beam looks.
        let across =
            if self.expected.sensor.is_camera() { range } else { p.point.truncate().length().max(0.1 * range) };
        let half = |spacing: f64, radius: f32| ((lambda / (radius * spacing as f32)).ceil() as i32).clamp(1, 1 << 12);
        let found = self.nearest(q.as_vec3(), m.as_vec3(), lambda * lambda, (half(su, across), half(sv, range)));
        found.map_or(NOWHERE, |at| at as u32)
    }

    /// Adds what a point says that is compared with the pixel `at`.
    #[inline(always)]
    fn add_point(&self, sum: &mut Sum, p: &MeasuredPoint, at: u32, moved: &FramePoses, gate: &Gate) {
        let q = moved.place(p);
        let range = f64::from(p.point.length());
        let reach = gate.translation + gate.rotation * range;
        let (su, sv) = self.expected.spacing;
        let constant = gate.kernel.most();
        let found = self.expected.pixels.get(at as usize);
        let is_other = self.only.is_some_and(|only| found.map(|pixel| pixel.object) != Some(only));
        if is_other || self.expected.is_uncertain(at as usize) {
            sum.others += 1;
            return;
        }
        let Some(pixel) = found else {
            sum.cost += constant;
            return;
        };
        let apart = pixel.point.distance_squared(q.as_vec3());
        let Some(compared) = self.compare(pixel, q, range, moved) else {
            sum.cost += constant;
            return;
        };
        let Comparison { normal, cos, e, noise, per_sigma } = compared;
        // A neighbour's point may be as far as the pixels are apart on the surface.
        let pitch = range * (if su.is_finite() { su } else { 0.0 }).max(if sv.is_finite() { sv } else { 0.0 });
        let within = 2.0 * pitch / cos + reach + 4.0 * self.noise.range_sigma(range);
        if !(f64::from(apart) <= within * within) {
            sum.cost += constant;
            return;
        }
        let normalized = e * per_sigma;
        sum.normalized.push(normalized.abs() as f32);
        let (weight, cost) = gate.kernel.weigh(normalized, reach * per_sigma);
        // What may not exist may have been matched to something else: its information is weighted by its existence.
        let existence = self.expected.existence(pixel.object);
        sum.cost += existence * cost + (1.0 - existence) * constant;
        sum.explained += usize::from(normalized.abs() <= EXPLAINED);
        let settles = matches!(gate.kernel, Kernel::Redescending { .. });
        let variance = (noise + self.surface).max(1e-12);
        if gate.finally && e * e <= WITHIN * WITHIN * variance {
            sum.deviation.add_point(e, noise, variance);
        }
        if weight == 0.0 || (settles && self.is_cut_off(pixel, &compared)) {
            return;
        }
        let w = existence * weight * per_sigma * per_sigma;
        // Where the ray meets the plane, not where noise has it: the product of a noisy lever and the noise itself is not zero in the mean.
        let q = if settles { q - (q - moved.centre) * (e / normal.dot(q - moved.centre)) } else { q };
        let turned = (q - moved.robot).cross(normal);
        let j = [normal.x, normal.y, normal.z, turned.x, turned.y, turned.z];
        for a in 0..6 {
            sum.gradient[a] += w * j[a] * e;
            for b in a..6 {
                sum.information[a][b] += w * j[a] * j[b];
            }
        }
        let late = f64::from(p.late);
        if late != 0.0 && (gate.finally || moved.twist.is_some()) {
            sum.late.add_point((w, w * weight, late), &j, e);
        }
        if gate.finally {
            for a in 0..6 {
                for b in a..6 {
                    sum.noise[a][b] += w * weight * j[a] * j[b];
                }
            }
            // An offset of the plane takes e down by as much, and so does an error of its object's pose.
            let group = match moved.origins.get(&pixel.object).filter(|_| self.only.is_none()) {
                Some(origin) => {
                    let group = sum.groups.entry(CommonError::Object(pixel.object)).or_default();
                    let g = ObjectError::gradient(*origin, q, normal);
                    for a in 0..6 {
                        (0..6).for_each(|b| group.pull[a][b] -= w * j[a] * g[b]);
                        (0..6).for_each(|b| group.late_pull[a][b] -= w * late * j[a] * g[b]);
                    }
                    group
                }
                None => {
                    let group = sum.groups.entry(CommonError::Offset(pixel.group)).or_default();
                    (0..6).for_each(|a| group.pull[a][0] -= w * j[a]);
                    (0..6).for_each(|a| group.late_pull[a][0] -= w * late * j[a]);
                    group
                }
            };
            group.weight += w;
            group.residual += w * e;
            group.variance += w * weight;
        }
    }
}

/// The least of numbers and the first place where it is. By halves, which become operations on many at once.
#[inline(always)]
fn least_of(all: &[f32; LANES]) -> (f32, usize) {
    let mut least = *all;
    let mut half = LANES / 2;
    while half > 0 {
        for k in 0..half {
            least[k] = if least[k + half] < least[k] { least[k + half] } else { least[k] };
        }
        half /= 2;
    }
    let mut places: [u32; LANES] = std::array::from_fn(|k| if all[k] <= least[0] { 1 << k } else { 0 });
    let mut half = LANES / 2;
    while half > 0 {
        (0..half).for_each(|k| places[k] |= places[k + half]);
        half /= 2;
    }
    (least[0], places[0].trailing_zeros() as usize)
}

/// A measured point and the plane of a pixel.
struct Comparison {
    normal: DVec3,
    /// Of the incidence.
    cos: f64,
    /// Distance from the plane, metres.
    e: f64,
    /// Its variance by the measurement's noise alone, square metres.
    noise: f64,
    /// 1 / its standard deviation, by all that is known.
    per_sigma: f64,
}

/// Where things are in the expected image's frame.
struct FramePoses {
    expected_from_now: DAffine3,
    centre: DVec3,
    robot: DVec3,
    /// Of the objects whose errors are stored; only where they are asked for.
    origins: BTreeMap<u32, DVec3>,
    /// The correction of the twist during the scan, if it is estimated: metres and radians per second.
    twist: Option<Twist>,
}

impl FramePoses {
    /// Where a point was when it was measured.
    #[inline(always)]
    fn place(&self, p: &MeasuredPoint) -> DVec3 {
        let q = self.expected_from_now.transform_point3(p.point.as_dvec3());
        match &self.twist {
            Some(twist) => q + f64::from(p.late) * (twist.linear + twist.angular.cross(q - self.robot)),
            None => q,
        }
    }
}

impl Residuals for RangeSource<'_> {
    fn linearize(&self, world_from_robot: &Pose, gate: &Gate) -> Normal {
        self.linearize_keeping(world_from_robot, None, gate, &mut Vec::new())
    }
}

impl RangeSource<'_> {
    /// [`Residuals::linearize`] with the pixels that the points were compared with before, in the order of the points that are
    /// looked at; they are looked for if there are none. `twist` is the correction of the twist during the scan, world axes, if
    /// it is estimated.
    pub(super) fn linearize_keeping(
        &self,
        world_from_robot: &Pose,
        twist: Option<&Vector>,
        gate: &Gate,
        matches: &mut Vec<u32>,
    ) -> Normal {
        let expected_from_world = self.expected.world_from_image.inverse();
        let now = expected_from_world * *world_from_robot * self.robot_from_image;
        let asked = self.expected.errors.iter().filter(|_| gate.finally);
        let moved = FramePoses {
            origins: asked.map(|(object, e)| (*object, expected_from_world.transform_point(e.origin))).collect(),
            expected_from_now: now.to_affine(),
            centre: now.translation,
            robot: expected_from_world.transform_point(world_from_robot.translation),
            twist: twist.map(|twist| {
                let [x, y, z, rx, ry, rz] = *twist;
                let turned = |v| expected_from_world.rotation * v;
                Twist::new(turned(DVec3::new(x, y, z)), turned(DVec3::new(rx, ry, rz)))
            }),
        };
        let step = self.points.len().div_ceil(gate.points).max(1);
        let count = self.points.len().div_ceil(step);
        let unmatched = matches.len() != count;
        matches.resize(count, NOWHERE);
        let one = |(points, matches): (&[MeasuredPoint], &mut [u32])| {
            pulp::Arch::new().dispatch(
                #[inline(always)]
                || {
                    let mut sum = Sum::default();
                    for (p, at) in points.iter().step_by(step).zip(matches) {
                        if unmatched {
                            *at = self.matched(p, &moved, gate);
                        }
                        self.add_point(&mut sum, p, *at, &moved, gate);
                    }
                    sum
                },
            )
        };
        let chunks = self.points.par_chunks(CHUNK * step).zip(matches.par_chunks_mut(CHUNK));
        let sums: Vec<Sum> = chunks.map(one).collect();
        self.put_together(sums, count)
    }

    /// Radians between neighbouring pixels.
    pub(super) fn pitch(&self) -> f64 {
        self.expected.spacing.0.min(self.expected.spacing.1)
    }

    /// Adds up in a fixed order and turns into world axes.
    fn put_together(&self, sums: Vec<Sum>, measured: usize) -> Normal {
        let mut total = Normal { measured, ..Normal::default() };
        let mut normalized = Vec::new();
        for sum in sums {
            add_to(&mut total.information, &sum.information);
            add_to(&mut total.noise, &sum.noise);
            (0..6).for_each(|i| total.gradient[i] += sum.gradient[i]);
            total.chi2 += sum.cost;
            total.explained += sum.explained;
            total.measured -= sum.others;
            total.deviation.add(&sum.deviation);
            total.late.add(&sum.late);
            normalized.extend(sum.normalized);
            for (shared, m) in sum.groups {
                total.groups.entry(shared).or_default().add(&m);
            }
        }
        total.compared = normalized.len();
        if !normalized.is_empty() {
            let step = normalized.len().div_ceil(SPREAD_POINTS);
            let mut normalized: Vec<f32> = normalized.into_iter().step_by(step).collect();
            total.spread = upper_median(&mut normalized, f32::total_cmp).map_or(0.0, f64::from);
        }
        let t = turn(self.expected.world_from_image.rotation);
        for m in [&mut total.information, &mut total.noise] {
            for a in 0..6 {
                (0..a).for_each(|b| m[a][b] = m[b][a]);
            }
            *m = sandwich(&t, m);
        }
        total.gradient = apply(&t, &total.gradient);
        total.late = total.late.turned(&t);
        for (shared, group) in &mut total.groups {
            for pull in [&mut group.pull, &mut group.late_pull] {
                *pull = match shared {
                    // The column of an offset is a number along the normal: it has no axes to turn.
                    CommonError::Offset(_) | CommonError::Edge(_) => product(&t, pull),
                    _ => sandwich(&t, pull),
                };
            }
        }
        if total.late != LateSums::default() {
            total.groups.extend(total.late.groups());
        }
        total
    }
}

impl Kernel {
    /// Weight, and cost in variances, of a residual in standard deviations. `wide` is the gate in standard deviations.
    pub(super) fn weigh(self, e: f64, wide: f64) -> (f64, f64) {
        match self {
            Self::Wide => {
                // Geman and McClure, as wide as the gate is, no narrower than the noise's own.
                let c2 = (2.0 * wide).max(TUKEY / 2.0).powi(2);
                let r = c2 / (c2 + e * e);
                (r * r, e * e * r)
            }
            Self::Redescending { spread } => {
                let c = TUKEY * spread;
                let t = (e / c).powi(2);
                if t >= 1.0 { (0.0, c * c / 6.0) } else { ((1.0 - t).powi(2), c * c / 6.0 * (1.0 - (1.0 - t).powi(3))) }
            }
        }
    }

    /// The cost of a point that is compared with nothing.
    pub(super) fn most(self) -> f64 {
        match self {
            Self::Wide => 0.0,
            Self::Redescending { spread } => (TUKEY * spread).powi(2) / 6.0,
        }
    }
}
