//! A model that stays true: what differs between prediction and measurement becomes evidence, and evidence becomes changes.
//!
//! Use it through the crate `presight`, which gives the same names.

mod apply;
mod blind;
mod boxes;
mod changes;
mod decide;
mod evidence;
mod features;
mod file;
mod fit;
mod joint;
mod learn;
mod located;
mod lookout;
mod moves;
mod parts;
mod policy;
mod priors;
mod program;
mod pulled;
mod recognize;
mod refine;
mod register;
mod rivals;
mod shapes;
mod shown;
mod sightings;
mod view;
mod voxels;

pub use apply::{Applied, Waiting};
pub use boxes::UprightBox;
pub use changes::change_lines;
pub use decide::{Doubt, Finding, Findings, Sight, What};
pub use evidence::{Evidence, Pixels};
pub use learn::{LearnOptions, Learner, Tally};
pub use lookout::Look;
pub use policy::{Action, Policy};
pub use program::ProgramRecognizer;
pub use recognize::{Proposal, Recognized, Recognizer};
pub use refine::Refined;
pub use shapes::{Library, Shape};
pub use voxels::{Occupied, Voxel, Voxels};
