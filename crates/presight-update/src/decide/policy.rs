//! The consequence of a finding: the paper's four reactions to exceptions, and the change of the model.

use crate::decide::findings::FindingKind;
use presight_model::error::{Error, Result};

/// The consequence of a kind of finding.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Action {
    /// The model is changed: the object is deleted or moved, or a box is inserted.
    Change,
    /// The object is marked as uncertain at its place in the model, and a copy of it, or a box, at the new place.
    #[default]
    Mark,
    /// The robot stops and reports the pose that decides the question.
    Stop,
    /// The place is added to a list of places to visit again.
    ComeBack,
    /// The finding has no consequence.
    Ignore,
}

/// The actions by their names in files and flags.
const ACTIONS: [(&str, Action); 5] = [
    ("change", Action::Change),
    ("mark", Action::Mark),
    ("stop", Action::Stop),
    ("come-back", Action::ComeBack),
    ("ignore", Action::Ignore),
];

/// The action for each kind of finding.
///
/// ```
/// use presight::update::{Action, Policy};
/// let policy = Policy::parse("gone=change,new=stop")?;
/// assert_eq!((policy.gone, policy.moved, policy.new), (Action::Change, Action::Mark, Action::Stop));
/// assert!(Policy::parse("gone=delete").is_err());
/// # Ok::<(), presight::Error>(())
/// ```
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Policy {
    /// For objects that are gone, seen through by some sensors, or that come and go.
    pub gone: Action,
    /// For objects that were moved.
    pub moved: Action,
    /// For new objects.
    pub new: Action,
    /// For parts of large objects.
    pub part: Action,
}

impl Policy {
    /// Parses `KIND=ACTION,..`, or an action for all kinds; kinds that are not named are marked.
    ///
    /// # Errors
    /// [`presight_model::ErrorKind::Usage`] naming the unknown word.
    pub fn parse(text: &str) -> Result<Self> {
        let mut policy = Self::default();
        for word in text.split(',').map(str::trim).filter(|word| !word.is_empty()) {
            let remedy = "give gone, moved, new or part, =, and change, mark, stop, come-back or ignore";
            let wrong = || Error::usage(format!("policy {word:?}"), remedy);
            let (kind, action) = word.split_once('=').unwrap_or(("all", word));
            let action = ACTIONS.iter().find(|(name, _)| *name == action).ok_or_else(wrong)?.1;
            match kind {
                "all" => policy = Self { gone: action, moved: action, new: action, part: action },
                "gone" => policy.gone = action,
                "moved" => policy.moved = action,
                "new" => policy.new = action,
                "part" => policy.part = action,
                _ => return Err(wrong()),
            }
        }
        Ok(policy)
    }

    /// The action for a finding.
    pub fn of(&self, kind: &FindingKind) -> Action {
        match kind {
            FindingKind::Gone | FindingKind::SeenThrough(_) | FindingKind::ComesAndGoes => self.gone,
            FindingKind::Moved { .. } => self.moved,
            FindingKind::New(_) | FindingKind::Recognized(_) => self.new,
            FindingKind::Part(_) => self.part,
        }
    }
}
