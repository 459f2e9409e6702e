//! Deadlines of predictions, and the file of what they cost.

use presight::internal::inputs;
use presight::io::costs;
use presight::{Error, Predictor, Result};
use std::path::PathBuf;
use std::time::Duration;

/// The deadline of a prediction.
#[derive(Debug, clap::Args)]
pub struct DeadlineArgs {
    /// Give up what cannot be predicted in this time; exit status 4 if nothing can (CPU engine only)
    ///
    /// Of repeated predictions each one has this time.
    #[arg(long, value_name = "MS", allow_negative_numbers = true)]
    deadline_ms: Option<f64>,

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
            _ => Ok(()),
        }
    }

    /// The time of each prediction.
    pub fn limit(&self) -> Option<Duration> {
        self.deadline_ms.map(|ms| Duration::from_secs_f64(ms / 1e3))
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
