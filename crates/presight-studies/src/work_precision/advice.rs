//! Recommended paths, derived from the rows.
//!
//! A path is recommended only if the study's own repetitions separate it from noise. Two paths are compared pair by
//! pair: by their times in the same turns, or by their errors at the same features. If they were equal, each would be
//! ahead in half of the pairs (a sign test). A path is ahead only if chance would put any of the compared paths so far
//! ahead at most once in twenty studies.
//!
//! **Faster.** Another path replaces the default if it is as exact, ahead in time, and a tenth faster: less is not
//! worth a setting.
//!
//! **More exact.** Halving the step of the samples halves the error of visible fractions and doubles the time. Any
//! error can be bought at this price. So a path that takes longer replaces the default only if it is ahead in its
//! errors and they fall by more than its time grows: if error times time gets smaller, by the largest and by the mean
//! error, with the third quartile of its times against the first quartile of the other's.

use super::features::RESOLUTION;
use super::results::{FAULT_SHARE, Row};

/// A path is clearly faster only if it takes less than this fraction of the time.
const WORTH: f64 = 0.9;

/// Probability with which noise may put one of the compared paths ahead.
const CHANCE: f64 = 0.05;

/// A path with another polygon at more than this fraction of the pixels is never recommended.
const MOST_OTHER: f64 = 0.1;

/// A path to features is as exact as another if neither its largest nor its mean error of a visible fraction is larger
/// by more than this. Both are sampled at different points, and so is the truth.
const AS_EXACT: f64 = 1e-3;

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

/// Returns true if `a` is clearly faster than `b`, one of `choices` paths.
fn is_clearly_faster(a: &Row, b: &Row, choices: usize) -> bool {
    a.median_ms < WORTH * b.median_ms && is_ahead(&a.turns_ms, &b.turns_ms, choices)
}

/// Returns true if `a` is smaller in more pairs than chance explains for any of `choices` paths. Equal pairs and
/// those with NaN do not count.
fn is_ahead(a: &[f64], b: &[f64], choices: usize) -> bool {
    let count = |is: fn(&f64, &f64) -> bool| a.iter().zip(b).filter(|(a, b)| is(a, b)).count();
    let (ahead, behind) = (count(|a, b| a < b), count(|a, b| a > b));
    let pairs = (ahead + behind) as f64;
    // Sums the probabilities of `ahead` and more heads, from all heads downwards; their logarithms do not underflow.
    let mut log = pairs * 0.5f64.ln();
    let mut tail = log.exp();
    for heads in (ahead..ahead + behind).rev() {
        log += ((heads + 1) as f64 / (pairs - heads as f64)).ln();
        tail += log.exp();
    }
    tail * choices as f64 <= CHANCE
}

/// The default path, replaced in the order of the tables by each path that is clearly faster.
fn take<'a>(paths: &[&'a Row]) -> Option<&'a Row> {
    let start = paths.iter().find(|r| r.default).or(paths.first())?;
    let faster = |r: &Row, best: &Row| is_clearly_faster(r, best, paths.len());
    Some(paths.iter().fold(*start, |best, r| if faster(r, best) { r } else { best }))
}

/// Advice on exact images.
fn for_images(best: &Row, exact: &[&Row]) -> String {
    let (ids, time) = (ids(best.error), within(best));
    if best.default {
        return format!(
            "take {}, which is the default: exact to rounding ({ids}) in {time}. No other exact path is clearly \
             faster.",
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
        let choices = self.paths().filter(rough).count();
        let faster = self.paths().filter(rough).filter(|r| is_clearly_faster(r, best, choices));
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

/// The paths to features.
struct FeaturePaths<'a> {
    rows: &'a [Row],
    /// One for each path, with its largest error.
    paths: Vec<&'a Row>,
    rays: &'a Row,
}

/// The largest and the mean error of visible fractions.
const OF_FEATURES: [&str; 2] = ["visible_fraction", "visible_fraction_mean"];

impl<'a> FeaturePaths<'a> {
    /// `None` if the rows have no features.
    fn new(rows: &'a [Row]) -> Option<Self> {
        let paths: Vec<&Row> = rows.iter().filter(|r| r.error_kind == OF_FEATURES[0]).collect();
        let rays = *paths.iter().find(|r| r.variant == "features by rays")?;
        Some(Self { rows, paths, rays })
    }

    fn error(&self, of: &Row, kind: &str) -> f64 {
        let same = |r: &&Row| r.engine == of.engine && r.variant == of.variant && r.error_kind == kind;
        self.rows.iter().find(same).map_or(f64::INFINITY, |r| r.error)
    }

    fn is_as_exact(&self, a: &Row, b: &Row) -> bool {
        OF_FEATURES.iter().all(|kind| self.error(a, kind) <= self.error(b, kind) + AS_EXACT)
    }

    fn is_more_exact(&self, a: &Row, b: &Row) -> bool {
        is_ahead(&a.errors, &b.errors, self.paths.len())
    }

    /// Returns true if the errors of `a` are smaller than the errors of `b` by more than its time is longer.
    fn is_worth_its_time(&self, a: &Row, b: &Row) -> bool {
        OF_FEATURES.iter().all(|kind| {
            let least = RESOLUTION * self.error(self.rays, kind);
            let price = |r: &Row, ms: f64| self.error(r, kind).max(least) * ms;
            price(a, a.quartiles_ms[1]) < price(b, b.quartiles_ms[0])
        })
    }

    /// The default, replaced in the order of the tables by each better path.
    fn best(&self) -> &'a Row {
        let start = self.paths.iter().find(|r| r.default).copied().unwrap_or(self.rays);
        let is_better = |a: &Row, b: &Row| {
            self.is_as_exact(a, b) && is_clearly_faster(a, b, self.paths.len())
                || self.is_more_exact(a, b) && self.is_worth_its_time(a, b)
        };
        self.paths.iter().fold(start, |best, r| if is_better(r, best) { r } else { best })
    }

    fn errors_of(&self, r: &Row) -> String {
        match r.error {
            0.0 => "no error".to_owned(),
            most => {
                let mean = self.error(r, OF_FEATURES[1]);
                format!("errors of visible fractions at most {most:.4}, {mean:.5} on average")
            }
        }
    }
}

/// Advice on features.
fn for_features(rows: &[Row], features: usize) -> String {
    let Some(all) = FeaturePaths::new(rows) else { return String::new() };
    if features < FEW_FEATURES {
        return format!(" There are too few features in view for advice on them: {features}.");
    }
    let best = all.best();
    let seen = format!("measured on {features} features");
    let (whose, cost) = (name(best), format!("{}, in {}, {seen}", all.errors_of(best), ms(best.median_ms)));
    let mut text = match all.paths.iter().find(|r| r.default) {
        _ if best.default => format!(" For features take {whose}, which is the default: {cost}."),
        Some(default) => {
            let price = format!("{} with {}", ms(default.median_ms), all.errors_of(default));
            format!(" For features take {whose} ({}): {cost}; the default, {}, takes {price}.", best.how, name(default))
        }
        None => format!(" For features take {whose} ({}): {cost}.", best.how),
    };
    let exact = all.paths.iter().filter(|r| all.is_more_exact(r, best));
    let mean = |r: &Row| all.error(r, OF_FEATURES[1]);
    if let Some(exact) = exact.min_by(|a, b| mean(a).total_cmp(&mean(b))) {
        let (errors, time) = (all.errors_of(exact), ms(exact.median_ms));
        text += &format!(
            " {} ({}) has {errors}, but takes {time}: time grows by more than the errors fall.",
            name(exact),
            exact.how
        );
    }
    text
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
            turns_ms: vec![median_ms; 9],
            errors: vec![error; 40],
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
        // Half the time by the median, but slower in one of nine turns.
        let mut noisy = exact("noisy", 1.0);
        noisy.iter_mut().for_each(|r| r.turns_ms[4] = 2.5);
        let text = advice(&[exact("default", 2.0), exact("index", 1.9), exact("slow", 3.0), noisy]);
        assert!(text.contains("take cpu, default"), "{text}");
        // Two turns are too few, however fast.
        let mut rare = exact("rare", 0.1);
        rare.iter_mut().for_each(|r| r.turns_ms[2..].fill(f64::NAN));
        let text = advice(&[exact("default", 2.0), rare]);
        assert!(text.contains("take cpu, default"), "{text}");
        // A faulty default is not recommended.
        let text = advice(&[path("default", 0.0, Some(0.1), 1.0), exact("slow", 9.0)]);
        assert!(text.contains("take cpu, slow") && text.contains("the default shows faults"), "{text}");
        assert!(text.contains("Do not take cpu, default"), "{text}");
        assert!(advice(&[path("half", 0.1, None, 1.0)]).contains("no path agrees"));
    }

    #[test]
    fn a_less_exact_path_comes_with_its_cost() {
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

    /// A path to features whose 40 errors are alike, but for one, the largest.
    fn to_features(variant: &str, worst: f64, mean: f64, ms: f64) -> [Row; 2] {
        let errors = [vec![worst], vec![mean; 39]].concat();
        let row = |kind, error| Row { errors: errors.clone(), ..row(variant, kind, error, ms) };
        [row(OF_FEATURES[0], worst), row(OF_FEATURES[1], mean)]
    }

    #[test]
    fn errors_of_features_are_weighed_against_time() {
        let rays = |ms| to_features("features by rays", 0.031, 0.002, ms);
        let default = to_features("default", 0.053, 0.003, 10.0);
        // 1.7 times as exact is not worth 134 times the time.
        let text = for_features(&[rays(1343.0), default.clone()].concat(), 40);
        assert_eq!(
            text,
            " For features take cpu, default, which is the default: errors of visible fractions at most 0.0530, \
             0.00300 on average, in 10 ms, measured on 40 features. cpu, features by rays (--take features by rays) \
             has errors of visible fractions at most 0.0310, 0.00200 on average, but takes 1343 ms: time grows by more \
             than the errors fall."
        );
        // In 1.2 times the time, it is: the products of error and time are 0.37 and 0.024 against 0.53 and 0.03.
        let text = for_features(&[rays(12.0), default.clone()].concat(), 40);
        assert!(text.contains("take cpu, features by rays (--take features by rays): errors of visible"), "{text}");
        assert!(
            text.contains("the default, cpu, default, takes 10 ms with errors of visible fractions at most 0.0530")
        );
        // By the third quartile of its times against the first of the default's, 0.53 is not below 0.50.
        let text = for_features(&[rays(15.5), default.clone()].concat(), 40);
        assert!(text.contains("take cpu, default"), "{text}");
        assert!(for_features(&[rays(12.0), default].concat(), 9).contains("too few features in view"));
        assert_eq!(for_features(&to_features("default", 0.1, 0.1, 1.0), 40), "");
    }

    #[test]
    fn errors_that_differ_by_chance_do_not_count() {
        // The largest error is smaller, but at half of the features the default is more exact.
        let rays = to_features("features by rays", 0.03, 0.002, 10.0);
        let default = to_features("default", 0.05, 0.003, 10.0);
        let mut lucky = to_features("lucky", 0.01, 0.001, 10.0);
        lucky.iter_mut().for_each(|r| r.errors.iter_mut().step_by(2).for_each(|e| *e = 0.1));
        let text = for_features(&[rays.clone(), default.clone(), lucky].concat(), 40);
        assert!(text.contains("take cpu, features by rays"), "{text}");
        // Faster and rougher by less than sampling explains, or by more.
        let close = to_features("close", 0.0305, 0.0021, 5.0);
        let text = for_features(&[rays.clone(), default.clone(), close].concat(), 40);
        assert!(text.contains("take cpu, close"), "{text}");
        let rough = to_features("rough", 0.06, 0.005, 1.0);
        let text = for_features(&[default, rough, rays].concat(), 40);
        assert!(text.contains("take cpu, features by rays"), "{text}");
    }

    /// Nine fair coins all show heads once in 512 throws, and eight or more heads ten times.
    #[test]
    fn paths_are_ahead_by_more_than_chance() {
        let [one, two] = [vec![1.0; 9], vec![2.0; 9]];
        let mixed = [vec![1.0; 8], vec![3.0]].concat();
        assert!(is_ahead(&one, &two, 25) && !is_ahead(&one, &two, 26), "0.05 * 512 = 25.6");
        assert!(is_ahead(&mixed, &two, 2) && !is_ahead(&mixed, &two, 3), "0.05 * 51.2 = 2.56");
        assert!(!is_ahead(&one, &one, 1) && !is_ahead(&[], &[], 1) && !is_ahead(&two, &one, 1));
        let many = vec![1.0; 5000];
        assert!(!is_ahead(&many, &[vec![0.0; 2500], vec![2.0; 2500]].concat(), 1), "nothing underflows");
    }

    #[test]
    fn a_part_of_the_image_is_no_exact_answer() {
        let mut part = path("part", 0.0, Some(0.0), 1.0);
        part.push(row("part", "missing_share", 0.75, 1.0));
        let text = advice(&[part, path("default", 0.0, Some(0.0), 4.0)]);
        assert!(text.contains("take cpu, default") && text.contains("Nothing less exact"), "{text}");
    }
}
