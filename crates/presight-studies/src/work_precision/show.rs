//! The results as CSV, JSON and an HTML page.

use super::approximations;
use super::results::{Finding, Findings, Row};
use super::tables;
use crate::chart::{Chart, Series, Style};
use crate::page::{Part, Section, Table, page};
use crate::{Machine, csv_field};
use presight_model::error::{Error, Result};
use serde::Serialize;

/// Format version of report.json.
const FORMAT: u32 = 1;

/// The columns of the CSV, stable for scripts.
const COLUMNS: &str = "scene,sensor,engine,variant,error_kind,error,bound,median_ms,p95_ms,pareto";

/// Kinds of errors: name, and description with the unit.
const KINDS: [(&str, &str); 14] = [
    (
        "id_mismatch",
        "fraction of pixels that show another polygon than the reference, or where only one of the two has a hit",
    ),
    (
        "range_ulp",
        "largest difference of ranges where both show the same polygon, in units in the last place of an f32",
    ),
    (
        "range_m",
        "the same in metres; its bound is the rounding error allowed at that pixel, and empty if nothing differs",
    ),
    ("range_mean_m", "mean difference of ranges over all pixels where both have a finite range, metres"),
    (
        "range_of_bound",
        "largest ratio of the difference to the rounding error allowed at its pixel; the bound of exact paths is 1",
    ),
    (
        "silhouette_px",
        "mean distance between the borders of objects in both images, pixels, in both directions, at most 16",
    ),
    ("silhouette_most_px", "the largest such distance"),
    ("fault_share", "only for exact paths: fraction of pixels that no rounding, edge or tie explains"),
    ("missing_share", "fraction of the sensor's pixels that the path leaves out; its other errors are for the rest"),
    (
        "visible_fraction",
        "largest error of a feature's visible fraction; the truth has a ray every 1/16 pixel; below 1e-12 it is \
         taken as 0",
    ),
    ("visible_fraction_mean", "the mean error over all features"),
    (
        "roi_missed",
        "fraction of random error samples in which a feature is outside its region of interest, mean over regions",
    ),
    ("roi_missed_worst", "the same for the worst region; its bound includes a margin for chance"),
    (
        "roi_area_share",
        "not an error, but the cost of certainty: mean fraction of the image in a region; times of all are for 100 \
         regions",
    ),
];

/// Charts: kind, title, label of the axis.
const CHARTS: [(&str, &str, &str); 5] = [
    ("id_mismatch", "Other polygons against time", "fraction of pixels"),
    ("range_m", "Range error against time", "largest error, m"),
    ("silhouette_px", "Silhouettes against time", "mean displacement, pixels"),
    ("visible_fraction", "Visible fractions against time", "largest error"),
    ("roi_missed", "Missed regions of interest against time for 100 regions", "fraction of samples"),
];

/// The rows as CSV, one per line.
pub fn to_csv(findings: &Findings) -> String {
    let mut csv = format!("{COLUMNS}\n");
    for r in findings.findings.iter().flat_map(|f| &f.rows) {
        let names = [&r.scene, &r.sensor, &r.engine, &r.variant].map(|name| csv_field(name)).join(",");
        let bound = r.bound.map(|b| format!("{b:e}")).unwrap_or_default();
        csv += &format!(
            "{names},{},{:e},{bound},{:.4},{:.4},{}\n",
            r.error_kind, r.error, r.median_ms, r.p95_ms, r.pareto
        );
    }
    csv
}

#[derive(Serialize)]
struct Document<'a> {
    format: u32,
    machine: &'a Machine,
    #[serde(flatten)]
    findings: &'a Findings,
}

/// The results as JSON. Infinite bounds are null.
///
/// # Errors
/// None in practice; [`presight::ErrorKind::Invalid`] if serialization fails.
pub fn to_json(findings: &Findings, machine: &Machine) -> Result<String> {
    serde_json::to_string_pretty(&Document { format: FORMAT, machine, findings })
        .map_err(|e| Error::invalid(format!("cannot write the results as JSON: {e}"), ""))
}

/// The results as one HTML page.
///
/// # Errors
/// Chart errors.
pub fn to_html(findings: &Findings, machine: &Machine) -> Result<String> {
    let mut sections = vec![answer(findings), about(findings, machine)];
    for finding in &findings.findings {
        sections.push(section(finding)?);
    }
    if !findings.approximations.is_empty() {
        sections.push(approximations::section(&findings.approximations));
    }
    sections.push(kinds());
    let lead = "The run time of each path from a scene to an image, and the error of its images. The truth is the \
                reference engine, a plain z-buffer in f64.";
    Ok(page("presight: error against run time", lead, &sections))
}

fn answer(findings: &Findings) -> Section {
    let parts = findings.findings.iter().map(|f| Part::Advice(f.advice.clone())).collect();
    Section { title: "Recommendations".into(), label: None, parts }
}

fn about(findings: &Findings, machine: &Machine) -> Section {
    let mut rows = machine.lines();
    rows.push(vec!["adapter and driver".into(), findings.adapter.clone()]);
    let head = ["item", "value"].map(String::from).to_vec();
    let missing = "Not measured here: the GPU's hardware rasterizer for cameras (see benches/raster), and planar \
                   images resampled to curved ones, which the product does not have (see benches/resampling). A \
                   request cannot select a region of the image, but a smaller sensor can, such as the roi of a ROS \
                   camera_info file; it is measured as \"middle part\". Features are sampled every half pixel unless \
                   stated otherwise. If the adapter is a software GPU, the GPU engine computes regions of interest on \
                   the CPU.";
    let parts = vec![
        Part::Table(Table { caption: "How it was measured".into(), head, rows, marked: Vec::new() }),
        Part::Text(missing.into()),
    ];
    Section { title: "Machine and paths".into(), label: None, parts }
}

fn kinds() -> Section {
    let rows = KINDS.iter().map(|(kind, text)| vec![(*kind).to_owned(), (*text).to_owned()]).collect();
    let head = vec!["error_kind".into(), "description".into()];
    let texts = [
        "Errors are the worst over all poses; fractions and means are over all poses. Times are from all runs except \
         warm-ups. Paths take turns, so that changes in the machine's load affect all paths alike. Times include \
         selection and all images in memory, with the GPU synchronised; times of features include their image. p95 is \
         the 95th percentile.",
        "A row is on the Pareto front if no other row of its kind is as fast and as exact. Paths that leave out a part \
         of the image are never on it. Regions of interest are compared at the same pose errors.",
        "The advice recommends the default unless another path is better by more than noise: it is ahead in so many \
         turns (or, in errors, at so many features) that chance would put one of the paths ahead at most once in \
         twenty studies. A path that is as exact must also be a tenth faster. A more exact path to features must be \
         worth its time: its largest and its mean error, each times its time, must be smaller, because finer samples \
         halve the error for twice the time. Less exact paths are mentioned only if at most a tenth of the pixels show \
         another polygon. Advice on features needs at least ten features.",
    ];
    let mut parts: Vec<Part> = texts.map(|text| Part::Text(text.into())).to_vec();
    parts.push(Part::Table(Table { caption: "Kinds of errors".into(), head, rows, marked: Vec::new() }));
    Section { title: "How to read it".into(), label: None, parts }
}

fn section(finding: &Finding) -> Result<Section> {
    let (w, h) = finding.size;
    let mut parts = vec![
        Part::Advice(finding.advice.clone()),
        Part::Picture { png: finding.preview.clone(), caption: "The range image at the first pose.".into() },
        Part::Heading("Error against time".into()),
    ];
    for (kind, title, label) in CHARTS {
        let rows: Vec<&Row> = finding.rows.iter().filter(|r| r.error_kind == kind).collect();
        if !rows.is_empty() {
            let caption = "Rings: the Pareto front. 1/2, 1/4: reduced resolution; table: the same rays from a table; \
                           part: only the middle of the image. A mark at 0 has no error.";
            let roi = "One mark for each pose error and propagation method; dashed: the allowed fraction.";
            let caption = if kind == "roi_missed" { roi } else { caption };
            parts.push(Part::Chart { svg: chart(&rows, title, label).svg()?, caption: caption.into() });
        }
    }
    parts.push(Part::Heading("Paths".into()));
    parts.extend(tables::errors(&finding.rows).into_iter().map(Part::Table));
    if !finding.not_measured.is_empty() {
        parts.push(Part::Heading("Not measured".into()));
        parts.extend(finding.not_measured.iter().cloned().map(Part::Text));
    }
    for (title, table) in [
        ("How to select them", tables::how(&finding.notes)),
        ("Stages", tables::stages(&finding.notes)),
        ("Skipped", tables::left_out(&finding.notes)),
    ] {
        parts.extend([Part::Heading(title.into()), Part::Table(table)]);
    }
    Ok(Section { title: format!("{}, {} ({w} x {h})", finding.scene, finding.sensor), label: None, parts })
}

fn chart(rows: &[&Row], title: &str, label: &str) -> Chart {
    let mut series: Vec<Series> = Vec::new();
    for row in rows {
        let at = series.iter().position(|s| s.name == row.family).unwrap_or_else(|| {
            series.push(Series { name: row.family.clone(), color: series.len(), ..Series::default() });
            series.len() - 1
        });
        series[at].points.push((row.median_ms, row.error));
        series[at].labels.push(row.label.clone());
    }
    for (name, mut points) in fronts(rows) {
        points.sort_by(|a, b| a.0.total_cmp(&b.0));
        series.push(Series { name, points, style: Style::Front, ..Series::default() });
    }
    // A bound shared by all rows is drawn as a horizontal line; other bounds are in the table.
    let bounds: Vec<f64> = rows.iter().filter_map(|r| r.bound).collect();
    if let Some(bound) = bounds.first().filter(|b| **b > 0.0 && bounds.iter().all(|x| x == *b)) {
        let times = || rows.iter().map(|r| r.median_ms);
        let (low, high) = (times().fold(f64::INFINITY, f64::min), times().fold(0.0, f64::max));
        let points = vec![(low, *bound), (high, *bound)];
        series.push(Series { name: "bound".into(), points, style: Style::Bound, color: 7, ..Series::default() });
    }
    let (title, x_label, y_label) = (title.to_owned(), "median time, ms".to_owned(), label.to_owned());
    Chart { title, x_label, y_label, x_log: true, y_log: true, series }
}

/// The Pareto front; for regions of interest one front for each size of the pose error. Only the first has a name.
fn fronts(rows: &[&Row]) -> Vec<(String, Vec<(f64, f64)>)> {
    let group = |r: &Row| if r.error_kind.starts_with("roi") { r.label.clone() } else { String::new() };
    let mut fronts: Vec<(String, Vec<(f64, f64)>)> = Vec::new();
    for row in rows.iter().filter(|r| r.pareto) {
        let (group, point) = (group(row), (row.median_ms, row.error));
        match fronts.iter_mut().find(|f| f.0 == group) {
            Some(front) => front.1.push(point),
            None => fronts.push((group, vec![point])),
        }
    }
    for (i, front) in fronts.iter_mut().enumerate() {
        front.0 = if i == 0 { "Pareto front".into() } else { String::new() };
    }
    fronts
}
