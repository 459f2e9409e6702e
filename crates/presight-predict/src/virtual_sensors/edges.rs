//! Edges: the visible parts of a layer's segments, in the image and in the world.

use presight_features::FeaturePrediction;
use presight_model::environment::FeatureShape;
use serde::Serialize;

/// The visible segments.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Edges {
    /// Segments with a visible part, in the order of the layer.
    pub edges: Vec<Edge>,
    /// Number of segments in the prediction, visible or not.
    pub segments: usize,
}

/// A segment that is visible at least in part.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Edge {
    /// Number in the layer.
    pub id: u32,
    /// Name in the layer.
    pub name: Option<String>,
    /// Visible share of the length in the image, inside image and range limits.
    pub visible_fraction: f64,
    /// Visible parts, from the first end to the second.
    pub visible: Vec<EdgePiece>,
}

/// A visible part of a segment.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct EdgePiece {
    /// Start and end as fractions of the segment's length in space, 0..=1.
    pub t: [f64; 2],
    /// Both ends in the image, column and row. The line between them is straight without lens distortion.
    pub pixels: [[f64; 2]; 2],
    /// Both ends in the world, metres.
    pub ends_world: [[f64; 3]; 2],
}

impl Edges {
    pub(super) fn summary(&self) -> String {
        let whole = self.edges.iter().filter(|e| e.visible_fraction == 1.0).count();
        format!("{} of {} segments are seen, {whole} of them whole", self.edges.len(), self.segments)
    }
}

pub(super) fn reduce(features: &FeaturePrediction) -> Edges {
    let mut found = Edges::default();
    for seen in &features.features {
        if !matches!(seen.feature.shape, FeatureShape::Segment { .. }) {
            continue;
        }
        found.segments += 1;
        let [a, b] = seen.points_world[..] else { continue };
        let piece = |t: [f64; 2], pixels: [glam::DVec2; 2]| EdgePiece {
            t,
            pixels: pixels.map(|p| p.to_array()),
            ends_world: t.map(|t| a.lerp(b, t).to_array()),
        };
        let visible: Vec<EdgePiece> = seen.visible.iter().map(|v| piece(v.t, v.pixels)).collect();
        if !visible.is_empty() {
            let (id, name) = (seen.feature.id, seen.feature.name.clone());
            found.edges.push(Edge { id, name, visible_fraction: seen.visible_fraction, visible });
        }
    }
    found
}
