//! Pareto fronts of time and error.

use super::results::Row;

/// Decides for each (time, error) whether it is on the Pareto front: no other is at least as good in both and better in
/// one. NaN values are never on the front.
pub(super) fn front(points: &[(f64, f64)]) -> Vec<bool> {
    let mut order: Vec<usize> =
        (0..points.len()).filter(|i| !points[*i].0.is_nan() && !points[*i].1.is_nan()).collect();
    order.sort_by(|a, b| points[*a].0.total_cmp(&points[*b].0).then(points[*a].1.total_cmp(&points[*b].1)));
    let mut on = vec![false; points.len()];
    let mut last: Option<(f64, f64)> = None;
    for i in order {
        // All earlier points are faster. Keep a point that is more exact than all of them, or equal to the last kept.
        if last.is_none_or(|kept| points[i].1 < kept.1 || points[i] == kept) {
            on[i] = true;
            last = Some(points[i]);
        }
    }
    on
}

/// Marks the front among the rows of each kind of error. Regions of interest are compared only at the same pose errors,
/// which are in their labels. Never marks their size, which is not an error, nor paths to a part of the image.
pub(super) fn mark(rows: &mut [Row]) {
    let path = |r: &Row| (r.engine.clone(), r.variant.clone());
    let partial: Vec<_> = rows.iter().filter(|r| r.error_kind == "missing_share").map(path).collect();
    let group = |r: &Row| match r.error_kind {
        "roi_area_share" => None,
        _ if partial.contains(&path(r)) => None,
        kind if kind.starts_with("roi") => Some((kind, r.label.clone())),
        kind => Some((kind, String::new())),
    };
    let groups: Vec<_> = rows.iter().map(group).collect();
    let mut kinds: Vec<_> = groups.iter().flatten().collect();
    kinds.sort_unstable();
    kinds.dedup();
    for kind in kinds {
        let of_kind: Vec<usize> = (0..rows.len()).filter(|i| groups[*i].as_ref() == Some(kind)).collect();
        let points: Vec<(f64, f64)> = of_kind.iter().map(|i| (rows[*i].median_ms, rows[*i].error)).collect();
        for (i, on) in of_kind.into_iter().zip(front(&points)) {
            rows[i].pareto = on;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use presight_model::random::SplitMix64;

    #[test]
    fn the_front_is_what_brute_force_finds() {
        let mut random = SplitMix64(5);
        for n in 0..200 {
            // Few distinct values, so that ties and duplicates occur.
            let mut value = || (random.bits() % 6) as f64;
            let points: Vec<(f64, f64)> = (0..n % 17).map(|_| (value(), value())).collect();
            let beats = |a: &(f64, f64), b: &(f64, f64)| a.0 <= b.0 && a.1 <= b.1 && a != b;
            let right: Vec<bool> = points.iter().map(|p| !points.iter().any(|q| beats(q, p))).collect();
            assert_eq!(front(&points), right, "{points:?}");
        }
    }

    #[test]
    fn what_is_no_number_is_never_on_it() {
        assert_eq!(front(&[(f64::NAN, 0.0), (1.0, f64::NAN), (2.0, 1.0)]), [false, false, true]);
    }
}
