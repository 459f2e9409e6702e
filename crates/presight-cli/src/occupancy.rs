//! `presight occupancy`: an occupancy grid of a scene, for planners.

use super::outputs::OutputFiles;
use super::{CommandOutcome, open_scene, print};
use presight::Result;
use presight::environment::IndexKind;
use presight::explore::{Cell, Grid, GridOptions};
use presight::files::ImportOptions;
use presight::tools::write_atomically;
use std::io::Write;
use std::path::PathBuf;

const EXAMPLES: &str = "Examples:
  presight occupancy hall.presight --out hall.yaml
  presight occupancy hall.glb --from-height 0.05 --to-height 0.6 --cell 0.02 --out low.yaml";

/// Write an occupancy grid of a scene as nav2's map_server reads it: YAML and PGM
///
/// A cell is occupied if a surface between the two heights above the floor reaches into it, free if a floor covers it
/// and no surface blocks it, and unknown without a floor or observations. The PGM gets the name of the YAML.
#[derive(Debug, clap::Args)]
#[command(after_help = EXAMPLES)]
pub struct Args {
    /// The model: a .glb or .gltf file, a .rhai script, or a store
    scene: PathBuf,

    /// The file to write, such as hall.yaml; hall.pgm is written next to it
    #[arg(long, value_name = "FILE.yaml")]
    out: PathBuf,

    /// Lowest height above the floor that is in the robot's way, metres
    #[arg(long, value_name = "METRES", default_value_t = GridOptions::default().from_height)]
    from_height: f64,

    /// Highest one, metres
    #[arg(long, value_name = "METRES", default_value_t = GridOptions::default().to_height)]
    to_height: f64,

    /// Side of a cell, metres
    #[arg(long, value_name = "METRES", default_value_t = GridOptions::default().cell)]
    cell: f64,

    /// Height of the floor, metres [default: the lowest large level surface]
    #[arg(long, value_name = "METRES", allow_hyphen_values = true)]
    floor: Option<f64>,
}

/// Runs the command.
///
/// # Errors
/// Errors from reading the scene, of the grid, and from writing.
pub fn run(args: &Args) -> Result<CommandOutcome> {
    let pgm = args.out.with_extension("pgm");
    let mut files = OutputFiles::default();
    files.add("--out", Some(&args.out), &["yaml", "yml"])?;
    files.add_any(&pgm)?;
    files.check_named([args.scene.as_path()])?;
    let options = GridOptions::default()
        .with_cell(args.cell)
        .with_from_height(args.from_height)
        .with_to_height(args.to_height)
        .with_floor(args.floor);
    options.check()?;
    let scene = open_scene(&args.scene, &ImportOptions::default(), IndexKind::None)?;
    let grid = Grid::of(scene.world.environment(), &options).map_err(|e| e.in_file(&args.scene))?;
    files.check_scene(&scene.files)?;
    let name = pgm.file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default();
    write_atomically(&pgm, |file| file.write_all(&grid.pgm()))?;
    write_atomically(&args.out, |file| file.write_all(grid.yaml(&name).as_bytes()))?;
    let [free, occupied, unknown] = [Cell::Free, Cell::Occupied, Cell::Unknown].map(|kind| grid.count(kind));
    print::data(&format!(
        "{} x {} cells, floor at {:.3} m: {free} free, {occupied} occupied, {unknown} unknown\n",
        grid.width, grid.height, grid.floor
    ))?;
    Ok(CommandOutcome::Done)
}
