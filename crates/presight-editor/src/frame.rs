//! Frames: images of a pose, the features in them, regions of interest, and why features are hidden.

use super::answer::{Answer, Body, pose_of, six_of};
use super::session::Session;
use presight::features::{BoxOptions, FeatureOptions, Hidden, PlacedFeatures, SeenFeature};
use presight::predict::Samples;
use presight::{Error, Images, Output, Outputs, Prediction, Request, Result, SensorPose};
use presight_pictures::{Overlay, Screen, Stroke, Style};
use serde::Deserialize;
use serde_json::{Value, json};
use std::time::Instant;

/// Maximum number of features in one request of `why`.
const MAX_EXPLAINED: usize = 500;

/// Asks for the images of a pose.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FrameRequest {
    pose: Vec<f64>,
    /// Names of outputs; the first one gives the scale.
    outputs: Vec<String>,
    /// Visible features.
    #[serde(default)]
    features: bool,
    /// Hidden ones too.
    #[serde(default)]
    hidden: bool,
    /// Every n-th row and column: 1, 2, 4 or 8.
    #[serde(default = "one")]
    stride: u32,
    /// Returned unchanged.
    #[serde(default)]
    seq: u64,
}

fn one() -> u32 {
    1
}

/// Asks for regions of interest.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RegionRequest {
    pose: Vec<f64>,
    /// Standard deviations of the pose: x, y, z in metres; roll, pitch, yaw in degrees.
    sigmas: [f64; 6],
    confidence: f64,
    #[serde(default)]
    seq: u64,
}

/// Asks why features are hidden.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub struct WhyRequest {
    pose: Vec<f64>,
    ids: Vec<u32>,
}

impl Session {
    /// The images of a pose, with the lines of the features.
    pub(crate) fn frame(&mut self, request: &FrameRequest) -> Result<Answer> {
        let start = Instant::now();
        let pose = pose_of(&request.pose)?;
        let outputs = request.outputs.iter().map(|name| name.parse()).collect::<Result<Vec<Output>>>()?;
        let first = *outputs.first().ok_or_else(|| Error::usage("no output is named", "name one, such as range"))?;
        if outputs.len() > Output::WITH_FEATURES.len() || outputs.contains(&Output::FeatureId) {
            return Err(Error::usage("these outputs are not for frames", "name each once, without feature_id"));
        }
        let sensor = match request.stride {
            1 => self.sensor.clone(),
            2 | 4 | 8 => self.sensor.thinned(request.stride)?,
            n => return Err(Error::usage(format!("a stride of {n}"), "give 1, 2, 4 or 8")),
        };
        let with_features = request.features && self.sensor.check_projection().is_ok() && request.stride == 1;
        let mut asked = Request::of(Outputs::of(&outputs));
        if with_features {
            let hidden = if request.hidden { Hidden::Full } else { Hidden::Count };
            let placed = self.placed.clone();
            asked = asked.with_features(FeatureOptions::default().with_placed(placed).with_hidden(hidden));
        }
        let prediction = self.predictor.predict(&self.world, &sensor, &pose, &asked)?;
        let images = &prediction.images;
        let screen = Screen::new(images, &self.sensor, first);
        let mut body = Body::new(json!({
            "seq": request.seq, "version": self.version, "size": [images.width, images.height],
            "stride": request.stride, "pose": six(&request.pose, &pose),
            "screen": in_words(&screen),
        }));
        outputs.iter().for_each(|output| add_image(&mut body, images, *output));
        if screen.above.is_some() {
            add_rays(&mut body, self);
        }
        if with_features {
            let sides =
                if request.hidden { self.predictor.predict_outlines(&self.world, &prediction)? } else { vec![] };
            let strokes = self.strokes(&screen, &prediction, &sides);
            let seen = prediction.features.iter().flat_map(|f| &f.features).filter(|f| !f.visible.is_empty());
            body.set("seen", json!(seen.map(|f| f.feature.id).collect::<Vec<u32>>()));
            add_strokes(&mut body, &strokes);
        }
        body.set("ms", json!(start.elapsed().as_secs_f64() * 1e3));
        Ok(body.answer())
    }

    /// The measured image, as a frame with the range alone; without arrays if there is none.
    pub(crate) fn measured(&self) -> Answer {
        let Some(measured) = &self.options.measured else { return Body::new(json!({})).answer() };
        let mut images = Images::default();
        images.prepare(self.sensor.width(), self.sensor.height(), Outputs::of(&[Output::Range]));
        images.range.copy_from_slice(measured.ranges());
        let screen = Screen::new(&images, &self.sensor, Output::Range);
        let mut body = Body::new(json!({ "size": [images.width, images.height], "screen": in_words(&screen) }));
        add_image(&mut body, &images, Output::Range);
        if screen.above.is_some() {
            add_rays(&mut body, self);
        }
        body.answer()
    }

    fn strokes(&self, screen: &Screen, prediction: &Prediction, sides: &[SeenFeature]) -> Vec<Stroke> {
        let Some(features) = &prediction.features else { return Vec::new() };
        let overlay = Overlay { features, sides, sensor: &self.sensor, pose: prediction.pose, numbers: false };
        screen.strokes(&overlay, &prediction.images)
    }

    /// The regions of interest of the features that are visible at a pose.
    pub(crate) fn regions(&mut self, request: &RegionRequest) -> Result<Answer> {
        let start = Instant::now();
        let pose = pose_of(&request.pose)?;
        self.sensor.check_projection()?;
        let mut sigmas = request.sigmas;
        if sigmas.iter().any(|s| !(0.0..=1e3).contains(s)) {
            return Err(Error::usage("the pose's standard deviations are out of range", "give 0 to 1000"));
        }
        sigmas[3..].iter_mut().for_each(|angle| *angle = angle.to_radians());
        let boxes = BoxOptions::default().with_sensor_sigmas(sigmas).with_confidence(request.confidence);
        let asked = Request::of(Outputs::of(&[Output::PolygonId, Output::Range]))
            .with_features(FeatureOptions::default().with_placed(self.placed.clone()))
            .with_regions(boxes);
        let prediction = self.predictor.predict(&self.world, &self.sensor, &pose, &asked)?;
        let screen = Screen::new(&prediction.images, &self.sensor, Output::Range);
        let mut strokes = self.strokes(&screen, &prediction, &[]);
        strokes.retain(|stroke| stroke.style == Style::Region);
        let boxes = prediction.features.iter().flat_map(|f| &f.features).filter_map(|f| Some((f.feature.id, f.roi?)));
        let boxes: Vec<(u32, [f64; 4])> = boxes.collect();
        let mut body = Body::new(json!({ "seq": request.seq, "version": self.version, "boxes": boxes }));
        add_strokes(&mut body, &strokes);
        body.set("ms", json!(start.elapsed().as_secs_f64() * 1e3));
        Ok(body.answer())
    }

    /// For each feature the visible share, and the hidden shares with their reasons.
    pub(crate) fn why(&mut self, request: &WhyRequest) -> Result<Answer> {
        let pose = pose_of(&request.pose)?;
        self.sensor.check_projection()?;
        if request.ids.len() > MAX_EXPLAINED {
            let what = format!("{} features in one request", request.ids.len());
            return Err(Error::usage(what, format!("ask for at most {MAX_EXPLAINED}")));
        }
        let all = &self.placed.features;
        let found = |id: &u32| all.binary_search_by_key(id, |p| p.feature.id).ok().map(|i| all[i].clone());
        let placed = PlacedFeatures::from(request.ids.iter().filter_map(found).collect::<Vec<_>>());
        let options = FeatureOptions::default().with_placed(placed.clone()).with_hidden(Hidden::Full);
        let asked = Request::of(Outputs::of(&[Output::PolygonId])).with_features(options);
        let prediction = self.aside.predict(&self.world, &self.sensor, &pose, &asked)?;
        let mut features = prediction.features.unwrap_or_default();
        features.spell_out(self.world.environment(), &placed.features);
        let told: Vec<Value> = features.features.iter().map(|f| self.explained(f)).collect();
        Ok(Answer::Json(json!({ "version": self.version, "features": told }).to_string()))
    }

    fn explained(&self, seen: &SeenFeature) -> Value {
        let objects = self.world.environment().objects();
        let hidden: Vec<Value> = seen
            .hidden
            .iter()
            .map(|h| {
                let by = h.by.and_then(|by| objects.get(by.object as usize)).map(|object| &object.name);
                json!({ "share": h.t[1] - h.t[0], "reason": h.reason.name(), "by": by })
            })
            .collect();
        json!({ "id": seen.feature.id, "visible": seen.visible_fraction, "range": seen.range, "hidden": hidden })
    }

    /// Images of the polygons at a pose.
    pub(crate) fn polygons(&mut self, pose: &SensorPose) -> Result<Images> {
        let request = Request::of(Outputs::of(&[Output::PolygonId, Output::Range]));
        Ok(self.predictor.predict(&self.world, &self.sensor, pose, &request)?.images)
    }

    /// The lines of features of their own, such as candidates, on the picture of a pose.
    pub(crate) fn strokes_of(&mut self, placed: PlacedFeatures, pose: &SensorPose) -> Result<Vec<Stroke>> {
        let outputs = Outputs::of(&[Output::PolygonId, Output::Range]);
        let request = Request::of(outputs).with_features(FeatureOptions::default().with_placed(placed));
        let prediction = self.aside.predict(&self.world, &self.sensor, pose, &request)?;
        let screen = Screen::new(&prediction.images, &self.sensor, Output::Range);
        Ok(self.strokes(&screen, &prediction, &[]))
    }
}

/// The six numbers of a pose. Six given numbers return unchanged, so that the page keeps its bits.
fn six(given: &[f64], pose: &SensorPose) -> [f64; 6] {
    given.try_into().unwrap_or_else(|_| six_of(pose))
}

/// How the page draws an image.
fn in_words(screen: &Screen) -> Value {
    json!({
        "size": screen.size, "mirrored": screen.mirrored,
        "above": screen.above.map(|(origin, scale)| json!({ "origin": origin, "pixels_per_metre": scale })),
        "low": screen.scale.low, "high": screen.scale.high, "logarithmic": screen.scale.logarithmic,
        "ticks": screen.scale.ticks(),
    })
}

fn add_image(body: &mut Body, images: &Images, output: Output) {
    let name = output.name();
    match images.samples(output) {
        Some(Samples::Floats(values)) => body.array(name, "f32", values, f32::to_le_bytes),
        Some(Samples::Ids(ids)) => body.array(name, "u32", ids, u32::to_le_bytes),
        Some(Samples::Vectors(vectors)) => body.array(name, "f32", vectors.as_flattened(), f32::to_le_bytes),
        None => {}
    }
}

/// The directions of a single row, x forward and y left; NaN without a ray.
fn add_rays(body: &mut Body, session: &Session) {
    let ray = |column| session.sensor.ray(column, 0).map_or([f32::NAN; 2], |r| [r.x as f32, r.y as f32]);
    let rays: Vec<[f32; 2]> = (0..session.sensor.width()).map(ray).collect();
    body.array("rays", "f32", rays.as_flattened(), f32::to_le_bytes);
}

/// Lines as a list of feature, style and number of corners, and an array of all corners.
pub fn add_strokes(body: &mut Body, strokes: &[Stroke]) {
    let list: Vec<(u32, &str, usize)> = strokes.iter().map(|s| (s.feature, s.style.name(), s.points.len())).collect();
    body.set("strokes", json!(list));
    let corners: Vec<f32> = strokes.iter().flat_map(|s| s.points.as_flattened()).copied().collect();
    body.array("corners", "f32", &corners, f32::to_le_bytes);
}
