//! Scene files and scripts: what they say, every way to be broken, and one-sided polygons through every door.

mod build;
mod import;
mod mirrored;
#[cfg(feature = "script")]
mod script;
