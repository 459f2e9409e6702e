//! Joins collinear lines, and removes overlaps between lines.

use super::effort::{Effort, Steps, steps};
use super::soup::grown;
use super::wings::Line;
use presight_model::error::Result;
use presight_model::geometry::Aabb;
use presight_model::index::{Params, QueryResult, Region, Skd, SpatialIndex};
use rayon::prelude::*;
use std::collections::BTreeMap;

/// Cosine of one degree, the largest angle between lines that are joined.
const PARALLEL: f64 = 0.999_847_695_156_391_2;

/// Joins collinear lines of one object that overlap or meet within `touch`. The longest line gives the direction. If
/// `kinds` is set, only lines of one kind are joined. The result is sorted by object, then in input order.
pub(super) fn merged(lines: &[Line], touch: f64, kinds: bool, effort: &Effort<'_>) -> Result<Vec<Line>> {
    let mut by_object: BTreeMap<u32, Vec<Line>> = BTreeMap::new();
    for line in lines {
        by_object.entry(line.object).or_default().push(*line);
    }
    let groups: Vec<Vec<Line>> = by_object.into_values().collect();
    let stage = effort.stage("lines", lines.len());
    let merge = |group: &Vec<Line>| merged_of_object(group, touch, kinds, effort, &stage);
    let merged: Vec<Vec<Line>> = groups.par_iter().map(merge).collect::<Result<_>>()?;
    Ok(merged.into_iter().flatten().collect())
}

fn merged_of_object(
    lines: &[Line],
    touch: f64,
    kinds: bool,
    effort: &Effort<'_>,
    stage: &Steps<'_>,
) -> Result<Vec<Line>> {
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
        let mut thing = effort.allowance(line.object);
        let (mut from, mut to) = (0.0f64, line.length());
        // Parts still to search along: first the whole line, then extensions at its ends.
        let mut parts = vec![(from, to)];
        near.clear();
        while let Some((a, b)) = parts.pop() {
            let (ids, before) = (query_along(&index, &line.part(a, b), 2.0 * touch, &mut found), (from, to));
            thing.spend(steps::FOUND * ids.len(), || line.start)?;
            near.extend(ids.iter().filter(|&&o| !taken[o as usize]).filter_map(|&o| {
                let other = &lines[o as usize];
                let fits = !kinds || other.kind == line.kind;
                let (a, b) = fits.then(|| along(line, other, touch)).flatten()?;
                Some((o, a, b))
            }));
            // Repeat while a line joins, because a farther line may come before the one that connects it.
            loop {
                let count = near.len();
                thing.spend(steps::FOUND * count, || line.start)?;
                near.retain(|&(o, a, b)| {
                    let joins = a <= to + touch && b >= from - touch;
                    if joins {
                        taken[o as usize] = true;
                        (from, to) = (from.min(a), to.max(b));
                    }
                    !joins
                });
                if near.len() == count {
                    break;
                }
            }
            if from < before.0 {
                parts.push((from, before.0));
            }
            if to > before.1 {
                parts.push((before.1, to));
            }
        }
        all.push((seed, line.part(from, to)));
    }
    all.sort_by_key(|(seed, _)| *seed);
    Ok(all.into_iter().map(|(_, line)| line).collect())
}

/// Boxes that together hold a line with a margin. A slanting line gets several, since one box would be wide.
pub(super) fn boxes_along(line: &Line, margin: f64) -> impl Iterator<Item = Aabb> + '_ {
    let mut extents = (line.end - line.start).abs().to_array();
    extents.sort_by(f64::total_cmp);
    // Largest width of a box across its longest side, metres.
    const WIDE: f64 = 1.0;
    let count = (extents[1] / WIDE).ceil().clamp(1.0, 256.0);
    (0..count as u32).map(move |k| {
        let at = |k: f64| line.start.lerp(line.end, k / count);
        grown(&Aabb::of([at(f64::from(k)), at(f64::from(k + 1))]), margin)
    })
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

/// Start and end of a collinear line along another.
fn along(line: &Line, other: &Line, touch: f64) -> Option<(f64, f64)> {
    let d = line.direction();
    let (p, q) = (other.start - line.start, other.end - line.start);
    let (a, b) = (p.dot(d), q.dot(d));
    let near = (p - d * a).length() <= touch && (q - d * b).length() <= touch;
    let straight = (b - a).abs() >= PARALLEL * other.length();
    (near && straight).then_some((a.min(b), a.max(b)))
}

/// Removes from every line the parts covered by an earlier line of any object. Pieces shorter than `least` are dropped.
pub(super) fn once(lines: &[Line], touch: f64, least: f64, effort: &Effort<'_>) -> Result<Vec<Line>> {
    let index = index_of(lines);
    let (mut found, mut all) = (QueryResult::default(), Vec::new());
    for (i, line) in lines.iter().enumerate() {
        let near = query_along(&index, line, 2.0 * touch, &mut found);
        let mut thing = effort.allowance(line.object);
        thing.spend(steps::FOUND * near.len(), || line.start)?;
        let mut left: Vec<(f64, f64)> = vec![(0.0, line.length())];
        for &earlier in near.iter().filter(|&&j| (j as usize) < i) {
            let Some((a, b)) = overlap(line, &lines[earlier as usize], touch) else { continue };
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

/// The part of a line within `touch` of another.
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

/// Ids of the lines whose boxes meet a box, sorted.
pub(super) fn query<'a>(index: &Skd<3>, bounds: &Aabb, found: &'a mut QueryResult) -> &'a [u32] {
    found.clear();
    index.query(&Region::cuboid(bounds), found);
    sorted(found)
}
