//! From frames to views: each pixel is compared with the predicted surface on its ray.

pub(crate) mod compare;
pub(crate) mod mount;
pub(crate) mod pixels;
pub(crate) mod priors;
pub(crate) mod register;
pub(crate) mod spot;
pub(crate) mod terms;
pub(crate) mod view;
