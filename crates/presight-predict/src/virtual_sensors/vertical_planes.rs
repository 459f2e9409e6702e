//! Vertical planes: connected image regions that each show one vertical plane.
//!
//! A surface is vertical if its normal is within [`TILT`] of horizontal. Pixels that share a side, also across the
//! seam of a full circle, belong together if they show the same polygon or polygons in one plane within [`COPLANAR`].

use super::View;
use super::pixels::{COPLANAR, PARALLEL, Pixels, TILT, VisiblePlane};
use glam::DVec3;
use presight_model::error::Result;
use serde::Serialize;

/// The visible vertical planes.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct VerticalPlanes {
    /// The planes, most pixels first.
    pub planes: Vec<VerticalPlane>,
    /// Number of pixels that show a vertical plane.
    pub pixels: usize,
}

/// A connected region of one vertical plane.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct VerticalPlane {
    /// Unit normal, on the sensor's side.
    pub normal_robot: [f64; 3],
    /// Metres from the sensor to the plane, along the normal.
    pub distance: f64,
    /// Mean of the hit points, metres.
    pub centre_robot: [f64; 3],
    /// Distance between the outermost hit points, horizontally and upward in the plane, metres.
    pub extent: [f64; 2],
    /// Number of pixels.
    pub pixels: usize,
    /// Visible area, square metres, from the solid angles of the pixels, their ranges and angles of incidence. `None`
    /// for a sensor with one row, whose pixels have no height.
    pub area: Option<f64>,
    /// Object shown by most pixels.
    pub object: String,
    /// First column and row, last column and row. A region across the seam of a full circle spans all columns.
    pub pixel_bounds: [u32; 4],
}

impl VerticalPlanes {
    pub(super) fn summary(&self) -> String {
        let share = |p: &VerticalPlane| format!("{:?} at {:.3} m", p.object, p.distance);
        let largest = self.planes.first().map(|p| format!(", the largest of {}", share(p))).unwrap_or_default();
        format!("{} vertical planes on {} pixels{largest}", self.planes.len(), self.pixels)
    }
}

/// Sums over the pixels of a region.
struct Region {
    /// Surface of the first pixel, with which all others are compared.
    surface: VisiblePlane,
    pixels: usize,
    sum: DVec3,
    low: [f64; 2],
    high: [f64; 2],
    area: f64,
    bounds: [u32; 4],
    objects: Vec<(u32, usize)>,
}

pub(super) fn reduce(view: &View<'_>) -> Result<VerticalPlanes> {
    let mut image = Pixels::with_ids(view)?;
    let (width, height) = (image.sensor.width(), image.sensor.height());
    let distinct = image.sensor.distinct_columns();
    let least = TILT.sin();
    let up = image.up;
    let mut pixels: Vec<Option<VisiblePlane>> = Vec::with_capacity(image.count());
    for row in 0..height {
        for column in 0..width {
            let surface = if column < distinct { image.surface(column, row) } else { None };
            pixels.push(surface.filter(|s| s.normal.dot(up).abs() <= least));
        }
    }
    let whole = image.sensor.columns_of_a_turn().is_some_and(|turn| (turn - f64::from(distinct)).abs() < 1e-6);
    let beside = |column: u32, row: u32| {
        let left = column.checked_sub(1).or(whole.then(|| distinct - 1));
        let right = Some(column + 1).filter(|c| *c < distinct).or(whole.then_some(0));
        let (above, below) = (row.checked_sub(1), Some(row + 1).filter(|r| *r < height));
        let in_row = [left, right].into_iter().flatten().map(move |c| (c, row));
        in_row.chain([above, below].into_iter().flatten().map(move |r| (column, r)))
    };
    let count = pixels.iter().flatten().count();
    let mut planes = Vec::new();
    let mut open = Vec::new();
    for start in 0..pixels.len() {
        let Some(first) = pixels[start].take() else { continue };
        let mut region = Region::new(first);
        open.push((start as u32 % width, start as u32 / width, first));
        while let Some((column, row, surface)) = open.pop() {
            region.add(&image, (column, row), &surface);
            for (c, r) in beside(column, row) {
                let at = image.at(c, r);
                let joins = |s: &VisiblePlane| image.hit(c, r, s).is_some_and(|p| in_one_plane(&region.surface, s, p));
                if let Some(surface) = pixels[at].filter(joins) {
                    pixels[at] = None;
                    open.push((c, r, surface));
                }
            }
        }
        planes.push(region.finish(&image));
    }
    planes.sort_by_key(|p| std::cmp::Reverse(p.pixels));
    Ok(VerticalPlanes { planes, pixels: count })
}

/// Returns true if a surface, at its visible point p, lies in the plane of another.
fn in_one_plane(plane: &VisiblePlane, other: &VisiblePlane, p: DVec3) -> bool {
    plane == other
        || plane.normal.dot(other.normal) >= PARALLEL && (plane.normal.dot(p) + plane.distance).abs() <= COPLANAR
}

impl Region {
    fn new(surface: VisiblePlane) -> Self {
        let (low, high) = ([f64::INFINITY; 2], [f64::NEG_INFINITY; 2]);
        let bounds = [u32::MAX, u32::MAX, 0, 0];
        Self { surface, pixels: 0, sum: DVec3::ZERO, low, high, area: 0.0, bounds, objects: Vec::new() }
    }

    /// Axes in the plane: horizontal and upward.
    fn axes(&self, up: DVec3) -> [DVec3; 2] {
        let across = up.cross(self.surface.normal).normalize();
        [across, self.surface.normal.cross(across)]
    }

    fn add(&mut self, image: &Pixels<'_>, (column, row): (u32, u32), surface: &VisiblePlane) {
        let Some(p) = image.hit(column, row, surface) else { return };
        self.pixels += 1;
        self.sum += p;
        for (k, axis) in self.axes(image.up).into_iter().enumerate() {
            (self.low[k], self.high[k]) = (self.low[k].min(axis.dot(p)), self.high[k].max(axis.dot(p)));
        }
        let cosine = surface.normal.dot(p).abs() / p.length();
        self.area += solid_angle(image, column, row) * p.length_squared() / cosine;
        let [c0, r0, c1, r1] = self.bounds;
        self.bounds = [c0.min(column), r0.min(row), c1.max(column), r1.max(row)];
        match self.objects.iter_mut().find(|(object, _)| *object == surface.object) {
            Some((_, n)) => *n += 1,
            None => self.objects.push((surface.object, 1)),
        }
    }

    fn finish(self, image: &Pixels<'_>) -> VerticalPlane {
        let most = self.objects.iter().max_by_key(|(object, n)| (*n, std::cmp::Reverse(*object)));
        VerticalPlane {
            normal_robot: image.turned_to_robot(self.surface.normal),
            distance: self.surface.distance,
            centre_robot: image.in_robot(self.sum / self.pixels.max(1) as f64),
            extent: [0, 1].map(|k| (self.high[k] - self.low[k]).max(0.0)),
            pixels: self.pixels,
            area: (image.sensor.height() > 1).then_some(self.area),
            object: most.map_or(String::new(), |(object, _)| image.name(*object)),
            pixel_bounds: self.bounds,
        }
    }
}

/// Solid angle of a pixel from two spherical triangles (van Oosterom and Strackee); 0 if a corner has no ray.
fn solid_angle(image: &Pixels<'_>, column: u32, row: u32) -> f64 {
    let corner = |du: f64, dv: f64| image.ray_at(f64::from(column) + du, f64::from(row) + dv);
    let corners = [corner(-0.5, -0.5), corner(0.5, -0.5), corner(0.5, 0.5), corner(-0.5, 0.5)];
    let [Some(a), Some(b), Some(c), Some(d)] = corners else { return 0.0 };
    let triangle = |a: DVec3, b: DVec3, c: DVec3| {
        let across = a.dot(b.cross(c)).abs();
        2.0 * across.atan2(1.0 + a.dot(b) + b.dot(c) + c.dot(a))
    };
    triangle(a, b, c) + triangle(a, c, d)
}
