//! The table of constants in `docs/design/localization-constants.md` is made from the source.

use std::fmt::Write;
use std::path::Path;

const HEAD: &str = "# Constants of localization\n\nMade from the source by the test `the_table_of_constants_is_that_of_the_source`;\n\
    `PRESIGHT_WRITE=1` writes it anew. The comment of each constant states its unit and its reason. Odds follow from error\n\
    rates: [decisions](localization.md#odds-of-a-pose).\n";

/// Rows for the constants of a file: name, value, and what its comment says.
fn rows(source: &str) -> String {
    let (mut text, mut why) = (String::new(), String::new());
    let mut lines = source.lines().map(str::trim);
    while let Some(line) = lines.next() {
        if let Some(doc) = line.strip_prefix("/// ") {
            why += if why.is_empty() { "" } else { " " };
            why += doc;
            continue;
        }
        let declared = line.split_once("const ").filter(|(before, _)| before.is_empty() || before.starts_with("pub"));
        let Some((name, rest)) =
            declared.and_then(|(_, rest)| rest.split_once(": ")).filter(|(name, _)| !name.contains('('))
        else {
            why.clear();
            continue;
        };
        let mut rest = rest.to_owned();
        while !rest.contains(';') || rest.matches('[').count() > rest.matches(']').count() {
            let Some(more) = lines.next() else { break };
            rest = format!("{rest} {more}");
        }
        let value = rest.split_once(" =").map_or("", |(_, value)| value.trim().trim_end_matches(';'));
        let value: String = value.chars().take(60).collect();
        let why = std::mem::take(&mut why).replace('|', "\\|");
        writeln!(text, "| `{name}` | `{}` | {why} |", value.replace('|', "\\|")).unwrap();
    }
    text
}

fn table() -> String {
    let mut text = HEAD.to_owned();
    let source = Path::new(env!("CARGO_MANIFEST_DIR")).join("src");
    for folder in ["estimate", "localize", "verdict", "history", "matching"] {
        let mut files: Vec<_> = source.join(folder).read_dir().unwrap().map(|entry| entry.unwrap().path()).collect();
        files.sort();
        for file in files {
            let rows = rows(&std::fs::read_to_string(&file).unwrap());
            if !rows.is_empty() {
                let name = file.file_name().unwrap().to_string_lossy().into_owned();
                write!(
                    text,
                    "\n## {folder}/{name}\n\n| constant | value | meaning and reason |\n|---|---|---|\n{rows}"
                )
                .unwrap();
            }
        }
    }
    text
}

#[test]
fn the_table_of_constants_is_that_of_the_source() {
    let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../docs/design/localization-constants.md");
    if std::env::var_os("PRESIGHT_WRITE").is_some() {
        std::fs::write(&file, table()).unwrap();
    }
    let told = std::fs::read_to_string(&file).unwrap_or_default();
    assert!(told == table(), "{} differs: PRESIGHT_WRITE=1 writes it", file.display());
}
