//! Deadlines of predictions, and the file of what they cost.

use presight::deadline::Priority;
use presight::io::costs;
use presight::{Error, Predictor, Request, Result};
use presight_files::inputs;
use std::path::PathBuf;
use std::time::Duration;

/// The deadline of a prediction.
#[derive(Debug, clap::Args)]
pub struct DeadlineArgs {
    /// Give up what cannot be predicted in this time; exit status 4 if nothing can (CPU engine only)
    ///
    /// Of repeated predictions, and of those at many poses, each one has this time.
    #[arg(long, value_name = "MS", allow_negative_numbers = true)]
    deadline_ms: Option<f64>,

    /// Least radius to which the view shrinks; if that is too much, it shrinks to an angle around the heading
    #[arg(long, value_name = "M", default_value_t = 2.0, allow_negative_numbers = true, requires = "deadline_ms")]
    deadline_radius: f64,

    /// Give up what is near this heading last: degrees from the sensor's forward axis, to the left
    #[arg(long, value_name = "DEG", default_value_t = 0.0, allow_negative_numbers = true, requires = "deadline_ms")]
    deadline_heading: f64,

    /// Find these features first, by number; then those with the longest images
    #[arg(long, value_name = "ID,..", value_delimiter = ',', requires = "deadline_ms")]
    deadline_features: Vec<u32>,

    /// Learn what predictions cost, and go on from what the file holds; it is made if it is not there
    #[arg(long, value_name = "FILE.json", requires = "deadline_ms")]
    pub costs: Option<PathBuf>,
}

impl DeadlineArgs {
    /// Checks them without touching the world.
    pub fn check(&self) -> Result<()> {
        match self.deadline_ms {
            Some(ms) if !(ms > 0.0 && ms <= 1e9) => {
                Err(Error::usage(format!("--deadline-ms {ms}"), "give milliseconds above 0 and up to 1e9"))
            }
            _ if !(self.deadline_radius > 0.0 && self.deadline_radius.is_finite()) => {
                let what = format!("--deadline-radius {}", self.deadline_radius);
                Err(Error::usage(what, "give metres above 0, such as 2"))
            }
            _ if !self.deadline_heading.is_finite() => {
                let what = format!("--deadline-heading {}", self.deadline_heading);
                Err(Error::usage(what, "give degrees, such as 30"))
            }
            _ => Ok(()),
        }
    }

    /// A request with the time of each prediction.
    pub fn add_to(&self, request: Request) -> Request {
        let Some(ms) = self.deadline_ms else { return request };
        let priority = Priority::default()
            .with_least_radius(self.deadline_radius)
            .with_heading(self.deadline_heading.to_radians())
            .with_features(self.deadline_features.clone());
        request.with_deadline(Duration::from_secs_f64(ms / 1e3)).with_priority(priority)
    }

    /// Goes on from the file, if it is there.
    pub fn read_costs(&self, predictor: &mut Predictor) -> Result<()> {
        if let Some(path) = self.costs.as_ref().filter(|path| path.exists()) {
            predictor.set_costs(costs::read(path)?);
            inputs::forget(path);
        }
        Ok(())
    }

    /// Keeps what was learnt.
    pub fn write_costs(&self, predictor: &Predictor) -> Result<()> {
        self.costs.as_ref().map_or(Ok(()), |path| costs::write(path, predictor.costs()))
    }
}
