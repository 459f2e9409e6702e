//! Stability: cases that grow harder along one difficulty each, every engine's error against the bound that the product
//! publishes, and against the truth in a hundred digits. Where the error leaves its bound is a fault; a case that is refused
//! with a typed error is not.
//!
//! Later parts add families of their own: anything that implements [`Family`] can be put into a [`Study`].

mod big;
mod families;
mod fold;
mod judge;
mod lens;
mod oracle;
mod output;
mod subjects;
#[cfg(test)]
mod tests;

pub use families::{Family, Finding, Outcome, all};
pub use output::{RunInfo, faults, to_csv, to_html, to_json};
pub use subjects::{BoxSetting, Subject, subjects};

use presight::Result;

/// What is tried.
pub struct Study {
    /// In the order of the report.
    pub families: Vec<Box<dyn Family>>,
    /// Fewer difficulties and draws.
    pub quick: bool,
}

/// One line of the report.
#[derive(Clone, Debug, PartialEq)]
pub struct Row {
    /// The family's name.
    pub family: &'static str,
    /// On the family's axis.
    pub difficulty: f64,
    /// What an engine made of it.
    pub finding: Finding,
}

impl Study {
    /// Every family.
    pub fn new(quick: bool) -> Self {
        Self { families: all(), quick }
    }

    /// Number of steps that [`Study::run`] tells of.
    pub fn steps(&self) -> usize {
        self.families.iter().map(|f| f.difficulties(self.quick).len()).sum()
    }

    /// Tries every family at every difficulty with every engine; `progress` hears each step before it is taken.
    ///
    /// # Errors
    /// Those of an engine that breaks down.
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
