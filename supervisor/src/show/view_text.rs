//! The view of a run as text: for the live block, the plain lines and `./vlaps status`.

use std::collections::BTreeMap;
use std::fmt::Write as _;

use shm_config::services::Process;

use crate::show::view::{ProcessView, View};

impl View {
    /// The run and its episode.
    pub fn headline(&self) -> String {
        let Self {
            run,
            clock,
            rate_hz,
            ..
        } = self;
        let mut line = format!("{run}: {clock}, {rate_hz} Hz");
        if let Some(episode) = &self.episode {
            // Writing to a string cannot fail.
            let _ = write!(line, "; episode {}", episode.number);
            if episode.of > 0 {
                let _ = write!(line, " of {}", episode.of);
            }
            let _ = write!(line, ", seed {}", episode.seed);
        }
        line
    }

    /// The driver, the reason and the speed.
    pub fn drive_line(&self) -> String {
        let speed_mps = self.episode.map_or(0.0, |episode| episode.speed_mps);
        match self.driver {
            _ if self.is_unled => {
                let why = why_braked(&self.world_refusals);
                format!("the world brakes: {why}, {speed_mps:.1} m/s")
            }
            Some((driver, reason)) => {
                let policy = self.policy.as_ref();
                let policy = policy.map_or(String::new(), |policy| format!("; {policy}"));
                let driving = match (self.is_person, &self.help) {
                    (true, Some(_)) => "you drive".into(),
                    (true, None) => "a human driver drives".into(),
                    (false, _) => format!("{driver} drives"),
                };
                format!("{driving} ({reason}), {speed_mps:.1} m/s{policy}")
            }
            None => "no driver yet".into(),
        }
    }

    /// The processes as a table, one line each.
    pub fn table(&self) -> String {
        let mut text = String::from(
            "  process    state          pid    Hz    ticks  late skipped restarts prio    MB",
        );
        for row in &self.processes {
            let pid = row.pid.map_or("-".into(), |pid| pid.to_string());
            let rate = row
                .rate_hz
                .map_or("-".into(), |rate_hz| rate_hz.to_string());
            let _ = write!(
                text,
                "\n  {:<10} {:<10} {pid:>7} {rate:>5} {:>8} {:>5} {:>7} {:>8} {:>4} {:>5.1}",
                row.process,
                row.state,
                row.ticks,
                row.late,
                row.skipped,
                row.restarts,
                row.priority,
                row.resident_mb
            );
            let slow: Vec<_> = row
                .overruns
                .iter()
                .map(|(part, count)| format!("{part} {count}"))
                .collect();
            if !slow.is_empty() {
                let _ = write!(text, "\n             over budget: {}", slow.join(", "));
            }
        }
        text
    }

    /// Finished episodes by outcome, such as `arrived 2, out_of_road 1`.
    pub fn outcome_line(&self) -> String {
        let some: Vec<_> = self
            .outcomes
            .iter()
            .filter(|(_, count)| *count > 0)
            .map(|(outcome, count)| format!("{outcome} {count}"))
            .collect();
        match some.is_empty() {
            true => "no episode finished yet".into(),
            false => some.join(", "),
        }
    }

    /// The whole view in one line, for output that is not a terminal.
    pub fn plain_line(&self) -> String {
        let completion = self
            .episode
            .map_or(0.0, |episode| episode.completion * 100.0);
        let sum = |field: fn(&ProcessView) -> u64| self.processes.iter().map(field).sum::<u64>();
        let world = self
            .processes
            .iter()
            .find(|row| row.process == Process::World.word());
        format!(
            "{}; {}; {completion:.0} %; {}; ticks {}, skipped {}, late {}, restarts {}",
            self.headline(),
            self.drive_line(),
            self.outcome_line(),
            world.map_or(0, |world| world.ticks),
            world.map_or(0, |world| world.skipped),
            sum(|row| row.late),
            sum(|row| u64::from(row.restarts)),
        )
    }
}

/// Why the world brakes, as its refusals show.
pub fn why_braked(refusals: &BTreeMap<&'static str, u64>) -> String {
    let listed: Vec<_> = refusals
        .iter()
        .map(|(reason, count)| format!("{reason} {count}"))
        .collect();
    match listed.is_empty() {
        true => "no command has arrived".into(),
        false => format!(
            "it has no valid command; refused so far: {}",
            listed.join(", ")
        ),
    }
}
