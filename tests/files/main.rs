//! Scene files and scripts: their content, every kind of damage, and one-sided polygons through every input.

mod build;
mod import;
mod mirrored;
#[cfg(feature = "script")]
mod script;
