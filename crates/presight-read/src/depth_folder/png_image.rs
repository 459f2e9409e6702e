//! The samples of a PNG image.

use png::{BitDepth, ColorType, Decoder, DecodingError, Transformations};
use std::io::{BufRead, Seek};

/// Parts of red, green and blue in the luminance: those of the primaries and the white point of sRGB (IEC 61966-2-1).
const LUMINANCE: [f32; 3] = [0.212_647_84, 0.715_179_2, 0.072_173_04];

/// An image in memory, row-major, with 8 or 16 bits a sample.
pub(super) struct PngImage {
    color: ColorType,
    samples: Vec<u16>,
    /// The sample of white: 255 or 65535.
    white: u16,
}

impl PngImage {
    /// Reads an image of `size` (width and height). The size is checked before decoding, because a small file may claim
    /// a huge image. The error names the size or the defect.
    pub(super) fn read(file: impl BufRead + Seek, size: (u32, u32)) -> Result<Self, String> {
        let named = |e: DecodingError| e.to_string();
        let mut decoder = Decoder::new(file);
        // Palettes become colours, and samples of fewer bits than 8 become bytes.
        decoder.set_transformations(Transformations::EXPAND);
        let mut reader = decoder.read_info().map_err(named)?;
        let (w, h) = reader.info().size();
        if (w, h) != size {
            return Err(format!("{w} x {h} pixels; the camera has {} x {}", size.0, size.1));
        }
        let (color, depth) = reader.output_color_type();
        let mut bytes = vec![0; reader.output_buffer_size().ok_or("the image does not fit into memory")?];
        reader.next_frame(&mut bytes).map_err(named)?;
        let (samples, white) = match depth {
            BitDepth::Sixteen => {
                (bytes.as_chunks().0.iter().map(|sample| u16::from_be_bytes(*sample)).collect(), u16::MAX)
            }
            _ => (bytes.into_iter().map(u16::from).collect(), u16::from(u8::MAX)),
        };
        Ok(Self { color, samples, white })
    }

    /// The samples of a 16-bit grey image; `None` for any other.
    pub(super) fn grey16(&self) -> Option<&[u16]> {
        (self.color == ColorType::Grayscale && self.white == u16::MAX).then_some(&self.samples)
    }

    /// The luminance of each pixel from 0 (black) to 1 (white), in steps of 1/65535. Transparency is ignored.
    pub(super) fn luminances(&self) -> Vec<f32> {
        let channels = self.color.samples();
        let scale = 1.0 / f32::from(self.white);
        let of_16_bits = |value: u16| f32::from(value) / f32::from(u16::MAX);
        let grey = |pixel: &[u16]| of_16_bits(pixel[0] * (u16::MAX / self.white));
        let colored = |pixel: &[u16]| {
            let luminance: f32 = pixel.iter().zip(LUMINANCE).map(|(v, part)| f32::from(*v) * scale * part).sum();
            of_16_bits((luminance * f32::from(u16::MAX)).round() as u16)
        };
        let pixels = self.samples.chunks_exact(channels);
        if channels >= LUMINANCE.len() { pixels.map(colored).collect() } else { pixels.map(grey).collect() }
    }
}
