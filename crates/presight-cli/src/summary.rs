//! One-line summaries of a prediction, as text and as JSON.

use presight::Prediction;
use presight::environment::Environment;
use presight::features::FeaturePrediction;
use serde_json::{Value, json};
use std::collections::HashSet;
use std::path::Path;

/// Counts over the images of a prediction.
pub struct Summary {
    /// The number of rays that hit, and the nearest and farthest range in metres; `None` without a range image.
    hits: Option<(usize, f32, f32)>,
    /// The number of objects seen, and of all objects; `None` without an object_id image.
    objects: Option<(usize, usize)>,
    features: Option<(usize, usize)>,
}

impl Summary {
    /// Counts the images and features of a prediction in which there are this many objects.
    pub fn of(prediction: &Prediction, objects: usize) -> Self {
        let images = &prediction.images;
        let seen = || images.range.iter().copied().filter(|r| r.is_finite());
        let (near, far) = seen().fold((f32::INFINITY, 0f32), |(lo, hi), r| (lo.min(r), hi.max(r)));
        // Neighbouring pixels mostly have the same id, so runs save lookups.
        let mut ids: HashSet<u32> = images.object_id.chunk_by(|a, b| a == b).map(|run| run[0]).collect();
        ids.remove(&0);
        Self {
            hits: (!images.range.is_empty()).then(|| (seen().count(), near, far)),
            objects: (!images.object_id.is_empty()).then_some((ids.len(), objects)),
            features: prediction.features.as_ref().map(|FeaturePrediction { features, stats, .. }| {
                (features.iter().filter(|f| !f.visible.is_empty()).count(), stats.features)
            }),
        }
    }

    /// The summary as text, without a line end.
    pub fn in_words(&self, prediction: &Prediction) -> String {
        let (sensor, pixels) = (&prediction.sensor, prediction.images.pixels());
        let mut parts = vec![format!("{} {} x {}", sensor.spec().name, sensor.width(), sensor.height())];
        parts.extend(self.hits.map(|(hits, near, far)| match hits {
            0 => "no ray hits".into(),
            _ => format!("{:.1} % of rays hit at {near:.3}..{far:.3} m", 100.0 * hits as f64 / pixels as f64),
        }));
        parts.extend(self.objects.map(|(seen, there)| format!("{seen} of {there} objects seen")));
        parts.extend(self.features.map(|(seen, all)| format!("{seen} of {all} features seen")));
        parts.extend(prediction.degradation().map(|given_up| given_up.summary()));
        parts.join(", ")
    }

    /// The summary as a JSON object (format 1). Values are null if they were not requested or do not exist.
    pub fn json(&self, scene: &Path, prediction: &Prediction, ms: f64, engine: &str) -> Value {
        let (sensor, pose) = (&prediction.sensor, prediction.pose.world_from_sensor());
        let hit = self.hits.filter(|(hits, ..)| *hits > 0);
        json!({
            "format": 1,
            "scene": scene.display().to_string(),
            "sensor": sensor.spec().name,
            "columns": sensor.width(),
            "rows": sensor.height(),
            "world_from_sensor": ([&pose.translation.to_array()[..], &pose.rotation.to_array()].concat()),
            "pixels_hit": self.hits.map(|(hits, ..)| hits),
            "nearest_m": hit.map(|(_, near, _)| near),
            "farthest_m": hit.map(|(.., far)| far),
            "objects_seen": self.objects.map(|(seen, _)| seen),
            "objects": self.objects.map(|(_, there)| there),
            "features_seen": self.features.map(|(seen, _)| seen),
            "features": self.features.map(|(_, all)| all),
            "given_up": prediction.degradation(),
            "prediction_ms": ms,
            "engine": engine,
        })
    }
}

/// Number of objects that are not deleted.
pub fn objects_in(environment: &Environment) -> usize {
    environment.objects().iter().filter(|o| !o.is_deleted()).count()
}
