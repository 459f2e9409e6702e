//! Deadlines: final pixels equal the full prediction's bit for bit, whatever else is given up.

#![allow(clippy::print_stdout, reason = "the tests print their figures")]

use presight_testkit as common;

mod bad_input;
mod features;
#[cfg(feature = "gpu")]
mod gpu;
mod partial;
mod readers;
mod ticks;
mod ways;
