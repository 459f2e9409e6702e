//! Solids from parameters: closed surfaces of planar convex polygons, corners counter-clockwise seen from outside.
//!
//! Lengths are metres. A solid stands on z = 0, centred on the z axis, unless its function says otherwise. Circles
//! become inscribed regular polygons with a corner on +x. Neighbours share corners by index, so that their edges have
//! the same bits. The same parameters give the same bits on every machine.

mod outline;
mod round;
mod split;
mod straight;
#[cfg(test)]
mod tests;

pub use outline::extrude;
pub use round::{cone, cylinder, prism, sphere, tube};
pub use straight::{cuboid, face, pyramid, rectangle, stairs, wedge};

use glam::DVec3;
use presight_model::error::{Error, Result};
use presight_model::limits;

/// Polygons over shared corners.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Solid {
    /// Positions, metres.
    pub vertices: Vec<DVec3>,
    corners: Vec<u32>,
    /// For each polygon, one past its last corner.
    ends: Vec<u32>,
}

impl Solid {
    /// Number of polygons.
    pub fn polygon_count(&self) -> usize {
        self.ends.len()
    }

    /// The corners of each polygon, as indices of vertices.
    pub fn polygons(&self) -> impl ExactSizeIterator<Item = &[u32]> {
        (0..self.ends.len()).map(|i| {
            let first = if i == 0 { 0 } else { self.ends[i - 1] };
            &self.corners[first as usize..self.ends[i] as usize]
        })
    }

    /// Number of corners of all polygons.
    pub fn corner_count(&self) -> usize {
        self.corners.len()
    }

    /// Appends a convex polygon; one with more corners than a mesh allows is cut along chords.
    pub fn push(&mut self, corners: impl IntoIterator<Item = u32>) {
        let start = self.corners.len();
        self.corners.extend(corners);
        let count = self.corners.len() - start;
        if count <= limits::MAX_CORNERS {
            self.ends.push(self.corners.len() as u32);
            return;
        }
        let all = self.corners.split_off(start);
        let mut from = 1;
        while from + 1 < count {
            let to = (from + limits::MAX_CORNERS - 2).min(count - 1);
            self.corners.push(all[0]);
            self.corners.extend_from_slice(&all[from..=to]);
            self.ends.push(self.corners.len() as u32);
            from = to;
        }
    }

    /// Appends all polygons of another solid.
    pub fn append(&mut self, other: &Self) {
        let (vertex, corner) = (self.vertices.len() as u32, self.corners.len() as u32);
        self.vertices.extend_from_slice(&other.vertices);
        self.corners.extend(other.corners.iter().map(|c| c + vertex));
        self.ends.extend(other.ends.iter().map(|e| e + corner));
    }

    /// Transforms every corner. If the transform mirrors, windings are reversed, so that outside stays outside.
    pub fn map(&mut self, mirrors: bool, mut a_from_b: impl FnMut(DVec3) -> DVec3) {
        for v in &mut self.vertices {
            *v = a_from_b(*v);
        }
        let mut first = 0;
        for &end in self.ends.iter().filter(|_| mirrors) {
            self.corners[first..end as usize].reverse();
            first = end as usize;
        }
    }
}

/// A length above 0.
fn length(name: &str, metres: f64) -> Result<f64> {
    if metres > 0.0 && metres <= limits::MAX_COORDINATE {
        return Ok(metres);
    }
    let what = format!("{name} is {metres}");
    Err(Error::invalid(what, format!("give metres above 0, at most {:e}", limits::MAX_COORDINATE)))
}

/// A length of 0 or more.
fn length_or_none(name: &str, metres: f64) -> Result<f64> {
    if metres == 0.0 { Ok(0.0) } else { length(name, metres) }
}

/// A number of facets or steps.
fn count(name: &str, n: u32, min: u32) -> Result<u32> {
    if (min..=limits::MAX_FACETS).contains(&n) {
        return Ok(n);
    }
    Err(Error::invalid(format!("{name} is {n}"), format!("give {min} to {}", limits::MAX_FACETS)))
}
