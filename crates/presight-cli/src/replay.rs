//! `presight replay`: a drive as images, with a page to browse them.

#[cfg(feature = "ros")]
use super::compared_bag::ComparedBag;
use super::drive::{Drive, FeatureCounts, Followed, Sensed};
use super::localize::summary;
#[cfg(feature = "ros")]
use super::output_bag::OutputBag;
use super::outputs::OutputFiles;
use super::{CommandOutcome, print};
use glam::EulerRot;
#[cfg(feature = "ros")]
use presight::PoseEstimate;
use presight::features::{BoxOptions, FeatureOptions, Hidden};
#[cfg(feature = "ros")]
use presight::files::Observation;
use presight::localize::{FeatureClass, FeatureFindings, Shape, Step, nees};
use presight::measured::Frame;
use presight::tools::{create_folder, write_atomically};
use presight::verdict::Verdict as Judged;
use presight::{
    Backend, Error, Images, Options, Output, Outputs, Predictor, Request, Result, RobotPose, Scene, Sensor, SensorPose,
};
use presight_pictures::{Comparison, GreyMark, GreyPanel, Overlay, PlanMarks, write_comparison};
use presight_studies::page::replay::{Leaf, page};
use std::io::Write;
use std::path::{Path, PathBuf};

const EXAMPLES: &str = "Examples:
  presight replay livingroom --map scenes/room.glb --sensor camera.toml \\
    --init reference --out shown
  presight replay both --map scenes/room.glb --sensor both/sensor.toml --init reference \\
    --layer edges.json --out seen
  presight replay drive.mcap --map hall.glb --init reference --mcap compared.mcap
  presight replay drive.mcap --map hall.glb --init reference --given --mcap given.mcap";

/// Show a drive: an image for each frame, and a page to browse them
///
/// Tracks the robot as `localize` does. DIR gets frames/*.png with predicted and measured ranges and the verdict of
/// each pixel, and index.html with the trajectory, the states, and the errors and uncertainty of the poses. With
/// --layer the images show its features, their regions of interest, and their matches in grey images and scans.
#[derive(Debug, clap::Args)]
#[command(after_help = EXAMPLES)]
pub struct Args {
    #[command(flatten)]
    drive: Drive,

    /// Standard deviation of the log's own positions, metres: part of the NEES
    #[arg(long, value_name = "METRES", default_value_t = 0.0)]
    reference_sigma: f64,

    /// Standard deviation of the log's own orientations, degrees: part of the NEES
    #[arg(long, value_name = "DEG", default_value_t = 0.0)]
    reference_sigma_deg: f64,

    /// Also show what each frame teaches of the model, as `update` would learn it
    #[cfg(feature = "store")]
    #[arg(long)]
    learn: bool,

    /// Write index.html and frames/*.png into this folder
    #[cfg_attr(feature = "ros", arg(long, value_name = "DIR", required_unless_present = "mcap"))]
    #[cfg_attr(not(feature = "ros"), arg(long, value_name = "DIR", required = true))]
    out: Option<PathBuf>,

    /// Write a ROS 2 bag for RViz, Foxglove or Rerun: measurements, predictions, verdicts, poses and the model
    ///
    /// For each measured message the bag has the prediction with the same stamp, frame and type on /presight/predicted,
    /// and on /presight/verdict its points with residual, verdict, object_id and the colours of the page. It also has
    /// the measured message itself, the model on /presight/model, and what `localize --mcap` writes.
    #[cfg(feature = "ros")]
    #[arg(long, value_name = "OUT.mcap")]
    mcap: Option<PathBuf>,

    /// Predict at the log's own poses instead of following the robot: a survey against a model
    #[cfg(feature = "ros")]
    #[arg(long, requires = "mcap", conflicts_with = "out")]
    given: bool,
}

/// Colours of predicted features by class, and of detections.
const FEATURES: [(&str, [u8; 3]); 6] = [
    ("matched", [0x00, 0xd0, 0x9c]),
    ("occluded", [0xff, 0x8c, 0x42]),
    ("missing", [0x56, 0xb4, 0xe9]),
    ("undecidable", [0x8a, 0x90, 0x9c]),
    ("found", [0xff, 0xe1, 0x4d]),
    ("only found", [0xcc, 0x79, 0xa7]),
];

/// Runs the command.
///
/// # Errors
/// Those of [`Drive::follow`], and errors from reading layers and from writing.
pub fn run(args: &Args) -> Result<CommandOutcome> {
    for (flag, sigma) in
        [("--reference-sigma", args.reference_sigma), ("--reference-sigma-deg", args.reference_sigma_deg)]
    {
        if !(sigma >= 0.0 && sigma.is_finite()) {
            return Err(Error::usage(format!("{flag} {sigma}"), "give a finite number of at least 0"));
        }
    }
    let mut files = OutputFiles::default();
    args.out.iter().try_for_each(|out| files.add_folder(out, &["index.html"]))?;
    #[cfg(feature = "ros")]
    let mut bag = OutputBag::of("--mcap", args.mcap.as_deref(), &mut files)?
        .map(|bag| ComparedBag::new(bag, args.drive.threads))
        .transpose()?;
    #[cfg(feature = "ros")]
    if let Some(bag) = bag.as_mut().filter(|_| args.given) {
        return given(args, files, bag);
    }
    let (mut painter, mut pictures) = (None, Vec::new());
    #[cfg(feature = "store")]
    let mut learning = args.learn.then(super::update::Learning::new).transpose()?;
    // What updates learn must not depend on it.
    #[cfg(feature = "store")]
    let drive = if args.learn { args.drive.clone() } else { args.drive.learning() };
    #[cfg(not(feature = "store"))]
    let drive = args.drive.learning();
    let followed = drive.follow(files, None, |scene, sensed, step| {
        #[cfg(feature = "ros")]
        bag.iter_mut().try_for_each(|bag| bag.step(scene, sensed, step))?;
        let name = format!("{:06}.png", pictures.len());
        if let Some(out) = &args.out {
            let frames = out.join("frames");
            let painter = match &mut painter {
                Some(painter) => painter,
                None => {
                    create_folder(out)?;
                    create_folder(&frames)?;
                    painter.insert(Painter::new(args, scene, sensed)?)
                }
            };
            painter.paint(scene, sensed, step, &frames.join(&name))?;
        }
        pictures.push(format!("frames/{name}"));
        #[cfg(feature = "store")]
        learning.iter_mut().try_for_each(|learning| learning.observe(&scene.world, step, sensed.frame))?;
        Ok(())
    })?;
    if pictures.is_empty() {
        return Err(Error::invalid("there are no frames to show", "give an earlier --from").in_file(&args.drive.log));
    }
    #[cfg(feature = "ros")]
    bag.iter_mut().try_for_each(ComparedBag::finish)?;
    let told = summary(&followed);
    let Some(out) = &args.out else {
        print::data(&told)?;
        return Ok(CommandOutcome::Done);
    };
    let extra = (args.reference_sigma, args.reference_sigma_deg.to_radians());
    #[cfg_attr(not(feature = "store"), expect(unused_mut, reason = "only learning adds to the leaves"))]
    let mut leaves: Vec<Leaf> = (0..pictures.len()).map(|k| leaf(&followed, k, &pictures[k], extra)).collect();
    #[cfg(feature = "store")]
    for (leaf, learnt) in leaves.iter_mut().zip(learning.iter().flat_map(|learning| &learning.notes)) {
        leaf.reason += learnt;
    }
    let title = format!("{} in {}", args.drive.log.display(), args.drive.map.display());
    let html = page(&title, &told.trim_end().replace('\n', "; "), &leaves);
    write_atomically(&out.join("index.html"), |file| file.write_all(html.as_bytes()))?;
    print::data(&told)?;
    Ok(CommandOutcome::Done)
}

/// Compares a log with the model at the log's own poses.
#[cfg(feature = "ros")]
fn given(args: &Args, files: OutputFiles, bag: &mut ComparedBag) -> Result<CommandOutcome> {
    args.drive.check_outputs(&files)?;
    let scene = args.drive.scene()?;
    files.check_scene(&scene.files)?;
    let (mut with, mut without) = (0, 0);
    args.drive.read(&scene, None, |scene, Observation { frame, reference, recorded }| {
        let Some(reference) = reference else {
            without += 1;
            return Ok(());
        };
        with += 1;
        let robot = PoseEstimate::of_sigmas(*reference, args.reference_sigma, args.reference_sigma_deg.to_radians());
        let sensed = Sensed { frame, grey: None, beside: &[], recorded: recorded.as_deref() };
        bag.given(scene, &sensed, &robot, args.drive.options(frame.sensor()).model_sigma)
    })?;
    if with == 0 {
        let remedy = "give a log with poses, such as /tf from map to the robot, or leave out --given";
        return Err(Error::invalid("the log has no poses", remedy).in_file(&args.drive.log));
    }
    bag.finish()?;
    print::notices(&(without > 0).then(|| format!("{without} frames have no pose and are left out")));
    print::lines([format!("{with} frames compared at the log's own poses")])?;
    Ok(CommandOutcome::Done)
}

/// Predicts again at the estimated pose, and draws the comparison.
struct Painter {
    predictor: Predictor,
    features: Option<FeatureOptions>,
}

impl Painter {
    fn new(args: &Args, scene: &Scene, sensed: &Sensed<'_>) -> Result<Self> {
        let threads = presight::Threads::from(args.drive.threads).started()?;
        let predictor = Predictor::new(Options::new(Backend::Cpu).with_threads(threads))?;
        // In logs with grey images, features are drawn over the grey image.
        let own = sensed.grey().is_none();
        let placed = own.then(|| args.drive.placed(scene, sensed.frame.sensor())).transpose()?.flatten();
        Ok(Self {
            predictor,
            features: placed.map(|p| FeatureOptions::default().with_hidden(Hidden::Full).with_placed(p)),
        })
    }

    fn paint(&mut self, scene: &Scene, sensed: &Sensed<'_>, step: &Step, path: &Path) -> Result<()> {
        let marks = step.estimate.findings.first().map(marks).unwrap_or_default();
        let grey = sensed.grey().and_then(Frame::grey);
        let grey = grey.map(|image| GreyPanel { image, marks: &marks, legend: &FEATURES });
        // The estimate is of that moment.
        let moment = sensed.frame.at_one_moment()?;
        let (frame, sensor) = (&*moment.frame, moment.frame.sensor());
        let legend = Judged::ALL.map(|verdict| (word(verdict), verdict.color()));
        if frame.grey().is_some() {
            let nothing = Images::default();
            let alone = Comparison {
                sensor,
                predicted: &nothing,
                sensed: &[],
                verdicts: &[],
                legend: &legend,
                features: None,
                grey,
                plan: None,
            };
            return write_comparison(path, &alone);
        }
        let robot = &step.estimate.pose;
        let pose = robot.robot().sensor(sensor);
        let mut request = Request::of(Outputs::of(&[Output::Range, Output::PolygonId]));
        if let Some(features) = &self.features {
            let regions = BoxOptions::default().with_robot(robot, sensor);
            request = request.with_features(features.clone()).with_regions(regions);
        }
        let predicted = self.predictor.predict(&scene.world, sensor, &pose, &request)?;
        let sides = match &predicted.features {
            Some(_) => self.predictor.predict_outlines(&scene.world, &predicted)?,
            None => Vec::new(),
        };
        let overlay = predicted.features.as_ref().map(|features| Overlay {
            features,
            sides: &sides,
            sensor,
            pose,
            numbers: false,
        });
        let judged: Vec<u8> = step.estimate.verdicts.first().map_or_else(Vec::new, |v| {
            let number = |v: &Judged| Judged::ALL.iter().position(|other| other == v).unwrap_or_default() as u8;
            v.pixels.iter().map(number).collect()
        });
        let plan = step.estimate.findings.first().map(|found| plan(found, sensor, &pose));
        let plan = plan.as_ref().filter(|_| grey.is_none());
        let comparison = Comparison {
            sensor,
            predicted: &predicted.images,
            sensed: frame.ranges(),
            verdicts: &judged,
            legend: &legend,
            features: overlay.as_ref(),
            grey,
            plan: plan.map(|marks| PlanMarks { marks, legend: &FEATURES }),
        };
        write_comparison(path, &comparison)
    }
}

/// A verdict in words.
fn word(verdict: Judged) -> &'static str {
    match verdict {
        Judged::NoReturn => "no return",
        Judged::NotPredicted => "not predicted",
        one_word => one_word.name(),
    }
}

/// Marks for a grey image: predicted features in the colours of their classes, with detections on top.
fn marks(findings: &FeatureFindings) -> Vec<GreyMark> {
    let kind = |name: &str| FEATURES.iter().position(|(known, _)| *known == name).unwrap_or_default();
    let mark = |shape: &Shape, kind: usize, radius: f64| GreyMark { points: shape.points().to_vec(), kind, radius };
    let mut marks: Vec<GreyMark> =
        findings.features.iter().map(|f| mark(&f.predicted, kind(f.class.name()), 1.6)).collect();
    let only = findings.only_found.iter().map(|at| &findings.detections[*at].shape);
    marks.extend(only.map(|shape| mark(shape, kind("only found"), 0.8)));
    marks.extend(findings.matched().map(|(_, found)| mark(&found.shape, kind("found"), 0.8)));
    marks
}

/// Marks for a top view of a scan of one row: predicted and detected reflectors.
fn plan(findings: &FeatureFindings, sensor: &Sensor, pose: &SensorPose) -> Vec<GreyMark> {
    let kind = |name: &str| FEATURES.iter().position(|(known, _)| *known == name).unwrap_or_default();
    let sensor_from_world = pose.world_from_sensor().inverse();
    let predicted = findings.features.iter().map(|f| {
        let points = f.points_world.iter().map(|p| sensor_from_world.transform_point(*p).truncate()).collect();
        GreyMark { points, kind: kind(f.class.name()), radius: 2.4 }
    });
    let place = |at: usize| {
        let found = &findings.detections[at];
        let range = found.properties.range?.mean;
        Some(vec![(sensor.ray_at(found.shape.centre().x, 0.0)? * range).truncate()])
    };
    let found = |at: usize, name: &str| Some(GreyMark { points: place(at)?, kind: kind(name), radius: 1.2 });
    let only = findings.only_found.iter().filter_map(|at| found(*at, "only found"));
    let matched = findings.features.iter().filter_map(|f| match f.class {
        FeatureClass::Matched(at) => found(at, "found"),
        _ => None,
    });
    predicted.chain(only).chain(matched).collect()
}

/// The page's data of a frame. `extra` is the standard deviation of the log's own poses, metres and radians.
fn leaf(followed: &Followed, k: usize, picture: &str, extra: (f64, f64)) -> Leaf {
    let (step, counts) = (&followed.steps[k], &followed.counts[k]);
    let truth = followed.reference[k].map(|robot| robot.world_from_robot());
    let known = truth.filter(|_| step.is_known());
    let mut wider = step.pose;
    for i in (0..6).filter(|i| step.pose.covariance[*i][*i] > 0.0) {
        wider.covariance[i][i] += if i < 3 { extra.0 * extra.0 } else { extra.1 * extra.1 };
    }
    let (yaw, pitch, roll) = step.pose.world_from_robot.rotation.to_euler(EulerRot::ZYX);
    let pixels = counts.iter().sum::<usize>().max(1) as f64;
    let sigmas = step.pose.covariance.sigmas();
    Leaf {
        picture: picture.to_owned(),
        time: step.stamp,
        state: step.phase.name(),
        reason: step.reason.clone(),
        position: step.pose.world_from_robot.translation.to_array(),
        attitude_deg: [roll, pitch, yaw].map(f64::to_degrees),
        sigmas: std::array::from_fn(|i| if i < 3 { sigmas[i] } else { sigmas[i].to_degrees() }),
        weak: step.estimate.weak.iter().map(|w| w.name.clone()).collect(),
        explained: step.estimate.explained,
        model_sigma: step.estimate.model_sigma,
        verdicts: Judged::ALL.iter().zip(counts).map(|(v, n)| (v.name(), *n as f64 / pixels)).collect(),
        features: followed.features[k].iter().flat_map(FeatureCounts::named).collect(),
        reference: truth.map(|t| t.translation.to_array()),
        off: known.map(|t| {
            let metres = step.pose.world_from_robot.translation.distance(t.translation);
            (metres, step.pose.world_from_robot.rotation.angle_between(t.rotation).to_degrees())
        }),
        nees: known.map(|t| nees(&wider, &RobotPose::new(t))).map(|(squared, n)| squared / n.max(1) as f64),
    }
}
