//! Relative links and images of the Markdown pages: their files exist, and have the headings that they name.

use std::collections::BTreeSet;
use std::fs;
use std::path::{Path, PathBuf};

/// The pages of a folder and of those below it.
fn pages(folder: &Path) -> Vec<PathBuf> {
    let mut found = Vec::new();
    for path in fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path()) {
        if path.is_dir() {
            found.extend(pages(&path));
        } else if path.extension().is_some_and(|e| e == "md") {
            found.push(path);
        }
    }
    found
}

/// The lines outside of code blocks.
fn prose(page: &str) -> impl Iterator<Item = &str> {
    let mut is_code = false;
    page.lines().filter(move |line| {
        is_code ^= line.trim_start().starts_with("```");
        !is_code
    })
}

/// The anchors that GitHub gives the headings of a page.
fn anchors(page: &str) -> BTreeSet<String> {
    let headings = prose(page).filter(|line| line.starts_with('#')).map(|line| line.trim_start_matches('#').trim());
    let kept = |c: char| (c.is_alphanumeric() || "-_ ".contains(c)).then_some(if c == ' ' { '-' } else { c });
    headings.map(|heading| heading.to_lowercase().chars().filter_map(kept).collect()).collect()
}

/// The targets of a page's links that lead nowhere.
fn dead(page: &Path, text: &str) -> Vec<String> {
    let targets = prose(text).flat_map(|line| line.split("](").skip(1)).filter_map(|rest| rest.split(')').next());
    let is_dead = |target: &&str| {
        let (file, anchor) = target.split_once('#').unwrap_or((target, ""));
        let path = if file.is_empty() { page.to_owned() } else { page.parent().unwrap().join(file) };
        let has_anchor = || fs::read_to_string(&path).is_ok_and(|text| anchors(&text).contains(anchor));
        !path.exists() || !(anchor.is_empty() || has_anchor())
    };
    targets
        .filter(|target| !target.contains("://"))
        .filter(is_dead)
        .map(|t| format!("{}: {t}", page.display()))
        .collect()
}

#[test]
fn relative_links_lead_somewhere() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let mut all: Vec<PathBuf> =
        ["docs", "benches/runs", "scenes"].iter().flat_map(|folder| pages(&root.join(folder))).collect();
    all.extend(
        ["README.md", "ARCHITECTURE.md", "CHANGELOG.md", "CONTRIBUTING.md", "benches/RESULTS.md"]
            .map(|name| root.join(name)),
    );
    let faults: Vec<String> = all.iter().flat_map(|page| dead(page, &fs::read_to_string(page).unwrap())).collect();
    assert!(faults.is_empty(), "dead links:\n{}", faults.join("\n"));
    let planted =
        "[a](docs/formats.md#sensors) [b](docs/formats.md#no-such) `x` [c](gone.md)\n```\n[d](code.md)\n```\n";
    let found = dead(&root.join("README.md"), planted);
    assert!(found.len() == 2 && found[0].ends_with("#no-such") && found[1].ends_with("gone.md"), "{found:?}");
}
