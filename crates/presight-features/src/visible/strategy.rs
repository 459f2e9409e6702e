//! Types that all strategies share: the queried feature, and the memory that one worker keeps between features.
//!
//! Each strategy is a function of type [`Strategy`]. It decides the whole feature, or returns `None` so that the next
//! one is tried. No result depends on the contents of the [`Workspace`]; its polygons and tiles only save work.

use super::candidates::Candidates;
use super::polygon::PolygonCache;
use super::runs::SampledSegment;
use super::samples::Samples;
use super::surface::FeatureSurface;
use super::tally::Tally;
use super::tiles::Tiles;
use super::{Visibility, VisibilityContext, area, rays, runs, samples};
use crate::FeatureStats;
use glam::DVec3;
use presight_model::environment::FeatureShape;

/// Decides which parts of a feature are seen; `None` if the strategy does not support that feature.
pub(super) type Strategy = fn(&FeatureQuery<'_>, &mut Workspace) -> Option<Decision>;

/// Strategies in the order in which they are tried. The last one decides any feature.
const BY_IMAGE: [Strategy; 3] = [runs::decide, area::decide, samples::decide];

/// A feature whose visibility is to be decided.
pub(super) struct FeatureQuery<'q> {
    pub frame: &'q VisibilityContext<'q>,
    pub shape: &'q FeatureShape,
    /// Its points, image frame.
    pub points: &'q [DVec3],
    pub own: &'q FeatureSurface<'q>,
    /// The slots that may hide the undecided samples, in order. They replace the images.
    pub hints: Option<&'q [Option<u32>]>,
}

/// The result for a feature.
pub(super) struct Decision {
    pub tally: Tally,
    pub stats: FeatureStats,
}

/// Memory that one worker keeps between features.
pub(super) struct Workspace {
    pub polygons: PolygonCache,
    pub tiles: Tiles,
    pub candidates: Candidates,
    /// Memory for the results of [`Tiles::between`].
    pub near: Vec<u32>,
    /// Empty while in use, like `segment`.
    pub samples: Samples,
    pub segment: SampledSegment,
}

impl Workspace {
    pub fn new(frame: &VisibilityContext<'_>) -> Self {
        Self {
            polygons: PolygonCache::new(frame),
            tiles: Tiles::of_sensor(frame),
            candidates: Candidates::default(),
            near: Vec::new(),
            samples: Samples::default(),
            segment: SampledSegment::default(),
        }
    }

    /// Prepares for another prediction, reusing the memory.
    pub fn renew(&mut self, frame: &VisibilityContext<'_>) {
        self.polygons.renew(frame);
        self.tiles = Tiles::of_sensor(frame);
    }
}

/// Decides a feature by the first strategy that supports it.
pub(super) fn decide(query: &FeatureQuery<'_>, workspace: &mut Workspace) -> Decision {
    let decision = match query.frame.options.visibility {
        Visibility::Rays => rays::decide(query, workspace),
        Visibility::Image => BY_IMAGE.iter().find_map(|strategy| strategy(query, workspace)),
    };
    decision.unwrap_or_else(|| Decision { tally: Tally::default(), stats: FeatureStats::default() })
}
