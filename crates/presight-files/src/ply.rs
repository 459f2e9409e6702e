//! PLY point clouds, binary little-endian: measured points only.

use super::point_fields::{Field, append_position, fields, in_words};
use presight_model::error::Result;
use presight_read::atomic::write_atomically;
use presight_render::points::{PointCloud, PointsFrame};
use std::io::{self, BufWriter, Write};
use std::path::Path;

/// Writes `x`, `y`, `z` and the fields of the cloud for every measured point; normals are `nx`, `ny`, `nz`. Positions
/// in the world are `double`, because `float` would lose the millimetres of UTM coordinates. Ids are `int`, which
/// Open3D reads, if all fit; otherwise they are `uint` and the function returns a notice.
///
/// # Errors
/// [`presight_model::ErrorKind::System`] if the file cannot be written.
pub fn write(path: &Path, cloud: &PointCloud<'_>) -> Result<Vec<String>> {
    let fields = fields(cloud);
    write_atomically(path, |file| {
        let mut out = BufWriter::new(file);
        write_to(&mut out, cloud, &fields)?;
        out.flush()
    })?;
    let unsigned = fields.iter().filter(|field| id_type(field) == "uint");
    let notice = |field: &Field<'_, '_>| {
        let name = field.name();
        format!("PLY: {name} has values of 2147483648 and more and is written as uint, which Open3D ignores")
    };
    Ok(unsigned.map(notice).collect())
}

/// The PLY type of an integer field.
fn id_type(field: &Field<'_, '_>) -> &'static str {
    match field {
        Field::Id(_, image) if image.iter().any(|id| *id > i32::MAX as u32) => "uint",
        _ => "int",
    }
}

fn properties(field: &Field<'_, '_>) -> String {
    match field {
        Field::Normal(_) => "property float nx\nproperty float ny\nproperty float nz\n".into(),
        Field::Float(..) => format!("property float {}\n", field.name()),
        Field::Ring(_) | Field::Id(..) => format!("property {} {}\n", id_type(field), field.name()),
    }
}

fn write_to(out: &mut impl Write, cloud: &PointCloud<'_>, fields: &[Field<'_, '_>]) -> io::Result<()> {
    let wide = cloud.frame() == PointsFrame::World;
    let real = if wide { "double" } else { "float" };
    write!(
        out,
        "ply\nformat binary_little_endian 1.0\n\
         comment presight range image, {}\n\
         comment world_from_sensor x,y,z,qx,qy,qz,qw {}\n\
         element vertex {}\n\
         property {real} x\nproperty {real} y\nproperty {real} z\n{}end_header\n",
        in_words(cloud.frame()),
        presight_read::exr::pose_to_text(&cloud.pose().world_from_sensor()),
        cloud.seen().count(),
        fields.iter().map(properties).collect::<String>()
    )?;
    let mut point = Vec::new();
    for (pixel, position) in cloud.seen() {
        point.clear();
        append_position(position, wide, &mut point);
        fields.iter().for_each(|field| field.append(pixel, true, &mut point));
        out.write_all(&point)?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::super::point_fields::tests::camera_view;
    use super::*;
    use presight_model::geometry::SensorPose;
    use presight_render::plan::{Output, Outputs};

    #[test]
    fn only_hits_are_written_with_their_ids() {
        let (sensor, images) = camera_view();
        for (frame, size) in [(PointsFrame::Sensor, 16), (PointsFrame::World, 28)] {
            let cloud = PointCloud::new(&images, &sensor, &SensorPose::IDENTITY, frame).unwrap();
            let cloud = cloud.only(Outputs::of(&[Output::PolygonId]));
            let mut bytes = Vec::new();
            write_to(&mut bytes, &cloud, &fields(&cloud)).unwrap();
            let end = bytes.windows(11).position(|w| w == b"end_header\n").unwrap() + 11;
            let header = std::str::from_utf8(&bytes[..end]).unwrap();
            assert!(header.contains("element vertex 4\n"), "{header}");
            let rows: Vec<&[u8]> = bytes[end..].chunks(size).collect();
            assert_eq!(rows.len(), 4);
            let ids: Vec<u32> = rows.iter().map(|r| u32::from_le_bytes(r[size - 4..].try_into().unwrap())).collect();
            assert_eq!(ids, [1, 2, 3, u32::MAX]);
        }
    }

    #[test]
    fn ids_are_signed_as_long_as_all_fit() {
        let (sensor, mut images) = camera_view();
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.ply");
        for (id, kind, notices) in [(i32::MAX as u32, "int", 0), (1 << 31, "uint", 1)] {
            images.polygon_id[4] = id;
            let cloud = PointCloud::new(&images, &sensor, &SensorPose::IDENTITY, PointsFrame::Sensor).unwrap();
            assert_eq!(write(&path, &cloud).unwrap().len(), notices);
            let bytes = std::fs::read(&path).unwrap();
            let header = String::from_utf8_lossy(&bytes[..500.min(bytes.len())]).into_owned();
            assert!(header.contains(&format!("\nproperty {kind} polygon_id\n")), "{header}");
        }
    }
}
