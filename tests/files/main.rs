//! Scene files, scripts and beam tables: their content, every kind of damage, and one-sided polygons through every input.

mod beams;
mod build;
mod import;
mod mirrored;
#[cfg(feature = "ros")]
mod moving_clouds;
mod plausible;
#[cfg(feature = "script")]
mod script;
mod skip_bad;
