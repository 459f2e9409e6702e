//! The changes of a world in memory that follow from findings.

use crate::decide::findings::{Finding, FindingKind};
use presight_model::change::Change;
use presight_model::environment::{Mark, MarkKind, Material, Mesh, NewObject};
use presight_model::geometry::Aabb;
use presight_model::world::World;

/// Inserts an object of the first material.
fn inserted(world: &World, object: Option<NewObject>) -> Change {
    let first = world.environment().materials().is_empty().then(|| Change::AddMaterial(Material::named("default")));
    Change::of(first.into_iter().chain(object.map(Change::InsertObject)).collect())
}

impl Finding {
    /// The change of a world that follows from the finding. `world` is the compared world, or that world after other
    /// findings.
    pub fn change(&self, world: &World) -> Change {
        let name = self.object.clone();
        let mark = |suffix: String, kind: MarkKind, class: Option<String>, bounds: Option<Aabb>| {
            let mark = Mark { object: self.object.clone(), kind, class, bounds };
            Change::SetMark { name: format!("{} {suffix}", self.object), mark }
        };
        match &self.kind {
            FindingKind::Gone => Change::DeleteObject { name },
            FindingKind::Moved { world_from_object, .. } => {
                Change::SetPose { name, world_from_object: *world_from_object }
            }
            FindingKind::New(found) => {
                let half = (0.5 * found.size).as_vec3();
                // The edges of a box are at least some millimetres long.
                let mesh = Mesh::cuboid("provisional", -half, half, 0).ok();
                inserted(world, mesh.map(|mesh| NewObject::new("provisional", found.pose, mesh.into())))
            }
            FindingKind::Recognized(known) => {
                inserted(world, Some(known.shape.object("provisional", known.world_from_object)))
            }
            FindingKind::Part(bounds) => mark(format!("part at {}", bounds.min), MarkKind::Absent, None, Some(*bounds)),
            FindingKind::SeenThrough(class) => {
                mark("seen through".to_owned(), MarkKind::Absent, Some(class.clone()), None)
            }
            FindingKind::ComesAndGoes => mark("comes and goes".to_owned(), MarkKind::Uncertain, None, None),
        }
    }
}
