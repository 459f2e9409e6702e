//! Bundles: rays that leave the sensor at one point and are measured at one time, so that one pose holds for them.

use super::ray_tiles::RayTiles;
use super::{RayTimes, Sensor};
use crate::error::Result;
use crate::memory;
use glam::DVec3;
use std::collections::HashMap;
use std::sync::OnceLock;

/// The rays of a sensor in bundles.
#[derive(Clone, Debug)]
pub struct Bundles {
    /// [`Sensor::start`] and seconds after the stamp, by bundle.
    starts: Vec<(DVec3, f64)>,
    numbers: BundleNumbers,
    /// Built on first use.
    tiles: OnceLock<RayTiles>,
}

/// The bundle of each pixel.
#[derive(Clone, Debug)]
pub(super) enum BundleNumbers {
    /// A column is a bundle.
    Columns,
    /// A row is a bundle.
    Rows,
    /// By pixel, row by row.
    Listed(Vec<u32>, u32),
}

impl Bundles {
    /// By origins, and by times too if the sensor moves.
    pub(super) fn new(sensor: &Sensor, moves: bool) -> Result<Self> {
        let (width, height) = (sensor.width(), sensor.height());
        let of_line = |time: &dyn Fn(u32) -> f64, count: u32| (0..count).map(|i| (DVec3::ZERO, time(i))).collect();
        let (starts, numbers) = match (&sensor.spec().times, sensor.has_origins()) {
            (RayTimes::Columns { .. }, false) if moves => {
                (of_line(&|column| sensor.seconds_after_stamp(column, 0), width), BundleNumbers::Columns)
            }
            (RayTimes::Rows { .. }, false) if moves => {
                (of_line(&|row| sensor.seconds_after_stamp(0, row), height), BundleNumbers::Rows)
            }
            _ => {
                let mut numbers = memory::reserved(width as usize * height as usize)?;
                let (mut starts, mut known) = (Vec::new(), HashMap::new());
                for (column, row) in (0..height).flat_map(|row| (0..width).map(move |column| (column, row))) {
                    let origin = sensor.start(column, row);
                    let time = if moves { sensor.seconds_after_stamp(column, row) } else { 0.0 };
                    let key = [origin.x, origin.y, origin.z, time].map(f64::to_bits);
                    numbers.push(*known.entry(key).or_insert_with(|| {
                        starts.push((origin, time));
                        starts.len() as u32 - 1
                    }));
                }
                (starts, BundleNumbers::Listed(numbers, width))
            }
        };
        Ok(Self { starts, numbers, tiles: OnceLock::new() })
    }

    /// Number of bundles.
    #[expect(clippy::len_without_is_empty, reason = "a sensor has rays")]
    pub fn len(&self) -> usize {
        self.starts.len()
    }

    /// [`Sensor::start`] and seconds after the stamp, by bundle.
    pub fn starts(&self) -> &[(DVec3, f64)] {
        &self.starts
    }

    /// The bundle of a pixel.
    #[inline]
    pub fn of_pixel(&self, column: u32, row: u32) -> u32 {
        match &self.numbers {
            BundleNumbers::Columns => column,
            BundleNumbers::Rows => row,
            BundleNumbers::Listed(numbers, width) => numbers[row as usize * *width as usize + column as usize],
        }
    }

    pub(super) fn numbers(&self) -> &BundleNumbers {
        &self.numbers
    }

    /// The rays of the sensor in compact tiles, each of one bundle; built on the first call.
    ///
    /// # Errors
    /// [`crate::ErrorKind::System`] if there is no memory for them.
    pub fn ray_tiles(&self, sensor: &Sensor) -> Result<&RayTiles> {
        if self.tiles.get().is_none() {
            let _ = self.tiles.set(RayTiles::of_bundles(sensor, self)?);
        }
        Ok(self.tiles.get().expect("they were set"))
    }
}
