//! Studies of all scenes and sensors.

use super::approximations;
use super::engines::Engines;
use super::one::SceneStudy;
use super::path::Path;
use super::results::Findings;
use super::setup::{Effort, Scene};
use presight_model::error::{Error, Result};
use presight_model::sensor::{Camera, Distortion, Geometry, Sensor, SensorSpec};

/// A work-precision study.
#[derive(Clone, Debug)]
pub struct Study {
    /// The scenes.
    pub scenes: Vec<Scene>,
    /// The sensors. Paths of those whose rays start at several points are not measured: there is a single one.
    pub sensors: Vec<Sensor>,
    /// Lidars that are compared with simpler ones.
    pub lidars: Vec<Sensor>,
    /// The amount of measurement.
    pub effort: Effort,
}

/// A sensor for full studies that needs a ray table: a fisheye of 180 degrees.
///
/// # Errors
/// None in practice; as [`Sensor::new`].
pub fn fisheye() -> Result<Sensor> {
    let distortion = Distortion::Equidistant([0.0; 4]);
    let camera = Camera { width: 512, height: 512, fx: 163.0, fy: 163.0, cx: 255.5, cy: 255.5, distortion };
    Sensor::new(SensorSpec::new("fisheye", "video", Geometry::Camera(camera)))
}

impl Study {
    /// The maximum number of progress reports of [`Study::run`].
    pub fn steps(&self) -> usize {
        let measured = self.sensors.len() * self.scenes.len();
        let poses: usize = self.sensors.len() * self.scenes.iter().map(|s| s.poses.len()).sum::<usize>();
        // Per measurement one for the truth and one for features, and one for each lidar. Per pose one for each path,
        // and the rounds of images, features and regions of interest.
        let lidars = self.lidars.len() * self.scenes.len();
        2 * measured + lidars + poses * (Path::all(true).len() + 3 * self.effort.rounds)
    }

    /// Runs the study. Calls `progress` with the name of each step.
    ///
    /// # Errors
    /// Errors from predictions, from generating features, and from drawing the preview.
    pub fn run(&self, mut progress: impl FnMut(&str)) -> Result<Findings> {
        let mut engines = Engines::open()?;
        let (mut findings, mut approximations) = (Vec::new(), Vec::new());
        for scene in &self.scenes {
            if scene.poses.is_empty() {
                return Err(Error::invalid("there are no poses", "give at least one").in_file(&scene.name));
            }
            for sensor in self.sensors.iter().filter(|sensor| !sensor.has_origins()) {
                let mut one =
                    SceneStudy { scene, sensor, effort: &self.effort, engines: &mut engines, not_measured: Vec::new() };
                let finding = one.run(&mut progress);
                findings
                    .push(finding.map_err(|e| e.at(format!("sensor {:?}", sensor.spec().name)).in_file(&scene.name))?);
            }
            for lidar in &self.lidars {
                let name = &lidar.spec().name;
                progress(&format!("simpler lidars: {name}, {}", scene.name));
                let costs = approximations::costs(scene, lidar);
                approximations.extend(costs.map_err(|e| e.at(format!("sensor {name:?}")).in_file(&scene.name))?);
            }
        }
        Ok(Findings { findings, approximations, adapter: engines.adapter() })
    }
}
