//! Questions that a planned view answers: objects in doubt, and findings at which a policy stops or to which it comes
//! back.

use presight::tools::write_atomically;
use presight::update::{Action, Finding, Learner, PlannedView, Policy, SiteFindings};
use presight::{Error, Result, World};
use serde_json::{Value, json};
use std::io::Write;
use std::path::Path;

/// Findings that a person or a robot must check, with the planned views.
pub struct Questions<'a> {
    all: Vec<(&'a Finding, Action, Option<PlannedView>)>,
}

/// A planned view in words; empty for none.
pub fn look_from(view: Option<&PlannedView>) -> String {
    view.map_or_else(String::new, |view| {
        let pose = view.pose.world_from_sensor();
        let (t, (_, _, yaw)) = (pose.translation, pose.rpy());
        let PlannedView { sensor, odds, .. } = view;
        let yaw = yaw.to_degrees();
        format!(
            "; look from {:.2},{:.2},{:.2} at {yaw:.0} degrees with {sensor}, expected log-odds {odds:.0}",
            t.x, t.y, t.z
        )
    })
}

/// The line of a question.
fn line(object: Value, why: &str, view: Option<&PlannedView>) -> String {
    let mut value = json!({"object": object, "why": why});
    if let Some(PlannedView { sensor, pose, odds }) = view {
        let pose = pose.world_from_sensor();
        let numbers: Vec<f64> = pose.translation.to_array().into_iter().chain(pose.rotation.to_array()).collect();
        value["look_from"] = json!({"sensor": sensor, "pose": numbers, "log_odds": (10.0 * odds).round() / 10.0});
    }
    format!("{value}\n")
}

impl<'a> Questions<'a> {
    /// The findings at which a policy stops or to which it comes back.
    pub fn of(learner: &mut Learner, world: &World, findings: &'a SiteFindings, policy: &Policy) -> Self {
        let asks = |finding: &&Finding| matches!(policy.of(&finding.kind), Action::Stop | Action::ComeBack);
        let all: Vec<&Finding> = findings.changes.iter().filter(asks).collect();
        let views = learner.plan_views(world, &all);
        Self { all: all.into_iter().zip(views).map(|(f, view)| (f, policy.of(&f.kind), view)).collect() }
    }

    /// The findings with an action in words, with their planned views.
    pub fn describe(&self, action: Action) -> impl Iterator<Item = String> {
        let own = self.all.iter().filter(move |(_, own, _)| *own == action);
        own.map(|(finding, _, view)| format!("{finding}{}", look_from(view.as_ref())))
    }

    /// A line for each object in doubt, and for each finding to check.
    pub fn lines(&self, findings: &SiteFindings) -> String {
        let doubts = findings.doubts.iter().map(|d| line(d.object.as_str().into(), &d.why, d.view.as_ref()));
        let name = |f: &Finding| if f.object.is_empty() { Value::Null } else { f.object.as_str().into() };
        let asked = self.all.iter().map(|(finding, _, view)| line(name(finding), &finding.to_string(), view.as_ref()));
        doubts.chain(asked).collect()
    }

    /// Adds each place to visit again as a line to the list of earlier runs, unless it is there already.
    ///
    /// # Errors
    /// Errors of reading and writing the list.
    pub fn come_back(&self, path: &Path) -> Result<()> {
        let known = match std::fs::read_to_string(path) {
            Ok(text) => text,
            Err(e) if e.kind() == std::io::ErrorKind::NotFound => String::new(),
            Err(e) => return Err(Error::io(path, "read it", e)),
        };
        let mut lines: Vec<String> = known.lines().map(str::to_owned).collect();
        for line in self.describe(Action::ComeBack).map(|finding| json!({ "come_back": finding }).to_string()) {
            if !lines.contains(&line) {
                lines.push(line);
            }
        }
        if lines.is_empty() {
            return Ok(());
        }
        let text: String = lines.iter().map(|line| format!("{line}\n")).collect();
        write_atomically(path, |file| file.write_all(text.as_bytes()))
    }
}
