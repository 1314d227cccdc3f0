//! `bench ipc`: measures what the stack's ports add to the latency of bare iceoryx2.

pub mod arguments;
mod bare;
pub mod link;
pub mod others;
pub mod peer;
pub mod port;

use hdrhistogram::Histogram;
use serde::Serialize;
use shm_config::message::{Advice, Command, Observation, Plan, Step};
use shm_config::run::{RunName, RunPaths};
use shm_config::wire::Wire;
use std::process::ExitCode;
use supervisor::machine::cores::own_cores;
use supervisor::run::leftovers::clean_run;
use supervisor::subcommand::{Output, Subcommand};

use crate::floor::stay_on;
pub use arguments::{BenchIpc, IpcEcho};
use arguments::{MessageChoice, Wake};
use lab::progress::Progress;
use lab::report::{Machine, table};
use lab::stop::Stop;
use link::{RoundTrips, histogram, ping};
use others::{Other, Program};
use peer::{Echo, Ends, Side, claim_for};
use port::{Check, End, Measured};
use stack::Clock;
use supervisor::subcommand::{say, write_json_option};

/// Number of alternating blocks of each side.
const BLOCKS: u64 = 10;
/// Round trips after which the rate is known well enough to choose the number of round
/// trips of a block.
const PROBE: u64 = 200;
/// A row ends early after this many times its sides' seconds, as on a machine with much
/// other work.
const PATIENCE: f64 = 12.0;
/// One in this many round trips at the begin of a block is not counted.
const WARM: u64 = 20;
/// Published target: the port's median over that of bare iceoryx2.
const RATIO_MAX: f64 = 1.1;

/// One message at one rate with one kind of receiver.
#[derive(Clone, Debug, Serialize)]
pub struct Row {
    /// The message.
    pub message: &'static str,
    /// Its size, bytes.
    pub bytes: usize,
    /// Messages per second; 0 for as fast as they are answered.
    pub rate_hz: u32,
    /// How the receiver waits.
    pub wake: &'static str,
    /// Real-time priority of both processes.
    pub priority: &'static str,
    /// All sides.
    pub sides: Vec<OneWay>,
    /// Median of the port over that of bare iceoryx2.
    pub ratio: f64,
}

/// One-way times of one side, ns.
#[derive(Clone, Debug, Serialize)]
pub struct OneWay {
    /// Name of the side.
    pub side: String,
    /// Round trips.
    pub count: u64,
    /// Median.
    pub p50_ns: u64,
    /// 99 % quantile.
    pub p99_ns: u64,
    /// 99.9 % quantile.
    pub p999_ns: u64,
    /// Maximum.
    pub max_ns: u64,
}

/// All rows.
#[derive(Clone, Debug, Serialize)]
pub struct Measurement {
    /// In the order of measurement.
    pub rows: Vec<Row>,
    /// The cores of the two processes; empty if they have no core each.
    pub cores: Vec<usize>,
    /// The other transports that were measured.
    pub others: Vec<Other>,
    /// The machine.
    pub conditions: Machine,
}

impl OneWay {
    fn of(side: &str, all: &Histogram<u64>) -> Self {
        Self {
            side: side.into(),
            count: all.len(),
            p50_ns: all.value_at_quantile(0.5),
            p99_ns: all.value_at_quantile(0.99),
            p999_ns: all.value_at_quantile(0.999),
            max_ns: all.max(),
        }
    }
}

struct IpcBench<'a> {
    arguments: &'a BenchIpc,
    wire: Wire,
    run: RunName,
    echo: Echo,
    stop: &'a Stop,
    clock: Clock,
}

/// Number of requested rows.
fn total(arguments: &BenchIpc) -> usize {
    let paced = arguments
        .rate
        .iter()
        .filter(|&&rate_hz| rate_hz > 0)
        .count();
    let rates = arguments.wake.iter().map(|wake| match wake {
        Wake::Grid => paced,
        Wake::Spin | Wake::Bell => arguments.rate.len(),
    });
    rates.sum::<usize>() * arguments.message.len()
}

impl Subcommand for BenchIpc {
    fn outputs(&self) -> Vec<Output> {
        vec![Output::json(&self.json)]
    }

    fn run(&self, clock: Clock) -> anyhow::Result<ExitCode> {
        let conditions = Machine::here()?;
        let cores = match own_cores()[..] {
            [.., echo, ping] => vec![ping, echo],
            _ => Vec::new(),
        };
        let programs = others::build(self)?;
        let run: RunName = format!("ipc-{}", std::process::id()).parse()?;
        let paths = RunPaths::new(run.clone());
        if let Some(&core) = cores.first() {
            stay_on(core);
        }
        let stop = Stop::listen()?;
        let mut rows = Vec::new();
        let done = measure(self, (&run, &cores), &programs, (clock, &stop), &mut rows);
        // Only these two processes were members of the run, and both have left it.
        let _ = clean_run(&paths);
        let measurement = Measurement {
            rows,
            cores,
            others: programs.into_iter().map(|program| program.other).collect(),
            conditions,
        };
        if !measurement.rows.is_empty() {
            print(&measurement);
        }
        done?;
        write_json_option(&self.json, &measurement)?;
        match total(self) - measurement.rows.len() {
            0 => Ok(ExitCode::SUCCESS),
            left => anyhow::bail!("stopped, {left} rows are left"),
        }
    }
}

/// Measures all rows, until a stop is requested.
fn measure(
    arguments: &BenchIpc,
    (run, cores): (&RunName, &[usize]),
    programs: &[Program],
    (clock, stop): (Clock, &Stop),
    rows: &mut Vec<Row>,
) -> anyhow::Result<()> {
    let mut bench = IpcBench {
        arguments,
        wire: Wire::join(run, End::Ping.process())?,
        run: run.clone(),
        echo: Echo::start(run, cores.get(1).copied())?,
        stop,
        clock,
    };
    // Spinning comes first: real-time priority is not given back afterwards.
    let mut wakes = arguments.wake.clone();
    wakes.sort_by_key(|wake| *wake != Wake::Spin);
    let total = total(arguments) as u64;
    let mut progress = Progress::begin("ipc".into(), "rows", (0, total), clock)?;
    for wake in wakes {
        for &message in &arguments.message {
            let more = match message {
                MessageChoice::Observation => bench.rows::<Observation>(wake),
                MessageChoice::Plan => bench.rows::<Plan>(wake),
                MessageChoice::Command => bench.rows::<Command>(wake),
                MessageChoice::Step => bench.rows::<Step>(wake),
                MessageChoice::Advice => bench.rows::<Advice>(wake),
            };
            for mut row in more? {
                // The other transports have no polling receiver.
                let beside = programs.iter().filter(|_| wake != Wake::Grid);
                for program in beside {
                    let all = program.measure(&row, cores, arguments.seconds)?;
                    row.sides.push(OneWay::of(program.other.name, &all));
                }
                rows.push(row);
            }
            progress.at(rows.len() as u64);
            if stop.is_asked() {
                return Ok(());
            }
        }
    }
    progress.end();
    Ok(())
}

impl IpcBench<'_> {
    /// Measures all rates of one message and receiver, until a stop is requested. Rate 0 is
    /// left out on a grid: it would only measure where on the grid an answer falls.
    fn rows<M: Measured>(&mut self, wake: Wake) -> anyhow::Result<Vec<Row>> {
        let priority = claim_for(wake);
        let mut ends = Ends::<M>::open(&self.wire, &self.run, End::Ping, wake)?;
        self.echo
            .order(&format!("open {} {}", M::WORD, wake.word()))?;
        self.echo.await_ready()?;
        let mut rows = Vec::new();
        for &rate_hz in &self.arguments.rate {
            if wake == Wake::Grid && rate_hz == 0 {
                continue;
            }
            let row = self.row(&mut ends, (wake, rate_hz, priority))?;
            // The row may have been interrupted.
            if self.stop.is_asked() {
                break;
            }
            rows.push(row);
        }
        self.echo.order("close")?;
        Ok(rows)
    }

    fn row<M: Measured>(
        &mut self,
        ends: &mut Ends<M>,
        (wake, rate_hz, priority): (Wake, u32, &'static str),
    ) -> anyhow::Result<Row> {
        let sides = [Side::Port, Side::Bare, Side::Open, Side::Tiny];
        let mut counts = [0; 4];
        for (side, count) in sides.into_iter().zip(&mut counts) {
            *count = self.count(ends, side, (wake, rate_hz))?;
        }
        let mut all = Vec::new();
        for _ in sides {
            all.push(histogram()?);
        }
        let begun = (self.clock)();
        let enough_ns = (self.arguments.seconds * PATIENCE * 1e9) as u64;
        for _ in 0..BLOCKS {
            if (self.clock)().since_ns(begun) > enough_ns || self.stop.is_asked() {
                break;
            }
            for ((side, &count), into) in sides.into_iter().zip(&counts).zip(&mut all) {
                let trips = RoundTrips {
                    wake,
                    period_ns: period_ns(rate_hz),
                    counts: [count / WARM, count],
                };
                self.block(ends, side, trips, into)?;
            }
        }
        let names = ["port", "bare iceoryx2", "port, no check", "bare, 8 bytes"];
        let sides: Vec<OneWay> = names
            .iter()
            .zip(&all)
            .map(|(name, all)| OneWay::of(name, all))
            .collect();
        Ok(Row {
            message: M::WORD,
            bytes: size_of::<M>(),
            rate_hz,
            wake: wake.word(),
            priority,
            ratio: sides[0].p50_ns as f64 / sides[1].p50_ns as f64,
            sides,
        })
    }

    /// The number of round trips that fill a block's share of the time.
    fn count<M: Measured>(
        &mut self,
        ends: &mut Ends<M>,
        side: Side,
        (wake, rate_hz): (Wake, u32),
    ) -> anyhow::Result<u64> {
        let seconds = self.arguments.seconds / BLOCKS as f64;
        if rate_hz > 0 {
            return Ok(((seconds * f64::from(rate_hz)).ceil() as u64).max(1));
        }
        let trips = RoundTrips {
            wake,
            period_ns: 0,
            counts: [PROBE, PROBE],
        };
        // By the clock, not the median: where the two processes share their cores with
        // others, most of the time passes between two messages.
        let begun = (self.clock)();
        self.block(ends, side, trips, &mut histogram()?)?;
        let took_s = (self.clock)().since_ns(begun) as f64 * 1e-9;
        let round_s = took_s / (2 * PROBE) as f64;
        Ok(((seconds / round_s) as u64).max(1))
    }

    fn block<M: Measured>(
        &mut self,
        ends: &mut Ends<M>,
        side: Side,
        trips: RoundTrips,
        into: &mut Histogram<u64>,
    ) -> anyhow::Result<()> {
        let count: u64 = trips.counts.iter().sum();
        let word = match side {
            Side::Port => "port",
            Side::Open => "open",
            Side::Bare => "bare",
            Side::Tiny => "tiny",
        };
        self.echo.order(&format!("go {word} {count}"))?;
        self.echo.await_ready()?;
        match side {
            Side::Port => {
                ends.port.check = Check::Admit;
                ping(&mut ends.port, trips, self.clock, into)
            }
            Side::Open => {
                ends.port.check = Check::Skip;
                ping(&mut ends.port, trips, self.clock, into)
            }
            Side::Bare => ping(&mut ends.bare, trips, self.clock, into),
            Side::Tiny => ping(&mut ends.tiny, trips, self.clock, into),
        }
    }
}

fn period_ns(rate_hz: u32) -> u64 {
    match rate_hz {
        0 => 0,
        _ => 1_000_000_000 / u64::from(rate_hz),
    }
}

fn print(measurement: &Measurement) {
    let mut table = table(&[
        "",
        "side",
        "round trips",
        "p50 ns",
        "p99",
        "p99.9",
        "max",
        "port / bare",
    ]);
    for row in &measurement.rows {
        let rate = match row.rate_hz {
            0 => "flat out".to_string(),
            rate_hz => format!("{rate_hz} Hz"),
        };
        let name = format!("{} {} B, {}, {rate}", row.message, row.bytes, row.wake);
        for (k, side) in row.sides.iter().enumerate() {
            let (name, ratio) = match k {
                0 => (name.clone(), format!("{:.2}", row.ratio)),
                _ => (String::new(), String::new()),
            };
            table.add_row([
                name,
                side.side.clone(),
                side.count.to_string(),
                side.p50_ns.to_string(),
                side.p99_ns.to_string(),
                side.p999_ns.to_string(),
                side.max_ns.to_string(),
                ratio,
            ]);
        }
    }
    say(table);
    let cores = match measurement.cores[..] {
        [ping, echo] => format!("two processes on cores {ping} and {echo}"),
        _ => "two processes on one core".into(),
    };
    let asked: Vec<&str> = measurement.rows.iter().map(|row| row.priority).collect();
    let sleepers = asked.iter().find(|word| **word != "not asked");
    say(format_args!(
        "one way: half of each round trip; {cores}, alternating blocks, {}; real-time priority of \
         sleeping receivers: {}; bare iceoryx2: the library's own benchmark with the same bytes \
         written and copied out; with 8 bytes as it is; nothing is left out of a maximum{}",
        measurement.conditions,
        sleepers.unwrap_or(&"not asked"),
        (measurement.others.iter())
            .map(|Other { name, version }| {
                format!("; {name} {version} over loopback, in blocks of its own")
            })
            .collect::<String>()
    ));
    let worst = |wake: &str| {
        let rows = measurement.rows.iter();
        let rows = rows.filter(|row| row.wake == wake && row.rate_hz == 0);
        rows.map(|row| row.ratio).reduce(f64::max)
    };
    for wake in ["spin", "bell"] {
        if let Some(worst) = worst(wake) {
            let word = if worst <= RATIO_MAX { "holds" } else { "over" };
            say(format_args!(
                "bar: the port adds at most 10 % to bare iceoryx2 in the median; {wake}, flat out: \
                 at most {:+.0} %, {word}",
                100.0 * (worst - 1.0)
            ));
        }
    }
}
