//! Offsets of features from their places in a layer, by the views that found them.

use crate::observe::terms::AXES;
use glam::{DMat3, DQuat, DVec2, DVec3};
use presight_localize::matching::{Detection, Shape};
use presight_localize::verdict::{ObjectError, body_from_image};
use presight_model::environment::{Feature, FeatureShape};
use presight_model::geometry::{Pose, PoseEstimate};
use presight_model::matrix::{Matrix, add_to, apply, inverse, product, sandwich, scaled, turn};
use presight_model::sensor::Sensor;

/// Standard deviation along a direction that is not measured, in distances from the sensor.
const UNMEASURED: f64 = 1e3;
/// Minimum variance of a place, square metres: a micrometre.
const MIN_VARIANCE: f64 = 1e-12;

/// Offsets over views of the offsets of a feature's points, world axes: of one point, or of both ends of an edge.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct Offsets {
    pub views: u32,
    information: Matrix,
    weighted: [f64; 6],
    /// Sum of the covariances that the poses add. The views of a run share this error.
    by_pose: Matrix,
}

/// A sensor at a pose.
pub(crate) struct SensorAtPose<'a> {
    pub sensor: &'a Sensor,
    pub pose: &'a PoseEstimate,
    world_from_image: Pose,
}

impl<'a> SensorAtPose<'a> {
    pub fn new(sensor: &'a Sensor, pose: &'a PoseEstimate) -> Self {
        let world_from_image = pose.world_from_robot * sensor.spec().mount * body_from_image(sensor);
        Self { sensor, pose, world_from_image }
    }

    /// Position of the sensor, world, metres.
    pub fn position(&self) -> DVec3 {
        self.world_from_image.translation
    }

    /// The ray of a pixel, world axes, and its derivatives by column and row.
    pub fn ray(&self, at: DVec2) -> Option<(DVec3, [DVec3; 2])> {
        // A scanner of one row does not measure heights. Its detections are in its plane.
        let rows = if self.sensor.height() == 1 { 0.0 } else { 1.0 };
        let along = |du: f64, dv: f64| self.sensor.ray_at(at.x + du, rows * (at.y + dv));
        let ray = along(0.0, 0.0)?;
        let turned = |du: f64, dv: f64| along(du, dv).map_or(DVec3::ZERO, |there| (there - ray) / 0.1);
        let rotation = self.world_from_image.rotation;
        Some((rotation * ray, [rotation * turned(0.1, 0.0), rotation * (rows * turned(0.0, 0.1))]))
    }

    /// Joint covariance of points of the world by the stated error of the pose, square metres.
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

/// Covariance of a point at a range by the covariance of its pixel, square metres.
pub(crate) fn across(detection: &Detection, [u, v]: [DVec3; 2], range: f64) -> DMat3 {
    let c = detection.covariance;
    let outer = |a: DVec3, b: DVec3| DMat3::from_cols(b.x * a, b.y * a, b.z * a);
    range * range * (c.x_axis.x * outer(u, u) + c.x_axis.y * (outer(u, v) + outer(v, u)) + c.y_axis.y * outer(v, v))
}

fn padded(m: DMat3) -> Matrix {
    let rows = m.transpose();
    std::array::from_fn(|i| std::array::from_fn(|j| if i < 3 && j < 3 { rows.col(i)[j] } else { 0.0 }))
}

impl Offsets {
    /// The offset in one view, from the model's points (world) to the detection. `shares` are the positions of the
    /// points along an edge, from 0 to 1.
    pub fn of(
        sensor: &SensorAtPose<'_>,
        detection: &Detection,
        points: &[DVec3],
        shares: Option<[f64; 2]>,
    ) -> Option<Self> {
        match &detection.shape {
            Shape::Segment { ends, .. } => Self::of_edge(sensor, detection, ends, points, shares?),
            Shape::Patch(_) => None,
            shape => {
                let middle = points.iter().sum::<DVec3>() / points.len().max(1) as f64;
                Self::of_point(sensor, detection, (shape.centre(), shape.points().len()), middle)
            }
        }
    }

    fn of_point(
        sensor: &SensorAtPose<'_>,
        detection: &Detection,
        (at, corners): (DVec2, usize),
        model: DVec3,
    ) -> Option<Self> {
        let (ray, steps) = sensor.ray(at)?;
        let along = ray.dot(model - sensor.position());
        let range = detection.properties.range.as_ref();
        let found = sensor.position() + range.map_or(along, |range| range.mean) * ray;
        let outer = |a: DVec3| DMat3::from_cols(a.x * a, a.y * a, a.z * a);
        let [u, v] = steps.map(|step| step - step.dot(ray) * ray);
        // The mean of several corners has a smaller variance than one corner.
        let mut own = across(detection, [u, v], along) * (1.0 / corners.max(1) as f64);
        // A detection without a range does not measure the distance, and a scanner of one row does not measure the
        // height.
        let unknown = (UNMEASURED * along).powi(2);
        own += range.map_or(unknown, |range| range.variance) * outer(ray);
        if v == DVec3::ZERO {
            own += unknown * outer(ray.cross(u).try_normalize()?);
        }
        let information = inverse(&padded(own), &AXES);
        let off = found - model;
        let weighted = apply(&information, &[off.x, off.y, off.z, 0.0, 0.0, 0.0]);
        Some(Self { views: 1, information, weighted, by_pose: sensor.by_pose(&[model]) })
    }

    /// The image line of an edge is a plane in the world. It measures the distance of each end of the part from that
    /// plane.
    fn of_edge(
        sensor: &SensorAtPose<'_>,
        detection: &Detection,
        ends: &[DVec2; 2],
        points: &[DVec3],
        shares: [f64; 2],
    ) -> Option<Self> {
        let [a, b] = points else { return None };
        let (first, last) = (sensor.ray(ends[0])?, sensor.ray(ends[1])?);
        let normal = first.0.cross(last.0).try_normalize()?;
        let mut sums = Self { views: 1, by_pose: sensor.by_pose(&[*a, *b]), ..Self::default() };
        for ((p, t), steps) in [a, b].into_iter().zip(shares).zip([first.1, last.1]) {
            let away = *p - sensor.position();
            let variance = normal.dot(across(detection, steps, away.length()) * normal) + MIN_VARIANCE;
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

    /// Posterior covariance of a feature's points about the points of the model, world axes. The model's points stay on
    /// their surface, so the square of the most likely offset is added. `shift` is the motion of the points since the
    /// views.
    fn posterior(&self, prior: &Matrix, shift: &[f64; 6]) -> Matrix {
        let mut known = scaled(&self.by_pose, 1.0 / f64::from(self.views.max(1)));
        (0..6).for_each(|i| known[i][i] += MIN_VARIANCE);
        // Information of views that share an error (Woodbury).
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
        // An exact coordinate stays exact.
        let axes: Vec<usize> = AXES.into_iter().filter(|i| prior[*i][*i] > 0.0).collect();
        let mut sum = inverse(prior, &axes);
        add_to(&mut sum, &information);
        let after = inverse(&sum, &axes);
        let off = apply(&after, &weighted);
        std::array::from_fn(|i| std::array::from_fn(|j| 0.5 * (after[i][j] + after[j][i]) + off[i] * off[j]))
    }
}

/// The shape of a feature with its posterior covariance. `before` and `now` are the poses of its object in the views
/// and now.
pub(crate) fn located(feature: &Feature, sums: &Offsets, (before, now): (&Pose, &Pose)) -> FeatureShape {
    let mut shape = feature.shape.clone();
    let points: Vec<DVec3> = match &shape {
        FeatureShape::Point { at, .. } | FeatureShape::Reflector { at, .. } => vec![*at],
        FeatureShape::Segment { ends, .. } => ends.to_vec(),
        FeatureShape::Fiducial { corners, .. } => vec![corners.iter().sum::<DVec3>() / 4.0],
        FeatureShape::Patch { .. } | FeatureShape::Contour { .. } => return shape,
    };
    let mut shift = [0.0; 6];
    for (k, p) in points.iter().enumerate() {
        let by = now.transform_point(*p) - before.transform_point(*p);
        (0..3).for_each(|i| shift[3 * k + i] = by[i]);
    }
    let refined = |blocks: Matrix| {
        let turned = |rotation: DQuat, m: &Matrix| sandwich(&turn(rotation), m);
        turned(now.rotation.conjugate(), &sums.posterior(&turned(now.rotation, &blocks), &shift))
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

    /// By hand: the layer states 3 cm, and three views of 1 cm each put the reflector 2 cm away along x. Together the
    /// views have a variance of 1/3 cm2, so the most likely offset is 9 / (9 + 1/3) of 2 cm. A common error of the
    /// poses of 1 cm leaves a variance of 4/3 cm2. If the object was moved there since, the offset is 0.
    #[test]
    fn a_reflectors_covariance_shrinks_about_its_point() {
        let mut sums = Offsets { views: 3, ..Offsets::default() };
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
        // A place that is exact in the layer stays exact.
        let exact = feature(FeatureShape::Reflector { at: DVec3::X, covariance: DMat3::ZERO });
        assert_eq!(located(&exact, &sums, here()), exact.shape);
    }

    /// A camera with a focal length of 100 pixels is 2 m from features whose places have a deviation of 1 cm. It finds
    /// them one pixel (2 cm) to the right (-y), with a noise of half a pixel (1 cm). By hand: across the ray half of
    /// the variance remains, and half of the 2 cm is accepted. Along the ray the covariance does not change.
    #[test]
    fn an_image_measures_offsets_across_its_rays() {
        let camera = Camera::pinhole(160, 120, 100.0, 100.0, 79.5, 59.5);
        let sensor = Sensor::new(SensorSpec::new("camera", "grey", Geometry::Camera(camera))).unwrap();
        let pose = PoseEstimate::new(RobotPose::IDENTITY, PoseCovariance::from_sigmas([1e-6; 6]));
        let sensor = SensorAtPose::new(&sensor, &pose);
        let p = DVec3::new(2.0, 0.0, 0.0);
        let found = Detection::point(DVec2::new(80.5, 59.5), 0.5);
        let sums = Offsets::of(&sensor, &found, &[p], None).unwrap();
        let got =
            diagonal(&located(&feature(FeatureShape::Point { at: p, covariance: of_sigma(0.01) }), &sums, here()));
        let expected = DVec3::new(1e-4, 1.5e-4, 0.5e-4);
        assert!((got - expected).abs().max_element() < 0.02e-4, "{got}");
        // An upright edge of 1 m about the same point: each end gets the same covariance across the edge, and its prior
        // one along it.
        let ends = [DVec3::new(2.0, 0.0, -0.5), DVec3::new(2.0, 0.0, 0.5)];
        let pixels = [DVec2::new(80.5, 84.5), DVec2::new(80.5, 34.5)];
        let found = Detection::new(Shape::Segment { ends: pixels, corners: [false; 2] }, 0.5);
        let sums = Offsets::of(&sensor, &found, &ends, Some([0.0, 1.0])).unwrap();
        let shape = FeatureShape::Segment { ends, covariances: [of_sigma(0.01); 2], cross: DMat3::ZERO };
        let FeatureShape::Segment { covariances, .. } = located(&feature(shape), &sums, here()) else { panic!() };
        for c in covariances {
            let got = DVec3::new(c.x_axis.x, c.y_axis.y, c.z_axis.z);
            assert!((got - DVec3::new(1e-4, 1.5e-4, 1e-4)).abs().max_element() < 0.05e-4, "{got}");
        }
    }
}
