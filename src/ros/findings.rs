//! Findings as markers.

use super::{MarkerKind, MessageOrigin, Record, SceneMarker};
use glam::DVec3;
use presight_model::environment::Environment;
use presight_update::{Finding, FindingKind, SiteFindings};

/// The findings on `/presight/findings`: boxes with their sentences, red around objects that are gone, blue around moved
/// objects, with an arrow, green around new objects, and yellow around doubtful ones.
pub fn findings(findings: &SiteFindings, environment: &Environment, origin: &MessageOrigin) -> Record {
    origin.markers("/presight/findings", &origin.map, markers(findings, environment))
}

const RED: [f32; 4] = [0.9, 0.1, 0.1, 1.0];
const BLUE: [f32; 4] = [0.2, 0.5, 1.0, 1.0];
const GREEN: [f32; 4] = [0.1, 0.8, 0.2, 1.0];
const YELLOW: [f32; 4] = [1.0, 0.85, 0.1, 1.0];

fn markers(findings: &SiteFindings, environment: &Environment) -> Vec<SceneMarker> {
    let found = findings.changes.iter().flat_map(|f| of_finding(f, &f.corners(environment)));
    let doubts = findings.doubts.iter().flat_map(|doubt| {
        let sentence = format!("doubtful: {}: {}", doubt.object, doubt.why);
        boxed("doubtful", YELLOW, &doubt.corners(environment), sentence)
    });
    found.chain(doubts).collect()
}

fn of_finding(finding: &Finding, corners: &[DVec3]) -> Vec<SceneMarker> {
    let (name, color) = match finding.kind {
        FindingKind::Gone => ("gone", RED),
        FindingKind::Part(_) => ("part gone", RED),
        FindingKind::Moved { .. } => ("moved", BLUE),
        FindingKind::New(_) | FindingKind::Recognized(_) => ("new", GREEN),
        FindingKind::SeenThrough(_) => ("seen through", BLUE),
        FindingKind::ComesAndGoes => ("comes and goes", YELLOW),
    };
    let mut markers = boxed(name, color, corners, finding.to_string());
    if let [from, to] = corners.chunks(CORNERS).map(centre).collect::<Vec<_>>()[..] {
        let mut arrow = SceneMarker::new(MarkerKind::Arrow, name, color);
        // Diameters of shaft and head, and the length of the head, metres.
        (arrow.scale, arrow.points) = ([0.03, 0.08, 0.12], vec![from.to_array(), to.to_array()]);
        markers.push(arrow);
    }
    markers
}

/// Corners of a box.
const CORNERS: usize = 8;
/// Height of a capital letter, metres: legible where a whole room is in view.
const LETTER: f64 = 0.15;

/// The edges of boxes, and a sentence above the last one; nothing without a box.
fn boxed(name: &str, color: [f32; 4], corners: &[DVec3], sentence: String) -> Vec<SceneMarker> {
    let Some(last) = corners.chunks_exact(CORNERS).last() else { return Vec::new() };
    // The bits of a corner's number are its sides, so an edge joins two numbers that differ in one bit.
    let ends = (0..CORNERS).flat_map(|k| [1, 2, 4].map(|bit| (k, k | bit))).filter(|(a, b)| a != b);
    let ends: Vec<(usize, usize)> = ends.collect();
    let edges = corners.chunks_exact(CORNERS).flat_map(|b| ends.iter().flat_map(|(i, k)| [b[*i], b[*k]]));
    let mut text = SceneMarker::new(MarkerKind::Text, name, color);
    text.pose.translation = centre(last).with_z(last.iter().map(|p| p.z).fold(f64::MIN, f64::max) + LETTER);
    (text.scale, text.text) = ([0.0, 0.0, LETTER], sentence);
    vec![SceneMarker::lines(name, color, edges.map(|p| p.to_array())), text]
}

fn centre(corners: &[DVec3]) -> DVec3 {
    corners.iter().sum::<DVec3>() / corners.len().max(1) as f64
}

#[cfg(test)]
mod tests {
    use super::*;

    /// By hand: a cube has 12 edges of its side.
    #[test]
    fn a_box_has_twelve_edges() {
        let corners: Vec<DVec3> =
            (0..8).map(|k| DVec3::new(f64::from(k & 1), f64::from(k >> 1 & 1), f64::from(k >> 2))).collect();
        let markers = boxed("new", GREEN, &corners, "new: a box".into());
        let points: Vec<DVec3> = markers[0].points.iter().map(|p| DVec3::from(*p)).collect();
        assert_eq!(points.len(), 24);
        assert!(points.chunks(2).all(|edge| edge[0].distance(edge[1]) == 1.0));
        assert_eq!(markers[1].pose.translation, DVec3::new(0.5, 0.5, 1.0 + LETTER));
    }
}
