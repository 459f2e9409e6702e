//! The machine on which a study was run.

use serde::Serialize;

/// The machine, the build and the command line.
#[derive(Clone, Debug, Default, Serialize)]
pub struct Machine {
    /// The model name, or the architecture if the system does not report one.
    pub cpu: String,
    /// The number of hardware threads.
    pub threads: usize,
    /// Operating system and architecture.
    pub system: String,
    /// The version of presight.
    pub version: &'static str,
    /// The cargo features of the build.
    pub features: Vec<&'static str>,
    /// True if built with debug assertions, which is slower.
    pub debug: bool,
    /// The command line.
    pub command: Vec<String>,
}

impl Machine {
    /// Describes this machine. `features` are the cargo features of the build, `command` is the command line.
    pub fn this(features: Vec<&'static str>, command: Vec<String>) -> Self {
        Self {
            cpu: cpu().unwrap_or_else(|| std::env::consts::ARCH.to_owned()),
            threads: std::thread::available_parallelism().map_or(1, usize::from),
            system: format!("{} {}", std::env::consts::OS, std::env::consts::ARCH),
            version: env!("CARGO_PKG_VERSION"),
            features,
            debug: cfg!(debug_assertions),
            command,
        }
    }

    /// Names and values for tables on pages.
    pub(crate) fn lines(&self) -> Vec<Vec<String>> {
        let build = if self.debug { ", built with assertions: slower than a release" } else { "" };
        let features = self.features.join(", ");
        [
            ("command", self.command.iter().map(|word| quoted(word)).collect::<Vec<_>>().join(" ")),
            ("presight", format!("{}, with {features}{build}", self.version)),
            ("CPU", format!("{}, {} threads", self.cpu, self.threads)),
            ("system", self.system.clone()),
        ]
        .map(|(name, value)| vec![name.to_owned(), value])
        .to_vec()
    }
}

/// The model name of the CPU, on Linux.
fn cpu() -> Option<String> {
    let text = std::fs::read_to_string("/proc/cpuinfo").ok()?;
    let line = text.lines().find(|l| l.starts_with("model name"))?;
    let name = line.split_once(':')?.1.trim();
    (!name.is_empty()).then(|| name.to_owned())
}

/// Quotes a word for a POSIX shell if necessary.
fn quoted(word: &str) -> String {
    let plain = |c: char| c.is_alphanumeric() || "-_./=:,+@%".contains(c);
    if !word.is_empty() && word.chars().all(plain) {
        word.to_owned()
    } else {
        format!("'{}'", word.replace('\'', r"'\''"))
    }
}

#[cfg(test)]
mod tests {
    use super::quoted;

    #[test]
    fn words_are_quoted_where_a_shell_would_split_or_change_them() {
        let words = ["--out", "a b/c.glb", "it's", "", "$HOME"].map(quoted);
        assert_eq!(words, ["--out", "'a b/c.glb'", r"'it'\''s'", "''", "'$HOME'"]);
    }
}
