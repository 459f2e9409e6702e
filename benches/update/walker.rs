//! A picture of a person who crosses before a robot and leaves nothing: `cargo bench --bench update -- walker FILE.png`.

use glam::DVec3;
use presight::Scene;
use presight_files::sensor_toml;
use presight_model::geometry::{Pose, PoseCovariance, PoseEstimate};
use presight_model::measured::Frame;
use presight_model::sensor::Sensor;
use presight_pictures::{Panel, panels_png};
use presight_predict::predict::{Backend, Options, Predictor};
use presight_render::plan::{Images, Output, Outputs};
use presight_testkit::caster::Caster;
use presight_testkit::way::Way;
use presight_update::{LearnOptions, Learner, What};

/// A range camera of 160 x 120 pixels, 72 degrees wide, 1.2 m above the floor.
const CAMERA: &str = "format = 1\nkind = \"camera\"\nname = \"range camera\"\nclass = \"laser\"\nwidth = 160\nheight = 120\nfx = 110.0\nfy = 110.0\ncx = 79.5\ncy = 59.5\nrange_max = 12.0\n[noise]\nrange_sigma = 0.01\n";
/// Frames that are shown, and seconds between two frames.
const SHOWN: [usize; 4] = [4, 8, 12, 16];
const STEP: f64 = 0.25;

/// Draws the strip. Panics if the person leaves anything.
pub fn strip(file: &str) {
    let world = Scene::open("scenes/room.glb").expect("a scene of the repository").world;
    let mut spec = sensor_toml::parse(CAMERA, "camera", None).expect("a sensor");
    spec.mount = Pose::from_xyz_rpy(DVec3::new(0.0, 0.0, 1.2), 0.0, 0.1, 0.0);
    let sensor = Sensor::new(spec).expect("a sound sensor");
    // Slow, so that a person who walks 1 m/s crosses.
    let way = Way::straight([0.7, 2.0, 0.1], 0.25, 12.0);
    let mut caster = Caster::new(world.environment(), sensor.clone(), 1).with_walkers(2, &way, 5);
    let mut learner = Learner::new(LearnOptions::default().with_apart(0.05)).expect("sound options");
    let sigmas = [0.002, 0.002, 0.002, 0.0005, 0.0005, 0.0005];
    let frames: Vec<Frame> = (0..48).map(|k| caster.frame(&|t| way.at(t), STEP * f64::from(k), None)).collect();
    for frame in &frames {
        let pose = PoseEstimate::new(way.at(frame.stamp), PoseCovariance::from_sigmas(sigmas));
        learner.observe_at(&world, &[frame], &pose).expect("a view");
    }
    learner.end_drive();
    let findings = learner.findings(&world);
    let left =
        findings.changes.iter().filter(|f| matches!(f.what, What::New(_) | What::Gone | What::Moved { .. })).count();
    assert_eq!(left, 0, "{:?}", findings.changes);
    let mut after = world.clone();
    findings.changes.iter().for_each(|finding| drop(after.apply(finding.change(&after))));
    let mut predictor = Predictor::new(Options::new(Backend::Cpu)).expect("a predictor");
    let (mut predicted, last) = (Images::default(), frames[SHOWN[3]].stamp);
    let at = way.at(last) * sensor.spec().mount;
    predictor
        .predict_images(&after, &sensor, &at, Outputs::of(&[Output::Range]), &mut predicted)
        .expect("a prediction");
    let names: Vec<String> = SHOWN.iter().map(|k| format!("measured, {:.0} s", frames[*k].stamp)).collect();
    let mut panels: Vec<Panel<'_>> =
        SHOWN.iter().zip(&names).map(|(k, name)| Panel { name, range: frames[*k].ranges() }).collect();
    panels.push(Panel { name: "model afterwards", range: &predicted.range });
    let png = panels_png(&panels, &sensor, &[]).expect("a picture");
    std::fs::write(file, png).expect("the picture can be written");
    println!("{} views; changes: {}", learner.tally().views, findings.changes.len());
}
