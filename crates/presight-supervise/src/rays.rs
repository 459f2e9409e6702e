//! The rays of a sensor and the angles between them.

use glam::{DMat3, DVec3, Vec3};
use presight_model::sensor::{Geometry, Sensor};
use presight_model::statistics::median;

/// Rays of a sensor in its body axes.
pub struct SensorRays {
    pub sensor: Sensor,
    pub width: usize,
    pub height: usize,
    /// Unit rays, row by row; NaN for a pixel without a ray.
    pub rays: Vec<Vec3>,
    /// The larger angle to the neighbours in the row and in the column, radians; infinite without a neighbour.
    pub spacing: Vec<[f32; 2]>,
    /// True if the last column is next to the first.
    pub is_closed: bool,
    /// Tangent of the elevation of a scanner's only row.
    pub only_row: Option<f32>,
    image_from_body: DMat3,
    is_table: bool,
}

impl SensorRays {
    pub fn new(sensor: &Sensor) -> Self {
        let (width, height) = (sensor.width() as usize, sensor.height() as usize);
        let body_from_image = sensor.body_from_image();
        let ray = |i: usize| sensor.ray((i % width) as u32, (i / width) as u32).map(|ray| body_from_image * ray);
        let rays: Vec<Vec3> = (0..width * height).map(|i| ray(i).map_or(Vec3::NAN, |r| r.as_vec3())).collect();
        let is_table = matches!(sensor.spec().geometry, Geometry::Rays(_));
        let is_turn = sensor.columns_of_a_turn().is_some_and(|turn| (turn - width as f64).abs() < 1.5);
        let is_closed = is_turn || is_table && height > 1 && is_round(&rays, [width, height]);
        let is_scanner = matches!(sensor.spec().geometry, Geometry::Scanner(_));
        let only_row = (is_scanner && height == 1).then(|| rays[0].z / rays[0].x.hypot(rays[0].y));
        let spacing = (0..rays.len()).map(|i| spacing_at(&rays, [width, height], i, is_closed)).collect();
        Self {
            sensor: sensor.clone(),
            width,
            height,
            rays,
            spacing,
            is_closed,
            only_row,
            image_from_body: body_from_image.transpose(),
            is_table,
        }
    }

    /// Column and row of a point in the sensor's body axes; `None` outside of the image.
    pub fn project(&self, p: DVec3) -> Option<[f32; 2]> {
        let in_image = self.image_from_body * p;
        let (u, v) = if self.is_table {
            // Between the rays: the nearest one alone would move cells by half a pixel.
            self.sensor.project(in_image).map(|(u, v)| (u as f32, v as f32))?
        } else {
            self.sensor.project_nearly(in_image.as_vec3())?
        };
        if !(u.is_finite() && v.is_finite()) {
            return None;
        }
        if self.is_table {
            // The nearest ray of a table may be far from a point that the table does not see.
            let (column, row) =
                (u.round().clamp(0.0, (self.width - 1) as f32), v.round().clamp(0.0, (self.height - 1) as f32));
            let at = row as usize * self.width + column as usize;
            let angle = self.rays[at].angle_between(p.as_vec3());
            let [across, down] = self.spacing[at];
            return (angle <= across.hypot(down)).then_some([u, v]);
        }
        Some(if self.only_row.is_some() { [u, 0.0] } else { [u, v] })
    }

    /// The pixel nearest to a place of the image; `None` outside of it.
    pub fn pixel(&self, [u, v]: [f32; 2]) -> Option<usize> {
        let (u, v) = (u.round(), v.round());
        let u = if self.is_closed { u.rem_euclid(self.width as f32) } else { u };
        let inside = u >= 0.0 && v >= 0.0 && u < self.width as f32 && v < self.height as f32;
        inside.then(|| v as usize * self.width + u as usize)
    }

    /// The up to eight pixels around a pixel.
    pub fn around(&self, at: usize) -> impl Iterator<Item = usize> + '_ {
        let (column, row) = ((at % self.width) as i64, (at / self.width) as i64);
        let steps = (-1..=1).flat_map(|v| (-1..=1).map(move |u| (u, v))).filter(|step| *step != (0, 0));
        steps.filter_map(move |(u, v)| {
            let (mut column, row) = (column + u, row + v);
            if self.is_closed {
                column = column.rem_euclid(self.width as i64);
            }
            let inside = (0..self.width as i64).contains(&column) && (0..self.height as i64).contains(&row);
            inside.then(|| row as usize * self.width + column as usize)
        })
    }
}

/// True if the last ray of the middle row leads on to its first, as in a scan that was moved to one moment while the robot
/// drove straight on. Between the ends of a turn of a robot that turns there is a gap, or they overlap.
fn is_round(rays: &[Vec3], [width, height]: [usize; 2]) -> bool {
    let row = &rays[height / 2 * width..][..width];
    let step = |pair: &[Vec3]| f64::from(pair[0].distance(pair[1]));
    let mut steps: Vec<f64> = row.windows(2).map(step).filter(|step| *step > 0.0).collect();
    // Comparisons with NaN are false.
    width > 2 && median(&mut steps).is_some_and(|usual| step(&[row[width - 1], row[0]]) < 1.5 * usual)
}

fn spacing_at(rays: &[Vec3], [width, height]: [usize; 2], i: usize, is_closed: bool) -> [f32; 2] {
    let (column, row) = (i % width, i / width);
    let to = |j: Option<usize>| {
        let angle = j.map_or(f32::NAN, |j| rays[i].distance(rays[j]));
        if angle > 0.0 { angle } else { f32::NAN }
    };
    let before = if column > 0 { Some(i - 1) } else { is_closed.then(|| i + width - 1) };
    let after = if column + 1 < width { Some(i + 1) } else { is_closed.then(|| i + 1 - width) };
    let above = (row > 0).then(|| i - width);
    let below = (row + 1 < height).then(|| i + width);
    // `max` ignores one missing neighbour.
    let larger = |a: f32, b: f32| if a.is_nan() && b.is_nan() { f32::INFINITY } else { a.max(b) };
    [larger(to(before), to(after)), larger(to(above), to(below))]
}
