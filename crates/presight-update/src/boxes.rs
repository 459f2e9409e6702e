//! The box around a group of points: upright, turned to be smallest.

use glam::{DQuat, DVec2, DVec3};
use presight_model::geometry::Pose;
use presight_model::statistics::quantile;

/// Steps of a quarter turn.
const TURNS: usize = 45;
/// Share of the points that may stick out on each side.
const OUT: f64 = 0.005;
/// A box is never thinner, metres.
const THINNEST: f64 = 0.02;

/// An upright box.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct UprightBox {
    /// The pose of its middle; its axes are its edges.
    pub pose: Pose,
    /// Its edges, metres.
    pub size: DVec3,
}

impl UprightBox {
    /// The smallest upright box that holds all but a few of the points, metres. Without points it is a point.
    pub fn of(points: &[DVec3]) -> Self {
        let extent =
            |values: &mut Vec<f64>| (quantile(values, OUT).unwrap_or(0.0), quantile(values, 1.0 - OUT).unwrap_or(0.0));
        let sides = |angle: f64| {
            let (x, y) = (DVec2::from_angle(angle), DVec2::from_angle(angle).perp());
            [x, y].map(|axis| extent(&mut points.iter().map(|p| p.truncate().dot(axis)).collect()))
        };
        let area = |[(a, b), (c, d)]: [(f64, f64); 2]| (b - a + THINNEST) * (d - c + THINNEST);
        let turn = |step: usize| step as f64 / TURNS as f64 * std::f64::consts::FRAC_PI_2;
        let best = (0..TURNS).map(turn).min_by(|a, b| area(sides(*a)).total_cmp(&area(sides(*b)))).unwrap_or(0.0);
        let ([(a, b), (c, d)], (low, high)) = (sides(best), extent(&mut points.iter().map(|p| p.z).collect()));
        let rotation = DQuat::from_rotation_z(best);
        let middle = rotation * DVec3::new(0.5 * (a + b), 0.5 * (c + d), 0.5 * (low + high));
        let size = DVec3::new(b - a, d - c, high - low).max(DVec3::splat(THINNEST));
        Self { pose: Pose { translation: middle, rotation }, size }
    }

    /// True if it holds a point, or misses it by at most `slack` metres.
    pub fn holds(&self, p: DVec3, slack: f64) -> bool {
        let q = self.pose.inverse().transform_point(p).abs();
        q.cmple(0.5 * self.size + slack).all()
    }

    /// Where a ray from outside along the unit `ray` meets it: the range, metres, and the cosine of the incidence.
    pub(crate) fn meet(&self, origin: DVec3, ray: DVec3) -> Option<(f64, f64)> {
        let back = self.pose.inverse();
        let (origin, ray) = (back.transform_point(origin), back.rotation * ray);
        let (a, b) = ((-0.5 * self.size - origin) / ray, (0.5 * self.size - origin) / ray);
        // NaN, where a ray runs in a side, is ignored by min and max.
        let (near, far) = (a.min(b), a.max(b));
        let (enter, leave) = (near.x.max(near.y).max(near.z), far.x.min(far.y).min(far.z));
        let axis = (0..3).find(|axis| near[*axis] == enter)?;
        (enter > 0.0 && enter <= leave).then(|| (enter, ray[axis].abs()))
    }
}

/// Two boxes take the place of one if they hold at most this share of its volume.
const SPLIT: f64 = 0.6;
/// Places along an edge where a box may be cut.
const CUTS: usize = 8;
/// Fewest points of a box.
const FEWEST: usize = 20;
/// Times that points are split in two.
const DEEPEST: usize = 3;

/// Points in several sets whose boxes are together much smaller than one box around all: things that touch, and concave things.
pub(crate) fn split(points: Vec<DVec3>) -> Vec<Vec<DVec3>> {
    split_to(points, DEEPEST)
}

fn split_to(points: Vec<DVec3>, depth: usize) -> Vec<Vec<DVec3>> {
    let volume = |points: &[DVec3]| {
        let size = UprightBox::of(points).size + THINNEST;
        size.x * size.y * size.z
    };
    let whole = UprightBox::of(&points);
    let back = whole.pose.inverse();
    let cut = |axis: usize, share: f64| -> [Vec<DVec3>; 2] {
        let at = (share - 0.5) * whole.size[axis];
        let (a, b) = points.iter().partition(|p| back.transform_point(**p)[axis] < at);
        [a, b]
    };
    let cuts = (0..3).flat_map(|axis| (1..CUTS).map(move |k| (axis, k as f64 / CUTS as f64)));
    let few: Vec<[Vec<DVec3>; 2]> =
        if depth == 0 { Vec::new() } else { cuts.map(|(axis, at)| cut(axis, at)).collect() };
    let enough = few.into_iter().filter(|[a, b]| a.len() >= FEWEST && b.len() >= FEWEST);
    let best = enough.map(|[a, b]| (volume(&a) + volume(&b), a, b)).min_by(|x, y| x.0.total_cmp(&y.0));
    match best {
        Some((sum, a, b)) if sum <= SPLIT * volume(&points) => {
            [split_to(a, depth - 1), split_to(b, depth - 1)].concat()
        }
        _ => vec![points],
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn block(least: DVec3, size: DVec3) -> Vec<DVec3> {
        let at = |k: usize| DVec3::new((k % 6) as f64, (k / 6 % 6) as f64, (k / 36) as f64) / 5.0;
        (0..216).map(|k| least + size * at(k)).collect()
    }

    /// A post that touches a low crate: two boxes. One crate alone: one box.
    #[test]
    fn things_that_touch_are_split() {
        let crate_of = block(DVec3::ZERO, DVec3::new(0.8, 0.8, 0.4));
        assert_eq!(split(crate_of.clone()).len(), 1);
        let post = block(DVec3::new(0.8, 0.2, 0.0), DVec3::new(0.06, 0.06, 2.5));
        let mut sizes: Vec<usize> = split([crate_of, post].concat()).iter().map(Vec::len).collect();
        sizes.sort_unstable();
        assert!(sizes.len() == 2 && sizes[1] >= 216 && sizes[1] < 300, "{sizes:?}");
    }
}
