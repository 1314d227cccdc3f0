//! The summary of a run as text.

use std::fmt;

use shm_config::counted;
use shm_config::message::Outcome;
use shm_config::services::Process;

use crate::show::clock::LOCKSTEP;
use crate::show::process_row::ProcessRow;
use crate::show::summary::Summary;
use crate::show::view_text::why_braked;

/// Versions of the weights that are listed, the newest first.
const WEIGHTS_SHOWN: usize = 5;
/// Episodes listed one by one at each end of a long run.
const EPISODES_SHOWN: usize = 20;

impl fmt::Display for Summary {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(f, "run {}: {}", self.run, self.ended)?;
        self.fmt_episodes(f)?;
        self.fmt_drivers(f)?;
        self.fmt_ticks(f)?;
        self.fmt_processes(f)
    }
}

impl Summary {
    fn fmt_episodes(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if self.episodes.is_empty() {
            return writeln!(f, "\nno episode was finished");
        }
        writeln!(
            f,
            "\nepisode      seed  outcome      strict  completion   ticks"
        )?;
        let (count, listed) = (self.episode_totals.count, self.episodes.len());
        for (index, row) in self.episodes.iter().enumerate() {
            if index == EPISODES_SHOWN && listed > 2 * EPISODES_SHOWN {
                writeln!(
                    f,
                    "    ... {} more in the JSON ...",
                    listed - 2 * EPISODES_SHOWN
                )?;
            }
            if index >= EPISODES_SHOWN && index + EPISODES_SHOWN < listed {
                continue;
            }
            writeln!(
                f,
                "{:>7}  {:>8}  {:<11}  {:<6}  {:>8.1} %  {:>6}",
                count - listed + index + 1,
                row.seed,
                row.outcome,
                if row.strict { "yes" } else { "no" },
                row.completion * 100.0,
                row.ticks
            )?;
        }
        let with = |outcome: Outcome| self.episode_totals.with(outcome);
        writeln!(
            f,
            "{}: {} arrived ({} without contact), {} out of road, {} max step, {} stopped",
            counted(count, "episode"),
            with(Outcome::Arrived),
            self.episode_totals.strict,
            with(Outcome::OutOfRoad),
            with(Outcome::MaxStep),
            with(Outcome::Stopped),
        )?;
        match with(Outcome::Stopped) {
            0 => Ok(()),
            _ => writeln!(f, "stopped: the run ended before the episode"),
        }
    }

    fn fmt_drivers(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let human = match self.person_share > 0.0 {
            true => format!("human driver {:.1} %, ", self.person_share * 100.0),
            false => String::new(),
        };
        writeln!(
            f,
            "\ndrove: {human}expert {:.1} %, policy {:.1} %, brake {:.1} % of {} ({} lost before they were read)",
            (self.share.expert - self.person_share) * 100.0,
            self.share.policy * 100.0,
            self.share.brake * 100.0,
            counted(self.steps, "step"),
            self.lost_steps
        )?;
        for (driver, reasons) in &self.reasons {
            let list: Vec<_> = reasons
                .iter()
                .map(|(reason, count)| format!("{reason} {count}"))
                .collect();
            writeln!(f, "  {driver}: {}", list.join(", "))?;
        }
        if self.braked > 0 {
            let world = self.processes.get(Process::World.word());
            let why = world.map_or(String::new(), |world| why_braked(&world.refusals));
            writeln!(
                f,
                "  but the world braked instead on {}: {why}",
                counted(self.braked, "tick")
            )?;
        }
        if let Some(policy) = &self.policy {
            writeln!(f, "policy: {policy}")?;
        }
        if self.weights.len() > 1 {
            let rows = self.weights.iter().rev().take(WEIGHTS_SHOWN);
            let rows: Vec<_> = rows
                .map(|row| format!("{} drove {} of {}", row.version, row.drove, row.proposed))
                .collect();
            let more = self.weights.len() - rows.len();
            let more = match more {
                0 => String::new(),
                _ => format!("; {more} more in the JSON"),
            };
            writeln!(f, "  steps by weights: {}{more}", rows.join(", "))?;
        }
        if let Some(reason) = self.judge_unasked {
            writeln!(f, "judge: {reason}")?;
        } else if let Some(judge) = self.judge.as_ref().filter(|judge| judge.questions > 0) {
            writeln!(f, "judge: {judge}")?;
        }
        let digest = self.command_digest.as_deref().unwrap_or("none");
        writeln!(f, "command digest {digest}")
    }

    fn fmt_ticks(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(f)?;
        // In the order of the data flow of a tick.
        for process in [Process::World, Process::Planner, Process::Controller] {
            if let Some(row) = self.processes.get(process.word()) {
                fmt_account(f, process, row)?;
            }
        }
        writeln!(
            f,
            "the car braked without a recent command on {} of traffic; maximum age of an applied command: {:.1} ms",
            counted(self.braked, "tick"),
            self.command_age_max_ms
        )?;
        if let Some(first_s) = self.first_command_s {
            writeln!(f, "first command {first_s:.2} s after the start")?;
        }
        match self.processes.get(Process::Recorder.word()) {
            None => Ok(()),
            Some(row) if row.lost == 0 => writeln!(f, "recorded: no message lost"),
            Some(row) => writeln!(
                f,
                "recorded: {} lost; logs/recorder.log names them",
                counted(row.lost, "message")
            ),
        }
    }

    fn fmt_processes(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        // In lockstep no process asks for privileges, and no tick can be late.
        if self.clock == LOCKSTEP {
            return self.fmt_restarts(f);
        }
        writeln!(
            f,
            "\nreal-time privileges (processors kept from sleeping: {})",
            self.cpu_latency
        )?;
        for (process, row) in &self.processes {
            let granted = &row.realtime;
            writeln!(
                f,
                "  {process:<10}  priority {} (asked {} {}, got {} {}), own core {}, locked memory {}",
                granted.priority,
                granted.scheduling_asked,
                granted.priority_asked,
                granted.scheduling_got,
                granted.priority_got,
                granted.core,
                granted.memory
            )?;
        }
        writeln!(
            f,
            "\nmemory, MB            resident    own  files  messages   faults (disk)  switched out"
        )?;
        for (process, row) in &self.processes {
            let memory = &row.memory_mb;
            writeln!(
                f,
                "  {process:<18}{:>10.1}{:>7.1}{:>7.1}{:>10.1}{:>9} {:>6}  {:>12}",
                row.resident_mb,
                memory.anonymous,
                memory.file,
                memory.shared,
                row.minor_faults,
                format!("({})", row.major_faults),
                row.involuntary_switches
            )?;
        }
        self.fmt_overruns(f)?;
        writeln!(
            f,
            "\nrelease lateness, us       p50         p99       p99.9         max     ticks  skipped  absent    late  restarts"
        )?;
        for (process, row) in &self.processes {
            let [p50, p99, p999, max] = match row.release_lateness_us {
                Some(us) => [us.p50, us.p99, us.p999, us.max].map(|us| format!("{us:.1}")),
                None => [const { "-" }; 4].map(String::from),
            };
            let rate = row
                .rate_hz
                .map_or(String::new(), |rate_hz| format!("{rate_hz} Hz"));
            writeln!(
                f,
                "  {process:<10}{rate:>8}{p50:>10}{p99:>12}{p999:>12}{max:>12}{:>10}{:>9}{:>8}{:>8}{:>10}",
                row.ticks, row.skipped, row.absent, row.late, row.restarts
            )?;
        }
        Ok(())
    }

    /// The parts of ticks that exceeded their budget, by process.
    fn fmt_overruns(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for (process, row) in &self.processes {
            let parts: Vec<_> = row
                .overruns
                .iter()
                .map(|(part, count)| format!("{part} {count}"))
                .collect();
            if !parts.is_empty() {
                writeln!(f, "\n{process} over budget: {}", parts.join(", "))?;
            }
        }
        Ok(())
    }

    fn fmt_restarts(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let restarted: Vec<_> = self
            .processes
            .iter()
            .filter(|(_, row)| row.restarts > 0)
            .map(|(process, row)| format!("{process} {}", row.restarts))
            .collect();
        match restarted.is_empty() {
            true => Ok(()),
            false => writeln!(f, "\nrestarts: {}", restarted.join(", ")),
        }
    }
}

/// The account of all ticks of a process's grid; empty for a process without a grid.
fn fmt_account(f: &mut fmt::Formatter<'_>, process: Process, row: &ProcessRow) -> fmt::Result {
    let (Some(elapsed_s), Some(period_s)) = (row.elapsed_s, row.period_s) else {
        return Ok(());
    };
    let due = (elapsed_s / period_s).round() as u64;
    let total = row.ticks + row.skipped;
    let relation = if total == due { "==" } else { "!=" };
    write!(
        f,
        "{process}: ticks {} + skipped {} = {total} {relation} {due} = elapsed {elapsed_s:.3} s / \
         period {period_s} s",
        row.ticks, row.skipped
    )?;
    match row.absent {
        0 => writeln!(f),
        absent => writeln!(f, "; absent {absent}"),
    }
}
