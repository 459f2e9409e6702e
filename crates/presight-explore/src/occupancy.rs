//! Occupancy grids for planners: YAML and PGM as the map_server of nav2 reads them.
//!
//! A cell is occupied if a surface between two heights above the floor reaches into it, free if a floor covers all of it
//! and nothing is in the way, and unknown otherwise: where no floor is known, and where a mark says that nobody looked.

use glam::{DVec2, DVec3};
use presight_model::environment::{Environment, MarkKind};
use presight_model::error::{Error, Result};
use presight_model::geometry::Aabb;

/// Most cells of a grid.
pub const MOST_CELLS: f64 = 1e8;
/// Surfaces that lean by less are floors: cosine.
const LEVEL: f64 = 0.97;
/// A floor may be this uneven, metres.
const UNEVEN: f64 = 0.1;
/// Surfaces that touch a cell to within this reach into it, metres.
const TOUCH: f64 = 1e-6;

/// The state of a cell.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Cell {
    /// Nothing is in the way above a floor.
    Free,
    /// Something is in the way.
    Occupied,
    /// No floor is known, or nobody looked.
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

/// What a grid is made of.
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
pub struct GridOptions {
    /// Side of a cell, metres.
    pub cell: f64,
    /// Lowest height above the floor that is in the way, metres.
    pub from_height: f64,
    /// Highest one, metres.
    pub to_height: f64,
    /// Height of the floor, metres; `None` for the lowest large level surface.
    pub floor: Option<f64>,
}

impl Default for GridOptions {
    fn default() -> Self {
        Self { cell: 0.05, from_height: 0.1, to_height: 1.8, floor: None }
    }
}

presight_model::with_options!(
    GridOptions:
    with_cell cell: f64,
    with_from_height from_height: f64,
    with_to_height to_height: f64,
    with_floor floor: Option<f64>,
);

impl GridOptions {
    /// Checks the numbers.
    ///
    /// # Errors
    /// [`presight_model::ErrorKind::Usage`] for cells or heights that are not finite or not in order.
    pub fn check(&self) -> Result<()> {
        let options = self;
        if !(options.cell > 0.0 && options.cell.is_finite()) {
            let what = format!("a `GridOptions::cell` of {} m", options.cell);
            return Err(Error::usage(what, "give a finite length above 0, such as 0.05"));
        }
        let (low, high) = (options.from_height, options.to_height);
        if !(low < high && low.is_finite() && high.is_finite() && options.floor.is_none_or(f64::is_finite)) {
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
    /// Row by row from the least y.
    pub cells: Vec<Cell>,
}

impl Grid {
    /// The grid of an environment.
    ///
    /// # Errors
    /// [`presight_model::ErrorKind::Usage`] for cells or heights that are not finite or not in order;
    /// [`presight_model::ErrorKind::Invalid`] without polygons, and for more than [`MOST_CELLS`] cells.
    pub fn of(environment: &Environment, options: &GridOptions) -> Result<Self> {
        options.check()?;
        let polygons = polygons(environment);
        let floor = options.floor.unwrap_or_else(|| floor_of(&polygons));
        let bounds = Aabb::of(polygons.iter().flatten().copied());
        if bounds.is_empty() {
            return Err(Error::invalid("the scene has no polygons", "give a scene with surfaces"));
        }
        let cell = options.cell;
        // On whole cells, so that grids of one scene have their cells in common.
        let least = (bounds.min.truncate() / cell).floor() - 1.0;
        let size = (bounds.max.truncate() / cell).ceil() + 1.0 - least;
        if size.x * size.y > MOST_CELLS {
            let what = format!("the grid has {:.0} x {:.0} cells; {MOST_CELLS:.0} are allowed", size.x, size.y);
            let least = 1.01 * cell * (size.x * size.y / MOST_CELLS).sqrt();
            let remedy = format!("use a `GridOptions::cell` of at least {least:.6} m");
            return Err(Error::invalid(what, remedy));
        }
        let (width, height) = (size.x as usize, size.y as usize);
        let cells = vec![Cell::Unknown; width * height];
        let mut grid = Self { width, height, cell, origin: least * cell, floor, cells };
        grid.add_floors(&polygons);
        grid.forget_unseen(environment, options);
        let (low, high) = (floor + options.from_height, floor + options.to_height);
        for polygon in &polygons {
            let part = between(polygon, low, high);
            grid.paint(&part, Cell::Occupied);
        }
        Ok(grid)
    }

    /// Cells that floors cover. What several polygons cover together counts: corners of the cell, each on a floor.
    fn add_floors(&mut self, polygons: &[Vec<DVec3>]) {
        let (width, height) = (self.width + 1, self.height + 1);
        let mut covered = vec![false; width * height];
        for polygon in polygons.iter().filter(|p| is_floor(p, self.floor)) {
            let flat: Vec<DVec2> = polygon.iter().map(|p| (p.truncate() - self.origin) / self.cell).collect();
            let turn = if area(&flat) < 0.0 { -1.0 } else { 1.0 };
            let (least, most) = flat.iter().fold((flat[0], flat[0]), |(a, b), q| (a.min(*q), b.max(*q)));
            let is_inside = |q: DVec2| {
                let side = |k: usize| (flat[(k + 1) % flat.len()] - flat[k]).perp_dot(q - flat[k]) * turn;
                (0..flat.len()).all(|k| side(k) >= -1e-9)
            };
            for y in least.y.ceil().max(0.0) as usize..=(most.y.floor().max(0.0) as usize).min(height - 1) {
                for x in least.x.ceil().max(0.0) as usize..=(most.x.floor().max(0.0) as usize).min(width - 1) {
                    covered[y * width + x] |= is_inside(DVec2::new(x as f64, y as f64));
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

    /// Cells with a mark of what nobody saw between the heights.
    fn forget_unseen(&mut self, environment: &Environment, options: &GridOptions) {
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

    /// Paints each cell that a convex polygon or a segment reaches into.
    fn paint(&mut self, polygon: &[DVec2], with: Cell) {
        if polygon.is_empty() {
            return;
        }
        let flat: Vec<DVec2> = polygon.iter().map(|p| (*p - self.origin) / self.cell).collect();
        let slack = TOUCH / self.cell;
        let (least, most) = flat.iter().fold((flat[0], flat[0]), |(a, b), q| (a.min(*q), b.max(*q)));
        let first = (least - slack).floor().max(DVec2::ZERO);
        let last = (most + slack).floor().min(DVec2::new(self.width as f64, self.height as f64) - 1.0);
        for y in first.y as usize..=last.y.max(0.0) as usize {
            for x in first.x as usize..=last.x.max(0.0) as usize {
                if overlaps(&flat, DVec2::new(x as f64, y as f64), slack) {
                    self.cells[y * self.width + x] = with;
                }
            }
        }
    }

    /// The file of pixels: PGM (P5), the greatest y first.
    pub fn pgm(&self) -> Vec<u8> {
        let mut bytes = format!("P5\n{} {}\n255\n", self.width, self.height).into_bytes();
        bytes.extend(self.cells.chunks(self.width).rev().flatten().map(|cell| cell.grey()));
        bytes
    }

    /// The file that map_server opens; `image` is the name of the file of pixels.
    pub fn yaml(&self, image: &str) -> String {
        // 205 means (255 - 205) / 255 = 0.19608, which lies between the two.
        format!(
            "image: {image}\nmode: trinary\nresolution: {:?}\norigin: [{:?}, {:?}, 0.0]\nnegate: 0\noccupied_thresh: 0.65\n\
             free_thresh: 0.196\n",
            self.cell, self.origin.x, self.origin.y
        )
    }

    /// Number of cells of a kind.
    pub fn count(&self, kind: Cell) -> usize {
        self.cells.iter().filter(|c| **c == kind).count()
    }
}

fn polygons(environment: &Environment) -> Vec<Vec<DVec3>> {
    let live = environment.objects().iter().filter(|o| !o.is_deleted());
    live.flat_map(|o| (0..o.mesh.polygon_count() as u32).map(move |k| o.polygon_in_world(k))).collect()
}

/// Twice the vector of the area.
fn doubled(polygon: &[DVec3]) -> DVec3 {
    (1..polygon.len() - 1).map(|k| (polygon[k] - polygon[0]).cross(polygon[k + 1] - polygon[0])).sum()
}

fn is_level(polygon: &[DVec3]) -> bool {
    let area = doubled(polygon);
    area.z.abs() > LEVEL * area.length()
}

fn is_floor(polygon: &[DVec3], floor: f64) -> bool {
    is_level(polygon) && polygon.iter().all(|p| (p.z - floor).abs() < UNEVEN)
}

/// Height of the lowest level surface with a quarter of the area that the largest has.
fn floor_of(polygons: &[Vec<DVec3>]) -> f64 {
    let mut areas = std::collections::BTreeMap::<i64, f64>::new();
    for polygon in polygons.iter().filter(|p| is_level(p)) {
        let height = polygon.iter().map(|p| p.z).sum::<f64>() / polygon.len() as f64;
        *areas.entry((height / UNEVEN).round() as i64).or_default() += doubled(polygon).length();
    }
    let most = areas.values().fold(0.0, |a: f64, b| a.max(*b));
    let lowest = areas.iter().find(|(_, area)| **area >= 0.25 * most).map(|(height, _)| *height);
    let near = |p: &&Vec<DVec3>| is_level(p) && lowest.is_some_and(|l| (p[0].z / UNEVEN - l as f64).abs() < 1.0);
    let (sum, weight) = polygons.iter().filter(near).fold((0.0, 0.0), |(sum, weight), p| {
        let area = doubled(p).length();
        (sum + area * p.iter().map(|p| p.z).sum::<f64>() / p.len() as f64, weight + area)
    });
    // Without a level surface: the lowest point.
    let lowest = || polygons.iter().flatten().map(|p| p.z).fold(f64::INFINITY, f64::min);
    if weight > 0.0 { sum / weight } else { lowest() }
}

/// The part of a polygon between two heights, seen from above.
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

fn area(flat: &[DVec2]) -> f64 {
    (0..flat.len()).map(|k| flat[k].perp_dot(flat[(k + 1) % flat.len()])).sum()
}

/// True if a convex polygon, which may be as thin as a line, reaches into the unit square at a corner (separating axes).
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
