//! How far a feature is from where its layer has it, by the looks that found it.

use crate::joint::AXES;
use glam::{DMat3, DQuat, DVec2, DVec3};
use presight_localize::matching::{Detection, Shape};
use presight_localize::verdict::{ObjectError, body_from_image};
use presight_model::environment::{Feature, FeatureShape};
use presight_model::geometry::{Pose, PoseEstimate};
use presight_model::matrix::{Matrix, add_to, apply, inverse, product, sandwich, scaled, turn};
use presight_model::sensor::Sensor;

/// Deviation of a place along a direction that is not measured, in distances from the sensor.
const FAR: f64 = 1e3;
/// No place is known better, square metres: a micrometre.
const LEAST: f64 = 1e-12;

/// What looks say of the errors of a feature's points, world axes: of one point, or of both ends of an edge.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct Sums {
    pub views: u32,
    information: Matrix,
    weighted: [f64; 6],
    /// Covariance that the poses add; views of a run share it.
    by_pose: Matrix,
}

/// A sensor at a pose.
pub(crate) struct Eye<'a> {
    pub sensor: &'a Sensor,
    pub pose: &'a PoseEstimate,
    world_from_image: Pose,
}

impl<'a> Eye<'a> {
    pub fn new(sensor: &'a Sensor, pose: &'a PoseEstimate) -> Self {
        let world_from_image = pose.world_from_robot * sensor.spec().mount * body_from_image(sensor);
        Self { sensor, pose, world_from_image }
    }

    /// Where the sensor is, world.
    pub fn place(&self) -> DVec3 {
        self.world_from_image.translation
    }

    /// The ray of a pixel, world axes, and how it turns by one pixel along columns and rows.
    pub fn ray(&self, at: DVec2) -> Option<(DVec3, [DVec3; 2])> {
        // A scanner of one row does not measure heights: its detections are in its plane.
        let rows = if self.sensor.height() == 1 { 0.0 } else { 1.0 };
        let along = |du: f64, dv: f64| self.sensor.ray_at(at.x + du, rows * (at.y + dv));
        let ray = along(0.0, 0.0)?;
        let turned = |du: f64, dv: f64| along(du, dv).map_or(DVec3::ZERO, |there| (there - ray) / 0.1);
        let rotation = self.world_from_image.rotation;
        Some((rotation * ray, [rotation * turned(0.1, 0.0), rotation * (rows * turned(0.0, 0.1))]))
    }

    /// How the stated error of the pose moves points of the world: their joint covariance.
    pub fn by_pose(&self, points: &[DVec3]) -> Matrix {
        let mut all = [[0.0; 6]; 6];
        let axes = [DVec3::X, DVec3::Y, DVec3::Z];
        let gradient =
            |k: usize| ObjectError::gradient(self.pose.world_from_robot.translation, points[k / 3], axes[k % 3]);
        for i in 0..3 * points.len() {
            let row = apply(self.pose.covariance.as_rows(), &gradient(i));
            for j in 0..3 * points.len() {
                all[i][j] = row.iter().zip(gradient(j)).map(|(a, b)| a * b).sum();
            }
        }
        all
    }
}

/// Covariance of a point at some range by that of its pixel, square metres.
pub(crate) fn across(detection: &Detection, [u, v]: [DVec3; 2], range: f64) -> DMat3 {
    let c = detection.covariance;
    let outer = |a: DVec3, b: DVec3| DMat3::from_cols(b.x * a, b.y * a, b.z * a);
    range * range * (c.x_axis.x * outer(u, u) + c.x_axis.y * (outer(u, v) + outer(v, u)) + c.y_axis.y * outer(v, v))
}

fn padded(m: DMat3) -> Matrix {
    let rows = m.transpose();
    std::array::from_fn(|i| std::array::from_fn(|j| if i < 3 && j < 3 { rows.col(i)[j] } else { 0.0 }))
}

impl Sums {
    /// A look that found a feature: the points that the model has, world, and where they were found. `shares` says where along an edge its
    /// points are.
    pub fn of(eye: &Eye<'_>, detection: &Detection, points: &[DVec3], shares: Option<[f64; 2]>) -> Option<Self> {
        match &detection.shape {
            Shape::Segment { ends, .. } => Self::of_edge(eye, detection, ends, points, shares?),
            Shape::Patch(_) => None,
            shape => {
                let middle = points.iter().sum::<DVec3>() / points.len().max(1) as f64;
                Self::of_point(eye, detection, (shape.centre(), shape.points().len()), middle)
            }
        }
    }

    fn of_point(eye: &Eye<'_>, detection: &Detection, (at, corners): (DVec2, usize), model: DVec3) -> Option<Self> {
        let (ray, steps) = eye.ray(at)?;
        let along = ray.dot(model - eye.place());
        let range = detection.properties.range.as_ref();
        let found = eye.place() + range.map_or(along, |range| range.mean) * ray;
        let outer = |a: DVec3| DMat3::from_cols(a.x * a, a.y * a, a.z * a);
        let [u, v] = steps.map(|step| step - step.dot(ray) * ray);
        // The mean of several corners is known better than one of them.
        let mut own = across(detection, [u, v], along) * (1.0 / corners.max(1) as f64);
        // Nothing is known along a ray without a range, nor across the plane of a scanner of one row.
        let unknown = (FAR * along).powi(2);
        own += range.map_or(unknown, |range| range.variance) * outer(ray);
        if v == DVec3::ZERO {
            own += unknown * outer(ray.cross(u).try_normalize()?);
        }
        let information = inverse(&padded(own), &AXES);
        let off = found - model;
        let weighted = apply(&information, &[off.x, off.y, off.z, 0.0, 0.0, 0.0]);
        Some(Self { views: 1, information, weighted, by_pose: eye.by_pose(&[model]) })
    }

    /// The line of an edge in the image is a plane in the world: it says how far each end of the part is across.
    fn of_edge(
        eye: &Eye<'_>,
        detection: &Detection,
        ends: &[DVec2; 2],
        points: &[DVec3],
        shares: [f64; 2],
    ) -> Option<Self> {
        let [a, b] = points else { return None };
        let (first, last) = (eye.ray(ends[0])?, eye.ray(ends[1])?);
        let normal = first.0.cross(last.0).try_normalize()?;
        let mut sums = Self { views: 1, by_pose: eye.by_pose(&[*a, *b]), ..Self::default() };
        for ((p, t), steps) in [a, b].into_iter().zip(shares).zip([first.1, last.1]) {
            let away = *p - eye.place();
            let variance = normal.dot(across(detection, steps, away.length()) * normal) + LEAST;
            let gradient: [f64; 6] = std::array::from_fn(|i| normal[i % 3] * if i < 3 { 1.0 - t } else { t });
            let off = -normal.dot(away);
            for i in 0..6 {
                (0..6).for_each(|j| sums.information[i][j] += gradient[i] * gradient[j] / variance);
                sums.weighted[i] += gradient[i] * off / variance;
            }
        }
        Some(sums)
    }

    pub fn add(&mut self, other: &Self) {
        self.views += other.views;
        add_to(&mut self.information, &other.information);
        add_to(&mut self.by_pose, &other.by_pose);
        (0..6).for_each(|i| self.weighted[i] += other.weighted[i]);
    }

    /// The covariance of a feature's points, world axes, after the looks, about the points of the model, which stay where they lie on
    /// their surface: by how much the most likely place is away from them counts, too. `shift` is how far the points were moved since.
    fn after(&self, prior: &Matrix, shift: &[f64; 6]) -> Matrix {
        let mut known = scaled(&self.by_pose, 1.0 / f64::from(self.views.max(1)));
        (0..6).for_each(|i| known[i][i] += LEAST);
        // The information of looks that share an error (Woodbury).
        let mut both = inverse(&known, &AXES);
        add_to(&mut both, &self.information);
        let share = product(&self.information, &inverse(&both, &AXES));
        let less = product(&share, &self.information);
        let mut information = self.information;
        add_to(&mut information, &scaled(&less, -1.0));
        let mut weighted = self.weighted;
        let moved = apply(&self.information, shift);
        (0..6).for_each(|i| weighted[i] -= moved[i]);
        let lost = apply(&share, &weighted);
        (0..6).for_each(|i| weighted[i] -= lost[i]);
        // A place that is known exactly stays so.
        let axes: Vec<usize> = AXES.into_iter().filter(|i| prior[*i][*i] > 0.0).collect();
        let mut sum = inverse(prior, &axes);
        add_to(&mut sum, &information);
        let after = inverse(&sum, &axes);
        let off = apply(&after, &weighted);
        std::array::from_fn(|i| std::array::from_fn(|j| 0.5 * (after[i][j] + after[j][i]) + off[i] * off[j]))
    }
}

/// The shape of a feature with its covariance after the looks. `stood` and `stands` are the poses of its object during the looks and now.
pub(crate) fn located(feature: &Feature, sums: &Sums, (stood, stands): (&Pose, &Pose)) -> FeatureShape {
    let mut shape = feature.shape.clone();
    let points: Vec<DVec3> = match &shape {
        FeatureShape::Point { at, .. } | FeatureShape::Reflector { at, .. } => vec![*at],
        FeatureShape::Segment { ends, .. } => ends.to_vec(),
        FeatureShape::Fiducial { corners, .. } => vec![corners.iter().sum::<DVec3>() / 4.0],
        FeatureShape::Patch { .. } | FeatureShape::Contour { .. } => return shape,
    };
    let mut shift = [0.0; 6];
    for (k, p) in points.iter().enumerate() {
        let by = stands.transform_point(*p) - stood.transform_point(*p);
        (0..3).for_each(|i| shift[3 * k + i] = by[i]);
    }
    let refined = |blocks: Matrix| {
        let turned = |rotation: DQuat, m: &Matrix| sandwich(&turn(rotation), m);
        turned(stands.rotation.conjugate(), &sums.after(&turned(stands.rotation, &blocks), &shift))
    };
    let block = |m: &Matrix, row: usize, column: usize| {
        DMat3::from_cols_array_2d(&std::array::from_fn(|j| std::array::from_fn(|i| m[3 * row + i][3 * column + j])))
    };
    match &mut shape {
        FeatureShape::Point { covariance, .. }
        | FeatureShape::Reflector { covariance, .. }
        | FeatureShape::Fiducial { covariance, .. }
            if *covariance != DMat3::ZERO =>
        {
            *covariance = block(&refined(padded(*covariance)), 0, 0);
        }
        FeatureShape::Segment { covariances, cross, .. } if *covariances != [DMat3::ZERO; 2] => {
            let (first, last, c) = (padded(covariances[0]), padded(covariances[1]), padded(*cross));
            let joint = std::array::from_fn(|i| {
                std::array::from_fn(|j| match (i < 3, j < 3) {
                    (true, true) => first[i][j],
                    (false, false) => last[i - 3][j - 3],
                    (true, false) => c[i][j - 3],
                    (false, true) => c[j][i - 3],
                })
            });
            let after = refined(joint);
            (*covariances, *cross) = ([block(&after, 0, 0), block(&after, 1, 1)], block(&after, 0, 1));
        }
        _ => {}
    }
    shape
}

#[cfg(test)]
mod tests {
    use super::*;
    use presight_model::environment::{Existence, Properties};
    use presight_model::geometry::{PoseCovariance, RobotPose};
    use presight_model::sensor::{Camera, Geometry, SensorSpec};

    fn feature(shape: FeatureShape) -> Feature {
        let (existence, properties) = (Existence::default(), Properties::default());
        Feature { id: 1, name: None, object: None, shape, existence, properties }
    }

    fn here() -> (&'static Pose, &'static Pose) {
        (&Pose::IDENTITY, &Pose::IDENTITY)
    }

    fn of_sigma(sigma: f64) -> DMat3 {
        DMat3::from_diagonal(DVec3::splat(sigma * sigma))
    }

    fn diagonal(shape: &FeatureShape) -> DVec3 {
        let (FeatureShape::Point { covariance: c, .. } | FeatureShape::Reflector { covariance: c, .. }) = shape else {
            panic!("{shape:?}")
        };
        DVec3::new(c.x_axis.x, c.y_axis.y, c.z_axis.z)
    }

    /// By hand: a layer that states 3 cm, and three views of 1 cm each that put it 2 cm away along x. Together the views have a
    /// variance of 1/3 cm2, so the most likely place is 9 / (9 + 1/3) of the way. Poses that are 1 cm off in all of these views leave
    /// a variance of 4/3 cm2. An object that was moved there since explains it all.
    #[test]
    fn a_reflectors_covariance_shrinks_about_its_point() {
        let mut sums = Sums { views: 3, ..Sums::default() };
        (0..3).for_each(|i| sums.information[i][i] = 3e4);
        sums.weighted[0] = 3e4 * 0.02;
        let reflector = feature(FeatureShape::Reflector { at: DVec3::X, covariance: of_sigma(0.03) });
        let (variance, off) = (1.0 / (1.0 / 9e-4 + 3e4), 0.02 * 9.0 / (9.0 + 1.0 / 3.0));
        let got = diagonal(&located(&reflector, &sums, here()));
        assert!((got.x - (variance + off * off)).abs() < 1e-9 && (got.y - variance).abs() < 1e-9, "{got}");
        (0..3).for_each(|i| sums.by_pose[i][i] = 3e-4);
        let got = diagonal(&located(&reflector, &sums, here()));
        assert!((got.y - 1.0 / (1.0 / 9e-4 + 1.0 / (4e-4 / 3.0))).abs() < 1e-9, "{got}");
        sums.by_pose = [[0.0; 6]; 6];
        let moved = Pose { translation: 0.02 * DVec3::X, ..Pose::IDENTITY };
        let got = diagonal(&located(&reflector, &sums, (&Pose::IDENTITY, &moved)));
        assert!((got.x - variance).abs() < 1e-9, "{got}");
        // A place that the layer knows exactly stays so.
        let exact = feature(FeatureShape::Reflector { at: DVec3::X, covariance: DMat3::ZERO });
        assert_eq!(located(&exact, &sums, here()), exact.shape);
    }

    /// A camera of 100 pixels focal length at the origin, 2 m before things whose places are known to 1 cm; they are found one pixel, 2 cm, to
    /// the right (-y) with half a pixel, 1 cm, of noise. By hand: across, half the variance is left, and half of the 2 cm are believed; along
    /// the ray nothing is learnt.
    #[test]
    fn an_image_says_how_far_a_feature_is_across() {
        let camera = Camera::pinhole(160, 120, 100.0, 100.0, 79.5, 59.5);
        let sensor = Sensor::new(SensorSpec::new("camera", "grey", Geometry::Camera(camera))).unwrap();
        let pose = PoseEstimate::new(RobotPose::IDENTITY, PoseCovariance::from_sigmas([1e-6; 6]));
        let eye = Eye::new(&sensor, &pose);
        let p = DVec3::new(2.0, 0.0, 0.0);
        let found = Detection::point(DVec2::new(80.5, 59.5), 0.5);
        let sums = Sums::of(&eye, &found, &[p], None).unwrap();
        let got =
            diagonal(&located(&feature(FeatureShape::Point { at: p, covariance: of_sigma(0.01) }), &sums, here()));
        let expected = DVec3::new(1e-4, 1.5e-4, 0.5e-4);
        assert!((got - expected).abs().max_element() < 0.02e-4, "{got}");
        // An upright edge of 1 m about the same point: each end is found across as well as the point, and no end along the edge.
        let ends = [DVec3::new(2.0, 0.0, -0.5), DVec3::new(2.0, 0.0, 0.5)];
        let pixels = [DVec2::new(80.5, 84.5), DVec2::new(80.5, 34.5)];
        let found = Detection::new(Shape::Segment { ends: pixels, corners: [false; 2] }, 0.5);
        let sums = Sums::of(&eye, &found, &ends, Some([0.0, 1.0])).unwrap();
        let shape = FeatureShape::Segment { ends, covariances: [of_sigma(0.01); 2], cross: DMat3::ZERO };
        let FeatureShape::Segment { covariances, .. } = located(&feature(shape), &sums, here()) else { panic!() };
        for c in covariances {
            let got = DVec3::new(c.x_axis.x, c.y_axis.y, c.z_axis.z);
            assert!((got - DVec3::new(1e-4, 1.5e-4, 1e-4)).abs().max_element() < 0.05e-4, "{got}");
        }
    }
}
