//! Decides segments that a scanner sees completely or not at all, without sampling them.
//!
//! Each polygon hides an interval of the segment, in closed form. If no polygon hides anything, or several together
//! hide all of it, by more than rounding, every sample would agree. Otherwise [`super::runs`] samples the segment.

use super::candidates::BLOCKS_APART;
use super::polygon::PreparedPolygon;
use super::strategy::{Decision, FeatureQuery, Workspace};
use super::tally::Tally;
use super::tiles::Look;
use crate::sample::{Part, Piece};
use crate::{FeatureStats, Hidden, VisibleInterval};
use glam::{DVec2, DVec3};
use presight_model::environment::FeatureShape;
use presight_render::ablation::Means;

/// Margin, relative to a length or share, that rounding cannot exceed.
const CLEARLY: f64 = 1e-12;

/// Segments seen under smaller angles are points in the image, radians.
const SHORT: f64 = 1e-9;

const MOST_TILES: usize = 1024;

/// The part of a stretch that a polygon hides.
enum Hides {
    Nothing,
    /// Shares of the stretch, from one end to the other.
    Between(f64, f64),
    /// The segment must be sampled.
    Unclear,
}

struct Segment {
    ends: [DVec3; 2],
    /// The share of the length at which it is nearest to the sensor, and the place.
    share: f64,
    foot: DVec3,
    ranges: [f64; 2],
    rounding: f64,
}

/// Decides a segment that is seen completely or not at all; `None` for all others.
pub(super) fn decide(query: &FeatureQuery<'_>, workspace: &mut Workspace) -> Option<Decision> {
    let FeatureQuery { frame, shape: FeatureShape::Segment { .. }, points: [a, b], own, .. } = query else {
        return None;
    };
    let (spec, options) = (frame.sensor.spec(), &frame.options);
    let is_plain =
        Means::WholeSegments.is_used() && own.is_plain() && spec.max_incidence.is_none() && !options.feature_id;
    if !is_plain || !frame.sampler.holds_all(*a, *b) {
        return None;
    }
    let d = *b - *a;
    let is_short = a.cross(d).length() <= SHORT * a.length() * b.length();
    if is_short {
        return None;
    }
    let share = (-a.dot(d) / d.length_squared().max(f64::MIN_POSITIVE)).clamp(0.0, 1.0);
    let foot = *a + share * d;
    let ranges = [foot.length(), a.length().max(b.length())];
    if !(ranges[0] >= spec.range_min && ranges[1] <= spec.range_max && ranges[0] > 0.0) {
        return None;
    }
    let segment = Segment { ends: [*a, *b], share, foot, ranges, rounding: own.rounding() };
    let hidden = segment.hidden_by_image(query, workspace)?;
    let samples = asked(query);
    if !hidden.is_empty() {
        // Pieces of curves need their lengths in the image.
        let is_hidden = options.hidden == Hidden::Count && !query.is_piece && are_all(hidden);
        let hidden_by_neighbours = samples;
        let stats = FeatureStats { features: 1, samples, hidden_by_neighbours, ..FeatureStats::default() };
        return is_hidden.then(|| Decision { tally: Tally::default(), stats });
    }
    segment.is_seen_in_space(query, workspace).then(|| segment.seen(query)).flatten()
}

/// The number of samples that a device tested; without a device the segment counts as one sample.
fn asked(query: &FeatureQuery<'_>) -> usize {
    query.hints.map_or(1, |hints| hints.len())
}

/// Returns true if the intervals together cover 0 to 1.
fn are_all(mut some: Vec<(f64, f64)>) -> bool {
    some.sort_unstable_by(|a, b| a.0.total_cmp(&b.0));
    let reach = some.iter().try_fold(0.0, |reach: f64, (from, to)| (*from <= reach).then(|| reach.max(*to)));
    reach.is_some_and(|reach| reach >= 1.0)
}

impl Segment {
    /// The intervals hidden by polygons that the image shows along it; `None` if it must be sampled.
    fn hidden_by_image(&self, query: &FeatureQuery<'_>, workspace: &mut Workspace) -> Option<Vec<(f64, f64)>> {
        let frame = query.frame;
        let Workspace { polygons, candidates, .. } = workspace;
        candidates.propose(query, polygons, |add| {
            let [a, b] = self.ends.map(|p| p / p.length());
            let angle = a.distance(b);
            let blocks = (angle / (BLOCKS_APART * frame.sampler.pixel_angle())).ceil().max(1.0);
            let places = (0..=blocks as u32).map(|i| a.lerp(b, f64::from(i) / blocks));
            places.filter_map(|p| frame.sensor.project(p)).for_each(|pixel| add(pixel.into()));
        });
        let mut hidden = Vec::new();
        for number in candidates.numbers() {
            let known = polygons.get(*number);
            match self.hides(known, polygons.planes_of(known), self.ends) {
                Hides::Nothing => {}
                Hides::Between(from, to) => hidden.push((from, to)),
                Hides::Unclear => return None,
            }
        }
        Some(hidden)
    }

    /// Returns true if surely no polygon hides any of it.
    fn is_seen_in_space(&self, query: &FeatureQuery<'_>, workspace: &mut Workspace) -> bool {
        let FeatureQuery { frame, own, .. } = query;
        let Workspace { polygons, tiles, near, .. } = workspace;
        let [mut p, b] = self.ends;
        for _ in 0..MOST_TILES {
            let share = tiles.of(p).1.left_at(p, b);
            let is_last = share >= 1.0 - CLEARLY;
            let q = if is_last { b } else { p.lerp(b, share) };
            let farthest = p.length().max(q.length());
            for look in [Look::First, Look::All] {
                let (tile, has_all) = tiles.tile(frame, polygons, p, farthest, look);
                tiles.between(tile, &[p, q], own, polygons, near);
                let mut nearby = near.iter().map(|number| polygons.get(*number));
                if !nearby.all(|known| matches!(self.hides(known, polygons.planes_of(known), [p, q]), Hides::Nothing)) {
                    return false;
                }
                if has_all {
                    break;
                }
            }
            // The end lies along the side of a tile: there is no way forward.
            if is_last || share <= 0.0 {
                return is_last;
            }
            // Step past the side; tiles are slightly larger than their nominal size.
            p = p.lerp(b, share + CLEARLY);
        }
        false
    }

    /// The part that a polygon hides of the stretch between two places.
    fn hides(&self, known: &PreparedPolygon, planes: &[DVec3], [p, q]: [DVec3; 2]) -> Hides {
        let shares = [known.inverse.dot(p), known.inverse.dot(q)];
        if shares[0] <= 1.0 && shares[1] <= 1.0 {
            return Hides::Nothing;
        }
        let (mut from, mut to, far) = (0.0f64, 1.0f64, self.ranges[1]);
        let mut is_grazed = false;
        for e in planes {
            let (f, g) = (e.dot(p), e.dot(q));
            let slack = CLEARLY * far * e.length();
            if f < -slack && g < -slack {
                return Hides::Nothing;
            }
            is_grazed |= f.abs().max(g.abs()) <= slack;
            if f < 0.0 {
                from = from.max(f / (f - g));
            }
            if g < 0.0 {
                to = to.min(f / (f - g));
            }
        }
        if from > to + CLEARLY {
            return if is_grazed { Hides::Unclear } else { Hides::Nothing };
        }
        let share_at = |s: f64| shares[0] + s * (shares[1] - shares[0]);
        let within = [share_at(from), share_at(to)];
        let most = within[0].max(within[1]);
        if most <= 1.0 - CLEARLY {
            return Hides::Nothing;
        }
        let least = self.ranges.map(|range| known.least_share(most, range, self.rounding));
        let least = least[0].max(least[1]) * (1.0 + CLEARLY);
        if !is_grazed && from <= to && within.iter().all(|share| *share > least) {
            return Hides::Between(from, to);
        }
        Hides::Unclear
    }

    /// The result that its samples would give if all are seen.
    fn seen(&self, query: &FeatureQuery<'_>) -> Option<Decision> {
        let sampler = &query.frame.sampler;
        let [a, b] = self.ends;
        let (mut tally, mut is_inside) = (Tally::default(), true);
        sampler.parts_around_foot([a, b], self.foot, query.is_piece, &mut |part| match part {
            Part::Run(run) => {
                tally.inside[0] += run.length;
                let nearest = run.number(self.share);
                for i in [nearest.floor(), nearest.ceil()] {
                    tally.see_at(run.middle((i.max(0.0) as usize).min(run.count - 1)).0);
                }
            }
            Part::One(Piece::Inside(sample)) => {
                tally.inside[0] += sample.weight;
                tally.see_at(sample.at);
            }
            Part::One(Piece::Outside { .. }) => is_inside = false,
        });
        tally.inside[1] = 1.0;
        tally.seen = tally.inside;
        let pixel = |p: DVec3| query.frame.sensor.project(p).map(DVec2::from);
        let pixels = [pixel(a)?, pixel(a + 1.0 * (b - a))?];
        tally.visible.push(VisibleInterval { t: [0.0, 1.0], pixels });
        let samples = asked(query);
        let stats = FeatureStats { features: 1, samples, visible: samples, ..FeatureStats::default() };
        is_inside.then_some(Decision { tally, stats })
    }
}
