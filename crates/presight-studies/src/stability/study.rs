//! A study of all families.

use super::families::{Family, Finding, all};
use super::subjects::Subject;
use presight_model::error::Result;

/// A stability study.
pub struct Study {
    /// The families in the order of the report.
    pub families: Vec<Box<dyn Family>>,
    /// Use fewer difficulties and random samples.
    pub quick: bool,
}

/// One line of the report.
#[derive(Clone, Debug, PartialEq)]
pub struct Row {
    /// The family's name.
    pub family: &'static str,
    /// Position on the family's axis.
    pub difficulty: f64,
    /// The result of one engine.
    pub finding: Finding,
}

impl Study {
    /// A study of all families.
    pub fn new(quick: bool) -> Self {
        Self { families: all(), quick }
    }

    /// The number of steps that [`Study::run`] reports.
    pub fn steps(&self) -> usize {
        self.families.iter().map(|f| f.difficulties(self.quick).len()).sum()
    }

    /// Measures every family at every difficulty with every engine. Calls `progress` before each step.
    ///
    /// # Errors
    /// Engine failures.
    pub fn run(&self, subjects: &mut [Subject], mut progress: impl FnMut(&str)) -> Result<Vec<Row>> {
        let mut rows = Vec::new();
        for family in &self.families {
            for difficulty in family.difficulties(self.quick) {
                progress(&format!("{} at {difficulty:e}", family.name()));
                let findings = family.measure(difficulty, self.quick, subjects);
                let findings = findings.map_err(|e| e.at(format!("{} at {difficulty:e}", family.name())))?;
                let row = |finding| Row { family: family.name(), difficulty, finding };
                rows.extend(findings.into_iter().map(row));
            }
        }
        Ok(rows)
    }
}
