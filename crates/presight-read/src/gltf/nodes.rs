//! The node hierarchy, read and composed in f64. In f32, UTM coordinates would lose precision.

use super::buffers::REPAIR;
use super::exact::RootPlacement;
use super::extensions::is_known;
use super::memory::Memory;
use super::quoted;
use glam::{DAffine3, DMat3, DQuat, DVec3};
use presight_model::error::{Error, Result};
use presight_model::limits;
use serde::Deserialize;
use serde::de::IgnoredAny;
use std::collections::{BTreeMap, BTreeSet};

/// The part of a glTF file that is read as f64.
#[derive(Deserialize)]
pub(super) struct NodeText {
    #[serde(default)]
    nodes: Vec<Node>,
    #[serde(default)]
    scenes: Vec<SceneText>,
    scene: Option<usize>,
}

#[derive(Deserialize)]
struct SceneText {
    #[serde(default)]
    nodes: Vec<usize>,
}

#[derive(Deserialize)]
struct Node {
    name: Option<String>,
    mesh: Option<usize>,
    #[serde(default)]
    children: Vec<usize>,
    skin: Option<usize>,
    matrix: Option<[f64; 16]>,
    translation: Option<[f64; 3]>,
    rotation: Option<[f64; 4]>,
    scale: Option<[f64; 3]>,
    #[serde(default)]
    extensions: NodeExtensions,
    extras: Option<serde_json::Value>,
}

#[derive(Default, Deserialize)]
struct NodeExtensions {
    #[serde(rename = "KHR_node_visibility")]
    visibility: Option<Visibility>,
    #[serde(rename = "EXT_mesh_gpu_instancing")]
    instancing: Option<Instancing>,
    #[serde(flatten)]
    others: BTreeMap<String, IgnoredAny>,
}

#[derive(Deserialize)]
struct Visibility {
    visible: Option<bool>,
}

#[derive(Deserialize)]
struct Instancing {
    attributes: Instances,
}

/// The accessors that place the instances of a node in its frame.
#[derive(Clone, Copy, Deserialize)]
#[serde(rename_all = "UPPERCASE")]
pub(super) struct Instances {
    pub translation: Option<u32>,
    pub rotation: Option<u32>,
    pub scale: Option<u32>,
}

/// The default scene.
#[derive(Default)]
pub(super) struct SceneNodes {
    /// Depth-first, with children in order.
    pub nodes: Vec<SceneNode>,
    /// Number of objects that `KHR_node_visibility` hides.
    pub hidden: usize,
    /// The extensions that are not followed, with the file's numbers of the nodes that have them.
    pub extensions: BTreeMap<String, BTreeSet<usize>>,
}

/// A node of the default scene with a mesh at or below it, or a group of our own writer.
pub(super) struct SceneNode {
    /// Index in the file.
    pub node: usize,
    /// Index of its parent among the scene nodes, which come before it.
    pub parent: Option<usize>,
    pub name: String,
    /// Full node path in the file, "a/b/c", for messages. It need not be unique.
    pub path: String,
    pub mesh: Option<usize>,
    /// glTF scene axes, y up.
    pub scene_from_node: DAffine3,
    /// The skin that poses its mesh.
    pub skin: Option<usize>,
    pub instances: Option<Instances>,
    /// Our own writer's data, for a root.
    pub placed: Option<RootPlacement>,
}

/// A mesh of the file, and the skin that poses it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(super) struct Shape {
    pub mesh: usize,
    pub skin: Option<usize>,
}

impl SceneNode {
    /// Its mesh, and the skin that poses it.
    pub fn shape(&self) -> Option<Shape> {
        Some(Shape { mesh: self.mesh?, skin: self.skin })
    }

    /// Copy of the node without the data of presight's own writer.
    pub fn copied(&self) -> Self {
        let Self { node, parent, mesh, scene_from_node, skin, instances, .. } = *self;
        let (name, path) = (self.name.clone(), self.path.clone());
        Self { node, parent, name, path, mesh, scene_from_node, skin, instances, placed: None }
    }
}

impl NodeText {
    /// Lists the scene nodes.
    pub fn scene_nodes(&self, memory: &mut Memory) -> Result<SceneNodes> {
        let parents = self.parents()?;
        let carries = self.carriers(&parents);
        let mut scene = SceneNodes::default();
        let mut seen = vec![false; self.nodes.len()];
        let mut path = String::new();
        // Not recursive, because a deep file must not exhaust the stack. (node, depth, length of the parent's path,
        // parent's index in `scene`, if it is visible, scene_from_parent)
        let mut stack: Vec<(usize, usize, usize, Option<usize>, bool, DAffine3)> =
            self.roots(&parents)?.iter().rev().map(|&r| (r, 0, 0, None, true, DAffine3::IDENTITY)).collect();
        while let Some((index, depth, parent_length, parent, visible, scene_from_parent)) = stack.pop() {
            let node = &self.nodes[index];
            if std::mem::replace(&mut seen[index], true) {
                return Err(self.error(index, "the scene holds this node twice"));
            }
            path.truncate(parent_length);
            let start = self.extend_path(index, depth, &mut path)?;
            let scene_from_node = scene_from_parent * node.transform().map_err(|what| self.error(index, what))?;
            let placed = node.extras.as_ref().filter(|_| depth == 0).and_then(RootPlacement::of);
            let visible = visible && node.is_visible();
            let mut own = None;
            if !visible {
                scene.hidden += usize::from(node.mesh.is_some());
            } else if carries[index] || matches!(placed, Some(RootPlacement::Group(_))) {
                memory.take_node(path.len())?;
                own = Some(scene.nodes.len());
                for extension in node.extensions.others.keys().filter(|extension| !is_known(extension)) {
                    scene.extensions.entry(extension.clone()).or_default().insert(index);
                }
                scene.nodes.push(SceneNode {
                    node: index,
                    parent,
                    name: path[start..].to_owned(),
                    path: path.clone(),
                    mesh: node.mesh,
                    scene_from_node,
                    skin: node.skin,
                    instances: node.extensions.instancing.as_ref().map(|all| all.attributes),
                    placed,
                });
            }
            let length = path.len();
            stack.extend(node.children.iter().rev().map(|&c| (c, depth + 1, length, own, visible, scene_from_node)));
        }
        Ok(scene)
    }

    /// Adds a node's name to the path of its parent, and returns where it starts.
    fn extend_path(&self, index: usize, depth: usize, path: &mut String) -> Result<usize> {
        if depth > 0 {
            path.push('/');
        }
        let start = path.len();
        match self.nodes[index].name.as_deref() {
            Some(name) if !name.is_empty() => path.push_str(name),
            _ => path.push_str(&format!("node{index}")),
        }
        let (levels, bytes) = (limits::MAX_NODE_DEPTH, limits::MAX_NAME_BYTES);
        if depth >= levels || path.len() > bytes {
            return Err(self.error(index, format!("nodes nest over {levels} levels or a path is over {bytes} bytes")));
        }
        Ok(start)
    }

    /// The transform of each node to the scene, whether it is in the default scene or not; `None` if it or a node
    /// above is broken.
    pub fn scene_from_nodes(&self) -> Result<Vec<Option<DAffine3>>> {
        let parents = self.parents()?;
        let mut all = vec![None; self.nodes.len()];
        let mut stack: Vec<(usize, DAffine3)> =
            (0..parents.len()).filter(|&i| parents[i].is_none()).map(|i| (i, DAffine3::IDENTITY)).collect();
        while let Some((index, scene_from_parent)) = stack.pop() {
            let node = &self.nodes[index];
            if let Ok(parent_from_node) = node.transform() {
                let scene_from_node = scene_from_parent * parent_from_node;
                all[index] = Some(scene_from_node);
                stack.extend(node.children.iter().map(|&child| (child, scene_from_node)));
            }
        }
        Ok(all)
    }

    /// The parent of each node. Checks that the hierarchy is a forest.
    fn parents(&self) -> Result<Vec<Option<usize>>> {
        let count = self.nodes.len();
        let mut parents = vec![None; count];
        for (index, node) in self.nodes.iter().enumerate() {
            for &child in &node.children {
                if child >= count {
                    return Err(self.error(index, format!("child {child} does not exist, there are {count} nodes")));
                }
                if let Some(other) = parents[child].replace(index) {
                    return Err(self.error(child, format!("it has two parents, nodes {other} and {index}")));
                }
            }
        }
        // As each node has at most one parent, nodes that no root reaches form a cycle.
        let mut reached = vec![false; count];
        let mut stack: Vec<usize> = (0..count).filter(|&i| parents[i].is_none()).collect();
        while let Some(i) = stack.pop() {
            reached[i] = true;
            stack.extend(&self.nodes[i].children);
        }
        match reached.iter().position(|r| !r) {
            Some(lost) => Err(self.error(lost, "it is its own ancestor: the nodes form a cycle")),
            None => Ok(parents),
        }
    }

    /// True for each node with a mesh at or below it.
    fn carriers(&self, parents: &[Option<usize>]) -> Vec<bool> {
        let mut carries = vec![false; self.nodes.len()];
        for (index, _) in self.nodes.iter().enumerate().filter(|(_, node)| node.mesh.is_some()) {
            let mut at = Some(index);
            while let Some(node) = at.filter(|&node| !std::mem::replace(&mut carries[node], true)) {
                at = parents[node];
            }
        }
        carries
    }

    /// Roots of the default scene.
    fn roots(&self, parents: &[Option<usize>]) -> Result<Vec<usize>> {
        let count = self.nodes.len();
        let Some(scene) = self.scenes.get(self.scene.unwrap_or(0)) else {
            if self.scene.is_none() {
                return Ok((0..count).filter(|&i| parents[i].is_none()).collect());
            }
            let e = Error::invalid(format!("there are {} scenes", self.scenes.len()), REPAIR);
            return Err(e.at(format!("scene {}", self.scene.unwrap_or(0))));
        };
        if let Some(n) = scene.nodes.iter().find(|&&n| n >= count) {
            return Err(Error::invalid(format!("node {n} does not exist, there are {count}"), REPAIR).at("scene"));
        }
        // glTF 2.0, section 3.5.1: nodes listed in a scene must be roots. A child would lose its parent's transform.
        if let Some((n, parent)) = scene.nodes.iter().find_map(|&n| Some((n, parents[n]?))) {
            let what = format!("the scene lists it as a root, but it is a child of {}", self.named(parent));
            let remedy = "list the root above it in the scene, or remove it from its parent's children";
            return Err(Error::invalid(what, remedy).at(self.named(n)));
        }
        Ok(scene.nodes.clone())
    }

    fn error(&self, index: usize, what: impl Into<String>) -> Error {
        Error::invalid(what, REPAIR).at(self.named(index))
    }

    /// A node in messages.
    fn named(&self, index: usize) -> String {
        format!("node {index} {}", quoted(self.nodes[index].name.as_deref().unwrap_or("")))
    }
}

impl Node {
    fn is_visible(&self) -> bool {
        self.extensions.visibility.as_ref().is_none_or(|v| v.visible.unwrap_or(true))
    }

    /// `parent_from_node`.
    fn transform(&self) -> Result<DAffine3, &'static str> {
        let Some(m) = &self.matrix else {
            return self.transform_from_trs();
        };
        if self.translation.is_some() || self.rotation.is_some() || self.scale.is_some() {
            return Err("it has both a matrix and translation, rotation or scale");
        }
        let last = [m[3], m[7], m[11], m[15]];
        // Exporters that multiply in f32 leave rounding errors here; larger values would be a projection.
        if last.iter().zip([0.0, 0.0, 0.0, 1.0]).any(|(a, b)| (a - b).abs() > 1e-6) {
            return Err("the last row of its matrix is not 0 0 0 1");
        }
        let column = |i: usize| DVec3::new(m[i], m[i + 1], m[i + 2]);
        Ok(DAffine3::from_mat3_translation(DMat3::from_cols(column(0), column(4), column(8)), column(12)))
    }

    fn transform_from_trs(&self) -> Result<DAffine3, &'static str> {
        let rotation = match self.rotation {
            None => DQuat::IDENTITY,
            Some(q) => {
                let q = DQuat::from_array(q);
                let length = q.length();
                // Quaternions with f32 digits would add a scale.
                if !(0.5..=2.0).contains(&length) {
                    return Err("its rotation is not a unit quaternion");
                }
                q.normalize()
            }
        };
        let scale = self.scale.map_or(DVec3::ONE, DVec3::from_array);
        let translation = self.translation.map_or(DVec3::ZERO, DVec3::from_array);
        Ok(DAffine3::from_scale_rotation_translation(scale, rotation, translation))
    }
}
