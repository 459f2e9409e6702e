use super::*;
use glam::DVec3;
use presight_model::error::ErrorKind;
use presight_model::geometry::Pose;
use presight_model::sensor::{Angles, Camera, Distortion, Mixture, Noise, RayTable, RayTimes, Scanner, StampAt};
use presight_model::sensor::{PRESETS, Sensor};
use proptest::prelude::*;

const SCANNER: &str = "format = 1
kind = \"scanner\"
range_max = 10

[azimuth]
start_deg = -90
step_deg = 0.5
count = 361

[elevation]
angles_deg = [-1.0, 3.0, 2.0]

[mount]
xyz = [1.0, 2.0, 3.0]
rpy_deg = [0.0, 0.0, 90.0]

[noise]
range_sigma = 0.01
angle_sigma_deg = 0.1
";

const CAMERA: &str = "format = 1
kind = \"camera\"
width = 640
height = 480
fx = 500
fy = 500
cx = 319.5
cy = 239.5
max_incidence_deg = 80
[distortion]
model = \"kannala_brandt\"
coefficients = [0.1, 0, 0, 0]
";

const BEAMS: &str = "format = 2
kind = \"scanner\"
range_max = 10
[azimuth]
start_deg = 0
step_deg = -5
count = 72
[beams]
elevations_deg = [15.0, 0.0, -15.0]
azimuth_offsets_deg = [1.5, 0.0, -1.5]
origins = [[0.02, 0.0, 0.01]]
range_lead = 0.02
time_offsets_s = [0.0, 0.001, 0.002]
shifts = [0, 4, 8]
destaggered = true
columns = [3, 60]
body_from_head = { xyz = [0.0, 0.0, 0.036], rpy_deg = [0.0, 0.0, 180.0] }
[timing]
turn_s = 0.1
stamp = \"last\"
";

const RAYS: &str = "format = 2
kind = \"rays\"
width = 2
height = 1
directions = [[1, 0, 0], [0, 1, 0]]
origins = [[0.0, 0.0, 0.0], [0.0, 0.0, 0.1]]
[timing]
times_s = [0.0, 0.1]
";

#[test]
fn every_key_of_format_2_arrives() {
    let s = parse(BEAMS, "lidar", None).unwrap();
    let Geometry::Rays(table) = &s.geometry else { panic!("no rays") };
    let beams = table.beams().unwrap();
    assert_eq!((beams.turn_s, beams.stamp, beams.is_destaggered), (0.1, StampAt::Last, true));
    assert_eq!((beams.origins.len(), beams.range_lead, beams.columns), (1, 0.02, Some([3, 60])));
    assert_eq!(s.times, beams.times());
    assert!((beams.body_from_head.transform_point(DVec3::X) - DVec3::new(-1.0, 0.0, 0.036)).length() < 1e-15);
    // The file stays a table of beams, and one of rays with times once they are no longer its own.
    let text = to_string(&s);
    assert!(text.len() < 1000 && text.contains("[beams]"), "{text}");
    assert_eq!(parse(&text, "", None).unwrap(), s);
    let other = s.clone().with_times(RayTimes::turning(0.2, StampAt::First));
    assert!(!to_string(&other).contains("[beams]"));
    assert_eq!(parse(&to_string(&other), "", None).unwrap(), other);

    let rays = parse(RAYS, "rays", None).unwrap();
    assert_eq!(rays.times, RayTimes::Listed(vec![0.0, 0.1].into()));
    assert_eq!(parse(&to_string(&rays), "", None).unwrap(), rays);
    let camera = CAMERA.replace("format = 1", "format = 2") + "[timing]\nreadout_s = 0.03\nstamp = \"middle\"\n";
    let camera = parse(&camera, "eye", None).unwrap();
    assert_eq!(camera.times, RayTimes::Rows { readout_s: 0.03, stamp: StampAt::Middle });
    assert_eq!(parse(&to_string(&camera), "", None).unwrap(), camera);
    let first = SCANNER.replace("range_max = 10", "turn_s = -0.1\nstamp = \"middle\"");
    let first = parse(&first, "s", None).unwrap();
    assert_eq!(first.times, RayTimes::Columns { turn_s: -0.1, stamp: StampAt::Middle });
    assert!(to_string(&first).starts_with("format = 1"));
    assert_eq!(parse(&to_string(&first), "", None).unwrap(), first);
}

/// By hand: in a frame of eight rays that swings twice, ray 1 has swung up by half and turned by 45 degrees.
#[test]
fn a_pattern_turns_while_it_swings() {
    let text = "format = 2\nkind = \"rays\"\nwidth = 8\nheight = 1\n[pattern]\nduration_s = 0.8\nturns = 1.0\n\
        swings = 2.0\nelevation_deg = [-30.0, 90.0]\n";
    let spec = parse(text, "p", None).unwrap();
    let Geometry::Rays(table) = &spec.geometry else { panic!("no rays") };
    let (x, z) = (30f64.to_radians().cos() * 0.5f64.sqrt(), 0.5);
    assert!(table.directions()[1].distance(DVec3::new(x, x, z)) < 1e-15, "{}", table.directions()[1]);
    assert!(table.directions()[2].distance(DVec3::Z) < 1e-15);
    assert_eq!(spec.times, RayTimes::Listed((0..8).map(|i| (0.8 * f64::from(i) / 8.0) as f32).collect()));
}

#[test]
fn every_key_arrives() {
    let s = parse(SCANNER, "front", None).unwrap();
    assert_eq!((s.name.as_str(), s.class.as_str(), s.range_min, s.range_max), ("front", "laser", 0.0, 10.0));
    let Geometry::Scanner(scanner) = &s.geometry else { panic!("no scanner") };
    assert_eq!(scanner.azimuth, Angles::Uniform { start_deg: -90.0, step_deg: 0.5, count: 361 });
    assert_eq!(scanner.rows_deg(), [3.0, 2.0, -1.0]);
    assert!((s.mount.transform_point(DVec3::X) - DVec3::new(1.0, 3.0, 3.0)).length() < 1e-15);
    assert_eq!((s.noise.range_sigma, s.noise.angle_sigma), (0.01, 0.1f64.to_radians()));

    let c = parse(CAMERA, "eye", None).unwrap();
    assert_eq!((c.class.as_str(), c.range_max, c.max_incidence), ("video", f64::INFINITY, Some(80f64.to_radians())));
    let Geometry::Camera(camera) = &c.geometry else { panic!("no camera") };
    assert_eq!(camera.distortion, Distortion::Equidistant([0.1, 0.0, 0.0, 0.0]));
}

#[test]
fn ray_tables_come_from_the_text_or_from_a_file_beside_it() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("r.csv"), "# x,y,z\n1,0,0\n nan, nan,nan \n\n0,2,0\n0,0,-1e3\n").unwrap();
    let head = "format = 1\nkind = \"rays\"\nwidth = 2\nheight = 2\n";
    let of_file = parse(&format!("{head}file = \"r.csv\""), "r", Some(folder.path())).unwrap();
    let inline = "directions = [[1, 0, 0], [nan, nan, nan], [0.0, 2, 0], [0, 0, -1000]]";
    assert_eq!(of_file, parse(&format!("{head}{inline}"), "r", None).unwrap());
    let Geometry::Rays(table) = &of_file.geometry else { panic!("no rays") };
    assert_eq!((table.directions()[2], table.directions()[3]), (DVec3::Y, DVec3::NEG_Z));
    assert!(table.directions()[1].is_nan());

    std::fs::write(folder.path().join("bad.csv"), "1,0,0\n1,0\n").unwrap();
    let e = parse(&format!("{head}file = \"bad.csv\""), "r", Some(folder.path())).unwrap_err();
    assert!(e.file().is_some_and(|f| f.ends_with("bad.csv")) && e.place() == Some("line 2"), "{e}");
    assert!(parse(&format!("{head}directions = [[1, 0, 0]]"), "r", None).is_err(), "one direction for four pixels");
    assert!(parse(head, "r", None).is_err());
    let missing = parse(&format!("{head}file = \"none.csv\""), "r", Some(folder.path())).unwrap_err();
    assert_eq!(missing.kind(), ErrorKind::Invalid);
}

/// One fault per case: text, part to replace, its replacement, and a part of the expected message.
#[test]
fn faults_are_refused_with_place_and_remedy() {
    let cases = [
        (SCANNER, "format = 1", "format = 3", "newer"),
        (SCANNER, "format = 1", "", "format = 1"),
        (SCANNER, "\"scanner\"", "\"scaner\"", "scaner"),
        (SCANNER, "kind = \"scanner\"", "", "kind is missing"),
        (SCANNER, "range_max", "rang_max", "line 3"),
        (SCANNER, "start_deg = -90", "start_deg = \"left\"", "line 6"),
        (SCANNER, "count = 361", "count = -1", "line 8"),
        (SCANNER, "count = 361", "count = 0", "0 x 3"),
        (SCANNER, "count = 361", "count = 100000", "100000 x 3"),
        (SCANNER, "count = 361", "count = 722", "goes round at most once"),
        (SCANNER, "step_deg = 0.5\n", "", "[azimuth]"),
        (SCANNER, "-90", "nan", "finite"),
        (SCANNER, "[-1.0, 3.0, 2.0]", "[2.0, 3.0, 2.0]", "twice"),
        (SCANNER, "[-1.0, 3.0, 2.0]", "[90.1]", "-90..=90"),
        (SCANNER, "[-1.0, 3.0, 2.0]", "[]", "361 x 0"),
        (SCANNER, "range_max = 10", "range_max = nan", "range limits"),
        (SCANNER, "range_max = 10", "range_min = 11.0\nrange_max = 10", "range limits"),
        (SCANNER, "range_max = 10", "fx = 10", "line 3"),
        (SCANNER, "range_max = 10", "beam_height_deg = -1.0", "beam_height"),
        (SCANNER, "[1.0, 2.0, 3.0]", "[1.0, inf, 3.0]", "[mount]"),
        (SCANNER, "rpy_deg = [0.0, 0.0, 90.0]", "quaternion = [0.0, 0.0, 0.0, 0.0]", "[mount]"),
        (SCANNER, "rpy_deg = [0.0, 0.0, 90.0]", "quaternion = [1e200, 0.0, 0.0, 0.0]", "[mount]"),
        (SCANNER, "rpy_deg = [0.0, 0.0, 90.0]", "rpy_deg = [0.0, 0.0, inf]", "[mount]"),
        (SCANNER, "rpy_deg", "quaternion = [0.0, 0.0, 0.0, 1.0]\nrpy_deg", "[mount]"),
        (SCANNER, "range_sigma = 0.01", "range_sigma = -1.0", "noise"),
        (SCANNER, "range_sigma = 0.01", "stamp_sigma_s = -1.0", "noise"),
        (SCANNER, "range_max = 10", "turn_s = 61", "turn_s"),
        (SCANNER, "range_max = 10", "turn_s = nan", "turn_s"),
        (SCANNER, "range_max = 10", "stamp = \"end\"", "line 3"),
        (SCANNER, "[noise]", "[timing]\nturn_s = 0.1\n[noise]", "[timing]: format 1"),
        (BEAMS, "format = 2", "format = 1", "[beams]: format 1"),
        (BEAMS, "range_max = 10", "turn_s = 0.1", "keys of format 1"),
        (BEAMS, "range_max = 10", "beam_height_deg = 1.0", "either [elevation] or [beams]"),
        (BEAMS, "[timing]", "[elevation]\nangles_deg = [1.0]\n[timing]", "either [elevation] or [beams]"),
        (BEAMS, "[1.5, 0.0, -1.5]", "[1.5, 0.0]", "[beams]: azimuth_offsets_deg: 2 values for 3 beams"),
        (BEAMS, "[15.0, 0.0, -15.0]", "[15000.0, 0.0, -15.0]", "[beams]: elevations_deg"),
        (BEAMS, "[[0.02, 0.0, 0.01]]", "[[0.02, 0.0, 12.0]]", "[beams]: origins"),
        (BEAMS, "[[0.02, 0.0, 0.01]]", "[[0.02, 0.0, nan]]", "[beams]: origins"),
        (BEAMS, "shifts = [0, 4, 8]", "shifts = [0, 0, 0]", "[beams]: shifts: a destaggered image"),
        (BEAMS, "columns = [3, 60]", "columns = [3, 72]", "[beams]: columns"),
        (BEAMS, "turn_s = 0.1", "turn_s = 61", "turn_s"),
        (BEAMS, "turn_s = 0.1", "readout_s = 0.1", "[timing]: beams turn by columns"),
        (BEAMS, "turn_s = 0.1", "turn_s = \"0.1\"", "line 1"),
        (RAYS, "times_s = [0.0, 0.1]", "times_s = [0.0]", "1 times for 2 x 1"),
        (RAYS, "times_s = [0.0, 0.1]", "times_s = [0.0, nan]", "ray 1"),
        (RAYS, "times_s = [0.0, 0.1]", "times_s = [0.0, 0.1]\nturn_s = 0.1", "[timing]: not one way"),
        (RAYS, "times_s = [0.0, 0.1]", "stamp = \"last\"", "[timing]: not one way"),
        (RAYS, "[0.0, 0.0, 0.1]", "[0.0, 0.0, 2.1]", "origins: ray 1"),
        (RAYS, "format = 2", "format = 1", "origins: format 1"),
        (
            RAYS,
            "[timing]\ntimes_s = [0.0, 0.1]",
            "[pattern]\nduration_s = 1.0\nturns = 1.0\nswings = 1.0\nelevation_deg = [0.0, 1.0]",
            "directions, file or [pattern]",
        ),
        (CAMERA, "width = 640", "width = 0", "0 x 480"),
        (CAMERA, "height = 480", "height = 100000", "640 x 100000"),
        (CAMERA, "fx = 500", "fx = nan", "intrinsics"),
        (CAMERA, "fx = 500", "fx = -500", "intrinsics"),
        (CAMERA, "cx = 319.5", "", "cx"),
        (CAMERA, "kannala_brandt", "kannala", "[distortion]"),
        (CAMERA, "[0.1, 0, 0, 0]", "[0.1, 0, 0]", "[distortion]"),
        (CAMERA, "[0.1, 0, 0, 0]", "[0.1, inf, 0, 0]", "coefficient 1"),
        (CAMERA, "max_incidence_deg = 80", "max_incidence_deg = 91", "max_incidence"),
        (CAMERA, "width = 640", "width = = 640", "line 3"),
    ];
    for (text, good, bad, says) in cases {
        let faulty = text.replace(good, bad);
        assert_ne!(faulty, text, "{good}");
        let e = parse(&faulty, "s", None).and_then(Sensor::new).expect_err(bad);
        assert!(e.to_string().contains(says), "{bad}: {e}");
        assert!(!e.to_string().contains('\n') && !e.remedy().is_empty(), "{e}");
    }
}

#[test]
fn files_are_named_in_errors_and_give_the_default_name() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("roof.toml");
    std::fs::write(&path, SCANNER).unwrap();
    assert_eq!(read(&path).unwrap().name, "roof");
    std::fs::write(&path, [0xff, 0xfe]).unwrap();
    let e = read(&path).unwrap_err();
    assert_eq!((e.kind(), e.file()), (ErrorKind::Invalid, Some(path.as_path())));
    let gone = folder.path().join("gone.toml");
    assert_eq!(read(&gone).unwrap_err().file(), Some(gone.as_path()));
}

#[test]
fn presets_read_back_equal() {
    for preset in PRESETS {
        let spec = parse(preset.toml, "", None).unwrap();
        assert_eq!(parse(&to_string(&spec), "", None).unwrap(), spec, "{}", preset.name);
    }
}

fn geometries() -> impl Strategy<Value = Geometry> {
    let deg = -80.0..80.0f64;
    let camera = (1..9u32, 1..9u32, [1.0..1e3f64, 1.0..1e3f64, -9.0..9.0f64, -9.0..9.0f64], any::<[i16; 14]>(), 0..4);
    let camera = camera.prop_map(|(width, height, [fx, fy, cx, cy], k, model)| {
        let k = k.map(|c| f64::from(c) / 77777.0);
        let of_lens = [8, 12, 14][width as usize % 3];
        let distortion = match model {
            0 => Distortion::None,
            1 => Distortion::PlumbBob([k[0], k[1], k[2], k[3], k[4]]),
            2 => Distortion::from_model("rational_polynomial", &k[..of_lens]).unwrap(),
            _ => Distortion::Equidistant([k[0], k[1], k[2], k[3]]),
        };
        Geometry::Camera(Camera { width, height, fx, fy, cx, cy, distortion })
    });
    let scanner = (deg.clone(), 0.01..0.3f64, 1..9u32, prop::collection::vec(deg, 1..5), any::<bool>());
    let scanner = scanner.prop_map(|(start_deg, step_deg, count, listed, uniform)| {
        let azimuth = Angles::Uniform { start_deg, step_deg: -step_deg, count };
        let elevation = if uniform { Angles::Uniform { start_deg, step_deg, count } } else { Angles::Listed(listed) };
        Geometry::Scanner(Scanner { azimuth, elevation, beam_height_deg: uniform.then_some(step_deg) })
    });
    let rays = (1..4u32, prop::collection::vec([-1.0..1.0f64, -1.0..1.0f64, 0.1..1.0f64], 3)).prop_map(|(n, d)| {
        let all = (0..3 * n as usize).map(|i| if i == 4 { DVec3::NAN } else { DVec3::from_array(d[i % 3]) }).collect();
        Geometry::Rays(RayTable::new(n, 3, all).unwrap())
    });
    prop_oneof![camera, scanner, rays]
}

proptest! {
    #[test]
    fn what_is_written_reads_back_equal(
        geometry in geometries(),
        name in "\\PC*",
        // Angles are numbers of degrees, as files and flags give them.
        (range_min, far, incidence, sigma) in (0.0..9.0f64, any::<bool>(), 1..=900u32, 0.0..3.0f64),
        (xyz, rpy) in ([-1e7..1e7f64, -9.0..9.0f64, -9.0..9.0f64], [-3.0..3.0f64, -1.5..1.5f64, -3.0..3.0f64]),
    ) {
        let mut spec = SensorSpec::new(name, "a\"b\\c", geometry);
        spec.range_min = range_min;
        spec.range_max = if far { f64::INFINITY } else { range_min + 1.0 / 3.0 };
        spec.max_incidence = far.then(|| (f64::from(incidence) / 10.0).to_radians());
        spec.mount = Pose::from_xyz_rpy(DVec3::from_array(xyz), rpy[0], rpy[1], rpy[2]);
        if far && matches!(spec.geometry, Geometry::Camera(_)) {
            spec.optical_from_image = spec.mount.rotation;
        }
        let mixture = Mixture { hit: 0.5, short: 0.25, none: 0.125, any: 0.125, beam_dependence: 1.0 + sigma };
        let stamp = [StampAt::First, StampAt::Middle, StampAt::Last][(incidence % 3) as usize];
        spec.times = RayTimes::turning(if far { -sigma } else { 0.0 }, stamp);
        spec.noise = Noise {
            range_sigma: sigma,
            stamp_sigma: if far { sigma / 3.0 } else { 0.0 },
            range_sigma_quadratic: if far { sigma / 7.0 } else { 0.0 },
            angle_sigma: sigma.to_radians(),
            mixture: if far { mixture } else { Mixture::default() },
            ..Noise::default()
        };
        let text = to_string(&spec);
        prop_assert_eq!(parse(&text, "other", None).unwrap(), spec);
    }
}
