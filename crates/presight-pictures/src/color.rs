//! Colours of values.

use super::canvas::{PAGE, Rgb, mix};
use super::scale::Scale;
use presight_render::plan::{Images, Output, SampleKind, Samples};

/// Nothing seen.
pub const MISS: Rgb = [0x26, 0x2a, 0x33];
/// Nearer than the sensor can measure.
pub const TOO_NEAR: Rgb = [0x8c, 0x2f, 0x39];
/// The sensor has no ray there.
pub const NO_RAY: Rgb = [0x0b, 0x0c, 0x0f];

/// Viridis by Smith and van der Walt (CC0), in tenths. Lightness rises evenly, which also suits colour-blind readers.
/// The darkest tenth is left out because it resembles the page.
const VIRIDIS: [Rgb; 10] = [
    [0x48, 0x24, 0x75],
    [0x41, 0x44, 0x87],
    [0x35, 0x5f, 0x8d],
    [0x2a, 0x78, 0x8e],
    [0x21, 0x91, 0x8c],
    [0x22, 0xa8, 0x84],
    [0x44, 0xbf, 0x70],
    [0x7a, 0xd1, 0x51],
    [0xbd, 0xdf, 0x26],
    [0xfd, 0xe7, 0x25],
];

/// Near (0) is light yellow, far (1) dark violet.
pub fn by_distance(share: f64) -> Rgb {
    let at = (1.0 - share).clamp(0.0, 1.0) * (VIRIDIS.len() - 1) as f64;
    let i = (at as usize).min(VIRIDIS.len() - 2);
    mix(VIRIDIS[i], VIRIDIS[i + 1], at - i as f64)
}

/// Marked pixels.
const MARKED: Rgb = [0x35, 0xd0, 0xff];
/// Stripes over pixels dropped for a deadline.
const GIVEN_UP: Rgb = [0x7a, 0x80, 0x8c];

/// Grey in perceptually even steps.
pub fn grey(share: f64) -> Rgb {
    [(share.clamp(0.0, 1.0) * 255.0).round() as u8; 3]
}

/// A colour for an id. Hues of consecutive ids are 137 degrees apart; lightness has one of three values.
pub fn by_id(id: u32) -> Rgb {
    const GOLDEN: f64 = 0.618_033_988_749_895;
    let hue = (f64::from(id) * GOLDEN).fract() * std::f64::consts::TAU;
    let lightness = [0.70, 0.80, 0.60][(id.wrapping_mul(0x9e37_79b9) >> 16) as usize % 3];
    oklab(lightness, 0.12 * hue.cos(), 0.12 * hue.sin())
}

/// OKLab (Ottosson 2020) to sRGB.
fn oklab(l: f64, a: f64, b: f64) -> Rgb {
    let cube = |x: f64| x * x * x;
    let long = cube(l + 0.396_337_777_4 * a + 0.215_803_757_3 * b);
    let medium = cube(l - 0.105_561_345_8 * a - 0.063_854_172_8 * b);
    let short = cube(l - 0.089_484_177_5 * a - 1.291_485_548_0 * b);
    let linear = [
        4.076_741_662_1 * long - 3.307_711_591_3 * medium + 0.230_969_929_2 * short,
        -1.268_438_004_6 * long + 2.609_757_401_1 * medium - 0.341_319_396_5 * short,
        -0.004_196_086_3 * long - 0.703_418_614_7 * medium + 1.707_614_701_0 * short,
    ];
    linear.map(|c| {
        let c = c.clamp(0.0, 1.0);
        let encoded = if c <= 0.003_130_8 { 12.92 * c } else { 1.055 * c.powf(1.0 / 2.4) - 0.055 };
        (encoded * 255.0).round() as u8
    })
}

/// The colours of all pixels of one output.
pub struct Palette {
    colors: Vec<Rgb>,
    /// Colours that are not values, with their names, for the legend.
    pub specials: Vec<(Rgb, &'static str)>,
}

impl Palette {
    pub fn new(images: &Images, output: Output, scale: &Scale) -> Self {
        let colors: Vec<Rgb> = match images.samples(output) {
            Some(Samples::Floats(values)) => values.iter().map(|v| of_value(*v, output, scale)).collect(),
            Some(Samples::Ids(ids)) => ids.iter().map(|id| if *id == 0 { MISS } else { by_id(*id) }).collect(),
            Some(Samples::Vectors(vectors)) => vectors.iter().map(|v| v.map(of_component)).collect(),
            None => Vec::new(),
        };
        let nothing = if output.info().kind == SampleKind::Vector { [0; 3] } else { MISS };
        let mut specials = vec![(nothing, "nothing")];
        if let Some(values) = images.floats(output).filter(|_| output.is_distance()) {
            let there = |special: fn(&f32) -> bool| values.iter().any(special);
            specials.retain(|_| there(|v| *v == f32::INFINITY));
            specials.extend(there(|v| *v == f32::NEG_INFINITY).then_some((TOO_NEAR, "too near")));
            specials.extend(there(|v| v.is_nan()).then_some((NO_RAY, "no ray")));
        } else {
            specials.retain(|_| colors.contains(&nothing));
        }
        Self { colors, specials }
    }

    /// Colours of classes by index into `legend`; a pixel without a class gets the page's colour.
    pub fn of_classes(classes: &[u8], legend: &[(&str, Rgb)]) -> Self {
        let color = |class: &u8| legend.get(usize::from(*class)).map_or(PAGE, |(_, color)| *color);
        Self { colors: classes.iter().map(color).collect(), specials: Vec::new() }
    }

    /// Tints some pixels.
    pub fn mark(&mut self, pixels: &[bool]) {
        for (color, _) in self.colors.iter_mut().zip(pixels).filter(|(_, on)| **on) {
            *color = mix(*color, MARKED, 0.6);
        }
        if pixels.contains(&true) {
            self.specials.push((MARKED, "marked"));
        }
    }

    /// Hatches pixels that were dropped for a deadline.
    pub fn hatch(&mut self, given_up: &[bool], width: u32) {
        let is_dark = |at: usize| (at % width as usize + at / width as usize) % 6 < 3;
        for (at, color) in self.colors.iter_mut().enumerate().filter(|(at, _)| given_up[*at]) {
            *color = if is_dark(at) { GIVEN_UP } else { MISS };
        }
        self.specials.retain(|(_, name)| *name != "no ray");
        self.specials.push((GIVEN_UP, "not predicted"));
    }

    pub fn color(&self, pixel: usize) -> Rgb {
        self.colors[pixel]
    }
}

/// Maps -1..=1 to 0..=255, as normal maps do; NaN is black.
fn of_component(v: f32) -> u8 {
    (127.5 * (v + 1.0)).round() as u8
}

fn of_value(v: f32, output: Output, scale: &Scale) -> Rgb {
    // Outputs without a unit are in 0..=1, and NaN where no surface is seen.
    let is_share = !output.is_distance();
    match v {
        v if v.is_nan() && is_share => MISS,
        v if v.is_nan() => NO_RAY,
        f32::INFINITY => MISS,
        f32::NEG_INFINITY => TOO_NEAR,
        v if is_share => grey(f64::from(v)),
        v => by_distance(scale.share(f64::from(v))),
    }
}
