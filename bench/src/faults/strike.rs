//! How a fault is injected into a set, and what came of it.

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

use super::lies::Told;
use super::room::{Filler, shared_memory};
use super::stage::{LOOK, Stage};
use super::strangers::{Forgery, HeldPlaces, Stranger, hold_loans};
use super::trouble::{Kind, Trouble};
use super::watch::{CHILDREN, Trial};
use lab::stop::Stop;
use stack::Clock;

/// How long a set may take to drive again, ns.
const RECOVERY_NS: u64 = 20_000_000_000;
/// What fills or starves lasts so long at least, ns: a process that dies
/// meanwhile shall meet it.
const LACK_NS: u64 = 50_000_000;
/// ... and so much longer at most, ns.
const LACK_MORE_NS: f64 = 250e6;

/// From forgery to forgery of a stranger, ns: 500 Hz.
const FORGERY_NS: u64 = 2_000_000;

/// What a blow did to the set.
pub enum Blow {
    /// The set goes on, or should.
    Goes {
        /// More about it.
        detail: String,
    },
    /// The supervisor is dead: the set has ended.
    Ended,
    /// The run is beyond help: the supervisor shall end it in order.
    Resigns,
    /// It was no fault on this machine, for this reason.
    Skipped(String),
}

/// What came of a fault.
#[derive(Debug, Clone, Default)]
pub struct Came {
    /// From the fault to the next safe command, or to the vehicle's own brake when
    /// that came first, ns.
    pub safe_ns: Option<u64>,
    /// Which of both: command, brake (a command, too) or vehicle.
    pub by: &'static str,
    /// From the fault to the next safe command, ns; `None` when none came.
    pub command_ns: Option<u64>,
    /// From the fault until every process was up and the car was driven on fresh
    /// inputs, ns; `None` when that never happened.
    pub recovered_ns: Option<u64>,
}

/// Injects a fault, once the set drives.
///
/// # Errors
/// When the set cannot be watched, or the fault not be made.
pub fn strike(stage: &mut Stage, trouble: &mut Trouble, clock: Clock) -> anyhow::Result<Blow> {
    let period_ns = stage.scene().period_ns();
    stage.watch_for((trouble.phase * period_ns as f64) as u64);
    let controller = stage.pid(Process::Controller);
    let target = trouble.target.unwrap_or(Process::Controller);
    let mut injection = Injection {
        lasting_ns: (trouble.periods * period_ns as f64) as u64,
        lack_ns: LACK_NS + (trouble.periods / 20.0 * LACK_MORE_NS) as u64,
        stage,
        target,
        clock,
    };
    let detail = match trouble.kind {
        Kind::Kill => injection.kill(),
        Kind::All => injection.kill_all(),
        Kind::Stop => injection.stop(),
        Kind::Hang => injection.order(FaultKind::Hang, 0),
        Kind::Spin => injection.order(FaultKind::Spin, 0),
        Kind::Panic => injection.order(FaultKind::Panic, 0),
        Kind::Allocation => injection.order(FaultKind::Allocation, 0),
        Kind::Slow => injection.slow(),
        Kind::Memory => match injection.pid() {
            Some(pid) => injection.lack_of_memory(pid)?,
            None => return Ok(Blow::Skipped(format!("{target} said no process id"))),
        },
        Kind::Disk => {
            let folder = injection.stage.scene().folder.clone();
            injection.lack_of_room(&folder, trouble.kills)?
        }
        Kind::Shm => injection.lack_of_room(shared_memory(), trouble.kills)?,
        Kind::Clock => injection.clock_steps()?,
        Kind::Hostile => injection.hostile(&mut trouble.dice)?,
        Kind::ForeignCommand => injection.forge(Forgery::Command)?,
        Kind::OtherEpisode => injection.forge(Forgery::OtherEpisode)?,
        Kind::ForeignObservation => injection.forge(Forgery::Observation)?,
        Kind::ForeignPlan => injection.forge(Forgery::PlanAndAdvice)?,
        Kind::ForgedHealth => injection.forge(Forgery::Health)?,
        Kind::Slots => injection.lack_of_places(),
        Kind::Loans => injection.lack_of_loans()?,
        Kind::Files => {
            injection.lose_files()?;
            return Ok(Blow::Resigns);
        }
    };
    if trouble.kind == Kind::Kill && target == Process::Supervisor {
        return Ok(Blow::Ended);
    }
    let now = clock();
    let lasts = !(trouble.kind.is_a_death() || trouble.kind.is_a_hang());
    if !lasts && target == Process::Controller {
        // Before the ports are read again.
        stage.doom(controller);
    }
    let watch = stage.watch();
    let struck = watch.trial().map_or(now, |trial| trial.struck);
    watch.over(if lasts { now } else { struck });
    Ok(Blow::Goes { detail })
}

/// A fault in the making. Each kind returns more about it, in words.
struct Injection<'a> {
    stage: &'a mut Stage,
    target: Process,
    /// How long a stop, a slow process or a stranger lasts, ns.
    lasting_ns: u64,
    /// How long something is lacking, ns.
    lack_ns: u64,
    clock: Clock,
}

impl Injection<'_> {
    fn begin(&mut self) {
        self.stage.watch().begin((self.clock)());
    }

    fn pid(&mut self) -> Option<Pid> {
        self.stage.pid(self.target).and_then(Pid::from_raw)
    }

    fn kill(&mut self) -> String {
        self.begin();
        self.stage.signal(self.target, Signal::KILL);
        String::new()
    }

    fn kill_all(&mut self) -> String {
        let pids = CHILDREN.map(|process| self.stage.pid(process));
        self.begin();
        for pid in pids.into_iter().flatten().filter_map(Pid::from_raw) {
            // The death of another process may have ended it.
            let _ = rustix::process::kill_process(pid, Signal::KILL);
        }
        String::new()
    }

    fn stop(&mut self) -> String {
        self.begin();
        self.stage.signal(self.target, Signal::STOP);
        self.stage.watch_for(self.lasting_ns);
        self.stage.signal(self.target, Signal::CONT);
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
        self.stage.watch().orders.send(&mut fault);
        String::new()
    }

    fn slow(&mut self) -> String {
        self.order(FaultKind::Slow, self.lasting_ns);
        self.stage.watch_for(self.lasting_ns);
        milliseconds(self.lasting_ns)
    }

    fn lack_of_memory(&mut self, pid: Pid) -> anyhow::Result<String> {
        self.begin();
        let before = starve(pid)?;
        self.stage.watch_for(self.lack_ns);
        // A process that died of it has a successor with the supervisor's limits.
        let _ = prlimit(Some(pid), Resource::As, before);
        Ok(milliseconds(self.lack_ns))
    }

    /// Of a file system; the target may be killed meanwhile.
    fn lack_of_room(&mut self, folder: &Path, kills: bool) -> anyhow::Result<String> {
        self.begin();
        let filler = Filler::fill(folder)?;
        if kills {
            self.stage.signal(self.target, Signal::KILL);
        }
        self.stage.watch_for(self.lack_ns);
        drop(filler);
        let meanwhile = if kills { ", killed meanwhile" } else { "" };
        Ok(milliseconds(self.lack_ns) + meanwhile)
    }

    fn clock_steps(&mut self) -> anyhow::Result<String> {
        self.begin();
        step_clock("+1 hour")?;
        self.stage.watch_for(self.lack_ns);
        step_clock("-1 hour")?;
        Ok(String::new())
    }

    fn hostile(&mut self, dice: &mut Xoshiro256PlusPlus) -> anyhow::Result<String> {
        let told = Told::draw(dice);
        self.begin();
        let now = (self.clock)();
        let watch = self.stage.watch();
        let step = *watch.ledger.newest().context("a step")?;
        let refused = match told.tell(&watch.wire, (&step, now), dice)? {
            true => "",
            false => ", refused",
        };
        Ok(format!("{told}{refused}"))
    }

    /// A stranger sends what is well formed for a while.
    fn forge(&mut self, forgery: Forgery) -> anyhow::Result<String> {
        let period_ns = self.stage.scene().period_ns();
        let mut stranger = Stranger::open(&self.stage.watch().wire, forgery)?;
        self.begin();
        let until = (self.clock)().after_ns(self.lasting_ns);
        while (self.clock)() < until {
            let step = *self.stage.watch().ledger.newest().context("a step")?;
            stranger.send(&step, (self.clock)(), period_ns);
            self.stage.watch_for(FORGERY_NS);
        }
        Ok(String::new())
    }

    /// Of places at the services, while the target restarts.
    fn lack_of_places(&mut self) -> String {
        self.begin();
        let held = HeldPlaces::take(&self.stage.watch().wire);
        self.stage.signal(self.target, Signal::KILL);
        self.stage.watch_for(self.lack_ns);
        drop(held);
        milliseconds(self.lack_ns)
    }

    fn lack_of_loans(&mut self) -> anyhow::Result<String> {
        self.begin();
        hold_loans(
            &self.stage.watch().wire,
            Duration::from_nanos(self.lasting_ns),
        )?;
        Ok(String::new())
    }

    fn lose_files(&mut self) -> anyhow::Result<()> {
        self.begin();
        for path in self.stage.paths().shared_memory()? {
            // Another process may have removed its own meanwhile.
            let _ = std::fs::remove_file(path);
        }
        let _ = std::fs::remove_dir_all(self.stage.paths().dir());
        self.stage.signal(self.target, Signal::KILL);
        Ok(())
    }
}

fn milliseconds(ns: u64) -> String {
    format!("{:.0} ms", ns as f64 / 1e6)
}

/// Waits until the set drives again, or a stop is asked for; what came of the fault
/// until then.
pub fn await_recovery(
    stage: &mut Stage,
    trouble: &Trouble,
    old_pid: Option<i32>,
    (clock, stop): (Clock, &Stop),
) -> Came {
    let over = stage.watch().trial().and_then(|trial| trial.over);
    let over = over.unwrap_or_else(clock);
    let dies = trouble.kind.is_a_death() || trouble.kind.is_a_hang();
    let until = clock().after_ns(RECOVERY_NS);
    let mut recovered = None;
    while recovered.is_none() && clock() < until && !stage.has_ended() && !stop.is_asked() {
        let watch = stage.watch();
        let fresh = watch.trial().and_then(|trial| trial.fresh);
        let replaced = match (dies, trouble.target) {
            (true, Some(target)) => watch.pid(target) != old_pid,
            _ => true,
        };
        let up = CHILDREN
            .into_iter()
            .all(|process| watch.is_up(process, over));
        if fresh.is_some() && replaced && up {
            recovered = Some(clock());
        }
        pause(LOOK);
    }
    let limits = stage.watch().limits;
    let trial = stage.watch().take_trial();
    trial.map_or_else(Came::default, |trial| came(&trial, &limits, recovered))
}

/// What came of a trial.
pub fn came(trial: &Trial, limits: &super::ledger::Limits, recovered: Option<Instant>) -> Came {
    let own = limits.own_brake(trial.before, trial.anchor);
    let since = |instant: Instant| instant.since_ns(trial.struck);
    let (safe, by) = match trial.command {
        Some((handed, brakes)) if handed <= own => {
            (handed, if brakes { "brake" } else { "command" })
        }
        _ => (own, "vehicle"),
    };
    Came {
        safe_ns: Some(since(safe)),
        by,
        command_ns: trial.command.map(|(handed, _)| since(handed)),
        recovered_ns: recovered.map(since),
    }
}

/// The process may have no more address space than it has; its limit before.
fn starve(pid: Pid) -> anyhow::Result<Rlimit> {
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
        // It died a moment ago.
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
