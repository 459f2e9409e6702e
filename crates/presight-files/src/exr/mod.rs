//! Lossless OpenEXR images of a prediction: floats as FLOAT, ids as UINT, vectors as three FLOAT channels. Text
//! attributes `presight:*` hold sensor, pose and scene.

mod motion;

use ::exr::image::{AnyChannel, AnyChannels, Blocks, Encoding, FlatSamples, Image, Layer};
use ::exr::meta::attribute::{AttributeValue, LineOrder, Text};
use ::exr::meta::header::LayerAttributes;
use ::exr::prelude::{Compression, WritableImage};
use presight_model::error::{Error, Result};
use presight_model::geometry::SensorPose;
use presight_model::measured::ScanMotion;
use presight_model::memory;
use presight_model::printable::quoted;
use presight_read::atomic::write_atomically;
use presight_read::exr::{KnownChannel, attribute, pose_from_text, pose_to_text, unsupported};
use presight_read::text::FORMAT;
use presight_render::deadline::Degradation;
use presight_render::plan::{IdScheme, Images, Output, Outputs, Raster, SampleKind, Samples, SamplesMut};
use std::collections::BTreeMap;
use std::fs::File;
use std::io::{self, BufRead, BufReader, BufWriter, Read, Seek, SeekFrom, Write};
use std::path::Path;

/// Origin of the images in a file. Files of other programs may lack any field.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Attributes {
    /// The sensor as sensor TOML.
    pub sensor: Option<String>,
    /// The sensor's pose, body axes. The file keeps every bit.
    pub pose: Option<SensorPose>,
    /// How the robot moved during the scan, relative to its pose at the stamp; `None` if it stood. The file keeps every
    /// bit.
    pub motion: Option<ScanMotion>,
    /// The scene's path, as given.
    pub scene: Option<String>,
    /// BLAKE3 of the scene file, hexadecimal.
    pub scene_blake3: Option<String>,
    /// Hash of the scene's content as it was opened ([`presight_model::environment::Environment::content_hash`]),
    /// hexadecimal. It is equal for a store and for the file from which the store was made.
    pub scene_content: Option<String>,
    /// Which numbering `polygon_id` uses.
    pub ids: Option<IdScheme>,
    /// Work dropped to meet a deadline. If set, a pixel that is NaN with id 0 was dropped or has no ray.
    pub given_up: Option<Degradation>,
    /// The rasterizer, if a GPU made the images.
    pub raster: Option<Raster>,
    /// Object names by `object_id`.
    pub objects: BTreeMap<u32, String>,
}

/// The content of an EXR file.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ImageFile {
    /// The images whose channel names presight knows.
    pub images: Images,
    /// Their origin.
    pub attributes: Attributes,
    /// Names of channels that are not images of presight.
    pub ignored: Vec<String>,
}

/// Writes the images of `outputs` that exist. The same images and attributes give the same bytes.
///
/// ```
/// use presight::files::{ExrAttributes, read_exr, write_exr};
/// use presight::{Images, Output, Outputs};
/// let mut images = Images::default();
/// images.prepare(3, 2, Outputs::of(&[Output::Range, Output::PolygonId]));
/// images.range[4] = f32::INFINITY;
/// let folder = tempfile::tempdir()?;
/// let path = folder.path().join("a.exr");
/// write_exr(&path, &images, Outputs::ALL, &ExrAttributes::default())?;
/// assert_eq!(read_exr(&path)?.images, images);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
///
/// # Errors
/// [`presight_model::ErrorKind::System`] if the file cannot be written; no partial file is left.
/// [`presight_model::ErrorKind::Invalid`] if there is no image.
pub fn write(path: &Path, images: &Images, outputs: Outputs, attributes: &Attributes) -> Result<()> {
    let mut channels = Vec::new();
    for output in outputs.iter() {
        let planes = match images.samples(output) {
            Some(Samples::Floats(image)) => vec![FlatSamples::F32(collected(image.iter().copied())?)],
            Some(Samples::Ids(image)) => vec![FlatSamples::U32(collected(image.iter().copied())?)],
            Some(Samples::Vectors(image)) => {
                let plane = |axis: usize| collected(image.iter().map(|v| v[axis])).map(FlatSamples::F32);
                vec![plane(0)?, plane(1)?, plane(2)?]
            }
            None => Vec::new(),
        };
        let named = output.channels().into_iter().zip(planes);
        channels.extend(named.map(|(name, samples)| AnyChannel::new(name.as_str(), samples)));
    }
    if channels.is_empty() {
        return Err(Error::invalid("there is no image to write", "request an output").in_file(path));
    }
    let mut layer = LayerAttributes::default();
    let frames = outputs.iter().filter(|o| images.samples(*o).is_some()).filter_map(frame_attribute);
    for (name, value) in to_texts(attributes).into_iter().chain(frames) {
        let value = AttributeValue::Text(Text::from_slice_unchecked(value.as_bytes()));
        layer.other.insert(Text::from(format!("presight:{name}").as_str()), value);
    }
    // Measured with four 1280 x 200 outputs of a hospital on two busy cores: uncompressed 5 ms and 4.1 MB, RLE 10 ms
    // and 3.5 MB (a tenth for a simple room), ZIP 40 to 320 ms and 1.4 MB. ZIP takes longer than the prediction.
    let encoding =
        Encoding { compression: Compression::RLE, blocks: Blocks::ScanLines, line_order: LineOrder::Increasing };
    let size = (images.width as usize, images.height as usize);
    let image = Image::from_layer(Layer::new(size, layer, encoding, AnyChannels::sort(channels.into())));
    write_atomically(path, |file| {
        image.write().to_buffered(BufWriter::new(&mut *file)).map_err(to_io)?;
        sort_header(file)
    })
}

fn collected<T>(samples: impl ExactSizeIterator<Item = T>) -> Result<Vec<T>> {
    let mut plane = memory::reserved(samples.len())?;
    plane.extend(samples);
    Ok(plane)
}

/// Name and value of the attribute with the frame of vectors.
fn frame_attribute(output: Output) -> Option<(String, String)> {
    let info = output.info();
    info.frame.map(|frame| (format!("{}_frame", info.name), frame.to_owned()))
}

fn to_io(e: ::exr::error::Error) -> io::Error {
    match e {
        ::exr::error::Error::Io(e) => e,
        other => io::Error::other(other),
    }
}

fn to_texts(attributes: &Attributes) -> Vec<(String, String)> {
    let mut texts = vec![("format", FORMAT.to_string())];
    texts.extend(attributes.sensor.clone().map(|t| ("sensor", t)));
    texts.extend(attributes.pose.map(|p| ("world_from_sensor", pose_to_text(&p.world_from_sensor()))));
    texts.extend(attributes.motion.as_ref().map(|motion| ("motion", motion::to_text(motion))));
    texts.extend(attributes.scene.clone().map(|t| ("scene", t)));
    texts.extend(attributes.scene_blake3.clone().map(|t| ("scene_blake3", t)));
    texts.extend(attributes.scene_content.clone().map(|t| ("scene_content", t)));
    texts.extend(attributes.ids.map(|ids| ("ids", if ids == IdScheme::Model { "model" } else { "source" }.into())));
    texts.extend(attributes.raster.map(|raster| ("raster", raster.name().into())));
    texts.extend(attributes.given_up.iter().flat_map(serde_json::to_string).map(|text| ("given_up", text)));
    // A map of numbers to strings always serializes.
    texts.push(("objects", serde_json::to_string(&attributes.objects).unwrap_or_default()));
    texts.into_iter().map(|(name, text)| (name.to_owned(), text)).collect()
}

/// Sorts the attributes of the written header in place. The exr crate keeps free attributes in a hash map, so their
/// order would otherwise change from run to run.
fn sort_header(file: &mut File) -> io::Result<()> {
    const MAGIC_AND_VERSION: u64 = 8;
    file.seek(SeekFrom::Start(MAGIC_AND_VERSION))?;
    let mut reader = BufReader::new(&mut *file);
    let mut attributes = Vec::new();
    loop {
        let mut bytes = Vec::new();
        reader.read_until(0, &mut bytes)?;
        if bytes.len() <= 1 {
            break;
        }
        let name = bytes.clone();
        reader.read_until(0, &mut bytes)?;
        let mut size = [0; 4];
        reader.read_exact(&mut size)?;
        bytes.extend(size);
        let start = bytes.len();
        bytes.resize(start + u32::from_le_bytes(size) as usize, 0);
        reader.read_exact(&mut bytes[start..])?;
        attributes.push((name, bytes));
    }
    attributes.sort();
    file.seek(SeekFrom::Start(MAGIC_AND_VERSION))?;
    let sorted: Vec<u8> = attributes.into_iter().flat_map(|(_, bytes)| bytes).collect();
    file.write_all(&sorted)
}

/// Reads the attributes, and the images whose channel names presight knows.
///
/// # Errors
/// [`presight_model::ErrorKind::Invalid`] or [`presight_model::ErrorKind::Unsupported`], naming the channel or
/// attribute, for a file that is missing, truncated or not EXR, has deep data, several layers or sides beyond the
/// limits, a channel that is subsampled or of the wrong type, or attributes of a newer format.
/// [`presight_model::ErrorKind::System`] if the system refuses.
pub fn read(path: &Path) -> Result<ImageFile> {
    read_unnamed(path).map_err(|e| e.in_file(path))
}

fn read_unnamed(path: &Path) -> Result<ImageFile> {
    let file = presight_read::exr::read(path, &known_channels())?;
    let mut attributes = Attributes::default();
    for (name, text) in &file.texts {
        attributes.take(name, text).map_err(|e| e.at(attribute(name)))?;
    }
    check_vectors(&file.channels)?;
    let mut images = Images { width: file.width, height: file.height, ..Images::default() };
    let mut ignored = Vec::new();
    for (name, samples) in file.channels {
        match of_channel(&name) {
            Some((output, axis)) => keep(&mut images, output, axis, samples)?,
            None => ignored.push(name),
        }
    }
    Ok(ImageFile { images, attributes, ignored })
}

fn known_channels() -> Vec<KnownChannel> {
    let of = |output: Output| {
        let is_id = matches!(output.info().kind, SampleKind::Id);
        output.channels().into_iter().map(move |name| KnownChannel { name, is_id })
    };
    Output::WITH_FEATURES.into_iter().flat_map(of).collect()
}

/// The output of a channel, and the component that it holds.
fn of_channel(name: &str) -> Option<(Output, usize)> {
    let mut outputs = Output::WITH_FEATURES.into_iter();
    outputs.find_map(|o| o.channels().iter().position(|channel| channel == name).map(|axis| (o, axis)))
}

/// Refuses a vector that lacks a component.
fn check_vectors(channels: &[(String, FlatSamples)]) -> Result<()> {
    for (name, _) in channels {
        let Some((output, _)) = of_channel(name) else { continue };
        let is_there = |wanted: &String| channels.iter().any(|(name, _)| name == wanted);
        if let Some(missing) = output.channels().into_iter().find(|wanted| !is_there(wanted)) {
            let what = format!("lacks the channel {missing:?} of the same vector");
            return Err(Error::invalid(what, "write all components of a vector").at(format!("channel {name:?}")));
        }
    }
    Ok(())
}

fn keep(images: &mut Images, output: Output, axis: usize, samples: FlatSamples) -> Result<()> {
    match (images.samples_mut(output), samples) {
        (SamplesMut::Floats(image), FlatSamples::F32(plane)) => *image = plane,
        (SamplesMut::Ids(image), FlatSamples::U32(plane)) => *image = plane,
        (SamplesMut::Vectors(image), FlatSamples::F32(plane)) => {
            memory::reserve(image, plane.len())?;
            image.resize(plane.len(), [f32::NAN; 3]);
            image.iter_mut().zip(plane).for_each(|(v, component)| v[axis] = component);
        }
        _ => {
            let remedy = "write floats as FLOAT and ids as UINT";
            return Err(Error::invalid("has the wrong type", remedy).at(format!("channel {:?}", output.name())));
        }
    }
    Ok(())
}

impl Attributes {
    fn take(&mut self, name: &str, text: &str) -> Result<()> {
        match name {
            "format" => {}
            "sensor" => self.sensor = Some(text.to_owned()),
            "world_from_sensor" => self.pose = Some(SensorPose::new(pose_from_text(text)?)),
            "motion" => self.motion = Some(motion::from_text(text)?),
            "scene" => self.scene = Some(text.to_owned()),
            "scene_blake3" => self.scene_blake3 = Some(text.to_owned()),
            "scene_content" => self.scene_content = Some(text.to_owned()),
            "ids" => {
                self.ids = Some(match text {
                    "model" => IdScheme::Model,
                    "source" => IdScheme::Source,
                    _ => return Err(Error::invalid(format!("is {}", quoted(text)), "write model or source")),
                });
            }
            "raster" => {
                let known = [Raster::Compute, Raster::Render].into_iter().find(|raster| raster.name() == text);
                let wrong = || Error::invalid(format!("is {}", quoted(text)), "write compute or render");
                self.raster = Some(known.ok_or_else(wrong)?);
            }
            "given_up" => {
                let wrong = |e| Error::invalid(format!("is not a valid list of dropped work: {e}"), "predict again");
                self.given_up = Some(serde_json::from_str(text).map_err(wrong)?);
            }
            "objects" => {
                self.objects = serde_json::from_str(text).map_err(|e| {
                    Error::invalid(format!("is not a map of ids to names: {e}"), "write {\"1\": \"name\"}")
                })?;
            }
            _ => check_frame(name, text)?,
        }
        Ok(())
    }
}

/// Refuses vectors in a frame other than the output's own.
fn check_frame(name: &str, text: &str) -> Result<()> {
    let known = Output::WITH_FEATURES.into_iter().filter_map(frame_attribute).find(|(attribute, _)| attribute == name);
    match known {
        Some((_, frame)) if frame != text => {
            Err(unsupported(format!("is {}", quoted(text)), "write vectors in the sensor's body frame"))
        }
        _ => Ok(()),
    }
}

#[cfg(test)]
mod tests;
