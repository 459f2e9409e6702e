//! Virtual sensors: a view, predicted or measured, reduced to what one task needs.
#![doc = include_str!("../docs/virtual-sensors.md")]

#[doc(inline)]
pub use presight_predict::virtual_sensors::{
    Corridor, CorridorFrame, Mask, Settings, View, ViewIds, VirtualReading, VirtualSensor,
};
