//! Where to look from: at objects in doubt, and at findings that a policy stops at or comes back to.

use super::told;
use presight::tools::write_atomically;
use presight::update::{Action, Finding, Findings, Learner, Look, Policy};
use presight::{Error, Result, World};
use serde_json::{Value, json};
use std::io::Write;
use std::path::Path;

/// Findings that a person or a robot has to look at, with the poses to look from.
pub struct Asked<'a> {
    all: Vec<(&'a Finding, Action, Option<Look>)>,
}

/// The pose to look from in words; empty for none.
pub fn look_from(look: Option<&Look>) -> String {
    look.map_or_else(String::new, |look| {
        let pose = look.pose.world_from_sensor();
        let (t, (_, _, yaw)) = (pose.translation, pose.rpy());
        let Look { sensor, odds, .. } = look;
        let yaw = yaw.to_degrees();
        format!(
            "; look from {:.2},{:.2},{:.2} at {yaw:.0} degrees with {sensor}, expected log-odds {odds:.0}",
            t.x, t.y, t.z
        )
    })
}

/// The line of something to look at.
fn line(what: Value, why: &str, look: Option<&Look>) -> String {
    let mut value = json!({"object": what, "why": why});
    if let Some(Look { sensor, pose, odds }) = look {
        let pose = pose.world_from_sensor();
        let numbers: Vec<f64> = pose.translation.to_array().into_iter().chain(pose.rotation.to_array()).collect();
        value["look_from"] = json!({"sensor": sensor, "pose": numbers, "log_odds": (10.0 * odds).round() / 10.0});
    }
    format!("{value}\n")
}

impl<'a> Asked<'a> {
    /// What a policy stops at or comes back to.
    pub fn of(learner: &mut Learner, world: &World, findings: &'a Findings, policy: &Policy) -> Self {
        let asks = |finding: &&Finding| matches!(policy.of(&finding.what), Action::Stop | Action::ComeBack);
        let all: Vec<&Finding> = findings.changes.iter().filter(asks).collect();
        let looks = learner.looks(world, &all);
        Self { all: all.into_iter().zip(looks).map(|(f, look)| (f, policy.of(&f.what), look)).collect() }
    }

    /// What has an action, in words, with the pose to look from.
    pub fn told(&self, action: Action) -> impl Iterator<Item = String> {
        let own = self.all.iter().filter(move |(_, own, _)| *own == action);
        own.map(|(finding, _, look)| format!("{}{}", told(finding), look_from(look.as_ref())))
    }

    /// A line for each object in doubt, and for each finding to look at.
    pub fn lines(&self, findings: &Findings) -> String {
        let doubts = findings.doubts.iter().map(|d| line(d.object.as_str().into(), &d.why, d.look.as_ref()));
        let name = |f: &Finding| if f.object.is_empty() { Value::Null } else { f.object.as_str().into() };
        let asked = self.all.iter().map(|(finding, _, look)| line(name(finding), &told(finding), look.as_ref()));
        doubts.chain(asked).collect()
    }

    /// Adds the places to come back to, a line each, to a list that survives. A place that is on it is not added again.
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
        for line in self.told(Action::ComeBack).map(|told| json!({ "come_back": told }).to_string()) {
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
