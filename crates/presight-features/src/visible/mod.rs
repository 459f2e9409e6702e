//! Decides which parts of features are visible.
//!
//! Each sample of a feature has its own ray, from the sensor to the sample; it is not the ray of any pixel. A polygon
//! on which the feature does not lie hides the sample if it covers that ray, exactly in f64 (all e_k . u >= 0), and is
//! nearer by more than the derived rounding bound: n . u / d > 1 / |p| + bound.
//!
//! **Candidates from the images.** The polygons seen by the nine pixels around each sample are tested first; in
//! straight images, only around some of the samples. Along a segment p(t) = a + t b both conditions are linear in t:
//! a polygon covers one interval of it, in closed form, and is tested once for all samples. The test is exact whatever
//! the images show; in a building it finds nearly all hidden samples.
//!
//! **Confirmation in space.** No image can prove that a sample is seen: nine rays may all miss an occluder under a
//! pixel. The index confirms the remaining samples. Tiles of the directions around the sensor share its queries
//! ([`tiles`]); single points have a ray each. Each polygon found gets the same test.
//!
//! **Strategies.** [`strategy`] tries functions of one signature: [`runs`] for segments, [`area`] and [`grid`] for
//! patches of many and few pixels, [`samples`] for the rest, and [`rays`] if one ray per sample is requested. They
//! share [`candidates`] (polygons that may hide a feature), [`polygon`] (polygons set up so far) and the tiles.
//!
//! The result equals that of one ray per sample ([`Visibility::Rays`]); images only save time. Comparing the point's
//! depth with the plane of its pixel's polygon would be wrong at silhouettes, where the polygon ends.

mod area;
mod candidates;
mod context;
mod contour;
mod grid;
mod marks;
mod polygon;
mod rays;
mod runs;
mod samples;
mod select;
mod sheet;
mod spans;
mod strategy;
mod surface;
mod tally;
mod tiles;
mod undecided;
mod windows;
mod worker;
pub(crate) mod workspaces;

use super::tree::{FeatureTree, check_placed, newest};
use super::{FeaturePrediction, Hidden, PlacedFeature, Reason, STEP, Vantage};
use context::VisibilityContext;
use glam::DVec3;
pub use marks::Marks;
use marks::Part;
use presight_model::contour::ContourSet;
use presight_model::error::Result;
use presight_model::geometry::Pose;
use presight_model::sensor::Sensor;
use presight_model::threads::parallel;
use presight_model::world::World;
use presight_render::plan::{IdScheme, Images};
use rayon::prelude::*;
use workspaces::IdleWorkspaces;

/// The method that decides visibility.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Visibility {
    /// Tests the polygons of neighbouring pixels; for the samples that these do not hide, queries the index in batches.
    #[default]
    Image,
    /// Casts a ray through the index for every sample. Slow; [`Visibility::Image`] is tested against it.
    Rays,
}

/// Settings for predicting features from existing images.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FeatureSettings {
    /// UTC seconds, for probabilities of existence. `None` means the newest confirmation of all features.
    pub time: Option<f64>,
    /// The numbering of `polygon_id` in the images.
    pub ids: IdScheme,
    /// Fill [`FeaturePrediction::feature_id`].
    pub feature_id: bool,
    /// Which results to return for features that are not seen.
    pub hidden: Hidden,
    /// The method that decides visibility.
    pub visibility: Visibility,
    /// Maximum length of a feature's image per sample, 0.001 pixels to [`STEP`]. Finer steps make visible fractions
    /// more precise and take longer. A patch that covers more than 1,024 pixels is sampled at its pixels. With
    /// [`Visibility::Rays`] a patch has up to 4,096 samples, and up to 64 times that number with finer steps.
    pub step: f64,
    /// A deadline left the images incomplete: pixels with NaN and id 0 hold no information. Large patches, which the
    /// images decide, are [`crate::Reason::NotPredicted`] there; the index decides the others as usual.
    pub is_partial: bool,
    /// Regions of interest will be computed: record where partly visible patches are seen.
    pub regions: bool,
}

impl Default for FeatureSettings {
    fn default() -> Self {
        Self {
            time: None,
            ids: IdScheme::default(),
            feature_id: false,
            hidden: Hidden::Full,
            visibility: Visibility::default(),
            step: STEP,
            is_partial: false,
            regions: false,
        }
    }
}

/// Predicts how much of each feature a sensor at a pose (body axes) sees, from the `polygon_id` image of the same
/// world, sensor and pose.
///
/// # Errors
/// [`presight_model::ErrorKind::Invalid`] if there is no `polygon_id` image of the sensor's size, a feature's object or
/// slot does not exist, or the sensor is a ray table with fewer than two rays; [`presight_model::ErrorKind::Usage`] for
/// a step out of its range; errors of [`Pose::check`] and [`presight_model::Threads::new`].
pub fn predict_features(
    world: &World,
    sensor: &Sensor,
    world_from_sensor: &Pose,
    images: &Images,
    placed: &[PlacedFeature],
    options: &FeatureSettings,
) -> Result<FeaturePrediction> {
    let vantage = Vantage { world, sensor, world_from_sensor };
    let prepared = PreparedFeatures::new(&vantage, images, placed, None, options)?;
    parallel(|| prepared.finish(None))
}

/// Features that were checked against a world and a sensor, ready to be predicted.
pub struct PreparedFeatures<'a> {
    /// `None` if there are no features.
    frame: Option<VisibilityContext<'a>>,
    images: &'a Images,
    placed: &'a [PlacedFeature],
    feature_id: bool,
    /// Indices of the features that are tested individually.
    some: Vec<usize>,
    /// Indices of the features that are out of view without a test, ascending, and the reasons.
    out_of_view: Vec<(u32, Reason)>,
    contours: Contours<'a>,
    workspaces: IdleWorkspaces,
}

/// The surfaces of contours.
enum Contours<'a> {
    Known(&'a ContourSet),
    Made(ContourSet),
}

impl Contours<'_> {
    fn set(&self) -> &ContourSet {
        match self {
            Self::Known(set) => set,
            Self::Made(set) => set,
        }
    }
}

/// Samples of a feature that only occlusion can still hide: positions (image frame) and nearest pixels (row-major).
pub(crate) type QuerySamples = Vec<(DVec3, u32)>;

/// Samples of features for a sensor, in the order of the features.
#[derive(Clone, Copy, Debug)]
pub struct FeatureSamples<'a> {
    /// By feature: positions (image frame) and nearest pixels (row-major).
    pub samples: &'a [Vec<(DVec3, u32)>],
    /// The features.
    pub placed: &'a [&'a PlacedFeature],
    /// The sensor.
    pub sensor: &'a Sensor,
}

/// The verdict of the nine pixels around a sample.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum OcclusionHint {
    /// The polygon in this slot hides the sample.
    Hidden(u32),
    /// A polygon covers the sample's ray and is not nearer, and no polygon next to it could be.
    Seen,
    /// The pixels do not decide.
    Doubt,
}

impl<'a> PreparedFeatures<'a> {
    /// Prepares features. Features given with a tree and with the surfaces of contours were already checked against the
    /// world.
    ///
    /// # Errors
    /// The errors of [`predict_features`].
    pub fn new(
        vantage: &Vantage<'a>,
        images: &'a Images,
        placed: &'a [PlacedFeature],
        known: Option<(&FeatureTree, &'a ContourSet)>,
        options: &FeatureSettings,
    ) -> Result<Self> {
        let Vantage { world, sensor, world_from_sensor } = *vantage;
        world_from_sensor.check()?;
        let none = Contours::Made(ContourSet::default());
        let (feature_id, some, out_of_view) = (options.feature_id, Vec::new(), Vec::new());
        let memory = known.map(|(tree, _)| tree.memory.clone());
        let workspaces = IdleWorkspaces::new(memory.unwrap_or_default());
        let prepared = Self { frame: None, images, placed, feature_id, some, out_of_view, contours: none, workspaces };
        if placed.is_empty() {
            return Ok(prepared);
        }
        let (mut made, mut contours) = (None, ContourSet::default());
        if known.is_none() {
            check_placed(world.environment(), placed)?;
            contours = ContourSet::new(world, &sensor.spec().class, placed)?;
            made = (options.hidden == Hidden::Count).then(|| FeatureTree::new(placed, &contours));
        }
        let (tree, known) = known.unzip();
        let tree = tree.or(made.as_ref());
        let newest = || tree.map_or_else(|| newest(placed), |tree| tree.newest);
        let time = options.time.unwrap_or_else(newest);
        let frame = VisibilityContext::new(world, sensor, world_from_sensor, images, time, options)?;
        let surfaces = known.unwrap_or(&contours);
        let (some, out_of_view) = match tree {
            Some(tree) if options.hidden == Hidden::Count => {
                let some = select::select(&frame, tree, placed, surfaces, &prepared.workspaces)?;
                (some.into_iter().map(|i| i as usize).collect(), Vec::new())
            }
            Some(tree) => {
                let reasons = select::out_of_view(&frame, tree, surfaces);
                let outside = (0..).zip(&reasons).filter_map(|(i, reason)| Some((i, (*reason)?)));
                ((0..placed.len()).filter(|i| reasons[*i].is_none()).collect(), outside.collect())
            }
            None => ((0..placed.len()).collect(), Vec::new()),
        };
        let contours = known.map_or(Contours::Made(contours), Contours::Known);
        Ok(Self { frame: Some(frame), some, out_of_view, contours, ..prepared })
    }

    /// By feature, the samples to look up in the images; for a device that still holds these.
    pub fn query_samples(&self) -> Vec<QuerySamples> {
        let Some(frame) = &self.frame else { return Vec::new() };
        self.some
            .par_iter()
            .with_min_len(BATCH)
            .map_init(|| self.workspaces.wake(frame), |awake, i| awake.worker().query_samples(&self.placed[*i]))
            .collect()
    }

    /// The features in the order of [`PreparedFeatures::query_samples`].
    pub fn asked(&self) -> impl Iterator<Item = &'a PlacedFeature> {
        self.some.iter().map(|i| &self.placed[*i])
    }

    /// Predicts all features. `hints` holds the slots that may hide the samples, in the order of
    /// [`PreparedFeatures::query_samples`]; without it the images are used.
    pub fn finish(mut self, hints: Option<&[Vec<Option<u32>>]>) -> FeaturePrediction {
        let mut marks = self.marks();
        let mut prediction = self.part(&self.some, hints, &mut marks);
        sort_as_given(&mut prediction);
        let is_each_once = self.contours.set().is_empty() && self.out_of_view.is_empty();
        if self.frame.as_ref().is_none_or(|frame| frame.options.hidden != Hidden::Count && is_each_once) {
            prediction.given = Vec::new();
        }
        prediction.out_of_view = std::mem::take(&mut self.out_of_view);
        prediction.stats.features = self.placed.len();
        prediction.feature_id = marks.into_image();
        prediction
    }

    /// Predicts the features with these indices, with their slots in `hints`, and records the pixels that they mark.
    pub fn part(&self, which: &[usize], hints: Option<&[Vec<Option<u32>>]>, marks: &mut Marks) -> FeaturePrediction {
        let mut prediction = FeaturePrediction::default();
        let Some(frame) = &self.frame else { return prediction };
        prediction.time = frame.time;
        let some = which.par_iter().enumerate().with_min_len(BATCH);
        let parts = some.fold(
            || (self.workspaces.wake(frame), Part::default()),
            |(mut awake, mut part), (at, number)| {
                let hints = hints.map(|hints| hints[at].as_slice());
                let placed = &self.placed[*number];
                match self.contours.set().get(*number) {
                    Some(surface) => {
                        let curves = awake.worker().contour(placed, surface);
                        curves.into_iter().for_each(|curve| part.take(*number, curve));
                    }
                    None if placed.feature.shape.is_contour() => {}
                    None => part.take(*number, awake.worker().feature(placed, hints)),
                }
                (awake, part)
            },
        );
        for mut part in parts.map(|(_, part)| part).collect::<Vec<Part>>() {
            prediction.features.append(&mut part.features);
            prediction.given.append(&mut part.given);
            prediction.stats.add(&part.stats);
            part.pixels.iter().for_each(|(number, pixels)| marks.add(&self.placed[*number].feature, pixels));
        }
        prediction
    }

    /// An image with no marks.
    pub fn marks(&self) -> Marks {
        let pixels = if self.feature_id { self.images.width as usize * self.images.height as usize } else { 0 };
        let distinct = self.frame.as_ref().map_or(self.images.width, |frame| frame.sensor.distinct_columns());
        Marks::new(pixels, [self.images.width, distinct].map(|columns| columns as usize))
    }

    /// Approximate lengths of the features' images, pixels. Only good for comparing features with each other.
    pub fn image_lengths(&self) -> Vec<f64> {
        let Some(frame) = &self.frame else { return Vec::new() };
        let one = |(number, placed): (usize, &PlacedFeature)| match self.contours.set().get(number) {
            Some(surface) => length_through(frame, &frame.in_image_of(&surface.hull, placed.object)),
            None => length_through(frame, &frame.in_image(placed).points),
        };
        self.placed.par_iter().enumerate().with_min_len(BATCH).map(one).collect()
    }
}

/// Restores the input order of the features; the curves of one feature keep theirs.
fn sort_as_given(prediction: &mut FeaturePrediction) {
    let given = &prediction.given;
    if given.is_sorted() {
        return;
    }
    let mut order: Vec<u32> = (0..given.len() as u32).collect();
    order.sort_by_key(|i| given[*i as usize]);
    let mut features: Vec<_> = std::mem::take(&mut prediction.features).into_iter().map(Some).collect();
    prediction.features = order.iter().filter_map(|i| features[*i as usize].take()).collect();
    prediction.given = order.iter().map(|i| given[*i as usize]).collect();
}

/// Approximate length of an outline's image, pixels. Parts outside the image do not count.
fn length_through(frame: &VisibilityContext<'_>, points: &[DVec3]) -> f64 {
    /// Pieces of each side.
    const PIECES: u32 = 8;
    let (sensor, turn) = (frame.sensor, frame.sensor.columns_of_a_turn());
    let (width, height) = (f64::from(sensor.width()), f64::from(sensor.height()));
    let place = |p: DVec3| {
        let inside = |(u, v): &(f64, f64)| (-0.5..=width - 0.5).contains(u) && (-0.5..=height - 0.5).contains(v);
        sensor.project(p).filter(inside)
    };
    let sides = if points.len() > 2 { points.len() } else { points.len().saturating_sub(1) };
    let mut length = 0.0;
    for side in 0..sides {
        let (from, to) = (points[side], points[(side + 1) % points.len()]);
        let mut last = place(from);
        for piece in 1..=PIECES {
            let next = place(from.lerp(to, f64::from(piece) / f64::from(PIECES)));
            if let (Some(a), Some(b)) = (last, next) {
                let across = (a.0 - b.0).abs();
                let across = turn.map_or(across, |turn| across.min(turn - across));
                length += across.hypot(a.1 - b.1);
            }
            last = next;
        }
    }
    length
}

/// Minimum number of features per parallel task.
const BATCH: usize = 32;
