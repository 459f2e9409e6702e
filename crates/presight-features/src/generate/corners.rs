//! Corners: points where edges of different directions meet.

use super::effort::{Effort, steps};
use super::line::Line;
use super::lines::{Nearness, index_of, query};
use super::soup::grown;
use glam::DVec3;
use presight_model::error::Result;
use presight_model::geometry::Aabb;
use presight_model::index::QueryResult;

/// Finds ends of lines at which another line leaves at an angle of at least `turn` (radians) from the line's direction
/// or its opposite. Returns each with the object of the first line there. Ends at the same place form one corner.
pub(super) fn corners(
    lines: &[Line],
    nearness: &Nearness<'_>,
    turn: f64,
    effort: &Effort<'_>,
) -> Result<Vec<(DVec3, u32)>> {
    let touch = 4.0 * nearness.touch;
    let index = index_of(lines);
    let (mut found, mut corners) = (QueryResult::default(), Vec::new());
    let straight = turn.cos();
    for (i, line) in lines.iter().enumerate() {
        for (k, p) in [line.start, line.end].into_iter().enumerate() {
            let mut directions: Vec<DVec3> = Vec::new();
            let (mut first, same) = (true, nearness.same(line.object, p));
            let near = query(&index, &grown(&Aabb::of([p]), touch), &mut found);
            let mut thing = effort.allowance(line.object);
            thing.spend(steps::FOUND * near.len(), || p)?;
            for &j in near {
                let other = &lines[j as usize];
                // Only the first end at this place makes a corner.
                let ends = [other.start, other.end];
                let earlier = |n: usize| ((j as usize), n) < (i, k) && ends[n].distance(p) <= same;
                first &= !earlier(0) && !earlier(1);
                if distance(other, p) <= touch {
                    directions.push(other.direction());
                }
            }
            // One pair of different directions is enough.
            for (n, a) in directions.iter().enumerate().filter(|_| first) {
                thing.spend(n, || p)?;
                if directions[..n].iter().any(|b| a.dot(*b).abs() < straight) {
                    corners.push((p, line.object));
                    break;
                }
            }
        }
    }
    Ok(corners)
}

fn distance(line: &Line, p: DVec3) -> f64 {
    let t = (p - line.start).dot(line.direction()).clamp(0.0, line.length());
    (line.start + line.direction() * t).distance(p)
}
