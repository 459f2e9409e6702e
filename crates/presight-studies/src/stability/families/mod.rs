//! The families of cases, each with one increasing difficulty.
//!
//! A family is a type that implements [`Family`]; [`all`] lists them. Most are scenes from the table in `scenes`, which
//! has their names, difficulties and functions that make the cases, and share one judge.

mod boxes;
mod family;
mod lens;
mod scenes;
mod shapes;

pub use family::{Family, Finding, Outcome};

/// Every family.
pub fn all() -> Vec<Box<dyn Family>> {
    let mut all: Vec<Box<dyn Family>> = Vec::new();
    all.extend(scenes::SCENES.iter().map(|s| Box::new(*s) as Box<dyn Family>));
    all.extend([lens::Fold::INSIDE, lens::Fold::BEYOND].map(|f| Box::new(f) as Box<dyn Family>));
    all.extend(boxes::ALL.map(|b| Box::new(b) as Box<dyn Family>));
    all
}
