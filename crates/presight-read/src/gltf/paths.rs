//! Unique full paths of nodes.

use super::nodes::SceneNode;
use presight_model::environment::Paths;

/// The path of each node that is an object or has objects below, and `None` for the others. A repeated name gets `#2`
/// and so on at its own level: `arm`, `arm/hand`, `arm#2`, `arm#2/hand`.
pub(super) fn paths(nodes: &[SceneNode], is_object: impl Fn(&SceneNode) -> bool) -> Vec<Option<String>> {
    let mut lives: Vec<bool> = nodes.iter().map(is_object).collect();
    // Parents come before their children.
    for index in (0..nodes.len()).rev() {
        if let Some(parent) = nodes[index].parent.filter(|_| lives[index]) {
            lives[parent] = true;
        }
    }
    let mut taken = Paths::default();
    let mut paths: Vec<Option<String>> = Vec::with_capacity(nodes.len());
    for (node, lives) in nodes.iter().zip(lives) {
        let wanted = || match node.parent.and_then(|parent| paths[parent].as_deref()) {
            Some(above) => format!("{above}/{}", node.name),
            None => node.name.clone(),
        };
        let path = lives.then(|| taken.take(wanted()));
        paths.push(path);
    }
    paths
}
