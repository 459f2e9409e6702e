//! Compares the tracker with a simulator that does not use its motion model. `cargo test --test features history --
//! --nocapture` prints the figures.

#![allow(clippy::print_stdout, reason = "the tests print their figures")]

mod bad_input;
mod drive;
mod segments;
mod simulator;

use presight_localize::history::{ImageExtent, TrackerOptions};
use presight_localize::matching::Matcher;

/// With fewer tracks the tests make a full prediction.
const FEWEST: usize = 60;

fn options() -> TrackerOptions {
    let matcher = Matcher::default().with_detection_probability(0.8);
    TrackerOptions::new(ImageExtent::new(simulator::WIDTH, simulator::HEIGHT)).with_matcher(matcher)
}
