//! Outlines of planes around the cells on which rays ended, without the cells that rays passed through and the
//! unobserved ones.

use crate::evidence::{Evidence, Fences, Margins, evidence};
use crate::geometry::{Cells, Flat, area, bounds, convex, doubled_area, simplified};
use crate::observe::Views;
use crate::surfels::Surface;
use glam::{DVec2, DVec3};
use rayon::prelude::*;
use std::collections::BTreeSet;

/// Radius around a surfel within which cells are tested, in its sizes.
const REACH: f64 = 2.0;
/// Maximum distance at which the border of a plane snaps to its common line with another plane, in sizes of surfels.
const CORNER: f64 = 0.8;
/// Maximum distance of the surfels of that other plane, in sizes.
const ADJACENT: f64 = 2.5;
/// Minimum sine between planes with a usable common line: 20 degrees.
const MIN_SINE: f64 = 0.34;
/// Half the diagonal of a cell, in sides: a cell at this distance from another plane lies entirely on one side of it.
const HALF_DIAGONAL: f64 = 0.5 * std::f64::consts::SQRT_2;
/// Minimum area of a piece, in cells.
const MIN_CELLS: f64 = 2.0;

/// A convex polygon on a plane.
#[derive(Clone, Debug)]
pub(crate) struct Piece {
    /// Index of the plane.
    pub plane: u32,
    /// Relative to the base of the views, counter-clockwise as seen from the side of the normal.
    pub corners: Vec<DVec3>,
}

impl Piece {
    /// Its area, square metres.
    pub fn area(&self) -> f64 {
        0.5 * doubled_area(&self.corners).length()
    }
}

/// Resolution of outlines.
#[derive(Clone, Copy, Debug)]
pub(crate) struct OutlineOptions {
    /// Size of a cell, in sizes of the plane's surfels.
    pub cell: f64,
    /// Tolerance of the simplification, in cells.
    pub tolerance: f64,
}

/// Areas by their evidence, square metres.
#[derive(Clone, Copy, Debug, Default)]
pub struct Areas {
    /// Surface on which rays ended.
    pub surface: f64,
    /// Adjacent openings, through which rays passed.
    pub open: f64,
    /// Adjacent unobserved area.
    pub unseen: f64,
}

impl Areas {
    pub(crate) fn add(&mut self, other: &Self) {
        self.surface += other.surface;
        self.open += other.open;
        self.unseen += other.unseen;
    }
}

/// The outline of one plane.
#[derive(Default)]
pub(crate) struct Outline {
    pub pieces: Vec<Piece>,
    pub areas: Areas,
    /// Middles of the adjacent unobserved cells, and the size of a cell, metres.
    pub unseen: (Vec<DVec3>, f64),
    /// Weight of the hits on the surface, and weight of its passes.
    pub evidence: [f64; 2],
}

/// Planes with their surfels.
#[derive(Clone, Copy)]
pub(crate) struct Planes<'a> {
    pub surface: &'a Surface,
    pub planes: &'a [Flat],
    /// By surfel: the index of its plane.
    pub labels: &'a [u32],
    /// By plane: the indices of its surfels.
    pub members: &'a [Vec<u32>],
    /// Pairs of planes that touch.
    pub adjacent: &'a [[u32; 2]],
}

/// The outlines of all planes.
pub(crate) fn outlines(views: &Views, all: Planes<'_>, options: OutlineOptions) -> Vec<Outline> {
    let mut adjacent = vec![Vec::new(); all.planes.len()];
    for [a, b] in all.adjacent {
        adjacent[*a as usize].push(*b);
        adjacent[*b as usize].push(*a);
    }
    let outline = |plane: usize| outline(views, &Corners { all, plane: plane as u32 }, &adjacent[plane], options);
    (0..all.planes.len()).into_par_iter().map(outline).collect()
}

fn outline(views: &Views, corners: &Corners<'_>, adjacent: &[u32], options: OutlineOptions) -> Outline {
    let all = corners.all;
    let (plane, surfels) = (&all.planes[corners.plane as usize], &all.surface.surfels);
    let members = &all.members[corners.plane as usize];
    let mut sizes: Vec<f64> = members.iter().map(|m| surfels[*m as usize].size).collect();
    let Some(size) = presight_model::statistics::median(&mut sizes).filter(|_| members.len() > 1) else {
        return Outline::default();
    };
    let places: Vec<(DVec2, f64)> =
        members.iter().map(|m| (plane.place(surfels[*m as usize].at), REACH * surfels[*m as usize].size)).collect();
    let around = places.iter().flat_map(|(q, reach)| [*q - *reach, *q + *reach]);
    let cells = Cells::covering(bounds(around), options.cell * size);
    let mut near = vec![false; cells.len()];
    places.iter().for_each(|(q, reach)| cells.mark(&mut near, *q, *reach));
    let tested: Vec<usize> = (0..cells.len()).filter(|c| near[*c]).collect();
    let middles: Vec<DVec2> = tested.iter().map(|c| cells.middle(*c)).collect();
    let fences = corners.fences(adjacent, &middles, size, cells.side);
    let seen = evidence(views, plane, &middles, &fences, Margins::of_cell(cells.side));
    let mut field = vec![-1.0; cells.len()];
    for (cell, seen) in tested.iter().zip(&seen) {
        field[*cell] = seen.value();
    }
    let field = cells.smoothed(&field);
    let mut found = Outline::default();
    count(&mut found, plane, &cells, (&tested, &middles, &seen), &field);
    let min_area = MIN_CELLS * cells.side * cells.side;
    let tolerance = options.tolerance * cells.side;
    let lines = cells.contours(&field).into_iter().map(|mut line| {
        line.iter_mut().for_each(|q| *q = corners.closed(*q, size));
        simplified(&line, tolerance)
    });
    let lines: Vec<Vec<DVec2>> = lines.filter(|line| line.len() > 2 && area(line).abs() > min_area).collect();
    let polygons = convex(&lines).into_iter();
    let in_space = |polygon: Vec<DVec2>| polygon.iter().map(|q| plane.point(*q)).collect();
    found.pieces = polygons.map(|p| Piece { plane: corners.plane, corners: in_space(p) }).collect();
    found
}

/// Sums areas and evidence, and collects the unobserved cells.
fn count(
    found: &mut Outline,
    plane: &Flat,
    cells: &Cells,
    (tested, middles, seen): (&[usize], &[DVec2], &[Evidence]),
    field: &[f32],
) {
    let one = cells.side * cells.side;
    for ((cell, middle), seen) in tested.iter().zip(middles).zip(seen) {
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

/// The common lines of a plane with others.
struct Corners<'a> {
    all: Planes<'a>,
    plane: u32,
}

impl Corners<'_> {
    /// The shortest vector in the plane from a point to the common line with another plane; `None` if the planes are
    /// nearly parallel.
    fn to_line(&self, other: &Flat, q: DVec2) -> Option<DVec2> {
        let across = self.across(other);
        let height = other.above(self.all.planes[self.plane as usize].point(q));
        (across.length() > MIN_SINE).then(|| -height / across.length_squared() * across)
    }

    /// The projection of another plane's normal on this plane.
    fn across(&self, other: &Flat) -> DVec2 {
        DVec2::from(self.all.planes[self.plane as usize].axes().map(|axis| other.normal.dot(axis)))
    }

    /// A point of the outline, moved to the common lines with one or two neighbouring planes near it, so that corners
    /// close.
    fn closed(&self, q: DVec2, size: f64) -> DVec2 {
        let p = self.all.planes[self.plane as usize].point(q);
        let near = self.all.surface.near(p, ADJACENT * size).map(|s| self.all.labels[s as usize]);
        let others: BTreeSet<u32> = near.filter(|other| *other != self.plane).collect();
        let shifts = others.iter().filter_map(|other| self.to_line(&self.all.planes[*other as usize], q));
        let mut shifts: Vec<DVec2> = shifts.filter(|shift| shift.length() < CORNER * size).collect();
        shifts.sort_by(|a, b| a.length_squared().total_cmp(&b.length_squared()));
        let Some(first) = shifts.first() else { return q };
        // The shift to the intersection of two lines has both shifts as its projections. If it is longer than their
        // sum, the lines intersect elsewhere.
        let to_both = |second: &DVec2| {
            let across = first.perp_dot(*second);
            let both = (first.perp() * second.length_squared() - second.perp() * first.length_squared()) / across;
            (both.length() < first.length() + second.length()).then_some(both)
        };
        q + shifts[1..].iter().find_map(to_both).unwrap_or(*first)
    }

    /// The adjacent planes along the stretches where they reach the common line, with the side of each cell near it.
    fn fences(&self, adjacent: &[u32], middles: &[DVec2], size: f64, cell: f64) -> Fences {
        let surfels = &self.all.surface.surfels;
        let sizes = self.all.members[self.plane as usize].iter().map(|m| surfels[*m as usize].size);
        let reach = REACH * sizes.fold(size, f64::max);
        let own = &self.all.planes[self.plane as usize];
        let mut fences =
            Fences { planes: Vec::new(), of: vec![Vec::new(); middles.len()], margin: Margins::of_cell(cell).hit };
        for other in adjacent {
            let flat = &self.all.planes[*other as usize];
            let along = self.across(flat).perp().normalize_or(DVec2::X);
            let at = |q: DVec2| (q.dot(along) / size).floor() as i64;
            // Stretches of the line, one size long, with surfels of the other plane.
            let mut reached = BTreeSet::new();
            for s in self.all.members[*other as usize].iter().map(|m| &surfels[*m as usize]) {
                let q = own.place(s.at);
                let is_near = |to_line: DVec2| own.above(s.at).abs().max(to_line.length()) < ADJACENT * s.size;
                if self.to_line(flat, q).is_some_and(is_near) {
                    reached.extend(at(q) - 1..=at(q) + 1);
                }
            }
            if reached.is_empty() {
                continue;
            }
            for (q, of) in middles.iter().zip(&mut fences.of) {
                let above = flat.above(own.point(*q));
                let is_near = self.to_line(flat, *q).is_some_and(|to_line| to_line.length() < reach);
                if is_near && above.abs() > HALF_DIAGONAL * cell && reached.contains(&at(*q)) {
                    of.push((fences.planes.len() as u32, above.signum() as f32));
                }
            }
            fences.planes.push(*flat);
        }
        fences
    }
}
