//! All headings of a level scanner from one panorama: a heading is a cyclic shift of the measured image over the
//! panorama of its place.

use super::RangeLikelihood;
use super::beam_model::BeamModel;
use glam::{DQuat, DVec3};
use presight_model::error::{Error, Result};
use presight_model::geometry::{Pose, SensorPose, sin_cos_deg};
use presight_model::sensor::{Angles, Geometry, SAME_ANGLE, Scanner, Sensor, SensorSpec};
use presight_render::row::is_level;
use std::array;

/// The headings of a scanner, and the panorama that contains all of them.
#[derive(Clone, Debug)]
pub struct Headings {
    pub(super) count: u32,
    /// Number of beams in the panorama.
    pub(super) beams: usize,
    /// Shift of the panorama from one heading to the next, in columns modulo its width.
    pub(super) stride: usize,
    sensor: Sensor,
    panorama: Sensor,
    /// For each column of the scanner the column of the panorama that is nearest to it at heading 0; `None` for a beam
    /// that comes twice, or has no column of its own.
    columns: Vec<Option<u32>>,
}

/// No beam is farther from its column of the panorama than this part of the least step between beams.
const FARTHEST: f64 = 0.25;

impl Headings {
    /// Creates `count` headings, evenly over a full turn. Heading k turns the scanner's x axis `360 k / count` degrees
    /// counter-clockwise from the world's x axis, about its z axis.
    ///
    /// The panorama has the scanner's beams if its azimuths are multiples of 360 degrees / (n `count`). The beams of
    /// other scanners are weighed at the nearest ones of a finer panorama, at most a quarter of a step away.
    ///
    /// ```
    /// use presight::predict::Headings;
    /// let scanner = presight::preset("laser-scanner")?;
    /// let headings = Headings::new(&scanner, 360)?;
    /// assert_eq!(headings.panorama().width(), 720);
    /// assert_eq!(headings.degrees(90), 90.0);
    /// // Steps of half a degree do not divide 7 headings.
    /// assert_eq!(Headings::new(&scanner, 7)?.panorama().width(), 7 * 206);
    /// # Ok::<(), presight::Error>(())
    /// ```
    ///
    /// # Errors
    /// [`presight_model::ErrorKind::Usage`] unless the sensor is a scanner, and for 0 headings or more than
    /// [`presight_model::limits::MAX_IMAGE_SIDE`].
    pub fn new(sensor: &Sensor, count: u32) -> Result<Self> {
        let spec = sensor.spec();
        let wrong = |what: &str, remedy: &str| {
            Err(Error::usage(format!("all headings at once: {what}"), remedy).at(format!("sensor {:?}", spec.name)))
        };
        let single = "give a pose for each heading instead";
        let Geometry::Scanner(scanner) = &spec.geometry else { return wrong("the sensor is not a scanner", single) };
        let most = presight_model::limits::MAX_IMAGE_SIDE;
        if !(1..=most).contains(&count) {
            return wrong(&format!("{count} headings"), &format!("give 1 to {most}"));
        }
        let start_deg = scanner.azimuth.degrees(0);
        let distinct = sensor.distinct_columns() as usize;
        let offs: Vec<f64> = (0..distinct).map(|i| (scanner.azimuth.degrees(i) - start_deg).abs()).collect();
        let beams = columns_for(&offs, count, most);
        let mut is_taken = vec![false; beams as usize];
        let mut columns = vec![None; sensor.width() as usize];
        for (column, off) in columns.iter_mut().zip(&offs) {
            let nearest = (off * f64::from(beams) / 360.0).round() as u32 % beams;
            *column = Some(nearest).filter(|c| !std::mem::replace(&mut is_taken[*c as usize], true));
        }
        let is_falling = scanner.azimuth.mean_step() < 0.0;
        let turn = if is_falling { -360.0 } else { 360.0 };
        let azimuth = Angles::Uniform { start_deg, step_deg: turn / f64::from(beams), count: beams };
        let geometry = Geometry::Scanner(Scanner { azimuth, ..scanner.clone() });
        let stride = (beams / count) as usize;
        let stride = if is_falling { beams as usize - stride } else { stride };
        let panorama = Sensor::new(spec.clone().with_geometry(geometry))?;
        Ok(Self { count, beams: beams as usize, stride, sensor: sensor.clone(), panorama, columns })
    }

    /// A measured image of the scanner in the columns of the panorama at heading 0, as far as they reach: its readings
    /// and its width.
    pub(super) fn resampled(&self, range: &[f32]) -> (Vec<f32>, usize) {
        let width = self.columns.iter().flatten().max().map_or(1, |last| *last as usize + 1);
        let rows = range.chunks(self.columns.len());
        let mut resampled = vec![f32::NAN; width * rows.len()];
        for (row, to) in rows.zip(resampled.chunks_mut(width)) {
            for (reading, column) in row.iter().zip(&self.columns) {
                if let Some(column) = column {
                    to[*column as usize] = *reading;
                }
            }
        }
        (resampled, width)
    }

    pub(super) fn sensor(&self) -> &SensorSpec {
        self.sensor.spec()
    }

    /// Number of headings.
    pub fn count(&self) -> u32 {
        self.count
    }

    /// The scanner with its beams extended to the full turn.
    pub fn panorama(&self) -> &Sensor {
        &self.panorama
    }

    /// The angle of a heading, degrees.
    pub fn degrees(&self, heading: u32) -> f64 {
        360.0 * f64::from(heading) / f64::from(self.count)
    }

    /// The pose of the sensor at a position and heading.
    pub fn pose(&self, place: DVec3, heading: u32) -> SensorPose {
        let (sin, cos) = sin_cos_deg(0.5 * self.degrees(heading));
        SensorPose::new(Pose { translation: place, rotation: DQuat::from_xyzw(0.0, 0.0, sin, cos) })
    }

    /// The pose at which the panorama for a place is predicted; the given pose's heading is ignored.
    ///
    /// # Errors
    /// [`presight_model::ErrorKind::Usage`] for a tilted pose.
    pub fn place(&self, pose: &SensorPose) -> Result<SensorPose> {
        let world_from_sensor = pose.world_from_sensor();
        world_from_sensor.check()?;
        if !is_level(&world_from_sensor) {
            let what = "all headings at once: the sensor is tilted, so its panorama depends on the heading";
            return Err(Error::usage(what, "give level poses, or a pose for each heading"));
        }
        Ok(SensorPose::new(Pose { rotation: DQuat::IDENTITY, ..world_from_sensor }))
    }
}

/// The smallest number of columns of a turn for which every beam is near a column: a multiple of `count`, at most
/// `most`. `offs` are the angles of the beams from the first one, degrees.
fn columns_for(offs: &[f64], count: u32, most: u32) -> u32 {
    let gaps = offs.array_windows().map(|[a, b]| b - a);
    let mean = offs.last().copied().unwrap_or(0.0) / offs.len() as f64;
    // A few close beams do not justify finer columns for all.
    let step = gaps.fold(f64::INFINITY, f64::min).max(0.5 * mean).min(360.0);
    let farthest = |columns: u32| {
        let place = |off: &f64| off * f64::from(columns) / 360.0;
        offs.iter().map(place).map(|x| (x - x.round()).abs()).fold(0.0, f64::max) * 360.0 / f64::from(columns)
    };
    let turns = (360.0 / (step * f64::from(count)) - SAME_ANGLE).ceil().clamp(1.0, f64::from(most / count)) as u32;
    let mut multiples = (turns..=most / count).map(|n| n * count);
    multiples.clone().find(|columns| farthest(*columns) <= FARTHEST * step).or(multiples.next_back()).unwrap_or(count)
}

/// Number of beams processed together.
const LANES: usize = 16;

/// A range at which no beam ends: its square is finite in f32, and a Gaussian so far away is 0.
const NOWHERE: f32 = 1e18;

/// Weighs all headings of a measured image.
#[derive(Clone, Debug)]
pub(super) struct HeadingWeights {
    headings: Headings,
    model: BeamModel,
    rows: Vec<Row>,
    /// Number of beams with a range, in all rows.
    ranged: usize,
}

/// A row of the measured image.
#[derive(Clone, Debug)]
struct Row {
    /// [`NOWHERE`] for beams without a range, and beyond the row's end.
    sensed: Vec<f32>,
    /// Beams without a return, and beams with a return below `range_min`.
    none: Vec<u32>,
    near: Vec<u32>,
}

/// A row of the panorama, extended by a measured row. Densities are relative to the density of random readings.
#[derive(Clone, Debug, Default)]
pub(super) struct Panorama {
    range: Vec<f32>,
    peak: Vec<f32>,
    sharpness: Vec<f32>,
    short: Vec<f32>,
    /// Logarithms of probabilities.
    none: Vec<f32>,
    near: Vec<f32>,
    /// Number of factors whose product certainly stays within f32.
    steps: usize,
}

impl HeadingWeights {
    pub fn new(headings: &Headings, sensed: &RangeLikelihood) -> Self {
        let (range, width) = headings.resampled(sensed.range());
        let row = |range: &[f32]| {
            let those = |what: f32| (0..).zip(range).filter(|(_, r)| **r == what).map(|(i, _)| i).collect();
            let mut ranges: Vec<f32> = range.iter().map(|r| if r.is_finite() { *r } else { NOWHERE }).collect();
            ranges.resize(width.next_multiple_of(LANES), NOWHERE);
            Row { sensed: ranges, none: those(f32::INFINITY), near: those(f32::NEG_INFINITY) }
        };
        let model = sensed.model;
        Self {
            headings: headings.clone(),
            model,
            rows: range.chunks(width).map(row).collect(),
            ranged: range.iter().filter(|r| r.is_finite()).count(),
        }
    }

    /// Returns log-likelihoods by heading, from the panorama's images.
    pub fn weigh(&self, range: &[f32], cos_incidence: &[f32], panorama: &mut Panorama) -> Vec<f32> {
        let arch = pulp::Arch::new();
        let count = self.headings.count as usize;
        let mut sums = vec![self.ranged as f64 * self.model.any.ln(); count];
        for (r, row) in self.rows.iter().enumerate() {
            let part = r * self.headings.beams..(r + 1) * self.headings.beams;
            let (range, cos_incidence) = (&range[part.clone()], &cos_incidence[part]);
            arch.dispatch(Fill { weigher: self, row, range, cos_incidence, panorama });
            arch.dispatch(Shift { weigher: self, row, panorama, sums: &mut sums });
        }
        self.tempered(&sums)
    }

    /// Returns log-likelihoods from the sums of the beams' logarithms.
    pub fn tempered(&self, sums: &[f64]) -> Vec<f32> {
        sums.iter().map(|sum| (sum / self.model.mixture.beam_dependence) as f32).collect()
    }
}

/// Fills a row of the panorama. A type, so that it is compiled for each vector width.
struct Fill<'a> {
    weigher: &'a HeadingWeights,
    row: &'a Row,
    range: &'a [f32],
    cos_incidence: &'a [f32],
    panorama: &'a mut Panorama,
}

impl pulp::WithSimd for Fill<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: pulp::Simd>(self, simd: S) {
        let Self { weigher, row, range, cos_incidence, panorama } = self;
        let model = &weigher.model;
        let n = range.len();
        for part in panorama.parts() {
            part.clear();
        }
        let mut most = 2f32;
        let (near, none) =
            (!row.near.is_empty(), [0.0, model.mixture.hit].map(|p| (model.mixture.none + p).ln() as f32));
        for at in (0..n).step_by(LANES) {
            let lanes = |image: &[f32]| array::from_fn(|l| image.get(at + l).copied().unwrap_or(f32::INFINITY).into());
            let (range, cos) = (lanes(range), lanes(cos_incidence));
            let beams = Beams::of(simd, model, &range, &cos);
            for l in 0..LANES.min(n - at) {
                most = most.max(panorama.push(model, range[l], &beams, l));
                panorama.none.push(if range[l] == f64::INFINITY { none[1] } else { none[0] });
                // Logarithms are slow, and scanners without a range_min never read below it.
                panorama.near.push(if near { beams.near[l].ln() as f32 } else { 0.0 });
            }
        }
        for part in panorama.parts() {
            for i in 0..row.sensed.len() {
                part.push(part[i % n]);
            }
        }
        panorama.steps = (125.0 / most.log2()).max(1.0) as usize;
    }
}

/// Densities of some beams' possible readings.
struct Beams {
    peak: [f64; LANES],
    sharpness: [f64; LANES],
    short: [f64; LANES],
    near: [f64; LANES],
}

impl Beams {
    #[inline(always)]
    fn of<S: pulp::Simd>(simd: S, model: &BeamModel, range: &[f64; LANES], cos_incidence: &[f64; LANES]) -> Self {
        let none = [0.0; LANES];
        let mut ours = Self { peak: none, sharpness: none, short: none, near: none };
        {
            let [range, cos] = [range, cos_incidence].map(|lanes| S::as_simd_f64s(lanes).0);
            let Self { peak, sharpness, short, near } = &mut ours;
            let [peak, sharpness, short, near] =
                [peak, sharpness, short, near].map(|lanes| S::as_mut_simd_f64s(lanes).0);
            for i in 0..LANES / S::F64_LANES {
                let surface = model.surface(simd, range[i], cos[i]);
                (peak[i], sharpness[i], short[i]) = (surface.peak, surface.sharpness, surface.short);
                near[i] = model.near(simd, range[i], surface.short);
            }
        }
        ours
    }
}

impl Panorama {
    fn parts(&mut self) -> [&mut Vec<f32>; 6] {
        let Self { range, peak, sharpness, short, none, near, .. } = self;
        [range, peak, sharpness, short, none, near]
    }

    /// Adds a beam. Returns the largest factor that it may have.
    #[inline(always)]
    fn push(&mut self, model: &BeamModel, range: f64, beams: &Beams, l: usize) -> f32 {
        let peak = (beams.peak[l] / model.any) as f32;
        let short = (beams.short[l] / model.any) as f32;
        // For powers of two instead of e.
        let sharpness = (-beams.sharpness[l] * std::f64::consts::LOG2_E) as f32;
        let [range, peak, sharpness, short] = match range {
            // A reading is always nearer than no return, and never nearer than a surface below range_min.
            f64::INFINITY => [(2.0 * model.range_max) as f32, 0.0, 0.0, short],
            f64::NEG_INFINITY => [0.0; 4],
            range => [range as f32, peak, sharpness, short],
        };
        self.range.push(range);
        self.peak.push(peak);
        self.sharpness.push(sharpness);
        self.short.push(short);
        1.0 + peak + short
    }
}

/// Adds a row's log-likelihoods of all headings. A type, so that it is compiled for each vector width.
struct Shift<'a> {
    weigher: &'a HeadingWeights,
    row: &'a Row,
    panorama: &'a Panorama,
    sums: &'a mut [f64],
}

impl pulp::WithSimd for Shift<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: pulp::Simd>(self, _: S) {
        let Self { weigher, row, panorama, sums } = self;
        let (beams, stride) = (weigher.headings.beams, weigher.headings.stride);
        for (k, sum) in sums.iter_mut().enumerate() {
            let first = k * stride % beams;
            let table = |table: &[f32], i: &u32| f64::from(table[first + *i as usize]);
            *sum += ranges(row, panorama, first);
            *sum += row.none.iter().map(|i| table(&panorama.none, i)).sum::<f64>();
            *sum += row.near.iter().map(|i| table(&panorama.near, i)).sum::<f64>();
        }
    }
}

/// Logarithm of the product of all range factors of a row whose first beam is the panorama's `first`.
#[inline(always)]
fn ranges<'a>(row: &Row, panorama: &'a Panorama, first: usize) -> f64 {
    const MANTISSA: u32 = 0x007f_ffff;
    const ONE: u32 = 0x3f80_0000;
    let sensed = row.sensed.as_chunks::<LANES>().0;
    let part = |table: &'a [f32]| table[first..first + row.sensed.len()].as_chunks::<LANES>().0;
    let (range, peak) = (part(&panorama.range), part(&panorama.peak));
    let (sharpness, short) = (part(&panorama.sharpness), part(&panorama.short));
    let mut product = [1f32; LANES];
    let mut exponent = [0u32; LANES];
    let chunks = sensed.iter().zip(range).zip(peak).zip(sharpness).zip(short);
    let mut left = panorama.steps;
    for ((((sensed, range), peak), sharpness), short) in chunks {
        for l in 0..LANES {
            let away = sensed[l] - range[l];
            let hit = peak[l] * exp2(away * away * sharpness[l]);
            let nearer = if away < 0.0 { short[l] } else { 0.0 };
            product[l] *= 1.0 + nearer + hit;
        }
        left -= 1;
        if left == 0 {
            // Factors are at least 1: keep the product's mantissa and count its exponent.
            for l in 0..LANES {
                let bits = product[l].to_bits();
                exponent[l] += (bits >> 23) - 127;
                product[l] = f32::from_bits(bits & MANTISSA | ONE);
            }
            left = panorama.steps;
        }
    }
    let mut whole = 0;
    let mut mantissas = 1.0;
    for (product, exponent) in product.iter().zip(exponent) {
        let bits = product.to_bits();
        whole += exponent + (bits >> 23) - 127;
        mantissas *= f64::from(f32::from_bits(bits & MANTISSA | ONE));
    }
    f64::from(whole) * std::f64::consts::LN_2 + f64::ln(mantissas)
}

/// 2^x for x <= 0, to a relative error of 3e-7; about 0 below -126. Without branches, so that it vectorizes.
#[inline(always)]
fn exp2(x: f32) -> f32 {
    /// After adding it, the last bit of the sum is worth 1.
    const ROUND: f32 = 12_582_912.0;
    let x = if x > -126.0 { x } else { -126.0 };
    let rounded = x + ROUND;
    let f = x - (rounded - ROUND);
    // 2^f by its Taylor series in f ln 2, |f| <= 1/2: the first omitted term is at most 1.1e-7.
    let p = 1.540_353e-4 * f + 1.333_355_8e-3;
    let p = p * f + 9.618_129e-3;
    let p = p * f + 5.550_411e-2;
    let p = p * f + 2.402_265e-1;
    let p = p * f + std::f32::consts::LN_2;
    let p = p * f + 1.0;
    f32::from_bits(p.to_bits().wrapping_add(rounded.to_bits() << 23))
}

#[cfg(test)]
mod tests {
    use super::exp2;

    #[test]
    fn powers_of_two_are_right() {
        for i in 0..=1_260_000u32 {
            let x = -(i as f32) * 1e-4;
            let exact = f64::from(x).exp2();
            assert!((f64::from(exp2(x)) / exact - 1.0).abs() < 3e-7, "{x}");
        }
        assert!(exp2(f32::NEG_INFINITY) < 2e-38 && exp2(-1e30) < 2e-38);
        assert_eq!(exp2(0.0), 1.0);
    }
}
