//! How far a training is: a bar in a terminal, a line for each block elsewhere.

use std::fmt;
use std::io::{IsTerminal, Write};
use std::time::Duration;

use indicatif::{HumanDuration, ProgressBar, ProgressState, ProgressStyle};
use shm_config::Instant;

use stack::Clock;

/// From frame to frame of the bar.
const FRAME: Duration = Duration::from_millis(200);

/// How far it is, on standard error.
pub struct Progress {
    bar: Option<ProgressBar>,
    name: String,
    unit: &'static str,
    total: u64,
    clock: Clock,
    begun: Instant,
    /// What was done before it began says nothing about how fast it goes.
    first: u64,
    said: u64,
    note: String,
}

impl Progress {
    /// Of something with a name that has come this far already.
    ///
    /// # Errors
    /// When the bar's template is wrong.
    pub fn begin(
        name: String,
        unit: &'static str,
        (first, total): (u64, u64),
        clock: Clock,
    ) -> anyhow::Result<Progress> {
        let bar = match std::io::stderr().is_terminal() {
            false => None,
            true => {
                let bar = ProgressBar::new(total);
                let style = format!(
                    "{{prefix}}  {{elapsed_precise}} {{wide_bar}} {{pos}}/{{len}} {unit}, {{left}}  {{msg}}"
                );
                bar.set_style(ProgressStyle::with_template(&style)?.with_key("left", left(first)));
                bar.set_prefix(name.clone());
                bar.enable_steady_tick(FRAME);
                bar.set_position(first);
                bar.reset_eta();
                Some(bar)
            }
        };
        Ok(Progress {
            bar,
            name,
            unit,
            total,
            clock,
            begun: clock(),
            first,
            said: first,
            note: String::new(),
        })
    }

    /// It has come this far; what is no news is not said again.
    pub fn at(&mut self, done: u64) {
        if let Some(bar) = &self.bar {
            bar.set_position(done);
            return;
        }
        if done <= self.said {
            return;
        }
        self.said = done;
        let elapsed_s = (self.clock)().since_ns(self.begun) as f64 * 1e-9;
        let each_s = elapsed_s / (done - self.first) as f64;
        let left_s = self.total.saturating_sub(done) as f64 * each_s;
        let line = format!(
            "{}: {done} of {} {}, {elapsed_s:.0} s, about {left_s:.0} s left{}{}",
            self.name,
            self.total,
            self.unit,
            if self.note.is_empty() { "" } else { "; " },
            self.note
        );
        write_line(&line);
    }

    /// What else there is to say; it stands beside the next figure.
    pub fn note(&mut self, note: String) {
        if let Some(bar) = &self.bar {
            bar.set_message(note);
        } else {
            self.note = note;
        }
    }

    /// Something is not as it should be; said at once, and it stays there.
    pub fn warn(&self, what: &str) {
        let line = format!("{}: warning: {what}", self.name);
        match &self.bar {
            Some(bar) => bar.println(line),
            None => write_line(&line),
        }
    }

    /// Something that takes a while begins; said at once.
    pub fn now(&mut self, what: &str) {
        match &self.bar {
            Some(bar) => bar.set_message(what.to_string()),
            None => write_line(&format!("{}: {what}", self.name)),
        }
    }

    /// Takes the bar away.
    pub fn end(self) {
        if let Some(bar) = self.bar {
            bar.finish_and_clear();
        }
    }
}

/// How much time is left, as the key of a bar's template; before anything is done there
/// is nothing to tell it by.
pub fn left(first: u64) -> impl Fn(&ProgressState, &mut dyn fmt::Write) + Clone {
    move |state, out| {
        // Writing to a string cannot fail.
        let _ = match state.pos() <= first {
            true => write!(out, "starting"),
            false => write!(out, "{} left", HumanDuration(state.eta())),
        };
    }
}

fn write_line(line: &str) {
    // The terminal may be closed.
    let _ = writeln!(std::io::stderr(), "{line}");
}
