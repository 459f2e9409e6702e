use super::*;
use crate::sensor::SensorSpec;
use glam::DVec3;

fn camera() -> Sensor {
    let camera = Camera::pinhole(6, 4, 5.0, 4.0, 2.5, 1.5);
    Sensor::new(SensorSpec::new("c", "laser", Geometry::Camera(camera))).unwrap()
}

fn scanner(columns: u32, rows: u32) -> Sensor {
    let uniform = |step_deg, count| Angles::Uniform { start_deg: -10.0, step_deg, count };
    let geometry = Scanner { azimuth: uniform(0.25, columns), elevation: uniform(0.5, rows), beam_height_deg: None };
    Sensor::new(SensorSpec::new("s", "laser", Geometry::Scanner(geometry))).unwrap()
}

#[test]
fn depth_is_told_as_range() {
    let frame = Frame::new(1.0, camera(), Measurement::DepthZ(vec![2.0; 24])).unwrap();
    // Pixel (0, 0) looks along (-0.5, -0.375, 1).
    let length = DVec3::new(-0.5, -0.375, 1.0).length();
    assert!((f64::from(frame.ranges()[0]) - 2.0 * length).abs() < 1e-6);
    assert!(Frame::new(0.0, scanner(361, 1), Measurement::DepthZ(vec![1.0; 361])).is_err());
}

/// REP-117 and sensor_msgs/LaserScan: a finite value outside of the limits is discarded, an infinite one has a meaning.
#[test]
fn what_is_no_measurement_is_nan() {
    let spec = camera().spec().clone().with_limits(0.1, 16.0);
    let with = |value: f32| {
        let mut values = vec![1.0; 24];
        values[9] = value;
        Frame::new(0.0, Sensor::new(spec.clone()).unwrap(), Measurement::Range(values)).unwrap()
    };
    for kept in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY, 0.1, 16.0, 2.5] {
        assert_eq!(with(kept).ranges()[9].to_bits(), kept.to_bits());
    }
    for none in [0.0, -0.0, -0.5, 0.099, 16.01, 65.533, f32::MAX] {
        assert!(with(none).ranges()[9].is_nan() && with(none).measurement().values()[9] == none, "{none}");
    }
    // The limits hold for the range, not for the depth: 12 m of depth in the corner are 14.2 m of range.
    let depth = |z: f32| Frame::new(0.0, Sensor::new(spec.clone()).unwrap(), Measurement::DepthZ(vec![z; 24])).unwrap();
    assert!((depth(12.0).ranges()[0] - 14.151).abs() < 1e-3 && depth(14.0).ranges()[0].is_nan());
    assert!(depth(14.0).ranges()[9].is_finite(), "the same depth ahead");
    assert!(Frame::new(f64::NAN, camera(), Measurement::Range(vec![1.0; 24])).is_err());
    assert!(Frame::new(0.0, camera(), Measurement::Range(vec![1.0; 23])).is_err());
}

/// For every geometry, each selected pixel keeps its ray and its value.
#[test]
fn thinned_pixels_keep_their_rays() {
    let table: Vec<DVec3> =
        (0..77).map(|i| DVec3::new(1.0, 0.01 * f64::from(i % 11), 0.02 * f64::from(i / 11))).collect();
    let table = Geometry::Rays(RayTable::new(11, 7, table).unwrap());
    let table = Sensor::new(SensorSpec::new("t", "laser", table)).unwrap();
    for sensor in [camera(), table, scanner(361, 1), scanner(321, 41)] {
        let (width, height) = (sensor.width(), sensor.height());
        let values: Vec<f32> = (0..width * height).map(|i| 1.0 + i as f32).collect();
        let frame = Frame::new(0.0, sensor.clone(), Measurement::Range(values)).unwrap();
        for stride in [1, 2, 3, 5] {
            let thin = frame.thinned(stride).unwrap();
            let (w, h) = (thin.sensor().width(), thin.sensor().height());
            assert_eq!((w, h), ((width / stride).max(1), (height / stride).max(1)));
            for (i, value) in thin.ranges().iter().enumerate() {
                let whole = (*value - 1.0) as u32;
                let a = sensor.ray(whole % width, whole / width).unwrap();
                let b = thin.sensor().ray(i as u32 % w, i as u32 / w).unwrap();
                assert!(a.distance(b) < 1e-12, "{}: {stride} {i}", sensor.spec().name);
            }
        }
        assert!(frame.thinned(0).is_err());
    }
}

/// Stated noise of 1 mm plus 2 mm per square metre: 9 mm at 2 m. A camera that states none gets 1 cm everywhere.
#[test]
fn noise_grows_as_stated() {
    let mut spec = camera().spec().clone();
    let sigma = |spec: &SensorSpec, range: f64| RangeNoise::of(&Sensor::new(spec.clone()).unwrap()).range_sigma(range);
    assert_eq!([sigma(&spec, 1.0), sigma(&spec, 4.0)], [0.01, 0.01]);
    (spec.noise.range_sigma, spec.noise.range_sigma_quadratic) = (0.001, 0.002);
    assert!((sigma(&spec, 2.0) - 0.009).abs() < 1e-15);
    spec.noise.range_sigma = 0.0;
    assert!((sigma(&spec, 2.0) - 0.008).abs() < 1e-15, "stated, if only in part");
}

#[test]
fn intensities_have_the_pixels_of_the_ranges() {
    let frame = || Frame::new(0.0, camera(), Measurement::Range(vec![1.0; 24])).unwrap();
    let with = |value: f32| {
        let mut values = vec![0.3; 24];
        values[9] = value;
        frame().with_intensities(GreyImage::new(6, 4, values)?)
    };
    for value in [0.0, 1.0, f32::NAN] {
        let kept = with(value).unwrap();
        let told = kept.intensities().unwrap().values()[9];
        assert!(told == value || told.is_nan() && value.is_nan());
    }
    for value in [-0.01, 1.01, 255.0, f32::INFINITY] {
        let e = with(value).unwrap_err();
        assert!(e.kind() == crate::ErrorKind::Invalid && !e.remedy().is_empty(), "{e}");
    }
    let other = frame().with_intensities(GreyImage::new(4, 6, vec![0.3; 24]).unwrap()).unwrap_err();
    assert!(other.to_string().contains("4 x 6"), "{other}");
    let image = || GreyImage::new(6, 4, vec![0.3; 24]).unwrap();
    let grey = Frame::new(0.0, camera(), Measurement::Grey(image())).unwrap();
    assert!(grey.with_intensities(image()).is_err());
}
