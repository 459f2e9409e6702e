//! The server refuses strangers, and withstands slow, large and many clients.

use super::{POSE, scene, session_of};
use presight_editor::http::{MAX_BODY, Server};
use serde_json::json;
use std::io::{Read, Write};
use std::net::TcpStream;
use std::time::{Duration, Instant};

/// Serves the room from a thread that ends with the process; returns address and token.
fn serve() -> (String, String) {
    let server = Server::listen(0).unwrap();
    let address = server.address();
    let (host, token) = address.strip_prefix("http://").unwrap().split_once("/#").unwrap();
    let folder = tempfile::tempdir().unwrap().keep();
    std::thread::spawn(move || {
        let session = session_of(&scene("room.glb"), None, &folder).unwrap();
        server.serve(session).unwrap();
    });
    (host.to_owned(), token.to_owned())
}

/// Sends bytes and returns the status, or 0 if the connection ends without one, and the whole answer.
fn send(host: &str, bytes: &[u8]) -> (u16, String) {
    let mut socket = TcpStream::connect(host).unwrap();
    socket.set_read_timeout(Some(Duration::from_secs(30))).unwrap();
    // The server may have answered and closed before everything was sent.
    let _ = socket.write_all(bytes);
    let mut answer = Vec::new();
    let _ = socket.read_to_end(&mut answer);
    let text = String::from_utf8_lossy(&answer).into_owned();
    let status = text.split(' ').nth(1).and_then(|word| word.parse().ok()).unwrap_or(0);
    (status, text)
}

fn post(path: &str, headers: &[(&str, &str)], body: &str) -> Vec<u8> {
    let lines: String = headers.iter().map(|(name, value)| format!("{name}: {value}\r\n")).collect();
    let head = format!("POST {path} HTTP/1.1\r\nConnection: close\r\nContent-Length: {}\r\n{lines}\r\n", body.len());
    format!("{head}{body}").into_bytes()
}

#[test]
fn only_the_page_gets_answers() {
    let (host, token) = serve();
    let token = ("X-Presight-Token", token.as_str());
    let here = ("Host", host.as_str());
    let local = format!("http://{host}");
    let own = ("Origin", local.as_str());
    for headers in [&[here, token][..], &[here, own, token], &[("Host", "localhost:1"), token]] {
        let (status, text) = send(&host, &post("/state", headers, "{}"));
        assert_eq!(status, 200, "{headers:?}");
        assert!(text.contains("\"version\":1") && text.contains("content-security-policy: default-src 'self'"));
        assert!(!text.to_lowercase().contains("access-control"));
    }
    // A page of another origin, a name that was made to point here, no token, a wrong one, one in the query.
    let evil = ("Origin", "http://evil.test");
    let long = "a".repeat(32);
    let refused: [&[(&str, &str)]; 7] = [
        &[here, evil, token],
        &[here, ("Origin", "null"), token],
        &[("Host", "evil.test"), token],
        &[token],
        &[here],
        &[here, ("X-Presight-Token", "")],
        &[here, ("X-Presight-Token", &long)],
    ];
    for headers in refused {
        let (status, text) = send(&host, &post("/state", headers, "{}"));
        let body = text.split("\r\n\r\n").nth(1).unwrap_or_default();
        // HTTP itself demands a host.
        assert!((status == 403 || status == 400) && body.is_empty(), "{headers:?}: {text}");
    }
    assert_eq!(send(&host, &post(&format!("/state?token={}", token.1), &[here], "{}")).0, 403);
    let preflight = format!(
        "OPTIONS /state HTTP/1.1\r\nHost: {host}\r\nConnection: close\r\n{}: POST\r\n\r\n",
        "Access-Control-Request-Method"
    );
    let (status, text) = send(&host, preflight.as_bytes());
    assert!(status == 405 && !text.to_lowercase().contains("access-control-allow"), "{text}");
    let get =
        |path: &str, host_line: &str| format!("GET {path} HTTP/1.1\r\nHost: {host_line}\r\nConnection: close\r\n\r\n");
    let (status, page) = send(&host, get("/", &host).as_bytes());
    assert!(status == 200 && !page.contains("room") && !page.contains(token.1));
    assert_eq!(send(&host, get("/", "evil.test").as_bytes()).0, 403);
    assert_eq!(send(&host, get("/state", &host).as_bytes()).0, 404);
    assert_eq!(send(&host, get("/../Cargo.toml", &host).as_bytes()).0, 404);
}

#[test]
fn bad_clients_are_refused_and_the_page_goes_on() {
    let (host, token) = serve();
    let headers = [("Host", host.as_str()), ("X-Presight-Token", token.as_str())];
    let page = || {
        let body = json!({ "pose": POSE, "outputs": ["range"] }).to_string();
        let start = Instant::now();
        let (status, _) = send(&host, &post("/frame", &headers, &body));
        assert_eq!(status, 200);
        assert!(start.elapsed() < Duration::from_secs(8), "{:?}", start.elapsed());
    };
    page();
    let large = "x".repeat(MAX_BODY + 1);
    assert_eq!(send(&host, &post("/frame", &headers, &large)).0, 413);
    let (status, text) = send(&host, &post("/frame", &headers, "{\"pose\":[NaN]}"));
    assert!(status == 422 && text.contains("remedy"), "{text}");
    assert_eq!(send(&host, &post("/nothing", &headers, "{}")).0, 404);
    let wide = "y".repeat(17 << 10);
    let (status, _) = send(&host, &post("/frame", &[headers[0], headers[1], ("X-Wide", &wide)], "{}"));
    assert!(status == 431 || status == 400 || status == 0, "{status}");
    assert_eq!(send(&host, b"nonsense\r\n\r\n").0, 400);
    // Clients that send a byte and wait, many at once: with a head, and with a body that never comes whole.
    let slow: Vec<TcpStream> = (0..200)
        .map(|i| {
            let mut socket = TcpStream::connect(&host).unwrap();
            let bytes =
                if i % 2 == 0 { b"P".to_vec() } else { post("/frame", &headers[..1], "{\"pose\"")[..90].to_vec() };
            let _ = socket.write_all(&bytes);
            socket
        })
        .collect();
    page();
    page();
    drop(slow);
    page();
}

#[test]
fn a_port_in_use_is_a_system_error() {
    let server = Server::listen(0).unwrap();
    let address = server.address();
    let port: u16 = address.split([':', '/']).find_map(|word| word.parse().ok()).unwrap();
    let e = Server::listen(port).err().unwrap();
    assert!(e.kind() == presight::ErrorKind::System && e.to_string().contains("`port`"), "{e}");
    assert!(!address.contains('?') && address.split('#').nth(1).unwrap().len() == 32);
}
