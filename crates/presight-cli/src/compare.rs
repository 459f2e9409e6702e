//! `presight compare`: compares two predictions pixel by pixel.

use super::frame_args::FrameArgs;
use super::outputs::OutputFiles;
use super::{CommandOutcome, open_scene, print};
use clap::ValueEnum;
use presight::environment::IndexKind;
use presight::files::{ExrAttributes, ImageFile, ImportOptions, parse_sensor_toml, read_exr};
use presight::tools::write_atomically;
use presight::{Error, IdScheme, Output, Outputs, Result, Scene, Sensor, blake3_of};
use presight_studies::comparison::{Precision, Report, View, compare};
use serde::Serialize;
use std::io::Write;
use std::path::{Path, PathBuf};

const EXAMPLES: &str = "Examples:
  presight compare reference.exr other.exr
  presight compare reference.exr other.exr --scene scenes/room.glb --json verdict.json";

/// Format version of the comparison JSON.
const FORMAT: u32 = 1;

/// Compare two predictions pixel by pixel
///
/// Every pixel is equal, an accepted edge or tie, or a fault. Only --scene distinguishes edges, ties and rounding from
/// faults; without it every mismatch is a fault. Exit status 0 without faults, 1 with faults.
#[derive(Debug, clap::Args)]
#[command(after_help = EXAMPLES)]
pub struct Args {
    /// The reference images
    reference: PathBuf,

    /// The images to check
    other: PathBuf,

    /// The model of both predictions; sensor and pose are read from REFERENCE
    #[arg(long, value_name = "SCENE")]
    scene: Option<PathBuf>,

    /// The floating-point precision of the images to check
    #[arg(long, value_enum, default_value_t = PrecisionArg::F32, requires = "scene")]
    precision: PrecisionArg,

    /// The merge tolerance of both predictions [default: 1e-6]
    #[arg(long, value_name = "X", requires = "scene")]
    merge_tolerance: Option<f64>,

    #[command(flatten)]
    frame: FrameArgs,

    /// Write the result as JSON
    #[arg(long, value_name = "FILE.json")]
    json: Option<PathBuf>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum PrecisionArg {
    /// 64-bit floats: the reference and the CPU engine
    F64,
    /// 32-bit floats: the GPU engine
    F32,
}

impl From<PrecisionArg> for Precision {
    fn from(precision: PrecisionArg) -> Self {
        match precision {
            PrecisionArg::F64 => Self::F64,
            PrecisionArg::F32 => Self::F32,
        }
    }
}

#[derive(Serialize)]
struct Document<'a> {
    format: u32,
    reference: String,
    other: String,
    scene: Option<String>,
    outputs: Vec<&'static str>,
    #[serde(flatten)]
    report: &'a Report,
}

/// Runs the command.
///
/// # Errors
/// Read errors, and images that cannot be compared.
pub fn run(args: &Args) -> Result<CommandOutcome> {
    let mut files = OutputFiles::default();
    files.add("--json", args.json.as_deref(), &["json"])?;
    files.check_named([&args.reference, &args.other].into_iter().chain(&args.scene).map(PathBuf::as_path))?;
    let mut reference = read_exr(&args.reference)?;
    let mut other = read_exr(&args.other)?;
    keep_common(&mut reference, &mut other).map_err(|e| e.in_file(&args.other))?;
    let view = args.scene.as_ref().map(|path| view_of(args, path, &reference.attributes)).transpose()?;
    if let Some((_, scene_files)) = &view {
        files.check_scene(scene_files)?;
    }
    let report =
        compare(&reference, &other, view.as_ref().map(|(view, _)| view)).map_err(|e| e.in_file(&args.other))?;
    if let Some(path) = &args.json {
        let name = |p: &Path| p.display().to_string();
        let document = Document {
            format: FORMAT,
            reference: name(&args.reference),
            other: name(&args.other),
            scene: args.scene.as_deref().map(name),
            outputs: reference.images.outputs().iter().map(Output::name).collect(),
            report: &report,
        };
        let json = serde_json::to_string_pretty(&document)
            .map_err(|e| Error::invalid(format!("cannot write the result as JSON: {e}"), "").in_file(path))?;
        write_atomically(path, |file| writeln!(file, "{json}"))?;
    }
    print::lines(in_words(&report))?;
    Ok(if report.fault == 0 { CommandOutcome::Done } else { CommandOutcome::Found })
}

/// Keeps only the images that both files have, and prints notes about the others.
fn keep_common(reference: &mut ImageFile, other: &mut ImageFile) -> Result<()> {
    let (a, b) = (reference.images.outputs(), other.images.outputs());
    // feature_id is not compared: it is not computed by the engine.
    let common: Vec<Output> = a.iter().filter(|o| b.has(*o) && *o != Output::FeatureId).collect();
    if common.is_empty() {
        return Err(Error::invalid("has no image that the reference has", "predict both with the same --outputs"));
    }
    for output in Output::WITH_FEATURES {
        if a.has(output) != b.has(output) {
            print::message(&format!("note: {} is in one file only and is not compared", output.name()));
        } else if output == Output::FeatureId && a.has(output) {
            print::message("note: feature_id is not compared");
        }
    }
    for images in [&mut reference.images, &mut other.images] {
        images.keep(Outputs::of(&common));
    }
    if differ(&reference.attributes, &other.attributes) {
        print::message("note: according to their attributes, the files have different sensors, poses or scenes");
    }
    Ok(())
}

/// Returns true if an attribute is set in both files and differs.
fn differ(a: &ExrAttributes, b: &ExrAttributes) -> bool {
    fn apart<T: PartialEq>(a: &Option<T>, b: &Option<T>) -> bool {
        a.is_some() && b.is_some() && a != b
    }
    // A store and the file from which it was made differ as files, but hold the same content.
    let has_content = a.scene_content.is_some() && b.scene_content.is_some();
    let scenes_differ =
        if has_content { a.scene_content != b.scene_content } else { apart(&a.scene_blake3, &b.scene_blake3) };
    let with_motion = a.pose.is_some() && b.pose.is_some() && a.motion != b.motion;
    scenes_differ || with_motion || apart(&a.pose, &b.pose) || apart(&a.sensor, &b.sensor) || apart(&a.ids, &b.ids)
}

/// The view that the reference was predicted in, and the files of its scene.
fn view_of(args: &Args, scene: &Path, attributes: &ExrAttributes) -> Result<(View, Vec<PathBuf>)> {
    let missing = |what: &str| {
        let remedy = "write the file with presight predict, or compare without --scene";
        Error::invalid("is missing", remedy).at(format!("attribute \"presight:{what}\"")).in_file(&args.reference)
    };
    let text = attributes.sensor.as_deref().ok_or_else(|| missing("sensor"))?;
    let pose = attributes.pose.ok_or_else(|| missing("world_from_sensor"))?;
    let in_sensor = |e: Error| e.at("attribute \"presight:sensor\"").in_file(&args.reference);
    let sensor = parse_sensor_toml(text, "sensor", None).and_then(Sensor::new).map_err(in_sensor)?;
    let ids = attributes.ids.unwrap_or_default();
    let default = args.frame.options()?;
    let options = ImportOptions {
        merge: ids == IdScheme::Model,
        merge_tolerance: args.merge_tolerance.unwrap_or(default.merge_tolerance),
        ..default
    };
    let is_other_file = attributes.scene_blake3.as_ref().is_some_and(|was| blake3_of(scene).is_ok_and(|is| is != *was));
    let Scene { world, files, .. } = open_scene(scene, &options, IndexKind::default())?;
    let content = || world.environment().content_hash().to_string();
    if is_other_file && attributes.scene_content.as_ref().is_none_or(|was| content() != *was) {
        let was = attributes.scene.as_deref().unwrap_or("another file");
        let what = format!("is not the scene that {} was predicted from", args.reference.display());
        return Err(Error::invalid(what, format!("give the original {was}, or predict again")).in_file(scene));
    }
    let motion = attributes.motion.clone();
    Ok((View { world, sensor, pose, motion, ids, precision: args.precision.into() }, files))
}

fn in_words(report: &Report) -> Vec<String> {
    let mut lines = vec![format!(
        "{} pixels: {} same, {} edge, {} coincident, {} faults",
        report.pixels, report.same, report.edge, report.coincident, report.fault
    )];
    if report.not_predicted > 0 {
        lines.push(format!("{} more were given up for a deadline and are not compared", report.not_predicted));
    }
    if let Some((column, row)) = report.worst_pixel {
        lines.push(format!("largest share of the error bound: {}; at pixel ({column}, {row})", report.worst));
    }
    lines.extend(report.faults.iter().map(|f| format!("fault at pixel ({}, {}): {}", f.column, f.row, f.why)));
    let more = report.fault - report.faults.len().min(report.fault);
    if more > 0 {
        lines.push(format!("and {more} more"));
    }
    lines
}
