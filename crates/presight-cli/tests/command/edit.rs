//! `presight edit`: its address and errors, and the page in a browser.

use super::Place;
use presight_testkit::skip::skip;
use std::io::{BufRead, BufReader, Read, Write};
use std::net::TcpStream;
use std::path::Path;
use std::process::{Command, Stdio};

/// The program, if it runs.
fn found(program: &str) -> bool {
    let run = Command::new(program).arg("--version").stdout(Stdio::null()).stderr(Stdio::null()).status();
    run.is_ok_and(|status| status.success())
}

#[test]
fn the_page_does_in_a_browser_what_it_should() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../presight-editor/tests/browser");
    let chromium = ["chromium", "chromium-browser", "google-chrome"].into_iter().find(|name| found(name));
    let Some(chromium) = chromium.filter(|_| found("node")) else {
        return skip("there is no Node or no Chromium: apt-get install nodejs npm chromium");
    };
    if !folder.join("node_modules/playwright-core").exists() {
        return skip("playwright-core is missing: npm ci --prefix crates/presight-editor/tests/browser");
    }
    let path = std::env::split_paths(&std::env::var_os("PATH").unwrap_or_default())
        .map(|folder| folder.join(chromium))
        .find(|path| path.exists());
    let done = Command::new("node")
        .arg("--test")
        .current_dir(&folder)
        .env("PRESIGHT", assert_cmd::cargo::cargo_bin("presight"))
        .env("CHROMIUM", path.unwrap())
        .output()
        .unwrap();
    assert!(
        done.status.success(),
        "{}{}",
        String::from_utf8_lossy(&done.stdout),
        String::from_utf8_lossy(&done.stderr)
    );
}

#[test]
fn the_address_is_printed_and_the_page_is_there() {
    let place = Place::new();
    let mut editor = Command::new(assert_cmd::cargo::cargo_bin("presight"))
        .args(["edit", "wall.glb", "--sensor", "video-camera", "--no-open", "--backend", "cpu"])
        .current_dir(place.path(""))
        .stdout(Stdio::piped())
        .spawn()
        .unwrap();
    let mut line = String::new();
    BufReader::new(editor.stdout.take().unwrap()).read_line(&mut line).unwrap();
    let (host, token) = line.trim().strip_prefix("http://").unwrap().split_once("/#").unwrap();
    assert_eq!(token.len(), 32);
    let mut socket = TcpStream::connect(host).unwrap();
    write!(socket, "GET / HTTP/1.1\r\nHost: {host}\r\nConnection: close\r\n\r\n").unwrap();
    let mut page = String::new();
    socket.read_to_string(&mut page).unwrap();
    editor.kill().unwrap();
    editor.wait().unwrap();
    assert!(page.starts_with("HTTP/1.1 200") && page.contains("<title>presight edit</title>"), "{page}");
}

#[test]
fn wrong_arguments_of_the_editor_are_errors_of_one_line() {
    let place = Place::new();
    place.write("radar.layer.json", br#"{"format": 1, "class": "radar", "features": []}"#);
    let edit = |rest: &str| place.run(&format!("edit wall.glb --sensor video-camera --no-open {rest}"));
    for (rest, status, said) in [
        ("--layer none.layer.json", 1, "none.layer.json: cannot "),
        ("--layer radar.layer.json", 2, "the layer has class \"radar\", the sensor has class \"video\""),
        ("--pose 1,2,3", 2, "--pose 1,2,3: 3 numbers"),
        ("--port 99999", 2, "99999"),
    ] {
        let outcome = edit(rest);
        assert_eq!(outcome.status, Some(status), "{rest}: {}", outcome.stderr);
        assert!(outcome.stderr.contains(said) && outcome.stderr.lines().count() == 1, "{rest}: {}", outcome.stderr);
    }
    let taken = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
    let outcome = edit(&format!("--port {}", taken.local_addr().unwrap().port()));
    assert!(outcome.status == Some(4) && outcome.stderr.contains("--port"), "{}", outcome.stderr);
}
