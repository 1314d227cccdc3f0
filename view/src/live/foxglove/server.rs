//! The port to which Foxglove and Lichtblick connect.

use std::io;
use std::net::SocketAddr;
use std::sync::Arc;

use axum::Router;
use axum::body::Body;
use axum::extract::{ConnectInfo, Request, State};
use axum::http::header::{CONNECTION, SEC_WEBSOCKET_ACCEPT, SEC_WEBSOCKET_PROTOCOL, UPGRADE};
use axum::http::{HeaderValue, StatusCode};
use axum::response::{IntoResponse as _, Response};

use super::board::Board;
use super::client;
use super::protocol::SUBPROTOCOLS;
use super::websocket::{Socket, handshake};
use crate::live::guard::{Guard, Refused};
use crate::live::listening::{FIRST_REQUEST, Limits, Listening, Peer};

/// Clients at a time.
const CLIENTS_MAX: usize = 16;
const LIMITS: Limits = Limits {
    name: "view-foxglove",
    connections: 2 * CLIENTS_MAX,
    // A second of the scene.
    send_buffer: 256 << 10,
    first_request: FIRST_REQUEST,
    // A client may have no subscription, and a run no news.
    silence: None,
};

#[derive(Clone)]
struct Shared {
    guard: Arc<Guard>,
    board: Arc<Board>,
    here: SocketAddr,
}

/// A server in a thread of its own. It stops when it is dropped.
#[derive(Debug)]
pub struct FoxgloveServer {
    listening: Listening,
    root: String,
}

impl FoxgloveServer {
    /// Starts a server on this address.
    ///
    /// # Errors
    /// When the port is taken, the address is not of this machine, or no thread can be
    /// had.
    pub fn start(address: SocketAddr, board: Arc<Board>) -> io::Result<Self> {
        let mut root = String::new();
        let listening = Listening::start(address, LIMITS, |here| {
            let guard = Guard::new(here)?;
            root = guard.root();
            let guard = Arc::new(guard);
            let shared = Shared { guard, board, here };
            Ok(Router::new().fallback(answer).with_state(shared))
        })?;
        Ok(Self { listening, root })
    }

    /// The address for Foxglove, with its token.
    pub fn url(&self) -> String {
        format!("ws://{}{}", self.listening.address(), self.root)
    }
}

async fn answer(
    State(shared): State<Shared>,
    ConnectInfo(peer): ConnectInfo<Peer>,
    request: Request,
) -> Response {
    peer.has_asked();
    match accept(&shared, peer.address, request) {
        Ok(response) => response,
        Err(refused) => refused.into_response(),
    }
}

fn accept(shared: &Shared, from: SocketAddr, mut request: Request) -> Result<Response, Refused> {
    let guard = &shared.guard;
    guard.check_viewer(request.headers(), (from, shared.here))?;
    if !guard.rest(request.uri().path())?.is_empty() {
        return Err((StatusCode::NOT_FOUND, "there is nothing here\n"));
    }
    let asked = handshake(request.headers(), &SUBPROTOCOLS).ok_or((
        StatusCode::UPGRADE_REQUIRED,
        "this is for Foxglove: open this address there, with ws:// before it\n",
    ))?;
    let protocol = asked.protocol.ok_or((
        StatusCode::BAD_REQUEST,
        "this server speaks foxglove.sdk.v1 and foxglove.websocket.v1\n",
    ))?;
    let entered = shared.board.enter(CLIENTS_MAX).ok_or((
        StatusCode::SERVICE_UNAVAILABLE,
        "too many clients are connected; close one\n",
    ))?;
    let mut response = Response::new(Body::empty());
    *response.status_mut() = StatusCode::SWITCHING_PROTOCOLS;
    let key = HeaderValue::from_str(&asked.accept);
    let key = key.map_err(|_| (StatusCode::BAD_REQUEST, "the request has no key\n"))?;
    let headers = response.headers_mut();
    headers.insert(CONNECTION, HeaderValue::from_static("upgrade"));
    headers.insert(UPGRADE, HeaderValue::from_static("websocket"));
    headers.insert(SEC_WEBSOCKET_PROTOCOL, HeaderValue::from_static(protocol));
    headers.insert(SEC_WEBSOCKET_ACCEPT, key);
    let (board, upgrade) = (shared.board.clone(), hyper::upgrade::on(&mut request));
    tokio::spawn(async move {
        // A client that leaves meanwhile is none.
        if let Ok(upgraded) = upgrade.await {
            client::serve(Socket::new(upgraded), board, entered).await;
        }
    });
    Ok(response)
}
