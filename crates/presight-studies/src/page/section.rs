//! Pages of sections: texts, tables, charts and pictures.

use super::document::document;
use super::strip::Strip;
use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use maud::{Markup, PreEscaped, html};

/// Number of sections up to which a page starts with links to them.
const MAX_LINKS: usize = 20;

/// A section of a page.
#[derive(Clone, Debug, Default)]
pub struct Section {
    /// The heading.
    pub title: String,
    /// A coloured label before the heading.
    pub label: Option<Label>,
    /// The contents, in order.
    pub parts: Vec<Part>,
}

/// A coloured label.
#[derive(Clone, Copy, Debug)]
pub struct Label {
    /// One or two words.
    pub text: &'static str,
    /// A CSS colour.
    pub color: &'static str,
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
        /// An `<svg>` element, as from `chart::Chart::svg`.
        svg: String,
        /// The text below the chart.
        caption: String,
    },
    /// A strip chart.
    Strip {
        /// The values.
        strip: Strip,
        /// The text below the chart.
        caption: String,
    },
    /// Lines of text that are shown on request.
    Details {
        /// The text that is always shown.
        summary: String,
        /// The lines.
        text: String,
    },
    /// A picture in a file beside the page.
    Image {
        /// Path relative to the page.
        file: String,
        /// What the picture shows.
        alt: &'static str,
        /// The text below the picture.
        caption: String,
    },
    /// An embedded picture.
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

/// Makes a page that refers only to files of [`Part::Image`]. `lead` is the paragraph below the title.
///
/// ```
/// use presight_studies::page::{Part, Section, page};
/// let section = Section { title: "Times".into(), parts: vec![Part::Text("a < b".into())], label: None };
/// let html = page("Study", "Costs of predictions.", &[section]);
/// assert!(html.contains("a &lt; b") && !html.contains("src=\"http"));
/// ```
pub fn page(title: &str, lead: &str, sections: &[Section]) -> String {
    let body = html! {
        @if (3..=MAX_LINKS).contains(&sections.len()) {
            nav { @for (i, s) in sections.iter().enumerate() { a href=(format!("#s{i}")) { (s.title) } " " } }
        }
        main {
            @for (i, s) in sections.iter().enumerate() {
                section id=(format!("s{i}")) {
                    h2 {
                        @if let Some(Label { text, color }) = s.label {
                            b.label style=(format!("background:{color}")) { (text) } " "
                        }
                        (s.title)
                    }
                    @for p in &s.parts { (part(p)) }
                }
            }
        }
    };
    document(title, lead, "", &body)
}

fn part(part: &Part) -> Markup {
    html! {
        @match part {
            Part::Text(text) => p { (text) },
            Part::Advice(text) => p.advice { (text) },
            Part::Heading(text) => h3 { (text) },
            Part::Table(t) => (table(t)),
            Part::Chart { svg, caption } => figure { (PreEscaped(svg)) figcaption { (caption) } },
            Part::Strip { strip, caption } => figure { (strip.svg(None)) figcaption { (caption) } },
            Part::Details { summary, text } => details { summary { (summary) } pre { (text) } },
            Part::Image { file, alt, caption } => figure.picture { img alt=(alt) src=(file); figcaption { (caption) } },
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
            thead { tr {
                @for (c, name) in table.head.iter().enumerate() { th class=[class(c)] scope="col" { (heading(name)) } }
            } }
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
            Part::Details { summary: "all".into(), text: "<b>".into() },
            Part::Image { file: "1.png".into(), alt: "a", caption: "b".into() },
            Part::Picture { png: vec![1, 2, 3], caption: "\" onload=\"x".into() },
            Part::Chart { svg: "<svg></svg>".into(), caption: "d".into() },
        ];
        let html = page("t", "l", &[Section { title: "s".into(), parts, label: None }]);
        assert!(!html.contains("<script") && html.contains("&lt;script&gt;"));
        assert!(html.contains("data:image/png;base64,AQID") && !html.contains("\" onload=\"x"));
        assert!(html.contains("<tr class=\"marked\">") && html.contains("<td class=\"n\">1.5</td>"));
        assert!(html.contains("<summary>all</summary><pre>&lt;b&gt;</pre>") && html.contains("src=\"1.png\""));
        assert!(html.contains("<svg></svg>") && !html.contains("http"));
        assert!(html.contains("prefers-color-scheme:dark") && html.contains("@media print"));
    }
}
