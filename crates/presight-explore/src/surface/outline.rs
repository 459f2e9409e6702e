//! Outlines of planes: where rays ended on them, and not where rays went through or nobody looked.

use crate::evidence::{Evidence, Fences, Margins, evidence};
use crate::geometry::{Cells, Flat, area, convex, simplified};
use crate::observe::Views;
use crate::surfels::Surface;
use glam::{DVec2, DVec3};
use rayon::prelude::*;
use std::collections::BTreeSet;

/// Cells this far around a surfel are looked at, in its sizes.
const REACH: f64 = 2.0;
/// Ends of a plane go to the common line with another plane if they are this near to it, in sizes of surfels.
const CORNER: f64 = 0.8;
/// Surfels of the other plane must be this near then, in sizes.
const BESIDE: f64 = 2.5;
/// Least sine between planes that have a common line: 20 degrees.
const LEAST_ANGLE: f64 = 0.34;
/// A cell whose middle is so far from another plane, in sides, lies on one side of it as a whole.
const WHOLE: f64 = 0.5 * std::f64::consts::SQRT_2;
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

/// The planes of surfels.
#[derive(Clone, Copy)]
pub(crate) struct Planes<'a> {
    pub surface: &'a Surface,
    pub planes: &'a [Flat],
    /// By surfel: its plane.
    pub labels: &'a [u32],
    /// By plane: its surfels.
    pub members: &'a [Vec<u32>],
    /// Pairs of planes that touch.
    pub beside: &'a [[u32; 2]],
}

/// The outlines of all planes.
pub(crate) fn outlines(views: &Views, all: Planes<'_>, options: OutlineOptions) -> Vec<Outline> {
    let mut beside = vec![Vec::new(); all.planes.len()];
    for [a, b] in all.beside {
        beside[*a as usize].push(*b);
        beside[*b as usize].push(*a);
    }
    let outline = |plane: usize| outline(views, &Corners { all, plane: plane as u32 }, &beside[plane], options);
    (0..all.planes.len()).into_par_iter().map(outline).collect()
}

fn outline(views: &Views, corners: &Corners<'_>, beside: &[u32], options: OutlineOptions) -> Outline {
    let all = corners.all;
    let (plane, surfels) = (&all.planes[corners.plane as usize], &all.surface.surfels);
    let members = &all.members[corners.plane as usize];
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
    let fences = corners.fences(beside, &middles, size, cells.side);
    let seen = evidence(views, plane, &middles, &fences, Margins::of_cell(cells.side));
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
    all: Planes<'a>,
    plane: u32,
}

impl Corners<'_> {
    /// The shortest way in the plane from a point of it to the common line with another plane; `None` if there is no such line.
    fn way_to(&self, other: &Flat, q: DVec2) -> Option<DVec2> {
        let across = self.across(other);
        let height = other.above(self.all.planes[self.plane as usize].point(q));
        (across.length() > LEAST_ANGLE).then(|| -height / across.length_squared() * across)
    }

    /// The normal of another plane, seen in this one.
    fn across(&self, other: &Flat) -> DVec2 {
        DVec2::from(self.all.planes[self.plane as usize].axes().map(|axis| other.normal.dot(axis)))
    }

    /// A point of the outline, on the common lines with neighbouring planes if it is near one or two, so that corners close.
    fn closed(&self, q: DVec2, size: f64) -> DVec2 {
        let p = self.all.planes[self.plane as usize].point(q);
        let near = self.all.surface.near(p, BESIDE * size).map(|s| self.all.labels[s as usize]);
        let others: BTreeSet<u32> = near.filter(|other| *other != self.plane).collect();
        let ways = others.iter().filter_map(|other| self.way_to(&self.all.planes[*other as usize], q));
        let mut ways: Vec<DVec2> = ways.filter(|way| way.length() < CORNER * size).collect();
        ways.sort_by(|a, b| a.length_squared().total_cmp(&b.length_squared()));
        let Some(first) = ways.first() else { return q };
        // The way to the point of both lines has each of the ways as its part along it. Where it is longer than both, their lines meet
        // elsewhere.
        let to_both = |second: &DVec2| {
            let across = first.perp_dot(*second);
            let both = (first.perp() * second.length_squared() - second.perp() * first.length_squared()) / across;
            (both.length() < first.length() + second.length()).then_some(both)
        };
        q + ways[1..].iter().find_map(to_both).unwrap_or(*first)
    }

    /// Neighbouring planes, where they reach the common line, for cells that are looked at because of surfels before that line.
    fn fences(&self, beside: &[u32], middles: &[DVec2], size: f64, cell: f64) -> Fences {
        let surfels = &self.all.surface.surfels;
        let sizes = self.all.members[self.plane as usize].iter().map(|m| surfels[*m as usize].size);
        let reach = REACH * sizes.fold(size, f64::max);
        let own = &self.all.planes[self.plane as usize];
        let mut fences =
            Fences { planes: Vec::new(), of: vec![Vec::new(); middles.len()], margin: Margins::of_cell(cell).hit };
        for other in beside {
            let flat = &self.all.planes[*other as usize];
            let along = self.across(flat).perp().normalize_or(DVec2::X);
            let at = |q: DVec2| (q.dot(along) / size).floor() as i64;
            // Stretches of the line, a size long, at which the other plane has surfels.
            let mut reached = BTreeSet::new();
            for s in self.all.members[*other as usize].iter().map(|m| &surfels[*m as usize]) {
                let q = own.place(s.at);
                let is_near = |way: DVec2| own.above(s.at).abs().max(way.length()) < BESIDE * s.size;
                if self.way_to(flat, q).is_some_and(is_near) {
                    reached.extend(at(q) - 1..=at(q) + 1);
                }
            }
            if reached.is_empty() {
                continue;
            }
            for (q, of) in middles.iter().zip(&mut fences.of) {
                let above = flat.above(own.point(*q));
                let is_near = self.way_to(flat, *q).is_some_and(|way| way.length() < reach);
                if is_near && above.abs() > WHOLE * cell && reached.contains(&at(*q)) {
                    of.push((fences.planes.len() as u32, above.signum() as f32));
                }
            }
            fences.planes.push(*flat);
        }
        fences
    }
}
