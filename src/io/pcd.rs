//! PCD point clouds, binary and organized: one point per pixel, NaN where nothing is measured.

use super::atomic::write_atomically;
use super::points::{PointCloud, PointsFrame, position_bytes};
use crate::error::Result;
use crate::geometry::Pose;
use std::io::{self, BufWriter, Write};
use std::path::Path;

/// Writes x, y, z and polygon_id of every pixel. `VIEWPOINT` transforms the points into the world: it is the sensor's pose for
/// points in the sensor frame, and the identity for points in the world.
///
/// # Errors
/// [`crate::ErrorKind::System`] if the file cannot be written.
pub fn write(path: &Path, cloud: &PointCloud) -> Result<()> {
    write_atomically(path, |file| {
        let mut out = BufWriter::new(file);
        write_to(&mut out, cloud)?;
        out.flush()
    })
}

fn write_to(out: &mut impl Write, cloud: &PointCloud) -> io::Result<()> {
    let (size, viewpoint) = match cloud.frame {
        PointsFrame::Sensor => (4, cloud.world_from_sensor),
        PointsFrame::World => (8, Pose::IDENTITY),
    };
    let (t, q) = (viewpoint.translation, viewpoint.rotation);
    write!(
        out,
        "# .PCD v0.7 - Point Cloud Data file format\n\
         # presight range image, {}\n\
         VERSION 0.7\nFIELDS x y z polygon_id\nSIZE {size} {size} {size} 4\nTYPE F F F U\nCOUNT 1 1 1 1\n\
         WIDTH {}\nHEIGHT {}\nVIEWPOINT {:?} {:?} {:?} {:?} {:?} {:?} {:?}\nPOINTS {}\nDATA binary\n",
        cloud.frame_in_words(),
        cloud.width,
        cloud.height,
        t.x,
        t.y,
        t.z,
        q.w,
        q.x,
        q.y,
        q.z,
        cloud.positions.len()
    )?;
    for (point, id) in cloud.positions.iter().zip(&cloud.polygon_id) {
        out.write_all(&position_bytes(cloud.frame, *point))?;
        out.write_all(&id.to_le_bytes())?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::super::points::tests::camera_view;
    use super::*;
    use glam::DVec3;

    #[test]
    fn every_pixel_is_written_in_order() {
        let (sensor, images) = camera_view();
        let pose = Pose::from_xyz_rpy(DVec3::new(1.0, 2.0, 3.0), 0.0, 0.0, 0.0);
        let cloud = PointCloud::new(&images, &sensor, &pose, PointsFrame::Sensor).unwrap();
        let mut bytes = Vec::new();
        write_to(&mut bytes, &cloud).unwrap();
        let end = bytes.windows(12).position(|w| w == b"DATA binary\n").unwrap() + 12;
        let header = std::str::from_utf8(&bytes[..end]).unwrap();
        assert!(header.contains("WIDTH 3\nHEIGHT 2\nVIEWPOINT 1.0 2.0 3.0 1.0 0.0 0.0 0.0\nPOINTS 6\n"), "{header}");
        let number = |i: usize| f32::from_le_bytes(bytes[end + i..end + i + 4].try_into().unwrap());
        assert_eq!(bytes.len() - end, 6 * 16);
        assert_eq!([number(16), number(20)], [2.0, 0.0]);
        assert!(number(3 * 16).is_nan());
        assert_eq!(bytes[end + 4 * 16 + 12..end + 5 * 16], u32::MAX.to_le_bytes());
    }
}
