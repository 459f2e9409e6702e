//! Findings as CSV, JSON and a page.

use super::{Finding, Findings, Row, tables};
use crate::chart::{Chart, Series, Style};
use crate::page::{Part, Section, Table, page};
use crate::{Machine, csv_field};
use presight::{Error, Result};
use serde::Serialize;

/// The version of report.json.
const FORMAT: u32 = 1;

/// The columns that scripts rely on.
const COLUMNS: &str = "scene,sensor,engine,variant,error_kind,error,bound,median_ms,p95_ms,pareto";

/// Kinds of errors: name, unit, what it is.
const KINDS: [(&str, &str); 14] = [
    (
        "id_mismatch",
        "share of pixels that show another polygon than the reference, or something where it shows nothing",
    ),
    (
        "range_ulp",
        "greatest difference of ranges where both show the same polygon, in units in the last place of an f32",
    ),
    (
        "range_m",
        "the same in metres; its bound is what rounding allows at that pixel, and is left empty where nothing differs",
    ),
    ("range_mean_m", "mean difference of ranges over all pixels where both see something, metres"),
    (
        "range_of_bound",
        "greatest share of what rounding allows at its pixel; 1 is the bound of paths that are to be exact",
    ),
    ("silhouette_px", "mean distance between the borders of objects in both images, pixels, both ways, at most 16"),
    ("silhouette_most_px", "the greatest such distance"),
    ("fault_share", "of paths that are to be exact: share of pixels that no rounding, edge or tie explains"),
    ("missing_share", "share of the sensor's pixels that the path leaves out; its other errors are of the rest"),
    (
        "visible_fraction",
        "greatest error of a feature's visible fraction; the truth is a ray every 1/16 of a pixel; below 1e-12 it counts as none",
    ),
    ("visible_fraction_mean", "the mean error over all features"),
    (
        "roi_missed",
        "share of draws of the errors in which a feature is outside its region of interest, mean over regions",
    ),
    ("roi_missed_worst", "the same of the worst region; its bound has room for chance"),
    (
        "roi_area_share",
        "no error, but what certainty costs: mean share of the image that a region takes; times of all three are of 100 regions",
    ),
];

/// Charts: kind, title, label of the axis.
const CHARTS: [(&str, &str, &str); 5] = [
    ("id_mismatch", "Other polygons against time", "share of pixels"),
    ("range_m", "Range error against time", "greatest error, m"),
    ("silhouette_px", "Silhouettes against time", "mean displacement, pixels"),
    ("visible_fraction", "Visible fractions against time", "greatest error"),
    ("roi_missed", "Missed regions of interest against time of 100 regions", "share of draws"),
];

/// One line a row, with the contract's columns.
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

/// Everything, for programs. Infinite bounds are null.
///
/// # Errors
/// None for what studies find; the serializer's own.
pub fn to_json(findings: &Findings, machine: &Machine) -> Result<String> {
    serde_json::to_string_pretty(&Document { format: FORMAT, machine, findings })
        .map_err(|e| Error::invalid(format!("the findings are no JSON: {e}"), ""))
}

/// Everything, for people: one HTML file.
///
/// # Errors
/// Those of charts.
pub fn to_html(findings: &Findings, machine: &Machine) -> Result<String> {
    let mut sections = vec![answer(findings), about(findings, machine)];
    for finding in &findings.findings {
        sections.push(section(finding)?);
    }
    sections.push(kinds());
    let lead = "What each way from a scene to an image costs, and how far its images are from the truth. The truth is the \
                reference, a plain z-buffer in f64.";
    Ok(page("presight: error against run time", lead, &sections))
}

fn answer(findings: &Findings) -> Section {
    let parts = findings.findings.iter().map(|f| Part::Advice(f.advice.clone())).collect();
    Section { title: "What to take".into(), parts }
}

fn about(findings: &Findings, machine: &Machine) -> Section {
    let mut rows = machine.lines();
    rows.push(vec!["adapter and driver".into(), findings.adapter.clone()]);
    let head = ["what", "value"].map(String::from).to_vec();
    let missing = "Not here: the GPU's hardware rasterizer for cameras (measured in benches/raster). Not in the product, and so not here: \
                   planar images resampled to curved ones (benches/resampling). A request names \
                   no region of the image: a smaller sensor does, as the roi of a ROS camera_info file; it is measured \
                   as \"middle part\". Features are sampled every half pixel unless it is said otherwise. Where the adapter is a program that plays a \
                   GPU, the GPU engine leaves regions of interest to the CPU.";
    let parts = vec![
        Part::Table(Table { caption: "How it was measured".into(), head, rows, marked: Vec::new() }),
        Part::Text(missing.into()),
    ];
    Section { title: "Machine and paths".into(), parts }
}

fn kinds() -> Section {
    let rows = KINDS.iter().map(|(kind, text)| vec![(*kind).to_owned(), (*text).to_owned()]).collect();
    let head = vec!["error_kind".into(), "what it is".into()];
    let texts = [
        "Errors are the worst over all poses, shares and means are over all of them. Times are of all runs but those that \
         warm up; paths take turns, so that a machine that grows busier does so for all of them alike. Times include \
         selection and all images in memory, with the GPU synchronised; those of features include their image. p95: 95 of \
         100 runs took at most so long.",
        "A row is on the Pareto front if no other of its kind is as fast and as exact; paths that leave a part of the image out \
         have no place on it. Regions of interest are compared at the same errors of the pose.",
        "Advice keeps to what a user gets anyway, unless another path is clearly faster: its median is below nine tenths, \
         and three quarters of its runs are faster than three quarters of the other's. What is less exact is told only where at \
         most a tenth of the pixels shows another polygon. On features advice rests on ten of them at least, and what has \
         errors no more than a thousandth above those of rays, the greatest and the mean, is as exact.",
    ];
    let mut parts: Vec<Part> = texts.map(|text| Part::Text(text.into())).to_vec();
    parts.push(Part::Table(Table { caption: "Kinds of errors".into(), head, rows, marked: Vec::new() }));
    Section { title: "How to read it".into(), parts }
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
            let caption = "Rings: the Pareto front. 1/2, 1/4: reduced resolution; table: the same rays from a table; part: \
                           the middle of the image only. A mark at 0 has no error at all.";
            let roi = "One mark for each size of the pose's error, by how errors went through the projection; dashed: what was asked for.";
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
        ("How to take them", tables::how(&finding.notes)),
        ("Stages", tables::stages(&finding.notes)),
        ("Left out", tables::left_out(&finding.notes)),
    ] {
        parts.extend([Part::Heading(title.into()), Part::Table(table)]);
    }
    Ok(Section { title: format!("{}, {} ({w} x {h})", finding.scene, finding.sensor), parts })
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
    // A bound that all share is a line across; others are in the table.
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

/// Pareto fronts: one, or one for each size of the pose's error, of which only the first is named.
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
