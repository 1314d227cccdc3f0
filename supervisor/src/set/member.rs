//! One process of the set as a state machine.

use runtime::LogFile;
use rustix::process::Signal;
use shm_config::Instant;
use shm_config::config::Supervisor;
use shm_config::message::HealthState;
use shm_config::text::printable;

use crate::machine::programs::Executable;
use crate::set::backoff::{After, Backoff};
use crate::set::event::Event;
use crate::set::exit::Exit;
use crate::set::launch::{Kind, Launch, Resume, Running};
use crate::set::mark::Mark;
use crate::set::table::{ProcessSpec, Restart};

/// How long a process may take from its start to being ready, ns. Opening the ports takes
/// milliseconds; twenty seconds allow for a cold disk under full load.
pub const READY_LIMIT_NS: u64 = 20_000_000_000;

/// The same for a process that an interpreter runs, ns: MetaDrive alone loads a
/// thousand Python modules, 3 s on an idle machine and 20 s under full load.
pub const SCRIPT_READY_LIMIT_NS: u64 = 60_000_000_000;

/// Lines shown of the log of a user's program that failed: the end of a traceback with
/// the call that raised it.
const USERS_LINES: usize = 6;

/// The phase of a process as the supervisor sees it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Phase {
    /// It is not due in the start order yet.
    Waiting,
    /// Started, not ready yet.
    Starting {
        /// When it was started.
        since: Instant,
    },
    /// Ready or running.
    Up {
        /// When it was started.
        since: Instant,
    },
    /// Reaped; the next decision follows.
    Dead {
        /// How it ended.
        exit: Exit,
        /// How long it ran, ns.
        ran_ns: u64,
    },
    /// Waiting for the end of the pause before its restart.
    Resting {
        /// When the pause ends.
        until: Instant,
    },
    /// Ended for good.
    Gone,
}

/// One process of the set.
#[derive(Debug)]
pub struct Member {
    row: &'static ProcessSpec,
    executable: Executable,
    child: Option<Running>,
    phase: Phase,
    backoff: Backoff,
    silent_ns: u64,
    ever_ready: bool,
    log: LogFile,
    kind: Kind,
}

/// What follows for the run.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Decision {
    /// The run goes on.
    Continue,
    /// The configured run is finished.
    Finished,
    /// The run cannot continue, for this reason.
    GiveUp(String),
}

impl Member {
    /// A process that has not been started.
    pub(crate) fn new(
        row: &'static ProcessSpec,
        executable: Executable,
        log: LogFile,
        kind: Kind,
    ) -> Self {
        Self {
            row,
            executable,
            child: None,
            phase: Phase::Waiting,
            backoff: Backoff::default(),
            silent_ns: 0,
            ever_ready: false,
            log,
            kind,
        }
    }

    /// Its row of the process table.
    pub fn row(&self) -> &'static ProcessSpec {
        self.row
    }

    /// Its phase.
    pub fn phase(&self) -> &Phase {
        &self.phase
    }

    /// Its process id; `None` when it does not live.
    pub fn pid(&self) -> Option<u32> {
        self.child.as_ref().map(Running::pid)
    }

    /// The mark that it and its descendants carry; `None` when it does not live.
    pub(crate) fn mark(&self) -> Option<&Mark> {
        self.child.as_ref().map(Running::mark)
    }

    /// How often it was restarted.
    pub fn restarts(&self) -> u32 {
        self.backoff.restarts()
    }

    /// Whether it was ready at least once.
    pub fn was_ready(&self) -> bool {
        self.ever_ready
    }

    /// Whether those after it may start: it was ready, or the run goes on without it.
    pub fn lets_others_start(&self) -> bool {
        self.ever_ready || self.phase == Phase::Gone
    }

    /// Whether it runs or is not reaped yet.
    pub fn lives(&self) -> bool {
        self.child.is_some()
    }

    /// Sends it a signal, if it lives.
    pub fn signal(&self, signal: Signal) {
        if let Some(child) = &self.child {
            child.signal(signal);
        }
    }

    /// Rotates its log when it exceeds its limit.
    pub(crate) fn rotate_log(&mut self, events: &mut Vec<Event>) {
        if let Err(error) = self.log.rotate() {
            events.push(Event::LogFull {
                process: self.row.process,
                reason: error.to_string(),
            });
        }
    }

    /// Takes its health message. A message that a dead predecessor left in a queue has
    /// another process id and is ignored.
    pub(crate) fn hear(&mut self, pid: u32, state: HealthState, events: &mut Vec<Event>) {
        if self.pid() != Some(pid) {
            return;
        }
        self.silent_ns = 0;
        if let Phase::Starting { since } = self.phase
            && state != HealthState::Starting
        {
            self.phase = Phase::Up { since };
            self.ever_ready = true;
            events.push(Event::Ready {
                process: self.row.process,
            });
        }
    }

    /// Reaps its child if it has ended; never blocks.
    pub(crate) fn reap(&mut self, now: Instant) -> bool {
        let Some(exit) = self.child.as_mut().and_then(Running::reap) else {
            return false;
        };
        let since = match self.phase {
            Phase::Starting { since } | Phase::Up { since } => since,
            _ => now,
        };
        self.child = None;
        self.phase = Phase::Dead {
            exit,
            ran_ns: now.since_ns(since),
        };
        true
    }

    /// Starts it.
    pub(crate) fn start(
        &mut self,
        launch: &Launch,
        resume: Resume,
        now: Instant,
        events: &mut Vec<Event>,
    ) -> Decision {
        let process = self.row.process;
        match launch.start(self.row, &self.executable, &mut self.log, resume) {
            Ok(child) => {
                let pid = child.pid();
                self.child = Some(child);
                self.phase = Phase::Starting { since: now };
                self.silent_ns = 0;
                events.push(Event::Started { process, pid });
                Decision::Continue
            }
            Err(error) => Decision::GiveUp(format!(
                "{process}: cannot start {}: {error}",
                launch.binary(self.row).display()
            )),
        }
    }

    /// Decides what follows from its phase.
    pub(crate) fn decide(
        &mut self,
        now: Instant,
        passed_ns: u64,
        limits: &Supervisor,
        events: &mut Vec<Event>,
    ) -> Decision {
        match self.phase.clone() {
            Phase::Waiting | Phase::Resting { .. } | Phase::Gone => Decision::Continue,
            Phase::Starting { since } => self.check_start_time(now.since_ns(since), events),
            Phase::Up { .. } => {
                let limit_ns = (limits.silence_s * 1e9) as u64;
                self.silent_ns += passed_ns;
                if self.silent_ns > limit_ns {
                    self.kill_silent(self.silent_ns, events);
                }
                Decision::Continue
            }
            Phase::Dead { exit, ran_ns } => {
                self.decide_after_exit(now, exit, ran_ns, limits, events)
            }
        }
    }

    fn check_start_time(&mut self, took_ns: u64, events: &mut Vec<Event>) -> Decision {
        let limit_ns = self.ready_limit_ns();
        if took_ns <= limit_ns {
            return Decision::Continue;
        }
        if !self.ever_ready {
            return Decision::GiveUp(format!(
                "{}: not ready {} s after its start{}",
                self.row.process,
                limit_ns / 1_000_000_000,
                self.last_lines_and_log()
            ));
        }
        self.kill_silent(took_ns, events);
        Decision::Continue
    }

    /// Kills it; the next reap collects it. SIGKILL also ends a stopped process.
    fn kill_silent(&mut self, silent_ns: u64, events: &mut Vec<Event>) {
        let process = self.row.process;
        if let Some(child) = &self.child {
            child.signal(Signal::KILL);
        }
        // If the kernel is slow to end it, the next SIGKILL follows after another whole
        // silence.
        self.silent_ns = 0;
        let limit_ns = self.ready_limit_ns();
        if let Phase::Starting { since } = &mut self.phase {
            *since = since.after_ns(limit_ns);
        }
        events.push(Event::Silenced { process, silent_ns });
    }

    fn decide_after_exit(
        &mut self,
        now: Instant,
        exit: Exit,
        ran_ns: u64,
        limits: &Supervisor,
        events: &mut Vec<Event>,
    ) -> Decision {
        let process = self.row.process;
        self.phase = Phase::Gone;
        match (&exit, self.row.restart) {
            // A restart is for a program that has worked. This one has an error that its
            // author should see at once.
            _ if !self.ever_ready && self.kind == Kind::OfTheUser => {
                return Decision::GiveUp(format!(
                    "{process}: its program ended before it was ready ({exit}){}",
                    self.last_lines_and_log()
                ));
            }
            (Exit::Done, Restart::AtEpisode) => return Decision::Finished,
            // A set-up that worked before fails when a disk or shared memory is full, which
            // may pass; one that never worked would fail again.
            (Exit::Refused, _) if !self.ever_ready => {
                return Decision::GiveUp(match self.log.last_line() {
                    // A child prefixes its line with its own name.
                    Some(line) => {
                        let own = format!("{}: ", self.row.binary);
                        let line = line.strip_prefix(&own).unwrap_or(&line);
                        format!("{process}: {}", printable(line))
                    }
                    None => format!(
                        "{process}: refused its set-up without a message; see {}",
                        self.log.path().display()
                    ),
                });
            }
            (Exit::Done | Exit::Refused | Exit::Crashed(_), _) => {}
        }
        match self.backoff.died(ran_ns, limits) {
            After::Pause(pause_ns) => {
                self.phase = Phase::Resting {
                    until: now.after_ns(pause_ns),
                };
                events.push(Event::Died {
                    process,
                    exit,
                    pause_ns,
                    restart: self.backoff.restarts(),
                    restarts_max: limits.restarts_max,
                });
                Decision::Continue
            }
            After::GiveUp if self.row.restart == Restart::OrWithout => {
                events.push(Event::Abandoned {
                    process,
                    exit,
                    restarts_max: limits.restarts_max,
                });
                Decision::Continue
            }
            After::GiveUp => Decision::GiveUp(format!(
                "{process}: died ({exit}) and was restarted {} times already, which is \
                 supervisor.restarts_max{}",
                limits.restarts_max,
                self.last_lines_and_log()
            )),
        }
    }

    fn ready_limit_ns(&self) -> u64 {
        match self.kind {
            Kind::OfTheBuild | Kind::OfTheUser => READY_LIMIT_NS,
            Kind::Script => SCRIPT_READY_LIMIT_NS,
        }
    }

    /// The end of its log: one line of a program of the build, which reports an error in
    /// one line; several of a user's, whose panic or traceback has more.
    fn last_lines_and_log(&self) -> String {
        let path = self.log.path().display();
        let count = match self.kind {
            Kind::OfTheBuild | Kind::Script => 1,
            Kind::OfTheUser => USERS_LINES,
        };
        let lines = self.log.last_lines(count);
        match lines.as_slice() {
            [] => format!("; its log is empty: {path}"),
            [line] => format!("; its last line: {}; its log: {path}", printable(line)),
            lines => {
                let mut text = format!("; its log: {path}; its last lines:");
                for line in lines {
                    text.push_str("\n  ");
                    text.push_str(&printable(line));
                }
                text
            }
        }
    }
}
