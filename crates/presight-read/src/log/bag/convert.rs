//! Messages as frames of a sensor.

use super::choice::Measured;
use crate::camera_info;
use crate::cloud::{PointTimes, ScanStamp, time_field};
use crate::log::{BagOptions, document, ray_times};
use crate::picture::Picture;
use glam::DVec3;
use presight_model::error::{Error, Result};
use presight_model::geometry::Pose;
use presight_model::limits;
use presight_model::measured::{Frame, GreyImage, Measurement, RangeGrid, range_grid};
use presight_model::sensor::{
    Angles, Geometry, RayTimes, Scanner, Sensor, SensorSpec, StampAt, body_from_optical_rotation,
};
use presight_ros::message::{CameraInfo, CompressedImage, Image, LaserScan, Message, PointCloud2, Scalar};
use std::sync::{Arc, Mutex, PoisonError};

/// Turns the messages of one topic into frames.
pub(super) struct Converter {
    pub measured: Measured,
    /// Noise, limits, class and mount that the messages do not have.
    pub given: Option<Sensor>,
    /// robot_from_sensor in body axes.
    pub mount: Pose,
    pub options: BagOptions,
    pub is_rectified: bool,
    /// The sensor of the last message, which serves again while its geometry stays the same.
    pub sensor: Option<Sensor>,
    /// Seconds from one scan to the next, where the messages do not know it.
    pub period_s: Option<f64>,
    pub notices: Arc<Mutex<Vec<String>>>,
}

impl Converter {
    pub(super) fn add_notice(&self, notice: impl Into<String>) {
        let notice = notice.into();
        let mut notices = self.notices.lock().unwrap_or_else(PoisonError::into_inner);
        if !notices.contains(&notice) {
            notices.push(notice);
        }
    }

    /// The sensor with this geometry; the last one again if it is the same.
    fn sensor(
        &mut self,
        name: &str,
        class: &str,
        geometry: Geometry,
        limits: Option<(f64, f64)>,
        times: RayTimes,
    ) -> Result<Sensor> {
        let spec = match &self.given {
            Some(given) => given.spec().clone().with_geometry(geometry),
            None => {
                let spec = SensorSpec::new(name, class, geometry);
                match limits {
                    Some((min, max)) => spec.with_limits(min, max),
                    None => spec,
                }
            }
        };
        let spec = spec.with_times(times).with_mount(self.mount);
        if let Some(sensor) = self.sensor.as_ref().filter(|s| *s.spec() == spec) {
            return Ok(sensor.clone());
        }
        let sensor = Sensor::new(spec)?;
        self.sensor = Some(sensor.clone());
        Ok(sensor)
    }

    /// The times of rays that the given sensor states, if it does.
    fn given_times(&self) -> Option<RayTimes> {
        self.given.as_ref().map(|given| given.spec().times.clone()).filter(|times| !times.is_at_once())
    }

    /// The frame of a message.
    ///
    /// # Errors
    /// [`presight_model::ErrorKind::Invalid`] if the message contradicts itself.
    pub(super) fn frame(&mut self, time: f64, data: &[u8], info: Option<&CameraInfo>) -> Result<Frame> {
        match self.measured {
            Measured::Scan => self.scan(time, LaserScan::decode(data)?),
            Measured::Points => self.points(time, &PointCloud2::decode(data)?),
            Measured::Depth | Measured::Grey => {
                let image = Image::decode(data)?;
                let measurement = measurement_of(&image)?;
                self.image(time, (image.width, image.height), measurement, info)
            }
            Measured::CompressedDepth => {
                let image = CompressedImage::decode(data)?;
                let (size, depth) = compressed_depth(&image)?;
                self.image(time, size, Measurement::DepthZ(depth), info)
            }
        }
    }

    fn scan(&mut self, time: f64, scan: LaserScan) -> Result<Frame> {
        let azimuth = azimuths(&scan)?;
        let elevation = Angles::Uniform { start_deg: 0.0, step_deg: 0.0, count: 1 };
        let geometry = Geometry::Scanner(Scanner { azimuth, elevation, beam_height_deg: None });
        let own = RayTimes::turning(self.turn_of(&scan), StampAt::First);
        let times = self.given_times().unwrap_or(own);
        if scan.range_min.is_nan() || scan.range_max.is_nan() {
            let what = format!("range_min is {}, range_max is {}", scan.range_min, scan.range_max);
            return Err(Error::invalid(what, "the driver must state the limits of its ranges, or 0 for both"));
        }
        let limits = (f64::from(scan.range_min.max(0.0)), f64::from(scan.range_max));
        let limits = (limits.1 > limits.0).then_some(limits);
        let sensor = self.sensor(&scan.header.frame_id, "laser", geometry, limits, times)?;
        let beams = scan.ranges.len();
        let frame = Frame::new(time, sensor, Measurement::Range(scan.ranges))?;
        if scan.intensities.is_empty() {
            return Ok(frame);
        }
        if scan.intensities.len() != beams {
            let what = format!("{} intensities for {beams} ranges", scan.intensities.len());
            return Err(Error::invalid(what, "the driver must give one for each ray, or none"));
        }
        match self.options.reflector {
            Some(full) => {
                let values = scan.intensities.iter().map(|i| (i / full).clamp(0.0, 1.0)).collect();
                frame.with_intensities(GreyImage::new(beams as u32, 1, values)?)
            }
            None => {
                self.add_notice(
                    "intensities are not read; `BagOptions::reflector` is the intensity of a full reflector",
                );
                Ok(frame)
            }
        }
    }

    /// The time that a whole scan takes; 0 if the driver does not know it, or gives an impossible one.
    fn turn_of(&mut self, scan: &LaserScan) -> f64 {
        let beams = scan.ranges.len() as f64;
        let turn_s = f64::from(scan.time_increment) * beams;
        if turn_s == 0.0 || !turn_s.is_finite() {
            return 0.0;
        }
        let part = (f64::from(scan.angle_increment) * beams).abs() / std::f64::consts::TAU;
        let scan_time = f64::from(scan.scan_time);
        let period = if scan_time > 0.0 { Some(scan_time) } else { self.period_s };
        let Some(expected) = period.map(|period| part * period) else { return turn_s };
        if (turn_s - expected).abs() <= MAX_TURN_DEVIATION * expected {
            return turn_s;
        }
        self.add_notice(format!(
            "time_increment is left out: {beams} beams would take {turn_s:.3} s, but their part of a revolution takes \
             {expected:.3} s; state turn_s in the sensor if the scanner turns while the robot moves"
        ));
        0.0
    }

    fn points(&mut self, time: f64, cloud: &PointCloud2<'_>) -> Result<Frame> {
        let missing =
            |name: &str| Error::invalid(format!("the points have no field {name}"), "record a topic with x, y and z");
        let values = |name: &str| cloud.values(name)?.ok_or_else(|| missing(name));
        let points = values("x")?.zip(values("y")?).zip(values("z")?).map(|((x, y), z)| {
            let p = DVec3::new(x, y, z);
            // Drivers write 0, 0, 0 or NaN where a ray met nothing.
            if p.is_finite() { p } else { DVec3::ZERO }
        });
        let points: Vec<DVec3> = points.collect();
        let size = (cloud.height > 1).then_some((cloud.width, cloud.height));
        let grid = range_grid(&points, size)?;
        let own = self.times_of(time, cloud, &points)?.map(|seconds| grid.spread(&seconds));
        let RangeGrid { table, ranges, .. } = grid;
        let given = self.given.as_ref().map(Sensor::spec);
        let (times, notice) = ray_times::of_cloud(own, given, (table.width(), table.height()), size.is_some())?;
        notice.into_iter().for_each(|notice| self.add_notice(notice));
        let sensor = self.sensor(&cloud.header.frame_id, "laser", Geometry::Rays(table), None, times)?;
        Frame::new(time, sensor, Measurement::Range(ranges))
    }

    /// Seconds after the stamp of each point, if the message has times.
    fn times_of(&self, stamp: f64, cloud: &PointCloud2<'_>, points: &[DVec3]) -> Result<Option<Vec<f32>>> {
        let Some(at) = time_field(cloud.fields.iter().map(|f| f.name.as_str())) else { return Ok(None) };
        let field = &cloud.fields[at];
        let Some(values) = cloud.values(&field.name)? else { return Ok(None) };
        let is_whole = !matches!(field.scalar, Some(Scalar::F32 | Scalar::F64));
        let times = PointTimes { field: field.name.clone(), values: values.collect(), is_whole };
        let taken = times.after(ScanStamp::Known(stamp), self.period_s, |i| points[i] != DVec3::ZERO)?;
        taken.notices.into_iter().for_each(|notice| self.add_notice(notice));
        Ok(taken.seconds)
    }

    fn image(
        &mut self,
        time: f64,
        size: (u32, u32),
        measurement: Measurement,
        info: Option<&CameraInfo>,
    ) -> Result<Frame> {
        let Some(info) = info else {
            return Err(Error::invalid("no CameraInfo came before this image", "record the CameraInfo of the camera"));
        };
        let (spec, notices) = camera_info::of_message(info, self.is_rectified)?;
        notices.into_iter().for_each(|notice| self.add_notice(notice));
        let class = if self.measured == Measured::Grey { "video" } else { "laser" };
        let sensor =
            self.sensor(&info.header.frame_id, class, spec.geometry, None, self.given_times().unwrap_or_default())?;
        if (sensor.width(), sensor.height()) != size {
            let what = format!(
                "{} x {} pixels, but its CameraInfo has {} x {}",
                size.0,
                size.1,
                sensor.width(),
                sensor.height()
            );
            return Err(Error::invalid(what, "record the CameraInfo of this image"));
        }
        Frame::new(time, sensor, measurement)
    }
}

/// Drivers state the turn of a scanner only roughly; a deviation above this is a wrong unit or a factor forgotten.
const MAX_TURN_DEVIATION: f64 = 0.2;

/// The angles of the beams, in degrees.
///
/// # Errors
/// [`presight_model::ErrorKind::Invalid`] if there is no beam, the increment is 0 or not finite, or the number of
/// ranges does not fit the angles by more than one beam.
fn azimuths(scan: &LaserScan) -> Result<Angles> {
    let count = scan.ranges.len();
    let (min, max, step) = (f64::from(scan.angle_min), f64::from(scan.angle_max), f64::from(scan.angle_increment));
    let wrong = |what: String| Error::invalid(what, "the driver must fill angles and ranges; record the topic again");
    if count == 0 {
        return Err(wrong("the scan has no ranges".into()));
    }
    if !(step.is_finite() && min.is_finite() && step != 0.0) {
        return Err(wrong(format!("angle_increment is {step} and angle_min is {min}")));
    }
    let intervals = (count - 1) as f64;
    let off = (min + step * intervals - max) / step;
    if !(off.abs() <= 1.5) {
        return Err(wrong(format!("{count} ranges do not fit the angles from {min} to {max} in steps of {step}")));
    }
    // Rounded to f32 the step is less precise than both ends.
    if off.abs() < 0.5 && count > 1 {
        return Ok(document::azimuths(min, max, count as u32, true));
    }
    let (start_deg, step_deg) = (document::round_degrees(min), step.to_degrees());
    Ok(Angles::Uniform { start_deg, step_deg, count: count as u32 })
}

/// Depth in metres along the optical axis, or brightness.
fn measurement_of(image: &Image<'_>) -> Result<Measurement> {
    let order16 = if image.is_bigendian { u16::from_be_bytes } else { u16::from_le_bytes };
    let order32 = if image.is_bigendian { f32::from_be_bytes } else { f32::from_le_bytes };
    let grey = |values: Vec<f32>| Ok(Measurement::Grey(GreyImage::new(image.width, image.height, values)?));
    match image.encoding.as_str() {
        "32FC1" => Ok(Measurement::DepthZ(image.rows::<4>()?.flatten().map(|bytes| order32(*bytes)).collect())),
        "16UC1" => {
            Ok(Measurement::DepthZ(image.rows::<2>()?.flatten().map(|bytes| millimetres(order16(*bytes))).collect()))
        }
        "mono16" => grey(image.rows::<2>()?.flatten().map(|b| f32::from(order16(*b)) / f32::from(u16::MAX)).collect()),
        "mono8" | "8UC1" => grey(image.rows::<1>()?.flatten().map(|[b]| f32::from(*b) / f32::from(u8::MAX)).collect()),
        other => Err(Error::invalid(format!("the encoding changed to {other}"), "record one encoding in a topic")),
    }
}

/// REP-118: millimetres, 0 where there is no depth. Some cameras write the largest number there.
fn millimetres(value: u16) -> f32 {
    if value == u16::MAX { f32::NAN } else { f32::from(value) / 1000.0 }
}

/// Size and depth in metres of an image of `compressedDepth`: 12 bytes (format and two parameters), then a PNG of 16
/// bits. Depth as f32 is stored inverse and quantized: z = a / (value - b).
fn compressed_depth(image: &CompressedImage<'_>) -> Result<((u32, u32), Vec<f32>)> {
    let wrong = |what: String| Error::invalid(what, "record the topic without compression");
    if image.format.contains("rvl") {
        return Err(wrong("compressedDepth in RVL is not supported".into()));
    }
    // Some drivers write the PNG without the 12 bytes.
    const PNG: &[u8] = b"\x89PNG";
    let (head, png) = if image.data.starts_with(PNG) {
        (&[][..], image.data)
    } else {
        image.data.split_at_checked(12).unwrap_or_default()
    };
    let mut size = (0, 0);
    let picture = Picture::read(std::io::Cursor::new(png), |(width, height)| {
        size = (width, height);
        let pixels = u64::from(width) * u64::from(height);
        if pixels <= limits::MAX_PIXELS { Ok(()) } else { Err(wrong(format!("{width} x {height} pixels"))) }
    })?;
    let values = picture.into_grey16()?;
    if !image.format.starts_with("32FC1") {
        return Ok((size, values.into_iter().map(millimetres).collect()));
    }
    let Some(head) = head.get(4..12) else { return Err(wrong("the 12 bytes before the PNG are missing".into())) };
    let parameter = |at: usize| f32::from_le_bytes(head[at..at + 4].try_into().expect("four bytes"));
    let (a, b) = (parameter(0), parameter(4));
    let metres = |value: u16| if value == 0 { f32::NAN } else { a / (f32::from(value) - b) };
    Ok((size, values.into_iter().map(metres).collect()))
}

/// robot_from_sensor in body axes from base_from_frame: images have optical frames (REP-103).
pub(super) fn body_mount(base_from_frame: Pose, measured: Measured) -> Pose {
    match measured {
        Measured::Scan | Measured::Points => base_from_frame,
        Measured::Depth | Measured::CompressedDepth | Measured::Grey => {
            let body_from_optical = Pose { translation: DVec3::ZERO, rotation: body_from_optical_rotation() };
            base_from_frame * body_from_optical.inverse()
        }
    }
}
