//! The page of an update: for each change the measurement, and the prediction before and after it.

use super::{Args, Drive, told};
use presight::Scene;
use presight_files::atomic::write_atomically;
use presight_model::error::Result;
use presight_model::measured::Frame;
use presight_model::world::World;
use presight_pictures::preview_png;
use presight_predict::predict::{Backend, Options, Predictor};
use presight_render::plan::{Images, Output, Outputs};
use presight_update::{Finding, Findings, Sight};
use std::collections::{BTreeMap, BTreeSet};
use std::fmt::Write as _;
use std::io::Write;
use std::path::Path;

/// Most changes that get pictures.
const MOST: usize = 200;

/// Drive, sensor and stamp of a frame.
type Key = (usize, String, u64);

fn key(sight: &Sight) -> Key {
    (sight.drive, sight.sensor.clone(), sight.stamp.to_bits())
}

/// All that the page shows.
pub struct Shown<'a> {
    pub args: &'a Args,
    pub drives: &'a [Drive],
    pub scene: &'a Scene,
    pub after: &'a World,
    pub findings: &'a Findings,
    pub told: &'a str,
}

impl Shown<'_> {
    /// Writes `index.html` and its pictures into a folder.
    ///
    /// # Errors
    /// Errors of reading the logs again, of predictions, and of writing.
    pub fn write(&self, out: &Path) -> Result<()> {
        let frames = self.frames()?;
        let mut predictor = Predictor::new(Options::new(Backend::Cpu))?;
        let mut body = String::new();
        for (number, finding) in self.findings.changes.iter().enumerate() {
            let frame = finding.sight.as_ref().and_then(|sight| frames.get(&key(sight)));
            let _ = write!(body, "<section><h2>{}. {}</h2>", number + 1, escaped(&told(finding)));
            if let Some(frame) = frame {
                for (name, png) in self.pictures(&mut predictor, finding, frame)? {
                    let file = format!("{:03}-{name}.png", number + 1);
                    write_atomically(&out.join(&file), |to| to.write_all(&png))?;
                    let _ = write!(
                        body,
                        "<figure><img src=\"{file}\" alt=\"{name}\"><figcaption>{name}</figcaption></figure>"
                    );
                }
            }
            body += &growth(finding);
            body += "</section>";
        }
        let html = format!(
            "<!doctype html><meta charset=\"utf-8\"><title>Update</title><style>{STYLE}</style><h1>{}</h1><pre>{}</pre>{body}",
            escaped(&self.args.drive.map.display().to_string()),
            escaped(self.told)
        );
        write_atomically(&out.join("index.html"), |file| file.write_all(html.as_bytes()))
    }

    /// The frames that show the findings, by drive, sensor and stamp.
    fn frames(&self) -> Result<BTreeMap<Key, Frame>> {
        let sights = self.findings.changes.iter().take(MOST).filter_map(|finding| finding.sight.as_ref());
        let wanted: BTreeSet<Key> = sights.map(key).collect();
        let mut frames = BTreeMap::new();
        for (number, drive) in self.drives.iter().enumerate().filter(|(n, _)| wanted.iter().any(|key| key.0 == *n)) {
            for drive in drive.each_log() {
                drive.read(self.scene, |_, frame, _| {
                    let key = (number, frame.sensor().spec().name.clone(), frame.stamp.to_bits());
                    if wanted.contains(&key) {
                        frames.insert(key, frame.clone());
                    }
                    Ok(())
                })?;
            }
        }
        Ok(frames)
    }

    fn pictures(
        &self,
        predictor: &mut Predictor,
        finding: &Finding,
        frame: &Frame,
    ) -> Result<Vec<(&'static str, Vec<u8>)>> {
        let (sensor, Some(sight)) = (frame.sensor(), &finding.sight) else { return Ok(Vec::new()) };
        let (width, height) = (sensor.width(), sensor.height());
        let measured = Images { width, height, range: frame.ranges().to_vec(), ..Images::default() };
        let mut pictures = vec![("measured", preview_png(&measured, sensor, Output::Range)?)];
        for (name, world) in [("before", &self.scene.world), ("after", self.after)] {
            let mut images = Images::default();
            predictor.predict_images(
                world,
                sensor,
                &sight.world_from_sensor,
                Outputs::of(&[Output::Range]),
                &mut images,
            )?;
            pictures.push((name, preview_png(&images, sensor, Output::Range)?));
        }
        Ok(pictures)
    }
}

/// How the odds of an object grew, as a line.
fn growth(finding: &Finding) -> String {
    let steps = &finding.growth;
    let Some(most) = steps.iter().map(|l| l.abs()).reduce(f32::max).filter(|most| *most > 0.0 && steps.len() > 1)
    else {
        return String::new();
    };
    let x = |k: usize| 300.0 * k as f32 / (steps.len() - 1) as f32;
    let points: Vec<String> =
        steps.iter().enumerate().map(|(k, l)| format!("{:.1},{:.1}", x(k), 30.0 - 28.0 * l / most)).collect();
    format!(
        "<svg viewBox=\"0 0 300 60\" width=\"300\" height=\"60\"><path d=\"M0 30H300\" stroke=\"#999\"/><polyline points=\"{}\" fill=\"none\" stroke=\"#06c\"/></svg><p>log-odds that it stands, view by view: last {:.1}</p>",
        points.join(" "),
        steps.last().copied().unwrap_or_default()
    )
}

const STYLE: &str = "body{font:15px/1.5 system-ui,sans-serif;margin:2rem auto;max-width:72rem;padding:0 1rem}figure{display:inline-block;margin:0 1rem 1rem 0;max-width:22rem}img{max-width:100%;image-rendering:pixelated}section{border-top:1px solid #ccc}h2{font-size:1rem}";

fn escaped(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;")
}
