//! Options of a learner.

use presight_model::error::{Error, Result};

presight_model::options! {
    /// Options of a [`Learner`](crate::Learner).
    #[derive(Clone, Copy, Debug, PartialEq)]
    pub struct LearnOptions {
        /// Distance after which a frame is a new view, metres.
        view_distance: f64 = 0.25, with_view_distance;
        /// Rotation after which a frame is a new view, radians.
        view_turn: f64 = 10f64.to_radians(), with_view_turn;
        /// Time after which a frame is a new view, seconds.
        view_time: f64 = 60.0, with_view_time;
        /// Maximum log-odds that one view adds, natural logarithm.
        max_per_view: f64 = 3.0, with_max_per_view;
        /// Minimum number of views for a decision.
        min_views: u32 = 3, with_min_views;
        /// Log-odds at which a decision is made, natural logarithm.
        decisive: f64 = 9.0, with_decisive;
        /// Minimum share of an object's decided cells that agree with a decision.
        min_agreeing: f64 = 0.8, with_min_agreeing;
        /// Distance that the robot must drive without getting lost before a view is believed, metres.
        settle: f64 = 2.0, with_settle;
        /// Edge of the voxels in which new objects are detected, metres.
        voxel: f64 = 0.1, with_voxel;
        /// Maximum number of rays of a frame that are compared.
        rays: usize = 8000, with_rays;
        /// Maximum number of views kept for fitting objects.
        views: usize = 400, with_views;
        /// Standard deviation of the model's surfaces, metres.
        model_sigma: f64 = 0.0, with_model_sigma;
    }
}

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
