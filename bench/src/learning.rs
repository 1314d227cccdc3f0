//! `bench learner`: gradient steps per second, beside PyTorch on the same cores.

use clap::Args;
use std::io::{BufRead, BufReader, Write};
use std::path::PathBuf;
use std::process::ExitCode;
use std::process::{Child, ChildStdin, ChildStdout, Command, Stdio};
use supervisor::subcommand::{Output, Subcommand, seconds};

use anyhow::Context;
use learner::Rate;
use learner::algorithm::{Pvp, Regression, Size, Source, Student, pvp, regression};
use learner::replay::{ACTIONS, Buffer, Replay, Then, Transition};
use rand_xoshiro::Xoshiro256PlusPlus;
use rand_xoshiro::rand_core::{Rng, SeedableRng};
use serde::Serialize;
use shm_config::message::{FEATURES, Preference};

use crate::products::{Buffers, Pass};
use lab::report::{Machine, table};
use stack::Clock;
use supervisor::subcommand::{say, write_json_option};

/// Measure gradient steps per second, beside PyTorch.
#[derive(Debug, Args)]
#[command(
    after_help = "Measures the update of pvp (twin critics, the actor every second time, Adam, target \
        networks) and that of imitation learning, with 2 x 256 neurons, on one thread and two. If the \
        Python has PyTorch, it makes the same updates, alternating.\n\n\
        Examples:\n  \
        ./vlaps bench learner\n  \
        ./vlaps bench learner --python torch/bin/python --json learner.json"
)]
pub struct BenchLearner {
    /// Seconds for each side of a row.
    #[arg(long, value_name = "S", default_value_t = 6.0, allow_negative_numbers = true,
          value_parser = seconds)]
    pub seconds: f64,
    /// A Python with PyTorch; default: python3.
    #[arg(long, value_name = "FILE")]
    pub python: Option<PathBuf>,
    /// Also write the rows to this file.
    #[arg(long, value_name = "FILE")]
    pub json: Option<PathBuf>,
}

impl Subcommand for BenchLearner {
    fn outputs(&self) -> Vec<Output> {
        vec![Output::json(&self.json)]
    }

    fn run(&self, clock: Clock) -> anyhow::Result<ExitCode> {
        let conditions = Machine::here()?;
        let replay = replay(HELD);
        let mut torch = Torch::start(self);
        let mut rows = Vec::new();
        for kind in [Kind::Pvp, Kind::Regression] {
            for batch in BATCHES {
                for threads in THREADS {
                    let case = Case {
                        kind,
                        batch,
                        threads,
                    };
                    let theirs = torch.as_mut().ok();
                    rows.push(row(case, &replay, theirs, (self.seconds, clock))?);
                }
            }
        }
        let torch = match &torch {
            Ok(torch) => torch.version.clone(),
            Err(note) => note.clone(),
        };
        let judged = |row: &&Row| row.case.kind == Kind::Pvp && row.case.batch == BATCHES[0];
        let ratios: Option<Vec<f64>> = rows.iter().filter(judged).map(|row| row.ratio).collect();
        let results = LearnerResults {
            is_met: ratios.map(|ratios| ratios.iter().all(|&ratio| ratio >= BAR)),
            rows,
            torch,
            seconds: self.seconds,
            conditions,
        };
        print(&results);
        write_json_option(&self.json, &results)?;
        Ok(ExitCode::SUCCESS)
    }
}

/// Neurons per hidden layer, as in the experiment.
const HIDDEN: usize = 256;
/// Batch sizes: that of the configuration, and PVP4Real's.
const BATCHES: [usize; 2] = [256, 1024];
/// Numbers of threads of the matrix products.
const THREADS: [usize; 2] = [1, 2];
/// Transitions in each replay buffer.
const HELD: usize = 20_000;
/// Number of alternating turns of each side, so that both meet the same load.
const TURNS: u32 = 6;
/// Minimum number of updates per turn; updates before the first turn are not counted.
const STEPS_MIN: u32 = 5;
/// Target: PVP is this many times as fast as PyTorch at the first batch size.
const BAR: f64 = 1.5;
/// Learning rate; it does not affect the time.
const RATE: Rate = Rate::constant(1e-4);

/// The same update in PyTorch.
const SCRIPT: &str = include_str!("../torch/td3_update.py");

/// The kind of update.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
enum Kind {
    /// Twin critics, the actor every second update, target networks.
    Pvp,
    /// The actor alone.
    Regression,
}

impl Kind {
    /// Number of updates after which the sequence of passes repeats.
    fn period(self) -> u32 {
        match self {
            Kind::Pvp => 2,
            Kind::Regression => 1,
        }
    }

    fn word(self) -> &'static str {
        match self {
            Kind::Pvp => "pvp",
            Kind::Regression => "regression",
        }
    }
}

/// A kind of update with its sizes.
#[derive(Clone, Copy, Debug, Serialize)]
struct Case {
    kind: Kind,
    batch: usize,
    threads: usize,
}

impl Case {
    /// The passes of one [`Kind::period`] of updates.
    fn passes(self) -> Vec<Pass> {
        let actor = Pass {
            sizes: [FEATURES, HIDDEN, HIDDEN, ACTIONS],
            rows: self.batch,
            groups: self.batch,
            backward: false,
            weights: false,
        };
        let critic = Pass {
            sizes: [FEATURES + ACTIONS, HIDDEN, HIDDEN, 1],
            ..actor
        };
        let learns = |pass| Pass {
            backward: true,
            weights: true,
            ..pass
        };
        // Half the states have a label that prefers the expert, and a second action.
        let asked = Pass {
            rows: self.batch + self.batch / 2,
            ..critic
        };
        match self.kind {
            Kind::Regression => vec![learns(actor)],
            Kind::Pvp => {
                let mut passes = Vec::new();
                for _ in 0..self.kind.period() {
                    passes.extend([actor, critic, critic, learns(asked), learns(asked)]);
                }
                let value = Pass {
                    backward: true,
                    ..critic
                };
                passes.extend([learns(actor), value]);
                passes
            }
        }
    }
}

/// Speed of one case.
#[derive(Clone, Debug, Serialize)]
struct Row {
    #[serde(flatten)]
    case: Case,
    /// Gradient steps per second of the matrix products alone: the upper limit.
    products_per_s: f64,
    /// Our gradient steps per second, including the sampling of the batch.
    steps_per_s: f64,
    /// PyTorch's gradient steps per second; `None` without PyTorch.
    torch_steps_per_s: Option<f64>,
    /// Our steps per second over PyTorch's.
    ratio: Option<f64>,
}

/// All rows.
#[derive(Clone, Debug, Serialize)]
struct LearnerResults {
    rows: Vec<Row>,
    /// Version of PyTorch, or the reason why it is missing.
    torch: String,
    /// Seconds measured per side of a row.
    seconds: f64,
    /// Whether the target at the first batch size is met; `None` without PyTorch.
    is_met: Option<bool>,
    conditions: Machine,
}

/// Full replay buffers of arbitrary transitions.
fn replay(held: usize) -> Replay {
    let mut dice = Xoshiro256PlusPlus::seed_from_u64(1);
    let mut unit = move || (dice.next_u64() >> 40) as f32 / (1_u64 << 24) as f32;
    let mut replay = Replay::new(held);
    for k in 0..2 * held {
        let mut action = || -> [f32; ACTIONS] { [2.0 * unit() - 1.0, 2.0 * unit() - 1.0] };
        let (applied, policy, other) = (action(), action(), action());
        let transition = Transition {
            state: std::array::from_fn(|_| unit()),
            next: std::array::from_fn(|_| unit()),
            applied,
            policy,
            // The driver's action is applied, except during hand-overs.
            expert: [applied, other][k % 2],
            label: [Preference::Expert, Preference::Policy][k % 2],
            then: [Then::On, Then::End][usize::from(k % 500 < 2)],
        };
        replay.push([Buffer::Expert, Buffer::Learner][k % 2], transition);
    }
    replay
}

fn row(
    case: Case,
    replay: &Replay,
    mut torch: Option<&mut Torch>,
    (seconds, clock): (f64, Clock),
) -> anyhow::Result<Row> {
    let mut random = Xoshiro256PlusPlus::seed_from_u64(2);
    let size = Size {
        inputs: FEATURES,
        hidden: HIDDEN,
        filters: 0,
        batch: case.batch,
    };
    let mut student = match case.kind {
        Kind::Pvp => {
            let settings = pvp::Settings::published(RATE);
            Student::Pvp(Box::new(Pvp::new(settings, size, &mut random)))
        }
        Kind::Regression => {
            let settings = regression::Settings::even(RATE);
            Student::Regression(Regression::new(Source::All, size, settings, &mut random))
        }
    };
    let passes = case.passes();
    let mut buffers = Buffers::new(&passes);
    let turn_s = seconds / f64::from(TURNS);
    let [mut bare, mut ours, mut theirs] = [Pace::default(); 3];
    // The first turn warms up: memory is touched, kernels are selected.
    for turn in 0..=TURNS {
        let bare_pace = Pace::of((turn_s, clock), || buffers.multiply(&passes, case.threads));
        let pace = Pace::of((turn_s, clock), || {
            student.update(replay, &mut random, case.threads);
        });
        let their_pace = match &mut torch {
            Some(torch) => torch.measure(case, turn_s)?,
            None => Pace::default(),
        };
        if turn > 0 {
            bare.add(Pace {
                steps: bare_pace.steps * case.kind.period(),
                ..bare_pace
            });
            ours.add(pace);
            theirs.add(their_pace);
        }
    }
    let torch_steps_per_s = torch.map(|_| theirs.steps_per_s());
    Ok(Row {
        case,
        products_per_s: bare.steps_per_s(),
        steps_per_s: ours.steps_per_s(),
        torch_steps_per_s,
        ratio: torch_steps_per_s.map(|theirs| ours.steps_per_s() / theirs),
    })
}

/// Number of updates and their total time.
#[derive(Clone, Copy, Debug, Default)]
struct Pace {
    steps: u32,
    seconds: f64,
}

impl Pace {
    /// Repeats `work` for one turn.
    fn of((turn_s, clock): (f64, Clock), mut work: impl FnMut()) -> Pace {
        let mut pace = Pace::default();
        let begun = clock();
        while pace.steps < STEPS_MIN || pace.seconds < turn_s {
            work();
            pace.steps += 1;
            pace.seconds = clock().since_ns(begun) as f64 * 1e-9;
        }
        pace
    }

    fn add(&mut self, other: Pace) {
        self.steps += other.steps;
        self.seconds += other.seconds;
    }

    fn steps_per_s(self) -> f64 {
        f64::from(self.steps) / self.seconds
    }
}

/// A Python process that measures on request.
struct Torch {
    child: Child,
    turns: ChildStdin,
    paces: BufReader<ChildStdout>,
    version: String,
}

impl Torch {
    /// On failure returns the note that the table prints.
    fn start(arguments: &BenchLearner) -> Result<Torch, String> {
        let python = arguments.python.clone();
        let python = python.unwrap_or_else(|| PathBuf::from("python3"));
        let mut child = Command::new(&python)
            .args(["-c", SCRIPT])
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .stderr(Stdio::null())
            .spawn()
            .map_err(|_| format!("{} does not start", python.display()))?;
        let (Some(turns), Some(paces)) = (child.stdin.take(), child.stdout.take()) else {
            return Err(format!("{} has no pipes", python.display()));
        };
        let mut torch = Torch {
            child,
            turns,
            paces: BufReader::new(paces),
            version: String::new(),
        };
        match torch.answer() {
            Ok(line) if line.starts_with("torch ") => {
                torch.version = line;
                Ok(torch)
            }
            _ => Err(format!("PyTorch is not installed in {}", python.display())),
        }
    }

    fn answer(&mut self) -> anyhow::Result<String> {
        let mut line = String::new();
        self.paces
            .read_line(&mut line)
            .context("PyTorch's script")?;
        anyhow::ensure!(line.ends_with('\n'), "PyTorch's script ended early");
        Ok(line.trim_end().to_string())
    }

    fn measure(&mut self, case: Case, seconds: f64) -> anyhow::Result<Pace> {
        let Case {
            kind,
            batch,
            threads,
        } = case;
        writeln!(
            self.turns,
            "{} {HIDDEN} {batch} {threads} {seconds} {STEPS_MIN}",
            kind.word()
        )
        .context("PyTorch's script")?;
        let line = self.answer()?;
        let (steps, seconds) = line.split_once(' ').context("PyTorch's answer")?;
        Ok(Pace {
            steps: steps.parse().context("PyTorch's answer")?,
            seconds: seconds.parse().context("PyTorch's answer")?,
        })
    }
}

impl Drop for Torch {
    fn drop(&mut self) {
        // The process holds nothing that needs an orderly end.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

fn print(results: &LearnerResults) {
    let header = [
        "",
        "batch",
        "threads",
        "products alone",
        "steps/s",
        "PyTorch steps/s",
        "ratio",
    ];
    let mut table = table(&header);
    for row in &results.rows {
        let number = |value: Option<f64>, digits: usize| {
            value.map_or("-".into(), |value| format!("{value:.digits$}"))
        };
        table.add_row([
            row.case.kind.word().into(),
            row.case.batch.to_string(),
            row.case.threads.to_string(),
            number(Some(row.products_per_s), 1),
            number(Some(row.steps_per_s), 1),
            number(row.torch_steps_per_s, 1),
            number(row.ratio, 2),
        ]);
    }
    say(table);
    let batch = BATCHES[0];
    match results.is_met {
        Some(true) => say(format_args!(
            "bar met: pvp at batch {batch} is at least {BAR} times as fast as PyTorch"
        )),
        Some(false) => say(format_args!(
            "bar missed: pvp at batch {batch} has to be at least {BAR} times as fast as PyTorch"
        )),
        None => {}
    }
    say(format_args!(
        "2 x {HIDDEN} neurons, {} s each, alternating after a warm-up, no real-time priority, {}, {}; products alone: only the matrix products of such an update, an upper limit for an update with these products",
        results.seconds, results.torch, results.conditions
    ));
}
