//! Which parts of features are seen.
//!
//! A sample of a feature has its own ray, from the sensor to the point itself, which is not that of any pixel. The images
//! propose what may hide it: the polygons seen by the nine pixels around the sample. Each that the feature does not lie on
//! is tested against the own ray, exactly in f64 (all e_k . u >= 0), and hides the sample if it is nearer by more than the
//! derived rounding bound: n . u / d > 1 / |p| + bound. The sample is seen if its own polygon covers the ray, or another
//! one of the nine does and is not nearer. Where none covers it (fine tessellation, occluders under a pixel, holes), or one
//! is beside the ray whose plane passes before the sample (the next facet of what it belongs to may cover the ray), the
//! sample is in doubt, and a ray through the index decides. So it does where pixels are larger than 3 degrees,
//! and for a single row whose beam is taller than two of its steps.
//!
//! Comparing the point's depth with the plane of its pixel's polygon instead swallows and leaks at silhouettes: that plane
//! says nothing about places that the polygon does not cover.

mod frame;
mod tally;

use super::sample::{Piece, Sample};
use super::{FeaturePrediction, FeatureStats, PlacedFeature, Reason, SeenFeature};
use crate::compare::{FaceBound, Precision};
use crate::environment::{Appearance, FeatureShape};
use crate::error::Result;
use crate::geometry::{Pose, plane_of_polygon};
use crate::index::{Found, Region};
use crate::plan::{IdScheme, Images};
use crate::reference::Face;
use crate::sensor::Sensor;
use crate::world::World;
use frame::Frame;
use glam::{DMat3, DVec2, DVec3};
use rayon::prelude::*;
use std::collections::HashMap;
use tally::{State, Tally, share};

/// How visibility is decided.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Visibility {
    /// By the polygons of neighbouring pixels, and by rays where these leave it open.
    #[default]
    Image,
    /// By a ray through the index for every sample: slow, and what the other is measured against.
    Rays,
}

/// How features are predicted.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct FeatureOptions {
    /// UTC seconds, for probabilities of existence; `None` is the newest confirmation of all features.
    pub time: Option<f64>,
    /// What `polygon_id` of the images numbers.
    pub ids: IdScheme,
    /// Fill [`FeaturePrediction::feature_id`].
    pub feature_id: bool,
    /// How visibility is decided.
    pub visibility: Visibility,
}

/// Predicts what a sensor at a pose (body axes) sees of features, from the `polygon_id` image that an engine made of the
/// same world, sensor and pose.
///
/// ```
/// use presight::environment::{Existence, Feature, FeatureShape, Properties};
/// use presight::features::{FeatureOptions, PlacedFeature, predict_features};
/// use presight::{Backend, Environment, Options, Output, Outputs, Pose, Predictor, Request, World};
/// use glam::{DMat3, DVec3};
///
/// let world = World::new(Environment::new());
/// let sensor = presight::preset("video-camera")?;
/// let mut predictor = Predictor::new(Options { backend: Backend::Cpu, threads: 1 })?;
/// let request = Request { outputs: Outputs::of(&[Output::PolygonId]), ..Request::default() };
/// let seen = predictor.predict(&world, &sensor, &Pose::IDENTITY, &request)?;
/// // An edge 3 m ahead in an empty world.
/// let ends = [DVec3::new(3.0, -0.2, 0.0), DVec3::new(3.0, 0.2, 0.1)];
/// let shape = FeatureShape::Segment { ends, covariances: [DMat3::ZERO; 2], cross: DMat3::ZERO };
/// let (existence, properties) = (Existence::default(), Properties::default());
/// let feature = Feature { id: 7, name: None, object: None, shape, existence, properties };
/// let placed = [PlacedFeature { feature, object: None, slots: vec![] }];
/// let options = FeatureOptions::default();
/// let found = predict_features(&world, &sensor, &Pose::IDENTITY, &seen.images, &placed, &options)?;
/// assert_eq!(found.features[0].visible_fraction, 1.0);
/// # Ok::<(), presight::Error>(())
/// ```
///
/// # Errors
/// [`crate::ErrorKind::Invalid`] if there is no `polygon_id` image of the sensor's size, a feature's object or slot does
/// not exist, or the sensor is a ray table without a nearest ray.
pub fn predict_features(
    world: &World,
    sensor: &Sensor,
    world_from_sensor: &Pose,
    images: &Images,
    placed: &[PlacedFeature],
    options: &FeatureOptions,
) -> Result<FeaturePrediction> {
    if placed.is_empty() {
        let pixels = if options.feature_id { sensor.width() as usize * sensor.height() as usize } else { 0 };
        return Ok(FeaturePrediction { feature_id: vec![0; pixels], ..FeaturePrediction::default() });
    }
    let frame = Frame::new(world, sensor, world_from_sensor, images, placed, options)?;
    let seen: Vec<Judged> = placed
        .par_iter()
        .with_min_len(8)
        .map_init(|| Judge::new(&frame), |judge, placed| judge.feature(placed))
        .collect();
    let mut prediction = FeaturePrediction::default();
    let mut keys = vec![u64::MAX; if options.feature_id { images.pixels() } else { 0 }];
    for (judged, placed) in seen.into_iter().zip(placed) {
        prediction.stats.add(&judged.stats);
        // Points and landmarks over segments over patches, then lower numbers.
        let key = u64::from(layer_of(&placed.feature.shape)) << 32 | u64::from(placed.feature.id);
        for pixel in judged.pixels {
            let at = &mut keys[pixel as usize];
            *at = key.min(*at);
        }
        prediction.features.push(judged.seen);
    }
    prediction.feature_id = keys.iter().map(|key| if *key == u64::MAX { 0 } else { *key as u32 }).collect();
    Ok(prediction)
}

fn layer_of(shape: &FeatureShape) -> u32 {
    match shape {
        FeatureShape::Point { .. } | FeatureShape::Reflector { .. } | FeatureShape::Fiducial { .. } => 0,
        FeatureShape::Segment { .. } => 1,
        FeatureShape::Patch { .. } => 2,
    }
}

/// A polygon in the image frame with its error bound, kept for all samples that come near it.
struct Known {
    slot: u32,
    face: Face,
    bound: FaceBound,
    /// It covers rays: opaque, seen from this side, not edge-on.
    covers: bool,
}

/// The answer for one sample.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Verdict {
    Seen,
    /// By a slot.
    Hidden(u32),
    Undecided,
}

/// What is known of a feature beside its geometry.
struct Own<'a> {
    slots: &'a [u32],
    /// Normals of what it lies on, as far as that can be seen, image frame.
    normals: Vec<DVec3>,
    /// A landmark is seen from here only.
    front: Option<DVec3>,
    /// Applies to all of it.
    reason: Option<Reason>,
    /// How far its points may be off by rounding, metres.
    rounding: f64,
}

struct Judged {
    seen: SeenFeature,
    stats: FeatureStats,
    pixels: Vec<u32>,
}

/// One worker.
struct Judge<'a> {
    frame: &'a Frame<'a>,
    known: Vec<Known>,
    by_slot: HashMap<u32, u32>,
    /// Polygons of the nine pixels around `center`, and whether the feature lies on them.
    near: Vec<(u32, bool)>,
    center: Option<(i64, i64)>,
    found: Found,
    stats: FeatureStats,
}

impl<'a> Judge<'a> {
    fn new(frame: &'a Frame<'a>) -> Self {
        Self {
            frame,
            known: Vec::new(),
            by_slot: HashMap::new(),
            near: Vec::with_capacity(9),
            center: None,
            found: Found::default(),
            stats: FeatureStats::default(),
        }
    }

    fn feature(&mut self, placed: &PlacedFeature) -> Judged {
        let frame = self.frame;
        let (points, image_from_object, rounding) = frame.in_image(placed);
        let own = self.own(placed, &points, image_from_object, rounding);
        let mut tally = Tally::default();
        self.stats = FeatureStats { features: 1, ..FeatureStats::default() };
        self.center = None;
        let mut judge = |piece: Piece| {
            let state = match piece {
                Piece::Outside { reason, .. } => State::Hidden(reason, None),
                Piece::Inside(sample) => self.sample(&sample, &own),
            };
            tally.take(frame, &piece, state, &own);
        };
        let area = match &placed.feature.shape {
            FeatureShape::Point { .. } | FeatureShape::Reflector { .. } => {
                judge(frame.sampler.point(points[0]));
                false
            }
            FeatureShape::Segment { .. } => {
                frame.sampler.segment(points[0], points[1], &mut judge);
                false
            }
            FeatureShape::Patch { .. } | FeatureShape::Fiducial { .. } => {
                frame.sampler.patch(&points, &mut judge);
                true
            }
        };
        let (visible, hidden) = if area { tally.shares(frame) } else { (tally.visible, tally.hidden) };
        let world_from_object = placed.object.map(|o| frame.environment.objects()[o as usize].world_from_object);
        let in_world = |p: &DVec3| world_from_object.map_or(*p, |pose| pose.transform_point(*p));
        let seen = SeenFeature {
            points_world: placed.feature.shape.points().iter().map(in_world).collect(),
            normal_world: placed
                .feature
                .properties
                .normal
                .and_then(|n| world_from_object.map_or(n, |pose| pose.rotation * n).try_normalize()),
            visible_fraction: share(tally.seen, tally.inside),
            visible,
            hidden,
            range: tally.nearest.map(|n| n.0),
            cos_incidence: tally.nearest.and_then(|n| n.1),
            existence: placed.feature.existence.at(frame.time),
            feature: placed.feature.clone(),
            roi: None,
            roi_flag: None,
            image_covariance: None,
        };
        Judged { seen, stats: self.stats, pixels: tally.pixels }
    }

    /// What holds for all of a feature.
    fn own<'p>(
        &mut self,
        placed: &'p PlacedFeature,
        points: &[DVec3],
        image_from_object: DMat3,
        rounding: f64,
    ) -> Own<'p> {
        let frame = self.frame;
        let class = &frame.sensor.spec().class;
        let (mut normals, mut there, mut away) = (Vec::new(), 0, 0);
        for slot in &placed.slots {
            let Some((object, polygon)) = frame.environment.locate(*slot) else { continue };
            let material = frame.environment.objects()[object as usize].mesh.material(polygon);
            if frame.environment.materials()[usize::from(material)].appearance(class) == Appearance::Invisible {
                continue;
            }
            there += 1;
            let at = self.know(*slot);
            let known = &self.known[at];
            if frame.facings[usize::from(material)].one_sided && !(known.face.distance < 0.0) {
                away += 1;
            } else {
                normals.push(known.face.normal);
            }
        }
        let landmark = matches!(placed.feature.shape, FeatureShape::Reflector { .. } | FeatureShape::Fiducial { .. });
        let given = placed.feature.properties.normal.and_then(|n| (image_from_object * n).try_normalize());
        // Corners are clockwise seen from the front: the right-hand normal points away from there.
        let of_outline = (points.len() > 2).then(|| plane_of_polygon(points)).flatten().map(|p| p.normal);
        let fiducial = matches!(placed.feature.shape, FeatureShape::Fiducial { .. });
        let front = given.or(of_outline.filter(|_| fiducial).map(|n| -n)).filter(|_| landmark);
        normals.extend(front);
        if normals.is_empty() && !(there > 0 && there == away) {
            normals.extend(given.or(of_outline));
        }
        let reason = match (placed.slots.len(), there) {
            (0, _) => None,
            (_, 0) => Some(Reason::Material),
            _ if there == away => Some(Reason::FacingAway),
            _ => None,
        };
        Own { slots: &placed.slots, normals, front, reason, rounding }
    }

    /// The polygon of a slot that exists.
    fn know(&mut self, slot: u32) -> usize {
        if let Some(at) = self.by_slot.get(&slot) {
            return *at as usize;
        }
        let frame = self.frame;
        let (object, polygon) = frame.environment.locate(slot).unwrap_or_default();
        let instance = frame.instance(object);
        let mesh = &frame.environment.objects()[object as usize].mesh;
        let face = Face::new(instance, mesh, polygon);
        let bound = FaceBound::new(&face, instance.center_in_mesh, Precision::F64);
        let facing = frame.facings[usize::from(mesh.material(polygon))];
        let covers = facing.opaque && (!facing.one_sided || face.distance < 0.0) && !face.edge_on();
        let at = self.known.len();
        self.known.push(Known { slot, face, bound, covers });
        self.by_slot.insert(slot, at as u32);
        at
    }

    fn sample(&mut self, sample: &Sample, own: &Own<'_>) -> State {
        let spec = self.frame.sensor.spec();
        let range = sample.at.length();
        let hidden = |reason| State::Hidden(reason, None);
        if range < spec.range_min {
            return hidden(Reason::BelowRangeMin);
        }
        if range > spec.range_max {
            return hidden(Reason::BeyondRangeMax);
        }
        if !(range > 0.0) {
            return hidden(Reason::Undecided);
        }
        if let Some(reason) = own.reason {
            return hidden(reason);
        }
        let ray = sample.at / range;
        if own.front.is_some_and(|n| !(n.dot(ray) < 0.0)) {
            return hidden(Reason::FacingAway);
        }
        if let Some(most) = spec.max_incidence
            && own.cosine(ray).is_some_and(|cosine| cosine < most.cos())
        {
            return hidden(Reason::Oblique);
        }
        self.stats.samples += 1;
        match self.verdict(ray, range, sample.pixel, own) {
            Verdict::Seen => State::Seen,
            Verdict::Hidden(slot) => State::Hidden(Reason::Occluded, Some(slot)),
            Verdict::Undecided => {
                self.stats.undecided += 1;
                hidden(Reason::Undecided)
            }
        }
    }

    fn verdict(&mut self, ray: DVec3, range: f64, pixel: DVec2, own: &Own<'_>) -> Verdict {
        if self.frame.by_pixels {
            self.gather(pixel, own);
            let (mut nearest, mut covered, mut beside) = (None::<(f64, u32)>, false, false);
            for (at, lies_on) in &self.near {
                let known = &self.known[*at as usize];
                if !known.covers {
                    continue;
                }
                if !known.face.holds(ray) {
                    // Its plane passes before the sample: it may be part of something that hides it.
                    let inverse = known.face.inverse_range(ray);
                    let behind = inverse > 0.0 && inverse * range <= 1.0;
                    beside |= !(*lies_on || behind);
                    continue;
                }
                match (*lies_on, nearer(known, ray, range, own)) {
                    (false, Nearer::Yes(inverse)) => {
                        if nearest.is_none_or(|n| inverse > n.0) {
                            nearest = Some((inverse, known.slot));
                        }
                    }
                    (false, Nearer::Unknown) => {}
                    _ => covered = true,
                }
            }
            if let Some((_, slot)) = nearest {
                self.stats.hidden_by_neighbours += 1;
                return Verdict::Hidden(slot);
            }
            if covered && !beside {
                self.stats.visible_by_neighbours += 1;
                return Verdict::Seen;
            }
        }
        self.stats.decided_by_ray += 1;
        self.by_ray(ray, range, own)
    }

    /// The polygons of the nine pixels around a place.
    fn gather(&mut self, pixel: DVec2, own: &Own<'_>) {
        let frame = self.frame;
        let (w, h) = (i64::from(frame.images.width), i64::from(frame.images.height));
        let inside = |x: f64, n: i64| (x.round() as i64).clamp(0, n - 1);
        let (column, row) = (inside(pixel.x, w), inside(pixel.y, h));
        if self.center == Some((column, row)) {
            return;
        }
        self.center = Some((column, row));
        self.near.clear();
        let wraps = frame.sampler.turn().is_some();
        let mut seen = [0u32; 9];
        let mut count = 0;
        for r in (row - 1).max(0)..=(row + 1).min(h - 1) {
            for c in column - 1..=column + 1 {
                let c = if wraps { c.rem_euclid(w) } else { c };
                if !(0..w).contains(&c) {
                    continue;
                }
                let id = frame.images.polygon_id[(r * w + c) as usize];
                if id == 0 || seen[..count].contains(&id) {
                    continue;
                }
                (seen[count], count) = (id, count + 1);
                let Some(slot) = frame.slot_of_id(id).filter(|s| frame.environment.locate(*s).is_some()) else {
                    continue;
                };
                let at = self.know(slot);
                self.near.push((at as u32, own.slots.contains(&slot)));
            }
        }
    }

    /// A ray from the sensor to the sample through the index.
    fn by_ray(&mut self, ray: DVec3, range: f64, own: &Own<'_>) -> Verdict {
        let frame = self.frame;
        let direction = frame.image_from_world.transpose() * ray;
        let region = Region::ray(frame.world_from_sensor.translation, direction, range * (1.0 + 1e-9));
        let mut found = std::mem::take(&mut self.found);
        found.clear();
        frame.world.index().query(frame.environment, &region, &mut found);
        let (mut nearest, mut unknown) = (None::<(f64, u32)>, false);
        for slot in found.all() {
            if own.slots.contains(&slot) || frame.environment.locate(slot).is_none() {
                continue;
            }
            let at = self.know(slot);
            let known = &self.known[at];
            if !known.covers || !known.face.holds(ray) {
                continue;
            }
            match nearer(known, ray, range, own) {
                Nearer::Yes(inverse) => {
                    if nearest.is_none_or(|n| inverse > n.0) {
                        nearest = Some((inverse, slot));
                    }
                }
                Nearer::Unknown => unknown = true,
                Nearer::No => {}
            }
        }
        self.found = found;
        match nearest {
            Some((_, slot)) => Verdict::Hidden(slot),
            None if unknown => Verdict::Undecided,
            None => Verdict::Seen,
        }
    }
}

enum Nearer {
    /// With its inverse range.
    Yes(f64),
    No,
    /// Nothing is known about its range.
    Unknown,
}

/// Is a polygon that covers the ray nearer than the sample by more than rounding?
fn nearer(known: &Known, ray: DVec3, range: f64, own: &Own<'_>) -> Nearer {
    let (inverse, of_sample) = (known.face.inverse_range(ray), range.recip());
    // The sample's own position and length.
    let slack = of_sample * (own.rounding * of_sample + 8.0 * f64::EPSILON);
    if !(inverse > of_sample + slack) {
        return Nearer::No;
    }
    let bound = known.bound.inverse_range(&known.face, ray);
    if !bound.is_finite() {
        return Nearer::Unknown;
    }
    if inverse > of_sample + slack + bound { Nearer::Yes(inverse) } else { Nearer::No }
}

impl Own<'_> {
    /// Of the surfaces it lies on, the one seen most directly.
    fn cosine(&self, ray: DVec3) -> Option<f64> {
        self.normals.iter().map(|n| n.dot(ray).abs().min(1.0)).reduce(f64::max)
    }
}
