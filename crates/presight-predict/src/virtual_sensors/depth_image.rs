//! Depth image: a point in space for every pixel.

use super::View;
use super::pixels::Pixels;
use presight_model::error::Result;
use serde::Serialize;

/// An image of points.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct DepthImage {
    /// Columns.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// Pixels with a point.
    pub points: usize,
    /// Bounding box of the points in the robot's frame, smallest and largest corner, metres; `None` without points.
    pub bounds_robot: Option<[[f64; 3]; 2]>,
    /// Points by pixel, row-major: the sensor's f64 ray times the f32 range; `None` without a range.
    pub points_robot: Vec<Option<[f64; 3]>>,
}

impl DepthImage {
    pub(super) fn summary(&self) -> String {
        let share = 100.0 * self.points as f64 / self.points_robot.len().max(1) as f64;
        format!("{} points, {share:.1} % of {} x {} pixels", self.points, self.width, self.height)
    }
}

pub(super) fn reduce(view: &View<'_>) -> Result<DepthImage> {
    let pixels = Pixels::new(view)?;
    let (width, height) = (pixels.sensor.width(), pixels.sensor.height());
    let mut points_robot = Vec::with_capacity(pixels.count());
    let mut bounds: Option<[[f64; 3]; 2]> = None;
    for row in 0..height {
        for column in 0..width {
            let range = pixels.range[pixels.at(column, row)];
            let ray = pixels.ray(column, row).filter(|_| range.is_finite());
            let point = ray.map(|ray| pixels.in_robot(ray * f64::from(range)));
            if let Some(p) = point {
                let [low, high] = bounds.get_or_insert([p, p]);
                for k in 0..3 {
                    (low[k], high[k]) = (low[k].min(p[k]), high[k].max(p[k]));
                }
            }
            points_robot.push(point);
        }
    }
    let points = points_robot.iter().flatten().count();
    Ok(DepthImage { width, height, points, bounds_robot: bounds, points_robot })
}
