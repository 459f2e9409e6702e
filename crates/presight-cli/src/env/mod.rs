//! `presight env`: stored environments.

mod apply;
mod export;
mod import;
mod show;
mod stale;

use super::frame_args::FrameArgs;
use super::open_scene;
use super::outputs::{OutputFiles, check_no_dash};
use super::{CommandOutcome, print};
use presight::environment::{Environment, IndexKind};
use presight::files::Up;
use presight::store;
use presight::store::{Note, Store};
use presight::tools;
use presight::{Error, Result};
use std::path::{Path, PathBuf};
use std::time::{SystemTime, UNIX_EPOCH};

const EXAMPLES: &str = "Examples:
  A store of a model, with features for a camera:
    presight env create hall.presight hall.glb
    presight env import hall.presight hall.video.layer.json

  Move one machine and remove another, both or none. The path of a group moves or removes all its objects:
    echo '{\"op\":\"group\",\"changes\":[{\"op\":\"move\",\"object\":\"forklift1\",\"pose\":[30,18,0,0,0,90]},
      {\"op\":\"delete_object\",\"object\":\"forklift2\"}]}' | tr -d '\\n' \\
      | presight env apply hall.presight -

  List all changes, and undo change 2:
    presight env log hall.presight
    presight env undo hall.presight 2

  Every command takes a store as its scene:
    presight predict hall.presight --sensor laser-scanner --pose 2,1,0.5,0,0,90 --png view.png";

/// Store an environment in a file, and change it safely: create, apply, log, undo
///
/// A store (.presight) is one SQLite file: objects, meshes, materials, feature layers, and a log of every change with
/// its time and cause. An acknowledged change is safely on disk.
#[derive(Debug, clap::Args)]
#[command(after_help = EXAMPLES)]
pub struct Args {
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, clap::Subcommand)]
enum Command {
    /// Create a store from a scene; its log is empty
    Create {
        /// The file to create, such as hall.presight
        store: PathBuf,
        /// The scene: .glb, .gltf, or another file that is read as a scene
        scene: PathBuf,
        #[command(flatten)]
        frame: FrameArgs,
        #[command(flatten)]
        note: NoteArgs,
    },
    Import(import::Args),
    Export(export::Args),
    Apply(apply::Args),
    /// Show the contents of a store
    Info {
        /// The store
        store: PathBuf,
        /// Print JSON
        #[arg(long)]
        json: bool,
        /// List the objects and features that were not confirmed for so long: 30d, 12h, 90m or 5s
        #[arg(long, value_name = "AGE")]
        stale: Option<String>,
        /// UTC seconds from which --stale counts back [default: the newest confirmation in the store]
        #[arg(long, value_name = "UTC", requires = "stale", allow_negative_numbers = true)]
        time: Option<f64>,
    },
    /// List all changes: number, time, cause, and change
    Log {
        /// The store
        store: PathBuf,
        /// Print JSON, one change per line, with its inverse
        #[arg(long)]
        json: bool,
    },
    /// Undo a change by appending its inverse; the log only grows
    Undo {
        /// The store
        store: PathBuf,
        /// The number of the change in the log
        change: u64,
        /// Also undo later changes of the same objects and features, newest first, after listing them
        #[arg(long)]
        cascade: bool,
        #[command(flatten)]
        note: NoteArgs,
    },
    /// Verify every row, the whole log and the file's structure; list features that no longer lie on a polygon
    ///
    /// Such features are a problem of the model, not of the file: the store is intact, and predictions ignore them.
    Check {
        /// The store
        store: PathBuf,
    },
}

/// The log entry of a change.
#[derive(Debug, clap::Args)]
struct NoteArgs {
    /// Cause of the change, for the log [default: the command; for apply the file, or stdin, and the line]
    #[arg(long, value_name = "TEXT")]
    cause: Option<String>,

    /// Time of the change, UTC seconds, for the log [default: now]
    #[arg(long, value_name = "T", allow_negative_numbers = true)]
    time: Option<f64>,
}

impl NoteArgs {
    /// The note of a change made now. Only the command reads the clock, the library never does.
    fn note(&self, cause: impl FnOnce() -> String) -> Result<Note> {
        if let Some(time) = self.time.filter(|t| !t.is_finite()) {
            return Err(Error::usage(format!("--time {time}"), "give finite UTC seconds"));
        }
        let now = || SystemTime::now().duration_since(UNIX_EPOCH).map_or(0.0, |d| d.as_secs_f64());
        Ok(Note::new(self.cause.clone().unwrap_or_else(cause), self.time.unwrap_or_else(now)))
    }
}

/// Runs the command.
///
/// # Errors
/// Store errors.
pub fn run(args: &Args) -> Result<CommandOutcome> {
    match &args.command {
        Command::Create { store, scene, frame, note } => create(store, scene, frame, note)?,
        Command::Import(args) => import::run(args)?,
        Command::Export(args) => export::run(args)?,
        Command::Apply(args) => apply::run(args)?,
        Command::Info { store, json, stale, time } => {
            let stale = stale.as_deref().map(|age| stale::Stale::new(age, *time)).transpose()?;
            show::info(store, *json, stale.as_ref())?;
        }
        Command::Log { store, json } => show::log(store, *json)?,
        Command::Undo { store, change, cascade, note } => undo(store, *change, *cascade, note)?,
        Command::Check { store } => show::check(store)?,
    }
    Ok(CommandOutcome::Done)
}

/// Opens a scene. Also returns its up axis and scale as text for the log, if they are not the default, and its files.
fn environment_of(scene: &Path, frame: &FrameArgs) -> Result<(Environment, String, Vec<PathBuf>)> {
    let scene = open_scene(scene, &frame.options()?, IndexKind::None)?;
    let lay = scene.frame.filter(|f| (f.up, f.scale) != (Up::Y, 1.0));
    let lay = lay.map(|f| format!(" (up {}, scale {})", f.up.name(), f.scale)).unwrap_or_default();
    Ok((std::sync::Arc::unwrap_or_clone(scene.world.into_environment()), lay, scene.files))
}

/// Opens a store for changes, without the spatial index that predictions need.
fn open_store(path: &Path) -> Result<Store> {
    Store::open_with_index(path, &IndexKind::None)
}

fn create(store: &Path, scene: &Path, frame: &FrameArgs, note: &NoteArgs) -> Result<()> {
    check_no_dash(store)?;
    let mut files = OutputFiles::default();
    files.add_any(store)?;
    files.check_named([scene])?;
    let mut note = note.note(|| format!("create of {}", scene.display()))?;
    let (environment, lay, scene_files) = environment_of(scene, frame)?;
    note.cause += &lay;
    let polygons = environment.objects().iter().map(|o| o.mesh.polygon_count() as u64);
    tools::require_memory(tools::memory_of_writing(polygons))?;
    files.check_scene(&scene_files)?;
    store::create(store, &environment, &note)?;
    print::data(&format!("{} objects, content {}\n", show::live(&environment).count(), environment.content_hash()))
}

fn undo(path: &Path, change: u64, cascade: bool, note: &NoteArgs) -> Result<()> {
    let note = note.note(|| format!("undo of {change}"))?;
    let mut store = open_store(path)?;
    let plan = store.undo_plan(change, cascade)?;
    if plan.len() > 1 {
        let numbers: Vec<String> = plan.iter().map(u64::to_string).collect();
        print::message(&format!("note: undoing {} changes: {}", plan.len(), numbers.join(", ")));
    }
    let made = store.undo(change, cascade, &note)?;
    let made: Vec<String> = made.iter().map(u64::to_string).collect();
    print::data(&format!("change {}\n", made.join(", ")))
}
