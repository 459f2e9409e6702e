//! Pixel boxes in which features are searched.

use glam::DVec2;
use presight_model::measured::GreyImage;
use presight_model::sensor::Sensor;

/// A box in pixel coordinates, as for regions of interest: x0, y0, x1, y1. The image starts at -0.5, -0.5.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PixelBox(pub [f64; 4]);

impl PixelBox {
    /// The whole image.
    pub fn whole(image: &GreyImage) -> Self {
        Self::of_size(image.width(), image.height())
    }

    /// The whole image of a sensor.
    pub fn whole_of(sensor: &Sensor) -> Self {
        Self::of_size(sensor.width(), sensor.height())
    }

    fn of_size(width: u32, height: u32) -> Self {
        Self([-0.5, -0.5, f64::from(width) - 0.5, f64::from(height) - 0.5])
    }

    /// True if a place lies in the box.
    pub fn contains(&self, place: DVec2) -> bool {
        let [x0, y0, x1, y1] = self.0;
        place.x >= x0 && place.x <= x1 && place.y >= y0 && place.y <= y1
    }

    /// First and last column and row with centres inside, for an image of this size; `None` if there is no such pixel.
    pub(super) fn pixels(&self, width: u32, height: u32) -> Option<[i64; 4]> {
        let [x0, y0, x1, y1] = self.0;
        let first = |x: f64| x.ceil().max(0.0) as i64;
        let last = |x: f64, side: u32| x.floor().min(f64::from(side) - 1.0) as i64;
        let found = [first(x0), first(y0), last(x1, width), last(y1, height)];
        let sound = self.0.iter().all(|x| x.is_finite()) && x1 >= 0.0 && y1 >= 0.0;
        (sound && found[0] <= found[2] && found[1] <= found[3]).then_some(found)
    }
}
