//! The tracker against a simulator of its own and a filter that is told the motion. `cargo test --test features history -- --nocapture` prints
//! its figures.

#![allow(clippy::print_stdout, reason = "figures are told where they are measured")]

mod bad_input;
mod drive;
mod segments;
mod simulator;
mod told;
