//! Two real states of one office, each as the map of the other, by connected parts of their meshes.

use super::case::{Amounts, Case};
use glam::{DVec3, Vec3};
use presight_model::caster::RayCaster;
use presight_model::environment::{Environment, Mesh, NewObject, Polygon, PolygonOrder};
use presight_model::geometry::Pose;
use presight_model::world::World;
use std::collections::{BTreeMap, HashMap};

/// A surface of the other state is the same one within this distance, metres.
const SAME: f64 = 0.02;

/// Splits the objects of an environment into connected parts: polygons that share a corner, within 0.1 mm.
fn parts(whole: &Environment, prefix: &str) -> Environment {
    let mut environment = Environment::new();
    for material in whole.materials() {
        environment.add_material(material.clone()).expect("room for a material");
    }
    for object in whole.objects().iter().filter(|o| !o.is_deleted()) {
        let polygons: Vec<Vec<DVec3>> =
            (0..object.mesh.polygon_count() as u32).map(|k| object.polygon_in_world(k)).collect();
        let mut of_corner: HashMap<[i64; 3], usize> = HashMap::new();
        let mut group: Vec<usize> = (0..polygons.len()).collect();
        let root = |group: &[usize], mut k: usize| {
            while group[k] != k {
                k = group[k];
            }
            k
        };
        for (k, p) in polygons.iter().enumerate().flat_map(|(k, corners)| corners.iter().map(move |p| (k, p))) {
            let other = *of_corner.entry((*p * 1e4).round().to_array().map(|x| x as i64)).or_insert(k);
            let (a, b) = (root(&group, k), root(&group, other));
            group[a.max(b)] = a.min(b);
        }
        let mut members: BTreeMap<usize, Vec<usize>> = BTreeMap::new();
        (0..polygons.len()).for_each(|k| members.entry(root(&group, k)).or_default().push(k));
        for (part, members) in members {
            let (mut vertices, mut faces) = (Vec::<Vec3>::new(), Vec::new());
            for k in members {
                let first = vertices.len() as u32;
                vertices.extend(polygons[k].iter().map(|p| p.as_vec3()));
                faces.push(Polygon::new((first..vertices.len() as u32).collect(), object.mesh.material(k as u32)));
            }
            // Single precision makes lines of some slivers.
            let Ok(mesh) = Mesh::new("part", vertices, faces, PolygonOrder::Spatial) else { continue };
            let name = format!("{prefix}{} {part}", object.name);
            environment.insert(NewObject::new(&name, Pose::IDENTITY, mesh.into())).expect("room for an object");
        }
    }
    environment
}

/// The parts of one state that the other one lacks: it has less than half of their points.
fn lacks(environment: &Environment, other: &World) -> Vec<String> {
    let caster = RayCaster::new(other, "laser");
    let is_lacking = |index: &usize| {
        let object = &environment.objects()[*index];
        let points: Vec<DVec3> = (0..object.mesh.polygon_count() as u32)
            .flat_map(|k| {
                let corners = object.polygon_in_world(k);
                let middle = corners.iter().sum::<DVec3>() / corners.len() as f64;
                corners.into_iter().map(move |p| 0.5 * (p + middle)).chain([middle])
            })
            .collect();
        let there = points.iter().filter(|p| caster.nearest(**p, SAME).is_some()).count();
        2 * there < points.len()
    };
    let lacking = (0..environment.objects().len()).filter(is_lacking);
    lacking.map(|index| environment.objects()[index].name.clone()).collect()
}

/// The case of a map and a site.
pub fn case(map: &Environment, site: &Environment, views: usize, seed: u64) -> Case {
    let (map, site) = (World::new(parts(map, "")), World::new(parts(site, "site ")));
    let removed = lacks(map.environment(), &site).into_iter().collect();
    let added = lacks(site.environment(), &map).into_iter().collect();
    let amounts = Amounts { removed: 0, moved: 0, added: 0, walkers: 0, views };
    Case::of(map, site, (removed, added), amounts, seed)
}
