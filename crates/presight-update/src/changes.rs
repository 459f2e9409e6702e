//! Findings as lines of `presight env apply`.

use crate::decide::{Finding, Findings, What};
use crate::learn::Learner;
use crate::policy::{Action, Policy};
use crate::refine::Refined;
use presight_model::caster::RayCaster;
use presight_model::change::Change;
use presight_model::environment::{
    CUBOID_FACES, Environment, Existence, Mark, MarkKind, Material, Mesh, NewObject, cuboid_corners,
};
use presight_model::geometry::Pose;
use presight_model::world::World;
use serde_json::{Value, json};

/// Existence of an object before anything was seen of it: one in a hundred objects of a model is not there.
const PRIOR: f64 = 0.99;
/// The most that the evidence of one run counts, natural logarithm of odds: one in a million.
const MOST: f64 = 13.8;

/// Lines of changes, with an id, a cause and the evidence of each.
///
/// `base` names the version of the model that the findings are of: lines of one version have ids of their own, so that
/// nothing is applied twice. `utc` is added to the stamps of frames, seconds. The policy says which findings change the
/// model, and which only mark it. What the model has marked already is left out.
pub fn change_lines(
    learner: &Learner,
    findings: &Findings,
    world: &World,
    (base, utc): (&str, f64),
    policy: &Policy,
) -> Vec<String> {
    if findings.wrong.is_some() {
        return Vec::new();
    }
    let environment = world.environment();
    let mut lines = Vec::new();
    for (number, finding) in findings.changes.iter().enumerate() {
        let action = policy.of(&finding.what);
        if matches!(action, Action::Change | Action::Mark) {
            lines.extend(line(finding, environment, (base, number), action == Action::Mark));
        }
    }
    let trust: Vec<Value> =
        findings.confirmed.iter().filter_map(|name| trust(learner, environment, name, utc)).collect();
    if !trust.is_empty() {
        let cause = format!("{} objects were seen where the model has them", trust.len());
        lines.push(with_id(json!({"op": "group", "changes": trust, "cause": cause}), base));
    }
    let refined = learner.refined(environment, findings);
    lines.extend(refined.iter().map(|refined| refined_line(refined, environment, base)));
    // Features on an object move with it; looks at them are compared with where it stands now.
    let mut stands = Environment::clone(environment);
    refined.iter().for_each(|r| drop(stands.set_pose(&r.object, r.world_from_object)));
    let features = learner.looks.changes((environment, &stands), learner.options.least_views, utc);
    if !features.is_empty() {
        let cause = format!("{} features were searched", features.len());
        lines.push(with_id(json!({"op": "group", "changes": features, "cause": cause}), base));
    }
    let known = (&**environment, &learner.casters);
    let new = learner.looks.insertions(known, learner.options.least_views, utc, base);
    lines.extend(new.into_iter().map(|op| with_id(op, base)));
    lines
}

/// The line of a finding; `None` if the model says so already.
fn line(
    finding: &Finding,
    environment: &Environment,
    (base, number): (&str, usize),
    only_mark: bool,
) -> Option<String> {
    let Finding { object, what, l, views, .. } = finding;
    let known = environment.object(object).map(|o| numbers(&o.world_from_object));
    let provisional = format!("provisional/{base}-{}", number + 1);
    let uncertain = mark(&format!("uncertain {object}"), object, "uncertain");
    let (mut value, cause) = match what {
        What::Gone if only_mark => (uncertain, format!("{object} is not where the model has it")),
        What::Gone => (json!({"op": "delete_object", "object": object}), format!("{object} is gone")),
        What::Moved { world_from_object, distance } => {
            let pose = numbers(world_from_object);
            let copy = json!({"op": "insert_object", "object": provisional, "pose": pose, "like": object});
            let op = if only_mark {
                json!({"op": "group", "changes": [uncertain, copy, mark(&provisional, &provisional, "uncertain")]})
            } else {
                json!({"op": "set_pose", "object": object, "pose": pose})
            };
            (op, format!("{object} was moved by {distance:.3} m"))
        }
        What::New(found) => {
            let half = (0.5 * found.size).as_vec3();
            let vertices: Vec<[f32; 3]> = cuboid_corners(-half, half).iter().map(|v| v.to_array()).collect();
            let insert = json!({"op": "insert_object", "object": provisional, "pose": numbers(&found.pose),
                "vertices": vertices, "polygons": CUBOID_FACES});
            let op = json!({"op": "group", "changes": [insert, mark(&provisional, &provisional, "uncertain")]});
            (op, "something stands where the model has nothing".to_owned())
        }
        What::Recognized(known) => {
            let insert = known.shape.insertion(&provisional, &numbers(&known.world_from_object));
            let op = if only_mark {
                json!({"op": "group", "changes": [insert, mark(&provisional, &provisional, "uncertain")]})
            } else {
                insert
            };
            (op, format!("a {} stands where the model has nothing", known.shape.name()))
        }
        What::Part(b) => {
            let kind = if only_mark { "uncertain" } else { "absent" };
            let mut op = mark(&format!("{object} part {base}-{}", number + 1), object, kind);
            op["box"] = json!([b.min.to_array(), b.max.to_array()]);
            (op, format!("a part of {object} is gone"))
        }
        What::SeenThrough(class) => {
            let mut op = mark(&format!("{object} for {class}"), object, "absent");
            op["class"] = class.as_str().into();
            (op, format!("sensors of class {class} see through {object}"))
        }
        What::ComesAndGoes => (uncertain, format!("{object} comes and goes")),
    };
    if is_marked(finding, environment, only_mark) {
        return None;
    }
    value["cause"] = cause.into();
    value["evidence"] = json!({"log_odds": (100.0 * l).round() / 100.0, "views": views});
    if let Some(pose) = known {
        value["was"] = json!([{"object": object, "pose": pose}]);
    }
    Some(with_id(value, base))
}

/// The line of an object that stands a little off its place: its pose, and its covariance in the layer of the sensors' class.
fn refined_line(refined: &Refined, environment: &Environment, base: &str) -> String {
    let Refined { object, class, world_from_object, covariance, distance, views } = refined;
    let pose = json!({"op": "set_pose", "object": object, "pose": numbers(world_from_object)});
    let covariance = covariance.as_rows().as_flattened();
    let own = json!({"op": "set_pose_covariance", "class": class, "object": object, "covariance": covariance});
    let mut value = json!({"op": "group", "changes": [pose, own]});
    value["cause"] = format!("{views} views put {object} {distance:.4} m off its place").into();
    value["evidence"] = json!({"views": views});
    if let Some(before) = environment.object(object) {
        value["was"] = json!([{"object": object, "pose": numbers(&before.world_from_object)}]);
    }
    with_id(value, base)
}

fn mark(name: &str, object: &str, kind: &str) -> Value {
    json!({"op": "set_mark", "mark": name, "object": object, "kind": kind})
}

/// True if a mark of the model already says what a finding would mark.
fn is_marked(finding: &Finding, environment: &Environment, only_mark: bool) -> bool {
    let says = |m: &Mark| match &finding.what {
        What::Gone | What::Moved { .. } => only_mark && m.kind == MarkKind::Uncertain && m.bounds.is_none(),
        What::ComesAndGoes => m.kind == MarkKind::Uncertain && m.bounds.is_none(),
        What::SeenThrough(class) => m.kind == MarkKind::Absent && m.bounds.is_none() && m.concerns(class),
        What::Part(part) => {
            let holds = m.bounds.is_none_or(|b| b.min.cmple(part.min).all() && b.max.cmpge(part.max).all());
            holds && (only_mark || m.kind == MarkKind::Absent)
        }
        What::New(_) | What::Recognized(_) => false,
    };
    environment.marks().any(|(_, m)| m.object == finding.object && says(m))
}

/// The trust in an object after views of it, by Bayes from the trust before.
fn trust(learner: &Learner, environment: &Environment, name: &str, utc: f64) -> Option<Value> {
    let evidence = learner.book.objects.get(&environment.index_of(name).ok()?)?;
    let confirmed = evidence.confirmed + utc;
    let before = environment.trust(name).map_or(PRIOR, |trust| trust.at(confirmed)).clamp(1e-9, 1.0 - 1e-9);
    let odds = (before / (1.0 - before)).ln() + evidence.l.clamp(-MOST, MOST);
    let rate = environment.trust(name).map_or(0.0, |trust| trust.rate);
    let after = Existence { p0: 1.0 / (1.0 + (-odds).exp()), confirmed, rate };
    let trust = json!({"existence": after.p0, "confirmed": after.confirmed, "rate": after.rate});
    Some(json!({"op": "set_trust", "object": name, "trust": trust}))
}

/// The line of a change, with an id that follows from its content and the version of the model.
fn with_id(mut value: Value, base: &str) -> String {
    let hash = blake3::hash(value.to_string().as_bytes()).to_hex();
    value["id"] = format!("{base}-{}", &hash[..12]).into();
    value.to_string()
}

/// Inserts an object of the first material.
fn inserted(world: &World, object: Option<NewObject>) -> Change {
    let first = world.environment().materials().is_empty().then(|| Change::AddMaterial(Material::named("default")));
    Change::of(first.into_iter().chain(object.map(Change::InsertObject)).collect())
}

fn numbers(pose: &Pose) -> Vec<f64> {
    pose.translation.to_array().into_iter().chain(pose.rotation.to_array()).collect()
}

impl Finding {
    /// The change of a world that follows from it. `world` is the one that it is of, perhaps with other findings applied.
    pub fn change(&self, world: &World) -> Change {
        let name = || self.object.clone();
        match &self.what {
            What::Gone => Change::DeleteObject { name: name() },
            What::Moved { world_from_object, .. } => {
                Change::SetPose { name: name(), world_from_object: *world_from_object }
            }
            What::New(found) => {
                let half = (0.5 * found.size).as_vec3();
                // The edges of a box are at least some millimetres long.
                let mesh = Mesh::cuboid("provisional", -half, half, 0).ok();
                inserted(world, mesh.map(|mesh| NewObject::new("provisional", found.pose, mesh.into())))
            }
            What::Recognized(known) => {
                inserted(world, Some(known.shape.placed("provisional", known.world_from_object)))
            }
            What::Part(bounds) => {
                let mark = Mark { object: name(), kind: MarkKind::Absent, class: None, bounds: Some(*bounds) };
                Change::SetMark { name: format!("{} part at {}", self.object, bounds.min), mark }
            }
            What::SeenThrough(class) => {
                let class = Some(class.clone());
                let mark = Mark { object: name(), kind: MarkKind::Absent, class, bounds: None };
                Change::SetMark { name: format!("{} seen through", self.object), mark }
            }
            What::ComesAndGoes => {
                let mark = Mark { object: name(), kind: MarkKind::Uncertain, class: None, bounds: None };
                Change::SetMark { name: format!("{} comes and goes", self.object), mark }
            }
        }
    }
}

impl Learner {
    /// The share of the measured points of the kept views that lie within some metres of what a world predicts.
    pub fn share_explained(&self, world: &World, within: f64) -> f64 {
        let class = self.views.back().map_or("", |view| view.kept.sensor.spec().class.as_str());
        let caster = RayCaster::new(world, class);
        let (mut all, mut near) = (0usize, 0usize);
        for view in &self.views {
            let (origin, reach) = (view.world_from_image.translation, view.kept.sensor.spec().range_max.min(1e5));
            for (at, ray) in view.kept.rays.iter().enumerate() {
                let z = f64::from(view.ranges[at]);
                if z.is_finite() && !ray.is_nan() {
                    let met = caster.cast(origin, view.world_from_image.rotation * *ray, reach, None);
                    all += 1;
                    near += usize::from(met.is_some_and(|met| (met.range - z).abs() <= within));
                }
            }
        }
        near as f64 / all.max(1) as f64
    }
}
