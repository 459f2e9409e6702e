//! The fields of points in PLY and PCD files, except the position.

use glam::{DVec3, Vec3};
use presight_read::cloud::POINTS_IN_WORLD;
use presight_render::plan::Output;
use presight_render::points::{PointCloud, PointsFrame};

/// Description of a frame, for the comment in both formats.
pub fn in_words(frame: PointsFrame) -> &'static str {
    match frame {
        PointsFrame::Sensor => "sensor body axes: x forward, y left, z up; metres",
        PointsFrame::World => POINTS_IN_WORLD,
    }
}

/// The fields of each point after its position, in the order of both formats: normals, `range`, `intensity` (the echo),
/// `ring` (the row of the image), `object_id` and `polygon_id`, as far as the cloud has them.
pub fn fields<'a, 'b>(cloud: &'b PointCloud<'a>) -> Vec<Field<'a, 'b>> {
    let images = cloud.images();
    let mut fields = Vec::new();
    if !cloud.normals().is_empty() {
        fields.push(Field::Normal(cloud.normals()));
    }
    for output in [Output::Range, Output::Echo] {
        let asked = images.floats(output).filter(|_| cloud.outputs().has(output));
        fields.extend(asked.map(|image| Field::Float(output, image)));
    }
    if cloud.has_rings() {
        fields.push(Field::Ring(images.width as usize));
    }
    for output in [Output::ObjectId, Output::PolygonId] {
        let asked = images.ids(output).filter(|_| cloud.outputs().has(output));
        fields.extend(asked.map(|image| Field::Id(output, image)));
    }
    fields
}

/// A field of all points.
#[derive(Clone, Copy, Debug)]
pub enum Field<'a, 'b> {
    Normal(&'b [Vec3]),
    Float(Output, &'a [f32]),
    /// The row of the image; holds its number of columns.
    Ring(usize),
    Id(Output, &'a [u32]),
}

impl Field<'_, '_> {
    /// The conventional name of the field.
    pub fn name(&self) -> &'static str {
        match self {
            Self::Normal(_) => "normal",
            Self::Float(Output::Echo, _) => "intensity",
            Self::Ring(_) => "ring",
            Self::Float(output, _) | Self::Id(output, _) => output.name(),
        }
    }

    /// Appends the bytes of a pixel, little-endian. A ring has 4 bytes, or 2 as in PCL's scanner points.
    pub fn append(&self, pixel: usize, wide_ring: bool, bytes: &mut Vec<u8>) {
        match *self {
            Self::Normal(normals) => bytes.extend(normals[pixel].to_array().iter().flat_map(|v| v.to_le_bytes())),
            Self::Float(_, image) => bytes.extend(image[pixel].to_le_bytes()),
            Self::Ring(columns) if wide_ring => bytes.extend(((pixel / columns) as u32).to_le_bytes()),
            // An image has at most 16,384 rows.
            Self::Ring(columns) => bytes.extend(((pixel / columns) as u16).to_le_bytes()),
            Self::Id(_, image) => bytes.extend(image[pixel].to_le_bytes()),
        }
    }
}

/// Appends a position, little-endian, in f64 or f32.
pub fn append_position(p: DVec3, wide: bool, bytes: &mut Vec<u8>) {
    match wide {
        true => bytes.extend(p.to_array().iter().flat_map(|v| v.to_le_bytes())),
        false => bytes.extend(p.to_array().iter().flat_map(|v| (*v as f32).to_le_bytes())),
    }
}

#[cfg(test)]
pub mod tests {
    use glam::DVec3;
    use presight_model::geometry::SensorPose;
    use presight_model::sensor::{Camera, Geometry, Sensor, SensorSpec};
    use presight_read::cloud::read;
    use presight_render::plan::{Images, Output, Outputs};
    use presight_render::points::{PointCloud, PointsFrame};

    /// A 3 x 2 camera image with a miss and a pixel that is too near.
    pub fn camera_view() -> (Sensor, Images) {
        let geometry = Geometry::Camera(Camera::pinhole(3, 2, 2.0, 2.0, 1.0, 0.0));
        let sensor = Sensor::new(SensorSpec::new("c", "video", geometry)).unwrap();
        let mut images = Images::default();
        images.prepare(3, 2, Outputs::of(&[Output::Range, Output::PolygonId]));
        images.range.copy_from_slice(&[1.0, 2.0, 3.0, f32::INFINITY, 5.0, f32::NEG_INFINITY]);
        images.polygon_id.copy_from_slice(&[1, 2, 3, 0, u32::MAX, 6]);
        (sensor, images)
    }

    /// Clouds that presight wrote are read back, in both frames.
    #[test]
    fn written_clouds_are_read_again() {
        let (sensor, images) = camera_view();
        let pose = SensorPose::from_xyz_rpy(DVec3::new(10.0, 20.0, 3.0), 0.1, 0.2, 0.3);
        let folder = tempfile::tempdir().unwrap();
        let (ply, pcd) = (folder.path().join("a.ply"), folder.path().join("a.pcd"));
        let truth = PointCloud::new(&images, &sensor, &pose, PointsFrame::Sensor).unwrap();
        for frame in [PointsFrame::Sensor, PointsFrame::World] {
            let cloud = PointCloud::new(&images, &sensor, &pose, frame).unwrap();
            crate::ply::write(&ply, &cloud).unwrap();
            crate::pcd::write(&pcd, &cloud).unwrap();
            let there = read(&ply).unwrap();
            let seen = truth.positions().iter().filter(|p| !p.is_nan());
            assert!(there.points.iter().zip(seen).all(|(a, b)| a.distance(*b) < 1e-6));
            assert_eq!((there.points.len(), there.pose), (4, Some(pose)));
            let organized = read(&pcd);
            if frame == PointsFrame::World {
                assert!(organized.unwrap_err().to_string().contains("in the world"));
                continue;
            }
            let organized = organized.unwrap();
            assert_eq!((organized.size, organized.pose), (Some((3, 2)), Some(pose)));
            assert!(organized.points[3].is_nan() && organized.points[1].distance(DVec3::new(2.0, 0.0, 0.0)) < 1e-6);
        }
    }
}
