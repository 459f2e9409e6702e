//! parry3d-f64 as an oracle that shares no code with what is tested: ray casts against triangles.

use glam::{DMat3, DVec3};
use parry3d_f64::math::Vector;
use parry3d_f64::query::Ray;
use parry3d_f64::shape::{CompositeShapeRef, TriMesh};
use presight::compare::Values;
use presight::{Environment, Pose, Sensor};

/// The triangles of an environment, each polygon cut into a fan, relative to an origin near the sensor.
pub struct Oracle {
    mesh: TriMesh,
    /// Object and slot by triangle.
    of_triangle: Vec<(u32, u32)>,
    origin: DVec3,
}

impl Oracle {
    /// `None` if there are no triangles. Differences to `origin` are taken before anything is added up, so that
    /// scenes far from the world's origin keep their digits.
    pub fn new(environment: &Environment, origin: DVec3) -> Option<Self> {
        let (mut vertices, mut triangles, mut of_triangle) = (Vec::new(), Vec::new(), Vec::new());
        for (index, object) in environment.objects().iter().enumerate() {
            let rotation = DMat3::from_quat(object.world_from_object.rotation);
            let shift = object.world_from_object.translation - origin;
            for polygon in 0..object.mesh.polygon_count() as u32 {
                let first = vertices.len() as u32;
                for p in object.mesh.corners_of(polygon) {
                    let p = rotation * object.object_from_mesh.transform_point3(p) + shift;
                    vertices.push(Vector::new(p.x, p.y, p.z));
                }
                for k in first + 1..vertices.len() as u32 - 1 {
                    triangles.push([first, k, k + 1]);
                    of_triangle.push((index as u32, object.first_slot + polygon));
                }
            }
        }
        let mesh = TriMesh::new(vertices, triangles).ok()?;
        Some(Self { mesh, of_triangle, origin })
    }

    /// What a right engine shows at a pixel; `None` without a ray.
    pub fn cast(&self, sensor: &Sensor, world_from_sensor: &Pose, (column, row): (u32, u32)) -> Option<Values> {
        let ray = sensor.ray(column, row)?;
        let direction = DMat3::from_quat(world_from_sensor.rotation) * (sensor.body_from_image() * ray);
        let from = world_from_sensor.translation - self.origin;
        let vector = |v: DVec3| Vector::new(v.x, v.y, v.z);
        let hit =
            CompositeShapeRef(&self.mesh).cast_local_ray(&Ray::new(vector(from), vector(direction)), f64::MAX, false);
        let spec = sensor.spec();
        let camera = |z: f32| sensor.is_camera().then_some(z);
        let Some((triangle, range)) = hit.filter(|(_, range)| *range <= spec.range_max) else {
            return Some(Values {
                range: Some(f32::INFINITY),
                depth_z: camera(f32::INFINITY),
                polygon_id: Some(0),
                object_id: Some(0),
                cos_incidence: Some(f32::NAN),
            });
        };
        let [a, b, c] = self.mesh.indices()[triangle as usize].map(|i| {
            let p = self.mesh.vertices()[i as usize];
            DVec3::new(p.x, p.y, p.z)
        });
        let (object, slot) = self.of_triangle[triangle as usize];
        let near = range < spec.range_min;
        let shown = |x: f64| if near { f32::NEG_INFINITY } else { x as f32 };
        Some(Values {
            range: Some(shown(range)),
            depth_z: camera(shown(range * ray.z)),
            polygon_id: Some(slot + 1),
            object_id: Some(object + 1),
            cos_incidence: Some((b - a).cross(c - a).normalize().dot(direction).abs() as f32),
        })
    }
}
