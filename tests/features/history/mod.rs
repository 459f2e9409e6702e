//! Compares the tracker with its own simulator and with a filter that knows the motion. `cargo test --test features
//! history -- --nocapture` prints the figures.

#![allow(clippy::print_stdout, reason = "the tests print their figures")]

mod bad_input;
mod drive;
mod hidden;
mod segments;
mod simulator;
mod told;
