//! Scalar fields on the cells of a plane, and the lines along which they are zero.

use glam::DVec2;
use std::collections::HashMap;

/// Maximum number of cells on a plane, which bounds their memory to 64 MiB a field. Larger planes get larger cells.
const MAX_CELLS: f64 = 1.6e7;

/// Square cells in a plane, row by row.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Cells {
    /// Outer corner of the first cell, metres.
    pub corner: DVec2,
    /// Side of a cell, metres.
    pub side: f64,
    pub width: usize,
    pub height: usize,
}

impl Cells {
    /// Cells of about the given side, metres, that cover a rectangle with a margin of two cells.
    pub fn covering((min, max): (DVec2, DVec2), side: f64) -> Self {
        let size = max - min;
        let side = side.max((size.x * size.y / MAX_CELLS).sqrt()).max(size.max_element() / 1e6);
        let corner = min - 2.0 * side;
        let count = |length: f64| (length / side).ceil() as usize + 4;
        Self { corner, side, width: count(size.x), height: count(size.y) }
    }

    pub fn len(&self) -> usize {
        self.width * self.height
    }

    /// The column and row of a point, which must lie on the cells.
    pub fn cell(&self, q: DVec2) -> (usize, usize) {
        let at = (q - self.corner) / self.side;
        ((at.x as usize).min(self.width - 1), (at.y as usize).min(self.height - 1))
    }

    /// The middle of a cell.
    pub fn middle(&self, cell: usize) -> DVec2 {
        let at = DVec2::new((cell % self.width) as f64, (cell / self.width) as f64);
        self.corner + (at + 0.5) * self.side
    }

    /// Marks the cells whose middles are within a distance of a point.
    pub fn mark(&self, marked: &mut [bool], q: DVec2, distance: f64) {
        let reach = (distance / self.side).ceil() as usize;
        let (column, row) = self.cell(q);
        for y in row.saturating_sub(reach)..=(row + reach).min(self.height - 1) {
            for x in column.saturating_sub(reach)..=(column + reach).min(self.width - 1) {
                let cell = y * self.width + x;
                if !marked[cell] && self.middle(cell).distance_squared(q) < distance * distance {
                    marked[cell] = true;
                }
            }
        }
    }

    /// The field blurred by a normal distribution of 0.7 cells.
    pub fn smoothed(&self, field: &[f32]) -> Vec<f32> {
        const KERNEL: [f32; 3] = [0.5698, 0.2054, 0.009_70];
        let along = |field: &[f32], step: usize, count: usize, place: fn(usize, usize) -> usize, width: usize| {
            let blurred = |cell: usize| {
                let at = place(cell, width);
                let value = |off: isize| {
                    let to = (at as isize + off).clamp(0, count as isize - 1);
                    field[(cell as isize + (to - at as isize) * step as isize) as usize]
                };
                KERNEL[0] * value(0) + KERNEL[1] * (value(-1) + value(1)) + KERNEL[2] * (value(-2) + value(2))
            };
            (0..field.len()).map(blurred).collect::<Vec<f32>>()
        };
        let rows = along(field, 1, self.width, |cell, width| cell % width, self.width);
        along(&rows, self.width, self.height, |cell, width| cell / width, self.width)
    }

    /// Closed lines around the cells at which a field is positive, which lie on the left of the lines. The field must
    /// be negative at the outer cells. The lines come from marching squares between the middles of cells. If only two
    /// opposite corners of a square are positive, the sign of the mean decides whether they are connected.
    pub fn contours(&self, field: &[f32]) -> Vec<Vec<DVec2>> {
        let next = self.steps(field);
        let mut starts: Vec<u64> = next.keys().copied().collect();
        starts.sort_unstable();
        let mut done = std::collections::HashSet::new();
        let mut loops = Vec::new();
        for start in starts {
            if done.contains(&start) {
                continue;
            }
            let (mut line, mut edge) = (Vec::new(), start);
            while done.insert(edge) {
                line.push(self.crossing(field, edge));
                let Some(to) = next.get(&edge) else { break };
                edge = *to;
            }
            loops.push(line);
        }
        loops
    }

    /// The next edge on the line, for each edge between two middles that a line crosses. Edge 2 c leads from cell c to
    /// the right, edge 2 c + 1 to the next row.
    fn steps(&self, field: &[f32]) -> HashMap<u64, u64> {
        let mut next = HashMap::new();
        for row in 0..self.height - 1 {
            for column in 0..self.width - 1 {
                let cell = row * self.width + column;
                let corners = [cell, cell + 1, cell + self.width + 1, cell + self.width];
                let inside = corners.map(|c| field[c] > 0.0);
                if inside.iter().all(|i| *i == inside[0]) {
                    continue;
                }
                let [c, right, _, above] = corners.map(|c| c as u64);
                // Edges of the square, counter-clockwise: edge k leads from corner k to corner k + 1.
                let edges = [2 * c, 2 * right + 1, 2 * above, 2 * c + 1];
                let mean: f32 = corners.iter().map(|c| field[*c]).sum();
                let is_saddle = inside[0] == inside[2] && inside[1] == inside[3];
                for k in 0..4 {
                    // Counter-clockwise along the border, the line enters where the border leaves the positive part.
                    if !inside[k] || inside[(k + 1) % 4] {
                        continue;
                    }
                    // It ends where the border enters the positive part: before this edge if the parts are separate.
                    let ends = |e: &usize| !inside[*e] && inside[(*e + 1) % 4];
                    let order = if is_saddle && mean <= 0.0 { [3, 2, 1] } else { [1, 2, 3] };
                    let end = order.map(|o| (k + o) % 4).into_iter().find(ends);
                    if let Some(end) = end {
                        next.insert(edges[k], edges[end]);
                    }
                }
            }
        }
        next
    }

    /// The zero of the field on an edge, by linear interpolation.
    fn crossing(&self, field: &[f32], edge: u64) -> DVec2 {
        let cell = (edge / 2) as usize;
        let other = if edge.is_multiple_of(2) { cell + 1 } else { cell + self.width };
        let (a, b) = (f64::from(field[cell]), f64::from(field[other]));
        self.middle(cell).lerp(self.middle(other), (a / (a - b)).clamp(0.01, 0.99))
    }
}

/// Signed area, positive if counter-clockwise.
pub(crate) fn area(line: &[DVec2]) -> f64 {
    let n = line.len();
    0.5 * (0..n).map(|k| (line[k] - line[0]).perp_dot(line[(k + 1) % n] - line[0])).sum::<f64>()
}

/// A closed line with fewer corners, within `tolerance` of all the dropped ones (Ramer, Douglas and Peucker).
pub(crate) fn simplified(line: &[DVec2], tolerance: f64) -> Vec<DVec2> {
    let farthest = |from: DVec2| {
        (0..line.len()).max_by(|a, b| line[*a].distance_squared(from).total_cmp(&line[*b].distance_squared(from)))
    };
    let Some(first) = line.first().and_then(|p| farthest(*p)) else { return Vec::new() };
    let turned: Vec<DVec2> = line[first..].iter().chain(&line[..=first]).copied().collect();
    let opposite = farthest(line[first]).map_or(0, |o| (o + line.len() - first) % line.len());
    let mut kept = vec![false; turned.len()];
    (kept[0], kept[opposite]) = (true, true);
    let mut parts = vec![(0, opposite), (opposite, turned.len() - 1)];
    while let Some((a, b)) = parts.pop() {
        let off = |k: usize| off_segment(turned[k], turned[a], turned[b]);
        let Some(worst) = (a + 1..b).max_by(|i, j| off(*i).total_cmp(&off(*j))) else { continue };
        if off(worst) > tolerance {
            kept[worst] = true;
            parts.extend([(a, worst), (worst, b)]);
        }
    }
    (0..turned.len() - 1).filter(|k| kept[*k]).map(|k| turned[k]).collect()
}

/// Distance of a point from a segment.
pub(crate) fn off_segment(p: DVec2, a: DVec2, b: DVec2) -> f64 {
    let along = b - a;
    let share = ((p - a).dot(along) / along.length_squared().max(1e-300)).clamp(0.0, 1.0);
    p.distance(a + along * share)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The outer line of a frame of cells runs counter-clockwise, the line of its hole clockwise (worked out by hand).
    #[test]
    fn a_hole_has_its_own_line() {
        let cells = Cells { corner: DVec2::ZERO, side: 1.0, width: 7, height: 7 };
        let inside = |cell: usize| {
            let (x, y) = (cell % 7, cell / 7);
            (1..=5).contains(&x) && (1..=5).contains(&y) && (x, y) != (3, 3)
        };
        let field: Vec<f32> = (0..49).map(|c| if inside(c) { 1.0 } else { -1.0 }).collect();
        let mut areas: Vec<f64> = cells.contours(&field).iter().map(|line| area(line)).collect();
        areas.sort_by(f64::total_cmp);
        // Corners are cut off by an eighth of a cell each; the hole is a diamond.
        assert_eq!(areas, [-0.5, 24.5]);
        let filled: Vec<f32> = (0..49).map(|c| if inside(c) || c == 24 { 1.0 } else { -1.0 }).collect();
        assert_eq!(cells.contours(&filled).len(), 1, "planted: a filled hole");
    }

    /// A square of side 10 with notches in two sides, the corners counted by hand.
    #[test]
    fn simplified_lines_keep_corners_beyond_the_tolerance() {
        let line = [[0.0, 0.0], [5.0, 0.05], [10.0, 0.0], [10.0, 10.0], [5.0, 8.0], [0.0, 10.0]].map(DVec2::from);
        assert_eq!(simplified(&line, 0.1).len(), 5);
        assert_eq!(simplified(&line, 3.0).len(), 4);
        assert_eq!(simplified(&line, 0.01).len(), 6);
    }
}
