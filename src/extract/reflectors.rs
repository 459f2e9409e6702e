//! Retro-reflectors in scans: what comes back far brighter than any wall.

use super::PixelBox;
use crate::error::{Error, Result};
use crate::frame::{Frame, GreyImage, RangeNoise};
use crate::matching::{Detection, Shape, UncertainValue};
use glam::{DMat2, DVec2};

/// What counts as a reflector.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ReflectorOptions {
    /// Least intensity; nothing diffuse comes near to it.
    pub least: f64,
    /// Largest extent, metres: what is wider is a wall, or a receiver that is blinded.
    pub widest: f64,
}

impl Default for ReflectorOptions {
    fn default() -> Self {
        Self { least: 0.8, widest: 0.4 }
    }
}

/// A reflector that was found.
#[derive(Clone, Debug, PartialEq)]
pub struct FoundReflector {
    /// Where in the image, with covariance. In a scan of one row nothing is known of the row.
    pub detection: Detection,
    /// Metres along the ray.
    pub range: UncertainValue,
}

/// Pixels squared: as good as unknown.
const UNKNOWN: f64 = 1e6;
/// How ranges may differ on one reflector, metres.
const DEPTH: f64 = 0.2;

/// The reflectors in a part of a scan, in the order of its pixels. `intensity` has the pixels of the scan, 1 for the brightest.
/// With [`PixelBox::whole_of`] it is the whole scan. A reflector on the seam of a turn is found as two.
///
/// # Examples
/// Two beams of a scanner meet a reflector 3 m away.
/// ```
/// use presight::extract::{PixelBox, ReflectorOptions, reflectors_in};
/// use presight::frame::{Frame, GreyImage, Measurement};
/// let scanner = presight::preset("laser-scanner")?;
/// let frame = Frame::new(0.0, scanner.clone(), Measurement::Range(vec![3.0; 361]))?;
/// let bright = (0..361).map(|i| if i == 40 || i == 41 { 1.0 } else { 0.3 });
/// let intensity = GreyImage::new(361, 1, bright.collect())?;
/// let found = reflectors_in(&frame, &intensity, PixelBox::whole_of(&scanner), &ReflectorOptions::default())?;
/// assert_eq!(found.len(), 1);
/// assert_eq!((found[0].detection.shape.centre().x, found[0].range.mean), (40.5, 3.0));
/// # Ok::<(), presight::Error>(())
/// ```
///
/// # Errors
/// [`crate::ErrorKind::Invalid`] if the intensities are of another size than the scan.
pub fn reflectors_in(
    frame: &Frame,
    intensity: &GreyImage,
    region: PixelBox,
    options: &ReflectorOptions,
) -> Result<Vec<FoundReflector>> {
    let sensor = frame.sensor();
    let (width, height) = (sensor.width(), sensor.height());
    if (intensity.width(), intensity.height()) != (width, height) {
        let what =
            format!("intensities of {} x {}, a scan of {width} x {height}", intensity.width(), intensity.height());
        return Err(Error::invalid(what, "give those of the scan's own pixels"));
    }
    let Some(pixels) = region.pixels(width, height) else { return Ok(Vec::new()) };
    let scan = BrightScan { frame, intensity, pixels, options };
    let mut seen = std::collections::BTreeSet::new();
    let mut found = Vec::new();
    let [x0, y0, x1, y1] = pixels;
    for at in (y0..=y1).flat_map(|r| (x0..=x1).map(move |c| (c, r))) {
        if scan.range(at).is_some() && !seen.contains(&at) {
            let spot = scan.spot(at, &mut seen);
            found.extend(scan.reflector(&spot));
        }
    }
    Ok(found)
}

struct BrightScan<'a> {
    frame: &'a Frame,
    intensity: &'a GreyImage,
    pixels: [i64; 4],
    options: &'a ReflectorOptions,
}

impl BrightScan<'_> {
    /// The range of a bright pixel of the box.
    fn range(&self, (c, r): (i64, i64)) -> Option<f64> {
        let [x0, y0, x1, y1] = self.pixels;
        let inside = (x0..=x1).contains(&c) && (y0..=y1).contains(&r);
        if !inside || !(f64::from(self.intensity.pixel(c as u32, r as u32)) >= self.options.least) {
            return None;
        }
        let range = self.frame.ranges()[(r * i64::from(self.intensity.width()) + c) as usize];
        (range.is_finite() && range > 0.0).then_some(f64::from(range))
    }

    /// The bright pixels that hang together with one, at about its range.
    fn spot(&self, first: (i64, i64), seen: &mut std::collections::BTreeSet<(i64, i64)>) -> Vec<((i64, i64), f64)> {
        let mut spot = Vec::new();
        let mut open = vec![first];
        seen.insert(first);
        while let Some((c, r)) = open.pop() {
            let Some(range) = self.range((c, r)) else { continue };
            spot.push(((c, r), range));
            for near in [(c - 1, r), (c + 1, r), (c, r - 1), (c, r + 1)] {
                if self.range(near).is_some_and(|other| (other - range).abs() <= DEPTH) && seen.insert(near) {
                    open.push(near);
                }
            }
        }
        spot
    }

    fn reflector(&self, spot: &[((i64, i64), f64)]) -> Option<FoundReflector> {
        let sensor = self.frame.sensor();
        let mut ranges: Vec<f64> = spot.iter().map(|(_, range)| *range).collect();
        ranges.sort_by(f64::total_cmp);
        let range = ranges[ranges.len() / 2];
        let end = |pick: fn(i64, i64) -> i64, of: fn(&(i64, i64)) -> i64| {
            spot.iter().map(|(at, _)| of(at)).reduce(pick).unwrap_or_default()
        };
        let (x0, x1) = (end(i64::min, |at| at.0), end(i64::max, |at| at.0));
        let (y0, y1) = (end(i64::min, |at| at.1), end(i64::max, |at| at.1));
        let ray = |u: f64, v: f64| sensor.ray_at(u, v);
        // By the pitch, as a full turn ends where it begins.
        let (x, y) = (x0 as f64, y0 as f64);
        let across = ray(x - 0.5, y)?.angle_between(ray(x + 0.5, y)?) * (x1 - x0 + 1) as f64;
        let down = if y1 > y0 { ray(x, y)?.angle_between(ray(x, y1 as f64)?) } else { 0.0 };
        if across.max(down) * range > self.options.widest {
            return None;
        }
        // Each end lies anywhere within its pixel's pitch: 1/12 of variance each, and half of that of their middle.
        let variance = 1.0 / 24.0;
        let of_row = if sensor.height() == 1 { UNKNOWN } else { variance };
        let centre = 0.5 * DVec2::new((x0 + x1) as f64, (y0 + y1) as f64);
        let mut detection = Detection::new(Shape::Reflector(centre), 1.0);
        detection.covariance = DMat2::from_diagonal(DVec2::new(variance, of_row));
        detection.properties.strength = Some(1.0);
        let sigma = RangeNoise::of(sensor).range_sigma(range);
        let variance = sigma * sigma / spot.len() as f64;
        Some(FoundReflector { detection, range: UncertainValue { mean: range, variance } })
    }
}
