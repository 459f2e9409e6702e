//! `presight occupancy`: an occupancy grid of a scene, for planners.

use super::outputs::OutputFiles;
use super::{CommandOutcome, open_scene, print};
use presight::Result;
use presight::environment::IndexKind;
use presight::explore::{Cell, Grid, GridOptions, Level};
use presight::files::ImportOptions;
use presight::tools::write_atomically;
use serde_json::json;
use std::io::Write;
use std::path::{Path, PathBuf};

const EXAMPLES: &str = "Examples:
  presight occupancy site.presight --out site.yaml
  presight occupancy scenes/room.glb --from-height 0.05 --to-height 0.6 --cell 0.02 --out low.yaml
  presight occupancy hall.glb --level 1 --keepout hall-keepout.yaml --out hall.yaml";

/// Write an occupancy grid of a scene as nav2's map_server reads it: YAML and PGM
///
/// A cell is occupied if a surface between the two heights above the floor reaches into it, free if a floor covers it
/// and no surface blocks it, and unknown without a floor or observations. The floor is one level of the scene, with its
/// ramps and steps. The PGM gets the name of the YAML.
#[derive(Debug, clap::Args)]
#[command(after_help = EXAMPLES)]
pub struct Args {
    /// The model: a .glb or .gltf file, a .rhai script, or a store
    scene: PathBuf,

    /// The file to write, such as hall.yaml; hall.pgm is written next to it
    #[arg(long, value_name = "FILE.yaml")]
    out: PathBuf,

    /// Also write a mask for nav2's keepout filter: the objects and parts that are marked as uncertain
    #[arg(long, value_name = "FILE.yaml")]
    keepout: Option<PathBuf>,

    /// Lowest height above the floor that is in the robot's way, metres; steps of the floor are at most as high, and at
    /// most 0.1
    #[arg(long, value_name = "METRES", default_value_t = GridOptions::default().from_height)]
    from_height: f64,

    /// Highest one, metres
    #[arg(long, value_name = "METRES", default_value_t = GridOptions::default().to_height)]
    to_height: f64,

    /// Side of a cell, metres
    #[arg(long, value_name = "METRES", default_value_t = GridOptions::default().cell)]
    cell: f64,

    /// Height of the floor, metres [default: the lowest large level with free room above]
    #[arg(long, value_name = "METRES", allow_hyphen_values = true, conflicts_with = "level")]
    floor: Option<f64>,

    /// Number of the level from 1, the lowest, as listed for a scene of several
    #[arg(long, value_name = "N")]
    level: Option<usize>,

    /// Maximum slope of a floor, degrees
    #[arg(long, value_name = "DEGREES", default_value_t = GridOptions::default().slope_deg)]
    slope: f64,

    /// Print JSON
    #[arg(long)]
    json: bool,
}

/// Runs the command.
///
/// # Errors
/// Errors from reading the scene, of the grid, and from writing.
pub fn run(args: &Args) -> Result<CommandOutcome> {
    let mut files = OutputFiles::default();
    files.add("--out", Some(&args.out), &["yaml", "yml"])?;
    files.add_any(&pgm_of(&args.out))?;
    if let Some(keepout) = &args.keepout {
        files.add("--keepout", Some(keepout), &["yaml", "yml"])?;
        files.add_any(&pgm_of(keepout))?;
    }
    files.check_named([args.scene.as_path()])?;
    let options = GridOptions::default()
        .with_cell(args.cell)
        .with_from_height(args.from_height)
        .with_to_height(args.to_height)
        .with_floor(args.floor)
        .with_level(args.level)
        .with_slope_deg(args.slope);
    options.check()?;
    let scene = open_scene(&args.scene, &ImportOptions::default(), IndexKind::None)?;
    let environment = scene.world.environment();
    let grid = Grid::of(environment, &options).map_err(|e| e.in_file(&args.scene))?;
    files.check_scene(&scene.files)?;
    write(&grid, &args.out)?;
    let mask = args.keepout.as_ref().map(|keepout| (grid.keepout(environment), keepout));
    if let Some((mask, keepout)) = mask.as_ref() {
        write(mask, keepout)?;
    }
    notices(args, &grid).iter().for_each(|line| print::message(line));
    let [free, occupied, unknown] = [Cell::Free, Cell::Occupied, Cell::Unknown].map(|kind| grid.count(kind));
    let kept_out = mask.as_ref().map(|(mask, _)| mask.count(Cell::Occupied));
    if args.json {
        let level = |(k, level): (usize, &Level)| {
            json!({
                "level": k + 1, "height": level.height, "area": level.area, "lowest": level.lowest,
                "highest": level.highest,
            })
        };
        let value = json!({
            "width": grid.width, "height": grid.height, "cell": grid.cell, "origin": grid.origin.to_array(),
            "floor": grid.floor, "level": grid.level, "free": free, "occupied": occupied, "unknown": unknown,
            "keepout": kept_out, "levels": grid.levels.iter().enumerate().map(level).collect::<Vec<_>>(),
        });
        print::data(&format!("{value:#}\n"))?;
    } else {
        print::data(&format!(
            "{} x {} cells, floor at {:.3} m: {free} free, {occupied} occupied, {unknown} unknown{}\n",
            grid.width,
            grid.height,
            grid.floor,
            kept_out.map_or(String::new(), |count| format!(", {count} kept out"))
        ))?;
    }
    Ok(CommandOutcome::Done)
}

fn pgm_of(yaml: &Path) -> PathBuf {
    yaml.with_extension("pgm")
}

fn write(grid: &Grid, yaml: &Path) -> Result<()> {
    let pgm = pgm_of(yaml);
    let name = pgm.file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default();
    write_atomically(&pgm, |file| file.write_all(&grid.pgm()))?;
    write_atomically(yaml, |file| file.write_all(grid.yaml(&name).as_bytes()))
}

/// What a reader of the grid should know: other levels, and a grid without a free cell.
fn notices(args: &Args, grid: &Grid) -> Vec<String> {
    let mut lines = Vec::new();
    let levels = grid.levels.iter().enumerate();
    let list = levels.map(|(k, level)| format!("{} at {:.3} m ({:.0} m2)", k + 1, level.height, level.area));
    let list = list.collect::<Vec<_>>().join(", ");
    let (scene, is_free) = (args.scene.display(), grid.count(Cell::Free) > 0);
    if is_free && grid.levels.len() > 1 && args.level.is_none() && args.floor.is_none() {
        let this = grid.level.map_or("another level".to_owned(), |level| format!("level {level}"));
        lines.push(format!("note: {scene}: this grid is of {this}; --level N takes another one: {list}"));
    }
    if !is_free && grid.levels.is_empty() {
        lines.push(format!(
            "warning: {scene}: no cell is free: no level surface has {} m of free room above; lower --to-height, raise \
             --slope, or give a model with a floor",
            args.to_height
        ));
    } else if !is_free {
        lines.push(format!(
            "warning: {scene}: no cell is free at {:.3} m; --level N takes a level of the scene: {list}",
            grid.floor
        ));
    }
    lines
}
