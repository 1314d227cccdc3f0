//! A port with a thread of its own, whose connections are limited in number and in silence.

use std::io;
use std::net::SocketAddr;
use std::pin::Pin;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::task::{Context, Poll};
use std::thread::JoinHandle;
use std::time::Duration;

use axum::Router;
use axum::extract::connect_info::Connected;
use axum::serve::{IncomingStream, Listener};
use tokio::io::{AsyncRead, AsyncWrite, ReadBuf};
use tokio::net::{TcpListener, TcpStream};
use tokio::sync::{OwnedSemaphorePermit, Semaphore, oneshot};
use tokio::time::{Instant, Sleep, sleep};

/// Time in which a page or a viewer sends its first request.
pub const FIRST_REQUEST: Duration = Duration::from_secs(10);

/// What a port allows.
#[derive(Debug, Clone, Copy)]
pub struct Limits {
    /// Name of the thread.
    pub name: &'static str,
    /// Connections at a time; further ones wait in the kernel.
    pub connections: usize,
    /// Bytes that wait in the kernel for a slow client.
    pub send_buffer: usize,
    /// Time after which a connection without a whole request is closed.
    pub first_request: Duration,
    /// Time after which a connection is closed to which nothing more was sent; `None` if
    /// clients may listen to a silent run.
    pub silence: Option<Duration>,
}

/// A port that is served until this value is dropped.
#[derive(Debug)]
pub struct Listening {
    address: SocketAddr,
    stop: Option<oneshot::Sender<()>>,
    thread: Option<JoinHandle<()>>,
}

impl Listening {
    /// Opens the port, and serves what `router` makes of the address that was opened.
    ///
    /// # Errors
    /// When the port is taken, the address is not of this machine, `router` refuses, or no
    /// thread can be had.
    pub fn start(
        address: SocketAddr,
        limits: Limits,
        router: impl FnOnce(SocketAddr) -> io::Result<Router>,
    ) -> io::Result<Self> {
        let listener = std::net::TcpListener::bind(address)?;
        listener.set_nonblocking(true)?;
        let address = listener.local_addr()?;
        let router = router(address)?;
        let runtime = tokio::runtime::Builder::new_current_thread()
            .enable_all()
            // Plans and recordings are read beside the connections.
            .max_blocking_threads(2)
            .build()?;
        let (stop, stopped) = oneshot::channel();
        let thread = std::thread::Builder::new()
            .name(limits.name.into())
            .spawn(move || {
                runtime.block_on(async {
                    let serving = tokio::spawn(serve(listener, limits, router));
                    // Ends when the handle is dropped, whichever way.
                    let _ = stopped.await;
                    serving.abort();
                });
                runtime.shutdown_background();
            })?;
        Ok(Self {
            address,
            stop: Some(stop),
            thread: Some(thread),
        })
    }

    /// The address that was opened.
    pub fn address(&self) -> SocketAddr {
        self.address
    }
}

impl Drop for Listening {
    fn drop(&mut self) {
        drop(self.stop.take());
        if let Some(thread) = self.thread.take() {
            // It panicked: its connections are closed.
            let _ = thread.join();
        }
    }
}

async fn serve(listener: std::net::TcpListener, limits: Limits, router: Router) {
    let Ok(listener) = TcpListener::from_std(listener) else {
        return;
    };
    let free = Arc::new(Semaphore::new(limits.connections));
    let port = Port {
        listener,
        limits,
        free,
    };
    let service = router.into_make_service_with_connect_info::<Peer>();
    // Ends only when the runtime does.
    let _ = axum::serve(port, service).await;
}

/// A client.
#[derive(Debug, Clone)]
pub struct Peer {
    /// Its address.
    pub address: SocketAddr,
    is_answered: Arc<AtomicBool>,
}

impl Peer {
    /// A whole request came: its connection stays open until it is answered, however long
    /// that takes.
    pub fn has_asked(&self) {
        self.is_answered.store(false, Ordering::Relaxed);
    }
}

impl Connected<IncomingStream<'_, Port>> for Peer {
    fn connect_info(stream: IncomingStream<'_, Port>) -> Self {
        Self {
            address: *stream.remote_addr(),
            is_answered: stream.io().is_answered.clone(),
        }
    }
}

struct Port {
    listener: TcpListener,
    limits: Limits,
    free: Arc<Semaphore>,
}

impl Listener for Port {
    type Io = Connection;
    type Addr = SocketAddr;

    async fn accept(&mut self) -> (Connection, SocketAddr) {
        let permit = self.free.clone().acquire_owned().await;
        let permit = permit.expect("the semaphore is never closed");
        let (stream, from) = Listener::accept(&mut self.listener).await;
        // Where the system refuses, news come a little later.
        let _ = stream.set_nodelay(true);
        let bytes = self.limits.send_buffer;
        let _ = rustix::net::sockopt::set_socket_send_buffer_size(&stream, bytes);
        let connection = Connection {
            stream,
            limits: self.limits,
            is_answered: Arc::new(AtomicBool::new(true)),
            deadline: Some(Box::pin(sleep(self.limits.first_request))),
            _permit: permit,
        };
        (connection, from)
    }

    fn local_addr(&self) -> io::Result<SocketAddr> {
        self.listener.local_addr()
    }
}

/// A client's connection. Reading fails when the client asked nothing for too long.
struct Connection {
    stream: TcpStream,
    limits: Limits,
    /// Whether no request waits for its answer.
    is_answered: Arc<AtomicBool>,
    deadline: Option<Pin<Box<Sleep>>>,
    _permit: OwnedSemaphorePermit,
}

impl Connection {
    fn has_sent(&mut self, sent: Poll<io::Result<usize>>) -> Poll<io::Result<usize>> {
        if let Poll::Ready(Ok(_)) = sent {
            self.is_answered.store(true, Ordering::Relaxed);
            match (self.limits.silence, &mut self.deadline) {
                // The same timer: a read that waits is woken by it.
                (Some(silence), Some(deadline)) => {
                    deadline.as_mut().reset(Instant::now() + silence);
                }
                _ => self.deadline = None,
            }
        }
        sent
    }
}

impl AsyncRead for Connection {
    fn poll_read(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
        buffer: &mut ReadBuf<'_>,
    ) -> Poll<io::Result<()>> {
        let (is_answered, again) = (self.is_answered.clone(), self.limits.first_request);
        while let Some(deadline) = &mut self.deadline
            && deadline.as_mut().poll(context).is_ready()
        {
            if is_answered.load(Ordering::Relaxed) {
                return Poll::Ready(Err(io::ErrorKind::TimedOut.into()));
            }
            deadline.as_mut().reset(Instant::now() + again);
        }
        Pin::new(&mut self.stream).poll_read(context, buffer)
    }
}

impl AsyncWrite for Connection {
    fn poll_write(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
        bytes: &[u8],
    ) -> Poll<io::Result<usize>> {
        let sent = Pin::new(&mut self.stream).poll_write(context, bytes);
        self.has_sent(sent)
    }

    fn poll_write_vectored(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
        slices: &[io::IoSlice<'_>],
    ) -> Poll<io::Result<usize>> {
        let sent = Pin::new(&mut self.stream).poll_write_vectored(context, slices);
        self.has_sent(sent)
    }

    fn is_write_vectored(&self) -> bool {
        self.stream.is_write_vectored()
    }

    fn poll_flush(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<io::Result<()>> {
        Pin::new(&mut self.stream).poll_flush(context)
    }

    fn poll_shutdown(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<io::Result<()>> {
        Pin::new(&mut self.stream).poll_shutdown(context)
    }
}

#[cfg(test)]
mod tests {
    use std::io::{Read, Write};
    use std::net::{Ipv4Addr, TcpStream};

    use axum::extract::ConnectInfo;

    use super::*;

    const LIMITS: Limits = Limits {
        name: "test",
        connections: 3,
        send_buffer: 4096,
        first_request: Duration::from_millis(200),
        silence: Some(Duration::from_millis(200)),
    };

    #[test]
    fn an_answer_may_take_longer_than_the_limits() {
        let router = |_| {
            Ok(
                Router::new().fallback(|ConnectInfo(peer): ConnectInfo<Peer>| async move {
                    peer.has_asked();
                    sleep(3 * LIMITS.first_request).await;
                    "late"
                }),
            )
        };
        let here = (Ipv4Addr::LOCALHOST, 0).into();
        let listening = Listening::start(here, LIMITS, router).expect("a port");
        let mut asking = TcpStream::connect(listening.address()).expect("a connection");
        let request = b"GET / HTTP/1.1\r\nhost: a\r\n\r\n";
        asking.write_all(request).expect("it is open");
        let mut text = Vec::new();
        asking.read_to_end(&mut text).expect("an answer");
        assert!(
            text.ends_with(b"late"),
            "{}",
            String::from_utf8_lossy(&text)
        );
    }

    #[test]
    fn silent_connections_are_closed_and_keep_no_one_out() {
        let router = |_| Ok(Router::new().fallback(|| async { "here" }));
        let here = (Ipv4Addr::LOCALHOST, 0).into();
        let listening = Listening::start(here, LIMITS, router).expect("a port");
        let connect = || TcpStream::connect(listening.address()).expect("a connection");
        let mut silent: Vec<TcpStream> = (0..2).map(|_| connect()).collect();
        // Half a request.
        let mut half = connect();
        half.write_all(b"GET / HTTP/1.1\r\nhost:")
            .expect("it is open");
        silent.push(half);
        let mut asking = connect();
        let request = b"GET / HTTP/1.1\r\nhost: a\r\n\r\n";
        asking.write_all(request).expect("it waits in the kernel");
        let mut text = Vec::new();
        // It ends, too, once it asks no more.
        asking.read_to_end(&mut text).expect("an answer");
        assert!(
            text.ends_with(b"here"),
            "{}",
            String::from_utf8_lossy(&text)
        );
        for mut stream in silent {
            let mut rest = Vec::new();
            let _ = stream.read_to_end(&mut rest);
            assert!(!rest.ends_with(b"here"));
        }
    }
}
