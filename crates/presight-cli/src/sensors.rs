//! `presight sensors`: the built-in sensors.

use super::sensor_args::SensorArgs;
use super::{CommandOutcome, print};
use presight::files;
use presight::sensor::PRESETS;
use presight::{Result, preset};

const EXAMPLES: &str = "Examples:
  presight sensors
  presight sensors video-camera > my-camera.toml     # edit it, then pass --sensor my-camera.toml
  presight sensors camera_info.yaml --rectified > rectified.toml";

/// List the built-in sensors, or print one, or the sensor of a file, as sensor TOML
#[derive(Debug, clap::Args)]
#[command(after_help = EXAMPLES)]
pub struct Args {
    /// The preset or the sensor file to print
    #[arg(value_name = "PRESET|FILE")]
    sensor: Option<String>,

    #[command(flatten)]
    image: SensorArgs,
}

/// Runs the command.
///
/// # Errors
/// [`presight::ErrorKind::Usage`] for an unknown preset; errors of the sensor file.
pub fn run(args: &Args) -> Result<CommandOutcome> {
    let text = match &args.sensor {
        Some(name) => {
            // With its comments, if it is a preset.
            let sensor = args.image.load(name)?;
            let preset = PRESETS.iter().find(|p| p.name == name);
            preset.map_or_else(|| files::sensor_to_toml(sensor.spec()), |p| p.toml.to_owned())
        }
        None => list()?,
    };
    print::data(&text)?;
    Ok(CommandOutcome::Done)
}

/// One line per preset: name, size, class, range, and the first sentence of its comment.
fn list() -> Result<String> {
    let width = PRESETS.iter().map(|p| p.name.len()).max().unwrap_or(0);
    let mut text = String::new();
    for p in PRESETS {
        let sensor = preset(p.name)?;
        let spec = sensor.spec();
        let size = format!("{} x {}", sensor.width(), sensor.height());
        let reach = if spec.range_max.is_finite() { format!("{} m", spec.range_max) } else { "any range".into() };
        let about = p.toml.lines().next().unwrap_or_default().trim_start_matches("# ");
        let about = about.split(". ").next().unwrap_or_default().trim_end_matches('.');
        text += &format!("{:width$}  {size:>10}  {:5}  {reach:>9}  {about}\n", p.name, spec.class);
    }
    Ok(text)
}
