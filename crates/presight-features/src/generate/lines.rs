//! Joins collinear lines, and removes overlaps between lines.
//!
//! Lines side by side are one line only within rounding. A face lies on one of them and hides the other as soon as they
//! are farther apart, so both are kept.

use super::effort::{Effort, Steps, steps};
use super::line::{Line, boxes_along};
use glam::DVec3;
use presight_model::environment::Environment;
use presight_model::error::Result;
use presight_model::geometry::Aabb;
use presight_model::index::{Params, QueryResult, Region, Skd, SpatialIndex};
use presight_model::place;
use rayon::prelude::*;
use std::collections::BTreeMap;

/// Cosine of one degree, the largest angle between lines that are joined.
const PARALLEL: f64 = 0.999_847_695_156_391_2;

/// Distances within which parts touch, and within which lines coincide.
pub(super) struct Nearness<'a> {
    pub environment: &'a Environment,
    /// Maximum distance between touching parts, metres.
    pub touch: f64,
}

impl Nearness<'_> {
    /// Distance from a point of an object (world) within which everything lies on the polygons at the point, metres.
    pub fn same(&self, object: u32, p: DVec3) -> f64 {
        place::rounding_at(&self.environment.objects()[object as usize], p)
    }

    fn same_along(&self, line: &Line) -> f64 {
        self.same(line.object, line.start).max(self.same(line.object, line.end))
    }
}

/// Joins collinear lines of one object that lie on each other or continue each other within `touch`. The longest line
/// gives the direction. If `kinds` is set, only lines of one kind are joined. The result is sorted by object, then in
/// input order.
pub(super) fn merged(lines: &[Line], near: &Nearness<'_>, kinds: bool, effort: &Effort<'_>) -> Result<Vec<Line>> {
    let mut by_object: BTreeMap<u32, Vec<Line>> = BTreeMap::new();
    for line in lines {
        by_object.entry(line.object).or_default().push(*line);
    }
    let groups: Vec<Vec<Line>> = by_object.into_values().collect();
    let stage = effort.stage("lines", lines.len());
    let merge = |group: &Vec<Line>| merged_of_object(group, near, kinds, effort, &stage);
    let merged: Vec<Vec<Line>> = groups.par_iter().map(merge).collect::<Result<_>>()?;
    Ok(merged.into_iter().flatten().collect())
}

fn merged_of_object(
    lines: &[Line],
    nearness: &Nearness<'_>,
    kinds: bool,
    effort: &Effort<'_>,
    stage: &Steps<'_>,
) -> Result<Vec<Line>> {
    let touch = nearness.touch;
    let index = index_of(lines);
    let mut order: Vec<u32> = (0..lines.len() as u32).collect();
    order.sort_by(|a, b| lines[*b as usize].length().total_cmp(&lines[*a as usize].length()).then(a.cmp(b)));
    let mut taken = vec![false; lines.len()];
    let (mut found, mut near, mut all) = (QueryResult::default(), Vec::new(), Vec::new());
    for seed in order {
        stage.step();
        if std::mem::replace(&mut taken[seed as usize], true) {
            continue;
        }
        let line = &lines[seed as usize];
        let same = nearness.same_along(line);
        let mut thing = effort.allowance(line.object);
        let (mut from, mut to) = (0.0f64, line.length());
        // Parts still to search along: first the whole line, then extensions at its ends.
        let mut parts = vec![(from, to)];
        near.clear();
        loop {
            for (a, b) in parts.drain(..) {
                let ids = query_along(&index, &line.part(a, b), 2.0 * touch, &mut found);
                thing.spend(steps::FOUND * ids.len(), || line.start)?;
                near.extend(ids.iter().filter(|&&o| !taken[o as usize]).filter_map(|&o| {
                    let other = &lines[o as usize];
                    let fits = !kinds || other.kind == line.kind;
                    Some((o, fits.then(|| along(line, other, touch)).flatten()?))
                }));
            }
            thing.spend(steps::FOUND * near.len(), || line.start)?;
            let before = (from, to, near.len());
            // Whatever lies on the line comes first: it decides where the line ends.
            for max_off in [same, touch] {
                near.retain(|(o, part)| {
                    let common = part.to.min(to) - part.from.max(from);
                    let joins = common >= -touch && part.off <= if common > touch { same } else { max_off };
                    if joins {
                        taken[*o as usize] = true;
                        (from, to) = (from.min(part.from), to.max(part.to));
                    }
                    !joins
                });
                if near.len() < before.2 {
                    break;
                }
            }
            // Repeat while a line joins, because a farther line may come before the one that connects it.
            if near.len() == before.2 {
                break;
            }
            parts.extend([(from, before.0), (before.1, to)].into_iter().filter(|(a, b)| a < b));
        }
        all.push((seed, line.part(from, to)));
    }
    all.sort_by_key(|(seed, _)| *seed);
    Ok(all.into_iter().map(|(_, line)| line).collect())
}

/// Ids of the lines near a line, sorted, without duplicates.
fn query_along<'a>(index: &Skd<3>, line: &Line, margin: f64, found: &'a mut QueryResult) -> &'a [u32] {
    found.clear();
    for bounds in boxes_along(line, margin) {
        index.query(&Region::cuboid(&bounds), found);
    }
    sorted(found)
}

fn sorted(found: &mut QueryResult) -> &[u32] {
    let runs: Vec<u32> = found.runs.drain(..).flatten().collect();
    found.ids.extend(runs);
    found.ids.sort_unstable();
    found.ids.dedup();
    &found.ids
}

/// A line along another.
struct Along {
    from: f64,
    to: f64,
    /// Maximum distance between the two, metres.
    off: f64,
}

fn along(line: &Line, other: &Line, touch: f64) -> Option<Along> {
    let d = line.direction();
    let (p, q) = (other.start - line.start, other.end - line.start);
    let (a, b) = (p.dot(d), q.dot(d));
    let off = (p - d * a).length().max((q - d * b).length());
    let straight = (b - a).abs() >= PARALLEL * other.length();
    (off <= touch && straight).then_some(Along { from: a.min(b), to: a.max(b), off })
}

/// Removes from every line the parts covered by an earlier line of any object. Pieces shorter than `least` are dropped.
pub(super) fn once(lines: &[Line], near: &Nearness<'_>, least: f64, effort: &Effort<'_>) -> Result<Vec<Line>> {
    let index = index_of(lines);
    let (mut found, mut all) = (QueryResult::default(), Vec::new());
    for (i, line) in lines.iter().enumerate() {
        let same = near.same_along(line);
        let others = query_along(&index, line, 2.0 * same, &mut found);
        let mut thing = effort.allowance(line.object);
        thing.spend(steps::FOUND * others.len(), || line.start)?;
        let mut left: Vec<(f64, f64)> = vec![(0.0, line.length())];
        for &earlier in others.iter().filter(|&&j| (j as usize) < i) {
            let Some((a, b)) = overlap(line, &lines[earlier as usize], same) else { continue };
            left = left.into_iter().flat_map(|(from, to)| [(from, to.min(a)), (from.max(b), to)]).collect();
            left.retain(|(from, to)| to > from);
            thing.spend(steps::FOUND * left.len(), || line.start)?;
        }
        let whole = left.len() == 1 && left[0] == (0.0, line.length());
        if whole {
            all.push(*line);
        } else {
            all.extend(left.into_iter().filter(|(from, to)| to - from >= least).map(|(a, b)| line.part(a, b)));
        }
    }
    Ok(all)
}

/// The part of a line along another one that is the same.
fn overlap(line: &Line, other: &Line, same: f64) -> Option<(f64, f64)> {
    let (d, length) = (line.direction(), line.length());
    if d.dot(other.direction()).abs() < PARALLEL {
        return None;
    }
    let t = |p: DVec3| (p - line.start).dot(d);
    let (a, b) = (t(other.start), t(other.end));
    let (a, b) = (a.min(b).max(0.0), a.max(b).min(length));
    let e = other.direction();
    let apart = |t: f64| {
        let p = line.start + d * t - other.start;
        (p - e * p.dot(e)).length()
    };
    (b > a && apart(a) <= same && apart(b) <= same).then_some((a, b))
}

pub(super) fn index_of(lines: &[Line]) -> Skd<3> {
    let boxes: Vec<(u32, Aabb)> = (0..).zip(lines.iter().map(Line::bounds)).collect();
    Skd::build(Params::default(), &boxes)
}

/// Ids of the lines whose boxes meet a box, sorted.
pub(super) fn query<'a>(index: &Skd<3>, bounds: &Aabb, found: &'a mut QueryResult) -> &'a [u32] {
    found.clear();
    index.query(&Region::cuboid(bounds), found);
    sorted(found)
}
