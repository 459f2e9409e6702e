//! Meshes from the triangles that a program holds.

use super::{Edges, TriangleMesh, Welder, merge};
use glam::Vec3;
use presight_model::environment::{Mesh, PolygonOrder};
use presight_model::error::{Error, Result};
use presight_model::limits;
use presight_model::memory;

/// Makes a mesh of triangles over vertices, metres in the mesh's own frame, all of one material: equal vertices are
/// welded and coplanar neighbours merged, as in a scene file. Returns the mesh, and how many triangles without an area
/// were left out.
///
/// ```
/// use glam::Vec3;
/// use presight::files::mesh_of_triangles;
/// let corners = [Vec3::ZERO, Vec3::X, Vec3::new(1.0, 1.0, 0.0), Vec3::Y];
/// let (mesh, flat) = mesh_of_triangles("tile", &corners, &[[0, 1, 2], [0, 2, 3], [0, 1, 1]], 0, 1e-6)?;
/// assert_eq!((mesh.polygon_count(), flat), (1, 1));
/// assert!(mesh_of_triangles("tile", &corners, &[[0, 1, 4]], 0, 1e-6).is_err());
/// # Ok::<(), presight::Error>(())
/// ```
///
/// # Errors
/// [`presight_model::ErrorKind::Invalid`], naming the mesh: a corner without a vertex, a vertex that is not finite, no
/// triangle with an area, too many; [`presight_model::ErrorKind::System`] if the memory does not suffice.
pub fn mesh_of_triangles(
    name: &str,
    vertices: &[Vec3],
    triangles: &[[u32; 3]],
    material: u16,
    tolerance: f64,
) -> Result<(Mesh, usize)> {
    triangles_of(vertices, triangles, material).map_err(|e| e.at(format!("mesh {name:?}"))).map(|mesh| {
        let twins = Edges::of(&mesh).twins();
        let parts = merge(&mesh, twins, tolerance).parts;
        let flat = mesh.degenerate.len();
        (Mesh::from_parts(name.to_owned(), mesh.vertices, &parts, PolygonOrder::Spatial), flat)
    })
}

fn triangles_of(vertices: &[Vec3], triangles: &[[u32; 3]], material: u16) -> Result<TriangleMesh> {
    let count = triangles.len() as u64;
    if count > limits::MAX_STORED_TRIANGLES {
        let remedy = format!("the limit is {}: give several meshes", limits::MAX_STORED_TRIANGLES);
        return Err(Error::invalid(format!("it has {count} triangles"), remedy));
    }
    memory::require(memory::of_meshes(std::iter::once(count)))?;
    let in_reach = |v: &Vec3| v.is_finite() && f64::from(v.abs().max_element()) <= limits::MAX_COORDINATE;
    if let Some(i) = vertices.iter().position(|v| !in_reach(v)) {
        let what = format!("vertex {i} is {}, not a finite position", vertices[i]);
        return Err(Error::invalid(what, format!("give metres of at most {:e}", limits::MAX_COORDINATE)));
    }
    let (mut mesh, mut welder) = (TriangleMesh::default(), Welder::default());
    for (i, triangle) in triangles.iter().enumerate() {
        let mut corners = [0; 3];
        for (corner, vertex) in corners.iter_mut().zip(triangle) {
            let Some(position) = vertices.get(*vertex as usize) else {
                let what = format!("triangle {i} names vertex {vertex}, and there are {}", vertices.len());
                return Err(Error::invalid(what, "count vertices from 0"));
            };
            *corner = welder.weld(*position, &mut mesh.vertices);
        }
        mesh.push(corners, material);
    }
    if mesh.triangles.is_empty() {
        return Err(Error::invalid("it has no triangle with an area", "leave it out, or repair it"));
    }
    mesh.end_primitive();
    Ok(mesh)
}
