//! The changes that follow from findings, with their evidence.

use crate::change::edits::{insert, mark, set_pose, source};
use crate::change::existence::{UNSTATED, posterior};
use crate::change::features;
use crate::change::refine::{RefinedPose, refined};
use crate::decide::findings::{Finding, FindingKind, SiteFindings};
use crate::decide::policy::{Action, Policy};
use crate::evidence::knowledge::Knowledge;
use presight_model::change::Change;
use presight_model::environment::{CUBOID_FACES, Environment, Existence, Mark, MarkKind, cuboid_corners};
use presight_model::error::Result;
use presight_model::geometry::Pose;
use presight_model::world::World;
use presight_store::{ChangeEvidence, Edit, ProposedChange, ShapeSource};

/// As [`Learner::changes`](crate::Learner::changes).
pub(crate) fn changes(
    known: &Knowledge,
    findings: &SiteFindings,
    world: &World,
    (base, utc): (&str, f64),
    policy: &Policy,
) -> Result<Vec<ProposedChange>> {
    if findings.wrong.is_some() {
        return Ok(Vec::new());
    }
    let environment = world.environment();
    let mut changes = Vec::new();
    for (number, finding) in (1..).zip(&findings.changes) {
        let action = policy.of(&finding.kind);
        let only_mark = action == Action::Mark;
        if (only_mark || action == Action::Change) && !is_marked(finding, environment, only_mark) {
            changes.push(of_finding(finding, environment, (base, number), only_mark)?);
        }
    }
    let group =
        |edits: Vec<Edit>, cause: String| ProposedChange::new(Edit::Group(edits), cause, None, Vec::new(), base);
    let trusts: Vec<Edit> =
        findings.confirmed.iter().filter_map(|name| trust(known, environment, name, utc)).map(Edit::from).collect();
    if !trusts.is_empty() {
        let cause = format!("{} objects were seen where the model has them", trusts.len());
        changes.push(group(trusts, cause)?);
    }
    let refined = refined(known, environment, findings);
    for refined in &refined {
        changes.push(of_refined(refined, environment, base)?);
    }
    // Features on an object move with it. Their offsets are relative to its new pose.
    let mut now = Environment::clone(environment);
    refined.iter().for_each(|r| drop(now.set_pose(&r.object, r.world_from_object)));
    let edits = features::changes(&known.features, (environment, &now), known.options.min_views, utc);
    if !edits.is_empty() {
        let cause = format!("{} features were searched", edits.len());
        changes.push(group(edits.into_iter().map(Edit::from).collect(), cause)?);
    }
    for features::Insertion { edit, cause, views } in features::insertions(known, environment, utc, base) {
        let evidence = ChangeEvidence { log_odds: None, views };
        changes.push(ProposedChange::new(edit, cause, Some(evidence), Vec::new(), base)?);
    }
    Ok(changes)
}

/// The change of the finding with this number, from 1.
fn of_finding(
    finding: &Finding,
    environment: &Environment,
    (base, number): (&str, usize),
    only_mark: bool,
) -> Result<ProposedChange> {
    let Finding { object, kind, l, views, .. } = finding;
    let provisional = format!("provisional/{base}-{number}");
    let uncertain = |name: String, object: &str| mark(name, object, MarkKind::Uncertain, None, None);
    let own = || uncertain(format!("uncertain {object}"), object);
    let marked = |pose: &Pose, shape: ShapeSource| {
        vec![insert(&provisional, pose, shape), uncertain(provisional.clone(), &provisional)]
    };
    let (edit, cause) = match kind {
        FindingKind::Gone => {
            let delete = || Edit::from(Change::DeleteObject { name: object.clone() });
            let reason = if only_mark { "not where the model has it" } else { "gone" };
            (if only_mark { own() } else { delete() }, format!("{object} is {reason}"))
        }
        FindingKind::Moved { world_from_object, distance } => {
            let edit = if only_mark {
                let copy = marked(world_from_object, ShapeSource::Like(object.clone()));
                Edit::Group(std::iter::once(own()).chain(copy).collect())
            } else {
                set_pose(object, world_from_object)
            };
            (edit, format!("{object} was moved by {distance:.3} m"))
        }
        FindingKind::New(found) => {
            let half = (0.5 * found.size).as_vec3();
            let vertices = cuboid_corners(-half, half).iter().map(|v| v.to_array()).collect();
            let polygons = CUBOID_FACES.iter().map(|face| face.to_vec()).collect();
            let edit = Edit::Group(marked(&found.pose, ShapeSource::Polygons { vertices, polygons }));
            (edit, "something stands where the model has nothing".to_owned())
        }
        FindingKind::Recognized(known) => {
            let (pose, shape) = (&known.world_from_object, source(&known.shape));
            let edit = if only_mark { Edit::Group(marked(pose, shape)) } else { insert(&provisional, pose, shape) };
            (edit, format!("a {} stands where the model has nothing", known.shape.name()))
        }
        FindingKind::Part(bounds) => {
            let kind = if only_mark { MarkKind::Uncertain } else { MarkKind::Absent };
            let edit = mark(format!("{object} part {base}-{number}"), object, kind, None, Some(*bounds));
            (edit, format!("a part of {object} is gone"))
        }
        FindingKind::SeenThrough(class) => {
            let edit = mark(format!("{object} for {class}"), object, MarkKind::Absent, Some(class.clone()), None);
            (edit, format!("sensors of class {class} see through {object}"))
        }
        FindingKind::ComesAndGoes => (own(), format!("{object} comes and goes")),
    };
    let evidence = ChangeEvidence { log_odds: Some((100.0 * l).round() / 100.0), views: *views };
    ProposedChange::new(edit, cause, Some(evidence), pose_before(environment, object), base)
}

/// The change of a refined pose: the pose, and its covariance in the layer of the sensors' class.
fn of_refined(refined: &RefinedPose, environment: &Environment, base: &str) -> Result<ProposedChange> {
    let RefinedPose { object, class, world_from_object, covariance, distance, views } = refined;
    let (class, covariance) = (class.clone(), Some(*covariance));
    let own = Change::SetPoseCovariance { class, object: object.clone(), covariance };
    let edit = Edit::Group(vec![set_pose(object, world_from_object), Edit::from(own)]);
    let cause = format!("{views} views put {object} {distance:.4} m off its place");
    let evidence = ChangeEvidence { log_odds: None, views: *views };
    ProposedChange::new(edit, cause, Some(evidence), pose_before(environment, object), base)
}

fn pose_before(environment: &Environment, object: &str) -> Vec<(String, Pose)> {
    environment.object(object).map(|o| (object.to_owned(), o.world_from_object)).into_iter().collect()
}

/// True if the model already has the mark of a finding.
fn is_marked(finding: &Finding, environment: &Environment, only_mark: bool) -> bool {
    let is_same = |m: &Mark| match &finding.kind {
        FindingKind::Gone | FindingKind::Moved { .. } => {
            only_mark && m.kind == MarkKind::Uncertain && m.bounds.is_none()
        }
        FindingKind::ComesAndGoes => m.kind == MarkKind::Uncertain && m.bounds.is_none(),
        FindingKind::SeenThrough(class) => m.kind == MarkKind::Absent && m.bounds.is_none() && m.concerns(class),
        FindingKind::Part(part) => {
            let contains = m.bounds.is_none_or(|b| b.min.cmple(part.min).all() && b.max.cmpge(part.max).all());
            contains && (only_mark || m.kind == MarkKind::Absent)
        }
        FindingKind::New(_) | FindingKind::Recognized(_) => false,
    };
    environment.marks().any(|(_, m)| m.object == finding.object && is_same(m))
}

/// The posterior trust in an object after views of it.
fn trust(known: &Knowledge, environment: &Environment, name: &str, utc: f64) -> Option<Change> {
    let evidence = known.book.objects.get(&environment.index_of(name).ok()?)?;
    let confirmed = evidence.confirmed + utc;
    let before = environment.trust(name);
    let prior = before.map_or(UNSTATED, |trust| trust.at(confirmed)).clamp(1e-9, 1.0 - 1e-9);
    let rate = before.map_or(0.0, |trust| trust.rate);
    let trust = Existence { p0: posterior(prior, evidence.l), confirmed, rate };
    Some(Change::SetTrust { object: name.to_owned(), trust: Some(trust) })
}
