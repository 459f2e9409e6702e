//! Features: generated, seen, with regions of interest, reduced by virtual sensors, and followed from frame to frame.

mod contours;
mod crowds;
mod feature_gpu;
mod feature_reference;
mod generate;
mod history;
mod roi_coverage;
mod roi_gpu;
mod virtual_sensors;
mod visibility;
