//! PCD point clouds, binary and organized: one point per pixel, NaN for a pixel without a measurement.

use super::point_fields::{Field, append_position, fields, in_words};
use presight_model::error::Result;
use presight_model::geometry::Pose;
use presight_read::atomic::write_atomically;
use presight_render::points::{PointCloud, PointsFrame};
use std::io::{self, BufWriter, Write};
use std::path::Path;

/// Distance from the origin, metres, from which an f32 coordinate may be off by half a millimetre.
const FAR: f64 = 8192.0;

/// Writes `x`, `y`, `z` and the fields of the cloud for every pixel; normals are `normal_x`, `normal_y`, `normal_z`.
/// `VIEWPOINT` transforms the points into the world: it is the sensor's pose for points in the sensor frame, and the
/// identity for points in the world.
///
/// Coordinates take 4 bytes, as PCL and Open3D expect. If a point in the world is too far from the origin for
/// millimetres, they take 8 bytes and the function returns a notice.
///
/// # Errors
/// [`presight_model::ErrorKind::System`] if the file cannot be written.
pub fn write(path: &Path, cloud: &PointCloud<'_>) -> Result<Vec<String>> {
    write_atomically(path, |file| {
        let mut out = BufWriter::new(file);
        write_to(&mut out, cloud)?;
        out.flush()
    })?;
    let notice = || {
        format!(
            "PCD: x, y and z are written as 8 bytes because points are {FAR} m or more from the origin; PCL and Open3D \
             read only 4 bytes: write PLY, or points in the sensor's frame"
        )
    };
    Ok(is_wide(cloud).then(notice).into_iter().collect())
}

fn is_wide(cloud: &PointCloud<'_>) -> bool {
    cloud.frame() == PointsFrame::World && cloud.seen().any(|(_, p)| p.abs().max_element() >= FAR)
}

/// The lines FIELDS, SIZE, TYPE and COUNT.
fn header(fields: &[Field<'_, '_>], size: u32) -> String {
    let mut columns = vec![("x", size, 'F'), ("y", size, 'F'), ("z", size, 'F')];
    for field in fields {
        match field {
            Field::Normal(_) => columns.extend(["normal_x", "normal_y", "normal_z"].map(|name| (name, 4, 'F'))),
            Field::Float(..) => columns.push((field.name(), 4, 'F')),
            Field::Ring(_) => columns.push((field.name(), 2, 'U')),
            Field::Id(..) => columns.push((field.name(), 4, 'U')),
        }
    }
    let line = |key: &str, word: &dyn Fn(&(&str, u32, char)) -> String| {
        format!("{key} {}\n", columns.iter().map(word).collect::<Vec<_>>().join(" "))
    };
    [
        line("FIELDS", &|c| c.0.to_owned()),
        line("SIZE", &|c| c.1.to_string()),
        line("TYPE", &|c| c.2.to_string()),
        line("COUNT", &|_| "1".to_owned()),
    ]
    .concat()
}

fn write_to(out: &mut impl Write, cloud: &PointCloud<'_>) -> io::Result<()> {
    let (fields, wide) = (fields(cloud), is_wide(cloud));
    let viewpoint = match cloud.frame() {
        PointsFrame::Sensor => cloud.pose().world_from_sensor(),
        PointsFrame::World => Pose::IDENTITY,
    };
    let (t, q) = (viewpoint.translation, viewpoint.rotation);
    let (width, height) = (cloud.images().width, cloud.images().height);
    write!(
        out,
        "# .PCD v0.7 - Point Cloud Data file format\n\
         # presight range image, {}\n\
         VERSION 0.7\n{}WIDTH {width}\nHEIGHT {height}\n\
         VIEWPOINT {:?} {:?} {:?} {:?} {:?} {:?} {:?}\nPOINTS {}\nDATA binary\n",
        in_words(cloud.frame()),
        header(&fields, if wide { 8 } else { 4 }),
        t.x,
        t.y,
        t.z,
        q.w,
        q.x,
        q.y,
        q.z,
        cloud.positions().len()
    )?;
    let mut point = Vec::new();
    for (pixel, position) in cloud.positions().iter().enumerate() {
        point.clear();
        append_position(*position, wide, &mut point);
        fields.iter().for_each(|field| field.append(pixel, false, &mut point));
        out.write_all(&point)?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::super::point_fields::tests::camera_view;
    use super::*;
    use glam::DVec3;
    use presight_model::geometry::SensorPose;
    use presight_render::plan::{Output, Outputs};

    #[test]
    fn every_pixel_is_written_in_order() {
        let (sensor, images) = camera_view();
        let pose = Pose::from_xyz_rpy(DVec3::new(1.0, 2.0, 3.0), 0.0, 0.0, 0.0);
        let cloud = PointCloud::new(&images, &sensor, &SensorPose::new(pose), PointsFrame::Sensor).unwrap();
        let cloud = cloud.only(Outputs::of(&[Output::PolygonId]));
        let mut bytes = Vec::new();
        write_to(&mut bytes, &cloud).unwrap();
        let end = bytes.windows(12).position(|w| w == b"DATA binary\n").unwrap() + 12;
        let header = std::str::from_utf8(&bytes[..end]).unwrap();
        assert!(header.contains("FIELDS x y z polygon_id\nSIZE 4 4 4 4\nTYPE F F F U\nCOUNT 1 1 1 1\n"), "{header}");
        assert!(header.contains("WIDTH 3\nHEIGHT 2\nVIEWPOINT 1.0 2.0 3.0 1.0 0.0 0.0 0.0\nPOINTS 6\n"), "{header}");
        let number = |i: usize| f32::from_le_bytes(bytes[end + i..end + i + 4].try_into().unwrap());
        assert_eq!(bytes.len() - end, 6 * 16);
        assert_eq!([number(16), number(20)], [2.0, 0.0]);
        assert!(number(3 * 16).is_nan());
        assert_eq!(bytes[end + 4 * 16 + 12..end + 5 * 16], u32::MAX.to_le_bytes());
    }

    #[test]
    fn coordinates_are_wide_only_where_narrow_ones_lose_the_millimetre() {
        let (sensor, images) = camera_view();
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.pcd");
        for (x, frame, size) in
            [(8000.0, PointsFrame::World, 4), (9000.0, PointsFrame::Sensor, 4), (9000.0, PointsFrame::World, 8)]
        {
            let pose = Pose::from_xyz_rpy(DVec3::new(x, 0.0, 0.0), 0.0, 0.0, 0.0);
            let cloud = PointCloud::new(&images, &sensor, &SensorPose::new(pose), frame).unwrap();
            assert_eq!(write(&path, &cloud).unwrap().len(), usize::from(size == 8));
            let header = std::fs::read(&path).unwrap();
            let sizes = format!("\nSIZE {size} {size} {size} 4 4\n");
            assert!(String::from_utf8_lossy(&header).contains(&sizes), "{x} {frame:?}");
        }
    }
}
