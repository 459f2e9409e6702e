//! OpenEXR files: their channels and text attributes, before anything is known of the images.

use crate::file;
use crate::text::{FORMAT, check_version};
use exr::image::FlatSamples;
use exr::meta::attribute::{AttributeValue, SampleType};
use exr::meta::header::Header;
use exr::prelude::{ReadChannels, ReadLayers};
use presight_model::error::{Error, ErrorKind, Result};
use presight_model::geometry::Pose;
use presight_model::printable::quoted;
use presight_model::{limits, memory};
use std::io::BufReader;
use std::path::Path;

/// A channel that a reader knows.
#[derive(Clone, Debug, PartialEq)]
pub struct KnownChannel {
    /// The name.
    pub name: String,
    /// True for whole numbers (UINT), false for floats (FLOAT).
    pub is_id: bool,
}

/// The content of a file of one layer.
#[derive(Clone, Debug, PartialEq)]
pub struct ExrFile {
    /// Number of columns.
    pub width: u32,
    /// Number of rows.
    pub height: u32,
    /// Names and pixels of all channels. A known channel has the type of [`KnownChannel`].
    pub channels: Vec<(String, FlatSamples)>,
    /// Names and values of the attributes `presight:*`, names without the prefix.
    pub texts: Vec<(String, String)>,
}

impl ExrFile {
    /// Takes the pixels of a channel of floats, row by row.
    pub fn take_floats(&mut self, name: &str) -> Option<Vec<f32>> {
        match self.channels.iter().position(|(of, _)| of == name).map(|at| self.channels.swap_remove(at).1) {
            Some(FlatSamples::F32(plane)) => Some(plane),
            _ => None,
        }
    }
}

/// Reads a file in which at least one channel is known.
///
/// # Errors
/// [`ErrorKind::Invalid`] or [`ErrorKind::Unsupported`], naming the channel or attribute, for a file that is missing,
/// truncated or not EXR, has deep data, several layers or sides beyond the limits, a known channel that is subsampled
/// or of another type, or attributes of a newer format. [`ErrorKind::System`] if the system refuses.
pub fn read(path: &Path, known: &[KnownChannel]) -> Result<ExrFile> {
    read_unnamed(path, known).map_err(|e| e.in_file(path))
}

fn read_unnamed(path: &Path, known: &[KnownChannel]) -> Result<ExrFile> {
    let file = file::open(path)?;
    let chunks = exr::block::read(BufReader::new(file), false).map_err(from_exr)?;
    let header = match chunks.headers() {
        [header] => header,
        many => return Err(unsupported(format!("{} layers", many.len()), "give a file of one layer")),
    };
    check_size(header)?;
    check_channels(header, known)?;
    let texts = texts_of(header)?;
    let (pixels, channels) = (header.layer_size.area() as u64, header.channels.list.len() as u64);
    memory::require(4 * pixels * channels)?;
    let image = exr::prelude::read()
        .no_deep_data()
        .largest_resolution_level()
        .all_channels()
        .first_valid_layer()
        .all_attributes()
        .pedantic()
        .from_chunks(chunks)
        .map_err(from_exr)?;
    let layer = image.layer_data;
    let channels = layer.channel_data.list.into_iter().map(|c| (c.name.to_string(), c.sample_data)).collect();
    Ok(ExrFile { width: layer.size.width() as u32, height: layer.size.height() as u32, channels, texts })
}

/// The error for content that this build cannot read.
pub fn unsupported(what: String, remedy: &str) -> Error {
    Error::new(ErrorKind::Unsupported, what, remedy)
}

fn from_exr(e: exr::error::Error) -> Error {
    use exr::error::Error as Exr;
    match e {
        Exr::Io(e) => Error::new(ErrorKind::System, format!("cannot read: {e}"), "see the system's message"),
        Exr::NotSupported(what) => unsupported(format!("EXR feature: {what}"), "write a plain scan-line file"),
        other => Error::invalid(format!("is not a valid EXR file: {other}"), "check the path, or write the file again"),
    }
}

/// Checks everything that determines memory use, before any is allocated.
fn check_size(header: &Header) -> Result<()> {
    let (width, height) = (header.layer_size.width() as u64, header.layer_size.height() as u64);
    let side = 1..=u64::from(limits::MAX_IMAGE_SIDE);
    if header.deep {
        return Err(unsupported("deep data".into(), "write one sample per pixel"));
    }
    // One row of a sensor whose rays are listed may be longer.
    let is_list = height == 1 && (1..=u64::from(limits::MAX_LISTED_RAYS)).contains(&width);
    let is_image = side.contains(&width) && side.contains(&height) && width * height <= limits::MAX_PIXELS;
    if is_list || is_image {
        return Ok(());
    }
    Err(Error::invalid(
        format!("image of {width} x {height} pixels"),
        format!("sides of 1 to {} and at most {} pixels can be read", limits::MAX_IMAGE_SIDE, limits::MAX_PIXELS),
    ))
}

fn check_channels(header: &Header, known: &[KnownChannel]) -> Result<()> {
    let names: Vec<String> = header.channels.list.iter().map(|c| c.name.to_string()).collect();
    let mut has_known = false;
    for (channel, name) in header.channels.list.iter().zip(&names) {
        let Some(KnownChannel { is_id, .. }) = known.iter().find(|k| k.name == *name) else { continue };
        has_known = true;
        let (wanted, word) = if *is_id { (SampleType::U32, "UINT") } else { (SampleType::F32, "FLOAT") };
        if channel.sample_type != wanted || channel.sampling.0 != 1 || channel.sampling.1 != 1 {
            let what = format!("is {:?}, sampled {:?}", channel.sample_type, channel.sampling);
            let wrong = Error::invalid(what, format!("write it as {word}, every pixel"));
            return Err(wrong.at(format!("channel {name:?}")));
        }
    }
    if has_known {
        return Ok(());
    }
    let what = format!("its channels ({}) are unknown", names[..names.len().min(8)].join(", "));
    let wanted: Vec<&str> = known.iter().map(|k| k.name.as_str()).collect();
    Err(Error::invalid(what, wanted.join(", ")).at("channels"))
}

/// The attributes `presight:*`, of a format that this build reads.
fn texts_of(header: &Header) -> Result<Vec<(String, String)>> {
    let mut texts = Vec::new();
    for (name, value) in header.shared_attributes.other.iter().chain(&header.own_attributes.other) {
        let name = name.to_string();
        let Some(name) = name.strip_prefix("presight:") else { continue };
        let wrong = |what, remedy| Error::invalid(what, remedy).at(attribute(name));
        let AttributeValue::Text(text) = value else {
            return Err(wrong("is not text", "write it as a string"));
        };
        let text = std::str::from_utf8(text.as_slice())
            .map_err(|e| wrong("is not UTF-8", "write it as UTF-8").caused_by(e))?;
        if name == "format" {
            check_version(text.parse().ok(), FORMAT, "1").map_err(|e| e.at(attribute(name)))?;
        }
        texts.push((name.to_owned(), text.to_owned()));
    }
    Ok(texts)
}

/// The place of an attribute in messages.
pub fn attribute(name: &str) -> String {
    format!("attribute \"presight:{name}\"")
}

/// A pose as `x,y,z,qx,qy,qz,qw`, each the shortest text that reads back as the same f64.
pub fn pose_to_text(pose: &Pose) -> String {
    pose.to_array().map(|v| format!("{v:?}")).join(",")
}

/// Reads the text of [`pose_to_text`].
///
/// # Errors
/// [`ErrorKind::Invalid`] unless it has seven finite numbers and a rotation.
pub fn pose_from_text(text: &str) -> Result<Pose> {
    let wrong = || Error::invalid(format!("{} is not a valid pose", quoted(text)), "write finite x,y,z,qx,qy,qz,qw");
    let numbers: Vec<f64> = text.split(',').map_while(|word| word.trim().parse().ok()).collect();
    let numbers: [f64; 7] = numbers.try_into().map_err(|_| wrong())?;
    Pose::of_numbers(&numbers).map_err(|_| wrong())
}
