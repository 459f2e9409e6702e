//! Scenes from memory: the same world as from the file, and clear errors for everything else.

use presight::{ErrorKind, Scene, SceneOptions};
use std::path::Path;

fn open(name: &str, bytes: &[u8]) -> presight::Result<Scene> {
    Scene::from_bytes(name, bytes, &SceneOptions::default())
}

fn file(name: &str) -> Vec<u8> {
    std::fs::read(Path::new(env!("CARGO_MANIFEST_DIR")).join("scenes").join(name)).unwrap()
}

/// The GLB's two chunks as a .gltf with the buffer embedded, or in a file of this name.
fn as_gltf(glb: &[u8], buffer: Option<&str>) -> Vec<u8> {
    let size = u32::from_le_bytes(glb[12..16].try_into().unwrap()) as usize;
    let mut json: serde_json::Value = serde_json::from_slice(&glb[20..20 + size]).unwrap();
    let uri = match buffer {
        Some(name) => name.to_owned(),
        None => format!("data:application/octet-stream;base64,{}", base64(&glb[20 + size + 8..])),
    };
    json["buffers"][0]["uri"] = uri.into();
    json.to_string().into_bytes()
}

fn base64(bytes: &[u8]) -> String {
    const LETTERS: &[u8; 64] = b"ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
    let mut text = String::new();
    for three in bytes.chunks(3) {
        let word = three.iter().enumerate().fold(0u32, |word, (i, byte)| word | u32::from(*byte) << (16 - 8 * i));
        (0..=three.len()).for_each(|i| text.push(LETTERS[(word >> (18 - 6 * i) & 63) as usize].into()));
    }
    text
}

#[test]
fn a_scene_from_memory_is_the_scene_of_the_file() {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("scenes/room.glb");
    let opened = Scene::open(path).unwrap();
    let glb = file("room.glb");
    for (name, bytes) in [("room.glb", glb.clone()), ("room", glb.clone()), ("room.gltf", as_gltf(&glb, None))] {
        let scene = open(name, &bytes).unwrap();
        assert_eq!(scene.path, Path::new(name));
        assert_eq!(scene.world.environment().content_hash(), opened.world.environment().content_hash(), "{name}");
        assert_eq!((scene.frame, &scene.report), (opened.frame, &opened.report), "{name}");
        assert_eq!(scene.world_from_gltf, opened.world_from_gltf, "{name}");
    }
}

#[test]
fn files_of_a_scene_in_memory_are_refused_with_a_remedy() {
    let e = open("room.gltf", &as_gltf(&file("room.glb"), Some("room.bin"))).unwrap_err();
    assert_eq!(
        (e.kind(), e.file(), e.place()),
        (ErrorKind::Unsupported, Some(Path::new("room.gltf")), Some("buffer 0"))
    );
    assert!(e.what().contains("room.bin") && e.remedy().contains(".glb"), "{e}");
    for (name, bytes) in [("hall.presight", &b"anything"[..]), ("hall", b"SQLite format 3\0 and pages")] {
        let e = open(name, bytes).unwrap_err();
        assert_eq!((e.kind(), e.file()), (ErrorKind::Unsupported, Some(Path::new(name))));
        assert!(e.remedy().contains("file"), "{e}");
    }
    assert_eq!(open("chair.stl", b"solid chair").unwrap_err().kind(), ErrorKind::Unsupported);
}

/// Every eighth cut, and 2000 changed bytes, most of them in the JSON text.
#[test]
fn broken_bytes_are_typed_errors() {
    let glb = file("room.glb");
    let refused = |bytes: &[u8]| match open("junk.glb", bytes) {
        Ok(_) => false,
        Err(e) => {
            assert!(matches!(e.kind(), ErrorKind::Invalid | ErrorKind::Unsupported), "{e}");
            assert!(e.file() == Some(Path::new("junk.glb")) && !e.remedy().is_empty(), "{e}");
            true
        }
    };
    for end in (0..glb.len()).step_by(8.max(glb.len() / 400)) {
        assert!(refused(&glb[..end]), "cut at {end}");
    }
    let mut random = presight_testkit::Random(1995);
    let mut all = 0;
    for _ in 0..2000 {
        let mut bytes = glb.clone();
        let at = random.bits() as usize % if random.bits().is_multiple_of(4) { bytes.len() } else { 4000 };
        bytes[at] = random.bits() as u8;
        all += usize::from(refused(&bytes));
    }
    assert!(all > 200, "{all} refused");
    for junk in [&b""[..], b"\0", b"glTF", b"{}", b"[]", b"{\"asset\":", b"\x89PNG\r\n\x1a\n", &[0xff; 64]] {
        assert!(refused(junk), "{junk:?}");
    }
}

#[cfg(feature = "script")]
#[test]
fn a_script_from_memory_builds_its_scene_but_reads_no_files() {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("scenes/pole.rhai");
    let (opened, scene) = (Scene::open(path).unwrap(), open("pole.rhai", &file("pole.rhai")).unwrap());
    assert_eq!(scene.world.environment().content_hash(), opened.world.environment().content_hash());
    let scripts = [
        (&b"place(\"room\", import_gltf(\"room.glb\"));"[..], "room.glb"),
        (b"import \"parts/table\" as parts;", "parts/table"),
        (b"place(", ""),
        (b"\xff\xfe", "UTF-8"),
    ];
    for (text, named) in scripts {
        let e = open("junk.rhai", text).unwrap_err();
        assert_eq!((e.kind(), e.file()), (ErrorKind::Invalid, Some(Path::new("junk.rhai"))), "{e}");
        assert!(e.to_string().contains(named) && !e.remedy().is_empty(), "{e}");
    }
}
