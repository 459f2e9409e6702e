//! Options of a learner.

use presight_model::error::{Error, Result};

/// Options of a [`Learner`](crate::Learner).
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
pub struct LearnOptions {
    /// Distance after which a frame is a new view, metres.
    pub view_distance: f64,
    /// Rotation after which a frame is a new view, radians.
    pub view_turn: f64,
    /// Time after which a frame is a new view, seconds.
    pub view_time: f64,
    /// Maximum log-odds that one view adds, natural logarithm.
    pub max_per_view: f64,
    /// Minimum number of views for a decision.
    pub min_views: u32,
    /// Log-odds at which a decision is made, natural logarithm.
    pub decisive: f64,
    /// Minimum share of an object's decided cells that agree with a decision.
    pub min_agreeing: f64,
    /// Distance that the robot must drive without getting lost before a view is believed, metres.
    pub settle: f64,
    /// Edge of the voxels in which new objects are detected, metres.
    pub voxel: f64,
    /// Maximum number of rays of a frame that are compared.
    pub rays: usize,
    /// Maximum number of views kept for fitting objects.
    pub views: usize,
    /// Standard deviation of the model's surfaces, metres.
    pub model_sigma: f64,
}

impl Default for LearnOptions {
    fn default() -> Self {
        Self {
            view_distance: 0.25,
            view_turn: 10f64.to_radians(),
            view_time: 60.0,
            max_per_view: 3.0,
            min_views: 3,
            decisive: 9.0,
            min_agreeing: 0.8,
            settle: 2.0,
            voxel: 0.1,
            rays: 8000,
            views: 400,
            model_sigma: 0.0,
        }
    }
}

presight_model::with_options!(
    LearnOptions:
    with_view_distance view_distance: f64,
    with_view_turn view_turn: f64,
    with_view_time view_time: f64,
    with_max_per_view max_per_view: f64,
    with_min_views min_views: u32,
    with_decisive decisive: f64,
    with_min_agreeing min_agreeing: f64,
    with_settle settle: f64,
    with_voxel voxel: f64,
    with_rays rays: usize,
    with_views views: usize,
    with_model_sigma model_sigma: f64,
);

impl LearnOptions {
    /// Checks all values.
    ///
    /// # Errors
    /// [`presight_model::ErrorKind::Usage`] for the first value that is out of range.
    pub(crate) fn check(&self) -> Result<()> {
        for (name, value) in [
            ("view_distance", self.view_distance),
            ("view_turn", self.view_turn),
            ("view_time", self.view_time),
            ("max_per_view", self.max_per_view),
            ("decisive", self.decisive),
            ("min_agreeing", self.min_agreeing),
            ("voxel", self.voxel),
            ("rays", self.rays as f64),
            ("views", self.views as f64),
        ] {
            if !(value > 0.0 && value.is_finite()) {
                return Err(Error::usage(format!("{name} of {value}"), "give a finite number above 0"));
            }
        }
        if !(self.model_sigma >= 0.0 && self.model_sigma.is_finite() && self.settle >= 0.0) {
            let what = format!("model_sigma of {} and settle of {}", self.model_sigma, self.settle);
            return Err(Error::usage(what, "give finite metres of at least 0"));
        }
        Ok(())
    }
}
