//! Walls from planar scans.

mod scan;
mod segment;
mod wall;

pub(crate) use scan::Wall;
pub(crate) use wall::walls;
