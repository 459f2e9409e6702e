//! Handles tracks at the image border and at the seam of a panoramic image.

use super::motion::PointMotion;
use super::options::ImageExtent;
use super::track::Track;
use crate::matching::Shape;
use glam::DVec2;

pub(super) fn is_within(p: DVec2, image: &ImageExtent) -> bool {
    let inside = |x: f64, size: u32| x >= -0.5 && x <= f64::from(size) - 0.5;
    (image.turn.is_some() || inside(p.x, image.width)) && inside(p.y, image.height)
}

/// Copies the motions' positions into the shape, with columns wrapped into one turn.
pub(super) fn place(track: &mut Track, turn: Option<f64>) {
    let Track { shape, motions, .. } = track;
    if let Some(turn) = turn {
        let shift = -turn * ((motions[0].position.x + 0.5) / turn).floor();
        motions.iter_mut().for_each(|m| m.position.x += shift);
    }
    for (p, motion) in shape.points_mut().iter_mut().zip(motions) {
        *p = motion.position;
    }
}

/// Returns true if a track is still in the image. A segment that leaves is clipped: its end slides along the border.
pub(super) fn stay_within(track: &mut Track, image: &ImageExtent) -> bool {
    let Shape::Segment { .. } = &track.shape else { return is_within(track.shape.centre(), image) };
    let ends = [track.motions[0].position, track.motions[1].position];
    if ends.iter().all(|p| is_within(*p, image)) {
        return true;
    }
    let Some([from, to]) = part_within(ends, image) else { return false };
    let both = [track.motions[0], track.motions[1]];
    for (i, t) in [(0, from), (1, to)] {
        let is_moved = if i == 0 { t > 0.0 } else { t < 1.0 };
        if is_moved {
            let near = both[if t < 0.5 { 0 } else { 1 }];
            let mix = |a: DVec2, b: DVec2| a.lerp(b, t);
            track.motions[i] = PointMotion {
                position: mix(both[0].position, both[1].position),
                speed: mix(both[0].speed, both[1].speed),
                acceleration: mix(both[0].acceleration, both[1].acceleration),
                ..near
            };
            // The known flow belonged to the old end, not to the point on the border.
            track.flow = Default::default();
            if let Shape::Segment { corners, .. } = &mut track.shape {
                corners[i] = false;
            }
        }
    }
    place(track, image.turn);
    let Shape::Segment { ends, .. } = &track.shape else { return true };
    ends[0].distance(ends[1]) >= SHORTEST_PART
}

/// Shortest clipped segment that is still followed, pixels.
const SHORTEST_PART: f64 = 4.0;

/// Clips a segment to the image. Returns the start and end of the inner part as fractions of the segment.
fn part_within(ends: [DVec2; 2], image: &ImageExtent) -> Option<[f64; 2]> {
    let (mut from, mut to) = (0.0f64, 1.0f64);
    let d = ends[1] - ends[0];
    let sizes = [image.width, image.height];
    for axis in 0..2 {
        if axis == 0 && image.turn.is_some() {
            continue;
        }
        let (low, high) = (-0.5, f64::from(sizes[axis]) - 0.5);
        let at = |x: f64| (x - ends[0][axis]) / d[axis];
        if d[axis] == 0.0 {
            if !(low..=high).contains(&ends[0][axis]) {
                return None;
            }
            continue;
        }
        let (enter, leave) = if d[axis] > 0.0 { (at(low), at(high)) } else { (at(high), at(low)) };
        (from, to) = (from.max(enter), to.min(leave));
    }
    (from < to).then_some([from, to])
}
