//! What to take, worked out from the rows.

use super::Row;
use super::features::ROUNDING;

/// What is less exact must take at most this share of the time to be worth a word.
const WORTH: f64 = 0.9;

/// A sentence or two for one scene and sensor.
pub(super) fn of(scene: &str, sensor: &str, rows: &[Row]) -> String {
    let error = |of: &Row, kind: &str| {
        let same = |r: &&Row| r.engine == of.engine && r.variant == of.variant && r.error_kind == kind;
        rows.iter().find(same).map(|r| r.error)
    };
    // Each path has one such row.
    let paths = || rows.iter().filter(|r| r.error_kind == "id_mismatch");
    let fastest = |a: &&Row, b: &&Row| a.median_ms.total_cmp(&b.median_ms);
    let exact = |r: &&Row| error(r, "fault_share") == Some(0.0) && error(r, "missing_share").is_none();
    let Some(best) = paths().filter(exact).min_by(fastest) else {
        return format!("For {scene} and {sensor} no path agrees with the reference: see the faults below.");
    };
    let mut text = format!(
        "For {scene} and {sensor} on this machine take {}, {}: exact to rounding ({}) in {} (95 % within {}).",
        best.engine,
        best.variant,
        ids(best.error),
        ms(best.median_ms),
        ms(best.p95_ms),
    );
    let rough = |r: &&Row| !exact(r) && error(r, "missing_share").is_none() && r.median_ms < WORTH * best.median_ms;
    match paths().filter(rough).min_by(|a, b| a.error.total_cmp(&b.error)) {
        Some(rough) => {
            let moved = error(rough, "silhouette_px").unwrap_or(0.0);
            text += &format!(
                " If {} and silhouettes off by {moved:.2} pixels on average will do, {}, {} takes {}.",
                ids(rough.error),
                rough.engine,
                rough.variant,
                ms(rough.median_ms),
            );
        }
        None => text += " Nothing less exact is faster by a tenth.",
    }
    text += &for_features(rows).unwrap_or_default();
    let wrong: Vec<String> = paths()
        .filter(|r| error(r, "fault_share").is_some_and(|share| share > 0.0))
        .map(|r| format!("{}, {}", r.engine, r.variant))
        .collect();
    if !wrong.is_empty() {
        text += &format!(" Do not take {}: pixels that no rounding explains.", wrong.join(" or "));
    }
    text
}

/// The fastest way to features that is as exact as a ray to every sample, by its greatest error and by its mean.
fn for_features(rows: &[Row]) -> Option<String> {
    let of_kind = |kind: &'static str| rows.iter().filter(move |r: &&Row| r.error_kind == kind);
    let error = |of: &Row, kind: &'static str| {
        of_kind(kind).find(|r| r.engine == of.engine && r.variant == of.variant).map_or(f64::INFINITY, |r| r.error)
    };
    let kinds = ["visible_fraction", "visible_fraction_mean"];
    let rays = of_kind(kinds[0]).find(|r| r.variant == "features by rays")?;
    let as_exact = |r: &&Row| kinds.iter().all(|kind| error(r, kind) <= error(rays, kind) + ROUNDING);
    let best = of_kind(kinds[0]).filter(as_exact).min_by(|a, b| a.median_ms.total_cmp(&b.median_ms))?;
    let off = if best.error == 0.0 { "no error".into() } else { format!("at most {:.3} of one wrong", best.error) };
    Some(format!(" For features take {}, {}: {off}, in {}.", best.engine, best.variant, ms(best.median_ms)))
}

fn ids(share: f64) -> String {
    if share == 0.0 {
        "every polygon as in the reference".into()
    } else {
        format!("{:.3} % other polygons", 100.0 * share)
    }
}

fn ms(ms: f64) -> String {
    if ms < 10.0 { format!("{ms:.2} ms") } else { format!("{ms:.0} ms") }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn row(variant: &str, error_kind: &'static str, error: f64, median_ms: f64) -> Row {
        Row {
            scene: "s".into(),
            sensor: "c".into(),
            engine: "cpu".into(),
            variant: variant.into(),
            error_kind,
            error,
            bound: None,
            median_ms,
            p95_ms: median_ms,
            pareto: false,
            runs: 1,
            family: String::new(),
            label: String::new(),
        }
    }

    fn path(variant: &str, ids: f64, faults: Option<f64>, ms: f64) -> Vec<Row> {
        let mut rows = vec![row(variant, "id_mismatch", ids, ms), row(variant, "silhouette_px", 0.5, ms)];
        rows.extend(faults.map(|f| row(variant, "fault_share", f, ms)));
        rows
    }

    #[test]
    fn it_follows_the_rows() {
        let slow = path("slow", 0.0, Some(0.0), 9.0);
        let fast = path("fast", 0.0, Some(0.0), 2.0);
        let half = path("half", 0.04, None, 1.0);
        let all = [slow.clone(), fast, half.clone()].concat();
        let text = of("hall", "camera", &all);
        assert!(text.contains("take cpu, fast: exact") && text.contains("4.000 % other polygons"), "{text}");
        assert!(text.contains("cpu, half takes 1.00 ms") && !text.contains("Do not take"), "{text}");
        let text = of("hall", "camera", &[slow, path("fast", 0.0, Some(0.1), 2.0)].concat());
        assert!(text.contains("take cpu, slow: exact") && text.contains("Do not take cpu, fast"), "{text}");
        assert!(text.contains("Nothing less exact") || text.contains("If "), "{text}");
        assert!(of("hall", "camera", &half).contains("no path agrees"));
    }

    #[test]
    fn features_are_taken_from_what_is_as_exact_as_rays() {
        let path = |variant: &str, worst: f64, mean: f64, ms: f64| {
            [row(variant, "visible_fraction", worst, ms), row(variant, "visible_fraction_mean", mean, ms)]
        };
        let rays = path("features by rays", 0.02, 0.002, 50.0);
        let fast = path("fast", 0.02, 0.002, 3.0);
        // Half the samples may be lucky at the worst one.
        let lucky = path("lucky", 0.01, 0.004, 1.0);
        let all = [rays.clone(), fast.clone(), lucky.clone(), path("finer", 0.01, 0.001, 4.0)].concat();
        assert_eq!(
            for_features(&all).unwrap(),
            " For features take cpu, fast: at most 0.020 of one wrong, in 3.00 ms."
        );
        let text = for_features(&[rays, lucky].concat()).unwrap();
        assert!(text.contains("features by rays"), "{text}");
        assert_eq!(for_features(&fast), None);
    }

    #[test]
    fn a_part_of_the_image_is_no_exact_answer() {
        let mut rows = path("part", 0.0, Some(0.0), 1.0);
        rows.push(row("part", "missing_share", 0.75, 1.0));
        rows.extend(path("all", 0.0, Some(0.0), 4.0));
        let text = of("hall", "camera", &rows);
        assert!(text.contains("take cpu, all: exact") && text.contains("Nothing less exact"), "{text}");
    }
}
