//! An independent oracle: ray casts against triangles by parry3d-f64.

use glam::{DMat3, DVec3};
use parry3d_f64::math::Vector;
use parry3d_f64::query::{PointQuery, Ray};
use parry3d_f64::shape::{CompositeShapeRef, TriMesh};
use presight_model::environment::{Appearance, Environment, Material};
use presight_model::geometry::Pose;
use presight_model::sensor::Sensor;
use presight_render::verify::PixelValues;

/// The triangles of an environment, each polygon cut into a fan, relative to an origin near the sensor.
pub struct Oracle {
    mesh: TriMesh,
    /// For each triangle the object, slot, unit normal and reflection factor of its polygon. The normal of the triangle
    /// would differ from it, because f32 corners are not exactly in one plane.
    of_triangle: Vec<(u32, u32, DVec3, f64)>,
    origin: DVec3,
}

impl Oracle {
    /// Builds the oracle; `None` if there are no triangles. Subtracts `origin` before all other sums, so that scenes
    /// far from the world's origin keep their precision.
    pub fn new(environment: &Environment, origin: DVec3) -> Option<Self> {
        Self::of_polygons(environment, origin, |_, _, _| true)
    }

    /// As [`Oracle::new`], of the polygons that are opaque to sensors of a class.
    pub fn seen_by(environment: &Environment, origin: DVec3, class: &str) -> Option<Self> {
        let is_opaque = |m: &Material| m.appearance(class) == Appearance::Opaque;
        let opaque: Vec<bool> = environment.materials().iter().map(is_opaque).collect();
        Self::of_polygons(environment, origin, |_, _, material| opaque[usize::from(material)])
    }

    /// As [`Oracle::new`], without polygons whose plane contains the origin, the sensor's position, within f64
    /// rounding. By definition they cover no rays.
    pub fn off_plane(environment: &Environment, origin: DVec3) -> Option<Self> {
        Self::of_polygons(environment, origin, |corners, normal, _| {
            let nearest =
                corners.iter().copied().fold(DVec3::INFINITY, |a, b| if b.length() < a.length() { b } else { a });
            let (longest, area) = size(corners);
            let rounding = 5e-16 * (nearest.length() + longest) * (1.0 + longest * longest / area);
            normal.dot(nearest).abs() > rounding
        })
    }

    fn of_polygons(
        environment: &Environment,
        origin: DVec3,
        keep: impl Fn(&[DVec3], DVec3, u16) -> bool,
    ) -> Option<Self> {
        let (mut vertices, mut triangles, mut of_triangle) = (Vec::new(), Vec::new(), Vec::new());
        for (index, object) in environment.objects().iter().enumerate() {
            let rotation = DMat3::from_quat(object.world_from_object.rotation);
            let shift = object.world_from_object.translation - origin;
            for polygon in 0..object.mesh.polygon_count() as u32 {
                let in_world = |p| rotation * object.object_from_mesh.transform_point3(p) + shift;
                let corners: Vec<DVec3> = object.mesh.corners_of(polygon).map(in_world).collect();
                let fan = (1..corners.len() - 1).map(|k| [0, k, k + 1]);
                let cross = |[a, b, c]: [usize; 3]| (corners[b] - corners[a]).cross(corners[c] - corners[a]);
                let normal = fan.clone().map(cross).sum::<DVec3>().normalize();
                if !keep(&corners, normal, object.mesh.material(polygon)) {
                    continue;
                }
                let reflection = environment.materials()[usize::from(object.mesh.material(polygon))].reflection;
                let first = vertices.len() as u32;
                vertices.extend(corners.iter().map(|p| Vector::new(p.x, p.y, p.z)));
                for triangle in fan {
                    triangles.push(triangle.map(|k| first + k as u32));
                    of_triangle.push((index as u32, object.first_slot + polygon, normal, reflection));
                }
            }
        }
        let mesh = TriMesh::new(vertices, triangles).ok()?;
        Some(Self { mesh, of_triangle, origin })
    }

    /// Returns true if a triangle lies within `length` metres of a point along a unit direction, both in the world.
    /// Ignores triangles of the polygons with the slots in `but`.
    pub fn hides(&self, from: DVec3, direction: DVec3, length: f64, but: &[u32]) -> bool {
        let vector = |v: DVec3| Vector::new(v.x, v.y, v.z);
        let mut done = 0.0;
        // Continue behind a hit that is ignored.
        for _ in 0..64 {
            let start = from - self.origin + done * direction;
            let ray = Ray::new(vector(start), vector(direction));
            let hit = CompositeShapeRef(&self.mesh).cast_local_ray(&ray, length - done, false);
            let Some((triangle, on)) = hit else { return false };
            if !but.contains(&self.of_triangle[triangle as usize].1) {
                return true;
            }
            done += on + 1e-10 * length;
            if done >= length {
                return false;
            }
        }
        panic!("64 polygons of one feature on one ray");
    }

    /// Metres from a point to the nearest triangle along a unit direction, both in the world, and the cosine of
    /// incidence; `None` if there is none.
    pub fn hit(&self, from: DVec3, direction: DVec3) -> Option<(f64, f64)> {
        self.met(from, direction).map(|(range, cosine, _)| (range, cosine))
    }

    /// As [`Oracle::hit`], with the slot of the polygon.
    pub fn met(&self, from: DVec3, direction: DVec3) -> Option<(f64, f64, u32)> {
        let vector = |v: DVec3| Vector::new(v.x, v.y, v.z);
        let ray = Ray::new(vector(from - self.origin), vector(direction));
        let (triangle, range) = CompositeShapeRef(&self.mesh).cast_local_ray(&ray, f64::MAX, false)?;
        let (_, slot, normal, _) = self.of_triangle[triangle as usize];
        Some((range, normal.dot(direction).abs(), slot))
    }

    /// Metres from a point in the world to the nearest triangle.
    pub fn nearest(&self, p: DVec3) -> f64 {
        let p = p - self.origin;
        self.mesh.distance_to_local_point(Vector::new(p.x, p.y, p.z), true)
    }

    /// As [`Oracle::hit`], the metres alone; infinite if there is none.
    pub fn distance(&self, from: DVec3, direction: DVec3) -> f64 {
        self.hit(from, direction).map_or(f64::INFINITY, |(range, _)| range)
    }

    /// As [`Oracle::cast`], for a sensor on a robot that moves: `robot` gives the robot's pose in the world by seconds
    /// after the stamp.
    pub fn cast_moving(
        &self,
        sensor: &Sensor,
        robot: &dyn Fn(f64) -> Pose,
        (column, row): (u32, u32),
    ) -> Option<PixelValues> {
        let (at, mount) = (robot(sensor.seconds_after_stamp(column, row)), sensor.spec().mount);
        let start = mount.translation + mount.rotation * sensor.start(column, row);
        let pose = Pose { rotation: at.rotation * mount.rotation, translation: at.translation + at.rotation * start };
        self.cast(sensor, &pose, (column, row))
    }

    /// The correct values of a pixel; `None` if it has no ray.
    pub fn cast(&self, sensor: &Sensor, world_from_sensor: &Pose, (column, row): (u32, u32)) -> Option<PixelValues> {
        let ray = sensor.ray(column, row)?;
        let direction = DMat3::from_quat(world_from_sensor.rotation) * (sensor.body_from_image() * ray);
        let from = world_from_sensor.translation - self.origin;
        let vector = |v: DVec3| Vector::new(v.x, v.y, v.z);
        let hit =
            CompositeShapeRef(&self.mesh).cast_local_ray(&Ray::new(vector(from), vector(direction)), f64::MAX, false);
        // Ranges count from behind the point at which the ray leaves the sensor.
        let hit = hit.map(|(triangle, range)| (triangle, range + sensor.range_lead()));
        let spec = sensor.spec();
        let camera = |z: f32| sensor.is_camera().then_some(z);
        let Some((triangle, range)) = hit.filter(|(_, range)| *range <= spec.range_max) else {
            return Some(PixelValues {
                range: Some(f32::INFINITY),
                depth_z: camera(f32::INFINITY),
                polygon_id: Some(0),
                object_id: Some(0),
                cos_incidence: Some(f32::NAN),
                echo: Some(f32::NAN),
                normal: Some([f32::NAN; 3]),
            });
        };
        let (object, slot, normal, reflection) = self.of_triangle[triangle as usize];
        let near = range < spec.range_min;
        let shown = |x: f64| if near { f32::NEG_INFINITY } else { x as f32 };
        let cos_incidence = normal.dot(direction).abs();
        let facing = if normal.dot(direction) > 0.0 { -normal } else { normal };
        let in_body = DMat3::from_quat(world_from_sensor.rotation).transpose() * facing;
        Some(PixelValues {
            range: Some(shown(range)),
            depth_z: camera(shown(range * ray.z)),
            polygon_id: Some(slot + 1),
            object_id: Some(object + 1),
            cos_incidence: Some(cos_incidence as f32),
            echo: Some((reflection * cos_incidence) as f32),
            normal: Some(in_body.as_vec3().to_array()),
        })
    }
}

/// The longest side and twice the area.
fn size(corners: &[DVec3]) -> (f64, f64) {
    let n = corners.len();
    let longest = (0..n).map(|k| corners[k].distance(corners[(k + 1) % n])).fold(0.0, f64::max);
    let doubled: DVec3 = (1..n - 1).map(|k| (corners[k] - corners[0]).cross(corners[k + 1] - corners[0])).sum();
    (longest, doubled.length())
}
