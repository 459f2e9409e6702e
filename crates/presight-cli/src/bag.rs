//! `presight bag`: the content of a ROS 2 bag, and the parts that presight takes from it.

use super::bag_args::BagArgs;
use super::{CommandOutcome, flags, print};
use presight::Result;
use presight::files::BagReport;
use std::path::PathBuf;

const EXAMPLES: &str = "Examples:
  presight bag drive.mcap
  presight bag drive.mcap --topic /camera/depth/image --base base_link
  presight bag drive.mcap --json | jq .topics";

/// Show the topics, frames and times of a ROS 2 bag, and what presight takes from it
///
/// BAG is an MCAP file, an SQLite file (.db3), or the folder that `ros2 bag record` makes. Commands that take a log
/// take a bag, with the same flags. ROS need not be installed. Exit status 1 if presight can take no log from the bag.
#[derive(Debug, clap::Args)]
#[command(after_help = EXAMPLES)]
pub struct Args {
    /// The bag
    bag: PathBuf,

    #[command(flatten)]
    choices: BagArgs,

    /// Print JSON
    #[arg(long)]
    json: bool,
}

/// Runs the command.
///
/// # Errors
/// A bag that cannot be read, or that has no topic for a log.
pub fn run(args: &Args) -> Result<CommandOutcome> {
    let report = BagReport::of(&args.bag, &args.choices.options()?)?;
    if args.json {
        print::data(&(flags::named(&report.to_json()) + "\n"))?;
    } else {
        print::lines(report.lines().iter().map(|line| flags::named(line)))?;
    }
    report.check()?;
    Ok(CommandOutcome::Done)
}
