//! Compares the findings of a learner with the truth.

use super::case::Case;
use glam::DVec3;
use presight_model::environment::Environment;
use presight_model::geometry::{Aabb, Pose};
use presight_model::sensor::Sensor;
use presight_predict::predict::{Backend, Options, Predictor};
use presight_render::plan::{Images, Output, Outputs};
use presight_update::{Findings, What};
use std::collections::BTreeMap;

/// A change is visible if this number of pixels changes by more than this distance, metres, in this number of views.
const VISIBLE: (usize, f64, usize) = (10, 0.1, 5);

/// Counts of one drive or of several.
#[derive(Clone, Debug, Default)]
pub struct Score {
    pub removed: (usize, usize),
    pub moved: (usize, usize),
    pub added: (usize, usize),
    /// Metres by which the middles of moved objects are off.
    pub places: Vec<f64>,
    /// Objects that stand and were decided; the ones found gone, and moved, by mistake.
    pub standing: usize,
    pub false_gone: usize,
    pub false_moved: usize,
    pub false_new: usize,
    /// Names of what went wrong.
    pub notes: Vec<String>,
}

impl Score {
    pub fn add(&mut self, other: &Self) {
        let sum = |a: &mut (usize, usize), b: (usize, usize)| *a = (a.0 + b.0, a.1 + b.1);
        sum(&mut self.removed, other.removed);
        sum(&mut self.moved, other.moved);
        sum(&mut self.added, other.added);
        self.places.extend(&other.places);
        self.standing += other.standing;
        self.false_gone += other.false_gone;
        self.false_moved += other.false_moved;
        self.false_new += other.false_new;
    }

    pub fn row(&self, name: &str) -> String {
        let share = |(found, all): (usize, usize)| {
            let (low, high) = interval(found, all);
            format!("{found} of {all} ({:.0} to {:.0} %)", 100.0 * low, 100.0 * high)
        };
        let mut places = self.places.clone();
        places.sort_by(f64::total_cmp);
        let at =
            |share: f64| places.get(((places.len().max(1) - 1) as f64 * share) as usize).map_or(f64::NAN, |x| 1e3 * x);
        format!(
            "| {name} | {} | {} | {} | {:.1}, {:.1} | {} of {} | {} | {} |",
            share(self.removed),
            share(self.moved),
            share(self.added),
            at(0.5),
            at(0.95),
            self.false_gone,
            self.standing,
            self.false_moved,
            self.false_new
        )
    }
}

pub const HEAD: &str = "| drive | removed, found gone | moved, found | added, found | place mm p50, p95 | false deletions | moved that stand | false new |\n|---|---|---|---|---|---|---|---|";

/// Wilson's 95 % interval of a share.
fn interval(found: usize, all: usize) -> (f64, f64) {
    if all == 0 {
        return (0.0, 1.0);
    }
    let (n, p, z) = (all as f64, found as f64 / all as f64, 1.96);
    let (middle, half) = ((p + z * z / (2.0 * n)), z * (p * (1.0 - p) / n + z * z / (4.0 * n * n)).sqrt());
    ((middle - half) / (1.0 + z * z / n), (middle + half) / (1.0 + z * z / n))
}

/// In how many views each changed object changes enough pixels: removed and moved ones by their name, added ones, too.
fn visible(case: &Case, sensor: &Sensor, poses: &[Pose]) -> BTreeMap<String, usize> {
    let mut predictor = Predictor::new(Options::new(Backend::Cpu).with_threads(1)).expect("a predictor");
    let outputs = Outputs::of(&[Output::Range, Output::ObjectId]);
    let mut views: BTreeMap<String, usize> = BTreeMap::new();
    for pose in poses {
        let world_from_sensor = *pose * sensor.spec().mount;
        let mut images = [Images::default(), Images::default()];
        for (world, image) in [&case.map, &case.site].into_iter().zip(&mut images) {
            predictor.predict_images(world, sensor, &world_from_sensor, outputs, image).expect("a prediction");
        }
        let name = |environment: &Environment, id: u32| {
            id.checked_sub(1).map(|i| environment.objects()[i as usize].name.clone())
        };
        let mut pixels: BTreeMap<String, usize> = BTreeMap::new();
        for i in 0..images[0].range.len() {
            let (a, b) = (images[0].range[i], images[1].range[i]);
            let differ = (a.is_finite() || b.is_finite()) && !((f64::from(a) - f64::from(b)).abs() <= VISIBLE.1);
            if differ {
                let before = name(case.map.environment(), images[0].object_id[i]);
                let after = name(case.site.environment(), images[1].object_id[i]);
                let is_changed =
                    |n: &String| case.removed.contains(n) || case.moved.contains_key(n) || case.added.contains(n);
                let mut both: Vec<String> = before.into_iter().chain(after).filter(is_changed).collect();
                both.dedup();
                both.into_iter().for_each(|n| *pixels.entry(n).or_default() += 1);
            }
        }
        pixels.into_iter().filter(|(_, n)| *n >= VISIBLE.0).for_each(|(n, _)| *views.entry(n).or_default() += 1);
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
pub fn score(case: &Case, sensor: &Sensor, poses: &[Pose], findings: &Findings) -> Score {
    let (map, site) = (case.map.environment(), case.site.environment());
    let views = visible(case, sensor, poses);
    let is_visible = |name: &String| views.get(name).is_some_and(|n| *n >= VISIBLE.2);
    let mut score = Score::default();
    let what: BTreeMap<&str, &What> = findings.changes.iter().map(|f| (f.object.as_str(), &f.what)).collect();
    let bounds = |name: &str| site.object(name).map(|o| o.world_bounds());
    // Where something stands that the map does not have there.
    let news: Vec<Aabb> = case.added.iter().chain(case.moved.keys()).filter_map(|name| bounds(name)).collect();
    let stands_at = |finding: &What, name: &str| match finding {
        What::Moved { world_from_object, .. } => {
            let object = map.object(name)?;
            let middle = object.mesh.bounds().transformed(&object.object_from_mesh).center();
            Some(world_from_object.transform_point(middle))
        }
        What::New(found) => Some(found.pose.translation),
        _ => None,
    };
    let reported: Vec<DVec3> = findings.changes.iter().filter_map(|f| stands_at(&f.what, &f.object)).collect();
    let is_reported = |b: Aabb| reported.iter().any(|p| holds(&grown(b, 0.1), *p));
    for name in case.removed.iter().filter(|name| is_visible(name)) {
        let found = match what.get(name.as_str()).copied() {
            Some(What::Gone) => true,
            // An object of equal mesh that stands elsewhere counts as right.
            Some(moved) if matches!(moved, What::Moved { .. }) => {
                stands_at(moved, name).is_some_and(|p| news.iter().any(|b| holds(&grown(*b, 0.1), p)))
            }
            _ => false,
        };
        score.removed = (score.removed.0 + usize::from(found), score.removed.1 + 1);
        if !found {
            score.notes.push(format!("removed {name}: {:?} {:?}", what.get(name.as_str()), doubt(findings, name)));
        }
    }
    for (name, pose) in case.moved.iter().filter(|(name, _)| is_visible(name)) {
        let there = bounds(name).expect("it stands");
        let object = map.object(name).expect("it exists");
        let middle = object.mesh.bounds().transformed(&object.object_from_mesh).center();
        let found = match what.get(name.as_str()).copied() {
            Some(What::Moved { world_from_object, .. }) => {
                let off = world_from_object.transform_point(middle).distance(pose.transform_point(middle));
                if off < 0.3 {
                    score.places.push(off);
                }
                if off > 0.01 {
                    score.notes.push(format!("moved {name}: place off by {off:.3}"));
                }
                off < 0.3 || news.iter().any(|b| holds(&grown(*b, 0.1), world_from_object.transform_point(middle)))
            }
            Some(What::Gone) => is_reported(there),
            _ => false,
        };
        score.moved = (score.moved.0 + usize::from(found), score.moved.1 + 1);
        if !found {
            let far = object.world_from_object.transform_point(middle).distance(pose.transform_point(middle));
            score.notes.push(format!(
                "moved {name} by {far:.2}: {:?} {:?}",
                what.get(name.as_str()),
                doubt(findings, name)
            ));
        }
    }
    for name in case.added.iter().filter(|name| is_visible(name)) {
        let found = is_reported(bounds(name).expect("it stands"));
        score.added = (score.added.0 + usize::from(found), score.added.1 + 1);
        if !found {
            score.notes.push(format!("added {name}: nothing at {:?}", bounds(name)));
        }
    }
    count_false(case, findings, &news, &mut score);
    score
}

fn doubt<'a>(findings: &'a Findings, name: &str) -> Option<&'a str> {
    findings.doubts.iter().find(|d| d.object == *name).map(|d| d.why.as_str())
}

fn count_false(case: &Case, findings: &Findings, news: &[Aabb], score: &mut Score) {
    let stands = |name: &str| !case.removed.contains(name) && !case.moved.contains_key(name);
    score.standing = findings.confirmed.iter().filter(|name| stands(name)).count();
    for finding in &findings.changes {
        let name = finding.object.as_str();
        match &finding.what {
            What::Gone if stands(name) => {
                score.false_gone += 1;
                score.standing += 1;
                score.notes.push(format!("false deletion of {name}: {:.1}, {} views", finding.l, finding.views));
            }
            What::Moved { distance, .. } if stands(name) => {
                score.false_moved += 1;
                score.standing += 1;
                score.notes.push(format!("{name} stands and was found moved by {distance:.3}"));
            }
            What::New(found) if !news.iter().any(|b| holds(&grown(*b, 0.15), found.pose.translation)) => {
                score.false_new += 1;
                score.notes.push(format!("false new {found:?}"));
            }
            _ => {}
        }
    }
}
