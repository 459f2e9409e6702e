//! A study as one self-contained HTML file: styles, charts and pictures are embedded.

use super::chart::PALETTE;
use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use maud::{DOCTYPE, Markup, PreEscaped, html};

/// A section of a page.
#[derive(Clone, Debug, Default)]
pub struct Section {
    /// The heading.
    pub title: String,
    /// The contents, in order.
    pub parts: Vec<Part>,
}

/// A part of a section. Texts are escaped, SVG is inserted unchanged.
#[derive(Clone, Debug)]
pub enum Part {
    /// A paragraph.
    Text(String),
    /// A highlighted paragraph with the conclusion.
    Advice(String),
    /// A heading inside the section.
    Heading(String),
    /// A table.
    Table(Table),
    /// A chart.
    Chart {
        /// An `<svg>` element, as from [`super::chart::Chart::svg`].
        svg: String,
        /// The text below the chart.
        caption: String,
    },
    /// A picture.
    Picture {
        /// The bytes of a PNG file.
        png: Vec<u8>,
        /// The text below the picture.
        caption: String,
    },
}

/// A table. Columns whose cells are all numbers are right-aligned.
#[derive(Clone, Debug, Default)]
pub struct Table {
    /// The text above the table.
    pub caption: String,
    /// Names of the columns.
    pub head: Vec<String>,
    /// Cells by row.
    pub rows: Vec<Vec<String>>,
    /// Indices of highlighted rows.
    pub marked: Vec<usize>,
}

/// Makes a page without external references. `lead` is the paragraph below the title.
///
/// ```
/// use presight_studies::page::{Part, Section, page};
/// let section = Section { title: "Times".into(), parts: vec![Part::Text("a < b".into())] };
/// let html = page("Study", "Costs of predictions.", &[section]);
/// assert!(html.contains("a &lt; b") && !html.contains("src=\"http"));
/// ```
pub fn page(title: &str, lead: &str, sections: &[Section]) -> String {
    html! {
        (DOCTYPE)
        html lang="en" {
            head {
                meta charset="utf-8";
                meta name="viewport" content="width=device-width, initial-scale=1";
                meta name="color-scheme" content="light dark";
                title { (title) }
                style { (PreEscaped(style())) }
            }
            body {
                header { h1 { (title) } p.lead { (lead) } }
                @if sections.len() > 2 {
                    nav { @for (i, s) in sections.iter().enumerate() { a href=(format!("#s{i}")) { (s.title) } " " } }
                }
                main {
                    @for (i, s) in sections.iter().enumerate() {
                        section id=(format!("s{i}")) { h2 { (s.title) } @for p in &s.parts { (part(p)) } }
                    }
                }
            }
        }
    }
    .into_string()
}

fn part(part: &Part) -> Markup {
    html! {
        @match part {
            Part::Text(text) => p { (text) },
            Part::Advice(text) => p.advice { (text) },
            Part::Heading(text) => h3 { (text) },
            Part::Table(t) => (table(t)),
            Part::Chart { svg, caption } => figure { (PreEscaped(svg)) figcaption { (caption) } },
            Part::Picture { png, caption } => figure.picture {
                img alt=(caption) src=(format!("data:image/png;base64,{}", STANDARD.encode(png)));
                figcaption { (caption) }
            },
        }
    }
}

fn table(table: &Table) -> Markup {
    let numeric: Vec<bool> = (0..table.head.len())
        .map(|c| table.rows.iter().filter_map(|r| r.get(c)).all(|cell| is_number(cell)) && !table.rows.is_empty())
        .collect();
    let class = |c: usize| numeric.get(c).copied().unwrap_or(false).then_some("n");
    html! {
        div.wide { table {
            caption { (table.caption) }
            thead { tr { @for (c, name) in table.head.iter().enumerate() { th class=[class(c)] scope="col" { (heading(name)) } } } }
            tbody {
                @for (i, row) in table.rows.iter().enumerate() {
                    tr class=[table.marked.contains(&i).then_some("marked")] {
                        @for (c, cell) in row.iter().enumerate() { td class=[class(c)] { (cell) } }
                    }
                }
            }
        } }
    }
}

/// A column heading that can wrap after each underscore.
fn heading(name: &str) -> Markup {
    html! { @for (i, piece) in name.split_inclusive('_').enumerate() { @if i > 0 { wbr; } (piece) } }
}

fn is_number(cell: &str) -> bool {
    let first = cell.split_whitespace().next().unwrap_or("-");
    matches!(first, "-" | "none") || first.parse::<f64>().is_ok()
}

/// The style sheet. Its colour variables have values for light screens and print, and for dark screens.
pub(crate) fn style() -> String {
    let series = |dark: bool| {
        let one = |(i, (light, night)): (usize, &(&str, &str))| format!("--s{i}:{};", if dark { night } else { light });
        PALETTE.iter().enumerate().map(one).collect::<String>()
    };
    let light = format!(
        "--paper:#fff;--ink:#1b1f24;--quiet:#57606a;--faint:#d8dee4;--tint:#f3f6f9;--advice:#e6f2fb;{}",
        series(false)
    );
    let dark = format!(
        "--paper:#0f1318;--ink:#e6edf3;--quiet:#9aa7b4;--faint:#2c343d;--tint:#171d24;--advice:#12283a;{}",
        series(true)
    );
    format!(
        ":root{{{light}}}\n@media screen and (prefers-color-scheme:dark){{:root{{{dark}}}}}\n{}",
        include_str!("page.css")
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn texts_are_escaped_and_pictures_are_inside() {
        let table = Table {
            caption: "c".into(),
            head: vec!["name".into(), "ms".into()],
            rows: vec![vec!["<script>".into(), "1.5".into()], vec!["b".into(), "-".into()]],
            marked: vec![1],
        };
        let parts = vec![
            Part::Table(table),
            Part::Picture { png: vec![1, 2, 3], caption: "\" onload=\"x".into() },
            Part::Chart { svg: "<svg></svg>".into(), caption: "d".into() },
        ];
        let html = page("t", "l", &[Section { title: "s".into(), parts }]);
        assert!(!html.contains("<script") && html.contains("&lt;script&gt;"));
        assert!(html.contains("data:image/png;base64,AQID") && !html.contains("\" onload=\"x"));
        assert!(html.contains("<tr class=\"marked\">") && html.contains("<td class=\"n\">1.5</td>"));
        assert!(html.contains("<svg></svg>") && !html.contains("http"));
        assert!(html.contains("prefers-color-scheme:dark") && html.contains("@media print"));
    }
}
