//! Distance to the nearest surface.

use glam::DVec3;
use presight_model::error::{Error, Result};
use presight_model::geometry::Aabb;
use presight_model::index::{QueryResult, Region};
use presight_model::world::World;
use presight_predict::free_poses::distance;

/// The surface nearest to a point.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct NearestSurface {
    /// Metres.
    pub distance: f64,
    /// Index of the object.
    pub object: u32,
    /// Number of the polygon's slot.
    pub slot: u32,
}

/// The surface nearest to a point of the world, metres; `None` in a world without polygons. Parts that are marked as
/// absent for all sensors are ignored.
///
/// ```
/// use presight::environment::Environment;
/// use presight::query::surface_distance;
/// use presight::{Pose, World};
/// use glam::DVec3;
/// let mut environment = Environment::new();
/// environment.add_cuboid("crate", Pose::IDENTITY, DVec3::ONE)?;
/// let nearest = surface_distance(&World::new(environment), DVec3::new(2.0, 0.0, 0.0))?.expect("a crate");
/// assert!((nearest.distance - 1.5).abs() < 1e-9 && nearest.object == 0);
/// # Ok::<(), presight::Error>(())
/// ```
///
/// # Errors
/// [`presight_model::ErrorKind::Usage`] for a point that is not finite.
pub fn surface_distance(world: &World, p: DVec3) -> Result<Option<NearestSurface>> {
    if !p.is_finite() {
        return Err(Error::usage(format!("a point at {p}"), "give finite metres"));
    }
    let environment = world.environment();
    let bounds = environment.bounds();
    if bounds.is_empty() {
        return Ok(None);
    }
    let farthest = bounds.distance_squared(p).sqrt() + bounds.size() + 1.0;
    let mut reach = bounds.distance_squared(p).sqrt() + 0.25;
    let mut found = QueryResult::default();
    loop {
        let region = Region::cuboid(&Aabb { min: p - reach, max: p + reach });
        let each = world.polygons_in(&region, None, &mut found).map(|(object, polygon)| {
            let slot = environment.objects()[object as usize].first_slot + polygon;
            let distance = distance(&environment.objects()[object as usize], polygon, p);
            NearestSurface { distance, object, slot }
        });
        let nearest = each.min_by(|a, b| a.distance.total_cmp(&b.distance));
        // Surfaces outside of the box are farther away.
        if nearest.is_some_and(|n| n.distance <= reach) || reach > farthest {
            return Ok(nearest);
        }
        reach *= 2.0;
    }
}
