//! `presight doctor`: tests the engines of this machine, and advises which to use and what to install.

use super::{CommandOutcome, features, flags, print};
use presight::Result;
use presight_studies::doctor::examine_engines;

const EXAMPLES: &str = "Examples:
  presight doctor

Exit status: 0 if all engines draw correct images, 1 if one does not or an adapter in use cannot be opened.";

/// Check the engines of this machine
///
/// Lists the adapters, draws a small scene with each through every stage, compares the images with the reference, and
/// reports which engine will be used and what to install.
#[derive(Debug, clap::Args)]
#[command(after_help = EXAMPLES)]
pub struct Args {}

/// Runs the command.
///
/// # Errors
/// [`presight::ErrorKind::System`] if the CPU engine's threads cannot be started, or stdout cannot be written.
pub fn run(_: &Args) -> Result<CommandOutcome> {
    let features = features();
    let features = if features.is_empty() { "no optional feature".into() } else { features.join(", ") };
    let (text, sound) = examine_engines()?;
    let text = format!("presight {}, built with {features}\n\n{text}", env!("CARGO_PKG_VERSION"));
    print::lines(flags::named(&text).lines())?;
    Ok(if sound { CommandOutcome::Done } else { CommandOutcome::Found })
}
