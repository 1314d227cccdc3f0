//! Output of a running set, from a thread of its own: a terminal that takes no
//! more text (Ctrl-S, a full pipe) must not hold the loop that restarts
//! processes. What does not fit into the queue meanwhile is dropped.

use std::io::{self, IsTerminal, Write};
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::thread::{self, JoinHandle};

use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};

use shm_config::text::printable_lines;

use crate::live::View;

/// Lines and views that may wait for the terminal.
const QUEUE: usize = 64;
/// Views between two plain lines: the loop shows five a second.
const PLAIN_EVERY: u32 = 5;
/// The bar's length; one part is 0.1 % of the route.
const BAR_PARTS: u64 = 1000;

enum Note {
    Line(String),
    View(Box<View>),
}

/// Where a running set shows how it does.
#[derive(Debug)]
pub struct Screen {
    notes: SyncSender<Note>,
    thread: JoinHandle<()>,
}

impl Screen {
    /// A live block when stdout is a terminal, else plain lines.
    pub fn open() -> Self {
        let (notes, inbox) = sync_channel(QUEUE);
        let thread = match io::stdout().is_terminal() {
            true => thread::spawn(move || draw(&inbox)),
            false => thread::spawn(move || print(&inbox)),
        };
        Self { notes, thread }
    }

    /// Shows a line that stays.
    pub fn line(&self, text: impl Into<String>) {
        let _ = self.notes.try_send(Note::Line(text.into()));
    }

    /// Shows how the run does now.
    pub fn show(&self, view: View) {
        let _ = self.notes.try_send(Note::View(Box::new(view)));
    }

    /// Takes the live block away and waits until all is written.
    pub fn close(self) {
        drop(self.notes);
        // A panic of the drawing thread has been printed by itself.
        let _ = self.thread.join();
    }
}

/// Writes text; a reader that has gone away is no reason to fail.
pub fn say(text: impl std::fmt::Display) {
    let mut out = io::stdout().lock();
    let _ = writeln!(out, "{}", printable_lines(&text.to_string()));
    let _ = out.flush();
}

fn draw(inbox: &Receiver<Note>) {
    let bar = ProgressBar::with_draw_target(Some(BAR_PARTS), ProgressDrawTarget::stdout());
    // The template is a constant; without it the default style would do.
    if let Ok(style) = ProgressStyle::with_template("{prefix}\n  [{bar:40}] {msg}") {
        bar.set_style(style.progress_chars("=> "));
    }
    for note in inbox {
        match note {
            Note::Line(text) => bar.println(printable_lines(&text)),
            Note::View(view) => {
                let completion = view.episode.map_or(0.0, |episode| episode.completion);
                let mut text = format!(
                    "{}\n{}\n  {}",
                    view.headline(),
                    view.table(),
                    view.drive_line()
                );
                if let Some(help) = &view.help {
                    text.push_str("\n  ");
                    text.push_str(help);
                }
                bar.set_prefix(cut(&printable_lines(&text), columns()));
                bar.set_message(format!(
                    "{:>3.0} %; {}",
                    completion * 100.0,
                    view.outcome_line()
                ));
                bar.set_position((completion.clamp(0.0, 1.0) * BAR_PARTS as f64) as u64);
            }
        }
    }
    bar.finish_and_clear();
}

/// Columns of the terminal; 80 when nobody knows.
fn columns() -> usize {
    match rustix::termios::tcgetwinsize(io::stdout()) {
        Ok(size) if size.ws_col > 0 => usize::from(size.ws_col),
        _ => 80,
    }
}

/// Every line cut to the terminal: a wrapped line would not be redrawn in place.
fn cut(text: &str, columns: usize) -> String {
    let lines = text
        .lines()
        .map(|line| line.chars().take(columns).collect());
    lines.collect::<Vec<String>>().join("\n")
}

fn print(inbox: &Receiver<Note>) {
    let mut last = String::new();
    let mut views = 0;
    for note in inbox {
        match note {
            Note::Line(text) => say(text),
            Note::View(view) => {
                if views % PLAIN_EVERY == 0 && view.episode.is_some() {
                    let line = view.plain_line();
                    if line != last {
                        say(&line);
                        last = line;
                    }
                }
                views += 1;
            }
        }
    }
}
