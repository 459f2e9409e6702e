//! Variants of the sensor that paths predict: the same rays from a table, fewer rays, or a part of the image.

use glam::DVec3;
use presight_model::error::Result;
use presight_model::sensor::{Angles, Camera, Geometry, RayTable, Scanner, Sensor};
use presight_render::plan::{ImageRequest, Images};

/// The images that every path predicts.
pub(super) fn request() -> ImageRequest {
    ImageRequest::default()
}

/// A variant of the sensor.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum ImageVariant {
    /// The sensor itself.
    Whole,
    /// Its rays as a table (`kind = "rays"`).
    Rays,
    /// One pixel for every n columns and rows.
    Reduced(u32),
    /// The middle half of the columns and, for a camera, of the rows.
    Region,
}

/// A variant applied to a sensor.
pub(super) struct StudyView {
    /// The sensor that is predicted.
    pub sensor: Sensor,
    /// The sensor whose pixels are compared.
    pub judge: Sensor,
    /// True if the whole image of the original sensor is compared.
    pub whole: bool,
    /// True if every pixel equals that of the original sensor, up to the engine's rounding.
    pub exact: bool,
    view: ImageVariant,
    /// Column and row of the view's first pixel in the sensor's image.
    first: (u32, u32),
    /// Columns and rows of the original image that one pixel covers.
    times: (u32, u32),
}

impl ImageVariant {
    /// The label in charts.
    pub fn label(self) -> &'static str {
        match self {
            Self::Whole => "",
            Self::Rays => "table",
            Self::Reduced(2) => "1/2",
            Self::Reduced(_) => "1/4",
            Self::Region => "part",
        }
    }

    /// The name in tables.
    pub fn name(self) -> String {
        match self {
            Self::Whole => String::new(),
            Self::Rays => ", ray table".into(),
            Self::Reduced(n) => format!(", 1/{n} resolution"),
            Self::Region => ", middle part".into(),
        }
    }

    /// Applies the variant to a sensor; `None` if the sensor has no such variant.
    pub fn of(self, sensor: &Sensor) -> Result<Option<StudyView>> {
        let mut spec = sensor.spec().clone();
        let (mut first, mut times) = ((0, 0), (1, 1));
        let geometry = match (self, &spec.geometry) {
            (Self::Whole, geometry) => Some(geometry.clone()),
            // Its rays are already a table.
            (Self::Rays, Geometry::Rays(_)) => None,
            (Self::Rays, _) => Some(Geometry::Rays(table(sensor)?)),
            (Self::Reduced(n), geometry) => reduced(geometry, n)?.map(|(geometry, by)| {
                times = by;
                geometry
            }),
            (Self::Region, geometry) => part(geometry).map(|(geometry, at)| {
                first = at;
                geometry
            }),
        };
        let Some(geometry) = geometry else { return Ok(None) };
        spec.geometry = geometry;
        let seen = if self == Self::Whole { sensor.clone() } else { Sensor::new(spec)? };
        let judge = if self == Self::Region { seen.clone() } else { sensor.clone() };
        let exact = !matches!(self, Self::Reduced(_));
        Ok(Some(StudyView { sensor: seen, judge, whole: self != Self::Region, exact, view: self, first, times }))
    }
}

impl StudyView {
    /// The truth and the predicted images, resampled to the same pixels.
    pub fn beside(&self, truth: &Images, made: &Images) -> (Images, Images) {
        let (w, h) = (self.judge.width(), self.judge.height());
        match self.view {
            ImageVariant::Whole | ImageVariant::Rays => (truth.clone(), made.clone()),
            ImageVariant::Reduced(_) => {
                let (by_x, by_y) = self.times;
                (truth.clone(), pick(made, w, h, |x, y| (x / by_x, y / by_y)))
            }
            ImageVariant::Region => (pick(truth, w, h, |x, y| (x + self.first.0, y + self.first.1)), made.clone()),
        }
    }

    /// The fraction of the sensor's pixels that are not predicted.
    pub fn missing_share(&self, sensor: &Sensor) -> f64 {
        let pixels = |s: &Sensor| f64::from(s.width()) * f64::from(s.height());
        1.0 - pixels(&self.judge) / pixels(sensor)
    }
}

/// Images of w x h pixels, copied from the pixels of `from` that `place` returns, clamped to its last column and row.
fn pick(from: &Images, w: u32, h: u32, place: impl Fn(u32, u32) -> (u32, u32)) -> Images {
    let mut to = Images::default();
    to.prepare(w, h, request().outputs);
    for (at, (y, x)) in (0..h).flat_map(|y| (0..w).map(move |x| (y, x))).enumerate() {
        let (px, py) = place(x, y);
        let source = py.min(from.height - 1) as usize * from.width as usize + px.min(from.width - 1) as usize;
        to.range[at] = from.range[source];
        to.polygon_id[at] = from.polygon_id[source];
        to.object_id[at] = from.object_id[source];
        to.cos_incidence[at] = from.cos_incidence[source];
    }
    to
}

/// A sensor's rays as a table, body axes.
fn table(sensor: &Sensor) -> Result<RayTable> {
    let (w, h) = (sensor.width(), sensor.height());
    let body_from_image = sensor.body_from_image();
    let ray = |x, y| sensor.ray(x, y).map_or(DVec3::NAN, |ray| body_from_image * ray);
    RayTable::new(w, h, (0..h).flat_map(|y| (0..w).map(move |x| ray(x, y))).collect())
}

/// One pixel in the middle of every n x n pixels. Rows are kept if they are few or listed.
fn reduced(geometry: &Geometry, n: u32) -> Result<Option<(Geometry, (u32, u32))>> {
    Ok(match geometry {
        Geometry::Camera(c) => {
            let (by, middle) = (f64::from(n), |at: f64| (at + 0.5) / f64::from(n) - 0.5);
            let (width, height) = (c.width.div_ceil(n), c.height.div_ceil(n));
            let (fx, fy, cx, cy) = (c.fx / by, c.fy / by, middle(c.cx), middle(c.cy));
            Some((Geometry::Camera(Camera { width, height, fx, fy, cx, cy, distortion: c.distortion.clone() }), (n, n)))
        }
        Geometry::Scanner(s) => {
            let Some(azimuth) = thinned(&s.azimuth, n) else { return Ok(None) };
            // Rows are numbered from the top in any order of angles, so groups of n match only if they divide all rows.
            let rows = thinned(&s.elevation, n).filter(|_| s.elevation.len() % n as usize == 0);
            let by = (n, if rows.is_some() { n } else { 1 });
            let elevation = rows.unwrap_or_else(|| s.elevation.clone());
            // Features stay visible at the same distance from a row, although there are fewer rows.
            let beam_height_deg = s.beam_height_deg.or(match s.elevation {
                Angles::Uniform { step_deg, count, .. } if count > 1 => Some(step_deg.abs()),
                _ => None,
            });
            Some((Geometry::Scanner(Scanner { azimuth, elevation, beam_height_deg }), by))
        }
        Geometry::Rays(r) => {
            let (w, h) = (r.width().div_ceil(n), r.height().div_ceil(n));
            let middle = |i: u32, side: u32| (i * n + n / 2).min(side - 1);
            let at = |x, y| r.directions()[(middle(y, r.height()) * r.width() + middle(x, r.width())) as usize];
            let rays = (0..h).flat_map(|y| (0..w).map(move |x| (x, y))).map(|(x, y)| at(x, y)).collect();
            Some((Geometry::Rays(RayTable::new(w, h, rays)?), (n, n)))
        }
    })
}

/// The middle angles of groups of n; `None` for listed angles and for fewer than two groups.
fn thinned(angles: &Angles, n: u32) -> Option<Angles> {
    match angles {
        Angles::Uniform { start_deg, step_deg, count } if *count >= 2 * n => {
            let start_deg = start_deg + step_deg * 0.5 * f64::from(n - 1);
            Some(Angles::Uniform { start_deg, step_deg: step_deg * f64::from(n), count: count.div_ceil(n) })
        }
        _ => None,
    }
}

/// The middle half of the image, and its first column and row.
fn part(geometry: &Geometry) -> Option<(Geometry, (u32, u32))> {
    match geometry {
        Geometry::Camera(c) if c.width >= 4 && c.height >= 4 => {
            let (x, y) = (c.width / 4, c.height / 4);
            let (width, height) = (c.width / 2, c.height / 2);
            let (cx, cy) = (c.cx - f64::from(x), c.cy - f64::from(y));
            Some((Geometry::Camera(Camera { width, height, cx, cy, ..c.clone() }), (x, y)))
        }
        Geometry::Scanner(s) => match s.azimuth {
            Angles::Uniform { start_deg, step_deg, count } if count >= 4 => {
                let x = count / 4;
                let start_deg = start_deg + step_deg * f64::from(x);
                let azimuth = Angles::Uniform { start_deg, step_deg, count: count / 2 };
                Some((Geometry::Scanner(Scanner { azimuth, ..s.clone() }), (x, 0)))
            }
            _ => None,
        },
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use presight_read::preset;

    /// A pixel of a reduced or partial view looks in the mean direction of the pixels that it covers.
    #[test]
    fn views_look_where_their_pixels_are() {
        for name in ["video-camera", "vlp-16", "laser-scanner", "realsense-d435", "microwave-radar-image"] {
            let sensor = preset(name).unwrap();
            for view in [ImageVariant::Reduced(2), ImageVariant::Reduced(4), ImageVariant::Region] {
                let seen = view.of(&sensor).unwrap().unwrap();
                let (x, y) = (seen.sensor.width() / 3, seen.sensor.height() / 3);
                let at = |k: u32, by: u32, first: u32, most: u32| (k * by + first).min(most);
                let low = (at(x, seen.times.0, seen.first.0, u32::MAX), at(y, seen.times.1, seen.first.1, u32::MAX));
                let high = (low.0 + seen.times.0 - 1, low.1 + seen.times.1 - 1);
                let middle = (sensor.ray(low.0, low.1).unwrap() + sensor.ray(high.0, high.1).unwrap()).normalize();
                let apart = seen.sensor.ray(x, y).unwrap().angle_between(middle);
                let pixel = sensor.ray(low.0, low.1).unwrap().angle_between(sensor.ray(low.0 + 1, low.1).unwrap());
                let most = if view == ImageVariant::Region { 1e-9 } else { 0.05 * pixel };
                assert!(apart <= most, "{name}, {view:?}: off by {} pixels", apart / pixel);
            }
        }
    }

    #[test]
    fn a_table_has_the_same_rays_to_the_bit() {
        let sensor = preset("vlp-16").unwrap();
        let seen = ImageVariant::Rays.of(&sensor).unwrap().unwrap();
        for (x, y) in [(0, 0), (1799, 15), (900, 7)] {
            assert_eq!(seen.sensor.ray(x, y), sensor.ray(x, y));
        }
        assert!(ImageVariant::Rays.of(&seen.sensor).unwrap().is_none());
    }
}
