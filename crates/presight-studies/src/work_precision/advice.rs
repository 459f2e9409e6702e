//! Recommended paths, derived from the rows.
//!
//! Times are noisy, so the advice recommends the default unless another path is *clearly faster*: its median is below
//! nine tenths of the other's, and its third quartile is below the other's first quartile.

use super::{FAULT_SHARE, Row};

/// A path is clearly faster only if it takes less than this fraction of the time.
const WORTH: f64 = 0.9;

/// A path with another polygon at more than this fraction of the pixels is never recommended.
const MOST_OTHER: f64 = 0.1;

/// Features are as exact as by rays if neither the largest nor the mean error of a visible fraction exceeds that of
/// rays by more than this. Both are sampled at different points, and so is the truth.
const AS_RAYS: f64 = 1e-3;

/// The minimum number of features for advice.
const FEW_FEATURES: usize = 10;

/// The advice for one scene and sensor. `features` is the number of features in view.
pub(super) fn of(scene: &str, sensor: &str, seen_share: f64, features: usize, rows: &[Row]) -> String {
    let whose = format!("For {scene} and {sensor}");
    if seen_share == 0.0 {
        return format!("{whose} there is no advice: nothing is visible from these poses; give others with --poses.");
    }
    let all = Rows(rows);
    let paths: Vec<&Row> = all.paths().collect();
    let exact: Vec<&Row> = paths.iter().copied().filter(|r| all.is_exact(r)).collect();
    let mut text = match take(&exact) {
        None => format!("{whose} no path agrees with the reference: see the faults below."),
        Some(best) => format!("{whose} on this machine {}{}", for_images(best, &exact), all.instead_of(best)),
    };
    text += &for_features(rows, features);
    let wrong: Vec<String> = paths.iter().filter(|r| all.error(r, FAULT_SHARE) > Some(0.0)).map(|r| name(r)).collect();
    if !wrong.is_empty() {
        text += &format!(" Do not take {}: it has pixels that rounding does not explain.", wrong.join(" or "));
    }
    text
}

/// Returns true if `a` is clearly faster than `b`.
fn is_clearly_faster(a: &Row, b: &Row) -> bool {
    a.median_ms < WORTH * b.median_ms && a.quartiles_ms[1] < b.quartiles_ms[0]
}

/// The default path, replaced in the order of the tables by each path that is clearly faster.
fn take<'a>(paths: &[&'a Row]) -> Option<&'a Row> {
    let start = paths.iter().find(|r| r.default).or(paths.first())?;
    Some(paths.iter().fold(*start, |best, r| if is_clearly_faster(r, best) { r } else { best }))
}

/// Advice on exact images.
fn for_images(best: &Row, exact: &[&Row]) -> String {
    let (ids, time) = (ids(best.error), within(best));
    if best.default {
        return format!(
            "take {}, which is the default: exact to rounding ({ids}) in {time}. No other exact path is clearly faster.",
            name(best)
        );
    }
    let default = match exact.iter().find(|r| r.default) {
        Some(default) => format!("the default, {}, takes {}", name(default), within(default)),
        None => "the default shows faults".into(),
    };
    format!("take {} ({}): exact to rounding ({ids}) in {time}; {default}.", name(best), best.how)
}

struct Rows<'a>(&'a [Row]);

impl<'a> Rows<'a> {
    /// The `id_mismatch` row of each path to an image.
    fn paths(&self) -> impl Iterator<Item = &'a Row> {
        self.0.iter().filter(|r| r.error_kind == "id_mismatch")
    }

    fn error(&self, of: &Row, kind: &str) -> Option<f64> {
        let same = |r: &&Row| r.engine == of.engine && r.variant == of.variant && r.error_kind == kind;
        self.0.iter().find(same).map(|r| r.error)
    }

    /// Returns true if the path predicts the whole image without faults.
    fn is_exact(&self, r: &Row) -> bool {
        self.error(r, FAULT_SHARE) == Some(0.0) && self.error(r, "missing_share").is_none()
    }

    /// Advice on a less exact but clearly faster path: the one with the smallest error.
    fn instead_of(&self, best: &Row) -> String {
        let rough = |r: &&Row| self.error(r, FAULT_SHARE).is_none() && self.error(r, "missing_share").is_none();
        let faster = self.paths().filter(rough).filter(|r| is_clearly_faster(r, best));
        let Some(rough) = faster.min_by(|a, b| a.error.total_cmp(&b.error)) else {
            return " Nothing less exact is clearly faster.".into();
        };
        if rough.error > MOST_OTHER {
            let most = 100.0 * MOST_OTHER;
            return format!(" Clearly faster paths show another polygon at more than {most} % of the pixels.");
        }
        let error = |kind| self.error(rough, kind).unwrap_or(0.0);
        let (moved, off) = (error("silhouette_px"), error("range_m"));
        let price = match (rough.error, moved) {
            (0.0, 0.0) => format!("range errors of up to {off:.1e} m, every polygon as in the reference,"),
            (0.0, _) => format!("silhouette errors of {moved:.2} pixels on average"),
            (share, _) => format!("{} and silhouette errors of {moved:.2} pixels on average", ids(share)),
        };
        format!(" If {price} are acceptable, {} takes {} ({}).", name(rough), ms(rough.median_ms), rough.how)
    }
}

/// Advice on features: a path that is as exact as a ray to every sample, by its largest and its mean error.
fn for_features(rows: &[Row], features: usize) -> String {
    let of_kind = |kind: &'static str| rows.iter().filter(move |r: &&Row| r.error_kind == kind);
    let error = |of: &Row, kind: &'static str| {
        of_kind(kind).find(|r| r.engine == of.engine && r.variant == of.variant).map_or(f64::INFINITY, |r| r.error)
    };
    let kinds = ["visible_fraction", "visible_fraction_mean"];
    let Some(rays) = of_kind(kinds[0]).find(|r| r.variant == "features by rays") else { return String::new() };
    if features < FEW_FEATURES {
        return format!(" There are too few features in view for advice on them: {features}.");
    }
    let as_exact = |r: &&Row| kinds.iter().all(|kind| error(r, kind) <= error(rays, kind) + AS_RAYS);
    let exact: Vec<&Row> = of_kind(kinds[0]).filter(as_exact).collect();
    let Some(best) = take(&exact) else { return String::new() };
    let off = |r: &Row| match (r.error, error(r, kinds[1])) {
        (0.0, _) => "no error".to_owned(),
        (most, mean) => format!("errors of visible fractions at most {most:.4}, {mean:.5} on average"),
    };
    let seen = format!("measured on {features} features");
    let (whose, cost) = (name(best), format!("{}, in {}, {seen}", off(best), ms(best.median_ms)));
    match of_kind(kinds[0]).find(|r| r.default) {
        _ if best.default => format!(" For features take {whose}, which is the default: {cost}."),
        Some(default) => {
            let price = format!("{} with {}", ms(default.median_ms), off(default));
            format!(" For features take {whose} ({}): {cost}; the default, {}, takes {price}.", best.how, name(default))
        }
        None => format!(" For features take {whose} ({}): {cost}.", best.how),
    }
}

fn name(r: &Row) -> String {
    format!("{}, {}", r.engine, r.variant)
}

fn ids(share: f64) -> String {
    if share == 0.0 {
        "every polygon as in the reference".into()
    } else {
        format!("{:.3} % other polygons", 100.0 * share)
    }
}

fn within(r: &Row) -> String {
    format!("{} (95 % within {})", ms(r.median_ms), ms(r.p95_ms))
}

fn ms(ms: f64) -> String {
    if ms < 10.0 { format!("{ms:.2} ms") } else { format!("{ms:.0} ms") }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A row with quartiles 5 % below and above the median.
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
            quartiles_ms: [0.95 * median_ms, 1.05 * median_ms],
            p95_ms: 1.2 * median_ms,
            pareto: false,
            runs: 1,
            default: variant == "default",
            how: format!("--take {variant}"),
            family: String::new(),
            label: String::new(),
        }
    }

    fn path(variant: &str, ids: f64, faults: Option<f64>, ms: f64) -> Vec<Row> {
        let mut rows = vec![row(variant, "id_mismatch", ids, ms), row(variant, "silhouette_px", 10.0 * ids, ms)];
        rows.push(row(variant, "range_m", 0.02, ms));
        rows.extend(faults.map(|f| row(variant, FAULT_SHARE, f, ms)));
        rows
    }

    fn advice(rows: &[Vec<Row>]) -> String {
        of("hall", "camera", 0.5, 40, &rows.concat())
    }

    #[test]
    fn the_default_stays_unless_another_is_clearly_faster() {
        let exact = |variant, ms| path(variant, 0.0, Some(0.0), ms);
        let text = advice(&[exact("slow", 9.0), exact("default", 2.0), exact("index", 1.85)]);
        assert!(text.contains("take cpu, default, which is the default: exact to rounding"), "{text}");
        assert!(text.contains("No other exact path is clearly faster. Nothing less exact"), "{text}");
        let text = advice(&[exact("default", 2.0), exact("one", 1.0), exact("two", 0.99)]);
        assert!(
            text.contains("take cpu, one (--take one): exact") && text.contains("default, cpu, default, takes 2.00 ms")
        );
        // Half the time, but the quartiles of both overlap.
        let mut noisy = exact("noisy", 1.0);
        noisy.iter_mut().for_each(|r| r.quartiles_ms = [0.5, 1.95]);
        let text = advice(&[exact("default", 2.0), noisy]);
        assert!(text.contains("take cpu, default"), "{text}");
        // A faulty default is not recommended.
        let text = advice(&[path("default", 0.0, Some(0.1), 1.0), exact("slow", 9.0)]);
        assert!(text.contains("take cpu, slow") && text.contains("the default shows faults"), "{text}");
        assert!(text.contains("Do not take cpu, default"), "{text}");
        assert!(advice(&[path("half", 0.1, None, 1.0)]).contains("no path agrees"));
    }

    #[test]
    fn what_is_less_exact_has_its_price_told() {
        let default = || path("default", 0.0, Some(0.0), 9.0);
        let text = advice(&[default(), path("half", 0.04, None, 1.0)]);
        assert!(text.contains("If 4.000 % other polygons and silhouette errors of 0.40 pixels"), "{text}");
        assert!(text.contains("cpu, half takes 1.00 ms (--take half)"), "{text}");
        let text = advice(&[default(), path("half", 0.0, None, 1.0)]);
        assert!(text.contains("If range errors of up to 2.0e-2 m, every polygon as in the reference, are"), "{text}");
        let text = advice(&[default(), path("quarter", 0.11, None, 0.1)]);
        assert!(text.contains("faster paths show another polygon at more than 10 % of the pixels"), "{text}");
        let text = advice(&[default(), path("half", 0.0, None, 8.5)]);
        assert!(text.contains("Nothing less exact is clearly faster"), "{text}");
        let text = of("hall", "camera", 0.0, 0, &default());
        assert!(text.contains("nothing is visible") && !text.contains("take"), "{text}");
    }

    #[test]
    fn features_are_taken_from_what_is_as_exact_as_rays() {
        let path = |variant: &str, worst: f64, mean: f64, ms: f64| {
            [row(variant, "visible_fraction", worst, ms), row(variant, "visible_fraction_mean", mean, ms)]
        };
        let rays = path("features by rays", 0.02, 0.002, 50.0);
        let default = path("default", 0.02, 0.002, 3.0);
        // A path with half the samples can have a smaller largest error by chance.
        let lucky = path("lucky", 0.01, 0.004, 1.0);
        let all = [rays.clone(), default.clone(), lucky.clone(), path("finer", 0.01, 0.001, 2.9)].concat();
        assert_eq!(
            for_features(&all, 40),
            " For features take cpu, default, which is the default: errors of visible fractions at most 0.0200, \
             0.00200 on average, in 3.00 ms, measured on 40 features."
        );
        assert!(for_features(&all, 9).contains("too few features in view for advice on them: 9"));
        // A difference explained by sampling does not replace the default; a larger one does.
        let sampled = path("default", 0.0205, 0.0023, 3.0);
        let text = for_features(&[rays.clone(), sampled, path("finer", 0.02, 0.001, 3.5)].concat(), 40);
        assert!(text.contains("take cpu, default, which is the default"), "{text}");
        let rough = path("default", 0.03, 0.0023, 3.0);
        let text = for_features(&[rays.clone(), rough, path("finer", 0.02, 0.001, 3.5)].concat(), 40);
        assert!(text.contains("take cpu, finer (--take finer): errors of visible fractions at most 0.0200"), "{text}");
        assert!(
            text.contains(
                "the default, cpu, default, takes 3.00 ms with errors of visible fractions at most 0.0300, 0.00230"
            ),
            "{text}"
        );
        let text = for_features(&[rays, lucky].concat(), 10);
        assert!(text.contains("features by rays (--take features by rays)"), "{text}");
        assert_eq!(for_features(&default, 40), "");
    }

    #[test]
    fn a_part_of_the_image_is_no_exact_answer() {
        let mut part = path("part", 0.0, Some(0.0), 1.0);
        part.push(row("part", "missing_share", 0.75, 1.0));
        let text = advice(&[part, path("default", 0.0, Some(0.0), 4.0)]);
        assert!(text.contains("take cpu, default") && text.contains("Nothing less exact"), "{text}");
    }
}
