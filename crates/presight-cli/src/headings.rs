//! The headings of the flags in the help, and the order of its parts: examples come first.

use clap::{Arg, Command};

/// Flags of one heading.
struct Heading {
    name: &'static str,
    /// False for flags that `-h` leaves to `--help`.
    is_common: bool,
    /// Long names; `command --flag` for the flag of one command only.
    flags: &'static [&'static str],
}

const fn common(name: &'static str, flags: &'static [&'static str]) -> Heading {
    Heading { name, is_common: true, flags }
}

const fn special(name: &'static str, flags: &'static [&'static str]) -> Heading {
    Heading { name, is_common: false, flags }
}

/// In the order of the first flags of a command.
const HEADINGS: [Heading; 23] = [
    common("Model", &["map", "scene", "exclude", "up", "scale"]),
    special("Model, rarely needed", &["merge-tolerance", "ids", "index", "reuse-visible", "precision", "model-sigma"]),
    common("Sensor", &["sensor", "robot"]),
    special("Sensor, rarely needed", &["rectified", "destagger", "preset", "grey", "grey-sensor"]),
    special("Frames of poses", &["pose-frame", "pose-of", "world-frame"]),
    common("Pose", &["pose", "poses", "pose-cov", "update --poses", "update --pose-cov"]),
    common("Log", &["from", "stride", "skip-bad", "odometry-sigma"]),
    special("ROS 2 bags", &["topic", "base", "mount", "reflector"]),
    common("Start", &["init"]),
    special("Uncertainty of the start", &["init-sigma", "init-sigma-deg", "init-odds"]),
    special("Search of the whole map", &["floor", "floor-to", "margin", "surrounded", "lean", "search-starts"]),
    special("Motion during a scan", &["twist", "pose-end", "trajectory", "stamp", "deskew"]),
    common(
        "Output",
        &[
            "out",
            "outputs",
            "npy",
            "rays",
            "png",
            "png-of",
            "depth-png",
            "mcap",
            "frame",
            "points",
            "points-frame",
            "json",
            "csv",
            "keepout",
            "apply",
        ],
    ),
    special(
        "Features",
        &[
            "layer",
            "own-features",
            "features",
            "hidden",
            "max-features",
            "predict --time",
            "confidence",
            "feature-numbers",
        ],
    ),
    special(
        "Features that are generated",
        &["class", "kinds", "min-length", "min-area", "crease-deg", "sigma", "flatness", "reach"],
    ),
    special(
        "Worth of a layer",
        &["worth", "spacing", "thin", "features --floor", "features --sensor", "features --layer"],
    ),
    special("Virtual sensors", &["virtual", "predict --corridor", "predict --floor", "mask"]),
    common("Corridor", &["corridor", "cell", "smallest", "upright", "speed"]),
    common(
        "Questions",
        &[
            "box",
            "sphere",
            "along",
            "docks",
            "apart",
            "free",
            "uncertain",
            "path",
            "below",
            "blocked",
            "since",
            "query --time",
        ],
    ),
    common(
        "Robot and floor",
        &[
            "radius",
            "step",
            "height",
            "slope",
            "from-height",
            "to-height",
            "level",
            "occupancy --floor",
            "occupancy --cell",
            "occupancy --keepout",
            "explore --floor",
            "wall-height",
        ],
    ),
    special(
        "Deadline",
        &["deadline-ms", "deadline-radius", "deadline-heading", "deadline-features", "costs", "recognizer-ms"],
    ),
    special(
        "Computing",
        &["backend", "raster", "way", "threads", "explain", "repeat", "stats", "shard", "port", "no-open"],
    ),
    special(
        "Method",
        &[
            "likelihood",
            "headings",
            "cell-m",
            "cell-deg",
            "count",
            "seed",
            "only",
            "sweep",
            "unfiltered",
            "stability",
            "quick",
            "pixel",
            "reference-sigma",
            "reference-sigma-deg",
            "learn",
            "given",
            "evidence",
            "time",
            "policy",
            "library",
            "measured",
            "recognizer",
            "views",
            "sure",
            "most-per-view",
            "grey-noise",
            "intensities",
            "intensity-noise",
            "drop-outs",
            "mixed-pixels",
            "displace",
            "walkers",
            "simulate --height",
            "polygons",
            "detail",
            "replace",
            "mirror",
            "cause",
            "cascade",
            "stale",
        ],
    ),
];

/// The parts of the help: the examples stand before the flags.
const TEMPLATE: &str = "{before-help}{about-with-newline}\n{usage-heading} {usage}{after-help}\n\n{all-args}";

/// The heading of a flag of a command.
fn heading_of(command: &str, flag: &str) -> Option<&'static Heading> {
    let own = format!("{command} --{flag}");
    let named = |name: &str| HEADINGS.iter().find(|heading| heading.flags.contains(&name));
    named(&own).or_else(|| named(flag))
}

/// The command with its flags under headings, and its subcommands with theirs. `-h` shows the common flags.
pub fn under_headings(command: Command) -> Command {
    arranged(command, "presight")
}

fn arranged(command: Command, path: &str) -> Command {
    let name = command.get_name().to_owned();
    let under = |arg: Arg| match arg.get_long().and_then(|flag| heading_of(&name, flag)) {
        Some(heading) => arg.help_heading(heading.name).hide_short_help(!heading.is_common),
        None => arg,
    };
    let command = command.mut_args(under).mut_subcommands(|sub| {
        let path = format!("{path} {}", sub.get_name());
        arranged(sub, &path)
    });
    match command.get_after_help().cloned() {
        None => command,
        Some(examples) => command
            .help_template(TEMPLATE)
            .after_long_help(examples)
            .after_help(format!("Examples and all flags: {path} --help")),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::command;
    use std::collections::{BTreeMap, BTreeSet};

    /// Maximum number of flags under one heading.
    const MAX_FLAGS: usize = 15;

    /// Visits every command with its path.
    fn each(command: &Command, path: &str, visit: &mut dyn FnMut(&Command, &str)) {
        visit(command, path);
        command.get_subcommands().for_each(|sub| each(sub, &format!("{path} {}", sub.get_name()), visit));
    }

    fn faults(command: &Command) -> Vec<String> {
        let mut faults = Vec::new();
        each(command, "presight", &mut |command, path| {
            let mut counts = BTreeMap::<&str, usize>::new();
            for arg in command.get_arguments().filter(|arg| !arg.is_hide_set()) {
                match (arg.get_long(), arg.get_help_heading()) {
                    (None | Some("help" | "version"), _) => {}
                    (Some(flag), None) => faults.push(format!("{path} --{flag} has no heading")),
                    (Some(_), Some(heading)) => *counts.entry(heading).or_default() += 1,
                }
            }
            let full = counts.into_iter().filter(|(_, count)| *count > MAX_FLAGS);
            faults.extend(full.map(|(heading, count)| format!("{path} has {count} flags under {heading}")));
        });
        faults
    }

    #[test]
    fn every_flag_has_a_heading_that_is_read_at_a_glance() {
        assert_eq!(faults(&command()), Vec::<String>::new());
        let stray = command().arg(Arg::new("stray").long("stray"));
        assert_eq!(faults(&stray), ["presight --stray has no heading"]);
        let names = ["a", "b", "c", "d", "e", "f", "g", "i", "j", "k", "l", "m", "n", "o", "p", "q"];
        let under_f = |name| Arg::new(name).long(name).help_heading("F");
        let full = names.into_iter().fold(command(), |command, name| command.arg(under_f(name)));
        assert_eq!(faults(&full), ["presight has 16 flags under F"]);
    }

    #[test]
    fn every_listed_flag_exists() {
        let mut known = BTreeSet::new();
        each(&command(), "presight", &mut |command, _| {
            for flag in command.get_arguments().filter_map(Arg::get_long) {
                known.insert(flag.to_owned());
                known.insert(format!("{} --{flag}", command.get_name()));
            }
        });
        let listed = HEADINGS.iter().flat_map(|heading| heading.flags);
        let unknown: Vec<_> = listed.filter(|flag| !known.contains(**flag)).collect();
        assert!(unknown.is_empty(), "{unknown:?}");
    }

    /// Examples come before the flags; `-h` fits a screen and names the rest.
    #[test]
    fn the_long_help_begins_with_examples_and_the_short_one_is_short() {
        each(&command(), "presight", &mut |command, path| {
            let mut command = command.clone();
            let (long, short) = (command.render_long_help().to_string(), command.render_help().to_string());
            if let Some(examples) = long.find("Examples:") {
                let flags =
                    ["\nOptions:", "\nOutput:", "\nModel:"].iter().filter_map(|heading| long.find(heading)).min();
                assert!(flags.is_none_or(|flags| examples < flags), "{path}: {long}");
                assert!(short.contains("Examples and all flags:"), "{path}");
            }
            assert!(short.lines().count() <= 60, "{path}: {} lines: {short}", short.lines().count());
        });
    }
}
