//! From evidence to changes: objects that are gone, moved, new, or still in doubt.

use crate::boxes::{UprightBox, split};
use crate::evidence::{BIG, Book, Evidence, PART};
use crate::fit::Thing;
use crate::learn::{LearnOptions, Learner};
use crate::lookout::{Look, Lookout};
use crate::moves::Place;
use crate::parts::{Part, parts};
use crate::recognize::{OWN, Recognized};
use crate::shown::growth_of_new;
use crate::view::{NOTHING, Says, View};
use crate::voxels::{Occupied, Voxels, joined};
use glam::DVec3;
use presight_localize::verdict::body_from_image;
use presight_model::caster::RayCaster;
use presight_model::environment::{Appearance, Environment, Material};
use presight_model::geometry::{Aabb, Pose, SensorPose};
use presight_model::world::World;
use std::collections::{BTreeMap, BTreeSet, VecDeque};

/// The shortest move that counts, metres.
const LEAST_MOVE: f64 = 0.02;
/// Voxels and points of the smallest thing that is reported as new.
pub(crate) const LEAST_NEW: (usize, usize) = (3, 20);
/// The largest share of views that may see through most of a new thing.
const MOST_AWAY: f64 = 0.1;
/// If a larger share of the decided objects changed, the map, the mount or the sensor is wrong.
const MOST_CHANGED: f64 = 0.5;
/// Fewer changes are never too many.
const FEW: usize = 3;

/// What happened to the model.
#[derive(Clone, Debug, PartialEq)]
pub enum What {
    /// An object is not there any more.
    Gone,
    /// An object stands elsewhere.
    Moved {
        /// Its pose now.
        world_from_object: Pose,
        /// How far its middle moved, metres.
        distance: f64,
    },
    /// Something stands where the model has nothing; this box is around the points on it.
    New(UprightBox),
    /// Something of a known shape stands where the model has nothing.
    Recognized(Recognized),
    /// A part of a big object is gone; the box around it is in the object's frame.
    Part(Aabb),
    /// Sensors of this class see through an object that others see, or that they see themselves where rays meet it flat: glass.
    SeenThrough(String),
    /// An object stands there at times, and at others not, as a door does.
    ComesAndGoes,
}

/// One difference between model and site, sure enough to change the model.
#[derive(Clone, Debug, PartialEq)]
pub struct Finding {
    /// The path of the object; empty for something new.
    pub object: String,
    /// What happened.
    pub what: What,
    /// What speaks for it: the odds, their logarithm counted positive.
    pub l: f64,
    /// Views that said so.
    pub views: u32,
    /// Where it is seen best.
    pub sight: Option<Sight>,
    /// The odds of the object, logarithm, after each view.
    pub growth: Vec<f32>,
}

/// A view that shows a finding.
#[derive(Clone, Debug, PartialEq)]
pub struct Sight {
    /// The number of the drive, from 0.
    pub drive: usize,
    /// The name of the sensor.
    pub sensor: String,
    /// The stamp of the frame, seconds.
    pub stamp: f64,
    /// The pose of the sensor.
    pub pose: SensorPose,
}

/// An object in doubt.
#[derive(Clone, Debug, PartialEq)]
pub struct Doubt {
    /// Its path.
    pub object: String,
    /// Why.
    pub why: String,
    /// The free pose from which predictions with and without it differ most; `None` if none shows it.
    pub look: Option<Look>,
}

/// What drives say of a model.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Findings {
    /// The changes, surest first within each kind.
    pub changes: Vec<Finding>,
    /// Objects in doubt.
    pub doubts: Vec<Doubt>,
    /// Objects that stand.
    pub confirmed: Vec<String>,
    /// Objects that no view said anything of.
    pub unseen: usize,
    /// Why nothing can be changed at all, if so.
    pub wrong: Option<String>,
}

/// A group of points that nothing explains.
pub(crate) struct Group {
    pub points: Vec<DVec3>,
    pub bounds: Aabb,
}

impl Learner {
    /// What the drives so far say of the world that they were compared with. This decides nothing for good: more drives
    /// may follow.
    pub fn findings(&mut self, world: &World) -> Findings {
        let class = self.views.back().map_or_else(String::new, |view| view.kept.sensor.spec().class.clone());
        self.caster(world, &class);
        let Self { casters, book, voxels, views, options, .. } = &*self;
        let Some(caster) = casters.get(&class) else { return Findings::default() };
        let environment = world.environment();
        let decision = Decision { environment, caster, book, voxels, views, options };
        let mut findings = decision.findings();
        if !findings.doubts.is_empty() {
            let lookout = Lookout::new(&decision, world);
            for doubt in &mut findings.doubts {
                doubt.look = environment.index_of(&doubt.object).ok().and_then(|object| lookout.at_object(object));
            }
        }
        Findings { wrong: self.pulled.wrong().or(findings.wrong), ..findings }
    }

    /// For each finding the free pose from which predictions with and without it differ most; `None` if no pose shows it.
    pub fn looks(&mut self, world: &World, findings: &[&Finding]) -> Vec<Option<Look>> {
        let class = self.views.back().map_or_else(String::new, |view| view.kept.sensor.spec().class.clone());
        self.caster(world, &class);
        let Self { casters, book, voxels, views, options, .. } = &*self;
        let Some(caster) = casters.get(&class) else { return vec![None; findings.len()] };
        let decision = Decision { environment: world.environment(), caster, book, voxels, views, options };
        let lookout = (!findings.is_empty()).then(|| Lookout::new(&decision, world));
        findings.iter().map(|finding| lookout.as_ref()?.at_finding(finding)).collect()
    }
}

pub(crate) struct Decision<'a> {
    pub environment: &'a Environment,
    pub caster: &'a RayCaster,
    pub book: &'a Book,
    pub voxels: &'a Voxels,
    pub views: &'a VecDeque<View>,
    pub options: &'a LearnOptions,
}

impl Decision<'_> {
    fn findings(&self) -> Findings {
        let mut found = Findings::default();
        let groups = groups(self.voxels, self.views);
        let doubted: Vec<u32> = self.live().filter(|object| self.is_doubted(*object)).collect();
        let moves = self.moves(&doubted, &groups);
        for object in self.live() {
            let name = self.environment.objects()[object as usize].name.clone();
            match (self.book.objects.get(&object), moves.get(&object)) {
                (Some(_), Some(place)) => self.add_moved(&mut found, object, name, place),
                (None, _) => found.unseen += 1,
                (Some(evidence), None) => self.add_standing(&mut found, object, name, evidence),
            }
        }
        let changed = found.changes.iter().filter(|f| matches!(f.what, What::Gone | What::Moved { .. })).count();
        let decided = changed + found.confirmed.len();
        if changed > FEW && changed as f64 > MOST_CHANGED * decided as f64 {
            found.wrong = Some(format!(
                "{changed} of {decided} objects seem to be gone or moved: check the map, the sensor and its mount"
            ));
        }
        let explained: Vec<(u32, Pose)> = moves.iter().map(|(object, place)| (*object, place.pose)).collect();
        self.add_new(&mut found, &groups, &explained);
        found.changes.sort_by(by_rank);
        found
    }

    pub(crate) fn finding(&self, object: String, what: What, l: f64, views: u32) -> Finding {
        let index = self.environment.index_of(&object).ok();
        let growth = index.and_then(|index| self.book.growth.get(&index)).cloned().unwrap_or_default();
        let region = match &what {
            What::New(found) => Some((found.pose.translation, 0.5 * found.size.length())),
            What::Recognized(known) => {
                let thing = Thing::of_bounds(NOTHING, &known.shape.bounds());
                Some((known.world_from_object.transform_point(thing.middle), thing.radius))
            }
            What::Moved { world_from_object, .. } => index.map(|object| {
                let thing = Thing::new(self.environment, object);
                (world_from_object.transform_point(thing.middle), thing.radius)
            }),
            What::Gone | What::Part(_) | What::SeenThrough(_) | What::ComesAndGoes => None,
        };
        let growth = match (&index, region) {
            (None, Some(region)) => growth_of_new(self.views.iter(), region, self.options.most_per_view),
            _ => growth,
        };
        let shows = |view: &&View| {
            let through = |at: &usize| Some(view.object[*at]) == index && view.says[*at] == Says::Through;
            let near = |p: &&DVec3| region.is_some_and(|(middle, radius)| p.distance(middle) <= radius);
            (0..view.says.len()).filter(through).count() + view.news.iter().filter(near).count()
        };
        let best = self.views.iter().max_by_key(shows).filter(|view| shows(view) > 0);
        let sight = best.map(|view| Sight {
            drive: view.drive,
            sensor: view.kept.sensor.spec().name.clone(),
            stamp: view.stamp,
            pose: SensorPose::new(view.world_from_image * body_from_image(&view.kept.sensor).inverse()),
        });
        Finding { object, what, l, views, sight, growth }
    }

    pub fn live(&self) -> impl Iterator<Item = u32> {
        (0..).zip(self.environment.objects()).filter(|(_, o)| !o.is_deleted()).map(|(object, _)| object)
    }

    /// True if several views spoke against an object, and not only on a few of its cells.
    fn is_doubted(&self, object: u32) -> bool {
        let Some(evidence) = self.book.objects.get(&object) else { return false };
        let (stand, gone) = self.book.decided(object, self.options);
        let size = 2.0 * Thing::new(self.environment, object).radius;
        let many = evidence.against >= self.options.least_views;
        size <= BIG && many && (evidence.l <= -self.options.sure || (gone >= 2 && 5 * gone >= stand + gone))
    }

    fn is_gone(&self, object: u32, evidence: &Evidence) -> bool {
        let (stand, gone) = self.book.decided(object, self.options);
        evidence.l <= -self.options.sure
            && evidence.against >= self.options.least_views
            && gone as f64 >= self.options.least_agreeing * (stand + gone).max(1) as f64
    }

    fn add_moved(&self, found: &mut Findings, object: u32, name: String, place: &Place) {
        let thing = Thing::new(self.environment, object);
        let before = self.environment.objects()[object as usize].world_from_object;
        let distance = before.transform_point(thing.middle).distance(place.pose.transform_point(thing.middle));
        let turned = before.rotation.angle_between(place.pose.rotation) * thing.radius;
        if distance.max(turned) < LEAST_MOVE {
            found.confirmed.push(name);
            return;
        }
        let what = What::Moved { world_from_object: place.pose, distance };
        found.changes.push(self.finding(name, what, place.score.l, place.score.views));
    }

    /// An object that did not move: it is gone, or seen through by some sensors, or comes and goes, or else.
    fn add_standing(&self, found: &mut Findings, object: u32, name: String, evidence: &Evidence) {
        let is_gone = self.is_gone(object, evidence);
        let mut through = self.book.see_through(object, self.options);
        if is_gone && self.has_glass(object) {
            through.extend(self.views.back().map(|view| view.kept.sensor.spec().class.clone()));
        }
        let what = if !through.is_empty() {
            through.into_iter().map(What::SeenThrough).collect()
        } else if is_gone {
            vec![What::Gone]
        } else if self.book.comes_and_goes(object, self.options) {
            vec![What::ComesAndGoes]
        } else {
            return self.add_rest(found, object, name, evidence);
        };
        let (l, views) = if is_gone { (-evidence.l, evidence.views) } else { (evidence.less, evidence.against) };
        found.changes.extend(what.into_iter().map(|what| self.finding(name.clone(), what, l, views)));
    }

    /// True if some sensors see through a material of an object.
    fn has_glass(&self, object: u32) -> bool {
        let mesh = &self.environment.objects()[object as usize].mesh;
        let materials = self.environment.materials();
        let is_glass = |material: &Material| material.appearance.values().any(|a| *a != Appearance::Opaque);
        (0..mesh.polygon_count() as u32).any(|polygon| is_glass(&materials[usize::from(mesh.material(polygon))]))
    }

    /// An object that is neither gone nor moved: it stands, perhaps without a part, or is in doubt.
    fn add_rest(&self, found: &mut Findings, object: u32, name: String, evidence: &Evidence) {
        let (stand, gone) = self.book.decided(object, self.options);
        let size = 2.0 * Thing::new(self.environment, object).radius;
        if size > BIG {
            let missing = parts(self.book.cells_of(object), PART, self.options);
            let finding = |part: Part| self.finding(name.clone(), What::Part(part.bounds), part.l, part.views);
            found.changes.extend(missing.into_iter().map(finding));
        }
        let standing = evidence.l >= self.options.sure && evidence.views >= self.options.least_views;
        let agree = stand as f64 >= self.options.least_agreeing * (stand + gone) as f64;
        if standing && (agree || size > BIG) {
            found.confirmed.push(name);
            return;
        }
        let why = if evidence.against == 0 {
            format!("seen in {} views, {} are needed", evidence.views, self.options.least_views)
        } else if gone > 0 && stand > 0 {
            format!("{gone} of {} cells of its surface are gone, {stand} stand", gone + stand)
        } else {
            format!("{} of {} views speak against it", evidence.against, evidence.views)
        };
        found.doubts.push(Doubt { object: name, why, look: None });
    }

    /// The points that objects at other poses than the model's do not explain.
    pub(crate) fn unexplained(&self, points: &[DVec3], by: &[(u32, Pose)]) -> Vec<DVec3> {
        let is_explained = |p: &DVec3| {
            by.iter().any(|(object, pose)| {
                self.caster.nearest_on(*object, pose.inverse().transform_point(*p), OWN).is_some()
            })
        };
        points.iter().filter(|p| !is_explained(p)).copied().collect()
    }

    /// What no moved or recognized object explains, in pieces, is new.
    pub(crate) fn add_new(&self, found: &mut Findings, groups: &[Group], explained: &[(u32, Pose)]) {
        for group in groups {
            let left = self.unexplained(&group.points, explained);
            let pieces = self.pieces(&left);
            let whole = if pieces.is_empty() && self.is_thing(&left) { vec![left] } else { pieces };
            for points in whole.into_iter().flat_map(split) {
                let l = self.options.most_per_view * f64::from(self.options.least_views);
                let what = What::New(UprightBox::of(&points));
                found.changes.push(self.finding(String::new(), what, l, self.options.least_views));
            }
        }
    }

    pub(crate) fn is_thing(&self, points: &[DVec3]) -> bool {
        let voxels: BTreeSet<[i32; 3]> = points.iter().map(|p| self.voxels.key(*p)).collect();
        voxels.len() >= LEAST_NEW.0 && points.len() >= LEAST_NEW.1
    }

    /// The pieces of a group that are large enough; the voxels of a piece touch.
    pub(crate) fn pieces(&self, points: &[DVec3]) -> Vec<Vec<DVec3>> {
        let keys = joined(points.iter().map(|p| self.voxels.key(*p)), 1);
        let of_voxel: BTreeMap<[i32; 3], usize> =
            keys.iter().enumerate().flat_map(|(piece, keys)| keys.iter().map(move |key| (*key, piece))).collect();
        let mut pieces = vec![Vec::new(); keys.len()];
        points.iter().for_each(|p| pieces[of_voxel[&self.voxels.key(*p)]].push(*p));
        pieces.retain(|piece| self.is_thing(piece));
        pieces
    }
}

/// The order of findings: by kind, then the surest first.
pub(crate) fn by_rank(a: &Finding, b: &Finding) -> std::cmp::Ordering {
    let rank = |f: &Finding| match f.what {
        What::Gone => 0,
        What::Moved { .. } => 1,
        What::Recognized(_) => 2,
        What::New(_) => 3,
        What::Part(_) => 4,
        What::SeenThrough(_) => 5,
        What::ComesAndGoes => 6,
    };
    rank(a).cmp(&rank(b)).then(b.l.total_cmp(&a.l))
}

/// The groups of occupied voxels, with the points in them. A person who comes by again and again leaves voxels that are hit more
/// often than passed, and not a thing: in other views most of these voxels are seen through at once.
pub(crate) fn groups(voxels: &Voxels, views: &VecDeque<View>) -> Vec<Group> {
    let keys = voxels.groups(&Occupied::default());
    let mut of_voxel = BTreeMap::new();
    for (group, keys) in keys.iter().enumerate() {
        of_voxel.extend(keys.iter().map(|key| (*key, group)));
    }
    let mut points: Vec<Vec<DVec3>> = vec![Vec::new(); keys.len()];
    // Views that see something of a group, and views that see through most of it.
    let mut votes = vec![(0usize, 0usize); keys.len()];
    for view in views {
        let mut seen = BTreeSet::new();
        for p in &view.news {
            if let Some(group) = of_voxel.get(&voxels.key(*p)) {
                points[*group].push(*p);
                seen.insert(*group);
            }
        }
        for (group, keys) in keys.iter().enumerate() {
            if seen.contains(&group) {
                votes[group].0 += 1;
            } else {
                let passed = |key: &&[i32; 3]| voxels.spot(**key).is_some_and(|spot| view.passed(&spot, voxels.size()));
                let through = keys.iter().filter(passed).count();
                votes[group].1 += usize::from(2 * through > keys.len());
            }
        }
    }
    let stands = |(there, away): (usize, usize)| away as f64 <= MOST_AWAY * (there + away) as f64;
    let group = |points: Vec<DVec3>| Group { bounds: Aabb::of(points.iter().copied()), points };
    let standing = points.into_iter().zip(votes).filter(|(_, votes)| stands(*votes)).map(|(points, _)| points);
    standing.filter(|points| !points.is_empty()).map(group).collect()
}
