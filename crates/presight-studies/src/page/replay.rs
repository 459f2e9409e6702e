//! A drive as a page to browse: an image for each frame, with the estimated pose, its uncertainty and the state.

use super::document::document;
use super::strip::Strip;
use maud::{Markup, PreEscaped, html};
use serde::Serialize;

/// The page's data of one frame.
#[derive(Clone, Debug, Default, Serialize)]
pub struct Leaf {
    /// Path of the image, relative to the page.
    pub picture: String,
    /// Time stamp, seconds.
    pub time: f64,
    /// State of the localizer: `unknown`, `candidates`, `kept`, `tracking` or `lost`.
    pub state: &'static str,
    /// Reason for the state, with numbers.
    pub reason: String,
    /// Estimated position of the robot, metres.
    pub position: [f64; 3],
    /// Estimated roll, pitch and yaw, degrees.
    pub attitude_deg: [f64; 3],
    /// Standard deviations of x, y, z in metres and about x, y, z in degrees.
    pub sigmas: [f64; 6],
    /// Directions that the measurement hardly constrains.
    pub weak: Vec<String>,
    /// Fraction of the measured points that are explained.
    pub explained: f64,
    /// Standard deviation of the map's surfaces, metres: the stated one, or the one learnt so far.
    pub model_sigma: f64,
    /// Fraction of the pixels with each verdict, by name.
    pub verdicts: Vec<(&'static str, f64)>,
    /// Counts of predicted features by class, and of other detections; empty without a search for features.
    pub features: Vec<(&'static str, usize)>,
    /// Position of the robot in the log's own poses, metres.
    pub reference: Option<[f64; 3]>,
    /// Error against the log's own pose, metres and degrees.
    pub off: Option<(f64, f64)>,
    /// Normalized estimation error squared per degree of freedom: 1 on average if the covariance is right.
    pub nees: Option<f64>,
}

/// States, and their colour variables in the style sheet.
const STATES: [(&str, &str); 5] =
    [("tracking", "--s2"), ("kept", "--s5"), ("candidates", "--s3"), ("lost", "--s1"), ("unknown", "--s7")];
/// Side of the plan, pixels.
const SIDE: f64 = 420.0;

/// Makes a page that refers only to the images. `lead` is the paragraph below the title.
///
/// ```
/// use presight_studies::page::replay::{Leaf, page};
/// let leaf = |k: u32| Leaf { picture: format!("{k}.png"), state: "tracking", time: k.into(), ..Leaf::default() };
/// let html = page("Drive", "Two frames.", &[leaf(0), leaf(1)]);
/// assert!(html.contains("src=\"0.png\"") && !html.contains("http"));
/// ```
pub fn page(title: &str, lead: &str, leaves: &[Leaf]) -> String {
    // Escape `<`: a text such as `</script>` in the data would end the script element.
    let data = serde_json::to_string(leaves).unwrap_or_else(|_| "[]".into()).replace('<', "\\u003c");
    let first = leaves.first().map(|leaf| leaf.picture.as_str()).unwrap_or_default();
    let body = html! {
        main {
            div.beside {
                figure {
                    (plan(leaves))
                    figcaption { "From above, x to the right, y up: the estimate; dashed: the log's own poses." }
                }
                div.told { dl id="told" {} }
            }
            (strips(leaves))
            div.controls {
                button id="before" aria-label="previous frame" { "◀" }
                input id="frame" type="range" min="0" max=(leaves.len().saturating_sub(1)) value="0" aria-label="frame";
                button id="after" aria-label="next frame" { "▶" }
                button id="play" { "play" }
            }
            figure.picture { img id="picture" src=(first) alt="predicted, measured and verdicts"; }
            noscript { p { "Without JavaScript the page shows only the first frame; all images are in its folder." } }
        }
        script id="leaves" type="application/json" { (PreEscaped(data)) }
        script { (PreEscaped(include_str!("replay.js"))) }
    };
    document(title, lead, include_str!("replay.css"), &body)
}

fn strips(leaves: &[Leaf]) -> Markup {
    let strip = |name: &str, value: fn(&Leaf) -> Option<f64>| Strip {
        name: name.into(),
        values: leaves.iter().map(value).collect(),
        ..Strip::default()
    };
    let all = [
        strip("explained fraction", |l| Some(l.explained)),
        strip("standard deviation of the map's surfaces, m", |l| Some(l.model_sigma)),
        strip("position error, m", |l| l.off.map(|o| o.0)),
        Strip { levels: vec![1.0], logarithmic: true, ..strip("NEES per degree of freedom", |l| l.nees) },
    ];
    html! {
        figure {
            (states(leaves))
            figcaption.key {
                @for (name, color) in STATES { span { i style=(format!("background:var({color})")) {} (name) } }
            }
        }
        @for strip in all.iter().filter(|s| s.values.iter().any(Option::is_some)) {
            figure { (strip.svg(Some(&now(Strip::height())))) figcaption { (strip.name) (range(strip)) } }
        }
    }
}

fn range(strip: &Strip) -> String {
    let [min, max] = strip.range();
    let scale = if strip.logarithmic { ", logarithmic" } else { "" };
    let expected: String = strip.levels.iter().map(|e| format!(", {e} expected (dashed)")).collect();
    format!(": {min:.3} to {max:.3}{scale}{expected}")
}

fn states(leaves: &[Leaf]) -> Markup {
    let color = |state: &str| STATES.iter().find(|(name, _)| *name == state).map_or("--faint", |(_, color)| *color);
    let width = 1000.0 / leaves.len().max(1) as f64;
    html! {
        svg.strip viewBox="0 0 1000 14" preserveAspectRatio="none" role="img" aria-label="states" {
            @for (k, leaf) in leaves.iter().enumerate() {
                rect x=(format!("{:.3}", k as f64 * width)) y="0" width=(format!("{:.3}", width + 0.05)) height="14"
                    style=(format!("fill:var({})", color(leaf.state))) {}
            }
            (now(14.0))
        }
    }
}

/// The cursor at the current frame, which the script moves.
fn now(height: f64) -> Markup {
    html! { line.now x1="0" x2="0" y1="0" y2=(height) {} }
}

/// The trajectory from above, with the same scale along both axes.
fn plan(leaves: &[Leaf]) -> Markup {
    let believed: Vec<[f64; 2]> = leaves.iter().map(|l| [l.position[0], l.position[1]]).collect();
    let reference: Vec<[f64; 2]> = leaves.iter().filter_map(|l| l.reference).map(|p| [p[0], p[1]]).collect();
    let all = || believed.iter().chain(&reference).copied().filter(|p| p.iter().all(|x| x.is_finite()));
    let low = |i: usize| all().map(|p| p[i]).fold(f64::INFINITY, f64::min);
    let high = |i: usize| all().map(|p| p[i]).fold(f64::NEG_INFINITY, f64::max);
    let (left, top, extent) = (low(0), high(1), (high(0) - low(0)).max(high(1) - low(1)).max(0.1));
    let at =
        |p: [f64; 2]| [0, 1].map(|i| 20.0 + (SIDE - 40.0) * if i == 0 { p[0] - left } else { top - p[1] } / extent);
    let line = |points: &[[f64; 2]]| {
        let text = |p: &[f64; 2]| at(*p).map(|x| format!("{x:.2}")).join(",");
        points.iter().map(text).collect::<Vec<_>>().join(" ")
    };
    // A round length for the scale bar.
    let power = 10f64.powf(extent.log10().floor());
    let metres = [5.0, 2.0, 1.0, 0.5, 0.2].map(|d| d * power).into_iter().find(|m| *m <= 0.5 * extent).unwrap_or(power);
    let bar = (SIDE - 40.0) * metres / extent;
    html! {
        svg.plan viewBox=(format!("0 0 {SIDE} {SIDE}")) role="img" aria-label="trajectory"
            data-left=(left) data-top=(top) data-extent=(extent) {
            polyline.reference points=(line(&reference)) {}
            polyline points=(line(&believed)) {}
            line.bar x1="20" x2=(20.0 + bar) y1=(SIDE - 8.0) y2=(SIDE - 8.0) {}
            text x=(26.0 + bar) y=(SIDE - 4.0) { (metres) " m" }
            circle.here cx="-9" cy="-9" r="6" {}
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn drive() -> Vec<Leaf> {
        let leaf = |k: usize| Leaf {
            picture: format!("frames/{k:06}.png"),
            time: k as f64,
            state: if k == 3 { "lost" } else { "tracking" },
            reason: "</script><b>".into(),
            position: [k as f64, 0.5 * k as f64, 0.0],
            reference: (k != 2).then_some([k as f64, 0.5 * k as f64 + 0.1, 0.0]),
            nees: (k != 2).then_some(1.0 + k as f64),
            ..Leaf::default()
        };
        (0..5).map(leaf).collect()
    }

    #[test]
    fn no_text_ends_the_script() {
        let html = page("a < b", "l", &drive());
        assert!(html.contains("a &lt; b") && !html.contains("</script><b>") && html.contains("\\u003c/script>"));
        assert_eq!(html.matches("</script>").count(), 2);
        let data = html.split("type=\"application/json\">").nth(1).unwrap().split("</script>").next().unwrap();
        let read: serde_json::Value = serde_json::from_str(data).unwrap();
        assert_eq!(read[4]["reason"], "</script><b>");
    }

    /// From (0, 0) to (4, 2) within 380 of 420 pixels: 95 pixels per metre, with the highest y of 2.1 at the top.
    #[test]
    fn the_plan_has_one_scale() {
        let html = plan(&drive()).into_string();
        assert!(
            html.contains("points=\"20.00,219.50 115.00,172.00 210.00,124.50 305.00,77.00 400.00,29.50\""),
            "{html}"
        );
        assert!(html.contains("<line class=\"bar\" x1=\"20\" x2=\"210\""), "{html}");
    }

    #[test]
    fn curves_break_where_nothing_is_known() {
        let html = strips(&drive()).into_string();
        let nees = html.split("aria-label=\"NEES").nth(1).unwrap().split("</svg>").next().unwrap();
        assert_eq!(nees.matches("<polyline").count(), 2, "{nees}");
        assert!(html.contains("NEES per degree of freedom: 1.000 to 5.000, logarithmic, 1 expected"), "{html}");
        assert!(!html.contains("aria-label=\"position error, m\""));
    }
}
