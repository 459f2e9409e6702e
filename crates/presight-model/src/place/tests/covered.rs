//! Tests the cover of patches against distances from another library at many places.
use super::super::local::Local;
use super::super::plane::{self, PatchPlane};
use super::super::{Support, cover, patch};
use super::*;
use glam::DVec2;

const R: f64 = 1e-3;

/// The unit square, cut into rows and columns of rectangles, with typical faults of models.
#[derive(Clone, Debug)]
struct Quilt {
    /// Coordinates where columns and rows end; the seam is the gap or overlap to the next.
    columns: Vec<(f64, f64)>,
    rows: Vec<(f64, f64)>,
    /// By rectangle: left out, doubled or in triangles, and the lift of its corners: level, and slope along x.
    kinds: Vec<(u8, f64, f64)>,
}

impl Quilt {
    fn polygons(&self) -> Vec<Vec<DVec3>> {
        let ends = |cuts: &[(f64, f64)]| {
            let mut all = vec![(0.0, cuts[0].0)];
            all.extend(cuts.windows(2).map(|w| (w[0].0 + w[0].1, w[1].0)));
            all
        };
        let (columns, rows) = (ends(&self.columns), ends(&self.rows));
        let mut polygons = Vec::new();
        for (k, (kind, level, slope)) in self.kinds.iter().enumerate() {
            let (x, y) = (columns[k % columns.len()], rows[k / columns.len()]);
            let at = |x: f64, y: f64| DVec3::new(x, y, level + slope * x);
            let corners = vec![at(x.0, y.0), at(x.1, y.0), at(x.1, y.1), at(x.0, y.1)];
            match kind {
                0 => {}
                1 => polygons.extend([corners.clone(), corners]),
                // Triangles, wound in either sense.
                2 => polygons.extend([corners[..3].to_vec(), vec![corners[2], corners[0], corners[3]]]),
                _ => polygons.push(corners),
            }
        }
        polygons
    }
}

fn cuts() -> impl Strategy<Value = Vec<(f64, f64)>> {
    let seam = prop_oneof![5 => Just(0.0), 1 => -0.02..0.0f64, 2 => 0.2e-3..1.9e-3f64, 1 => 1.9e-3..5e-3f64];
    prop::collection::vec((0.05..1.0f64, seam), 1..6).prop_map(|parts| {
        let whole: f64 = parts.iter().map(|p| p.0).sum();
        let mut end = 0.0;
        let mut cuts: Vec<(f64, f64)> = parts
            .iter()
            .map(|(part, seam)| {
                end += part / whole;
                (end, *seam)
            })
            .collect();
        if let Some(last) = cuts.last_mut() {
            last.0 = 1.0;
        }
        cuts
    })
}

prop_compose! {
    fn quilt()(columns in cuts(), rows in cuts())(
        kinds in prop::collection::vec(
            (
                prop_oneof![1 => Just(0u8), 3 => Just(1), 6 => Just(2), 30 => Just(3)],
                prop_oneof![3 => Just(0.0), 1 => -0.8e-3..0.8e-3f64],
                prop_oneof![6 => Just(0.0), 1 => -0.05..0.05f64],
            ),
            columns.len() * rows.len(),
        ),
        columns in Just(columns),
        rows in Just(rows),
    ) -> Quilt {
        Quilt { columns, rows, kinds }
    }
}

fn lie_of(polygons: &[Vec<DVec3>], corners: &[DVec3]) -> Support {
    let about = |p: &DVec3| *p - corners[0];
    let near: Vec<Local> =
        (0..).zip(polygons).map(|(slot, p)| Local::new(slot, p.iter().map(about).collect(), R)).collect();
    patch::lie(&near, &corners.iter().map(about).collect::<Vec<_>>(), &|_| Ok(())).unwrap()
}

fn nearest(polygons: &[Vec<DVec3>], p: DVec3) -> f64 {
    polygons.iter().map(|c| oracle_distance(c, p)).fold(f64::INFINITY, f64::min)
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(256))]

    /// A rejected patch is off at the reported point; an accepted patch is nowhere off by more than the slack.
    #[test]
    fn what_is_refused_is_off_and_what_is_taken_is_not(
        quilt in quilt(),
        turn in 0.0..6.3f64,
        shrink in prop_oneof![Just(0.0), 0.0..0.2f64],
    ) {
        let polygons = quilt.polygons();
        let square = [[0., 0.], [1., 0.], [1., 1.], [0., 1.]].map(DVec2::from_array);
        let corners = square.map(|c| {
            let from_middle = DVec2::from_angle(turn).rotate(c - 0.5) * if shrink > 0.0 { 0.7 - shrink } else { 1.0 };
            (0.5 + if shrink > 0.0 { from_middle } else { c - 0.5 }).extend(0.0)
        });
        match lie_of(&polygons, &corners) {
            Support::Off(at) => {
                let off = nearest(&polygons, at + corners[0]);
                prop_assert!(off > R, "rejected where it is {off:e} off");
            }
            Support::On(_) => {
                // Samples at seams and rims, where it could be off, and everywhere.
                let seams = |cuts: &[(f64, f64)]| {
                    let across = |(end, seam): &(f64, f64)| {
                        let (end, seam) = (*end, *seam);
                        (0..=8).map(move |k| end + seam * f64::from(k) / 8.0)
                    };
                    cuts.iter().flat_map(across).collect::<Vec<_>>()
                };
                let mut at: Vec<[f64; 2]> =
                    (0..1600).map(|k| [f64::from(k % 40) / 39.0, f64::from(k / 40) / 39.0]).collect();
                let (xs, ys) = (seams(&quilt.columns), seams(&quilt.rows));
                at.extend(xs.iter().flat_map(|x| ys.iter().map(|y| [*x, *y])));
                at.extend(xs.iter().flat_map(|x| (0..200).map(|k| [*x, f64::from(k) / 199.0])));
                at.extend(ys.iter().flat_map(|y| (0..200).map(|k| [f64::from(k) / 199.0, *y])));
                let inside = |p: DVec3| (0..4).all(|k| {
                    let (a, b) = (corners[k], corners[(k + 1) % 4]);
                    (b - a).cross(p - a).z >= 0.0
                });
                for p in at.iter().map(|p| DVec3::new(p[0], p[1], 0.0)).filter(|p| inside(*p)) {
                    let off = nearest(&polygons, p);
                    prop_assert!(off <= (1.0 + cover::SLACK) * R + 1e-12, "accepted, but {off:e} off at {p}");
                }
            }
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(512))]

    /// The outline around a polygon contains everything within the tolerance, and nothing farther than the slack
    /// allows, also if the polygon leans out of the plane.
    #[test]
    fn outlines_stand_just_outside_the_tolerance(
        radii in prop::collection::vec(0.05..2.0f64, 3..12),
        stretch in prop_oneof![Just(1.0), Just(0.01), Just(1e-3)],
        lean in prop_oneof![Just(0.0), -0.08..0.08f64, -1e-3..1e-3f64],
        height in prop_oneof![Just(0.0), -0.99e-3..0.99e-3f64],
        seed in any::<u64>(),
    ) {
        // Any points of an ellipse are convex.
        let whole: f64 = radii.iter().sum();
        let mut angle = 0.0;
        let corners: Vec<DVec3> = radii.iter().map(|part| {
            angle += std::f64::consts::TAU * part / whole;
            let at = DVec2::from_angle(angle) * DVec2::new(1.0, stretch);
            at.extend(height + lean * at.x)
        }).collect();
        let local = Local::new(0, corners.clone(), R);
        let flat = PatchPlane::of(&crate::geometry::Plane { normal: DVec3::Z, offset: 0.0 });
        let Some(under) = coplanar::CoplanarPart::new(&local, &flat) else { return Ok(()) };
        let around = under.around(&flat);
        let reaches = |p: DVec2| oracle_distance(&corners, flat.lift(p));
        for p in &around {
            let far = reaches(*p);
            prop_assert!(far > R && far <= (1.0 + cover::SLACK) * R + 1e-12, "{far:e}");
        }
        let mut bits = seed;
        let mut uniform = || {
            bits = bits.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (bits >> 11) as f64 / (1u64 << 53) as f64
        };
        // Near corners and sides, where the tolerance ends.
        for k in 0..400 {
            let (u, v) = (flat.project(corners[k % corners.len()]), flat.project(corners[(k + 1) % corners.len()]));
            let beside = DVec2::from_angle(7.0 * uniform()) * R * uniform().sqrt();
            let p = u.lerp(v, if k % 3 == 0 { 0.0 } else { uniform() }) + beside;
            let inside = plane::sides(&around).map(|side| plane::inside(side, p)).fold(f64::INFINITY, f64::min);
            prop_assert!(reaches(p) > R || inside > 0.0, "{:e} off at {p}, but outside", reaches(p));
        }
    }
}

/// Coincident slabs, cut differently and laid over each other, as in real office models.
#[test]
fn doubled_surfaces_and_long_seams_are_settled() {
    let strip = |x0: f64, x1: f64, y0: f64, y1: f64| {
        [[x0, y0], [x1, y0], [x1, y1], [x0, y1]].map(|[x, y]| DVec3::new(x, y, 0.0)).to_vec()
    };
    // The polygons span a long slanted seam between one and two tolerances wide.
    let (from, to) = (DVec3::new(0.0, 0.1, 0.0), DVec3::new(40.0, 0.17, 0.0));
    let seam = |w: f64| {
        let up = DVec3::Y * w;
        let lower = vec![DVec3::ZERO, DVec3::X * 40.0, to, from];
        let upper = vec![from + up, to + up, DVec3::new(40.0, 0.3, 0.0), DVec3::new(0.0, 0.3, 0.0)];
        vec![lower.clone(), upper.clone(), lower, upper]
    };
    let whole = strip(0.0, 40.0, 0.0, 0.3);
    assert!(matches!(lie_of(&seam(1.9e-3), &whole), Support::On(on) if on.len() == 4));
    assert!(matches!(lie_of(&seam(2.1e-3), &whole), Support::Off(_)));
    // A hundred strips over a hundred others, with no common seams.
    let mut both: Vec<_> = (0..100).map(|k| strip(0.4 * f64::from(k), 0.4 * f64::from(k + 1), 0.0, 0.3)).collect();
    both.extend((0..100).map(|k| strip(0.4 * f64::from(k) - 0.17, 0.4 * f64::from(k) + 0.23, -0.05, 0.35)));
    assert!(matches!(lie_of(&both, &whole), Support::On(on) if on.len() == 200));
    // One strip of each removed in the same place: a gap of 6 cm by 30 cm is left.
    both.remove(150);
    both.remove(49);
    let Support::Off(at) = lie_of(&both, &whole) else { panic!("the gap is not found") };
    assert!(nearest(&both, at) > 0.02, "the reported point is not far off: {at}");
}

/// The outline of a patch alone would miss this gap.
#[test]
fn an_island_is_found_by_its_own_border_only() {
    // A ring around an island. The gap between them is inside the outline, so no side of the outline crosses it.
    let ring = |hole: f64| {
        let at = |r: f64, k: u32| (r * DVec2::from_angle(std::f64::consts::TAU * f64::from(k) / 4.0)).extend(0.0);
        (0..4).map(move |k| vec![at(hole, k), at(3.0, k), at(3.0, k + 1), at(hole, k + 1)]).collect::<Vec<_>>()
    };
    let mut polygons = ring(0.5);
    let island: Vec<DVec3> =
        (0..4).map(|k| (0.49 * DVec2::from_angle(std::f64::consts::TAU * f64::from(k) / 4.0)).extend(0.0)).collect();
    polygons.push(island);
    let whole = [[-1., -1., 0.], [1., -1., 0.], [1., 1., 0.], [-1., 1., 0.]].map(DVec3::from_array);
    assert!(matches!(lie_of(&polygons, &whole), Support::Off(_)));
    let closed: Vec<_> = ring(0.4905).into_iter().chain(polygons.split_off(4)).collect();
    assert!(matches!(lie_of(&closed, &whole), Support::On(on) if on.len() == 5));
}
