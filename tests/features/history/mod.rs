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
    // One false detection in a window of some 50 pixels.
    let matcher = Matcher::default().with_detection_probability(0.8).with_clutter_density(0.02);
    TrackerOptions::new(ImageExtent::new(simulator::WIDTH, simulator::HEIGHT)).with_matcher(matcher)
}
