//! The outputs: the table of the images that a prediction can deliver.

use presight_model::error::{Error, Result};
use presight_model::printable::did_you_mean;
use presight_model::sensor::Sensor;

/// An image that a prediction can deliver. [`Output::info`] is its row of the table.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Output {
    /// Euclidean distance along the ray, metres.
    Range,
    /// Planar distance along a camera's optical axis, metres (REP-118).
    DepthZ,
    /// The visible polygon; 0 without a hit.
    PolygonId,
    /// The visible object (index + 1); 0 without a hit.
    ObjectId,
    /// |cos| of the angle between ray and surface normal: the paper's reflection angle (section 3.2).
    CosIncidence,
    /// Strength of the echo: reflection factor of the surface's material times `cos_incidence`, without a range law
    /// (section 3.2). Computed from other images, see [`super::FramePlan::finish`].
    Echo,
    /// Unit normal of the visible polygon, on the sensor's side, in the sensor's body axes (x forward, y left, z up;
    /// also for cameras). Computed from other images, as [`Output::Echo`].
    Normal,
    /// The number of the visible feature; 0 without a feature. Derived from predicted features, not by an engine (see
    /// `features`).
    FeatureId,
}

/// The type of an image's pixels.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum SampleKind {
    /// One f32.
    Float,
    /// One u32; 0 stands for a missing value.
    Id,
    /// Three f32: x, y, z.
    Vector,
}

impl SampleKind {
    /// Number of 4-byte values in a pixel.
    pub const fn numbers(self) -> usize {
        match self {
            Self::Float | Self::Id => 1,
            Self::Vector => 3,
        }
    }
}

/// The component that makes an image.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Maker {
    /// The resolve stage of every engine.
    Engine,
    /// A step that all engines share, from the engines' images: [`super::FramePlan::finish`].
    Plan,
    /// The prediction of features.
    Features,
}

/// A row of the table of outputs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub struct OutputInfo {
    /// The output.
    pub output: Output,
    /// Its name in requests and files.
    pub name: &'static str,
    /// The type of its pixels.
    pub kind: SampleKind,
    /// Its unit: `m`, or `1` if dimensionless. Empty for ids.
    pub unit: &'static str,
    /// The frame of a vector image.
    pub frame: Option<&'static str>,
    /// True if only cameras have this image.
    pub cameras_only: bool,
    /// The component that makes the image.
    pub maker: Maker,
}

/// A row for an image that engines resolve for every sensor.
const fn resolved(output: Output, name: &'static str, kind: SampleKind, unit: &'static str) -> OutputInfo {
    OutputInfo { output, name, kind, unit, frame: None, cameras_only: false, maker: Maker::Engine }
}

/// In the order of [`Output`]; `feature_id` is last.
const TABLE: [OutputInfo; 8] = [
    resolved(Output::Range, "range", SampleKind::Float, "m"),
    OutputInfo { cameras_only: true, ..resolved(Output::DepthZ, "depth_z", SampleKind::Float, "m") },
    resolved(Output::PolygonId, "polygon_id", SampleKind::Id, ""),
    resolved(Output::ObjectId, "object_id", SampleKind::Id, ""),
    resolved(Output::CosIncidence, "cos_incidence", SampleKind::Float, "1"),
    OutputInfo { maker: Maker::Plan, ..resolved(Output::Echo, "echo", SampleKind::Float, "1") },
    OutputInfo {
        frame: Some("body"),
        maker: Maker::Plan,
        ..resolved(Output::Normal, "normal", SampleKind::Vector, "1")
    },
    OutputInfo { maker: Maker::Features, ..resolved(Output::FeatureId, "feature_id", SampleKind::Id, "") },
];

/// The first outputs of the table.
const fn first<const N: usize>() -> [Output; N] {
    let mut outputs = [Output::Range; N];
    let mut i = 0;
    while i < N {
        outputs[i] = TABLE[i].output;
        i += 1;
    }
    outputs
}

impl Output {
    /// All outputs except `feature_id`, which engines and the plan make.
    pub const ALL: [Self; TABLE.len() - 1] = first();

    /// All outputs, including `feature_id`.
    pub const WITH_FEATURES: [Self; TABLE.len()] = first();

    /// Its row of the table.
    #[doc(hidden)]
    pub const fn info(self) -> &'static OutputInfo {
        &TABLE[self as usize]
    }

    /// Its name in requests and files.
    pub const fn name(self) -> &'static str {
        self.info().name
    }

    /// Its unit: `m`, or `1` if dimensionless. Empty for ids.
    pub fn unit(self) -> &'static str {
        self.info().unit
    }

    /// True for images of ids (u32); the others hold f32.
    pub fn is_of_ids(self) -> bool {
        self.info().kind == SampleKind::Id
    }

    /// True if a prediction without features makes this image for such a sensor.
    pub fn is_made_for(self, sensor: &Sensor) -> bool {
        self.info().maker != Maker::Features && (!self.info().cameras_only || sensor.is_camera())
    }

    /// True for images in metres: `+inf` without a hit, `-inf` if it is too near.
    pub fn is_distance(self) -> bool {
        self.info().unit == "m"
    }

    /// The names of its channels in OpenEXR: its own, or one for each component of a vector, such as `v.x`.
    pub fn channels(self) -> Vec<String> {
        match self.info().kind {
            SampleKind::Float | SampleKind::Id => vec![self.name().to_owned()],
            SampleKind::Vector => ["x", "y", "z"].map(|axis| format!("{}.{axis}", self.name())).to_vec(),
        }
    }

    /// Returns the output with this name.
    pub fn named(name: &str) -> Option<Self> {
        Self::WITH_FEATURES.into_iter().find(|output| output.name() == name)
    }
}

impl std::str::FromStr for Output {
    type Err = Error;

    fn from_str(name: &str) -> Result<Self> {
        Self::named(name).ok_or_else(|| {
            let what = format!("unknown output {name:?}");
            match name {
                "depth" => Error::usage(what, "use depth_z (planar, cameras only) or range (along the ray)"),
                _ => {
                    let names = Self::WITH_FEATURES.map(Self::name);
                    Error::usage(what, format!("{}choose from {}", did_you_mean(name, names), names.join(", ")))
                }
            }
        })
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
pub struct Outputs(u16);

impl Outputs {
    /// All outputs except `feature_id`.
    pub const ALL: Self = Self::of(&Output::ALL);

    /// Creates a set of these outputs.
    pub const fn of(outputs: &[Output]) -> Self {
        let (mut bits, mut i) = (0, 0);
        while i < outputs.len() {
            bits |= 1 << outputs[i] as u16;
            i += 1;
        }
        Self(bits)
    }

    /// True if the set contains the output.
    pub fn has(self, output: Output) -> bool {
        self.0 & (1 << output as u16) != 0
    }

    /// The set with one more output.
    #[must_use]
    pub fn with(self, output: Output) -> Self {
        Self(self.0 | 1 << output as u16)
    }

    /// The set without one output.
    #[must_use]
    pub fn without(self, output: Output) -> Self {
        Self(self.0 & !(1 << output as u16))
    }

    /// Number of 4-byte values that a pixel has in all these images.
    pub fn numbers(self) -> usize {
        self.iter().map(|output| output.info().kind.numbers()).sum()
    }

    /// All outputs in the set, in the order of the table.
    pub fn iter(self) -> impl Iterator<Item = Output> {
        Output::WITH_FEATURES.into_iter().filter(move |o| self.has(*o))
    }
}

impl Default for Outputs {
    fn default() -> Self {
        Self::of(&[Output::Range, Output::PolygonId, Output::ObjectId, Output::CosIncidence])
    }
}

impl std::str::FromStr for Outputs {
    type Err = Error;

    fn from_str(list: &str) -> Result<Self> {
        let outputs: Vec<Output> = list.split(',').map(|word| word.trim().parse()).collect::<Result<_>>()?;
        Ok(Self::of(&outputs))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_table_is_in_the_order_of_the_outputs_and_names_each_once() {
        for (i, info) in TABLE.iter().enumerate() {
            assert_eq!(info.output as usize, i, "{}", info.name);
            assert_eq!(Output::named(info.name), Some(info.output));
            assert_eq!(info.kind == SampleKind::Vector, info.frame.is_some(), "{}", info.name);
            assert_eq!(info.kind == SampleKind::Id, info.unit.is_empty(), "{}", info.name);
            assert_eq!(info.maker == Maker::Features, i == Output::ALL.len(), "{}", info.name);
        }
    }
}
