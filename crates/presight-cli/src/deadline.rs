//! Deadlines of predictions, and the file of learnt costs.

use presight::files;
use presight::predict::Priority;
use presight::{Error, Predictor, Request, Result};
use std::path::PathBuf;
use std::time::Duration;

/// Flags of a prediction's deadline.
#[derive(Debug, clap::Args)]
pub struct DeadlineArgs {
    /// Give up what does not fit in this time, milliseconds; exit status 4 if nothing fits
    ///
    /// With --repeat or --poses the limit applies to each prediction; a pose of --poses for which nothing fits is given
    /// up as a whole, and the series goes on. A GPU without 64-bit atomics cannot keep a deadline: --backend auto then
    /// takes the CPU engine, and --backend gpu is refused.
    #[arg(long, value_name = "MS", allow_negative_numbers = true)]
    deadline_ms: Option<f64>,

    /// Smallest radius to which the view shrinks; if that still takes too long, an angle around the heading is kept
    #[arg(long, value_name = "M", default_value_t = 2.0, allow_negative_numbers = true, requires = "deadline_ms")]
    deadline_radius: f64,

    /// Keep directions near this heading longest: degrees to the left of the sensor's forward axis
    #[arg(long, value_name = "DEG", default_value_t = 0.0, allow_negative_numbers = true, requires = "deadline_ms")]
    deadline_heading: f64,

    /// Predict the features with these ids first, then the others from the longest image to the shortest
    #[arg(long, value_name = "ID,..", value_delimiter = ',', requires = "deadline_ms")]
    deadline_features: Vec<u32>,

    /// File of learnt prediction costs: read if it exists, and updated
    #[arg(long, value_name = "FILE.json", requires = "deadline_ms")]
    pub costs: Option<PathBuf>,
}

impl DeadlineArgs {
    /// Checks the flags without opening any file.
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

    /// Adds the deadline, if any, to a request.
    pub fn add_to(&self, request: Request) -> Request {
        let Some(ms) = self.deadline_ms else { return request };
        let priority = Priority::default()
            .with_min_radius(self.deadline_radius)
            .with_heading(self.deadline_heading.to_radians())
            .with_features(self.deadline_features.clone());
        request.with_deadline(Duration::from_secs_f64(ms / 1e3)).with_priority(priority)
    }

    /// Loads the costs file, if it exists.
    pub fn read_costs(&self, predictor: &mut Predictor) -> Result<()> {
        if let Some(path) = self.costs.as_ref().filter(|path| path.exists()) {
            predictor.set_costs(files::read_costs(path)?);
        }
        Ok(())
    }

    /// Saves the learnt costs.
    pub fn write_costs(&self, predictor: &Predictor) -> Result<()> {
        self.costs.as_ref().map_or(Ok(()), |path| files::write_costs(path, predictor.costs()))
    }
}
