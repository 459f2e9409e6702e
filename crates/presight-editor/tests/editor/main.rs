//! The session without a network, and the server on a socket.

mod http;
mod session;

use presight::{Backend, Options, Scene};
use presight_editor::{Answer, Session, SessionOptions};
use serde_json::Value;
use std::path::{Path, PathBuf};

/// A pose in the room from which shelf, table and door are seen.
const POSE: [f64; 6] = [0.3, 0.35, 1.65, 0.0, 12.0, 38.0];

fn scene(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../../scenes").join(name)
}

fn session_of(scene: &Path, layer: Option<&Path>, folder: &Path) -> presight::Result<Session> {
    session_with("video-camera", scene, layer, folder)
}

fn session_with(sensor: &str, scene: &Path, layer: Option<&Path>, folder: &Path) -> presight::Result<Session> {
    let mut options = SessionOptions::default();
    options.layer = layer.map(Path::to_owned);
    options.folder = folder.to_owned();
    options.engine = Options::new(Backend::Cpu).with_threads(1);
    let (sensor, _) = presight::files::load_sensor(sensor)?;
    Session::open(Scene::open(scene)?, sensor, options)
}

/// The JSON of an answer, and the bytes after it.
fn parts(answer: Answer) -> (Value, Vec<u8>) {
    match answer {
        Answer::Json(text) => (serde_json::from_str(&text).unwrap(), Vec::new()),
        Answer::Binary(bytes) => {
            let length = u32::from_le_bytes(bytes[..4].try_into().unwrap()) as usize;
            let rest = bytes[(4 + length).next_multiple_of(4)..].to_vec();
            (serde_json::from_slice(&bytes[4..4 + length]).unwrap(), rest)
        }
        other => panic!("{other:?}"),
    }
}

fn ask(session: &mut Session, name: &str, body: Value) -> Value {
    parts(session.answer(name, body.to_string().as_bytes())).0
}

/// A request with the version that the session has.
fn step(session: &mut Session, name: &str, mut body: Value) -> Value {
    body["version"] = ask(session, "state", Value::Null)["version"].clone();
    ask(session, name, body)
}

fn refusal(session: &mut Session, name: &str, body: &str) -> String {
    match session.answer(name, body.as_bytes()) {
        Answer::Wrong(e) => {
            assert!(!e.remedy().is_empty(), "{e}");
            e.to_string()
        }
        other => panic!("{name} {body}: {other:?}"),
    }
}
