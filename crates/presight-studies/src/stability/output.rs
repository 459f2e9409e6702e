//! The study as an HTML page, CSV and JSON.

use super::families::Outcome;
use super::study::{Row, Study};
use crate::Machine;
use crate::chart::{Chart, Series, Style};
use crate::page::{Part, Section, Table, page};
use presight_model::error::{Error, ErrorKind, Result};
use serde_json::{Value, json};

/// Format version of `report.json`.
const FORMAT: u32 = 1;

/// A bound above this leaves fewer than three significant digits, so the result is hardly usable.
const THREE_DIGITS: f64 = 1e-3;

/// Information about the run.
#[derive(Clone, Debug, Default)]
pub struct RunInfo {
    /// The machine and the command line.
    pub machine: Machine,
    /// Notes about engines: adapters, and engines that were skipped.
    pub notes: Vec<String>,
}

/// The number of faults.
pub fn faults(rows: &[Row]) -> usize {
    rows.iter().filter(|r| r.finding.outcome == Outcome::Fault).count()
}

/// `stability.csv`: family, difficulty, engine, error, bound, outcome. Error and bound are empty for refused cases. A
/// bound that is not finite is `inf`.
pub fn to_csv(rows: &[Row]) -> String {
    let number = |x: f64| if x.is_nan() { String::new() } else { format!("{x:e}") };
    let mut csv = String::from("family,difficulty,engine,error,bound,outcome\n");
    for Row { family, difficulty, finding: f } in rows {
        let (error, bound, outcome) = (number(f.error), number(f.bound), f.outcome.name());
        csv += &format!("{family},{difficulty:e},{},{error},{bound},{outcome}\n", f.engine);
    }
    csv
}

/// `report.json`; numbers that are not finite are null.
///
/// # Errors
/// None in practice; [`ErrorKind::System`] if serialization fails.
pub fn to_json(study: &Study, rows: &[Row], about: &RunInfo) -> Result<String> {
    let families: Vec<Value> = study
        .families
        .iter()
        .map(|f| json!({ "name": f.name(), "about": f.about(), "difficulty": f.axis(), "error": f.error() }))
        .collect();
    let row = |r: &Row| {
        let f = &r.finding;
        json!({
            "family": r.family, "difficulty": r.difficulty, "engine": f.engine, "error": f.error, "bound": f.bound,
            "outcome": f.outcome, "other_pixels": f.other, "edge_on_polygons": f.edge_on, "note": f.note,
        })
    };
    let all = json!({
        "format": FORMAT,
        "study": "stability",
        "quick": study.quick,
        "machine": about.machine,
        "notes": about.notes,
        "faults": faults(rows),
        "families": families,
        "rows": rows.iter().map(row).collect::<Vec<_>>(),
    });
    serde_json::to_string_pretty(&all)
        .map_err(|e| Error::new(ErrorKind::System, format!("cannot write JSON: {e}"), "").caused_by(e))
}

/// `index.html`. A family without finite values has no chart.
///
/// # Errors
/// None.
pub fn to_html(study: &Study, rows: &[Row], about: &RunInfo) -> Result<String> {
    let mut sections = vec![summary(study, rows, about)];
    for family in &study.families {
        let own: Vec<&Row> = rows.iter().filter(|r| r.family == family.name()).collect();
        let mut parts = vec![Part::Text(family.about().into()), Part::Advice(advice(&own))];
        let falling = study.falls(family.name());
        if let Ok(svg) = chart(&own, family.axis(), family.error(), falling).svg() {
            let caption = format!("{}: error of each engine, and its bound.", family.name());
            parts.push(Part::Chart { svg, caption });
        }
        let notes: Vec<Vec<String>> = notes(&own);
        if !notes.is_empty() {
            let head = ["difficulty", "engine", "outcome", "note"].map(String::from).to_vec();
            let faults = notes.iter().enumerate().filter(|(_, n)| n[2] == "fault").map(|(i, _)| i).collect();
            parts.push(Part::Table(Table { caption: "Notes".into(), head, rows: notes, marked: faults }));
        }
        sections.push(Section { title: family.name().into(), label: None, parts });
    }
    let lead = "Every engine against a truth computed with a hundred digits, in cases of increasing difficulty: does \
                the error stay within presight's published bound until the case is refused?";
    Ok(page("Numerical stability", lead, &sections))
}

impl Study {
    /// Returns true if a family becomes harder towards smaller values of its difficulty.
    fn falls(&self, family: &str) -> bool {
        let all = self.families.iter().find(|f| f.name() == family).map(|f| f.difficulties(self.quick));
        all.is_some_and(|d| d.first() > d.last())
    }
}

fn summary(study: &Study, rows: &[Row], about: &RunInfo) -> Section {
    let faults = faults(rows);
    let rejected = rows.iter().filter(|r| r.finding.outcome == Outcome::Rejected).count();
    let verdict = format!(
        "{} cases in {} families: {faults} faults, {rejected} refused with a typed error.",
        rows.len(),
        study.families.len()
    );
    let head = [
        "family",
        "largest error",
        "largest error / bound",
        "bound leaves 3 digits",
        "refused from",
        "pixels that differ",
        "left out as edge-on",
        "faults",
    ];
    let (mut table, mut marked) = (Vec::new(), Vec::new());
    for family in &study.families {
        let own: Vec<&Row> = rows.iter().filter(|r| r.family == family.name()).collect();
        for engine in engines(&own) {
            let of = Reach::of(&own, engine);
            if of.faults > 0 {
                marked.push(table.len());
            }
            let name = format!("{}, {engine}", family.name());
            let refused = refused_from(&own).map_or("-".into(), |d| format!("{d:e}"));
            let from = of.vague_from.map_or("everywhere".into(), |d| format!("up to {d:e}"));
            table.push(vec![
                name,
                format!("{:.1e}", of.error),
                format!("{:.2}", of.share),
                from,
                refused,
                of.other.to_string(),
                of.edge_on.to_string(),
                of.faults.to_string(),
            ]);
        }
    }
    let table = Table {
        caption: "Errors and bounds of each family and engine".into(),
        head: head.map(String::from).to_vec(),
        rows: table,
        marked,
    };
    let machine = Table {
        caption: "The run".into(),
        head: ["item", "value"].map(String::from).to_vec(),
        rows: about.machine.lines(),
        marked: Vec::new(),
    };
    let counted = "A pixel may differ from the truth at an outline, or where a polygon was left out as edge-on: the \
                   engine could not prove on which side of its plane the sensor is, so the surface behind it is shown. \
                   Errors are measured at pixels that show the true polygon, and without a bound at pixels where it \
                   was left out. Counts of polygons left out are sums over images.";
    let mut parts = vec![Part::Advice(verdict), Part::Table(table), Part::Text(counted.into())];
    parts.extend(about.notes.iter().map(|note| Part::Text(note.clone())));
    parts.push(Part::Table(machine));
    Section { title: "Summary".into(), label: None, parts }
}

/// The results of one engine in one family.
struct Reach {
    error: f64,
    /// The largest ratio of error to bound.
    share: f64,
    /// The last difficulty before the bound leaves fewer than three digits; `None` if it never does.
    vague_from: Option<f64>,
    other: usize,
    edge_on: usize,
    faults: usize,
}

impl Reach {
    fn of(rows: &[&Row], engine: &str) -> Self {
        let own: Vec<&Row> = rows.iter().filter(|r| r.finding.engine == engine).copied().collect();
        let most = |of: fn(&Row) -> f64| own.iter().map(|r| of(r)).filter(|x| x.is_finite()).fold(0.0, f64::max);
        let vague = own.iter().position(|r| !(r.finding.bound <= THREE_DIGITS));
        let coverage = own.iter().all(|r| r.family.ends_with("-box") || r.family == "indefinite");
        Self {
            error: most(|r| r.finding.error),
            share: most(|r| if r.finding.error == 0.0 { 0.0 } else { r.finding.error / r.finding.bound }),
            vague_from: vague.filter(|_| !coverage).map(|k| own[k.saturating_sub(1)].difficulty),
            other: own.iter().map(|r| r.finding.other).sum(),
            edge_on: own.iter().map(|r| r.finding.edge_on).sum(),
            faults: own.iter().filter(|r| r.finding.outcome == Outcome::Fault).count(),
        }
    }
}

/// Engines in the order of the rows, without refused cases.
fn engines<'a>(rows: &[&'a Row]) -> Vec<&'a str> {
    let mut engines: Vec<&str> = Vec::new();
    for row in rows.iter().filter(|r| r.finding.outcome != Outcome::Rejected) {
        if !engines.contains(&row.finding.engine.as_str()) {
            engines.push(&row.finding.engine);
        }
    }
    engines
}

fn refused_from(rows: &[&Row]) -> Option<f64> {
    rows.iter().find(|r| r.finding.outcome == Outcome::Rejected).map(|r| r.difficulty)
}

/// A one-sentence summary of a family.
fn advice(rows: &[&Row]) -> String {
    let faults = rows.iter().filter(|r| r.finding.outcome == Outcome::Fault).count();
    let refused: Vec<f64> =
        rows.iter().filter(|r| r.finding.outcome == Outcome::Rejected).map(|r| r.difficulty).collect();
    let unbounded = unbounded(rows);
    let within = match (faults, unbounded.is_empty()) {
        (0, true) => "Every error is within its bound".to_owned(),
        (0, false) => format!("Every error that has a bound is within it; there is no bound {}", unbounded.join(", ")),
        (n, _) => format!("{n} cases are wrong"),
    };
    match (refused.first(), refused.last()) {
        (Some(a), Some(b)) if a == b => format!("{within}; refused at {a:e}."),
        (Some(a), Some(b)) => format!("{within}; refused from {a:e} to {b:e}."),
        _ => format!("{within}; nothing is refused."),
    }
}

/// The difficulties and engines without a bound: `from 1e-6 on for gpu and gpu-32-bit`.
fn unbounded(rows: &[&Row]) -> Vec<String> {
    let mut found: Vec<(String, Vec<&str>)> = Vec::new();
    for engine in engines(rows) {
        let own: Vec<&Row> = rows.iter().filter(|r| r.finding.engine == engine).copied().collect();
        let without = |r: &&Row| r.finding.bound == f64::INFINITY;
        let Some(first) = own.iter().position(without) else { continue };
        let place = match own[first..].iter().all(without) {
            _ if first + 1 == own.len() => format!("at {:e}", own[first].difficulty),
            true => format!("from {:e} on", own[first].difficulty),
            false => {
                let all = own.iter().filter(|r| without(r)).map(|r| format!("{:e}", r.difficulty));
                format!("at {}", all.collect::<Vec<_>>().join(" and "))
            }
        };
        match found.iter_mut().find(|(other, _)| *other == place) {
            Some((_, engines)) => engines.push(engine),
            None => found.push((place, vec![engine])),
        }
    }
    let all = engines(rows).len();
    let names = |names: &[&str]| match names {
        [first @ .., last] if names.len() < all && !first.is_empty() => format!("{} and {last}", first.join(", ")),
        [one] if all > 1 => (*one).to_owned(),
        _ => "any engine".to_owned(),
    };
    found.into_iter().map(|(place, engines)| format!("{place} for {}", names(&engines))).collect()
}

fn notes(rows: &[&Row]) -> Vec<Vec<String>> {
    let told = rows.iter().filter(|r| !r.finding.note.is_empty());
    told.map(|r| {
        let f = &r.finding;
        vec![format!("{:e}", r.difficulty), f.engine.clone(), f.outcome.name().into(), f.note.clone()]
    })
    .collect()
}

/// A chart of error and bound by difficulty, with one colour per engine.
fn chart(rows: &[&Row], axis: &str, error: &str, falling: bool) -> Chart {
    let mut series = Vec::new();
    for (color, engine) in engines(rows).into_iter().enumerate() {
        let of = |value: fn(&Row) -> f64| {
            let own = rows.iter().filter(|r| r.finding.engine == engine);
            own.map(|r| (r.difficulty, value(r))).collect::<Vec<_>>()
        };
        let (errors, bounds) = (of(|r| r.finding.error), of(|r| r.finding.bound));
        let name = engine.to_owned();
        series.push(Series {
            name: format!("{name}: bound"),
            points: bounds,
            style: Style::Bound,
            color,
            labels: vec![],
        });
        series.push(Series { name, points: errors, style: Style::LinePoints, color, labels: vec![] });
    }
    let harder = if falling { "harder to the left" } else { "harder to the right" };
    Chart {
        title: String::new(),
        x_label: format!("{axis} ({harder})"),
        y_label: error.split(';').next().unwrap_or(error).to_owned(),
        x_log: true,
        y_log: true,
        series,
    }
}
