//! Projects points to continuous pixel coordinates, and finds the ray at given pixel coordinates.
//!
//! The centre of the top-left pixel is (0, 0), and pixel i spans i - 0.5 .. i + 0.5. The ray of a pixel projects to the
//! pixel's own indices. Between the beams of a scanner, coordinates are linear in the angles.

use super::grid::PixelGrid;
use super::ray_grid::RayGrid;
use super::scanner::{Angles, Scanner};
use super::{Geometry, Lens, Sensor, SensorSpec};
use crate::error::{Error, Result};
use glam::{DVec2, DVec3, Vec3};

/// Precomputed data for projection, one per sensor.
#[derive(Debug)]
#[expect(clippy::large_enum_variant, reason = "a sensor has one; a box would cost every projection")]
pub(super) enum Projector {
    /// Straight lines in closed form.
    Pinhole,
    /// A lens model.
    Lens(Lens),
    /// Beam angles.
    Scanner(Beams),
    /// The nearest ray of a table.
    Table,
}

/// Angles of a scanner as rising or falling lists, degrees.
#[derive(Debug)]
pub(super) struct Beams {
    azimuth: Axis,
    elevation: Axis,
}

/// Angles by pixel number.
#[derive(Debug)]
enum Axis {
    Uniform {
        start: f64,
        step: f64,
        count: usize,
    },
    /// At least two, rising or falling. If the pixels go fully round, one more on either side of them.
    Listed {
        angles: Vec<f64>,
        is_round: bool,
    },
}

impl Axis {
    /// `lone` is the angle that one pixel spans if there is only one.
    fn new(angles: &[f64], uniform: Option<f64>, lone: f64) -> Self {
        match (angles, uniform) {
            ([only], step) => {
                Self::Uniform { start: *only, step: step.filter(|s| *s != 0.0).unwrap_or(lone), count: 1 }
            }
            ([first, ..], Some(step)) => Self::Uniform { start: *first, step, count: angles.len() },
            _ => Self::Listed { angles: angles.to_vec(), is_round: false },
        }
    }

    /// With the neighbours of the first and of the last pixel over the seam, of `turn` columns in 360 degrees.
    fn closed(self, turn: f64) -> Self {
        let Self::Listed { angles, is_round: false } = self else { return self };
        let (count, distinct) = (angles.len(), turn as usize);
        let by = 360f64.copysign(angles[count - 1] - angles[0]);
        let (before, after) = (angles[distinct - 1] - by, angles[count - distinct] + by);
        let angles = std::iter::once(before).chain(angles).chain([after]).collect();
        Self::Listed { angles, is_round: true }
    }

    fn ends(&self) -> (f64, f64) {
        match self {
            Self::Uniform { start, step, count } => (*start, start + (*count - 1) as f64 * step),
            Self::Listed { angles, is_round } => {
                let beside = usize::from(*is_round);
                (angles[beside], angles[angles.len() - 1 - beside])
            }
        }
    }

    /// Continuous pixel index at an angle.
    fn number(&self, angle: f64) -> f64 {
        match self {
            Self::Uniform { start, step, .. } => (angle - start) / step,
            Self::Listed { angles, is_round } => {
                let rising = angles[1] > angles[0];
                let after = angles.partition_point(|a| if rising { *a <= angle } else { *a >= angle });
                let i = after.clamp(1, angles.len() - 1) - 1;
                i as f64 + (angle - angles[i]) / (angles[i + 1] - angles[i]) - f64::from(*is_round)
            }
        }
    }

    /// The angle at a continuous pixel index.
    fn angle(&self, number: f64) -> f64 {
        match self {
            Self::Uniform { start, step, .. } => start + number * step,
            Self::Listed { angles, is_round } => {
                let number = number + f64::from(*is_round);
                let i = (number.floor().max(0.0) as usize).min(angles.len() - 2);
                angles[i] + (number - i as f64) * (angles[i + 1] - angles[i])
            }
        }
    }
}

impl Beams {
    fn new(scanner: &Scanner) -> Self {
        let azimuths: Vec<f64> = (0..scanner.azimuth.len()).map(|i| scanner.azimuth.degrees(i)).collect();
        let rows = scanner.rows_deg();
        let step = |angles: &Angles| match angles {
            Angles::Uniform { step_deg, .. } => Some(*step_deg),
            Angles::Listed(_) => None,
        };
        let azimuth = Axis::new(&azimuths, step(&scanner.azimuth), 1.0);
        let azimuth = match scanner.columns_of_a_turn() {
            Some(turn) => azimuth.closed(turn),
            None => azimuth,
        };
        let (first, last) = azimuth.ends();
        let across = if azimuths.len() > 1 { (last - first).abs() / (azimuths.len() - 1) as f64 } else { 1.0 };
        // Rows have falling elevation, whatever the order in the file. A single row is as high as its beam, or square.
        let lone = scanner.beam_height_deg.filter(|h| *h > 0.0).unwrap_or(across);
        let falling = if rows.len() > 1 { step(&scanner.elevation).map(|s| -s.abs()) } else { Some(-lone) };
        Self { azimuth, elevation: Axis::new(&rows, falling, -lone) }
    }

    fn project(&self, p: DVec3) -> (f64, f64) {
        let flat = p.x.hypot(p.y);
        let azimuth = p.y.atan2(p.x).to_degrees();
        let elevation = p.z.atan2(flat).to_degrees();
        // Uses the turn nearest to the middle of the image.
        let (first, last) = self.azimuth.ends();
        let middle = 0.5 * (first + last);
        let azimuth = azimuth + 360.0 * ((middle - azimuth) / 360.0).round();
        (self.azimuth.number(azimuth), self.elevation.number(elevation))
    }

    /// [`Beams::project`] in f32, accurate enough to find the pixel.
    #[inline(always)]
    fn project_nearly(&self, p: Vec3) -> (f32, f32) {
        let flat = (p.x * p.x + p.y * p.y).sqrt();
        let azimuth = f64::from(atan2_nearly(p.y, p.x)).to_degrees();
        let elevation = f64::from(atan2_nearly(p.z, flat)).to_degrees();
        let (first, last) = self.azimuth.ends();
        let turns = (0.5 * (first + last) - azimuth) / 360.0;
        let azimuth = azimuth + 360.0 * turns.round_ties_even();
        (self.azimuth.number(azimuth) as f32, self.elevation.number(elevation) as f32)
    }

    fn ray(&self, u: f64, v: f64) -> DVec3 {
        let elevation = self.elevation.angle(v).clamp(-90.0, 90.0).to_radians();
        let azimuth = (self.azimuth.angle(u) % 360.0).to_radians();
        let ((sa, ca), (se, ce)) = (azimuth.sin_cos(), elevation.sin_cos());
        DVec3::new(ce * ca, ce * sa, se)
    }
}

/// atan2 to 3e-6 radians, NaN at the origin.
#[inline(always)]
fn atan2_nearly(y: f32, x: f32) -> f32 {
    use std::f32::consts::{FRAC_PI_2, PI};
    let (ax, ay) = (x.abs(), y.abs());
    let t = ax.min(ay) / ax.max(ay);
    let s = t * t;
    // Minimax odd polynomial of degree 11 for the arc tangent on 0..1.
    let p = ((((-0.011_721_2 * s + 0.052_653_32) * s - 0.116_432_87) * s + 0.193_543_46) * s - 0.332_623_47) * s
        + 0.999_977_26;
    let first = if ay > ax { FRAC_PI_2 - p * t } else { p * t };
    (if x < 0.0 { PI - first } else { first }).copysign(y)
}

impl Projector {
    pub(super) fn new(spec: &SensorSpec) -> Self {
        match &spec.geometry {
            Geometry::Camera(c) if c.distortion.is_none() => Self::Pinhole,
            Geometry::Camera(c) => Self::Lens(c.distortion.lens()),
            Geometry::Scanner(s) => Self::Scanner(Beams::new(s)),
            Geometry::Rays(_) => Self::Table,
        }
    }
}

impl Sensor {
    /// Continuous pixel coordinates (column, row) of a point of the image frame at any distance; the centre of the
    /// top-left pixel is (0, 0). They may lie outside the image, which spans -0.5..width - 0.5 by -0.5..height - 0.5.
    ///
    /// Returns `None` where the sensor images nothing: behind a camera, beyond the fold of a lens, in a hole of a ray
    /// table, and at the sensor itself. For a scanner, the azimuth nearest to the middle of the image is used, so the
    /// one seam lies opposite to it; at the poles every column is correct. The pixel of a single row is as high as the
    /// beam (`beam_height_deg`), or square if that is 0. For a ray table, the result is the nearest ray's pixel plus a
    /// fraction interpolated from that ray's neighbours.
    ///
    /// ```
    /// use presight::sensor::{Camera, Geometry, SensorSpec};
    /// use presight::Sensor;
    /// use glam::DVec3;
    /// let camera = Camera::pinhole(640, 480, 500.0, 500.0, 319.5, 239.5);
    /// let sensor = Sensor::new(SensorSpec::new("camera", "video", Geometry::Camera(camera)))?;
    /// // 2 m ahead, 0.5 m to the right.
    /// assert_eq!(sensor.project(DVec3::new(0.5, 0.0, 2.0)), Some((444.5, 239.5)));
    /// assert_eq!(sensor.project(DVec3::NEG_Z), None);
    /// # Ok::<(), presight::Error>(())
    /// ```
    pub fn project(&self, p_in_image: DVec3) -> Option<(f64, f64)> {
        let p = p_in_image;
        if !p.is_finite() || p == DVec3::ZERO {
            return None;
        }
        match (self.projector(), &self.spec().geometry) {
            (Projector::Pinhole, Geometry::Camera(c)) => {
                (p.z > 0.0).then(|| (c.fx * (p.x / p.z) + c.cx, c.fy * (p.y / p.z) + c.cy))
            }
            (Projector::Lens(lens), Geometry::Camera(c)) => {
                let (x, y) = lens.distort(p)?;
                Some((c.fx * x + c.cx, c.fy * y + c.cy))
            }
            (Projector::Scanner(beams), _) => Some(beams.project(p)),
            _ => match self.grid() {
                PixelGrid::Rays(table) => in_table(table, p.normalize()).map(|p| (p.x, p.y)),
                PixelGrid::Lines(_) => None,
            },
        }
    }

    /// [`Sensor::project`] in f32 for searches in an image. Accurate to 1e-5 radians, and to a pixel for a ray table.
    /// At the sensor itself the result is `None` or NaN.
    #[inline(always)]
    pub fn project_nearly(&self, p: Vec3) -> Option<(f32, f32)> {
        match (self.projector(), &self.spec().geometry) {
            (Projector::Pinhole, Geometry::Camera(c)) => {
                let s = 1.0 / p.z;
                (p.z > 0.0).then_some((p.x * s * c.fx as f32 + c.cx as f32, p.y * s * c.fy as f32 + c.cy as f32))
            }
            (Projector::Scanner(beams), _) => Some(beams.project_nearly(p)),
            (Projector::Table, _) => {
                let (u, v) = self.near_pixel(p.as_dvec3().try_normalize()?)?;
                Some((u as f32, v as f32))
            }
            _ => self.project(p.as_dvec3()).map(|(u, v)| (u as f32, v as f32)),
        }
    }

    /// The unit ray in the image frame at continuous pixel coordinates: the inverse of [`Sensor::project`]. Returns
    /// `None` outside the domain of a lens, and between rays of a table if one of them is missing.
    pub fn ray_at(&self, u: f64, v: f64) -> Option<DVec3> {
        match (self.projector(), &self.spec().geometry) {
            (Projector::Pinhole, Geometry::Camera(c)) => {
                let (x, y) = c.normalized(u, v);
                Some(DVec3::new(x, y, 1.0).normalize())
            }
            (Projector::Lens(lens), Geometry::Camera(c)) => {
                let (x, y) = c.normalized(u, v);
                lens.undistort(x, y).map(DVec3::normalize)
            }
            (Projector::Scanner(beams), _) => Some(beams.ray(u, v)),
            _ => self.between_rays(u, v),
        }
    }

    /// Factors the rays at columns and rows as `ray = column part + row multiple * axis`, not normalized. Returns the
    /// column parts, the axis and the row multiples, or `None` if the rays have no such factors.
    pub fn rays_by_column(&self, columns: &[f64], rows: &[f64]) -> Option<(Vec<DVec3>, DVec3, Vec<f64>)> {
        match (self.projector(), &self.spec().geometry) {
            (Projector::Pinhole, Geometry::Camera(c)) => {
                let column = |u: &f64| DVec3::new(c.normalized(*u, 0.0).0, 0.0, 1.0);
                let row = |v: &f64| c.normalized(0.0, *v).1;
                Some((columns.iter().map(column).collect(), DVec3::Y, rows.iter().map(row).collect()))
            }
            (Projector::Scanner(beams), _) => {
                let column = |u: &f64| {
                    let (sin, cos) = (beams.azimuth.angle(*u) % 360.0).to_radians().sin_cos();
                    DVec3::new(cos, sin, 0.0)
                };
                let row = |v: &f64| beams.elevation.angle(*v).clamp(-90.0, 90.0).to_radians().tan();
                Some((columns.iter().map(column).collect(), DVec3::Z, rows.iter().map(row).collect()))
            }
            _ => None,
        }
    }

    /// Bilinear interpolation between the rays of a table.
    fn between_rays(&self, u: f64, v: f64) -> Option<DVec3> {
        let (w, h) = (self.width(), self.height());
        let inside = u >= -0.5 && v >= -0.5 && u <= f64::from(w) - 0.5 && v <= f64::from(h) - 0.5;
        if !inside {
            return None;
        }
        let near = |x: f64, n: u32| {
            let x = x.clamp(0.0, f64::from(n - 1));
            let i = (x.floor() as u32).min(n - 1);
            (i, (i + 1).min(n - 1), x - f64::from(i))
        };
        let ((c0, c1, s), (r0, r1, t)) = (near(u, w), near(v, h));
        let mut sum = DVec3::ZERO;
        for (column, row, share) in
            [(c0, r0, (1.0 - s) * (1.0 - t)), (c1, r0, s * (1.0 - t)), (c0, r1, (1.0 - s) * t), (c1, r1, s * t)]
        {
            if share > 0.0 {
                sum += share * self.ray(column, row)?;
            }
        }
        sum.try_normalize()
    }

    /// Number of columns of a full turn, if the last column of a scanner is next to the first.
    pub fn columns_of_a_turn(&self) -> Option<f64> {
        let Geometry::Scanner(scanner) = &self.spec().geometry else { return None };
        scanner.columns_of_a_turn()
    }

    /// Checks that features can be projected onto the sensor's image.
    ///
    /// # Errors
    /// [`crate::ErrorKind::Invalid`] for a ray table with fewer than two rays: the angle that a single ray covers is
    /// unknown.
    pub fn check_projection(&self) -> Result<()> {
        let PixelGrid::Rays(table) = self.grid() else { return Ok(()) };
        if matches!(self.spec().geometry, Geometry::Camera(_)) {
            return Ok(());
        }
        let rays = table.directions().filter(|d| !d.is_nan()).take(2).count();
        if rays < 2 {
            let what = "cannot project features onto a ray table with fewer than two rays";
            return Err(Error::invalid(what, "list at least two rays, or predict without features")
                .at(format!("sensor {:?}", self.spec().name)));
        }
        Ok(())
    }
}

/// The pixel of the nearest ray of a table, plus a fraction; `None` farther from that ray than its neighbours are.
fn in_table(table: &RayGrid, ray: DVec3) -> Option<DVec2> {
    let (column, row, near) = nearest_ray(table, ray)?;
    let at = |dc: i64, dr: i64| {
        let (c, r) = (i64::from(column) + dc, i64::from(row) + dr);
        let inside = (0..i64::from(table.width())).contains(&c) && (0..i64::from(table.height())).contains(&r);
        let d = inside.then(|| table.direction(c as u32, r as u32))?;
        (!d.is_nan()).then_some(d)
    };
    // Offset from the nearest ray to this one, in the plane that touches the unit sphere at the nearest ray.
    let off = ray / ray.dot(near) - near;
    // One pixel step along an axis: towards the neighbour on the ray's side, or away from the other neighbour.
    let step = |dc: i64, dr: i64| {
        let ahead = at(dc, dr).map(|d| d / d.dot(near) - near);
        let behind = at(-dc, -dr).map(|d| near - d / d.dot(near));
        match (ahead, behind) {
            (Some(a), Some(b)) => Some(if off.dot(a) >= 0.0 { a } else { b }),
            (a, b) => a.or(b),
        }
    };
    let (x, y) = (step(1, 0), step(0, 1));
    let widest = [x, y].into_iter().flatten().map(DVec3::length).fold(0.0, f64::max);
    if !(off.length() <= widest.max(1e-12)) {
        return None;
    }
    let fraction = match (x, y) {
        (Some(x), Some(y)) => {
            let (xx, xy, yy) = (x.dot(x), x.dot(y), y.dot(y));
            let determinant = xx * yy - xy * xy;
            let (bx, by) = (off.dot(x), off.dot(y));
            if determinant > 1e-6 * xx * yy {
                DVec2::new(bx * yy - by * xy, by * xx - bx * xy) / determinant
            } else {
                DVec2::ZERO
            }
        }
        (Some(x), None) => DVec2::new(off.dot(x) / x.dot(x), 0.0),
        (None, Some(y)) => DVec2::new(0.0, off.dot(y) / y.dot(y)),
        (None, None) => DVec2::ZERO,
    };
    let fraction = if fraction.is_finite() { fraction.clamp(DVec2::NEG_ONE, DVec2::ONE) } else { DVec2::ZERO };
    Some(DVec2::new(f64::from(column), f64::from(row)) + fraction)
}

/// Pixel and direction of the ray nearest to a direction.
fn nearest_ray(table: &RayGrid, ray: DVec3) -> Option<(u32, u32, DVec3)> {
    let mut best: Option<(f64, u32, u32, DVec3)> = None;
    let mut best_angle = f64::INFINITY;
    for tile in table.tiles().iter().filter(|t| t.half_angle >= 0.0) {
        if tile.axis.angle_between(ray) - tile.half_angle > best_angle {
            continue;
        }
        for row in tile.row..tile.row + tile.height {
            for column in tile.column..tile.column + tile.width {
                let d = table.direction(column, row);
                // NaN is never nearer.
                let apart = d.distance_squared(ray);
                if best.is_none_or(|b| apart < b.0) && !d.is_nan() {
                    best = Some((apart, column, row, d));
                    best_angle = 2.0 * (0.5 * apart.sqrt()).min(1.0).asin() + 1e-7;
                }
            }
        }
    }
    best.filter(|b| b.0 < 1.0).map(|(_, column, row, d)| (column, row, d))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sensor::{Camera, Distortion, RayTable};
    use proptest::prelude::*;

    fn sensor(geometry: Geometry) -> Sensor {
        Sensor::new(SensorSpec::new("s", "laser", geometry)).unwrap()
    }

    fn scanner(azimuth: Angles, elevation: Angles) -> Sensor {
        sensor(Geometry::Scanner(Scanner { azimuth, elevation, beam_height_deg: None }))
    }

    fn uniform(start_deg: f64, step_deg: f64, count: u32) -> Angles {
        Angles::Uniform { start_deg, step_deg, count }
    }

    fn sensors() -> Vec<Sensor> {
        let lens = |d: Distortion| {
            let camera = Camera { distortion: d, ..Camera::pinhole(61, 47, 50.0, 55.0, 29.0, 24.5) };
            sensor(Geometry::Camera(camera))
        };
        let table: Vec<DVec3> = (0..20 * 30)
            .map(|i| {
                let (c, r) = (i % 30, i / 30);
                if (c + 3 * r) % 17 == 5 {
                    return DVec3::NAN;
                }
                DVec3::new(1.0, 0.04 * f64::from(15 - c), 0.05 * f64::from(10 - r) + 0.003 * f64::from(c))
            })
            .collect();
        vec![
            lens(Distortion::None),
            lens(Distortion::PlumbBob([-0.28, 0.07, 1e-3, -5e-4, 0.0])),
            lens(Distortion::Equidistant([0.02, -0.01, 0.0, 0.0])),
            scanner(uniform(-180.0, 1.0, 360), uniform(-40.0, 2.0, 41)),
            scanner(uniform(200.0, -0.7, 300), Angles::Listed(vec![-80.0, 3.0, 4.0, 40.0, 89.0])),
            scanner(Angles::Listed(vec![-50.0, -10.0, 0.0, 1.0, 90.0]), uniform(0.0, 0.0, 1)),
            sensor(Geometry::Rays(RayTable::new(30, 20, table).unwrap())),
            sensor(Geometry::Camera(Camera::pinhole(512, 512, 443.4, 443.4, 255.5, 255.5))),
            scanner(uniform(-90.0, 0.5, 361), uniform(0.0, 0.0, 1)),
            scanner(uniform(-180.0, 0.28125, 1280), uniform(-20.0, 0.2, 200)),
            scanner(uniform(-180.0, 0.2, 1800), Angles::Listed((0..16).map(|i| f64::from(2 * i - 15)).collect())),
        ]
    }

    /// Ray tables are accurate to the pixel only.
    #[test]
    fn what_is_projected_nearly_is_near() {
        for sensor in sensors() {
            let all = (0..sensor.height()).flat_map(|row| (0..sensor.width()).map(move |column| (column, row)));
            for (column, row) in all.step_by(7) {
                let Some(ray) = sensor.ray(column, row) else { continue };
                let (u, v) = sensor.project_nearly(3.0 * ray.as_vec3()).unwrap();
                let off = (u - column as f32).hypot(v - row as f32);
                assert!(off < 0.01, "{}: {u} {v} instead of {column} {row}", sensor.spec().name);
            }
            assert!(!sensor.project_nearly(Vec3::ZERO).is_some_and(|(u, v)| u.is_finite() && v.is_finite()));
        }
    }

    #[test]
    fn rays_come_back_as_their_pixels() {
        for sensor in sensors() {
            let (w, h) = (sensor.width(), sensor.height());
            let mut worst: f64 = 0.0;
            for row in (0..h).step_by(h.div_ceil(40) as usize) {
                for column in (0..w).step_by(w.div_ceil(40) as usize) {
                    let Some(ray) = sensor.ray(column, row) else { continue };
                    let (u, v) = sensor.project(ray * 3.7).unwrap();
                    worst = worst.max((u - f64::from(column)).hypot(v - f64::from(row)));
                    let back = sensor.ray_at(f64::from(column), f64::from(row)).unwrap();
                    assert!(back.distance(ray) < 1e-12, "{}", sensor.spec().name);
                }
            }
            assert!(worst < 1e-8, "{}: {worst}", sensor.spec().name);
        }
    }

    #[test]
    fn what_is_not_imaged_has_no_coordinates() {
        let camera = sensor(Geometry::Camera(Camera::pinhole(4, 3, 2.0, 2.0, 1.5, 1.0)));
        for p in [DVec3::NEG_Z, DVec3::X, DVec3::ZERO, DVec3::NAN] {
            assert_eq!(camera.project(p), None);
        }
        let table = RayTable::new(2, 1, vec![DVec3::X, DVec3::new(1.0, 0.1, 0.0)]).unwrap();
        let rays = sensor(Geometry::Rays(table));
        let (u, v) = rays.project(DVec3::new(1.0, 0.05, 0.0)).unwrap();
        assert!((u - 0.5).abs() < 5e-3 && v == 0.0, "{u} {v}");
        assert_eq!(rays.project(DVec3::new(1.0, 0.5, 0.0)), None);
        assert_eq!(rays.project(DVec3::NEG_X), None);
        assert!(rays.check_projection().is_ok());
        let lone = sensor(Geometry::Rays(RayTable::new(2, 1, vec![DVec3::X, DVec3::NAN]).unwrap()));
        let e = lone.check_projection().unwrap_err();
        assert!(e.to_string().contains("fewer than two rays"), "{e}");
    }

    #[test]
    fn a_whole_turn_has_no_end() {
        assert_eq!(scanner(uniform(-180.0, 1.0, 360), uniform(0.0, 0.0, 1)).columns_of_a_turn(), Some(360.0));
        assert_eq!(scanner(uniform(-180.0, 1.0, 350), uniform(0.0, 0.0, 1)).columns_of_a_turn(), None);
        let back = scanner(uniform(-180.0, 1.0, 360), uniform(0.0, 0.0, 1)).project(DVec3::new(-1.0, -1e-9, 0.0));
        assert!((back.unwrap().0).abs() < 1e-6, "{back:?}");
        // A turn has a column that comes twice only once.
        let twice = |azimuth| scanner(azimuth, uniform(0.0, 0.0, 1)).columns_of_a_turn().unwrap();
        assert!((twice(uniform(-180.0, 0.500_695_410_292_072_3, 720)) - 719.0).abs() < 1e-9);
        assert_eq!(twice(Angles::Listed(vec![-180.0, -50.0, 10.0, 180.0])), 3.0);
    }

    /// By hand: azimuths 40, 90, 200 and 340 degrees go round: from the last to the first it is 60 degrees, less
    /// than two steps of 140. 15 degrees lie 35 of them behind 340, and 25 before 40.
    #[test]
    fn uneven_columns_go_on_over_the_seam() {
        let at = |degrees: f64| DVec3::new(degrees.to_radians().cos(), degrees.to_radians().sin(), 0.0);
        for falling in [false, true] {
            let sign = if falling { -1.0 } else { 1.0 };
            let listed = [40.0, 90.0, 200.0, 340.0].map(|a| sign * a);
            let s = scanner(Angles::Listed(listed.to_vec()), uniform(0.0, 0.0, 1));
            assert_eq!(s.columns_of_a_turn(), Some(4.0));
            for (degrees, column) in [(90.0, 1.0), (270.0, 2.5), (355.0, 3.25), (15.0, -25.0 / 60.0)] {
                let (u, _) = s.project(at(sign * degrees)).unwrap();
                assert!((u - column).abs() < 1e-9, "{degrees}: {u}");
                assert!(s.ray_at(u, 0.0).unwrap().distance(at(sign * degrees)) < 1e-9, "{degrees}");
            }
        }
        let half = scanner(Angles::Listed(vec![0.0, 90.0, 170.0]), uniform(0.0, 0.0, 1));
        assert_eq!(half.columns_of_a_turn(), None);
    }

    proptest! {
        /// Also between pixels.
        #[test]
        fn projection_undoes_rays(which in 0..15usize, u in 0.0..1.0f64, v in 0.0..1.0f64) {
            let all = sensors();
            let sensor = &all[which % all.len()];
            let (u, v) = (u * f64::from(sensor.width() - 1), v * f64::from(sensor.height() - 1));
            if let Some(ray) = sensor.ray_at(u, v) {
                prop_assert!((ray.length() - 1.0).abs() < 1e-12);
                let (pu, pv) = sensor.project(ray * 0.2).unwrap();
                // For tables, both directions are linear approximations.
                let near = if matches!(sensor.spec().geometry, Geometry::Rays(_)) { 0.1 } else { 1e-7 };
                prop_assert!((pu - u).hypot(pv - v) < near, "{}: {u} {v} {pu} {pv}", sensor.spec().name);
            }
        }
    }
}
