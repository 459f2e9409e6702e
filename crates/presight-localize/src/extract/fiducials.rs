//! Fiducials in grey images, found by the AprilTag library (E. Olson 2011, J. Wang and E. Olson 2016).

use super::region::PixelBox;
use crate::matching::{Detection, Marker, Shape};
use apriltag::{Detector, DetectorBuilder, Family, Image};
use glam::DVec2;
use presight_model::error::{Error, ErrorKind, Result};
use presight_model::measured::GreyImage;

/// Minimum width and height of a searched image, pixels.
const SMALLEST: i64 = 16;
/// Corner error from blur, sampling and 1 % of noise, pixels; measured on rendered tags (`cargo test fiducials`).
const FLOOR: f64 = 0.06;
/// Additional corner error for cells of one pixel; it falls with the square of the cell size.
const OF_CELLS: f64 = 0.36;
/// Bits of error that are corrected. With two, the library takes seconds to prepare.
const CORRECTED: usize = 1;

/// Finds the fiducials of one dictionary.
pub struct FiducialFinder {
    detector: Detector,
    family: &'static str,
    /// Number of cells between neighbouring corners.
    cells: f64,
}

impl FiducialFinder {
    /// True for the dictionaries that [`FiducialFinder::new`] accepts.
    pub fn knows(family: &str) -> bool {
        matches!(family, "DICT_APRILTAG_16h5" | "DICT_APRILTAG_25h9" | "DICT_APRILTAG_36h11")
    }

    /// Makes a finder for a dictionary by OpenCV's name: DICT_APRILTAG_16h5, 25h9 or 36h11.
    ///
    /// # Errors
    /// [`ErrorKind::Usage`] for any other name; [`ErrorKind::System`] if the library gets no memory.
    pub fn new(family: &str) -> Result<Self> {
        let (family, tags, cells) = match family {
            "DICT_APRILTAG_16h5" => ("DICT_APRILTAG_16h5", Family::tag_16h5(), 6.0),
            "DICT_APRILTAG_25h9" => ("DICT_APRILTAG_25h9", Family::tag_25h9(), 7.0),
            "DICT_APRILTAG_36h11" => ("DICT_APRILTAG_36h11", Family::tag_36h11(), 8.0),
            other => {
                let remedy = "give DICT_APRILTAG_16h5, DICT_APRILTAG_25h9 or DICT_APRILTAG_36h11";
                return Err(Error::usage(format!("fiducial dictionary {other:?} is not supported"), remedy));
            }
        };
        let made = DetectorBuilder::new().add_family_bits(tags, CORRECTED).build();
        let refused = |e| Error::new(ErrorKind::System, format!("fiducials: {e}"), "free some memory");
        let mut detector = made.map_err(refused)?;
        // At half the resolution, small tags would be lost.
        detector.set_decimation(1.0);
        Ok(Self { detector, family, cells })
    }

    /// The fiducials in a box of an image: corners clockwise from each tag's own top left, with covariance and
    /// identity. Pixels without a measurement are treated as black.
    ///
    /// # Errors
    /// [`ErrorKind::System`] if the library gets no memory for its image.
    pub fn find(&mut self, image: &GreyImage, region: PixelBox) -> Result<Vec<Detection>> {
        let Some([x0, y0, x1, y1]) = region.pixels(image.width(), image.height()) else { return Ok(Vec::new()) };
        let (width, height) = (x1 - x0 + 1, y1 - y0 + 1);
        if width < SMALLEST || height < SMALLEST {
            return Ok(Vec::new());
        }
        let stride = width as usize;
        let made = Image::zeros_with_stride(width as usize, height as usize, stride);
        let refused = |e| Error::new(ErrorKind::System, format!("a grey image: {e}"), "free some memory");
        let mut grey = made.map_err(refused)?;
        for (r, row) in grey.as_slice_mut().chunks_mut(stride).enumerate() {
            for (c, to) in row.iter_mut().enumerate() {
                // NaN becomes 0.
                *to = (255.0 * image.pixel(x0 as u32 + c as u32, y0 as u32 + r as u32)).round() as u8;
            }
        }
        let first = DVec2::new(x0 as f64, y0 as f64);
        let found = self.detector.detect(&grey);
        Ok(found.iter().map(|tag| self.detection(tag, first)).collect())
    }

    fn detection(&self, tag: &apriltag::Detection, first: DVec2) -> Detection {
        // The library's origin is the corner of the first pixel; its corners run counter-clockwise from the lower left.
        let [lower_left, lower_right, upper_right, upper_left] =
            tag.corners().map(|corner| DVec2::from(corner) - 0.5 + first);
        let corners = [upper_left, upper_right, lower_right, lower_left];
        let sides = (0..4).map(|i| corners[i].distance(corners[(i + 1) % 4]));
        let cell = sides.fold(f64::INFINITY, f64::min) / self.cells;
        let mut detection = Detection::new(Shape::Fiducial(corners), FLOOR.hypot(OF_CELLS / (cell * cell)));
        detection.properties.marker = Some(Marker { family: self.family.into(), code: tag.id() as u32 });
        detection
    }
}
