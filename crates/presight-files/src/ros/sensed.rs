//! Predicted images as messages of the sensor.

use super::{MessageOrigin, topic_name};
use crate::point_fields::{Field, append_position, fields};
use glam::DMat3;
use presight_model::error::{Error, Result};
use presight_model::geometry::SensorPose;
use presight_model::sensor::{Angles, Distortion, Geometry, RayTimes, Sensor, StampAt};
use presight_render::plan::{Images, Output, Outputs};
use presight_render::points::{PointCloud, PointsFrame};
use presight_ros::Record;
use presight_ros::message::{CameraInfo, Image, LaserScan, PointCloud2, PointField, Scalar};

impl MessageOrigin {
    /// The images that a sensor needs for its messages, of those that are wanted: the range of a scanner, the depth of
    /// a camera.
    pub fn outputs(sensor: &Sensor, wanted: Outputs) -> Outputs {
        wanted.with(if sensor.is_camera() { Output::DepthZ } else { Output::Range })
    }

    /// Predicted images on topics below the sensor's name: `scan` of a level scanner of one row with equal steps, and
    /// `points` of every scanner; `depth` (`depth_rect` if R turns it),
    /// `object_id`, `polygon_id` and `camera_info` of a camera. The fields of
    /// points and the images of ids are those that were predicted and are wanted.
    ///
    /// # Errors
    /// As [`PointCloud::new`]; [`presight_model::ErrorKind::Invalid`] if the depth of a camera is missing.
    pub fn prediction(&self, sensor: &Sensor, images: &Images, wanted: Outputs) -> Result<Vec<Record>> {
        let topic = |name: &str| format!("/{}/{name}", topic_name(&sensor.spec().name));
        if let Some(info) = self.camera_info(sensor) {
            let mut records = vec![Record::of(&topic("camera_info"), self.stamp_ns, &info)];
            let turned = image_from_optical(sensor) != DMat3::IDENTITY;
            records.push(self.depth_image(&topic(if turned { "depth_rect" } else { "depth" }), images)?);
            for output in [Output::ObjectId, Output::PolygonId].into_iter().filter(|output| wanted.has(*output)) {
                let ids = images.ids(output).unwrap_or_default();
                records.extend((!ids.is_empty()).then(|| self.image(&topic(output.name()), images, "32SC1", ids)));
            }
            return Ok(records);
        }
        let scan = self.laser_scan(sensor, &images.range, &images.echo);
        let scan = scan.map(|scan| Record::of(&topic("scan"), self.stamp_ns, &scan));
        let points = self.point_cloud(&topic("points"), sensor, images, wanted)?;
        Ok(scan.into_iter().chain([points]).collect())
    }

    /// Predicted images on `/presight/predicted`, as a message of the type with which the sensor measures; the points
    /// of a scan also on `/presight/predicted/points`, because some viewers draw no scans.
    ///
    /// # Errors
    /// As [`MessageOrigin::prediction`].
    pub fn predicted(&self, sensor: &Sensor, images: &Images) -> Result<Vec<Record>> {
        const TOPIC: &str = "/presight/predicted";
        if let Some(info) = self.camera_info(sensor) {
            let info = Record::of("/presight/camera_info", self.stamp_ns, &info);
            return Ok(vec![info, self.depth_image(TOPIC, images)?]);
        }
        let scan = self.laser_scan(sensor, &images.range, &[]).map(|scan| Record::of(TOPIC, self.stamp_ns, &scan));
        let topic = if scan.is_some() { "/presight/predicted/points" } else { TOPIC };
        let points = self.point_cloud(topic, sensor, images, images.outputs())?;
        Ok(scan.into_iter().chain([points]).collect())
    }

    /// Ranges as a scan; `None` if the sensor is not a level scanner of one row with equal steps. Without intensities
    /// the message has none.
    fn laser_scan(&self, sensor: &Sensor, ranges: &[f32], intensities: &[f32]) -> Option<LaserScan> {
        let Geometry::Scanner(scanner) = &sensor.spec().geometry else { return None };
        let Angles::Uniform { start_deg, step_deg, count } = scanner.azimuth else { return None };
        if scanner.elevation.len() != 1 || scanner.elevation.degrees(0) != 0.0 {
            return None;
        }
        let radians = |degrees: f64| degrees.to_radians() as f32;
        let turn_s = match sensor.spec().times {
            RayTimes::Columns { turn_s, stamp: StampAt::First } => turn_s,
            _ => 0.0,
        };
        let part = (step_deg * f64::from(count)).abs() / 360.0;
        Some(LaserScan {
            header: self.header(&self.sensor),
            angle_min: radians(start_deg),
            angle_max: radians(start_deg + step_deg * f64::from(count.saturating_sub(1))),
            angle_increment: radians(step_deg),
            time_increment: (turn_s / f64::from(count)) as f32,
            scan_time: if part > 0.0 { (turn_s.abs() / part) as f32 } else { 0.0 },
            range_min: sensor.spec().range_min as f32,
            range_max: sensor.spec().range_max as f32,
            ranges: ranges.to_vec(),
            intensities: intensities.to_vec(),
        })
    }

    /// The points of a range image, organized, with the values of other images that are wanted; NaN where the ray met
    /// nothing.
    ///
    /// # Errors
    /// As [`PointCloud::new`].
    pub fn point_cloud(&self, topic: &str, sensor: &Sensor, images: &Images, wanted: Outputs) -> Result<Record> {
        let cloud = PointCloud::new(images, sensor, &SensorPose::IDENTITY, PointsFrame::Sensor)?.only(wanted);
        // The range is the length of the point.
        let values: Vec<Field<'_, '_>> =
            fields(&cloud).into_iter().filter(|f| !matches!(f, Field::Float(Output::Range, _))).collect();
        let mut columns = vec![("x", Scalar::F32), ("y", Scalar::F32), ("z", Scalar::F32)];
        for value in &values {
            match value {
                Field::Normal(_) => columns.extend(["normal_x", "normal_y", "normal_z"].map(|n| (n, Scalar::F32))),
                Field::Float(..) => columns.push((value.name(), Scalar::F32)),
                Field::Ring(_) => columns.push((value.name(), Scalar::U16)),
                Field::Id(..) => columns.push((value.name(), Scalar::U32)),
            }
        }
        let point_step: usize = columns.iter().map(|(_, scalar)| scalar.size()).sum();
        let mut data = presight_model::memory::reserved(cloud.positions().len() * point_step)?;
        for (pixel, position) in cloud.positions().iter().enumerate() {
            append_position(*position, false, &mut data);
            values.iter().for_each(|value| value.append(pixel, false, &mut data));
        }
        Ok(self.points(topic, (images.width, images.height), &columns, &data))
    }

    /// Points with these fields, packed without gaps in the order of the fields; NaN positions may be among them.
    pub(super) fn points(
        &self,
        topic: &str,
        (width, height): (u32, u32),
        columns: &[(&str, Scalar)],
        data: &[u8],
    ) -> Record {
        let mut point_step = 0;
        let fields = columns.iter().map(|(name, scalar)| {
            let field = PointField { name: (*name).to_owned(), offset: point_step, scalar: Some(*scalar), count: 1 };
            point_step += scalar.size() as u32;
            field
        });
        let fields = fields.collect();
        let cloud = PointCloud2 {
            header: self.header(&self.sensor),
            height,
            width,
            fields,
            is_bigendian: false,
            point_step,
            row_step: point_step * width,
            data,
            is_dense: false,
        };
        Record::of(topic, self.stamp_ns, &cloud)
    }

    /// The depth along the optical axis as an image of `32FC1`, metres.
    ///
    /// # Errors
    /// [`presight_model::ErrorKind::Invalid`] if the depth is missing.
    pub fn depth_image(&self, topic: &str, images: &Images) -> Result<Record> {
        if images.depth_z.len() != images.pixels() {
            return Err(Error::invalid("the prediction has no depth", "predict the image depth_z"));
        }
        Ok(self.image(topic, images, "32FC1", &images.depth_z))
    }

    fn image<T: Copy + ToBytes>(&self, topic: &str, images: &Images, encoding: &str, values: &[T]) -> Record {
        let data: Vec<u8> = values.iter().flat_map(|value| value.to_bytes()).collect();
        let image = Image {
            header: self.header(&self.sensor),
            height: images.height,
            width: images.width,
            encoding: encoding.to_owned(),
            is_bigendian: false,
            step: images.width * size_of::<T>() as u32,
            data: &data,
        };
        Record::of(topic, self.stamp_ns, &image)
    }

    /// The calibration of a camera; `None` for another sensor. A rectified image is a camera without distortion; R
    /// turns from the optical frame to it.
    fn camera_info(&self, sensor: &Sensor) -> Option<CameraInfo> {
        let Geometry::Camera(camera) = &sensor.spec().geometry else { return None };
        let (fx, fy, cx, cy) = (camera.fx, camera.fy, camera.cx, camera.cy);
        let (model, d) = match &camera.distortion {
            Distortion::None => ("plumb_bob", vec![0.0; 5]),
            lens => (lens.model(), lens.coefficients().to_vec()),
        };
        Some(CameraInfo {
            header: self.header(&self.sensor),
            height: camera.height,
            width: camera.width,
            distortion_model: model.to_owned(),
            d,
            k: [fx, 0.0, cx, 0.0, fy, cy, 0.0, 0.0, 1.0],
            r: image_from_optical(sensor).transpose().to_cols_array(),
            p: [fx, 0.0, cx, 0.0, 0.0, fy, cy, 0.0, 0.0, 0.0, 1.0, 0.0],
            binning: [0; 2],
            roi: [0; 4],
            do_rectify: false,
        })
    }
}

/// The rotation of a rectified image; the identity for others.
fn image_from_optical(sensor: &Sensor) -> DMat3 {
    DMat3::from_quat(sensor.spec().optical_from_image.conjugate())
}

/// A number of four bytes.
trait ToBytes {
    fn to_bytes(self) -> [u8; 4];
}

impl ToBytes for f32 {
    fn to_bytes(self) -> [u8; 4] {
        self.to_le_bytes()
    }
}

impl ToBytes for u32 {
    fn to_bytes(self) -> [u8; 4] {
        self.to_le_bytes()
    }
}
