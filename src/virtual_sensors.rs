//! Virtual sensors: a view, predicted or measured, reduced to what one task needs.
#![doc = include_str!("../docs/virtual-sensors.md")]

#[doc(inline)]
pub use presight_predict::virtual_sensors::{
    Answer, Corridor, CorridorFrame, DepthImage, Directions, Docking, Edge, Edges, FloorRegion, FreeFloor, InCorridor,
    Landmark, Landmarks, Mask, MaskRegion, Nearest, NearestPoint, RadarLine, RadarLines, Settings, Unobservable,
    VerticalPlane, VerticalPlanes, View, ViewIds, VirtualReading, VirtualSensor,
};
