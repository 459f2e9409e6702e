//! Docks: groups of reflectors.

use glam::{DQuat, DVec3};
use presight_model::environment::{Feature, FeatureShape};
use presight_model::error::{Error, Result};
use presight_model::geometry::Pose;
use presight_model::world::World;
use std::sync::Arc;

/// A group of reflectors that a robot can dock at.
#[derive(Clone, Debug, PartialEq)]
pub struct Dock {
    /// Path of the group or object that contains all its reflectors; empty if there is no common one.
    pub name: String,
    /// Sensor class of the layer.
    pub class: String,
    /// Centre of the reflectors; the x axis is the horizontal part of their mean normal.
    pub world_from_dock: Pose,
    /// Ids of the reflectors and their places in the world, metres.
    pub reflectors: Vec<(u32, DVec3)>,
}

struct Reflector {
    id: u32,
    object: String,
    at: DVec3,
    normal: Option<DVec3>,
}

/// Groups of two or more reflectors of all layers by their first ids. Each reflector is at most `apart` metres from
/// another one of its group.
///
/// # Errors
/// [`presight_model::ErrorKind::Usage`] for a distance that is not above 0.
pub fn docks(world: &World, apart: f64) -> Result<Vec<Dock>> {
    if !(apart > 0.0 && apart.is_finite()) {
        return Err(Error::usage(format!("reflectors {apart} m apart"), "give metres above 0, such as 1"));
    }
    let mut found = Vec::new();
    for layer in world.environment().layers() {
        let mut open: Vec<Reflector> = layer.features.iter().filter_map(|f| reflector(world, f)).collect();
        open.reverse();
        while let Some(first) = open.pop() {
            let (mut group, mut next) = (vec![first], 0);
            while next < group.len() {
                let at = group[next].at;
                next += 1;
                let (near, far): (Vec<_>, Vec<_>) = open.drain(..).partition(|r| r.at.distance(at) <= apart);
                group.extend(near.into_iter().rev());
                open = far;
            }
            if group.len() > 1 {
                group.sort_by_key(|r| r.id);
                found.push(dock(&layer.class, &group));
            }
        }
    }
    Ok(found)
}

fn reflector(world: &World, feature: &Arc<Feature>) -> Option<Reflector> {
    let FeatureShape::Reflector { at, .. } = feature.shape else { return None };
    let object = feature.object.as_deref();
    let pose = object.and_then(|path| world.environment().object(path)).map_or(Pose::IDENTITY, |o| o.world_from_object);
    Some(Reflector {
        id: feature.id,
        object: object.unwrap_or_default().to_owned(),
        at: pose.transform_point(at),
        normal: feature.properties.normal.map(|normal| pose.rotation * normal),
    })
}

fn dock(class: &str, group: &[Reflector]) -> Dock {
    let middle = group.iter().map(|r| r.at).sum::<DVec3>() / group.len() as f64;
    let facing = group.iter().filter_map(|r| r.normal).sum::<DVec3>().with_z(0.0).normalize_or_zero();
    let heading = if facing == DVec3::ZERO { 0.0 } else { facing.y.atan2(facing.x) };
    let parts = |r: &Reflector| r.object.split('/').map(str::to_owned).collect::<Vec<String>>();
    let mut shared = parts(&group[0]);
    for r in group {
        let same = shared.iter().zip(parts(r)).take_while(|(a, b)| *a == b).count();
        shared.truncate(same);
    }
    Dock {
        name: shared.join("/"),
        class: class.to_owned(),
        world_from_dock: Pose { translation: middle, rotation: DQuat::from_rotation_z(heading) },
        reflectors: group.iter().map(|r| (r.id, r.at)).collect(),
    }
}
