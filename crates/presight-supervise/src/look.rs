//! The view of one sensor on the cells of a corridor.

use super::grid::Cells;
use super::pixels::Readings;
use super::rays::SensorRays;
use super::state::UnseenReason;
use super::windows::{Windows, level_and_step};
use presight_model::geometry::Pose;
use presight_model::statistics::NOISE_BOUND;
use std::f32::consts::FRAC_1_SQRT_2;

/// Maximum number of pixels along a side of a window.
const MAX_SIDE: f32 = 255.0;

/// The view of one sensor on a cell.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CellView {
    /// `None` if the cell is free.
    pub unseen: Option<UnseenReason>,
    /// `None` if a ray reaches the centre.
    pub hidden: Option<UnseenReason>,
}

/// The image of a corner of cells.
#[derive(Clone, Copy)]
struct Corner {
    /// Column and row; NaN outside of the image.
    place: [f32; 2],
    /// Metres from the sensor.
    distance: f32,
    /// Height above the cone of a scanner's only row, metres.
    above: f32,
}

/// The image of a cell.
struct Patch {
    /// Range of columns.
    columns: [f32; 2],
    /// Range of rows.
    rows: [f32; 2],
    /// Distance beyond which rays must reach, metres.
    far: f32,
    /// Distance between rays there, across and down, metres.
    spacing: [f32; 2],
}

/// One sensor's view of the cells.
pub struct SensorView<'a> {
    pub rays: &'a SensorRays,
    readings: &'a Readings,
    windows: Windows<'a>,
    cells: &'a Cells,
    sensor_from_corridor: Pose,
    /// Standard deviation of the corridor's pose relative to the sensor, metres and radians.
    uncertainty: [f64; 2],
    smallest: f32,
    is_upright: bool,
    corners: Vec<Option<Corner>>,
}

impl<'a> SensorView<'a> {
    pub fn new(
        rays: &'a SensorRays,
        readings: &'a Readings,
        cells: &'a Cells,
        sensor_from_corridor: Pose,
        uncertainty: [f64; 2],
        (smallest, is_upright): (f64, bool),
    ) -> Self {
        let windows = Windows::new(&readings.through, rays.width, rays.is_closed);
        let corners = vec![None; cells.corner_count()];
        let smallest = smallest as f32;
        Self { rays, readings, windows, cells, sensor_from_corridor, uncertainty, smallest, is_upright, corners }
    }

    /// The view on a cell.
    pub fn cell(&mut self, cell: usize) -> CellView {
        let corners = self.cells.corners(cell).map(|number| self.corner(number));
        let fold =
            |of: fn(&Corner) -> f32, f: fn(f32, f32) -> f32| corners.iter().map(of).reduce(f).unwrap_or(f32::NAN);
        let (above, below) = (fold(|c| c.above, f32::max), fold(|c| c.above, f32::min));
        let out = CellView { unseen: Some(UnseenReason::OutOfView), hidden: Some(UnseenReason::OutOfView) };
        // A single row only sees cells that it intersects.
        if self.rays.only_row.is_some() && !(above >= 0.0 && below <= 0.0) {
            return out;
        }
        let hidden = self.hidden(cell);
        let Some(patch) = self.patch(&corners) else { return CellView { hidden, ..out } };
        let leaves_gap = self.rays.only_row.is_some() && !self.is_upright && above.max(-below) >= self.smallest;
        let unseen = match self.window_size(&patch).filter(|_| !leaves_gap) {
            Some(size) => self.blocked(&patch, size).map(|why| hidden.unwrap_or(why)),
            None => Some(hidden.unwrap_or(UnseenReason::BetweenRays)),
        };
        CellView { unseen, hidden }
    }

    fn corner(&mut self, number: usize) -> Corner {
        if let Some(known) = self.corners[number] {
            return known;
        }
        let p = self.sensor_from_corridor.transform_point(self.cells.corner(number));
        let place = self.rays.project(p).unwrap_or([f32::NAN; 2]);
        let above = self.rays.only_row.map_or(0.0, |tangent| p.z - f64::from(tangent) * p.x.hypot(p.y)) as f32;
        *self.corners[number].insert(Corner { place, distance: p.length() as f32, above })
    }

    /// The reason why no ray reaches the centre of a cell; `None` if a ray does.
    fn hidden(&self, cell: usize) -> Option<UnseenReason> {
        let p = self.sensor_from_corridor.transform_point(self.cells.middle(cell));
        let Some(at) = self.rays.project(p).and_then(|place| self.rays.pixel(place)) else {
            return Some(UnseenReason::OutOfView);
        };
        (f64::from(self.readings.measured[at]) <= p.length()).then_some(self.readings.behind[at])
    }

    /// The image of a cell; `None` if a part of the cell is outside.
    fn patch(&self, corners: &[Corner; 8]) -> Option<Patch> {
        let turn = self.rays.is_closed.then_some(self.rays.width as f32);
        let first = corners[0].place[0];
        let (mut columns, mut rows) = ([f32::INFINITY, f32::NEG_INFINITY], [f32::INFINITY, f32::NEG_INFINITY]);
        let mut far = 0.0f32;
        for corner in corners {
            let [mut u, v] = corner.place;
            if u.is_nan() {
                return None;
            }
            if let Some(turn) = turn {
                u -= turn * ((u - first) / turn).round();
            }
            (columns, rows) = ([columns[0].min(u), columns[1].max(u)], [rows[0].min(v), rows[1].max(v)]);
            far = far.max(corner.distance);
        }
        // All columns of a scanner meet at its axis.
        if turn.is_some_and(|turn| columns[1] - columns[0] > 0.5 * turn) {
            return None;
        }
        let middle = [0.5 * (columns[0] + columns[1]), 0.5 * (rows[0] + rows[1])];
        let limits = [self.rays.width, self.rays.height].map(|n| n as f32 - 1.0);
        let nearest = |i: usize| if i == 0 && turn.is_some() { middle[i] } else { middle[i].clamp(0.0, limits[i]) };
        let spacing = self.rays.spacing[self.rays.pixel([nearest(0), nearest(1)])?];
        let off = (NOISE_BOUND * (self.uncertainty[0] + self.uncertainty[1] * f64::from(far))) as f32;
        far += off;
        let spacing = [far * spacing[0], if self.rays.only_row.is_some() { 0.0 } else { far * spacing[1] }];
        if off > 0.0 {
            let by = spacing.map(|spacing| if spacing > 0.0 { off / spacing } else { 0.0 });
            (columns, rows) = ([columns[0] - by[0], columns[1] + by[0]], [rows[0] - by[1], rows[1] + by[1]]);
        }
        Some(Patch { columns, rows, far, spacing })
    }

    /// Size in pixels of the largest window that fits into a disc as wide as the smallest intruder. `None` for a window
    /// with less than two pixels.
    fn window_size(&self, patch: &Patch) -> Option<[usize; 2]> {
        let [across, down] = patch.spacing;
        let rows = match (FRAC_1_SQRT_2 * self.smallest / down).floor() {
            _ if self.rays.only_row.is_some() => 1.0,
            rows if rows >= 1.0 => rows.min(MAX_SIDE),
            _ if down < self.smallest => 1.0,
            _ => return None,
        };
        let left = self.smallest * self.smallest - (rows * down) * (rows * down);
        let columns = (left.max(0.0).sqrt() / across).floor().min(MAX_SIDE);
        (columns >= 1.0 && rows * columns >= 2.0).then_some([columns as usize, rows as usize])
    }

    /// The reason why rays do not pass a part of a patch; `None` if two rays pass in every window whose centre is in
    /// the patch.
    fn blocked(&mut self, patch: &Patch, [across, down]: [usize; 2]) -> Option<UnseenReason> {
        let ((a, step_u), (b, step_v)) = (level_and_step(across), level_and_step(down));
        let starts = |[from, to]: [f32; 2], size: usize| {
            let half = 0.5 * size as f32;
            ((from - half).ceil() as i64, (to - half).ceil() as i64)
        };
        let ((u0, u1), (v0, v1)) = (starts(patch.columns, across), starts(patch.rows, down));
        let mut v = v0;
        loop {
            let mut u = u0;
            loop {
                if self.windows.second([a, b], u, v) <= patch.far {
                    return Some(self.why([u, v], [1 << a, 1 << b], patch.far));
                }
                if u >= u1 {
                    break;
                }
                u += step_u as i64;
            }
            if v >= v1 {
                return None;
            }
            v += step_v as i64;
        }
    }

    /// The reason of the first ray of a window that does not pass.
    fn why(&self, [u, v]: [i64; 2], [across, down]: [i64; 2], far: f32) -> UnseenReason {
        let pixels = (v..v + down).flat_map(|v| (u..u + across).map(move |u| [u as f32, v as f32]));
        let blocked = |place| match self.rays.pixel(place) {
            None => Some(UnseenReason::OutOfView),
            Some(at) => (self.readings.through[at] <= far).then_some(self.readings.behind[at]),
        };
        pixels.filter_map(blocked).next().unwrap_or(UnseenReason::BetweenRays)
    }
}
