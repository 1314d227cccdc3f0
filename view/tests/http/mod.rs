//! A page under test: the program, and a small HTTP client.

use std::io::{BufRead, BufReader, Read, Write};
use std::net::{SocketAddr, TcpStream};
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::time::Duration;

/// A running `vlaps-view`. It is told to end when it is dropped.
pub struct Page {
    child: Child,
    /// The address that it printed.
    pub url: String,
}

impl Page {
    /// Starts the program with these arguments, on any free port.
    pub fn start(program: &Path, folder: &Path, arguments: &[&str]) -> Self {
        let mut child = Command::new(program)
            .args(["view", "--port", "0"])
            .args(arguments)
            .current_dir(folder)
            .stdin(Stdio::null())
            .stdout(Stdio::piped())
            .spawn()
            .expect("the program starts");
        let mut lines = BufReader::new(child.stdout.take().expect("its output"));
        let mut url = String::new();
        lines.read_line(&mut url).expect("a line");
        assert!(url.starts_with("http://"), "{url}");
        // What it says later must find a reader.
        std::thread::spawn(move || lines.read_to_end(&mut Vec::new()));
        Self {
            child,
            url: url.trim().into(),
        }
    }

    /// Its process id.
    pub fn pid(&self) -> u32 {
        self.child.id()
    }

    /// Host and port, and the path below them.
    pub fn place(&self) -> (&str, &str) {
        let rest = self.url.strip_prefix("http://").expect("HTTP");
        rest.split_at(rest.find('/').expect("a path"))
    }

    /// Where it listens, on the loopback.
    pub fn address(&self) -> SocketAddr {
        let (host, _) = self.place();
        let port = host.rsplit(':').next().and_then(|port| port.parse().ok());
        SocketAddr::from(([127, 0, 0, 1], port.expect("a port")))
    }

    /// The answer to a path below the page.
    pub fn get(&self, path: &str) -> Answer {
        let (host, root) = self.place();
        self.ask(&format!("GET {root}{path} HTTP/1.1\r\nHost: {host}\r\n"))
    }

    /// As JSON.
    pub fn json(&self, path: &str) -> serde_json::Value {
        let answer = self.get(path);
        assert_eq!(answer.status, 200, "{path}: {}", answer.text());
        serde_json::from_slice(&answer.body).expect("JSON")
    }

    /// The answer to a request whose head lacks only its end.
    pub fn ask(&self, head: &str) -> Answer {
        let mut stream = TcpStream::connect(self.address()).expect("a connection");
        let head = format!("{head}Connection: close\r\n\r\n");
        let mut bytes = Vec::new();
        // A server that refuses may close before it has read all.
        let _ = stream.write_all(head.as_bytes());
        let _ = stream.read_to_end(&mut bytes);
        Answer::of(&bytes)
    }

    /// Follows the run, or all of them.
    pub fn follow(&self) -> Events {
        self.follow_below("")
    }

    /// Follows what is shown at a path below the page.
    pub fn follow_below(&self, below: &str) -> Events {
        let (host, root) = self.place();
        let mut stream = TcpStream::connect(self.address()).expect("a connection");
        let head = format!("GET {root}{below}stream HTTP/1.0\r\nHost: {host}\r\n\r\n");
        stream.write_all(head.as_bytes()).expect("a request");
        stream.set_read_timeout(Some(SILENCE)).expect("a timeout");
        Events {
            lines: BufReader::new(stream),
        }
    }
}

impl Drop for Page {
    fn drop(&mut self) {
        let _ = Command::new("kill")
            .arg(self.child.id().to_string())
            .status();
        let _ = self.child.wait();
    }
}

/// An answer.
pub struct Answer {
    /// 200 and so on; 0 without an answer.
    pub status: u16,
    /// The head, in small letters.
    pub head: String,
    /// The content.
    pub body: Vec<u8>,
}

impl Answer {
    fn of(bytes: &[u8]) -> Self {
        let end = bytes.windows(4).position(|four| four == b"\r\n\r\n");
        let (head, body) = bytes.split_at(end.map_or(bytes.len(), |end| end + 4));
        let head = String::from_utf8_lossy(head).to_lowercase();
        let status = head.split(' ').nth(1).and_then(|word| word.parse().ok());
        Self {
            status: status.unwrap_or(0),
            body: body.into(),
            head,
        }
    }

    /// The content as text.
    pub fn text(&self) -> String {
        String::from_utf8_lossy(&self.body).into_owned()
    }
}

/// Time without a byte after which a stream is given up; the server sends one every 5 s.
const SILENCE: Duration = Duration::from_secs(60);
/// Events without the wanted one after which a stream is given up: some minutes.
const EVENTS_MAX: usize = 10_000;

/// Server-sent events.
pub struct Events {
    lines: BufReader<TcpStream>,
}

impl Events {
    /// The next event: its name and its data; `None` at the end of the stream.
    pub fn next(&mut self) -> Option<(String, serde_json::Value)> {
        let mut name = String::new();
        loop {
            let mut line = String::new();
            if self.lines.read_line(&mut line).ok()? == 0 {
                return None;
            }
            if let Some(text) = line.strip_prefix("event: ") {
                name = text.trim().into();
            } else if let Some(text) = line.strip_prefix("data: ") {
                return Some((name, serde_json::from_str(text).expect("JSON")));
            }
        }
    }

    /// The data of the next event of this name that fits.
    pub fn until(
        &mut self,
        wanted: &str,
        fits: impl Fn(&serde_json::Value) -> bool,
    ) -> serde_json::Value {
        let mut last = None;
        for _ in 0..EVENTS_MAX {
            let (name, data) = self.next().expect("the stream goes on");
            if name == wanted && fits(&data) {
                return data;
            }
            last = Some((name, data));
        }
        panic!("no {wanted} that fits among {EVENTS_MAX} events; the last: {last:?}");
    }
}
