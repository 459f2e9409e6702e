//! Fast predictions for a level one-row scanner: the world is cut once into segments at its height, and searched
//! nearest first. Cuts are kept per version of the world. Ranges agree with images within the range bound
//! ([`crate::verify`]).

mod cut;
mod view;

pub use cut::RowCut;
pub use view::RowView;

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

/// Cuts of one version of the world.
#[derive(Debug, Default)]
pub struct RowCuts(Mutex<CutCache>);

#[derive(Debug, Default)]
struct CutCache {
    /// [`World::stamp`].
    world: u64,
    /// Least recently used first.
    cuts: Vec<(String, f64, Arc<RowCut>)>,
}

impl RowCuts {
    /// Maximum number of heights and classes that are kept.
    const MOST: usize = 8;

    /// Returns the cut for a version of the world, a sensor class and a height; makes it if it is not cached.
    pub fn get(&self, world: &World, class: &str, height: f64) -> Arc<RowCut> {
        let mut kept = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        if kept.world != world.stamp() {
            *kept = CutCache { world: world.stamp(), cuts: Vec::new() };
        }
        let known = kept.cuts.iter().position(|(of, at, _)| of == class && *at == height);
        let entry = match known {
            Some(i) => kept.cuts.remove(i),
            None => (class.to_owned(), height, Arc::new(RowCut::new(world, class, height))),
        };
        let cut = entry.2.clone();
        kept.cuts.push(entry);
        if kept.cuts.len() > Self::MOST {
            kept.cuts.remove(0);
        }
        cut
    }
}

/// The images range and cos_incidence from a cut, for tests; `None` for unsupported sensors and tilted poses.
pub fn see(world: &World, sensor: &Sensor, world_from_sensor: &Pose) -> Option<(Vec<f32>, Vec<f32>)> {
    let mut view = RowView::new(sensor).filter(|_| is_level(world_from_sensor))?;
    let cut = RowCut::new(world, &sensor.spec().class, world_from_sensor.translation.z);
    let (mut range, mut cos_incidence) = (Vec::new(), Vec::new());
    view.see(&cut, world_from_sensor, &mut range, &mut cos_incidence);
    Some((range, cos_incidence))
}
