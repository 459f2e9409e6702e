//! Importing: every feature of scene files on files built by hand, every kind of damage, and the real scenes.

mod bad;
mod features;
mod memory;
mod scenes;
