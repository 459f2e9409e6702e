//! Surfaces of sparse views, from triangles between neighbouring rays. The space between other rays stays unobserved.

use super::found::Surfaces;
use super::options::ExploreOptions;
use super::outline::{Areas, Piece};
use super::region::{Regions, SPREAD};
use super::solid::{PixelCounts, Solid, verdicts};
use crate::geometry::{Flat, convex, simplified};
use crate::observe::{MIN_COSINE, View, Views, directions, spacing};
use crate::surfels::{MIN_SIZE, Noise, Surface, Surfel};
use glam::{DVec2, DVec3};
use presight_model::error::Result;
use presight_predict::predict::Predictor;
use spade::{DelaunayTriangulation, HasPosition, Point2, Triangulation};
use std::collections::{BTreeSet, HashMap};

/// Maximum distance of neighbouring rays, in spacings of the sensor's rays: every other ray may lack a reading, across
/// and along.
const GAP: f64 = 2.0 * std::f64::consts::SQRT_2;
/// Tolerance of straight borders, in sides of a triangle. The border of a surface is uncertain by half a side.
const STRAIGHT: f64 = 0.15;

/// A ray of a view.
struct Ray {
    /// Azimuth and elevation, in spacings.
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
    /// Triangles that are too large or span a depth step.
    open: Vec<[u32; 3]>,
}

impl Sheet {
    pub fn of(view: &View, is_used: impl Fn(usize) -> bool) -> Self {
        let directions = directions(view);
        let unit = spacing(view, &directions);
        // Rays without a return are included, so that no triangle spans the free space along them.
        let measured = (0..view.ranges.len()).filter(|i| !view.ranges[*i].is_nan() && is_used(*i));
        let measured = measured.map(|i| (directions[i] / unit, i as u32));
        let measured = measured.map(|(at, pixel)| Ray { at: Point2::new(at.x, at.y), pixel });
        let mut sheet = Self::default();
        // The directions are finite and not tiny, so they can be inserted.
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
            if is_near && cosine.abs() > f64::from(MIN_COSINE) { &mut sheet.triangles } else { &mut sheet.open }
                .push(corners);
        }
        sheet
    }

    /// The triangles as surfels, whose neighbours share a side with them.
    fn surface(&self, view: &View) -> Surface {
        let mut sides: HashMap<[u32; 2], Vec<u32>> = HashMap::new();
        for (triangle, i) in self.triangles.iter().zip(0..) {
            sides_of(triangle).for_each(|side| sides.entry(side).or_default().push(i));
        }
        let adjacent = |t: &[u32; 3]| sides_of(t).flat_map(|side| sides[&side].clone()).collect::<BTreeSet<u32>>();
        let lists = self.triangles.iter().map(|t| adjacent(t).into_iter().collect()).collect();
        Surface::with_neighbours(self.triangles.iter().map(|t| surfel(view, t)).collect(), lists)
    }
}

fn sides_of(t: &[u32; 3]) -> impl Iterator<Item = [u32; 2]> + '_ {
    (0..3).map(|k| [t[k].min(t[(k + 1) % 3]), t[k].max(t[(k + 1) % 3])])
}

fn surfel(view: &View, triangle: &[u32; 3]) -> Surfel {
    let [a, b, c] = triangle.map(|i| view.point(i as usize));
    let (at, outer) = ((a + b + c) / 3.0, (b - a).cross(c - a));
    let ray = at - view.origin();
    let normal = outer.normalize();
    let cosine = normal.dot(ray).abs() / ray.length();
    let size = (b - a).length().max((c - b).length()).max((a - c).length());
    Surfel { at, normal, weight: cosine * cosine / ray.length(), size }
}

/// A view with its triangles.
struct Drawn<'a> {
    view: &'a View,
    sheet: &'a Sheet,
}

impl Drawn<'_> {
    /// The polygons of triangles on one plane. Their corners are the intersections of the rays with the plane, and
    /// their borders are simplified by a share of `size`.
    fn pieces(&self, plane: &Flat, number: u32, triangles: &[u32], size: f64) -> Vec<Piece> {
        let in_plane = |border: Vec<u32>| {
            let line: Vec<DVec2> = border.iter().map(|pixel| self.intersection(plane, *pixel as usize)).collect();
            if line.len() > 4 { simplified(&line, STRAIGHT * size) } else { line }
        };
        let lines: Vec<Vec<DVec2>> = self.borders(triangles).into_iter().map(in_plane).collect();
        let in_space = |p: Vec<DVec2>| Piece { plane: number, corners: p.iter().map(|q| plane.point(*q)).collect() };
        let sound: Vec<Vec<DVec2>> =
            lines.into_iter().filter(|l| l.len() > 2 && l.iter().all(|q| q.is_finite())).collect();
        convex(&sound).into_iter().map(in_space).collect()
    }

    /// Closed lines around triangles, as the pixels of their corners.
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
                // Equal numbers of sides start and end at each corner.
                let Some(next) = open.range((at, 0)..=(at, u32::MAX)).next().copied() else { break };
                open.remove(&next);
                at = next.1;
            }
            borders.push(border);
        }
        borders
    }

    /// The intersection of a pixel's ray with a plane, in the plane; NaN if the ray points away from it.
    fn intersection(&self, plane: &Flat, pixel: usize) -> DVec2 {
        let (origin, ray) = (self.view.origin(), self.view.ray(pixel));
        let distance = -plane.above(origin) / ray.dot(plane.normal);
        if distance > 0.0 { plane.place(origin + ray * distance) } else { DVec2::NAN }
    }
}

/// The surfaces of the used pixels. Each view adds surfaces for the pixels that the earlier views do not explain.
pub(crate) fn sheets(
    views: &Views,
    options: &ExploreOptions,
    predictor: &mut Predictor,
    is_used: impl Fn(usize, usize) -> bool,
) -> Result<Option<Surfaces>> {
    let (mut found, detail) = (Found::default(), options.detail.unwrap_or(MIN_SIZE));
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
    let verdicts = verdicts(predictor, views, &solid, &found.pieces, &found.tolerance)?;
    let mut evidence = vec![[0.0; 2]; found.planes.len()];
    for (piece, PixelCounts { explained, blocked }) in found.pieces.iter().zip(&verdicts.pixels) {
        let [hit, pass] = &mut evidence[piece.plane as usize];
        (*hit, *pass) = (*hit + f64::from(*explained), *pass + f64::from(*blocked));
    }
    // A corner lies on a ray, and chance decides which of the pieces around the corner explains that ray: one pixel is
    // no evidence.
    let sound = found.pieces.into_iter().zip(&verdicts.pixels).filter(|(_, pixels)| pixels.gain() >= -1);
    let pieces: Vec<Piece> = sound.map(|(piece, _)| piece).collect();
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
        adjacent: found.adjacent,
        planes: found.planes,
    }))
}

/// The surfaces of the views so far.
#[derive(Default)]
struct Found {
    planes: Vec<Flat>,
    pieces: Vec<Piece>,
    tolerance: Vec<f64>,
    unseen: Vec<(Vec<DVec3>, f64)>,
    adjacent: Vec<[u32; 2]>,
}

impl Found {
    /// By pixel of one view: true if the pieces explain it.
    fn explained(&self, predictor: &mut Predictor, view: &Views) -> Result<Vec<bool>> {
        let mut explained = vec![false; view.all()[0].ranges.len()];
        if !self.pieces.is_empty() {
            Solid::new(view, &self.pieces)?.compare(predictor, view, |seen| {
                let tolerance = self.tolerance[self.pieces[seen.piece as usize].plane as usize];
                explained[seen.pixel] = (seen.measured - seen.predicted).abs() < 4.0 * tolerance;
            })?;
        }
        Ok(explained)
    }

    /// Adds the surfaces of a sheet: at most `room` pieces, those with the largest solid angles.
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
        // The solid angle of a piece.
        let angle = |piece: &Piece| {
            let ray = piece.corners[0] - view.origin();
            piece.area() * ray.dot(regions.planes[(piece.plane - first) as usize].normal).abs() / ray.length().powi(3)
        };
        pieces.sort_by(|a, b| angle(b).total_cmp(&angle(a)));
        pieces.truncate(room);
        self.pieces.extend(pieces);
        let labels: Vec<u32> = regions.labels.iter().map(|label| first + label).collect();
        let pairs = (0..labels.len()).flat_map(|t| surface.neighbours(t).iter().map(move |n| (t, *n as usize)));
        let adjacent: BTreeSet<[u32; 2]> = pairs.map(|(t, n)| [labels[t], labels[n]]).filter(|[a, b]| a < b).collect();
        self.adjacent.extend(adjacent);
        self.planes.extend(regions.planes);
        self.add_unseen(view, sheet, &labels);
    }

    /// Records the unobserved places at the borders of surfaces, where rays are too far apart.
    fn add_unseen(&mut self, view: &View, sheet: &Sheet, labels: &[u32]) {
        let mut of: HashMap<[u32; 2], u32> = HashMap::new();
        for (triangle, label) in sheet.triangles.iter().zip(labels) {
            of.extend(sides_of(triangle).map(|side| (side, *label)));
        }
        for open in &sheet.open {
            let Some(label) = sides_of(open).find_map(|side| of.get(&side)) else { continue };
            let (places, side) = &mut self.unseen[*label as usize];
            let [a, b, c] = open.map(|i| view.point(i as usize));
            // The nearest corner lies on the surface, not in the depth behind it.
            let nearest =
                [a, b, c].into_iter().min_by(|p, q| p.distance(view.origin()).total_cmp(&q.distance(view.origin())));
            places.extend(nearest);
            *side = side.max(self.tolerance[*label as usize] / SPREAD);
        }
    }
}
