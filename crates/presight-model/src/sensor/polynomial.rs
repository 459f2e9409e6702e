//! Sign changes of polynomials. A lens model folds over at the first one.

/// Value of `coefficients[0] + coefficients[1] x + ..`.
pub(super) fn evaluate(coefficients: &[f64], x: f64) -> f64 {
    coefficients.iter().rev().fold(0.0, |sum, c| sum * x + c)
}

/// Coefficients of the product.
pub(super) fn product(a: &[f64], b: &[f64]) -> Vec<f64> {
    let mut p = vec![0.0; a.len() + b.len() - 1];
    for (i, x) in a.iter().enumerate() {
        for (j, y) in b.iter().enumerate() {
            p[i + j] += x * y;
        }
    }
    p
}

/// Coefficients of the derivative.
pub(super) fn derivative(a: &[f64]) -> Vec<f64> {
    a.iter().enumerate().skip(1).map(|(i, c)| i as f64 * c).collect()
}

/// Every x in (0, upper) where the polynomial changes sign, rising, to the last bit of its evaluation.
///
/// A polynomial is monotone between two neighbouring sign changes of its derivative and has at most one sign change
/// there. The recursion finds the sign changes of the derivative first and bisects each interval between them, so it
/// cannot step over a narrow pair of roots.
pub(super) fn sign_changes(a: &[f64], upper: f64) -> Vec<f64> {
    if a.len() < 2 {
        return Vec::new();
    }
    let mut found = Vec::new();
    let mut last = (0.0, evaluate(a, 0.0));
    for x in sign_changes(&derivative(a), upper).into_iter().chain([upper]) {
        let value = evaluate(a, x);
        if value == 0.0 {
            // An extremum that touches zero does not change the sign.
            continue;
        }
        if last.1 * value.signum() < 0.0 {
            found.push(bisect(a, last.0, x));
        }
        last = (x, value);
    }
    found
}

/// Bisects an interval whose ends have opposite signs. Returns the lower side of the sign change.
fn bisect(a: &[f64], mut low: f64, mut high: f64) -> f64 {
    let sign = evaluate(a, low).signum();
    loop {
        let middle = 0.5 * (low + high);
        if middle <= low || middle >= high {
            return low;
        }
        if evaluate(a, middle) * sign > 0.0 { low = middle } else { high = middle }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn a_double_root_is_no_change_and_a_narrow_pair_is_found() {
        assert!(sign_changes(&[1.0, -2.0, 1.0], 5.0).is_empty());
        let pair = sign_changes(&product(&[-1.0, 1.0], &[-1.0 - 1e-6, 1.0]), 5.0);
        assert_eq!(pair.len(), 2);
        assert!((pair[0] - 1.0).abs() < 1e-9 && (pair[1] - 1.0 - 1e-6).abs() < 1e-9, "{pair:?}");
    }

    proptest! {
        #[test]
        fn simple_roots_are_all_found(mut roots in prop::collection::vec(0.05..4.0f64, 1..6)) {
            roots.sort_by(f64::total_cmp);
            prop_assume!(roots.windows(2).all(|w| w[1] - w[0] > 0.05));
            let a = roots.iter().fold(vec![1.0], |p, &root| product(&p, &[root, -1.0]));
            let found = sign_changes(&a, 5.0);
            prop_assert_eq!(found.len(), roots.len());
            for (f, r) in found.iter().zip(&roots) {
                prop_assert!((f - r).abs() < 1e-7, "{} {}", f, r);
            }
        }
    }
}
