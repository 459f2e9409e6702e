//! `presight features --worth`: how well a layer determines the pose, and which of its features are sufficient.

use super::super::{bar, print};
use crate::outputs::OutputFiles;
use presight::features::{FeatureLayer, PlacedFeatures};
use presight::files::{self, load_sensor};
use presight::tools::{quantile, upper_median, write_atomically};
use presight::{Error, Options, Predictor, Result, Scene, Sensor};
use presight_pictures::{GridMap, write_maps};
use presight_studies::worth::{HEADINGS, Thinned, Worth, WorthOptions};
use std::io::Write;
use std::path::{Path, PathBuf};

/// Allowed relative growth of a standard deviation by thinning.
const GROWTH: f64 = 0.1;

/// Flags of `--worth`.
#[derive(Clone, Debug, clap::Args)]
pub struct WorthArgs {
    /// Report how well the layer determines a sensor's pose, at every free place of a grid and in eight headings
    ///
    /// The layer is read from --layer or generated. The sensor's mount gives its height above the floor.
    #[arg(long, requires = "sensor")]
    pub worth: bool,

    /// The sensor, with pixel_sigma in [noise]
    #[arg(long, value_name = "PRESET|FILE", requires = "worth")]
    sensor: Option<String>,

    /// Read the layer from this file instead of generating it
    #[arg(long, value_name = "FILE.layer.json", requires = "worth")]
    layer: Option<PathBuf>,

    /// Distance between places, metres [default: 1]
    #[arg(long, value_name = "M", requires = "worth")]
    spacing: Option<f64>,

    /// Height of the robot's frame, metres [default: 0]
    #[arg(long, value_name = "M", requires = "worth", allow_negative_numbers = true)]
    floor: Option<f64>,

    /// Write a line for each free place: the largest standard deviation of position and of heading
    #[arg(long, value_name = "FILE.csv", requires = "worth")]
    csv: Option<PathBuf>,

    /// Draw both standard deviations as maps
    #[arg(long, value_name = "FILE.png", requires = "worth")]
    png: Option<PathBuf>,

    /// Write a thinned layer to --out: as few features as let standard deviations grow by at most 10 %
    #[arg(long, requires = "worth", requires = "out")]
    thin: bool,
}

impl WorthArgs {
    /// Loads the sensor; `None` without `--worth`.
    pub fn sensor(&self) -> Result<Option<Sensor>> {
        let Some(sensor) = &self.sensor else { return Ok(None) };
        let (sensor, notices) = load_sensor(sensor)?;
        print::notices(&notices);
        Ok(Some(sensor))
    }

    /// Adds the output files to `files`.
    pub fn name_files(&self, files: &mut OutputFiles) -> Result<()> {
        files.add("--csv", self.csv.as_deref(), &["csv"])?;
        files.add("--png", self.png.as_deref(), &["png"])?;
        files.check_named(self.layer.as_deref().into_iter().chain(self.sensor.as_deref().map(Path::new)))
    }

    /// Reads the layer of `--layer`, if given.
    pub fn given(&self, class: &str) -> Result<Option<FeatureLayer>> {
        let Some(path) = &self.layer else { return Ok(None) };
        let given = files::read_layer(path)?.layer;
        if given.class != class {
            let what = format!("the layer has class {:?}, the sensor has class {class:?}", given.class);
            return Err(Error::usage(what, "give a layer of the sensor's class").in_file(path));
        }
        Ok(Some(given))
    }

    /// Evaluates the layer, writes the files, and with `--thin` thins the layer. Returns the lines to print.
    pub fn tell(&self, scene: &Scene, sensor: &Sensor, layer: &mut FeatureLayer) -> Result<Vec<String>> {
        let mut options = WorthOptions::default();
        options.spacing = self.spacing.unwrap_or(options.spacing);
        options.floor = self.floor.unwrap_or(options.floor);
        let placed: PlacedFeatures = presight::features::place(&scene.world, layer)?.into();
        let mut predictor = Predictor::new(Options::default())?;
        let bar = bar::bar(0);
        let worth = Worth::of(&scene.world, sensor, &placed, &options, &mut predictor, |done, of| {
            bar.set_length(of as u64);
            bar.set_position(done as u64);
        });
        bar.finish_and_clear();
        let worth = worth?;
        let mut lines = in_words(&worth);
        if let Some(path) = &self.csv {
            write_atomically(path, |file| file.write_all(worth.csv().as_bytes()))?;
        }
        if let Some(path) = &self.png {
            write_png(path, &worth)?;
        }
        if self.thin {
            let thinned = worth.thinned(GROWTH);
            lines.push(thinned_in_words(&worth, &thinned));
            let mut keep = thinned.keep.iter();
            layer.features.retain(|_| *keep.next().unwrap_or(&false));
        }
        Ok(lines)
    }
}

fn write_png(path: &Path, worth: &Worth) -> Result<()> {
    let position = worth.map(|place| place.position_sigma);
    let heading = worth.map(|place| place.heading_sigma.to_degrees());
    let columns = worth.size[0];
    let maps = [
        GridMap { title: "position, 1 sd", unit: "m", columns, values: &position },
        GridMap { title: "heading, 1 sd", unit: "deg", columns, values: &heading },
    ];
    write_maps(path, &maps)
}

/// Median and maximum of the finite standard deviations, and the number of places where a direction is not determined.
fn in_words(worth: &Worth) -> Vec<String> {
    let open = worth.places.iter().filter(|p| p.position_sigma.is_infinite()).count();
    let told = |name: &str, unit: &str, value: &dyn Fn(usize) -> f64| {
        let mut known: Vec<f64> = (0..worth.places.len()).map(value).filter(|v| v.is_finite()).collect();
        match (upper_median(&mut known, f64::total_cmp), quantile(&mut known, 1.0)) {
            (Some(median), Some(most)) => {
                format!("{name:<12} 1 sd: median {median:.4} {unit}, maximum {most:.4} {unit}")
            }
            _ => format!("{name:<12} not determined anywhere"),
        }
    };
    vec![
        format!(
            "places       {} of {} x {}, {HEADINGS} headings each; a direction is not determined at {open}",
            worth.places.len(),
            worth.size[0],
            worth.size[1]
        ),
        told("position", "m", &|i| worth.places[i].position_sigma),
        told("heading", "deg", &|i| worth.places[i].heading_sigma.to_degrees()),
    ]
}

fn thinned_in_words(worth: &Worth, thinned: &Thinned) -> String {
    let kept = thinned.keep.iter().filter(|k| **k).count();
    let [position, heading] = [thinned.position_growth, thinned.heading_growth].map(|g| 100.0 * g);
    format!(
        "thinned      {kept} of {} features; position grows by {position:.1} %, heading by {heading:.1} % at most",
        worth.given
    )
}
