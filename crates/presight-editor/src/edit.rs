//! Steps of editing: changes from the page, generated features, undo and redo, and what a pixel offers.

use super::answer::{Answer, Body, pose_of};
use super::frame::add_strokes;
use super::save::RestoreRequest;
use super::session::{Session, Step};
use glam::{DVec2, DVec3};
use presight::environment::Aabb;
use presight::features::{
    Feature, FeatureKind, FeatureLayer, FeatureOptions, GenerateOptions, PlacedFeatures, generate, place,
};
use presight::files::layer_fields;
use presight::store::feature_change;
use presight::{Change, Error, Images, Output, Outputs, Request, Result, SensorPose};
use presight_studies::pick::{Candidates, Hit, NearbyFeature, PickView};
use serde::Deserialize;
use serde_json::value::RawValue;
use serde_json::{Value, json};
use std::collections::HashSet;
use std::sync::Arc;

/// An edge this near to the pixel comes before the surface under it, pixels.
const ON_EDGE: f64 = 8.0;
/// The most candidates of an answer.
const MAX_CANDIDATES: usize = 24;
/// Maximum distance of a new id from the first free one.
const FREE_IDS: u32 = 1 << 24;

/// A step of the page.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ChangeRequest {
    #[serde(rename = "version")]
    _version: u64,
    /// As a line of `presight env apply`.
    change: Box<RawValue>,
    /// What the undo button says.
    label: String,
}

/// Asks for features of the model.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub struct GenerateRequest {
    #[serde(rename = "version")]
    _version: u64,
    /// A pose: only features that are visible from it. None: the whole model.
    pose: Option<Vec<f64>>,
    #[serde(default)]
    kinds: Vec<String>,
    min_length: Option<f64>,
    min_area: Option<f64>,
    sigma: Option<f64>,
}

/// Asks what a pixel sees, and which features it offers.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PickRequest {
    pose: Vec<f64>,
    /// Column and row.
    pixel: [u32; 2],
    #[serde(default = "half_a_metre")]
    reach: f64,
    #[serde(default)]
    seq: u64,
}

fn half_a_metre() -> f64 {
    0.5
}

impl Session {
    /// Applies a step of the page.
    pub(crate) fn change(&mut self, request: &ChangeRequest) -> Result<()> {
        let change = feature_change(request.change.get(), self.world.environment())?;
        self.check_change(&change)?;
        if request.label.len() > 200 {
            return Err(Error::usage("the label is over 200 bytes long", "shorten it"));
        }
        self.step(change, &request.label)
    }

    /// Applies a change as a step that can be undone.
    pub(crate) fn step(&mut self, change: Change, label: &str) -> Result<()> {
        let inverse = self.apply(&change, label, false)?;
        self.undo.push(Step { change: inverse, label: label.to_owned() });
        self.redo.clear();
        Ok(())
    }

    /// Only features of this class, with ids that were never used.
    fn check_change(&self, change: &Change) -> Result<()> {
        let of_class = |class: &String| match *class == self.class {
            true => Ok(()),
            false => Err(Error::usage(format!("a feature for class {class:?}"), format!("give {:?}", self.class))),
        };
        match change {
            Change::Group(changes) => changes.iter().try_for_each(|change| self.check_change(change)),
            Change::InsertFeature { class, feature } => {
                let free = self.next_id..self.next_id.saturating_add(FREE_IDS);
                if !free.contains(&feature.id) {
                    let what = format!("feature {}: its id is not free", feature.id);
                    return Err(Error::usage(what, format!("take {}", self.next_id)));
                }
                of_class(class)
            }
            Change::SetFeature { class, .. }
            | Change::DeleteFeature { class, .. }
            | Change::SetTolerance { class, .. } => of_class(class),
            _ => Err(Error::usage("this change is not a step of the editor", "insert, set or delete features")),
        }
    }

    /// Undoes the last step, or redoes the one undone last.
    pub(crate) fn take_back(&mut self, undo: bool) -> Result<()> {
        let from = if undo { &mut self.undo } else { &mut self.redo };
        let what = if undo { "nothing to undo" } else { "nothing to redo" };
        let step = from.pop().ok_or_else(|| Error::usage(what, "make a step first"))?;
        match self.apply(&step.change, &step.label, true) {
            Ok(inverse) => {
                let to = if undo { &mut self.redo } else { &mut self.undo };
                to.push(Step { change: inverse, label: step.label });
                Ok(())
            }
            Err(e) => {
                if undo { &mut self.undo } else { &mut self.redo }.push(step);
                Err(e)
            }
        }
    }

    /// Takes or drops the steps of a session that ended before it saved: all or none.
    pub(crate) fn restore(&mut self, request: &RestoreRequest) -> Result<()> {
        if !request.keep {
            return self.journal.clear();
        }
        let lines = self.journal.take_offered();
        self.journal.replays(true);
        let before = self.undo.len();
        let done = lines.iter().enumerate().try_for_each(|(i, line)| {
            let place = |e: Error| e.at(format!("step {}", i + 1));
            let change = feature_change(line, self.world.environment()).map_err(place)?;
            let inverse = self.apply(&change, "restored", true).map_err(place)?;
            self.undo.push(Step { change: inverse, label: "restored step".into() });
            Ok(())
        });
        if done.is_err() {
            while self.undo.len() > before {
                let Some(step) = self.undo.pop() else { break };
                self.apply(&step.change, "", true)?;
            }
            self.journal.offer(lines);
        }
        self.journal.replays(false);
        done
    }

    /// Makes features of the model that the layer does not have yet, as one step. Returns their number.
    pub(crate) fn generate(&mut self, request: &GenerateRequest) -> Result<usize> {
        let pose = request.pose.as_deref().map(pose_of).transpose()?;
        let mut options = GenerateOptions::default();
        if !request.kinds.is_empty() {
            options.kinds = request.kinds.iter().map(|kind| kind.parse()).collect::<Result<Vec<FeatureKind>>>()?;
        }
        options.min_length = request.min_length.unwrap_or(options.min_length);
        options.min_area = request.min_area.unwrap_or(options.min_area);
        options.sigma = request.sigma.unwrap_or(options.sigma);
        options.check()?;
        if let Some(pose) = &pose {
            let images = self.polygons(pose)?;
            options.region = seen_box(&images, &self.sensor, pose);
            if options.region.is_none() {
                return Ok(0);
            }
        }
        let mut layer = generate(self.world.environment(), &self.class, &options)?.layer;
        if let Some(pose) = &pose {
            let placed = place(&self.world, &layer)?;
            let options = FeatureOptions::default().with_placed(placed);
            let request = Request::of(Outputs::of(&[Output::PolygonId])).with_features(options);
            let seen = self.aside.predict(&self.world, &self.sensor, pose, &request)?.features.unwrap_or_default();
            let seen: HashSet<u32> = seen.features.iter().map(|f| f.feature.id).collect();
            layer.features.retain(|f| seen.contains(&f.id));
        }
        let known: HashSet<Place> = self.listed().iter().map(|f| place_of(f)).collect();
        layer.features.retain(|f| !known.contains(&place_of(f)));
        let count = layer.features.len();
        if u32::MAX - self.next_id < count as u32 {
            return Err(Error::usage("no free ids are left", "begin a new layer"));
        }
        if count > 0 {
            let insert = |(id, feature): (u32, Arc<Feature>)| {
                let feature = Feature { id, ..Arc::unwrap_or_clone(feature) };
                Change::InsertFeature { class: self.class.clone(), feature }
            };
            let mut changes: Vec<Change> = (self.next_id..).zip(layer.features).map(insert).collect();
            // Features of scanned meshes may be further from their facets.
            if layer.tolerance > self.tolerance() {
                changes.insert(0, Change::SetTolerance { class: self.class.clone(), tolerance: layer.tolerance });
            }
            self.step(Change::Group(changes), &format!("generate {count} features"))?;
        }
        Ok(count)
    }

    /// The point that a pixel sees, and the features that may be made there, the most likely one first.
    pub(crate) fn pick(&mut self, request: &PickRequest) -> Result<Answer> {
        let pose = pose_of(&request.pose)?;
        let [column, row] = request.pixel;
        if column >= self.sensor.width() || row >= self.sensor.height() {
            let what = format!("pixel {column},{row} is outside the image");
            return Err(Error::usage(what, "point into it"));
        }
        if !(request.reach > 0.0 && request.reach <= 100.0) {
            return Err(Error::usage(format!("a reach of {} m", request.reach), "give metres, at most 100"));
        }
        let images = self.polygons(&pose)?;
        let view =
            PickView { world: &self.world, sensor: &self.sensor, pose: &pose.world_from_sensor(), images: &images };
        let Some(hit) = view.hit((column, row)) else {
            return Ok(Body::new(json!({ "seq": request.seq, "hit": null, "candidates": [] })).answer());
        };
        let options = GenerateOptions::default();
        let pixel = DVec2::new(f64::from(column), f64::from(row));
        let Candidates { near, surfaces, tolerance } =
            view.candidates(&self.class, &hit, pixel, request.reach, &options)?;
        let seen = |n: &NearbyFeature| n.pixels.is_some();
        let (edges, others): (Vec<_>, Vec<_>) =
            near.into_iter().filter(seen).partition(|n| n.pixels.is_some_and(|p| p <= ON_EDGE));
        let point = Arc::new(hit.point(&self.world, options.sigma));
        let with = |n: NearbyFeature| (n.feature, n.pixels);
        let mut candidates: Vec<(Arc<Feature>, Option<f64>)> = edges.into_iter().map(with).collect();
        candidates.extend(surfaces.into_iter().map(|feature| (feature, None)));
        candidates.extend(others.into_iter().map(with));
        candidates.truncate(MAX_CANDIDATES - 1);
        candidates.push((point, None));
        let told: Vec<Value> = candidates.iter().map(|(feature, pixels)| told(feature, *pixels)).collect();
        // Numbered, so that each line names its candidate.
        let numbered =
            |(i, (f, _)): (u32, &(Arc<Feature>, Option<f64>))| Arc::new(Feature { id: i, ..Feature::clone(f) });
        let features = (1..).zip(&candidates).map(numbered).collect();
        let class = self.class.clone();
        let layer = FeatureLayer { class, tolerance, features, pose_covariances: Vec::new() };
        let placed = PlacedFeatures::from(place(&self.world, &layer)?);
        let mut body = Body::new(
            json!({ "seq": request.seq, "hit": self.in_words(&hit), "candidates": told, "tolerance": tolerance }),
        );
        if self.sensor.check_projection().is_ok() {
            add_strokes(&mut body, &self.strokes_of(placed, &pose)?);
        }
        Ok(body.answer())
    }

    fn in_words(&self, hit: &Hit) -> Value {
        let environment = self.world.environment();
        let object = &environment.objects()[hit.object as usize];
        let material = &environment.materials()[usize::from(object.mesh.material(hit.polygon))];
        json!({
            "object": object.name, "polygon": hit.slot + 1, "material": material.name, "range": hit.range,
            "point": hit.p_in_world.to_array(), "normal": hit.normal.to_array(),
        })
    }
}

fn told(feature: &Feature, pixels: Option<f64>) -> Value {
    json!({ "feature": layer_fields(feature), "pixels": pixels })
}

/// A box around the points that an image shows, world.
fn seen_box(images: &Images, sensor: &presight::Sensor, pose: &SensorPose) -> Option<Aabb> {
    let world_from_sensor = pose.world_from_sensor();
    /// Metres around the points: edges reach a little further.
    const AROUND: f64 = 0.05;
    let mut points = Vec::new();
    let whole = f64::from(images.width) * f64::from(images.height);
    // A coarse sample is enough: the box only limits the work, and features reach out of it.
    let step = ((whole / 4e4).sqrt().floor() as usize).max(1);
    for row in (0..images.height).step_by(step) {
        for column in (0..images.width).step_by(step) {
            let range = f64::from(images.range[row as usize * images.width as usize + column as usize]);
            if let Some(ray) = sensor.ray(column, row).filter(|_| range.is_finite()) {
                points.push(world_from_sensor.transform_point(sensor.body_from_image() * ray * range));
            }
        }
    }
    let bounds = Aabb::of(points);
    (!bounds.is_empty())
        .then(|| Aabb { min: bounds.min - DVec3::splat(AROUND), max: bounds.max + DVec3::splat(AROUND) })
}

/// Kind, object and corners to a tenth of a millimetre: two features there are one.
type Place = (&'static str, Option<String>, Vec<[i64; 3]>);

fn place_of(feature: &Feature) -> Place {
    let round = |p: &DVec3| p.to_array().map(|c| (c * 1e4).round() as i64);
    let mut corners: Vec<[i64; 3]> = feature.shape.points().iter().map(round).collect();
    corners.sort_unstable();
    (feature.shape.kind(), feature.object.clone(), corners)
}
