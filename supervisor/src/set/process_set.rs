//! The process set as a state machine over its children. It never blocks, reads no clock
//! and opens no port.

use std::path::Path;

use runtime::LogFile;
use rustix::process::Signal;
use shm_config::Instant;
use shm_config::config::{Config, Supervisor};
use shm_config::message::HealthState;
use shm_config::services::Process;

use crate::cli::failure::Failure;
use crate::machine::programs::Executable;
use crate::set::event::Event;
use crate::set::launch::{Kind, Launch, Resume};
use crate::set::mark::Mark;
use crate::set::member::{Decision, Member, Phase};
use crate::set::table::rows;

/// The most that one call of [`ProcessSet::decide`] adds to a silence, ns: four periods of
/// the loop. A supervisor that was itself stopped must not count its own absence as the
/// silence of its processes.
const LOOK_MAX_NS: u64 = 200_000_000;

/// All processes of a run except the supervisor.
#[derive(Debug)]
pub struct ProcessSet {
    members: Vec<Member>,
    launch: Launch,
    limits: Supervisor,
    looked: Option<Instant>,
    events: Vec<Event>,
}

impl ProcessSet {
    /// The set of a configuration, with no process started; logs go to `log_dir`.
    ///
    /// # Errors
    /// When a binary is missing or a log cannot be made.
    pub fn new(config: &Config, launch: Launch, log_dir: &Path) -> Result<Self, Failure> {
        let limit_bytes = u64::from(config.supervisor.log_mb) << 20;
        let mut members = Vec::new();
        for row in rows(config) {
            let binary = launch.binary(row);
            if launch.kind(row) == Kind::OfTheBuild && !binary.is_file() {
                return Err(Failure::GivenUp(format!(
                    "{}: missing; build it with `cargo build --release --workspace --bins`",
                    binary.display()
                )));
            }
            let log =
                LogFile::create(log_dir, row.process.word(), limit_bytes).map_err(|error| {
                    Failure::GivenUp(format!("{}: cannot keep a log: {error}", log_dir.display()))
                })?;
            let kind = launch.kind(row);
            let executable = match kind {
                Kind::OfTheBuild => Executable::hold(binary.clone()),
                Kind::Script | Kind::OfTheUser => Ok(Executable::at(binary.clone())),
            };
            let executable = executable.map_err(|error| {
                Failure::GivenUp(format!("{}: cannot be read: {error}", binary.display()))
            })?;
            members.push(Member::new(row, executable, log, kind));
        }
        Ok(Self {
            members,
            launch,
            limits: config.supervisor.clone(),
            looked: None,
            events: Vec::new(),
        })
    }

    /// The processes, in the order of start.
    pub fn members(&self) -> &[Member] {
        &self.members
    }

    /// One process; `None` when it is not part of this run.
    pub fn member(&self, process: Process) -> Option<&Member> {
        self.members
            .iter()
            .find(|member| member.row().process == process)
    }

    /// The events since the last call.
    pub fn take_events(&mut self) -> Vec<Event> {
        std::mem::take(&mut self.events)
    }

    /// Takes the health message of a process. A message that a dead predecessor left in
    /// a queue has another process id and is ignored.
    pub fn hear(&mut self, process: Process, pid: u32, state: HealthState) {
        let Some(member) = self
            .members
            .iter_mut()
            .find(|member| member.row().process == process)
        else {
            return;
        };
        member.hear(pid, state, &mut self.events);
    }

    /// Reaps children that have ended; returns whether there were any. Never blocks.
    pub fn reap(&mut self, now: Instant) -> bool {
        let mut died = false;
        for member in &mut self.members {
            died |= member.reap(now);
        }
        died
    }

    /// Decides what follows for dead processes, silent ones and slow starts.
    pub fn decide(&mut self, now: Instant) -> Decision {
        let passed_ns = self
            .looked
            .map_or(0, |looked| now.since_ns(looked).min(LOOK_MAX_NS));
        self.looked = Some(now);
        for member in &mut self.members {
            match member.decide(now, passed_ns, &self.limits, &mut self.events) {
                Decision::Continue => {}
                end => return end,
            }
        }
        Decision::Continue
    }

    /// Starts the processes that are due: first starts in the table's order, each when the
    /// one before is ready; restarts when their pause is over.
    pub fn start_due(&mut self, now: Instant, resume: Resume) -> Decision {
        for index in 0..self.members.len() {
            let due = match self.members[index].phase() {
                Phase::Waiting => self.members[..index].iter().all(Member::lets_others_start),
                Phase::Resting { until } => now >= *until,
                _ => false,
            };
            if due
                && let Decision::GiveUp(reason) =
                    self.members[index].start(&self.launch, resume, now, &mut self.events)
            {
                return Decision::GiveUp(reason);
            }
        }
        Decision::Continue
    }

    /// When the next restart is due; `None` when none is pending.
    pub fn next_start(&self) -> Option<Instant> {
        self.members
            .iter()
            .filter_map(|member| match member.phase() {
                Phase::Resting { until } => Some(*until),
                _ => None,
            })
            .min()
    }

    /// Rotates logs that have grown over their limit.
    pub fn rotate_logs(&mut self) {
        for member in &mut self.members {
            member.rotate_log(&mut self.events);
        }
    }

    /// Sends a signal to one process, if it lives.
    pub fn signal(&self, process: Process, signal: Signal) {
        if let Some(member) = self.member(process) {
            member.signal(signal);
        }
    }

    /// Sends a signal to every living process.
    pub fn signal_all(&self, signal: Signal) {
        for member in &self.members {
            member.signal(signal);
        }
    }

    /// Whether a process runs or is not reaped yet.
    pub fn lives(&self, process: Process) -> bool {
        self.member(process).is_some_and(Member::lives)
    }

    /// Whether a living process carries this mark.
    pub(crate) fn carries(&self, mark: &Mark) -> bool {
        self.members
            .iter()
            .any(|member| member.mark() == Some(mark))
    }

    /// Whether no process lives.
    pub fn is_empty(&self) -> bool {
        !self.members.iter().any(Member::lives)
    }
}
