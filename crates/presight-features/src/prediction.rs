//! Predicted features.

use super::PlacedFeature;
use super::roi::RoiFlag;
use glam::{DVec2, DVec3};
use presight_model::environment::{Environment, Feature};
use presight_render::plan::CountName;
use std::sync::Arc;

presight_model::words! {
    /// Why a part of a feature is hidden. If several reasons apply, the first in this order is given.
    #[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
    pub enum Reason {
        /// Behind a camera.
        BehindSensor = "behind_sensor",
        /// Outside the image; for a scanner with one row also above or below its beam.
        OutsideImage = "outside_image",
        /// Nearer than `range_min`.
        BelowRangeMin = "below_range_min",
        /// Farther than `range_max`.
        BeyondRangeMax = "beyond_range_max",
        /// All polygons on which it lies are invisible to the sensor's class.
        Material = "material",
        /// Seen from behind. Applies to landmarks, and to features that lie only on one-sided polygons.
        FacingAway = "facing_away",
        /// Seen at a larger angle of incidence than `max_incidence`.
        Oblique = "oblique",
        /// Behind another polygon.
        Occluded = "occluded",
        /// Covered by a polygon that is, within rounding, equally far away.
        Undecided = "undecided",
        /// Unknown: the pixels that would decide were given up for a deadline, and no other occluder was found.
        NotPredicted = "not_predicted",
    }
}

impl Reason {
    /// Returns true for parts outside the image or range limits. Visible shares do not include them.
    pub fn is_outside(self) -> bool {
        self <= Self::BeyondRangeMax
    }
}

/// A visible part of a feature.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct VisibleInterval {
    /// Start and end as fractions of the length in space, 0..=1, from the first defining point to the last. [0, 1] for
    /// a point. For a patch, shares of its area in the image: first the visible part, then the hidden parts by reason.
    pub t: [f64; 2],
    /// Pixel coordinates of both ends (column, row). For a patch, the bounding box of the visible part. Between the
    /// ends of a contour's part see [`super::image_path`].
    pub pixels: [DVec2; 2],
}

/// A hidden part of a feature.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct HiddenInterval {
    /// See [`VisibleInterval::t`].
    pub t: [f64; 2],
    /// The first reason that applies.
    pub reason: Reason,
    /// The polygon that hides it, for [`Reason::Occluded`].
    pub by: Option<Occluder>,
}

/// A polygon that hides a feature.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Occluder {
    /// Its slot.
    pub slot: u32,
    /// Its `polygon_id`.
    pub polygon_id: u32,
    /// Index of its object.
    pub object: u32,
}

/// Visibility of one feature from a sensor.
#[derive(Clone, Debug, PartialEq)]
pub struct SeenFeature {
    /// The feature from the layer.
    pub feature: Arc<Feature>,
    /// For a contour, the number of the curve. The longest curve of a surface in the image has number 0. The numbers
    /// are valid for this prediction only.
    pub branch: Option<u32>,
    /// Defining points in the world, metres. For a contour, the points of the curve; if closed, the first is repeated.
    pub points_world: Vec<DVec3>,
    /// Unit normal of its surface in the world, if the layer gives one.
    pub normal_world: Option<DVec3>,
    /// Visible share of the image length inside image and range limits. For patches a share of the area, for points 0
    /// or 1. 0 if the feature is outside these limits.
    pub visible_fraction: f64,
    /// The visible parts. Together with `hidden` they cover 0..=1.
    pub visible: Vec<VisibleInterval>,
    /// The hidden parts, with reasons.
    pub hidden: Vec<HiddenInterval>,
    /// Metres to the nearest visible sample.
    pub range: Option<f64>,
    /// |cos| of the angle between ray and surface normal there; for an edge, the largest over its visible surfaces.
    pub cos_incidence: Option<f64>,
    /// Probability that it exists at the time of the prediction.
    pub existence: f64,
    /// The region of interest: the pixel box in which the feature will be found, x0, y0, x1, y1.
    pub roi: Option<[f64; 4]>,
    /// The method by which the region was found.
    pub roi_flag: Option<RoiFlag>,
    /// 2 x 2 covariance in the image of every defining point, pixels squared. Present for visible features whose
    /// defining points all have an image; never for contours.
    pub image_covariance: Option<Vec<[[f64; 2]; 2]>>,
    /// Boxes in the image that together hold the visible part of a patch. Cleared when its region of interest has been
    /// computed.
    pub windows: Vec<[DVec2; 2]>,
}

impl SeenFeature {
    /// The pieces of a segment or curve between two fractions of its length, in the world.
    pub fn along(&self, t: [f64; 2]) -> Vec<[DVec3; 2]> {
        along(&self.points_world, t)
    }

    /// A feature without visible or hidden parts, with its probability of existence at a time (UTC seconds).
    pub(super) fn unseen(environment: &Environment, placed: &PlacedFeature, time: f64) -> Self {
        let feature = &placed.feature;
        let pose = placed.object.map(|o| environment.objects()[o as usize].world_from_object);
        let in_world = |p: &DVec3| pose.map_or(*p, |pose| pose.transform_point(*p));
        let normal = |n: DVec3| pose.map_or(n, |pose| pose.rotation * n).try_normalize();
        Self {
            points_world: feature.shape.points().iter().map(in_world).collect(),
            normal_world: feature.properties.normal.and_then(normal),
            visible_fraction: 0.0,
            visible: Vec::new(),
            hidden: Vec::new(),
            range: None,
            cos_incidence: None,
            existence: feature.existence.at(time),
            feature: feature.clone(),
            branch: None,
            roi: None,
            roi_flag: None,
            image_covariance: None,
            windows: Vec::new(),
        }
    }

    /// A feature that is fully visible. It must be given in the world's frame.
    pub fn whole(feature: &Feature) -> Self {
        Self {
            points_world: feature.shape.points().to_vec(),
            feature: Arc::new(feature.clone()),
            branch: None,
            normal_world: None,
            visible_fraction: 1.0,
            visible: vec![VisibleInterval { t: [0.0, 1.0], pixels: [DVec2::ZERO; 2] }],
            hidden: Vec::new(),
            range: None,
            cos_incidence: None,
            existence: 1.0,
            roi: None,
            roi_flag: None,
            image_covariance: None,
            windows: Vec::new(),
        }
    }
}

/// The pieces of a polyline between two fractions of its length, 0..=1.
pub fn along(points: &[DVec3], [from, to]: [f64; 2]) -> Vec<[DVec3; 2]> {
    if let [a, b] = *points {
        let at = |t: f64| a + t * (b - a);
        return vec![[at(from), at(to)]];
    }
    let whole: f64 = points.windows(2).map(|pair| pair[0].distance(pair[1])).sum();
    let (mut before, mut pieces) = (0.0, Vec::new());
    for pair in points.windows(2) {
        let length = pair[0].distance(pair[1]);
        let [from, to] = [from, to].map(|t| (t * whole - before) / length);
        let part = [from, to].map(|t| t.clamp(0.0, 1.0));
        // An interval of length 0 gives one point.
        if part[0] < part[1] || from == to && part == [from, to] && pieces.is_empty() {
            pieces.push(part.map(|t| pair[0].lerp(pair[1], t)));
        }
        before += length;
    }
    pieces
}

/// How visibility was decided.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct FeatureStats {
    /// Number of features of the sensor's class.
    pub features: usize,
    /// Features tested individually: possibly in view, and not hidden as a whole by one polygon.
    pub asked: usize,
    /// Samples tested for visibility. A fully visible or fully hidden segment adds one.
    pub samples: usize,
    /// Samples hidden by a polygon of the nine neighbouring pixels.
    pub hidden_by_neighbours: usize,
    /// Samples hidden by a polygon that the index found and the nine pixels missed.
    pub hidden_in_space: usize,
    /// Visible samples: the index found no polygon in between.
    pub visible: usize,
    /// Samples covered by a polygon of unknown range.
    pub undecided: usize,
}

impl FeatureStats {
    /// Adds the counts of another prediction.
    pub fn add(&mut self, other: &Self) {
        self.features += other.features;
        self.asked += other.asked;
        self.samples += other.samples;
        self.hidden_by_neighbours += other.hidden_by_neighbours;
        self.hidden_in_space += other.hidden_in_space;
        self.visible += other.visible;
        self.undecided += other.undecided;
    }

    /// The counts with their names in the statistics file.
    pub fn counts(&self) -> [(CountName, usize); 7] {
        [
            (CountName::Features, self.features),
            (CountName::FeaturesQueried, self.asked),
            (CountName::FeatureSamples, self.samples),
            (CountName::FeatureSamplesHiddenByNeighbours, self.hidden_by_neighbours),
            (CountName::FeatureSamplesHiddenInSpace, self.hidden_in_space),
            (CountName::FeatureSamplesVisible, self.visible),
            (CountName::FeatureSamplesUndecided, self.undecided),
        ]
    }
}

/// The features in a sensor's view, with their visible parts.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct FeaturePrediction {
    /// The features in the given order; with [`super::Hidden::Count`] only the visible ones.
    pub features: Vec<SeenFeature>,
    /// For each entry of `features`, its index among the given features; all curves of a contour have the same index.
    /// Empty if `features` has every given feature once.
    pub given: Vec<u32>,
    /// The number of the feature in each pixel, row-major; 0 for none. Empty unless requested. Each sample marks one
    /// pixel. Points and landmarks win over segments, then contours, then patches; then lower numbers win.
    pub feature_id: Vec<u32>,
    /// How visibility was decided.
    #[doc(hidden)]
    pub stats: FeatureStats,
    /// With [`super::Hidden::Full`] and [`super::Hidden::Reason`], indices of the given features that are entirely out
    /// of view, in ascending order with reasons. `features` has no entries for them before
    /// [`FeaturePrediction::spell_out`].
    pub out_of_view: Vec<(u32, Reason)>,
    /// Time of the probabilities of existence, UTC seconds.
    pub time: f64,
}

impl FeaturePrediction {
    /// Moves the features of `out_of_view` to `features`, as in files. `placed` are the given features. Some may be
    /// missing in the prediction ([`super::FeatureOptions::max_features`]).
    ///
    /// ```
    /// # std::env::set_current_dir(concat!(env!("CARGO_MANIFEST_DIR"), "/../..")).unwrap();
    /// use presight::features::{FeatureOptions, Hidden, PlacedFeatures};
    /// use presight::{Backend, Options, Output, Outputs, Predictor, Request, Scene, SensorPose};
    /// # use presight::features::{GenerateOptions, generate};
    /// # use presight::features::place;
    /// let scene = Scene::open("scenes/room.glb")?;
    /// let layer = generate(scene.world.environment(), "video", &GenerateOptions::default())?.layer;
    /// let placed = PlacedFeatures::from(place(&scene.world, &layer)?);
    /// let options = FeatureOptions::default().with_placed(placed.clone()).with_hidden(Hidden::Full);
    /// let request = Request::of(Outputs::of(&[Output::PolygonId])).with_features(options);
    /// let camera = presight::preset("video-camera")?;
    /// let away = SensorPose::from_xyz_rpy(100.0 * glam::DVec3::X, 0.0, 0.0, 0.0);
    /// let mut predictor = Predictor::new(Options::new(Backend::Cpu).with_threads(1))?;
    /// let mut seen = predictor.predict(&scene.world, &camera, &away, &request)?.features.unwrap();
    /// seen.spell_out(scene.world.environment(), &placed.features);
    /// assert!(seen.out_of_view.is_empty());
    /// assert_eq!(seen.features[0].hidden[0].reason.name(), "behind_sensor");
    /// # Ok::<(), presight::Error>(())
    /// ```
    pub fn spell_out(&mut self, environment: &Environment, placed: &[PlacedFeature]) {
        if self.out_of_view.is_empty() {
            return;
        }
        let hidden = |reason| vec![HiddenInterval { t: [0.0, 1.0], reason, by: None }];
        let unseen = |(number, reason): (u32, Reason)| {
            let unseen = SeenFeature::unseen(environment, &placed[number as usize], self.time);
            (number, SeenFeature { hidden: hidden(reason), ..unseen })
        };
        let mut all: Vec<(u32, SeenFeature)> = std::mem::take(&mut self.out_of_view).into_iter().map(unseen).collect();
        let looked_at = std::mem::take(&mut self.given).into_iter().zip(std::mem::take(&mut self.features));
        all.extend(looked_at);
        // The sort is stable, so the curves of a contour stay in order.
        all.sort_by_key(|(number, _)| *number);
        (self.given, self.features) = all.into_iter().unzip();
        if self.given.iter().copied().eq(0..placed.len() as u32) {
            self.given = Vec::new();
        }
    }

    /// Index of an entry of `features` among the given features.
    pub fn given_at(&self, index: usize) -> usize {
        given_at(&self.given, index)
    }
}

pub(super) fn given_at(given: &[u32], index: usize) -> usize {
    given.get(index).map_or(index, |number| *number as usize)
}

#[cfg(test)]
mod tests {
    use super::along;
    use glam::DVec3;

    #[test]
    fn parts_of_curves_are_told_by_length() {
        // 1 m along x, then 3 m along y.
        let points = [DVec3::ZERO, DVec3::X, DVec3::new(1.0, 3.0, 0.0)];
        let [first, second] = [[DVec3::X * 0.5, DVec3::X], [DVec3::X, DVec3::new(1.0, 1.0, 0.0)]];
        assert_eq!(along(&points, [0.125, 0.5]), [first, second]);
        assert_eq!(along(&points, [0.25, 0.5]), [second]);
        assert_eq!(along(&points, [0.5, 0.5]), [[second[1]; 2]]);
        assert_eq!(along(&points[..2], [0.5, 1.0]), [first]);
    }
}
