//! Meshes, sensors and frames shared by several families.

use super::family::Case;
use glam::{DVec3, Vec3};
use presight_model::environment::{CUBOID_FACES, cuboid_corners};
use presight_model::environment::{Environment, Material, Mesh, NewObject, Polygon, PolygonOrder};
use presight_model::error::Result;
use presight_model::geometry::Pose;
use presight_model::sensor::{Angles, Camera, Geometry, Scanner, Sensor, SensorSpec};
use presight_model::world::World;
use std::sync::Arc;

/// The pose of a scene's frame in the world: rotated, so that no coordinates are exact by chance.
pub fn frame(at: DVec3) -> Pose {
    Pose::from_xyz_rpy(at, 0.3, -0.2, 0.7)
}

/// A world under construction.
pub struct Scene {
    environment: Environment,
    pub world_from_scene: Pose,
}

impl Scene {
    /// An empty scene in a frame.
    ///
    /// # Errors
    /// None in practice.
    pub fn new(world_from_scene: Pose) -> Result<Self> {
        let mut environment = Environment::new();
        environment.add_material(Material::named("grey"))?;
        Ok(Self { environment, world_from_scene })
    }

    /// Adds polygons as one object, with the pose `at` in the scene's frame.
    ///
    /// # Errors
    /// Those of [`Mesh::new`] and [`Environment::insert`].
    pub fn add(&mut self, polygons: &[Vec<Vec3>], at: Pose) -> Result<()> {
        let mesh = mesh(polygons)?;
        let pose = self.world_from_scene * at;
        self.environment.insert(NewObject::new("thing", pose, Arc::new(mesh))).map(|_| ())
    }

    /// Adds an object, with a pose in the world.
    ///
    /// # Errors
    /// Those of [`Environment::insert`].
    pub fn insert(&mut self, new: NewObject) -> Result<()> {
        self.environment.insert(new).map(|_| ())
    }

    /// Makes a case for each sensor, with poses in the scene's frame.
    pub fn seen_by(self, sensors: impl IntoIterator<Item = (Sensor, Pose)>) -> Vec<Case> {
        let world = World::new(self.environment);
        let pose = |at: &Pose| self.world_from_scene * *at;
        sensors.into_iter().map(|(sensor, at)| Case { world: world.clone(), sensor, pose: pose(&at) }).collect()
    }
}

/// A mesh of polygons. Equal corners share one vertex.
///
/// # Errors
/// Those of [`Mesh::new`].
pub fn mesh(polygons: &[Vec<Vec3>]) -> Result<Mesh> {
    let mut vertices: Vec<Vec3> = Vec::new();
    let mut number = |p: &Vec3| {
        vertices.iter().position(|v| v == p).unwrap_or_else(|| {
            vertices.push(*p);
            vertices.len() - 1
        }) as u32
    };
    let list: Vec<_> = polygons.iter().map(|p| Polygon::new(p.iter().map(&mut number).collect(), 0)).collect();
    Mesh::new("case", vertices, list, PolygonOrder::Given)
}

/// A rectangle perpendicular to the x axis, with intervals of y and z.
pub fn wall(x: f64, [y0, y1]: [f64; 2], [z0, z1]: [f64; 2]) -> Vec<Vec3> {
    [[x, y0, z0], [x, y1, z0], [x, y1, z1], [x, y0, z1]].map(point).to_vec()
}

/// Rounds a point to f32. The rounded point is the exact input of the case.
pub fn point(p: [f64; 3]) -> Vec3 {
    DVec3::from_array(p).as_vec3()
}

/// The six faces of a box.
pub fn cuboid(least: [f64; 3], most: [f64; 3]) -> Vec<Vec<Vec3>> {
    let corners = cuboid_corners(point(least), point(most));
    CUBOID_FACES.map(|f| f.map(|i| corners[i as usize]).to_vec()).to_vec()
}

/// A camera of 33 x 17 pixels that looks along x, with focal lengths and principal point in pixels.
///
/// # Errors
/// Those of [`Sensor::new`].
pub fn camera(fx: f64, fy: f64, cx: f64, cy: f64) -> Result<Sensor> {
    let camera = Camera::pinhole(33, 17, fx, fy, cx, cy);
    Sensor::new(SensorSpec::new("camera", "study", Geometry::Camera(camera)))
}

/// A scanner.
///
/// # Errors
/// Those of [`Sensor::new`].
pub fn scanner(start_deg: f64, step_deg: f64, count: u32, rows_deg: &[f64]) -> Result<Sensor> {
    let azimuth = Angles::Uniform { start_deg, step_deg, count };
    let scanner = Scanner { azimuth, elevation: Angles::Listed(rows_deg.to_vec()), beam_height_deg: None };
    Sensor::new(SensorSpec::new("scanner", "study", Geometry::Scanner(scanner)))
}

/// A camera and a scanner that cover a wide range of directions.
///
/// # Errors
/// None in practice.
pub fn sensors(at: DVec3) -> Result<[(Sensor, Pose); 2]> {
    let pose = |roll, pitch, yaw| Pose::from_xyz_rpy(at, roll, pitch, yaw);
    Ok([
        (camera(15.0, 14.0, 16.3, 8.1)?, pose(0.1, 0.2, 0.3)),
        (scanner(-180.0, 10.7, 33, &[88.0, 41.0, 12.3, 1.0, -7.0, -33.3, -71.0])?, pose(0.05, -0.1, 1.0)),
    ])
}
