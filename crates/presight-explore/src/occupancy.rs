//! Occupancy grids for planners: YAML and PGM as the map_server of nav2 reads them.
//!
//! A cell is occupied if a surface between two heights above the floor reaches into it. It is free if a floor covers it
//! completely and it is not occupied. It is unknown otherwise, and where a mark records an unobserved space.

use crate::geometry::{area, bounds, doubled_area, is_inside};
use glam::{DVec2, DVec3};
use presight_model::environment::{Environment, MarkKind};
use presight_model::error::{Error, Result};
use presight_model::geometry::Aabb;

/// Maximum number of cells of a grid, which bounds its file to 100 MB.
pub const MAX_CELLS: f64 = 1e8;
/// Minimum cosine between the vertical and the normal of a level surface: 14 degrees.
const LEVEL: f64 = 0.97;
/// Maximum unevenness of a floor, metres.
const UNEVEN: f64 = 0.1;
/// Maximum distance between a cell and a surface that touches it, metres.
const TOUCH: f64 = 1e-6;

/// The state of a cell.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Cell {
    /// Floor without an obstacle above it.
    Free,
    /// Obstacle between the heights.
    Occupied,
    /// Unobserved cell, or cell without a floor.
    Unknown,
}

impl Cell {
    /// Its grey value in a trinary map.
    pub fn grey(self) -> u8 {
        match self {
            Self::Free => 254,
            Self::Occupied => 0,
            Self::Unknown => 205,
        }
    }
}

presight_model::options! {
    /// Resolution and heights of a grid.
    #[derive(Clone, Copy, Debug, PartialEq)]
    pub struct GridOptions {
        /// Side of a cell, metres.
        cell: f64 = 0.05, with_cell;
        /// Lower end of the obstacles' heights above the floor, metres.
        from_height: f64 = 0.1, with_from_height;
        /// Upper end of these heights, metres.
        to_height: f64 = 1.8, with_to_height;
        /// Height of the floor, metres; `None` for the lowest large level surface.
        floor: Option<f64> = None, with_floor;
    }
}

impl GridOptions {
    /// Checks the values.
    ///
    /// # Errors
    /// [`presight_model::ErrorKind::Usage`] for cells or heights that are not finite or not in order.
    pub fn check(&self) -> Result<()> {
        if !(self.cell > 0.0 && self.cell.is_finite()) {
            let what = format!("a `GridOptions::cell` of {} m", self.cell);
            return Err(Error::usage(what, "give a finite length above 0, such as 0.05"));
        }
        let (low, high) = (self.from_height, self.to_height);
        if !(low < high && low.is_finite() && high.is_finite() && self.floor.is_none_or(f64::is_finite)) {
            let what = format!("`GridOptions::from_height` of {low} m and `GridOptions::to_height` of {high} m");
            return Err(Error::usage(what, "give finite heights above the floor, the lower one first"));
        }
        Ok(())
    }
}

/// An occupancy grid.
#[derive(Clone, Debug)]
pub struct Grid {
    /// Columns, along x.
    pub width: usize,
    /// Rows, along y.
    pub height: usize,
    /// Side of a cell, metres.
    pub cell: f64,
    /// Outer corner of the first cell, metres in the world.
    pub origin: DVec2,
    /// Height of the floor, metres in the world.
    pub floor: f64,
    /// Row by row, with rising y.
    pub cells: Vec<Cell>,
}

impl Grid {
    /// The grid of an environment.
    ///
    /// # Errors
    /// [`presight_model::ErrorKind::Usage`] for cells or heights that are not finite or not in order;
    /// [`presight_model::ErrorKind::Invalid`] without polygons, and for more than [`MAX_CELLS`] cells.
    pub fn of(environment: &Environment, options: &GridOptions) -> Result<Self> {
        options.check()?;
        let polygons = polygons(environment);
        let floor = options.floor.unwrap_or_else(|| floor_of(&polygons));
        let bounds = Aabb::of(polygons.iter().flatten().copied());
        if bounds.is_empty() {
            return Err(Error::invalid("the scene has no polygons", "give a scene with surfaces"));
        }
        let cell = options.cell;
        // Aligned to multiples of the cell, so that all grids of a scene share their cells.
        let first = (bounds.min.truncate() / cell).floor() - 1.0;
        let size = (bounds.max.truncate() / cell).ceil() + 1.0 - first;
        if size.x * size.y > MAX_CELLS {
            let what = format!("the grid has {:.0} x {:.0} cells; {MAX_CELLS:.0} are allowed", size.x, size.y);
            let min = 1.01 * cell * (size.x * size.y / MAX_CELLS).sqrt();
            let remedy = format!("use a `GridOptions::cell` of at least {min:.6} m");
            return Err(Error::invalid(what, remedy));
        }
        let (width, height) = (size.x as usize, size.y as usize);
        let cells = vec![Cell::Unknown; width * height];
        let mut grid = Self { width, height, cell, origin: first * cell, floor, cells };
        grid.add_floors(&polygons);
        grid.mark_unseen(environment, options);
        let (low, high) = (floor + options.from_height, floor + options.to_height);
        for polygon in &polygons {
            let part = between(polygon, low, high);
            grid.paint(&part, Cell::Occupied);
        }
        Ok(grid)
    }

    /// Marks the cells that floors cover as free. A cell is covered if each of its corners lies on a floor polygon, so
    /// that several polygons can cover it together.
    fn add_floors(&mut self, polygons: &[Vec<DVec3>]) {
        let (width, height) = (self.width + 1, self.height + 1);
        let mut covered = vec![false; width * height];
        for polygon in polygons.iter().filter(|p| is_floor(p, self.floor)) {
            let mut flat: Vec<DVec2> = polygon.iter().map(|p| (p.truncate() - self.origin) / self.cell).collect();
            if area(&flat) < 0.0 {
                flat.reverse();
            }
            let (min, max) = bounds(flat.iter().copied());
            for y in min.y.ceil().max(0.0) as usize..=(max.y.floor().max(0.0) as usize).min(height - 1) {
                for x in min.x.ceil().max(0.0) as usize..=(max.x.floor().max(0.0) as usize).min(width - 1) {
                    covered[y * width + x] |= is_inside(DVec2::new(x as f64, y as f64), &flat, 1e-9);
                }
            }
        }
        for y in 0..self.height {
            for x in 0..self.width {
                let corners = [y * width + x, y * width + x + 1, (y + 1) * width + x, (y + 1) * width + x + 1];
                if corners.iter().all(|c| covered[*c]) {
                    self.cells[y * self.width + x] = Cell::Free;
                }
            }
        }
    }

    /// Marks the cells of unobserved spaces between the heights as unknown.
    fn mark_unseen(&mut self, environment: &Environment, options: &GridOptions) {
        let (low, high) = (self.floor + options.from_height, self.floor + options.to_height);
        for (_, mark) in environment.marks().filter(|(_, mark)| mark.kind == MarkKind::Unseen) {
            let (Some(object), Some(b)) = (environment.object(&mark.object), mark.bounds) else { continue };
            let b = b.transformed(&object.world_from_object.to_affine());
            if b.max.z < low || b.min.z > high {
                continue;
            }
            let corners = [b.min, b.max.with_y(b.min.y), b.max, b.min.with_y(b.max.y)];
            self.paint(&corners.map(DVec3::truncate), Cell::Unknown);
        }
    }

    /// Sets each cell that a convex polygon or a segment reaches into.
    fn paint(&mut self, polygon: &[DVec2], with: Cell) {
        if polygon.is_empty() {
            return;
        }
        let flat: Vec<DVec2> = polygon.iter().map(|p| (*p - self.origin) / self.cell).collect();
        let slack = TOUCH / self.cell;
        let (min, max) = bounds(flat.iter().copied());
        let first = (min - slack).floor().max(DVec2::ZERO);
        let last = (max + slack).floor().min(DVec2::new(self.width as f64, self.height as f64) - 1.0);
        for y in first.y as usize..=last.y.max(0.0) as usize {
            for x in first.x as usize..=last.x.max(0.0) as usize {
                if overlaps(&flat, DVec2::new(x as f64, y as f64), slack) {
                    self.cells[y * self.width + x] = with;
                }
            }
        }
    }

    /// The pixels as a PGM file (P5), with falling y.
    pub fn pgm(&self) -> Vec<u8> {
        let mut bytes = format!("P5\n{} {}\n255\n", self.width, self.height).into_bytes();
        bytes.extend(self.cells.chunks(self.width).rev().flatten().map(|cell| cell.grey()));
        bytes
    }

    /// The file that map_server opens; `image` is the name of the PGM file.
    pub fn yaml(&self, image: &str) -> String {
        // A grey value of 205 is the probability (255 - 205) / 255 = 0.19608, which lies between the thresholds.
        format!(
            "image: {}\nmode: trinary\nresolution: {:?}\norigin: [{:?}, {:?}, 0.0]\nnegate: 0\n\
             occupied_thresh: 0.65\nfree_thresh: 0.196\n",
            quoted_yaml(image),
            self.cell,
            self.origin.x,
            self.origin.y
        )
    }

    /// Number of cells in a state.
    pub fn count(&self, kind: Cell) -> usize {
        self.cells.iter().filter(|c| **c == kind).count()
    }
}

/// A double-quoted YAML scalar: in a plain one `#` begins a comment and `: ` a value.
fn quoted_yaml(text: &str) -> String {
    let mut quoted = String::from("\"");
    for c in text.chars() {
        match c {
            '"' | '\\' => quoted.extend(['\\', c]),
            c if c.is_control() => quoted += &format!("\\u{:04X}", u32::from(c)),
            c => quoted.push(c),
        }
    }
    quoted + "\""
}

/// The polygons that are not marked as absent for all sensors.
fn polygons(environment: &Environment) -> Vec<Vec<DVec3>> {
    environment
        .present_polygons()
        .map(|(object, k)| environment.objects()[object as usize].polygon_in_world(k))
        .collect()
}

fn is_level(polygon: &[DVec3]) -> bool {
    let area = doubled_area(polygon);
    area.z.abs() > LEVEL * area.length()
}

fn is_floor(polygon: &[DVec3], floor: f64) -> bool {
    is_level(polygon) && polygon.iter().all(|p| (p.z - floor).abs() < UNEVEN)
}

/// Height of the lowest level surface with at least a quarter of the area of the largest one; the height of the lowest
/// point without a level surface.
fn floor_of(polygons: &[Vec<DVec3>]) -> f64 {
    let mut areas = std::collections::BTreeMap::<i64, f64>::new();
    for polygon in polygons.iter().filter(|p| is_level(p)) {
        let height = polygon.iter().map(|p| p.z).sum::<f64>() / polygon.len() as f64;
        *areas.entry((height / UNEVEN).round() as i64).or_default() += doubled_area(polygon).length();
    }
    let max = areas.values().fold(0.0, |a: f64, b| a.max(*b));
    let lowest = areas.iter().find(|(_, area)| **area >= 0.25 * max).map(|(height, _)| *height);
    let near = |p: &&Vec<DVec3>| is_level(p) && lowest.is_some_and(|l| (p[0].z / UNEVEN - l as f64).abs() < 1.0);
    let (sum, weight) = polygons.iter().filter(near).fold((0.0, 0.0), |(sum, weight), p| {
        let area = doubled_area(p).length();
        (sum + area * p.iter().map(|p| p.z).sum::<f64>() / p.len() as f64, weight + area)
    });
    let lowest = || polygons.iter().flatten().map(|p| p.z).fold(f64::INFINITY, f64::min);
    if weight > 0.0 { sum / weight } else { lowest() }
}

/// The part of a polygon between two heights, projected on the floor.
fn between(polygon: &[DVec3], low: f64, high: f64) -> Vec<DVec2> {
    let cut = |points: Vec<DVec3>, above: &dyn Fn(DVec3) -> f64| {
        let mut kept = Vec::new();
        for k in 0..points.len() {
            let (a, b) = (points[k], points[(k + 1) % points.len()]);
            let (da, db) = (above(a), above(b));
            if da >= 0.0 {
                kept.push(a);
            }
            if (da > 0.0 && db < 0.0) || (da < 0.0 && db > 0.0) {
                kept.push(a + (b - a) * (da / (da - db)));
            }
        }
        kept
    };
    let part = cut(cut(polygon.to_vec(), &|p| p.z - low), &|p| high - p.z);
    part.into_iter().map(DVec3::truncate).collect()
}

/// True if a convex polygon, which may be as thin as a line, reaches into the unit square at a corner (separating
/// axes).
fn overlaps(polygon: &[DVec2], corner: DVec2, slack: f64) -> bool {
    let square = [corner, corner + DVec2::X, corner + DVec2::ONE, corner + DVec2::Y];
    let sides = (0..polygon.len()).map(|k| (polygon[(k + 1) % polygon.len()] - polygon[k]).perp());
    sides.chain([DVec2::X, DVec2::Y]).filter(|axis| axis.length_squared() > 1e-24).all(|axis| {
        let axis = axis.normalize();
        let span = |points: &[DVec2]| {
            let along = points.iter().map(|p| p.dot(axis));
            along.fold((f64::INFINITY, f64::NEG_INFINITY), |(a, b), x| (a.min(x), b.max(x)))
        };
        let (a, b) = (span(polygon), span(&square));
        a.0 <= b.1 + slack && b.0 <= a.1 + slack
    })
}
