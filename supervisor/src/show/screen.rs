//! Output of a running set from a thread of its own: a terminal that accepts no more text
//! (Ctrl-S, a full pipe) must not block the supervision loop. Output that does not fit into
//! the queue meanwhile is dropped.

use std::io::{self, IsTerminal};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::thread::{self, JoinHandle};

use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use rustix::event::{PollFd, PollFlags, poll};
use rustix::time::Timespec;

use shm_config::text::printable_lines;

use crate::cli::print::say;
use crate::show::layout::{columns, cut, split};
use crate::show::view::View;

/// Lines and views that may wait for the terminal.
const QUEUE: usize = 64;
/// Views between two plain lines: the loop shows five a second.
const PLAIN_EVERY: u32 = 5;
/// The bar's length; one part is 0.1 % of the route.
const BAR_PARTS: u64 = 1000;
/// The reason that ends a run whose output has lost its reader.
///
/// A program that writes into a broken pipe dies of SIGPIPE, and a user of
/// `./vlaps up | head` expects that the run ends. Dying immediately would leave the car to
/// the world's brake and lose the summary, so the run stops in order, with the exit code of
/// a run that was given up. Output to `/dev/null` does not end a run.
pub const UNREAD: &str = "its output is a pipe without a reader; the car is braked to a \
                          stand; for a run without a reader, `./vlaps up > up.log`";

enum Note {
    Line(String),
    View(Box<View>),
}

/// The output of a running set.
#[derive(Debug)]
pub struct Screen {
    notes: SyncSender<Note>,
    thread: JoinHandle<()>,
    unread: Arc<AtomicBool>,
}

impl Screen {
    /// A live block when stdout is a terminal, else plain lines.
    pub fn open() -> Self {
        let (notes, inbox) = sync_channel(QUEUE);
        let unread = Arc::new(AtomicBool::new(false));
        let told = unread.clone();
        let thread = match io::stdout().is_terminal() {
            true => thread::spawn(move || draw(&inbox)),
            false => thread::spawn(move || print(&inbox, &told)),
        };
        Self {
            notes,
            thread,
            unread,
        }
    }

    /// Whether the reader of the output has ended.
    pub fn is_unread(&self) -> bool {
        self.unread.load(Ordering::Relaxed)
    }

    /// Prints a line.
    pub fn line(&self, text: impl Into<String>) {
        let _ = self.notes.try_send(Note::Line(text.into()));
    }

    /// Shows a view of the run.
    pub fn show(&self, view: View) {
        let _ = self.notes.try_send(Note::View(Box::new(view)));
    }

    /// Removes the live block and waits until all output is written.
    pub fn close(self) {
        drop(self.notes);
        // A panic of the drawing thread has already been printed.
        let _ = self.thread.join();
    }
}

fn draw(inbox: &Receiver<Note>) {
    let bar = ProgressBar::with_draw_target(Some(BAR_PARTS), ProgressDrawTarget::stdout());
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
                let columns = columns();
                let message = format!("{:>3.0} %; {}", completion * 100.0, view.outcome_line());
                let (bar_columns, message_columns) = split(columns);
                // The template is made of numbers; without it the default style would do.
                let template = format!("{{prefix}}\n  [{{bar:{bar_columns}}}] {{msg}}");
                if let Ok(style) = ProgressStyle::with_template(&template) {
                    bar.set_style(style.progress_chars("=> "));
                }
                bar.set_prefix(cut(&printable_lines(&text), columns));
                bar.set_message(cut(&message, message_columns));
                bar.set_position((completion.clamp(0.0, 1.0) * BAR_PARTS as f64) as u64);
            }
        }
    }
    bar.finish_and_clear();
}

/// Whether standard output is a pipe whose reading end is closed.
fn reader_has_gone() -> bool {
    let stdout = io::stdout();
    let mut look = [PollFd::new(&stdout, PollFlags::empty())];
    let now = Timespec {
        tv_sec: 0,
        tv_nsec: 0,
    };
    poll(&mut look, Some(&now)).is_ok() && look[0].revents().contains(PollFlags::ERR)
}

fn print(inbox: &Receiver<Note>, unread: &AtomicBool) {
    let mut last = String::new();
    let mut views = 0;
    for note in inbox {
        if reader_has_gone() {
            unread.store(true, Ordering::Relaxed);
        }
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
