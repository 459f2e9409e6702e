//! PNG files from rows of pixels.

use ::png::{BitDepth, ColorType, Compression, Encoder, Filter};
use std::io::{self, Write};

/// The channels and the depth of a pixel. Samples of 16 bits are big-endian.
#[derive(Clone, Copy, Debug)]
pub(crate) enum PixelFormat {
    Rgb8,
    Grey8,
    Grey16,
}

/// Writes rows of pixels, the upper row first, as a PNG file.
pub(crate) fn encode(
    mut out: impl Write,
    bytes: &[u8],
    width: u32,
    height: u32,
    format: PixelFormat,
) -> io::Result<()> {
    let (color, depth) = match format {
        PixelFormat::Rgb8 => (ColorType::Rgb, BitDepth::Eight),
        PixelFormat::Grey8 => (ColorType::Grayscale, BitDepth::Eight),
        PixelFormat::Grey16 => (ColorType::Grayscale, BitDepth::Sixteen),
    };
    let mut encoder = Encoder::new(&mut out, width, height);
    encoder.set_color(color);
    encoder.set_depth(depth);
    encoder.set_compression(Compression::Fast);
    encoder.set_filter(Filter::Adaptive);
    let mut writer = encoder.write_header()?;
    writer.write_image_data(bytes)?;
    writer.finish()?;
    out.flush()
}
