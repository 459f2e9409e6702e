//! Fits an object to measured points, and scores a pose by all views.

use crate::evidence::knowledge::Knowledge;
use crate::evidence::objects::{cell, cell_size};
use crate::observe::priors::own_bounds;
use crate::observe::terms::AXES;
use crate::observe::view::{KNOWN, MIN_COSINE, View};
use glam::{DQuat, DVec3};
use presight_localize::motion::{NormalEquations, motion_between, moved};
use presight_localize::verdict::ObjectError;
use presight_model::caster::{RayCaster, RayHit};
use presight_model::environment::Environment;
use presight_model::geometry::{Aabb, Pose};
use presight_model::statistics::NOISE_BOUND;
use std::collections::BTreeMap;

/// Maximum distances of points from the surface in the steps of a fit, metres.
const GATES: [f64; 12] = [0.4, 0.3, 0.3, 0.2, 0.2, 0.15, 0.1, 0.1, 0.06, 0.05, 0.04, 0.04];
/// Prior standard deviations of a move of an object on a floor: x, y, z in metres, roll, pitch, yaw in radians.
const FREE: [f64; 6] = [2.0, 2.0, 0.05, 0.03, 0.03, 1.0];
/// Standard deviation of a measured point in a fit, metres. It includes the pose's error, which the points of one view
/// share.
pub(crate) const POINT_SIGMA: f64 = 0.02;
/// Standard deviation of a fitted surface, metres.
pub(crate) const SURFACE_SIGMA: f64 = 0.005;
/// Minimum number of points on a judged cell of a fitted surface.
const MIN_POINTS: usize = 3;

/// The evidence of all views on an object at a pose.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Score {
    /// Log-odds that it stands there, against an empty place.
    pub l: f64,
    /// Views with evidence.
    pub views: u32,
    /// Pixels that confirm it.
    pub there: usize,
    /// Pixels that see through it.
    pub through: usize,
    /// Minimum of 0 and the log-odds of the cells of its surface.
    pub worst: f64,
}

impl Score {
    /// The confirmed share of its visible surface.
    pub fn share(&self) -> f64 {
        self.there as f64 / (self.there + self.through).max(1) as f64
    }
}

/// The fit of the points around a surface, cell by cell.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Fit {
    /// Cells whose mean point lies on the surface.
    pub on: usize,
    /// Cells whose mean point does not.
    pub off: usize,
    /// Sum over cells of the squared mean distance in variances.
    pub chi2: f64,
}

impl Fit {
    /// The share of the cells whose mean point lies on the surface.
    pub fn share(&self) -> f64 {
        self.on as f64 / (self.on + self.off).max(1) as f64
    }
}

/// The points on one cell, with sums over views of the weights and of the weighted mean distances.
#[derive(Clone, Copy, Default)]
struct CellSums {
    points: usize,
    weight: f64,
    sum: f64,
}

/// An object that is fitted.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Thing {
    pub object: u32,
    /// Centre of its bounds, in its frame, metres.
    pub middle: DVec3,
    /// Half of the diagonal of its bounds, metres.
    pub radius: f64,
}

impl Thing {
    pub fn new(environment: &Environment, object: u32) -> Self {
        let o = &environment.objects()[object as usize];
        Self::of_bounds(object, &own_bounds(o))
    }

    /// An object by its index and its bounds in its frame.
    pub fn of_bounds(object: u32, bounds: &Aabb) -> Self {
        Self { object, middle: bounds.center(), radius: 0.5 * bounds.size() }
    }

    /// Centre and radius of the ball around it at a pose, world, metres.
    pub fn ball(&self, pose: &Pose) -> (DVec3, f64) {
        (pose.transform_point(self.middle), self.radius)
    }
}

/// Fits objects to the points of all views.
pub(crate) struct Fitter<'a> {
    pub caster: &'a RayCaster,
    pub known: &'a Knowledge,
}

impl Fitter<'_> {
    /// Measured points in a ball that no other object explains, world frame, at most `max`.
    pub fn points_near(&self, middle: DVec3, radius: f64, object: u32, max: usize) -> Vec<DVec3> {
        let mut found = Vec::new();
        for view in &self.known.views {
            if view.origin().distance(middle) > view.pixels.sensor.spec().range_max + radius {
                continue;
            }
            found.extend(view.unexplained(object).filter(|p| p.distance(middle) <= radius));
        }
        let step = found.len().div_ceil(max.max(1)).max(1);
        found.into_iter().step_by(step).collect()
    }

    /// The pose that minimizes the distances of points from an object's surface, from a start: Gauss-Newton steps with
    /// falling gates. The object turns about its centre.
    pub fn slide(&self, thing: &Thing, start: &Pose, points: &[DVec3], gates: &[f64]) -> Pose {
        let start = Pose { translation: start.transform_point(thing.middle), ..*start };
        let mut pose = start;
        let mut free = [[0.0; 6]; 6];
        (0..6).for_each(|i| free[i][i] = FREE[i].powi(-2));
        for gate in gates {
            let mut equations = NormalEquations::default();
            let back = pose.inverse();
            for p in points {
                let q = back.transform_point(*p) + thing.middle;
                let Some(foot) = self.caster.nearest_on(thing.object, q, *gate) else { continue };
                let distance = foot.distance_squared.sqrt();
                let outward = q - foot.point;
                let n = pose.rotation * if distance > 1e-6 { outward / distance } else { foot.normal };
                let j = ObjectError::gradient(pose.translation, *p, n);
                let weight = (1.0 - (distance / gate).powi(2)).powi(2) / POINT_SIGMA.powi(2);
                equations.add(-distance, &j, weight);
            }
            pose = moved(&pose, &equations.step(&free, &motion_between(&start, &pose), &AXES).0);
        }
        Pose { translation: pose.translation - pose.rotation * thing.middle, ..pose }
    }

    /// True if the points around a pose fix it against sliding on the floor: each horizontal direction has at least 2 %
    /// of the squared normals. A long object without a visible end slides along itself. A single slice, as a planar
    /// scanner sees it, is an outline that other objects share.
    pub fn is_held(&self, thing: &Thing, pose: &Pose) -> bool {
        let points = self.points_near(pose.transform_point(thing.middle), thing.radius + 0.1, thing.object, 2000);
        let (back, mut sum, mut count, mut slice) = (pose.inverse(), [0.0; 3], 0.0, Aabb::EMPTY);
        for p in points {
            if let Some(foot) = self.caster.nearest_on(thing.object, back.transform_point(p), KNOWN) {
                let n = pose.rotation * foot.normal;
                slice = slice.with(p);
                (sum, count) = ([sum[0] + n.x * n.x, sum[1] + n.x * n.y, sum[2] + n.y * n.y], count + 1.0);
            }
        }
        let [xx, xy, yy] = sum;
        let smallest = 0.5 * (xx + yy) - (0.25 * (xx - yy).powi(2) + xy * xy).sqrt();
        count > 0.0 && smallest >= 0.02 * count && slice.max.z - slice.min.z >= 2.0 * KNOWN
    }

    /// The fit of the points around a pose to an object's surface. An object of another size or shape misses whole
    /// faces by more than the error of the mean of their points, although each point may be within its noise.
    pub fn fit(&self, thing: &Thing, pose: &Pose) -> Fit {
        let (middle, back, size) = (pose.transform_point(thing.middle), pose.inverse(), cell_size(2.0 * thing.radius));
        let mut cells: BTreeMap<(u8, [i32; 3]), CellSums> = BTreeMap::new();
        for view in &self.known.views {
            let range = view.origin().distance(middle);
            let noise = view.noise.range_sigma(range);
            let common = view.pose_sigma.0 + range * view.pose_sigma.1;
            let gate = KNOWN + NOISE_BOUND * noise;
            let mut own: BTreeMap<(u8, [i32; 3]), (usize, f64)> = BTreeMap::new();
            for p in view.unexplained(thing.object).filter(|p| p.distance(middle) <= thing.radius + gate) {
                let q = back.transform_point(p);
                let Some(foot) = self.caster.nearest_on(thing.object, q, gate) else { continue };
                let cell = own.entry(cell(foot.point, foot.normal, size)).or_default();
                *cell = (cell.0 + 1, cell.1 + (q - foot.point).dot(foot.normal));
            }
            for (key, (count, sum)) in own {
                let weight = 1.0 / (noise * noise / count as f64 + common * common);
                let cell = cells.entry(key).or_default();
                cell.points += count;
                (cell.weight, cell.sum) = (cell.weight + weight, cell.sum + weight * sum / count as f64);
            }
        }
        let mut fit = Fit::default();
        for cell in cells.values().filter(|cell| cell.points >= MIN_POINTS) {
            let share = (cell.sum / cell.weight).powi(2) / (1.0 / cell.weight + SURFACE_SIGMA * SURFACE_SIGMA);
            fit.chi2 += share;
            let is_on = share <= NOISE_BOUND * NOISE_BOUND;
            (fit.on, fit.off) = (fit.on + usize::from(is_on), fit.off + usize::from(!is_on));
        }
        fit
    }

    /// Log of the prior probability of a move. Because of it, each of two equal objects gets the nearer place.
    pub fn prior(&self, thing: &Thing, from: &Pose, to: &Pose) -> f64 {
        let about = |pose: &Pose| Pose { translation: pose.transform_point(thing.middle), ..*pose };
        let off = motion_between(&about(from), &about(to));
        -0.5 * off.iter().zip(FREE).map(|(x, sigma)| (x / sigma).powi(2)).sum::<f64>()
    }

    /// The share of points within some metres of an object at a pose.
    pub fn explained(&self, object: u32, pose: &Pose, points: &[DVec3], within: f64) -> f64 {
        let back = pose.inverse();
        let on = |p: &&DVec3| self.caster.nearest_on(object, back.transform_point(**p), within).is_some();
        points.iter().filter(on).count() as f64 / points.len().max(1) as f64
    }

    /// The best pose for a group of points, from several starts, and the share of the points that it explains. Each
    /// start has the centre of the object above or below that of the points.
    pub fn best(&self, thing: &Thing, from: &Pose, middle: DVec3, points: &[DVec3]) -> (Pose, f64) {
        let few: Vec<DVec3> = points.iter().copied().step_by(points.len().div_ceil(150).max(1)).collect();
        let mut best = (*from, -1.0);
        for degrees in [0.0f64, 20.0, -20.0, 40.0, -40.0, 90.0, -90.0, 180.0] {
            let turn = DQuat::from_rotation_z(degrees.to_radians());
            let rotation = turn * from.rotation;
            // The centre of the bounds keeps its height, which the fit corrects.
            let place = middle.with_z(from.transform_point(thing.middle).z);
            let start = Pose { translation: place - rotation * thing.middle, rotation };
            let end = self.slide(thing, &start, &few, &GATES);
            let share = self.explained(thing.object, &end, &few, 0.04);
            if share > best.1 + 0.02 {
                best = (end, share);
            }
        }
        best
    }

    /// Refines a pose by all points around it.
    pub fn settle(&self, thing: &Thing, start: &Pose) -> Pose {
        let mut pose = *start;
        for gates in [&[0.1, 0.08, 0.06][..], &[0.05, 0.05, 0.05, 0.05]] {
            let points = self.points_near(pose.transform_point(thing.middle), thing.radius + 0.1, thing.object, 3000);
            pose = self.slide(thing, &pose, &points, gates);
        }
        pose
    }

    /// The evidence of the views on an object at a pose, by the pixels whose range would differ without it.
    pub fn score(&self, thing: &Thing, pose: &Pose) -> Score {
        let (mut score, (middle, radius)) = (Score::default(), thing.ball(pose));
        let (back, size) = (pose.inverse(), cell_size(2.0 * radius));
        let mut cells: BTreeMap<(u8, [i32; 3]), f64> = BTreeMap::new();
        let max = self.known.options.max_per_view;
        let limit = |sum: f64| sum.clamp(-max, max);
        for view in &self.known.views {
            if view.origin().distance(middle) > view.reach() + radius {
                continue;
            }
            let (mut sum, mut of_cells) = (0.0, BTreeMap::<(u8, [i32; 3]), f64>::new());
            for (at, ray) in view.pixels.rays_at(view.world_from_image, (middle, radius)) {
                let Some((is_there, hit)) = self.is_there(view, thing.object, pose, (ray, view.ranges[at])) else {
                    continue;
                };
                score.there += usize::from(is_there);
                score.through += usize::from(!is_there);
                let sign = if is_there { 1.0 } else { -1.0 };
                sum += sign;
                let p = back.transform_point(view.origin() + hit.range * ray);
                *of_cells.entry(cell(p, back.rotation * hit.normal, size)).or_default() += sign;
            }
            of_cells.into_iter().for_each(|(key, sum)| *cells.entry(key).or_default() += limit(sum));
            if sum != 0.0 {
                score.views += 1;
                score.l += limit(sum);
            }
        }
        score.worst = cells.into_values().fold(0.0, f64::min);
        score
    }

    /// The hit of a ray (world frame) on an object at a pose, and true if the reading confirms it, false if it is
    /// farther. `None` if the reading does not decide.
    fn is_there(&self, view: &View, object: u32, pose: &Pose, (ray, z): (DVec3, f32)) -> Option<(bool, RayHit)> {
        let z = f64::from(z);
        if z.is_nan() {
            return None;
        }
        let hit = self.caster.cast_at(object, pose, (view.origin(), ray, view.reach()))?;
        let cos = hit.normal.dot(ray).abs();
        let sigma = pixel_sigma(view, hit.range, cos);
        if cos < 0.2 || z < hit.range - NOISE_BOUND * sigma {
            return None;
        }
        let other = self.caster.cast(view.origin(), ray, hit.range + 2.0 * NOISE_BOUND * sigma, Some(object));
        other.is_none().then_some((z <= hit.range + NOISE_BOUND * sigma, hit))
    }
}

/// Standard deviation of a range to a fitted surface at a cosine of the incidence, metres.
pub(crate) fn pixel_sigma(view: &View, range: f64, cos: f64) -> f64 {
    let angle = view.pose_sigma.1 + view.noise.angle * (1.0 - cos * cos).max(0.0).sqrt();
    let offset = view.pose_sigma.0 + range * angle;
    view.noise.range_sigma(range) + (offset + SURFACE_SIGMA) / cos.max(MIN_COSINE)
}
