//! The images every engine fills.

use super::output::{Maker, Output, Outputs};
use presight_model::error::Result;
use presight_model::memory;
use presight_model::sensor::{ImagePart, PixelGrid, Sensor};

/// The images of one prediction, row-major, from the top row down. An image that was not requested is empty.
///
/// Distances are `+inf` beyond `range_max` or without a hit, `-inf` below `range_min` (other images keep their values),
/// and NaN if the pixel has no ray. Without a hit, `cos_incidence`, `echo` and `normal` are NaN, and ids are 0.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Images {
    /// Columns.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// Metres along the ray.
    pub range: Vec<f32>,
    /// Metres along the optical axis; cameras only.
    pub depth_z: Vec<f32>,
    /// See [`super::IdScheme`].
    pub polygon_id: Vec<u32>,
    /// Object index + 1.
    pub object_id: Vec<u32>,
    /// 0..=1.
    pub cos_incidence: Vec<f32>,
    /// 0..=1: reflection factor times `cos_incidence`.
    pub echo: Vec<f32>,
    /// Unit vectors in the sensor's body axes.
    pub normal: Vec<[f32; 3]>,
    /// The feature's number; filled from `features::FeaturePrediction`, never by an engine.
    pub feature_id: Vec<u32>,
}

/// The samples of one image, one per pixel.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Samples<'a> {
    /// An image of [`super::SampleKind::Float`].
    Floats(&'a [f32]),
    /// An image of [`super::SampleKind::Id`].
    Ids(&'a [u32]),
    /// An image of [`super::SampleKind::Vector`].
    Vectors(&'a [[f32; 3]]),
}

impl Samples<'_> {
    /// Number of pixels.
    pub fn len(&self) -> usize {
        match self {
            Self::Floats(image) => image.len(),
            Self::Ids(image) => image.len(),
            Self::Vectors(image) => image.len(),
        }
    }

    /// True if the image was not requested.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// True if the pixel has no value: NaN, or id 0.
    fn is_open(&self, at: usize) -> bool {
        match self {
            Self::Floats(image) => image.get(at).is_none_or(|v| v.is_nan()),
            Self::Ids(image) => image.get(at).is_none_or(|id| *id == 0),
            Self::Vectors(image) => image.get(at).is_none_or(|v| v.iter().all(|x| x.is_nan())),
        }
    }
}

/// One image, for writing.
#[derive(Debug)]
pub enum SamplesMut<'a> {
    /// An image of [`super::SampleKind::Float`].
    Floats(&'a mut Vec<f32>),
    /// An image of [`super::SampleKind::Id`].
    Ids(&'a mut Vec<u32>),
    /// An image of [`super::SampleKind::Vector`].
    Vectors(&'a mut Vec<[f32; 3]>),
}

impl SamplesMut<'_> {
    fn clear(&mut self) {
        match self {
            Self::Floats(image) => image.clear(),
            Self::Ids(image) => image.clear(),
            Self::Vectors(image) => image.clear(),
        }
    }

    fn resize(&mut self, pixels: usize) {
        match self {
            Self::Floats(image) => image.resize(pixels, 0.0),
            Self::Ids(image) => image.resize(pixels, 0),
            Self::Vectors(image) => image.resize(pixels, [0.0; 3]),
        }
    }

    fn reserve(&mut self, pixels: usize) -> Result<()> {
        match self {
            Self::Floats(image) => memory::reserve(image, pixels),
            Self::Ids(image) => memory::reserve(image, pixels),
            Self::Vectors(image) => memory::reserve(image, pixels),
        }
    }
}

impl Images {
    /// Returns an image; `None` if it is empty.
    pub fn samples(&self, output: Output) -> Option<Samples<'_>> {
        let samples = match output {
            Output::Range => Samples::Floats(&self.range),
            Output::DepthZ => Samples::Floats(&self.depth_z),
            Output::PolygonId => Samples::Ids(&self.polygon_id),
            Output::ObjectId => Samples::Ids(&self.object_id),
            Output::CosIncidence => Samples::Floats(&self.cos_incidence),
            Output::Echo => Samples::Floats(&self.echo),
            Output::Normal => Samples::Vectors(&self.normal),
            Output::FeatureId => Samples::Ids(&self.feature_id),
        };
        (!samples.is_empty()).then_some(samples)
    }

    /// Returns an image for writing, empty or not.
    pub fn samples_mut(&mut self, output: Output) -> SamplesMut<'_> {
        match output {
            Output::Range => SamplesMut::Floats(&mut self.range),
            Output::DepthZ => SamplesMut::Floats(&mut self.depth_z),
            Output::PolygonId => SamplesMut::Ids(&mut self.polygon_id),
            Output::ObjectId => SamplesMut::Ids(&mut self.object_id),
            Output::CosIncidence => SamplesMut::Floats(&mut self.cos_incidence),
            Output::Echo => SamplesMut::Floats(&mut self.echo),
            Output::Normal => SamplesMut::Vectors(&mut self.normal),
            Output::FeatureId => SamplesMut::Ids(&mut self.feature_id),
        }
    }

    /// Returns a float image; `None` if it is empty or of another kind.
    pub fn floats(&self, output: Output) -> Option<&[f32]> {
        match self.samples(output) {
            Some(Samples::Floats(image)) => Some(image),
            _ => None,
        }
    }

    /// Returns an id image; `None` if it is empty or of another kind.
    pub fn ids(&self, output: Output) -> Option<&[u32]> {
        match self.samples(output) {
            Some(Samples::Ids(image)) => Some(image),
            _ => None,
        }
    }

    /// Empties all images except these. Allocations are kept.
    pub fn keep(&mut self, outputs: Outputs) {
        for output in Output::WITH_FEATURES.into_iter().filter(|o| !outputs.has(*o)) {
            self.samples_mut(output).clear();
        }
    }

    /// Resizes the requested images and empties the others. Allocations are kept; contents are unspecified.
    pub fn prepare(&mut self, width: u32, height: u32, outputs: Outputs) {
        (self.width, self.height) = (width, height);
        let pixels = self.pixels();
        for output in Output::WITH_FEATURES {
            let wanted = outputs.has(output) && output.info().maker != Maker::Features;
            self.samples_mut(output).resize(if wanted { pixels } else { 0 });
        }
    }

    /// Same as [`Images::prepare`], but reports missing memory as an error.
    ///
    /// # Errors
    /// [`presight_model::ErrorKind::System`] if the system refuses the memory.
    pub fn try_prepare(&mut self, width: u32, height: u32, outputs: Outputs) -> Result<()> {
        let pixels = width as usize * height as usize;
        let mut wanted = Output::ALL.into_iter().filter(|o| outputs.has(*o));
        wanted.try_for_each(|output| self.samples_mut(output).reserve(pixels))?;
        self.prepare(width, height, outputs);
        Ok(())
    }

    /// Creates empty images with room for this many pixels.
    ///
    /// # Errors
    /// [`presight_model::ErrorKind::System`] if the system refuses the memory.
    pub fn with_room(pixels: usize, outputs: Outputs) -> Result<Self> {
        let mut images = Self::default();
        outputs.iter().try_for_each(|output| images.samples_mut(output).reserve(pixels))?;
        Ok(images)
    }

    /// Fills every image with "no hit", and with "no ray" where the sensor has none.
    #[doc(hidden)]
    pub fn show_nothing(&mut self, grid: &PixelGrid) {
        for output in Output::WITH_FEATURES {
            match self.samples_mut(output) {
                SamplesMut::Floats(image) if output.is_distance() => {
                    image.fill(f32::INFINITY);
                    if let PixelGrid::Rays(rays) = grid {
                        for (pixel, ray) in image.iter_mut().zip(rays.directions()) {
                            *pixel = if ray.x.is_nan() { f32::NAN } else { *pixel };
                        }
                    }
                }
                SamplesMut::Floats(image) => image.fill(f32::NAN),
                SamplesMut::Ids(image) => image.fill(0),
                SamplesMut::Vectors(image) => image.fill([f32::NAN; 3]),
            }
        }
    }

    /// True if a pixel was given up for a deadline: its floats are NaN and its ids 0. In a complete prediction such a
    /// pixel has no hit or no ray.
    pub fn is_open(&self, at: usize) -> bool {
        Output::WITH_FEATURES.into_iter().filter_map(|o| self.samples(o)).all(|samples| samples.is_open(at))
    }

    /// Marks every sample as given up that a surface beyond `complete_to` metres may hide, by the range image. Returns
    /// their number. A surface nearer than `range_min` hides everything beyond it.
    pub fn leave_open(&mut self, complete_to: f64, range_min: f64) -> u64 {
        let is_final = |range: f32| match range {
            f32::NEG_INFINITY => range_min <= complete_to,
            range => range.is_nan() || f64::from(range) <= complete_to,
        };
        let open: Vec<usize> = (0..self.range.len()).filter(|at| !is_final(self.range[*at])).collect();
        for output in Output::WITH_FEATURES {
            match self.samples_mut(output) {
                SamplesMut::Floats(image) if !image.is_empty() => open.iter().for_each(|at| image[*at] = f32::NAN),
                SamplesMut::Ids(image) if !image.is_empty() => open.iter().for_each(|at| image[*at] = 0),
                SamplesMut::Vectors(image) if !image.is_empty() => {
                    open.iter().for_each(|at| image[*at] = [f32::NAN; 3])
                }
                _ => {}
            }
        }
        open.len() as u64
    }

    /// Expands the images of a part to whole images: other pixels are NaN with id 0. Returns the number of their rays.
    #[doc(hidden)]
    pub fn spread(&mut self, part: &Self, which: &ImagePart, sensor: &Sensor) -> Result<u64> {
        let (width, height) = (sensor.width(), sensor.height());
        self.try_prepare(width, height, part.outputs())?;
        fn spread<T: Copy>(to: &mut [T], from: &[T], nothing: T, width: u32, which: &ImagePart) {
            let mut from = from.chunks(which.width() as usize);
            for (y, to) in to.chunks_mut(width as usize).enumerate() {
                to.fill(nothing);
                if y % which.stride as usize == 0 {
                    let columns = to[which.first_column as usize..].iter_mut().step_by(which.stride as usize);
                    columns.zip(from.next().into_iter().flatten()).for_each(|(to, from)| *to = *from);
                }
            }
        }
        let floats = [
            (&mut self.range, &part.range),
            (&mut self.depth_z, &part.depth_z),
            (&mut self.cos_incidence, &part.cos_incidence),
            (&mut self.echo, &part.echo),
        ];
        let ids = [(&mut self.polygon_id, &part.polygon_id), (&mut self.object_id, &part.object_id)];
        floats.into_iter().for_each(|(to, from)| spread(to, from, f32::NAN, width, which));
        ids.into_iter().for_each(|(to, from)| spread(to, from, 0, width, which));
        let rays = |grid: &PixelGrid, pixels: u64| match grid {
            PixelGrid::Lines(_) => pixels,
            PixelGrid::Rays(rays) => rays.directions().filter(|ray| !ray.is_nan()).count() as u64,
        };
        let all = rays(sensor.grid(), u64::from(width) * u64::from(height));
        Ok(all - rays(sensor.part(*which)?.grid(), part.pixels() as u64))
    }

    /// Copies one pixel from images of the same size and outputs.
    pub(crate) fn copy_pixel(&mut self, from: &Self, at: usize) {
        fn copy<T: Copy>(to: &mut [T], from: &[T], at: usize) {
            if let (Some(to), Some(from)) = (to.get_mut(at), from.get(at)) {
                *to = *from;
            }
        }
        for output in Output::WITH_FEATURES {
            match (self.samples_mut(output), from.samples(output)) {
                (SamplesMut::Floats(to), Some(Samples::Floats(from))) => copy(to, from, at),
                (SamplesMut::Ids(to), Some(Samples::Ids(from))) => copy(to, from, at),
                (SamplesMut::Vectors(to), Some(Samples::Vectors(from))) => copy(to, from, at),
                _ => {}
            }
        }
    }

    /// Bytes of memory held, including the capacity of empty images.
    pub fn bytes(&self) -> u64 {
        let held = Output::WITH_FEATURES.map(|o| 4 * o.info().kind.numbers() * self.capacity(o));
        held.iter().sum::<usize>() as u64
    }

    /// The image's capacity in pixels.
    fn capacity(&self, output: Output) -> usize {
        match output {
            Output::Range => self.range.capacity(),
            Output::DepthZ => self.depth_z.capacity(),
            Output::PolygonId => self.polygon_id.capacity(),
            Output::ObjectId => self.object_id.capacity(),
            Output::CosIncidence => self.cos_incidence.capacity(),
            Output::Echo => self.echo.capacity(),
            Output::Normal => self.normal.capacity(),
            Output::FeatureId => self.feature_id.capacity(),
        }
    }

    /// Number of pixels.
    pub fn pixels(&self) -> usize {
        self.width as usize * self.height as usize
    }

    /// The images that are not empty.
    pub fn outputs(&self) -> Outputs {
        let there = Output::WITH_FEATURES.into_iter().filter(|o| self.samples(*o).is_some());
        there.fold(Outputs::of(&[]), Outputs::with)
    }
}

#[cfg(test)]
mod tests {
    use super::super::output::SampleKind;
    use super::*;

    fn kind_of(samples: &SamplesMut<'_>) -> SampleKind {
        match samples {
            SamplesMut::Floats(_) => SampleKind::Float,
            SamplesMut::Ids(_) => SampleKind::Id,
            SamplesMut::Vectors(_) => SampleKind::Vector,
        }
    }

    #[test]
    fn every_image_is_of_the_kind_that_the_table_names() {
        let mut images = Images::default();
        images.prepare(3, 1, Outputs::ALL);
        for output in Output::WITH_FEATURES {
            assert_eq!(kind_of(&images.samples_mut(output)), output.info().kind, "{}", output.name());
            assert_eq!(images.samples(output).is_some(), output != Output::FeatureId);
        }
        assert_eq!(images.outputs(), Outputs::ALL);
        images.keep(Outputs::of(&[Output::Echo]));
        assert_eq!(images.outputs(), Outputs::of(&[Output::Echo]));
    }
}
