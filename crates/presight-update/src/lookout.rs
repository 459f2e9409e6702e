//! Where to look from: the free pose from which predictions with and without something differ most.

use crate::decide::{Decision, Finding, What};
use crate::fit::Thing;
use crate::rivals::{Surface, squared};
use crate::view::View;
use glam::{DQuat, DVec3};
use presight_localize::verdict::body_from_image;
use presight_model::geometry::{Aabb, Pose, SensorPose};
use presight_model::index::QueryResult;
use presight_model::world::World;
use presight_predict::free_poses::{height_above, is_clear};
use std::collections::{BTreeMap, BTreeSet, VecDeque};

/// Distance between neighbouring places, metres.
const CELL: f64 = 0.25;
/// Most places of a sensor that are searched, the nearest to the way first.
const MOST_PLACES: usize = 20_000;
/// Steps between the heights of a robot at which nothing may be near, metres, and the lowest above the floor.
const STEP: f64 = 0.4;
const LOWEST: f64 = 0.35;
/// A neighbouring place may be higher or lower by this, metres.
const KERB: f64 = 0.1;
/// Nothing new may be nearer to a place, metres.
const AWAY: f64 = 0.35;
/// Places that are looked from with a few rays, and the best of them that are looked from with many.
const TRIED: (usize, usize) = (600, 16);
/// Rays of a look at something.
const RAYS: usize = 300;
/// A point this near to the box of a part belongs to it, metres.
const ON_BOX: f64 = 1e-3;

/// The look whose reading decides most.
#[derive(Clone, Debug, PartialEq)]
pub struct Look {
    /// The name of the sensor that looks.
    pub sensor: String,
    /// Its pose.
    pub pose: SensorPose,
    /// The expected logarithm of the likelihood ratio of its reading, with against without the thing.
    pub odds: f64,
}

/// What may be there or not.
#[derive(Clone, Debug)]
enum Subject<'a> {
    /// An object, where the model has it.
    Object(u32),
    /// An object, at another pose.
    Moved(u32, &'a Pose),
    /// A box where the model has nothing.
    Box(crate::UprightBox),
    /// A part of an object, by a box in its frame.
    Part(u32, &'a Aabb),
}

/// Looks for poses to look from.
pub(crate) struct Lookout<'a> {
    decision: &'a Decision<'a>,
    stations: Vec<(&'a View, Vec<DVec3>)>,
}

impl<'a> Lookout<'a> {
    /// The free places of each sensor at its height, that a robot reaches from where it was.
    pub fn new(decision: &'a Decision<'a>, world: &World) -> Self {
        let class = decision.views.back().map(|view| &view.kept.sensor.spec().class);
        let mut newest: BTreeMap<&str, &View> = BTreeMap::new();
        for view in decision.views.iter().filter(|view| Some(&view.kept.sensor.spec().class) == class) {
            newest.insert(&view.kept.sensor.spec().name, view);
        }
        let news = blocked(decision);
        let places = |name: &str| {
            let own = decision.views.iter().filter(|view| view.kept.sensor.spec().name == name);
            reached(world, own.map(|view| view.world_from_image.translation), &news)
        };
        Self { decision, stations: newest.into_iter().map(|(name, view)| (view, places(name))).collect() }
    }

    /// The best look at an object, to see if it stands.
    pub fn at_object(&self, object: u32) -> Option<Look> {
        let o = &self.decision.environment.objects()[object as usize];
        let thing = Thing::new(self.decision.environment, object);
        self.best(&Subject::Object(object), (o.world_from_object.transform_point(thing.middle), thing.radius))
    }

    /// The best look at what a finding changes.
    pub fn at_finding(&self, finding: &Finding) -> Option<Look> {
        let environment = self.decision.environment;
        let object = environment.index_of(&finding.object);
        let subject = match &finding.what {
            What::Gone | What::SeenThrough(_) | What::ComesAndGoes => Subject::Object(object.ok()?),
            What::Moved { world_from_object, .. } => Subject::Moved(object.ok()?, world_from_object),
            What::Part(bounds) => Subject::Part(object.ok()?, bounds),
            What::New(found) => Subject::Box(*found),
            What::Recognized(known) => {
                let (bounds, pose) = (known.shape.bounds(), &known.world_from_object);
                let middle = Pose { translation: pose.transform_point(bounds.center()), ..*pose };
                Subject::Box(crate::UprightBox { pose: middle, size: bounds.max - bounds.min })
            }
        };
        let bounds = Aabb::of(finding.corners(environment));
        self.best(&subject, (bounds.center(), 0.5 * bounds.size()))
    }

    fn best(&self, subject: &Subject<'_>, (middle, radius): (DVec3, f64)) -> Option<Look> {
        let mut best: Option<Look> = None;
        for (view, places) in &self.stations {
            let reach = view.kept.sensor.spec().range_max.min(1e5);
            let mut near: Vec<(f64, DVec3)> = places.iter().map(|p| (p.distance(middle), *p)).collect();
            near.retain(|(distance, _)| *distance <= reach + radius);
            near.sort_by(|a, b| a.0.total_cmp(&b.0));
            let step = near.len().div_ceil(TRIED.0).max(1);
            let look = |(_, place): (f64, DVec3), rays: usize| {
                let pose = facing(view, place, middle);
                (self.expected(subject, view, &pose, (middle, radius), rays), pose)
            };
            let mut coarse: Vec<(f64, (f64, DVec3))> =
                near.into_iter().step_by(step).map(|at| (look(at, RAYS / 20).0, at)).collect();
            coarse.sort_by(|a, b| b.0.total_cmp(&a.0));
            for (odds, pose) in coarse.into_iter().take(TRIED.1).map(|(_, at)| look(at, RAYS)) {
                if odds > best.as_ref().map_or(0.0, |best| best.odds) {
                    let pose = SensorPose::new(pose * body_from_image(&view.kept.sensor).inverse());
                    best = Some(Look { sensor: view.kept.sensor.spec().name.clone(), pose, odds });
                }
            }
        }
        best
    }

    /// The expected logarithm of the likelihood ratio of a reading from a pose of the image frame, by about `most` of its rays: for
    /// each ray the mean of the two cases that the thing is there and that it is not.
    fn expected(
        &self,
        subject: &Subject<'_>,
        view: &View,
        world_from_image: &Pose,
        (middle, radius): (DVec3, f64),
        most: usize,
    ) -> f64 {
        let toward = world_from_image.inverse().transform_point(middle);
        let distance = toward.length();
        let cone = (radius / distance.max(radius)).asin().cos() * distance;
        let rays: Vec<&DVec3> = view.kept.rays.iter().filter(|ray| ray.dot(toward) >= cone).collect();
        let step = rays.len().div_ceil(most.max(1)).max(1);
        let spec = view.kept.sensor.spec();
        let mut sum = 0.0;
        for ray in rays.into_iter().step_by(step) {
            let (origin, ray) = (world_from_image.translation, world_from_image.rotation * *ray);
            let reads = |surface: &Option<Surface>| surface.map_or(f64::INFINITY, |(range, _)| range);
            let (with, without) = self.surfaces(subject, origin, ray, spec.range_max.min(1e5));
            let (a, b) = (reads(&with), reads(&without));
            if a != b && a.min(b) >= spec.range_min {
                sum += 0.25 * (squared(view, a, without) + squared(view, b, with));
            }
        }
        sum * step as f64
    }

    /// What a ray meets first with the thing, and without it.
    fn surfaces(
        &self,
        subject: &Subject<'_>,
        origin: DVec3,
        ray: DVec3,
        reach: f64,
    ) -> (Option<Surface>, Option<Surface>) {
        let caster = self.decision.caster;
        let surface = |range: f64, normal: DVec3| (range, normal.dot(ray).abs());
        let cast = |but: Option<u32>| caster.cast(origin, ray, reach, but).map(|met| surface(met.range, met.normal));
        let nearer = |a: Option<Surface>, b: Option<Surface>| a.into_iter().chain(b).min_by(|x, y| x.0.total_cmp(&y.0));
        let first = caster.cast(origin, ray, reach, None);
        let own = first.map(|met| surface(met.range, met.normal));
        match subject {
            Subject::Object(object) if first.is_some_and(|met| met.object == *object) => (own, cast(Some(*object))),
            Subject::Part(object, bounds) if first.is_some_and(|met| met.object == *object) => {
                let pose = self.decision.environment.objects()[*object as usize].world_from_object;
                let p = pose.inverse().transform_point(origin + own.map_or(0.0, |own| own.0) * ray);
                let is_in = p.cmpge(bounds.min - ON_BOX).all() && p.cmple(bounds.max + ON_BOX).all();
                (own, if is_in { cast(Some(*object)) } else { own })
            }
            Subject::Object(_) | Subject::Part(..) => (own, own),
            Subject::Moved(object, pose) => {
                let there = caster.cast_at(*object, pose, (origin, ray, reach));
                (nearer(cast(Some(*object)), there.map(|met| surface(met.range, met.normal))), own)
            }
            Subject::Box(found) => (nearer(own, found.meet(origin, ray).filter(|met| met.0 <= reach)), own),
        }
    }
}

/// The pose of the image frame at a place, of a robot that turns until the sensor's x axis points at something.
fn facing(view: &View, place: DVec3, at: DVec3) -> Pose {
    let world_from_sensor = view.world_from_image.rotation * body_from_image(&view.kept.sensor).rotation.inverse();
    let (ahead, toward) = (world_from_sensor * DVec3::X, at - place);
    let turn = DQuat::from_rotation_z(toward.y.atan2(toward.x) - ahead.y.atan2(ahead.x));
    Pose { translation: place, rotation: (turn * view.world_from_image.rotation).normalize() }
}

type Key = [i32; 2];

fn key(p: DVec3) -> Key {
    [p.x, p.y].map(|x| (x / CELL).round() as i32)
}

/// The places that something new is too near to.
fn blocked(decision: &Decision<'_>) -> BTreeSet<Key> {
    let around = (AWAY / CELL).ceil() as i32;
    let near = |p: DVec3| {
        let [x, y] = key(p);
        let all = (-around..=around).flat_map(move |dx| (-around..=around).map(move |dy| [x + dx, y + dy]));
        all.filter(move |k| (p.truncate() - CELL * glam::DVec2::from(k.map(f64::from))).length() < AWAY)
    };
    let groups = decision.voxels.groups(&crate::Occupied::default());
    groups
        .concat()
        .into_iter()
        .filter_map(|voxel| decision.voxels.spot(voxel))
        .map(|spot| spot.mean)
        .flat_map(near)
        .collect()
}

/// Free places at the height of a sensor that can be reached from where it was, the nearest first.
fn reached(world: &World, from: impl Iterator<Item = DVec3>, news: &BTreeSet<Key>) -> Vec<DVec3> {
    let mut found = QueryResult::default();
    let mut next: VecDeque<(DVec3, Option<f64>)> = VecDeque::new();
    let (mut known, mut places) = (BTreeSet::new(), Vec::new());
    for p in from {
        // Where the sensor was, a robot can be.
        if known.insert(key(p)) {
            next.push_back((p, height_above(world, p, 10.0, &mut found)));
        }
    }
    while let Some((p, floor)) = next.pop_front() {
        places.push(p);
        if places.len() == MOST_PLACES {
            break;
        }
        let [x, y] = key(p);
        for beside in [[x - 1, y], [x + 1, y], [x, y - 1], [x, y + 1]] {
            if !known.insert(beside) || news.contains(&beside) {
                continue;
            }
            let [x, y] = beside.map(|k| CELL * f64::from(k));
            if let Some(place) = stood(world, DVec3::new(x, y, p.z), floor, &mut found) {
                next.push_back((place, floor));
            }
        }
    }
    places
}

/// The place of a sensor at its height above the floor, if a robot can stand there.
fn stood(world: &World, at: DVec3, floor: Option<f64>, found: &mut QueryResult) -> Option<DVec3> {
    let here = height_above(world, at, 10.0, found);
    let (place, lowest) = match (floor, here) {
        (Some(usual), Some(height)) if (height - usual).abs() <= KERB => {
            (at + (usual - height) * DVec3::Z, usual - LOWEST)
        }
        (None, None) => (at, 0.0),
        _ => return None,
    };
    let steps = (lowest / STEP).max(0.0).floor() as u32;
    (0..=steps).all(|k| is_clear(world, place - f64::from(k) * STEP * DVec3::Z, found)).then_some(place)
}
