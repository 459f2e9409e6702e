//! A quick stability study of every engine: no fault; and planted faults, each of which it has to find.
#![expect(clippy::print_stderr, reason = "what was measured is worth reading, and a skipped engine says so")]

use presight::compare::Precision;
use presight::report::stability::{BoxSetting, Cpu, Outcome, Row, Study, Subject, subjects};
use presight::{FramePlan, Images, Result};

fn faults(rows: &[Row]) -> Vec<String> {
    let of = |r: &Row| format!("{} at {:e}, {}: {}", r.family, r.difficulty, r.finding.engine, r.finding.note);
    rows.iter().filter(|r| r.finding.outcome == Outcome::Fault).map(of).collect()
}

#[test]
fn no_engine_has_a_fault() {
    let (mut all, notes) = subjects(1).unwrap();
    for note in &notes {
        eprintln!("{note}");
        assert!(!note.starts_with("SKIPPED") || std::env::var_os("CI").is_none(), "CI needs an adapter: {note}");
    }
    let study = Study::new(std::env::var_os("PRESIGHT_FULL").is_none());
    let start = std::time::Instant::now();
    let rows = study.run(&mut all, |_| {}).unwrap();
    eprintln!("{} rows in {:?}", rows.len(), start.elapsed());
    for r in &rows {
        let f = &r.finding;
        eprintln!(
            "{:14} {:8.1e} {:10} {:10.3e} {:10.3e} {:8} {}",
            r.family,
            r.difficulty,
            f.engine,
            f.error,
            f.bound,
            f.outcome.name(),
            f.note
        );
    }
    let found = faults(&rows);
    assert!(found.is_empty(), "{} faults:\n{}", found.len(), found.join("\n"));
}
