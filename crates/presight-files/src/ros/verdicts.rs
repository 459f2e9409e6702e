//! Verdicts on measured points as a cloud.

use super::MessageOrigin;
use glam::DMat3;
use presight_model::error::{Error, Result};
use presight_model::measured::Frame;
use presight_render::plan::Images;
use presight_ros::Record;
use presight_ros::message::Scalar;

impl MessageOrigin {
    /// The points of a frame on `/presight/verdict`, each with its residual (measured less predicted range, metres),
    /// the number of its verdict, the object that was predicted there, and the colour of the verdict. A point that was
    /// predicted but not measured is at its predicted place; rays with neither have no point.
    ///
    /// `residuals` and `verdicts` have one value for each pixel; `colors` has one sRGB colour for each verdict.
    ///
    /// # Errors
    /// [`presight_model::ErrorKind::Invalid`] if the images do not have the size of the frame, or a verdict has no
    /// colour.
    pub fn verdicts(
        &self,
        frame: &Frame,
        predicted: &Images,
        residuals: &[f32],
        verdicts: &[u8],
        colors: &[[u8; 3]],
    ) -> Result<Record> {
        let sensor = frame.sensor();
        let (ranges, pixels) = (frame.ranges(), frame.ranges().len());
        let sizes = [predicted.range.len(), predicted.object_id.len(), residuals.len(), verdicts.len()];
        if sizes != [pixels; 4] || verdicts.iter().any(|v| usize::from(*v) >= colors.len()) {
            let what = format!("verdicts on {pixels} pixels need four images of this size, not {sizes:?}");
            return Err(Error::invalid(what, "predict range and object_id with the sensor of the frame"));
        }
        let columns = [
            ("x", Scalar::F32),
            ("y", Scalar::F32),
            ("z", Scalar::F32),
            ("residual", Scalar::F32),
            ("verdict", Scalar::U8),
            ("object_id", Scalar::U32),
            // Packed as 0x00rrggbb in a float, as PCL and RViz read it.
            ("rgb", Scalar::F32),
        ];
        let frame_from_image = if sensor.is_camera() {
            DMat3::from_quat(sensor.spec().optical_from_image)
        } else {
            sensor.body_from_image()
        };
        let (mut data, mut count) = (Vec::new(), 0);
        for pixel in 0..pixels {
            let (column, row) = (pixel as u32 % sensor.width(), pixel as u32 / sensor.width());
            let range = [ranges[pixel], predicted.range[pixel]].into_iter().find(|r| r.is_finite() && *r > 0.0);
            let Some((range, ray)) = range.zip(sensor.ray(column, row)) else { continue };
            let point = (sensor.origin(column, row) + frame_from_image * ray * f64::from(range)).as_vec3();
            let [r, g, b] = colors[usize::from(verdicts[pixel])].map(u32::from);
            data.extend(point.to_array().iter().flat_map(|v| v.to_le_bytes()));
            data.extend(residuals[pixel].to_le_bytes());
            data.push(verdicts[pixel]);
            data.extend(predicted.object_id[pixel].to_le_bytes());
            data.extend((r << 16 | g << 8 | b).to_le_bytes());
            count += 1;
        }
        Ok(self.points("/presight/verdict", (count, 1), &columns, &data))
    }
}
