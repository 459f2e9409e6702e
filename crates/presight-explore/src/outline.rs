//! Outlines of planes: where rays ended on them, and not where rays went through or nobody looked.

use crate::convex::convex;
use crate::evidence::{Evidence, Margins, evidence};
use crate::field::{Cells, area, simplified};
use crate::flat::Flat;
use crate::surfel::Surface;
use crate::view::Views;
use glam::{DVec2, DVec3};
use rayon::prelude::*;

/// Cells this far around a surfel are looked at, in its sizes.
const REACH: f64 = 2.0;
/// Ends of a plane go to the common line with another plane if they are this near to it, in sizes of surfels.
const CORNER: f64 = 0.8;
/// Surfels of the other plane must be this near then, in sizes.
const BESIDE: f64 = 2.5;
/// Least sine between planes that have a common line: 20 degrees.
const LEAST_ANGLE: f64 = 0.34;
/// Smallest piece, in areas of a cell.
const LEAST_CELLS: f64 = 2.0;

/// A convex polygon on a plane.
#[derive(Clone, Debug)]
pub(crate) struct Piece {
    /// Number of the plane.
    pub plane: u32,
    /// Relative to the base of the views, counter-clockwise as seen from the side of the normal.
    pub corners: Vec<DVec3>,
}

impl Piece {
    /// Square metres.
    pub fn area(&self) -> f64 {
        let c = &self.corners;
        let sum: DVec3 = (1..c.len() - 1).map(|k| (c[k] - c[0]).cross(c[k + 1] - c[0])).sum();
        0.5 * sum.length()
    }
}

/// How outlines are found.
#[derive(Clone, Copy, Debug)]
pub(crate) struct OutlineOptions {
    /// Side of a cell in sizes of the plane's surfels.
    pub cell: f64,
    /// How far outlines may be simplified, in cells.
    pub tolerance: f64,
}

/// Area by what rays say, square metres.
#[derive(Clone, Copy, Debug, Default)]
pub struct Areas {
    /// Explored: rays ended there.
    pub surface: f64,
    /// Next to explored surfaces: rays went through.
    pub open: f64,
    /// Next to explored surfaces: nobody looked.
    pub unseen: f64,
}

impl Areas {
    pub(crate) fn add(&mut self, other: &Self) {
        self.surface += other.surface;
        self.open += other.open;
        self.unseen += other.unseen;
    }
}

/// What one plane shows.
pub(crate) struct Outline {
    pub pieces: Vec<Piece>,
    pub areas: Areas,
    /// Middles of cells next to the surface that nobody saw, and the side of a cell.
    pub unseen: (Vec<DVec3>, f64),
    /// Rays that ended on the surface, and that went through it, by weight.
    pub evidence: [f64; 2],
}

/// The outlines of all planes. `members` are the surfels of each.
pub(crate) fn outlines(
    views: &Views,
    surface: &Surface,
    planes: &[Flat],
    members: &[Vec<u32>],
    labels: &[u32],
    options: OutlineOptions,
) -> Vec<Outline> {
    let outline = |plane: usize| {
        let corners = Corners { surface, planes, labels, plane: plane as u32 };
        outline(views, &corners, &members[plane], options)
    };
    (0..planes.len()).into_par_iter().map(outline).collect()
}

fn outline(views: &Views, corners: &Corners<'_>, members: &[u32], options: OutlineOptions) -> Outline {
    let (plane, surfels) = (&corners.planes[corners.plane as usize], &corners.surface.surfels);
    let nothing =
        || Outline { pieces: Vec::new(), areas: Areas::default(), unseen: (Vec::new(), 0.0), evidence: [0.0; 2] };
    let mut sizes: Vec<f64> = members.iter().map(|m| surfels[*m as usize].size).collect();
    let Some(size) = presight_model::statistics::median(&mut sizes).filter(|_| members.len() > 1) else {
        return nothing();
    };
    let places: Vec<(DVec2, f64)> =
        members.iter().map(|m| (plane.place(surfels[*m as usize].at), REACH * surfels[*m as usize].size)).collect();
    let first = places[0].0;
    let around = |(a, b): (DVec2, DVec2), (q, reach): &(DVec2, f64)| (a.min(*q - *reach), b.max(*q + *reach));
    let (least, most) = places.iter().fold((first, first), around);
    let cells = Cells::covering(least, most, options.cell * size);
    let mut near = vec![false; cells.len()];
    places.iter().for_each(|(q, reach)| cells.mark(&mut near, *q, *reach));
    let looked: Vec<usize> = (0..cells.len()).filter(|c| near[*c]).collect();
    let middles: Vec<DVec2> = looked.iter().map(|c| cells.middle(*c)).collect();
    let seen = evidence(views, plane, &middles, Margins::of_cell(cells.side));
    let mut field = vec![-1.0; cells.len()];
    for (cell, seen) in looked.iter().zip(&seen) {
        field[*cell] = seen.value();
    }
    let field = cells.smoothed(&field);
    let mut found = nothing();
    count(&mut found, plane, &cells, (&looked, &middles, &seen), &field);
    let least_area = LEAST_CELLS * cells.side * cells.side;
    let tolerance = options.tolerance * cells.side;
    let lines = cells.contours(&field).into_iter().map(|mut line| {
        line.iter_mut().for_each(|q| *q = corners.closed(*q, size));
        simplified(&line, tolerance)
    });
    let lines: Vec<Vec<DVec2>> = lines.filter(|line| line.len() > 2 && area(line).abs() > least_area).collect();
    let polygons = convex(&lines).into_iter();
    let in_space = |polygon: Vec<DVec2>| polygon.iter().map(|q| plane.point(*q)).collect();
    found.pieces = polygons.map(|p| Piece { plane: corners.plane, corners: in_space(p) }).collect();
    found
}

/// Sums areas and evidence, and keeps the cells that nobody saw.
fn count(
    found: &mut Outline,
    plane: &Flat,
    cells: &Cells,
    (looked, middles, seen): (&[usize], &[DVec2], &[Evidence]),
    field: &[f32],
) {
    let one = cells.side * cells.side;
    for ((cell, middle), seen) in looked.iter().zip(middles).zip(seen) {
        if field[*cell] > 0.0 {
            found.areas.surface += one;
            found.evidence[0] += f64::from(seen.hit);
            found.evidence[1] += f64::from(seen.pass);
        } else if seen.pass > 0.0 {
            found.areas.open += one;
        } else if seen.hits == 0 {
            found.areas.unseen += one;
            found.unseen.0.push(plane.point(*middle));
        }
    }
    found.unseen.1 = cells.side;
}

/// Where a plane meets others.
struct Corners<'a> {
    surface: &'a Surface,
    planes: &'a [Flat],
    labels: &'a [u32],
    plane: u32,
}

impl Corners<'_> {
    /// A point of the outline, on the common line with a neighbouring plane if it is near one, so that corners close.
    fn closed(&self, q: DVec2, size: f64) -> DVec2 {
        let own = &self.planes[self.plane as usize];
        let p = own.point(q);
        let mut others: Vec<u32> = self.surface.near(p, BESIDE * size).map(|s| self.labels[s as usize]).collect();
        others.sort_unstable();
        others.dedup();
        let [x, y] = own.axes();
        let mut lines: Vec<(f64, DVec2)> = Vec::new();
        for other in others.iter().filter(|o| **o != self.plane) {
            let other = &self.planes[*other as usize];
            let across = DVec2::new(other.normal.dot(x), other.normal.dot(y));
            let sine = across.length();
            if sine > LEAST_ANGLE {
                let way = -other.above(p) / (sine * sine) * across;
                lines.push((way.length(), way));
            }
        }
        let nearest = lines.into_iter().filter(|(off, _)| *off < CORNER * size).min_by(|a, b| a.0.total_cmp(&b.0));
        nearest.map_or(q, |(_, way)| q + way)
    }
}
