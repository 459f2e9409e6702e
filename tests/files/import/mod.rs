//! Importing: every feature of a scene file on files made by hand, every way to be broken, and the real scenes.

mod bad;
mod features;
mod memory;
mod scenes;
