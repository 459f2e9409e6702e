//! From evidence to findings: each object is gone, moved, confirmed or in doubt, and the remaining points are new
//! objects.

use crate::decide::boxes::{UprightBox, split};
use crate::decide::decision::Decision;
use crate::decide::findings::{DoubtfulObject, FindingKind, SiteFindings, by_rank};
use crate::decide::fit::Thing;
use crate::decide::groups::{Group, groups};
use crate::decide::moves::Place;
use crate::decide::parts::{Part, parts};
use crate::decide::planner::ViewPlanner;
use crate::evidence::knowledge::Knowledge;
use crate::evidence::objects::{Evidence, MIN_DIVIDED, PART};
use presight_model::environment::{Appearance, Material};
use presight_model::geometry::Pose;
use presight_model::world::World;

/// Minimum distance of a reported move, metres.
const MIN_MOVE: f64 = 0.02;
/// If a larger share of the decided objects is gone or moved, the map, the mount or the sensor is wrong.
const MAX_CHANGED: f64 = 0.5;
/// This number of changes is always plausible.
const FEW_CHANGES: usize = 3;

/// All findings so far, with a planned view for each object in doubt.
pub(crate) fn findings(known: &Knowledge, world: &World) -> SiteFindings {
    let environment = world.environment();
    let Some(decision) = Decision::new(known, environment) else { return SiteFindings::default() };
    let mut findings = decision.findings();
    if !findings.doubts.is_empty() {
        let planner = ViewPlanner::new(&decision, world);
        for doubt in &mut findings.doubts {
            doubt.view = environment.index_of(&doubt.object).ok().and_then(|object| planner.at_object(object));
        }
    }
    SiteFindings { wrong: known.corrections.wrong().or(findings.wrong), ..findings }
}

impl Decision<'_> {
    fn findings(&self) -> SiteFindings {
        let mut found = SiteFindings::default();
        let groups = groups(self.known);
        let doubted: Vec<u32> = self.live().filter(|object| self.is_doubted(*object)).collect();
        let moves = self.moves(&doubted, &groups);
        for object in self.live() {
            let name = self.environment.objects()[object as usize].name.clone();
            match (self.known.book.objects.get(&object), moves.get(&object)) {
                (Some(_), Some(place)) => self.add_moved(&mut found, object, name, place),
                (None, _) => found.unseen += 1,
                (Some(evidence), None) => self.add_in_place(&mut found, object, name, evidence),
            }
        }
        let is_change = |kind: &FindingKind| matches!(kind, FindingKind::Gone | FindingKind::Moved { .. });
        let changed = found.changes.iter().filter(|f| is_change(&f.kind)).count();
        let decided = changed + found.confirmed.len();
        if changed > FEW_CHANGES && changed as f64 > MAX_CHANGED * decided as f64 {
            found.wrong = Some(format!(
                "{changed} of {decided} objects seem to be gone or moved: check the map, the sensor and its mount"
            ));
        }
        let explained: Vec<(u32, Pose)> = moves.iter().map(|(object, place)| (*object, place.pose)).collect();
        self.add_new(&mut found, &groups, &explained);
        found.changes.sort_by(by_rank);
        found
    }

    /// True if several views contradict an object on many of its cells.
    fn is_doubted(&self, object: u32) -> bool {
        let options = &self.known.options;
        let Some(evidence) = self.known.book.objects.get(&object) else { return false };
        let (present, gone) = self.known.book.decided(object, options);
        let size = 2.0 * Thing::new(self.environment, object).radius;
        size <= MIN_DIVIDED
            && evidence.against >= options.min_views
            && (evidence.l <= -options.decisive || (gone >= 2 && 5 * gone >= present + gone))
    }

    fn is_gone(&self, object: u32, evidence: &Evidence) -> bool {
        let options = &self.known.options;
        let (present, gone) = self.known.book.decided(object, options);
        evidence.l <= -options.decisive
            && evidence.against >= options.min_views
            && gone as f64 >= options.min_agreeing * (present + gone).max(1) as f64
    }

    fn add_moved(&self, found: &mut SiteFindings, object: u32, name: String, place: &Place) {
        let thing = Thing::new(self.environment, object);
        let before = self.environment.objects()[object as usize].world_from_object;
        let distance = before.transform_point(thing.middle).distance(place.pose.transform_point(thing.middle));
        let turned = before.rotation.angle_between(place.pose.rotation) * thing.radius;
        if distance.max(turned) < MIN_MOVE {
            found.confirmed.push(name);
            return;
        }
        let kind = FindingKind::Moved { world_from_object: place.pose, distance };
        found.changes.push(self.finding(name, kind, place.score.l, place.score.views));
    }

    /// Adds an object that was not moved: it is gone, seen through by some sensors, comes and goes, or is present.
    fn add_in_place(&self, found: &mut SiteFindings, object: u32, name: String, evidence: &Evidence) {
        let book = &self.known.book;
        let is_gone = self.is_gone(object, evidence);
        let mut through = book.see_through(object, &self.known.options);
        if is_gone && self.has_glass(object) {
            through.extend(self.known.views.back().map(|view| view.class().to_owned()));
        }
        let kinds = if !through.is_empty() {
            through.into_iter().map(FindingKind::SeenThrough).collect()
        } else if is_gone {
            vec![FindingKind::Gone]
        } else if book.comes_and_goes(object, &self.known.options) {
            vec![FindingKind::ComesAndGoes]
        } else {
            return self.add_present(found, object, name, evidence);
        };
        let (l, views) = if is_gone { (-evidence.l, evidence.views) } else { (evidence.less, evidence.against) };
        found.changes.extend(kinds.into_iter().map(|kind| self.finding(name.clone(), kind, l, views)));
    }

    /// True if some sensors see through a material of an object.
    fn has_glass(&self, object: u32) -> bool {
        let mesh = &self.environment.objects()[object as usize].mesh;
        let materials = self.environment.materials();
        let is_glass = |material: &Material| material.appearance.values().any(|a| *a != Appearance::Opaque);
        (0..mesh.polygon_count() as u32).any(|polygon| is_glass(&materials[usize::from(mesh.material(polygon))]))
    }

    /// Adds an object that is neither gone nor moved: it is confirmed, perhaps without a part, or in doubt.
    fn add_present(&self, found: &mut SiteFindings, object: u32, name: String, evidence: &Evidence) {
        let options = &self.known.options;
        let (present, gone) = self.known.book.decided(object, options);
        let is_large = 2.0 * Thing::new(self.environment, object).radius > MIN_DIVIDED;
        if is_large {
            let missing = parts(self.known.book.cells_of(object), PART, options);
            let finding = |part: Part| self.finding(name.clone(), FindingKind::Part(part.bounds), part.l, part.views);
            found.changes.extend(missing.into_iter().map(finding));
        }
        let is_confirmed = evidence.l >= options.decisive && evidence.views >= options.min_views;
        let do_cells_agree = present as f64 >= options.min_agreeing * (present + gone) as f64;
        if is_confirmed && (do_cells_agree || is_large) {
            found.confirmed.push(name);
            return;
        }
        let why = if evidence.against == 0 {
            format!("seen in {} views, {} are needed", evidence.views, options.min_views)
        } else if gone > 0 && present > 0 {
            format!("{gone} of {} cells of its surface are gone, {present} stand", gone + present)
        } else {
            format!("{} of {} views contradict it", evidence.against, evidence.views)
        };
        found.doubts.push(DoubtfulObject { object: name, why, view: None });
    }

    /// Adds a new object for each piece of the points that moved and recognized objects do not explain.
    pub(crate) fn add_new(&self, found: &mut SiteFindings, groups: &[Group], explained: &[(u32, Pose)]) {
        let options = &self.known.options;
        for group in groups {
            let left = self.unexplained(&group.points, explained);
            let pieces = self.pieces(&left);
            let whole = if pieces.is_empty() && self.is_object(&left) { vec![left] } else { pieces };
            for points in whole.into_iter().flat_map(split) {
                let l = options.max_per_view * f64::from(options.min_views);
                let kind = FindingKind::New(UprightBox::of(&points));
                found.changes.push(self.finding(String::new(), kind, l, options.min_views));
            }
        }
    }
}
