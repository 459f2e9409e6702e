//! Compares the findings of a learner with the truth.

use super::case::Case;
use glam::DVec3;
use presight_model::environment::{Environment, Object};
use presight_model::geometry::{Aabb, Pose, SensorPose};
use presight_model::sensor::Sensor;
use presight_predict::predict::{Backend, Options, Predictor};
use presight_render::plan::{Images, Output, Outputs};
use presight_update::{FindingKind, SiteFindings, UprightBox};
use std::collections::BTreeMap;

/// A change is visible if this number of pixels changes by more than this distance, metres, in this number of views.
const VISIBLE: (usize, f64, usize) = (10, 0.1, 5);

/// What fewer views see at its new place is not decided: views that find something new.
const SEEN: usize = 3;

/// Counts of one drive or of several.
#[derive(Clone, Debug, Default)]
pub struct Score {
    pub removed: (usize, usize),
    /// The removed ones that as many views see past: new things only cover the others.
    pub seen_past: (usize, usize),
    pub moved: (usize, usize),
    /// The moved ones that three views see where they stand now.
    pub moved_seen: (usize, usize),
    pub added: (usize, usize),
    /// Metres by which the middles of moved objects are off.
    pub places: Vec<f64>,
    /// Objects that stand and were decided; the ones found gone, and moved, by mistake.
    pub standing: usize,
    pub false_gone: usize,
    pub false_moved: usize,
    pub false_new: usize,
    /// Changed objects that were found moved to where something else stands.
    pub elsewhere: usize,
    /// Names of what went wrong.
    pub notes: Vec<String>,
    /// Names of visible changes that were not found, with their causes.
    pub missed: Vec<(String, String)>,
}

impl Score {
    pub fn add(&mut self, other: &Self) {
        let sum = |a: &mut (usize, usize), b: (usize, usize)| *a = (a.0 + b.0, a.1 + b.1);
        sum(&mut self.removed, other.removed);
        sum(&mut self.seen_past, other.seen_past);
        sum(&mut self.moved, other.moved);
        sum(&mut self.moved_seen, other.moved_seen);
        sum(&mut self.added, other.added);
        self.places.extend(&other.places);
        self.standing += other.standing;
        self.false_gone += other.false_gone;
        self.false_moved += other.false_moved;
        self.false_new += other.false_new;
        self.elsewhere += other.elsewhere;
    }

    pub fn row(&self, name: &str) -> String {
        let mut places = self.places.clone();
        places.sort_by(f64::total_cmp);
        let at =
            |share: f64| places.get(((places.len().max(1) - 1) as f64 * share) as usize).map_or(f64::NAN, |x| 1e3 * x);
        format!(
            "| {name} | {} | {} | {} | {} | {:.1}, {:.1} | {} of {} | {} | {} | {} |",
            share(self.removed),
            share(self.moved),
            share(self.moved_seen),
            share(self.added),
            at(0.5),
            at(0.95),
            self.false_gone,
            self.standing,
            self.false_moved,
            self.false_new,
            self.elsewhere
        )
    }
}

/// A count with its 95 % interval.
pub fn share((found, all): (usize, usize)) -> String {
    let (low, high) = interval(found, all);
    format!("{found} of {all} ({:.0} to {:.0} %)", 100.0 * low, 100.0 * high)
}

/// In how many views an object changes enough pixels, in how many of them where it stands now, and in how many views
/// are past it.
type Seen = (usize, usize, usize);

pub const HEAD: &str = "| drive | removed, found gone | moved, found | seen at the new place | added, found | place mm p50, p95 | false deletions | moved that stand | false new | moved to another's place |\n|---|---|---|---|---|---|---|---|---|---|";

/// Wilson's 95 % interval of a share.
fn interval(found: usize, all: usize) -> (f64, f64) {
    if all == 0 {
        return (0.0, 1.0);
    }
    let (n, p, z) = (all as f64, found as f64 / all as f64, 1.96);
    let (middle, half) = ((p + z * z / (2.0 * n)), z * (p * (1.0 - p) / n + z * z / (4.0 * n * n)).sqrt());
    ((middle - half) / (1.0 + z * z / n), (middle + half) / (1.0 + z * z / n))
}

/// In how many views each changed object changes enough pixels, and in how many of them where it stands now, for the
/// sensor of several that sees it in most views.
fn visible_by(case: &Case, sensors: &[&Sensor], poses: &[Pose]) -> BTreeMap<String, Seen> {
    let mut all = BTreeMap::<String, Seen>::new();
    for (name, views) in sensors.iter().flat_map(|sensor| visible(case, sensor, poses)) {
        let most = all.entry(name).or_default();
        *most = (most.0.max(views.0), most.1.max(views.1), most.2.max(views.2));
    }
    all
}

/// As [`visible_by`], of one sensor.
fn visible(case: &Case, sensor: &Sensor, poses: &[Pose]) -> BTreeMap<String, Seen> {
    let mut predictor = Predictor::new(Options::new(Backend::Cpu).with_threads(1)).expect("a predictor");
    let outputs = Outputs::of(&[Output::Range, Output::ObjectId]);
    let mut views: BTreeMap<String, Seen> = BTreeMap::new();
    for pose in poses {
        let world_from_sensor = *pose * sensor.spec().mount;
        let mut images = [Images::default(), Images::default()];
        for (world, image) in [&case.map, &case.site].into_iter().zip(&mut images) {
            predictor
                .predict_images(world, sensor, &SensorPose::new(world_from_sensor), outputs, image)
                .expect("a prediction");
        }
        let name = |environment: &Environment, id: u32| {
            id.checked_sub(1).map(|i| environment.objects()[i as usize].name.clone())
        };
        let mut pixels: BTreeMap<String, Seen> = BTreeMap::new();
        for i in 0..images[0].range.len() {
            let (a, b) = (images[0].range[i], images[1].range[i]);
            let differ = (a.is_finite() || b.is_finite()) && !((f64::from(a) - f64::from(b)).abs() <= VISIBLE.1);
            if differ {
                let before = name(case.map.environment(), images[0].object_id[i]);
                let after = name(case.site.environment(), images[1].object_id[i]);
                let is_changed =
                    |n: &String| case.removed.contains(n) || case.moved.contains_key(n) || case.added.contains(n);
                after.iter().filter(|n| is_changed(n)).for_each(|n| pixels.entry(n.clone()).or_default().1 += 1);
                let is_past = f64::from(a) + VISIBLE.1 < f64::from(b) && a.is_finite();
                if is_past && let Some(n) = before.clone().filter(is_changed) {
                    pixels.entry(n).or_default().2 += 1;
                }
                let mut both: Vec<String> = before.into_iter().chain(after).filter(is_changed).collect();
                both.dedup();
                both.into_iter().for_each(|n| pixels.entry(n).or_default().0 += 1);
            }
        }
        for (name, (all, now, past)) in pixels {
            let sum = views.entry(name).or_default();
            sum.0 += usize::from(all >= VISIBLE.0);
            sum.1 += usize::from(now >= VISIBLE.0);
            sum.2 += usize::from(past >= VISIBLE.0);
        }
    }
    views
}

fn grown(bounds: Aabb, by: f64) -> Aabb {
    Aabb { min: bounds.min - by, max: bounds.max + by }
}

fn holds(b: &Aabb, p: DVec3) -> bool {
    p.cmpge(b.min).all() && p.cmple(b.max).all()
}

/// Compares findings with the truth.
pub fn score(case: &Case, sensors: &[&Sensor], poses: &[Pose], findings: &SiteFindings) -> Score {
    let (map, site) = (case.map.environment(), case.site.environment());
    let views = visible_by(case, sensors, poses);
    let is_visible = |name: &String| views.get(name).is_some_and(|n| n.0 >= VISIBLE.2);
    let mut score = Score::default();
    let what: BTreeMap<&str, &FindingKind> = findings.changes.iter().map(|f| (f.object.as_str(), &f.kind)).collect();
    let bounds = |name: &str| site.object(name).map(|o| o.world_bounds());
    // Where something stands that the map does not have there.
    let news: Vec<Aabb> = case.added.iter().chain(case.moved.keys()).filter_map(|name| bounds(name)).collect();
    let stands_at = |finding: &FindingKind, name: &str| match finding {
        FindingKind::Moved { world_from_object, .. } => {
            let object = map.object(name)?;
            let middle = object.mesh.bounds().transformed(&object.object_from_mesh).center();
            Some(world_from_object.transform_point(middle))
        }
        FindingKind::New(found) => Some(found.pose.translation),
        _ => None,
    };
    let reported: Vec<DVec3> = findings.changes.iter().filter_map(|f| stands_at(&f.kind, &f.object)).collect();
    // Objects of equal meshes are exchangeable: one may be found where another was moved or added.
    let equal = |name: &str, p: DVec3| {
        let size = |o: &Object| o.mesh.bounds().transformed(&o.object_from_mesh).half_extent();
        let size_of = map.object(name).map(size);
        case.added.iter().chain(case.moved.keys()).filter_map(|other| site.object(other)).any(|other| {
            holds(&grown(other.world_bounds(), 0.1), p) && size_of.is_some_and(|s| s.distance(size(other)) < 0.02)
        })
    };
    let is_reported = |b: Aabb| reported.iter().any(|p| holds(&grown(b, 0.1), *p));
    for name in case.removed.iter().filter(|name| is_visible(name)) {
        let found = match what.get(name.as_str()).copied() {
            Some(FindingKind::Gone) => true,
            // An object of equal mesh that stands elsewhere counts as right.
            Some(moved) if matches!(moved, FindingKind::Moved { .. }) => {
                stands_at(moved, name).is_some_and(|p| equal(name, p))
            }
            _ => false,
        };
        score.removed = (score.removed.0 + usize::from(found), score.removed.1 + 1);
        if views[name].2 >= VISIBLE.2 {
            score.seen_past = (score.seen_past.0 + usize::from(found), score.seen_past.1 + 1);
        }
        if !found {
            let why = format!(
                "removed, visible in {} views, {} past it: {}",
                views[name].0,
                views[name].2,
                state(findings, name)
            );
            score.missed.push((name.clone(), why));
        }
    }
    for (name, pose) in case.moved.iter().filter(|(name, _)| is_visible(name)) {
        let there = bounds(name).expect("it stands");
        let object = map.object(name).expect("it exists");
        let middle = object.mesh.bounds().transformed(&object.object_from_mesh).center();
        let found = match what.get(name.as_str()).copied() {
            Some(FindingKind::Moved { world_from_object, .. }) => {
                let off = world_from_object.transform_point(middle).distance(pose.transform_point(middle));
                if off < 0.3 {
                    score.places.push(off);
                }
                if off > 0.01 {
                    let p = world_from_object.transform_point(middle);
                    let there = |o: &&Object| !o.is_deleted() && holds(&grown(o.world_bounds(), 0.02), p);
                    let near: Vec<&str> = site.objects().iter().filter(there).map(|o| o.name.as_str()).collect();
                    score.notes.push(format!("moved {name}: place off by {off:.3}, within the bounds of {near:?}"));
                }
                let is_right = off < 0.3 || equal(name, world_from_object.transform_point(middle));
                score.elsewhere += usize::from(!is_right);
                is_right
            }
            Some(FindingKind::Gone) => is_reported(there),
            _ => false,
        };
        score.moved = (score.moved.0 + usize::from(found), score.moved.1 + 1);
        if views[name].1 >= SEEN {
            score.moved_seen = (score.moved_seen.0 + usize::from(found), score.moved_seen.1 + 1);
        }
        if !found {
            let far = object.world_from_object.transform_point(middle).distance(pose.transform_point(middle));
            let (state, near) = (state(findings, name), nearest(findings, there.center()));
            let why = format!(
                "moved by {far:.2} m, visible in {} views, {} of its new place: {state}; now at {:.2}, {near}",
                views[name].0,
                views[name].1,
                there.center()
            );
            score.missed.push((name.clone(), why));
        }
    }
    for name in case.added.iter().filter(|name| is_visible(name)) {
        let found = is_reported(bounds(name).expect("it stands"));
        score.added = (score.added.0 + usize::from(found), score.added.1 + 1);
        if !found {
            let b = bounds(name).expect("it stands");
            let (size, near) = (b.max - b.min, nearest(findings, b.center()));
            let why = format!("{size:.2} at {:.2}, visible in {} views, {near}", b.center(), views[name].0);
            score.missed.push((name.clone(), why));
        }
    }
    count_false(case, findings, &news, &mut score);
    score
}

/// A report about an object.
fn state(findings: &SiteFindings, name: &str) -> String {
    let change = findings.changes.iter().find(|f| f.object == *name).map(|f| format!("{:?}", f.kind));
    let doubt = findings.doubts.iter().find(|d| d.object == *name).map(|d| format!("in doubt: {}", d.why));
    let stands = findings.confirmed.iter().any(|n| n == name).then(|| "confirmed".to_owned());
    change.or(doubt).or(stands).unwrap_or_else(|| "no view says anything".to_owned())
}

/// The box of something new that is nearest to a place.
fn nearest(findings: &SiteFindings, p: DVec3) -> String {
    let boxes = findings.changes.iter().filter_map(|f| if let FindingKind::New(b) = &f.kind { Some(b) } else { None });
    let far = |b: &UprightBox| b.pose.translation.distance(p);
    let near = boxes.min_by(|a, b| far(a).total_cmp(&far(b)));
    near.map_or_else(String::new, |b| format!("the nearest box {:.2} at {:.2}", b.size, b.pose.translation))
}

fn count_false(case: &Case, findings: &SiteFindings, news: &[Aabb], score: &mut Score) {
    let stands = |name: &str| !case.removed.contains(name) && !case.moved.contains_key(name);
    score.standing = findings.confirmed.iter().filter(|name| stands(name)).count();
    for finding in &findings.changes {
        let name = finding.object.as_str();
        match &finding.kind {
            FindingKind::Gone if stands(name) => {
                score.false_gone += 1;
                score.standing += 1;
                score.notes.push(format!("false deletion of {name}: {:.1}, {} views", finding.l, finding.views));
            }
            FindingKind::Moved { distance, .. } if stands(name) => {
                score.false_moved += 1;
                score.standing += 1;
                score.notes.push(format!("{name} stands and was found moved by {distance:.3}"));
            }
            FindingKind::New(found) if !news.iter().any(|b| holds(&grown(*b, 0.15), found.pose.translation)) => {
                score.false_new += 1;
                let b = found.pose.translation;
                let holds = |o: &&Object| !o.is_deleted() && holds(&grown(o.world_bounds(), 0.05), b);
                let near: Vec<&str> =
                    case.site.environment().objects().iter().filter(holds).map(|o| o.name.as_str()).collect();
                score.notes.push(format!("false new {:.2} at {b:.2}, within the bounds of {near:?}", found.size));
            }
            _ => {}
        }
    }
}
