//! Progress of a long computation: a bar in a terminal, otherwise occasional lines.

use std::fmt;
use std::io::{IsTerminal, Write};
use std::time::Duration;

use indicatif::{HumanDuration, ProgressBar, ProgressState, ProgressStyle};
use shm_config::Instant;

use stack::Clock;

/// Interval between two frames of the bar.
const FRAME: Duration = Duration::from_millis(200);

/// Progress on standard error.
pub struct Progress {
    bar: Option<ProgressBar>,
    name: String,
    unit: &'static str,
    total: u64,
    clock: Clock,
    begun: Instant,
    /// Number done before it began; left out of the estimate of the remaining time.
    first: u64,
    said: u64,
    note: String,
}

impl Progress {
    /// Begins the progress of a named computation; some of it may be done already.
    ///
    /// # Errors
    /// If the bar's template is invalid.
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

    /// Sets the number done; an unchanged number prints nothing.
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

    /// Sets the note that is printed with the next number.
    pub fn note(&mut self, note: String) {
        if let Some(bar) = &self.bar {
            bar.set_message(note);
        } else {
            self.note = note;
        }
    }

    /// Prints a line immediately; it stays on the screen.
    pub fn tell(&self, what: &str) {
        let line = format!("{}: {what}", self.name);
        match &self.bar {
            Some(bar) => bar.println(line),
            None => write_line(&line),
        }
    }

    /// Prints a warning immediately; it stays on the screen.
    pub fn warn(&self, what: &str) {
        self.tell(&format!("warning: {what}"));
    }

    /// Reports immediately that a longer phase begins.
    pub fn now(&mut self, what: &str) {
        match &self.bar {
            Some(bar) => bar.set_message(what.to_string()),
            None => write_line(&format!("{}: {what}", self.name)),
        }
    }

    /// Removes the bar.
    pub fn end(self) {
        if let Some(bar) = self.bar {
            bar.finish_and_clear();
        }
    }
}

/// The remaining time, as a key of a bar's template; before anything is done there is no
/// estimate.
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
    // Standard error may be closed.
    let _ = writeln!(std::io::stderr(), "{line}");
}
