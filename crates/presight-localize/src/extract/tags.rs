//! Fiducials for [`super::find_features`], with the Cargo feature `fiducials` and for dictionaries of its library.

#[cfg(feature = "fiducials")]
use super::fiducials::FiducialFinder;
use super::region::PixelBox;
use crate::matching::Detection;
use presight_model::environment::FeatureShape;
use presight_model::error::Result;
use presight_model::measured::GreyImage;

/// True if features of this shape are searched in grey images: segments, points and, with the Cargo feature
/// `fiducials`, fiducials of a dictionary that `FiducialFinder` supports.
pub fn is_sought(shape: &FeatureShape) -> bool {
    match shape {
        FeatureShape::Segment { .. } | FeatureShape::Point { .. } => true,
        #[cfg(feature = "fiducials")]
        FeatureShape::Fiducial { family, .. } => FiducialFinder::knows(family),
        _ => false,
    }
}

/// The fiducials of a dictionary in a box of an image.
#[cfg(feature = "fiducials")]
pub(super) fn tags_in(image: &GreyImage, region: PixelBox, family: &str) -> Result<Vec<Detection>> {
    use std::cell::RefCell;
    use std::collections::BTreeMap;
    thread_local! {
        // The library takes a while to prepare a dictionary, and a finder must not leave its thread.
        static FINDERS: RefCell<BTreeMap<String, FiducialFinder>> = const { RefCell::new(BTreeMap::new()) };
    }
    FINDERS.with_borrow_mut(|finders| {
        if !finders.contains_key(family) {
            finders.insert(family.to_owned(), FiducialFinder::new(family)?);
        }
        finders.get_mut(family).map_or_else(|| Ok(Vec::new()), |finder| finder.find(image, region))
    })
}

/// Finds nothing: the library is not built in.
#[cfg(not(feature = "fiducials"))]
pub(super) fn tags_in(_: &GreyImage, _: PixelBox, _: &str) -> Result<Vec<Detection>> {
    Ok(Vec::new())
}
