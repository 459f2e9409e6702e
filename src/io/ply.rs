//! PLY point clouds, binary little-endian: measured points only.

use super::atomic::write_atomically;
use super::points::{PointCloud, PointsFrame, position_bytes};
use crate::error::Result;
use std::io::{self, BufWriter, Write};
use std::path::Path;

/// Writes x, y, z and polygon_id of every measured point.
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
    let real = match cloud.frame {
        PointsFrame::Sensor => "float",
        PointsFrame::World => "double",
    };
    write!(
        out,
        "ply\nformat binary_little_endian 1.0\n\
         comment presight range image, {}\n\
         comment world_from_sensor x,y,z,qx,qy,qz,qw {}\n\
         element vertex {}\n\
         property {real} x\nproperty {real} y\nproperty {real} z\nproperty uint polygon_id\nend_header\n",
        cloud.frame_in_words(),
        super::exr::pose_to_text(&cloud.world_from_sensor),
        cloud.seen().count()
    )?;
    for (point, id) in cloud.seen() {
        out.write_all(&position_bytes(cloud.frame, point))?;
        out.write_all(&id.to_le_bytes())?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::super::points::tests::camera_view;
    use super::*;
    use crate::geometry::Pose;

    #[test]
    fn only_hits_are_written_with_their_ids() {
        let (sensor, images) = camera_view();
        for (frame, size) in [(PointsFrame::Sensor, 16), (PointsFrame::World, 28)] {
            let cloud = PointCloud::new(&images, &sensor, &Pose::IDENTITY, frame).unwrap();
            let mut bytes = Vec::new();
            write_to(&mut bytes, &cloud).unwrap();
            let end = bytes.windows(11).position(|w| w == b"end_header\n").unwrap() + 11;
            let header = std::str::from_utf8(&bytes[..end]).unwrap();
            assert!(header.contains("element vertex 4\n"), "{header}");
            let rows: Vec<&[u8]> = bytes[end..].chunks(size).collect();
            assert_eq!(rows.len(), 4);
            let ids: Vec<u32> = rows.iter().map(|r| u32::from_le_bytes(r[size - 4..].try_into().unwrap())).collect();
            assert_eq!(ids, [1, 2, 3, u32::MAX]);
        }
    }
}
