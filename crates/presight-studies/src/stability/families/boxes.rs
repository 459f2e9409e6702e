//! Uncertain features in front of a camera: nearly singular, indefinite and stiff covariances.

use super::family::{Family, Finding, powers};
use crate::stability::big::{Big, Vector};
use crate::stability::subjects::{BoxSetting, Subject};
use glam::{DMat3, DQuat, DVec3};
use presight_features::{BoxOptions, FeaturePrediction, PlacedFeature, SeenFeature};
use presight_model::change::Change;
use presight_model::environment::{Environment, Existence, Feature, FeatureShape, Properties};
use presight_model::error::Result;
use presight_model::geometry::{Pose, PoseCovariance};
use presight_model::random::SplitMix64;
use presight_model::sensor::{Camera, Geometry, Sensor, SensorSpec};
use presight_model::statistics::normal_pair;
use presight_model::world::World;

/// Error bound of an entry (a, b) of an image covariance J S J^T, relative to sum |J_ai| sigma_i times sum |J_bj|
/// sigma_j: 1e-12 for the eigenvalues that square roots of covariances drop (`features::normal`), plus f64 rounding.
pub(super) const COVARIANCE_BOUND: f64 = 2e-12;

const CONFIDENCE: f64 = 0.99;
/// Focal length and principal point, pixels.
const F: f64 = 500.0;
const CENTRE: [f64; 2] = [319.5, 239.5];

/// Covariances of the sensor's pose and the features, as factors F of F F^T.
struct Factors {
    sensor: [[f64; 6]; 6],
    feature: [[f64; 3]; 3],
    /// Subtracted from the smallest eigenvalue of the pose's covariance, relative to the largest.
    negative: f64,
}

#[derive(Clone, Copy, PartialEq)]
enum BoxMeasure {
    /// Covariances of image points, compared with J S J^T computed with a hundred digits.
    Covariance,
    /// Share of random samples that regions of interest contain.
    Coverage,
}

/// A family of covariances.
#[derive(Clone, Copy)]
pub(super) struct Boxes {
    name: &'static str,
    about: &'static str,
    axis: &'static str,
    difficulties: fn(bool) -> Vec<f64>,
    factors: fn(f64) -> Factors,
    measured: BoxMeasure,
}

const CONDITION: Boxes = Boxes {
    name: "condition",
    about: "Rotated covariances of pose and feature, ever nearer to singular; measures covariances of image points.",
    axis: "condition number of the covariances",
    difficulties: |quick| powers(0, 16, quick),
    factors: by_condition,
    measured: BoxMeasure::Covariance,
};

const STIFF: Boxes = Boxes {
    name: "stiff",
    about: "Features known to 1e-9 m, and a pose of ever larger uncertainty in translation and rotation (m, rad); \
            measures covariances of image points.",
    axis: "standard deviation of the pose",
    difficulties: |quick| powers(-9, 3, quick),
    factors: by_stiffness,
    measured: BoxMeasure::Covariance,
};

/// The table.
pub(super) const ALL: [Boxes; 5] = [
    CONDITION,
    Boxes {
        name: "condition-box",
        about: "As condition, but measures how often regions of interest of 99 % contain random samples of the errors.",
        measured: BoxMeasure::Coverage,
        ..CONDITION
    },
    STIFF,
    Boxes {
        name: "stiff-box",
        about: "As stiff, but measures how often regions of interest of 99 % contain random samples of the errors.",
        measured: BoxMeasure::Coverage,
        ..STIFF
    },
    Boxes {
        name: "indefinite",
        about: "A pose covariance with an ever more negative eigenvalue: one explained by rounding to six digits is \
                treated as 0, a more negative one is refused.",
        axis: "negative eigenvalue / largest eigenvalue",
        difficulties: |quick| powers(-16, -1, quick),
        factors: |negative| Factors { negative, ..by_condition(1e30) },
        measured: BoxMeasure::Coverage,
    },
];

impl Family for Boxes {
    fn name(&self) -> &'static str {
        self.name
    }

    fn about(&self) -> &'static str {
        self.about
    }

    fn axis(&self) -> &'static str {
        self.axis
    }

    fn error(&self) -> &'static str {
        match self.measured {
            BoxMeasure::Covariance => "error of an image covariance, in |J| sigma |J| sigma",
            BoxMeasure::Coverage => "lack of coverage (bound: four sigma of the samples)",
        }
    }

    fn difficulties(&self, quick: bool) -> Vec<f64> {
        (self.difficulties)(quick)
    }

    fn measure(&self, difficulty: f64, quick: bool, subjects: &mut [Subject]) -> Result<Vec<Finding>> {
        let factors = (self.factors)(difficulty);
        let setting = match setting(&factors) {
            Ok(setting) => setting,
            Err(e) => return Ok(vec![Finding::rejected(&e)]),
        };
        let mut findings = Vec::new();
        for subject in subjects {
            let found = match subject.boxes(&setting) {
                Ok(None) => continue,
                Ok(Some(found)) => found,
                Err(e) if e.kind() == presight_model::error::ErrorKind::Invalid => {
                    return Ok(vec![Finding::rejected(&e)]);
                }
                Err(e) => return Err(e),
            };
            let (error, bound) = match self.measured {
                BoxMeasure::Covariance => (covariance_error(&setting, &found), COVARIANCE_BOUND),
                BoxMeasure::Coverage => lack_of_coverage(&setting, &factors, &found, if quick { 1000 } else { 20_000 }),
            };
            findings.push(Finding::of(subject.name.clone(), error, bound));
        }
        Ok(findings)
    }
}

/// An orthonormal basis from a seed, by Gram-Schmidt.
fn basis<const N: usize>(seed: u64) -> [[f64; N]; N] {
    let mut random = SplitMix64(seed);
    let mut columns: Vec<[f64; N]> = Vec::new();
    while columns.len() < N {
        let mut v: [f64; N] = std::array::from_fn(|_| random.unit() - 0.5);
        for _ in 0..2 {
            for c in &columns {
                let along: f64 = (0..N).map(|i| c[i] * v[i]).sum();
                (0..N).for_each(|i| v[i] -= along * c[i]);
            }
        }
        let length = v.iter().map(|x| x * x).sum::<f64>().sqrt();
        if length > 0.1 {
            columns.push(v.map(|x| x / length));
        }
    }
    std::array::from_fn(|i| std::array::from_fn(|j| columns[j][i]))
}

/// A factor whose standard deviations fall from `greatest` to `greatest` / sqrt(`condition`), along a random basis.
fn turned<const N: usize>(seed: u64, greatest: f64, condition: f64) -> [[f64; N]; N] {
    let basis = basis::<N>(seed);
    let sigma = |j: usize| greatest * condition.powf(-0.5 * j as f64 / (N - 1) as f64);
    std::array::from_fn(|i| std::array::from_fn(|j| basis[i][j] * sigma(j)))
}

fn by_condition(condition: f64) -> Factors {
    Factors { sensor: turned(1, 0.02, condition), feature: turned(2, 0.03, condition), negative: 0.0 }
}

fn by_stiffness(sigma: f64) -> Factors {
    let sensor = std::array::from_fn(|i| std::array::from_fn(|j| if i == j { sigma } else { 0.0 }));
    Factors { sensor, feature: turned(3, 1e-9, 4.0), negative: 0.0 }
}

/// F F^T, exactly symmetric, with `negative` subtracted in its last direction.
fn product<const N: usize>(f: &[[f64; N]; N], negative: f64) -> [[f64; N]; N] {
    let square = |j: usize| (0..N).map(|i| f[i][j] * f[i][j]).sum::<f64>();
    let greatest = (0..N).map(square).fold(0.0, f64::max);
    let last = square(N - 1).sqrt();
    let unit: [f64; N] = std::array::from_fn(|i| if last > 0.0 { f[i][N - 1] / last } else { 0.0 });
    std::array::from_fn(|i| {
        std::array::from_fn(|j| {
            let (i, j) = (i.min(j), i.max(j));
            (0..N).map(|k| f[i][k] * f[j][k]).sum::<f64>() - negative * greatest * unit[i] * unit[j]
        })
    })
}

/// Points in front of a camera, inserted into a world by a regular change.
fn setting(factors: &Factors) -> Result<BoxSetting> {
    let camera = Camera::pinhole(640, 480, F, F, CENTRE[0], CENTRE[1]);
    let sensor = Sensor::new(SensorSpec::new("camera", "study", Geometry::Camera(camera)))?;
    let world_from_sensor = Pose::from_xyz_rpy(DVec3::new(3.0, -7.0, 2.0), 0.2, 0.1, 0.9);
    let covariance = DMat3::from_cols_array_2d(&product(&factors.feature, 0.0));
    let mut world = World::new(Environment::new());
    let (mut features, mut placed) = (Vec::new(), Vec::new());
    let ahead = [[3.0, 0.0, 0.0], [4.0, 1.2, -0.7], [2.0, -1.0, 0.5], [30.0, 5.0, 3.0], [0.6, 0.1, -0.2]];
    for (id, p) in (1..).zip(ahead) {
        let at = world_from_sensor.transform_point(DVec3::from_array(p));
        let feature = Feature {
            id,
            name: None,
            object: None,
            shape: FeatureShape::Point { at, covariance },
            existence: Existence::default(),
            properties: Properties::default(),
        };
        // Unchecked: there are no polygons, on which features would have to lie.
        world.apply_unchecked(Change::InsertFeature { class: "study".into(), feature: feature.clone() })?;
        features.push(SeenFeature::whole(&feature));
        placed.push(PlacedFeature { feature: feature.into(), object: None, slots: Vec::new() });
    }
    let prediction = FeaturePrediction { features, ..FeaturePrediction::default() };
    let options = BoxOptions::default()
        .with_sensor(PoseCovariance::from_rows(product(&factors.sensor, factors.negative)))
        .with_confidence(CONFIDENCE);
    Ok(BoxSetting { world, sensor, world_from_sensor, placed, prediction, options })
}

/// The largest error of an entry of all image covariances; infinite if one is missing or NaN.
fn covariance_error(setting: &BoxSetting, found: &FeaturePrediction) -> f64 {
    let mut worst = 0.0f64;
    for (feature, placed) in found.features.iter().zip(&setting.placed) {
        let Some(covariance) = feature.image_covariance.as_ref().and_then(|all| all.first()) else {
            return f64::INFINITY;
        };
        let (truth, scale) = true_covariance(setting, placed);
        for (a, b) in [(0, 0), (0, 1), (1, 0), (1, 1)] {
            let off = (&Big::new(covariance[a][b]) - &truth[a][b]).abs().to_f64() / (scale[a] * scale[b]);
            worst = if off <= worst { worst } else { off };
        }
    }
    worst
}

/// J S J^T of a point with a hundred digits, and the sum of |J_i| sigma_i for each row of J.
///
/// With p = R^T (P - t), pose errors (tau, theta) move it to R^T Exp(-theta) (P - t - tau).
fn true_covariance(setting: &BoxSetting, placed: &PlacedFeature) -> ([[Big; 2]; 2], [f64; 2]) {
    let FeatureShape::Point { at, covariance } = &placed.feature.shape else {
        return (std::array::from_fn(|_| std::array::from_fn(|_| Big::new(0.0))), [f64::INFINITY; 2]);
    };
    let pose = &setting.world_from_sensor;
    let back = pose.rotation.conjugate();
    let apart = &Vector::new(*at) - &Vector::new(pose.translation);
    let p = apart.turned(back);
    let [x, y, z] = &p.0;
    // Derivatives of u = cx - f y / x and v = cy - f z / x with respect to the position in body axes.
    let (f, square) = (Big::new(F), x * x);
    let along = |c: &Big| &(&f * c) / &square;
    let across = -&(&f / x);
    let zero = Big::new(0.0);
    let rows = [Vector([along(y), across.clone(), zero.clone()]), Vector([along(z), zero, across])];
    let axes = DVec3::AXES.map(Vector::new);
    let minus = Big::new(-1.0);
    let translations = axes.iter().map(|axis| axis.turned(back).scaled(&minus));
    let rotations = axes.iter().map(|axis| axis.cross(&apart).turned(back).scaled(&minus));
    let of_sensor: Vec<Vector> = translations.chain(rotations).collect();
    let of_feature: Vec<Vector> = axes.iter().map(|axis| axis.turned(back)).collect();
    let slopes = |columns: &[Vector]| rows.each_ref().map(|g| columns.iter().map(|c| g.dot(c)).collect::<Vec<_>>());
    let (sensor, feature) = (slopes(&of_sensor), slopes(&of_feature));
    let product = |a: usize, b: usize| {
        let mut sum = Big::new(0.0);
        for (i, j) in (0..6).flat_map(|i| (0..6).map(move |j| (i, j))) {
            let s = Big::new(setting.options.sensor[i][j]);
            sum = &sum + &(&(&sensor[a][i] * &s) * &sensor[b][j]);
        }
        for (i, j) in (0..3).flat_map(|i| (0..3).map(move |j| (i, j))) {
            let s = Big::new(covariance.col(j)[i]);
            sum = &sum + &(&(&feature[a][i] * &s) * &feature[b][j]);
        }
        sum
    };
    let scale = [0, 1].map(|a| {
        let sensor: f64 = (0..6).map(|i| sensor[a][i].to_f64().abs() * setting.options.sensor[i][i].sqrt()).sum();
        let feature: f64 = (0..3).map(|i| feature[a][i].to_f64().abs() * covariance.col(i)[i].sqrt()).sum();
        sensor + feature
    });
    ([[product(0, 0), product(0, 1)], [product(1, 0), product(1, 1)]], scale)
}

/// The confidence minus the coverage of the worst region of interest, at least 0, and four standard deviations of the
/// coverage. A sample that leaves the image counts as covered.
fn lack_of_coverage(setting: &BoxSetting, factors: &Factors, found: &FeaturePrediction, draws: usize) -> (f64, f64) {
    let bound = 4.0 * (CONFIDENCE * (1.0 - CONFIDENCE) / draws as f64).sqrt();
    let mut held = vec![0usize; setting.placed.len()];
    let mut random = SplitMix64(7);
    let mut normal = || {
        let [x, y] = [random.unit(), random.unit()];
        normal_pair(x.max(1e-300), y, 1.0)[0]
    };
    for _ in 0..draws {
        let pose = times(&factors.sensor, std::array::from_fn(|_| normal()));
        let (shift, turn) = (DVec3::new(pose[0], pose[1], pose[2]), DVec3::new(pose[3], pose[4], pose[5]));
        let back = setting.world_from_sensor.rotation.conjugate() * DQuat::from_scaled_axis(-turn);
        for (i, placed) in setting.placed.iter().enumerate() {
            let error = DVec3::from_array(times(&factors.feature, std::array::from_fn(|_| normal())));
            let at = placed.feature.shape.points()[0] + error;
            let p = back * (at - setting.world_from_sensor.translation - shift);
            let (u, v) = (CENTRE[0] - F * p.y / p.x, CENTRE[1] - F * p.z / p.x);
            let seen = p.x > 0.0 && (-0.5..639.5).contains(&u) && (-0.5..479.5).contains(&v);
            // A missing or NaN region contains nothing.
            let holds = |[x0, y0, x1, y1]: [f64; 4]| x0 <= u && u <= x1 && y0 <= v && v <= y1;
            held[i] += usize::from(found.features[i].roi.is_some_and(|roi| !seen || holds(roi)));
        }
    }
    let least = held.into_iter().min().unwrap_or(0) as f64 / draws as f64;
    ((CONFIDENCE - least).max(0.0), bound)
}

fn times<const N: usize>(f: &[[f64; N]; N], x: [f64; N]) -> [f64; N] {
    std::array::from_fn(|i| (0..N).map(|j| f[i][j] * x[j]).sum())
}
