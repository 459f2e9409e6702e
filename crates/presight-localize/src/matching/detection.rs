//! Detections: the features that an extractor finds in a measured image.

use glam::{DMat2, DVec2};

/// Maximum number of corners of an outline; it bounds the comparison to 256 pairs. Outlines are compared corner by
/// corner, at every starting corner.
pub(crate) const MAX_OUTLINE: usize = 16;

/// Position of a feature in pixel coordinates (column, row). The centre of the top-left pixel is (0, 0).
#[derive(Clone, Debug, PartialEq)]
pub enum Shape {
    /// A point.
    Point(DVec2),
    /// A retro-reflector.
    Reflector(DVec2),
    /// A straight edge. Extractors break edges anywhere, so an end has no meaning along the edge unless it is a corner.
    Segment {
        /// Both ends, in any order.
        ends: [DVec2; 2],
        /// True for each end that is a corner.
        corners: [bool; 2],
    },
    /// The outline of a planar patch with 3 to 16 corners, starting at any corner.
    Patch(Vec<DVec2>),
    /// A fiducial's corners, clockwise from its own top left.
    Fiducial([DVec2; 4]),
}

impl Shape {
    /// The defining points.
    pub fn points(&self) -> &[DVec2] {
        match self {
            Self::Point(at) | Self::Reflector(at) => std::slice::from_ref(at),
            Self::Segment { ends, .. } => ends,
            Self::Patch(corners) => corners,
            Self::Fiducial(corners) => corners,
        }
    }

    /// The defining points, mutable.
    pub(crate) fn points_mut(&mut self) -> &mut [DVec2] {
        match self {
            Self::Point(at) | Self::Reflector(at) => std::slice::from_mut(at),
            Self::Segment { ends, .. } => ends,
            Self::Patch(corners) => corners,
            Self::Fiducial(corners) => corners,
        }
    }

    /// Mean of the defining points.
    pub fn centre(&self) -> DVec2 {
        let points = self.points();
        points.iter().sum::<DVec2>() / points.len().max(1) as f64
    }

    /// Checks that the coordinates are finite, that a segment has a length, and that a patch has 3 to 16 corners.
    #[doc(hidden)]
    pub fn check(&self) -> Result<(), Rejection> {
        if !self.points().iter().all(|p| p.is_finite() && p.abs().max_element() <= MAX_PIXEL) {
            return Err(Rejection::NotFinite);
        }
        match self {
            Self::Segment { ends, .. } if !(ends[0].distance(ends[1]) >= SHORTEST) => Err(Rejection::Degenerate),
            Self::Patch(corners) if !(3..=MAX_OUTLINE).contains(&corners.len()) => Err(Rejection::Degenerate),
            _ => Ok(()),
        }
    }
}

/// Minimum length of a segment, pixels; a shorter one has no direction.
const SHORTEST: f64 = 1e-3;

/// Maximum pixel coordinate. Squared distances cannot overflow.
const MAX_PIXEL: f64 = 1e9;

/// A fiducial's identity.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Marker {
    /// OpenCV's name of the dictionary.
    pub family: String,
    /// Number in the dictionary.
    pub code: u32,
}

/// Other properties of a detection; `None` is unknown and not compared.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct DetectionProperties {
    /// Strength or reflectivity, 0..=1.
    pub strength: Option<f64>,
    /// Contrast, 0..=1.
    pub contrast: Option<f64>,
    /// Direction in the image, radians from columns to rows, modulo pi. Segments need none: their ends define it.
    pub direction: Option<f64>,
    /// Identity of a fiducial; different ones never match.
    pub marker: Option<Marker>,
    /// Metres along the ray, with the variance of the measurement; for reflectors in scans.
    pub range: Option<UncertainValue>,
}

/// A feature found in a measured image.
///
/// ```
/// use glam::DVec2;
/// use presight::localize::Detection;
/// let mut corner = Detection::point(DVec2::new(120.5, 64.0), 0.5);
/// corner.properties.contrast = Some(0.8);
/// assert!(corner.check().is_ok());
/// let broken = Detection::point(DVec2::new(f64::NAN, 64.0), 0.5);
/// assert!(broken.check().is_err());
/// ```
#[derive(Clone, Debug, PartialEq)]
pub struct Detection {
    /// Kind and position.
    pub shape: Shape,
    /// Covariance of each defining point, pixels squared. For the end of a segment only the part across the segment
    /// counts, unless the end is a corner.
    pub covariance: DMat2,
    /// Other properties.
    pub properties: DetectionProperties,
}

impl Detection {
    /// A shape whose points have the standard deviation `sigma`, pixels.
    pub fn new(shape: Shape, sigma: f64) -> Self {
        Self {
            shape,
            covariance: DMat2::from_diagonal(DVec2::splat(sigma * sigma)),
            properties: DetectionProperties::default(),
        }
    }

    /// A point with the standard deviation `sigma`, pixels.
    pub fn point(at: DVec2, sigma: f64) -> Self {
        Self::new(Shape::Point(at), sigma)
    }

    /// An edge without corners, with the standard deviation `sigma` across it, pixels.
    pub fn segment(ends: [DVec2; 2], sigma: f64) -> Self {
        Self::new(Shape::Segment { ends, corners: [false; 2] }, sigma)
    }

    /// Checks that all values are usable.
    ///
    /// # Errors
    /// The reason for which the detection is rejected.
    #[doc(hidden)]
    pub fn check(&self) -> Result<(), Rejection> {
        self.shape.check()?;
        let [a, b, c, d] = self.covariance.to_cols_array();
        if ![a, b, c, d].iter().all(|x| x.is_finite() && x.abs() <= MAX_PIXEL * MAX_PIXEL) {
            return Err(Rejection::NotFinite);
        }
        if !(a >= 0.0 && d >= 0.0 && (b - c).abs() <= 1e-9 * (a + d) && b * c <= a * d * (1.0 + 1e-9)) {
            return Err(Rejection::Covariance);
        }
        let p = &self.properties;
        if p.range.is_some_and(|r| !(r.mean.is_finite() && r.variance >= 0.0 && r.variance.is_finite())) {
            return Err(Rejection::NotFinite);
        }
        let numbers = [p.strength, p.contrast, p.direction];
        if numbers.iter().flatten().all(|x| x.is_finite()) { Ok(()) } else { Err(Rejection::NotFinite) }
    }
}

/// Reason for rejecting a detection.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Rejection {
    /// A coordinate, a covariance or a property is NaN, infinite or absurdly large.
    NotFinite,
    /// A segment without length, or an outline of fewer than 3 or more than 16 corners.
    Degenerate,
    /// The covariance is not symmetric and positive semidefinite.
    Covariance,
}

/// A number with its variance.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct UncertainValue {
    /// Most likely value.
    pub mean: f64,
    /// Its variance.
    pub variance: f64,
}

/// Expected properties of a feature; `None` is unknown.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ExpectedProperties {
    /// Strength or reflectivity.
    pub strength: Option<UncertainValue>,
    /// Contrast.
    pub contrast: Option<UncertainValue>,
    /// Direction, radians, modulo pi.
    pub direction: Option<UncertainValue>,
    /// Identity of a fiducial.
    pub marker: Option<Marker>,
    /// Metres along the ray.
    pub range: Option<UncertainValue>,
}

/// A feature that may be detected.
#[derive(Clone, Debug, PartialEq)]
pub struct ExpectedFeature {
    /// Most likely position.
    pub shape: Shape,
    /// Covariance of each defining point without the noise of the detection, pixels squared.
    pub covariances: Vec<DMat2>,
    /// Search window: x0, y0, x1, y1. Detections outside are not candidates, but segments only have to cross it.
    pub window: [f64; 4],
    /// Expected properties.
    pub properties: ExpectedProperties,
}
