//! A server that always refuses, with text that acts on a terminal, and records the
//! keys that it receives.

use std::fs;
use std::io::{BufRead as _, BufReader, Read as _, Write as _};
use std::net::{TcpListener, TcpStream};
use std::path::{Path, PathBuf};
use std::process::Output;
use std::sync::{Arc, Mutex};
use std::thread;

use serde_json::json;

pub const KEY: &str = "sk-test-4f1d77-never-to-be-seen";

/// An escape sequence, one of C1, an override and an isolate of direction, zero-width
/// characters.
pub const HOSTILE: &str =
    "red\u{1b}[31m c1\u{9b}2J rlo\u{202e} lri\u{2066} zero\u{200b}\u{feff}width";
pub const RAW: [char; 6] = [
    '\u{1b}', '\u{9b}', '\u{202e}', '\u{2066}', '\u{200b}', '\u{feff}',
];

pub fn is_raw(text: &str) -> bool {
    text.contains(RAW)
}

/// A policy trained for 9,800 steps, whose proposals the judge compares.
pub fn policy() -> String {
    let file = "../results/learning/ppl-10000.onnx";
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join(file);
    path.display().to_string()
}

/// How a server answers a request with this `Authorization`.
pub type Answer = fn(&str) -> (&'static str, String);

/// A server that records the keys that it receives.
pub struct Server {
    /// The value of `vlm.server`.
    pub url: String,
    sent: Arc<Mutex<Vec<String>>>,
}

impl Server {
    pub fn start(answer: Answer) -> Self {
        let listener = TcpListener::bind("127.0.0.1:0").expect("a port");
        let address = listener.local_addr().expect("an address");
        let sent = Arc::new(Mutex::new(Vec::new()));
        let keep = sent.clone();
        thread::spawn(move || {
            for stream in listener.incoming().flatten() {
                let keep = keep.clone();
                // A connection that closes within a request is ignored.
                thread::spawn(move || serve(stream, answer, &keep));
            }
        });
        Self {
            url: format!("http://{address}/v1"),
            sent,
        }
    }

    pub fn was_sent(&self, key: &str) -> usize {
        let sent = self.sent.lock().expect("whole");
        sent.iter().filter(|one| one.contains(key)).count()
    }
}

fn serve(stream: TcpStream, answer: Answer, keep: &Mutex<Vec<String>>) -> Option<()> {
    let mut reader = BufReader::new(stream.try_clone().ok()?);
    let (mut authorization, mut length) = (String::new(), 0);
    loop {
        let mut line = String::new();
        reader
            .read_line(&mut line)
            .ok()
            .filter(|bytes| *bytes > 0)?;
        let Some((name, value)) = line.trim_end().split_once(": ") else {
            if line.trim_end().is_empty() {
                break;
            }
            continue;
        };
        match name.to_ascii_lowercase().as_str() {
            "authorization" => authorization = value.into(),
            "content-length" => length = value.parse().ok()?,
            _ => {}
        }
    }
    let mut body = vec![0; length];
    reader.read_exact(&mut body).ok()?;
    let (status, text) = answer(&authorization);
    keep.lock().ok()?.push(authorization);
    let head = format!(
        "HTTP/1.1 {status}\r\ncontent-type: application/json\r\ncontent-length: {}\r\n\
         connection: close\r\n\r\n",
        text.len()
    );
    let mut stream = stream;
    stream.write_all(head.as_bytes()).ok()?;
    stream.write_all(text.as_bytes()).ok()
}

/// Always refuses, and repeats the key within text that acts on a terminal.
pub fn refuses(authorization: &str) -> (&'static str, String) {
    let message = format!("{HOSTILE}: incorrect key: {authorization}");
    let body = json!({"error": {"message": message, "code": "invalid_api_key"}});
    ("401 Unauthorized", body.to_string())
}

pub fn files_below(folder: &Path) -> Vec<PathBuf> {
    let entries = fs::read_dir(folder).into_iter().flatten().flatten();
    let mut files = Vec::new();
    for path in entries.map(|entry| entry.path()) {
        match path.is_dir() {
            true => files.extend(files_below(&path)),
            false => files.push(path),
        }
    }
    files
}

pub fn said(output: &Output) -> String {
    let parts = [&output.stdout, &output.stderr];
    parts
        .map(|part| String::from_utf8_lossy(part).into_owned())
        .concat()
}
