//! Injects faults: decides for each connection, before the HTTP library sees it, whether
//! it gets a fault.

use std::io;
use std::net::SocketAddr;
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::Duration;

use serde_json::Value;
use tokio::io::{AsyncReadExt as _, AsyncWriteExt as _};
use tokio::net::{TcpListener, TcpStream};
use tokio::sync::mpsc;

use super::server_fault::{ServerFault, Step};
use super::{Shared, question};

/// Maximum length of a request that is read before a fault, bytes.
const REQUEST_BYTES_MAX: usize = 64 << 20;

/// A listener that passes on the connections without a fault.
pub struct FaultInjector {
    guests: mpsc::Receiver<(TcpStream, SocketAddr)>,
    address: SocketAddr,
}

/// Begins to accept connections.
pub fn open(listener: TcpListener, shared: Arc<Shared>) -> FaultInjector {
    let unknown = SocketAddr::from(([127, 0, 0, 1], 0));
    let address = listener.local_addr().unwrap_or(unknown);
    let (pass, guests) = mpsc::channel(64);
    tokio::spawn(async move {
        loop {
            match listener.accept().await {
                Ok((stream, from)) => {
                    tokio::spawn(receive(stream, from, shared.clone(), pass.clone()));
                }
                // Most likely out of file descriptors: retry until some are closed.
                Err(_) => tokio::time::sleep(Duration::from_millis(50)).await,
            }
        }
    });
    FaultInjector { guests, address }
}

impl axum::serve::Listener for FaultInjector {
    type Io = TcpStream;
    type Addr = SocketAddr;

    async fn accept(&mut self) -> (TcpStream, SocketAddr) {
        match self.guests.recv().await {
            Some(guest) => guest,
            None => std::future::pending().await,
        }
    }

    fn local_addr(&self) -> io::Result<SocketAddr> {
        Ok(self.address)
    }
}

async fn receive(
    stream: TcpStream,
    from: SocketAddr,
    shared: Arc<Shared>,
    pass: mpsc::Sender<(TcpStream, SocketAddr)>,
) {
    let injected = match shared.options.injected {
        Some(injected) if injected.ignores_request() || is_question(&stream).await => {
            (shared.draw() < shared.options.injected_share).then_some(injected)
        }
        _ => None,
    };
    match injected {
        // The HTTP server has ended.
        None => drop(pass.send((stream, from)).await),
        Some(injected) => {
            shared.requests.fetch_add(1, Ordering::Relaxed);
            // The client has closed the connection, as a fault makes it do.
            let _ = inject(injected, stream, &shared).await;
        }
    }
}

/// Whether the request is a POST: only questions get faults, `/health` always answers.
async fn is_question(stream: &TcpStream) -> bool {
    let mut begin = [0; 4];
    let seen = stream.peek(&mut begin).await;
    seen.is_ok_and(|count| begin[..count] == *b"POST")
}

async fn inject(injected: ServerFault, mut stream: TcpStream, shared: &Shared) -> io::Result<()> {
    let (head, body) = match injected.ignores_request() {
        true => (String::new(), Vec::new()),
        false => read_request(&mut stream).await?,
    };
    let body: Value = serde_json::from_slice(&body).unwrap_or_default();
    let authorization = header(&head, "authorization").unwrap_or("none");
    for step in injected.script(question::preset(&body), authorization) {
        match step {
            Step::Send(bytes) => send(&mut stream, &bytes, shared).await?,
            Step::Drip(bytes, every) => {
                for byte in bytes {
                    send(&mut stream, &[byte], shared).await?;
                    tokio::time::sleep(every).await;
                }
            }
            Step::Flood(bytes) => {
                const CHUNK: usize = 65_536;
                let chunk = [b"10000\r\n", &[b' '; CHUNK][..], b"\r\n"].concat();
                for _ in 0..bytes / CHUNK as u64 {
                    send(&mut stream, &chunk, shared).await?;
                }
                send(&mut stream, b"0\r\n\r\n", shared).await?;
            }
            // Until the client closes the connection.
            Step::Hang => while stream.read(&mut [0; 1024]).await? > 0 {},
            Step::Reset => return reset(stream),
        }
    }
    // Unread input would turn the close into a reset.
    stream.shutdown().await?;
    while stream.read(&mut [0; 1024]).await? > 0 {}
    Ok(())
}

async fn send(stream: &mut TcpStream, bytes: &[u8], shared: &Shared) -> io::Result<()> {
    stream.write_all(bytes).await?;
    shared
        .bytes_sent
        .fetch_add(bytes.len() as u64, Ordering::Relaxed);
    Ok(())
}

/// Closes with a linger time of 0, which makes the kernel reset the connection.
fn reset(stream: TcpStream) -> io::Result<()> {
    rustix::net::sockopt::set_socket_linger(&stream, Some(Duration::ZERO))?;
    drop(stream);
    Ok(())
}

/// Reads head and body of one request.
async fn read_request(stream: &mut TcpStream) -> io::Result<(String, Vec<u8>)> {
    let mut bytes = Vec::new();
    let mut buffer = vec![0; 65_536];
    loop {
        let end = bytes.windows(4).position(|four| four == b"\r\n\r\n");
        if let Some(end) = end {
            let head = String::from_utf8_lossy(&bytes[..end]).into_owned();
            let length = header(&head, "content-length").and_then(|text| text.parse().ok());
            let whole = end + 4 + length.unwrap_or(0).min(REQUEST_BYTES_MAX);
            while bytes.len() < whole {
                let count = stream.read(&mut buffer).await?;
                if count == 0 {
                    break;
                }
                bytes.extend_from_slice(&buffer[..count]);
            }
            return Ok((head, bytes.split_off(end + 4)));
        }
        let count = stream.read(&mut buffer).await?;
        if count == 0 || bytes.len() > REQUEST_BYTES_MAX {
            return Ok((String::new(), Vec::new()));
        }
        bytes.extend_from_slice(&buffer[..count]);
    }
}

fn header<'a>(head: &'a str, name: &str) -> Option<&'a str> {
    let mut lines = head.lines().filter_map(|line| line.split_once(':'));
    let (_, value) = lines.find(|(key, _)| key.eq_ignore_ascii_case(name))?;
    Some(value.trim())
}
