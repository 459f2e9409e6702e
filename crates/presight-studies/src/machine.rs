//! What the figures were taken on.

use serde::Serialize;

/// The machine, the program and how it was called.
#[derive(Clone, Debug, Default, Serialize)]
pub struct Machine {
    /// As the system names it; the architecture where it does not.
    pub cpu: String,
    /// Threads that run at once.
    pub threads: usize,
    /// Operating system and architecture.
    pub system: String,
    /// Of presight.
    pub version: &'static str,
    /// Optional parts that were built in.
    pub features: Vec<&'static str>,
    /// Built with the compiler's checks: slower.
    pub debug: bool,
    /// The command line.
    pub command: Vec<String>,
}

impl Machine {
    /// This one; `features` are the optional parts that the program was built with, `command` is how it was called.
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

    /// Names and values, as pages show them.
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

/// Linux tells it in a file.
fn cpu() -> Option<String> {
    let text = std::fs::read_to_string("/proc/cpuinfo").ok()?;
    let line = text.lines().find(|l| l.starts_with("model name"))?;
    let name = line.split_once(':')?.1.trim();
    (!name.is_empty()).then(|| name.to_owned())
}

/// As a shell takes it for one word.
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
