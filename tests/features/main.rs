//! Features: generation, visibility, regions of interest, reduction by virtual sensors, and tracking.

mod closed;
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
