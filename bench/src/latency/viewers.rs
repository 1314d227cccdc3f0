//! The page of a row, and the browsers that show it.

use std::io::{Read, Write};
use std::net::{SocketAddr, TcpStream};
use std::path::Path;
use std::process::{Child, Stdio};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::thread::JoinHandle;
use std::time::Duration;

use anyhow::{Context, bail};
use serde_json::Value;
use shm_config::time::Clock;

use super::beside;
use supervisor::machine::signals::pause;

/// Time limit for the page to answer, ns.
const START_NS: u64 = 20_000_000_000;
/// Between two looks for it.
const LOOK: Duration = Duration::from_millis(20);
/// How long a browser waits for news before it looks whether the row is over.
const PATIENCE: Duration = Duration::from_millis(500);
/// Bytes that the stalled browser's kernel takes before its page is stalled, too.
const STALLED_BUFFER: usize = 4096;

/// Who looks at a row's set.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Viewers {
    /// No page.
    Absent,
    /// The page with one browser.
    One,
    /// The page with ten browsers, one of which reads nothing.
    Ten,
}

impl Viewers {
    /// Browsers that read, and those that do not.
    fn counts(self) -> (usize, usize) {
        match self {
            Self::Absent => (0, 0),
            Self::One => (1, 0),
            Self::Ten => (9, 1),
        }
    }
}

/// The page of a row with its browsers. It ends when it is dropped.
pub struct RowPage {
    page: Child,
    stop: Arc<AtomicBool>,
    read: Arc<AtomicU64>,
    browsers: Vec<JoinHandle<()>>,
    stalled: Vec<TcpStream>,
}

impl RowPage {
    /// Starts the page of a run; `None` without viewers.
    ///
    /// # Errors
    /// If the page does not start or does not answer.
    pub fn start(
        viewers: Viewers,
        (run, folder): (&str, &Path),
        clock: Clock,
    ) -> anyhow::Result<Option<Self>> {
        if viewers == Viewers::Absent {
            return Ok(None);
        }
        let told = folder.join(format!("{run}-view.json"));
        let program = std::env::current_exe()?.with_file_name("vlaps-view");
        let mut command = beside(&program.to_string_lossy());
        command
            .args(["view", "--port", "0", "--run", run, "--json"])
            .arg(&told);
        let command = command.stdin(Stdio::null()).stdout(Stdio::null());
        let page = command.spawn().context("vlaps-view")?;
        let mut row = Self {
            page,
            stop: Arc::default(),
            read: Arc::default(),
            browsers: Vec::new(),
            stalled: Vec::new(),
        };
        let address = row.address(&told, clock)?;
        let (reading, stalled) = viewers.counts();
        for _ in 0..reading {
            let stream = request(address)?;
            let (stop, read) = (row.stop.clone(), row.read.clone());
            let browser = std::thread::spawn(move || follow(stream, &stop, &read));
            row.browsers.push(browser);
        }
        for _ in 0..stalled {
            let stream = request(address)?;
            rustix::net::sockopt::set_socket_recv_buffer_size(&stream, STALLED_BUFFER)?;
            row.stalled.push(stream);
        }
        Ok(Some(row))
    }

    /// Where the page listens, as soon as it says so.
    fn address(&mut self, told: &Path, clock: Clock) -> anyhow::Result<SocketAddr> {
        let until = clock().after_ns(START_NS);
        loop {
            let text = std::fs::read_to_string(told).unwrap_or_default();
            let value: Value = serde_json::from_str(&text).unwrap_or_default();
            let url = value["url"].as_str().unwrap_or_default();
            let host = url.trim_start_matches("http://").trim_end_matches('/');
            if let Ok(address) = host.parse() {
                return Ok(address);
            }
            if let Some(status) = self.page.try_wait()? {
                bail!("the page ended: {status}");
            }
            if clock() > until {
                bail!("the page does not start");
            }
            pause(LOOK);
        }
    }

    /// Ends the page, and returns the bytes that its browsers have read.
    ///
    /// # Errors
    /// If no browser has read anything, or the page has ended before.
    pub fn finish(mut self) -> anyhow::Result<u64> {
        if let Some(status) = self.page.try_wait()? {
            bail!("the page ended during the row: {status}");
        }
        self.stop();
        match self.read.load(Ordering::Relaxed) {
            0 => bail!("the page sent nothing"),
            bytes => Ok(bytes),
        }
    }

    fn stop(&mut self) {
        self.stop.store(true, Ordering::Relaxed);
        if let Ok(None) = self.page.try_wait() {
            // Ours, and not waited for yet: the id is its own.
            let pid = rustix::process::Pid::from_child(&self.page);
            let _ = rustix::process::kill_process(pid, rustix::process::Signal::TERM);
            let _ = self.page.wait();
        }
        for browser in self.browsers.drain(..) {
            // It panicked, and said so.
            let _ = browser.join();
        }
        self.stalled.clear();
    }
}

impl Drop for RowPage {
    fn drop(&mut self) {
        self.stop();
    }
}

/// Asks for the news of the run.
fn request(address: SocketAddr) -> anyhow::Result<TcpStream> {
    let mut stream = TcpStream::connect(address).context("the page does not answer")?;
    let head = format!("GET /stream HTTP/1.1\r\nHost: {address}\r\n\r\n");
    stream.write_all(head.as_bytes())?;
    stream.set_read_timeout(Some(PATIENCE))?;
    Ok(stream)
}

/// Reads all news until the row is over, as a browser does.
fn follow(mut stream: TcpStream, stop: &AtomicBool, read: &AtomicU64) {
    let mut bytes = vec![0; 64 << 10];
    while !stop.load(Ordering::Relaxed) {
        match stream.read(&mut bytes) {
            Ok(0) => return,
            Ok(count) => {
                read.fetch_add(count as u64, Ordering::Relaxed);
            }
            // Nothing new yet.
            Err(_) => {}
        }
    }
}
