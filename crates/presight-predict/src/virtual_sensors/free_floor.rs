//! Free floor: visible floor, on which the robot may drive.
//!
//! Floor is a polygon that is horizontal within [`TILT`], is seen from above, and lies within [`FLOOR_HEIGHT`] of
//! the floor's height. That height defaults to the height of the robot's origin. Real models mix windings, so the
//! visible side counts, not the winding.
//!
//! The outline of the floor pixels follows pixel sides. Each corner is projected to the floor plane along its own ray,
//! including lens distortion, so the outline is accurate to a pixel. A pixel counts only if all its corners meet the
//! floor plane within the sensor's range. Pixels that reach over the horizon are counted separately.

use super::mask::{Mask, MaskRegion};
use super::pixels::{Pixels, TILT, VisiblePlane};
use super::{Settings, View};
use glam::DVec3;
use presight_model::error::Result;
use presight_model::sensor::Geometry;
use serde::Serialize;

/// Maximum distance of floor above or below its stated height, metres.
pub const FLOOR_HEIGHT: f64 = 0.05;

/// Visible free floor.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct FreeFloor {
    /// Height of the floor plane in the world, metres.
    pub floor_z_world: f64,
    /// Total area of the regions, square metres.
    pub area: f64,
    /// Number of pixels in the regions.
    pub pixels: usize,
    /// Number of floor pixels whose corners do not all meet the floor plane within range; not included above.
    pub pixels_over_horizon: usize,
    /// Connected regions of the image, largest area first.
    pub regions: Vec<FloorRegion>,
    /// The pixels of the regions.
    pub mask: Mask,
}

/// A region of floor as polygons in the robot's frame, metres. Seen from above, the outer polygon runs
/// counter-clockwise and holes run clockwise.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct FloorRegion {
    /// Area without holes, square metres.
    pub area: f64,
    /// Number of pixels.
    pub pixels: usize,
    /// Outer outline.
    pub outer_robot: Vec<[f64; 3]>,
    /// Outlines of objects that stand on the floor or hide it.
    pub holes_robot: Vec<Vec<[f64; 3]>>,
}

impl FreeFloor {
    pub(super) fn summary(&self) -> String {
        let holes: usize = self.regions.iter().map(|r| r.holes_robot.len()).sum();
        let share = 100.0 * self.pixels as f64 / self.mask.pixels.len().max(1) as f64;
        format!(
            "{:.3} m2 of floor at z = {:.3} m in {} regions with {holes} holes, {share:.1} % of the image",
            self.area,
            self.floor_z_world,
            self.regions.len()
        )
    }
}

/// The floor plane relative to the camera.
struct Floor {
    /// The world's z axis in the sensor's body axes.
    up: DVec3,
    /// Height relative to the sensor, metres; negative below it.
    height: f64,
    range_max: f64,
}

impl Floor {
    fn holds(&self, surface: &VisiblePlane) -> bool {
        let [low, high] = surface.heights;
        let level = low >= self.height - FLOOR_HEIGHT && high <= self.height + FLOOR_HEIGHT;
        // Normals point to the sensor's side, so an upward normal means that the surface is seen from above.
        level && surface.normal.dot(self.up) >= TILT.cos()
    }

    /// Intersection of a ray with the plane, within range.
    fn meet(&self, ray: DVec3) -> Option<DVec3> {
        let range = self.height / self.up.dot(ray);
        (range > 0.0 && range <= self.range_max).then(|| ray * range)
    }

    /// Intersection of the ray at a pixel corner with the plane.
    fn meet_at(&self, (i, j): (u32, u32), pixels: &Pixels<'_>) -> Option<DVec3> {
        pixels.ray_at(f64::from(i) - 0.5, f64::from(j) - 0.5).and_then(|ray| self.meet(ray))
    }
}

pub(super) fn reduce(view: &View<'_>, settings: &Settings) -> Result<FreeFloor> {
    let mut pixels = Pixels::with_ids(view)?;
    let world_from_robot = pixels.world_from_sensor * pixels.robot_from_sensor.inverse();
    let floor_z_world = settings.floor_z_world.unwrap_or(world_from_robot.translation.z);
    let height = floor_z_world - pixels.world_from_sensor.translation.z;
    let floor = Floor { up: pixels.up, height, range_max: pixels.sensor.spec().range_max };
    let mut mask = Mask::new(pixels.sensor.width(), pixels.sensor.height());
    let mut pixels_over_horizon = 0;
    // Results for the corners above and below the row, computed on demand because undistorting is slow.
    let mut meets = [(); 2].map(|()| vec![None; mask.width as usize + 1]);
    for row in 0..mask.height {
        meets.swap(0, 1);
        meets[1].fill(None);
        for column in 0..mask.width {
            if !pixels.surface(column, row).is_some_and(|s| floor.holds(&s)) {
                continue;
            }
            let all = [(0, 0), (1, 0), (1, 1), (0, 1)].into_iter().all(|(i, j)| {
                let corner = (column + i, row + j);
                *meets[j as usize][corner.0 as usize].get_or_insert_with(|| floor.meet_at(corner, &pixels).is_some())
            });
            if all {
                mask.pixels[pixels.at(column, row)] = true;
            } else {
                pixels_over_horizon += 1;
            }
        }
    }
    // Lens distortion bends straight edges.
    let straight = matches!(&pixels.sensor.spec().geometry, Geometry::Camera(c) if c.distortion.is_none());
    let mut regions: Vec<FloorRegion> =
        mask.regions(!straight).iter().map(|region| project(region, &floor, &pixels)).collect();
    regions.sort_by(|a, b| b.area.total_cmp(&a.area));
    // An empty sum is -0; adding 0 makes it 0.
    let area = regions.iter().map(|r| r.area).sum::<f64>() + 0.0;
    Ok(FreeFloor { floor_z_world, area, pixels: mask.count(), pixels_over_horizon, regions, mask })
}

fn project(region: &MaskRegion, floor: &Floor, pixels: &Pixels<'_>) -> FloorRegion {
    let mut area = 0.0;
    let mut outline = |corners_of: &[(u32, u32)]| {
        let points: Vec<DVec3> = corners_of.iter().filter_map(|c| floor.meet_at(*c, pixels)).collect();
        debug_assert_eq!(points.len(), corners_of.len(), "corners of pixels that count meet the floor");
        area += signed_area(&points, floor.up);
        points.into_iter().map(|p| pixels.in_robot(p)).collect::<Vec<_>>()
    };
    let outer_robot = outline(&region.outer);
    let holes_robot = region.holes.iter().map(|hole| outline(hole)).collect();
    FloorRegion { area, pixels: region.pixels, outer_robot, holes_robot }
}

/// Positive for a counter-clockwise outline about the axis.
fn signed_area(points: &[DVec3], axis: DVec3) -> f64 {
    let Some((first, rest)) = points.split_first() else { return 0.0 };
    rest.windows(2).map(|w| 0.5 * (w[0] - first).cross(w[1] - first).dot(axis)).sum()
}
