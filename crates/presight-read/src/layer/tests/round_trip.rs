//! Written layers read back bit for bit.

use super::super::{parse, read, to_string, write};
use super::{DMat3, DVec3};
use presight_model::environment::{Existence, Feature, FeatureLayer, FeatureShape, Properties};
use presight_model::error::ErrorKind;
use presight_model::geometry::PoseCovariance;
use proptest::prelude::*;

/// Any finite f64 of a sensible size, including denormals and negative zero.
fn number() -> impl Strategy<Value = f64> {
    prop_oneof![
        4 => any::<f64>().prop_filter_map("out of range", |x| (x.abs() <= 1e12).then_some(x)),
        4 => -1e3..1e3f64,
        1 => Just(-0.0),
        1 => Just(4469320.123456789),
        1 => Just(f64::MIN_POSITIVE / 3.0),
    ]
}

fn point() -> impl Strategy<Value = DVec3> {
    [number(), number(), number()].prop_map(DVec3::from_array)
}

/// A factor L of a covariance L L^T of any rank.
fn factor() -> impl Strategy<Value = DMat3> {
    let column = (-1.0..1.0f64, -1.0..1.0f64, -1.0..1.0f64, -9.0..3.0f64, any::<bool>())
        .prop_map(|(x, y, z, power, zero)| DVec3::new(x, y, z) * if zero { 0.0 } else { 10f64.powf(power) });
    [column.clone(), column.clone(), column].prop_map(|[x, y, z]| DMat3::from_cols(x, y, z))
}

fn symmetric(factor: DMat3) -> DMat3 {
    let m = factor * factor.transpose();
    // Mirrors one triangle, because the two triangles of the product differ by rounding.
    DMat3::from_cols(
        m.x_axis,
        DVec3::new(m.x_axis.y, m.y_axis.y, m.y_axis.z),
        DVec3::new(m.x_axis.z, m.y_axis.z, m.z_axis.z),
    )
}

fn shape() -> impl Strategy<Value = FeatureShape> {
    let covariance = || factor().prop_map(symmetric);
    let square = (-1e3..1e3f64, -1e3..1e3f64, 1e-3..10.0f64, -3.1..3.1f64).prop_map(|(x, y, side, yaw)| {
        let (at, right) = (DVec3::new(x, y, 1.0), side * DVec3::new(yaw.cos(), yaw.sin(), 0.0));
        let down = DVec3::new(0.0, 0.0, -side);
        [at, at + right, at + right + down, at + down]
    });
    let flat =
        (prop::collection::btree_set(0u32..720, 3..12), -1e3..1e3f64, 0.1..10.0f64).prop_map(|(angles, z, radius)| {
            let corner = |a: &u32| {
                let angle = f64::from(*a).to_radians() / 2.0;
                DVec3::new(radius * angle.cos(), radius * angle.sin(), z)
            };
            angles.iter().map(corner).collect::<Vec<_>>()
        });
    prop_oneof![
        (point(), covariance()).prop_map(|(at, covariance)| FeatureShape::Point { at, covariance }),
        (point(), covariance()).prop_map(|(at, covariance)| FeatureShape::Reflector { at, covariance }),
        (point(), point(), factor(), factor(), any::<bool>(), any::<bool>()).prop_filter_map(
            "no length",
            |(a, b, first, second, alike, crossed)| {
                let second = if alike { first } else { second };
                let cross = if crossed { first * second.transpose() } else { DMat3::ZERO };
                let covariances = [symmetric(first), symmetric(second)];
                (a != b).then_some(FeatureShape::Segment { ends: [a, b], covariances, cross })
            }
        ),
        (flat, covariance()).prop_map(|(corners, covariance)| FeatureShape::Patch { corners, covariance }),
        (square, covariance(), 0u32..587).prop_map(|(corners, covariance, code)| FeatureShape::Fiducial {
            corners,
            covariance,
            family: "DICT_APRILTAG_36h11".into(),
            code,
        }),
    ]
}

fn feature() -> impl Strategy<Value = Feature> {
    let share = || prop::option::of(0.0..=1.0f64);
    let normal = prop::option::of((-1.0..1.0f64, -3.1..3.1f64).prop_map(|(z, a): (f64, f64)| {
        let r = (1.0 - z * z).sqrt();
        DVec3::new(r * a.cos(), r * a.sin(), z).normalize()
    }));
    let text = || prop::option::of("\\PC{0,12}|[\"\\\\\\n\\t]{1,3}");
    let existence = (0.0..=1.0f64, number(), 0.0..1.0f64, any::<bool>()).prop_map(|(p0, confirmed, rate, plain)| {
        if plain { Existence::default() } else { Existence { p0, confirmed, rate } }
    });
    (text(), text(), shape(), existence, share(), share(), normal).prop_map(
        |(name, object, shape, existence, strength, contrast, normal)| {
            // The normal of a patch or fiducial must agree with its corners.
            let surface = matches!(shape, FeatureShape::Patch { .. } | FeatureShape::Fiducial { .. });
            let properties = Properties { strength, contrast, normal: normal.filter(|_| !surface) };
            Feature { id: 1, name, object, shape, existence, properties }
        },
    )
}

/// A text that distinguishes -0 from 0, which `==` does not.
fn bits(layer: &FeatureLayer) -> String {
    format!("{layer:?}")
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(256))]

    #[test]
    fn layers_read_back_bit_for_bit(
        features in prop::collection::vec((feature(), 1u32..1000), 0..6),
        poses in prop::collection::btree_map("\\PC{0,12}", prop::collection::vec(-1e-3..1e-3f64, 6), 0..3),
        tolerance in 1e-9..1.0f64,
    ) {
        let mut id = 0;
        let features = features.into_iter().map(|(mut f, step)| {
            id += step;
            f.id = id;
            f
        });
        let pose_covariances = poses.into_iter().map(|(path, v)| {
            let entry = |i: usize, j: usize| v[i] * v[j];
            (path, PoseCovariance::from_rows(std::array::from_fn(|i| std::array::from_fn(|j| entry(i, j)))))
        });
        let layer = FeatureLayer {
            class: "video".into(),
            tolerance,
            features: features.map(Into::into).collect(),
            // Not sorted: writing must keep the order of the layer.
            pose_covariances: pose_covariances.rev().collect(),
        };
        let text = to_string(&layer).unwrap();
        let again = parse(&text).unwrap_or_else(|e| panic!("{e}\n{text}"));
        prop_assert!(again.removed.is_empty());
        prop_assert_eq!(bits(&again.layer), bits(&layer));
        prop_assert_eq!(to_string(&again.layer).unwrap(), text);
    }
}

#[test]
fn a_layer_that_could_not_be_read_is_not_written() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("l.json");
    let point = |id: u32, x: f64| Feature {
        id,
        name: None,
        object: None,
        shape: FeatureShape::Point { at: DVec3::new(x, 0.0, 0.0), covariance: DMat3::ZERO },
        existence: Existence::default(),
        properties: Properties::default(),
    };
    let layer = |features: Vec<Feature>| {
        let features = features.into_iter().map(Into::into).collect();
        FeatureLayer { class: "video".into(), tolerance: 1e-3, features, ..FeatureLayer::default() }
    };
    let good = layer(vec![point(1, 1.0), point(2, 2.0)]);
    write(&path, &good).unwrap();
    assert_eq!(read(&path).unwrap().layer, good);
    let kept = std::fs::read(&path).unwrap();
    for bad in [vec![point(1, f64::NAN)], vec![point(2, 1.0), point(1, 1.0)], vec![point(1, 0.0), point(1, 0.0)]] {
        assert_eq!(write(&path, &layer(bad)).unwrap_err().kind(), ErrorKind::Invalid);
    }
    let twice = FeatureLayer { pose_covariances: vec![("a".into(), PoseCovariance::ZERO); 2], ..good };
    assert!(write(&path, &twice).unwrap_err().to_string().contains("given twice"));
    assert_eq!(std::fs::read(&path).unwrap(), kept);
}
