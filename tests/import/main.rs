//! Importing: every feature of a scene file on files made by hand, every way to be broken, and the real scenes.

// Tests tell on stderr what they skipped and measured.
#![allow(clippy::print_stderr)]

mod bad;
mod build;
mod features;
mod scenes;
