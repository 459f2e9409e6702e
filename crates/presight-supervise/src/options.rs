//! Options of supervision.

use presight_model::error::{Error, Result};
use std::time::Duration;

presight_model::options! {
    /// Options of a [`Supervisor`](crate::Supervisor).
    #[derive(Clone, Copy, Debug, PartialEq)]
    pub struct SuperviseOptions {
        /// Side of the cells, metres.
        cell: f64 = 0.1, with_cell;
        /// Width of the smallest intruder that a free cell cannot hide, metres.
        smallest: f64 = 0.07, with_smallest;
        /// Assumes that objects in the corridor reach the heights that the sensor sees, as safety scanners do.
        is_upright: bool = false, with_upright;
        /// Speed of the robot along the corridor, metres per second.
        speed: f64 = 0.0, with_speed;
        /// Standard deviation of the model's surfaces along their normals, metres.
        model_sigma: f64 = 0.0, with_model_sigma;
        /// Maximum expected number of chance intrusions in a frame.
        false_alarms: f64 = 1e-4, with_false_alarms;
        /// Share of arbitrary readings, which are neither right within the noise nor mixed at an edge of the model.
        arbitrary_readings: f64 = 1e-3, with_arbitrary_readings;
        /// Maximum time for a frame; `None` for no limit.
        deadline: Option<Duration> = None, with_deadline;
    }
}

impl SuperviseOptions {
    /// Checks all values.
    ///
    /// # Errors
    /// [`presight_model::ErrorKind::Usage`] for the first value that is out of range.
    pub fn check(&self) -> Result<()> {
        let positive = |x: f64| x > 0.0 && x.is_finite();
        let not_negative = |x: f64| x >= 0.0 && x.is_finite();
        for (name, value, is_sound, remedy) in [
            ("cell", self.cell, positive(self.cell), "give metres above 0"),
            ("smallest", self.smallest, positive(self.smallest), "give metres above 0"),
            ("speed", self.speed, not_negative(self.speed), "give metres per second of at least 0"),
            ("model_sigma", self.model_sigma, not_negative(self.model_sigma), "give metres of at least 0"),
            ("false_alarms", self.false_alarms, positive(self.false_alarms), "give a number above 0"),
            (
                "arbitrary_readings",
                self.arbitrary_readings,
                (0.0..=1.0).contains(&self.arbitrary_readings),
                "give a share of 0 to 1",
            ),
        ] {
            if !is_sound {
                return Err(Error::usage(format!("{name} of {value}"), remedy));
            }
        }
        match self.deadline {
            Some(deadline) if deadline.is_zero() => Err(Error::usage("a deadline of 0", "give a time above 0")),
            _ => Ok(()),
        }
    }
}
