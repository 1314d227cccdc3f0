//! The side that joins: the vehicle's rows in a run of this machine, an unchanged program on
//! them, and what it publishes back.

use std::collections::VecDeque;
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use ring::signature::Ed25519KeyPair;
use shm_config::config::Config;
use shm_config::file::{Entry, Folder, make_folders};
use shm_config::message::{Advice, FrameRequest, Health, HealthState, Learning, Weights};
use shm_config::run::{Origin, RunName, RunPaths};
use shm_config::services::{ADVICE, FRAME_REQUEST, LEARNING, WEIGHTS, health};
use shm_config::wire::{Subscriber, WireError};
use shm_config::{Instant, Message};

use crate::carrier::Connection;
use crate::clock_map::ClockMap;
use crate::flow::QUEUE_MAX;
use crate::keys::Bundle;
use crate::mirror::{Mirror, Shift, instants, local_config, remove};
use crate::peer::{News, Peer, Vehicle};
use crate::program::{Look, Program};
use crate::refusal::Reason;
use crate::report;
use crate::role::{CONFIG, Passage, Role, RowId};
use crate::rows::{bytes_of, signed_bytes};
use crate::stand_in::clocks;

/// Longest wait for a packet before the program's answers are read.
const TURN: Duration = Duration::from_millis(1);
/// Packets that are read in one turn.
const TURN_MAX: usize = 256;
/// Time between two looks at program and connections, ns.
const LOOK_NS: u64 = 20_000_000;
/// The vehicle has this long to answer until the connection is made anew, ns.
const ANSWER_NS: u64 = 1_500_000_000;
/// The vehicle's clock is mapped after this many round trips: the first ones include the start
/// of the connection.
const SAMPLES: usize = 3;
/// The vehicle's clock may be this far off from the map in use until it is drawn anew, ns: a
/// tenth of the shortest time that advice is held.
const OFF_NS_MAX: u64 = 100_000_000;

/// How to join.
pub struct Options {
    /// The invitation.
    pub bundle: Bundle,
    /// `HOST:PORT` of the vehicle, when it is not the invitation's.
    pub address: String,
    /// The run's name on this machine.
    pub name: RunName,
    /// This machine's own settings: the model that a judge asks.
    pub own: Config,
}

/// What the program publishes, to be sent back.
enum Answers {
    Judge(Subscriber<Advice>, Subscriber<FrameRequest>),
    Learner(
        Subscriber<Learning>,
        Subscriber<Weights>,
        Box<Ed25519KeyPair>,
    ),
    None,
}

/// The run on this machine. The program ends before its services do.
struct Local {
    program: Option<Program>,
    answers: Answers,
    /// The program's health: it hears nothing that is published before it is ready.
    health: Option<Subscriber<Health>>,
    is_ready: bool,
    /// What came before that.
    held: VecDeque<(RowId, Arc<[u8]>)>,
    mirror: Mirror,
    text: String,
    lockstep: bool,
}

/// The join in progress.
struct Join<'a> {
    options: &'a Options,
    role: Role,
    peer: Peer,
    connection: Connection,
    local: Option<Local>,
    shift: Option<Shift>,
    heard: Instant,
    looked: Instant,
    reported: Instant,
    last_refusal: Option<Reason>,
    /// That no vehicle answers is told once.
    is_told: bool,
    report: PathBuf,
}

/// Joins until `stop` is set.
///
/// # Errors
/// One line: the invitation is damaged, the run lives already, or the program ends each time.
pub fn join(options: &Options, stop: &AtomicBool) -> Result<(), String> {
    let role = options.bundle.role().map_err(|error| error.to_string())?;
    let folder = PathBuf::from(format!("runs/{}", options.name));
    let io_failed = |error: std::io::Error| format!("{}: {error}", folder.display());
    make_folders(&folder).map_err(io_failed)?;
    let made = Folder::open(&folder, Entry::Readable).map_err(io_failed)?;
    made.make_inside("logs", Entry::Readable)
        .map_err(io_failed)?;
    let (now, _) = clocks();
    let mut join = Join {
        options,
        role,
        peer: Peer::new(&options.bundle).map_err(|error| error.to_string())?,
        connection: Connection::open(&options.bundle, &options.address)?,
        local: None,
        shift: None,
        heard: now,
        looked: Instant(0),
        reported: Instant(0),
        last_refusal: None,
        is_told: false,
        report: folder.join("link-join.json"),
    };
    tracing::info!(address = options.address, role = role.word(), "joins");
    let ended = join.work(stop);
    join.peer.end();
    join.flush();
    join.close();
    ended
}

impl Local {
    /// Keeps a message until the program is ready: of newest rows the newest, of others as
    /// many as a reader may fall behind. What is dropped here shows as a gap of numbers.
    fn hold(&mut self, role: Role, row: RowId, bytes: Arc<[u8]>) {
        if row.passage(role) == Passage::Newest {
            self.held.retain(|(held, _)| *held != row);
        }
        if self.held.len() == QUEUE_MAX {
            self.held.pop_front();
        }
        self.held.push_back((row, bytes));
    }

    /// Whether the program has become ready just now.
    fn becomes_ready(&mut self) -> bool {
        let health = self
            .health
            .as_mut()
            .and_then(|port| port.newest(Message::check));
        let state = health.and_then(|health| HealthState::from_code(health.state));
        let is_set_up = matches!(state, Some(HealthState::Ready | HealthState::Running));
        let becomes = is_set_up && !self.is_ready;
        self.is_ready |= is_set_up;
        becomes
    }
}

impl Join<'_> {
    fn work(&mut self, stop: &AtomicBool) -> Result<(), String> {
        while !stop.load(Ordering::Relaxed) {
            self.receive();
            let (now, _) = clocks();
            for news in self.peer.take_news() {
                self.hear(news, now)?;
            }
            self.map(now);
            self.release();
            self.answer();
            self.peer.poll(now);
            self.flush();
            self.look(now)?;
        }
        Ok(())
    }

    fn receive(&mut self) {
        let mut wait = TURN;
        for _ in 0..TURN_MAX {
            let Some(arrived) = self.connection.receive(wait) else {
                break;
            };
            let (now, _) = clocks();
            self.peer.receive(&arrived.bytes, (arrived.at, now));
            wait = Duration::ZERO;
        }
        let flooded = self.connection.take_flooded();
        self.peer.refused.add(Reason::Flooded, flooded);
        if let Some(live) = &self.peer.live {
            self.heard = self.heard.max(live.heard);
        }
    }

    fn flush(&mut self) {
        for bytes in self.peer.take_out() {
            self.connection.send(bytes);
        }
    }

    fn hear(&mut self, news: News, now: Instant) -> Result<(), String> {
        match news {
            News::Joined(vehicle) => {
                self.heard = now;
                (self.last_refusal, self.is_told) = (None, false);
                if vehicle == Vehicle::New {
                    self.shift = None;
                }
                tracing::info!(vehicle = ?vehicle, "joined");
            }
            News::Lost(why) => {
                tracing::warn!(why, "the session is over; connects again");
                self.connection.renew();
                self.heard = now;
            }
            News::Refused(reason) => {
                self.heard = now;
                if self.last_refusal.replace(reason) != Some(reason) {
                    tracing::error!(reason = reason.word(), "{}", advice_on(reason));
                }
            }
            News::Jumped(by_ns) => {
                let by_ms = by_ns as f64 * 1e-6;
                tracing::warn!(by_ms, "the vehicle's clock, or this one, has jumped");
                self.shift = None;
            }
            News::Message(CONFIG, bytes) => {
                let text = String::from_utf8(bytes.to_vec());
                let text = text.map_err(|_| "the vehicle's configuration is no text")?;
                self.configure(text)?;
            }
            News::Message(row, bytes) => match &mut self.local {
                Some(local) if !local.is_ready => local.hold(self.role, row, bytes),
                _ => self.write(row, &bytes),
            },
        }
        Ok(())
    }

    fn write(&mut self, row: RowId, bytes: &[u8]) {
        let Some(local) = &mut self.local else {
            return;
        };
        // In lockstep and for a learner and for files the times stay the vehicle's: nothing
        // compares them with a clock.
        let keeps = local.lockstep || matches!(self.role, Role::Learner | Role::Recorder);
        let shift = match (keeps, self.shift) {
            (true, _) => Shift::default(),
            (false, Some(shift)) => shift,
            // The clock is not mapped yet; there will be newer messages.
            (false, None) => return,
        };
        if let Err(reason) = local.mirror.write(row, bytes, shift) {
            self.peer.refused.count(reason);
        }
    }

    /// Gives a program that has become ready what came before.
    fn release(&mut self) {
        let is_mapped = self.shift.is_some();
        let Some(local) = self.local.as_mut().filter(|_| is_mapped) else {
            return;
        };
        if local.becomes_ready() {
            local.mirror.update_connections();
            for (row, bytes) in std::mem::take(&mut local.held) {
                self.write(row, &bytes);
            }
        }
    }

    /// Draws the map of the vehicle's clock, once: a question and its answer then differ by
    /// nothing. What the map is off by is added to all ages.
    fn map(&mut self, now: Instant) {
        let clock = self.peer.live.as_ref().map(|live| &live.clock);
        let samples = clock.map_or(0, ClockMap::samples);
        let Some(mapped) = clock.and_then(|clock| clock.mapped(now.0)) else {
            return;
        };
        let late_ns = i64::try_from(mapped.uncertainty_ns).unwrap_or(i64::MAX);
        let shift = Shift((-mapped.offset_ns).saturating_sub(late_ns));
        match self.shift {
            None if samples < SAMPLES => {}
            None => {
                let ahead_ms = mapped.offset_ns as f64 * 1e-6;
                let uncertainty_ms = mapped.uncertainty_ns as f64 * 1e-6;
                tracing::info!(ahead_ms, uncertainty_ms, "the vehicle's clock is mapped");
                self.shift = Some(shift);
            }
            Some(used) if used.0.abs_diff(shift.0) > OFF_NS_MAX + mapped.uncertainty_ns => {
                let by_ms = (shift.0 - used.0) as f64 * 1e-6;
                tracing::warn!(by_ms, "the clocks have run apart; mapped anew");
                self.shift = Some(shift);
            }
            Some(_) => {}
        }
    }

    fn configure(&mut self, text: String) -> Result<(), String> {
        if self.local.as_ref().is_some_and(|local| local.text == text) {
            return Ok(());
        }
        if self.local.is_some() {
            tracing::warn!("the vehicle has another configuration; begins anew");
            self.close();
        }
        let config = local_config(&text, &self.options.name, &self.options.own)?;
        let folder = PathBuf::from(&config.run.folder);
        let whole = folder.canonicalize().map_err(|error| error.to_string())?;
        let mut config = config;
        config.run.folder = whole.display().to_string();
        let origin = Origin {
            folder: whole.clone(),
            parent: None,
        };
        let mirror = Mirror::open(&config, self.role, &origin)?;
        let answers = self.answers(&mirror)?;
        let program = match self.role.stands_for() {
            Some(process) => {
                let log = whole.join("logs").join(format!("{process}.log"));
                let program = Program::new(process, &mirror.paths.config_file(), log);
                Some(program.map_err(|error| error.to_string())?)
            }
            None => None,
        };
        let name = &self.options.name;
        match self.role {
            Role::View => tracing::info!("`./vlaps view --run {name}` shows it"),
            Role::Recorder => tracing::info!("`./vlaps record {name} --out DIR` records it"),
            Role::Judge | Role::Learner => {}
        }
        let health = match self.role.stands_for() {
            Some(process) => {
                let port = mirror.wire.latest(health(process));
                Some(port.map_err(|error| error.to_string())?)
            }
            None => None,
        };
        self.local = Some(Local {
            is_ready: program.is_none(),
            held: VecDeque::new(),
            health,
            program,
            answers,
            mirror,
            text,
            lockstep: config.run.is_lockstep(),
        });
        Ok(())
    }

    fn answers(&self, mirror: &Mirror) -> Result<Answers, String> {
        let wire = &mirror.wire;
        let failed = |error: WireError| error.to_string();
        Ok(match self.role {
            Role::Judge => Answers::Judge(
                wire.latest(ADVICE).map_err(failed)?,
                wire.latest(FRAME_REQUEST).map_err(failed)?,
            ),
            Role::Learner => {
                let signer = self.options.bundle.signer();
                Answers::Learner(
                    wire.latest(LEARNING).map_err(failed)?,
                    wire.latest(WEIGHTS).map_err(failed)?,
                    Box::new(signer.map_err(|error| error.to_string())?),
                )
            }
            Role::View | Role::Recorder => Answers::None,
        })
    }

    /// Sends what the program has published.
    fn answer(&mut self) {
        let Some(local) = &mut self.local else {
            return;
        };
        let shift = match local.lockstep {
            true => Shift::default(),
            false => self.shift.unwrap_or_default(),
        };
        let mut push = |service: &str, bytes| {
            if let Some(row) = RowId::of(service) {
                self.peer.push(row, bytes);
            }
        };
        match &mut local.answers {
            Answers::Judge(advices, requests) => {
                if let Some(mut advice) = advices.newest(Message::check) {
                    for at_ns in instants(&mut advice) {
                        *at_ns = shift.there(*at_ns);
                    }
                    push(ADVICE.name, bytes_of(&advice));
                }
                if let Some(mut request) = requests.newest(Message::check) {
                    request.header.taken_ns = shift.there(request.header.taken_ns);
                    push(FRAME_REQUEST.name, bytes_of(&request));
                }
            }
            Answers::Learner(learning, weights, signer) => {
                let run = self.options.bundle.identity;
                let signed = weights.visit(|weights| match weights.check() {
                    Ok(()) => Some(signed_bytes(weights, run, signer)),
                    Err(_) => None,
                });
                if let Some(bytes) = signed.flatten() {
                    push(WEIGHTS.name, bytes);
                }
                if let Some(learning) = learning.newest(Message::check) {
                    push(LEARNING.name, bytes_of(&learning));
                }
            }
            Answers::None => {}
        }
    }

    /// Looks at what changes seldom.
    fn look(&mut self, now: Instant) -> Result<(), String> {
        if now.since_ns(self.looked) < LOOK_NS {
            return Ok(());
        }
        self.looked = now;
        if self.peer.live.is_none() && now.since_ns(self.heard) > ANSWER_NS {
            self.heard = now;
            self.connection.renew();
            if !self.is_told {
                self.is_told = true;
                let address = &self.options.address;
                tracing::warn!(address, "no vehicle answers; tries on");
            }
        }
        if now.since_ns(self.reported) >= report::REPORT_NS {
            self.reported = now;
            let text = report::of_peer(&self.peer, &self.options.address, now);
            // A full disk costs the report, and nothing else.
            let _ = report::write(&self.report, &text);
        }
        let Some(local) = &mut self.local else {
            return Ok(());
        };
        if let (Some(program), Some(process)) = (&mut local.program, self.role.stands_for()) {
            match program.look(now) {
                Look::Same => local.is_ready &= program.is_running(),
                Look::Started(pid) => {
                    local.is_ready = false;
                    local.mirror.name(process, pid);
                    local.mirror.wire.sweep();
                }
                Look::GivenUp(why) => return Err(why),
            }
        }
        local.mirror.update_connections();
        if let Some(health) = &mut local.health {
            health.update_connections();
        }
        match &mut local.answers {
            Answers::Judge(advices, requests) => {
                advices.update_connections();
                requests.update_connections();
            }
            Answers::Learner(learning, weights, _) => {
                learning.update_connections();
                weights.update_connections();
            }
            Answers::None => {}
        }
        Ok(())
    }

    fn close(&mut self) {
        if let Some(local) = self.local.take() {
            let paths: RunPaths = local.mirror.paths.clone();
            drop(local);
            remove(&paths);
        }
    }
}

/// What a user does about a refusal.
fn advice_on(reason: Reason) -> &'static str {
    match reason {
        Reason::OtherRun => "the invitation is of another run; ask for one of this run",
        Reason::WrongKey => "the invitation is not of this run's keys; ask for a new one",
        Reason::WrongRole => "this port is of another role; use the port of yours",
        Reason::Expired => "the invitation has ended; ask for a new one",
        Reason::Revoked => "the invitation was revoked; ask for a new one",
        Reason::OtherLayout => "the vehicle has another version; build both from one source",
        Reason::Occupied => "another peer has this role now; tries again",
        _ => "the vehicle refuses",
    }
}
