//! Objects whose data are in a buffer without data. Such a file is valid: glTF leaves the meaning of the buffer to
//! extensions (glTF 2.0, section 3.6.1.2).

use super::accessor::{Document, position_accessor};
use super::nodes::{SceneNode, Shape};
use super::notices::LeftOut;
use super::place_of;
use super::skin::influence_accessors;
use crate::preparation::{ProblemBook, ProblemKind};
use gltf::json::mesh::Primitive;
use std::collections::HashMap;

/// Takes the mesh from each node that needs data of such a buffer. Returns these nodes.
pub(super) fn leave_out(document: &Document<'_>, nodes: &mut [SceneNode], book: &mut ProblemBook) -> LeftOut {
    let (mut known, mut all) = (HashMap::new(), LeftOut::default());
    for node in nodes {
        let Some(shape) = node.shape() else { continue };
        let of_shape = *known.entry(shape).or_insert_with(|| document.dataless_buffer(shape));
        let instances = node.instances.map_or([None; 3], |i| [i.translation, i.rotation, i.scale]);
        let of_instances = || document.first_dataless(instances.into_iter().flatten().map(|i| i as usize));
        let Some(buffer) = of_shape.or_else(of_instances) else { continue };
        book.note(ProblemKind::EmptyMesh, || format!("{}: buffer {buffer} has no data", place_of(node)));
        all.add(|| place_of(node));
        node.mesh = None;
    }
    all
}

impl Document<'_> {
    /// The first buffer without data that a mesh or its skin needs.
    fn dataless_buffer(&self, Shape { mesh, skin }: Shape) -> Option<usize> {
        let skin = skin.filter(|_| self.has_influences(mesh));
        let primitives = self.root.meshes.get(mesh).map_or(&[][..], |mesh| &mesh.primitives);
        let of_primitive = |primitive: &Primitive| {
            let influences = skin.map_or_else(Vec::new, |_| influence_accessors(primitive));
            position_accessor(primitive).into_iter().chain(primitive.indices).map(|i| i.value()).chain(influences)
        };
        let of_skin = skin.and_then(|skin| self.root.skins.get(skin)?.inverse_bind_matrices).map(|i| i.value());
        self.first_dataless(primitives.iter().flat_map(of_primitive).chain(of_skin))
    }

    /// The first buffer without data that these accessors need.
    fn first_dataless(&self, accessors: impl Iterator<Item = usize>) -> Option<usize> {
        let views = accessors.filter_map(|i| self.root.accessors.get(i)).flat_map(|accessor| {
            let sparse = accessor.sparse.iter().flat_map(|s| [s.indices.buffer_view, s.values.buffer_view]);
            accessor.buffer_view.into_iter().chain(sparse)
        });
        let mut buffers =
            views.filter_map(|view| self.root.buffer_views.get(view.value())).map(|view| view.buffer.value());
        buffers.find(|&buffer| self.buffers.is_nowhere(buffer))
    }
}
