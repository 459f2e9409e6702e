//! Meshes as blobs, little-endian:
//!
//! | bytes | what |
//! |---|---|
//! | 16 | u32 V vertices, P polygons, C corners, and 1 if polygons lie in spatial order, 0 if as they were given |
//! | 24 V | positions x, y, z in f64, metres, mesh frame; each is the f32 that the model has |
//! | 32 P | planes of the polygons, f64: unit normal x, y, z, and its product with the points of the plane, metres |
//! | 12 P | per polygon: u32 number of corners, number of its material in `materials`, number of its first source triangle |
//! | 4 C | corners of all polygons, one polygon after the other: u32 number of the vertex |
//!
//! Planes follow from positions; they are kept because computing them takes longer than all else when a store is opened.

use super::schema::damaged;
use crate::environment::{Mesh, PolygonOrder, PolygonRecord};
use crate::error::Result;
use crate::geometry::Plane;
use glam::DVec3;

pub(super) fn encode(mesh: &Mesh) -> Vec<u8> {
    let corners = mesh.all_corners();
    let size = 16 + 24 * mesh.vertices().len() + 44 * mesh.polygon_count() + 4 * corners.len();
    let mut bytes = Vec::with_capacity(size);
    let spatial = u32::from(mesh.order() == PolygonOrder::Spatial);
    // Below the limits, which fit.
    let counts = [mesh.vertices().len() as u32, mesh.polygon_count() as u32, corners.len() as u32, spatial];
    counts.iter().for_each(|x| bytes.extend_from_slice(&x.to_le_bytes()));
    for v in mesh.vertices() {
        v.to_array().iter().for_each(|x| bytes.extend_from_slice(&f64::from(*x).to_le_bytes()));
    }
    for plane in mesh.planes() {
        let row = [plane.normal.x, plane.normal.y, plane.normal.z, plane.offset];
        row.iter().for_each(|x| bytes.extend_from_slice(&x.to_le_bytes()));
    }
    for r in mesh.polygons() {
        let row = [u32::from(r.corner_count), u32::from(r.material), r.source];
        row.iter().for_each(|x| bytes.extend_from_slice(&x.to_le_bytes()));
    }
    corners.iter().for_each(|x| bytes.extend_from_slice(&x.to_le_bytes()));
    bytes
}

/// The mesh of a blob, whose hash need not be proven yet; `materials` is how many there are.
pub(super) fn decode(name: &str, bytes: &[u8], materials: usize) -> Result<Mesh> {
    let wrong = || damaged(format!("the blob of mesh {name:?} does not hold what it claims"));
    let (words, _) = bytes.as_chunks::<4>();
    let word = |w: &[u8; 4]| u32::from_le_bytes(*w);
    let [v, p, c, spatial] = words.get(..4).ok_or_else(wrong)? else { return Err(wrong()) };
    let [v, p, c, spatial] = [v, p, c, spatial].map(word);
    if bytes.len() as u64 != 16 + 24 * u64::from(v) + 44 * u64::from(p) + 4 * u64::from(c) {
        return Err(wrong());
    }
    let (positions, rest) = bytes[16..].split_at(24 * v as usize);
    let (planes, rest) = rest.split_at(32 * p as usize);
    let (records, corners) = rest.split_at(12 * p as usize);
    let float = |eight: &[u8; 8]| f64::from_le_bytes(*eight);
    let numbers = |bytes: &[u8; 24]| [0, 1, 2].map(|i| float(&bytes.as_chunks::<8>().0[i]));
    let vertices = positions.as_chunks::<24>().0.iter().map(|p| DVec3::from_array(numbers(p)).as_vec3()).collect();
    let plane = |bytes: &[u8; 32]| {
        let [x, y, z, offset] = [0, 1, 2, 3].map(|i| float(&bytes.as_chunks::<8>().0[i]));
        Plane { normal: DVec3::new(x, y, z), offset }
    };
    let planes = planes.as_chunks::<32>().0.iter().map(plane).collect();
    let corners: Vec<u32> = corners.as_chunks::<4>().0.iter().map(word).collect();
    let mut first_corner = 0;
    let mut all = Vec::with_capacity(p as usize);
    for record in records.as_chunks::<12>().0 {
        let (three, _) = record.as_chunks::<4>();
        let (count, material, source) = (word(&three[0]), word(&three[1]), word(&three[2]));
        let corner_count = u8::try_from(count).map_err(|_| wrong())?;
        let material = u16::try_from(material).ok().filter(|m| usize::from(*m) < materials).ok_or_else(wrong)?;
        all.push(PolygonRecord { first_corner, source, material, corner_count });
        first_corner = first_corner.checked_add(count).ok_or_else(wrong)?;
    }
    let order = if spatial == 1 { PolygonOrder::Spatial } else { PolygonOrder::Given };
    Mesh::restored(name.to_owned(), vertices, corners, all, Some(planes), order)
        .map_err(|e| e.at(format!("mesh {name:?}")))
}
