//! Reflectors in a search: at which places and headings the bright spots of a scan are reflectors of the layer.

use crate::extract::{PixelBox, ReflectorOptions, reflectors_in};
use glam::{DQuat, DVec2, DVec3};
use presight_model::error::Result;
use presight_model::measured::{Frame, RangeNoise};
use std::f64::consts::{FRAC_1_SQRT_2, TAU};

/// How much a reflector that a pose explains speaks for it, natural logarithm of the odds: about one in twenty spots fits a wrong pose by
/// chance.
pub(super) const ODDS: f64 = 3.0;
/// A scan with more spots shows bright surfaces, not reflectors.
const MOST_SPOTS: usize = 64;
/// Deviations of a range within which a spot is a reflector, and half of the width of one, metres.
const WITHIN: (f64, f64) = (3.0, 0.1);

/// The bright spots of a level scan, and the reflectors that they may be.
pub(super) struct SeenReflectors {
    spots: Vec<Spot>,
    /// In the plane, by rising x, metres.
    known: Vec<DVec2>,
}

/// A bright spot, as the sensor sees it.
struct Spot {
    /// From its x axis, counter-clockwise, radians.
    bearing: f64,
    /// In the plane, metres.
    range: f64,
    /// Standard deviation of the range, metres.
    sigma: f64,
}

impl SeenReflectors {
    /// Those of a scan; `None` if it shows none, or too much. `known` is where the layer has its reflectors (world).
    /// `upright_from_sensor` makes the row level, and keeps its x axis.
    ///
    /// # Errors
    /// Those of [`reflectors_in`].
    pub fn of(frame: &Frame, upright_from_sensor: DQuat, known: &[DVec3]) -> Result<Option<Self>> {
        let Some(intensities) = frame.intensities().filter(|_| !known.is_empty()) else { return Ok(None) };
        let sensor = frame.sensor();
        let (body, noise) = (sensor.body_from_image(), RangeNoise::of(sensor));
        let found = reflectors_in(frame, intensities, PixelBox::whole_of(sensor), &ReflectorOptions::default())?;
        let spot = |found: &crate::extract::FoundReflector| {
            let at = found.detection.shape.centre();
            let way = upright_from_sensor * (body * sensor.ray_at(at.x, at.y)?) * found.range.mean;
            let sigma = noise.range_sigma(found.range.mean);
            Some(Spot { bearing: way.y.atan2(way.x), range: way.truncate().length(), sigma })
        };
        let spots: Vec<Spot> = found.iter().filter_map(spot).collect();
        if spots.is_empty() || spots.len() > MOST_SPOTS {
            return Ok(None);
        }
        let mut known: Vec<DVec2> = known.iter().map(|p| p.truncate()).collect();
        known.sort_by(|a, b| a.x.total_cmp(&b.x));
        Ok(Some(Self { spots, known }))
    }

    /// Adds what they say of the headings of a place: `logs` has one log-likelihood for each, evenly over the full turn. The sensor may be
    /// anywhere in the place's cell, whose side is in metres. What hides a reflector from there, the ranges tell.
    pub fn add_to(&self, logs: &mut [f32], place: DVec2, cell: f64) {
        let (count, turn) = (logs.len(), TAU / logs.len() as f64);
        let mut explained = vec![false; count];
        for Spot { bearing, range, sigma } in &self.spots {
            let reach = FRAC_1_SQRT_2 * cell + WITHIN.0 * sigma + WITHIN.1;
            let first = self.known.partition_point(|p| p.x < place.x - range - reach);
            for p in self.known[first..].iter().take_while(|p| p.x <= place.x + range + reach) {
                let way = *p - place;
                if (way.length() - range).abs() > reach {
                    continue;
                }
                let heading = way.y.atan2(way.x) - bearing;
                let half = (reach / range).min(0.5 * TAU) + 0.5 * turn;
                let (from, to) = (((heading - half) / turn).ceil() as i64, ((heading + half) / turn).floor() as i64);
                (from..=to.min(from + count as i64 - 1))
                    .for_each(|k| explained[k.rem_euclid(count as i64) as usize] = true);
            }
            for (log, explained) in logs.iter_mut().zip(&mut explained) {
                *log += if std::mem::take(explained) { ODDS as f32 } else { 0.0 };
            }
        }
    }
}
