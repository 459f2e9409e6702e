//! The command line. Arguments are checked before any file is opened. Only this crate prints.

#[cfg(feature = "ros")]
mod bag;
mod bag_args;
mod bar;
mod batch;
mod compare;
#[cfg(feature = "ros")]
mod compared_bag;
mod deadline;
mod doctor;
mod drive;
#[cfg(all(feature = "gpu", target_os = "linux"))]
mod drivers;
#[cfg(feature = "edit")]
mod edit;
mod engine_args;
#[cfg(feature = "store")]
mod env;
#[cfg(feature = "store")]
mod explore;
mod features;
mod file_names;
mod flags;
mod frame_args;
mod headings;
mod index;
mod inspect;
mod layers;
mod localize;
mod motion_args;
#[cfg(feature = "store")]
mod occupancy;
#[cfg(feature = "ros")]
mod output_bag;
mod outputs;
mod overlap;
pub mod pose;
mod pose_series;
mod predict;
mod print;
mod query;
#[cfg(feature = "report")]
mod replay;
#[cfg(feature = "report")]
mod report;
mod resume;
mod sensor_args;
mod sensors;
mod series;
mod signals;
mod simulate;
pub mod summary;
mod supervise;
mod templates;
#[cfg(feature = "store")]
mod update;
mod virtual_sensor;

use clap::{CommandFactory, FromArgMatches, Parser, Subcommand};
use presight::environment::IndexKind;
use presight::files::ImportOptions;
#[cfg(not(all(feature = "report", feature = "ros", feature = "store", feature = "edit")))]
use presight::files::not_built;
use presight::{Result, Scene, SceneOptions};
use std::any::TypeId;
use std::ffi::OsString;
use std::path::Path;
use std::process::ExitCode;

/// Predicts what a robot's sensors should see.
///
/// presight reads a polygonal 3D model (glTF 2.0, a scene script or a stored environment) and predicts exact images of
/// a sensor at a pose: for each pixel the range, the polygon, the object and the angle of incidence.
///
/// In every command SCENE is a .glb or .gltf file, a script (.rhai) or a store (.presight).
#[derive(Debug, Parser)]
#[command(name = "presight", version, max_term_width = 100, after_help = EXAMPLES)]
struct Cli {
    #[command(subcommand)]
    command: Command,
}

const EXAMPLES: &str = "Examples:
  presight sensors                            # list the built-in sensors
  presight inspect hall.glb                   # the contents of a model, and its problems
  presight predict hall.glb --sensor microwave-radar-image --pose 2,1,1.2,0,0,90 --png view.png
  presight compare reference.exr other.exr    # do two predictions agree?
  presight doctor                             # which engines work here
  presight report hall.glb --quick --out study # a page of error against run time
  presight env create hall.presight hall.glb  # keep a model, and every change to it

Exit status: 0 success, 1 an invalid file or a check that found something, 2 wrong usage,
3 no device for the requested backend, 4 a system error (disk full, memory, locked, permission).

scenes/examples.sh in the repository makes the files that the examples of all commands name.";

#[derive(Debug, Subcommand)]
enum Command {
    Predict(Box<predict::Args>),
    #[cfg(feature = "ros")]
    Bag(bag::Args),
    /// Show a ROS 2 bag: not in this build
    #[cfg(not(feature = "ros"))]
    #[command(disable_help_flag = true)]
    Bag {
        #[arg(trailing_var_arg = true, allow_hyphen_values = true, hide = true)]
        rest: Vec<String>,
    },
    Batch(Box<batch::Args>),
    Inspect(inspect::Args),
    Sensors(sensors::Args),
    Index(index::Args),
    Compare(compare::Args),
    Features(Box<features::Args>),
    #[cfg(feature = "edit")]
    Edit(Box<edit::Args>),
    /// Edit a feature layer on a page: not in this build
    #[cfg(not(feature = "edit"))]
    #[command(disable_help_flag = true)]
    Edit {
        #[arg(trailing_var_arg = true, allow_hyphen_values = true, hide = true)]
        rest: Vec<String>,
    },
    Doctor(doctor::Args),
    Localize(Box<localize::Args>),
    #[cfg(feature = "report")]
    Replay(Box<replay::Args>),
    /// Show a drive: not in this build
    #[cfg(not(feature = "report"))]
    #[command(disable_help_flag = true)]
    Replay {
        #[arg(trailing_var_arg = true, allow_hyphen_values = true, hide = true)]
        rest: Vec<String>,
    },
    #[cfg(feature = "store")]
    Update(Box<update::Args>),
    /// Learn what changed: not in this build
    #[cfg(not(feature = "store"))]
    #[command(disable_help_flag = true)]
    Update {
        #[arg(trailing_var_arg = true, allow_hyphen_values = true, hide = true)]
        rest: Vec<String>,
    },
    Simulate(simulate::Args),
    Supervise(Box<supervise::Args>),
    Query(query::Args),
    #[cfg(feature = "report")]
    Report(report::Args),
    /// Measure error against run time: not in this build
    #[cfg(not(feature = "report"))]
    #[command(disable_help_flag = true)]
    Report {
        #[arg(trailing_var_arg = true, allow_hyphen_values = true, hide = true)]
        rest: Vec<String>,
    },
    #[cfg(feature = "store")]
    Explore(Box<explore::Args>),
    /// Explore an environment: not in this build
    #[cfg(not(feature = "store"))]
    #[command(disable_help_flag = true)]
    Explore {
        #[arg(trailing_var_arg = true, allow_hyphen_values = true, hide = true)]
        rest: Vec<String>,
    },
    #[cfg(feature = "store")]
    Occupancy(occupancy::Args),
    /// Write an occupancy grid: not in this build
    #[cfg(not(feature = "store"))]
    #[command(disable_help_flag = true)]
    Occupancy {
        #[arg(trailing_var_arg = true, allow_hyphen_values = true, hide = true)]
        rest: Vec<String>,
    },
    #[cfg(feature = "store")]
    Env(env::Args),
    /// Keep an environment in a file: not in this build
    #[cfg(not(feature = "store"))]
    #[command(disable_help_flag = true)]
    Env {
        #[arg(trailing_var_arg = true, allow_hyphen_values = true, hide = true)]
        rest: Vec<String>,
    },
}

/// The cargo features of this build.
fn features() -> Vec<&'static str> {
    let all = [
        ("gpu", cfg!(feature = "gpu")),
        ("images", cfg!(feature = "images")),
        ("ros", cfg!(feature = "ros")),
        ("script", cfg!(feature = "script")),
        ("store", cfg!(feature = "store")),
        ("report", cfg!(feature = "report")),
        ("edit", cfg!(feature = "edit")),
    ];
    all.into_iter().filter(|(_, built)| *built).map(|(name, _)| name).collect()
}

/// Runs the command with the arguments of the process.
pub fn main() -> ExitCode {
    #[cfg(all(feature = "gpu", target_os = "linux"))]
    drivers::hide_missing_display();
    ExitCode::from(run(std::env::args_os()))
}

/// Runs the command with these arguments, the first of them the program's name, and returns its exit status. From then
/// on a signal to the process ends it, and half-written files are removed before.
pub fn run(arguments: impl IntoIterator<Item = OsString>) -> u8 {
    signals::listen();
    let arguments: Vec<OsString> = arguments.into_iter().collect();
    let parsed = command().try_get_matches_from(&arguments).and_then(|matches| Cli::from_arg_matches(&matches));
    let cli = match parsed {
        Ok(cli) => cli,
        Err(e) => return refuse(&e, &arguments),
    };
    let done = match cli.command {
        Command::Predict(args) => predict::run(&args),
        #[cfg(feature = "ros")]
        Command::Bag(args) => bag::run(&args),
        #[cfg(not(feature = "ros"))]
        Command::Bag { .. } => Err(not_built("ROS 2 bags", "ros")),
        Command::Batch(args) => batch::run(&args),
        Command::Inspect(args) => inspect::run(&args),
        Command::Sensors(args) => sensors::run(&args),
        Command::Index(args) => index::run(&args),
        Command::Compare(args) => compare::run(&args),
        Command::Features(args) => features::run(&args),
        #[cfg(feature = "edit")]
        Command::Edit(args) => edit::run(&args),
        #[cfg(not(feature = "edit"))]
        Command::Edit { .. } => Err(not_built("the editor", "edit")),
        Command::Doctor(args) => doctor::run(&args),
        Command::Localize(args) => localize::run(&args),
        #[cfg(feature = "report")]
        Command::Replay(args) => replay::run(&args),
        #[cfg(not(feature = "report"))]
        Command::Replay { .. } => Err(not_built("pages", "report")),
        #[cfg(feature = "store")]
        Command::Update(args) => update::run(&args),
        #[cfg(not(feature = "store"))]
        Command::Update { .. } => Err(not_built("updates", "store")),
        Command::Simulate(args) => simulate::run(&args),
        Command::Supervise(args) => supervise::run(&args),
        Command::Query(args) => query::run(&args),
        #[cfg(feature = "report")]
        Command::Report(args) => report::run(&args, &arguments),
        #[cfg(not(feature = "report"))]
        Command::Report { .. } => Err(not_built("studies", "report")),
        #[cfg(feature = "store")]
        Command::Explore(args) => explore::run(&args),
        #[cfg(feature = "store")]
        Command::Occupancy(args) => occupancy::run(&args),
        #[cfg(not(feature = "store"))]
        Command::Explore { .. } | Command::Occupancy { .. } => Err(not_built("stored environments", "store")),
        #[cfg(feature = "store")]
        Command::Env(args) => env::run(&args),
        #[cfg(not(feature = "store"))]
        Command::Env { .. } => Err(not_built("stored environments", "store")),
    };
    conclude(done)
}

/// The command line. All options accept negative numbers, so that an error names the number and not an unknown flag.
fn command() -> clap::Command {
    fn numbers(command: clap::Command) -> clap::Command {
        let negative = |arg: clap::Arg| {
            let real = arg.get_value_parser().type_id() == TypeId::of::<f64>();
            match (arg.get_action().takes_values(), real) {
                (false, _) => arg,
                (true, false) => arg.allow_negative_numbers(true),
                // Clap does not recognize -1e-9 and -inf as numbers.
                (true, true) => arg.allow_hyphen_values(true),
            }
        };
        command.mut_args(negative).mut_subcommands(numbers)
    }
    headings::under_headings(numbers(Cli::command()))
}

/// Opens a scene. Output of a script's `print` and notices of the import go to stderr.
fn open_scene(path: &Path, import: &ImportOptions, index: IndexKind) -> Result<Scene> {
    open_scene_without(path, import, index, &[])
}

/// As [`open_scene`], without these objects and groups.
fn open_scene_without(path: &Path, import: &ImportOptions, index: IndexKind, exclude: &[String]) -> Result<Scene> {
    let options = SceneOptions::default().with_import(import.clone()).with_index(index).with_exclude(exclude);
    let scene = Scene::open_with(path, &options, &mut print::message)?;
    print::notices(&scene.report.notices);
    Ok(scene)
}

/// The outcome of a command that did not fail.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum CommandOutcome {
    /// Exit status 0.
    Done,
    /// A check found something: exit status 1.
    Found,
}

fn conclude(done: Result<CommandOutcome>) -> u8 {
    match done {
        Ok(CommandOutcome::Done) => 0,
        Ok(CommandOutcome::Found) => 1,
        Err(e) => {
            print::message(&format!("error: {e}"));
            e.kind().exit_status()
        }
    }
}

/// The flag, command or value whose spelling is most like the one that was given.
fn suggestion(e: &clap::Error) -> Option<String> {
    use clap::error::{ContextKind, ContextValue};
    let kinds = [ContextKind::SuggestedArg, ContextKind::SuggestedSubcommand, ContextKind::SuggestedValue];
    kinds.into_iter().find_map(|kind| match e.get(kind)? {
        ContextValue::String(one) => Some(one.clone()),
        ContextValue::Strings(all) => all.last().cloned(),
        _ => None,
    })
}

/// Prints help and version to stdout. Prints a usage error as one line, like every other error.
fn refuse(e: &clap::Error, arguments: &[OsString]) -> u8 {
    use clap::error::ErrorKind as Clap;
    let help = [Clap::DisplayHelp, Clap::DisplayVersion, Clap::DisplayHelpOnMissingArgumentOrSubcommand];
    if help.contains(&e.kind()) {
        // There is nowhere to report that stdout is closed.
        let _ = e.print();
        return e.exit_code() as u8;
    }
    let text = e.to_string();
    let words = |line: &str| line.split_whitespace().collect::<Vec<_>>().join(" ");
    let before_usage = text.lines().take_while(|line| !line.starts_with("Usage:") && !line.starts_with("For more"));
    let useful = |line: &String| !line.is_empty() && !line.starts_with("tip:");
    let mut message: Vec<String> = before_usage.map(words).filter(useful).collect();
    message.extend(suggestion(e).map(|alike| format!("(did you mean {alike}?)")));
    let command = arguments
        .get(1)
        .and_then(|a| a.to_str())
        .filter(|a| Cli::command().find_subcommand(a).is_some())
        .map(|a| format!(" {a}"))
        .unwrap_or_default();
    print::message(&format!("{}; see presight{command} --help", message.join(" ")));
    2
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_command_line_is_well_formed() {
        command().debug_assert();
    }
}
