//! Random errors in space, checks of boxes against them, and the best box for other draws.

use super::common::Random;
use super::{CONFIDENCES, Covariance, draws};
use glam::{DMat3, DQuat, DVec3};
use presight_features::roi::RoiFlag;
use presight_features::{BoxOptions, BoxQuery, FeaturePrediction, PlacedFeature, SeenFeature, add_boxes};
use presight_model::environment::{Environment, Existence, Feature, FeatureShape, Properties};
use presight_model::geometry::{Pose, PoseCovariance};
use presight_model::sensor::Sensor;
use presight_model::statistics::normal_pair;
use presight_model::world::World;
use rayon::prelude::*;

/// L with L L^T equal to the covariance; zero where it is singular.
pub fn cholesky(covariance: &Covariance) -> Covariance {
    let mut l = [[0.0; 6]; 6];
    for j in 0..6 {
        let rest = covariance[j][j] - (0..j).map(|k| l[j][k] * l[j][k]).sum::<f64>();
        if rest <= 1e-12 * covariance[j][j] {
            continue;
        }
        l[j][j] = rest.sqrt();
        for i in j + 1..6 {
            l[i][j] = (covariance[i][j] - (0..j).map(|k| l[i][k] * l[j][k]).sum::<f64>()) / l[j][j];
        }
    }
    l
}

/// Standard normal numbers by Box-Muller.
pub struct Normal(Random, Option<f64>);

impl Normal {
    pub fn new(seed: u64) -> Self {
        Self(Random(seed), None)
    }

    pub fn next(&mut self) -> f64 {
        if let Some(kept) = self.1.take() {
            return kept;
        }
        let [x, y] = [self.0.unit(), self.0.unit()];
        let [now, later] = normal_pair(x.max(1e-300), y, 1.0);
        self.1 = Some(later);
        now
    }

    /// Two vectors with the covariance L L^T.
    pub fn pair(&mut self, l: &Covariance) -> [DVec3; 2] {
        let mut x = [0.0; 6];
        for j in (0..6).filter(|j| l[*j][*j] > 0.0) {
            let normal = self.next();
            (j..6).for_each(|i| x[i] += l[i][j] * normal);
        }
        [DVec3::new(x[0], x[1], x[2]), DVec3::new(x[3], x[4], x[5])]
    }
}

pub fn ends_covariance(shape: &FeatureShape) -> Covariance {
    let mut all = [[0.0; 6]; 6];
    let mut put = |row: usize, column: usize, m: &DMat3| {
        for (i, j) in (0..3).flat_map(|i| (0..3).map(move |j| (i, j))) {
            all[row + i][column + j] = m.col(j)[i];
        }
    };
    match shape {
        FeatureShape::Segment { covariances: [a, b], cross, .. } => {
            put(0, 0, a);
            put(3, 3, b);
            put(0, 3, cross);
            put(3, 0, &cross.transpose());
        }
        FeatureShape::Point { covariance, .. } | FeatureShape::Patch { covariance, .. } => put(0, 0, covariance),
        other => panic!("{other:?}"),
    }
    all
}

/// Material points in the feature's frame, with the weights of both ends' errors.
fn material(shape: &FeatureShape, parts: usize) -> Vec<(DVec3, [f64; 2])> {
    match shape {
        FeatureShape::Segment { ends: [a, b], .. } => {
            let at = |i: usize| i as f64 / parts as f64;
            (0..=parts).map(|i| (a.lerp(*b, at(i)), [1.0 - at(i), at(i)])).collect()
        }
        other => other.points().iter().map(|p| (*p, [1.0, 0.0])).collect(),
    }
}

/// One feature in full view of one sensor.
#[derive(Clone)]
pub struct Case {
    pub name: String,
    pub sensor: Sensor,
    pub pose: Pose,
    pub covariance: Covariance,
    pub shape: FeatureShape,
    /// The largest area relative to the best box, if the case is to be tight.
    pub tight: Option<f64>,
}

pub type Reach = Option<[f64; 4]>;

impl Case {
    pub fn found(&self, confidence: f64) -> ([f64; 4], RoiFlag) {
        let feature = Feature {
            id: 1,
            name: None,
            object: None,
            shape: self.shape.clone(),
            existence: Existence::default(),
            properties: Properties::default(),
        };
        let seen = SeenFeature::whole(&feature);
        let placed = PlacedFeature { feature: feature.into(), object: None, slots: Vec::new() };
        let mut prediction = FeaturePrediction { features: vec![seen], ..FeaturePrediction::default() };
        let world = World::new(Environment::default());
        let options =
            BoxOptions::default().with_sensor(PoseCovariance::from_rows(self.covariance)).with_confidence(confidence);
        add_boxes(
            &mut prediction,
            &BoxQuery {
                placed: &[placed],
                world: &world,
                sensor: &self.sensor,
                world_from_sensor: &self.pose,
                options: &options,
            },
        )
        .unwrap();
        let seen = &prediction.features[0];
        (seen.roi.expect("it has an image"), seen.roi_flag.expect("with a flag"))
    }

    /// The extent of the feature's image in each draw: x0, y0, x1, y1, unwrapped to the nominal; `None` where a point
    /// has no image. With `clipped` only points in the image count, because the box need not contain points that have
    /// left it.
    pub fn reaches(&self, seed: u64, draws: usize, clipped: bool) -> Vec<Reach> {
        const CHUNK: usize = 10_000;
        let (sensor_root, ends_root) = (cholesky(&self.covariance), cholesky(&ends_covariance(&self.shape)));
        let points = material(&self.shape, 8);
        let turn = self.sensor.columns_of_a_turn();
        let image_from_body = self.sensor.body_from_image().transpose();
        let image_from_world = image_from_body * self.pose.rotation_matrix().transpose();
        let (w, h) = (f64::from(self.sensor.width()) - 0.5, f64::from(self.sensor.height()) - 0.5);
        let (near, _) = self.sensor.project(image_from_world * (points[0].0 - self.pose.translation)).unwrap();
        let one = |normal: &mut Normal| -> Reach {
            let [shift, angle] = normal.pair(&sensor_root);
            let ends = normal.pair(&ends_root);
            // The pose is Exp(angle) R, t + shift.
            let turned = image_from_world * DMat3::from_quat(DQuat::from_scaled_axis(-angle));
            let mut reach = [f64::INFINITY, f64::INFINITY, f64::NEG_INFINITY, f64::NEG_INFINITY];
            for (at, shares) in &points {
                let p = *at + ends[0] * shares[0] + ends[1] * shares[1] - self.pose.translation - shift;
                let Some((mut u, v)) = self.sensor.project(turned * p) else {
                    if clipped {
                        continue;
                    }
                    return None;
                };
                let inside = v >= -0.5 && v <= h && (turn.is_some() || u >= -0.5 && u <= w);
                if clipped && !inside {
                    continue;
                }
                u -= turn.map_or(0.0, |turn| turn * ((u - near) / turn).round());
                reach = [reach[0].min(u), reach[1].min(v), reach[2].max(u), reach[3].max(v)];
            }
            Some(reach)
        };
        let chunk = |i: usize| {
            let mut normal = Normal(Random(seed.wrapping_mul(1 << 32).wrapping_add(i as u64)), None);
            (0..CHUNK.min(draws - i * CHUNK)).map(|_| one(&mut normal)).collect::<Vec<_>>()
        };
        (0..draws.div_ceil(CHUNK)).into_par_iter().flat_map_iter(chunk).collect()
    }

    pub fn missed(&self, bounds: &[f64; 4], flag: RoiFlag, reaches: &[Reach]) -> f64 {
        let turn = self.sensor.columns_of_a_turn().unwrap_or(0.0);
        let holds = |reach: &Reach| {
            let Some(r) = reach else { return false };
            let all_around = turn > 0.0 && bounds[2] - bounds[0] >= turn - 1e-9;
            let across =
                |shift: f64| all_around || r[0] + shift >= bounds[0] - 1e-9 && r[2] + shift <= bounds[2] + 1e-9;
            flag == RoiFlag::WholeImage
                || r[0] > r[2]
                || [-turn, 0.0, turn].into_iter().any(across) && r[1] >= bounds[1] - 1e-9 && r[3] <= bounds[3] + 1e-9
        };
        reaches.par_iter().filter(|r| !holds(r)).count() as f64 / reaches.len() as f64
    }

    /// The violations at any confidence.
    pub fn check(&self) -> Vec<String> {
        let n = draws();
        let reaches = self.reaches(11, n, true);
        let others = self.tight.map(|_| Best::new(&self.reaches(12, n.min(200_000), false)));
        let mut wrong = Vec::new();
        for confidence in CONFIDENCES {
            let (bounds, flag) = self.found(confidence);
            let missed = self.missed(&bounds, flag, &reaches);
            let fail = 1.0 - confidence;
            let most = 1.1 * fail + 3.0 * (fail * confidence / n as f64).sqrt();
            let name = format!("{}, {}, {confidence}: {bounds:.2?} {flag:?}", self.name, self.sensor.spec().name);
            let mut line = format!("{name}: missed {missed:.5} of {fail:.3}");
            if missed > most {
                wrong.push(format!("{name}: missed {missed}, at most {most}"));
            }
            let (w, h) = (f64::from(self.sensor.width()) - 0.5, f64::from(self.sensor.height()) - 0.5);
            let all_round = self.sensor.columns_of_a_turn().is_some();
            let cut = bounds[1] <= -0.5 || bounds[3] >= h || !all_round && (bounds[0] <= -0.5 || bounds[2] >= w);
            if let (Some(tight), Some(best), false) = (self.tight, &others, cut) {
                let ratio = (bounds[2] - bounds[0]) * (bounds[3] - bounds[1]) / best.area(confidence);
                line += &format!(", {ratio:.3} x the best");
                if !(ratio <= tight) || flag == RoiFlag::WholeImage {
                    wrong.push(format!("{name}: {ratio} times the best area"));
                }
            }
            println!("{line}");
        }
        wrong
    }
}

/// The draws, and their sides in order.
pub struct Best {
    known: Vec<[f64; 4]>,
    sorted: [Vec<f64>; 4],
    lost: usize,
}

impl Best {
    pub fn new(reaches: &[Reach]) -> Self {
        let known: Vec<[f64; 4]> = reaches.iter().flatten().copied().collect();
        let sorted = std::array::from_fn(|c| {
            let mut values: Vec<f64> = known.iter().map(|r| r[c]).collect();
            values.par_sort_unstable_by(f64::total_cmp);
            values
        });
        Self { lost: reaches.len() - known.len(), known, sorted }
    }

    /// The smallest area of boxes that hold this share of the draws: the sides' tails in several proportions, as rare
    /// as possible.
    pub fn area(&self, confidence: f64) -> f64 {
        let patterns: Vec<[f64; 4]> = [0.5, 1.0, 2.0]
            .into_iter()
            .flat_map(|x| [[x, 1.0, x, 1.0], [x, 1.0, 1.0, 1.0], [1.0, x, 1.0, 1.0], [1.0, 1.0, x, 1.0]])
            .collect();
        patterns.par_iter().map(|weights| self.area_at(confidence, weights)).reduce(|| f64::INFINITY, f64::min)
    }

    pub fn area_at(&self, confidence: f64, weights: &[f64; 4]) -> f64 {
        let n = self.known.len();
        let bounds = |tail: f64| {
            let low = |c: usize| ((tail * weights[c] * n as f64) as usize).min(n - 1);
            let s = &self.sorted;
            [s[0][low(0)], s[1][low(1)], s[2][n - 1 - low(2)], s[3][n - 1 - low(3)]]
        };
        let share = |b: &[f64; 4]| {
            let inside = |r: &&[f64; 4]| r[0] >= b[0] && r[1] >= b[1] && r[2] <= b[2] && r[3] <= b[3];
            self.known.iter().filter(inside).count() as f64 / (n + self.lost) as f64
        };
        let (mut low, mut high) = (0.0, 1.0 - confidence);
        for _ in 0..16 {
            let middle = 0.5 * (low + high);
            if share(&bounds(middle)) >= confidence { low = middle } else { high = middle }
        }
        let b = bounds(low);
        (b[2] - b[0]).max(1.0) * (b[3] - b[1]).max(1.0)
    }
}
