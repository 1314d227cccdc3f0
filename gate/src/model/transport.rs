//! Reads a response, and names faults below HTTP.

use std::error::Error;
use std::io;

use reqwest::Response;

use super::Fault;

/// The fault in an error of `reqwest`, found in its chain of causes.
pub fn fault(error: &reqwest::Error) -> Fault {
    let mut cause: Option<&(dyn Error + 'static)> = Some(error);
    while let Some(current) = cause {
        if let Some(fault) = of_cause(current) {
            return match fault {
                // The connection ended during the TLS handshake.
                Fault::ConnectionReset if is_handshake(error) => Fault::Tls,
                fault => fault,
            };
        }
        cause = current.source();
    }
    match () {
        () if error.is_timeout() => Fault::Timeout,
        () if error.is_connect() => Fault::Unreachable,
        () => Fault::Protocol,
    }
}

fn is_handshake(error: &reqwest::Error) -> bool {
    let is_encrypted = error.url().is_some_and(|url| url.scheme() == "https");
    is_encrypted && error.is_connect()
}

fn of_cause(cause: &(dyn Error + 'static)) -> Option<Fault> {
    if cause.is::<rustls::Error>() {
        return Some(Fault::Tls);
    }
    if let Some(error) = cause.downcast_ref::<io::Error>() {
        // An I/O error that wraps another does not name it as its source.
        let inner = error.get_ref().and_then(|inner| of_cause(inner));
        return inner.or_else(|| of_kind(error.kind()));
    }
    let error = cause.downcast_ref::<hyper::Error>()?;
    if error.is_incomplete_message() || error.is_closed() {
        return Some(Fault::ConnectionReset);
    }
    (error.is_parse() || error.is_parse_status()).then_some(Fault::Protocol)
}

fn of_kind(kind: io::ErrorKind) -> Option<Fault> {
    match kind {
        io::ErrorKind::ConnectionRefused => Some(Fault::ConnectionRefused),
        io::ErrorKind::ConnectionReset
        | io::ErrorKind::ConnectionAborted
        | io::ErrorKind::BrokenPipe
        | io::ErrorKind::NotConnected
        | io::ErrorKind::UnexpectedEof => Some(Fault::ConnectionReset),
        io::ErrorKind::TimedOut => Some(Fault::Timeout),
        io::ErrorKind::HostUnreachable | io::ErrorKind::NetworkUnreachable => {
            Some(Fault::Unreachable)
        }
        _ => None,
    }
}

/// Reads at most `bytes_max`, and returns whether that was all.
pub async fn read_body(mut response: Response, bytes_max: usize) -> (Vec<u8>, Result<(), Fault>) {
    let announced = response.content_length().unwrap_or(0);
    if announced > bytes_max as u64 {
        return (Vec::new(), Err(Fault::TooLarge));
    }
    let mut bytes = Vec::with_capacity(announced as usize);
    loop {
        match response.chunk().await {
            Ok(None) => return (bytes, Ok(())),
            Ok(Some(chunk)) if bytes.len() + chunk.len() > bytes_max => {
                return (bytes, Err(Fault::TooLarge));
            }
            Ok(Some(chunk)) => bytes.extend_from_slice(&chunk),
            Err(error) => return (bytes, Err(fault(&error))),
        }
    }
}
