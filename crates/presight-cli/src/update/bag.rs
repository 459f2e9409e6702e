//! The ROS 2 bag of findings.

use super::Args;
use crate::compared_bag::ComparedBag;
use crate::output_bag::OutputBag;
use crate::outputs::OutputFiles;
use presight::ros;
use presight::update::SiteFindings;
use presight::{Result, Scene};

/// The bag of `--mcap`.
pub fn open(args: &Args) -> Result<Option<ComparedBag>> {
    let bag = OutputBag::of("--mcap", args.mcap.as_deref(), &mut OutputFiles::default())?;
    bag.map(|bag| ComparedBag::new(bag, args.drive.threads)).transpose()
}

/// Adds the findings at the time of the last frame, and ends the bag.
pub fn conclude(compared: &mut ComparedBag, scene: &Scene, findings: &SiteFindings) -> Result<()> {
    compared.conclude(|origin| vec![ros::findings(findings, scene.world.environment(), origin)])?;
    compared.finish()
}
