//! Fits an object to measured points, and asks all views whether it stands there.

use crate::evidence::{cell, cell_size};
use crate::view::{BOUND, View};
use glam::{DQuat, DVec3};
use presight_localize::motion::moved;
use presight_model::caster::RayCaster;
use presight_model::environment::Environment;
use presight_model::geometry::{Aabb, Pose};
use presight_model::matrix::{add_to, apply, inverse};
use std::collections::BTreeMap;

/// How far an object may be off where its fit starts, metres, and where it ends.
const GATES: [f64; 12] = [0.4, 0.3, 0.3, 0.2, 0.2, 0.15, 0.1, 0.1, 0.06, 0.05, 0.04, 0.04];
/// The prior of a move, one standard deviation: metres along x and y and along z, radians of
/// roll and pitch and of yaw. Things stand on floors.
const FREE: [f64; 6] = [2.0, 2.0, 0.05, 0.03, 0.03, 1.0];
/// Standard deviation of a measured point in a fit, metres: with the pose's error, which points of one view share.
const POINT: f64 = 0.02;
/// A fitted surface is known no better than this, one standard deviation, metres.
const SURFACE: f64 = 0.005;
/// Points farther than noise and this from a fitted surface belong to something else, metres.
const BESIDE: f64 = 0.05;
/// The heights at which a thing is seen span this, metres: twice [`BESIDE`].
const SLICE: f64 = 0.1;
/// Points that a cell of a fitted surface needs to be judged.
const LEAST_POINTS: usize = 3;

/// What the views say of an object at a pose.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Score {
    /// Logarithm of the odds that it stands there, against nothing.
    pub l: f64,
    /// Views that said something.
    pub views: u32,
    /// Pixels that saw it, and pixels that saw through it.
    pub there: usize,
    pub through: usize,
    /// The odds of the cell of its surface that is the least sure to be there, logarithm.
    pub worst: f64,
}

impl Score {
    /// The share of its surface that is seen and is there.
    pub fn share(&self) -> f64 {
        self.there as f64 / (self.there + self.through).max(1) as f64
    }
}

/// How the points around a fitted surface lie on it, cell by cell.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Fit {
    /// Cells whose points lie on the surface in the mean, and cells whose points do not.
    pub on: usize,
    pub off: usize,
    /// Sum over cells of the squared mean distance in units of its variance.
    pub chi2: f64,
}

impl Fit {
    /// The share of the cells whose points lie on the surface.
    pub fn share(&self) -> f64 {
        self.on as f64 / (self.on + self.off).max(1) as f64
    }
}

/// The points on one cell: their number, and sums of weights and of weighted mean distances of each view.
#[derive(Clone, Copy, Default)]
struct OnCell {
    points: usize,
    weight: f64,
    sum: f64,
}

/// An object that is fitted.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Thing {
    pub object: u32,
    /// The middle of its bounds, in its frame, metres.
    pub middle: DVec3,
    /// Half of the diagonal of its bounds, metres.
    pub radius: f64,
}

impl Thing {
    pub fn new(environment: &Environment, object: u32) -> Self {
        let o = &environment.objects()[object as usize];
        Self::of_bounds(object, &o.mesh.bounds().transformed(&o.object_from_mesh))
    }

    /// A thing by its number and its bounds in its frame.
    pub fn of_bounds(object: u32, bounds: &Aabb) -> Self {
        Self { object, middle: bounds.center(), radius: 0.5 * bounds.size() }
    }
}

/// Fits objects with the views of a drive.
pub(crate) struct Fitter<'a> {
    pub caster: &'a RayCaster,
    pub views: Vec<&'a View>,
    /// Most that a view counts.
    pub most_per_view: f64,
}

impl Fitter<'_> {
    /// Measured points near a place that no other object explains, world frame, at most `most`.
    pub fn points_near(&self, middle: DVec3, radius: f64, object: u32, most: usize) -> Vec<DVec3> {
        let mut found = Vec::new();
        for view in &self.views {
            if view.world_from_image.translation.distance(middle) > view.kept.sensor.spec().range_max + radius {
                continue;
            }
            found.extend(view.unexplained(object).filter(|p| p.distance(middle) <= radius));
        }
        let step = found.len().div_ceil(most.max(1)).max(1);
        found.into_iter().step_by(step).collect()
    }

    /// The pose that a thing slides to from a start, by points: Gauss and Newton on their distances to its surface, with a
    /// gate that closes. It turns about its middle.
    pub fn slide(&self, thing: &Thing, start: &Pose, points: &[DVec3], gates: &[f64]) -> Pose {
        let start = Pose { translation: start.transform_point(thing.middle), ..*start };
        let mut pose = start;
        let mut free = [[0.0; 6]; 6];
        (0..6).for_each(|i| free[i][i] = FREE[i].powi(-2));
        for gate in gates {
            let (mut information, mut gradient) = ([[0.0; 6]; 6], [0.0; 6]);
            let back = pose.inverse();
            for p in points {
                let q = back.transform_point(*p) + thing.middle;
                let Some(foot) = self.caster.nearest_on(thing.object, q, *gate) else { continue };
                let distance = foot.distance_squared.sqrt();
                let outward = q - foot.point;
                let n = pose.rotation * if distance > 1e-6 { outward / distance } else { foot.normal };
                let turned = (*p - pose.translation).cross(n);
                let j = [n.x, n.y, n.z, turned.x, turned.y, turned.z];
                let weight = (1.0 - (distance / gate).powi(2)).powi(2) / POINT.powi(2);
                for a in 0..6 {
                    gradient[a] += weight * distance * j[a];
                    (0..6).for_each(|b| information[a][b] += weight * j[a] * j[b]);
                }
            }
            let off = presight_localize::motion::motion_between(&start, &pose);
            (0..6).for_each(|i| gradient[i] -= free[i][i] * off[i]);
            add_to(&mut information, &free);
            let step = apply(&inverse(&information, &[0, 1, 2, 3, 4, 5]), &gradient);
            pose = moved(&pose, &step);
        }
        Pose { translation: pose.translation - pose.rotation * thing.middle, ..pose }
    }

    /// True if points around a pose hold it against sliding on the floor: in no horizontal direction do fewer than 2 % of
    /// the normals count. A long thing without a visible end slides along itself. One slice of it, as a planar scanner sees it, is an
    /// outline that other things have, too.
    pub fn is_held(&self, thing: &Thing, pose: &Pose) -> bool {
        let points = self.points_near(pose.transform_point(thing.middle), thing.radius + 0.1, thing.object, 2000);
        let (back, mut sum, mut count, mut slice) = (pose.inverse(), [0.0; 3], 0.0, Aabb::EMPTY);
        for p in points {
            if let Some(foot) = self.caster.nearest_on(thing.object, back.transform_point(p), 0.05) {
                let n = pose.rotation * foot.normal;
                slice = slice.with(p);
                (sum, count) = ([sum[0] + n.x * n.x, sum[1] + n.x * n.y, sum[2] + n.y * n.y], count + 1.0);
            }
        }
        let [xx, xy, yy] = sum;
        let least = 0.5 * (xx + yy) - (0.25 * (xx - yy).powi(2) + xy * xy).sqrt();
        count > 0.0 && least >= 0.02 * count && slice.max.z - slice.min.z >= SLICE
    }

    /// How the points around a pose lie on an object's surface. A thing of another size or shape leaves whole faces off, by more
    /// than the mean of their points may err; its points one by one may still be within their noise.
    pub fn fit(&self, thing: &Thing, pose: &Pose) -> Fit {
        let (middle, back, size) = (pose.transform_point(thing.middle), pose.inverse(), cell_size(2.0 * thing.radius));
        let mut cells: BTreeMap<(u8, [i32; 3]), OnCell> = BTreeMap::new();
        for view in &self.views {
            let range = view.world_from_image.translation.distance(middle);
            let noise = view.noise.range_sigma(range);
            let common = view.off.0 + range * view.off.1;
            let gate = BESIDE + BOUND * noise;
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
        for cell in cells.values().filter(|cell| cell.points >= LEAST_POINTS) {
            let share = (cell.sum / cell.weight).powi(2) / (1.0 / cell.weight + SURFACE * SURFACE);
            fit.chi2 += share;
            let is_on = share <= BOUND * BOUND;
            (fit.on, fit.off) = (fit.on + usize::from(is_on), fit.off + usize::from(!is_on));
        }
        fit
    }

    /// Logarithm of how probable a move is, by the prior of the fits: of two equal things, each is moved to the nearer place.
    pub fn prior(&self, thing: &Thing, from: &Pose, to: &Pose) -> f64 {
        let about = |pose: &Pose| Pose { translation: pose.transform_point(thing.middle), ..*pose };
        let off = presight_localize::motion::motion_between(&about(from), &about(to));
        -0.5 * off.iter().zip(FREE).map(|(x, sigma)| (x / sigma).powi(2)).sum::<f64>()
    }

    /// The share of points that lie on an object at a pose.
    pub fn explained(&self, object: u32, pose: &Pose, points: &[DVec3], within: f64) -> f64 {
        let back = pose.inverse();
        let on = |p: &&DVec3| self.caster.nearest_on(object, back.transform_point(**p), within).is_some();
        points.iter().filter(on).count() as f64 / points.len().max(1) as f64
    }

    /// The best pose among several starts around a place, for a group of points. Each start has the middle of the object's
    /// bounds over the middle of the points.
    pub fn best(&self, thing: &Thing, from: &Pose, middle: DVec3, points: &[DVec3]) -> (Pose, f64) {
        let few: Vec<DVec3> = points.iter().copied().step_by(points.len().div_ceil(150).max(1)).collect();
        let mut best = (*from, -1.0);
        for degrees in [0.0f64, 20.0, -20.0, 40.0, -40.0, 90.0, -90.0, 180.0] {
            let turn = DQuat::from_rotation_z(degrees.to_radians());
            let rotation = turn * from.rotation;
            // The middle of the bounds keeps its height; the fit settles the rest.
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

    /// Settles a pose by all points around it.
    pub fn settle(&self, thing: &Thing, start: &Pose) -> Pose {
        let mut pose = *start;
        for gates in [&[0.1, 0.08, 0.06][..], &[0.05, 0.05, 0.05, 0.05]] {
            let points = self.points_near(pose.transform_point(thing.middle), thing.radius + 0.1, thing.object, 3000);
            pose = self.slide(thing, &pose, &points, gates);
        }
        pose
    }

    /// Asks the views whether an object stands at a pose: pixels that see it, and pixels that see through it, where without
    /// it something else would be measured.
    pub fn score(&self, thing: &Thing, pose: &Pose) -> Score {
        let Thing { object, middle, radius } = *thing;
        let (mut score, middle) = (Score::default(), pose.transform_point(middle));
        let (back, size) = (pose.inverse(), cell_size(2.0 * radius));
        let mut cells: BTreeMap<(u8, [i32; 3]), f64> = BTreeMap::new();
        for view in &self.views {
            let p = view.world_from_image.inverse().transform_point(middle);
            let (distance, reach) = (p.length(), view.kept.sensor.spec().range_max.min(1e5));
            if distance > reach + radius {
                continue;
            }
            let (toward, wide) = (p / distance, (radius / distance.max(radius)).asin());
            let cone = wide.cos();
            let (mut sum, mut of_cells) = (0.0, BTreeMap::<(u8, [i32; 3]), f64>::new());
            for (at, ray) in view.kept.rays.iter().enumerate().filter(|(_, ray)| ray.dot(toward) >= cone) {
                let z = f64::from(view.ranges[at]);
                if z.is_nan() {
                    continue;
                }
                let (origin, ray) = (view.world_from_image.translation, view.world_from_image.rotation * *ray);
                let Some(met) = self.caster.cast_at(object, pose, (origin, ray, reach)) else { continue };
                let cos = met.normal.dot(ray).abs();
                let off = view.off.0 + met.range * (view.off.1 + view.noise.angle * (1.0 - cos * cos).sqrt());
                let sigma = view.noise.range_sigma(met.range) + (off + 0.005) / cos.max(0.1);
                if cos < 0.2 || z < met.range - BOUND * sigma {
                    continue;
                }
                let other = self.caster.cast(origin, ray, met.range + 2.0 * BOUND * sigma, Some(object));
                if other.is_some() {
                    continue;
                }
                let there = z <= met.range + BOUND * sigma;
                (score.there, score.through) = (score.there + usize::from(there), score.through + usize::from(!there));
                let sign = if there { 1.0 } else { -1.0 };
                sum += sign;
                let p = back.transform_point(origin + met.range * ray);
                *of_cells.entry(cell(p, back.rotation * met.normal, size)).or_default() += sign;
            }
            let most = self.most_per_view;
            of_cells.into_iter().for_each(|(key, sum)| *cells.entry(key).or_default() += sum.clamp(-most, most));
            if sum != 0.0 {
                score.views += 1;
                score.l += f64::clamp(sum, -self.most_per_view, self.most_per_view);
            }
        }
        score.worst = cells.into_values().fold(0.0, f64::min);
        score
    }
}
