//! AprilTags of the dictionary 36h11 for rendered images: the first codes, their cells, and boards for scenes.

use glam::{DVec3, Vec3};
use presight_model::environment::{Environment, Material, Mesh, NewObject, Polygon, PolygonOrder};
use presight_model::geometry::Pose;
use std::sync::Arc;

/// The first codes of the dictionary.
const CODES: [u64; 4] = [0xd_7e00_984b, 0xd_da66_4ca7, 0xd_c4a1_c821, 0xe_17b4_70e9];

/// Column and row of each bit of a code, highest bit first, in the black square from its top left.
const BITS: [(i32, i32); 36] = [
    (1, 1),
    (2, 1),
    (3, 1),
    (4, 1),
    (5, 1),
    (2, 2),
    (3, 2),
    (4, 2),
    (3, 3),
    (6, 1),
    (6, 2),
    (6, 3),
    (6, 4),
    (6, 5),
    (5, 2),
    (5, 3),
    (5, 4),
    (4, 3),
    (6, 6),
    (5, 6),
    (4, 6),
    (3, 6),
    (2, 6),
    (5, 5),
    (4, 5),
    (3, 5),
    (4, 4),
    (1, 6),
    (1, 5),
    (1, 4),
    (1, 3),
    (1, 2),
    (2, 5),
    (2, 4),
    (2, 3),
    (3, 4),
];

/// Returns true if a cell of a tag is white. `column` and `row` count from the top left of the black square, which is 8
/// cells wide and surrounded by white cells.
pub fn is_white(tag: usize, column: i32, row: i32) -> bool {
    let outside = !(0..8).contains(&column) || !(0..8).contains(&row);
    let bit = BITS.iter().position(|bit| *bit == (column, row));
    outside || bit.is_some_and(|bit| CODES[tag] >> (35 - bit) & 1 == 1)
}

/// Adds a board with a tag whose black square is `side` metres wide. Seen from the front, x points right, y up and z
/// towards the viewer. Returns the square's corners in the world, clockwise from the top left.
pub fn add_tag(environment: &mut Environment, name: &str, tag: usize, pose: &Pose, side: f64) -> [DVec3; 4] {
    let [black, white] = [("black", 0.15), ("white", 0.9)].map(|(name, reflection)| {
        let known = environment.materials().iter().position(|m| m.name == name);
        let make = || environment.add_material(Material { reflection, ..Material::named(name) }).expect("a material");
        known.map_or_else(make, |at| at as u16)
    });
    let corner = |column: i32, row: i32| {
        let [x, y] = [column - 4, 4 - row].map(|at| side * f64::from(at) / 8.0);
        DVec3::new(x, y, 0.0)
    };
    let (mut vertices, mut cells): (Vec<Vec3>, Vec<Polygon>) = Default::default();
    for (row, column) in (-1..9).flat_map(|row| (-1..9).map(move |column| (row, column))) {
        let first = vertices.len() as u32;
        // Counter-clockwise, seen from the front.
        let around = [(column, row + 1), (column + 1, row + 1), (column + 1, row), (column, row)];
        vertices.extend(around.map(|(c, r)| corner(c, r).as_vec3()));
        let material = if is_white(tag, column, row) { white } else { black };
        cells.push(Polygon::new((first..first + 4).collect(), material));
    }
    let mesh = Mesh::new(name, vertices, cells, PolygonOrder::Given).expect("a sound mesh");
    environment.insert(NewObject::new(name, *pose, Arc::new(mesh))).expect("a new object");
    [(0, 0), (8, 0), (8, 8), (0, 8)].map(|(c, r)| pose.transform_point(corner(c, r)))
}
