//! Deadlines: what is final is the full prediction's bit for bit, whatever else is given up.

#![allow(clippy::print_stdout, reason = "figures are told where they are measured")]

use presight_testkit as common;

mod bad_input;
mod features;
#[cfg(feature = "gpu")]
mod gpu;
mod partial;
mod readers;
mod ticks;
