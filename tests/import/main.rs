//! Importing: every feature of a scene file on files made by hand, every way to be broken, and the real scenes.

mod bad;
mod build;
#[path = "../common/mod.rs"]
mod common;
mod features;
mod memory;
mod scenes;
