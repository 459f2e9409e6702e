//! A picture of a person who crosses before a robot and leaves nothing: `cargo bench --bench update -- walker
//! FILE.png`.

use glam::DVec3;
use presight::Scene;
use presight_model::geometry::{Pose, PoseCovariance, PoseEstimate, RobotPose, SensorPose};
use presight_model::measured::Frame;
use presight_model::sensor::Sensor;
use presight_model::world::World;
use presight_pictures::{Panel, panels_png};
use presight_predict::predict::{Backend, Options, Predictor};
use presight_read::sensor_toml;
use presight_render::plan::{Images, Output, Outputs};
use presight_testkit::caster::Caster;
use presight_testkit::route::Route;
use presight_update::{FindingKind, LearnOptions, Learner};

/// A range camera of 160 x 120 pixels, 72 degrees wide, 1.2 m above the floor.
const CAMERA: &str = "format = 1\nkind = \"camera\"\nname = \"range camera\"\nclass = \"laser\"\nwidth = 160\nheight = 120\nfx = 110.0\nfy = 110.0\ncx = 79.5\ncy = 59.5\nrange_max = 12.0\n[noise]\nrange_sigma = 0.01\n";
/// Seconds between two frames, and their number.
const STEP: f64 = 0.25;
const FRAMES: usize = 48;
/// Number of pixels, more than half a metre nearer than the model, by which a frame shows a person.
const PERSON: usize = 500;
/// Distance of the frames shown, in frames. A frame without a person follows the last one with a person.
const APART: usize = 3;

/// Draws the strip. Panics if the person leaves anything.
pub fn strip(file: &str) {
    let world = Scene::open("scenes/room.glb").expect("a scene of the repository").world;
    let mut spec = sensor_toml::parse(CAMERA, "camera", None).expect("a sensor");
    spec.mount = Pose::from_xyz_rpy(DVec3::new(0.0, 0.0, 1.2), 0.0, 0.1, 0.0);
    let sensor = Sensor::new(spec).expect("a sound sensor");
    // Slow, so that a person who walks 1 m/s crosses.
    let route = Route::straight([0.7, 2.0, 0.1], 0.25, 12.0);
    let mut predictor = Predictor::new(Options::new(Backend::Cpu)).expect("a predictor");
    let mut predict = |world: &World, stamp: f64| {
        let (mut images, at) = (Images::default(), route.at(stamp) * sensor.spec().mount);
        predictor
            .predict_images(world, &sensor, &SensorPose::new(at), Outputs::of(&[Output::Range]), &mut images)
            .expect("a prediction");
        images.range
    };
    // The first draw in which somebody crosses.
    let draw = |seed: u64| {
        let mut caster = Caster::new(world.environment(), sensor.clone(), seed).with_walkers(2, &route, seed);
        (0..FRAMES).map(|k| caster.frame(&|t| route.at(t), STEP * k as f64, None)).collect::<Vec<Frame>>()
    };
    let mut found = None;
    for seed in 1..100 {
        let frames = draw(seed);
        let mut shows = |frame: &Frame| {
            let expected = predict(&world, frame.stamp);
            expected.iter().zip(frame.ranges()).filter(|(e, z)| **z < **e - 0.5).count() >= PERSON
        };
        let shown: Vec<bool> = frames.iter().map(&mut shows).collect();
        let is_crossing = |k: &usize| (0..3).all(|n| shown[k + n * APART]) && !shown[k + 3 * APART];
        if let Some(first) = (0..FRAMES - 3 * APART).find(is_crossing) {
            found = Some((frames, first));
            break;
        }
    }
    let (frames, first) = found.expect("somebody crosses");
    let mut learner = Learner::new(LearnOptions::default().with_view_distance(0.05)).expect("sound options");
    let sigmas = [0.002, 0.002, 0.002, 0.0005, 0.0005, 0.0005];
    for frame in &frames {
        let pose = PoseEstimate::new(RobotPose::new(route.at(frame.stamp)), PoseCovariance::from_sigmas(sigmas));
        learner.observe_at(&world, &[frame], &pose).expect("a view");
    }
    learner.end_drive();
    let findings = learner.findings(&world);
    let left = findings
        .changes
        .iter()
        .filter(|f| matches!(f.kind, FindingKind::New(_) | FindingKind::Gone | FindingKind::Moved { .. }))
        .count();
    assert_eq!(left, 0, "{:?}", findings.changes);
    let mut after = world.clone();
    findings.changes.iter().for_each(|finding| drop(after.apply(finding.change(&after))));
    let shown: Vec<&Frame> = (0..4).map(|n| &frames[first + n * APART]).collect();
    let predicted = predict(&after, shown[3].stamp);
    let names: Vec<String> = shown.iter().map(|frame| format!("measured, {:.2} s", frame.stamp)).collect();
    let mut panels: Vec<Panel<'_>> =
        shown.iter().zip(&names).map(|(frame, name)| Panel { name, range: frame.ranges() }).collect();
    panels.push(Panel { name: "model afterwards", range: &predicted });
    let png = panels_png(&panels, &sensor, &[]).expect("a picture");
    std::fs::write(file, png).expect("the picture can be written");
    println!("{} views; changes: {}", learner.tally().views, findings.changes.len());
}
