//! Frames measured by a sensor, in the pixels of its own image.
//!
//! A [`Frame`] has the pixel order, the frames and the special values of a prediction, so that the two can be compared
//! pixel by pixel. Values follow REP-117: `-inf` means too near, `+inf` nothing within reach, NaN no measurement.

mod deskew;
mod grey;
mod motion;
mod noise;
mod poses;
mod range_grid;
mod trajectory;

pub use deskew::FrameAtMoment;
pub use grey::GreyImage;
pub use motion::{MAX_POSE_GAP_S, ScanMotion};
pub use noise::RangeNoise;
pub use poses::ScanPoses;
pub use range_grid::{RangeGrid, range_grid};
pub use trajectory::Trajectory;

use crate::error::{Error, Result};
use crate::geometry::{InRobot, Pose, PoseCovariance};
use crate::plausible;
use crate::sensor::{Angles, Camera, Geometry, RayTable, RayTimes, Scanner, Sensor, SensorSpec};

/// The values that a sensor measured, row by row.
#[derive(Clone, Debug, PartialEq)]
pub enum Measurement {
    /// Metres along each ray.
    Range(Vec<f32>),
    /// Metres along the optical axis of a camera (REP-118).
    DepthZ(Vec<f32>),
    /// Brightness, 0 black and 1 white.
    Grey(GreyImage),
}

impl Measurement {
    /// The values, row by row.
    pub fn values(&self) -> &[f32] {
        match self {
            Self::Range(values) | Self::DepthZ(values) => values,
            Self::Grey(image) => image.values(),
        }
    }
}

/// The robot's motion since the previous frame, from odometry.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Motion {
    /// The current pose of the robot, in its previous frame.
    pub previous_from_current: Pose,
    /// Its covariance, along the axes of the robot's previous frame.
    pub covariance: PoseCovariance<InRobot>,
}

crate::options! {
    /// Errors of odometry, one standard deviation: parts proportional to distance and turn, and a constant part.
    ///
    /// Default: slipping wheels, typical of robots without a calibration.
    #[derive(Clone, Copy, Debug, PartialEq)]
    pub struct OdometryNoise {
        /// Metres along each axis per metre driven.
        distance: f64 = 0.1, with_distance;
        /// Radians per radian turned.
        turn: f64 = 0.1, with_turn;
        /// Radians per metre driven.
        turn_per_distance: f64 = 0.05, with_turn_per_distance;
        /// Constant part, metres.
        constant: f64 = 0.01, with_constant;
        /// Constant part, radians.
        constant_turn: f64 = 0.005, with_constant_turn;
    }
}

impl Motion {
    /// A motion from odometry that does not report its accuracy.
    ///
    /// # Examples
    /// ```
    /// use presight::Pose;
    /// use presight::measured::{Motion, OdometryNoise};
    /// let ahead = Pose::from_xyz_rpy(glam::DVec3::X, 0.0, 0.0, 0.0);
    /// let motion = Motion::of_odometry(ahead, &OdometryNoise::default().with_distance(0.1).with_constant(0.02));
    /// assert!((motion.covariance[0][0].sqrt() - 0.12).abs() < 1e-12); // 10 cm of 1 m, and 2 cm
    /// ```
    pub fn of_odometry(previous_from_current: Pose, noise: &OdometryNoise) -> Self {
        let distance = previous_from_current.translation.length();
        let turn = previous_from_current.rotation.angle_between(glam::DQuat::IDENTITY);
        let metres = noise.distance * distance + noise.constant;
        let radians = noise.turn * turn + noise.turn_per_distance * distance + noise.constant_turn;
        let sigmas = [metres, metres, metres, radians, radians, radians];
        Self { previous_from_current, covariance: PoseCovariance::from_sigmas(sigmas) }
    }
}

/// One measurement of one sensor.
///
/// # Examples
/// ```
/// use presight::measured::{Frame, Measurement};
/// let scanner = presight::preset("laser-scanner")?; // 361 beams
/// let frame = Frame::new(0.0, scanner.clone(), Measurement::Range(vec![2.0; 361]))?;
/// assert_eq!(frame.ranges()[180], 2.0);
/// // The sensor's image has another size:
/// assert!(Frame::new(0.0, scanner, Measurement::Range(vec![2.0; 360])).is_err());
/// # Ok::<(), presight::Error>(())
/// ```
#[derive(Clone, Debug)]
pub struct Frame {
    /// Seconds, on the log's own clock.
    pub stamp: f64,
    /// Motion since the previous frame; `None` if unknown.
    pub motion: Option<Motion>,
    sensor: Sensor,
    measurement: Measurement,
    ranges: Vec<f32>,
    intensities: Option<GreyImage>,
    scan_motion: Option<ScanMotion>,
    deskewed_by: Option<f64>,
}

impl Frame {
    /// Makes a frame of measured values. A distance of 0, and a finite one outside of the sensor's limits, is no
    /// measurement.
    ///
    /// # Errors
    /// [`crate::ErrorKind::Invalid`] if there is not one value for each pixel of the sensor, if the stamp is not
    /// finite or not in seconds, or if depth is given for a sensor that is not a camera.
    pub fn new(stamp: f64, sensor: Sensor, measurement: Measurement) -> Result<Self> {
        let (width, height) = (sensor.width() as usize, sensor.height() as usize);
        let values = measurement.values();
        plausible::check_stamp(stamp)?;
        if let Measurement::Grey(image) = &measurement {
            return Self::of_grey(stamp, sensor, image.clone());
        }
        if values.len() != width * height {
            return Err(Error::invalid(
                format!("{} measured values for a sensor of {width} x {height} pixels", values.len()),
                "give one value per pixel, or the sensor that measured them",
            ));
        }
        let mut ranges = match &measurement {
            Measurement::Range(values) => values.clone(),
            Measurement::DepthZ(values) => ranges_of_depth(&sensor, values)?,
            Measurement::Grey(_) => Vec::new(),
        };
        // Limits are rounded to f32 like the ranges, because they need not be exact in f32.
        let limits = sensor.spec().range_min as f32..=sensor.spec().range_max as f32;
        let is_none = |r: f32| r == 0.0 || r.is_finite() && !limits.contains(&r);
        ranges.iter_mut().filter(|r| is_none(**r)).for_each(|r| *r = f32::NAN);
        Ok(Self::of(stamp, sensor, measurement, ranges))
    }

    /// Adds the echo intensity of each pixel: 1 is as bright as a retro-reflector, NaN means no echo.
    ///
    /// # Examples
    /// ```
    /// use presight::measured::{Frame, GreyImage, Measurement};
    /// let scanner = presight::preset("laser-scanner")?;
    /// let frame = Frame::new(0.0, scanner, Measurement::Range(vec![2.0; 361]))?;
    /// let bright = (0..361).map(|i| if i == 180 { 1.0 } else { 0.2 });
    /// let frame = frame.with_intensities(GreyImage::new(361, 1, bright.collect())?)?;
    /// assert_eq!(frame.intensities().unwrap().values()[180], 1.0);
    /// # Ok::<(), presight::Error>(())
    /// ```
    ///
    /// # Errors
    /// [`crate::ErrorKind::Invalid`] for an image of another size, a value outside 0 to 1, or a frame without ranges.
    pub fn with_intensities(self, intensities: GreyImage) -> Result<Self> {
        let (width, height) = (self.sensor.width(), self.sensor.height());
        if self.grey().is_some() {
            return Err(Error::invalid("intensities for a grey image", "give intensities with ranges only"));
        }
        if (intensities.width(), intensities.height()) != (width, height) {
            let size = format!("{} x {}", intensities.width(), intensities.height());
            let what = format!("intensities of {size} pixels for a sensor of {width} x {height}");
            return Err(Error::invalid(what, "give one value per pixel, NaN for none"));
        }
        check_intensities(intensities.values())?;
        Ok(Self { intensities: Some(intensities), ..self })
    }

    fn of(stamp: f64, sensor: Sensor, measurement: Measurement, ranges: Vec<f32>) -> Self {
        let (motion, intensities, scan_motion, deskewed_by) = (None, None, None, None);
        Self { stamp, motion, sensor, measurement, ranges, intensities, scan_motion, deskewed_by }
    }

    /// Adds the motion of the robot while the rays were measured, at the times of [`SensorSpec::times`].
    #[must_use]
    pub fn with_scan_motion(self, motion: ScanMotion) -> Self {
        Self { scan_motion: Some(motion), ..self }
    }

    /// The motion of the robot while the rays were measured; `None` if unknown.
    pub fn scan_motion(&self) -> Option<&ScanMotion> {
        self.scan_motion.as_ref()
    }

    /// Seconds from the stamp of the scan to the moment to which its points were moved ([`Frame::deskewed`]); `None` if
    /// they were not.
    pub fn deskewed_by(&self) -> Option<f64> {
        self.deskewed_by
    }

    fn of_grey(stamp: f64, sensor: Sensor, image: GreyImage) -> Result<Self> {
        let (width, height) = (sensor.width(), sensor.height());
        if (image.width(), image.height()) != (width, height) {
            let what = format!(
                "a grey image of {} x {} pixels for a sensor of {width} x {height}",
                image.width(),
                image.height()
            );
            return Err(Error::invalid(what, "give the sensor that measured it"));
        }
        // A grey image has no ranges.
        let ranges = vec![f32::NAN; image.values().len()];
        let measurement = Measurement::Grey(image);
        Ok(Self::of(stamp, sensor, measurement, ranges))
    }

    /// The sensor that measured.
    pub fn sensor(&self) -> &Sensor {
        &self.sensor
    }

    /// The measured values as they were given.
    pub fn measurement(&self) -> &Measurement {
        &self.measurement
    }

    /// The grey image; `None` if distances were measured.
    pub fn grey(&self) -> Option<&GreyImage> {
        match &self.measurement {
            Measurement::Grey(image) => Some(image),
            _ => None,
        }
    }

    /// The echo intensity of each pixel; `None` if the sensor does not report it.
    pub fn intensities(&self) -> Option<&GreyImage> {
        self.intensities.as_ref()
    }

    /// Metres along each ray, row by row, for any measurement. A 0 and a finite value outside of the sensor's limits
    /// are NaN here; a grey image has only NaN.
    pub fn ranges(&self) -> &[f32] {
        &self.ranges
    }

    /// Every `stride`-th column and row, as a frame of its own sensor, in which each pixel keeps its ray and its value.
    /// Sides shorter than the stride keep one pixel.
    ///
    /// # Errors
    /// [`crate::ErrorKind::Usage`] for a stride of 0.
    pub fn thinned(&self, stride: u32) -> Result<Self> {
        if stride == 0 {
            return Err(Error::usage("a stride of 0", "give 1 for every pixel"));
        }
        let (width, height) = (self.sensor.width(), self.sensor.height());
        let (columns, rows) = (PixelStride::of(width, stride), PixelStride::of(height, stride));
        let spec = thinned_spec(self.sensor.spec(), columns, rows)?;
        let pick = |values: &[f32]| {
            let row = |r: u32| (0..columns.count).map(move |c| (columns.at(c), r));
            let pixels = (0..rows.count).flat_map(|r| row(rows.at(r)));
            pixels.map(|(c, r)| values[r as usize * width as usize + c as usize]).collect::<Vec<f32>>()
        };
        let pick_image = |image: &GreyImage| GreyImage::new(columns.count, rows.count, pick(image.values()));
        let measurement = match &self.measurement {
            Measurement::Range(values) => Measurement::Range(pick(values)),
            Measurement::DepthZ(values) => Measurement::DepthZ(pick(values)),
            Measurement::Grey(image) => Measurement::Grey(pick_image(image)?),
        };
        Ok(Self {
            stamp: self.stamp,
            motion: self.motion,
            sensor: Sensor::new(spec)?,
            measurement,
            ranges: pick(&self.ranges),
            intensities: self.intensities.as_ref().map(pick_image).transpose()?,
            scan_motion: self.scan_motion.clone(),
            deskewed_by: self.deskewed_by,
        })
    }
}

/// Checks that intensities are 0 to 1 or NaN; the error names the first that is not.
pub fn check_intensities(values: &[f32]) -> Result<()> {
    let is_none = |v: &f32| !v.is_nan() && !(0.0..=1.0).contains(v);
    let Some(at) = values.iter().position(is_none) else { return Ok(()) };
    let remedy = match values[at] {
        v if v > 1.0 => "divide by the value that the sensor reports for a retro-reflector, so that it becomes 1",
        _ => "give 0 to 1, or no value (null, NaN) where there was no echo",
    };
    Err(Error::invalid(format!("an intensity of {}", values[at]), remedy).at(format!("intensity {at}")))
}

/// The selected pixels of one side.
#[derive(Clone, Copy)]
struct PixelStride {
    first: u32,
    stride: u32,
    count: u32,
}

impl PixelStride {
    /// Centred in the side.
    fn of(side: u32, stride: u32) -> Self {
        let stride = stride.min(side);
        let count = side / stride;
        Self { first: (side - 1 - (count - 1) * stride) / 2, stride, count }
    }

    fn at(self, k: u32) -> u32 {
        self.first + k * self.stride
    }
}

fn thinned_spec(spec: &SensorSpec, columns: PixelStride, rows: PixelStride) -> Result<SensorSpec> {
    let scaled = |f: f64, c: f64, kept: PixelStride| {
        (f / f64::from(kept.stride), (c - f64::from(kept.first)) / f64::from(kept.stride))
    };
    let geometry = match &spec.geometry {
        Geometry::Camera(camera) => {
            let ((fx, cx), (fy, cy)) = (scaled(camera.fx, camera.cx, columns), scaled(camera.fy, camera.cy, rows));
            let distortion = camera.distortion.clone();
            Geometry::Camera(Camera { width: columns.count, height: rows.count, fx, fy, cx, cy, distortion })
        }
        Geometry::Scanner(scanner) => {
            let falling = scanner.rows_deg();
            let elevation = Angles::Listed((0..rows.count).map(|r| falling[rows.at(r) as usize]).collect());
            let azimuth = match scanner.azimuth {
                Angles::Uniform { step_deg, .. } => Angles::Uniform {
                    start_deg: scanner.azimuth.degrees(columns.first as usize),
                    step_deg: step_deg * f64::from(columns.stride),
                    count: columns.count,
                },
                Angles::Listed(_) => Angles::Listed(
                    (0..columns.count).map(|c| scanner.azimuth.degrees(columns.at(c) as usize)).collect(),
                ),
            };
            Geometry::Scanner(Scanner { azimuth, elevation, beam_height_deg: scanner.beam_height_deg })
        }
        Geometry::Rays(table) => {
            let at = |c: u32, r: u32| table.directions()[(rows.at(r) * table.width() + columns.at(c)) as usize];
            let pixels = || (0..rows.count).flat_map(|r| (0..columns.count).map(move |c| (c, r)));
            let thin = RayTable::new(columns.count, rows.count, pixels().map(|(c, r)| at(c, r)).collect())?;
            Geometry::Rays(match table.origins() {
                Some(from) => {
                    let from = pixels().map(|(c, r)| from[(rows.at(r) * table.width() + columns.at(c)) as usize]);
                    thin.with_origins(from.collect())?
                }
                None => thin,
            })
        }
    };
    let times = match &spec.times {
        RayTimes::AtOnce => RayTimes::AtOnce,
        times => {
            let size = spec.geometry.size();
            let pixels = (0..rows.count).flat_map(|r| (0..columns.count).map(move |c| (columns.at(c), rows.at(r))));
            RayTimes::Listed(pixels.map(|(c, r)| times.seconds(c, r, size) as f32).collect())
        }
    };
    Ok(SensorSpec { geometry, times, ..spec.clone() })
}

fn ranges_of_depth(sensor: &Sensor, depth_z: &[f32]) -> Result<Vec<f32>> {
    if !sensor.is_camera() {
        return Err(Error::invalid(
            format!("depth_z of sensor {:?}, which is not a camera", sensor.spec().name),
            "give ranges",
        ));
    }
    let width = sensor.width() as usize;
    let range = |(i, z): (usize, &f32)| {
        let ray = sensor.ray((i % width) as u32, (i / width) as u32);
        ray.map_or(f32::NAN, |ray| (f64::from(*z) / ray.z) as f32)
    };
    Ok(depth_z.iter().enumerate().map(range).collect())
}

#[cfg(test)]
mod tests;
