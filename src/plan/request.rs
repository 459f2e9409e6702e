//! Requests: which images a prediction makes.

use crate::environment::Object;
use crate::error::{Error, Result};

/// An image that a prediction can deliver.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Output {
    /// Euclidean distance along the ray, metres.
    Range,
    /// Planar distance along a camera's optical axis, metres (REP-118).
    DepthZ,
    /// The visible polygon; 0 is nothing.
    PolygonId,
    /// The visible object (index + 1); 0 is nothing.
    ObjectId,
    /// |cos| of the angle between ray and surface normal: the paper's reflection angle (section 3.2).
    CosIncidence,
    /// Strength of the echo: reflection factor of the surface's material times `cos_incidence`, without a range law
    /// (section 3.2). Computed from other images, see [`super::FramePlan::finish`].
    Echo,
    /// The visible feature, by its own number; 0 is none. Made from predicted features, not by an engine (see
    /// [`crate::features`]).
    FeatureId,
}

impl Output {
    /// All outputs that engines make.
    pub const ALL: [Self; 6] =
        [Self::Range, Self::DepthZ, Self::PolygonId, Self::ObjectId, Self::CosIncidence, Self::Echo];

    /// All outputs, including `feature_id`.
    pub const WITH_FEATURES: [Self; 7] =
        [Self::Range, Self::DepthZ, Self::PolygonId, Self::ObjectId, Self::CosIncidence, Self::Echo, Self::FeatureId];

    /// The channel name in files.
    pub fn name(self) -> &'static str {
        match self {
            Self::Range => "range",
            Self::DepthZ => "depth_z",
            Self::PolygonId => "polygon_id",
            Self::ObjectId => "object_id",
            Self::CosIncidence => "cos_incidence",
            Self::Echo => "echo",
            Self::FeatureId => "feature_id",
        }
    }
}

/// A set of [`Output`]s. The default is range, polygon_id, object_id and cos_incidence.
///
/// ```
/// use presight::{Output, Outputs};
/// let outputs: Outputs = "range,polygon_id".parse()?;
/// assert!(outputs.has(Output::Range) && !outputs.has(Output::CosIncidence));
/// # Ok::<(), presight::Error>(())
/// ```
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Outputs(u8);

impl Outputs {
    /// All outputs that engines make.
    pub const ALL: Self = Self(0b11_1111);

    /// The set of exactly these outputs.
    pub fn of(outputs: &[Output]) -> Self {
        Self(outputs.iter().fold(0, |bits, o| bits | 1 << *o as u8))
    }

    /// True if the set contains the output.
    pub fn has(self, output: Output) -> bool {
        self.0 & (1 << output as u8) != 0
    }

    /// The set with one more output.
    #[must_use]
    pub fn with(self, output: Output) -> Self {
        Self(self.0 | 1 << output as u8)
    }

    /// The set without one output.
    #[must_use]
    pub fn without(self, output: Output) -> Self {
        Self(self.0 & !(1 << output as u8))
    }

    /// All outputs in the set, in a fixed order.
    pub fn iter(self) -> impl Iterator<Item = Output> {
        Output::WITH_FEATURES.into_iter().filter(move |o| self.has(*o))
    }
}

impl Default for Outputs {
    fn default() -> Self {
        Self::ALL.without(Output::DepthZ).without(Output::Echo)
    }
}

impl std::str::FromStr for Outputs {
    type Err = Error;

    fn from_str(list: &str) -> Result<Self> {
        let names = Output::WITH_FEATURES.map(Output::name).join(", ");
        let mut outputs = Vec::new();
        for word in list.split(',').map(str::trim) {
            let found = Output::WITH_FEATURES.into_iter().find(|o| o.name() == word);
            let unknown = || {
                let what = format!("unknown output {word:?}");
                match word {
                    "depth" => Error::usage(what, "depth_z is planar, of cameras; range is along the ray"),
                    _ => Error::usage(what, format!("choose from {names}")),
                }
            };
            outputs.push(found.ok_or_else(unknown)?);
        }
        Ok(Self::of(&outputs))
    }
}

/// Which number `polygon_id` holds.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum IdScheme {
    /// Slot + 1.
    #[default]
    Model,
    /// Number of the source triangle + 1; for environments imported without merging.
    Source,
}

impl IdScheme {
    /// The `polygon_id` of a polygon of an object.
    pub fn id_of(self, object: &Object, polygon: u32) -> u32 {
        match self {
            Self::Model => object.first_slot + polygon + 1,
            Self::Source => object.first_source + object.mesh.source(polygon) + 1,
        }
    }
}

/// The images that a plan is made for.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct ImageRequest {
    /// The images to make; others cost nothing.
    pub outputs: Outputs,
    /// Which number `polygon_id` holds.
    pub ids: IdScheme,
}

impl From<Outputs> for ImageRequest {
    fn from(outputs: Outputs) -> Self {
        Self { outputs, ..Self::default() }
    }
}

impl From<&Self> for ImageRequest {
    fn from(request: &Self) -> Self {
        *request
    }
}
