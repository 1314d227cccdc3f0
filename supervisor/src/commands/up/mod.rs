//! `up`: start, watch, restart, stop, add up.

pub mod settings;

use std::io;
use std::path::Path;

use shm_config::Instant;
use shm_config::config::{Config, GateMode, Simulator};
use shm_config::services::{Process, TAKEOVER};
use shm_config::wire::Wire;

use crate::Clock;
use crate::arguments::Up;
use crate::cli::failure::Failure;
use crate::cli::output::Output;
use crate::commands::clean::tell_strangers;
use crate::machine::cores::own_cores;
use crate::machine::idle::IdleBound;
use crate::machine::memory::Memory;
use crate::machine::parent;
use crate::machine::signals::Signals;
use crate::run::folder::{cannot_write, keep, prepare_folder};
use crate::run::journal::Journal;
use crate::run::place::{Place, check_shared_memory, shared_memory};
use crate::run::restarts;
use crate::run::roster::Roll;
use crate::run::shared_memory::Need;
use crate::set::event::Event;
use crate::set::launch::{Launch, own_folder};
use crate::set::member::{Phase, Turn};
use crate::set::orphans::Orphans;
use crate::set::process_set::ProcessSet;
use crate::set::stop::Stop;
use crate::set::table::Rights;
use crate::setup::metadrive;
use crate::show::screen::{Screen, UNREAD, say};
use crate::show::summary::Summary;
use crate::show::summary_text;
use crate::show::view::View;
use crate::takeover::seat::{Keys, Seat};
use crate::telemetry::judge;
use crate::telemetry::ports::{Depth, Ports};
use crate::telemetry::tally::Tally;
use crate::telemetry::timing;

/// The loop's period, ns: 20 Hz.
const PERIOD_NS: u64 = 50_000_000;
/// While processes start, each waits for the one before: look more often, ns.
const START_PERIOD_NS: u64 = 5_000_000;
/// From view to view, ns.
const SHOW_NS: u64 = 200_000_000;
/// From look to look at the run's files, ns.
const PLACE_NS: u64 = 500_000_000;
/// From look to look at the size of the logs, ns.
const LOGS_NS: u64 = 1_000_000_000;

/// Folder of the children's binaries, for tests of the supervisor alone.
const BINARIES_VARIABLE: &str = "VLAPS_BIN_DIR";

/// How a run ended.
#[derive(Debug, Clone, PartialEq, Eq)]
enum End {
    Finished,
    Stopped,
    Killed,
    GivenUp(String),
}

/// Drives a run to its end.
///
/// # Errors
/// When the configuration is wrong, the run cannot start, or it had to be given
/// up. Nothing of it is left in shared memory either way.
pub fn up(arguments: &Up, clock: Clock) -> Result<(), Failure> {
    let started = clock();
    if let Some(parent) = arguments.parent {
        parent::end_with(parent)?;
    }
    let config = settings::resolve(arguments)?;
    shm_config::secret::take_named(&config.vlm.key_env).map_err(Failure::secrets)?;
    let json = match &arguments.json {
        Some(path) => Some((path, Output::of_option("--json", path)?)),
        None => None,
    };
    let no_signals =
        |error: io::Error| Failure::GivenUp(format!("cannot take over signals: {error}"));
    let signals = Signals::install().map_err(no_signals)?;
    if config.gate.mode == GateMode::Human {
        signals.stop_on_quit().map_err(no_signals)?;
    }
    // Its terminal is put back however this function is left.
    let keys = Keys::of(&config, arguments.keys.as_deref())?;
    let name = config
        .run
        .name
        .parse()
        .map_err(|error| Failure::Usage(format!("{error}")))?;
    let (place, leftovers) = Place::take(name)?;
    if leftovers.files > 0 {
        say(format_args!(
            "removed what a killed run '{}' left: {} files, {} KB of shared memory",
            config.run.name,
            leftovers.files,
            leftovers.bytes >> 10
        ));
    }
    tell_strangers(place.paths())?;
    check_shared_memory(shared_memory()?.0, &Need::of(&config))?;
    let folder = prepare_folder(&config, &place, arguments.parent)?;
    let late = signals.late();
    let run = (&config, &place, folder.path());
    let (end, summary, timing, screen) = drive(run, keys, signals, (clock, started))?;
    drop(place);
    // Nothing is left to stop: what still waits for a terminal or a pipe may be
    // ended like any other program.
    late.end_at_once();
    screen.close();
    // First on the screen: a full disk takes no file.
    summary_text::tell(&summary, arguments, folder.path());
    let timing = keep(&folder, timing::FILE, Ok(timing));
    let kept = keep(&folder, "summary.json", summary.text());
    // It may lie on another disk: what was refused before is told after it.
    if let Some((path, output)) = json {
        let written = summary.text().and_then(|text| output.write(&text));
        written.map_err(|error| cannot_write(path, &error))?;
    }
    timing.and(kept)?;
    match end {
        End::Finished | End::Stopped => Ok(()),
        End::Killed => Err(Failure::Killed {
            signal: late.last(),
        }),
        End::GivenUp(reason) => Err(Failure::GivenUp(reason)),
    }
}

fn drive(
    (config, place, folder): (&Config, &Place, &Path),
    keys: Option<Keys>,
    signals: Signals,
    (clock, started): (Clock, Instant),
) -> Result<(End, Summary, String, Screen), Failure> {
    let binaries = match std::env::var_os(BINARIES_VARIABLE) {
        Some(folder) => folder.into(),
        None => own_folder()
            .map_err(|error| Failure::GivenUp(format!("cannot find the binaries: {error}")))?,
    };
    let launch = Launch {
        binaries,
        // Not the copy in the folder: anybody may edit that one meanwhile.
        config: place.paths().config_file(),
        rights: rights(config),
        world: match config.world.simulator {
            Simulator::BuiltIn => None,
            Simulator::MetaDrive => Some(metadrive::world()?),
        },
    };
    let idle = IdleBound::of(config);
    let logs = folder.join("logs");
    let set = ProcessSet::new(config, launch, &logs)?;
    let wire = Wire::join(place.paths().name(), Process::Supervisor)?;
    let ports = Ports::open(&wire, config, Depth::All)?;
    let roll = Roll::open(&wire)?;
    let seat = match keys {
        Some(keys) => Some(Seat::new(keys, wire.publisher(TAKEOVER)?)),
        None => None,
    };
    let now = clock();
    let mut run = Run {
        config,
        place,
        place_looked: now,
        ports,
        seat,
        roll,
        wire,
        set,
        tally: Tally::begun(started),
        screen: Screen::open(),
        journal: Journal::open(&logs, config, now)?,
        shown: now,
        logs_tended: now,
        is_warned: false,
        judge_trouble: String::new(),
        orphans: Orphans::adopt(),
        stops_asked: 0,
        ending: None,
    };
    let grant = idle.grant();
    let bound_us = config.supervisor.cpu_latency_us;
    run.journal.line(
        now,
        &format!("processors wake up within {bound_us} us: {grant}"),
    );
    let end = run.loop_to_the_end(signals, clock);
    let ended = match &end {
        End::Finished => "finished".into(),
        End::Stopped => "stopped".into(),
        End::Killed => "killed".into(),
        End::GivenUp(reason) => format!("given up: {reason}"),
    };
    let summary = Summary::of(config, &run.tally, &run.set, ended).with_idle(&idle);
    let timing = timing::csv(&run.tally);
    Ok((end, summary, timing, run.screen))
}

/// What the processes ask for: nothing in lockstep, which has no deadline and
/// would only keep the cores from everybody else.
fn rights(config: &Config) -> Rights {
    if !config.supervisor.realtime || config.run.is_lockstep() {
        return Rights::Ordinary;
    }
    Rights::RealTime(own_cores())
}

/// A run in progress. Fields are dropped in this order: ports before the wire.
struct Run<'a> {
    config: &'a Config,
    place: &'a Place,
    place_looked: Instant,
    ports: Ports,
    seat: Option<Seat>,
    roll: Roll,
    wire: Wire,
    set: ProcessSet,
    tally: Tally,
    screen: Screen,
    journal: Journal,
    shown: Instant,
    logs_tended: Instant,
    is_warned: bool,
    judge_trouble: String,
    orphans: Orphans,
    stops_asked: usize,
    ending: Option<(End, Stop)>,
}

impl Run<'_> {
    fn loop_to_the_end(&mut self, mut signals: Signals, clock: Clock) -> End {
        loop {
            let now = clock();
            self.look(now);
            self.sit(now);
            self.stops_asked += signals.take_stops();
            let turn = match self.ending {
                None => self.act(now),
                Some(_) => Turn::Drive,
            };
            self.end_if_due(turn, now);
            self.tell(now);
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

    /// Takes in all there is to see. The dead are collected before the ports
    /// are read, so that their last words are in what is read.
    fn look(&mut self, now: Instant) {
        let died = self.set.reap(now);
        let told = self.orphans.tend(&self.set, died, now);
        told.iter().for_each(|line| self.journal.line(now, line));
        for sign in self.ports.drain(&mut self.tally) {
            self.set.hear(sign.process, sign.pid, sign.state);
        }
        if died && self.ending.is_none() {
            // Their successors find the places of the dead free.
            self.wire.sweep();
        }
    }

    /// Passes on what the person wants, when there is one.
    fn sit(&mut self, now: Instant) {
        let seat = self.seat.as_mut();
        if let Some(change) = seat.and_then(|seat| seat.tend(&self.tally, now)) {
            self.journal.line(now, change);
        }
    }

    /// Restarts, kills and starts what is due.
    fn act(&mut self, now: Instant) -> Turn {
        if now.since_ns(self.place_looked) >= PLACE_NS {
            self.place_looked = now;
            if !self.place.is_whole() {
                return Turn::GiveUp(format!(
                    "{}: the run's files were removed while it drives; who dies now could not \
                     come back, so the car is braked to a stand; start it anew",
                    self.place.paths().dir().display()
                ));
            }
        }
        let turn = match self.set.judge(now) {
            Turn::Drive if self.is_driven() && !self.set.lives(Process::World) => Turn::Finished,
            Turn::Drive => self.set.start_due(now, self.tally.resume()),
            end => end,
        };
        // At once: a process waits until it is named, and is heard from then on.
        self.roll.call(&self.wire, &self.set);
        turn
    }

    /// Every configured episode has ended: a world that dies after its last one
    /// is not started for one more.
    fn is_driven(&self) -> bool {
        let episodes = self.config.run.episodes;
        episodes > 0 && self.tally.next_episode() >= episodes
    }

    fn end_if_due(&mut self, turn: Turn, now: Instant) {
        if self.ending.is_some() {
            return;
        }
        let end = match turn {
            Turn::Finished => End::Finished,
            Turn::GiveUp(reason) => End::GivenUp(reason),
            Turn::Drive if self.stops_asked > 0 => End::Stopped,
            Turn::Drive if self.screen.is_unread() => End::GivenUp(UNREAD.into()),
            Turn::Drive => return,
        };
        let line = match &end {
            End::Finished => "the run is driven to its end".into(),
            End::Stopped | End::Killed => {
                "stopping: the car is braked to a stand; once more kills".into()
            }
            End::GivenUp(reason) => format!("giving up: {reason}"),
        };
        if end == End::Finished {
            // What the controller still does drives nothing.
            self.tally.close_steps();
        }
        self.journal.line(now, &line);
        if end == End::Stopped {
            self.screen.line(line);
        }
        let stop = Stop::begin(&self.set, &self.config.supervisor, now);
        self.ending = Some((end, stop));
    }

    fn tell(&mut self, now: Instant) {
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
        for line in self.roll.foreigners(&self.wire, &self.tally) {
            self.journal.line(now, &line);
            self.screen.line(line);
        }
        if now.since_ns(self.shown) >= SHOW_NS {
            self.shown = now;
            self.weigh();
            let view = View::from_inside(self.config, &self.tally, &self.set);
            self.screen.show(View {
                help: self.seat.as_ref().and_then(Seat::help),
                ..view
            });
        }
        if now.since_ns(self.logs_tended) >= LOGS_NS {
            self.logs_tended = now;
            self.warn_of_judge(now);
            for member in self.set.members() {
                if let Some(pid) = member.pid() {
                    self.tally.count_threads(member.row().process, pid);
                }
            }
            self.set.tend_logs();
        }
    }

    /// Takes in how much memory everybody has.
    fn weigh(&mut self) {
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
                 `./vlaps doctor` says how to grant it, --no-realtime asks for none",
                refused.join(", ")
            );
            self.journal.line(now, &line);
            self.screen.line(line);
        }
    }

    /// A judge that is not asked any more costs no tick, so nothing else shows it.
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

    fn pause_ns(&self, now: Instant) -> u64 {
        let starts = self
            .set
            .members()
            .iter()
            .any(|member| matches!(member.phase(), Phase::Waiting | Phase::Starting { .. }));
        let period_ns = match starts && self.ending.is_none() {
            true => START_PERIOD_NS,
            false => PERIOD_NS,
        };
        let due_ns = self
            .set
            .next_start()
            .map_or(u64::MAX, |due| due.since_ns(now));
        period_ns.min(due_ns.max(1_000_000))
    }
}
