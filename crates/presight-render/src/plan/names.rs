//! Names in statistics: enums in memory, which become words only when shown or written.

use super::Output;
use serde::{Serialize, Serializer};
use std::fmt;

/// Defines an enum of names that are written as words.
macro_rules! names {
    ($(#[$about:meta])* $name:ident { $($(#[$meaning:meta])* $variant:ident = $word:literal,)* }) => {
        presight_model::words! {
            $(#[$about])*
            #[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
            #[non_exhaustive]
            pub enum $name {
                $($(#[$meaning])* #[doc = concat!("`", $word, "`")] $variant = $word,)*
            }
        }

        impl Serialize for $name {
            fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
                serializer.serialize_str(self.name())
            }
        }
    };
}

names! {
    /// A stage of a prediction, or a variant of one that costs extra.
    StageName {
        Selection = "selection",
        Reference = "reference",
        Tiles = "tiles",
        Hidden = "hidden",
        SetupAndRasterization = "setup and rasterization",
        FirstWave = "first wave",
        Setup = "setup",
        Rasterization = "rasterization",
        Upload = "upload",
        DrawingOnDevice = "drawing on the device",
        Device = "device",
        Cull = "cull",
        Raster = "raster",
        HardwareRaster = "hardware rasterizer",
        ReuseOfLastFrame = "reuse of the last frame",
        CoarseDepth = "coarse depth",
        Resolve = "resolve",
        ResolveOnDevice = "resolve on the device",
        ResolveOnCpu = "resolve on the CPU",
        WeighOnDevice = "weigh on the device",
        Readback = "readback",
        Echo = "echo",
        Normal = "normal",
        FeaturesOnDevice = "features on the device",
        Features = "features",
        FeatureChoice = "choice of features",
        RegionsOnDevice = "regions of interest on the device",
        RegionsOfInterest = "regions of interest",
        RaysByTiles = "rays by tiles",
        RayTable = "ray table",
        MaterialTest = "material test per polygon",
        ReflectionFactor = "reflection factor per pixel",
        SecondRasterPass = "second raster pass",
        InstancesFromStorage = "instances from a storage buffer",
        RaysFromStorage = "rays from a storage buffer",
        SetupInF64 = "setup in f64",
    }
}

names! {
    /// A count in a prediction.
    CountName {
        PolygonsTested = "polygons tested",
        PolygonsSelected = "polygons selected",
        PolygonsInView = "polygons in view",
        /// Polygons of runs that are not hidden: their vertices were located among the samples.
        PolygonsPlaced = "polygons placed",
        /// Placed polygons that may cover a sample.
        PolygonsPassed = "polygons passed",
        /// Passed polygons that needed individual bounds, because their vertices did not decide.
        PolygonsBounded = "polygons bounded",
        PolygonsSetUp = "polygons set up",
        /// Single polygons hidden by earlier waves, on the GPU.
        PolygonsHidden = "polygons hidden",
        /// Polygons that lie between the sensor's rays.
        PolygonsBetweenSamples = "polygons between samples",
        /// Polygons that the hardware rasterizer drew; compute spans drew the others.
        PolygonsRendered = "polygons rendered",
        PolygonsSetUpInF64 = "polygons set up in f64",
        /// Polygons that an engine left out because it could not decide on which side of them the sensor is.
        PolygonsEdgeOn = "polygons edge-on",
        RunsSelected = "runs selected",
        /// Runs that are drawn first because the sensor's last frame showed them.
        RunsShownBefore = "runs shown before",
        RunsHidden = "runs hidden",
        Waves = "waves",
        /// Polygons that may be visible after the first wave, estimated if many were selected.
        PolygonsLeft = "polygons left after the first wave",
        /// Intervals of samples of a polygon on a line; for ray tables, tiles in which a polygon is drawn.
        Spans = "spans",
        SamplesTested = "samples tested",
        SamplesWritten = "samples written",
        WorkItems = "work items",
        Reruns = "reruns for room",
        HitsWithoutId = "internal errors: hits without id",
        /// Nodes of trees that tiles of rays opened.
        TreeNodes = "tree nodes",
        /// Blocks of eight triangles that tiles of rays tested.
        TriangleBlocks = "triangle blocks",
        /// Rays whose polygon the search left open.
        RaysInDoubt = "rays in doubt",
        SegmentsOfCut = "segments of the cut",
        SegmentsTested = "segments tested",
        /// Beams for which rounding could decide, so that an engine did.
        BeamsDecided = "beams decided by an engine",
        Features = "features",
        FeaturesQueried = "features asked",
        FeaturesNotChosen = "features not chosen",
        FeatureSamples = "feature samples",
        FeatureSamplesHiddenByNeighbours = "feature samples hidden by neighbours",
        FeatureSamplesHiddenInSpace = "feature samples hidden in space",
        FeatureSamplesVisible = "feature samples visible",
        FeatureSamplesUndecided = "feature samples undecided",
        FeatureSamplesInDoubt = "feature samples in doubt on the device",
        FeaturesOffPolygons = "features off their polygons",
        RegionsOnDevice = "regions of interest made on the device",
        LinearRegions = "linear regions",
        SetRegions = "regions as sets",
        WholeImages = "whole images",
    }
}

/// A part of the work that a prediction may not need.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum Part {
    /// A stage, or a variant of one.
    Stage(StageName),
    /// An image.
    Image(Output),
    /// This number of objects.
    Objects(usize),
    /// This number of polygons of objects in view.
    Polygons(usize),
}

impl From<StageName> for Part {
    fn from(stage: StageName) -> Self {
        Self::Stage(stage)
    }
}

impl fmt::Display for Part {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Stage(stage) => f.write_str(stage.name()),
            Self::Image(output) => write!(f, "{} image", output.name()),
            Self::Objects(n) => write!(f, "{n} objects"),
            Self::Polygons(n) => write!(f, "{n} polygons of objects in view"),
        }
    }
}

impl Serialize for Part {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_str(self)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_two_names_are_one_word() {
        let stages: std::collections::BTreeSet<_> = StageName::ALL.iter().map(|s| s.name()).collect();
        let counts: std::collections::BTreeSet<_> = CountName::ALL.iter().map(|c| c.name()).collect();
        assert_eq!((stages.len(), counts.len()), (StageName::ALL.len(), CountName::ALL.len()));
    }

    #[test]
    fn files_hold_words() {
        let parts = [Part::Stage(StageName::RayTable), Part::Image(Output::Echo), Part::Objects(3), Part::Polygons(2)];
        let json = serde_json::to_string(&(parts, CountName::Waves)).unwrap();
        let words = r#"[["ray table","echo image","3 objects","2 polygons of objects in view"],"waves"]"#;
        assert_eq!(json, words);
    }
}
