//! The smallest upright box around a group of points.

use glam::{DQuat, DVec2, DVec3};
use presight_model::geometry::Pose;
use presight_model::statistics::quantile;

/// Steps of a quarter turn.
const TURNS: usize = 45;
/// Share of the points that may be outside on each side.
const OUTSIDE: f64 = 0.005;
/// Minimum edge of a box, metres.
const MIN_EDGE: f64 = 0.02;

/// An upright box.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct UprightBox {
    /// The pose of its centre, with axes along its edges.
    pub pose: Pose,
    /// The lengths of its edges, metres.
    pub size: DVec3,
}

impl UprightBox {
    /// The smallest upright box that contains all but a few of the points, metres. Without points it has its minimum
    /// size at the origin.
    pub fn of(points: &[DVec3]) -> Self {
        let extent = |values: &mut Vec<f64>| {
            (quantile(values, OUTSIDE).unwrap_or(0.0), quantile(values, 1.0 - OUTSIDE).unwrap_or(0.0))
        };
        let sides = |angle: f64| {
            let (x, y) = (DVec2::from_angle(angle), DVec2::from_angle(angle).perp());
            [x, y].map(|axis| extent(&mut points.iter().map(|p| p.truncate().dot(axis)).collect()))
        };
        let area = |[(a, b), (c, d)]: [(f64, f64); 2]| (b - a + MIN_EDGE) * (d - c + MIN_EDGE);
        let turn = |step: usize| step as f64 / TURNS as f64 * std::f64::consts::FRAC_PI_2;
        let best = (0..TURNS).map(turn).min_by(|a, b| area(sides(*a)).total_cmp(&area(sides(*b)))).unwrap_or(0.0);
        let ([(a, b), (c, d)], (low, high)) = (sides(best), extent(&mut points.iter().map(|p| p.z).collect()));
        let rotation = DQuat::from_rotation_z(best);
        let middle = rotation * DVec3::new(0.5 * (a + b), 0.5 * (c + d), 0.5 * (low + high));
        let size = DVec3::new(b - a, d - c, high - low).max(DVec3::splat(MIN_EDGE));
        Self { pose: Pose { translation: middle, rotation }, size }
    }

    /// True if a point is in the box, or outside by at most `slack` metres.
    pub fn holds(&self, p: DVec3, slack: f64) -> bool {
        let q = self.pose.inverse().transform_point(p).abs();
        q.cmple(0.5 * self.size + slack).all()
    }

    /// Range and cosine of the incidence at which a ray from outside along the unit `ray` meets it, metres.
    pub(crate) fn meet(&self, origin: DVec3, ray: DVec3) -> Option<(f64, f64)> {
        let back = self.pose.inverse();
        let (origin, ray) = (back.transform_point(origin), back.rotation * ray);
        let (a, b) = ((-0.5 * self.size - origin) / ray, (0.5 * self.size - origin) / ray);
        // A ray in a side gives NaN, which min and max ignore.
        let (near, far) = (a.min(b), a.max(b));
        let (enter, leave) = (near.x.max(near.y).max(near.z), far.x.min(far.y).min(far.z));
        let axis = (0..3).find(|axis| near[*axis] == enter)?;
        (enter > 0.0 && enter <= leave).then(|| (enter, ray[axis].abs()))
    }
}

/// Two boxes replace one if their volume is at most this share of its volume.
const SPLIT: f64 = 0.6;
/// Candidate cuts along an edge of a box, plus one.
const CUTS: usize = 8;
/// Minimum number of points of a new object.
pub(crate) const MIN_POINTS: usize = 20;
/// Maximum depth of splits.
const MAX_DEPTH: usize = 3;

/// Splits points into sets whose boxes are together much smaller than one box around all, for objects that touch and
/// concave objects.
pub(crate) fn split(points: Vec<DVec3>) -> Vec<Vec<DVec3>> {
    split_to(points, MAX_DEPTH)
}

fn split_to(points: Vec<DVec3>, depth: usize) -> Vec<Vec<DVec3>> {
    let volume = |points: &[DVec3]| {
        let size = UprightBox::of(points).size + MIN_EDGE;
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
    let enough = few.into_iter().filter(|[a, b]| a.len() >= MIN_POINTS && b.len() >= MIN_POINTS);
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
    fn touching_objects_are_split() {
        let crate_of = block(DVec3::ZERO, DVec3::new(0.8, 0.8, 0.4));
        assert_eq!(split(crate_of.clone()).len(), 1);
        let post = block(DVec3::new(0.8, 0.2, 0.0), DVec3::new(0.06, 0.06, 2.5));
        let mut sizes: Vec<usize> = split([crate_of, post].concat()).iter().map(Vec::len).collect();
        sizes.sort_unstable();
        assert!(sizes.len() == 2 && sizes[1] >= 216 && sizes[1] < 300, "{sizes:?}");
    }
}
