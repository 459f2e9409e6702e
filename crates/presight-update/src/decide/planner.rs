//! Plans views: finds the free pose from which predictions with and without an object differ most.

use crate::decide::boxes::UprightBox;
use crate::decide::decision::Decision;
use crate::decide::findings::{Finding, FindingKind, PlannedView};
use crate::decide::fit::Thing;
use crate::decide::rivals::{Surface, squared};
use crate::evidence::knowledge::Knowledge;
use crate::evidence::voxels::OccupancyThreshold;
use crate::observe::view::View;
use glam::{DQuat, DVec3};
use presight_localize::verdict::body_from_image;
use presight_model::floor::{Footing, Mobility, height_below};
use presight_model::geometry::{Aabb, Pose};
use presight_model::index::QueryResult;
use presight_model::world::World;
use presight_predict::free_poses::{FREE_DISTANCE, is_clear};
use std::collections::{BTreeMap, BTreeSet, VecDeque};

/// Distance between neighbouring candidate positions, metres.
const CELL: f64 = 0.25;
/// Maximum number of candidate positions of a sensor, those nearest to the driven path first.
const MAX_PLACES: usize = 20_000;
/// Interval between the heights at which the surroundings of a robot must be free, metres.
const STEP: f64 = 0.4;
/// Maximum height of a sensor above its floor, metres.
const FLOOR_REACH: f64 = 10.0;
/// Minimum distance of a position from new objects, and minimum height of free positions above the floor, metres.
const CLEARANCE: f64 = 0.35;
/// Number of positions that are evaluated with few rays, and of the best of them that are evaluated with all.
const TRIED: (usize, usize) = (600, 16);
/// Number of rays with which a view is evaluated.
const RAYS: usize = 300;
/// Points this near to the box of a part belong to it, metres.
const ON_BOX: f64 = 1e-3;

/// The object whose presence is in question.
#[derive(Clone, Debug)]
enum Subject<'a> {
    /// An object at its place in the model.
    Object(u32),
    /// An object at another pose.
    Moved(u32, &'a Pose),
    /// A box where the model is empty.
    Box(UprightBox),
    /// A part of an object, given by a box in its frame.
    Part(u32, &'a Aabb),
}

/// As [`Learner::plan_views`](crate::Learner::plan_views).
pub(crate) fn plan_views(known: &Knowledge, world: &World, findings: &[&Finding]) -> Vec<Option<PlannedView>> {
    let decision = Decision::new(known, world.environment()).filter(|_| !findings.is_empty());
    let planner = decision.as_ref().map(|decision| ViewPlanner::new(decision, world));
    findings.iter().map(|finding| planner.as_ref()?.at_finding(finding)).collect()
}

/// Finds the free poses that decide questions.
pub(crate) struct ViewPlanner<'a> {
    decision: &'a Decision<'a>,
    stations: Vec<(&'a View, Vec<DVec3>)>,
}

impl<'a> ViewPlanner<'a> {
    /// Finds the free positions of each sensor that a robot can reach from its path.
    pub fn new(decision: &'a Decision<'a>, world: &World) -> Self {
        let class = decision.known.views.back().map(|view| view.class());
        let mut newest: BTreeMap<&str, &View> = BTreeMap::new();
        for view in decision.known.views.iter().filter(|view| Some(view.class()) == class) {
            newest.insert(view.sensor_name(), view);
        }
        let blocked = blocked(decision);
        let places = |name: &str| {
            let own = decision.known.views.iter().filter(|view| view.sensor_name() == name);
            reached(world, own.map(View::origin), &blocked)
        };
        Self { decision, stations: newest.into_iter().map(|(name, view)| (view, places(name))).collect() }
    }

    /// The view that decides best whether an object is at its place.
    pub fn at_object(&self, object: u32) -> Option<PlannedView> {
        let o = &self.decision.environment.objects()[object as usize];
        let thing = Thing::new(self.decision.environment, object);
        self.best(&Subject::Object(object), thing.ball(&o.world_from_object))
    }

    /// The view that decides best whether a finding is right.
    pub fn at_finding(&self, finding: &Finding) -> Option<PlannedView> {
        let environment = self.decision.environment;
        let object = environment.index_of(&finding.object);
        let subject = match &finding.kind {
            FindingKind::Gone | FindingKind::SeenThrough(_) | FindingKind::ComesAndGoes => {
                Subject::Object(object.ok()?)
            }
            FindingKind::Moved { world_from_object, .. } => Subject::Moved(object.ok()?, world_from_object),
            FindingKind::Part(bounds) => Subject::Part(object.ok()?, bounds),
            FindingKind::New(found) => Subject::Box(*found),
            FindingKind::Recognized(known) => {
                let (bounds, pose) = (known.shape.bounds(), &known.world_from_object);
                let middle = Pose { translation: pose.transform_point(bounds.center()), ..*pose };
                Subject::Box(UprightBox { pose: middle, size: bounds.max - bounds.min })
            }
        };
        let bounds = Aabb::of(finding.corners(environment));
        self.best(&subject, (bounds.center(), 0.5 * bounds.size()))
    }

    fn best(&self, subject: &Subject<'_>, (middle, radius): (DVec3, f64)) -> Option<PlannedView> {
        let mut best: Option<PlannedView> = None;
        for (view, places) in &self.stations {
            let mut near: Vec<(f64, DVec3)> = places.iter().map(|p| (p.distance(middle), *p)).collect();
            near.retain(|(distance, _)| *distance <= view.reach() + radius);
            near.sort_by(|a, b| a.0.total_cmp(&b.0));
            let step = near.len().div_ceil(TRIED.0).max(1);
            let evaluate = |(_, place): (f64, DVec3), rays: usize| {
                let pose = facing(view, place, middle);
                (self.expected(subject, view, &pose, (middle, radius), rays), pose)
            };
            let mut coarse: Vec<(f64, (f64, DVec3))> =
                near.into_iter().step_by(step).map(|at| (evaluate(at, RAYS / 20).0, at)).collect();
            coarse.sort_by(|a, b| b.0.total_cmp(&a.0));
            for (odds, pose) in coarse.into_iter().take(TRIED.1).map(|(_, at)| evaluate(at, RAYS)) {
                if odds > best.as_ref().map_or(0.0, |best| best.odds) {
                    let (sensor, pose) = (view.sensor_name().to_owned(), view.sensor_pose(&pose));
                    best = Some(PlannedView { sensor, pose, odds });
                }
            }
        }
        best
    }

    /// The expected logarithm of the likelihood ratio of a reading from a pose of the image frame, by about `max` of
    /// its rays. Each ray adds the mean of the two cases, with and without the object.
    fn expected(
        &self,
        subject: &Subject<'_>,
        view: &View,
        world_from_image: &Pose,
        ball: (DVec3, f64),
        max: usize,
    ) -> f64 {
        let rays: Vec<DVec3> = view.pixels.rays_at(*world_from_image, ball).map(|(_, ray)| ray).collect();
        let step = rays.len().div_ceil(max.max(1)).max(1);
        let (origin, mut sum) = (world_from_image.translation, 0.0);
        for ray in rays.into_iter().step_by(step) {
            let reads = |surface: &Option<Surface>| surface.map_or(f64::INFINITY, |(range, _)| range);
            let (with, without) = self.surfaces(subject, origin, ray, view.reach());
            let (a, b) = (reads(&with), reads(&without));
            if a != b && a.min(b) >= view.pixels.sensor.spec().range_min {
                sum += 0.25 * (squared(view, a, without) + squared(view, b, with));
            }
        }
        sum * step as f64
    }

    /// The first surface on a ray with the object, and without it.
    fn surfaces(
        &self,
        subject: &Subject<'_>,
        origin: DVec3,
        ray: DVec3,
        reach: f64,
    ) -> (Option<Surface>, Option<Surface>) {
        let caster = self.decision.caster;
        let surface = |range: f64, normal: DVec3| (range, normal.dot(ray).abs());
        let cast = |but: Option<u32>| caster.cast(origin, ray, reach, but).map(|hit| surface(hit.range, hit.normal));
        let nearer = |a: Option<Surface>, b: Option<Surface>| a.into_iter().chain(b).min_by(|x, y| x.0.total_cmp(&y.0));
        let first = caster.cast(origin, ray, reach, None);
        let own = first.map(|hit| surface(hit.range, hit.normal));
        match subject {
            Subject::Object(object) if first.is_some_and(|hit| hit.object == *object) => (own, cast(Some(*object))),
            Subject::Part(object, bounds) if first.is_some_and(|hit| hit.object == *object) => {
                let pose = self.decision.environment.objects()[*object as usize].world_from_object;
                let p = pose.inverse().transform_point(origin + own.map_or(0.0, |own| own.0) * ray);
                let is_in = p.cmpge(bounds.min - ON_BOX).all() && p.cmple(bounds.max + ON_BOX).all();
                (own, if is_in { cast(Some(*object)) } else { own })
            }
            Subject::Object(_) | Subject::Part(..) => (own, own),
            Subject::Moved(object, pose) => {
                let there = caster.cast_at(*object, pose, (origin, ray, reach));
                (nearer(cast(Some(*object)), there.map(|hit| surface(hit.range, hit.normal))), own)
            }
            Subject::Box(found) => (nearer(own, found.meet(origin, ray).filter(|hit| hit.0 <= reach)), own),
        }
    }
}

/// The pose of the image frame at a position, after the robot has turned the sensor's x axis towards a point.
fn facing(view: &View, place: DVec3, at: DVec3) -> Pose {
    let world_from_sensor = view.world_from_image.rotation * body_from_image(&view.pixels.sensor).rotation.inverse();
    let (ahead, toward) = (world_from_sensor * DVec3::X, at - place);
    let turn = DQuat::from_rotation_z(toward.y.atan2(toward.x) - ahead.y.atan2(ahead.x));
    Pose { translation: place, rotation: (turn * view.world_from_image.rotation).normalize() }
}

type Key = [i32; 2];

fn key(p: DVec3) -> Key {
    [p.x, p.y].map(|x| (x / CELL).round() as i32)
}

/// The positions that are too near to new objects.
fn blocked(decision: &Decision<'_>) -> BTreeSet<Key> {
    let around = (CLEARANCE / CELL).ceil() as i32;
    let near = |p: DVec3| {
        let [x, y] = key(p);
        let all = (-around..=around).flat_map(move |dx| (-around..=around).map(move |dy| [x + dx, y + dy]));
        all.filter(move |k| (p.truncate() - CELL * glam::DVec2::from(k.map(f64::from))).length() < CLEARANCE)
    };
    let groups = decision.known.voxels.groups(&OccupancyThreshold::default());
    groups
        .concat()
        .into_iter()
        .filter_map(|voxel| decision.known.voxels.spot(voxel))
        .map(|spot| spot.mean)
        .flat_map(near)
        .collect()
}

/// Free positions at the height of a sensor that the robot can reach from its path, the nearest first.
fn reached(world: &World, from: impl Iterator<Item = DVec3>, blocked: &BTreeSet<Key>) -> Vec<DVec3> {
    let mut found = QueryResult::default();
    let mut next: VecDeque<(DVec3, Option<f64>)> = VecDeque::new();
    let (mut known, mut places) = (BTreeSet::new(), Vec::new());
    for p in from {
        // The path itself is free.
        if known.insert(key(p)) {
            let floor = height_below(world, p, FLOOR_REACH, &Mobility::default(), &mut found);
            next.push_back((p, floor.map(|floor| p.z - floor)));
        }
    }
    while let Some((p, floor)) = next.pop_front() {
        places.push(p);
        if places.len() == MAX_PLACES {
            break;
        }
        let [x, y] = key(p);
        for neighbour in [[x - 1, y], [x + 1, y], [x, y - 1], [x, y + 1]] {
            if !known.insert(neighbour) || blocked.contains(&neighbour) {
                continue;
            }
            let [x, y] = neighbour.map(|k| CELL * f64::from(k));
            if let Some(place) = sensor_place(world, DVec3::new(x, y, p.z), floor, &mut found) {
                next.push_back((place, floor));
            }
        }
    }
    places
}

/// The position of a sensor at its usual height above the floor, if a robot can stand there: missing floor keeps the
/// distance that walls keep. `at` is as high as a neighbouring position. Without a usual height, there is no floor.
fn sensor_place(world: &World, at: DVec3, usual: Option<f64>, found: &mut QueryResult) -> Option<DVec3> {
    let mobility = Mobility::default();
    let (place, lowest) = match usual {
        Some(usual) => {
            let footing = Footing::at(world, at - usual * DVec3::Z, FREE_DISTANCE, &mobility, found)?;
            if footing.edge < FREE_DISTANCE {
                return None;
            }
            (at.with_z(footing.height + usual), usual - CLEARANCE)
        }
        None if height_below(world, at, FLOOR_REACH, &mobility, found).is_none() => (at, 0.0),
        None => return None,
    };
    let steps = (lowest / STEP).max(0.0).floor() as u32;
    (0..=steps).all(|k| is_clear(world, place - f64::from(k) * STEP * DVec3::Z, found)).then_some(place)
}
