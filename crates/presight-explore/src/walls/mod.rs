//! Walls from planar scans, seen from above.

mod scan;
mod segment;
mod wall;

pub(crate) use scan::Wall;
pub(crate) use wall::walls;
