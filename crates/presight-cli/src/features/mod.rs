//! `presight features`: generates feature layers from the model.

mod pick;
mod worth;

use super::frame_args::FrameArgs;
use super::open_scene;
use super::outputs::OutputFiles;
use super::{CommandOutcome, print};
use clap::builder::NonEmptyStringValueParser;
use presight::environment::{Environment, IndexKind};
use presight::features::{FeatureKind, GenerateOptions, GeneratedLayer, generate_with_progress};
use presight::files;
use presight::{Error, Result};
use std::path::PathBuf;
use std::time::Instant;

const EXAMPLES: &str = "Examples:
  All edges, corners and planes for a camera, with their counts:
    presight features scenes/room.glb --class video --out room.video.layer.json

  Only long creases and borders, for a radar:
    presight features scenes/room.glb --class radar --kinds crease,border --min-length 0.5

  How well the layer determines a camera's pose across the map, and a layer with as few features as necessary:
    presight features scenes/room.glb --worth --sensor eye.toml --layer room.video.layer.json \\
      --floor 0 --spacing 2 --csv worth.csv --png worth.png --thin --out few.layer.json

  The surface at a pixel, with an entry to paste into a layer:
    presight features pick hall.glb --sensor video-camera --pose 0,0,1.5,0,10,0 --pixel 320,240

  The JSON schema of layer files, for editors and tools:
    presight features schema > layer.schema.json";

/// Generate a layer of features from a model
///
/// Edges are generated where surfaces meet at an angle, end, change material or intersect, independent of polygon
/// winding; corners where edges meet; patches on vertical and horizontal planes.
#[derive(Debug, clap::Args)]
#[command(after_help = EXAMPLES, args_conflicts_with_subcommands = true, subcommand_negates_reqs = true)]
pub struct Args {
    #[command(subcommand)]
    command: Option<Command>,

    /// The model: a .glb or .gltf file, a .rhai script, or a store
    #[arg(required = true)]
    scene: Option<PathBuf>,

    /// The sensor class of the features
    #[arg(long, value_name = "CLASS", required_unless_present = "worth", conflicts_with = "worth")]
    #[arg(value_parser = NonEmptyStringValueParser::new())]
    class: Option<String>,

    /// Write the layer
    #[arg(long, value_name = "FILE.layer.json")]
    out: Option<PathBuf>,

    #[command(flatten)]
    frame: FrameArgs,

    #[command(flatten)]
    options: OptionArgs,

    #[command(flatten)]
    worth: worth::WorthArgs,
}

#[derive(Debug, clap::Subcommand)]
enum Command {
    Pick(Box<pick::Args>),
    /// Print the JSON schema of layer files
    Schema,
}

/// Flags of the generator.
#[derive(Clone, Debug, clap::Args)]
struct OptionArgs {
    /// Kinds, from crease, border, material, intersection, corner, vertical, horizontal, contour [default: all]
    #[arg(long, value_name = "LIST", value_delimiter = ',')]
    kinds: Vec<FeatureKind>,

    /// Minimum length of an edge, metres [default: 0.05]
    #[arg(long, value_name = "M")]
    min_length: Option<f64>,

    /// Minimum area of a patch, square metres [default: 0.25]
    #[arg(long, value_name = "M2")]
    min_area: Option<f64>,

    /// Minimum angle between the surfaces of a crease, degrees, 0 is flat [default: 30]
    #[arg(long, value_name = "DEG")]
    crease_deg: Option<f64>,

    /// Standard deviation of positions, metres [default: 0.01]
    #[arg(long, value_name = "M")]
    sigma: Option<f64>,

    /// Maximum distance of facets from their plane, metres, 0 for exact planes [default: three times the noise of each
    /// scanned mesh, at most three times --sigma]
    #[arg(long, value_name = "M")]
    flatness: Option<f64>,
}

impl OptionArgs {
    fn options(&self) -> GenerateOptions {
        let default = GenerateOptions::default();
        GenerateOptions {
            kinds: if self.kinds.is_empty() { default.kinds } else { self.kinds.clone() },
            min_length: self.min_length.unwrap_or(default.min_length),
            min_area: self.min_area.unwrap_or(default.min_area),
            crease: self.crease_deg.map_or(default.crease, f64::to_radians),
            sigma: self.sigma.unwrap_or(default.sigma),
            flatness: self.flatness,
            ..default
        }
    }
}

/// Runs the command.
///
/// # Errors
/// Wrong usage; errors from reading the scene and from writing.
pub fn run(args: &Args) -> Result<CommandOutcome> {
    if let Some(command) = &args.command {
        return match command {
            Command::Pick(args) => pick::run(args),
            Command::Schema => print::data(files::layer_schema()).map(|()| CommandOutcome::Done),
        };
    }
    // Clap requires both if there is no subcommand.
    let missing = || Error::usage("a scene and --class or --worth are required", "see presight features --help");
    let sensor = args.worth.sensor()?;
    let class = sensor.as_ref().map(|s| s.spec().class.clone()).or_else(|| args.class.clone());
    let (scene, class) = args.scene.as_ref().zip(class).ok_or_else(missing)?;
    let options = args.options.options();
    options.check()?;
    let mut files = OutputFiles::default();
    files.add("--out", args.out.as_deref(), &["json"])?;
    args.worth.name_files(&mut files)?;
    files.check_named([scene.as_path()])?;
    let index = if sensor.is_some() { IndexKind::default() } else { IndexKind::None };
    let scene = open_scene(scene, &args.frame.options()?, index)?;
    let start = Instant::now();
    let (mut layer, mut lines) = match args.worth.given(&class)? {
        Some(layer) => (layer, Vec::new()),
        None => {
            let generated = generated(scene.world.environment(), &class, &options)?;
            let lines = in_words(&generated, &options, start.elapsed().as_secs_f64());
            (generated.layer, lines)
        }
    };
    files.check_scene(&scene.files)?;
    if let Some(sensor) = &sensor {
        lines.extend(args.worth.tell(&scene, sensor, &mut layer)?);
    }
    if let Some(path) = &args.out {
        files::write_layer(path, &layer)?;
    }
    print::lines(lines)?;
    Ok(CommandOutcome::Done)
}

/// Generates the layer with a progress bar.
fn generated(environment: &Environment, class: &str, options: &GenerateOptions) -> Result<GeneratedLayer> {
    let bar = super::bar::bar(0);
    let generated = generate_with_progress(environment, class, options, &|progress| {
        bar.set_length(progress.of as u64);
        bar.set_position(progress.done as u64);
        bar.set_message(progress.stage);
    });
    bar.finish_and_clear();
    generated
}

fn in_words(generated: &GeneratedLayer, options: &GenerateOptions, seconds: f64) -> Vec<String> {
    let counts = &generated.counts;
    let mut lines = vec![format!("class        {}", generated.layer.class)];
    let kinds = FeatureKind::ALL.into_iter().filter(|k| options.kinds.contains(k));
    lines.extend(kinds.map(|k| format!("{:<12} {}", k.name(), counts.of(k))));
    lines.push(format!("together     {} features in {seconds:.2} s", generated.layer.features.len()));
    let invisible = match counts.invisible {
        0 => String::new(),
        n => format!(", {n} more invisible to the class"),
    };
    lines.push(format!("looked at    {} polygons{invisible}; {} lines", counts.polygons, counts.candidates));
    if options.kinds.iter().any(|k| FeatureKind::ALL[5..].contains(k)) {
        let whose = if options.flatness.is_some() { "as given" } else { "from the noise of their facets" };
        lines.push(match counts.uneven {
            0 => "planes       exact".to_owned(),
            n => format!("planes       within {:.4} m of the facets of {n} objects, {whose}", generated.flatness),
        });
    }
    let off = match counts.off {
        0 => String::new(),
        n => format!("; {n} features moved off the surface by joining"),
    };
    lines.push(format!(
        "left out     {} lines under {} m, {} smooth or flush, {} inside matter{off}",
        counts.short, options.min_length, counts.flat, counts.buried
    ));
    lines
}
