//! Compares the table of outputs in docs/formats.md with the library's outputs.

use presight_render::plan::Output;
use presight_render::plan::{Maker, SampleKind};

/// The row of an output in the page's format.
fn row(output: Output) -> String {
    let info = output.info();
    let kind = match info.kind {
        SampleKind::Float => "float",
        SampleKind::Id => "id",
        SampleKind::Vector => "vector",
    };
    let sensors = if info.cameras_only { "cameras" } else { "all" };
    let maker = match info.maker {
        Maker::Engine => "engine",
        Maker::Plan => "plan",
        Maker::Features => "features",
    };
    let unit = if info.unit.is_empty() { String::new() } else { format!("{} ", info.unit) };
    format!("| `{}` | {kind} | {unit}| {sensors} | {maker} |", info.name)
}

/// The rows missing from a page.
fn missing(page: &str) -> Vec<&'static str> {
    Output::WITH_FEATURES.into_iter().filter(|o| !page.lines().any(|line| line == row(*o))).map(Output::name).collect()
}

#[test]
fn the_page_on_formats_has_the_table_of_outputs() {
    let page = std::fs::read_to_string(concat!(env!("CARGO_MANIFEST_DIR"), "/docs/formats.md")).unwrap();
    assert_eq!(missing(&page), [""; 0]);
    let wrong = page.replace("| `depth_z` | float | m | cameras |", "| `depth_z` | float | m | all |");
    assert_eq!(missing(&wrong), ["depth_z"]);
}
