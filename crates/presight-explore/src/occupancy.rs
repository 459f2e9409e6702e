//! Occupancy grids for planners: YAML and PGM as the map_server of nav2 reads them.
//!
//! A cell is occupied if a surface between two heights above the floor reaches into it. It is free if a floor covers it
//! completely and it is not occupied. It is unknown otherwise, and where a mark records an unobserved space. The floor
//! is one level of [`HeightField`]; heights count from the floor of each cell, so that ramps and steps belong to it.

use glam::{DVec2, DVec3};
use presight_model::environment::{Environment, MarkKind, Object};
use presight_model::error::{Error, Result};
use presight_model::floor::{FieldOptions, GridFrame, HeightField, Level, Mobility};
use presight_model::geometry::Aabb;

/// Maximum number of cells of a grid: 250 x 250 m in cells of 5 cm. It bounds the file to 25 MB, and the memory to 1 GB
/// for each floor above another.
pub const MAX_CELLS: f64 = 2.5e7;

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
        /// Height of the floor, metres; `None` for the lowest large level with free room above.
        floor: Option<f64> = None, with_floor;
        /// Number of the level from 1, by rising height, as in [`Grid::levels`]; `None` for the one at `floor`.
        level: Option<usize> = None, with_level;
        /// Maximum slope of a floor, degrees.
        slope_deg: f64 = Mobility::default().slope_deg, with_slope_deg;
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
        if !(0.0 <= low && low < high && low.is_finite() && high.is_finite() && self.floor.is_none_or(f64::is_finite)) {
            let what = format!("`GridOptions::from_height` of {low} m and `GridOptions::to_height` of {high} m");
            return Err(Error::usage(what, "give finite heights above the floor, the lower one first"));
        }
        if !self.mobility().is_sound() {
            let what = format!("a `GridOptions::slope_deg` of {}", self.slope_deg);
            return Err(Error::usage(what, "give 0 to 60 degrees"));
        }
        Ok(())
    }

    /// The robot: its step is at most the height from which obstacles count.
    fn mobility(&self) -> Mobility {
        let step = self.from_height.clamp(0.0, Mobility::default().step);
        Mobility::default().with_step(step).with_height(self.to_height).with_slope_deg(self.slope_deg)
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
    /// Height of the floor, metres in the world: the most frequent height of its level.
    pub floor: f64,
    /// Levels of the scene by rising height, without levels much smaller than the largest one.
    pub levels: Vec<Level>,
    /// Number of the level of this grid from 1, if it is in the list.
    pub level: Option<usize>,
    /// Row by row, with rising y.
    pub cells: Vec<Cell>,
    /// Height of the floor in each cell, metres; without a floor, that of a nearest cell.
    heights: Vec<f64>,
    options: GridOptions,
}

impl Grid {
    /// The grid of an environment.
    ///
    /// # Errors
    /// [`presight_model::ErrorKind::Usage`] for cells, heights and slopes that are not finite or not in order, and for
    /// a level that does not exist; [`presight_model::ErrorKind::Invalid`] without polygons, for more than
    /// [`MAX_CELLS`] cells, and for too many floors above one another.
    pub fn of(environment: &Environment, options: &GridOptions) -> Result<Self> {
        options.check()?;
        let polygons = polygons(environment);
        let bounds = Aabb::of(polygons.iter().flatten().copied());
        if bounds.is_empty() {
            return Err(Error::invalid("the scene has no polygons", "give a scene with surfaces"));
        }
        let frame = frame(&bounds, options.cell)?;
        let field_options =
            FieldOptions::default().with_mobility(options.mobility()).with_from_height(options.from_height);
        let field = HeightField::new(&polygons, frame, &field_options)?;
        let (numbers, levels): (Vec<usize>, Vec<Level>) = field.levels().into_iter().unzip();
        let chosen = match options.level {
            Some(number) => {
                Some(numbers.get(number.wrapping_sub(1)).copied().ok_or_else(|| no_level(number, &levels))?)
            }
            None => options.floor.map_or_else(|| field.default_level(), |height| field.level_at(height)),
        };
        let floor = chosen.map(|level| field.level(level).height).or(options.floor).unwrap_or(bounds.min.z);
        let GridFrame { origin, cell, width, height } = frame;
        let mut grid = Self {
            width,
            height,
            cell,
            origin,
            floor,
            levels,
            level: chosen.and_then(|level| numbers.iter().position(|number| *number == level)).map(|k| k + 1),
            cells: vec![Cell::Unknown; frame.count()],
            heights: chosen.map_or_else(|| vec![floor; frame.count()], |level| field.heights(level)),
            options: *options,
        };
        for (cell, height) in grid.heights.iter().enumerate().filter(|_| chosen.is_some()) {
            if field.is_free(cell, *height) {
                grid.cells[cell] = Cell::Free;
            }
        }
        let heights = grid.heights.iter().copied();
        let (lowest, highest) = heights.fold((f64::INFINITY, f64::NEG_INFINITY), |(a, b), z| (a.min(z), b.max(z)));
        let reaches = |polygon: &&Vec<DVec3>| {
            polygon.iter().any(|p| p.z >= lowest + options.from_height)
                && polygon.iter().any(|p| p.z <= highest + options.to_height)
        };
        for polygon in polygons.iter().filter(reaches) {
            grid.paint(&frame, polygon, options.from_height, |cell| {
                if *cell == Cell::Unknown {
                    *cell = Cell::Occupied;
                }
            });
        }
        grid.mark_unseen(environment, &frame);
        Ok(grid)
    }

    /// The mask of this grid for nav2's keepout filter: cells are occupied where an object or a part of it that is
    /// marked as uncertain is on the floor or in the obstacles' heights, and free everywhere else.
    #[must_use]
    pub fn keepout(&self, environment: &Environment) -> Self {
        let mut mask = Self { cells: vec![Cell::Free; self.cells.len()], ..self.clone() };
        let frame = GridFrame { origin: self.origin, cell: self.cell, width: self.width, height: self.height };
        let step = self.options.mobility().step;
        for (_, mark) in environment.marks().filter(|(_, mark)| mark.kind == MarkKind::Uncertain) {
            let Ok(index) = environment.index_of(&mark.object) else { continue };
            let object = &environment.objects()[index as usize];
            for polygon in 0..object.mesh.polygon_count() as u32 {
                let within = mark.bounds.is_none_or(|b| meets(object, polygon, &b));
                if within && !environment.is_absent(index, polygon, None) {
                    // From a step below the floor: the robot must not drive where the floor may be missing.
                    mask.paint(&frame, &object.polygon_in_world(polygon), -step, |cell| *cell = Cell::Occupied);
                }
            }
        }
        mask
    }

    /// Marks the cells of unobserved spaces between the heights as unknown.
    fn mark_unseen(&mut self, environment: &Environment, frame: &GridFrame) {
        for (_, mark) in environment.marks().filter(|(_, mark)| mark.kind == MarkKind::Unseen) {
            let (Some(object), Some(b)) = (environment.object(&mark.object), mark.bounds) else { continue };
            let b = b.transformed(&object.world_from_object.to_affine());
            let bottom = [b.min, b.max.with_y(b.min.y), b.max, b.min.with_y(b.max.y)].map(|p| p.with_z(b.min.z));
            let (cells, heights, options) = (&mut self.cells, &self.heights, &self.options);
            frame.each_touched(&bottom, |cell, _, _| {
                let (low, high) = (heights[cell] + options.from_height, heights[cell] + options.to_height);
                if b.max.z >= low && b.min.z <= high && cells[cell] == Cell::Free {
                    cells[cell] = Cell::Unknown;
                }
            });
        }
    }

    /// Calls `set` with each cell in which a convex polygon reaches into the heights from `from` above the floor on.
    fn paint(&mut self, frame: &GridFrame, polygon: &[DVec3], from: f64, mut set: impl FnMut(&mut Cell)) {
        let (cells, heights, to) = (&mut self.cells, &self.heights, self.options.to_height);
        frame.each_touched(polygon, |cell, low, high| {
            if high >= heights[cell] + from && low <= heights[cell] + to {
                set(&mut cells[cell]);
            }
        });
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

/// Cells aligned to multiples of their side, so that all grids of a scene share their cells.
fn frame(bounds: &Aabb, cell: f64) -> Result<GridFrame> {
    let first = (bounds.min.truncate() / cell).floor() - 1.0;
    let size = (bounds.max.truncate() / cell).ceil() + 1.0 - first;
    if size.x * size.y > MAX_CELLS {
        let what = format!("the grid has {:.0} x {:.0} cells; {MAX_CELLS:.0} are allowed", size.x, size.y);
        let min = 1.01 * cell * (size.x * size.y / MAX_CELLS).sqrt();
        return Err(Error::invalid(what, format!("use a `GridOptions::cell` of at least {min:.6} m")));
    }
    Ok(GridFrame { origin: first * cell, cell, width: size.x as usize, height: size.y as usize })
}

fn no_level(number: usize, levels: &[Level]) -> Error {
    let heights: Vec<String> = levels.iter().map(|level| format!("{:.3}", level.height)).collect();
    let remedy = match heights.len() {
        0 => "the scene has no level surface with free room above".to_owned(),
        n => format!("give 1 to {n}, for floors at {} m", heights.join(", ")),
    };
    Error::usage(format!("there is no level {number}"), remedy)
}

/// True if the box of a polygon meets a box in the frame of its object.
fn meets(object: &Object, polygon: u32, bounds: &Aabb) -> bool {
    let own = Aabb::of(object.mesh.corners_of(polygon).map(|p| object.object_from_mesh.transform_point3(p)));
    own.min.cmple(bounds.max).all() && own.max.cmpge(bounds.min).all()
}
