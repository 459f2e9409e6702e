//! `presight features pick`: the surface and features at a pixel.

use super::super::frame_args::FrameArgs;
use super::super::open_scene;
use super::super::pose::PoseArgs;
use super::super::{CommandOutcome, print};
use super::OptionArgs;
use crate::sensor_args::SensorArgs;
use glam::{DVec2, DVec3};
use presight::environment::IndexKind;
use presight::features::GenerateOptions;
use presight::files;
use presight::{Backend, Error, Options, Output, Outputs, Predictor, Request, Result};
use presight_studies::pick::{Hit, NearbyFeature, PickView};
use std::path::PathBuf;

/// Show the polygon and point that a pixel sees, nearby edges, and a layer entry to paste
#[derive(Debug, clap::Args)]
pub struct Args {
    /// The model: a .glb or .gltf file, a .rhai script, or a store
    scene: PathBuf,

    /// A preset (see `presight sensors`) or a sensor file
    #[arg(long, value_name = "PRESET|FILE")]
    sensor: String,

    #[command(flatten)]
    image: SensorArgs,

    #[command(flatten)]
    pose: PoseArgs,

    #[command(flatten)]
    frame: FrameArgs,

    /// Column and row; the top left pixel is 0,0
    #[arg(long, value_name = "U,V", value_parser = parse_pixel)]
    pixel: (u32, u32),

    /// Distance from the point within which edges are listed, metres
    #[arg(long, value_name = "M", default_value_t = 0.5)]
    reach: f64,

    #[command(flatten)]
    options: OptionArgs,
}

fn parse_pixel(text: &str) -> Result<(u32, u32)> {
    let number = |word: &str| word.trim().parse::<f64>().ok().filter(|x| (-0.5..1e6).contains(x));
    let both = text.split_once(',').and_then(|(u, v)| Some((number(u)?, number(v)?)));
    // Pixel i spans i - 0.5 .. i + 0.5.
    both.map(|(u, v)| ((u + 0.5).floor() as u32, (v + 0.5).floor() as u32))
        .ok_or_else(|| Error::usage(format!("{text:?} is not a pixel"), "give column,row"))
}

/// Runs the command.
///
/// # Errors
/// Wrong usage; errors from reading the scene and sensor, and from the engine. A pixel without a surface is not an
/// error, but sets exit status 1.
pub fn run(args: &Args) -> Result<CommandOutcome> {
    let pose = args.pose.parse()?;
    let options = args.options.options();
    if !(args.reach >= 0.0 && args.reach <= 1e6) {
        return Err(Error::usage(format!("--reach {} is out of range", args.reach), "give metres from 0"));
    }
    options.check()?;
    let sensor = args.image.load(&args.sensor)?;
    let (column, row) = args.pixel;
    if column >= sensor.width() || row >= sensor.height() {
        let what = format!("--pixel {column},{row}: the image is {} x {}", sensor.width(), sensor.height());
        return Err(Error::usage(what, "give column,row inside it"));
    }
    let scene = open_scene(&args.scene, &args.frame.options()?, IndexKind::default())?;
    let pose = pose.of_sensor(sensor.spec(), &scene.world_from_gltf)?;
    let mut predictor = Predictor::new(Options::new(Backend::Cpu))?;
    let request = Request::of(Outputs::of(&[Output::PolygonId]));
    let images = predictor.predict(&scene.world, &sensor, &pose, &request)?.images;
    let view = PickView { world: &scene.world, sensor: &sensor, pose: &pose.world_from_sensor(), images: &images };
    let Some(hit) = view.hit(args.pixel) else {
        print::data(&format!("pixel {column},{row} sees nothing\n"))?;
        return Ok(CommandOutcome::Found);
    };
    print::lines(describe(&view, &hit, args, &options)?)?;
    Ok(CommandOutcome::Done)
}

fn describe(view: &PickView<'_>, hit: &Hit, args: &Args, options: &GenerateOptions) -> Result<Vec<String>> {
    let (sensor, environment) = (view.sensor, view.world.environment());
    let object = &environment.objects()[hit.object as usize];
    let object_from_world = object.world_from_object.inverse();
    let p_in_object = object_from_world.transform_point(hit.p_in_world);
    let normal_in_object = object_from_world.rotation * hit.normal;
    let material = &environment.materials()[usize::from(object.mesh.material(hit.polygon))];
    let class = &sensor.spec().class;
    let mut lines = vec![
        format!("pixel            {},{} of {}", args.pixel.0, args.pixel.1, sensor.spec().name),
        format!("polygon          id {}, {} of the object", hit.slot + 1, hit.polygon),
        format!("object           {}", object.name),
        format!("material         {}", material.name),
        format!("range            {:.6} m", hit.range),
        format!("point in world   {}", vector(hit.p_in_world)),
        format!("point in object  {}", vector(p_in_object)),
        format!("normal in world  {}", vector(hit.normal)),
        format!("normal in object {}", vector(normal_in_object)),
    ];
    let pixel = DVec2::new(f64::from(args.pixel.0), f64::from(args.pixel.1));
    let near = view.candidates(class, hit, pixel, args.reach, options)?.near;
    let (seen, hidden): (Vec<NearbyFeature>, Vec<NearbyFeature>) = near.into_iter().partition(|n| n.pixels.is_some());
    lines.push(String::new());
    lines.push(format!(
        "visible edges and corners within {} m of it, nearest in the image first \
         (pixels, metres, kind, points in the object, object)",
        args.reach
    ));
    lines.extend(listed(&seen));
    lines.push(String::new());
    lines.push("hidden edges and corners within the same distance, nearest first".into());
    lines.extend(listed(&hidden));
    let point = hit.point(view.world, options.sigma);
    lines.push(String::new());
    lines.push("an entry for a layer; give it an id that the layer has never used".into());
    // The user may mean the nearest feature or the point itself.
    match seen.first() {
        Some(nearest) => {
            lines.push(files::layer_entry(&nearest.feature)?);
            lines.extend([String::new(), "or the point itself".into()]);
            lines.push(files::layer_entry(&point)?);
        }
        None => lines.push(files::layer_entry(&point)?),
    }
    Ok(lines)
}

fn listed(near: &[NearbyFeature]) -> Vec<String> {
    let line = |n: &NearbyFeature| {
        let points: Vec<String> = n.feature.shape.points().iter().map(|p| vector(*p)).collect();
        let pixels = n.pixels.map_or("-".into(), |p| format!("{p:.1} px"));
        let (name, object) = (n.feature.name.as_deref(), n.feature.object.as_deref().unwrap_or_default());
        format!("  {pixels:>9}  {:.4} m  {:<12}  {}  {object}", n.metres, name.unwrap_or_default(), points.join(" to "))
    };
    if near.is_empty() { vec!["  none".into()] } else { near.iter().map(line).collect() }
}

fn vector(v: DVec3) -> String {
    // Adding 0 turns -0 into 0.
    let [x, y, z] = v.to_array().map(|c| (c * 1e6).round() / 1e6 + 0.0);
    format!("[{x}, {y}, {z}]")
}
