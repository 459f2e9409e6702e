//! Skins at rest: joints, not the mesh's own node, place the vertices of a skinned mesh (glTF 2.0, section 3.7.3).

use super::accessor::{AccessorCounts, Document, Values, position_accessor};
use super::buffers::REPAIR;
use super::nodes::{NodeText, SceneNode};
use super::notices::objects;
use super::place_of;
use crate::preparation::{ProblemBook, ProblemKind};
use glam::{DAffine3, DMat3, DVec3, Vec3};
use gltf::json;
use json::accessor::{ComponentType, Type};
use json::mesh::{Primitive, Semantic};
use json::validation::Checked;
use presight_model::error::{Error, Result};
use std::collections::BTreeMap;
use std::collections::btree_map::Entry;

/// The rest poses of skins, by their numbers.
pub(super) type RestPoses = BTreeMap<usize, RestPose>;

/// The skins of a scene.
#[derive(Default)]
pub(super) struct Skins {
    pub poses: RestPoses,
    /// Number of nodes with a skin whose mesh has no joints or weights.
    unused: usize,
}

impl Skins {
    /// The notice about skins that cannot be followed.
    pub fn notice(&self) -> Option<String> {
        let what = "skins of meshes without joints or weights are not followed: their nodes place them";
        (self.unused > 0).then(|| format!("{what} ({})", objects(self.unused)))
    }
}

/// A skin at rest. Its frame has the axes of the scene and the first joint as origin: far from the scene's origin, 32
/// bits would round the vertices.
pub(super) struct RestPose {
    /// In the scene's frame.
    origin: DVec3,
    /// For each joint.
    rest_from_mesh: Vec<DAffine3>,
}

/// The vertices of a primitive, posed by joints.
pub(super) struct Posed<'a> {
    pose: &'a RestPose,
    /// Joints and weights, four of each for a vertex.
    sets: Vec<(Values<'a>, Values<'a>)>,
}

/// The accessors of joints and weights of a primitive, set by set.
fn influences(
    primitive: &Primitive,
) -> impl Iterator<Item = (json::Index<json::Accessor>, json::Index<json::Accessor>)> {
    let of = |semantic| primitive.attributes.get(&Checked::Valid(semantic)).copied();
    (0..).map_while(move |set| Some((of(Semantic::Joints(set))?, of(Semantic::Weights(set))?)))
}

/// Poses the skinned nodes: each gets the frame of its skin. A node keeps its own transform if its mesh has no joints
/// and weights.
pub(super) fn pose(
    document: &Document<'_>,
    text: &NodeText,
    nodes: &mut [SceneNode],
    book: &mut ProblemBook,
) -> Result<Skins> {
    let Skins { mut poses, mut unused } = Skins::default();
    let mut scene_from_nodes = None;
    for node in nodes.iter_mut() {
        let (Some(mesh), Some(skin)) = (node.mesh, node.skin) else { continue };
        if !document.has_influences(mesh) {
            node.skin = None;
            unused += 1;
            book.note(ProblemKind::IgnoredFeature, || {
                format!("{}: skin: the mesh has no joints or weights", place_of(node))
            });
            continue;
        }
        let pose = match poses.entry(skin) {
            Entry::Occupied(known) => known.into_mut(),
            Entry::Vacant(new) => {
                let of_nodes = match &scene_from_nodes {
                    Some(known) => known,
                    None => scene_from_nodes.insert(text.scene_from_nodes()?),
                };
                new.insert(document.rest_pose(skin, of_nodes).map_err(|e| e.at(format!("skin {skin}")))?)
            }
        };
        node.scene_from_node = DAffine3::from_translation(pose.origin);
    }
    Ok(Skins { poses, unused })
}

impl Document<'_> {
    /// True if all primitives of a mesh that have positions also have joints and weights.
    pub fn has_influences(&self, mesh: usize) -> bool {
        let Some(mesh) = self.root.meshes.get(mesh) else { return false };
        let mut placed = mesh.primitives.iter().filter(|p| position_accessor(p).is_some()).peekable();
        placed.peek().is_some() && placed.all(|p| influences(p).next().is_some())
    }

    fn rest_pose(&self, skin: usize, scene_from_nodes: &[Option<DAffine3>]) -> Result<RestPose> {
        let count = self.root.skins.len();
        let Some(skin) = self.root.skins.get(skin) else {
            return Err(Error::invalid(format!("it does not exist, there are {count}"), REPAIR));
        };
        let scene_from_joints = skin.joints.iter().map(|joint| {
            let place = scene_from_nodes.get(joint.value()).copied().flatten().filter(|place| place.is_finite());
            place.ok_or_else(|| Error::invalid(format!("node {}, a joint, has no valid place", joint.value()), REPAIR))
        });
        let scene_from_joints = scene_from_joints.collect::<Result<Vec<DAffine3>>>()?;
        let Some(first) = scene_from_joints.first() else { return Err(Error::invalid("it has no joints", REPAIR)) };
        let origin = first.translation;
        let rest_from_scene = DAffine3::from_translation(-origin);
        let mut rest_from_mesh: Vec<DAffine3> =
            scene_from_joints.iter().map(|&joint| rest_from_scene * joint).collect();
        if let Some(accessor) = skin.inverse_bind_matrices {
            let joints_from_mesh = self.matrices(accessor, rest_from_mesh.len())?;
            for (rest, joint_from_mesh) in rest_from_mesh.iter_mut().zip(joints_from_mesh) {
                *rest *= joint_from_mesh;
            }
        }
        Ok(RestPose { origin, rest_from_mesh })
    }

    /// The first `count` matrices of an accessor.
    fn matrices(&self, accessor: json::Index<json::Accessor>, count: usize) -> Result<Vec<DAffine3>> {
        let there = self.proven_count(accessor, &mut AccessorCounts::default())?;
        if there < count as u64 {
            let what = format!("{count} joints have only {there} inverse bind matrices");
            return Err(Error::invalid(what, REPAIR));
        }
        let values = self.values(accessor, Type::Mat4, "inverse bind matrices")?;
        let matrix = |i: usize| {
            let m = values.numbers::<16>(i).map(f64::from);
            let column = |k: usize| DVec3::new(m[k], m[k + 1], m[k + 2]);
            DAffine3::from_mat3_translation(DMat3::from_cols(column(0), column(4), column(8)), column(12))
        };
        Ok((0..count).map(matrix).collect())
    }

    /// Checks that the data of the joints and weights of a primitive exist.
    pub fn prove_influences(&self, primitive: &Primitive, proven: &mut AccessorCounts) -> Result<()> {
        influences(primitive).try_for_each(|(joints, weights)| {
            self.proven_count(joints, proven)?;
            self.proven_count(weights, proven).map(|_| ())
        })
    }

    /// The joints and weights of a primitive, for `count` vertices.
    pub fn posed<'a>(&'a self, primitive: &Primitive, pose: &'a RestPose, count: usize) -> Result<Posed<'a>> {
        let set = |(joints, weights): (json::Index<json::Accessor>, json::Index<json::Accessor>)| {
            let component =
                |c: &ComponentType| matches!(c, ComponentType::U8 | ComponentType::U16 | ComponentType::U32);
            let place = |e: Error| e.at(format!("accessor {}", joints.value()));
            if !matches!(&self.accessor(joints)?.component_type, Checked::Valid(c) if component(&c.0)) {
                return Err(place(Error::invalid("joints must be u8 or u16", REPAIR)));
            }
            let values = (self.values(joints, Type::Vec4, "joints")?, self.values(weights, Type::Vec4, "weights")?);
            let there = values.0.count().min(values.1.count());
            if there < count {
                let what = format!("{count} vertices have only {there} joints or weights");
                return Err(place(Error::invalid(what, REPAIR)));
            }
            Ok(values)
        };
        Ok(Posed { pose, sets: influences(primitive).map(set).collect::<Result<_>>()? })
    }
}

/// Numbers of the accessors of joints and weights, which say if two primitives share their vertices.
pub(super) fn influence_accessors(primitive: &Primitive) -> Vec<usize> {
    influences(primitive).flat_map(|(joints, weights)| [joints.value(), weights.value()]).collect()
}

impl Posed<'_> {
    /// Vertex `i`, given in the mesh frame, in the frame of the rest pose. A vertex without weights follows the first
    /// joint.
    pub fn place(&self, i: usize, in_mesh: Vec3) -> Result<Vec3> {
        let in_mesh = in_mesh.as_dvec3();
        let (mut sum, mut weights) = (DVec3::ZERO, 0.0);
        let joint = |number: usize| {
            let there = self.pose.rest_from_mesh.len();
            let what = || format!("vertex {i} names joint {number}, there are {there}");
            self.pose.rest_from_mesh.get(number).ok_or_else(|| Error::invalid(what(), REPAIR))
        };
        for (numbers, shares) in &self.sets {
            for (number, weight) in numbers.numbers::<4>(i).into_iter().zip(shares.numbers::<4>(i).map(f64::from)) {
                if weight != 0.0 {
                    sum += joint(number as usize)?.transform_point3(in_mesh) * weight;
                    weights += weight;
                }
            }
        }
        // Weights with few digits do not add up to 1.
        let place = if weights == 0.0 { joint(0)?.transform_point3(in_mesh) } else { sum / weights };
        Ok(place.as_vec3())
    }
}
