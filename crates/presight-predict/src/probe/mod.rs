//! Tests whether an engine draws correctly on this machine: drivers have faults, and a wrong image is worse than none.
//!
//! A tiny scene, seen by a tiny sensor of each kind that has its own code path, is compared to the reference
//! as in every test ([`presight_render::verify`]).

mod features;

pub use features::DeviceCheck;

use glam::{DVec3, Vec3};
use presight_model::environment::{Environment, Material, Mesh, NewObject, Polygon, PolygonOrder};
use presight_model::error::Result;
use presight_model::geometry::Pose;
use presight_model::sensor::{Angles, Camera, Geometry, PixelGrid, RayTable, Scanner, Sensor, SensorSpec};
use presight_model::world::World;
use presight_render::plan::{FramePlan, ImageRequest, Images, Output, Outputs};
use presight_render::reference;
use presight_render::verify::{Precision, Report, compare};
use std::sync::Arc;

presight_model::words! {
    /// A kind of sensor.
    #[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
    pub enum SensorKind {
        /// A pinhole camera: spans along rows.
        Camera = "camera",
        /// A scanner of many rows: spans along columns.
        Scanner = "scanner",
        /// A scanner of one row.
        Row = "one-row scanner",
        /// A ray table: distorted lenses and free directions.
        Rays = "ray table",
    }
}

impl SensorKind {
    /// The kind of a sensor.
    pub fn of(sensor: &Sensor) -> Self {
        match sensor.grid() {
            PixelGrid::Rays(_) => Self::Rays,
            PixelGrid::Lines(_) if sensor.is_camera() => Self::Camera,
            PixelGrid::Lines(_) if sensor.height() == 1 => Self::Row,
            PixelGrid::Lines(_) => Self::Scanner,
        }
    }

    fn sensor(self) -> Result<Sensor> {
        let uniform = |start_deg, step_deg, count| Angles::Uniform { start_deg, step_deg, count };
        let scanner = |azimuth, elevation| Geometry::Scanner(Scanner { azimuth, elevation, beam_height_deg: None });
        let geometry = match self {
            Self::Camera => Geometry::Camera(Camera::pinhole(48, 32, 30.0, 30.0, 23.5, 15.5)),
            Self::Scanner => scanner(uniform(-180.0, 7.5, 48), uniform(-80.0, 5.0, 33)),
            Self::Row => scanner(uniform(-180.0, 1.0, 360), uniform(0.0, 0.0, 1)),
            Self::Rays => {
                // Rays on a bent surface, which no engine can draw with spans.
                let at = |i: u32, n: u32| (f64::from(i) + 0.5) / f64::from(n) * 2.0 - 1.0;
                let ray = |i: u32| {
                    let (y, z) = (at(i % 24, 24), at(i / 24, 16));
                    DVec3::new(1.0 - y * y * (1.0 + z), -1.5 * y, -z).normalize()
                };
                Geometry::Rays(RayTable::new(24, 16, (0..24 * 16).map(ray).collect())?)
            }
        };
        Sensor::new(SensorSpec::new(self.name(), "probe", geometry).with_limits(0.4, 3.0))
    }
}

/// The scene of all tasks.
#[derive(Debug)]
pub struct Probe {
    world: World,
}

impl Probe {
    /// Makes the scene: a room with a slanting pillar, a plate in front of it, one close to the sensor, and a sliver.
    ///
    /// # Errors
    /// Only for a bug in the scene.
    pub fn new() -> Result<Self> {
        let mut environment = Environment::new();
        for name in ["wall", "thing"] {
            environment.add_material(Material::named(name))?;
        }
        let mut add = |name: &str, pose: Pose, mesh: Mesh| {
            environment.insert(NewObject::new(name, pose, Arc::new(mesh))).map(|_| ())
        };
        add("room", Pose::IDENTITY, Mesh::cuboid("room", Vec3::new(-3.0, -2.5, -1.2), Vec3::new(3.0, 2.5, 1.6), 0)?)?;
        let slanting = Pose::from_xyz_rpy(DVec3::new(1.6, 0.3, 0.1), 0.2, -0.3, 0.7);
        add("pillar", slanting, Mesh::cuboid("pillar", Vec3::new(-0.3, -0.2, -1.1), Vec3::new(0.3, 0.2, 1.1), 1)?)?;
        let corners = [[0.0, -0.4, -0.3], [0.1, 0.3, -0.4], [0.0, 0.45, 0.2], [-0.1, -0.1, 0.5]].map(Vec3::from_array);
        let faces = vec![Polygon::new(vec![0, 1, 2], 1), Polygon::new(vec![0, 2, 3], 1)];
        let plate = Mesh::new("plate", corners.to_vec(), faces, PolygonOrder::Given)?;
        add("plate", Pose::from_xyz_rpy(DVec3::new(0.9, -0.5, 0.0), 0.0, 0.1, -0.4), plate)?;
        let corners = [[0.7, -0.25, 0.0], [0.7, 0.2, 0.01], [0.3, 0.2, 0.01], [0.3, -0.25, 0.0]];
        let faces = vec![Polygon::new(vec![0, 1, 2, 3], 1)];
        let near = Mesh::new("near", corners.map(Vec3::from_array).to_vec(), faces, PolygonOrder::Given)?;
        add("near", Pose::IDENTITY, near)?;
        let corners = [[2.0, 2.0, -1.0], [2.0, -2.0, 1.0], [2.0, -2.0, 1.002]].map(Vec3::from_array).to_vec();
        let sliver = Mesh::new("sliver", corners, vec![Polygon::new(vec![0, 1, 2], 1)], PolygonOrder::Given)?;
        add("sliver", Pose::IDENTITY, sliver)?;
        Ok(Self { world: World::new(environment) })
    }

    /// Draws a task's outputs (`depth_z` only for cameras, no `feature_id`) and compares them with the reference.
    ///
    /// # Errors
    /// Errors of the engine; [`presight_model::ErrorKind::Invalid`] if an image lacks pixels.
    pub fn run(
        &self,
        task: SensorKind,
        outputs: Outputs,
        draw: impl FnOnce(&FramePlan, &mut Images) -> Result<()>,
    ) -> Result<Report> {
        let sensor = task.sensor()?;
        let all = outputs.without(Output::FeatureId);
        let outputs = if sensor.is_camera() { all } else { all.without(Output::DepthZ) };
        let request = ImageRequest { outputs, ..ImageRequest::default() };
        let plan = FramePlan::new(&self.world, &sensor, &pose(), request)?;
        let (mut expected, mut drawn) = (Images::default(), Images::default());
        reference::render(&plan, &mut expected)?;
        draw(&plan, &mut drawn)?;
        compare(&expected, &drawn, &plan, Precision::F32)
    }
}

/// The sensor's pose.
fn pose() -> Pose {
    Pose::from_xyz_rpy(DVec3::new(0.1, -0.2, 0.15), 0.03, -0.05, 0.2)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn by_reference(plan: &FramePlan, images: &mut Images) -> Result<()> {
        reference::render(plan, images).map(|_| ())
    }

    #[test]
    fn every_task_is_of_its_kind_and_shows_something_of_everything() {
        let probe = Probe::new().unwrap();
        let mut by_any = std::collections::BTreeSet::new();
        for task in SensorKind::ALL {
            assert_eq!(SensorKind::of(&task.sensor().unwrap()), task);
            let mut seen = std::collections::BTreeSet::new();
            let (mut near, mut far) = (false, false);
            let report = probe.run(task, Outputs::ALL, |plan, images| {
                by_reference(plan, images)?;
                seen.extend(images.object_id.iter().copied());
                near |= images.range.contains(&f32::NEG_INFINITY);
                far |= images.range.contains(&f32::INFINITY);
                Ok(())
            });
            let report = report.unwrap();
            assert_eq!((report.fault, report.edge), (0, 0), "{}", task.name());
            assert!(seen.len() >= 3, "{}: {seen:?}", task.name());
            assert!(near || task == SensorKind::Row, "{}: the plate before the sensor is too near", task.name());
            assert!(far, "{}: walls are out of reach", task.name());
            by_any.extend(seen);
        }
        assert!((1..=4).all(|object| by_any.contains(&object)), "{by_any:?}");
    }

    /// The comparison detects one wrong id, one wrong range, and wrong cosines.
    #[test]
    fn what_a_wrong_driver_might_draw_is_found() {
        let probe = Probe::new().unwrap();
        let faults: [fn(&mut Images); 3] = [
            |images| {
                let (middle, id) = (images.pixels() / 2, images.polygon_id[images.pixels() / 2]);
                images.polygon_id[middle] = if id == 7 { 8 } else { 7 };
            },
            |images| {
                let at = images.range.iter().position(|r| r.is_finite()).unwrap();
                images.range[at] *= 1.001;
            },
            |images| images.cos_incidence.iter_mut().for_each(|c| *c *= 0.99),
        ];
        for task in SensorKind::ALL {
            for (n, fault) in faults.iter().enumerate() {
                let spoiled = |plan: &FramePlan, images: &mut Images| {
                    by_reference(plan, images)?;
                    fault(images);
                    Ok(())
                };
                assert!(probe.run(task, Outputs::ALL, spoiled).unwrap().fault > 0, "fault {n} of the {}", task.name());
            }
        }
    }
}
