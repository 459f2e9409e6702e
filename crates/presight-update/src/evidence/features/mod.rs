//! Evidence on the features of layers, and on features that layers lack.

pub(crate) mod blind;
pub(crate) mod book;
pub(crate) mod located;
pub(crate) mod sightings;
