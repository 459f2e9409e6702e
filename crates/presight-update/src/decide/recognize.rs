//! New objects of known shapes: a library or a recognizer proposes shapes and poses, and the evidence decides.

use crate::decide::boxes::{UprightBox, split};
use crate::decide::decision::{Decision, OWN, moved};
use crate::decide::findings::{FindingKind, SiteFindings, by_rank};
use crate::decide::fit::{Fitter, Score, Thing};
use crate::decide::groups::groups;
use crate::decide::moves::is_same_place;
use crate::decide::rivals::{Explanation, better};
use crate::decide::shapes::{Library, LibraryShape, Recognized};
use crate::evidence::knowledge::Knowledge;
use glam::{DQuat, DVec3};
use presight_model::environment::Environment;
use presight_model::error::{Error, Result};
use presight_model::geometry::{Aabb, Pose};
use presight_model::world::World;
use std::collections::BTreeMap;
use std::sync::Arc;

/// Maximum distances of points from a shape in the short fits that select starts, metres.
const SHORT: [f64; 4] = [0.4, 0.2, 0.1, 0.06];
/// Number of points of a short fit.
const SHORT_POINTS: usize = 100;
/// Number of starts of a shape that are fitted in full.
const BEST: usize = 3;
/// Number of yaws from which a shape of the library starts.
const YAWS: usize = 12;
/// A shape that exceeds the bounds of the points by more, metres, also starts from both sides, because a fit does not
/// reach that far.
const SLACK: f64 = 0.3;
/// Minimum ratio of the lengths of a shape and of the points to which it is fitted.
const MIN_LENGTH_RATIO: f64 = 0.25;
/// Maximum number of points that a recognizer receives.
const MAX_POINTS: usize = 20_000;
/// Maximum number of proposals that are evaluated for one group of points.
const MAX_PROPOSALS: usize = 100;

/// A shape at a possible pose.
#[derive(Clone, Debug, PartialEq)]
pub struct Proposal {
    /// The name of a shape of the library, or of an object of the model.
    pub object: String,
    /// Its pose. A fit to the points corrects errors of some decimetres and 15 degrees.
    pub world_from_object: Pose,
}

/// Proposes shapes for points. A proposal becomes a finding only if the evidence agrees.
pub trait Recognizer {
    /// Returns at most 100 proposals for a group of points; none for an unknown object.
    ///
    /// `points` are at most 20,000 measured points of all views that the model does not explain, world frame, metres.
    ///
    /// # Errors
    /// Any error that prevents an answer. The recognizer then receives no further points.
    fn recognize(&mut self, points: &[DVec3]) -> Result<Vec<Proposal>>;
}

/// A group of points, or a piece of one, with the starts of shapes by number.
struct Candidate {
    points: Vec<DVec3>,
    starts: Vec<(usize, Pose)>,
}

/// A shape at a pose that the evidence supports.
#[derive(Clone, Copy)]
struct PlacedShape {
    /// Number of the shape.
    shape: usize,
    thing: Thing,
    pose: Pose,
    score: Score,
    /// Log-odds against boxes.
    odds: f64,
}

/// As [`Learner::recognize`](crate::Learner::recognize).
pub(crate) fn recognize(
    known: &Knowledge,
    world: &World,
    findings: &mut SiteFindings,
    library: &Library,
    recognizer: Option<&mut dyn Recognizer>,
) -> Result<()> {
    let environment = &**world.environment();
    let Some(decision) = Decision::new(known, environment).filter(|_| findings.wrong.is_none()) else { return Ok(()) };
    let mut explained = moved(&findings.changes, environment);
    let groups = groups(known);
    let mut candidates = Vec::new();
    for group in &groups {
        let left = decision.unexplained(&group.points, &explained);
        let pieces = decision.pieces(&left);
        let whole = (pieces.len() != 1 && decision.is_object(&left)).then_some(left);
        candidates.extend(whole.into_iter().chain(pieces).map(|points| Candidate { points, starts: Vec::new() }));
    }
    let mut shapes = library.shapes().to_vec();
    candidates.iter_mut().for_each(|candidate| candidate.start_library(&shapes));
    let answered = recognizer.map_or(Ok(()), |recognizer| ask(recognizer, &mut candidates, &mut shapes, environment));
    let first = environment.objects().len() as u32;
    let caster =
        decision.caster.with_meshes(first, shapes.iter().map(|shape| (shape.mesh(), shape.object_from_mesh())));
    let decision = Decision { caster: &caster, ..decision };
    let placed = decision.recognized(&candidates, (first, &shapes), &explained);
    if placed.is_empty() {
        return answered;
    }
    explained.extend(placed.iter().map(|placed| (placed.thing.object, placed.pose)));
    findings.changes.retain(|finding| !matches!(finding.kind, FindingKind::New(_)));
    decision.add_new(findings, &groups, &explained);
    for PlacedShape { shape, pose, score, odds, .. } in placed {
        let kind = FindingKind::Recognized(Recognized { shape: shapes[shape].clone(), world_from_object: pose });
        findings.changes.push(decision.finding(String::new(), kind, odds.min(score.l), score.views));
    }
    findings.changes.sort_by(by_rank);
    answered
}

/// Asks a recognizer about each group of points. The shapes of objects of the model that it names are added.
fn ask(
    recognizer: &mut dyn Recognizer,
    candidates: &mut [Candidate],
    shapes: &mut Vec<Arc<LibraryShape>>,
    environment: &Environment,
) -> Result<()> {
    for candidate in candidates {
        let step = candidate.points.len().div_ceil(MAX_POINTS).max(1);
        let points: Vec<DVec3> = candidate.points.iter().copied().step_by(step).collect();
        for Proposal { object, world_from_object } in recognizer.recognize(&points)?.into_iter().take(MAX_PROPOSALS) {
            let number = shapes.iter().position(|shape| shape.name() == object).or_else(|| {
                let found = environment.object(&object).filter(|o| o.mesh.polygon_count() > 0)?;
                shapes.push(Arc::new(LibraryShape::of_object(found)));
                Some(shapes.len() - 1)
            });
            let Some(number) = number else {
                let what = format!("the recognizer names {object:?}, which is neither in the library nor in the map");
                let remedy =
                    "let it give the name of a file of the library, without its ending, or of an object of the map";
                return Err(Error::invalid(what, remedy));
            };
            candidate.starts.push((number, world_from_object));
        }
    }
    Ok(())
}

impl Candidate {
    /// Adds starts of the library's shapes: several yaws, with the top or the bottom of the shape at that of the
    /// points, and horizontally with the centre at that of the points or, for a much larger shape, with a side at
    /// theirs.
    fn start_library(&mut self, shapes: &[Arc<LibraryShape>]) {
        let points = Aabb::of(self.points.iter().copied());
        for (number, shape) in shapes.iter().enumerate() {
            let bounds = shape.bounds();
            let lengths = [bounds, points].map(|b| (b.max - b.min).max_element());
            if lengths[0].min(lengths[1]) < MIN_LENGTH_RATIO * lengths[0].max(lengths[1]) {
                continue;
            }
            for yaw in 0..YAWS {
                let rotation = DQuat::from_rotation_z(std::f64::consts::TAU * yaw as f64 / YAWS as f64);
                let turned = bounds.transformed(&Pose { rotation, ..Pose::IDENTITY }.to_affine());
                let slack = turned.half_extent() - points.half_extent();
                let sides = |slack: f64| if slack > SLACK { vec![0.0, -slack, slack] } else { vec![0.0] };
                // Bottom at bottom, and top at top; one start is enough if shape and points have the same height.
                let heights = if 2.0 * slack.z.abs() > OWN { vec![-slack.z, slack.z] } else { vec![-slack.z] };
                for x in sides(slack.x) {
                    for y in sides(slack.y) {
                        for z in &heights {
                            let translation = points.center() + DVec3::new(x, y, *z) - turned.center();
                            self.starts.push((number, Pose { translation, rotation }));
                        }
                    }
                }
            }
        }
    }
}

impl Decision<'_> {
    /// The shapes that the evidence supports, group by group. A group may contain several; the one with the highest
    /// odds is first.
    fn recognized(
        &self,
        candidates: &[Candidate],
        (first, shapes): (u32, &[Arc<LibraryShape>]),
        explained: &[(u32, Pose)],
    ) -> Vec<PlacedShape> {
        let (mut found, mut explained) = (Vec::<PlacedShape>::new(), explained.to_vec());
        let fitter = self.fitter();
        for Candidate { points, starts } in candidates {
            let mut by_shape: BTreeMap<usize, Vec<Pose>> = BTreeMap::new();
            starts.iter().for_each(|(shape, pose)| by_shape.entry(*shape).or_default().push(*pose));
            let mut left = self.unexplained(points, &explained);
            while self.is_object(&left) {
                let place = |(shape, starts): (&usize, &Vec<Pose>)| {
                    let thing = Thing::of_bounds(first + *shape as u32, &shapes[*shape].bounds());
                    self.best_of(&fitter, *shape, &thing, starts, &left)
                };
                let free = |placed: &PlacedShape| !self.is_taken(placed, &found);
                let places = by_shape.iter().filter_map(place).filter(free);
                let Some(best) = places.max_by(|a, b| a.odds.total_cmp(&b.odds)) else { break };
                explained.push((best.thing.object, best.pose));
                found.push(best);
                let rest = self.unexplained(&left, &explained);
                if rest.len() == left.len() {
                    break;
                }
                left = rest;
            }
        }
        found
    }

    /// True if another object stands at the place of a shape.
    fn is_taken(&self, placed: &PlacedShape, found: &[PlacedShape]) -> bool {
        let ball = |placed: &PlacedShape| placed.thing.ball(&placed.pose);
        let own = ball(placed);
        found.iter().any(|other| is_same_place(&own, &ball(other)))
            || self.standing(&[]).iter().any(|other| is_same_place(&own, other))
    }

    /// The best pose of a shape among its starts, if the evidence decides for it.
    fn best_of(
        &self,
        fitter: &Fitter<'_>,
        shape: usize,
        thing: &Thing,
        starts: &[Pose],
        points: &[DVec3],
    ) -> Option<PlacedShape> {
        let options = &self.known.options;
        let few: Vec<DVec3> = points.iter().copied().step_by(points.len().div_ceil(SHORT_POINTS).max(1)).collect();
        let short = |start: &Pose| {
            let end = fitter.slide(thing, start, &few, &SHORT);
            (fitter.explained(thing.object, &end, &few, *SHORT.last().unwrap_or(&OWN)), end)
        };
        let mut ends: Vec<(f64, Pose)> = starts.iter().map(short).collect();
        ends.sort_by(|a, b| b.0.total_cmp(&a.0));
        let settled = ends.iter().take(BEST).filter_map(|(_, pose)| {
            let pose = fitter.settle(thing, pose);
            let (score, fit) = (fitter.score(thing, &pose), fitter.fit(thing, &pose));
            let is_decided = self.is_decisive(&score) && fit.share() >= options.min_agreeing;
            if !is_decided || !fitter.is_held(thing, &pose) {
                return None;
            }
            let odds = self.against_boxes(thing, &pose, points);
            (odds >= options.decisive).then_some(PlacedShape { shape, thing: *thing, pose, score, odds })
        });
        settled.max_by(|a, b| a.odds.total_cmp(&b.odds))
    }

    /// Log-odds of a shape with boxes around the remaining points, against boxes around all points.
    fn against_boxes(&self, thing: &Thing, pose: &Pose, points: &[DVec3]) -> f64 {
        let boxes = |points: Vec<DVec3>| -> Vec<UprightBox> {
            let sets = if self.is_object(&points) { split(points) } else { Vec::new() };
            sets.iter().map(|set| UprightBox::of(set)).collect()
        };
        let rest = boxes(self.unexplained(points, &[(thing.object, *pose)]));
        let with = Explanation { thing: Some((thing, pose)), boxes: &rest };
        let all = boxes(points.to_vec());
        let without = Explanation { thing: None, boxes: &all };
        better(self, &with, &without, &Aabb::of(points.iter().copied()))
    }
}
