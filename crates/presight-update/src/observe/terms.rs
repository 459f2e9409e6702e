//! The normal equations of one view: sums over its readings for its pose and for the poses of the objects that it
//! shows.

use presight_model::matrix::Matrix;

/// All numbers of a pose.
pub(crate) const AXES: [usize; 6] = [0, 1, 2, 3, 4, 5];

/// Sums over the readings of one view on one object. J_o and J_v are the derivatives of a residual e by the motion of
/// the object and of the view; readings are weighted by their information.
#[derive(Clone, Debug, Default)]
pub(crate) struct ObjectTerms {
    pub object: u32,
    /// Sum of J_o J_o'.
    pub own: Matrix,
    /// Sum of J_o J_v'.
    pub mixed: Matrix,
    /// Sum of J_v J_v'.
    pub view: Matrix,
    /// Sum of J_v J_o', weighted by the noise of the readings alone, as in estimates of poses.
    pub pull: Matrix,
    /// Sum of J_o e.
    pub of_object: [f64; 6],
    /// Sum of J_v e.
    pub of_view: [f64; 6],
}

/// Sums over all readings of one view.
#[derive(Clone, Debug, Default)]
pub(crate) struct Terms {
    pub objects: Vec<ObjectTerms>,
    /// Information on the view's pose: the stated one, and that of readings on objects with exact poses.
    pub information: Matrix,
    /// Information times the offset of the pose.
    pub pull: [f64; 6],
    /// Numbers of the pose that are uncertain.
    pub axes: Vec<usize>,
}
