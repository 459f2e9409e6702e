//! The page of an update: for each change the measurement between the predictions without and with it, and how its
//! evidence grew.

use super::looks::look_from;
use super::{Args, Drive};
use glam::DVec3;
use presight::files::Observation;
use presight::measured::{Frame, ScanMotion};
use presight::tools::write_atomically;
use presight::update::{BestView, DoubtfulObject, Finding, FindingKind, PlannedView, SiteFindings};
use presight::{Backend, Change, Images, Options, Output, Outputs, Predictor, Result, Scene, Sensor, World};
use presight_pictures::{Panel, panels_png};
use presight_studies::page::{Label, Part, Section, Strip, page};
use std::collections::{BTreeMap, BTreeSet};
use std::io::Write;
use std::path::Path;

/// Maximum number of changes with pictures.
const MAX_PICTURES: usize = 200;
/// Maximum number of objects in doubt with pictures.
const MAX_DOUBTS: usize = 60;

/// A frame of a run.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct FrameKey {
    drive: usize,
    sensor: String,
    stamp_bits: u64,
}

impl FrameKey {
    /// The key of a frame of the drive with this number.
    pub fn of(drive: usize, frame: &Frame) -> Self {
        Self { drive, sensor: frame.sensor().spec().name.clone(), stamp_bits: frame.stamp.to_bits() }
    }

    fn of_view(view: &BestView) -> Self {
        Self { drive: view.drive, sensor: view.sensor.clone(), stamp_bits: view.stamp.to_bits() }
    }
}

/// The content of the page.
pub struct Page<'a> {
    pub args: &'a Args,
    pub drives: &'a [Drive],
    /// The motion of the robot during each scan that takes time.
    pub motions: &'a BTreeMap<FrameKey, ScanMotion>,
    pub scene: &'a Scene,
    pub findings: &'a SiteFindings,
    pub summary: &'a str,
}

impl Page<'_> {
    /// Writes `index.html` and its pictures into a folder.
    ///
    /// # Errors
    /// Errors of reading the logs again, of predictions, and of writing.
    pub fn write(&self, out: &Path) -> Result<()> {
        let frames = self.frames()?;
        let mut predictor = Predictor::new(Options::new(Backend::Cpu))?;
        // Counts first. The pictures below show each change.
        let (head, rest) =
            self.summary.match_indices('\n').nth(2).map_or((self.summary, ""), |(at, _)| self.summary.split_at(at));
        let all = Part::Details { summary: "As text".into(), text: rest.trim_start_matches('\n').into() };
        let mut sections =
            vec![Section { title: "All findings and doubts".into(), parts: vec![all], ..Section::default() }];
        for (number, finding) in self.findings.changes.iter().enumerate() {
            let frame = finding.best_view.as_ref().and_then(|view| frames.get(&FrameKey::of_view(view)));
            let text = finding.to_string();
            let rest = text.split_once(": ").map_or(&*text, |(_, rest)| rest);
            let mut parts = Vec::new();
            if let Some(frame) = frame {
                let file = format!("{:03}.png", number + 1);
                let png = self.picture(&mut predictor, (finding, &self.without(number)), frame)?;
                write_atomically(&out.join(&file), |to| to.write_all(&png))?;
                let caption = format!(
                    "At {} s. If the right picture is more like the middle one than the left is, the change is right.",
                    frame.stamp
                );
                parts.push(Part::Image { file, alt: "measurement between predictions", caption });
            }
            parts.extend(growth(finding, self.args.sure));
            sections.push(Section {
                title: format!("{}. {rest}", number + 1),
                label: Some(label(&finding.kind)),
                parts,
            });
        }
        self.doubts(&mut predictor, out, &mut sections)?;
        let html = page(&self.args.drive.map.display().to_string(), head, &sections);
        write_atomically(&out.join("index.html"), |file| file.write_all(html.as_bytes()))
    }

    /// The frames that show the findings, each at one moment.
    fn frames(&self) -> Result<BTreeMap<FrameKey, Frame>> {
        let views = self.findings.changes.iter().take(MAX_PICTURES).filter_map(|finding| finding.best_view.as_ref());
        let wanted: BTreeSet<FrameKey> = views.map(FrameKey::of_view).collect();
        let mut frames = BTreeMap::new();
        for (number, drive) in self.drives.iter().enumerate().filter(|(n, _)| wanted.iter().any(|key| key.drive == *n))
        {
            for drive in drive.each_log() {
                drive.read_again(self.scene, None, |_, Observation { frame, .. }| {
                    let key = FrameKey::of(number, frame);
                    if wanted.contains(&key) {
                        let moving = self.motions.get(&key).map(|m| frame.clone().with_scan_motion(m.clone()));
                        frames.insert(key, moving.unwrap_or_else(|| frame.clone()).at_one_moment()?.frame.into_owned());
                    }
                    Ok(())
                })?;
            }
        }
        Ok(frames)
    }

    /// Adds a section for each object in doubt with the predictions without and with it from its planned view.
    fn doubts(&self, predictor: &mut Predictor, out: &Path, sections: &mut Vec<Section>) -> Result<()> {
        let sensors = self.sensors()?;
        for (number, doubt) in self.findings.doubts.iter().enumerate().take(MAX_DOUBTS) {
            let mut parts = Vec::new();
            let sensor = doubt.view.as_ref().and_then(|view| Some((view, sensors.get(&view.sensor)?)));
            if let Some((view, sensor)) = sensor {
                let file = format!("doubt-{:03}.png", number + 1);
                let png = self.expected(predictor, doubt, (view, sensor))?;
                write_atomically(&out.join(&file), |to| to.write_all(&png))?;
                let caption = "From the free pose that tells most.".into();
                parts.push(Part::Image { file, alt: "predictions without and with it", caption });
            }
            let title = format!("{}: {}{}", doubt.object, doubt.why, look_from(doubt.view.as_ref()));
            sections.push(Section { title, label: Some(Label { text: "doubtful", color: "#777" }), parts });
        }
        Ok(())
    }

    /// The predictions without and with an object in doubt from its planned view.
    fn expected(
        &self,
        predictor: &mut Predictor,
        doubt: &DoubtfulObject,
        (view, sensor): (&PlannedView, &Sensor),
    ) -> Result<Vec<u8>> {
        let mut without = self.scene.world.clone();
        drop(without.apply_unchecked(Change::DeleteObject { name: doubt.object.clone() }));
        let mut predicted = [Images::default(), Images::default()];
        for (world, images) in [&without, &self.scene.world].into_iter().zip(&mut predicted) {
            let range = Outputs::of(&[Output::Range]);
            predictor.predict_images(world, sensor, &view.pose, range, images)?;
        }
        let sensor_from_world = view.pose.world_from_sensor().inverse();
        let corners = doubt.corners(self.scene.world.environment()).into_iter();
        let around: Vec<DVec3> = corners.map(|p| sensor_from_world.transform_point(p)).collect();
        let panels = [("without it", &predicted[0]), ("with it", &predicted[1])]
            .map(|(name, i)| Panel { name, range: &i.range });
        panels_png(&panels, sensor, &around)
    }

    /// The sensors of planned views, by name.
    fn sensors(&self) -> Result<BTreeMap<String, Sensor>> {
        let mut wanted: BTreeSet<&str> =
            self.findings.doubts.iter().filter_map(|d| Some(d.view.as_ref()?.sensor.as_str())).collect();
        let mut sensors = BTreeMap::new();
        for drive in self.drives.iter().flat_map(Drive::each_log) {
            if wanted.is_empty() {
                break;
            }
            drive.read_again(self.scene, None, |_, Observation { frame, .. }| {
                let sensor = frame.sensor();
                if wanted.remove(&*sensor.spec().name) {
                    sensors.insert(sensor.spec().name.clone(), sensor.clone());
                }
                Ok(())
            })?;
        }
        Ok(sensors)
    }

    /// The world with all changes but one.
    fn without(&self, number: usize) -> World {
        let mut world = self.scene.world.clone();
        let others = self.findings.changes.iter().enumerate().filter(|(other, _)| *other != number);
        others.for_each(|(_, finding)| drop(world.apply_unchecked(finding.change(&world))));
        world
    }

    /// The measurement between the predictions of a world without and with one change, around its place.
    fn picture(
        &self,
        predictor: &mut Predictor,
        (finding, without): (&Finding, &World),
        frame: &Frame,
    ) -> Result<Vec<u8>> {
        let (sensor, Some(view)) = (frame.sensor(), &finding.best_view) else { return Ok(Vec::new()) };
        // Both worlds have all other changes, so that they differ by this one alone.
        let mut with = without.clone();
        // A change that cannot be applied, such as a box at an invalid place, is shown without its effect.
        drop(with.apply_unchecked(finding.change(&with)));
        let mut predicted = [Images::default(), Images::default()];
        for (world, images) in [without, &with].into_iter().zip(&mut predicted) {
            let range = Outputs::of(&[Output::Range]);
            predictor.predict_images(world, sensor, &view.pose, range, images)?;
        }
        let sensor_from_world = view.pose.world_from_sensor().inverse();
        let around = finding.corners(self.scene.world.environment()).into_iter();
        let around: Vec<DVec3> = around.map(|p| sensor_from_world.transform_point(p)).collect();
        let panels = [
            Panel { name: "without the change", range: &predicted[0].range },
            Panel { name: "measured", range: frame.ranges() },
            Panel { name: "with it", range: &predicted[1].range },
        ];
        panels_png(&panels, sensor, &around)
    }
}

/// The evidence view by view, with the odds that decide as dashed lines.
fn growth(finding: &Finding, sure: f64) -> Option<Part> {
    let last = finding.growth.last()?;
    let values: Vec<Option<f64>> =
        std::iter::once(0.0).chain(finding.growth.iter().map(|l| f64::from(*l))).map(Some).collect();
    let caption = format!(
        "log-odds that it stands there, over {} views: {last:.0} at the end; dashed: what decides",
        finding.growth.len()
    );
    let strip = Strip { name: "log-odds".into(), values, levels: vec![-sure, 0.0, sure], logarithmic: false };
    Some(Part::Strip { strip, caption })
}

/// The kind of a finding, with its colour.
fn label(kind: &FindingKind) -> Label {
    let (text, color) = match kind {
        FindingKind::Gone => ("gone", "#c33"),
        FindingKind::Moved { .. } => ("moved", "#b60"),
        FindingKind::New(_) | FindingKind::Recognized(_) => ("new", "#283"),
        FindingKind::Part(_) => ("part gone", "#c33"),
        FindingKind::SeenThrough(_) => ("seen through", "#639"),
        FindingKind::ComesAndGoes => ("comes and goes", "#639"),
    };
    Label { text, color }
}
