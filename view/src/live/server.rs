//! The page's server: a few read-only paths, for the user's own browser.

use std::convert::Infallible;
use std::fmt;
use std::io;
use std::net::SocketAddr;
use std::sync::Arc;
use std::time::Duration;

use axum::Router;
use axum::body::Body;
use axum::extract::{ConnectInfo, Request, State};
use axum::http::header::{ALLOW, CACHE_CONTROL, CONTENT_TYPE, LOCATION};
use axum::http::request::Parts;
use axum::http::{HeaderValue, Method, StatusCode};
use axum::response::Response;
use bytes::Bytes;
use futures_util::stream::unfold;
use tokio::time::timeout;

use super::guard::{Guard, Refused};
use super::hub::{Cursor, Hub};
use super::listening::{FIRST_REQUEST, Limits, Listening, Peer};
use super::page;
use super::source::{Place, Source};

/// Pages that follow a run at a time; a further one is told to wait.
const CLIENTS_MAX: usize = 64;
/// A stream without news says that it lives after this time.
const KEEP_ALIVE: Duration = Duration::from_secs(5);
const LIMITS: Limits = Limits {
    name: "view-server",
    // Twice the pages: browsers keep a second connection for the answers.
    connections: 2 * CLIENTS_MAX,
    // Some four seconds of scenes.
    send_buffer: 128 << 10,
    first_request: FIRST_REQUEST,
    silence: Some(Duration::from_secs(60)),
};

const JSON: &str = "application/json";
const EVENTS: &str = "text/event-stream";
const TEXT: &str = "text/plain; charset=utf-8";

/// What every answer carries. No script but ours runs, nothing is loaded from elsewhere,
/// no other page may frame this one, and the address with its token is told to no one.
const HEADERS: [(&str, &str); 7] = [
    (
        "content-security-policy",
        "default-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'",
    ),
    ("x-content-type-options", "nosniff"),
    ("x-frame-options", "DENY"),
    ("referrer-policy", "no-referrer"),
    ("cross-origin-opener-policy", "same-origin"),
    ("cross-origin-resource-policy", "same-origin"),
    (
        "permissions-policy",
        "camera=(), geolocation=(), microphone=()",
    ),
];

/// What all connections share.
#[derive(Clone)]
struct Shared {
    guard: Arc<Guard>,
    source: Arc<Source>,
    here: SocketAddr,
}

/// A server in a thread of its own. It stops when it is dropped.
pub struct Server {
    listening: Listening,
    root: String,
}

impl fmt::Debug for Server {
    // Without the root, which holds the token.
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(formatter, "Server({})", self.address())
    }
}

impl Server {
    /// Starts a server on this address.
    ///
    /// # Errors
    /// When the port is taken, the address is not of this machine, or no thread can be
    /// had.
    pub fn start(address: SocketAddr, source: Arc<Source>) -> io::Result<Self> {
        let mut root = String::new();
        let listening = Listening::start(address, LIMITS, |here| {
            let guard = Guard::new(here)?;
            root = guard.root();
            let guard = Arc::new(guard);
            let shared = Shared {
                guard,
                source,
                here,
            };
            Ok(Router::new().fallback(answer).with_state(shared))
        })?;
        Ok(Self { listening, root })
    }

    /// Where it listens.
    pub fn address(&self) -> SocketAddr {
        self.listening.address()
    }

    /// The page's address, with its token.
    pub fn url(&self) -> String {
        format!("http://{}{}", self.address(), self.root)
    }
}

async fn answer(
    State(shared): State<Shared>,
    ConnectInfo(peer): ConnectInfo<Peer>,
    request: Request,
) -> Response {
    peer.has_asked();
    // The content of a request, which is not read.
    let (head, _) = request.into_parts();
    let mut response = match dispatch(&shared, peer.address, &head).await {
        Ok(response) => response,
        Err((status, text)) => plain(status, text),
    };
    let headers = response.headers_mut();
    for (name, value) in HEADERS {
        headers.insert(name, HeaderValue::from_static(value));
    }
    headers.insert(CACHE_CONTROL, HeaderValue::from_static("no-store"));
    response
}

async fn dispatch(shared: &Shared, from: SocketAddr, head: &Parts) -> Result<Response, Refused> {
    let guard = &shared.guard;
    guard.check(&head.headers, (from, shared.here))?;
    let (path, query) = (head.uri.path(), head.uri.query());
    let rest = guard.rest(path)?;
    if head.method != Method::GET && head.method != Method::HEAD {
        let mut response = plain(StatusCode::METHOD_NOT_ALLOWED, "the page is read-only\n");
        let allowed = HeaderValue::from_static("GET, HEAD");
        response.headers_mut().insert(ALLOW, allowed);
        return Ok(response);
    }
    // Relative addresses need the slash behind the token.
    if rest.is_empty() && !path.ends_with('/') {
        return Ok(moved(&guard.root()));
    }
    let (source, rest) = match shared.source.place(rest)? {
        Place::Below(source, rest) => (source, rest),
        Place::WithoutSlash => return Ok(moved(&format!("{path}/"))),
    };
    let name = match rest {
        "" => source.page(),
        rest => rest,
    };
    if let Some(file) = page::file(name) {
        return Ok(whole(file.media_type, Bytes::from_static(file.bytes)));
    }
    match (rest, source.hub()) {
        ("stream", Some(hub)) => stream(hub),
        _ => {
            let rest = rest.to_string();
            let query = query.unwrap_or_default().to_string();
            // It reads files, or plans: not among the connections.
            let told = tokio::task::spawn_blocking(move || source.tell(&rest, &query));
            let told = told.await.unwrap_or(Err((
                StatusCode::INTERNAL_SERVER_ERROR,
                "the answer failed; the log has more\n",
            )));
            told.map(|(media_type, bytes)| whole(media_type, bytes))
        }
    }
}

/// All news of a run from now on, and what was kept.
fn stream(hub: &Arc<Hub>) -> Result<Response, Refused> {
    let client = hub.enter(CLIENTS_MAX).ok_or((
        StatusCode::SERVICE_UNAVAILABLE,
        "too many pages are open; close one\n",
    ))?;
    let begin = (hub.clone(), hub.listen(), Cursor::default(), client);
    let news = unfold(begin, |(hub, mut news, mut cursor, client)| async move {
        loop {
            let text = hub.since(&mut cursor);
            if !text.is_empty() {
                let bytes = Ok::<_, Infallible>(Bytes::from(text));
                return Some((bytes, (hub, news, cursor, client)));
            }
            match timeout(KEEP_ALIVE, news.changed()).await {
                Ok(Ok(())) => {}
                Ok(Err(_)) => return None,
                Err(_) => {
                    let bytes = Ok(Bytes::from_static(b": alive\n\n"));
                    return Some((bytes, (hub, news, cursor, client)));
                }
            }
        }
    });
    let mut response = Response::new(Body::from_stream(news));
    let headers = response.headers_mut();
    headers.insert(CONTENT_TYPE, HeaderValue::from_static(EVENTS));
    Ok(response)
}

fn whole(media_type: &'static str, bytes: Bytes) -> Response {
    let mut response = Response::new(Body::from(bytes));
    let headers = response.headers_mut();
    headers.insert(CONTENT_TYPE, HeaderValue::from_static(media_type));
    response
}

/// A JSON answer of a source.
pub fn json(text: String) -> (&'static str, Bytes) {
    (JSON, text.into())
}

fn plain(status: StatusCode, text: &'static str) -> Response {
    let mut response = whole(TEXT, Bytes::from_static(text.as_bytes()));
    *response.status_mut() = status;
    response
}

fn moved(root: &str) -> Response {
    let mut response = plain(StatusCode::PERMANENT_REDIRECT, "");
    if let Ok(root) = root.parse() {
        response.headers_mut().insert(LOCATION, root);
    }
    response
}
