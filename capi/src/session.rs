//! The membership of this process in its run.

use std::process;
use std::sync::atomic::{AtomicU32, Ordering};

use clap::Parser;
use robot::clock::Begin;
use runtime::{Arguments, Member, SetUpError, TickLoop};
use shm_config::Instant;
use shm_config::message::{HealthState, Observation, Plan, Progress};
use shm_config::services::Process;
use shm_config::time::monotonic;
use shm_config::wire::Wire;
use vehicle::Fan;

use crate::description;
use crate::door::Door;
use crate::failure::{Answer, Failure};
use crate::planner::{self, PlannerSide};
use crate::port::{self, Place, Port, Use, Workspace};
use crate::world::{self, WorldSide};

/// Ports that one process may open in its life: a number is not used again, so that a
/// stale one is an error. The built-in processes open at most five.
const PORTS_MAX: usize = 64;

/// The process that joined, 0 before. It joins one run once: signals and the log are set
/// up for its whole life.
static JOINED: AtomicU32 = AtomicU32::new(0);

/// The arguments with which the supervisor starts a process.
#[derive(Parser, Debug, Clone)]
#[command(about = "A process of a VLAPS run, started by ./vlaps up")]
pub struct Cli {
    #[command(flatten)]
    arguments: Arguments,
    /// Where a world begins; the other processes ignore it.
    #[command(flatten)]
    begin: Begin,
}

/// A process that has joined its run, with its open ports.
pub struct Session {
    /// The process that joined; one that it forked is no member.
    pid: u32,
    run: TickLoop,
    door: Door,
    begin: Begin,
    has_begun: bool,
    ports: Vec<Option<Box<dyn Port>>>,
    world: Option<WorldSide>,
    planner: Option<PlannerSide>,
    messages: Messages,
    settings: toml::Table,
}

/// Room for what the loops are given.
#[derive(Default)]
struct Messages {
    observation: Workspace<Observation>,
    progress: Workspace<Progress>,
    plan: Workspace<Plan>,
}

fn process_of(word: &str) -> Result<Process, Failure> {
    let found = Process::ALL.iter().find(|process| process.word() == word);
    match found {
        None | Some(Process::Supervisor) => Err(Failure::invalid(format!(
            "no process '{word}' joins a run; there are world, planner, controller, gate, \
             learner, recorder"
        ))),
        Some(process) => Ok(*process),
    }
}

impl Session {
    /// Joins the run that the arguments of this process name.
    ///
    /// # Errors
    /// When `layout` is not this library's, the arguments or the configuration are
    /// wrong, the run uses another layout, or no supervisor names this process.
    #[allow(clippy::disallowed_methods)] // a process entry point chooses the clock
    pub fn join(layout: u64, name: &str, words: &[String]) -> Result<Self, Failure> {
        let ours = description::layout();
        if layout != ours {
            return Err(Failure::layout(layout, ours));
        }
        let member_as = process_of(name)?;
        let cli = Cli::try_parse_from(words)
            .map_err(|error| Failure::invalid(one_line(&error.to_string())))?;
        let pid = process::id();
        match JOINED.compare_exchange(0, pid, Ordering::SeqCst, Ordering::SeqCst) {
            Ok(_) => {}
            Err(joined) if joined == pid => {
                return Err(Failure::invalid("a process joins a run only once"));
            }
            Err(_) => return Err(is_forked()),
        }
        let member = Member::join(member_as, &cli.arguments, monotonic)?;
        member.wire.compare_layouts(member_as)?;
        let settings = toml::Table::try_from(&member.config)
            .map_err(|error| SetUpError::Own(format!("configuration: {error}")))?;
        let door = Door::of(&member.config, monotonic);
        Ok(Self {
            pid,
            run: TickLoop::start(member)?,
            door,
            begin: cli.begin,
            has_begun: false,
            ports: Vec::with_capacity(PORTS_MAX),
            world: None,
            planner: None,
            messages: Messages::default(),
            settings,
        })
    }

    /// Whether this process is the one that joined.
    ///
    /// # Errors
    /// When that one forked it.
    pub fn check_process(&self) -> Result<(), Failure> {
        match self.pid == process::id() {
            true => Ok(()),
            false => Err(is_forked()),
        }
    }

    fn process(&self) -> Process {
        self.run.member.process
    }

    /// Opens a port; returns its number.
    ///
    /// # Errors
    /// As [`port::open`]; when too many were opened, those since closed among them; and
    /// when this process publishes the service already.
    pub fn open(&mut self, service: &str, with: Use) -> Result<usize, Failure> {
        if self.ports.len() == PORTS_MAX {
            return Err(Failure::invalid(format!(
                "{PORTS_MAX} ports were opened, the most that a process may"
            )));
        }
        if with == Use::Write && (self.has_writer(service) || self.loop_publishes(service)) {
            return Err(Failure::invalid(format!(
                "this process publishes {service} already, by another port or by its loop"
            )));
        }
        let port = port::open(&self.run.member.wire, self.process(), service, with)?;
        self.ports.push(Some(port));
        Ok(self.ports.len() - 1)
    }

    /// Whether a port publishes it.
    fn has_writer(&self, service: &str) -> bool {
        let mut ports = self.ports.iter().flatten();
        ports.any(|port| port.publishes() == Some(service))
    }

    /// Whether the loop of the world or of the planner publishes it.
    fn loop_publishes(&self, service: &str) -> bool {
        self.world.is_some() && world::PUBLISHED.contains(&service)
            || self.planner.is_some() && planner::PUBLISHED.contains(&service)
    }

    /// A service has one publisher in a process: a port beside the loop would mix its
    /// messages with the loop's.
    fn check_no_writer(&self, services: &[&str]) -> Result<(), Failure> {
        match services.iter().find(|service| self.has_writer(service)) {
            None => Ok(()),
            Some(service) => Err(Failure::invalid(format!(
                "the loop publishes {service}: close the port that does"
            ))),
        }
    }

    /// Closes a port.
    ///
    /// # Errors
    /// When it is not open.
    pub fn close(&mut self, port: usize) -> Result<(), Failure> {
        let place = self.ports.get_mut(port).filter(|place| place.is_some());
        *place.ok_or_else(|| not_open(port))? = None;
        Ok(())
    }

    fn port(&mut self, port: usize) -> Result<(&mut dyn Port, &Wire, &mut Door), Failure> {
        let found = self.ports.get_mut(port).and_then(Option::as_mut);
        let found = found.ok_or_else(|| not_open(port))?;
        Ok((found.as_mut(), &self.run.member.wire, &mut self.door))
    }

    /// Reads the newest admissible message of a port.
    ///
    /// # Errors
    /// When the port or the length is wrong.
    pub fn newest(&mut self, port: usize, place: Place) -> Result<Answer, Failure> {
        let (port, wire, door) = self.port(port)?;
        port.newest((wire, door), place).map(answer)
    }

    /// Reads the next admissible message of a queue.
    ///
    /// # Errors
    /// As [`Session::newest`].
    pub fn next(&mut self, port: usize, place: Place) -> Result<Answer, Failure> {
        let (port, wire, door) = self.port(port)?;
        port.next((wire, door), place).map(answer)
    }

    /// Checks a message and publishes it.
    ///
    /// # Errors
    /// When the check of its service refuses it: nothing is sent then.
    pub fn publish(&mut self, port: usize, message: &[u8]) -> Result<(), Failure> {
        let (port, _, door) = self.port(port)?;
        port.publish(door, message)?;
        if port.publishes() == Some(shm_config::services::OBSERVATION.name) {
            door.asked = header_of(message);
        }
        self.run.telemetry.health.state = HealthState::Running.code();
        self.run.telemetry.health.ticks += 1;
        Ok(())
    }

    /// Checks a message as its reader will, and sends nothing.
    ///
    /// # Errors
    /// As [`Session::publish`].
    pub fn admit(&self, service: &str, message: &[u8]) -> Result<(), Failure> {
        port::admit(&self.door, service, message)
    }

    /// The first call of a loop: everything is open now.
    fn begin(&mut self) {
        if !self.has_begun {
            self.has_begun = true;
            self.run.member.apply_privileges();
            self.run
                .telemetry
                .set_privileges(&self.run.member.privileges);
            let now = self.run.now();
            self.run.telemetry.enter(HealthState::Ready, now);
        }
    }

    /// Publishes health and timing that are due, and connects to new peers.
    fn keep_up(&mut self) {
        self.begin();
        let now = self.run.now();
        self.run.telemetry.count_refused(&self.run.member.wire);
        self.run.telemetry.heartbeat(now);
        for port in self.ports.iter_mut().flatten() {
            port.update_connections();
        }
    }

    /// Sleeps until a message wakes this process, at most `limit_ns` and never longer
    /// than a heartbeat allows.
    pub fn wait(&mut self, limit_ns: u64) -> Answer {
        self.keep_up();
        if self.run.member.is_stopping() {
            return Answer::Ended;
        }
        let now = self.run.now();
        self.run.wait(Some(now.after_ns(limit_ns)), now);
        Answer::Ok
    }

    /// The world's next tick; [`WorldSide::await_tick`].
    ///
    /// # Errors
    /// When this process is not the world, a port publishes what the loop does, or shared
    /// memory refuses its ports.
    pub fn await_tick(&mut self) -> Result<Option<crate::world::Tick>, Failure> {
        if self.world.is_none() {
            check_is(self.process(), Process::World)?;
            self.check_no_writer(world::PUBLISHED)?;
            self.world = Some(WorldSide::open(&self.run.member, self.begin)?);
        }
        self.keep_up();
        match &mut self.world {
            Some(world) => world.await_tick(&mut self.run),
            None => Err(Failure::invalid("no world")),
        }
    }

    /// The world's answer to its tick; [`WorldSide::finish_tick`].
    ///
    /// # Errors
    /// When a check refuses a message, or no tick was awaited.
    pub fn finish_tick(&mut self, observation: &[u8], progress: &[u8]) -> Result<Answer, Failure> {
        let Some(world) = &mut self.world else {
            return Err(Failure::invalid("vlaps_await_tick comes first"));
        };
        let messages = (
            self.messages.observation.read("observation", observation)?,
            &*self.messages.progress.read("progress", progress)?,
        );
        world.finish_tick(&mut self.run, &mut self.door, messages)
    }

    /// The next observation at which the planner has its turn, `None` when the process
    /// was asked to stop.
    ///
    /// # Errors
    /// When this process is not the planner, a port publishes what the loop does, or
    /// shared memory refuses its ports.
    pub fn await_observation(&mut self) -> Result<Option<Observation>, Failure> {
        if self.planner.is_none() {
            check_is(self.process(), Process::Planner)?;
            self.check_no_writer(planner::PUBLISHED)?;
            self.planner = Some(PlannerSide::open(&self.run.member)?);
        }
        loop {
            self.keep_up();
            if self.run.member.is_stopping() {
                return Ok(None);
            }
            let Some(planner) = &mut self.planner else {
                return Err(Failure::invalid("no planner"));
            };
            if let Some(observation) = planner.take(&mut self.run) {
                return Ok(Some(observation));
            }
            self.run.wait(None, self.run.now());
        }
    }

    /// The planner's plan for the observation it was given.
    ///
    /// # Errors
    /// When the check refuses the plan, or no observation was awaited.
    pub fn answer(&mut self, plan: &[u8]) -> Result<(), Failure> {
        let Some(planner) = &mut self.planner else {
            return Err(Failure::invalid("vlaps_await_observation comes first"));
        };
        planner.answer(&mut self.run, self.messages.plan.read("plan", plan)?)
    }

    /// A number of the configuration by its key, such as `scanner.range_m`; true is 1.
    ///
    /// # Errors
    /// When the configuration has no such key, or it holds no number.
    pub fn setting(&self, key: &str) -> Result<f64, Failure> {
        let mut words = key.split('.');
        let first = words.next().and_then(|word| self.settings.get(word));
        let value = words.fold(first, |value, word| value?.get(word));
        match value {
            Some(toml::Value::Float(number)) => Ok(*number),
            Some(toml::Value::Integer(number)) => Ok(*number as f64),
            Some(toml::Value::Boolean(is_set)) => Ok(f64::from(u8::from(*is_set))),
            Some(_) => Err(Failure::invalid(format!("{key} is no number"))),
            None => Err(Failure::invalid(format!(
                "no key '{key}'; `./vlaps config` prints all"
            ))),
        }
    }

    /// Writes the run's scanner into an observation; where its beams look.
    pub fn show_scanner(&self, observation: &mut Observation) -> Fan {
        let scanner = &self.run.member.config.scanner;
        observation.set_fan(&scanner.fan());
        observation.lidar_max_m = scanner.range_m as f32;
        observation.fan()
    }

    /// Whether the run's clock is simulated.
    pub fn is_lockstep(&self) -> bool {
        self.run.member.config.run.is_lockstep()
    }

    /// The process id that the roster names; 0 when it names none.
    ///
    /// # Errors
    /// For an unknown process.
    pub fn pid_of(&self, process: &str) -> Result<u32, Failure> {
        let process = process_of(process)?;
        Ok(self.run.member.wire.named(process).unwrap_or(0))
    }

    /// The machine's clock, ns.
    pub fn now(&self) -> Instant {
        self.run.now()
    }

    /// The last health message.
    pub fn finish(&mut self) {
        let now = self.run.now();
        self.run.telemetry.enter(HealthState::Finished, now);
    }
}

/// What is wrong with the arguments, without the parser's usage.
fn one_line(error: &str) -> String {
    let said = error.split("\n\nUsage").next().unwrap_or(error);
    let words: Vec<_> = said
        .split_whitespace()
        .skip_while(|word| *word == "error:")
        .collect();
    format!(
        "{}; `./vlaps up` starts the processes of a run",
        words.join(" ")
    )
}

fn answer(came: bool) -> Answer {
    match came {
        true => Answer::Ok,
        false => Answer::None,
    }
}

fn is_forked() -> Failure {
    Failure::invalid("a forked process has not joined; its parent has")
}

fn not_open(port: usize) -> Failure {
    Failure::invalid(format!("port {port} is not open"))
}

fn check_is(process: Process, wanted: Process) -> Result<(), Failure> {
    match process == wanted {
        true => Ok(()),
        false => Err(Failure::invalid(format!(
            "this process joined as the {process}, not as the {wanted}"
        ))),
    }
}

/// Tick and episode of a message, from the header that each begins with.
fn header_of(message: &[u8]) -> Option<(u64, u32)> {
    use shm_config::layout::Layout;
    use shm_config::message::Header;
    let header = Header::from_bytes(message.get(..size_of::<Header>())?)?;
    Some((header.tick, header.episode))
}
