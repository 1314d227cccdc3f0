//! What a run in progress shows and writes down.

use shm_config::Instant;
use shm_config::services::Process;

use super::supervision::Run;
use crate::machine::memory::Memory;
use crate::run::restarts;
use crate::set::event::Event;
use crate::set::member::Phase;
use crate::show::view::View;
use crate::takeover::input::TakeoverInput;
use crate::telemetry::judge;

/// Time between two views, ns.
const SHOW_NS: u64 = 200_000_000;
/// Time between two checks of the logs, ns.
const LOGS_NS: u64 = 1_000_000_000;

impl Run<'_> {
    pub(super) fn report(&mut self, now: Instant) {
        for event in self.set.take_events() {
            if matches!(event, Event::Died { .. }) {
                restarts::write(self.place.paths(), self.set.members());
            }
            let text = event.to_string();
            self.journal.line(now, &text);
            if event.is_notable() {
                self.screen.line(text);
            }
        }
        self.warn_of_refused_priority(now);
        for line in self
            .foreign_reports
            .take_new(&self.wire, &self.tally, self.place.paths())
        {
            self.journal.line(now, &line);
            self.screen.line(line);
        }
        if now.since_ns(self.shown) >= SHOW_NS {
            self.shown = now;
            self.count_memory_of_all();
            let view = View::from_inside(self.config, &self.tally, &self.set);
            self.screen.show(View {
                help: self.takeover.as_ref().and_then(TakeoverInput::help),
                ..view
            });
        }
        if now.since_ns(self.logs_checked) >= LOGS_NS {
            self.logs_checked = now;
            self.warn_of_judge(now);
            for member in self.set.members() {
                if let Some(pid) = member.pid() {
                    self.tally.count_threads(member.row().process, pid);
                }
            }
            self.set.rotate_logs();
        }
    }

    /// Reads the memory of all processes from the kernel.
    fn count_memory_of_all(&mut self) {
        for member in self.set.members() {
            if let Some(memory) = member.pid().and_then(Memory::of) {
                self.tally.count_memory(member.row().process, memory);
            }
        }
    }

    fn warn_of_refused_priority(&mut self, now: Instant) {
        let is_up = |phase: &Phase| matches!(phase, Phase::Up { .. });
        let members = self.set.members();
        if self.is_warned || !members.iter().all(|member| is_up(member.phase())) {
            return;
        }
        self.is_warned = true;
        let refused: Vec<_> = members
            .iter()
            .map(|member| member.row().process)
            .filter(|process| self.tally.is_priority_refused(*process))
            .map(Process::word)
            .collect();
        if !refused.is_empty() {
            let line = format!(
                "warning: real-time priority refused to {}; driving without it, ticks may be late: \
                 `./vlaps doctor` shows how to grant it, --no-realtime asks for none",
                refused.join(", ")
            );
            self.journal.line(now, &line);
            self.screen.line(line);
        }
    }

    /// A judge that is not asked any more delays no tick, so nothing else shows it.
    fn warn_of_judge(&mut self, now: Instant) {
        let trouble = judge::trouble(self.config, &self.tally);
        if trouble.is_empty() || trouble == self.judge_trouble {
            return;
        }
        self.judge_trouble = trouble;
        let line = format!("warning: the judge: {}", self.judge_trouble);
        self.journal.line(now, &line);
        self.screen.line(line);
    }
}
