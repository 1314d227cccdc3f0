//! A small client of the protocol that Foxglove speaks.

use std::collections::BTreeMap;
use std::io::{BufRead, BufReader, ErrorKind, Read, Write};
use std::net::TcpStream;
use std::time::Duration;

use serde_json::Value;

/// A connection to a server.
pub struct Viewer {
    stream: BufReader<TcpStream>,
    /// Received bytes of a frame that is not whole.
    part: Vec<u8>,
    /// What the server says of itself.
    pub info: Value,
    /// Its channels, by topic.
    pub channels: BTreeMap<String, Value>,
}

/// A message: the subscription's number, epoch time in ns, and CDR.
pub type Data = (u32, u64, Vec<u8>);

impl Viewer {
    /// Connects; the HTTP status when the server refuses.
    pub fn connect(url: &str, headers: &[(&'static str, &str)]) -> Result<Self, u16> {
        let rest = url.strip_prefix("ws://").expect("a WebSocket");
        let (host, path) = rest.split_at(rest.find('/').expect("a path"));
        let port = host.rsplit(':').next().and_then(|port| port.parse().ok());
        let port: u16 = port.expect("a port");
        let mut stream = TcpStream::connect(("127.0.0.1", port)).expect("a connection");
        // The key and its answer are the example of RFC 6455.
        let mut head = format!(
            "GET {path} HTTP/1.1\r\nHost: {host}\r\nConnection: Upgrade\r\n\
             Upgrade: websocket\r\nSec-WebSocket-Version: 13\r\n\
             Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n\
             Sec-WebSocket-Protocol: foxglove.websocket.v1\r\n"
        );
        for (name, value) in headers {
            head += &format!("{name}: {value}\r\n");
        }
        stream.write_all((head + "\r\n").as_bytes()).expect("sent");
        let mut stream = BufReader::new(stream);
        let mut lines = Vec::new();
        loop {
            let mut line = String::new();
            stream.read_line(&mut line).expect("a line");
            match line.trim() {
                "" => break,
                line => lines.push(line.to_lowercase()),
            }
        }
        let status = lines[0]
            .split(' ')
            .nth(1)
            .and_then(|word| word.parse().ok());
        let status: u16 = status.expect("a status");
        if status != 101 {
            return Err(status);
        }
        for line in [
            "sec-websocket-accept: s3pplmbitxaq9kygzzhzrbk+xoo=",
            "sec-websocket-protocol: foxglove.websocket.v1",
        ] {
            assert!(lines.iter().any(|there| there == line), "{lines:?}");
        }
        let mut viewer = Self {
            stream,
            part: Vec::new(),
            info: Value::Null,
            channels: BTreeMap::new(),
        };
        viewer.info = viewer.text();
        assert_eq!(viewer.info["op"], "serverInfo");
        let advertised = viewer.text();
        assert_eq!(advertised["op"], "advertise");
        for channel in advertised["channels"].as_array().expect("channels") {
            let topic = channel["topic"].as_str().expect("a topic");
            viewer.channels.insert(topic.into(), channel.clone());
        }
        Ok(viewer)
    }

    /// The next frame: opcode and content; `None` when none comes in time.
    fn frame(&mut self) -> Option<(u8, Vec<u8>)> {
        loop {
            if let Some((opcode, from, to)) = whole(&self.part) {
                let payload = self.part[from..to].to_vec();
                self.part.drain(..to);
                return Some((opcode, payload));
            }
            let mut bytes = [0; 16 << 10];
            match self.stream.read(&mut bytes) {
                Ok(0) => panic!("the server has closed"),
                Ok(count) => self.part.extend_from_slice(&bytes[..count]),
                Err(error) => {
                    let kinds = [ErrorKind::WouldBlock, ErrorKind::TimedOut];
                    assert!(kinds.contains(&error.kind()), "{error}");
                    return None;
                }
            }
        }
    }

    /// The next text.
    pub fn text(&mut self) -> Value {
        loop {
            let (opcode, payload) = self.frame().expect("a message");
            if opcode == 1 {
                return serde_json::from_slice(&payload).expect("JSON");
            }
        }
    }

    /// Sends a request.
    pub fn ask(&mut self, request: &Value) {
        let text = request.to_string();
        // Masked with zeros, which change nothing; its length has two bytes.
        let mut frame = vec![0x81, 0x80 | 126];
        frame.extend_from_slice(&(text.len() as u16).to_be_bytes());
        frame.extend_from_slice(&[0; 4]);
        frame.extend_from_slice(text.as_bytes());
        self.stream.get_mut().write_all(&frame).expect("sent");
    }

    /// Subscribes to a topic under this number.
    pub fn subscribe(&mut self, id: u32, topic: &str) {
        let channel = self.channels[topic]["id"].clone();
        let subscriptions = [serde_json::json!({"id": id, "channelId": channel})];
        self.ask(&serde_json::json!({"op": "subscribe", "subscriptions": subscriptions}));
    }

    /// How long to wait for a message; then there is none.
    pub fn patience(&mut self, patience: Duration) {
        let stream = self.stream.get_ref();
        stream.set_read_timeout(Some(patience)).expect("a time");
    }

    /// The next message; `None` when none comes in time.
    pub fn data(&mut self) -> Option<Data> {
        loop {
            let (opcode, bytes) = self.frame()?;
            if opcode == 2 {
                assert_eq!(bytes[0], 1, "message data");
                let (id, rest) = bytes[1..].split_first_chunk().expect("a number");
                let (time, cdr) = rest.split_first_chunk().expect("a time");
                let (id, time) = (u32::from_le_bytes(*id), u64::from_le_bytes(*time));
                return Some((id, time, cdr.to_vec()));
            }
        }
    }
}

/// Opcode, and begin and end of the content, of the whole frame at the beginning.
fn whole(bytes: &[u8]) -> Option<(u8, usize, usize)> {
    let (first, second) = (*bytes.first()?, *bytes.get(1)?);
    assert_eq!(first & 0xf0, 0x80, "whole messages");
    let (from, length) = match second {
        126 => (
            4,
            u64::from(u16::from_be_bytes(*bytes.get(2..)?.first_chunk()?)),
        ),
        127 => (10, u64::from_be_bytes(*bytes.get(2..)?.first_chunk()?)),
        short => (2, u64::from(short)),
    };
    let to = from + length as usize;
    (bytes.len() >= to).then_some((first & 0x0f, from, to))
}

/// Reads CDR field by field.
pub struct Cdr<'a> {
    bytes: &'a [u8],
    at: usize,
}

impl<'a> Cdr<'a> {
    /// Behind the encapsulation of little-endian CDR.
    pub fn new(cdr: &'a [u8]) -> Self {
        let bytes = cdr.strip_prefix(&[0, 1, 0, 0]).expect("CDR");
        Self { bytes, at: 0 }
    }

    fn take<const N: usize>(&mut self) -> [u8; N] {
        self.at = self.at.next_multiple_of(N);
        let taken = self.bytes[self.at..self.at + N].try_into().expect("bytes");
        self.at += N;
        taken
    }

    /// A number of 32 bits.
    pub fn u32(&mut self) -> u32 {
        u32::from_le_bytes(self.take())
    }

    /// A number of 64 bits.
    pub fn f64(&mut self) -> f64 {
        f64::from_le_bytes(self.take())
    }

    /// A string.
    pub fn string(&mut self) -> String {
        let length = self.u32() as usize;
        let text = &self.bytes[self.at..self.at + length - 1];
        self.at += length;
        String::from_utf8(text.to_vec()).expect("UTF-8")
    }
}

/// Position, heading and frame of a `geometry_msgs/PoseStamped`.
pub fn pose(cdr: &[u8]) -> ([f64; 2], f64, String) {
    let mut cdr = Cdr::new(cdr);
    let _stamp = (cdr.u32(), cdr.u32());
    let frame = cdr.string();
    let [x, y, _] = [(); 3].map(|()| cdr.f64());
    let [_, _, sin, cos] = [(); 4].map(|()| cdr.f64());
    ([x, y], 2.0 * sin.atan2(cos), frame)
}
