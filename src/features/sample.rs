//! Features sampled along their image.
//!
//! A segment's image is cut into pieces of at most half a pixel, finer if that is asked for, and a sample sits in the middle of each. A pinhole
//! camera images straight lines as straight lines: clipped in closed form, equal pieces in the image. Everywhere else
//! (lens distortion, scanners, ray tables) the arc of directions between the ends is halved until its image is short
//! enough, so that the curved image of a straight edge is followed, over seam and poles, too.
//!
//! A scanner of one row sees a cone of directions (with the height of its beam, a layer between two cones): segments and
//! patches are cut with it first.

use super::Reason;
use super::columns;
use super::straight::{Straight, before_camera};
use crate::geometry::plane_of_polygon;
use crate::sensor::{Angles, Camera, Geometry, Scanner, Sensor};
use glam::{DVec2, DVec3};

/// Longest piece of an image that one sample stands for unless it is to be finer, pixels.
pub const STEP: f64 = 0.5;
/// Most samples of one segment.
pub const MAX_SEGMENT_SAMPLES: usize = 1 << 17;
/// Most samples of one patch every half pixel: of larger ones they are farther apart, unless images decide pixel by pixel. Where
/// samples are to be finer they may be as many more, up to 64 times.
pub const MAX_PATCH_SAMPLES: usize = 1 << 12;
/// Most cells of the grid around a patch that has few samples in it.
const MAX_PATCH_CELLS: usize = 1 << 16;

/// Pieces of arc that are looked at first, in pixels: no part of an image smaller than that between two places outside
/// of it is found.
const COARSE: f64 = 8.0;
/// Most pieces of arc that are looked at first.
const MAX_COARSE: f64 = 4096.0;
/// A piece of an image no longer than this may be sampled as a straight line, pixels.
const RUN: f64 = 12.0;
/// If its middle is no farther than this from that line's, pixels.
const BENT: f64 = 1.0 / 64.0;
/// How often arcs are halved: beyond a pole's neighbourhood nothing needs as many.
const MAX_DEPTH: u32 = 40;
/// Directions this far off the cone of a row without height are still on it, radians.
const ON_CONE: f64 = 1e-9;

/// A small part of a feature's image.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sample {
    /// Part of the feature's length in space that it stands for; equal ends where a cut leaves a point.
    pub t: [f64; 2],
    /// Its middle, image frame, metres.
    pub at: DVec3,
    /// Pixel coordinates of the middle.
    pub pixel: DVec2,
    /// Pixel coordinates of both ends.
    pub ends: [DVec2; 2],
    /// Length (area for patches) in the image, pixels; 0 of points.
    pub weight: f64,
}

/// What sampling finds along a feature.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Piece {
    /// In the image.
    Inside(Sample),
    /// Not in the image, or behind the sensor.
    Outside {
        /// Part of the feature's length.
        t: [f64; 2],
        /// Why.
        reason: Reason,
    },
}

/// Samples features for one sensor.
#[derive(Debug)]
pub struct Sampler<'a> {
    sensor: &'a Sensor,
    pinhole: Option<&'a Camera>,
    size: DVec2,
    turn: Option<f64>,
    /// Longest piece of an image that one sample stands for, pixels.
    step: f64,
    /// About the finest angle between neighbouring rays.
    pixel_angle: f64,
    /// Elevations between which a single row sees.
    cone: Option<[f64; 2]>,
    /// Elevations of rows and half the height of the beam, degrees, where it does not reach from row to row.
    beams: Option<(Vec<f64>, f64)>,
}

impl<'a> Sampler<'a> {
    /// For a sensor, every [`STEP`].
    pub fn new(sensor: &'a Sensor) -> Self {
        Self::with_step(sensor, STEP)
    }

    /// For a sensor, every so many pixels, above 0.
    pub(super) fn with_step(sensor: &'a Sensor, step: f64) -> Self {
        let (mut pinhole, mut cone, mut beams) = (None, None, None);
        match &sensor.spec().geometry {
            Geometry::Camera(c) if c.distortion.is_none() => pinhole = Some(c),
            Geometry::Scanner(s) if s.elevation.len() == 1 => {
                let half = 0.5 * s.beam_height_deg.unwrap_or(0.0);
                let row = s.elevation.degrees(0);
                cone = Some([row - half, row + half].map(|e| e.clamp(-90.0, 90.0).to_radians()));
            }
            Geometry::Scanner(s) => beams = s.beam_height_deg.map(|h| (s.rows_deg(), 0.5 * h)),
            _ => {}
        }
        Self {
            sensor,
            pinhole,
            size: DVec2::new(f64::from(sensor.width()), f64::from(sensor.height())),
            turn: sensor.columns_of_a_turn(),
            step,
            pixel_angle: pixel_angle(sensor),
            cone,
            beams,
        }
    }

    /// Columns of a whole turn, where the last column's neighbour is the first.
    pub fn turn(&self) -> Option<f64> {
        self.turn
    }

    /// True of a scanner of one row, which sees cuts.
    pub(super) fn is_one_row(&self) -> bool {
        self.cone.is_some()
    }

    /// About the finest angle between neighbouring rays, radians.
    pub(super) fn pixel_angle(&self) -> f64 {
        self.pixel_angle
    }

    /// Column and row of the pixel whose centre is nearest to a place in the image; columns beyond the seam are those of the other side.
    pub(super) fn nearest_pixel(&self, place: DVec2) -> (i64, i64) {
        let x = match self.turn {
            Some(turn) if !(place.x >= -0.5 && place.x < self.size.x - 0.5) => (place.x + 0.5).rem_euclid(turn) - 0.5,
            _ => place.x,
        };
        let nearest = |x: f64, n: f64| ((x + 0.5) as i64).min(n as i64 - 1);
        (nearest(x, self.size.x), nearest(place.y, self.size.y))
    }

    /// The sample of a point of the image frame.
    pub fn point(&self, at: DVec3) -> Piece {
        let t = [0.0, 1.0];
        match self.project(at).filter(|pixel| self.holds(at, *pixel)) {
            Some(pixel) => Piece::Inside(Sample { t, at, pixel, ends: [pixel, pixel], weight: 0.0 }),
            None => self.outside(at, t),
        }
    }

    /// Samples a segment between two points of the image frame; pieces come in order and cover all of 0..=1.
    pub fn segment(&self, a: DVec3, b: DVec3, visit: &mut impl FnMut(Piece)) {
        match (self.pinhole, self.cone) {
            (Some(camera), _) => self.straight(camera, a, b, visit),
            (None, Some(cone)) => self.cut(cone, a, b, visit),
            (None, None) => self.arc(a, b, [0.0, 1.0], visit),
        }
    }

    fn project(&self, p: DVec3) -> Option<DVec2> {
        self.sensor.project(p).map(DVec2::from)
    }

    /// True if a point, imaged at `pixel`, is in the image.
    fn holds(&self, at: DVec3, pixel: DVec2) -> bool {
        let within = |x: f64, n: f64| x >= -0.5 && x <= n - 0.5;
        let inside = (self.turn.is_some() || within(pixel.x, self.size.x)) && within(pixel.y, self.size.y);
        let elevation = || at.z.atan2(at.x.hypot(at.y));
        if let Some([low, high]) = self.cone {
            return (self.turn.is_some() || within(pixel.x, self.size.x))
                && (low - ON_CONE..=high + ON_CONE).contains(&elevation());
        }
        let in_beam = |(rows, half): &(Vec<f64>, f64)| {
            let row = (pixel.y.round().max(0.0) as usize).min(rows.len() - 1);
            (elevation().to_degrees() - rows[row]).abs() <= *half
        };
        inside && self.beams.as_ref().is_none_or(in_beam)
    }

    fn outside(&self, at: DVec3, t: [f64; 2]) -> Piece {
        let behind = self.sensor.is_camera() && at.z <= 0.0 && self.sensor.project(at).is_none();
        Piece::Outside { t, reason: if behind { Reason::BehindSensor } else { Reason::OutsideImage } }
    }

    /// A pinhole camera: the image of a segment is straight.
    fn straight(&self, camera: &Camera, a: DVec3, b: DVec3, visit: &mut impl FnMut(Piece)) {
        let Some(part) = self.clip(camera, a, b) else { return before_camera(a, b, [0.0, 1.0], visit) };
        part.before(a, b, visit);
        let (mut t0, mut p0) = part.bound(0);
        for i in 0..part.count {
            let (t1, p1) = part.bound(i + 1);
            let weight = part.length * part.step;
            let (at, pixel) = part.middle(i);
            visit(Piece::Inside(Sample { t: [t0, t1], at, pixel, ends: [p0, p1], weight }));
            (t0, p0) = (t1, p1);
        }
        part.after(a, b, visit);
    }

    /// The part of a segment in the image of a pinhole camera; `None` for other sensors, and if there is none.
    pub(crate) fn straight_part(&self, a: DVec3, b: DVec3) -> Option<Straight> {
        self.clip(self.pinhole?, a, b)
    }

    fn clip(&self, camera: &Camera, a: DVec3, b: DVec3) -> Option<Straight> {
        // Positive inside the four sides of the image: linear along the segment. Together they put it in front.
        let sides = |p: DVec3| {
            let (x, y) = (camera.fx * p.x, camera.fy * p.y);
            let (left, top) = (camera.cx + 0.5, camera.cy + 0.5);
            [x + left * p.z, (self.size.x - left) * p.z - x, y + top * p.z, (self.size.y - top) * p.z - y, p.z]
        };
        let (mut from, mut to) = (0.0f64, 1.0f64);
        for (s, e) in sides(a).into_iter().zip(sides(b)) {
            match (s >= 0.0, e >= 0.0) {
                (true, true) => {}
                (false, false) => to = -1.0,
                (false, true) => from = from.max(s / (s - e)),
                (true, false) => to = to.min(s / (s - e)),
            }
        }
        let at = |t: f64| if t == 1.0 { b } else { a + t * (b - a) };
        let (start, end) = (at(from), at(to.max(0.0)));
        if !(from < to && start.z > 0.0 && end.z > 0.0) {
            return None;
        }
        let place = |p: DVec3| DVec2::new(camera.fx * (p.x / p.z) + camera.cx, camera.fy * (p.y / p.z) + camera.cy);
        let pixels = [place(start), place(end)];
        let length = pixels[0].distance(pixels[1]);
        let count = (length / self.step).ceil().clamp(1.0, MAX_SEGMENT_SAMPLES as f64);
        Some(Straight { t: [from, to], ends: [start, end], pixels, count: count as usize, length, step: 1.0 / count })
    }

    /// A single row: cuts with the cones above and below it.
    fn cut(&self, [low, high]: [f64; 2], a: DVec3, b: DVec3, visit: &mut impl FnMut(Piece)) {
        let at = |t: f64| a + t * (b - a);
        let elevation = |p: DVec3| p.z.atan2(p.x.hypot(p.y));
        let within = |p: DVec3| (low - ON_CONE..=high + ON_CONE).contains(&elevation(p));
        let mut places = crossings(a, b, low);
        if high > low {
            places.extend(crossings(a, b, high));
        }
        places.retain(|t| *t > 0.0 && *t < 1.0);
        places.sort_by(f64::total_cmp);
        places.dedup();
        let mut from = 0.0;
        for to in places.iter().copied().chain([1.0]) {
            if within(at(0.5 * (from + to))) {
                self.arc(at(from), at(to), [from, to], visit);
            } else {
                visit(Piece::Outside { t: [from, to], reason: Reason::OutsideImage });
                // A row without height leaves points.
                if to < 1.0 && low == high {
                    let t = [to, to];
                    match self.point(at(to)) {
                        Piece::Inside(sample) => visit(Piece::Inside(Sample { t, ..sample })),
                        Piece::Outside { reason, .. } => visit(Piece::Outside { t, reason }),
                    }
                }
            }
            from = to;
        }
    }

    /// Any sensor: halves the arc of directions from a to b, which are at `span` of the whole feature.
    fn arc(&self, a: DVec3, b: DVec3, span: [f64; 2], visit: &mut impl FnMut(Piece)) {
        let (near, far) = (a.length(), b.length());
        let angle = a.cross(b).length().atan2(a.dot(b));
        if !(angle > 1e-12 && near > 0.0 && far > 0.0) {
            // Seen from its end: a point.
            match self.point(a.lerp(b, 0.5)) {
                Piece::Inside(sample) => visit(Piece::Inside(Sample { t: span, ..sample })),
                Piece::Outside { reason, .. } => visit(Piece::Outside { t: span, reason }),
            }
            return;
        }
        let t_at = |phi: f64| {
            let (x, y) = (near * phi.sin(), far * (angle - phi).sin());
            if phi <= 0.0 || x <= 0.0 {
                0.0
            } else if phi >= angle || y <= 0.0 {
                1.0
            } else {
                x / (x + y)
            }
        };
        let end = |phi: f64| {
            let t = t_at(phi);
            let at = a + t * (b - a);
            End { phi, t: span[0] + t * (span[1] - span[0]), at, range: at.length(), pixel: self.project(at) }
        };
        let pieces = (angle / (COARSE * self.pixel_angle)).ceil().clamp(1.0, MAX_COARSE);
        let mut left = MAX_SEGMENT_SAMPLES;
        let mut from = end(0.0);
        for i in 1..=pieces as u32 {
            let mut to = end(angle * f64::from(i) / pieces);
            // Past the sensor's centre t hardly changes, and rounding could turn it back.
            to.t = to.t.max(from.t);
            self.halve(&from, &to, MAX_DEPTH, &end, &mut left, visit);
            from = to;
        }
    }

    fn halve(
        &self,
        from: &End,
        to: &End,
        depth: u32,
        end: &impl Fn(f64) -> End,
        left: &mut usize,
        visit: &mut impl FnMut(Piece),
    ) {
        let middle = || {
            let m = end(0.5 * (from.phi + to.phi));
            End { t: m.t.clamp(from.t, to.t), ..m }
        };
        let t = [from.t, to.t];
        let apart = from.pixel.zip(to.pixel).map(|(p, q)| self.distance(p, q));
        let short = apart.is_some_and(|d| d <= self.step);
        let last =
            depth == 0 || *left == 0 || to.phi - from.phi <= 0.25 * self.step * self.pixel_angle && apart.is_none();
        if short || last {
            let m = middle();
            *left = left.saturating_sub(1);
            let inside = m.pixel.filter(|pixel| self.holds(m.at, *pixel));
            return visit(match inside {
                Some(pixel) => Piece::Inside(Sample {
                    t,
                    at: m.at,
                    pixel,
                    ends: [from.pixel.unwrap_or(pixel), to.pixel.unwrap_or(pixel)],
                    weight: apart.unwrap_or(0.0).min(self.step),
                }),
                None => self.outside(m.at, t),
            });
        }
        if apart.is_some_and(|d| d <= RUN) && self.run(from, to, &middle(), left, visit) {
            return;
        }
        let off = |pixel: DVec2| {
            let out = (DVec2::splat(-0.5) - pixel).max(pixel - (self.size - 0.5)).max(DVec2::ZERO);
            out.max_element()
        };
        let skipped = match (from.pixel, to.pixel, apart) {
            (Some(p), Some(q), Some(d)) => off(p).min(off(q)) > d + 2.0,
            (None, None, _) => true,
            _ => false,
        };
        if skipped {
            return visit(self.outside(middle().at, t));
        }
        let m = middle();
        self.halve(from, &m, depth - 1, end, left, visit);
        self.halve(&m, to, depth - 1, end, left, visit);
    }

    /// Samples a piece of an arc whose image is straight but for [`BENT`]; false if it is not.
    ///
    /// Samples are at equal angles: at share s of it the arc is at share s p / (s p + (1 - s) q) of the straight line between
    /// its ends in space, at ranges p and q, but for the square of the angle.
    fn run(&self, from: &End, to: &End, middle: &End, left: &mut usize, visit: &mut impl FnMut(Piece)) -> bool {
        let (Some(p), Some(q), Some(m)) = (from.pixel, to.pixel, middle.pixel) else { return false };
        // Beams are tall or thin: samples are held to them one by one.
        let plain = self.cone.is_none() && self.beams.is_none();
        let length = p.distance(q);
        let count = (length / self.step).ceil().max(1.0);
        if !(plain && m.distance(0.5 * (p + q)) <= BENT && count as usize <= *left) || length > RUN {
            return false;
        }
        *left -= count as usize;
        let step = 1.0 / count;
        let along = |s: f64| s * from.range / (s * from.range + (1.0 - s) * to.range);
        let (mut t0, mut p0) = (from.t, p);
        for i in 0..count as u32 {
            let s = f64::from(i + 1) * step;
            let last = f64::from(i + 1) == count;
            let (t1, p1) = if last { (to.t, q) } else { (from.t + along(s) * (to.t - from.t), p.lerp(q, s)) };
            let half = s - 0.5 * step;
            let (at, pixel, t) = (from.at.lerp(to.at, along(half)), p.lerp(q, half), [t0, t1]);
            visit(if self.holds(at, pixel) {
                Piece::Inside(Sample { t, at, pixel, ends: [p0, p1], weight: length * step })
            } else {
                self.outside(at, t)
            });
            (t0, p0) = (t1, p1);
        }
        true
    }

    /// Distance in the image, over the seam if that is nearer.
    fn distance(&self, p: DVec2, q: DVec2) -> f64 {
        let mut by = (p - q).abs();
        if let Some(turn) = self.turn {
            by.x = by.x.min((turn - by.x).abs());
        }
        by.length()
    }

    /// Samples the area of a convex patch in the image, corners in the image frame; `t` of the samples is 0..=1 and
    /// their weight the area that they stand for. Without any in the image, one piece says why. Columns may lie beyond the
    /// seam.
    pub fn patch(&self, corners: &[DVec3], visit: &mut impl FnMut(Piece)) {
        // With as few as every half pixel, finer steps would change nothing of large patches.
        let times = (STEP / self.step).powi(2).clamp(1.0, 64.0);
        self.patch_in_cells(corners, (MAX_PATCH_SAMPLES as f64 * times) as usize, visit);
    }

    /// The same of a patch that covers few pixels, however long and thin it is.
    pub(super) fn small_patch(&self, corners: &[DVec3], visit: &mut impl FnMut(Piece)) {
        self.patch_in_cells(corners, MAX_PATCH_CELLS, visit);
    }

    fn patch_in_cells(&self, corners: &[DVec3], most: usize, visit: &mut impl FnMut(Piece)) {
        let Some(cone) = PatchCone::new(corners) else {
            // Seen from its edge, as far as can be told.
            return visit(self.edge_on(corners));
        };
        let bounds = self.patch_bounds(corners, &cone);
        let mut any = false;
        if let Some([low, high]) = bounds {
            let flat = self.cone.is_some_and(|[l, h]| l == h);
            let size = high - low;
            let area = if flat { size.x * self.step } else { size.x * size.y };
            let step = (area / most as f64).sqrt().max(self.step);
            let columns = (size.x / step).ceil().max(1.0);
            let rows = if flat { 1.0 } else { (size.y / step).ceil().max(1.0) };
            let cell = DVec2::new(size.x / columns, size.y / rows);
            let weight = if flat { cell.x } else { cell.x * cell.y };
            self.visit_cells(&cone, [low, cell, DVec2::new(columns, rows)], flat, &mut |at, pixel| {
                any = true;
                visit(Piece::Inside(Sample { t: [0.0, 1.0], at, pixel, ends: [pixel, pixel], weight }));
            });
        }
        if !any {
            visit(self.edge_on(corners));
        }
    }

    /// Visits the middles of the cells of a grid in which a patch is seen, row by row: where it is, and the pixel.
    fn visit_cells(
        &self,
        cone: &PatchCone,
        [low, cell, count]: [DVec2; 3],
        flat: bool,
        visit: &mut impl FnMut(DVec3, DVec2),
    ) {
        let at = |low: f64, cell: f64, count: f64| -> Vec<f64> {
            (0..count as u32).map(|i| low + cell * (f64::from(i) + 0.5)).collect()
        };
        let (columns, rows) = (at(low.x, cell.x, count.x), at(low.y, cell.y, count.y));
        let rows = if flat { vec![0.0] } else { rows };
        let mut meet = |ray: Option<DVec3>, pixel: DVec2| {
            let at = ray.and_then(|ray| cone.meet(ray));
            if let Some(at) = at.filter(|at| self.holds(*at, pixel)) {
                visit(at, pixel);
            }
        };
        let Some((parts, axis, times)) = self.sensor.rays_by_column(&columns, &rows) else {
            for v in &rows {
                columns.iter().for_each(|u| meet(self.sensor.ray_at(*u, *v), DVec2::new(*u, *v)));
            }
            return;
        };
        // Of every column the patch is seen between two rows: most cells of a long and thin one are passed over.
        let between: Vec<[f64; 2]> = parts.iter().map(|part| cone.between(*part, axis)).collect();
        for (v, times) in rows.iter().zip(times) {
            for ((u, part), [from, to]) in columns.iter().zip(&parts).zip(&between) {
                if times >= *from && times <= *to {
                    meet(Some(*part + times * axis), DVec2::new(*u, *v));
                }
            }
        }
    }

    /// A patch too small or too flat for a grid: its middle, if that is in the image.
    fn edge_on(&self, corners: &[DVec3]) -> Piece {
        self.point(corners.iter().sum::<DVec3>() / corners.len().max(1) as f64)
    }

    /// A box around a patch's image, cut to the image; over a seam its columns go on beyond the width.
    pub(super) fn patch_bounds(&self, corners: &[DVec3], cone: &PatchCone) -> Option<[DVec2; 2]> {
        let (least, greatest) = (DVec2::splat(-0.5), self.size - 0.5);
        let (mut low, mut high) = (DVec2::INFINITY, DVec2::NEG_INFINITY);
        let mut take = |p: DVec2| (low, high) = (low.min(p), high.max(p));
        for (k, a) in corners.iter().enumerate() {
            let b = corners[(k + 1) % corners.len()];
            self.segment(*a, b, &mut |piece| {
                if let Piece::Inside(s) = piece {
                    s.ends.into_iter().chain([s.pixel]).for_each(|p| take(p.clamp(least, greatest)));
                }
            });
        }
        // Where the image is inside the patch, its own border is the patch's image's border.
        let middle = 0.5 * (least + greatest);
        let mut border = vec![middle];
        for i in 0..=16 {
            let s = f64::from(i) / 16.0;
            let (x, y) = (least.x + s * self.size.x, least.y + s * self.size.y);
            border.extend([(x, least.y), (x, greatest.y), (least.x, y), (greatest.x, y)].map(DVec2::from));
            if self.cone.is_some() {
                border.push(DVec2::new(x, 0.0));
            }
        }
        let covers = |p: &DVec2| self.sensor.ray_at(p.x, p.y).is_some_and(|ray| cone.meet(ray).is_some());
        border.into_iter().filter(covers).for_each(&mut take);
        if low.x > high.x {
            return None;
        }
        if self.pinhole.is_none() && self.sensor.is_camera() || matches!(self.sensor.spec().geometry, Geometry::Rays(_))
        {
            // Curved outlines are followed, but tables may have holes and folds beside them.
            (low, high) = ((low - 1.0).max(least), (high + 1.0).min(greatest));
        }
        if self.turn.is_some() {
            [low.x, high.x] = columns::of_corners(self.sensor, corners).unwrap_or([least.x, greatest.x]);
        }
        // A row without height, or an edge-on sliver: one sample wide at least.
        let (mid, half) = (0.5 * (low + high), (0.5 * (high - low)).max(DVec2::splat(1e-9)));
        Some([mid - half, mid + half])
    }
}

/// A place on an arc.
struct End {
    phi: f64,
    t: f64,
    at: DVec3,
    range: f64,
    pixel: Option<DVec2>,
}

/// The directions to a convex patch, and its plane.
pub(super) struct PatchCone {
    pub edges: Vec<DVec3>,
    normal: DVec3,
    offset: f64,
}

impl PatchCone {
    /// `None` if the sensor is in the patch's plane.
    pub fn new(corners: &[DVec3]) -> Option<Self> {
        let plane = plane_of_polygon(corners)?;
        let reach = corners.iter().map(|p| p.length()).fold(0.0, f64::max);
        if plane.offset.abs() <= 1e-12 * reach {
            return None;
        }
        let sign = plane.offset.signum();
        let edge = |k: usize| sign * corners[k].cross(corners[(k + 1) % corners.len()] - corners[k]);
        Some(Self { edges: (0..corners.len()).map(edge).collect(), normal: plane.normal, offset: plane.offset })
    }

    /// Its product with a unit ray is one over the range there; with any vector, one over how much longer it has to be.
    pub fn inverse(&self) -> DVec3 {
        self.normal / self.offset
    }

    /// Metres.
    pub fn distance(&self) -> f64 {
        self.offset.abs()
    }

    /// Between which multiples of an axis, added to a vector, it may be met; hardly more than needed.
    fn between(&self, part: DVec3, axis: DVec3) -> [f64; 2] {
        let (mut from, mut to) = (f64::NEG_INFINITY, f64::INFINITY);
        for e in &self.edges {
            let (at_0, slope) = (e.dot(part), e.dot(axis));
            let at = -at_0 / slope;
            let slack = 1e-9 * (1.0 + at.abs());
            if slope > 0.0 {
                from = from.max(at - slack);
            } else if slope < 0.0 {
                to = to.min(at + slack);
            }
        }
        [from, to]
    }

    /// Where a ray of any length meets it.
    fn meet(&self, ray: DVec3) -> Option<DVec3> {
        let inverse = self.normal.dot(ray) / self.offset;
        (inverse > 0.0 && self.edges.iter().all(|e| e.dot(ray) >= 0.0)).then(|| ray / inverse)
    }
}

/// Where a segment crosses the cone of an elevation.
fn crossings(a: DVec3, b: DVec3, elevation: f64) -> Vec<f64> {
    let d = b - a;
    let tan = elevation.tan();
    if tan == 0.0 {
        return if d.z == 0.0 { Vec::new() } else { vec![-a.z / d.z] };
    }
    // z^2 = tan^2 (x^2 + y^2), on the side that z has the tangent's sign.
    let square = |p: DVec3, q: DVec3| p.z * q.z - tan * tan * (p.x * q.x + p.y * q.y);
    let (qa, qb, qc) = (square(d, d), square(a, d), square(a, a));
    let mut roots = Vec::new();
    let discriminant = qb * qb - qa * qc;
    if discriminant < 0.0 {
        return roots;
    }
    let q = -(qb + qb.signum() * discriminant.sqrt());
    roots.extend([q / qa, qc / q].into_iter().filter(|t| t.is_finite()));
    roots.retain(|t| (a.z + t * d.z) * tan >= 0.0);
    roots
}

/// About the finest angle between neighbouring rays, radians.
fn pixel_angle(sensor: &Sensor) -> f64 {
    let mean = |angles: &Angles| {
        let n = angles.len();
        if n < 2 { f64::INFINITY } else { ((angles.degrees(n - 1) - angles.degrees(0)) / (n - 1) as f64).abs() }
    };
    if let Geometry::Scanner(Scanner { azimuth, elevation, .. }) = &sensor.spec().geometry {
        let finest = mean(azimuth).min(mean(elevation));
        return if finest.is_finite() && finest > 0.0 { finest.to_radians() } else { 1f64.to_radians() };
    }
    let (w, h) = (sensor.width(), sensor.height());
    let mut finest = f64::INFINITY;
    for i in 0..16 {
        for j in 0..16 {
            let (c, r) = (i * w / 16, j * h / 16);
            let Some(ray) = sensor.ray(c, r) else { continue };
            for other in [(c + 1, r), (c, r + 1)].into_iter().filter_map(|(c, r)| sensor.ray(c, r)) {
                let angle = ray.angle_between(other);
                if angle > 1e-9 {
                    finest = finest.min(angle);
                }
            }
        }
    }
    if finest.is_finite() { finest } else { 1f64.to_radians() }
}
