//! What Vulkan drivers print.

use std::env;
use std::os::unix::process::CommandExt;
use std::path::Path;
use std::process::Command;

/// Where Mesa looks for the socket of a Wayland display.
const FOLDER: &str = "XDG_RUNTIME_DIR";

/// Hides one line of Mesa that looks like an error of this command: `error: XDG_RUNTIME_DIR is invalid or not set in
/// the environment.` If that is so, this process starts again with a folder that cannot hold a socket; other messages
/// of drivers stay. It starts again because only `unsafe` code can set a variable of a running process.
pub fn hide_missing_display() {
    if env::var_os(FOLDER).is_some_and(|folder| Path::new(&folder).is_absolute()) {
        return;
    }
    let (Ok(program), mut args) = (env::current_exe(), env::args_os()) else { return };
    let mut again = Command::new(program);
    if let Some(name) = args.next() {
        again.arg0(name);
    }
    // If the system refuses, this process goes on, and the line may appear.
    let _ = again.args(args).env(FOLDER, "/dev/null").exec();
}
