//! Instances of nodes: `EXT_mesh_gpu_instancing`.

use super::accessor::{AccessorCounts, Document};
use super::buffers::REPAIR;
use super::memory::Memory;
use super::nodes::{Instances, SceneNode};
use super::place_of;
use glam::{DAffine3, DQuat, DVec3};
use gltf::json;
use json::accessor::Type;
use presight_model::error::{Error, Result};

/// Replaces each node with instances by a node for each of them, with its name and its parent. It keeps its children.
/// Skinned nodes have no instances, because their transform is ignored.
pub(super) fn expanded(document: &Document<'_>, nodes: Vec<SceneNode>, memory: &mut Memory) -> Result<Vec<SceneNode>> {
    let mut all = Vec::with_capacity(nodes.len());
    let mut number_of = Vec::with_capacity(nodes.len());
    let mut proven = AccessorCounts::default();
    for mut node in nodes {
        node.parent = node.parent.map(|parent| number_of[parent]);
        number_of.push(all.len());
        let instances = node.instances.filter(|_| node.mesh.is_some() && node.skin.is_none());
        let Some(instances) = instances else {
            all.push(node);
            continue;
        };
        let place = |e: Error| e.at(place_of(&node));
        let (count, node_from_instance) = document.places(instances, &mut proven).map_err(place)?;
        // Counted before any is made.
        (0..count).try_for_each(|_| memory.take_node(node.path.len()))?;
        let mut found = Vec::with_capacity(count);
        for i in 0..count {
            let scene_from_node = node.scene_from_node * node_from_instance(i).map_err(place)?;
            found.push(SceneNode { scene_from_node, ..node.copied() });
        }
        all.push(SceneNode { mesh: None, ..node });
        all.append(&mut found);
    }
    Ok(all)
}

impl Document<'_> {
    /// The number of instances, and the transform of each to its node.
    fn places(
        &self,
        instances: Instances,
        proven: &mut AccessorCounts,
    ) -> Result<(usize, impl Fn(usize) -> Result<DAffine3>)> {
        let Instances { translation, rotation, scale } = instances;
        let mut count = None;
        for accessor in [translation, rotation, scale].into_iter().flatten() {
            let there = self.proven_count(json::Index::new(accessor), proven)?;
            if *count.get_or_insert(there) != there {
                return Err(Error::invalid(
                    "its instances differ in number between translation, rotation and scale",
                    REPAIR,
                ));
            }
        }
        let values = |accessor: Option<u32>, type_: Type, words| {
            accessor.map(|accessor| self.values(json::Index::new(accessor), type_, words)).transpose()
        };
        let translations = values(translation, Type::Vec3, "translations")?;
        let rotations = values(rotation, Type::Vec4, "rotations")?;
        let scales = values(scale, Type::Vec3, "scales")?;
        let place = move |i: usize| {
            let translation = translations.as_ref().map_or(DVec3::ZERO, |all| all.get(i).as_dvec3());
            let scale = scales.as_ref().map_or(DVec3::ONE, |all| all.get(i).as_dvec3());
            let rotation = match &rotations {
                None => DQuat::IDENTITY,
                Some(all) => rotation_of(all.numbers::<4>(i)).ok_or_else(|| {
                    Error::invalid(format!("the rotation of instance {i} is not a unit quaternion"), REPAIR)
                })?,
            };
            Ok(DAffine3::from_scale_rotation_translation(scale, rotation, translation))
        };
        // A node without attributes has one instance, in its own place.
        Ok((count.unwrap_or(1) as usize, place))
    }
}

/// A rotation with the digits of 8 or 16 bits, without the scale that rounding adds.
fn rotation_of(numbers: [f32; 4]) -> Option<DQuat> {
    let rotation = DQuat::from_array(numbers.map(f64::from));
    (0.5..=2.0).contains(&rotation.length()).then(|| rotation.normalize())
}
