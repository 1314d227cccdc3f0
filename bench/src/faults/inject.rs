//! Injects a fault into a set and records the outcome.

use std::path::Path;
use std::process::{Command, Stdio};
use std::time::Duration;

use anyhow::Context;
use rand_xoshiro::Xoshiro256PlusPlus;
use rustix::process::{Pid, Resource, Rlimit, Signal, prlimit};
use shm_config::Instant;
use shm_config::message::{Fault, FaultKind};
use shm_config::services::Process;
use supervisor::machine::signals::pause;

use super::foreign::{ForeignProcess, Forgery, HeldPorts, hold_loans};
use super::malformed::Malformed;
use super::monitor::{CHILDREN, Trial};
use super::planned::{Kind, PlannedFault};
use super::sandbox::{Filler, shared_memory};
use super::tested_set::{POLL, TestedSet};
use lab::stop::Stop;
use stack::Clock;

/// Time limit for a set to drive again, ns.
const RECOVERY_NS: u64 = 20_000_000_000;
/// Shortest time that a resource is exhausted, ns: long enough for a process that dies
/// meanwhile to be restarted without it.
const EXHAUSTED_NS: u64 = 50_000_000;
/// Range of the random time added to it, ns.
const EXHAUSTED_MORE_NS: f64 = 250e6;

/// Interval between two forged messages, ns: 500 Hz.
const FORGERY_NS: u64 = 2_000_000;

/// Immediate effect of an injected fault on the set.
pub enum Effect {
    /// The set should continue.
    Continues {
        /// Details of the fault.
        detail: String,
    },
    /// The supervisor is dead: the set has ended.
    Ended,
    /// The run cannot continue: the supervisor should end it in order.
    GivesUp,
    /// The fault cannot be injected on this machine, for this reason.
    Skipped(String),
}

/// Outcome of a fault.
#[derive(Debug, Clone, Default)]
pub struct Outcome {
    /// From the fault to the next safe command, or to the vehicle's own brake if that came
    /// first, ns.
    pub safe_ns: Option<u64>,
    /// What made the car safe: command, brake (a brake command) or vehicle.
    pub by: &'static str,
    /// From the fault to the next safe command, ns; `None` without one.
    pub command_ns: Option<u64>,
    /// From the fault until every process was up and the car was driven on fresh inputs,
    /// ns; `None` if that did not happen.
    pub recovered_ns: Option<u64>,
}

/// Injects a fault into a driving set.
///
/// # Errors
/// If the set cannot be watched, or the fault cannot be injected.
pub fn inject(
    set: &mut TestedSet,
    planned: &mut PlannedFault,
    clock: Clock,
) -> anyhow::Result<Effect> {
    let period_ns = set.options().period_ns();
    set.watch_for((planned.phase * period_ns as f64) as u64);
    let controller = set.pid(Process::Controller);
    let target = planned.target.unwrap_or(Process::Controller);
    let mut injection = Injection {
        lasting_ns: (planned.periods * period_ns as f64) as u64,
        exhausted_ns: EXHAUSTED_NS + (planned.periods / 20.0 * EXHAUSTED_MORE_NS) as u64,
        set,
        target,
        clock,
    };
    let detail = match planned.kind {
        Kind::Kill => injection.kill(),
        Kind::All => injection.kill_all(),
        Kind::Stop => injection.stop(),
        Kind::Hang => injection.order(FaultKind::Hang, 0),
        Kind::Spin => injection.order(FaultKind::Spin, 0),
        Kind::Panic => injection.order(FaultKind::Panic, 0),
        Kind::Allocation => injection.order(FaultKind::Allocation, 0),
        Kind::Slow => injection.slow(),
        Kind::Memory => match injection.pid() {
            Some(pid) => injection.exhaust_memory(pid)?,
            None => {
                return Ok(Effect::Skipped(format!(
                    "{target} has published no process id"
                )));
            }
        },
        Kind::Disk => {
            let folder = injection.set.options().folder.clone();
            injection.fill(&folder, planned.kills)?
        }
        Kind::Shm => injection.fill(shared_memory(), planned.kills)?,
        Kind::Clock => injection.clock_steps()?,
        Kind::Hostile => injection.hostile(&mut planned.dice)?,
        Kind::ForeignCommand => injection.forge(Forgery::Command)?,
        Kind::OtherEpisode => injection.forge(Forgery::OtherEpisode)?,
        Kind::ForeignObservation => injection.forge(Forgery::Observation)?,
        Kind::ForeignPlan => injection.forge(Forgery::PlanAndAdvice)?,
        Kind::ForgedHealth => injection.forge(Forgery::Health)?,
        Kind::Slots => injection.exhaust_ports(),
        Kind::Loans => injection.exhaust_loans()?,
        Kind::Files => {
            injection.remove_files()?;
            return Ok(Effect::GivesUp);
        }
    };
    if planned.kind == Kind::Kill && target == Process::Supervisor {
        return Ok(Effect::Ended);
    }
    let now = clock();
    let lasts = !(planned.kind.is_a_death() || planned.kind.is_a_hang());
    if !lasts && target == Process::Controller {
        // Must be set before the ports are read again.
        set.expect_death(controller);
    }
    let monitor = set.monitor();
    let injected = monitor.trial().map_or(now, |trial| trial.injected);
    monitor.over(if lasts { now } else { injected });
    Ok(Effect::Continues { detail })
}

/// A fault that is being injected. The method of each kind returns details in words.
struct Injection<'a> {
    set: &'a mut TestedSet,
    target: Process,
    /// Duration of a stop, a slow process or forged messages, ns.
    lasting_ns: u64,
    /// Time for which a resource is exhausted, ns.
    exhausted_ns: u64,
    clock: Clock,
}

impl Injection<'_> {
    fn begin(&mut self) {
        self.set.monitor().begin((self.clock)());
    }

    fn pid(&mut self) -> Option<Pid> {
        self.set.pid(self.target).and_then(Pid::from_raw)
    }

    fn kill(&mut self) -> String {
        self.begin();
        self.set.signal(self.target, Signal::KILL);
        String::new()
    }

    fn kill_all(&mut self) -> String {
        let pids = CHILDREN.map(|process| self.set.pid(process));
        self.begin();
        for pid in pids.into_iter().flatten().filter_map(Pid::from_raw) {
            // The death of another process may have ended it already.
            let _ = rustix::process::kill_process(pid, Signal::KILL);
        }
        String::new()
    }

    fn stop(&mut self) -> String {
        self.begin();
        self.set.signal(self.target, Signal::STOP);
        self.set.watch_for(self.lasting_ns);
        self.set.signal(self.target, Signal::CONT);
        milliseconds(self.lasting_ns)
    }

    fn order(&mut self, kind: FaultKind, duration_ns: u64) -> String {
        let mut fault = Fault {
            duration_ns,
            target: self.target.code(),
            kind: kind.code(),
            ..Fault::default()
        };
        self.begin();
        fault.header.taken_ns = (self.clock)().0;
        self.set.monitor().orders.send(&mut fault);
        String::new()
    }

    fn slow(&mut self) -> String {
        self.order(FaultKind::Slow, self.lasting_ns);
        self.set.watch_for(self.lasting_ns);
        milliseconds(self.lasting_ns)
    }

    fn exhaust_memory(&mut self, pid: Pid) -> anyhow::Result<String> {
        self.begin();
        let before = limit_memory(pid)?;
        self.set.watch_for(self.exhausted_ns);
        // If it died, its successor has the supervisor's limits.
        let _ = prlimit(Some(pid), Resource::As, before);
        Ok(milliseconds(self.exhausted_ns))
    }

    /// Fills a file system; the target may be killed meanwhile.
    fn fill(&mut self, folder: &Path, kills: bool) -> anyhow::Result<String> {
        self.begin();
        let filler = Filler::fill(folder)?;
        if kills {
            self.set.signal(self.target, Signal::KILL);
        }
        if kills && folder == shared_memory() {
            // To read is to connect to the target's successor, and a connection for which
            // there is no memory kills this program with SIGBUS. Steps wait in their queue.
            pause(Duration::from_nanos(self.exhausted_ns));
        } else {
            self.set.watch_for(self.exhausted_ns);
        }
        drop(filler);
        let meanwhile = if kills { ", killed meanwhile" } else { "" };
        Ok(milliseconds(self.exhausted_ns) + meanwhile)
    }

    fn clock_steps(&mut self) -> anyhow::Result<String> {
        self.begin();
        step_clock("+1 hour")?;
        self.set.watch_for(self.exhausted_ns);
        step_clock("-1 hour")?;
        Ok(String::new())
    }

    fn hostile(&mut self, dice: &mut Xoshiro256PlusPlus) -> anyhow::Result<String> {
        let malformed = Malformed::draw(dice);
        self.begin();
        let now = (self.clock)();
        let monitor = self.set.monitor();
        let step = *monitor.ledger.newest().context("a step")?;
        let refused = match malformed.publish(&monitor.wire, (&step, now), dice)? {
            true => "",
            false => ", refused",
        };
        Ok(format!("{malformed}{refused}"))
    }

    /// Sends well-formed forged messages for a while.
    fn forge(&mut self, forgery: Forgery) -> anyhow::Result<String> {
        let period_ns = self.set.options().period_ns();
        let mut foreign = ForeignProcess::open(&self.set.monitor().wire, forgery)?;
        self.begin();
        let until = (self.clock)().after_ns(self.lasting_ns);
        while (self.clock)() < until {
            let step = *self.set.monitor().ledger.newest().context("a step")?;
            foreign.send(&step, (self.clock)(), period_ns);
            self.set.watch_for(FORGERY_NS);
        }
        Ok(String::new())
    }

    /// Takes all ports of the services while the target restarts.
    fn exhaust_ports(&mut self) -> String {
        self.begin();
        let held = HeldPorts::take(&self.set.monitor().wire);
        self.set.signal(self.target, Signal::KILL);
        self.set.watch_for(self.exhausted_ns);
        drop(held);
        milliseconds(self.exhausted_ns)
    }

    fn exhaust_loans(&mut self) -> anyhow::Result<String> {
        self.begin();
        hold_loans(
            &self.set.monitor().wire,
            Duration::from_nanos(self.lasting_ns),
        )?;
        Ok(String::new())
    }

    fn remove_files(&mut self) -> anyhow::Result<()> {
        self.begin();
        for path in self.set.paths().shared_memory()? {
            // Another process may have removed its own file meanwhile.
            let _ = std::fs::remove_file(path);
        }
        let _ = std::fs::remove_dir_all(self.set.paths().dir());
        self.set.signal(self.target, Signal::KILL);
        Ok(())
    }
}

fn milliseconds(ns: u64) -> String {
    format!("{:.0} ms", ns as f64 / 1e6)
}

/// Waits until the set drives again or a stop is requested; returns the outcome of
/// the fault.
pub fn await_recovery(
    set: &mut TestedSet,
    planned: &PlannedFault,
    old_pid: Option<i32>,
    (clock, stop): (Clock, &Stop),
) -> Outcome {
    let over = set.monitor().trial().and_then(|trial| trial.over);
    let over = over.unwrap_or_else(clock);
    let dies = planned.kind.is_a_death() || planned.kind.is_a_hang();
    let until = clock().after_ns(RECOVERY_NS);
    let mut recovered = None;
    while recovered.is_none() && clock() < until && !set.has_ended() && !stop.is_asked() {
        let monitor = set.monitor();
        let fresh = monitor.trial().and_then(|trial| trial.fresh);
        let replaced = match (dies, planned.target) {
            (true, Some(target)) => monitor.pid(target) != old_pid,
            _ => true,
        };
        let up = CHILDREN
            .into_iter()
            .all(|process| monitor.is_up(process, over));
        if fresh.is_some() && replaced && up {
            recovered = Some(clock());
        }
        pause(POLL);
    }
    let limits = set.monitor().limits;
    let trial = set.monitor().take_trial();
    trial.map_or_else(Outcome::default, |trial| {
        outcome_of(&trial, &limits, recovered)
    })
}

/// The outcome of a trial.
pub fn outcome_of(
    trial: &Trial,
    limits: &super::ledger::Limits,
    recovered: Option<Instant>,
) -> Outcome {
    let own = limits.own_brake(trial.before, trial.anchor);
    let since = |instant: Instant| instant.since_ns(trial.injected);
    let (safe, by) = match trial.command {
        Some((handed, brakes)) if handed <= own => {
            (handed, if brakes { "brake" } else { "command" })
        }
        _ => (own, "vehicle"),
    };
    Outcome {
        safe_ns: Some(since(safe)),
        by,
        command_ns: trial.command.map(|(handed, _)| since(handed)),
        recovered_ns: recovered.map(since),
    }
}

/// Limits a process to its present address space; returns its previous limit.
fn limit_memory(pid: Pid) -> anyhow::Result<Rlimit> {
    let path = format!("/proc/{}/status", pid.as_raw_nonzero());
    let text = std::fs::read_to_string(&path).context(path)?;
    let size = text.lines().find_map(|line| line.strip_prefix("VmSize:"));
    let size = size.and_then(|size| size.trim().strip_suffix(" kB")?.parse::<u64>().ok());
    let none = Rlimit {
        current: None,
        maximum: None,
    };
    let limit = Rlimit {
        current: Some(size.context("VmSize")? * 1024),
        maximum: None,
    };
    match prlimit(Some(pid), Resource::As, limit) {
        Ok(before) => Ok(before),
        // The process has just died.
        Err(rustix::io::Errno::SRCH) => Ok(none),
        Err(error) => Err(error).context("prlimit"),
    }
}

fn step_clock(by: &str) -> anyhow::Result<()> {
    let status = Command::new("date")
        .args(["--set", by])
        .stdout(Stdio::null())
        .status()
        .context("date")?;
    anyhow::ensure!(status.success(), "date --set '{by}' was refused");
    Ok(())
}
