//! Importing: every feature of scene files on files built by hand, every kind of damage, and the real scenes.

mod bad;
mod cases;
mod features;
mod instances;
mod memory;
mod notices;
mod scenes;
mod schema;
mod skins;
