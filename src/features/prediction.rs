//! What is predicted of features.

use crate::environment::Feature;
use glam::{DVec2, DVec3};

/// Why a part of a feature is not seen: the first that applies, in this order.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Reason {
    /// Behind a camera.
    BehindSensor,
    /// The image does not reach there; for a scanner of one row also above or below its beam.
    OutsideImage,
    /// Nearer than the sensor can measure.
    BelowRangeMin,
    /// Farther than the sensor can measure.
    BeyondRangeMax,
    /// Everything it lies on is invisible to the sensor's class.
    Material,
    /// Seen from behind: a landmark, or a feature of one-sided polygons only.
    FacingAway,
    /// Seen at a flatter angle than the sensor extracts features at (`max_incidence`).
    Oblique,
    /// Behind another polygon.
    Occluded,
    /// A polygon covers it whose distance is not known better than to rounding.
    Undecided,
}

impl Reason {
    /// Every reason, in order.
    pub const ALL: [Self; 9] = [
        Self::BehindSensor,
        Self::OutsideImage,
        Self::BelowRangeMin,
        Self::BeyondRangeMax,
        Self::Material,
        Self::FacingAway,
        Self::Oblique,
        Self::Occluded,
        Self::Undecided,
    ];

    /// As files name it.
    pub fn name(self) -> &'static str {
        match self {
            Self::BehindSensor => "behind_sensor",
            Self::OutsideImage => "outside_image",
            Self::BelowRangeMin => "below_range_min",
            Self::BeyondRangeMax => "beyond_range_max",
            Self::Material => "material",
            Self::FacingAway => "facing_away",
            Self::Oblique => "oblique",
            Self::Occluded => "occluded",
            Self::Undecided => "undecided",
        }
    }

    /// Not in the part of the image that visible shares refer to.
    pub fn is_outside(self) -> bool {
        self <= Self::BeyondRangeMax
    }
}

/// A part of a feature that is seen.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct VisibleInterval {
    /// 0..=1 by length in space from the first defining point to the second. A point is [0, 1]. For a patch, shares of
    /// its area in the image: first what is seen, then the hidden parts by reason.
    pub t: [f64; 2],
    /// Pixel coordinates of both ends (column, row); for a patch, least and greatest of what is seen.
    pub pixels: [DVec2; 2],
}

/// A part of a feature that is not seen.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct HiddenInterval {
    /// As [`VisibleInterval::t`].
    pub t: [f64; 2],
    /// The first reason that applies.
    pub reason: Reason,
    /// What hides it, for [`Reason::Occluded`].
    pub by: Option<Occluder>,
}

/// A polygon that hides something.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Occluder {
    /// Its slot.
    pub slot: u32,
    /// Its number as images show it.
    pub polygon_id: u32,
    /// Index of its object.
    pub object: u32,
}

/// One feature as a sensor sees it.
#[derive(Clone, Debug, PartialEq)]
pub struct SeenFeature {
    /// As the layer has it.
    pub feature: Feature,
    /// Its defining points in the world, metres.
    pub points_world: Vec<DVec3>,
    /// Unit normal of its surface in the world, if the layer gives one.
    pub normal_world: Option<DVec3>,
    /// Share of the image length inside image and range limits that is seen; of the area for patches, 0 or 1 for points.
    /// 0 where nothing is inside.
    pub visible_fraction: f64,
    /// What is seen; with `hidden` it is all of 0..=1.
    pub visible: Vec<VisibleInterval>,
    /// What is not, and why.
    pub hidden: Vec<HiddenInterval>,
    /// Metres to the nearest visible sample.
    pub range: Option<f64>,
    /// |cos| of the angle between ray and surface there; of the surfaces of an edge the one seen most directly.
    pub cos_incidence: Option<f64>,
    /// Probability that it exists at the time of the prediction.
    pub existence: f64,
    /// Pixels in which it will be found: x0, y0, x1, y1.
    pub roi: Option<[f64; 4]>,
    /// How the region was found: `linear`, `set` or `whole_image`.
    pub roi_flag: Option<&'static str>,
    /// 2 x 2 covariance in the image of every defining point, pixels squared; of what is seen, as the region is, and where
    /// every defining point has an image.
    pub image_covariance: Option<Vec<[[f64; 2]; 2]>>,
}

impl SeenFeature {
    /// A feature as if all of it were seen, its frame the world's and nothing else known: for what follows from being seen.
    pub fn whole(feature: &Feature) -> Self {
        Self {
            points_world: feature.shape.points().to_vec(),
            feature: feature.clone(),
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
        }
    }
}

/// How visibility was decided.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct FeatureStats {
    /// Features of the sensor's class.
    pub features: usize,
    /// Samples that reached the test of visibility.
    pub samples: usize,
    /// Hidden by a polygon of the nine neighbouring pixels.
    pub hidden_by_neighbours: usize,
    /// Hidden by another that the nine pixels missed, found by asking the index.
    pub hidden_in_space: usize,
    /// Visible: the index has nothing in between.
    pub visible: usize,
    /// Covered by a polygon whose range is not known.
    pub undecided: usize,
}

impl FeatureStats {
    /// Sums.
    pub fn add(&mut self, other: &Self) {
        self.features += other.features;
        self.samples += other.samples;
        self.hidden_by_neighbours += other.hidden_by_neighbours;
        self.hidden_in_space += other.hidden_in_space;
        self.visible += other.visible;
        self.undecided += other.undecided;
    }

    /// Names and counts, as statistics have them.
    pub fn counts(&self) -> [(&'static str, usize); 6] {
        [
            ("features", self.features),
            ("feature samples", self.samples),
            ("feature samples hidden by neighbours", self.hidden_by_neighbours),
            ("feature samples hidden in space", self.hidden_in_space),
            ("feature samples visible", self.visible),
            ("feature samples undecided", self.undecided),
        ]
    }
}

/// What a sensor sees of features.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct FeaturePrediction {
    /// In the order they were given.
    pub features: Vec<SeenFeature>,
    /// The feature's number by pixel, row-major, 0 is none; empty unless asked for. One pixel a sample; points and
    /// landmarks over segments over patches, lower numbers first.
    pub feature_id: Vec<u32>,
    /// How visibility was decided.
    pub stats: FeatureStats,
}
