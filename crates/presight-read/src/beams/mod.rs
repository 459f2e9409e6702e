//! Beam tables as the makers of lidars and their drivers write them: Ouster's metadata, Velodyne's calibrations, and
//! patterns as CSV.

pub mod ouster;
pub mod pattern;
pub mod velodyne;

use presight_model::error::{Error, Result};
use presight_model::sensor::{BeamTable, Geometry, RayTable, SensorSpec};

/// A laser sensor with these beams. `names` are the words of the file for the fields of [`BeamTable`], for errors.
fn sensor_of(name: &str, beams: BeamTable, names: &[(&str, &str)]) -> Result<SensorSpec> {
    let times = beams.times();
    let table = RayTable::of_beams(beams).map_err(|e| {
        let named = names.iter().find(|(field, _)| e.place() == Some(field));
        match named {
            Some((_, name)) => Error::new(e.kind(), e.what(), e.remedy()).at(name),
            None => e,
        }
    })?;
    Ok(SensorSpec::new(name, "laser", Geometry::Rays(table)).with_times(times))
}
