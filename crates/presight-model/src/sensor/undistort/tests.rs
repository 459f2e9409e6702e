use super::*;
use proptest::prelude::*;

fn models() -> impl Strategy<Value = Distortion> {
    let p = -0.01..0.01f64;
    prop_oneof![
        (-0.5..0.5f64, -1.0..1.0f64, p.clone(), p.clone(), -1.5..1.5f64)
            .prop_map(|(k1, k2, p1, p2, k3)| Distortion::PlumbBob([k1, k2, p1, p2, k3])),
        (-0.5..0.5f64, -1.0..1.0f64, -1.0..1.0f64)
            .prop_map(|(k1, k2, k3)| Distortion::PlumbBob([k1, k2, 0.0, 0.0, k3])),
        (-3.0..3.0f64, -3.0..3.0f64, p.clone(), p, -2.0..2.0f64, [-3.0..3.0f64, -3.0..3.0f64, -2.0..2.0f64])
            .prop_map(|(k1, k2, p1, p2, k3, [k4, k5, k6])| rational([k1, k2, p1, p2, k3, k4, k5, k6], [0.0; 6])),
        (
            [-0.5..0.5f64, -1.0..1.0f64, -0.01..0.01f64, -0.01..0.01f64, -1.0..1.0f64],
            [-0.5..0.5f64, -1.0..1.0f64, -1.0..1.0f64],
            [-0.02..0.02f64, -0.02..0.02f64, -0.02..0.02f64, -0.02..0.02f64, -0.2..0.2f64, -0.2..0.2f64],
            any::<bool>(),
        )
            .prop_map(|([k1, k2, p1, p2, k3], [k4, k5, k6], [a, b, c, d, x, y], tilted)| {
                let [x, y] = [x, y].map(|tau| if tilted { tau } else { 0.0 });
                rational([k1, k2, p1, p2, k3, k4, k5, k6], [a, b, c, d, x, y])
            }),
        [-0.1..0.1f64, -0.05..0.05f64, -0.02..0.02f64, -0.005..0.005f64].prop_map(Distortion::Equidistant),
    ]
}

fn rational(k: [f64; 8], more: [f64; 6]) -> Distortion {
    Distortion::from_model("rational_polynomial", &[&k[..], &more].concat()).unwrap()
}

/// The model with an upright image sensor, and the third coordinate of a tilted image point before its division.
fn upright(model: &Distortion) -> (Distortion, impl Fn((f64, f64)) -> f64) {
    let (mut model, mut tau) = (model.clone(), [0.0; 2]);
    if let Distortion::RationalPolynomial(k) = &mut model {
        tau = [k[12], k[13]];
        k[12..].fill(0.0);
    }
    (model, move |(x, y)| tau[1].sin() * x - tau[1].cos() * tau[0].sin() * y + tau[1].cos() * tau[0].cos())
}

/// The formulas of OpenCV's documentation, written independently and without a valid region.
fn textbook(model: &Distortion, p: DVec3) -> (f64, f64) {
    let (x, y) = (p.x / p.z, p.y / p.z);
    let s = x * x + y * y;
    let brown = |k: [f64; 8]| {
        let [k1, k2, p1, p2, k3, k4, k5, k6] = k;
        let f = (1.0 + k1 * s + k2 * s.powi(2) + k3 * s.powi(3)) / (1.0 + k4 * s + k5 * s.powi(2) + k6 * s.powi(3));
        (x * f + 2.0 * p1 * x * y + p2 * (s + 2.0 * x * x), y * f + p1 * (s + 2.0 * y * y) + 2.0 * p2 * x * y)
    };
    match *model {
        Distortion::None => (x, y),
        Distortion::PlumbBob([k1, k2, p1, p2, k3]) => brown([k1, k2, p1, p2, k3, 0.0, 0.0, 0.0]),
        Distortion::RationalPolynomial([k1, k2, p1, p2, k3, k4, k5, k6, s1, s2, s3, s4, tau_x, tau_y]) => {
            let (u, v) = brown([k1, k2, p1, p2, k3, k4, k5, k6]);
            let (u, v) = (u + s1 * s + s2 * s * s, v + s3 * s + s4 * s * s);
            // Rows of OpenCV's matrices, multiplied out.
            let (cx, sx, cy, sy) = (tau_x.cos(), tau_x.sin(), tau_y.cos(), tau_y.sin());
            let turned = [cy * u + sy * sx * v - sy * cx, cx * v + sx, sy * u - cy * sx * v + cy * cx];
            let onto = |of: f64, axis: f64| (cy * cx * of - axis * turned[2]) / turned[2];
            (onto(turned[0], -sy * cx), onto(turned[1], sx))
        }
        Distortion::Equidistant([k1, k2, k3, k4]) => {
            let t = p.x.hypot(p.y).atan2(p.z);
            let td = t * (1.0 + k1 * t.powi(2) + k2 * t.powi(4) + k3 * t.powi(6) + k4 * t.powi(8));
            let r = p.x.hypot(p.y);
            if r == 0.0 { (0.0, 0.0) } else { (td * p.x / r, td * p.y / r) }
        }
    }
}

/// The radius (angle for fisheyes) at which the image point first stops moving outwards, found by small steps.
fn fold_by_steps(model: &Distortion, direction: f64, end: f64) -> f64 {
    let model = &upright(model).0;
    let ray = |r: f64| match model {
        Distortion::Equidistant(_) => DVec3::new(r.sin() * direction.cos(), r.sin() * direction.sin(), r.cos()),
        _ => DVec3::new(r * direction.cos(), r * direction.sin(), 1.0),
    };
    let n = 20_000;
    let mut last = 0.0;
    for i in 1..=n {
        let r = end * f64::from(i) / f64::from(n);
        let (x, y) = textbook(model, ray(r));
        let along = x * direction.cos() + y * direction.sin();
        if !(along > last) || along > last + 1e3 {
            return r;
        }
        last = along;
    }
    end
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(512))]

    #[test]
    fn what_is_undistorted_is_distorted_back(model in models(), x in -1.5..1.5f64, y in -1.5..1.5f64) {
        let lens = model.lens();
        if let Some(ray) = lens.undistort(x, y) {
            let (xd, yd) = textbook(&model, ray);
            prop_assert!((xd - x).hypot(yd - y) < 1e-12, "{} {}", xd, yd);
            let (xd, yd) = lens.distort(ray).unwrap();
            prop_assert!((xd - x).hypot(yd - y) < 1e-12, "{} {}", xd, yd);
        }
    }

    #[test]
    fn rays_before_the_fold_come_back(model in models(), direction in -3.2..3.2f64, t in 0.0..0.98f64) {
        let fisheye = matches!(model, Distortion::Equidistant(_));
        // A tangential term bends the path outwards, so stay further away from the fold.
        let r = t * fold_by_steps(&model, direction, if fisheye { std::f64::consts::PI } else { 2.0 })
            * if model.coefficients().len() > 4 { 0.9 } else { 1.0 };
        let ray = if fisheye {
            DVec3::new(r.sin() * direction.cos(), r.sin() * direction.sin(), r.cos())
        } else {
            DVec3::new(r * direction.cos(), r * direction.sin(), 1.0)
        };
        let lens = model.lens();
        let (plain, depth) = upright(&model);
        let Some((xd, yd)) = lens.distort(ray) else {
            prop_assume!(depth(textbook(&plain, ray)) > 0.0);
            return Err(TestCaseError::fail(format!("{r} is not imaged")));
        };
        let back = lens.undistort(xd, yd).map(DVec3::normalize);
        prop_assert!(back.is_some_and(|b| b.distance(ray.normalize()) < 1e-9), "{:?} {:?}", back, ray.normalize());
    }

    #[test]
    fn nothing_comes_from_beyond_the_fold(model in models(), direction in -3.2..3.2f64, xd in -3.0..3.0f64) {
        let lens = model.lens();
        let (x, y) = (xd * direction.cos(), xd * direction.sin());
        if let Some(ray) = lens.undistort(x, y) {
            let fisheye = matches!(model, Distortion::Equidistant(_));
            let r = if fisheye { ray.x.hypot(ray.y).atan2(ray.z) } else { ray.x.hypot(ray.y) };
            let end = if fisheye { std::f64::consts::PI } else { 1.1 * r };
            let fold = fold_by_steps(&model, ray.y.atan2(ray.x), end);
            prop_assert!(r <= fold * 1.001 + 1e-3 * end, "{} beyond {}", r, fold);
        }
    }
}

/// Neighbouring image points have neighbouring rays across the whole region, and it has no holes.
#[test]
fn the_inverse_is_continuous_and_its_region_has_no_holes() {
    let barrel = Distortion::PlumbBob([-0.28340811, 0.07395907, 0.00019359, 1.76187114e-05, 0.0]);
    let strong = Distortion::PlumbBob([-0.4, 0.05, 0.01, -0.008, 0.0]);
    let fisheye = Distortion::Equidistant([0.0034823894, 0.000715034845, -0.002053236, 0.000202936735]);
    for model in [barrel, strong, fisheye] {
        let lens = model.lens();
        for k in 0..72 {
            let (sin, cos) = f64::from(k * 5).to_radians().sin_cos();
            let mut last = DVec3::Z;
            let mut ended = false;
            for i in 0..2000 {
                let r = f64::from(i) * 0.001;
                match lens.undistort(r * cos, r * sin).map(DVec3::normalize) {
                    Some(ray) => {
                        assert!(!ended, "{model:?}: a hole before {r} at {k}");
                        // Near the fold the step grows like a square root.
                        assert!(ray.angle_between(last) < 0.08, "{model:?}: a jump at {r}, {k}");
                        last = ray;
                    }
                    None => ended = true,
                }
            }
        }
    }
}

proptest! {
    /// Newton's method needs the derivative; compared with differences of the textbook's formula.
    #[test]
    fn the_derivative_is_that_of_the_formula(model in models(), x in -0.4..0.4f64, y in -0.4..0.4f64) {
        let (plain, _) = upright(&model);
        let Kind::Brown(brown, None) = plain.lens().0 else { return Ok(()) };
        prop_assume!(brown.pole > 0.7);
        let at = |x, y| DVec2::from(textbook(&plain, DVec3::new(x, y, 1.0)));
        let (j, step) = (brown.jacobian(DVec2::new(x, y)), 1e-5);
        let by_x = (at(x + step, y) - at(x - step, y)) / (2.0 * step);
        let by_y = (at(x, y + step) - at(x, y - step)) / (2.0 * step);
        let size = 1.0 + j.x_axis.length() + j.y_axis.length();
        prop_assert!(j.x_axis.distance(by_x) + j.y_axis.distance(by_y) < 1e-5 * size, "{} {} {}", j, by_x, by_y);
    }
}

/// With s1 alone the image of (x, 0) is x + s1 x^2, which turns back at x = -1 / (2 s1).
#[test]
fn thin_prism_terms_fold_where_they_do_by_hand() {
    let lens = rational([0.0; 8], [-0.25, 0.0, 0.0, 0.0, 0.0, 0.0]).lens();
    assert_eq!(lens.distort(DVec3::new(1.0, 0.0, 1.0)), Some((0.75, 0.0)));
    assert!((lens.undistort(0.75, 0.0).unwrap().x - 1.0).abs() < 1e-12);
    assert!(lens.undistort(1.0 - 1e-6, 0.0).is_some_and(|ray| (ray.x - 1.998).abs() < 1e-9));
    assert!(lens.undistort(1.0 + 1e-6, 0.0).is_none());
    assert!(lens.distort(DVec3::new(2.1, 0.0, 1.0)).is_none());
    assert!(lens.distort(DVec3::new(-9.0, 0.0, 1.0)).is_some(), "on the other side it never folds");
}

/// With tauY alone the image of (x, y) is (x, cos(tauY) y) / (sin(tauY) x + cos(tauY)), multiplied out by hand. Nothing
/// is imaged from x = -cot(tauY) on.
#[test]
fn a_tilted_sensor_sees_up_to_its_own_plane() {
    let tau = 1.5f64;
    let lens = rational([0.0; 8], [0.0, 0.0, 0.0, 0.0, 0.0, tau]).lens();
    assert_eq!(lens.distort(DVec3::Z), Some((0.0, 0.0)));
    let edge = -1.0 / tau.tan();
    assert!(lens.distort(DVec3::new(edge - 1e-9, 0.0, 1.0)).is_none());
    let (u, v) = lens.distort(DVec3::new(0.5, 0.5, 1.0)).unwrap();
    let third = 0.5 * tau.sin() + tau.cos();
    assert!((u - 0.5 / third).abs() < 1e-14 && (v - 0.5 * tau.cos() / third).abs() < 1e-14, "{u} {v}");
    let back = lens.undistort(u, v).unwrap();
    assert!((back - DVec3::new(0.5, 0.5, 1.0)).length() < 1e-13, "{back}");
    assert!(lens.undistort(1e300, 0.0).is_none_or(|ray| ray.is_finite()));
}

/// The fold of this polynomial lies nearer than the first search step; results must still be finite.
#[test]
fn a_fold_nearer_than_the_first_step_is_found() {
    let lens = Distortion::PlumbBob([-0.25, 0.07, 1e9, -0.002, 0.0]).lens();
    assert!([0.0, 1e-9, 0.5].into_iter().all(|x| lens.undistort(x, -x).is_none_or(|ray| ray.is_finite())));
}

#[test]
fn fold_over_is_no_ray() {
    // r (1 - 0.3 r^2) rises to 0.70272.. at r = 1.0540925.. and falls to zero at 1.8257..
    let fold = Distortion::PlumbBob([-0.3, 0.0, 0.0, 0.0, 0.0]);
    let lens = fold.lens();
    let top = (1.0f64 / 0.9).sqrt();
    let highest = top * (1.0 - 0.3 * top * top);
    assert!(lens.undistort(highest - 1e-12, 0.0).is_some());
    assert!(lens.undistort(highest + 1e-12, 0.0).is_none());
    assert!(lens.undistort(0.0, -5.0).is_none());
    assert!(lens.distort(DVec3::new(1.7, 0.0, 1.0)).is_none(), "this point falls back to 0.2261 from beyond");
    assert!(lens.undistort(0.2261, 0.0).unwrap().x < 0.3);

    // A pole: 1 - 4 r^2 in the denominator.
    let pole = rational([0.0, 0.0, 0.0, 0.0, 0.0, -4.0, 0.0, 0.0], [0.0; 6]).lens();
    assert!(pole.distort(DVec3::new(0.6, 0.0, 1.0)).is_none());
    let ray = pole.undistort(100.0, 0.0).unwrap();
    assert!(ray.x < 0.5 && ray.x > 0.49);

    let fisheye = Distortion::Equidistant([-0.1, 0.0, 0.0, 0.0]).lens();
    let top = (1.0f64 / 0.3).sqrt();
    assert!(fisheye.undistort(top * (1.0 - 0.1 * top * top) + 1e-12, 0.0).is_none());
    let wide = Distortion::Equidistant([0.0; 4]).lens();
    let back = wide.undistort(0.0, 2.5).unwrap();
    assert!(back.z < -0.8 && back.y > 0.0, "143 degrees off the axis: {back}");
    assert!(wide.undistort(0.0, 3.2).is_none());
    assert!(lens.undistort(f64::NAN, 0.0).is_none());
}

/// Planted fault: a forward map that ignores its fold reaches the same image point twice.
#[test]
fn the_fold_by_steps_is_a_fold() {
    let fold = Distortion::PlumbBob([-0.3, 0.0, 0.0, 0.0, 0.0]);
    assert!((fold_by_steps(&fold, 0.7, 2.0) - (1.0f64 / 0.9).sqrt()).abs() < 2e-4);
}
