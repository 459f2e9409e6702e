//! The poses of objects, estimated jointly from all views.
//!
//! The residual e of a reading on an object o in a view v satisfies e + J_v x_v - J_o d_o = noise, with a small motion
//! x_v of the view's pose and a small motion d_o of the object. All views may share one error of their poses. Therefore
//! the stated covariance of a pose is used only once for all views, and each view determines the poses of its objects
//! relative to each other. Eliminating each x_v by a Schur complement leaves normal equations of the objects alone.

use crate::observe::priors::Priors;
use crate::observe::terms::{AXES, ObjectTerms, Terms};
use presight_model::matrix::{Matrix, add_to, apply, inverse, product, scaled, transposed};
use std::collections::{BTreeMap, BTreeSet};

/// Maximum number of objects whose poses are estimated, because their equations are dense. Further objects are left
/// out.
const MAX_OBJECTS: usize = 300;
/// Ratio of the prior deviation of an object that may have moved to the stated deviation.
const LOOSE: f64 = 100.0;

/// Normal equations of all objects.
#[derive(Clone, Debug, Default)]
pub(crate) struct Joint {
    /// By pair of objects, the smaller index first.
    information: BTreeMap<(u32, u32), Matrix>,
    gradient: BTreeMap<u32, [f64; 6]>,
    /// Number of views of each object.
    views: BTreeMap<u32, u32>,
}

/// The estimated motion of one object from its stated pose.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct ObjectMotion {
    pub views: u32,
    /// About the centre of the object, world axes: metres, radians.
    pub motion: [f64; 6],
    pub covariance: Matrix,
}

fn minus(a: &mut [f64; 6], b: &[f64; 6]) {
    (0..6).for_each(|i| a[i] -= b[i]);
}

impl Joint {
    /// Adds a view.
    pub fn add(&mut self, terms: &Terms) {
        let known = |views: &mut BTreeMap<u32, u32>, object| views.len() < MAX_OBJECTS || views.contains_key(&object);
        let mut on: Vec<&ObjectTerms> = Vec::new();
        for of in &terms.objects {
            if known(&mut self.views, of.object) {
                *self.views.entry(of.object).or_default() += 1;
                on.push(of);
            }
        }
        let (mut c, mut pull) = (terms.information, terms.pull);
        for of in &on {
            add_to(&mut c, &of.view);
            (0..6).for_each(|i| pull[i] += of.of_view[i]);
        }
        let inverse = inverse(&c, &terms.axes);
        for (at, a) in on.iter().enumerate() {
            let gain = product(&a.mixed, &inverse);
            let gradient = self.gradient.entry(a.object).or_default();
            (0..6).for_each(|i| gradient[i] += a.of_object[i]);
            minus(gradient, &apply(&gain, &pull));
            add_to(self.information.entry((a.object, a.object)).or_default(), &a.own);
            for b in &on[at..] {
                let (pair, block) = if a.object <= b.object {
                    ((a.object, b.object), product(&gain, &transposed(&b.mixed)))
                } else {
                    ((b.object, a.object), transposed(&product(&gain, &transposed(&b.mixed))))
                };
                add_to(self.information.entry(pair).or_default(), &scaled(&block, -1.0));
            }
        }
    }

    /// The motions of the objects by all views. An object that is not `standing` may be anywhere. Estimates of poses
    /// take the errors of objects as independent, so the covariances are widened by the effect of their correlations in
    /// `views`.
    pub fn solve<'a>(
        &self,
        priors: &Priors,
        standing: &BTreeSet<u32>,
        views: impl Iterator<Item = &'a Terms>,
    ) -> BTreeMap<u32, ObjectMotion> {
        let order: Vec<u32> = self.views.keys().copied().filter(|object| priors.get(*object).is_some()).collect();
        let n = 6 * order.len();
        let mut a = vec![0.0; n * n];
        for (at, object) in order.iter().enumerate() {
            let prior = priors.get(*object).map_or([[0.0; 6]; 6], |prior| prior.covariance);
            let wide = if standing.contains(object) { 1.0 } else { LOOSE };
            let known = inverse(&scaled(&prior, wide * wide), &AXES);
            for (other_at, other) in order.iter().enumerate().take(at + 1) {
                let mut block = self.information.get(&(*other, *object)).map_or([[0.0; 6]; 6], transposed);
                if at == other_at {
                    add_to(&mut block, &known);
                    // An axis without variance is exact.
                    (0..6).filter(|i| prior[*i][*i] <= 0.0).for_each(|i| block[i][i] += 1e18);
                }
                for i in 0..6 {
                    (0..6).for_each(|j| a[(6 * at + i) * n + 6 * other_at + j] = block[i][j]);
                }
            }
        }
        invert(&mut a, n);
        let solution = Solution { order: &order, covariance: &a, standing };
        let widening = solution.widening(views);
        let gradient: Vec<f64> = order.iter().flat_map(|o| self.gradient.get(o).copied().unwrap_or_default()).collect();
        let of = |(at, object): (usize, &u32)| {
            let motion = std::array::from_fn(|i| {
                let row = 6 * at + i;
                (0..n).map(|k| a[row.max(k) * n + row.min(k)] * gradient[k]).sum()
            });
            let covariance = scaled(&solution.block(at, at), widening);
            (*object, ObjectMotion { views: self.views[object], motion, covariance })
        };
        order.iter().enumerate().map(of).filter(|(object, _)| standing.contains(object)).collect()
    }
}

/// The covariance of all motions; only the lower triangle is used.
struct Solution<'a> {
    order: &'a [u32],
    covariance: &'a [f64],
    standing: &'a BTreeSet<u32>,
}

impl Solution<'_> {
    fn block(&self, row: usize, column: usize) -> Matrix {
        let n = 6 * self.order.len();
        let at = |i: usize, j: usize| self.covariance[i.max(j) * n + i.min(j)];
        std::array::from_fn(|i| std::array::from_fn(|j| at(6 * row + i, 6 * column + j)))
    }

    /// Mean ratio over views of the variance that the objects' errors add to a pose to its value for independent
    /// errors. Layers hold one covariance per object, and estimates take them as independent, but the errors of objects
    /// in the same view are correlated.
    fn widening<'a>(&self, views: impl Iterator<Item = &'a Terms>) -> f64 {
        let (mut sum, mut count) = (0.0, 0.0f64);
        for view in views {
            let place = |of: &&ObjectTerms| self.order.binary_search(&of.object).ok();
            let known = view.objects.iter().filter(|of| self.standing.contains(&of.object));
            let pulls: Vec<(usize, &Matrix)> = known.filter_map(|of| Some((place(&of)?, &of.pull))).collect();
            let (mut alone, mut together) = ([[0.0; 6]; 6], [[0.0; 6]; 6]);
            for (i, a) in &pulls {
                for (j, b) in &pulls {
                    let part = product(&product(a, &self.block(*i, *j)), &transposed(b));
                    add_to(&mut together, &part);
                    if i == j {
                        add_to(&mut alone, &part);
                    }
                }
            }
            let back = inverse(&alone, &view.axes);
            let ratio = product(&back, &together);
            let all = product(&back, &alone);
            let trace = |m: &Matrix| (0..6).map(|i| m[i][i]).sum::<f64>();
            // This trace is the number of axes that the view determines.
            if trace(&all) > 0.5 {
                (sum, count) = (sum + trace(&ratio) / trace(&all), count + 1.0);
            }
        }
        if count > 0.0 { (sum / count).max(1.0) } else { 1.0 }
    }
}

/// Inverts a symmetric positive definite matrix in place, by sweeps; only its lower triangle is used.
fn invert(a: &mut [f64], n: usize) {
    let mut column = vec![0.0; n];
    for k in 0..n {
        let pivot = 1.0 / a[k * n + k];
        (0..n).for_each(|i| column[i] = a[i.max(k) * n + i.min(k)]);
        column[k] = 0.0;
        for i in 0..n {
            let factor = column[i] * pivot;
            if factor != 0.0 {
                let row = &mut a[i * n..=i * n + i];
                row.iter_mut().zip(&column).for_each(|(x, c)| *x -= factor * c);
            }
        }
        for i in 0..n {
            a[i.max(k) * n + i.min(k)] = column[i] * pivot;
        }
        a[k * n + k] = -pivot;
    }
    a.iter_mut().for_each(|x| *x = -*x);
}

#[cfg(test)]
mod tests {
    use super::*;
    use presight_model::environment::Environment;
    use presight_model::geometry::{Pose, PoseCovariance};
    use presight_model::world::World;

    /// Two crates whose x has a deviation of 1 m; their other coordinates are exact.
    fn world() -> World {
        let mut environment = Environment::new();
        for name in ["a", "b"] {
            environment.add_cuboid(name, Pose::IDENTITY, glam::DVec3::ONE).unwrap();
        }
        let mut world = World::new(environment);
        for object in ["a", "b"] {
            let covariance = Some(PoseCovariance::from_sigmas([1.0, 0.0, 0.0, 0.0, 0.0, 0.0]));
            let (class, object) = ("laser".to_owned(), object.to_owned());
            world.apply(presight_model::change::Change::SetPoseCovariance { class, object, covariance }).unwrap();
        }
        world
    }

    /// A view of both from an unknown place, with one reading of unit variance on each.
    fn view(residuals: [f64; 2]) -> Terms {
        let mut one = [[0.0; 6]; 6];
        one[0][0] = 1.0;
        let of = |(object, e): (u32, f64)| {
            let sum = [e, 0.0, 0.0, 0.0, 0.0, 0.0];
            ObjectTerms { object, own: one, mixed: one, view: one, pull: one, of_object: sum, of_view: sum }
        };
        Terms { objects: (0..).zip(residuals).map(of).collect(), axes: vec![0], ..Terms::default() }
    }

    /// By hand: the residuals put the crates 2 m farther apart, with a variance of 2. The prior variance of their
    /// distance is also 2. The result is 1 m, one half for each, with a variance of 1. The sum keeps its variance of 2,
    /// so each crate has a variance of 3/4, and their covariance is 1/4. A pose that averages both has a variance of
    /// (3/4 + 3/4 + 1/4 + 1/4) / 4. Independent errors would give (3/4 + 3/4) / 4. The ratio is 4/3.
    #[test]
    fn views_determine_poses_of_objects_relative_to_each_other() {
        let world = world();
        let priors = Priors::of(world.environment(), "laser", 0.0);
        let mut joint = Joint::default();
        joint.add(&view([0.0, 2.0]));
        let standing = BTreeSet::from([0, 1]);
        let alone = joint.solve(&priors, &standing, std::iter::empty());
        assert!((alone[&0].motion[0] + 0.5).abs() < 1e-9 && (alone[&1].motion[0] - 0.5).abs() < 1e-9, "{alone:?}");
        assert!((alone[&0].covariance[0][0] - 0.75).abs() < 1e-9, "{alone:?}");
        let wide = joint.solve(&priors, &standing, std::iter::once(&view([0.0, 2.0])));
        assert!((wide[&0].covariance[0][0] - 0.75 * 4.0 / 3.0).abs() < 1e-9, "{wide:?}");
        // An object that may have moved does not affect the other.
        let one = joint.solve(&priors, &BTreeSet::from([0]), std::iter::empty());
        assert!(one.len() == 1 && one[&0].motion[0].abs() < 1e-3, "{one:?}");
        assert!((one[&0].covariance[0][0] - 1.0).abs() < 1e-3, "{one:?}");
    }

    /// The inverse of [[4, 2], [2, 3]] is [[3, -2], [-2, 4]] / 8.
    #[test]
    fn a_matrix_is_inverted() {
        let mut a = [4.0, 0.0, 2.0, 3.0];
        invert(&mut a, 2);
        assert!((a[0] - 3.0 / 8.0).abs() < 1e-12 && (a[2] + 0.25).abs() < 1e-12 && (a[3] - 0.5).abs() < 1e-12, "{a:?}");
    }
}
