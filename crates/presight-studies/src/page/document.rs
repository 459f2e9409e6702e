//! The frame of every page: head, style sheet, title and lead.

use maud::{DOCTYPE, Markup, PreEscaped, html};

/// The colour-blind safe palette of Okabe and Ito, for light and for dark pages.
pub(crate) const PALETTE: [(&str, &str); 8] = [
    ("#0072b2", "#56b4e9"),
    ("#d55e00", "#ff8c42"),
    ("#009e73", "#2fd6a3"),
    ("#b8860b", "#f0e442"),
    ("#cc79a7", "#e6a0c8"),
    ("#5b5bd6", "#9f9ff5"),
    ("#7a5230", "#c9a27c"),
    ("#606060", "#b0b0b0"),
];

/// A page with a title, a paragraph below it, and a body. `css` is added to the common style sheet.
pub(super) fn document(title: &str, lead: &str, css: &str, body: &Markup) -> String {
    html! {
        (DOCTYPE)
        html lang="en" {
            head {
                meta charset="utf-8";
                meta name="viewport" content="width=device-width, initial-scale=1";
                meta name="color-scheme" content="light dark";
                title { (title) }
                style { (PreEscaped(style())) (PreEscaped(css)) }
            }
            body { header { h1 { (title) } p.lead { (lead) } } (body) }
        }
    }
    .into_string()
}

/// The style sheet. Its colour variables have values for light screens and print, and for dark screens.
fn style() -> String {
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
