//! Errors of images.

use super::results::FAULT_SHARE;
use presight_model::error::Result;
use presight_render::plan::{FramePlan, Images};
use presight_render::verify;
use presight_render::verify::Precision;

/// Distances between borders are clamped to this, pixels.
const REACH: i32 = 16;

/// Errors of images: the worst over poses; fractions and means over all pixels.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct ImageErrors {
    pixels: usize,
    /// Pixels with another polygon, or where only one of the two images has a hit.
    other_id: usize,
    /// Pixels that rounding does not explain; `None` for paths that are not exact.
    faults: Option<usize>,
    /// The largest difference of ranges where both show the same polygon, in units in the last place.
    ulps: u32,
    /// The difference in metres, and the difference allowed at that pixel.
    range_m: f64,
    allowed_m: f64,
    /// The largest ratio of the difference to that allowed at its pixel.
    of_bound: f64,
    /// Sum of |difference| over pixels where both ranges are finite, and their number.
    range_sum_m: f64,
    both_see: usize,
    /// Sum of distances between borders of objects, their number, and the largest distance, pixels.
    border_sum: f64,
    borders: usize,
    border_most: f64,
    /// Fraction of the sensor's pixels that the path leaves out.
    missing_share: f64,
}

impl ImageErrors {
    /// No errors yet, for a path that leaves out a fraction of the sensor's pixels.
    pub fn of_all_but(missing_share: f64) -> Self {
        Self { missing_share, ..Self::default() }
    }

    /// Adds the errors of another pose.
    pub fn add(&mut self, other: &Self) {
        self.pixels += other.pixels;
        self.other_id += other.other_id;
        if let Some(more) = other.faults {
            *self.faults.get_or_insert(0) += more;
        }
        self.ulps = self.ulps.max(other.ulps);
        if other.range_m > self.range_m || self.allowed_m == 0.0 {
            (self.range_m, self.allowed_m) = (other.range_m, other.allowed_m);
        }
        self.of_bound = self.of_bound.max(other.of_bound);
        self.range_sum_m += other.range_sum_m;
        self.both_see += other.both_see;
        self.border_sum += other.border_sum;
        self.borders += other.borders;
        self.border_most = self.border_most.max(other.border_most);
    }

    /// All kinds of errors: name, error, and the bound if there is one.
    pub fn kinds(&self) -> Vec<(&'static str, f64, Option<f64>)> {
        let share = |n: usize, of: usize| n as f64 / of.max(1) as f64;
        let exact = self.faults.is_some();
        let mut kinds = vec![
            ("id_mismatch", share(self.other_id, self.pixels), None),
            ("range_ulp", f64::from(self.ulps), None),
            // If no range differs, there is no pixel of the largest error.
            ("range_m", self.range_m, (exact && self.range_m > 0.0).then_some(self.allowed_m)),
            ("range_mean_m", self.range_sum_m / self.both_see.max(1) as f64, None),
            ("range_of_bound", self.of_bound, exact.then_some(1.0)),
            ("silhouette_px", self.border_sum / self.borders.max(1) as f64, None),
            ("silhouette_most_px", self.border_most, None),
        ];
        if let Some(faults) = self.faults {
            kinds.push((FAULT_SHARE, share(faults, self.pixels), Some(0.0)));
        }
        if self.missing_share > 0.0 {
            kinds.push(("missing_share", self.missing_share, None));
        }
        kinds
    }
}

/// Compares images of the same pixels. For an exact path of precision `exact`, [`verify::compare`] counts faults.
///
/// # Errors
/// Images of different sizes.
pub(super) fn compare_images(
    truth: &Images,
    other: &Images,
    plan: &FramePlan,
    exact: Option<Precision>,
) -> Result<ImageErrors> {
    let mut errors = ImageErrors { pixels: truth.pixels(), ..ImageErrors::default() };
    if let Some(precision) = exact {
        errors.faults = Some(verify::compare(truth, other, plan, precision)?.fault);
    }
    // Paths that are not exact are compared with the strictest bound.
    let precision = exact.unwrap_or(Precision::F64);
    for at in 0..truth.pixels() {
        let (r, o) = (truth.range[at], other.range[at]);
        let same_id = truth.polygon_id[at] == other.polygon_id[at] && truth.object_id[at] == other.object_id[at];
        let same_kind = r.is_finite() && o.is_finite() || r == o || r.is_nan() && o.is_nan();
        errors.other_id += usize::from(!(same_id && same_kind));
        if !(r.is_finite() && o.is_finite()) {
            continue;
        }
        let off = (f64::from(r) - f64::from(o)).abs();
        errors.range_sum_m += off;
        errors.both_see += 1;
        if same_id && truth.polygon_id[at] != 0 && off > 0.0 {
            let pixel = (at as u32 % truth.width, at as u32 / truth.width);
            let allowed = verify::allowed(truth, plan, pixel, precision).map_or(f64::INFINITY, |a| a.range);
            errors.of_bound = errors.of_bound.max(off / allowed);
            errors.ulps = errors.ulps.max(r.to_bits().abs_diff(o.to_bits()));
            if off > errors.range_m {
                (errors.range_m, errors.allowed_m) = (off, allowed);
            }
        }
    }
    displacement(truth, other, &mut errors);
    Ok(errors)
}

/// Adds the distances from each border pixel of one image to the nearest of the other, in both directions.
fn displacement(truth: &Images, other: &Images, errors: &mut ImageErrors) {
    let (a, b) = (borders(truth), borders(other));
    for (from, to) in [(&a, &b), (&b, &a)] {
        if from == to {
            errors.borders += from.iter().filter(|on| **on).count();
            continue;
        }
        let beside = beside(to, truth.width as usize);
        for (at, _) in from.iter().enumerate().filter(|(_, on)| **on) {
            let distance = distance(&beside, truth.width as usize, at);
            errors.border_sum += distance;
            errors.borders += 1;
            errors.border_most = errors.border_most.max(distance);
        }
    }
}

/// Pixels whose right or lower neighbour shows another object.
fn borders(images: &Images) -> Vec<bool> {
    let (w, id) = (images.width as usize, &images.object_id);
    let border = |at: usize| {
        let right = at % w + 1 < w && id[at] != id[at + 1];
        right || id.get(at + w).is_some_and(|below| *below != id[at])
    };
    (0..id.len()).map(border).collect()
}

/// Distance along the row to the nearest pixel that is set, at most [`REACH`].
fn beside(set: &[bool], w: usize) -> Vec<i32> {
    let mut distances = vec![REACH; set.len()];
    for (row, on) in distances.chunks_mut(w).zip(set.chunks(w)) {
        let mut since = REACH;
        for x in 0..w {
            since = if on[x] { 0 } else { (since + 1).min(REACH) };
            row[x] = since;
        }
        since = REACH;
        for x in (0..w).rev() {
            since = if on[x] { 0 } else { (since + 1).min(REACH) };
            row[x] = row[x].min(since);
        }
    }
    distances
}

/// Euclidean distance to the nearest pixel that is set, at most [`REACH`].
fn distance(beside: &[i32], w: usize, at: usize) -> f64 {
    let (x, y, h) = (at % w, (at / w) as i32, (beside.len() / w) as i32);
    let mut best = REACH * REACH;
    for dy in 0..REACH {
        if dy * dy >= best {
            break;
        }
        for row in [y - dy, y + dy] {
            if (0..h).contains(&row) {
                let along = beside[row as usize * w + x];
                best = best.min(dy * dy + along * along);
            }
        }
    }
    f64::from(best).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;
    use presight_model::random::SplitMix64;
    use presight_predict::probe::{Probe, SensorKind};

    fn error(errors: &ImageErrors, kind: &str) -> f64 {
        errors.kinds().into_iter().find(|k| k.0 == kind).unwrap().1
    }

    /// Errors of the probe's reference images after `spoil`.
    fn spoiled(spoil: impl Fn(&mut Images)) -> ImageErrors {
        let mut found = None;
        let outputs = presight_render::plan::Outputs::default();
        let probe = Probe::new().unwrap();
        let draw = |plan: &FramePlan, images: &mut Images| {
            presight_render::reference::render(plan, images)?;
            let truth = images.clone();
            let mut other = truth.clone();
            spoil(&mut other);
            found = Some(compare_images(&truth, &other, plan, Some(Precision::F64))?);
            Ok(())
        };
        probe.run(SensorKind::Camera, outputs, draw).unwrap();
        found.unwrap()
    }

    #[test]
    fn the_truth_has_no_error() {
        for (kind, error, bound) in spoiled(|_| ()).kinds() {
            assert_eq!(error, 0.0, "{kind}");
            assert!(kind != "range_m" || bound.is_none(), "a bound of {bound:?} m without an error");
        }
    }

    #[test]
    fn planted_faults_show() {
        let seen = |i: &Images| i.range.iter().position(|r| r.is_finite()).unwrap();
        let farther = spoiled(|i| {
            let at = seen(i);
            i.range[at] += 1e-3;
        });
        assert!(error(&farther, "range_m") > 0.9e-3 && error(&farther, "fault_share") > 0.0);
        let bound = farther.kinds().into_iter().find(|k| k.0 == "range_m").unwrap().2;
        assert!(bound.is_some_and(|b| b > 0.0 && b < 1e-3), "{bound:?}");
        assert!(error(&farther, "range_of_bound") > 1.0 && error(&farther, "range_ulp") > 100.0);
        assert_eq!(error(&farther, "id_mismatch"), 0.0);
        let by_an_ulp = spoiled(|i| {
            let at = seen(i);
            i.range[at] = i.range[at].next_up();
        });
        assert_eq!(error(&by_an_ulp, "range_ulp"), 1.0);
        assert!(error(&by_an_ulp, "range_of_bound") <= 1.0 && error(&by_an_ulp, "fault_share") == 0.0);
        let renamed = spoiled(|i| {
            let at = seen(i);
            i.polygon_id[at] += 1;
        });
        assert!(error(&renamed, "id_mismatch") > 0.0 && error(&renamed, "fault_share") > 0.0);
        let shifted = spoiled(|i| {
            let w = i.width as usize;
            i.object_id.chunks_mut(w).for_each(|row| row.rotate_right(2));
        });
        assert!((0.5..=2.5).contains(&error(&shifted, "silhouette_px")), "{shifted:?}");
        assert!(error(&shifted, "silhouette_most_px") >= 2.0);
        let blind = spoiled(|i| i.range.fill(f32::INFINITY));
        assert!(error(&blind, "id_mismatch") > 0.1);
    }

    #[test]
    fn distances_are_what_brute_force_finds() {
        let mut random = SplitMix64(3);
        let (w, h) = (23usize, 17usize);
        for rare in [3, 40, 400, 4000] {
            let set: Vec<bool> = (0..w * h).map(|_| random.bits().is_multiple_of(rare)).collect();
            let along = beside(&set, w);
            for at in 0..w * h {
                let to = |other: usize| {
                    let (dx, dy) = ((at % w).abs_diff(other % w) as f64, (at / w).abs_diff(other / w) as f64);
                    dx.hypot(dy)
                };
                let nearest = (0..w * h).filter(|o| set[*o]).map(to).fold(f64::from(REACH), f64::min);
                assert!((distance(&along, w, at) - nearest).abs() < 1e-12);
            }
        }
    }
}
