//! `vlaps-bench`: `./vlaps eval`, `bench` and `draw`.

use std::alloc::System;
use std::num::NonZeroUsize;
use std::process::ExitCode;
use std::time::Duration;

use bench::Clock;
use bench::arguments::{Arguments, Bench, Command, Draw, Eval};
use bench::eval::{Task, evaluate};
use bench::evaluation::Evaluation;
use bench::metric::FOOTNOTE;
use bench::planning::Clocks;
use bench::report::{say, write_json};
use bench::speed::Gauges;
use bench::{
    draw, faults, inference, ipc, judging, latency, learning, mpc, outputs, parity, planning,
    settings, soak, speed, swapping, sweep, train,
};
use clap::Parser;
use indicatif::{ProgressBar, ProgressStyle};
use rustix::time::{ClockId, clock_gettime};
use shm_config::text::{causes, printable_arguments, printable_lines};
use shm_config::time::monotonic;
use shm_config::{counted, secret};
use stats_alloc::{INSTRUMENTED_SYSTEM, StatsAlloc};
use supervisor::cli::failure::{EXIT_FAILED, Failure};

/// Counts bytes, for the memory of a world.
#[global_allocator]
static ALLOCATOR: &StatsAlloc<System> = &INSTRUMENTED_SYSTEM;

fn main() -> ExitCode {
    // Before anything else: nothing may copy the environment.
    let taken = secret::take().map_err(Failure::secrets);
    // A process entry point: the clock is read nowhere else.
    #[allow(clippy::disallowed_methods)]
    let clock: Clock = monotonic;
    let arguments = Arguments::try_parse().unwrap_or_else(|error| {
        let shown = Arguments::try_parse_from(printable_arguments()).err();
        shown.unwrap_or(error).exit()
    });
    let command = arguments.command;
    let done = taken
        .and_then(|()| outputs::check(&command))
        .map_err(anyhow::Error::from)
        .and_then(|()| carry_out(&command, clock));
    done.unwrap_or_else(|error| {
        use std::io::Write;
        // The reader may have gone.
        let shown = format!("error: {}", causes(&*error));
        let _ = writeln!(std::io::stderr(), "{}", printable_lines(&shown));
        let failure = error.downcast_ref::<Failure>();
        ExitCode::from(failure.map_or(EXIT_FAILED, Failure::exit_code))
    })
}

fn carry_out(command: &Command, clock: Clock) -> anyhow::Result<ExitCode> {
    match command {
        Command::Eval(arguments) => eval(arguments, clock).map(|()| ExitCode::SUCCESS),
        Command::Bench(Bench::Parity(arguments)) => parity::bench(arguments),
        Command::Bench(Bench::Sim(arguments)) => {
            speed::bench(arguments, gauges(clock)).map(|()| ExitCode::SUCCESS)
        }
        Command::Bench(Bench::Mpc(arguments)) => {
            mpc::bench(arguments, gauges(clock)).map(|()| ExitCode::SUCCESS)
        }
        Command::Bench(Bench::Policy(arguments)) => {
            inference::bench(arguments, clock, allocations).map(|()| ExitCode::SUCCESS)
        }
        Command::Bench(Bench::Learner(arguments)) => {
            learning::bench(arguments, clock).map(|()| ExitCode::SUCCESS)
        }
        Command::Bench(Bench::Swap(arguments)) => {
            swapping::bench(arguments, clock).map(|()| ExitCode::SUCCESS)
        }
        Command::Bench(Bench::Judge(arguments)) => {
            judging::bench(arguments, clock).map(|()| ExitCode::SUCCESS)
        }
        Command::Bench(Bench::Soak(arguments)) => soak::bench(arguments, clock),
        Command::Bench(Bench::Sweep(arguments)) => {
            sweep::bench(arguments, clock).map(|()| ExitCode::SUCCESS)
        }
        Command::Bench(Bench::Latency(arguments)) => {
            latency::bench(arguments, clock).map(|()| ExitCode::SUCCESS)
        }
        Command::Bench(Bench::Ipc(arguments)) => {
            ipc::bench(arguments, clock).map(|()| ExitCode::SUCCESS)
        }
        Command::Bench(Bench::IpcEcho(arguments)) => {
            ipc::peer::answer(arguments, clock).map(|()| ExitCode::SUCCESS)
        }
        Command::Bench(Bench::Faults(arguments)) => faults::bench(arguments, clock),
        Command::Bench(Bench::Planner(arguments)) => {
            let clocks = Clocks {
                wall: clock,
                core: core_time,
            };
            planning::bench(arguments, clocks).map(|()| ExitCode::SUCCESS)
        }
        Command::Train(arguments) => train::train(arguments, clock).map(|()| ExitCode::SUCCESS),
        Command::Draw(Draw::Map(arguments)) => draw::map(arguments).map(|()| ExitCode::SUCCESS),
        Command::Draw(Draw::Episode(arguments)) => {
            draw::episode(arguments, clock).map(|()| ExitCode::SUCCESS)
        }
        Command::Draw(Draw::Frame(arguments)) => {
            draw::frame(arguments, clock).map(|()| ExitCode::SUCCESS)
        }
        Command::Draw(Draw::Plan(arguments)) => {
            draw::plan(arguments, clock).map(|()| ExitCode::SUCCESS)
        }
    }
}

fn gauges(clock: Clock) -> Gauges {
    Gauges {
        clock,
        core: core_time,
        bytes_held,
    }
}

/// Processor time of this thread so far.
#[allow(clippy::disallowed_methods)] // a process entry point reads the clock
fn core_time() -> Duration {
    let now = clock_gettime(ClockId::ThreadCPUTime);
    Duration::new(now.tv_sec.unsigned_abs(), now.tv_nsec.unsigned_abs() as u32)
}

/// Allocations and reallocations so far.
fn allocations() -> usize {
    let stats = ALLOCATOR.stats();
    stats.allocations + stats.reallocations
}

/// Bytes of the heap in use.
fn bytes_held() -> usize {
    let stats = ALLOCATOR.stats();
    stats
        .bytes_allocated
        .saturating_sub(stats.bytes_deallocated)
}

/// Most failures of an evaluation that are drawn.
const DRAWN_MAX: usize = 50;

fn eval(arguments: &Eval, clock: Clock) -> anyhow::Result<()> {
    let chosen = &arguments.configuration;
    let config = settings::config(chosen.config.as_deref(), &chosen.overrides)?;
    let cores = std::thread::available_parallelism()?;
    // More would wait for a core or for an episode.
    let of_use = cores.min(NonZeroUsize::try_from(arguments.episodes as usize)?);
    let asked = arguments.threads.unwrap_or(of_use);
    let task = Task {
        driver: arguments.driver,
        world: arguments.world,
        first_seed: arguments.first_seed,
        episodes: arguments.episodes,
        threads: asked.min(of_use),
    };
    let bar = ProgressBar::new(task.episodes);
    let style = "{elapsed_precise} {wide_bar} {pos}/{len} episodes, {left}";
    bar.set_style(ProgressStyle::with_template(style)?.with_key("left", train::progress::left(0)));
    let begun = clock();
    let drives = evaluate(&task, &config, clock, |_| bar.inc(1))?;
    let elapsed_s = clock().since_ns(begun) as f64 * 1e-9;
    bar.finish_and_clear();
    let evaluation = Evaluation::new(&task, &drives);
    let last_seed = task.first_seed.wrapping_add(task.episodes - 1);
    say(format_args!(
        "{} in {}, seeds {} to {last_seed}: {} on {} in {elapsed_s:.1} s",
        task.driver.word(),
        task.world.name(),
        task.first_seed,
        counted(task.episodes, "episode"),
        counted(task.threads.get() as u64, "thread")
    ));
    if asked > of_use {
        say(format_args!(
            "--threads {asked}: with {} and {} no more than {of_use} are of use",
            counted(cores.get() as u64, "core"),
            counted(task.episodes, "episode")
        ));
    }
    say(evaluation.table());
    say(FOOTNOTE);
    if let Some(failures) = evaluation.failure_table() {
        say("failures by the strict metric, with their seeds:");
        say(failures);
    }
    if let Some(folder) = &arguments.draw {
        let seeds: Vec<u64> = evaluation
            .failures
            .iter()
            .map(|failure| failure.seed)
            .collect();
        let drawn = (&seeds[..], task.driver);
        draw::failures((folder, DRAWN_MAX), drawn, &config, clock)?;
    }
    match &arguments.json {
        Some(path) => write_json(path, &evaluation),
        None => Ok(()),
    }
}
