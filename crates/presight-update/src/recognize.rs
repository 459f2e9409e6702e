//! New things of a known shape: a recognizer proposes, the evidence decides.

use crate::boxes::{UprightBox, split};
use crate::decide::{Decision, Findings, What, by_rank, groups};
use crate::fit::{Fitter, Score, Thing};
use crate::learn::Learner;
use crate::moves::is_same_spot;
use crate::rivals::{Stand, better};
use crate::shapes::{Library, Shape};
use glam::{DQuat, DVec3};
use presight_model::environment::Environment;
use presight_model::error::{Error, Result};
use presight_model::geometry::{Aabb, Pose};
use presight_model::world::World;
use std::collections::BTreeMap;
use std::sync::Arc;

/// A point so near to a recognized thing belongs to it, metres.
pub(crate) const OWN: f64 = 0.1;
/// How far a shape may be off in the short fits that choose among starts, metres.
const SHORT: [f64; 4] = [0.4, 0.2, 0.1, 0.06];
/// Points of a short fit.
const FEW: usize = 100;
/// Starts of a shape that are fitted in full.
const BEST: usize = 3;
/// Yaws that a shape of the library starts from.
const YAWS: usize = 12;
/// A shape that sticks out of the points by more, metres, also starts from both sides: a fit does not reach that far.
const SLACK: f64 = 0.3;
/// A shape is not tried where it and the points differ more in length.
const LEAST_LENGTH: f64 = 0.25;
/// Most points that a recognizer gets.
const MOST_POINTS: usize = 20_000;
/// Most proposals for one group of points that are looked at.
const MOST_PROPOSALS: usize = 100;

/// A shape and where it may stand.
#[derive(Clone, Debug, PartialEq)]
pub struct Proposal {
    /// The name of a shape of the library, or of an object of the model.
    pub object: String,
    /// Its pose; a fit to the points corrects some decimetres and 15 degrees.
    pub world_from_object: Pose,
}

/// Names things by their points. A proposal becomes a finding only if the evidence agrees.
pub trait Recognizer {
    /// What a group of points may be, at most 100 proposals; none if it does not know.
    ///
    /// `points` are measured points that the model does not explain, of all views, at most 20,000, world frame, metres.
    ///
    /// # Errors
    /// Whatever keeps it from an answer. It gets no further points.
    fn recognize(&mut self, points: &[DVec3]) -> Result<Vec<Proposal>>;
}

/// A new thing of a known shape.
#[derive(Clone, Debug, PartialEq)]
pub struct Recognized {
    /// Its shape.
    pub shape: Arc<Shape>,
    /// Its pose.
    pub world_from_object: Pose,
}

/// A group of points, or a piece of one, with shapes by number and their starts.
struct Tried {
    points: Vec<DVec3>,
    starts: Vec<(usize, Pose)>,
}

/// A shape that stands somewhere, by its number.
#[derive(Clone, Copy)]
struct Placed {
    shape: usize,
    thing: Thing,
    pose: Pose,
    score: Score,
    /// Logarithm of its odds against boxes.
    odds: f64,
}

impl Learner {
    /// Puts shapes that explain new points better than boxes in place of the boxes. Shapes of the library start from several yaws,
    /// and shapes that the recognizer names from its poses. A shape is taken if the points hold it, if at least 80 % of its
    /// surface that is seen is there and no part of it is surely seen through, and if its odds against boxes are at least
    /// [`crate::LearnOptions::sure`].
    ///
    /// # Errors
    /// Those of the recognizer, and [`presight_model::ErrorKind::Invalid`] if it names an unknown object. The findings are then
    /// as without its further answers.
    pub fn recognize(
        &mut self,
        world: &World,
        findings: &mut Findings,
        library: &Library,
        recognizer: Option<&mut dyn Recognizer>,
    ) -> Result<()> {
        let class = self.views.back().map_or_else(String::new, |view| view.kept.sensor.spec().class.clone());
        self.caster(world, &class);
        let Self { casters, book, voxels, views, options, .. } = &*self;
        let Some(caster) = casters.get(&class).filter(|_| findings.wrong.is_none()) else { return Ok(()) };
        let environment = &**world.environment();
        let mut explained = moved(findings, environment);
        let groups = groups(voxels, views);
        let decision = Decision { environment, caster, book, voxels, views, options };
        let mut tried = Vec::new();
        for group in &groups {
            let left = decision.unexplained(&group.points, &explained);
            let pieces = decision.pieces(&left);
            let whole = (pieces.len() != 1 && decision.is_thing(&left)).then_some(left);
            tried.extend(whole.into_iter().chain(pieces).map(|points| Tried { points, starts: Vec::new() }));
        }
        let mut shapes = library.shapes().to_vec();
        tried.iter_mut().for_each(|tried| tried.start_library(&shapes));
        let asked = recognizer.map_or(Ok(()), |recognizer| ask(recognizer, &mut tried, &mut shapes, environment));
        let first = environment.objects().len() as u32;
        let caster = caster.with_meshes(first, shapes.iter().map(|s| (s.mesh(), s.object_from_mesh())));
        let decision = Decision { environment, caster: &caster, book, voxels, views, options };
        let placed = decision.recognized(&tried, (first, &shapes), &explained);
        if placed.is_empty() {
            return asked;
        }
        explained.extend(placed.iter().map(|placed| (placed.thing.object, placed.pose)));
        findings.changes.retain(|finding| !matches!(finding.what, What::New(_)));
        decision.add_new(findings, &groups, &explained);
        for Placed { shape, pose, score, odds, .. } in placed {
            let what = What::Recognized(Recognized { shape: shapes[shape].clone(), world_from_object: pose });
            findings.changes.push(decision.finding(String::new(), what, odds.min(score.l), score.views));
        }
        findings.changes.sort_by(by_rank);
        asked
    }
}

/// Where moved objects stand now: they explain points.
fn moved(findings: &Findings, environment: &Environment) -> Vec<(u32, Pose)> {
    let of = |(object, what): (&String, &What)| match what {
        What::Moved { world_from_object, .. } => Some((environment.index_of(object).ok()?, *world_from_object)),
        _ => None,
    };
    findings.changes.iter().filter_map(|finding| of((&finding.object, &finding.what))).collect()
}

/// Asks a recognizer about each group of points. The shapes of objects of the model that it names are added.
fn ask(
    recognizer: &mut dyn Recognizer,
    tried: &mut [Tried],
    shapes: &mut Vec<Arc<Shape>>,
    environment: &Environment,
) -> Result<()> {
    for tried in tried {
        let step = tried.points.len().div_ceil(MOST_POINTS).max(1);
        let points: Vec<DVec3> = tried.points.iter().copied().step_by(step).collect();
        for Proposal { object, world_from_object } in recognizer.recognize(&points)?.into_iter().take(MOST_PROPOSALS) {
            let number = shapes.iter().position(|shape| shape.name() == object).or_else(|| {
                let found = environment.object(&object).filter(|o| o.mesh.polygon_count() > 0)?;
                shapes.push(Arc::new(Shape::of_object(found)));
                Some(shapes.len() - 1)
            });
            let Some(number) = number else {
                let what = format!("the recognizer names {object:?}, which is neither in the library nor in the map");
                let remedy =
                    "let it give the name of a file of the library, without its ending, or of an object of the map";
                return Err(Error::invalid(what, remedy));
            };
            tried.starts.push((number, world_from_object));
        }
    }
    Ok(())
}

impl Tried {
    /// Starts of the library's shapes: from several yaws, with the top or the bottom of the shape at that of the points, and with
    /// its middle over theirs or, if it is much larger, with a side at theirs.
    fn start_library(&mut self, shapes: &[Arc<Shape>]) {
        let points = Aabb::of(self.points.iter().copied());
        for (number, shape) in shapes.iter().enumerate() {
            let bounds = shape.bounds();
            let lengths = [bounds, points].map(|b| (b.max - b.min).max_element());
            if lengths[0].min(lengths[1]) < LEAST_LENGTH * lengths[0].max(lengths[1]) {
                continue;
            }
            for yaw in 0..YAWS {
                let rotation = DQuat::from_rotation_z(std::f64::consts::TAU * yaw as f64 / YAWS as f64);
                let turned = bounds.transformed(&Pose { rotation, ..Pose::IDENTITY }.to_affine());
                let slack = turned.half_extent() - points.half_extent();
                let sides = |slack: f64| if slack > SLACK { vec![0.0, -slack, slack] } else { vec![0.0] };
                // Above and below the middle of the points; both are the same if shape and points are of one height.
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
    /// The shapes that stand somewhere, group by group. A group may hold several, the surest first.
    fn recognized(
        &self,
        tried: &[Tried],
        (first, shapes): (u32, &[Arc<Shape>]),
        explained: &[(u32, Pose)],
    ) -> Vec<Placed> {
        let (mut found, mut explained) = (Vec::<Placed>::new(), explained.to_vec());
        let fitter = self.fitter();
        for Tried { points, starts } in tried {
            let mut by_shape: BTreeMap<usize, Vec<Pose>> = BTreeMap::new();
            starts.iter().for_each(|(shape, pose)| by_shape.entry(*shape).or_default().push(*pose));
            let mut left = self.unexplained(points, &explained);
            while self.is_thing(&left) {
                let place = |(shape, starts): (&usize, &Vec<Pose>)| {
                    let thing = Thing::of_bounds(first + *shape as u32, &shapes[*shape].bounds());
                    self.best_of(&fitter, *shape, &thing, starts, &left)
                };
                let free = |placed: &Placed| !self.is_taken(placed, &found);
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

    /// True if another thing stands where a shape would.
    fn is_taken(&self, placed: &Placed, found: &[Placed]) -> bool {
        let spot = |thing: &Thing, pose: &Pose| (pose.transform_point(thing.middle), thing.radius);
        let own = spot(&placed.thing, &placed.pose);
        found.iter().any(|other| is_same_spot(&own, &spot(&other.thing, &other.pose)))
            || self.standing(&[]).iter().any(|other| is_same_spot(&own, other))
    }

    /// The best pose of a shape among its starts, if the evidence is sure of it.
    fn best_of(
        &self,
        fitter: &Fitter<'_>,
        shape: usize,
        thing: &Thing,
        starts: &[Pose],
        points: &[DVec3],
    ) -> Option<Placed> {
        let few: Vec<DVec3> = points.iter().copied().step_by(points.len().div_ceil(FEW).max(1)).collect();
        let short = |start: &Pose| {
            let end = fitter.slide(thing, start, &few, &SHORT);
            (fitter.explained(thing.object, &end, &few, *SHORT.last().unwrap_or(&OWN)), end)
        };
        let mut ends: Vec<(f64, Pose)> = starts.iter().map(short).collect();
        ends.sort_by(|a, b| b.0.total_cmp(&a.0));
        let settled = ends.iter().take(BEST).filter_map(|(_, pose)| {
            let pose = fitter.settle(thing, pose);
            let (score, fit) = (fitter.score(thing, &pose), fitter.fit(thing, &pose));
            let is_sure = self.is_sure(&score) && fit.share() >= self.options.least_agreeing;
            if !is_sure || !fitter.is_held(thing, &pose) {
                return None;
            }
            let odds = self.against_boxes(thing, &pose, points);
            (odds >= self.options.sure).then_some(Placed { shape, thing: *thing, pose, score, odds })
        });
        settled.max_by(|a, b| a.odds.total_cmp(&b.odds))
    }

    /// Logarithm of the odds of a shape, with boxes around the points that it leaves, against boxes around all points.
    fn against_boxes(&self, thing: &Thing, pose: &Pose, points: &[DVec3]) -> f64 {
        let boxes = |points: Vec<DVec3>| -> Vec<UprightBox> {
            let sets = if self.is_thing(&points) { split(points) } else { Vec::new() };
            sets.iter().map(|set| UprightBox::of(set)).collect()
        };
        let rest = boxes(self.unexplained(points, &[(thing.object, *pose)]));
        let with = Stand { thing: Some((thing, pose)), boxes: &rest };
        let all = boxes(points.to_vec());
        let without = Stand { thing: None, boxes: &all };
        better(self, &with, &without, &Aabb::of(points.iter().copied()))
    }
}
