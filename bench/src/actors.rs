//! `bench actors`: transitions per second from actors to their learner.

use std::io::{Read, Write};
use std::os::unix::net::UnixStream;
use std::path::PathBuf;
use std::process::ExitCode;
use std::thread;
use std::time::Duration;

use anyhow::{Context, bail};
use clap::Args;
use lab::actors::actor::{SentSteps, build};
use lab::actors::children::Children;
use lab::actors::connection::{Asked, Guest, SeatEvent};
use lab::actors::door::Door;
use lab::actors::drive::Episodes;
use lab::actors::envelope::{Broken, Kind, Outgoing, receive};
use lab::actors::message::{Assignment, EpisodeKey, assignment, put_hello};
use lab::actors::pool::Pool;
use lab::actors::remote::connect;
use lab::actors::tls::{CertifiedKey, Invitation, ListenerKeys, joining};
use lab::report::{Machine, table};
use lab::statistics::quantile;
use serde::Serialize;
use shm_config::config::Config;
use shm_config::layout::Layout as _;
use shm_config::message::{Message as _, Step};
use stack::Clock;
use supervisor::machine::signals::pause;
use supervisor::subcommand::{Output, Subcommand, say, seconds, write_json_option};

/// Rounds of a row.
const ROUNDS: u32 = 7;
/// Target for steps that were made before, over either transport.
const BAR: f64 = 40_000.0;
/// Longest episode that is sent, ticks.
const TICKS_MAX: u32 = 300;
/// Numbers of processes that drive.
const PROCESSES: [u32; 2] = [1, 2];
/// How long an event may take: the first episodes of new processes take some seconds.
const PATIENCE: Duration = Duration::from_secs(60);

/// How long actors have to end after their row.
const FAREWELL: Duration = Duration::from_secs(5);

/// Certificates of the tests, whose keys protect nothing else.
macro_rules! pem {
    ($name:literal) => {
        include_str!(concat!("../../lab/tests/tls/", $name, ".pem")).to_string()
    };
}

/// Measure transitions per second from actors to their learner.
#[derive(Debug, Args)]
#[command(
    after_help = "The rows unix and tls send steps that were driven before, from one thread to the \
        learner's side of a connection, which checks each step; unix is a pair of sockets within \
        the machine, tls is mutual TLS over the loopback device. The rows of actors are whole \
        processes that drive the default expert, without a learner's updates. Each row is the \
        median of seven rounds.\n\n\
        Exit code 1: a transport carries fewer than 40,000 transitions/s.\n\n\
        Examples:\n  \
        ./vlaps bench actors\n  \
        ./vlaps bench actors --seconds 20 --json actors.json"
)]
pub struct BenchActors {
    /// Seconds for each row.
    #[arg(long, value_name = "S", default_value_t = 7.0, allow_negative_numbers = true,
          value_parser = seconds)]
    pub seconds: f64,
    /// Also write the rows to this file.
    #[arg(long, value_name = "FILE")]
    pub json: Option<PathBuf>,
}

/// One row.
#[derive(Clone, Debug, Serialize)]
struct Rate {
    row: String,
    transitions_per_s: f64,
    quartiles: [f64; 2],
    megabytes_per_s: f64,
}

/// All rows.
#[derive(Debug, Serialize)]
struct ActorRates {
    rows: Vec<Rate>,
    /// Bytes of a step as it is sent.
    step_bytes: usize,
    /// Whether both transports reach the target.
    is_met: bool,
    seconds: f64,
    conditions: Machine,
}

impl Subcommand for BenchActors {
    fn outputs(&self) -> Vec<Output> {
        vec![Output::json(&self.json)]
    }

    fn run(&self, clock: Clock) -> anyhow::Result<ExitCode> {
        let conditions = Machine::here()?;
        let config = Config::default();
        let steps = driven(&config)?;
        let step_bytes = steps[0].as_bytes()[..steps[0].used_bytes()].len();
        let mut measured = RateRows {
            clock,
            round_ns: (self.seconds / f64::from(ROUNDS) * 1e9) as u64,
            step_bytes,
            rows: Vec::new(),
        };
        let configuration = toml::to_string(&config)?;
        let mut pool = Pool::new(configuration.clone());
        over_unix(&mut pool, steps.clone())?;
        measured.row("unix".into(), pool)?;
        let mut pool = Pool::new(configuration.clone());
        over_tls(&mut pool, steps)?;
        measured.row("tls".into(), pool)?;
        for processes in PROCESSES {
            let mut pool = Pool::new(configuration.clone());
            let children = Children::start(processes, &mut pool)?;
            measured.row(shm_config::counted(u64::from(processes), "actor"), pool)?;
            drop(children);
        }
        let rows = measured.rows;
        let is_met = rows[..2].iter().all(|row| row.transitions_per_s >= BAR);
        let results = ActorRates {
            rows,
            step_bytes,
            is_met,
            seconds: self.seconds,
            conditions,
        };
        print(&results);
        write_json_option(&self.json, &results)?;
        Ok(match results.is_met {
            true => ExitCode::SUCCESS,
            false => ExitCode::from(1),
        })
    }
}

/// The steps of one episode.
fn driven(config: &Config) -> anyhow::Result<Vec<Step>> {
    let mut steps = Vec::new();
    let key = EpisodeKey {
        block: 0,
        episode: 0,
    };
    Episodes::new(config)?.drive(key, TICKS_MAX, None, |step| {
        steps.push(*step);
        std::ops::ControlFlow::Continue(())
    })?;
    match steps.is_empty() {
        true => bail!("the episode has no step"),
        false => Ok(steps),
    }
}

/// Answers each assignment with the same steps until the learner's side ends.
fn answer(mut line: impl Read + Write, steps: &[Step], identity: &str) -> Result<(), Broken> {
    let (mut out, mut body) = (Outgoing::default(), Vec::new());
    put_hello(&mut out, &build(), identity);
    out.send(Kind::Hello, &mut line)?;
    receive(&mut line, &[Kind::Welcome], &mut body)?;
    while receive(&mut line, &[Kind::Drive, Kind::Finish], &mut body)? == Kind::Drive {
        let asked = assignment(&body)?;
        let mut sending = SentSteps::new(asked.key, &mut out);
        for step in steps {
            sending.add(step, &mut line)?;
        }
        sending.end(steps.len() as u32, &mut line)?;
    }
    Ok(())
}

fn over_unix(pool: &mut Pool, steps: Vec<Step>) -> anyhow::Result<()> {
    let (own, theirs) = UnixStream::pair()?;
    pool.add_local("unix".into(), own)?;
    // It ends with the connection.
    thread::spawn(move || answer(theirs, &steps, ""));
    Ok(())
}

fn over_tls(pool: &mut Pool, steps: Vec<Step>) -> anyhow::Result<()> {
    let keys = tempfile::NamedTempFile::new()?;
    std::fs::write(keys.path(), r#"{"identity": "bench", "revoked": []}"#)?;
    let mut door = Door::open(
        "127.0.0.1:0",
        ListenerKeys {
            keys: keys.path().into(),
            identity: "bench".into(),
            authority: pem!("authority"),
            certificate: CertifiedKey {
                certificate: pem!("listener"),
                key: pem!("listener-key"),
            },
        },
    )?;
    let invitation = Invitation {
        role: "actor".into(),
        peer: "00112233445566778899aabbccddeeff".into(),
        address: door.address()?.to_string(),
        authority: pem!("authority"),
        certificate: CertifiedKey {
            certificate: pem!("actor"),
            key: pem!("actor-key"),
        },
    };
    let config = joining(&invitation)?;
    thread::spawn(move || {
        let line = connect(&invitation, &config).map_err(Broken::Gone)?;
        answer(line, &steps, &invitation.peer)
    });
    loop {
        if let Some(arrived) = door.look(1)?.pop() {
            let arrived = arrived.map_err(Broken::Rejected);
            let arrived = arrived.map_err(|broken| anyhow::anyhow!("{broken}"))?;
            pool.add(
                Guest::Certified(arrived.certificate),
                arrived.line,
                arrived.close,
            )?;
            return Ok(());
        }
        pause(Duration::from_millis(10));
    }
}

/// The rows so far, and how they are measured.
struct RateRows {
    clock: Clock,
    round_ns: u64,
    step_bytes: usize,
    rows: Vec<Rate>,
}

impl RateRows {
    /// Measures the actors of a pool; all are ready before the first round.
    fn row(&mut self, row: String, mut pool: Pool) -> anyhow::Result<()> {
        let mut episode = 0;
        // The first episodes of each actor are not counted.
        self.episodes(&mut pool, &mut episode, PROCESSES[1] as usize)?;
        let mut rates = Vec::new();
        for _ in 0..ROUNDS {
            let begun = (self.clock)();
            let mut steps = 0;
            let mut elapsed_ns = 0;
            while elapsed_ns < self.round_ns {
                steps += self.episodes(&mut pool, &mut episode, 1)?;
                elapsed_ns = (self.clock)().since_ns(begun);
            }
            rates.push(steps as f64 / (elapsed_ns as f64 * 1e-9));
        }
        pool.finish(FAREWELL, pause);
        let [median, low, high] = [0.5, 0.25, 0.75].map(|share| quantile(&rates, share));
        self.rows.push(Rate {
            row,
            transitions_per_s: median,
            quartiles: [low, high],
            megabytes_per_s: median * self.step_bytes as f64 * 1e-6,
        });
        Ok(())
    }

    /// Takes so many episodes; their number of steps.
    fn episodes(&self, pool: &mut Pool, next: &mut u32, count: usize) -> anyhow::Result<usize> {
        let (mut taken, mut steps) = (0, 0);
        while taken < count {
            for seat in pool.idle() {
                let key = EpisodeKey {
                    block: 0,
                    episode: *next,
                };
                *next += 1;
                let assignment = Assignment {
                    key,
                    ticks_max: TICKS_MAX,
                    version: 0,
                };
                let asked = Asked {
                    assignment,
                    policy: None,
                };
                pool.ask(seat, asked);
            }
            match pool.event(PATIENCE).context("no actor answers")? {
                SeatEvent::Ready(..) => {}
                SeatEvent::Whole(_, _, episode) => {
                    taken += 1;
                    steps += episode.len();
                }
                SeatEvent::Gone(_, broken) => bail!("an actor: {broken}"),
            }
        }
        Ok(steps)
    }
}

fn print(results: &ActorRates) {
    let mut rows = table(&["", "transitions/s", "quartiles", "MB/s"]);
    for row in &results.rows {
        let [low, high] = row.quartiles;
        rows.add_row([
            row.row.clone(),
            format!("{:.0}", row.transitions_per_s),
            format!("{low:.0} to {high:.0}"),
            format!("{:.1}", row.megabytes_per_s),
        ]);
    }
    say(rows);
    say(format_args!(
        "{} bytes a step; target of the transports {BAR:.0}/s: {}; {} s a row; {}",
        results.step_bytes,
        if results.is_met { "met" } else { "missed" },
        results.seconds,
        results.conditions
    ));
}
