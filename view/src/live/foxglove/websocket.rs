//! The server's side of WebSocket (RFC 6455), as far as a viewer needs it: text and binary
//! out, text in, ping and close.
//!
//! The library for it brings 13 packages; this needs the handshake and the frame's head.

use std::io;

use axum::http::HeaderMap;
use axum::http::header::{CONNECTION, SEC_WEBSOCKET_KEY, SEC_WEBSOCKET_PROTOCOL, UPGRADE};
use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use bytes::{Buf as _, Bytes, BytesMut};
use hyper::upgrade::Upgraded;
use hyper_util::rt::TokioIo;
use tokio::io::{AsyncReadExt as _, AsyncWriteExt as _};

/// Longest message of a client, bytes: some thousand subscriptions.
const MESSAGE_MAX: usize = 64 << 10;
/// What RFC 6455 appends to a client's key.
const KEY_END: &str = "258EAFA5-E914-47DA-95CA-C5AB0DC85B11";

/// The opcodes, RFC 6455 section 5.2.
mod opcode {
    pub(super) const CONTINUATION: u8 = 0;
    pub(super) const TEXT: u8 = 1;
    pub(super) const BINARY: u8 = 2;
    pub(super) const CLOSE: u8 = 8;
    pub(super) const PING: u8 = 9;
    pub(super) const PONG: u8 = 10;
}

/// What a client asks for in its first request.
#[derive(Debug, PartialEq, Eq)]
pub(super) struct Handshake {
    /// The answer to its key.
    pub(super) accept: String,
    /// The first of `spoken` that it speaks; `None` when it speaks none of them.
    pub(super) protocol: Option<&'static str>,
}

/// Reads a handshake; `None` from a request that is none.
pub(super) fn handshake(headers: &HeaderMap, spoken: &[&'static str]) -> Option<Handshake> {
    let words = |name| {
        let values = headers.get_all(name).into_iter();
        let texts = values.filter_map(|value| value.to_str().ok());
        texts.flat_map(|text| text.split(',').map(str::trim))
    };
    let wants = |name, word: &str| words(name).any(|one| one.eq_ignore_ascii_case(word));
    if !wants(UPGRADE, "websocket") || !wants(CONNECTION, "upgrade") {
        return None;
    }
    let key = headers.get(SEC_WEBSOCKET_KEY)?.to_str().ok()?;
    let mut sha1 = sha1_smol::Sha1::new();
    sha1.update(key.as_bytes());
    sha1.update(KEY_END.as_bytes());
    let offered = |protocol: &&&str| words(SEC_WEBSOCKET_PROTOCOL).any(|one| one == **protocol);
    Some(Handshake {
        accept: STANDARD.encode(sha1.digest().bytes()),
        protocol: spoken.iter().find(offered).copied(),
    })
}

/// What a client sends.
#[derive(Debug, PartialEq, Eq)]
pub(super) enum Heard {
    /// A text.
    Text(String),
    /// It asks for a sign of life, with these bytes.
    Ping(Bytes),
    /// It leaves.
    Close,
}

/// A frame of a client.
#[derive(Debug, PartialEq, Eq)]
struct Frame {
    is_last: bool,
    opcode: u8,
    payload: Bytes,
}

/// What a client has sent so far.
#[derive(Debug, Default)]
pub(super) struct Incoming {
    received: BytesMut,
    /// The parts of a message so far, and its opcode.
    parts: Option<(u8, Vec<u8>)>,
}

/// One connection.
#[derive(Debug)]
pub(super) struct Socket {
    io: TokioIo<Upgraded>,
    incoming: Incoming,
}

impl Incoming {
    /// What has arrived, as bytes.
    pub(super) fn of(bytes: &[u8]) -> Self {
        Self {
            received: bytes.into(),
            parts: None,
        }
    }

    /// What the client says next; `None` until more arrives.
    ///
    /// # Errors
    /// When the client breaks the protocol.
    pub(super) fn next(&mut self) -> io::Result<Option<Heard>> {
        while let Some(frame) = parse(&mut self.received)? {
            if let Some(heard) = self.take(frame)? {
                return Ok(Some(heard));
            }
        }
        Ok(None)
    }

    /// What a frame says; `None` when it is a part, or nothing for us.
    fn take(&mut self, frame: Frame) -> io::Result<Option<Heard>> {
        let (opcode, mut bytes) = match frame.opcode {
            opcode::PING => return Ok(Some(Heard::Ping(frame.payload))),
            opcode::CLOSE => return Ok(Some(Heard::Close)),
            opcode::PONG => return Ok(None),
            opcode::CONTINUATION => self.parts.take().ok_or_else(broken)?,
            opcode::TEXT | opcode::BINARY if self.parts.is_none() => (frame.opcode, Vec::new()),
            _ => return Err(broken()),
        };
        bytes.extend_from_slice(&frame.payload);
        if bytes.len() > MESSAGE_MAX {
            return Err(broken());
        }
        if !frame.is_last {
            self.parts = Some((opcode, bytes));
            return Ok(None);
        }
        // Clients publish nothing here, so binary is not read.
        let is_text = opcode == opcode::TEXT;
        let text = is_text.then(|| String::from_utf8(bytes).map(Heard::Text));
        text.transpose().map_err(|_| broken())
    }
}

impl Socket {
    pub(super) fn new(upgraded: Upgraded) -> Self {
        Self {
            io: TokioIo::new(upgraded),
            incoming: Incoming::default(),
        }
    }

    /// What the client sends next. Nothing is lost when the future is dropped.
    ///
    /// # Errors
    /// When the connection breaks, or the client breaks the protocol.
    pub(super) async fn hear(&mut self) -> io::Result<Heard> {
        loop {
            if let Some(heard) = self.incoming.next()? {
                return Ok(heard);
            }
            if self.io.read_buf(&mut self.incoming.received).await? == 0 {
                return Ok(Heard::Close);
            }
        }
    }

    /// Sends a text.
    ///
    /// # Errors
    /// When the connection breaks.
    pub(super) async fn text(&mut self, text: &str) -> io::Result<()> {
        self.send(opcode::TEXT, text.as_bytes()).await
    }

    /// Sends bytes.
    ///
    /// # Errors
    /// When the connection breaks.
    pub(super) async fn binary(&mut self, bytes: &[u8]) -> io::Result<()> {
        self.send(opcode::BINARY, bytes).await
    }

    /// Answers a ping.
    ///
    /// # Errors
    /// When the connection breaks.
    pub(super) async fn pong(&mut self, bytes: &[u8]) -> io::Result<()> {
        self.send(opcode::PONG, bytes).await
    }

    /// Says that this side leaves, too.
    ///
    /// # Errors
    /// When the connection breaks.
    pub(super) async fn close(&mut self) -> io::Result<()> {
        self.send(opcode::CLOSE, &[]).await
    }

    async fn send(&mut self, opcode: u8, payload: &[u8]) -> io::Result<()> {
        self.io.write_all(&head(opcode, payload.len())).await?;
        self.io.write_all(payload).await?;
        self.io.flush().await
    }
}

fn broken() -> io::Error {
    io::ErrorKind::InvalidData.into()
}

/// The head of a whole, unmasked frame.
fn head(opcode: u8, length: usize) -> Vec<u8> {
    let mut head = vec![0x80 | opcode];
    match length {
        0..126 => head.push(length as u8),
        126..0x1_0000 => {
            head.push(126);
            head.extend_from_slice(&(length as u16).to_be_bytes());
        }
        _ => {
            head.push(127);
            head.extend_from_slice(&(length as u64).to_be_bytes());
        }
    }
    head
}

/// Takes a client's frame off the received bytes; `None` until it is whole.
fn parse(received: &mut BytesMut) -> io::Result<Option<Frame>> {
    let Some(&[first, second]) = received.first_chunk() else {
        return Ok(None);
    };
    // Extensions are not agreed, and a client masks what it sends.
    if first & 0x70 != 0 || second & 0x80 == 0 {
        return Err(broken());
    }
    let (length_bytes, short) = match second & 0x7f {
        126 => (2, None),
        127 => (8, None),
        short => (0, Some(u64::from(short))),
    };
    let at = 2 + length_bytes;
    let Some(mask) = received.get(at..at + 4) else {
        return Ok(None);
    };
    let mask = [mask[0], mask[1], mask[2], mask[3]];
    let long = received[2..at].iter();
    let long = long.fold(0_u64, |sum, byte| sum << 8 | u64::from(*byte));
    let length = short.unwrap_or(long);
    // Before its bytes are waited for: nothing grows without limit.
    if length > MESSAGE_MAX as u64 {
        return Err(broken());
    }
    let length = length as usize;
    if received.len() < at + 4 + length {
        return Ok(None);
    }
    received.advance(at + 4);
    let mut payload = received.split_to(length);
    for (byte, mask) in payload.iter_mut().zip(mask.iter().cycle()) {
        *byte ^= mask;
    }
    Ok(Some(Frame {
        is_last: first & 0x80 != 0,
        opcode: first & 0x0f,
        payload: payload.freeze(),
    }))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The example of RFC 6455, section 1.3.
    #[test]
    fn the_handshake_is_that_of_the_rfc() {
        let mut headers = HeaderMap::new();
        let mut set = |name: &'static str, value: &'static str| {
            headers.insert(name, value.parse().expect("a value"));
        };
        set("upgrade", "websocket");
        set("sec-websocket-key", "dGhlIHNhbXBsZSBub25jZQ==");
        set("sec-websocket-protocol", "other, b");
        set("connection", "keep-alive, Upgrade");
        let expected = Handshake {
            accept: "s3pPLMBiTxaQ9kYGzzhZRbK+xOo=".into(),
            protocol: Some("b"),
        };
        assert_eq!(handshake(&headers, &["a", "b"]), Some(expected));
        headers.remove("sec-websocket-key");
        assert_eq!(handshake(&headers, &["a", "b"]), None);
    }

    /// The examples of RFC 6455, section 5.7.
    #[test]
    fn frames_are_those_of_the_rfc() {
        let hello = [
            0x81, 0x85, 0x37, 0xfa, 0x21, 0x3d, 0x7f, 0x9f, 0x4d, 0x51, 0x58,
        ];
        let mut received = BytesMut::new();
        for byte in hello {
            assert_eq!(parse(&mut received).expect("no error"), None);
            received.extend_from_slice(&[byte]);
        }
        let frame = parse(&mut received).expect("no error").expect("a frame");
        assert_eq!((frame.is_last, frame.opcode), (true, opcode::TEXT));
        assert_eq!(&frame.payload[..], b"Hello");
        assert!(received.is_empty());
        assert_eq!(head(opcode::TEXT, 5), [0x81, 0x05]);
        assert_eq!(head(opcode::BINARY, 256), [0x82, 126, 1, 0]);
        let expected = [0x82, 127, 0, 0, 0, 0, 0, 1, 0, 0];
        assert_eq!(head(opcode::BINARY, 1 << 16), expected);
    }

    #[test]
    fn what_breaks_the_protocol_is_an_error() {
        let refused = |bytes: &[u8]| parse(&mut BytesMut::from(bytes)).is_err();
        assert!(refused(&[0x81, 0x05]), "without a mask");
        assert!(refused(&[0xc1, 0x85]), "with an extension");
        let mut long = vec![0x81, 0xff];
        long.extend_from_slice(&(1_u64 << 40).to_be_bytes());
        long.extend_from_slice(&[0; 4]);
        assert!(refused(&long), "a terabyte");
    }
}
