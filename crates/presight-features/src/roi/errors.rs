//! The error model: sensor, object and feature as one standard normal vector, and its effect on material points.
//!
//! Everything is rotated into the sensor's body axes once. The derivative of an image coordinate with gradient g at p
//! then takes two scalar products per error: -t . g - r . (p x g) for the sensor, t . g + r . (q x g) for the object
//! with q from the object's origin, and e0 . (s0 g) + e1 . (s1 g) for the ends of the feature.

use glam::{DMat3, DVec3};
use presight_model::environment::FeatureShape;
use presight_model::error::Result;
use presight_model::geometry::{InObject, InWorld, Pose, PoseCovariance};
use presight_model::matrix::square_root;

/// Maximum number of errors: six for each pose, three for each end.
pub const ERRORS: usize = 3 * KIND;

/// Number of errors of one kind.
pub const KIND: usize = 6;

/// One entry for each error: sensor, object, ends.
pub(super) type ErrorVector = [[f64; KIND]; 3];

/// Applies a function to every entry.
#[inline]
pub(super) fn each(xi: &ErrorVector, f: impl Fn(f64) -> f64) -> ErrorVector {
    xi.map(|kind| kind.map(&f))
}

/// Square root of a pose's covariance: (translation, rotation) for one unit of each of six standard normal variables.
#[derive(Clone, Copy, Debug, Default)]
pub struct PoseErrors([[DVec3; 2]; KIND]);

impl PoseErrors {
    /// From a covariance, along the same axes.
    pub fn new<A>(covariance: &PoseCovariance<A>) -> Self {
        Self(pairs(&square_root(covariance.as_rows())))
    }

    fn turned(&self, turn: &DMat3) -> [[DVec3; 2]; KIND] {
        self.0.map(|pair| pair.map(|v| *turn * v))
    }
}

/// A sensor's uncertain pose, shared by all features seen from it.
#[derive(Clone, Debug)]
pub struct Viewpoint {
    world_from_body: Pose,
    body_from_world: DMat3,
    /// The sensor's errors, which are the same for every feature.
    columns: Columns,
    /// Roots of the summed squares of translations and of rotations.
    size: [f64; 2],
}

impl Viewpoint {
    /// From a sensor's pose and its covariance.
    ///
    /// # Errors
    /// The errors of [`Pose::check`].
    pub fn new(world_from_body: &Pose, covariance: &PoseCovariance<InWorld>) -> Result<Self> {
        world_from_body.check()?;
        let body_from_world = world_from_body.rotation_matrix().transpose();
        let errors = PoseErrors::new(covariance).turned(&body_from_world);
        let columns = Columns::new(&errors.map(|pair| pair.map(|v| -v)));
        Ok(Self { world_from_body: *world_from_body, body_from_world, columns, size: sizes(&errors) })
    }
}

impl Viewpoint {
    /// Transforms a point from the world to the body frame.
    pub(crate) fn in_body(&self, p_in_world: DVec3) -> DVec3 {
        self.body_from_world * (p_in_world - self.world_from_body.translation)
    }

    /// Both vectors of a sensor error, negated, body axes.
    pub fn pair(&self, i: usize) -> [DVec3; 2] {
        self.columns.pair(i)
    }
}

/// The errors of one kind, body axes: two vectors per error, stored by coordinate.
#[derive(Clone, Copy, Debug, Default)]
pub struct Columns {
    first: [[f64; KIND]; 3],
    second: [[f64; KIND]; 3],
}

impl Columns {
    fn new(pairs: &[[DVec3; 2]; KIND]) -> Self {
        let mut columns = Self::default();
        for (i, [first, second]) in pairs.iter().enumerate() {
            for k in 0..3 {
                columns.first[k][i] = first[k];
                columns.second[k][i] = second[k];
            }
        }
        columns
    }

    /// Both vectors of an error.
    pub fn pair(&self, i: usize) -> [DVec3; 2] {
        [&self.first, &self.second].map(|of| DVec3::new(of[0][i], of[1][i], of[2][i]))
    }

    /// Sum of all errors with these coefficients.
    fn sum(&self, xi: &[f64; KIND]) -> [DVec3; 2] {
        // Two lanes.
        let part = |of: &[f64; KIND]| {
            let [a, b] = [0, 1].map(|k| of[k] * xi[k] + of[k + 2] * xi[k + 2] + of[k + 4] * xi[k + 4]);
            a + b
        };
        [&self.first, &self.second].map(|of| DVec3::new(part(&of[0]), part(&of[1]), part(&of[2])))
    }

    /// Derivatives with respect to each error: the products of its two vectors with `g` and `w`.
    #[inline]
    fn slopes(&self, [g, w]: [DVec3; 2]) -> [f64; KIND] {
        let ([a, b, c], [d, e, f]) = (&self.first, &self.second);
        std::array::from_fn(|i| a[i] * g.x + b[i] * g.y + c[i] * g.z + d[i] * w.x + e[i] * w.y + f[i] * w.z)
    }
}

/// All errors that affect one feature.
#[derive(Clone, Debug)]
pub struct FeatureErrorModel {
    body_from_frame: DMat3,
    /// The frame's origin in the body frame, composed in f64; world positions are subtracted first.
    origin: DVec3,
    /// Errors of sensor, object and ends.
    columns: [Columns; 3],
    /// As in [`Viewpoint`], for sensor, object and ends.
    sizes: [[f64; 2]; 3],
}

/// A material point of a feature: its position in the feature's frame, and its share of the error of each end.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BodyPoint {
    /// Position in the feature's frame, metres.
    pub at: DVec3,
    /// Shares of the errors of the first and second end; (1, 0) for rigid features.
    pub shares: [f64; 2],
}

impl BodyPoint {
    /// The point of a segment at the fraction `t` of its length.
    pub fn on_segment(ends: &[DVec3; 2], t: f64) -> Self {
        Self { at: ends[0].lerp(ends[1], t), shares: [1.0 - t, t] }
    }

    /// A point of a rigid feature.
    pub fn rigid(at: DVec3) -> Self {
        Self { at, shares: [1.0, 0.0] }
    }
}

/// The nominal position of a material point, body axes.
#[derive(Clone, Copy, Debug)]
pub struct NominalPoint {
    /// Relative to the sensor.
    pub p: DVec3,
    /// Relative to the origin of the feature's frame.
    pub q: DVec3,
    pub shares: [f64; 2],
}

impl FeatureErrorModel {
    /// The errors of a feature seen from a pose. `world_from_frame` is the pose of the feature's object (identity for
    /// the world).
    ///
    /// # Errors
    /// The errors of [`Pose::check`] for either pose.
    pub fn new(
        world_from_body: &Pose,
        sensor: &PoseCovariance<InWorld>,
        world_from_frame: &Pose,
        object: Option<&PoseCovariance<InObject>>,
        shape: &FeatureShape,
    ) -> Result<Self> {
        world_from_frame.check()?;
        let (viewpoint, object) = (Viewpoint::new(world_from_body, sensor)?, object.map(PoseErrors::new));
        Ok(Self::seen_from(&viewpoint, world_from_frame, object.as_ref(), shape))
    }

    /// Same as [`FeatureErrorModel::new`], with precomputed data that many features share.
    pub fn seen_from(
        viewpoint: &Viewpoint,
        world_from_frame: &Pose,
        object: Option<&PoseErrors>,
        shape: &FeatureShape,
    ) -> Self {
        let body_from_frame = viewpoint.body_from_world * world_from_frame.rotation_matrix();
        let apart = world_from_frame.translation - viewpoint.world_from_body.translation;
        let mut columns = [viewpoint.columns, Columns::default(), Columns::default()];
        let mut sizes = [viewpoint.size, [0.0; 2], [0.0; 2]];
        if let Some(object) = object {
            let turned = object.turned(&body_from_frame);
            (columns[1], sizes[1]) = (Columns::new(&turned), self::sizes(&turned));
        }
        if let Some(ends) = ends_errors(shape) {
            let ends = ends.map(|pair| pair.map(|v| body_from_frame * v));
            (columns[2], sizes[2]) = (Columns::new(&ends), self::sizes(&ends));
        }
        Self { body_from_frame, origin: viewpoint.body_from_world * apart, columns, sizes }
    }

    /// Number of independent errors.
    pub fn dimensions(&self) -> usize {
        self.used().count()
    }

    /// The exact position of a point in the body frame under errors `xi` (standard normal, one for each dimension).
    pub fn place(&self, point: &BodyPoint, xi: &[f64]) -> DVec3 {
        let mut all = ErrorVector::default();
        for (i, x) in self.used().zip(xi) {
            all.as_flattened_mut()[i] = *x;
        }
        self.moved(&self.nominal(point), &all)
    }

    /// Indices of the errors that are not 0.
    pub(super) fn used(&self) -> impl Iterator<Item = usize> {
        (0..ERRORS).filter(|i| self.pair(*i) != [DVec3::ZERO; 2])
    }

    /// Both vectors of an error, body axes.
    pub fn pair(&self, i: usize) -> [DVec3; 2] {
        self.columns[i / KIND].pair(i % KIND)
    }

    /// Returns true if the object's pose has errors.
    pub(crate) fn has_object(&self) -> bool {
        self.sizes[1] != [0.0; 2]
    }

    /// Returns true if the feature's own position has errors.
    fn has_ends(&self) -> bool {
        self.sizes[2] != [0.0; 2]
    }

    /// Position without errors.
    pub fn nominal(&self, point: &BodyPoint) -> NominalPoint {
        let q = self.body_from_frame * point.at;
        NominalPoint { p: self.origin + q, q, shares: point.shares }
    }

    /// Transforms a point from the body frame to the feature's frame.
    pub(crate) fn in_frame(&self, p_in_body: DVec3) -> DVec3 {
        self.body_from_frame.transpose() * (p_in_body - self.origin)
    }

    /// Position with errors, body frame.
    pub(super) fn moved(&self, point: &NominalPoint, xi: &ErrorVector) -> DVec3 {
        self.motion(xi).place(point)
    }

    /// Motion of all points under errors. It is exact, because object and sensor may turn by large angles.
    pub(super) fn motion(&self, xi: &ErrorVector) -> Motion {
        let [sensor, object, ends] = &self.columns;
        let object = self.has_object().then(|| object.sum(&xi[1])).map(|[shift, turn]| (Turn::new(turn), shift));
        let ends = self.has_ends().then(|| ends.sum(&xi[2]));
        // The sensor's columns are negated.
        let [shift, turn] = sensor.sum(&xi[0]);
        Motion { ends, object, shift: self.origin + shift, turn: Turn::new(turn) }
    }

    /// Derivatives, with respect to each error at 0, of a function with the gradient `g` at a point.
    #[inline]
    pub(super) fn slopes(&self, point: &NominalPoint, g: DVec3) -> ErrorVector {
        let [sensor, object, ends] = &self.columns;
        let none = [0.0; KIND];
        [
            sensor.slopes([g, point.p.cross(g)]),
            if self.has_object() { object.slopes([g, point.q.cross(g)]) } else { none },
            if self.has_ends() { ends.slopes([point.shares[0] * g, point.shares[1] * g]) } else { none },
        ]
    }

    /// Upper bound on the standard deviation of a point's position, body frame, metres, by the triangle inequality.
    pub fn spread(&self, point: &NominalPoint) -> f64 {
        let [sensor, object, ends] = &self.sizes;
        let a = sensor[0] + sensor[1] * point.p.length();
        let b = object[0] + object[1] * point.q.length();
        let c = ends[0] * point.shares[0].abs() + ends[1] * point.shares[1].abs();
        (a * a + b * b + c * c).sqrt()
    }
}

/// Motion of the points of a feature under errors, body frame.
pub(super) struct Motion {
    /// Shifts of both ends, in the feature's frame.
    ends: Option<[DVec3; 2]>,
    /// Rotation about the frame's origin, and translation of the object.
    object: Option<(Turn, DVec3)>,
    /// Vector from the sensor to the frame's origin, before the sensor turns.
    shift: DVec3,
    turn: Turn,
}

impl Motion {
    pub fn place(&self, point: &NominalPoint) -> DVec3 {
        let mut v = point.q;
        if let Some([first, second]) = self.ends {
            v += first * point.shares[0] + second * point.shares[1];
        }
        if let Some((turn, shift)) = self.object {
            v = turn.of(v) + shift;
        }
        self.turn.of(self.shift + v)
    }
}

/// Exp(turn) with sin(a) / a and (1 - cos(a)) / a^2 of its angle a; small angles use series.
#[derive(Clone, Copy)]
struct Turn {
    turn: DVec3,
    sine: f64,
    versine: f64,
}

impl Turn {
    fn new(turn: DVec3) -> Self {
        let square = turn.length_squared();
        let (sine, versine) = if square > 0.06 {
            let angle = square.sqrt();
            let (sin, cos) = angle.sin_cos();
            (sin / angle, (1.0 - cos) / square)
        } else {
            // The series are accurate to 1e-13 here.
            (
                1.0 - square / 6.0 * (1.0 - square / 20.0 * (1.0 - square / 42.0 * (1.0 - square / 72.0))),
                0.5 - square / 24.0 * (1.0 - square / 30.0 * (1.0 - square / 56.0 * (1.0 - square / 90.0))),
            )
        };
        Self { turn, sine, versine }
    }

    fn of(&self, v: DVec3) -> DVec3 {
        let across = self.turn.cross(v);
        v + self.sine * across + self.versine * self.turn.cross(across)
    }
}

fn sizes(pairs: &[[DVec3; 2]; KIND]) -> [f64; 2] {
    [0, 1].map(|k| pairs.iter().map(|pair| pair[k].length_squared()).sum::<f64>().sqrt())
}

/// Splits the columns of a six-row factor into pairs of vectors.
fn pairs(f: &[[f64; 6]; 6]) -> [[DVec3; 2]; KIND] {
    std::array::from_fn(|c| [DVec3::new(f[0][c], f[1][c], f[2][c]), DVec3::new(f[3][c], f[4][c], f[5][c])])
}

/// Errors of both ends for unit normal variables, in the feature's frame. Rigid features have one end. `None` for
/// exactly known features.
fn ends_errors(shape: &FeatureShape) -> Option<[[DVec3; 2]; KIND]> {
    let exact = |m: &DMat3| *m == DMat3::ZERO;
    let rows = |m: &DMat3| m.transpose().to_cols_array_2d();
    let column = |f: &[[f64; 3]; 3], c: usize| DVec3::new(f[0][c], f[1][c], f[2][c]);
    Some(match shape {
        FeatureShape::Segment { covariances: [a, b], .. } if exact(a) && exact(b) => return None,
        FeatureShape::Segment { covariances: [a, b], cross, .. } if exact(cross) => {
            let (f, g) = (square_root(&rows(a)), square_root(&rows(b)));
            std::array::from_fn(|c| match c {
                0..3 => [column(&f, c), DVec3::ZERO],
                _ => [DVec3::ZERO, column(&g, c - 3)],
            })
        }
        FeatureShape::Segment { covariances: [a, b], cross, .. } => {
            let (a, b, across) = (rows(a), rows(b), rows(cross));
            pairs(&square_root(&std::array::from_fn(|i| {
                std::array::from_fn(|j| match (i / 3, j / 3) {
                    (0, 0) => a[i][j],
                    (0, _) => across[i][j - 3],
                    (_, 0) => across[j][i - 3],
                    _ => b[i - 3][j - 3],
                })
            })))
        }
        FeatureShape::Point { covariance, .. }
        | FeatureShape::Patch { covariance, .. }
        | FeatureShape::Reflector { covariance, .. }
        | FeatureShape::Fiducial { covariance, .. }
        | FeatureShape::Contour { covariance, .. } => {
            if exact(covariance) {
                return None;
            }
            let f = square_root(&rows(covariance));
            std::array::from_fn(|c| if c < 3 { [column(&f, c), DVec3::ZERO] } else { [DVec3::ZERO; 2] })
        }
    })
}
