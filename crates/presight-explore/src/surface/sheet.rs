//! Surfaces of sensors whose rays are far apart. There the smallest pieces of surface are triangles between neighbouring rays;
//! between other rays nobody looked.

use super::found::Surfaces;
use super::options::ExploreOptions;
use super::outline::{Areas, Piece};
use super::region::Regions;
use super::solid::{Seen, Shown, Solid, shown};
use crate::geometry::{Flat, convex, simplified};
use crate::observe::{LEAST_COSINE, View, Views, directions, spacing};
use crate::surfels::{Noise, SMALLEST, Surface, Surfel};
use glam::{DVec2, DVec3};
use presight_model::error::Result;
use presight_predict::predict::Predictor;
use spade::{DelaunayTriangulation, HasPosition, Point2, Triangulation};
use std::collections::{BTreeSet, HashMap};

/// Rays are neighbours up to this many spacings of the sensor's rays: every other one may lack a reading, across and along.
const GAP: f64 = 2.0 * std::f64::consts::SQRT_2;
/// Borders are straight within this share of a side of a triangle. Where a surface ends is known to half of it.
const STRAIGHT: f64 = 0.15;

/// A ray in spacings of azimuth and elevation.
struct Ray {
    at: Point2<f64>,
    pixel: u32,
}

impl HasPosition for Ray {
    type Scalar = f64;

    fn position(&self) -> Point2<f64> {
        self.at
    }
}

/// Triangles between the neighbouring rays of a view.
#[derive(Default)]
pub(crate) struct Sheet {
    /// Pixels of the corners, counter-clockwise as seen from the sensor.
    triangles: Vec<[u32; 3]>,
    /// Triangles without a surface: too large, or steps in depth.
    open: Vec<[u32; 3]>,
}

impl Sheet {
    pub fn of(view: &View, is_used: impl Fn(usize) -> bool) -> Self {
        let directions = directions(view);
        let unit = spacing(view, &directions);
        // Rays that met nothing count, too: no triangle may span their way.
        let measured = (0..view.ranges.len()).filter(|i| !view.ranges[*i].is_nan() && is_used(*i));
        let measured = measured.map(|i| (directions[i] / unit, i as u32));
        let measured = measured.map(|(at, pixel)| Ray { at: Point2::new(at.x, at.y), pixel });
        let mut sheet = Self::default();
        // Directions are finite and not tiny, so that all can be inserted.
        let Ok(triangulation) = DelaunayTriangulation::<Ray>::bulk_load(measured.collect()) else { return sheet };
        for face in triangulation.inner_faces() {
            let mut corners = face.vertices().map(|v| v.data().pixel);
            if corners.iter().any(|i| view.ranges[*i as usize].is_infinite()) {
                continue;
            }
            let ends = face.positions().map(|p| DVec2::new(p.x, p.y));
            let is_near = (0..3).all(|k| ends[k].distance(ends[(k + 1) % 3]) <= GAP);
            let [a, b, c] = corners.map(|i| view.point(i as usize));
            let Some(normal) = (b - a).cross(c - a).try_normalize() else { continue };
            let cosine = normal.dot((view.origin() - (a + b + c) / 3.0).normalize());
            if cosine < 0.0 {
                corners.swap(1, 2);
            }
            if is_near && cosine.abs() > f64::from(LEAST_COSINE) { &mut sheet.triangles } else { &mut sheet.open }
                .push(corners);
        }
        sheet
    }

    /// Each triangle as a surfel; its neighbours share a side with it.
    fn surface(&self, view: &View) -> Surface {
        let mut sides: HashMap<[u32; 2], Vec<u32>> = HashMap::new();
        for (triangle, i) in self.triangles.iter().zip(0..) {
            sides_of(triangle).for_each(|side| sides.entry(side).or_default().push(i));
        }
        let beside = |t: &[u32; 3]| sides_of(t).flat_map(|side| sides[&side].clone()).collect::<BTreeSet<u32>>();
        let lists = self.triangles.iter().map(|t| beside(t).into_iter().collect()).collect();
        Surface::with_neighbours(self.triangles.iter().map(|t| surfel(view, t)).collect(), lists)
    }
}

fn sides_of(t: &[u32; 3]) -> impl Iterator<Item = [u32; 2]> + '_ {
    (0..3).map(|k| [t[k].min(t[(k + 1) % 3]), t[k].max(t[(k + 1) % 3])])
}

fn surfel(view: &View, triangle: &[u32; 3]) -> Surfel {
    let [a, b, c] = triangle.map(|i| view.point(i as usize));
    let (at, outer) = ((a + b + c) / 3.0, (b - a).cross(c - a));
    let way = at - view.origin();
    let normal = outer.normalize();
    let cosine = normal.dot(way).abs() / way.length();
    let size = (b - a).length().max((c - b).length()).max((a - c).length());
    Surfel { at, normal, weight: cosine * cosine / way.length(), size }
}

/// Convex polygons on planes, as seen from one view.
struct Drawn<'a> {
    view: &'a View,
    sheet: &'a Sheet,
}

impl Drawn<'_> {
    /// The polygons of triangles on one plane: corners are where the rays meet it, and borders are straight within a share of `size`.
    fn pieces(&self, plane: &Flat, number: u32, triangles: &[u32], size: f64) -> Vec<Piece> {
        let in_plane = |border: Vec<u32>| {
            let line: Vec<DVec2> = border.iter().map(|pixel| self.meets(plane, *pixel as usize)).collect();
            if line.len() > 4 { simplified(&line, STRAIGHT * size) } else { line }
        };
        let lines: Vec<Vec<DVec2>> = self.borders(triangles).into_iter().map(in_plane).collect();
        let in_space = |p: Vec<DVec2>| Piece { plane: number, corners: p.iter().map(|q| plane.point(*q)).collect() };
        let sound: Vec<Vec<DVec2>> =
            lines.into_iter().filter(|l| l.len() > 2 && l.iter().all(|q| q.is_finite())).collect();
        convex(&sound).into_iter().map(in_space).collect()
    }

    /// Closed lines around triangles: the pixels of their corners.
    fn borders(&self, triangles: &[u32]) -> Vec<Vec<u32>> {
        let sides = triangles.iter().flat_map(|t| {
            let t = self.sheet.triangles[*t as usize];
            (0..3).map(move |k| (t[k], t[(k + 1) % 3]))
        });
        let mut open: BTreeSet<(u32, u32)> = BTreeSet::new();
        for (a, b) in sides {
            if !open.remove(&(b, a)) {
                open.insert((a, b));
            }
        }
        let mut borders = Vec::new();
        while let Some((first, mut at)) = open.pop_first() {
            let mut border = vec![first];
            while at != first {
                border.push(at);
                // As many sides leave a corner as lead to it.
                let Some(next) = open.range((at, 0)..=(at, u32::MAX)).next().copied() else { break };
                open.remove(&next);
                at = next.1;
            }
            borders.push(border);
        }
        borders
    }

    /// Where a ray meets a plane, in the plane; NaN if it leads away.
    fn meets(&self, plane: &Flat, pixel: usize) -> DVec2 {
        let (origin, ray) = (self.view.origin(), self.view.ray(pixel));
        let way = -plane.above(origin) / ray.dot(plane.normal);
        if way > 0.0 { plane.place(origin + ray * way) } else { DVec2::NAN }
    }
}

/// What rays say about a surface in this distance, in sizes of its triangles, is about that surface.
const SPREAD: f64 = 0.3;

/// The surfaces of the pixels that are used. Each view adds what the views before it do not explain.
pub(crate) fn sheets(
    views: &Views,
    options: &ExploreOptions,
    predictor: &mut Predictor,
    is_used: impl Fn(usize, usize) -> bool,
) -> Result<Option<Surfaces>> {
    let (mut found, detail) = (Found::default(), options.detail.unwrap_or(SMALLEST));
    for (number, view) in views.all().iter().enumerate() {
        let explained = found.explained(predictor, &views.only(number))?;
        let sheet = Sheet::of(view, |pixel| is_used(number, pixel) && !explained[pixel]);
        let room = options.polygons - found.pieces.len();
        if room > 0 && !sheet.triangles.is_empty() {
            options.threads.run(|| found.add(view, &sheet, detail, room))?;
        }
    }
    if found.pieces.is_empty() {
        return Ok(None);
    }
    let solid = Solid::new(views, &found.pieces)?;
    let verdicts = shown(predictor, views, &solid, &found.pieces, &found.tolerance)?;
    let mut evidence = vec![[0.0; 2]; found.planes.len()];
    for (piece, Shown { explains, blocks }) in found.pieces.iter().zip(&verdicts.shown) {
        let [hit, pass] = &mut evidence[piece.plane as usize];
        (*hit, *pass) = (*hit + f64::from(*explains), *pass + f64::from(*blocks));
    }
    // Corners are where rays meet the planes: which of the pieces around it explains such a ray is chance.
    let is_blocking = |s: &Shown| s.blocks > s.explains + 1;
    let pieces: Vec<Piece> = found
        .pieces
        .into_iter()
        .zip(&verdicts.shown)
        .filter(|(_, s)| !is_blocking(s))
        .map(|(piece, _)| piece)
        .collect();
    let unseen: f64 = found.unseen.iter().map(|(places, side)| places.len() as f64 * side * side).sum();
    Ok(Some(Surfaces {
        base: views.base(),
        detail,
        mirrored: 0,
        areas: Areas { surface: pieces.iter().map(Piece::area).sum(), open: 0.0, unseen },
        pieces,
        evidence,
        sigmas: verdicts.sigmas,
        parts: verdicts.parts,
        unseen: found.unseen,
        beside: found.beside,
        planes: found.planes,
    }))
}

/// The pieces of all views.
#[derive(Default)]
struct Found {
    planes: Vec<Flat>,
    pieces: Vec<Piece>,
    tolerance: Vec<f64>,
    unseen: Vec<(Vec<DVec3>, f64)>,
    beside: Vec<[u32; 2]>,
}

impl Found {
    /// The pixels of one view that the pieces explain.
    fn explained(&self, predictor: &mut Predictor, view: &Views) -> Result<Vec<bool>> {
        let mut explained = vec![false; view.all()[0].ranges.len()];
        if !self.pieces.is_empty() {
            Solid::new(view, &self.pieces)?.visit(predictor, view, 1, |seen: Seen| {
                let tolerance = self.tolerance[self.pieces[seen.piece as usize].plane as usize];
                explained[seen.pixel] = (seen.measured - seen.predicted).abs() < 4.0 * tolerance;
            })?;
        }
        Ok(explained)
    }

    /// Adds the surfaces of a sheet: at most `room` pieces, the largest in the view.
    fn add(&mut self, view: &View, sheet: &Sheet, detail: f64, room: usize) {
        let surface = sheet.surface(view);
        let regions = Regions::new(&surface, (detail, Noise::default()), room);
        let (first, drawn) = (self.planes.len() as u32, Drawn { view, sheet });
        let mut pieces = Vec::new();
        for ((plane, members), number) in regions.planes.iter().zip(regions.members()).zip(first..) {
            let sizes = members.iter().map(|m| surface.surfels[*m as usize].size);
            let size = sizes.sum::<f64>() / members.len().max(1) as f64;
            pieces.extend(drawn.pieces(plane, number, &members, size));
            self.tolerance.push(SPREAD * size);
            self.unseen.push((Vec::new(), 0.0));
        }
        // The part of the view that a piece fills.
        let angle = |piece: &Piece| {
            let way = piece.corners[0] - view.origin();
            piece.area() * way.dot(regions.planes[(piece.plane - first) as usize].normal).abs() / way.length().powi(3)
        };
        pieces.sort_by(|a, b| angle(b).total_cmp(&angle(a)));
        pieces.truncate(room);
        self.pieces.extend(pieces);
        let labels: Vec<u32> = regions.labels.iter().map(|label| first + label).collect();
        let pairs = (0..labels.len()).flat_map(|t| surface.neighbours(t).iter().map(move |n| (t, *n as usize)));
        let beside: BTreeSet<[u32; 2]> = pairs.map(|(t, n)| [labels[t], labels[n]]).filter(|[a, b]| a < b).collect();
        self.beside.extend(beside);
        self.planes.extend(regions.planes);
        self.leave_open(view, sheet, &labels);
    }

    /// Keeps the places at borders of surfaces where rays are too far apart.
    fn leave_open(&mut self, view: &View, sheet: &Sheet, labels: &[u32]) {
        let mut of: HashMap<[u32; 2], u32> = HashMap::new();
        for (triangle, label) in sheet.triangles.iter().zip(labels) {
            of.extend(sides_of(triangle).map(|side| (side, *label)));
        }
        for open in &sheet.open {
            let Some(label) = sides_of(open).find_map(|side| of.get(&side)) else { continue };
            let (places, side) = &mut self.unseen[*label as usize];
            let [a, b, c] = open.map(|i| view.point(i as usize));
            // Along the surface, not into the depth behind it.
            let nearest =
                [a, b, c].into_iter().min_by(|p, q| p.distance(view.origin()).total_cmp(&q.distance(view.origin())));
            places.extend(nearest);
            *side = side.max(self.tolerance[*label as usize] / SPREAD);
        }
    }
}
