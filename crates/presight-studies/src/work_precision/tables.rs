//! Tables of the page: errors and times, settings of paths, stages, and skipped stages.

use super::results::{PathNotes, Row};
use crate::page::Table;
use presight_render::plan::Omission;

/// The tables of errors: caption, kinds, and whether cells include bounds (too wide for images).
const FAMILIES: [(&str, &[&str], bool); 3] = [
    (
        "Images",
        &[
            "id_mismatch",
            "range_ulp",
            "range_m",
            "range_mean_m",
            "range_of_bound",
            "silhouette_px",
            "silhouette_most_px",
            "fault_share",
            "missing_share",
        ],
        false,
    ),
    ("Features", &["visible_fraction", "visible_fraction_mean"], true),
    ("Regions of interest: times for 100", &["roi_missed", "roi_missed_worst", "roi_area_share"], true),
];

/// Tables for images, features and regions of interest, with a row for each path and a column for each kind of error.
pub(super) fn errors(rows: &[Row]) -> Vec<Table> {
    let table = |(caption, kinds, bounds)| of_kinds(rows, caption, kinds, bounds);
    FAMILIES.into_iter().filter_map(table).collect()
}

fn of_kinds(rows: &[Row], caption: &str, kinds: &[&str], bounds: bool) -> Option<Table> {
    let firsts: Vec<&Row> = rows.iter().filter(|r| Some(&r.error_kind) == kinds.first()).collect();
    if firsts.is_empty() {
        return None;
    }
    let mut table =
        Table { caption: caption.to_owned(), head: head(&["path", "median ms", "p95 ms"]), ..Table::default() };
    table.head.extend(kinds.iter().map(|k| (*k).to_owned()));
    for (i, first) in firsts.into_iter().enumerate() {
        let of_path = |kind: &&str| {
            let same = |r: &&Row| r.engine == first.engine && r.variant == first.variant && r.error_kind == *kind;
            rows.iter().find(same)
        };
        let cell = |kind: &&str| match of_path(kind) {
            None => "-".into(),
            Some(Row { error, bound: Some(bound), .. }) if bounds => format!("{} of {}", short(*error), short(*bound)),
            Some(row) => short(row.error),
        };
        if kinds.iter().any(|kind| of_path(kind).is_some_and(|r| r.pareto)) {
            table.marked.push(i);
        }
        let mut cells = vec![name(&first.engine, &first.variant, first.default)];
        cells.extend([first.median_ms, first.p95_ms].map(|ms| format!("{ms:.3}")));
        cells.extend(kinds.iter().map(cell));
        table.rows.push(cells);
    }
    table.caption += "; bold: on the Pareto front of a kind of error";
    Some(table)
}

fn name(engine: &str, variant: &str, default: bool) -> String {
    format!("{engine}, {variant}{}", if default { " (default)" } else { "" })
}

fn of_notes(n: &PathNotes) -> String {
    name(&n.engine, &n.variant, n.default)
}

fn head(names: &[&str]) -> Vec<String> {
    names.iter().map(|name| (*name).to_owned()).collect()
}

fn short(value: f64) -> String {
    match value {
        0.0 => "0".into(),
        v if (1e-3..1e5).contains(&v.abs()) => {
            let digits = (2 - v.abs().log10().floor() as i32).clamp(0, 5) as usize;
            format!("{v:.digits$}")
        }
        v => format!("{v:.1e}"),
    }
}

/// Flags and settings that select each path.
pub(super) fn how(notes: &[PathNotes]) -> Table {
    Table {
        caption: "Flags are for presight predict, which reads features from --layer and predicts regions of interest \
                  with --pose-cov; presight sensors NAME prints a sensor file to start from"
            .into(),
        head: head(&["path", "how to select it"]),
        rows: notes.iter().map(|n| vec![of_notes(n), n.how.clone()]).collect(),
        marked: Vec::new(),
    }
}

/// Times of stages, and counts of the last run.
pub(super) fn stages(notes: &[PathNotes]) -> Table {
    let row = |n: &PathNotes| {
        let stage = |s: &super::StageTime| format!("{} {} ({})", s.stage, short(s.median_ms), short(s.p95_ms));
        let stages: Vec<String> = n.stages.iter().map(stage).collect();
        let counts: Vec<String> = n.counts.iter().map(|(name, count)| format!("{name} {count}")).collect();
        vec![of_notes(n), n.runs.to_string(), stages.join(", "), counts.join(", ")]
    };
    Table {
        caption: "Medians (p95) in ms; counts of the last run".into(),
        head: head(&["path", "runs", "stages", "counts"]),
        rows: notes.iter().map(row).collect(),
        marked: Vec::new(),
    }
}

/// Skipped stages and images, with the reason and the paths that skip them.
pub(super) fn left_out(notes: &[PathNotes]) -> Table {
    let leaving: Vec<&PathNotes> = notes.iter().filter(|n| !n.left_out.is_empty()).collect();
    let all: Vec<String> = leaving.iter().map(|n| of_notes(n)).collect();
    let mut rows: Vec<(&Omission, Vec<String>)> = Vec::new();
    for (n, path) in leaving.iter().zip(&all) {
        for left in &n.left_out {
            match rows.iter_mut().find(|(row, _)| *row == left) {
                Some((_, by)) => by.push(path.clone()),
                None => rows.push((left, vec![path.clone()])),
            }
        }
    }
    let row =
        |(left, by): (&Omission, Vec<String>)| vec![left.what.to_string(), left.why.to_string(), in_short(&by, &all)];
    Table {
        caption: "Stages and images skipped without loss (last pose); all: every path that skips something".into(),
        head: head(&["skipped", "why", "by"]),
        rows: rows.into_iter().map(row).collect(),
        marked: Vec::new(),
    }
}

/// The names in `some`, or "all but" the missing names if these are fewer.
fn in_short(some: &[String], all: &[String]) -> String {
    let others: Vec<&String> = all.iter().filter(|name| !some.contains(name)).collect();
    let names = |names: &[&String]| names.iter().map(|n| n.as_str()).collect::<Vec<_>>().join("; ");
    match others.len() {
        0 => "all".into(),
        n if n < some.len() => format!("all but {}", names(&others)),
        _ => names(&some.iter().collect::<Vec<_>>()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use presight_render::plan::StageName;

    #[test]
    fn what_nearly_all_leave_out_is_said_in_short() {
        let [all_do, many_do, few_do] = [StageName::Hidden, StageName::RayTable, StageName::SecondRasterPass];
        let left = |what: StageName| Omission { what: what.into(), why: "not needed".into() };
        let notes: Vec<PathNotes> = (0..5)
            .map(|i| PathNotes {
                engine: "cpu".into(),
                variant: format!("path {i}"),
                how: String::new(),
                default: i == 0,
                runs: 3,
                stages: Vec::new(),
                counts: Vec::new(),
                left_out: match i {
                    0 => vec![left(all_do)],
                    1 => vec![left(all_do), left(few_do), left(many_do)],
                    2 | 3 => vec![left(all_do), left(many_do)],
                    _ => Vec::new(),
                },
            })
            .collect();
        let by: Vec<String> = left_out(&notes).rows.into_iter().map(|mut row| row.remove(2)).collect();
        assert_eq!(by, ["all", "cpu, path 1", "all but cpu, path 0 (default)"]);
    }
}
