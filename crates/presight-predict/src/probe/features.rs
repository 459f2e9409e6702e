//! Checks of a device's feature results: occlusion of samples, and boxes of regions of interest.

use super::{Probe, SensorKind};
use crate::engine::{Device, Engine};
use glam::{DMat3, DVec3};
use presight_features::{
    BoxOptions, BoxQuery, FeaturePrediction, FeatureSamples, FeatureSettings, OcclusionHint, PlacedFeature,
    PreparedFeatures, Vantage, Visibility, add_boxes, predict_features,
};
use presight_model::environment::{Existence, Feature, FeatureShape, Properties};
use presight_model::error::Result;
use presight_model::geometry::Pose;
use presight_model::sensor::Sensor;
use presight_render::plan::{FramePlan, ImageRequest, Images, Output, Outputs, Stats};

/// Tolerance for a side of a box compared to the CPU, pixels.
const OFF: f64 = 1.0 / 16.0;

/// Positions of points between two places.
const SHARES: [f64; 3] = [0.25, 0.5, 0.75];

/// Result of a device's check on points of the scene's polygons.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct DeviceCheck {
    /// Number of points.
    pub all: usize,
    /// Number of points that the device decided.
    pub answered: usize,
    /// Number of wrong decisions.
    pub wrong: usize,
}

impl DeviceCheck {
    /// True if the device is usable. Its answers are in f32, so 1 % may be wrong at outlines; the CPU corrects these.
    pub fn is_sound(&self) -> bool {
        100 * self.wrong <= self.answered && 4 * self.answered >= self.all
    }
}

impl Probe {
    /// Tests a device's occlusion answers for points of the scene's polygons against exact rays.
    ///
    /// # Errors
    /// Errors of the engine.
    pub fn occlusion(&self, task: SensorKind, engine: &mut dyn Engine) -> Result<DeviceCheck> {
        let (sensor, pose, placed) = (task.sensor()?, super::pose(), self.points());
        let request = ImageRequest { outputs: Outputs::of(&[Output::PolygonId]), ..ImageRequest::default() };
        let plan = FramePlan::new(&self.world, &sensor, &pose, request)?;
        let mut images = Images::default();
        engine.render(&plan, &mut images, &mut Stats::default())?;
        let Some(device) = engine.device() else { return Ok(DeviceCheck::default()) };
        let right = self.seen(&sensor, &pose, &placed)?;
        let options = FeatureSettings::default();
        let vantage = Vantage { world: &self.world, sensor: &sensor, world_from_sensor: &pose };
        let samples = PreparedFeatures::new(&vantage, &images, &placed, None, &options)?.query_samples();
        let of = samples.iter().zip(&right.features);
        let of = of.flat_map(|(samples, seen)| samples.iter().map(|_| seen.visible_fraction > 0.0));
        let placed: Vec<_> = placed.iter().collect();
        let hints = device.query_occlusion(&FeatureSamples { samples: &samples, placed: &placed, sensor: &sensor })?;
        let mut check = DeviceCheck { all: hints.len(), ..DeviceCheck::default() };
        for (hint, visible) in hints.into_iter().zip(of) {
            check.answered += usize::from(hint != OcclusionHint::Doubt);
            check.wrong += match hint {
                OcclusionHint::Hidden(_) => usize::from(visible),
                OcclusionHint::Seen => usize::from(!visible),
                OcclusionHint::Doubt => 0,
            };
        }
        Ok(check)
    }

    /// Tests a device's 99 % boxes around points of the scene's polygons against the CPU's.
    ///
    /// # Errors
    /// Errors of the engine.
    pub fn regions(&self, task: SensorKind, device: &mut dyn Device) -> Result<DeviceCheck> {
        let (sensor, pose, placed) = (task.sensor()?, super::pose(), self.points());
        let mut options = BoxOptions::default();
        // Standard deviations of 1 cm and half a degree.
        (0..3).for_each(|i| (options.sensor[i][i], options.sensor[3 + i][3 + i]) = (1e-4, 7.6e-5));
        let mut right = self.seen(&sensor, &pose, &placed)?;
        let mut made = right.clone();
        add_boxes(
            &mut right,
            &BoxQuery {
                placed: &placed,
                world: &self.world,
                sensor: &sensor,
                world_from_sensor: &pose,
                options: &options,
            },
        )?;
        let answered = device.add_boxes(
            &mut made,
            &BoxQuery {
                placed: &placed,
                world: &self.world,
                sensor: &sensor,
                world_from_sensor: &pose,
                options: &options,
            },
        )?;
        let differs = |i: &usize| {
            let (a, b) = (&right.features[*i], &made.features[*i]);
            let near = |a: [f64; 4], b: [f64; 4]| a.iter().zip(b).all(|(a, b)| (a - b).abs() <= OFF);
            a.roi_flag != b.roi_flag
                || a.roi.zip(b.roi).is_some_and(|(a, b)| !near(a, b))
                || a.roi.is_some() != b.roi.is_some()
        };
        let all = right.features.iter().filter(|f| f.roi.is_some()).count();
        Ok(DeviceCheck { all, answered, wrong: (0..placed.len()).filter(differs).count() })
    }

    /// The exact visibility of each point, by rays.
    fn seen(&self, sensor: &Sensor, pose: &Pose, placed: &[PlacedFeature]) -> Result<FeaturePrediction> {
        let (width, height) = (sensor.width(), sensor.height());
        let polygon_id = vec![0; width as usize * height as usize];
        let images = Images { width, height, polygon_id, ..Images::default() };
        let options = FeatureSettings { visibility: Visibility::Rays, ..FeatureSettings::default() };
        predict_features(&self.world, sensor, pose, &images, placed, &options)
    }

    /// Points on every polygon: three near each side, but not on it, because neighbours touch there; and three in the
    /// sensor's horizontal plane, for one-row scanners.
    fn points(&self) -> Vec<PlacedFeature> {
        let (sensor, mut placed) = (super::pose(), Vec::new());
        let mut add = |at: DVec3, slot: u32| {
            let shape = FeatureShape::Point { at, covariance: DMat3::from_diagonal(DVec3::splat(1e-6)) };
            let (existence, properties) = (Existence::default(), Properties::default());
            let feature =
                Feature { id: placed.len() as u32 + 1, name: None, object: None, shape, existence, properties };
            placed.push(PlacedFeature { feature: feature.into(), object: None, slots: vec![slot] });
        };
        let up = sensor.rotation * DVec3::Z;
        let height = |p: DVec3| up.dot(p - sensor.translation);
        for o in self.world.environment().objects() {
            let world_from_mesh = o.world_from_mesh();
            for polygon in 0..o.mesh.polygon_count() as u32 {
                let corners: Vec<DVec3> =
                    o.mesh.corners_of(polygon).map(|c| world_from_mesh.transform_point3(c)).collect();
                let middle = corners.iter().sum::<DVec3>() / corners.len() as f64;
                let sides = corners.iter().zip(corners.iter().cycle().skip(1));
                let mut crossings = Vec::new();
                for (a, b) in sides {
                    for share in SHARES {
                        add(a.lerp(*b, share).lerp(middle, 0.3), o.first_slot + polygon);
                    }
                    let (from, to) = (height(*a), height(*b));
                    if (from < 0.0) != (to < 0.0) {
                        crossings.push(a.lerp(*b, from / (from - to)));
                    }
                }
                if let [a, b] = crossings[..] {
                    SHARES.into_iter().for_each(|share| add(a.lerp(b, share), o.first_slot + polygon));
                }
            }
        }
        placed
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[cfg(feature = "gpu")]
    #[test]
    fn a_device_that_is_right_is_found_sound() {
        use crate::gpu;
        use presight_testkit::skip::no_adapter;
        let probe = Probe::new().unwrap();
        let mut engine = match gpu::testing::open(gpu::DeviceOptions::default(), gpu::testing::Setup::ALL_ON_DEVICE) {
            Ok(engine) => engine,
            Err(e) => {
                no_adapter(e);
                return;
            }
        };
        for task in SensorKind::ALL {
            let seen = probe.occlusion(task, &mut engine).unwrap();
            assert!(seen.is_sound() && seen.answered > 20, "{}: {seen:?}", task.name());
            let regions = probe.regions(task, &mut engine).unwrap();
            assert!(regions.wrong == 0 && regions.all > 5, "{}: {regions:?}", task.name());
            // The CPU handles lenses and ray tables.
            assert!(regions.answered > 0 || task == SensorKind::Rays, "{}: {regions:?}", task.name());
        }
    }

    #[test]
    fn wrong_answers_and_none_are_not_sound() {
        assert!(DeviceCheck { all: 100, answered: 100, wrong: 1 }.is_sound());
        assert!(!DeviceCheck { all: 100, answered: 100, wrong: 2 }.is_sound());
        assert!(!DeviceCheck { all: 100, answered: 24, wrong: 0 }.is_sound());
    }
}
