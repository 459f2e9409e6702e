//! Virtual sensors in a prediction: their flags, inputs and results.

use super::print;
use presight::files;
use presight::virtual_sensors::{Settings, View, VirtualReading, VirtualSensor};
use presight::{Error, Outputs, Pose, Prediction, Predictor, Result, Scene, Sensor, SensorPose};
use presight_pictures as png;
use std::path::{Path, PathBuf};

/// Flags of the virtual sensor.
#[derive(Debug, clap::Args)]
pub struct VirtualArgs {
    /// Use the sensor for one task: free-floor, edges, radar-lines, radar-nearest, radar-landmarks, depth-image,
    /// vertical-planes or docking
    ///
    /// The result goes under "virtual" into the --features file; without that file one line is printed.
    #[arg(long = "virtual", value_name = "NAME")]
    pub task: Option<VirtualSensor>,

    /// The robot's planned path, for radar-nearest: {polyline_in_robot, half_width, z_min, z_max}, metres
    #[arg(long, value_name = "FILE.json", requires = "task")]
    pub corridor: Option<PathBuf>,

    /// Height of the floor in the world, for free-floor [default: the robot's origin; without a [mount], the floor
    /// straight below the sensor]
    #[arg(long, alias = "floor-z", value_name = "METRES", requires = "task", allow_negative_numbers = true)]
    floor: Option<f64>,

    /// Write the pixels that free-floor marks, white on black
    #[arg(long, value_name = "FILE.png", requires = "task")]
    pub mask: Option<PathBuf>,
}

impl VirtualArgs {
    /// Checks the flags without opening any file.
    pub fn check(&self) -> Result<()> {
        let only = |of: VirtualSensor, flag: &str, given: bool| {
            if given && self.task != Some(of) {
                let what = format!("--{flag} is for --virtual {}", of.name());
                return Err(Error::usage(what, format!("drop --{flag}, or give --virtual {}", of.name())));
            }
            Ok(())
        };
        only(VirtualSensor::RadarNearest, "corridor", self.corridor.is_some())?;
        only(VirtualSensor::FreeFloor, "floor", self.floor.is_some())?;
        only(VirtualSensor::FreeFloor, "mask", self.mask.is_some())?;
        match self.floor.filter(|z| !z.is_finite()) {
            Some(z) => Err(Error::usage(format!("--floor {z}"), "give finite metres")),
            None => Ok(()),
        }
    }

    /// Checks that the virtual sensor works with this sensor.
    pub fn check_sensor(&self, sensor: &Sensor) -> Result<()> {
        self.task.map_or(Ok(()), |v| v.check(sensor).map_err(|e| e.at("--virtual")))
    }

    /// The images that the virtual sensor reads.
    pub fn outputs(&self) -> Outputs {
        self.task.map_or(Outputs::of(&[]), VirtualSensor::outputs)
    }

    /// Memory of the reading in bytes per pixel; if it is written, its text is included.
    pub fn bytes_by_pixel(&self, written: bool) -> u64 {
        match self.task {
            None => 0,
            Some(VirtualSensor::DepthImage) => 32 + if written { 72 } else { 0 },
            Some(VirtualSensor::VerticalPlanes) => 64,
            Some(_) => 6,
        }
    }

    /// Reads the corridor file, and finds the floor height if it is not known.
    pub fn settings(
        &self,
        scene: &Scene,
        sensor: &Sensor,
        pose: &SensorPose,
        predictor: &mut Predictor,
    ) -> Result<Settings> {
        let corridor = self.corridor.as_deref().map(files::read_corridor).transpose()?;
        let unknown = self.task == Some(VirtualSensor::FreeFloor)
            && self.floor.is_none()
            && sensor.spec().mount == Pose::IDENTITY;
        let below = unknown.then(|| predictor.floor_below(&scene.world, sensor, pose)).transpose();
        let below = below.map_err(|e| e.at("--virtual"))?;
        Ok(Settings { floor_z_world: self.floor.or(below), corridor })
    }

    /// The virtual sensor's reading; `None` without `--virtual`.
    pub fn read(&self, scene: &Scene, prediction: &Prediction, settings: &Settings) -> Result<Option<VirtualReading>> {
        let Some(task) = self.task else { return Ok(None) };
        task.reduce(&View::of(prediction, scene.world.environment()), settings).map(Some)
    }

    /// Writes the mask, if `--mask` is given, and prints a one-line summary unless the reading goes into a file.
    pub fn tell(&self, reading: Option<&VirtualReading>, mask: Option<&Path>, in_file: bool) -> Result<()> {
        let Some(reading) = reading else { return Ok(()) };
        if let (Some(path), Some(mask)) = (mask, reading.mask()) {
            png::write_mask(path, mask)?;
        }
        if in_file { Ok(()) } else { print::lines([reading.summary()]) }
    }
}
