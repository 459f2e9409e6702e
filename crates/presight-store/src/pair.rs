//! Pairs the objects of a scene with the objects of an environment by their paths.
//!
//! A file may repeat a name: its second `chair` becomes `chair#2`, in the order of the file. Such numbers do
//! not identify an object. Objects of a repeated name are therefore paired in three passes: unchanged objects, then
//! objects of equal shape, then the rest; each pass minimizes the sum of the distances. A repeated group is paired as a
//! whole. A unique name is paired with the same name.

use super::assign::{MAX_WORK, assign};
use glam::DVec3;
use presight_model::environment::{ContentHash, Environment, Material, Mesh, Object};
use presight_model::geometry::Aabb;
use std::collections::{BTreeMap, BTreeSet, HashMap};
use std::sync::Arc;

/// Distances are compared in steps of a micrometre.
const STEPS: f64 = 1e6;

/// The farthest distance, metres: sums over all objects stay far below the largest integer.
const FARTHEST: f64 = 1e6;

/// What the paths of a scene are called in the environment.
#[derive(Debug, Default)]
pub(super) struct Pairing {
    /// Paths of objects and groups of the scene that have another name in the environment.
    names: HashMap<String, String>,
    /// The repeated names among them: the path in the scene, and in the environment.
    pub renamed: Vec<(String, String)>,
    /// Repeated paths for which several pairings are equally near.
    pub ties: Vec<String>,
}

/// An object at or below the place that is being paired.
#[derive(Clone, Copy)]
struct Part<'a> {
    /// The path from here to the object; `None` if it is here.
    rest: Option<&'a str>,
    object: &'a Object,
}

/// The parts at and below each name of a place.
type Units<'a> = BTreeMap<&'a str, Vec<Part<'a>>>;

/// One of several units with the same name.
struct Repeat<'a> {
    head: &'a str,
    /// Equal for units with equal shapes, and for equal shapes at equal poses.
    shape: blake3::Hash,
    whole: blake3::Hash,
    /// Middle of its bounds in the world.
    middle: DVec3,
}

/// Hashes of an environment's meshes.
pub(super) struct MeshHashes {
    materials: Vec<ContentHash>,
    meshes: HashMap<*const Mesh, ContentHash>,
}

impl MeshHashes {
    pub fn new(environment: &Environment) -> Self {
        let materials = environment.materials().iter().map(Material::content_hash).collect();
        Self { materials, meshes: HashMap::new() }
    }

    pub fn of(&mut self, mesh: &Arc<Mesh>) -> ContentHash {
        let Self { materials, meshes } = self;
        *meshes.entry(Arc::as_ptr(mesh)).or_insert_with(|| mesh.content_hash(|m| materials[usize::from(m)]))
    }
}

/// Objects that are not deleted.
pub(super) fn live(environment: &Environment) -> impl Iterator<Item = &Object> {
    environment.objects().iter().filter(|o| !o.is_deleted())
}

impl Pairing {
    /// Pairs the objects of a scene (`theirs`) with the objects of the environment (`ours`).
    pub fn new(ours: &Environment, theirs: &Environment, hashes: [&mut MeshHashes; 2]) -> Self {
        let mut pairing = Self::default();
        if [ours, theirs].into_iter().any(|e| live(e).any(|o| o.name.contains('#'))) {
            let [ours, theirs] = [ours, theirs].map(|e| live(e).map(|o| Part { rest: Some(&o.name), object: o }));
            pairing.pair(["", ""], [ours.collect(), theirs.collect()], hashes);
        }
        pairing
    }

    /// The name in the environment for a path of the scene.
    pub fn name<'a>(&'a self, path: &'a str) -> &'a str {
        self.names.get(path).map_or(path, String::as_str)
    }

    /// Pairs the parts below two places, given by their paths with a slash at the end.
    fn pair(&mut self, at: [&str; 2], parts: [Vec<Part<'_>>; 2], hashes: [&mut MeshHashes; 2]) {
        let [mut ours, theirs] = parts.map(units);
        let [of_ours, of_theirs] = hashes;
        let is_name = |name: &str| ours.contains_key(name) || theirs.contains_key(name);
        let mut families: BTreeMap<&str, [Vec<&str>; 2]> = BTreeMap::new();
        for (side, heads) in [ours.keys(), theirs.keys()].into_iter().enumerate() {
            for head in heads {
                let base = Some(base(head)).filter(|base| is_name(base)).unwrap_or(head);
                families.entry(base).or_default()[side].push(head);
            }
        }
        let mut taken: BTreeSet<String> = ours.keys().map(|head| (*head).to_owned()).collect();
        let mut names: BTreeMap<&str, String> = BTreeMap::new();
        for (base, [of_us, of_them]) in families {
            let paired = match (&of_us[..], &of_them[..]) {
                ([], _) | (_, []) => Vec::new(),
                ([one], [other]) => vec![(*one, *other)],
                _ => {
                    let of_us = of_us.iter().map(|head| Repeat::new(head, &ours[head], of_ours)).collect();
                    let repeats = [of_us, of_them.iter().map(|h| Repeat::new(h, &theirs[h], of_theirs)).collect()];
                    let (paired, is_tie) = pair_repeats(repeats);
                    self.ties.extend(is_tie.then(|| format!("{}{base}", at[1])));
                    paired
                }
            };
            names.extend(paired.iter().map(|(one, other)| (*other, (*one).to_owned())));
            for head in of_them {
                names.entry(head).or_insert_with(|| {
                    let numbered = (2u32..).map(|k| format!("{base}#{k}"));
                    let free = std::iter::once(head.to_owned()).chain(numbered).find(|name| !taken.contains(name));
                    let free = free.unwrap_or_else(|| head.to_owned());
                    taken.insert(free.clone());
                    free
                });
            }
        }
        for (head, of_them) in theirs {
            let name = &names[head];
            let [own, path] = [format!("{}{name}", at[0]), format!("{}{head}", at[1])];
            let of_us = ours.remove(name.as_str()).unwrap_or_default();
            if name != head {
                self.renamed.push((path.clone(), own.clone()));
            }
            let parts =
                [of_us, of_them].map(|parts| parts.into_iter().filter(|p| p.rest.is_some()).collect::<Vec<_>>());
            if !parts[1].is_empty() {
                let places = [format!("{own}/"), format!("{path}/")];
                self.pair(places.each_ref().map(String::as_str), parts, [&mut *of_ours, &mut *of_theirs]);
            }
            if own != path {
                self.names.insert(path, own);
            }
        }
    }
}

/// Splits the parts of a place by the names directly below it.
fn units(parts: Vec<Part<'_>>) -> Units<'_> {
    let mut units = Units::new();
    for Part { rest, object } in parts {
        let Some(path) = rest else { continue };
        let (head, rest) = path.split_once('/').map_or((path, None), |(head, rest)| (head, Some(rest)));
        units.entry(head).or_default().push(Part { rest, object });
    }
    units
}

/// The name without the numbers of repetitions.
fn base(name: &str) -> &str {
    let number = |text: &str| !text.starts_with('0') && text != "1" && text.bytes().all(|b| b.is_ascii_digit());
    match name.rsplit_once('#') {
        Some((before, text)) if !before.is_empty() && !text.is_empty() && number(text) => base(before),
        _ => name,
    }
}

impl<'a> Repeat<'a> {
    fn new(head: &'a str, parts: &[Part<'_>], hashes: &mut MeshHashes) -> Self {
        let (mut bounds, mut shapes) = (Aabb::EMPTY, Vec::with_capacity(parts.len()));
        for Part { rest, object } in parts {
            let path: Vec<&str> = rest.iter().flat_map(|rest| rest.split('/').map(base)).collect();
            let scale = object.object_from_mesh.to_cols_array().map(f64::to_bits);
            let pose = object.world_from_object.to_array().map(f64::to_bits);
            shapes.push((path, hashes.of(&object.mesh).0, scale, pose));
            bounds = bounds.union(object.world_bounds());
        }
        shapes.sort_unstable();
        let [mut shape, mut whole] = [blake3::Hasher::new(), blake3::Hasher::new()];
        for (path, mesh, scale, pose) in &shapes {
            shape.update(format!("{path:?} {mesh:?} {scale:?}").as_bytes());
            whole.update(format!("{path:?} {mesh:?} {scale:?} {pose:?}").as_bytes());
        }
        Self { head, shape: shape.finalize(), whole: whole.finalize(), middle: bounds.center() }
    }
}

/// Pairs units of one name, as their heads. True if several pairings are equally near.
fn pair_repeats<'a>(repeats: [Vec<Repeat<'a>>; 2]) -> (Vec<(&'a str, &'a str)>, bool) {
    let mut left = repeats.map(|side| side.into_iter().map(Some).collect::<Vec<_>>());
    let (mut pairs, mut is_tie) = (Vec::new(), false);
    is_tie |= pair_class(&mut left, &mut pairs, |r| *r.whole.as_bytes());
    is_tie |= pair_class(&mut left, &mut pairs, |r| *r.shape.as_bytes());
    is_tie |= pair_class(&mut left, &mut pairs, |_| ());
    (pairs, is_tie)
}

/// Pairs the units that are left, among those with equal keys. True if several pairings are equally near.
fn pair_class<'a, K: Ord>(
    left: &mut [Vec<Option<Repeat<'a>>>; 2],
    pairs: &mut Vec<(&'a str, &'a str)>,
    key: impl Fn(&Repeat<'a>) -> K,
) -> bool {
    let mut classes: BTreeMap<K, [Vec<usize>; 2]> = BTreeMap::new();
    for (side, units) in left.iter().enumerate() {
        for (i, unit) in units.iter().enumerate().filter_map(|(i, unit)| Some((i, unit.as_ref()?))) {
            classes.entry(key(unit)).or_default()[side].push(i);
        }
    }
    let mut is_tie = false;
    for [ours, theirs] in classes.into_values().filter(|class| class.iter().all(|side| !side.is_empty())) {
        // The shorter side gives the rows.
        let turned = ours.len() > theirs.len();
        let (rows, columns) = if turned { (&theirs, &ours) } else { (&ours, &theirs) };
        let of = |side: bool, i: usize| left[usize::from(side)][i].as_ref();
        let cost = |row: usize, column: usize| {
            let (row, column) = (of(turned, row)?, of(!turned, column)?);
            let steps = (row.middle.distance(column.middle).min(FARTHEST) * STEPS).round() as i64;
            Some((steps, row.head == column.head))
        };
        let (columns_of, tie) = nearest(rows, columns, |row, column| cost(row, column).unwrap_or_default());
        is_tie |= tie;
        for (row, column) in rows.iter().zip(columns_of) {
            let (i, j) = if turned { (columns[column], *row) } else { (*row, columns[column]) };
            let (one, other) = (left[0][i].take(), left[1][j].take());
            pairs.extend(one.zip(other).map(|(one, other)| (one.head, other.head)));
        }
    }
    is_tie
}

/// The column of each row, with the least sum of costs; among equal ones those with most equal names. Large tables are
/// not searched: each row takes the nearest column that is left, and the pairing is a tie.
fn nearest(rows: &[usize], columns: &[usize], cost: impl Fn(usize, usize) -> (i64, bool)) -> (Vec<usize>, bool) {
    if rows.len().saturating_mul(rows.len()).saturating_mul(columns.len()) > MAX_WORK {
        let mut free: BTreeSet<usize> = (0..columns.len()).collect();
        let take = |row: &usize| {
            let order = |column: usize| (cost(*row, columns[column]).0, !cost(*row, columns[column]).1);
            let near = free.iter().copied().min_by_key(|c| order(*c)).unwrap_or_default();
            free.remove(&near);
            near
        };
        return (rows.iter().map(take).collect(), true);
    }
    let table = |of: &dyn Fn((i64, bool)) -> i64| -> Vec<Vec<i64>> {
        rows.iter().map(|row| columns.iter().map(|column| of(cost(*row, *column))).collect()).collect()
    };
    let found = assign(&table(&|(steps, _)| steps));
    if !found.is_tie {
        return (found.columns, false);
    }
    let more = rows.len() as i64 + 1;
    let named = assign(&table(&|(steps, same)| steps * more - i64::from(same)));
    // Units that do not differ can take each other's place.
    let differs = rows.len() != columns.len() || table(&|(steps, _)| steps).iter().flatten().any(|steps| *steps > 0);
    (named.columns, differs)
}
