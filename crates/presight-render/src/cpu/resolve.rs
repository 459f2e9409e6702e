//! Resolve: the requested images from inverse depth and winner, band by band while the z-buffer is still in the cache.

use super::Bands;
use super::batch::{NOTHING, Shade};
use super::raster_lines::{Buffer, EIGHT};
use crate::plan::{FramePlan, Images};
use presight_model::sensor::{LineAxis, LineGrid, PixelGrid, RayGrid};
use std::ops::Range;

/// The parts of the images that one band fills: the pixels of each image row. Images that were not requested have no
/// rows.
#[derive(Default)]
pub(super) struct Target<'a> {
    range: Vec<&'a mut [f32]>,
    depth_z: Vec<&'a mut [f32]>,
    cos_incidence: Vec<&'a mut [f32]>,
    polygon_id: Vec<&'a mut [u32]>,
    object_id: Vec<&'a mut [u32]>,
}

/// Cuts the images into the bands' targets.
pub(super) fn split<'a>(images: &'a mut Images, bands: &Bands) -> Vec<Target<'a>> {
    let width = images.width as usize;
    let mut targets: Vec<Target<'a>> = (0..bands.count()).map(|_| Target::default()).collect();
    fn deal<'a, 't, T>(
        image: &'a mut [T],
        width: usize,
        bands: &Bands,
        targets: &'t mut [Target<'a>],
        part: impl Fn(&'t mut Target<'a>) -> &'t mut Vec<&'a mut [T]>,
    ) {
        let mut parts: Vec<_> = targets.iter_mut().map(part).collect();
        if bands.axis == LineAxis::Columns {
            parts.iter_mut().for_each(|part| part.reserve_exact(image.len() / width));
        }
        for (y, row) in image.chunks_mut(width).enumerate() {
            match bands.axis {
                LineAxis::Rows => parts[y / bands.per_band].push(row),
                LineAxis::Columns => {
                    row.chunks_mut(bands.per_band).zip(&mut parts).for_each(|(piece, part)| part.push(piece));
                }
            }
        }
    }
    deal(&mut images.range, width, bands, &mut targets, |t| &mut t.range);
    deal(&mut images.depth_z, width, bands, &mut targets, |t| &mut t.depth_z);
    deal(&mut images.cos_incidence, width, bands, &mut targets, |t| &mut t.cos_incidence);
    deal(&mut images.polygon_id, width, bands, &mut targets, |t| &mut t.polygon_id);
    deal(&mut images.object_id, width, bands, &mut targets, |t| &mut t.object_id);
    targets
}

/// Number of pixels of a row processed together, for scanners also the number of lines: two cache lines of an image.
/// Every row of a scanner's image has its own memory page, and each visit to it may miss in the address translation.
pub(super) const TOGETHER: usize = 32;

/// Fills the requested images of a band, which is complete to a distance in metres. Returns the number of samples left
/// open and, with a deadline, the number of samples with a polygon.
#[inline(always)]
pub(super) fn resolve(
    target: &mut Target<'_>,
    buffer: &Buffer,
    plan: &FramePlan,
    shades: &[Shade],
    bands: &Bands,
    band: usize,
    complete_to: f32,
) -> (u64, u64) {
    let spec = plan.sensor.spec();
    let (range_min, range_max, min_inverse) = (spec.range_min, spec.range_max, min_inverse(complete_to.into()));
    let counts = plan.limit.is_some();
    let lead = plan.sensor.range_lead();
    let mut painter =
        Painter { shades, range_min, range_max, lead, min_inverse, given_up: 0, counts, written: 0, target };
    let lines = bands.lines(band);
    match (bands.axis, plan.sensor.grid()) {
        (LineAxis::Columns, _) => columns(&mut painter, buffer, lines.len(), bands.samples),
        (LineAxis::Rows, PixelGrid::Lines(grid)) => {
            rows(&mut painter, buffer, lines, bands.samples, |pixels, line, part| pixels.pinhole(grid, line, part));
        }
        (LineAxis::Rows, PixelGrid::Rays(grid)) => {
            rows(&mut painter, buffer, lines, bands.samples, |pixels, line, part| pixels.of_tiles(grid, line, part));
        }
    }
    (painter.given_up, painter.written)
}

/// The minimum x with `1 / x <= range`, so that samples are compared without a division each; 0 for an infinite range.
fn min_inverse(range: f64) -> f64 {
    if range == f64::INFINITY {
        return 0.0;
    }
    let mut least = 1.0 / range;
    while 1.0 / least > range {
        least = least.next_up();
    }
    while least > 0.0 && 1.0 / least.next_down() <= range {
        least = least.next_down();
    }
    least
}

/// Fills the images of scanners, whose lines are image columns: transposes the buffer octet by octet, in its order.
#[inline(always)]
fn columns(painter: &mut Painter<'_, '_>, buffer: &Buffer, lines: usize, samples: usize) {
    let mut pixels = [const { Pixels::unit() }; EIGHT];
    if let Some(samples) = buffer.few {
        for (first, sample) in (0..lines).step_by(TOGETHER).flat_map(|first| (0..samples).map(move |s| (first, s))) {
            let (count, pixels) = (TOGETHER.min(lines - first), &mut pixels[0]);
            for j in 0..count {
                let (at, i) = buffer.place(first + j, sample);
                (pixels.inverse[j], pixels.winner[j]) = (buffer.inverse[at].0[i], buffer.winner[at].0[i] as u32);
            }
            painter.paint(pixels, sample, first..first + count);
        }
        return;
    }
    for first in (0..lines).step_by(TOGETHER) {
        let count = TOGETHER.min(lines - first);
        for octet in 0..samples.div_ceil(EIGHT) {
            let at = buffer.at(first, octet);
            for (j, inverse) in buffer.inverse[at..at + count].iter().enumerate() {
                for i in 0..EIGHT {
                    pixels[i].inverse[j] = inverse.0[i];
                }
            }
            let winners = &buffer.winner[at..at + count];
            let first_winner = winners[0].0[0];
            let mut other = [0; EIGHT];
            for winner in winners {
                for i in 0..EIGHT {
                    other[i] |= winner.0[i] ^ first_winner;
                }
            }
            if other == [0; EIGHT] {
                pixels.iter_mut().for_each(|pixels| pixels.winner.fill(first_winner as u32));
            } else {
                for (j, winner) in winners.iter().enumerate() {
                    for i in 0..EIGHT {
                        pixels[i].winner[j] = winner.0[i] as u32;
                    }
                }
            }
            let rows = EIGHT.min(samples - octet * EIGHT);
            for (i, pixels) in pixels[..rows].iter().enumerate() {
                painter.paint(pixels, octet * EIGHT + i, first..first + count);
            }
        }
    }
}

/// Fills images whose rows are the lines.
#[inline(always)]
fn rows(
    painter: &mut Painter<'_, '_>,
    buffer: &Buffer,
    lines: Range<usize>,
    samples: usize,
    rays: impl Fn(&mut Pixels, usize, Range<usize>),
) {
    const OCTETS: usize = TOGETHER / EIGHT;
    let octets = samples.div_ceil(EIGHT);
    let mut pixels = Pixels::unit();
    for (row, line) in lines.enumerate() {
        let line_of_buffer = row * octets..(row + 1) * octets;
        let inverse = buffer.inverse[line_of_buffer.clone()].chunks(OCTETS);
        let winner = buffer.winner[line_of_buffer].chunks(OCTETS);
        for (c, (inverse, winner)) in inverse.zip(winner).enumerate() {
            for (o, (inverse, winner)) in inverse.iter().zip(winner).enumerate() {
                for i in 0..EIGHT {
                    pixels.inverse[o * EIGHT + i] = inverse.0[i];
                    pixels.winner[o * EIGHT + i] = winner.0[i] as u32;
                }
            }
            let part = c * TOGETHER..samples.min((c + 1) * TOGETHER);
            rays(&mut pixels, line, part.clone());
            painter.paint(&pixels, row, part);
        }
    }
}

/// Input for some pixels of a row.
struct Pixels {
    inverse: [f64; TOGETHER],
    winner: [u32; TOGETHER],
    /// Rays of the z-buffer: 1 / length (NaN where there is no ray) and z, in the image frame.
    per_length: [f64; TOGETHER],
    z: [f64; TOGETHER],
}

impl Pixels {
    /// Rays of length 1 for images without z.
    const fn unit() -> Self {
        Self { inverse: [0.0; TOGETHER], winner: [0; TOGETHER], per_length: [1.0; TOGETHER], z: [1.0; TOGETHER] }
    }

    /// The rays of a pinhole camera, whose z is 1.
    #[inline(always)]
    fn pinhole(&mut self, grid: &LineGrid, row: usize, samples: Range<usize>) {
        let image_from_line = grid.image_from_line();
        let x_per_t = image_from_line.z_axis.x;
        let y = image_from_line.x_axis.y * grid.lines()[row][0];
        let y_squared = y * y;
        for (per_length, t) in self.per_length.iter_mut().zip(&grid.positions()[samples]) {
            let x = t * x_per_t;
            *per_length = 1.0 / (x * x + y_squared + 1.0).sqrt();
        }
    }

    /// The rays of a table, from the beginning of a tile on.
    #[inline(always)]
    fn of_tiles(&mut self, grid: &RayGrid, row: usize, samples: Range<usize>) {
        let first = row / EIGHT * grid.tiles_across();
        for (i, column) in samples.step_by(EIGHT).enumerate() {
            let z = &grid.rays_of(first + column / EIGHT).z[row % EIGHT];
            for (j, z) in z.iter().enumerate() {
                self.per_length[i * EIGHT + j] = if z.is_nan() { f64::NAN } else { 1.0 };
                self.z[i * EIGHT + j] = *z;
            }
        }
    }
}

/// Fills images from pixels.
struct Painter<'t, 'a> {
    /// By winner.
    shades: &'t [Shade],
    range_min: f64,
    range_max: f64,
    /// Added to the distance from where a ray starts.
    lead: f64,
    /// Minimum inverse depth of final samples; 0 if all polygons were drawn.
    min_inverse: f64,
    given_up: u64,
    /// True if samples with a polygon are counted, and their number.
    counts: bool,
    written: u64,
    target: &'t mut Target<'a>,
}

impl Painter<'_, '_> {
    /// Fills a part of a row. It computes all values of the part before it stores them: loops of fixed length become
    /// vectors, and no load waits for a store to another image, whose rows may be whole pages apart.
    #[inline(always)]
    fn paint(&mut self, pixels: &Pixels, row: usize, part: Range<usize>) {
        // Usually they all show one polygon.
        let first = pixels.winner[0];
        let alike = pixels.winner.iter().fold(true, |alike, winner| alike & (*winner == first));
        if self.counts {
            let with_polygon = pixels.winner[..part.len()].iter().map(|winner| u32::from(*winner != NOTHING));
            let all = if first != NOTHING { part.len() as u64 } else { 0 };
            self.written += if alike { all } else { u64::from(with_polygon.sum::<u32>()) };
        }
        let mut inverse = [0.0; TOGETHER];
        for i in 0..TOGETHER {
            inverse[i] = pixels.inverse[i] * pixels.per_length[i];
        }
        if self.min_inverse > 0.0 && self.leave_all_open(&inverse[..part.len()], row, part.clone()) {
            return;
        }
        let mut distance = [0.0; TOGETHER];
        let (mut polygon_id, mut object_id) = ([0; TOGETHER], [0; TOGETHER]);
        if alike {
            let seen = &self.shades[first as usize];
            distance.fill(seen.distance);
            polygon_id.fill(seen.polygon_id);
            object_id.fill(seen.object_id);
        } else {
            for (i, &winner) in pixels.winner.iter().enumerate() {
                let seen = &self.shades[winner as usize];
                (distance[i], polygon_id[i], object_id[i]) = (seen.distance, seen.polygon_id, seen.object_id);
            }
        }
        let (mut exact, mut range) = ([0.0; TOGETHER], [0.0; TOGETHER]);
        for i in 0..TOGETHER {
            exact[i] = 1.0 / inverse[i] + self.lead;
            range[i] = metres(exact[i], exact[i], self.range_min, self.range_max);
        }
        // Ids and angle are kept below range_min. At infinity and without a ray there is no polygon.
        if self.target.cos_incidence.get(row).is_some() {
            let mut shown = [0.0; TOGETHER];
            for i in 0..TOGETHER {
                let cos = (distance[i] * inverse[i]) as f32;
                let cos = if cos > 1.0 { 1.0 } else { cos };
                shown[i] = if range[i] < f32::INFINITY { cos } else { f32::NAN };
            }
            store(&mut self.target.cos_incidence, row, &part, &shown);
        }
        for i in 0..TOGETHER {
            let seen = range[i] < f32::INFINITY;
            polygon_id[i] = if seen { polygon_id[i] } else { 0 };
            object_id[i] = if seen { object_id[i] } else { 0 };
        }
        if self.target.depth_z.get(row).is_some() {
            let mut shown = [0.0; TOGETHER];
            for i in 0..TOGETHER {
                shown[i] = metres(pixels.z[i] / pixels.inverse[i], exact[i], self.range_min, self.range_max);
            }
            store(&mut self.target.depth_z, row, &part, &shown);
        }
        store(&mut self.target.range, row, &part, &range);
        store(&mut self.target.polygon_id, row, &part, &polygon_id);
        store(&mut self.target.object_id, row, &part, &object_id);
        if self.min_inverse > 0.0 {
            self.give_up(&inverse[..part.len()], row, part);
        }
    }

    /// Leaves all samples open if polygons left out may hide every one of them. Returns true in that case.
    #[cold]
    #[inline(never)]
    fn leave_all_open(&mut self, inverse: &[f64], row: usize, part: Range<usize>) -> bool {
        // Lanes without a ray have inverse NaN, and images have NaN there in both cases.
        if inverse.iter().fold(false, |any, inverse| any | (*inverse >= self.min_inverse)) {
            return false;
        }
        self.given_up += inverse.iter().filter(|inverse| !inverse.is_nan()).count() as u64;
        let Target { range, depth_z, cos_incidence, polygon_id, object_id } = self.target;
        for image in [range, depth_z, cos_incidence] {
            image.get_mut(row).into_iter().for_each(|row| row[part.clone()].fill(f32::NAN));
        }
        for image in [polygon_id, object_id] {
            image.get_mut(row).into_iter().for_each(|row| row[part.clone()].fill(0));
        }
        true
    }

    /// Leaves samples open that polygons left out may hide: farther than the complete distance, or without a polygon.
    #[cold]
    #[inline(never)]
    fn give_up(&mut self, inverse: &[f64], row: usize, part: Range<usize>) {
        let mut open = [false; TOGETHER];
        for (open, inverse) in open.iter_mut().zip(inverse) {
            // Lanes without a ray have inverse NaN.
            *open = *inverse < self.min_inverse;
        }
        let open = &open[..inverse.len()];
        let count = open.iter().filter(|open| **open).count();
        if count == 0 {
            return;
        }
        self.given_up += count as u64;
        let Target { range, depth_z, cos_incidence, polygon_id, object_id } = self.target;
        for image in [range, depth_z, cos_incidence] {
            let Some(out) = image.get_mut(row) else { continue };
            out[part.clone()].iter_mut().zip(open).for_each(|(out, open)| *out = if *open { f32::NAN } else { *out });
        }
        for image in [polygon_id, object_id] {
            let Some(out) = image.get_mut(row) else { continue };
            out[part.clone()].iter_mut().zip(open).for_each(|(out, open)| *out = if *open { 0 } else { *out });
        }
    }
}

/// Stores a part of a row, if the image is requested.
#[inline(always)]
fn store<T: Copy>(image: &mut [&mut [T]], row: usize, part: &Range<usize>, values: &[T; TOGETHER]) {
    let Some(row) = image.get_mut(row) else { return };
    let out = &mut row[part.clone()];
    match <&mut [T; TOGETHER]>::try_from(&mut *out) {
        Ok(whole) => *whole = *values,
        Err(_) => out.copy_from_slice(&values[..out.len()]),
    }
}

/// A distance as stored in images, by the range of its ray: infinity for misses, NaN for missing rays.
#[inline(always)]
fn metres(value: f64, range: f64, range_min: f64, range_max: f64) -> f32 {
    let shown = if range < range_min { f32::NEG_INFINITY } else { value as f32 };
    // For a miss the value is infinity times the z of the ray, which is 0 or negative for some lenses.
    let shown = if range > range_max || range == f64::INFINITY { f32::INFINITY } else { shown };
    if range.is_nan() { f32::NAN } else { shown }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn everything_is_final_where_all_is_drawn_and_nothing_where_nothing_is() {
        assert_eq!(min_inverse(f64::INFINITY), 0.0);
        assert_eq!(min_inverse(0.0), f64::INFINITY);
        assert_eq!(min_inverse(4.0), 0.25f64);
    }

    proptest! {
        /// Ranges around the minimum inverse, where an error of one rounding in the bound would show.
        #[test]
        fn inverses_are_compared_as_ranges_are(range in 1e-6..1e6f32, off in -4i64..=4) {
            let range = f64::from(range);
            let inverse = f64::from_bits((1.0 / range).to_bits().wrapping_add_signed(off));
            prop_assert_eq!(inverse >= min_inverse(range), 1.0 / inverse <= range);
        }
    }
}
