//! `presight features --worth`: where a layer fixes the pose, and which of its features are enough.

use super::super::{bar, print};
use crate::outputs::OutputFiles;
use presight::environment::FeatureLayer;
use presight::features::PlacedFeatures;
use presight::io::atomic::write_atomically;
use presight::io::{layer, load_sensor};
use presight::worth::{HEADINGS, Thinned, Worth, WorthOptions};
use presight::{Error, Options, Predictor, Result, Scene, Sensor};
use presight_pictures::{GridMap, write_maps};
use std::io::Write;
use std::path::{Path, PathBuf};

/// By how much a thinned layer may let a standard deviation grow.
const GROWTH: f64 = 0.1;

/// The flags that say what a layer is worth.
#[derive(Clone, Debug, clap::Args)]
pub struct WorthArgs {
    /// Tell how well the layer fixes the pose of a sensor, at every free place of a grid and in eight headings
    ///
    /// The layer is that of --layer, or the generated one. Its mount says how high the sensor is above the floor.
    #[arg(long, requires = "sensor")]
    pub worth: bool,

    /// The sensor, with pixel_sigma in [noise]
    #[arg(long, value_name = "PRESET|FILE", requires = "worth")]
    sensor: Option<String>,

    /// The layer, in place of a generated one
    #[arg(long, value_name = "FILE.layer.json", requires = "worth")]
    layer: Option<PathBuf>,

    /// Metres between places [default: 1]
    #[arg(long, value_name = "M", requires = "worth")]
    spacing: Option<f64>,

    /// Height of the robot's frame, metres [default: 0]
    #[arg(long, value_name = "M", requires = "worth", allow_negative_numbers = true)]
    floor: Option<f64>,

    /// Write a line for each free place: the largest standard deviation of position and of heading
    #[arg(long, value_name = "FILE.csv", requires = "worth")]
    csv: Option<PathBuf>,

    /// Draw both as maps
    #[arg(long, value_name = "FILE.png", requires = "worth")]
    png: Option<PathBuf>,

    /// Keep as few features as it takes: no view's standard deviations grow by over a tenth; --out gets what is left
    #[arg(long, requires = "worth", requires = "out")]
    thin: bool,
}

impl WorthArgs {
    /// The sensor that is asked about.
    pub fn sensor(&self) -> Result<Option<Sensor>> {
        let Some(sensor) = &self.sensor else { return Ok(None) };
        let (sensor, notices) = load_sensor(sensor)?;
        print::notices(&notices);
        Ok(Some(sensor))
    }

    /// Takes note of the files that are written.
    pub fn name_files(&self, files: &mut OutputFiles) -> Result<()> {
        files.add("--csv", self.csv.as_deref(), &["csv"])?;
        files.add("--png", self.png.as_deref(), &["png"])?;
        files.check_named(self.layer.as_deref())
    }

    /// The layer, if a file has it.
    pub fn given(&self, class: &str) -> Result<Option<FeatureLayer>> {
        let Some(path) = &self.layer else { return Ok(None) };
        let given = layer::read(path)?.layer;
        if given.class != class {
            let what = format!("the layer is for {:?}, the sensor of class {class:?}", given.class);
            return Err(Error::usage(what, "give a layer of the sensor's class").in_file(path));
        }
        Ok(Some(given))
    }

    /// Tells what the layer is worth, writes the files, and leaves in the layer what is enough if it is to be thinned.
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

/// Median and largest of what is known, and how many places leave a direction open.
fn in_words(worth: &Worth) -> Vec<String> {
    let open = worth.places.iter().filter(|p| p.position_sigma.is_infinite()).count();
    let told = |name: &str, unit: &str, value: &dyn Fn(usize) -> f64| {
        let mut known: Vec<f64> = (0..worth.places.len()).map(value).filter(|v| v.is_finite()).collect();
        known.sort_by(f64::total_cmp);
        match known.last() {
            Some(last) => {
                format!("{name:<12} 1 sd {:.4} {unit} in the median, {last:.4} {unit} at most", known[known.len() / 2])
            }
            None => format!("{name:<12} nowhere known"),
        }
    };
    vec![
        format!(
            "places       {} of {} x {}, {HEADINGS} headings each; {open} leave a direction open",
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
