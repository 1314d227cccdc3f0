//! The supervision loop of a run.

use shm_config::Instant;
use shm_config::config::Config;
use shm_config::services::Process;
use shm_config::wire::Wire;

use crate::Clock;
use crate::machine::service::{ServiceManager, Stage};
use crate::machine::signals::Signals;
use crate::run::journal::Journal;
use crate::run::place::Place;
use crate::run::roster::RosterPublisher;
use crate::set::member::{Decision, Member, Phase};
use crate::set::orphans::Orphans;
use crate::set::process_set::ProcessSet;
use crate::set::stop::Stop;
use crate::show::screen::{Screen, UNREAD};
use crate::takeover::input::TakeoverInput;
use crate::telemetry::foreign::ForeignReports;
use crate::telemetry::ports::Ports;
use crate::telemetry::tally::Tally;

/// The loop's period, ns: 20 Hz.
const PERIOD_NS: u64 = 50_000_000;
/// The period in lockstep, ns: steps come as fast as the processes answer, thousands in a
/// second, and wait in shared memory until this loop reads them.
const LOCKSTEP_PERIOD_NS: u64 = 10_000_000;
/// The period while processes start, ns: each waits for the one before.
const START_PERIOD_NS: u64 = 5_000_000;
/// Time between two checks of the run's files, ns.
const PLACE_NS: u64 = 500_000_000;
/// How a run ended.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) enum End {
    Finished,
    Stopped,
    Killed,
    GivenUp(String),
}

/// A run in progress. Fields are dropped in this order: ports before the wire.
pub(super) struct Run<'a> {
    pub(super) config: &'a Config,
    pub(super) place: &'a Place,
    pub(super) place_looked: Instant,
    pub(super) ports: Ports,
    pub(super) takeover: Option<TakeoverInput>,
    pub(super) roster_port: RosterPublisher,
    pub(super) foreign_reports: ForeignReports,
    pub(super) wire: Wire,
    pub(super) set: ProcessSet,
    pub(super) tally: Tally,
    pub(super) screen: Screen,
    pub(super) journal: Journal,
    pub(super) shown: Instant,
    pub(super) logs_checked: Instant,
    pub(super) is_warned: bool,
    pub(super) judge_trouble: String,
    pub(super) orphans: Orphans,
    pub(super) service: ServiceManager,
    pub(super) stops_asked: usize,
    pub(super) ending: Option<(End, Stop)>,
}

impl Run<'_> {
    pub(super) fn loop_to_the_end(&mut self, mut signals: Signals, clock: Clock) -> End {
        loop {
            let now = clock();
            self.observe(now);
            self.publish_takeover(now);
            self.stops_asked += signals.take_stops();
            let turn = match self.ending {
                None => self.decide_and_start(now),
                Some(_) => Decision::Continue,
            };
            self.end_if_due(turn, now);
            self.report(now);
            self.service.tell(self.stage(), now);
            if let Some((end, stop)) = &mut self.ending {
                if self.set.is_empty() && !self.orphans.remain() {
                    return end.clone();
                }
                if self.stops_asked > 1 {
                    stop.kill(&self.set);
                    if *end == End::Stopped {
                        *end = End::Killed;
                    }
                }
                stop.advance(&self.set, now);
            }
            signals.wait(self.pause_ns(now));
        }
    }

    /// Reads exits and messages. Dead processes are reaped before the ports are read, so that
    /// their last messages are among those read.
    fn observe(&mut self, now: Instant) {
        let died = self.set.reap(now);
        let told = self.orphans.collect_ended(&self.set, died, now);
        told.iter().for_each(|line| self.journal.line(now, line));
        for sign in self.ports.drain(&mut self.tally) {
            self.set.hear(sign.process, sign.pid, sign.state);
        }
        if died && self.ending.is_none() {
            // The restarted processes need the ports of the dead ones.
            self.wire.sweep();
        }
    }

    /// Publishes the takeover message, with `--gate human`.
    fn publish_takeover(&mut self, now: Instant) {
        let takeover = self.takeover.as_mut();
        if let Some(change) = takeover.and_then(|takeover| takeover.publish(&self.tally, now)) {
            self.journal.line(now, change);
        }
    }

    /// Restarts, kills and starts what is due.
    fn decide_and_start(&mut self, now: Instant) -> Decision {
        if now.since_ns(self.place_looked) >= PLACE_NS {
            self.place_looked = now;
            if let Some(reason) = self.place_lost() {
                return Decision::GiveUp(reason);
            }
        }
        let turn = match self.set.decide(now) {
            Decision::Continue if self.is_driven() && !self.set.lives(Process::World) => {
                Decision::Finished
            }
            Decision::Continue => self.set.start_due(now, self.tally.resume()),
            end => end,
        };
        // Immediately after the start: a process waits until it is on the roster.
        self.roster_port.publish(&self.wire, &self.set);
        turn
    }

    /// Why a process that dies now could not be restarted; `None` when it could.
    fn place_lost(&self) -> Option<String> {
        let dir = self.place.paths().dir();
        let dir = dir.display();
        match self.place.is_whole() {
            Ok(true) => None,
            Ok(false) => Some(format!(
                "{dir}: the run's files were removed while it drives; a process that dies now \
                 could not be restarted, so the car is braked to a stand; start the run again"
            )),
            Err(error) => Some(format!(
                "{dir}: the supervisor cannot read the run's files any more: {error}; a process \
                 that dies now could not be restarted, so the car is braked to a stand; start the \
                 run again (with a higher `ulimit -n` when too many files are open)"
            )),
        }
    }

    /// Whether each configured episode has ended: a world that dies after its last one is
    /// not restarted.
    fn is_driven(&self) -> bool {
        let episodes = self.config.run.episodes;
        episodes > 0 && self.tally.next_episode() >= episodes
    }

    fn end_if_due(&mut self, turn: Decision, now: Instant) {
        if self.ending.is_some() {
            return;
        }
        let end = match turn {
            Decision::Finished => End::Finished,
            Decision::GiveUp(reason) => End::GivenUp(reason),
            Decision::Continue if self.stops_asked > 0 => End::Stopped,
            Decision::Continue if self.screen.is_unread() => End::GivenUp(UNREAD.into()),
            Decision::Continue => return,
        };
        let line = match &end {
            End::Finished => "the run is finished".into(),
            End::Stopped | End::Killed => {
                "stopping: the car is braked to a stand; a second signal kills".into()
            }
            End::GivenUp(reason) => format!("giving up: {reason}"),
        };
        if end == End::Finished {
            // Later commands of the controller move no car.
            self.tally.close_steps();
        }
        self.journal.line(now, &line);
        if end == End::Stopped {
            self.screen.line(line);
        }
        let stop = Stop::begin(&self.set, &self.config.supervisor, now);
        self.ending = Some((end, stop));
    }

    fn stage(&self) -> Stage {
        match self.ending {
            Some(_) => Stage::Stopping,
            None if self.set.members().iter().all(Member::lets_others_start) => Stage::Ready,
            None => Stage::Starting,
        }
    }

    fn pause_ns(&self, now: Instant) -> u64 {
        let starts = self
            .set
            .members()
            .iter()
            .any(|member| matches!(member.phase(), Phase::Waiting | Phase::Starting { .. }));
        let period_ns = match starts && self.ending.is_none() {
            true => START_PERIOD_NS,
            false if self.config.run.is_lockstep() => LOCKSTEP_PERIOD_NS,
            false => PERIOD_NS,
        };
        let due_ns = self
            .set
            .next_start()
            .map_or(u64::MAX, |due| due.since_ns(now));
        period_ns.min(due_ns.max(1_000_000))
    }
}
