//! Corners in grey images, where edges of several directions meet.
//!
//! Candidates are pixels where brightness changes in all directions (smaller eigenvalue of the structure tensor: C.
//! Harris and M. Stephens 1988, J. Shi and C. Tomasi 1994). The corner is the point nearest to all edge lines through
//! the surrounding pixels (W. Förstner and E. Gülch 1987), with the covariance of this least-squares problem.

use super::region::PixelBox;
use crate::matching::Detection;
use glam::{DMat2, DVec2};
use presight_model::measured::GreyImage;

presight_model::options! {
    /// Thresholds of the corner detector.
    ///
    /// Default: a camera of 8 bits with 1 % of noise.
    #[derive(Clone, Copy, Debug, PartialEq)]
    pub struct CornerOptions {
        /// Standard deviation of a grey value.
        noise: f64 = 0.01, with_noise;
        /// Minimum grey-value difference across the weaker of the edges that meet.
        min_contrast: f64 = 0.06, with_min_contrast;
        /// Maximum number of corners returned, the strongest first.
        max_corners: usize = 500, with_max_corners;
    }
}

/// Half side of the detection window, pixels.
const HALF: i64 = 3;
/// Minimum distance between corners, pixels: half a window, as nearer ones share most of their pixels.
const APART: i64 = 3;
/// Maximum distance of a corner from its peak, pixels. The response of a wedge peaks where both edges are long in the
/// window: further inside for a narrower wedge (5 pixels for 52 degrees).
const FARTHEST: f64 = 5.0;
/// Minimum ratio of the smaller eigenvalue to the larger: edges that meet at 35 degrees.
const MIN_ROUNDNESS: f64 = 0.1;
/// Error left by blur and sampling at best, pixels: edge lines bend where they meet.
const FLOOR: f64 = 0.1;

/// The corners in a box of an image, the strongest first, as points with covariance.
///
/// # Examples
/// The bright quarter of an image begins at column 10 and row 12.
pub fn corners_in(image: &GreyImage, region: PixelBox, options: &CornerOptions) -> Vec<Detection> {
    let Some(gradients) = Gradients::of(image, region) else { return Vec::new() };
    let strengths = gradients.strengths();
    // An edge of contrast k adds gradients of about k^2 / 4 per window row; noise adds the same everywhere.
    let rows = f64::from(2 * HALF as i32 + 1);
    let of_noise = rows * rows * 0.1875 * options.noise * options.noise;
    let least = 0.125 * rows * options.min_contrast.max(4.0 * options.noise).powi(2) + 2.0 * of_noise;
    let mut peaks = gradients.peaks(&strengths, least);
    peaks.sort_by(|a, b| b.0.total_cmp(&a.0).then(a.1.cmp(&b.1)));
    let mut found: Vec<Detection> = Vec::new();
    for (strength, at) in peaks {
        let Some((place, covariance)) = gradients.corner(at, options.noise) else { continue };
        // Two peaks may lead to one corner, and a corner may lie outside of the box.
        let known = found.iter().any(|d| d.shape.centre().distance(place) < APART as f64);
        if known || !region.contains(place) || found.len() == options.max_corners {
            continue;
        }
        let mut detection = Detection::point(place, 1.0);
        detection.covariance = covariance;
        detection.properties.contrast = Some((8.0 * (strength - of_noise) / rows).max(0.0).sqrt().min(1.0));
        found.push(detection);
    }
    found
}

/// Gradients in a box and its margin.
struct Gradients {
    left: i64,
    top: i64,
    width: usize,
    height: usize,
    /// Grey values per pixel; NaN next to a pixel without a measurement.
    values: Vec<DVec2>,
}

impl Gradients {
    /// Gradients within reach of the windows in the box, clipped to the image; `None` if no pixel is inside.
    fn of(image: &GreyImage, region: PixelBox) -> Option<Self> {
        let [x0, y0, x1, y1] = region.pixels(image.width(), image.height())?;
        let reach = HALF + FARTHEST.ceil() as i64;
        let (left, top) = ((x0 - reach).max(1), (y0 - reach).max(1));
        let (right, bottom) =
            ((x1 + reach).min(i64::from(image.width()) - 2), (y1 + reach).min(i64::from(image.height()) - 2));
        if right - left < 2 * HALF || bottom - top < 2 * HALF {
            return None;
        }
        let (width, height) = ((right - left + 1) as usize, (bottom - top + 1) as usize);
        let mut values = Vec::with_capacity(width * height);
        for r in top..=bottom {
            for c in left..=right {
                let v = |dc: i64, dr: i64| f64::from(image.pixel((c + dc) as u32, (r + dr) as u32));
                // Smoothed across (Sobel), so that the steps of a slanted edge are not detected as corners.
                let right = v(1, -1) + 2.0 * v(1, 0) + v(1, 1) - v(-1, -1) - 2.0 * v(-1, 0) - v(-1, 1);
                let down = v(-1, 1) + 2.0 * v(0, 1) + v(1, 1) - v(-1, -1) - 2.0 * v(0, -1) - v(1, -1);
                values.push(DVec2::new(right, down) / 8.0);
            }
        }
        Some(Self { left, top, width, height, values })
    }

    /// The smaller eigenvalue of the structure tensor around each pixel; 0 near the image border.
    fn strengths(&self) -> Vec<f64> {
        let products = |f: fn(&DVec2) -> f64| self.window_sums(&self.values.iter().map(f).collect::<Vec<f64>>());
        let (xx, xy, yy) = (products(|g| g.x * g.x), products(|g| g.x * g.y), products(|g| g.y * g.y));
        let smaller = |i: usize| {
            let (half, off) = (0.5 * (xx[i] + yy[i]), 0.5 * (xx[i] - yy[i]));
            let apart = off.hypot(xy[i]);
            // Rejects the steps of a slanted edge, and NaN next to a pixel without a measurement.
            if half - apart > MIN_ROUNDNESS * (half + apart) { half - apart } else { 0.0 }
        };
        (0..xx.len()).map(smaller).collect()
    }

    /// Window sums, first along rows, then along columns; 0 where the window leaves the image.
    fn window_sums(&self, of: &[f64]) -> Vec<f64> {
        let (w, h, half) = (self.width, self.height, HALF as usize);
        let mut along = vec![0.0; of.len()];
        for r in 0..h {
            for c in half..w - half {
                along[r * w + c] = of[r * w + c - half..=r * w + c + half].iter().sum();
            }
        }
        let mut sums = vec![0.0; of.len()];
        for r in half..h - half {
            for k in r - half..=r + half {
                for c in half..w - half {
                    sums[r * w + c] += along[k * w + c];
                }
            }
        }
        sums
    }

    /// Local maxima of the response.
    fn peaks(&self, strengths: &[f64], least: f64) -> Vec<(f64, (i64, i64))> {
        let mut peaks = Vec::new();
        let (w, h) = (self.width as i64, self.height as i64);
        for r in HALF..h - HALF {
            for c in HALF..w - HALF {
                let own = strengths[(r * w + c) as usize];
                if own < least {
                    continue;
                }
                let around = (-APART..=APART).flat_map(|j| (-APART..=APART).map(move |i| (c + i, r + j)));
                let mut near = around.filter(|(x, y)| (0..w).contains(x) && (0..h).contains(y));
                // Among equal ones, the first in reading order wins.
                let is_peak = near.all(|(x, y)| {
                    let other = strengths[(y * w + x) as usize];
                    other < own || (other == own && (y, x) >= (r, c))
                });
                if is_peak {
                    peaks.push((own, (c, r)));
                }
            }
        }
        peaks
    }

    /// The point nearest to the surrounding edge lines, and its covariance; `None` if it is not near the peak.
    fn corner(&self, peak: (i64, i64), noise: f64) -> Option<(DVec2, DMat2)> {
        let first = DVec2::new(peak.0 as f64, peak.1 as f64);
        let mut place = first;
        for step in 0..4 {
            let (cx, cy) = (place.x.round() as i64, place.y.round() as i64);
            let (mut tensor, mut pull, mut squares, mut n) = (DMat2::ZERO, DVec2::ZERO, 0.0, 0.0);
            for r in cy - HALF..=cy + HALF {
                for c in cx - HALF..=cx + HALF {
                    if !(0..self.width as i64).contains(&c) || !(0..self.height as i64).contains(&r) {
                        return None;
                    }
                    let g = self.values[r as usize * self.width + c as usize];
                    let at = DVec2::new(c as f64, r as f64);
                    tensor += DMat2::from_cols(g * g.x, g * g.y);
                    pull += g * g.dot(at);
                    squares += g.dot(at - place).powi(2);
                    n += 1.0;
                }
            }
            // Noise gradients alone do not determine a point.
            let determinant = tensor.determinant();
            if !(determinant > 1e-12) {
                return None;
            }
            let inverse = tensor.inverse();
            let next = inverse * pull;
            if !(next.distance(first) <= FARTHEST) {
                return None;
            }
            let moved = next.distance(place);
            place = next;
            if moved < 0.02 || step == 3 {
                let scatter = (squares / (n - 2.0f64)).max(0.1875 * noise * noise);
                let covariance = inverse * scatter + DMat2::from_diagonal(DVec2::splat(FLOOR * FLOOR));
                return Some((place + DVec2::new(self.left as f64, self.top as f64), covariance));
            }
        }
        None
    }
}
