//! Lines that continue each other become one; what two lines have in common belongs to one of them.

use super::soup::grown;
use super::wings::Line;
use crate::geometry::Aabb;
use crate::index::{Found, Params, Region, Skd, SpatialIndex};

/// Cosine of the largest angle of lines that are one, and of the largest of an angle that is none.
const PARALLEL: f64 = 0.999_847_695_156_391_2;

/// Joins collinear lines of one object that overlap or meet within `touch`. The longest give the directions; kinds
/// must agree if `kinds`.
pub(super) fn merged(lines: &[Line], touch: f64, kinds: bool) -> Vec<Line> {
    let index = index_of(lines);
    let mut order: Vec<u32> = (0..lines.len() as u32).collect();
    order.sort_by(|a, b| lines[*b as usize].length().total_cmp(&lines[*a as usize].length()).then(a.cmp(b)));
    let mut taken = vec![false; lines.len()];
    let (mut found, mut all) = (Found::default(), Vec::new());
    for seed in order {
        if std::mem::replace(&mut taken[seed as usize], true) {
            continue;
        }
        let line = &lines[seed as usize];
        let d = line.direction();
        let (mut from, mut to) = (0.0f64, line.length());
        // What is new at the ends is looked at, until nothing is.
        let mut ask = line.bounds();
        loop {
            query(&index, &grown(&ask, 2.0 * touch), &mut found);
            let before = (from, to);
            // More than once: one that joins at the far side of another one may come first.
            loop {
                let mut more = false;
                for &other in &found.ids {
                    let o = &lines[other as usize];
                    let fits = !taken[other as usize] && o.object == line.object && (!kinds || o.kind == line.kind);
                    let Some((a, b)) = fits.then(|| along(line, o, touch)).flatten() else { continue };
                    if a <= to + touch && b >= from - touch {
                        taken[other as usize] = true;
                        (from, to, more) = (from.min(a), to.max(b), true);
                    }
                }
                if !more {
                    break;
                }
            }
            if (from, to) == before {
                break;
            }
            ask = Aabb::of([line.start + d * from, line.start + d * to]);
        }
        all.push((seed, line.part(from, to)));
    }
    // In the order they came.
    all.sort_by_key(|(seed, _)| *seed);
    all.into_iter().map(|(_, line)| line).collect()
}

/// Where a collinear line begins and ends along another.
fn along(line: &Line, other: &Line, touch: f64) -> Option<(f64, f64)> {
    let d = line.direction();
    let (p, q) = (other.start - line.start, other.end - line.start);
    let (a, b) = (p.dot(d), q.dot(d));
    let near = (p - d * a).length() <= touch && (q - d * b).length() <= touch;
    let straight = (b - a).abs() >= PARALLEL * other.length();
    (near && straight).then_some((a.min(b), a.max(b)))
}

/// Takes from every line what an earlier one has already, whatever their objects; pieces shorter than `least` are
/// dropped.
pub(super) fn once(lines: &[Line], touch: f64, least: f64) -> Vec<Line> {
    let index = index_of(lines);
    let (mut found, mut all) = (Found::default(), Vec::new());
    for (i, line) in lines.iter().enumerate() {
        query(&index, &grown(&line.bounds(), 2.0 * touch), &mut found);
        let mut left: Vec<(f64, f64)> = vec![(0.0, line.length())];
        for &earlier in found.ids.iter().filter(|&&j| (j as usize) < i) {
            let Some((a, b)) = overlap(line, &lines[earlier as usize], touch) else { continue };
            left = left.into_iter().flat_map(|(from, to)| [(from, to.min(a)), (from.max(b), to)]).collect();
            left.retain(|(from, to)| to > from);
        }
        let whole = left.len() == 1 && left[0] == (0.0, line.length());
        if whole {
            all.push(*line);
        } else {
            all.extend(left.into_iter().filter(|(from, to)| to - from >= least).map(|(a, b)| line.part(a, b)));
        }
    }
    all
}

/// The part of a line that runs within `touch` of another.
fn overlap(line: &Line, other: &Line, touch: f64) -> Option<(f64, f64)> {
    let (d, length) = (line.direction(), line.length());
    if d.dot(other.direction()).abs() < PARALLEL {
        return None;
    }
    let t = |p: glam::DVec3| (p - line.start).dot(d);
    let (a, b) = (t(other.start), t(other.end));
    let (a, b) = (a.min(b).max(0.0), a.max(b).min(length));
    let e = other.direction();
    let apart = |t: f64| {
        let p = line.start + d * t - other.start;
        (p - e * p.dot(e)).length()
    };
    (b > a && apart(a) <= 2.0 * touch && apart(b) <= 2.0 * touch).then_some((a, b))
}

pub(super) fn index_of(lines: &[Line]) -> Skd<3> {
    let boxes: Vec<(u32, Aabb)> = (0..).zip(lines.iter().map(Line::bounds)).collect();
    Skd::build(Params::default(), &boxes)
}

/// Ids of what meets a box, rising, into `found.ids`.
pub(super) fn query(index: &Skd<3>, bounds: &Aabb, found: &mut Found) {
    found.clear();
    index.query(&Region::cuboid(bounds), found);
    let runs: Vec<u32> = found.runs.drain(..).flatten().collect();
    found.ids.extend(runs);
    found.ids.sort_unstable();
}
