//! Decides whether a command ended in an allowed way and left only whole files.

use super::process::{Ended, Out};
use super::rows::{Pantry, Row, files};
use std::fs;
use std::path::Path;

/// The allowed ways for a command to end under a limit, in addition to success.
#[derive(Clone, Copy, Debug)]
pub enum May {
    /// Fail with one of these statuses.
    Fail(&'static [i32]),
    /// Be ended by this signal.
    EndBy(i32),
    /// Anything except a hang, a panic in our code, or a partial file: a foreign driver is at work.
    BeForeign,
}

/// Returns the violations as sentences.
pub fn faults(row: &Row, ended: &Ended, folder: &Path, may: May, stdout: Out) -> Vec<String> {
    let mut faults = Vec::new();
    let errors = ended.stderr.lines().filter(|line| line.starts_with("error: ")).count();
    let done = ended.status == Some(0);
    let panicked = match may {
        May::BeForeign => ["src/", "crates/"].iter().any(|ours| ended.stderr.contains(&format!("panicked at {ours}"))),
        _ => ended.stderr.contains("panicked"),
    };
    if ended.hung || panicked {
        faults.push(if ended.hung { "it hangs".into() } else { "it panics".into() });
    }
    let as_told = match (may, ended.status, ended.signal) {
        (May::BeForeign, ..) => true,
        (_, Some(0), _) => errors == 0,
        (May::Fail(statuses), Some(status), _) => statuses.contains(&status) && errors == 1,
        (May::EndBy(wanted), None, Some(signal)) => signal == wanted && errors == 0,
        _ => false,
    };
    if !as_told {
        faults.push(format!("status {:?}, signal {:?}, {errors} errors", ended.status, ended.signal));
    }
    let usual = Pantry::get().usual.get(row.line);
    let printed = |text: &str| text.lines().count();
    if let Some(usual) = usual.filter(|_| done && stdout == Out::Read && !row.line.starts_with("doctor")) {
        let (is, was) = (printed(&ended.stdout), printed(&usual.ended.stdout));
        faults.extend((is != was).then(|| format!("{is} lines on stdout instead of {was}")));
    }
    faults.extend(left_behind(row, folder, done));
    faults
}

/// Finds partial files, unexpected files, and files that are missing after success.
fn left_behind(row: &Row, folder: &Path, done: bool) -> Vec<String> {
    let mut faults = Vec::new();
    let there = files(folder);
    for (name, bytes) in &there {
        let is_store = row.on_store && name == "hall.presight";
        // SQLite's own journal, which it replays later.
        let is_journal = name.ends_with(".presight-journal");
        // The same command resumes from these records.
        let is_record = name.starts_with(".presight-") && name.ends_with(".series");
        if !done && (is_record || name.ends_with(".npy.unfinished")) {
            continue;
        }
        if !is_store && !is_journal && !row.outputs.contains(&name.as_str()) {
            faults.push(format!("{name} is left behind"));
        } else if !is_journal && let Err(why) = whole(row, &folder.join(name), name, bytes) {
            faults.push(format!("{name} is not whole: {why}"));
        }
    }
    if done {
        let missing = row.outputs.iter().filter(|name| !there.contains_key(**name));
        faults.extend(missing.map(|name| format!("{name} is missing")));
    }
    faults
}

/// Images and points must be the same as without limits. Other files contain times and are only parsed.
fn whole(row: &Row, path: &Path, name: &str, bytes: &[u8]) -> Result<(), String> {
    let usual = Pantry::get().usual.get(row.line).and_then(|usual| usual.files.get(name));
    let text = || std::str::from_utf8(bytes).map_err(|e| e.to_string());
    let ends = |end: &str| if text()?.trim_end().ends_with(end) { Ok(()) } else { Err(format!("no {end} at its end")) };
    match path.extension().and_then(|e| e.to_str()).unwrap_or_default() {
        "json" => serde_json::from_slice::<serde_json::Value>(bytes).map(|_| ()).map_err(|e| e.to_string()),
        "html" => ends("</html>"),
        "svg" => ends("</svg>"),
        "csv" => match usual.map(|usual| usual.iter().filter(|b| **b == b'\n').count()) {
            Some(lines) if lines != text()?.lines().count() => Err(format!("it does not have {lines} lines")),
            _ => Ok(()),
        },
        "presight" => sound(path),
        "exr" if usual.is_none() => presight::files::read_exr(path).map(|_| ()).map_err(|e| e.to_string()),
        _ if usual.is_none_or(|usual| usual == bytes) => Ok(()),
        _ => Err("it differs from that of an unlimited run".into()),
    }
}

/// Runs `env check` on a store without limits.
fn sound(path: &Path) -> Result<(), String> {
    let mut command = std::process::Command::new(env!("CARGO_BIN_EXE_presight"));
    let output = command.args(["env", "check"]).arg(path).output().map_err(|e| e.to_string())?;
    // The check has replayed the journal of an interrupted writer.
    let journal = path.with_extension("presight-journal");
    let _ = fs::remove_file(journal);
    if output.status.success() { Ok(()) } else { Err(String::from_utf8_lossy(&output.stderr).into_owned()) }
}
