//! The server: the page's files, and messages to the session, for this machine only.
//!
//! It is made of `hyper` on one thread of `tokio`: both are kept well, and limits on headers, bodies, time and
//! connections, which keep out what other pages and programs send, are theirs. `tiny_http` is a fourth of the crates,
//! but had no release since 2022, and gives every slow client a thread for as long as it likes.

use super::answer::Answer;
use super::session::Session;
use http_body_util::{BodyExt, Full, Limited};
use hyper::body::{Bytes, Incoming};
use hyper::header::{self, HeaderMap, HeaderValue};
use hyper::server::conn::http1;
use hyper::service::service_fn;
use hyper::{Method, Request, Response, StatusCode};
use hyper_util::rt::{TokioIo, TokioTimer};
use presight::{Error, ErrorKind, Result};
use std::collections::VecDeque;
use std::convert::Infallible;
use std::fmt::Write;
use std::net::{Ipv4Addr, Ipv6Addr, SocketAddr};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex};
use std::time::Duration;
use tokio::net::TcpListener;
use tokio::task::AbortHandle;

/// The header that carries the token.
pub const TOKEN: &str = "x-presight-token";
/// The largest body of a request, bytes.
pub const MAX_BODY: usize = 1 << 20;
/// The largest head of a request, bytes.
pub const MAX_HEAD: usize = 16 << 10;
/// Maximum number of open connections.
pub const MAX_CONNECTIONS: usize = 64;
/// The longest time for a head, and for a body.
const PATIENCE: Duration = Duration::from_secs(10);

/// The page's files. They hold no data.
const FILES: [(&str, &str, &str); 12] = [
    ("/", "text/html; charset=utf-8", include_str!("page/index.html")),
    ("/icon.svg", "image/svg+xml", include_str!("page/icon.svg")),
    ("/style.css", "text/css; charset=utf-8", include_str!("page/style.css")),
    ("/main.js", "text/javascript; charset=utf-8", include_str!("page/main.js")),
    ("/carrier.js", "text/javascript; charset=utf-8", include_str!("page/carrier.js")),
    ("/colours.js", "text/javascript; charset=utf-8", include_str!("page/colours.js")),
    ("/picture.js", "text/javascript; charset=utf-8", include_str!("page/picture.js")),
    ("/pose.js", "text/javascript; charset=utf-8", include_str!("page/pose.js")),
    ("/list.js", "text/javascript; charset=utf-8", include_str!("page/list.js")),
    ("/panel.js", "text/javascript; charset=utf-8", include_str!("page/panel.js")),
    ("/plan.js", "text/javascript; charset=utf-8", include_str!("page/plan.js")),
    ("/views.js", "text/javascript; charset=utf-8", include_str!("page/views.js")),
];

/// A server that listens, but does not answer yet.
pub struct Server {
    listeners: Vec<std::net::TcpListener>,
    port: u16,
    token: String,
}

impl Server {
    /// Listens on this port (0: any free one) of 127.0.0.1, and of ::1 if the machine has it.
    ///
    /// # Errors
    /// [`ErrorKind::System`] if the port is in use or not allowed, or the system gives no random numbers.
    pub fn listen(port: u16) -> Result<Self> {
        let refused = |e: std::io::Error| {
            let what = format!("`port` {port}: cannot listen: {e}");
            Error::new(ErrorKind::System, what, "give another, or 0 for any free one").caused_by(e)
        };
        let first = std::net::TcpListener::bind((Ipv4Addr::LOCALHOST, port)).map_err(refused)?;
        let port = first.local_addr().map_err(refused)?.port();
        let mut listeners = vec![first];
        listeners.extend(std::net::TcpListener::bind((Ipv6Addr::LOCALHOST, port)));
        listeners.iter().try_for_each(|listener| listener.set_nonblocking(true)).map_err(refused)?;
        let mut random = [0; 16];
        getrandom::fill(&mut random).map_err(|e| {
            Error::new(ErrorKind::System, format!("the system gives no random numbers: {e}"), "see its message")
        })?;
        let token = random.iter().fold(String::new(), |mut text, byte| {
            let _always_works = write!(text, "{byte:02x}");
            text
        });
        Ok(Self { listeners, port, token })
    }

    /// The page's address, with the token that its requests carry.
    pub fn address(&self) -> String {
        format!("http://127.0.0.1:{}/#{}", self.port, self.token)
    }

    /// Answers until the process ends.
    ///
    /// # Errors
    /// [`ErrorKind::System`] if the system refuses threads or sockets.
    pub fn serve(self, session: Session) -> Result<()> {
        let wrap = |e: std::io::Error| {
            Error::new(ErrorKind::System, format!("the server cannot start: {e}"), "see the system's message")
        };
        let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().map_err(wrap)?;
        let desk = Arc::new(Desk { session: Mutex::new(session), token: self.token });
        runtime.block_on(async {
            let mut listeners = Vec::new();
            for listener in self.listeners {
                listeners.push(TcpListener::from_std(listener).map_err(wrap)?);
            }
            let mut connections = Connections::default();
            loop {
                let socket = match &listeners[..] {
                    [first, second] => either(first, second).await,
                    [first, ..] => first.accept().await,
                    [] => return Ok(()),
                };
                match socket {
                    Ok((socket, _)) => connections.add(socket, &desk),
                    // Too many open files, or a client that is gone: the next one may do better.
                    Err(_) => tokio::time::sleep(Duration::from_millis(50)).await,
                }
            }
        })
    }
}

/// The next connection of two listeners.
async fn either(a: &TcpListener, b: &TcpListener) -> std::io::Result<(tokio::net::TcpStream, SocketAddr)> {
    std::future::poll_fn(|context| match a.poll_accept(context) {
        std::task::Poll::Pending => b.poll_accept(context),
        ready => ready,
    })
    .await
}

/// The open connections, oldest first. A new one beyond the limit ends the oldest that never showed the token: the page
/// keeps working under attack.
#[derive(Default)]
struct Connections {
    open: VecDeque<(Arc<AtomicBool>, AbortHandle)>,
}

impl Connections {
    fn add(&mut self, socket: tokio::net::TcpStream, desk: &Arc<Desk>) {
        self.open.retain(|(_, handle)| !handle.is_finished());
        if self.open.len() >= MAX_CONNECTIONS {
            let stranger = self.open.iter().position(|(trusted, _)| !trusted.load(Ordering::Relaxed));
            match stranger.and_then(|at| self.open.remove(at)) {
                Some((_, handle)) => handle.abort(),
                None => return,
            }
        }
        let _only_slower_without = socket.set_nodelay(true);
        let trusted = Arc::new(AtomicBool::new(false));
        let (desk, shown) = (desk.clone(), trusted.clone());
        let service = service_fn(move |request| {
            let (desk, shown) = (desk.clone(), shown.clone());
            async move { Ok::<_, Infallible>(desk.answer(request, &shown).await) }
        });
        let mut builder = http1::Builder::new();
        builder.timer(TokioTimer::new()).header_read_timeout(PATIENCE).max_buf_size(MAX_HEAD);
        let connection = builder.serve_connection(TokioIo::new(socket), service);
        let task = tokio::spawn(async move {
            let _the_client_is_gone = connection.await;
        });
        self.open.push_back((trusted, task.abort_handle()));
    }
}

/// What answers requests.
struct Desk {
    session: Mutex<Session>,
    token: String,
}

type Reply = Response<Full<Bytes>>;

impl Desk {
    async fn answer(self: Arc<Self>, request: Request<Incoming>, trusted: &AtomicBool) -> Reply {
        if !is_from_here(request.headers()) {
            return reply(StatusCode::FORBIDDEN, "text/plain", Bytes::new());
        }
        let path = request.uri().path().to_owned();
        if request.method() == Method::GET {
            return match FILES.iter().find(|(name, ..)| *name == path) {
                Some((_, kind, text)) => reply(StatusCode::OK, kind, Bytes::from_static(text.as_bytes())),
                None => reply(StatusCode::NOT_FOUND, "text/plain", Bytes::new()),
            };
        }
        if request.method() != Method::POST {
            return reply(StatusCode::METHOD_NOT_ALLOWED, "text/plain", Bytes::new());
        }
        let token = request.headers().get(TOKEN).map(HeaderValue::as_bytes).unwrap_or_default();
        if !same(token, self.token.as_bytes()) {
            return reply(StatusCode::FORBIDDEN, "text/plain", Bytes::new());
        }
        trusted.store(true, Ordering::Relaxed);
        let body = Limited::new(request.into_body(), MAX_BODY).collect();
        let body = match tokio::time::timeout(PATIENCE, body).await {
            Ok(Ok(body)) => body.to_bytes(),
            Ok(Err(e)) if e.is::<http_body_util::LengthLimitError>() => {
                return reply(StatusCode::PAYLOAD_TOO_LARGE, "text/plain", Bytes::new());
            }
            Ok(Err(_)) => return reply(StatusCode::BAD_REQUEST, "text/plain", Bytes::new()),
            Err(_) => return reply(StatusCode::REQUEST_TIMEOUT, "text/plain", Bytes::new()),
        };
        let work = move || {
            // A panic is a defect of the session; its state is that before the request or after it.
            let mut session = self.session.lock().unwrap_or_else(std::sync::PoisonError::into_inner);
            session.answer(path.trim_start_matches('/'), &body)
        };
        let answer = tokio::task::spawn_blocking(work).await;
        answer.map_or_else(|_| reply(StatusCode::INTERNAL_SERVER_ERROR, "text/plain", Bytes::new()), reply_of)
    }
}

fn reply_of(answer: Answer) -> Reply {
    let json = "application/json";
    match answer {
        Answer::Json(text) => reply(StatusCode::OK, json, text.into()),
        Answer::Binary(bytes) => reply(StatusCode::OK, "application/octet-stream", bytes.into()),
        Answer::Behind(text) => reply(StatusCode::CONFLICT, json, text.into()),
        Answer::Wrong(e) => {
            let error = e.to_string();
            let text = serde_json::json!({ "error": error, "remedy": e.remedy() }).to_string();
            reply(StatusCode::UNPROCESSABLE_ENTITY, json, text.into())
        }
        Answer::Unknown => reply(StatusCode::NOT_FOUND, "text/plain", Bytes::new()),
    }
}

fn reply(status: StatusCode, kind: &'static str, body: Bytes) -> Reply {
    let mut reply = Response::new(Full::new(body));
    *reply.status_mut() = status;
    let fixed = [
        (header::CONTENT_TYPE, kind),
        (header::CACHE_CONTROL, "no-store"),
        (
            header::CONTENT_SECURITY_POLICY,
            "default-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'",
        ),
        (header::X_CONTENT_TYPE_OPTIONS, "nosniff"),
        (header::REFERRER_POLICY, "no-referrer"),
    ];
    reply.headers_mut().extend(fixed.map(|(name, value)| (name, HeaderValue::from_static(value))));
    // Other origins may not even embed an answer.
    let policy = header::HeaderName::from_static("cross-origin-resource-policy");
    reply.headers_mut().insert(policy, HeaderValue::from_static("same-origin"));
    reply
}

/// True for a request to this machine by name or address, from no other page than ours. A page of another site that
/// made its name point here sends its own name as host.
fn is_from_here(headers: &HeaderMap) -> bool {
    let mut hosts = headers.get_all(header::HOST).iter();
    let host = hosts.next().is_some_and(|host| host.to_str().is_ok_and(is_local));
    let origin =
        |value: &HeaderValue| value.to_str().ok().and_then(|text| text.strip_prefix("http://")).is_some_and(is_local);
    host && hosts.next().is_none() && headers.get_all(header::ORIGIN).iter().all(origin)
}

/// True for `localhost`, 127.0.0.1 and ::1, with any port: `ssh -L` has its own.
fn is_local(host: &str) -> bool {
    let name = match host.rsplit_once(':') {
        Some((name, port)) if !port.is_empty() && port.bytes().all(|c| c.is_ascii_digit()) => name,
        _ => host,
    };
    ["localhost", "127.0.0.1", "[::1]"].iter().any(|local| name.eq_ignore_ascii_case(local))
}

/// Compares in a time that depends on the lengths alone.
fn same(a: &[u8], b: &[u8]) -> bool {
    a.len() == b.len() && a.iter().zip(b).fold(0, |differ, (a, b)| differ | (a ^ b)) == 0
}

#[cfg(test)]
mod tests {
    use super::*;

    fn headers(host: &[&str], origin: &[&str]) -> HeaderMap {
        let mut headers = HeaderMap::new();
        for (name, values) in [(header::HOST, host), (header::ORIGIN, origin)] {
            for value in values {
                headers.append(name.clone(), HeaderValue::from_str(value).unwrap());
            }
        }
        headers
    }

    #[test]
    fn only_this_machine_and_its_own_page_may_ask() {
        for host in ["localhost", "localhost:80", "127.0.0.1:4567", "[::1]:9", "[::1]", "LocalHost:1"] {
            assert!(is_from_here(&headers(&[host], &[])), "{host}");
            assert!(is_from_here(&headers(&[host], &["http://localhost:1"])), "{host}");
        }
        for host in [
            "",
            "evil.test",
            "localhost.evil.test",
            "127.0.0.1.evil.test:80",
            "evil.test:127",
            "::1",
            "127.0.0.2",
            "localhost:",
            "localhost:x",
            "user@localhost",
            "0.0.0.0",
            "localhost:80:90x",
            "xlocalhost",
        ] {
            assert!(!is_from_here(&headers(&[host], &[])), "{host}");
        }
        for origin in [
            "null",
            "https://localhost",
            "http://evil.test",
            "http://localhost.evil.test",
            "file://",
            "http://localhost/x",
        ] {
            assert!(!is_from_here(&headers(&["localhost"], &[origin])), "{origin}");
        }
        assert!(!is_from_here(&headers(&[], &[])));
        assert!(!is_from_here(&headers(&["localhost", "evil.test"], &[])));
        assert!(!is_from_here(&headers(&["localhost"], &["http://localhost", "http://evil.test"])));
    }
}
