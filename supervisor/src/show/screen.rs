//! Output of a running set, from a thread of its own: a terminal that takes no
//! more text (Ctrl-S, a full pipe) must not hold the loop that restarts
//! processes. What does not fit into the queue meanwhile is dropped.

use std::io::{self, IsTerminal, Write};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::thread::{self, JoinHandle};

use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use rustix::event::{PollFd, PollFlags, poll};
use rustix::time::Timespec;

use shm_config::text::printable_lines;

use crate::show::view::View;

/// Lines and views that may wait for the terminal.
const QUEUE: usize = 64;
/// Views between two plain lines: the loop shows five a second.
const PLAIN_EVERY: u32 = 5;
/// The bar's length; one part is 0.1 % of the route.
const BAR_PARTS: u64 = 1000;
/// Columns of the bar on a wide terminal, and what stands around it.
const BAR_COLUMNS: usize = 40;
const AROUND_COLUMNS: usize = "  [] ".len();
/// A narrower terminal is written to as if it had these.
const COLUMNS_MIN: usize = 20;

/// Why a run ends whose output nothing reads any more.
///
/// A program that writes on into a broken pipe dies of SIGPIPE; a user who types
/// `./vlaps up | head` expects that the car does not drive on unseen. To die at once
/// would leave it to the world's brake and lose the summary, so it is an orderly stop,
/// with the exit code of a run that was given up. Without any reader from the begin on
/// (`> /dev/null`) it drives.
pub const UNREAD: &str = "its output is a pipe that nothing reads any more; the car is braked to a \
                          stand; for a run that nothing reads, `./vlaps up > up.log`";

enum Note {
    Line(String),
    View(Box<View>),
}

/// Where a running set shows how it does.
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

    /// The reader of what is printed has gone away.
    pub fn is_unread(&self) -> bool {
        self.unread.load(Ordering::Relaxed)
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

/// The same; on a terminal, lines that are too long for it are continued on the next.
pub fn say_fitted(text: &str) {
    match io::stdout().is_terminal() {
        true => say(wrapped(text, columns())),
        false => say(text),
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

/// Columns of the terminal; 80 when nobody knows.
fn columns() -> usize {
    match rustix::termios::tcgetwinsize(io::stdout()) {
        Ok(size) if size.ws_col > 0 => usize::from(size.ws_col).max(COLUMNS_MIN),
        _ => 80,
    }
}

/// Columns of the bar, and of the words behind it, on a terminal of so many.
fn split(columns: usize) -> (usize, usize) {
    let bar = (columns / 3).min(BAR_COLUMNS);
    (bar, columns.saturating_sub(bar + AROUND_COLUMNS))
}

/// Every line cut to the terminal: a wrapped line would not be redrawn in place.
fn cut(text: &str, columns: usize) -> String {
    let lines = text
        .lines()
        .map(|line| match line.chars().count() > columns {
            true => line
                .chars()
                .take(columns.saturating_sub(1))
                .chain(['…'])
                .collect(),
            false => line.into(),
        });
    lines.collect::<Vec<String>>().join("\n")
}

/// Every line broken between words where it is too long; what follows stands four
/// columns further in than its begin.
fn wrapped(text: &str, columns: usize) -> String {
    let mut lines = Vec::new();
    for line in text.lines() {
        let indent = line.len() - line.trim_start().len();
        let further = " ".repeat((indent + 4).min(columns / 2));
        let mut left = line.to_string();
        while left.chars().count() > columns {
            let begin = left.len() - left.trim_start().len();
            let letters = || left.char_indices().take(columns + 1);
            let spaces = letters().filter(|(place, letter)| *letter == ' ' && *place > begin);
            // A word that is longer than the line is broken where the line ends.
            let end = spaces.last().or_else(|| letters().last());
            let rest = left.split_off(end.map_or(left.len(), |(place, _)| place));
            lines.push(left.trim_end().to_string());
            left = format!("{further}{}", rest.trim_start());
        }
        lines.push(left);
    }
    lines.join("\n")
}

/// Standard output is a pipe whose reader has gone.
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_line_of_the_live_block_is_wider_than_the_terminal() {
        let message = "  6 %; no episode finished yet";
        for columns in COLUMNS_MIN..200 {
            let (bar, words) = split(columns);
            let line = format!("  [{}] {}", "=".repeat(bar), cut(message, words));
            assert!(line.chars().count() <= columns, "{columns}: {line}");
        }
        assert_eq!(split(80).0 + split(100).0, 26 + 33);
        assert_eq!(split(120).0, BAR_COLUMNS);
        let (_, words) = split(60);
        assert_eq!(cut(message, words), message, "60 columns hold it all");
        assert_eq!(cut("äöü\nlonger", 4), "äöü\nlon…");
    }

    #[test]
    fn a_summary_on_a_narrow_terminal_is_broken_between_words() {
        let text = "  expert: unloaded 716, vetoed 12, expired 3\nshort";
        let told = wrapped(text, 24);
        assert_eq!(
            told,
            "  expert: unloaded 716,\n      vetoed 12, expired\n      3\nshort"
        );
        let digest = "f".repeat(64);
        for columns in COLUMNS_MIN..90 {
            let told = wrapped(&format!("command digest {digest}, größer"), columns);
            let widest = told.lines().map(|line| line.chars().count()).max();
            assert!(widest <= Some(columns), "{columns}: {told}");
            let letters = |text: &str| text.chars().filter(|c| !c.is_whitespace()).count();
            assert_eq!(letters(&told), 15 - 2 + 64 + 1 + 6);
        }
        assert_eq!(wrapped("\na\n\nb", 80), "\na\n\nb");
    }
}
