//! Finds polygons by the ids in images.

use super::IdScheme;
use presight_model::environment::Environment;
use std::collections::HashMap;

/// Finds the polygon of a pixel. Source numbers are looked up in tables, which are built per object on demand.
#[derive(Debug)]
pub struct PolygonsOfIds<'a> {
    environment: &'a Environment,
    ids: IdScheme,
    /// By object: polygon index + 1 by source number.
    of_source: HashMap<u32, Vec<u32>>,
}

impl<'a> PolygonsOfIds<'a> {
    /// Creates a finder for images of this environment whose `polygon_id` follows `ids`.
    pub fn new(environment: &'a Environment, ids: IdScheme) -> Self {
        Self { environment, ids, of_source: HashMap::new() }
    }

    /// Object and polygon index for a pixel's ids. `None` for 0 and for ids that are not in the environment.
    pub fn find(&mut self, object_id: u32, polygon_id: u32) -> Option<(u32, u32)> {
        let object = object_id.checked_sub(1)?;
        let o = self.environment.objects().get(object as usize)?;
        let number = polygon_id.checked_sub(1)?;
        let polygon = match self.ids {
            IdScheme::Model => number.checked_sub(o.first_slot)?,
            IdScheme::Source => {
                let table = self.of_source.entry(object).or_insert_with(|| {
                    let mut table = Vec::new();
                    for polygon in 0..o.mesh.polygon_count() as u32 {
                        let source = o.mesh.source(polygon) as usize;
                        table.resize(table.len().max(source + 1), 0);
                        table[source] = polygon + 1;
                    }
                    table
                });
                table.get(number.checked_sub(o.first_source)? as usize)?.checked_sub(1)?
            }
        };
        ((polygon as usize) < o.mesh.polygon_count()).then_some((object, polygon))
    }
}
