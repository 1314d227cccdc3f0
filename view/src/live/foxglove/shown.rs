//! Puts what the reader of a run has read on the board.

use std::path::Path;
use std::sync::Arc;
use std::time::SystemTime;

use recorder::schema::ENCAPSULATION;
use recorder::standard::{Standard, Topic};
use shm_config::config::Config;
use shm_config::file::read_ours;
use shm_config::layout::Layout as _;
use shm_config::message::{Health, Step};
use shm_config::services::Process;

use super::board::Board;
use crate::live::status::Question;

/// As often as the reader reads.
const RATE_HZ: f64 = 20.0;
/// Longest picture that is sent, bytes: one of the largest frame without compression.
const PICTURE_BYTES_MAX: u64 = 8 << 20;

/// Makes the messages of one run for the board.
#[derive(Debug)]
pub struct Shown {
    board: Arc<Board>,
    config: Config,
    /// With the time offset of the first step; `None` before it.
    made: Option<(Standard, u64)>,
    healths: Vec<(Process, Health)>,
    question: Option<u64>,
    cdr: Vec<u8>,
}

impl Shown {
    /// For a run with this configuration.
    pub fn new(board: Arc<Board>, config: &Config) -> Self {
        Self {
            board,
            config: config.clone(),
            made: None,
            healths: Vec::new(),
            question: None,
            cdr: Vec::new(),
        }
    }

    /// Notes the health of a process.
    pub fn note(&mut self, process: Process, health: &Health) {
        self.healths.retain(|(of, _)| *of != process);
        self.healths.push((process, *health));
    }

    /// Shows a step, if any client is there.
    pub fn step(&mut self, step: &Step) {
        if !self.board.is_watched() {
            return;
        }
        let taken_ns = step.header.taken_ns;
        let config = &self.config;
        let (standard, offset_ns) = self.made.get_or_insert_with(|| {
            // The step is at most one look old, and a viewer needs no more than that.
            let offset_ns = epoch_ns().saturating_sub(taken_ns);
            (Standard::new(config, offset_ns, RATE_HZ), offset_ns)
        });
        let epoch_ns = taken_ns.saturating_add(*offset_ns);
        for (process, health) in self.healths.drain(..) {
            standard.note(process, &health);
        }
        let board = &self.board;
        standard.step(step, &mut |topic, cdr| {
            board.put(Board::place(topic), epoch_ns, cdr);
        });
        self.cdr.clear();
        self.cdr.extend_from_slice(&ENCAPSULATION);
        self.cdr.extend_from_slice(step.as_bytes());
        board.put(board.steps(), epoch_ns, &self.cdr);
        board.wake();
    }

    /// Shows the picture of the judge's last question, once.
    pub fn question(&mut self, question: &Question, pictures: &Path) {
        let (true, Some((standard, offset_ns))) = (self.board.is_watched(), &mut self.made) else {
            return;
        };
        if self.question.replace(question.number) == Some(question.number) {
            return;
        }
        let Some(name) = question.pictures.first() else {
            return;
        };
        // A picture that is not there yet or any more is not shown.
        let Ok(bytes) = read_ours(&pictures.join(name), PICTURE_BYTES_MAX) else {
            return;
        };
        let format = match bytes.starts_with(b"\x89PNG") {
            true => "png",
            false => "jpeg",
        };
        let now_ns = epoch_ns();
        let board = &self.board;
        let taken_ns = now_ns.saturating_sub(*offset_ns);
        standard.picture(taken_ns, (format, &bytes), &mut |topic: Topic, cdr| {
            board.put(Board::place(topic), now_ns, cdr);
        });
        board.wake();
    }
}

/// Epoch time, ns.
#[allow(clippy::disallowed_methods)] // viewers want the machine's date, which no caller has
fn epoch_ns() -> u64 {
    let since = SystemTime::now().duration_since(SystemTime::UNIX_EPOCH);
    since.map_or(0, |since| since.as_nanos() as u64)
}
