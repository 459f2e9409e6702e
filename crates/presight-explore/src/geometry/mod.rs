//! Planes, cells on planes, and convex polygons.

mod cells;
mod convex;
mod plane;

pub(crate) use cells::{Cells, area, simplified};
pub(crate) use convex::convex;
pub(crate) use plane::{Flat, bounds, doubled_area, is_inside};
