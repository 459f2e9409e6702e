//! `presight edit`: the visual feature editor, on a page that this process serves.

use super::batch::read_measured;
use super::frame_args::FrameArgs;
use super::pose::PoseArgs;
use super::sensor_args::SensorArgs;
use super::{CommandOutcome, open_scene, print};
use presight::environment::IndexKind;
use presight::{Result, Threads};
use presight_editor::http::Server;
use presight_editor::{Session, SessionOptions};
use std::path::PathBuf;

const EXAMPLES: &str = "Examples:
  A new layer for a camera:
    presight edit hall.glb --sensor video-camera --pose 2,1,1.2,0,0,90

  What the sensor measured, beside what it should see:
    presight edit scenes/room.glb --sensor camera.toml --pose 0.7,2.2,1,0,0,0 --measured reference.exr

  An existing layer, without opening a browser:
    presight edit hall.glb --sensor video-camera --layer hall.video.layer.json --no-open

  The layer in a store; every step is a change in its log:
    presight edit site.presight --sensor video-camera

  On a robot, seen from here through ssh -L 4567:127.0.0.1:4567 ROBOT:
    presight edit site.presight --sensor video-camera --port 4567 --no-open";

/// Edit a feature layer on a page that shows the predicted image; a click makes a feature
///
/// Prints the page's address, opens it in the browser if there is a display, and serves it to this machine alone until
/// Ctrl-C. Steps that are not saved are kept in LAYER.edits; the next start offers them.
#[derive(Debug, clap::Args)]
#[command(after_help = EXAMPLES)]
pub struct Args {
    /// The model: a .glb or .gltf file, a .rhai script, or a store
    scene: PathBuf,

    /// A preset (see `presight sensors`) or a sensor file
    #[arg(long, value_name = "PRESET|FILE")]
    sensor: String,

    #[command(flatten)]
    image: SensorArgs,

    #[command(flatten)]
    pose: PoseArgs,

    #[command(flatten)]
    frame: FrameArgs,

    #[command(flatten)]
    engine: super::engine_args::EngineArgs,

    /// The layer to edit [default: that of the store; else a new one]
    #[arg(long, value_name = "FILE.layer.json")]
    layer: Option<PathBuf>,

    /// Show a measured image next to the predicted one: an EXR file, or frame INDEX of a log, from 0
    #[arg(long, value_name = "FILE.exr|LOG#INDEX")]
    measured: Option<String>,

    /// The port of the page's address, 0 = any free one
    #[arg(long, value_name = "N", default_value_t = 0)]
    port: u16,

    /// Do not open a browser
    #[arg(long)]
    no_open: bool,
}

/// Runs the command.
///
/// # Errors
/// Wrong usage; errors from reading the scene, the sensor and the layer, from the engine, and from the server.
pub fn run(args: &Args) -> Result<CommandOutcome> {
    let pose = args.pose.parse_if_given()?;
    let sensor = args.image.load(&args.sensor)?;
    let server = Server::listen(args.port)?;
    let scene = open_scene(&args.scene, &args.frame.options()?, IndexKind::default())?;
    let mut options = SessionOptions::default();
    options.command = ["presight".to_owned(), "predict".to_owned(), args.scene.display().to_string()].into();
    options.command.extend(args.frame.given());
    options.command.extend(["--sensor".to_owned(), args.sensor.clone()]);
    options.pose = pose.map(|pose| pose.of_sensor(sensor.spec(), &scene.world_from_gltf)).transpose()?;
    options.layer = args.layer.clone();
    let read = |name: &String| read_measured(name, &sensor).map_err(|e| e.at(format!("--measured {name}")));
    options.measured = args.measured.as_ref().map(read).transpose()?;
    if args.image.rectified {
        options.command.push("--rectified".into());
    }
    if args.image.destagger {
        options.command.push("--destagger".into());
    }
    options.engine = args.engine.options(Threads::from(0).started()?);
    let session = Session::open(scene, sensor, options)?;
    let address = server.address();
    print::lines([address.clone()])?;
    if !args.no_open {
        open_browser(&address);
    }
    server.serve(session)?;
    Ok(CommandOutcome::Done)
}

/// Opens the page if there is a display. Nothing depends on it: the address is printed. Other users of the machine can
/// read command lines, so that the browser gets the name of a file that only this user can read, which leads to the
/// address with its token.
fn open_browser(address: &str) {
    use std::process::{Command, Stdio};
    let has_display = ["DISPLAY", "WAYLAND_DISPLAY"].iter().any(|name| std::env::var_os(name).is_some());
    let mut command = match std::env::consts::OS {
        "macos" => Command::new("open"),
        "windows" => Command::new("explorer"),
        _ if has_display => Command::new("xdg-open"),
        _ => return,
    };
    let Some(page) = redirect(address) else { return };
    let _goes_on_without =
        command.arg(page.path()).stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::null()).spawn();
    // The browser has read it by then; the token ends with this process.
    std::thread::spawn(move || {
        std::thread::sleep(READING_TIME);
        drop(page);
    });
}

/// The time that a browser may take to start.
const READING_TIME: std::time::Duration = std::time::Duration::from_secs(60);

/// A page, readable by this user alone, that leads to an address; `None` if the system refuses it.
fn redirect(address: &str) -> Option<tempfile::NamedTempFile> {
    use std::io::Write;
    let mut file = tempfile::Builder::new().prefix("presight-edit-").suffix(".html").tempfile().ok()?;
    write!(file, "<!doctype html><meta http-equiv=\"refresh\" content=\"0;url={address}\">").ok()?;
    file.flush().ok()?;
    Some(file)
}

#[cfg(all(test, unix))]
mod tests {
    use super::*;
    use std::os::unix::fs::PermissionsExt;

    #[test]
    fn only_this_user_can_read_the_token() {
        let page = redirect("http://127.0.0.1:1/#abc").unwrap();
        assert_eq!(page.as_file().metadata().unwrap().permissions().mode() & 0o077, 0);
        assert!(std::fs::read_to_string(page.path()).unwrap().contains("url=http://127.0.0.1:1/#abc"));
    }
}
