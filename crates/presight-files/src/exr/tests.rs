//! Bit-exact round trips, and errors for broken files.

use super::*;
use glam::DVec3;
use presight_model::error::ErrorKind;
use presight_model::limits;
use presight_render::deadline::{DegradationKind, DegradationStep};
use proptest::prelude::*;

fn images(width: u32, height: u32, outputs: Outputs) -> Images {
    let mut images = Images::default();
    images.prepare(width, height, outputs);
    let odd = [f32::INFINITY, f32::NEG_INFINITY, f32::NAN, -0.0, f32::MIN_POSITIVE / 4.0, f32::MAX, 1.5];
    let mut state = 0x9e37_79b9_u32;
    let mut next = || {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        state
    };
    for image in [&mut images.range, &mut images.depth_z, &mut images.cos_incidence, &mut images.echo] {
        for (i, v) in image.iter_mut().enumerate() {
            *v = if i % 3 == 0 { odd[i / 3 % odd.len()] } else { f32::from_bits(next()) };
        }
    }
    for (i, v) in images.normal.as_flattened_mut().iter_mut().enumerate() {
        *v = if i % 4 == 0 { odd[i / 4 % odd.len()] } else { f32::from_bits(next()) };
    }
    for image in [&mut images.polygon_id, &mut images.object_id] {
        image.iter_mut().for_each(|v| *v = next());
        if let Some(first) = image.first_mut() {
            *first = u32::MAX;
        }
    }
    images
}

fn attributes() -> Attributes {
    Attributes {
        sensor: Some("format = 1\nkind = \"camera\"\n".into()),
        motion: Some(ScanMotion::Twist(presight_model::geometry::Twist::new(DVec3::X, DVec3::Z))),
        pose: Some(SensorPose::from_xyz_rpy(DVec3::new(5_000_000.123_456_789, -0.1, 1e-300), 0.1, 0.2, 3.0)),
        scene: Some("räume/hall.glb".into()),
        scene_blake3: Some("00ff".into()),
        scene_content: Some("ff00".into()),
        ids: Some(IdScheme::Source),
        raster: Some(Raster::Render),
        given_up: Some(Degradation {
            complete_to: 3.25,
            samples: 7,
            means: vec![DegradationStep { means: DegradationKind::Clock, at_ms: 1.5, metres: Some(3.25) }],
            ..Degradation::default()
        }),
        objects: (1..=12).map(|i| (i, format!("Tür \"{i}\""))).collect(),
    }
}

fn bits(images: &Images) -> Vec<u32> {
    let floats = [&images.range, &images.depth_z, &images.cos_incidence, &images.echo];
    let ids = [&images.polygon_id, &images.object_id];
    floats
        .into_iter()
        .flatten()
        .chain(images.normal.as_flattened())
        .map(|v| v.to_bits())
        .chain(ids.into_iter().flatten().copied())
        .collect()
}

fn write_and_read(images: &Images, attributes: &Attributes) -> ImageFile {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.exr");
    write(&path, images, Outputs::ALL, attributes).unwrap();
    read(&path).unwrap()
}

#[test]
fn every_bit_round_trips() {
    for (w, h) in [(1, 1), (7, 3), (3, 70), (361, 1)] {
        for outputs in [Outputs::ALL, Outputs::default(), Outputs::of(&[Output::ObjectId])] {
            let before = images(w, h, outputs);
            let after = write_and_read(&before, &attributes());
            assert_eq!((after.images.width, after.images.height), (w, h));
            assert_eq!(after.images.outputs(), outputs);
            assert_eq!(bits(&after.images), bits(&before));
            assert_eq!(after.attributes, attributes());
        }
    }
}

#[test]
fn a_swapped_row_is_noticed() {
    let before = images(7, 3, Outputs::ALL);
    let mut after = write_and_read(&before, &attributes()).images;
    after.range.swap(0, 7);
    assert_ne!(bits(&after), bits(&before));
}

#[test]
fn the_same_images_give_the_same_bytes() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.exr");
    let bytes: Vec<Vec<u8>> = (0..8)
        .map(|_| {
            write(&path, &images(20, 9, Outputs::ALL), Outputs::ALL, &attributes()).unwrap();
            std::fs::read(&path).unwrap()
        })
        .collect();
    assert!(bytes.iter().all(|b| *b == bytes[0]));
}

fn error_of(path: &Path) -> Error {
    read(path).unwrap_err()
}

#[test]
fn missing_and_foreign_files_are_the_files_fault() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.exr");
    assert_eq!(error_of(&path).kind(), ErrorKind::Invalid);
    std::fs::write(&path, b"PNG, not EXR").unwrap();
    assert_eq!(error_of(&path).kind(), ErrorKind::Invalid);
    let folder_error = error_of(folder.path());
    assert_eq!(folder_error.kind(), ErrorKind::Invalid, "{folder_error}");
}

#[test]
fn a_newer_format_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.exr");
    write(&path, &images(2, 2, Outputs::ALL), Outputs::ALL, &Attributes::default()).unwrap();
    let mut bytes = std::fs::read(&path).unwrap();
    let at = bytes.windows(15).position(|w| w == b"presight:format").unwrap();
    let value = at + 15 + 1 + "string\0".len() + 4;
    assert_eq!(bytes[value], b'1');
    bytes[value] = b'2';
    std::fs::write(&path, bytes).unwrap();
    let e = error_of(&path);
    assert_eq!((e.kind(), e.place()), (ErrorKind::Unsupported, Some("attribute \"presight:format\"")));
}

/// The channels of a file, and the text of an attribute.
fn header_of(path: &Path, attribute: &str) -> (Vec<String>, Option<String>) {
    let image = ::exr::prelude::read_all_flat_layers_from_file(path).unwrap();
    let layer = &image.layer_data[0];
    let names = layer.channel_data.list.iter().map(|c| c.name.to_string()).collect();
    let text = layer.attributes.other.get(&Text::from(attribute)).map(|value| match value {
        AttributeValue::Text(text) => text.to_string(),
        other => panic!("{other:?}"),
    });
    (names, text)
}

#[test]
fn vectors_are_three_channels_and_say_their_frame() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.exr");
    let images = images(4, 3, Outputs::of(&[Output::Normal, Output::ObjectId]));
    write(&path, &images, Outputs::ALL, &Attributes::default()).unwrap();
    let (channels, frame) = header_of(&path, "presight:normal_frame");
    assert_eq!(channels, ["normal.x", "normal.y", "normal.z", "object_id"]);
    assert_eq!(frame.as_deref(), Some("body"));
    // Vectors in another frame are refused.
    let mut bytes = std::fs::read(&path).unwrap();
    let at = bytes.windows(21).position(|w| w == b"presight:normal_frame").unwrap();
    let value = at + 21 + 1 + "string\0".len() + 4;
    bytes[value..value + 4].copy_from_slice(b"rear");
    std::fs::write(&path, bytes).unwrap();
    let e = error_of(&path);
    assert_eq!((e.kind(), e.place()), (ErrorKind::Unsupported, Some("attribute \"presight:normal_frame\"")));
    // A file without vectors has no such attribute.
    write(&path, &images, Outputs::of(&[Output::ObjectId]), &Attributes::default()).unwrap();
    assert_eq!(header_of(&path, "presight:normal_frame"), (vec!["object_id".to_owned()], None));
    // A vector with two components is refused.
    let two = vec![("normal.x", FlatSamples::F32(vec![1.0; 6])), ("normal.z", FlatSamples::F32(vec![0.0; 6]))];
    write_foreign(&path, two, (3, 2));
    assert_eq!(error_of(&path).place(), Some("channel \"normal.x\""));
}

/// Writes channels of any type under any name, as foreign programs may.
fn write_foreign(path: &Path, channels: Vec<(&str, FlatSamples)>, size: (usize, usize)) {
    let list = channels.into_iter().map(|(name, samples)| AnyChannel::new(name, samples)).collect();
    Image::from_channels(size, AnyChannels::sort(list)).write().to_file(path).unwrap();
}

#[test]
fn wrong_channels_are_named() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.exr");
    write_foreign(&path, vec![("range", FlatSamples::U32(vec![1; 6]))], (3, 2));
    assert_eq!(error_of(&path).place(), Some("channel \"range\""));
    write_foreign(&path, vec![("polygon_id", FlatSamples::F32(vec![1.0; 6]))], (3, 2));
    assert_eq!(error_of(&path).place(), Some("channel \"polygon_id\""));
    write_foreign(&path, vec![("R", FlatSamples::F32(vec![1.0; 6]))], (3, 2));
    assert_eq!(error_of(&path).place(), Some("channels"));
    let both = vec![("R", FlatSamples::F32(vec![1.0; 6])), ("range", FlatSamples::F32(vec![2.0; 6]))];
    write_foreign(&path, both, (3, 2));
    let file = read(&path).unwrap();
    assert_eq!((file.ignored, file.images.range), (vec!["R".to_owned()], vec![2.0; 6]));
    let wide = limits::MAX_IMAGE_SIDE as usize + 1;
    write_foreign(&path, vec![("range", FlatSamples::F32(vec![1.0; 2 * wide]))], (wide, 2));
    assert_eq!(error_of(&path).kind(), ErrorKind::Invalid);
    // A row of listed rays.
    write_foreign(&path, vec![("range", FlatSamples::F32(vec![1.0; wide]))], (wide, 1));
    assert_eq!(read(&path).unwrap().images.range, vec![1.0; wide]);
    let longest = limits::MAX_LISTED_RAYS as usize;
    write_foreign(&path, vec![("range", FlatSamples::F32(vec![1.0; longest + 1]))], (longest + 1, 1));
    assert_eq!(error_of(&path).kind(), ErrorKind::Invalid);
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(300))]
    /// Truncated or bit-flipped files give an error or an image of valid size, never a panic.
    #[test]
    fn broken_files_never_panic(cut in 0.0..1.0f64, flips in prop::collection::vec((0.0..1.0f64, 0u8..8), 0..4)) {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.exr");
        write(&path, &images(9, 5, Outputs::ALL), Outputs::ALL, &attributes()).unwrap();
        let whole = std::fs::read(&path).unwrap();
        let truncated = &whole[..(cut * whole.len() as f64) as usize];
        std::fs::write(&path, truncated).unwrap();
        prop_assert!(read(&path).is_err());
        let mut flipped = whole.clone();
        for (at, bit) in flips {
            flipped[(at * whole.len() as f64) as usize] ^= 1 << bit;
        }
        std::fs::write(&path, flipped).unwrap();
        if let Ok(file) = read(&path) {
            prop_assert!(file.images.pixels() as u64 <= limits::MAX_PIXELS);
        }
    }
}
