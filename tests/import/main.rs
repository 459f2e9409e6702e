//! Importing: every feature of a scene file on files made by hand, every way to be broken, and the real scenes.

#![expect(clippy::print_stderr, reason = "tests tell what they skipped and measured")]

mod bad;
mod build;
#[path = "../common/mod.rs"]
mod common;
mod features;
mod scenes;
