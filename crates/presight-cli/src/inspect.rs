//! `presight inspect`: the contents and problems of a model.

use super::frame_args::FrameArgs;
use super::open_scene;
use super::{CommandOutcome, flags, print};
use presight::environment::{Aabb, Appearance, Environment, IndexKind, Material, Object};
use presight::files;
use presight::{Error, Pose, Result, Scene};
use serde_json::{Value, json};
use std::path::{Path, PathBuf};

const EXAMPLES: &str = "Examples:
  presight inspect hall.glb
  presight inspect hall.glb --json | jq '.problems[] | {kind, total}'";

/// Format version of the inspection JSON.
const FORMAT: u32 = 1;

/// Show objects, polygons, bounds, materials and every problem of a model
#[derive(Debug, clap::Args)]
#[command(after_help = EXAMPLES)]
pub struct Args {
    /// The model: a .glb or .gltf file, a .rhai script, or a store
    scene: PathBuf,

    /// Merge coplanar neighbours within this fraction of an object's size [default: 1e-6]
    #[arg(long, value_name = "X")]
    merge_tolerance: Option<f64>,

    #[command(flatten)]
    frame: FrameArgs,

    /// Print JSON
    #[arg(long)]
    json: bool,
}

/// Runs the command. Problems of a model are not errors: most real models have some.
///
/// # Errors
/// Import errors.
pub fn run(args: &Args) -> Result<CommandOutcome> {
    let mut options = args.frame.options()?;
    options.merge_tolerance = args.merge_tolerance.unwrap_or(options.merge_tolerance);
    let mut scene = open_scene(&args.scene, &options, IndexKind::None)?;
    scene.report.problems.extend(files::problem_of_lost_features(scene.world.environment())?);
    if args.json {
        let value = as_json(&args.scene, &scene);
        let wrong = |e| Error::invalid(format!("cannot write the inspection as JSON: {e}"), "").in_file(&args.scene);
        print::data(&(serde_json::to_string_pretty(&value).map_err(wrong)? + "\n"))?;
    } else {
        print::lines(in_words(&args.scene, &scene))?;
    }
    Ok(CommandOutcome::Done)
}

/// The number of polygons of each material, over all objects.
fn polygons_by_material(environment: &Environment) -> Vec<u64> {
    let mut counts = vec![0; environment.materials().len()];
    for object in environment.objects() {
        for polygon in 0..object.mesh.polygon_count() as u32 {
            counts[usize::from(object.mesh.material(polygon))] += 1;
        }
    }
    counts
}

/// Objects that are not deleted, with their indices.
fn live(environment: &Environment) -> impl Iterator<Item = (usize, &Object)> {
    environment.objects().iter().enumerate().filter(|(_, o)| !o.is_deleted())
}

fn bounds_json(b: &Aabb) -> Value {
    if b.is_empty() { Value::Null } else { json!({ "min": b.min.to_array(), "max": b.max.to_array() }) }
}

fn pose_json(pose: &Pose) -> Value {
    let (t, q) = (pose.translation, pose.rotation);
    json!([t.x, t.y, t.z, q.x, q.y, q.z, q.w])
}

fn group_json(path: &str, world_from_group: &Pose) -> Value {
    json!({ "name": path, "world_from_group": pose_json(world_from_group) })
}

fn as_json(path: &Path, scene: &Scene) -> Value {
    let environment = scene.world.environment();
    let object = |(index, o): (usize, &Object)| {
        json!({
            "id": index + 1,
            "name": o.name,
            "mesh": o.mesh.name(),
            "polygons": o.mesh.polygon_count(),
            "first_polygon_id": o.first_slot + 1,
            "first_source_id": o.first_source + 1,
            "world_from_object": pose_json(&o.world_from_object),
            "bounds": bounds_json(&o.world_bounds()),
        })
    };
    let counts = polygons_by_material(environment);
    let material = |(m, polygons): (&Material, u64)| {
        json!({
            "name": m.name,
            "polygons": polygons,
            "reflection": m.reflection,
            "one_sided": m.one_sided,
            "color": m.color,
            "appearance": m.appearance,
        })
    };
    let report = &scene.report;
    json!({
        "format": FORMAT,
        "scene": path.display().to_string(),
        "content_hash": environment.content_hash().to_string(),
        "up": scene.frame.map(|frame| frame.up),
        "scale": scene.frame.map(|frame| frame.scale),
        "hints": hints(scene),
        "triangles_in_scene": report.triangles_in_scene,
        "triangles_stored": report.triangles_stored,
        "polygons_in_scene": report.polygons_in_scene,
        "polygons_stored": report.polygons_stored,
        "merges": report.merges,
        "largest_deviation_m": report.largest_deviation_m,
        "bounds": bounds_json(&environment.bounds()),
        "objects": live(environment).map(object).collect::<Vec<_>>(),
        "groups": environment.groups().iter().map(|(path, frame)| group_json(path, frame)).collect::<Vec<_>>(),
        "materials": environment.materials().iter().zip(counts).map(material).collect::<Vec<_>>(),
        "problems": report.problems,
    })
}

/// Hints that the file was read with a wrong up axis or scale.
fn hints(scene: &Scene) -> Vec<String> {
    let Some(frame) = scene.frame else { return Vec::new() };
    let scene_from_world = frame.world_from_scene.inverse().to_affine();
    let hints = frame.hints(&scene.world.environment().bounds().transformed(&scene_from_world));
    hints.iter().map(|hint| flags::named(hint)).collect()
}

fn in_words(path: &Path, scene: &Scene) -> Vec<String> {
    let environment = scene.world.environment();
    let report = &scene.report;
    let mut lines = vec![path.display().to_string()];
    lines.push(format!("objects    {} in {} groups", live(environment).count(), environment.groups().len()));
    if report.triangles_in_scene > 0 {
        lines.push(format!(
            "polygons   {} from {} triangles in the scene, {} from {} stored",
            report.polygons_in_scene, report.triangles_in_scene, report.polygons_stored, report.triangles_stored
        ));
        let deviation = report.largest_deviation_m;
        lines.push(format!("merging    {} merges, largest deviation {deviation:.3e} m", report.merges));
    } else {
        // A store holds polygons, not triangles.
        lines.push(format!("polygons   {}, {} stored", report.polygons_in_scene, report.polygons_stored));
    }
    lines.push(format!("bounds     {}", bounds_in_words(&environment.bounds())));
    lines.push(format!("content    {}", environment.content_hash()));
    lines.push(match scene.frame {
        Some(frame) => format!("frame      {} of the file is up, its unit is {} m", frame.up.name(), frame.scale),
        None => "frame      z is up, metres".into(),
    });
    lines.extend(hints(scene).iter().map(|hint| format!("hint       {hint}")));
    lines.extend([String::new(), "objects (id, polygons, bounds in the world, name)".into()]);
    for (index, o) in live(environment) {
        let (polygons, bounds) = (o.mesh.polygon_count(), bounds_in_words(&o.world_bounds()));
        lines.push(format!("  {:>5}  {polygons:>8}  {bounds}  {}", index + 1, o.name));
    }
    lines.extend([String::new(), "materials (polygons, properties, name)".into()]);
    for (m, polygons) in environment.materials().iter().zip(polygons_by_material(environment)) {
        lines.push(format!("  {polygons:>8}  {}  {}", properties(m), m.name));
    }
    let found = if report.problems.is_empty() { "no problems" } else { "problems" };
    lines.extend([String::new(), found.into()]);
    lines.extend(report.problems.iter().flat_map(|p| p.lines("  ")).map(|line| format!("  {line}")));
    lines
}

fn bounds_in_words(b: &Aabb) -> String {
    if b.is_empty() {
        return "empty".into();
    }
    // Adding 0 turns -0 into 0.
    let plain = |x: f64| (x * 1e3).round() / 1e3 + 0.0;
    let side = |low: f64, high: f64| format!("{:.3}..{:.3}", plain(low), plain(high));
    format!("x {} y {} z {} m", side(b.min.x, b.max.x), side(b.min.y, b.max.y), side(b.min.z, b.max.z))
}

fn properties(m: &Material) -> String {
    let mut words = vec![format!("reflection {}", m.reflection)];
    words.extend(m.one_sided.then(|| "one-sided".to_owned()));
    words.extend(m.appearance.iter().filter(|(_, a)| **a != Appearance::Opaque).map(|(class, a)| {
        let word = if *a == Appearance::Transparent { "transparent" } else { "invisible" };
        format!("{word} to {class}")
    }));
    words.join(", ")
}
