//! The images every engine fills.

use super::request::{Output, Outputs};
use crate::error::Result;
use crate::memory;
use crate::sensor::{Part, PixelGrid, Sensor};

/// The images of one prediction, row-major, row 0 on top. An image that was not requested is empty.
///
/// Distances are `+inf` beyond `range_max` and where nothing is hit, `-inf` below `range_min` (ids and cos_incidence are
/// kept there), and NaN where the pixel has no ray. `cos_incidence` and `echo` are NaN where nothing is hit. Id 0 is nothing.
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
    /// The feature's own number; filled from [`crate::features::FeaturePrediction`], never by an engine.
    pub feature_id: Vec<u32>,
}

impl Images {
    /// Resizes the requested images and empties the others. Allocations are kept; contents are unspecified.
    pub fn prepare(&mut self, width: u32, height: u32, outputs: Outputs) {
        (self.width, self.height) = (width, height);
        let pixels = width as usize * height as usize;
        let len = |o| if outputs.has(o) { pixels } else { 0 };
        self.range.resize(len(Output::Range), 0.0);
        self.depth_z.resize(len(Output::DepthZ), 0.0);
        self.polygon_id.resize(len(Output::PolygonId), 0);
        self.object_id.resize(len(Output::ObjectId), 0);
        self.cos_incidence.resize(len(Output::CosIncidence), 0.0);
        self.echo.resize(len(Output::Echo), 0.0);
        self.feature_id.clear();
    }

    /// [`Images::prepare`], if there is room for them.
    ///
    /// # Errors
    /// [`crate::ErrorKind::System`] if the system refuses the memory.
    pub(crate) fn try_prepare(&mut self, width: u32, height: u32, outputs: Outputs) -> Result<()> {
        let pixels = width as usize * height as usize;
        let len = |o| if outputs.has(o) { pixels } else { 0 };
        memory::reserve(&mut self.range, len(Output::Range))?;
        memory::reserve(&mut self.depth_z, len(Output::DepthZ))?;
        memory::reserve(&mut self.polygon_id, len(Output::PolygonId))?;
        memory::reserve(&mut self.object_id, len(Output::ObjectId))?;
        memory::reserve(&mut self.cos_incidence, len(Output::CosIncidence))?;
        memory::reserve(&mut self.echo, len(Output::Echo))?;
        self.prepare(width, height, outputs);
        Ok(())
    }

    /// Every image that is there shows that nothing is seen, and no ray where the sensor has none.
    pub fn show_nothing(&mut self, grid: &PixelGrid) {
        for image in [&mut self.range, &mut self.depth_z] {
            image.fill(f32::INFINITY);
            if let PixelGrid::Rays(rays) = grid {
                for (pixel, ray) in image.iter_mut().zip(rays.directions()) {
                    *pixel = if ray.x.is_nan() { f32::NAN } else { *pixel };
                }
            }
        }
        self.cos_incidence.fill(f32::NAN);
        self.echo.fill(f32::NAN);
        self.polygon_id.fill(0);
        self.object_id.fill(0);
    }

    /// Whether a sample is not there, of a prediction that gave something up (without that it is one that sees nothing or has no
    /// ray): its floats are NaN and its ids 0.
    pub(crate) fn is_open(&self, at: usize) -> bool {
        let floats = [&self.range, &self.depth_z, &self.cos_incidence, &self.echo];
        let ids = [&self.polygon_id, &self.object_id];
        floats.iter().all(|image| image.get(at).is_none_or(|v| v.is_nan()))
            && ids.iter().all(|image| image.get(at).is_none_or(|id| *id == 0))
    }

    /// Makes whole images of those of a part of a sensor's image: what is left out is NaN with id 0. Returns how many rays that is.
    pub(crate) fn spread(&mut self, part: &Self, which: &Part, sensor: &Sensor) -> Result<u64> {
        let (width, height) = (sensor.width(), sensor.height());
        self.try_prepare(width, height, part.outputs())?;
        fn spread<T: Copy>(to: &mut [T], from: &[T], nothing: T, width: u32, which: &Part) {
            to.fill(nothing);
            let rows = to.chunks_mut(width as usize).step_by(which.stride as usize);
            for (to, from) in rows.zip(from.chunks(which.width() as usize)) {
                let columns = to[which.first_column as usize..].iter_mut().step_by(which.stride as usize);
                columns.zip(from).for_each(|(to, from)| *to = *from);
            }
        }
        let floats = [
            (&mut self.range, &part.range),
            (&mut self.depth_z, &part.depth_z),
            (&mut self.cos_incidence, &part.cos_incidence),
            (&mut self.echo, &part.echo),
        ];
        floats.into_iter().for_each(|(to, from)| spread(to, from, f32::NAN, width, which));
        for (to, from) in [(&mut self.polygon_id, &part.polygon_id), (&mut self.object_id, &part.object_id)] {
            spread(to, from, 0, width, which);
        }
        let rays = |grid: &PixelGrid, pixels: u64| match grid {
            PixelGrid::Lines(_) => pixels,
            PixelGrid::Rays(rays) => rays.directions().filter(|ray| !ray.is_nan()).count() as u64,
        };
        let all = rays(sensor.grid(), u64::from(width) * u64::from(height));
        Ok(all - rays(sensor.part(*which)?.grid(), part.pixels() as u64))
    }

    /// Takes one pixel over from images of the same size and outputs.
    pub(crate) fn copy_pixel(&mut self, from: &Self, at: usize) {
        fn copy<T: Copy>(to: &mut [T], from: &[T], at: usize) {
            if let (Some(to), Some(from)) = (to.get_mut(at), from.get(at)) {
                *to = *from;
            }
        }
        copy(&mut self.range, &from.range, at);
        copy(&mut self.depth_z, &from.depth_z, at);
        copy(&mut self.cos_incidence, &from.cos_incidence, at);
        copy(&mut self.echo, &from.echo, at);
        copy(&mut self.polygon_id, &from.polygon_id, at);
        copy(&mut self.object_id, &from.object_id, at);
        copy(&mut self.feature_id, &from.feature_id, at);
    }

    /// Bytes of memory held, including the capacity of images that are empty now.
    pub fn bytes(&self) -> u64 {
        let floats = [&self.range, &self.depth_z, &self.cos_incidence, &self.echo].map(Vec::capacity);
        let ids = [&self.polygon_id, &self.object_id, &self.feature_id].map(Vec::capacity);
        4 * floats.iter().chain(&ids).sum::<usize>() as u64
    }

    /// Number of pixels.
    pub fn pixels(&self) -> usize {
        self.width as usize * self.height as usize
    }

    /// The images that are not empty.
    pub fn outputs(&self) -> Outputs {
        let lens = [
            (Output::Range, self.range.len()),
            (Output::DepthZ, self.depth_z.len()),
            (Output::PolygonId, self.polygon_id.len()),
            (Output::ObjectId, self.object_id.len()),
            (Output::CosIncidence, self.cos_incidence.len()),
            (Output::Echo, self.echo.len()),
            (Output::FeatureId, self.feature_id.len()),
        ];
        let there: Vec<Output> = lens.into_iter().filter(|(_, len)| *len > 0).map(|(o, _)| o).collect();
        Outputs::of(&there)
    }

    /// A float image; `None` if it is empty or holds ids.
    pub fn floats(&self, output: Output) -> Option<&[f32]> {
        let image = match output {
            Output::Range => &self.range,
            Output::DepthZ => &self.depth_z,
            Output::CosIncidence => &self.cos_incidence,
            Output::Echo => &self.echo,
            Output::PolygonId | Output::ObjectId | Output::FeatureId => return None,
        };
        (!image.is_empty()).then_some(image.as_slice())
    }

    /// An id image; `None` if it is empty or holds floats.
    pub fn ids(&self, output: Output) -> Option<&[u32]> {
        let image = match output {
            Output::PolygonId => &self.polygon_id,
            Output::ObjectId => &self.object_id,
            Output::FeatureId => &self.feature_id,
            Output::Range | Output::DepthZ | Output::CosIncidence | Output::Echo => return None,
        };
        (!image.is_empty()).then_some(image.as_slice())
    }
}
