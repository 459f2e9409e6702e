//! Predictions for a level one-row scanner as a problem of the plane. The world is cut once into segments at its
//! height, and a tree of the segments is searched. Images have the bits of other predictions: the search only finds the
//! polygon of each beam, and where rounding could decide, the engine does (`cpu::row`). Cuts are kept per version of
//! the world.

mod cut;
mod search;
mod segment;
mod tree;

pub(crate) use cut::CutObject;
pub use cut::{MAX_TILT, RowCut};
pub(crate) use search::{NOTHING, RowBeams, RowSearch, RowView, Search, UNSURE};
pub use segment::Segment;

use glam::DVec3;
use presight_model::geometry::Pose;
use presight_model::sensor::Sensor;
use presight_model::world::World;
use std::sync::{Arc, Mutex, PoisonError};

/// True if the sensor's z axis is vertical, up to the rounding of poses in text files.
pub fn is_level(pose: &Pose) -> bool {
    let up = pose.rotation * DVec3::Z;
    up.z > 0.0 && up.x.abs().max(up.y.abs()) <= 1e-8
}

/// True if a level sensor of this kind can use a cut.
pub fn is_row(sensor: &Sensor) -> bool {
    search::row_grid(sensor).is_some()
}

/// True if a sensor at this pose can use a cut.
fn is_exactly_level(pose: &Pose) -> bool {
    let m = pose.rotation_matrix();
    let tilt = [m.x_axis.z, m.y_axis.z, m.z_axis.x, m.z_axis.y];
    m.z_axis.z > 0.0 && tilt.iter().all(|t| t.abs() <= MAX_TILT)
}

/// Cuts of one version of the world.
#[derive(Debug, Default)]
pub struct RowCuts(Mutex<CutCache>);

#[derive(Debug, Default)]
struct CutCache {
    /// [`World::stamp`].
    world: u64,
    /// Cuts in the order of their last use.
    heights: Vec<CutHeight>,
}

/// A height and a class that was scanned at it.
#[derive(Debug)]
struct CutHeight {
    class: String,
    height: f64,
    scans: u32,
    cut: Option<Arc<RowCut>>,
}

/// Time to make a cut that is not in the cache.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Making {
    /// Immediately, for many scans.
    AtOnce,
    /// After [`RowCuts::SCANS`] scans of the height.
    IfOften,
    /// Never, because time is short.
    Never,
}

impl RowCuts {
    /// Maximum number of heights and classes that are kept.
    const MAX_CUTS: usize = 8;

    /// Number of single predictions at a height after which its cut is made: a cut takes the time of about ten
    /// predictions.
    pub const SCANS: u32 = 16;

    /// Returns the cut that serves a scan, if the sensor is a level one-row scanner.
    pub fn get(&self, world: &World, sensor: &Sensor, pose: &Pose, making: Making) -> Option<Arc<RowCut>> {
        if !is_row(sensor) || !is_exactly_level(pose) {
            return None;
        }
        let (class, height) = (&sensor.spec().class, pose.translation.z);
        let mut kept = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        if kept.world != world.stamp() {
            *kept = CutCache { world: world.stamp(), heights: Vec::new() };
        }
        let known = kept.heights.iter().position(|of| of.class == *class && of.height == height);
        let mut entry = match known {
            Some(i) => kept.heights.remove(i),
            None => CutHeight { class: class.clone(), height, scans: 0, cut: None },
        };
        entry.scans = entry.scans.saturating_add(1);
        let is_due = match making {
            Making::AtOnce => true,
            Making::IfOften => entry.scans >= Self::SCANS,
            Making::Never => false,
        };
        if entry.cut.is_none() && is_due {
            entry.cut = Some(Arc::new(RowCut::new(world, class, height)));
        }
        let cut = entry.cut.clone();
        kept.heights.push(entry);
        if kept.heights.len() > Self::MAX_CUTS {
            kept.heights.remove(0);
        }
        cut.filter(|cut| cut.serves(pose.translation.truncate()))
    }
}
