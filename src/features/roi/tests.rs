//! Boxes held to draws of the errors.

use super::seen::unwrapped;
use super::*;
use crate::environment::FeatureShape;
use crate::geometry::Pose;
use glam::{DMat3, DVec3};
use std::f64::consts::{PI, TAU};

/// A pinhole camera of 640 x 480 pixels, body axes.
struct Camera;

impl Projection for Camera {
    fn project(&self, p: DVec3) -> Option<[f64; 2]> {
        (p.x > 0.0).then(|| [319.5 - 500.0 * p.y / p.x, 239.5 - 500.0 * p.z / p.x])
    }

    fn lever(&self, p: DVec3) -> f64 {
        p.x
    }

    fn size(&self) -> (u32, u32) {
        (640, 480)
    }

    fn turn(&self) -> Option<f64> {
        None
    }
}

/// A scanner of 720 x 181 half and whole degrees: all round, from pole to pole.
struct Scanner;

impl Projection for Scanner {
    fn project(&self, p: DVec3) -> Option<[f64; 2]> {
        let azimuth = p.y.atan2(p.x);
        let elevation = p.z.atan2(p.x.hypot(p.y));
        (p.length() > 0.0).then(|| [(azimuth + PI) / TAU * 720.0, 90.0 - elevation.to_degrees()])
    }

    fn lever(&self, p: DVec3) -> f64 {
        p.x.hypot(p.y)
    }

    fn size(&self) -> (u32, u32) {
        (720, 181)
    }

    fn turn(&self) -> Option<f64> {
        Some(720.0)
    }
}

/// Standard normal numbers.
struct Normal(u64);

impl Normal {
    fn unit(&mut self) -> f64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        ((z ^ (z >> 31)) >> 11) as f64 / (1u64 << 53) as f64
    }

    /// Box and Muller.
    fn next(&mut self) -> f64 {
        let (a, b) = (self.unit().max(1e-300), self.unit());
        (-2.0 * a.ln()).sqrt() * (TAU * b).cos()
    }
}

fn draws() -> usize {
    std::env::var("PRESIGHT_DRAWS").ok().and_then(|n| n.parse().ok()).unwrap_or(20_000)
}

/// Where the feature's image reaches in each draw: x0, y0, x1, y1, unwrapped to the nominal; `None` out of projection.
/// With `clipped` only points that are in the image count: what has left it need not be found there.
fn drawn(
    projection: &impl Projection,
    uncertain: &Uncertain,
    points: &[Material],
    seed: u64,
    clipped: bool,
) -> Vec<Option<[f64; 4]>> {
    let mut normal = Normal(seed);
    let (w, h) = projection.size();
    let inside = |v: f64, size: u32| (-0.5..=f64::from(size) - 0.5).contains(&v);
    let in_image = |at: [f64; 2]| inside(at[1], h) && (projection.turn().is_some() || inside(at[0], w));
    let nominal = projection.project(uncertain.place(&points[0], &[])).unwrap();
    let mut draw = || {
        let xi: Vec<f64> = (0..uncertain.dimensions()).map(|_| normal.next()).collect();
        let mut reach = [f64::INFINITY, f64::INFINITY, f64::NEG_INFINITY, f64::NEG_INFINITY];
        for point in points {
            match projection.project(uncertain.place(point, &xi)) {
                Some(mut at) if !clipped || in_image(at) => {
                    at[0] = unwrapped(projection, at[0], nominal[0]);
                    for c in 0..2 {
                        reach[c] = reach[c].min(at[c]);
                        reach[c + 2] = reach[c + 2].max(at[c]);
                    }
                }
                None if !clipped => return None,
                _ => {}
            }
        }
        Some(reach)
    };
    (0..draws()).map(|_| draw()).collect()
}

/// True if the box holds what is in the image of the reach.
fn holds(projection: &impl Projection, b: &Roi, reach: &Option<[f64; 4]>) -> bool {
    let Some(r) = reach else { return false };
    if b.flag == RoiFlag::WholeImage || r[0] > r[2] {
        return true;
    }
    let turn = projection.turn().unwrap_or(0.0);
    let across = |shift: f64| r[0] + shift >= b.bounds[0] - 1e-9 && r[2] + shift <= b.bounds[2] + 1e-9;
    [-turn, 0.0, turn].into_iter().any(across) && r[1] >= b.bounds[1] - 1e-9 && r[3] <= b.bounds[3] + 1e-9
}

/// The area of the best box on draws: each side at the same tail of its own distribution, as rare as can be.
fn best_area(reaches: &[Option<[f64; 4]>], confidence: f64) -> f64 {
    let known: Vec<[f64; 4]> = reaches.iter().flatten().copied().collect();
    let sorted: Vec<Vec<f64>> = (0..4)
        .map(|c| {
            let mut values: Vec<f64> = known.iter().map(|r| r[c]).collect();
            values.sort_by(f64::total_cmp);
            values
        })
        .collect();
    let n = known.len();
    let bounds = |tail: f64| {
        let low = ((tail * n as f64) as usize).min(n - 1);
        [sorted[0][low], sorted[1][low], sorted[2][n - 1 - low], sorted[3][n - 1 - low]]
    };
    let share = |b: &[f64; 4]| {
        let inside = |r: &&[f64; 4]| r[0] >= b[0] && r[1] >= b[1] && r[2] <= b[2] && r[3] <= b[3];
        known.iter().filter(inside).count() as f64 / reaches.len() as f64
    };
    let (mut low, mut high) = (0.0, 1.0 - confidence);
    for _ in 0..20 {
        let middle = 0.5 * (low + high);
        if share(&bounds(middle)) >= confidence { low = middle } else { high = middle }
    }
    let b = bounds(low);
    (b[2] - b[0]).max(1.0) * (b[3] - b[1]).max(1.0)
}

fn diagonal(sigmas: [f64; 6]) -> PoseCovariance {
    let mut m = [[0.0; 6]; 6];
    for (i, s) in sigmas.into_iter().enumerate() {
        m[i][i] = s * s;
    }
    m
}

fn isotropic(sigma: f64) -> DMat3 {
    DMat3::from_diagonal(DVec3::splat(sigma * sigma))
}

fn segment(a: DVec3, b: DVec3, sigma: f64) -> FeatureShape {
    FeatureShape::Segment { ends: [a, b], covariances: [isotropic(sigma); 2], cross: DMat3::ZERO }
}

fn samples(shape: &FeatureShape) -> Vec<Material> {
    match shape {
        FeatureShape::Segment { ends, .. } => (0..=8).map(|i| Material::on_segment(ends, f64::from(i) / 8.0)).collect(),
        other => other.points().iter().map(|p| Material::rigid(*p)).collect(),
    }
}

struct Case {
    name: &'static str,
    pose: PoseCovariance,
    shape: FeatureShape,
    /// Greatest area beside the best box, if the case is to be tight.
    tight: Option<f64>,
}

fn case(name: &'static str, pose: PoseCovariance, shape: FeatureShape, tight: Option<f64>) -> Case {
    Case { name, pose, shape, tight }
}

fn cases() -> Vec<Case> {
    let robot = |xy: f64, heading_deg: f64| diagonal([xy, xy, 0.0, 0.0, 0.0, heading_deg.to_radians()]);
    let post = |x: f64, y: f64| segment(DVec3::new(x, y, -0.8), DVec3::new(x, y, 0.7), 0.01);
    let point = |x: f64, y: f64, z: f64, sigma: f64| FeatureShape::Point {
        at: DVec3::new(x, y, z),
        covariance: isotropic(sigma),
    };
    let line = DVec3::new(0.3, 0.2, 0.5);
    let singular = DMat3::from_cols(line * line.x, line * line.y, line * line.z) * 0.01;
    let mut correlated = diagonal([0.05, 0.05, 0.05, 0.01, 0.01, 0.01]);
    (correlated[0][5], correlated[5][0]) = (4e-4, 4e-4);
    (correlated[1][5], correlated[5][1]) = (-4.5e-4, -4.5e-4);
    vec![
        case("a post, robot uncertain in x, y and heading", robot(0.03, 1.0), post(5.0, 0.4), Some(1.15)),
        case("a point", robot(0.05, 1.0), point(6.0, -1.0, 0.5, 0.05), Some(1.15)),
        case("a point, all pose errors", correlated, point(6.0, -1.0, 0.5, 0.05), Some(1.15)),
        case(
            "a slanting edge",
            robot(0.02, 0.5),
            segment(DVec3::new(4.0, -1.0, -0.6), DVec3::new(6.0, 1.0, 0.8), 0.03),
            Some(1.15),
        ),
        case("only the feature is uncertain", diagonal([0.0; 6]), point(4.0, 0.3, 0.2, 0.04), Some(1.15)),
        case("nothing is uncertain", diagonal([0.0; 6]), point(4.0, 0.3, 0.2, 0.0), None),
        case(
            "a singular covariance",
            diagonal([0.0; 6]),
            FeatureShape::Point { at: DVec3::new(4.0, 0.3, 0.2), covariance: singular },
            None,
        ),
        case("a post 3 m ahead", robot(0.15, 4.0), post(3.0, 0.1), Some(2.0)),
        case("a post 1.5 m ahead", robot(0.1, 5.0), post(1.5, 0.1), None),
        case(
            "a post 0.3 m ahead, heading 20 degrees",
            robot(0.02, 20.0),
            segment(DVec3::new(0.3, 0.0, -0.05), DVec3::new(0.3, 0.0, 0.05), 0.002),
            None,
        ),
        case("sigma 1e-9 m", diagonal([1e-9; 6]), point(4.0, 0.3, 0.2, 1e-9), None),
        case("sigma 1e3 m", diagonal([1e3, 1e3, 1e3, 0.0, 0.0, 0.1]), point(4.0, 0.3, 0.2, 1e-9), None),
    ]
}

fn check(projection: &impl Projection, case: &Case, confidence: f64) -> Result<RoiFlag, String> {
    let uncertain = Uncertain::new(&Pose::IDENTITY, &case.pose, &Pose::IDENTITY, None, &case.shape);
    let points = samples(&case.shape);
    let b = roi(projection, &uncertain, &points, confidence).ok_or("no image")?;
    let reaches = drawn(projection, &uncertain, &points, 11, true);
    let n = reaches.len() as f64;
    let missed = reaches.iter().filter(|r| !holds(projection, &b, r)).count() as f64 / n;
    let fail = 1.0 - confidence;
    let most = 1.1 * fail + 3.0 * (fail * confidence / n).sqrt();
    let say = |what: String| Err(format!("{}, {confidence}: {what}; {b:?}", case.name));
    if missed > most {
        return say(format!("missed {missed}, at most {most}"));
    }
    if let Some(tight) = case.tight {
        let area = (b.bounds[2] - b.bounds[0]) * (b.bounds[3] - b.bounds[1]);
        let ratio = area / best_area(&drawn(projection, &uncertain, &points, 12, false), confidence);
        if b.flag == RoiFlag::WholeImage || ratio > tight {
            return say(format!("{ratio} times the best area"));
        }
    }
    Ok(b.flag)
}

#[test]
fn boxes_hold_as_often_as_they_say() {
    let mut wrong = Vec::new();
    for case in cases() {
        for confidence in [0.9, 0.99, 0.999] {
            wrong.extend(check(&Camera, &case, confidence).err());
            wrong.extend(check(&Scanner, &case, confidence).err());
        }
    }
    assert!(wrong.is_empty(), "{wrong:#?}");
}

/// Planted faults: each side drawn in by a fifth, and two axes of the covariance swapped, are noticed.
#[test]
fn boxes_drawn_in_are_noticed() {
    let case = &cases()[0];
    let points = samples(&case.shape);
    let uncertain = Uncertain::new(&Pose::IDENTITY, &case.pose, &Pose::IDENTITY, None, &case.shape);
    let reaches = drawn(&Camera, &uncertain, &points, 5, true);
    let missed = |b: &Roi| reaches.iter().filter(|r| !holds(&Camera, b, r)).count() as f64 / reaches.len() as f64;
    let good = roi(&Camera, &uncertain, &points, 0.99).unwrap();
    assert!(missed(&good) < 0.012);
    let size = [good.bounds[2] - good.bounds[0], good.bounds[3] - good.bounds[1]];
    for side in 0..4 {
        let mut bad = good;
        bad.bounds[side] += size[side % 2] * if side < 2 { 0.2 } else { -0.2 };
        assert!(missed(&bad) > 0.02, "side {side}: {}", missed(&bad));
    }
    let mut swapped = case.pose;
    (swapped[5][5], swapped[4][4]) = (swapped[4][4], swapped[5][5]);
    let other = Uncertain::new(&Pose::IDENTITY, &swapped, &Pose::IDENTITY, None, &case.shape);
    assert!(missed(&roi(&Camera, &other, &points, 0.99).unwrap()) > 0.02);
}

#[test]
fn slopes_are_those_of_place() {
    let pose = Pose::from_xyz_rpy(DVec3::new(5e6, -3.0, 1.0), 0.2, -0.3, 1.1);
    let frame = Pose::from_xyz_rpy(DVec3::new(5e6 + 4.0, -2.0, 1.5), -0.5, 0.1, 0.7);
    let mut covariance = diagonal([0.1, 0.2, 0.3, 0.01, 0.02, 0.03]);
    (covariance[0][4], covariance[4][0]) = (1e-3, 1e-3);
    let shape = segment(DVec3::new(0.1, 0.2, 0.3), DVec3::new(1.0, -0.4, 0.6), 0.05);
    let uncertain = Uncertain::new(&pose, &covariance, &frame, Some(&covariance), &shape);
    assert_eq!(uncertain.dimensions(), 18);
    let point = samples(&shape)[5];
    let placed = uncertain.nominal(&point);
    let slopes = DVec3::AXES.map(|axis| uncertain.slopes(&placed, axis));
    for i in 0..18 {
        let at = |step: f64| {
            let mut xi = vec![0.0; 18];
            xi[i] = step;
            uncertain.place(&point, &xi)
        };
        let difference = (at(1e-4) - at(-1e-4)) / 2e-4;
        let slope = DVec3::from_array(slopes.map(|s| s[i]));
        assert!((difference - slope).length() < 1e-7, "{i}: {difference} and {slope}");
    }
    // A turn of the sensor to the left moves what it sees to the right.
    let turn = Uncertain::new(
        &Pose::IDENTITY,
        &diagonal([0.0, 0.0, 0.0, 0.0, 0.0, 0.1]),
        &Pose::IDENTITY,
        None,
        &FeatureShape::Point { at: DVec3::X, covariance: DMat3::ZERO },
    );
    assert!(turn.place(&Material::rigid(DVec3::X), &[1.0]).y < -0.09);
}

#[test]
fn boxes_over_the_seam_go_on_beyond_the_width() {
    let shape = FeatureShape::Point { at: DVec3::new(-5.0, 0.01, 0.0), covariance: isotropic(0.1) };
    let uncertain = Uncertain::new(&Pose::IDENTITY, &diagonal([0.0; 6]), &Pose::IDENTITY, None, &shape);
    let b = roi(&Scanner, &uncertain, &samples(&shape), 0.99).unwrap();
    assert!(b.bounds[0] > 700.0 && b.bounds[2] > 719.5 && b.bounds[2] < 740.0, "{b:?}");
}

#[test]
fn nothing_uncertain_is_a_pixel() {
    let shape = FeatureShape::Point { at: DVec3::new(4.0, 0.0, 0.0), covariance: DMat3::ZERO };
    let uncertain = Uncertain::new(&Pose::IDENTITY, &diagonal([0.0; 6]), &Pose::IDENTITY, None, &shape);
    let b = roi(&Camera, &uncertain, &samples(&shape), 0.99).unwrap();
    assert_eq!((b.bounds, b.flag), ([319.0, 239.0, 320.0, 240.0], RoiFlag::Linear));
}
